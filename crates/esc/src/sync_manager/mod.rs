//! SyncManagers: which side may access guarded memory, and when a buffer changes hands.
//!
//! The first byte of an area opens its buffer, and the last one closes it; in between any bytes may
//! be accessed in any number of accesses. A buffer that ECAT closed changes hands at the end of a
//! good frame.

mod unit;

use core::ops::Range;

use isocat_wire::register::{Value, al_event, sm_status, sync_manager};
use isocat_wire::sync_manager::SyncManager;

use crate::chip::Chip;
use crate::memory::Registers;
use crate::room::Room;
use unit::{PDI_DEACTIVATED, Unit};

/// The side that accesses.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Side {
    /// The wire.
    Ecat,
    /// The local CPU.
    Pdi,
}

/// The direction of the data, seen from the side that accesses.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Direction {
    /// From the ESC.
    Read,
    /// Into the ESC.
    Write,
}

/// The result of an access to memory.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) struct Access {
    /// At least one byte was accessed.
    pub any: bool,
    /// A buffer that triggers the watchdog was completed.
    pub watchdog: bool,
    /// The PDI opened a buffer whose SyncManager records the time (0x09F8).
    pub started: bool,
    /// The PDI closed a buffer whose SyncManager records the time (0x09FC).
    pub changed: bool,
}

/// The effects of the end of a good frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) struct Exchanged {
    /// A buffer that triggers the watchdog was completed.
    pub watchdog: bool,
    /// A SyncManager that records the time (0x09F0) exchanged its buffer.
    pub latch: bool,
    /// The SyncManagers whose buffer changed hands, one bit each.
    pub units: u16,
    /// Bits of the AL event request that were not set before.
    pub al_events: u32,
}

/// All SyncManagers of an ESC.
pub(crate) struct SyncManagers {
    slots: Room<Slot, MOST>,
    count: usize,
    /// Units that guard memory: they are enabled and have a length.
    guarding: u16,
    /// The guarding units whose area no other unit overlaps.
    alone: u16,
    /// Those of them that are [plain](Unit::is_plain) for ECAT, and for the PDI too, if that
    /// releases buffers by reading.
    simple: u16,
    plain: u16,
    /// Those of the plain ones that the PDI reads, and those that it writes.
    plain_outputs: u16,
    plain_inputs: u16,
    /// The address behind the last buffer of all units.
    reserved_end: usize,
    /// Units whose buffer the frame in flight closed.
    closing: u16,
    /// Units whose activation ECAT wrote and the PDI has not read since.
    changed: u16,
    /// Units that the frame in flight accessed.
    touched: u16,
    /// The label of the bytes that the PDI writes.
    pub pdi_label: u64,
    /// The PDI releases a buffer that it reads by writing the last byte: register 0x014E bit 0.
    release_by_write: bool,
    /// See [`Chip::sm_buffer_in_use`].
    shows_in_use: bool,
}

/// One SyncManager, and what is kept for it.
#[derive(Clone, Copy)]
struct Slot {
    unit: Unit,
    /// The unit before the frame in flight, if the frame accessed it.
    before: Unit,
    /// The labels of the contents by buffer; see [`crate::Esc::label`]. A frame does not copy them:
    /// a label changes only when a buffer changes hands, and that is never undone.
    labels: [u64; 3],
}

/// A SyncManager of three buffers that records no times: all effects of an exchange by ECAT are
/// known.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Simple {
    /// The bit of the AL event request that an exchange of its buffer sets, if any.
    event: u32,
    /// Its bit in sets of SyncManagers.
    bit: u16,
    /// The first buffer in process RAM, and the length of each.
    start: u16,
    length: u16,
    number: u8,
    /// An exchange of its buffer triggers the watchdog, if ECAT writes.
    pub watchdog: bool,
}

impl Simple {
    /// Instead of one that is not used.
    pub const NONE: Self =
        Self { event: 0, bit: 0, start: 0, length: 0, number: 0, watchdog: false };

    /// Whether it belongs to this set.
    #[inline]
    pub const fn is_in(&self, set: u16) -> bool {
        self.bit & set != 0
    }

    /// The bytes of a buffer, and how many.
    #[inline]
    fn place(&self, buffer: usize) -> (usize, usize) {
        let length = usize::from(self.length);
        (usize::from(self.start) + buffer * length, length)
    }
}

impl Slot {
    const REST: Self = Self { unit: Unit::REST, before: Unit::REST, labels: [0; 3] };
}

impl SyncManagers {
    /// The SyncManagers of `chip` at rest.
    pub fn new(chip: &Chip) -> Self {
        let count = usize::from(chip.sm_count).min(MOST);
        Self {
            slots: Room::new(count, Slot::REST),
            count,
            guarding: 0,
            alone: 0,
            simple: 0,
            plain: 0,
            plain_outputs: 0,
            plain_inputs: 0,
            reserved_end: 0,
            closing: 0,
            changed: 0,
            touched: 0,
            pdi_label: 0,
            release_by_write: chip.acknowledge_by_write,
            shows_in_use: chip.sm_buffer_in_use,
        }
    }

    /// Accesses `len` bytes of `ram` from `address` on (0x1000 is its first byte). `each` is called
    /// for every run that may be accessed, with the bytes in RAM and their place in the data.
    pub fn access(
        &mut self,
        (side, direction): (Side, Direction),
        ram: &mut [u8],
        address: u16,
        len: usize,
        mut each: impl FnMut(&mut [u8], Range<usize>),
    ) -> Access {
        let mut outcome = Access::default();
        let first = usize::from(address);
        let end = first + len;
        if let Some(number) = self.whole(first, end) {
            // Process data is usually one whole buffer, and nothing must be cut.
            let way = (side, direction);
            let place = match side {
                Side::Ecat => self.ecat_whole(direction, number),
                Side::Pdi => self.guarded(way, number, first..end, &mut outcome),
            };
            if let Some(bytes) = place.and_then(|place| run(ram, place, len)) {
                let len = bytes.len();
                each(bytes, 0..len);
                outcome.any = true;
            }
            return outcome;
        }
        let mut at = first;
        while at < end {
            let stop = self.boundary(at, end);
            let place = match self.at(at) {
                Place::Free => Some(at),
                Place::Spare => None,
                Place::Guarded(number) => {
                    self.guarded((side, direction), number, at..stop, &mut outcome)
                }
            };
            if let Some(bytes) = place.and_then(|place| run(ram, place, stop - at)) {
                let from = at - first;
                let to = from + bytes.len();
                each(bytes, from..to);
                outcome.any = true;
            }
            at = stop;
        }
        outcome
    }

    /// Completes a write of ECAT into registers that a SyncManager guards. Registers have no
    /// buffers, but the interrupt and the watchdog trigger of the SyncManager work.
    pub fn write_registers(&mut self, address: u16, len: usize) {
        let first = usize::from(address);
        for number in bits(self.guarding) {
            let unit = &self.slots[number].unit;
            let last = unit.end() - 1;
            if unit.config.is_ecat_write()
                && last < PROCESS_RAM
                && (first..first + len).contains(&last)
            {
                self.closing |= 1 << number;
            }
        }
    }

    /// The address behind the last buffer of all; 0 if there is none.
    pub const fn reserved_end(&self) -> usize {
        self.reserved_end
    }

    /// Whether a buffer waits for the end of the frame.
    #[inline]
    pub const fn is_closing(&self) -> bool {
        self.closing != 0
    }

    /// Handles the arrival of a frame: from now on the units that it accesses are remembered,
    /// unless the frame is known to be `good`.
    #[inline]
    pub const fn begin_frame(&mut self, good: bool) {
        self.touched = if good { u16::MAX } else { 0 };
    }

    /// The label of the bytes that were last read, or are being read, from a SyncManager's buffer;
    /// 0 without a label.
    #[inline]
    pub fn label(&self, number: usize) -> u64 {
        let Some(slot) = self.slots.get(number) else { return 0 };
        let is_plain = self.plain & 1 << number != 0;
        let unit = &slot.unit;
        slot.labels[if is_plain { unit.consumer() } else { unit.buffer(Direction::Read) }]
    }

    /// Handles the end of a good frame: buffers that ECAT closed change hands, and those that it
    /// wrote get its `label`.
    pub fn end_good_frame(&mut self, label: u64) -> Exchanged {
        let closed = core::mem::take(&mut self.closing);
        let mut exchanged = Exchanged { units: closed, ..Exchanged::default() };
        for number in bits(closed) {
            let Slot { unit, labels, .. } = &mut self.slots[number];
            if unit.config.is_ecat_write() {
                labels[unit.buffer(Direction::Write)] = label;
            }
            let before = unit.raises_al_event();
            exchanged.watchdog |= unit.complete(Side::Ecat);
            if unit.raises_al_event() && !before {
                exchanged.al_events |= al_event::sync_manager(number);
            }
            exchanged.latch |= unit.config.activate & SyncManager::LATCH_ECAT != 0;
        }
        exchanged
    }

    /// The same for a SyncManager that [`write_whole`](Self::write_whole) closed. Returns the bit
    /// of the AL event request that this newly sets.
    #[inline]
    pub fn end_write(&mut self, simple: &Simple, label: u64) -> u32 {
        let Slot { unit, labels, .. } = &mut self.slots[usize::from(simple.number)];
        let event = if unit.int_written { 0 } else { simple.event };
        labels[unit.producer()] = label;
        unit.written();
        event
    }

    /// The same after [`read_whole`](Self::read_whole).
    #[inline]
    pub fn end_read(&mut self, simple: &Simple) -> u32 {
        let unit = &mut self.slots[usize::from(simple.number)].unit;
        if core::mem::replace(&mut unit.int_read, true) { 0 } else { simple.event }
    }

    /// The SyncManagers whose buffer the frame in flight closed, for a caller that ends them.
    #[inline]
    pub fn take_closed(&mut self) -> u16 {
        core::mem::take(&mut self.closing)
    }

    /// Handles the end of a bad frame: everything is as before the frame.
    pub fn end_bad_frame(&mut self) {
        self.closing = 0;
        for number in bits(core::mem::take(&mut self.touched)) {
            if let Some(slot) = self.slots.get_mut(number) {
                slot.unit = slot.before;
            }
        }
    }

    /// Handles a PDI write of `len` bytes from `address` on: if the PDI acknowledges by writing, it
    /// releases the buffers that the PDI reads and whose last byte is written.
    pub fn release_by_write(&mut self, address: u16, len: usize) -> Access {
        let mut outcome = Access::default();
        let first = usize::from(address);
        for number in bits(self.guarding) {
            let unit = &mut self.slots[number].unit;
            let last = unit.end() - 1;
            if self.release_by_write
                && unit.is_open_for_reading()
                && (first..first + len).contains(&last)
            {
                unit.complete(Side::Pdi);
                outcome.changed |= unit.config.activate & SyncManager::LATCH_PDI != 0;
            }
        }
        outcome
    }

    /// Applies the registers of one SyncManager after ECAT wrote them.
    pub fn configure(
        &mut self,
        number: usize,
        registers: &mut Registers,
        activation_written: bool,
    ) {
        if number >= self.count {
            return;
        }
        if activation_written {
            self.changed |= 1 << number;
        }
        let config = registers.load(sync_manager(number));
        let unit = &mut self.slots[number].unit;
        if config.is_enabled() != unit.config.is_enabled() {
            unit.reset();
        }
        unit.config = config;
        self.update(number);
    }

    /// Handles a PDI write to the PDI control byte.
    pub fn write_pdi_control(&mut self, number: usize, value: u8, registers: &mut Registers) {
        if number >= self.count {
            return;
        }
        let unit = &mut self.slots[number].unit;
        if (value ^ unit.config.pdi_control) & PDI_DEACTIVATED != 0 {
            unit.reset();
        }
        unit.config.pdi_control = value & 0x03;
        registers.set_byte(sync_manager(number).address + 7, value & 0x03);
        self.closing &= !(1 << number);
        self.update(number);
    }

    /// Handles a PDI read of the activation byte.
    pub fn acknowledge_activation(&mut self, number: usize) {
        self.changed &= !(1 << number);
    }

    /// Whether the configuration bytes of this SyncManager are locked.
    pub fn is_enabled(&self, number: usize) -> bool {
        self.slots.get(number).is_some_and(|slot| slot.unit.config.is_enabled())
    }

    /// The bits of the AL event request (0x0220) that come from SyncManagers.
    pub fn al_events(&self) -> u32 {
        let mut events = if self.changed != 0 { al_event::SM_ACTIVATION } else { 0 };
        for number in bits(self.guarding) {
            let unit = &self.slots[number].unit;
            if unit.raises_al_event() {
                events |= al_event::sync_manager(number);
            }
        }
        events
    }

    /// The bits of the ECAT event request (0x0210) that come from SyncManagers: 4 to 11 for SM0 to
    /// SM7.
    pub fn ecat_events(&self) -> u16 {
        let mut events = 0;
        for number in bits(self.guarding & 0x00FF) {
            let unit = &self.slots[number].unit;
            let raised = if unit.config.is_ecat_write() { unit.int_read } else { unit.int_written };
            if raised && unit.config.control & SyncManager::CONTROL_ECAT_EVENT != 0 {
                events |= 1 << (4 + number);
            }
        }
        events
    }

    /// A SyncManager, if it is simple and ECAT writes its buffer (`written`) or reads it.
    pub fn simple(&self, number: usize, written: bool) -> Option<Simple> {
        let config = &self.slots[number].unit.config;
        let has_event = config.control & SyncManager::CONTROL_AL_EVENT != 0;
        let is_simple = self.simple & 1 << number != 0 && config.is_ecat_write() == written;
        is_simple.then(|| Simple {
            event: if has_event { al_event::sync_manager(number) } else { 0 },
            bit: 1 << number,
            start: config.start - PROCESS_RAM as u16,
            length: config.length,
            number: number as u8,
            watchdog: config.control & SyncManager::CONTROL_WATCHDOG != 0,
        })
    }

    /// ECAT opens, writes and closes one area as a whole, in a frame known to be good. Returns its
    /// place in process RAM, and its length.
    #[inline]
    pub fn write_whole(&mut self, simple: &Simple) -> (usize, usize) {
        self.closing |= simple.bit;
        let unit = &mut self.slots[usize::from(simple.number)].unit;
        unit.write_whole(Side::Ecat);
        simple.place(unit.producer())
    }

    /// The same for a read. `None`: nothing was written yet.
    #[inline]
    pub fn read_whole(&mut self, simple: &Simple) -> Option<(usize, usize)> {
        let unit = &mut self.slots[usize::from(simple.number)].unit;
        unit.read_whole(Side::Ecat)?;
        self.closing |= simple.bit;
        Some(simple.place(unit.consumer()))
    }

    /// ECAT opens, accesses and closes one area as a whole. Returns its place in memory if allowed.
    pub fn ecat_whole(&mut self, direction: Direction, number: usize) -> Option<usize> {
        let Slot { unit, before, .. } = &mut self.slots[number];
        if self.touched & 1 << number == 0 {
            self.touched |= 1 << number;
            *before = *unit;
        }
        let place = unit.admit(Side::Ecat, direction, 0)?;
        unit.ecat_open = false;
        self.closing |= 1 << number;
        Some(place)
    }

    /// The PDI opens, accesses and closes one area as a whole. Returns its place in memory, and
    /// whether the watchdog is triggered. `None`: the access is not allowed or has more effects,
    /// and nothing was done.
    #[inline(always)]
    pub fn pdi_whole(&mut self, direction: Direction, number: usize) -> Option<(usize, bool)> {
        let Slot { unit, labels, .. } = &mut self.slots[number];
        let usual = match direction {
            Direction::Read => self.plain_outputs,
            Direction::Write => self.plain_inputs,
        };
        if usual & 1 << number == 0 {
            return None;
        }
        let (place, watchdog) = match direction {
            Direction::Write => {
                let place = unit.write_whole(Side::Pdi);
                labels[unit.producer()] = self.pdi_label;
                (place, unit.written())
            }
            Direction::Read => {
                let place = unit.read_whole(Side::Pdi)?;
                unit.int_read = true;
                (place, false)
            }
        };
        Some((place, watchdog))
    }

    /// Opens, accesses and closes a part of one area. Returns its place in memory if allowed.
    fn guarded(
        &mut self,
        (side, direction): (Side, Direction),
        number: usize,
        part: Range<usize>,
        outcome: &mut Access,
    ) -> Option<usize> {
        let Slot { unit, before, labels } = &mut self.slots[number];
        if side == Side::Ecat && self.touched & 1 << number == 0 {
            self.touched |= 1 << number;
            *before = *unit;
        }
        let offset = part.start - usize::from(unit.config.start);
        let place = unit.admit(side, direction, offset)?;
        let latch = side == Side::Pdi && unit.config.activate & SyncManager::LATCH_PDI != 0;
        outcome.started |= latch && offset == 0;
        let held = self.release_by_write && direction == Direction::Read;
        if part.end == unit.end() {
            match side {
                Side::Ecat => {
                    unit.ecat_open = false;
                    self.closing |= 1 << number;
                }
                Side::Pdi if held && unit.config.length > 1 => {}
                Side::Pdi => {
                    if direction == Direction::Write {
                        labels[unit.buffer(direction)] = self.pdi_label;
                    }
                    outcome.watchdog |= unit.complete(side);
                    outcome.changed |= latch;
                }
            }
        } else if offset == 0 && side == Side::Ecat {
            self.closing &= !(1 << number);
        }
        Some(place)
    }

    /// The unit that guards exactly these addresses and shares none of them with another unit.
    fn whole(&self, first: usize, end: usize) -> Option<usize> {
        let found = bits(self.alone)
            .find(|number| usize::from(self.slots[*number].unit.config.start) == first)?;
        (self.slots[found].unit.end() == end).then_some(found)
    }

    /// The unit of three buffers that guards exactly these addresses and shares none of them with
    /// another.
    pub fn three_buffers(&self, start: u16, length: u16) -> Option<usize> {
        let first = usize::from(start);
        let number = self.whole(first, first + usize::from(length))?;
        self.slots[number].unit.is_buffered().then_some(number)
    }

    /// Finds the units whose areas no other unit's buffers overlap, and the end of the last buffer.
    fn find_alone(&mut self) {
        (self.alone, self.simple, self.reserved_end) = (0, 0, 0);
        (self.plain_outputs, self.plain_inputs) = (0, 0);
        for number in bits(self.guarding) {
            let unit = &self.slots[number].unit;
            let (start, end) = (usize::from(unit.config.start), unit.end());
            self.reserved_end = self.reserved_end.max(unit.reserved_end());
            let shared = bits(self.guarding & !(1 << number)).any(|other| {
                let other = &self.slots[other].unit;
                start < other.reserved_end() && usize::from(other.config.start) < end
            });
            if !shared {
                self.alone |= 1 << number;
                self.simple |= u16::from(unit.is_plain()) << number;
                let is_plain = unit.is_plain() && !self.release_by_write;
                let is_read = unit.direction_of(Side::Pdi) == Direction::Read;
                self.plain_outputs |= u16::from(is_plain && is_read) << number;
                self.plain_inputs |= u16::from(is_plain && !is_read) << number;
            }
        }
        self.plain = if self.release_by_write { 0 } else { self.simple };
    }

    /// The kind of memory at `address`.
    fn at(&self, address: usize) -> Place {
        let mut place = Place::Free;
        for number in bits(self.guarding) {
            let unit = &self.slots[number].unit;
            let start = usize::from(unit.config.start);
            if (start..unit.end()).contains(&address) {
                return Place::Guarded(number);
            }
            if (start..unit.reserved_end()).contains(&address) {
                place = Place::Spare;
            }
        }
        place
    }

    /// The next address after `at` where the answer of [`Self::at`] may change, at most `end`.
    fn boundary(&self, at: usize, end: usize) -> usize {
        let mut next = end;
        for number in bits(self.guarding) {
            let unit = &self.slots[number].unit;
            for edge in [usize::from(unit.config.start), unit.end(), unit.reserved_end()] {
                if edge > at && edge < next {
                    next = edge;
                }
            }
        }
        next
    }

    fn update(&mut self, number: usize) {
        let config = &self.slots[number].unit.config;
        let bit = 1 << number;
        if config.is_enabled() && config.length > 0 {
            self.guarding |= bit;
        } else {
            self.guarding &= !bit;
            self.closing &= !bit;
        }
        self.find_alone();
    }

    /// Puts the status bytes in a range of addresses into force, before they are read.
    pub fn show(&self, range: &Range<u16>, registers: &mut Registers) {
        for number in 0..self.count {
            let address = sm_status(number).address;
            if range.contains(&address) {
                registers.set_byte(address, self.status(number));
            }
        }
    }

    /// The status byte of a SyncManager; 0 if the chip does not have it.
    pub fn status(&self, number: usize) -> u8 {
        let exists = number < self.count;
        if exists { self.slots[number].unit.status(self.shows_in_use) } else { 0 }
    }
}

/// The part of `len` bytes of `ram` from address `place` on that exists; `None` if it is empty.
fn run(ram: &mut [u8], place: usize, len: usize) -> Option<&mut [u8]> {
    let from = place.wrapping_sub(PROCESS_RAM);
    let end = from.saturating_add(len).min(ram.len());
    ram.get_mut(from..end).filter(|bytes| !bytes.is_empty())
}

/// The kind of memory at an address.
enum Place {
    /// No SyncManager guards it.
    Free,
    /// The second or third buffer of a SyncManager, which can only be reached through the first.
    Spare,
    /// The guarded area of a SyncManager.
    Guarded(usize),
}

/// The numbers of the bits that are set.
fn bits(mut mask: u16) -> impl Iterator<Item = usize> {
    core::iter::from_fn(move || {
        (mask != 0).then(|| {
            let number = mask.trailing_zeros() as usize;
            mask &= mask - 1;
            number
        })
    })
}

/// Most SyncManagers of an ESC.
const MOST: usize = 16;
const PROCESS_RAM: usize = isocat_wire::register::PROCESS_RAM as usize;
/// Bytes of one SyncManager's registers.
pub(crate) const SM_LEN: u16 = <SyncManager as Value>::LEN as u16;
