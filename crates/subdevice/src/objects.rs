//! The MainDevice's access to the dictionary: rights by state, gaps, complete access, and the rules
//! of the objects that the stack itself uses.

use isocat_sync::object::{ERROR_SETTINGS, INPUT_PARAMETER, OUTPUT_PARAMETER, sub};
use isocat_sync::object::{INPUT_ASSIGNMENT, INTERPOLATION_TIME, OUTPUT_ASSIGNMENT};
use isocat_sync::{SyncMode, SyncType};
use isocat_wire::coe::DataType;
use isocat_wire::coe::info::{Access, ObjectCode};
use isocat_wire::{AbortCode, AlState, Nanos, ObjectAddress};

use crate::application::Application;
use crate::assignment;
use crate::checks;
use crate::description::{Entry, Object};
use crate::dictionary::Values;
use crate::misbehaviour::{self, Faults, Misbehaviour};
use crate::sync_engine::{Chosen, SyncEngine};

/// Most bytes of a value, and of an object in complete access, that an SDO can carry.
pub const MAX_TRANSFER: usize = 1024;

/// The dictionary, with everything that affects an access.
pub(crate) struct Objects<'a, A> {
    pub dictionary: Values<'a>,
    pub application: &'a mut A,
    pub sync: &'a mut SyncEngine,
    pub chosen: &'a mut Chosen,
    pub state: AlState,
}

impl<A: Application> Objects<'_, A> {
    /// Writes one entry.
    pub fn write(&mut self, address: ObjectAddress, data: &[u8]) -> Result<(), AbortCode> {
        let entry = self.writable(address)?;
        check_length(entry, data.len())?;
        let mut value = Value::new(entry)?;
        value.bytes_mut()[..data.len()].copy_from_slice(data);
        value.mask(entry);
        self.check_value(address, entry, value.bytes(), None)?;
        self.application.write_object(address, value.bytes())?;
        self.store(address, entry, value.bytes());
        Ok(())
    }

    /// Writes an object from sub-index `first` (0 or 1) on, packed as in complete access. If one
    /// entry must not be written, none is; only a refusal by the application comes after earlier
    /// entries were written.
    pub fn write_complete(&mut self, index: u16, first: u8, data: &[u8]) -> Result<(), AbortCode> {
        let object = self.complete(index, first)?;
        let start = complete_start(first);
        let given = |entry: &&Entry| {
            let end = entry.complete_access_offset + u32::from(entry.bits);
            entry.sub >= first && !entry.is_gap() && end <= start + 8 * data.len() as u32
        };
        if data.len() > complete_len(object, first, u8::MAX) {
            return Err(AbortCode::TOO_LONG);
        }
        // The number of entries comes first, and decides how many must follow.
        let count = (first == 0 && assignment::is_guarded_by_count(index))
            .then(|| data.first().copied().unwrap_or_default());
        let given_last = object.entries.iter().rfind(given).map(|entry| entry.sub);
        let expected = count.unwrap_or(0).max(first);
        if given_last.is_none_or(|last| last < expected) {
            return Err(match count {
                Some(count) if count > object.max_sub() => AbortCode::TOO_HIGH,
                _ => AbortCode::TOO_SHORT,
            });
        }
        let cut = object.entries.iter().find(|entry| {
            let begins = entry.complete_access_offset < start + 8 * data.len() as u32;
            entry.sub >= first && !entry.is_gap() && begins && !given(entry)
        });
        if cut.is_some() {
            return Err(AbortCode::LENGTH_MISMATCH);
        }
        let mut any_writable = false;
        for entry in object.entries.iter().filter(given) {
            let address = ObjectAddress::new(index, entry.sub);
            let value = Value::unpack(entry, data, start)?;
            match self.writable(address) {
                Ok(entry) => {
                    any_writable = true;
                    self.check_value(address, entry, value.bytes(), count)?;
                }
                Err(fault) => {
                    // An entry that cannot be written is accepted if it has its present value.
                    let mut present = [0; MAX_TRANSFER];
                    let same = self
                        .value(address, entry, &mut present)
                        .is_ok_and(|len| present[..len] == *value.bytes());
                    if !same {
                        return Err(fault);
                    }
                }
            }
        }
        if !any_writable {
            return Err(AbortCode::READ_ONLY);
        }
        for entry in object.entries.iter().filter(given) {
            let address = ObjectAddress::new(index, entry.sub);
            if self.writable(address).is_ok() {
                let value = Value::unpack(entry, data, start)?;
                self.application.write_object(address, value.bytes())?;
                self.store(address, entry, value.bytes());
            }
        }
        Ok(())
    }

    /// Reads one entry into the front of `target`; returns its length in bytes.
    pub fn read(
        &mut self,
        address: ObjectAddress,
        target: &mut [u8; MAX_TRANSFER],
    ) -> Result<usize, AbortCode> {
        let entry = self.readable(address)?;
        self.value(address, entry, target)
    }

    /// Reads an object from sub-index `first` (0 or 1) on, packed as in complete access. Entries
    /// that cannot be read are zeros; if none can be read, the transfer fails.
    pub fn read_complete(
        &mut self,
        index: u16,
        first: u8,
        target: &mut [u8; MAX_TRANSFER],
    ) -> Result<usize, AbortCode> {
        let object = self.complete(index, first)?;
        let start = complete_start(first);
        let last = if self.is_hidden(index) {
            0
        } else if object.code == ObjectCode::ARRAY || assignment::is_guarded_by_count(index) {
            self.dictionary.value(index, 0).unwrap_or_default().min(u32::from(u8::MAX)) as u8
        } else {
            u8::MAX
        };
        let len = complete_len(object, first, last);
        if len > target.len() {
            return Err(AbortCode::OBJECT_TOO_BIG);
        }
        target[..len].fill(0);
        let mut result = Err(AbortCode::WRITE_ONLY);
        for entry in object.entries {
            if entry.sub < first || entry.sub > last || entry.is_gap() {
                continue;
            }
            let address = ObjectAddress::new(index, entry.sub);
            if let Err(fault) = self.readable(address) {
                if result.is_err() {
                    result = Err(fault);
                }
                continue;
            }
            let mut value = [0; MAX_TRANSFER];
            let bytes = self.value(address, entry, &mut value)?;
            pack(entry, &value[..bytes], start, &mut target[..len]);
            result = Ok(len);
        }
        if self.faults().contains(&Misbehaviour::ShiftedCompleteAccess(index)) {
            target[..len].rotate_left(1);
        }
        if last < first.max(1) { Ok(len) } else { result }
    }

    /// Checks whether a download may begin: `total` bytes to an entry, or to an object from the
    /// sub-index on.
    pub fn check_download(
        &self,
        address: ObjectAddress,
        complete: bool,
        total: usize,
    ) -> Result<(), AbortCode> {
        if total > MAX_TRANSFER {
            return Err(AbortCode::OUT_OF_MEMORY);
        }
        if complete {
            let object = self.complete(address.index, address.sub)?;
            let most = complete_len(object, address.sub, u8::MAX);
            return if total > most { Err(AbortCode::TOO_LONG) } else { Ok(()) };
        }
        check_length(self.writable(address)?, total)
    }

    /// The misbehaviours of the device.
    pub fn faults(&self) -> &Faults {
        self.dictionary.description().behaviour.faults()
    }

    /// Bytes of an entry, for a download without a stated size.
    pub fn entry_len(&self, address: ObjectAddress) -> Result<usize, AbortCode> {
        Ok(self.entry(address)?.len())
    }

    fn entry(&self, address: ObjectAddress) -> Result<&'static Entry, AbortCode> {
        let object = self.dictionary.object(address.index).ok_or(AbortCode::NO_OBJECT)?;
        let hidden = address.sub != 0 && self.is_hidden(address.index)
            || self.faults().contains(&Misbehaviour::MissingEntry(address));
        let entry = object.entry(address.sub).filter(|_| !hidden).ok_or(AbortCode::NO_SUBINDEX)?;
        if entry.is_gap() { Err(AbortCode::UNSUPPORTED_ACCESS) } else { Ok(entry) }
    }

    fn readable(&self, address: ObjectAddress) -> Result<&'static Entry, AbortCode> {
        let entry = self.entry(address)?;
        let cyclic = matches!(self.state, AlState::SafeOp | AlState::Op);
        let refused = cyclic && self.faults().contains(&Misbehaviour::RefusesRead(address));
        if !entry.access.has_any(Access::READ) {
            Err(AbortCode::WRITE_ONLY)
        } else if refused || !entry.access.has(self.right(READ_PREOP)) {
            Err(AbortCode::WRONG_STATE)
        } else {
            Ok(entry)
        }
    }

    fn writable(&self, address: ObjectAddress) -> Result<&'static Entry, AbortCode> {
        let entry = self.entry(address)?;
        let faults = self.faults();
        if faults.contains(&Misbehaviour::AcceptsWrite(address)) {
            return Ok(entry);
        }
        let refused = faults.contains(&Misbehaviour::RefusesWrite(address, self.state));
        let read_only = faults.contains(&Misbehaviour::ReadOnly(address));
        if read_only || !entry.access.has_any(Access::WRITE) {
            Err(AbortCode::READ_ONLY)
        } else if refused || !entry.access.has(self.right(Access::WRITE_PREOP.0)) {
            Err(AbortCode::WRONG_STATE)
        } else {
            Ok(entry)
        }
    }

    /// The right of PREOP, shifted to that of the present state.
    const fn right(&self, preop: u16) -> Access {
        Access(match self.state {
            AlState::SafeOp => preop << 1,
            AlState::Op => preop << 2,
            _ => preop,
        })
    }

    fn complete(&self, index: u16, first: u8) -> Result<&'static Object, AbortCode> {
        let object = self.dictionary.object(index).ok_or(AbortCode::NO_OBJECT)?;
        if first > 1 || object.code == ObjectCode::VAR {
            return Err(AbortCode::UNSUPPORTED_ACCESS);
        }
        Ok(object)
    }

    /// Whether the object hides its sub-indices because its direction is not transmitted.
    fn is_hidden(&self, index: u16) -> bool {
        self.dictionary.description().behaviour.hide_unused_sync_objects && self.is_unused(index)
    }

    /// Whether the direction of the object is not transmitted.
    fn is_unused(&self, index: u16) -> bool {
        matches!(self.state, AlState::SafeOp | AlState::Op)
            && match index {
                OUTPUT_PARAMETER => !self.sync.has_outputs(),
                INPUT_PARAMETER => !self.sync.has_inputs(),
                _ => false,
            }
    }

    fn value(
        &mut self,
        address: ObjectAddress,
        entry: &Entry,
        target: &mut [u8; MAX_TRANSFER],
    ) -> Result<usize, AbortCode> {
        let len = entry.len();
        if len > target.len() {
            return Err(AbortCode::OBJECT_TOO_BIG);
        }
        let target = &mut target[..len];
        let faults = self.faults();
        let half = address.sub == 0
            && faults.contains(&Misbehaviour::HalfHidden)
            && self.is_unused(address.index);
        let own = if half || address.sub == 0 && self.is_hidden(address.index) {
            Some(0)
        } else {
            self.sync.counter(address).or_else(|| self.measured(address, entry))
        };
        let own = if faults.is_empty() { own } else { self.shown(address, entry, own) };
        if let Some(number) = own {
            for (target, byte) in target.iter_mut().zip(number.to_le_bytes()) {
                *target = byte;
            }
            return Ok(len);
        }
        if let Some(given) = self.application.read_object(address, target) {
            return given.map(|bytes| bytes.min(len));
        }
        target.copy_from_slice(self.dictionary.bytes(entry));
        Ok(len)
    }

    /// The measured value of a time that the device states as 0.
    fn measured(&self, address: ObjectAddress, entry: &Entry) -> Option<u32> {
        if !matches!(address.index, OUTPUT_PARAMETER | INPUT_PARAMETER) {
            return None;
        }
        let measured = &self.dictionary.description().behaviour.measured;
        let able = match address.sub {
            sub::CYCLE_TIME => measured.cycle,
            sub::SHIFT_TIME => measured.shift,
            sub::MINIMUM_CYCLE_TIME => measured.minimum_cycle,
            sub::CALC_AND_COPY_TIME => measured.calc_and_copy,
            sub::DELAY_TIME => measured.delay,
            _ => false,
        };
        let stated = self.dictionary.description().power_on(entry).iter().any(|&byte| byte != 0);
        let written = address.sub == sub::CYCLE_TIME && self.chosen.cycle;
        if able && !stated && !written { self.sync.measured(address) } else { None }
    }

    /// The number that an entry shows in place of the right one, if it differs.
    fn shown(&self, address: ObjectAddress, entry: &Entry, own: Option<u32>) -> Option<u32> {
        let stored = number(self.dictionary.bytes(entry));
        let right = own.unwrap_or(stored);
        let shown = misbehaviour::shown(self.faults(), address, right);
        if shown == right { own } else { Some(shown) }
    }

    /// Checks the rules of the stack's own objects. `count` is the number of entries in the same
    /// complete access.
    fn check_value(
        &self,
        address: ObjectAddress,
        entry: &Entry,
        value: &[u8],
        count: Option<u8>,
    ) -> Result<(), AbortCode> {
        let same = self.dictionary.bytes(entry) == value;
        let number = number(value);
        let ObjectAddress { index, sub } = address;
        if self.faults().contains(&Misbehaviour::AcceptsValue(address, number)) {
            return Ok(());
        }
        if assignment::is_guarded_by_count(index) {
            let closed = sub != 0 && count.is_none();
            let occupied = self.dictionary.value(index, 0).is_some_and(|count| count != 0);
            if closed && occupied && !same {
                return Err(AbortCode::SUB0_NOT_ZERO);
            }
            return assignment::check_write(&self.dictionary, address, number);
        }
        if index != OUTPUT_PARAMETER && index != INPUT_PARAMETER {
            return Ok(());
        }
        let cyclic = matches!(self.state, AlState::SafeOp | AlState::Op);
        match sub {
            sub::SYNC_TYPE if cyclic && !same => Err(AbortCode::WRONG_STATE),
            sub::SYNC_TYPE if !cyclic => self.check_sync_type(index, SyncType(number as u16)),
            sub::CYCLE_TIME if cyclic && !same => {
                if self.sync.mode() != SyncMode::FreeRun {
                    Err(AbortCode::WRONG_STATE)
                } else if Nanos::from_u32(number) < checks::minimum_cycle_time(&self.dictionary) {
                    Err(AbortCode::TOO_LOW)
                } else {
                    Ok(())
                }
            }
            _ => Ok(()),
        }
    }

    /// Checks whether the type may be chosen, by the device's capabilities and the present
    /// assignment.
    fn check_sync_type(&self, index: u16, chosen: SyncType) -> Result<(), AbortCode> {
        let description = self.dictionary.description();
        let transmits = |assigned, most: u16| match assignment::length(&self.dictionary, assigned) {
            Ok(Some(bytes)) => bytes > 0,
            Ok(None) => most > 0,
            Err(_) => false,
        };
        let outputs = transmits(OUTPUT_ASSIGNMENT, description.outputs.max_length);
        let inputs = transmits(INPUT_ASSIGNMENT, description.inputs.max_length);
        let supported = checks::supported_types(&self.dictionary, outputs, inputs);
        let of_outputs = index == OUTPUT_PARAMETER;
        let allowed = match chosen {
            SyncType::FREE_RUN => true,
            SyncType::SM if of_outputs => outputs && supported.sm_synchronous(),
            SyncType::SM => !outputs && inputs && supported.sm_synchronous(),
            SyncType::INPUTS_ON_SM2 => !of_outputs && outputs && supported.sm_synchronous(),
            SyncType::DC_SYNC0 => supported.dc_sync0(),
            SyncType::DC_SYNC1 => supported.dc_sync1(),
            _ => false,
        };
        if allowed { Ok(()) } else { Err(AbortCode::VALUE_RANGE) }
    }

    /// Stores a value and applies its effects.
    fn store(&mut self, address: ObjectAddress, entry: &Entry, value: &[u8]) {
        self.dictionary.bytes_mut(entry).copy_from_slice(value);
        let of_outputs = address.index == OUTPUT_PARAMETER;
        match address.index {
            OUTPUT_PARAMETER | INPUT_PARAMETER => match address.sub {
                sub::SYNC_TYPE if of_outputs => self.chosen.output_type = true,
                sub::SYNC_TYPE => self.chosen.input_type = true,
                sub::CYCLE_TIME => {
                    // Both directions have the same cycle.
                    self.chosen.cycle = true;
                    let other = if of_outputs { INPUT_PARAMETER } else { OUTPUT_PARAMETER };
                    self.dictionary.set(other, sub::CYCLE_TIME, number(value));
                }
                sub::GET_CYCLE_TIME => {
                    // One command serves both directions; the written value is kept.
                    let ignores = self.faults().contains(&Misbehaviour::IgnoresReset);
                    if number(value) & RESET_COUNTERS != 0 && !ignores {
                        self.sync.reset_counters();
                    }
                    let other = if of_outputs { INPUT_PARAMETER } else { OUTPUT_PARAMETER };
                    let others = self.dictionary.value(other, sub::GET_CYCLE_TIME).unwrap_or(0);
                    if number(value) & MEASURE != 0 {
                        self.sync.measure(true);
                    } else if others & MEASURE == 0 {
                        self.sync.measure(false);
                    }
                }
                _ => {}
            },
            ERROR_SETTINGS => {}
            INTERPOLATION_TIME => {
                self.chosen.interpolation = true;
                return;
            }
            _ => return,
        }
        self.sync.load_settings(&self.dictionary);
    }
}

/// The bytes of one entry while it is checked.
struct Value {
    bytes: [u8; MAX_TRANSFER],
    len: usize,
}

impl Value {
    fn new(entry: &Entry) -> Result<Self, AbortCode> {
        let len = entry.len();
        if len > MAX_TRANSFER {
            return Err(AbortCode::OBJECT_TOO_BIG);
        }
        Ok(Self { bytes: [0; MAX_TRANSFER], len })
    }

    /// Extracts the entry's bits from a complete access that starts at bit `start` of the object.
    fn unpack(entry: &Entry, data: &[u8], start: u32) -> Result<Self, AbortCode> {
        let mut value = Self::new(entry)?;
        let from = entry.complete_access_offset.saturating_sub(start) as usize;
        for bit in 0..usize::from(entry.bits) {
            let at = from + bit;
            if data.get(at / 8).is_some_and(|byte| byte >> (at % 8) & 1 != 0) {
                value.bytes[bit / 8] |= 1 << (bit % 8);
            }
        }
        Ok(value)
    }

    /// Clears the unused bits of the last byte.
    fn mask(&mut self, entry: &Entry) {
        let used = entry.bits % 8;
        if used != 0 && self.len > 0 {
            self.bytes[self.len - 1] &= (1 << used) - 1;
        }
    }

    fn bytes(&self) -> &[u8] {
        &self.bytes[..self.len]
    }

    fn bytes_mut(&mut self) -> &mut [u8] {
        &mut self.bytes[..self.len]
    }
}

/// Inserts the entry's bits into a complete access that starts at bit `start` of the object.
fn pack(entry: &Entry, value: &[u8], start: u32, target: &mut [u8]) {
    let to = entry.complete_access_offset.saturating_sub(start) as usize;
    for bit in 0..usize::from(entry.bits).min(8 * value.len()) {
        let at = to + bit;
        if value[bit / 8] >> (bit % 8) & 1 != 0
            && let Some(byte) = target.get_mut(at / 8)
        {
            *byte |= 1 << (at % 8);
        }
    }
}

/// Bytes of a complete access from sub-index `first` to `last`. Sub-index 0 takes 16 bits.
fn complete_len(object: &Object, first: u8, last: u8) -> usize {
    let start = complete_start(first);
    let entries = object.entries.iter().filter(|entry| (first..=last).contains(&entry.sub));
    let end = entries.map(|entry| {
        let bits = if entry.sub == 0 { FIRST_SUB_BITS } else { u32::from(entry.bits) };
        entry.complete_access_offset + bits
    });
    end.max().unwrap_or(0).saturating_sub(start).div_ceil(8) as usize
}

/// The bit of the object at which a complete access from this sub-index starts.
const fn complete_start(first: u8) -> u32 {
    if first == 0 { 0 } else { FIRST_SUB_BITS }
}

/// Checks a length. A number must have all its bytes; text may be shorter.
fn check_length(entry: &Entry, given: usize) -> Result<(), AbortCode> {
    let text = matches!(
        entry.data_type,
        DataType::VISIBLE_STRING | DataType::OCTET_STRING | DataType::UNICODE_STRING
    );
    if given > entry.len() {
        Err(AbortCode::TOO_LONG)
    } else if given < entry.len() && !text {
        Err(AbortCode::TOO_SHORT)
    } else {
        Ok(())
    }
}

fn number(value: &[u8]) -> u32 {
    value.iter().take(4).rev().fold(0, |number, &byte| number << 8 | u32::from(byte))
}

/// Bits that sub-index 0 takes in complete access.
const FIRST_SUB_BITS: u32 = 16;
/// Right to read in PREOP.
const READ_PREOP: u16 = 0x0001;
/// Sub-index 08, bit 0: start a new measurement.
const MEASURE: u32 = 0x0001;
/// Sub-index 08, bit 1: reset the error counters.
const RESET_COUNTERS: u32 = 0x0002;
