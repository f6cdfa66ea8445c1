//! Doubts about 0x1C32 and 0x1C33.

use isocat_maindevice::segment::{SubDevice, SyncObject};
use isocat_sync::object::{
    INPUT_PARAMETER, OUTPUT_PARAMETER, ShiftBy, SupportedTypes, SyncType, sub,
};
use isocat_sync::table;
use isocat_wire::ObjectAddress;
use isocat_wire::time::Nanos;

use super::super::objects::{
    COUNTERS, MODES, columns, copies_too_long, is_mandatory, is_unstated, not_stated, shown_type,
    writable, wrong_length,
};
use super::Doubts;
use crate::report::NoteKind;

impl Doubts {
    /// Doubts about both objects. `complete` means that all objects of the device were read.
    pub(super) fn sync_objects(&mut self, device: &SubDevice, complete: bool) {
        let both = [
            (OUTPUT_PARAMETER, device.output_sync.as_ref(), device.outputs.length > 0),
            (INPUT_PARAMETER, device.input_sync.as_ref(), device.inputs.length > 0),
        ];
        for (index, object, used) in both {
            match object {
                Some(object) => self.sync_object(device, index, object, used),
                None if used && complete => self.asks(
                    NoteKind::NoSyncObject,
                    format!(
                        "it has no object 0x{index:04X}: nothing says how it can be synchronized"
                    ),
                ),
                None => {}
            }
        }
        if complete && !both[0].2 && !both[1].2 && !device.sii.sync_managers.is_empty() {
            self.asks(
                NoteKind::NothingAssigned,
                "nothing is assigned in 0x1C12 and 0x1C13: the MainDevice must assign PDOs"
                    .to_owned(),
            );
        }
        let types = |object: Option<&SyncObject>, used| object.filter(|_| used)?.values.supported;
        let (outputs, inputs) = (types(both[0].1, both[0].2), types(both[1].1, both[1].2));
        if let (Some(outputs), Some(inputs)) = (outputs, inputs) {
            let (own, other) = (outputs.0 & MODES, inputs.0 & MODES);
            let text = format!("0x1C32:04 announces {outputs}, 0x1C33:04 {inputs}");
            match own & other {
                0 if own != 0 && other != 0 => {
                    self.contradicts(
                        NoteKind::TypesExcludeEachOther,
                        text + ": no mode is in both",
                    );
                }
                _ if own != other => self.asks(NoteKind::TypesDisagree, text),
                _ => {}
            }
        }
        let cycle = |object: Option<&SyncObject>| {
            object?.values.minimum_cycle_time.filter(|time| *time > Nanos::ZERO)
        };
        let cycles = cycle(both[0].1).zip(cycle(both[1].1));
        if let Some((outputs, inputs)) = cycles.filter(|(outputs, inputs)| outputs != inputs) {
            self.asks(
                NoteKind::MinimumCyclesDiffer,
                format!("its minimum cycle is {outputs} in 0x1C32:05, {inputs} in 0x1C33:05"),
            );
        }
    }

    fn sync_object(&mut self, device: &SubDevice, index: u16, object: &SyncObject, used: bool) {
        let at = |sub| ObjectAddress::new(index, sub);
        for entry in &object.entries {
            if let Err(code) = &entry.value {
                self.contradicts(
                    NoteKind::NotReadable,
                    format!("{} is described, but can't be read: abort {code}", at(entry.sub)),
                );
            }
            if let (Some(bits), Ok(bytes)) = (wrong_length(entry), &entry.value) {
                self.contradicts(
                    NoteKind::Length,
                    format!(
                        "{} has {} bytes, but is described as {bits} bits",
                        at(entry.sub),
                        bytes.len()
                    ),
                );
            }
        }
        let values = &object.values;
        let types = match values.supported.filter(|types| types.0 & MODES != 0) {
            Some(types) => types,
            None if used => {
                return self.asks(
                    NoteKind::NoTypes,
                    format!("{} announces no mode", at(sub::SUPPORTED_TYPES)),
                );
            }
            None => return,
        };
        let strange = values.sync_type.and_then(|shown| Some((shown, shown_type(shown, types)?)));
        if let Some((shown, why)) = strange {
            let what = format!("{} shows {shown}, {why}: {types}", at(sub::SYNC_TYPE));
            // 0 may as well mean that no type has been chosen yet.
            match shown {
                SyncType::FREE_RUN => self.asks(NoteKind::FreeRunNotAnnounced, what),
                _ => self.contradicts(NoteKind::TypeNotAnnounced, what),
            }
        }
        self.announcement(device, index, object, types);
        let ran: Vec<String> = COUNTERS
            .into_iter()
            .filter_map(|sub| Some((sub, object.entry(sub)?.number()?)))
            .filter(|(_, count)| *count > 0)
            .map(|(sub, count)| format!("{sub:02X} {count}"))
            .collect();
        if !ran.is_empty() {
            self.asks(
                NoteKind::Counted,
                format!("0x{index:04X} has counted before the scan: {}", ran.join(", ")),
            );
        }
        let unstated: Vec<String> = object
            .entries
            .iter()
            .filter(|entry| {
                entry.number() == Some(0) && is_unstated(device, index, object, entry.sub)
            })
            .map(|entry| format!("{:02X}", entry.sub))
            .collect();
        if !unstated.is_empty() {
            let why = not_stated(object);
            self.asks(
                NoteKind::NotStated,
                format!(
                    "modes that are announced ask for times in 0x{index:04X} that read {why}: {}",
                    unstated.join(", ")
                ),
            );
        }
    }

    /// Compares the announcement of sub-index 04 with the other entries.
    fn announcement(
        &mut self,
        device: &SubDevice,
        index: u16,
        object: &SyncObject,
        types: SupportedTypes,
    ) {
        let at = |sub| ObjectAddress::new(index, sub);
        let values = &object.values;
        let dc = types.dc_sync0() || types.dc_sync1() || types.dc_subordinated();
        if dc && !device.dc.has_clock() {
            self.contradicts(
                NoteKind::DcWithoutClock,
                format!(
                    "{} announces {types}, but it has no system time",
                    at(sub::SUPPORTED_TYPES)
                ),
            );
        }
        if types.shift() == ShiftBy::Reserved {
            self.contradicts(
                NoteKind::ShiftReserved,
                format!("{} has 11 in bits 6:5, which means nothing", at(sub::SUPPORTED_TYPES)),
            );
        }
        let shift = object.entry(sub::SHIFT_TIME);
        if types.shift() == ShiftBy::LocalTimer && index == OUTPUT_PARAMETER {
            match shift.map(writable) {
                None => self.contradicts(
                    NoteKind::NoShift,
                    format!(
                        "a shift by local timer is announced, but {} is missing",
                        at(sub::SHIFT_TIME)
                    ),
                ),
                Some(Some(false)) => self.contradicts(
                    NoteKind::ShiftReadOnly,
                    format!(
                        "a shift by local timer is announced, but {} can't be written",
                        at(sub::SHIFT_TIME)
                    ),
                ),
                _ => {}
            }
        }
        if types.delay_should_be_measured() && types.delay_fixed() {
            self.asks(
                NoteKind::DelayBoth,
                format!(
                    "{} says that delays are fixed (bit 11) and that they should be \
                        measured (bit 10)",
                    at(sub::SUPPORTED_TYPES)
                ),
            );
        }
        let delays = values.minimum_delay_time.zip(values.delay_time);
        let differ = |(least, delay): &(Nanos, Nanos)| *least > Nanos::ZERO && least != delay;
        if let Some((least, delay)) = delays.filter(|both| types.delay_fixed() && differ(both)) {
            self.asks(
                NoteKind::DelayNotFixed,
                format!(
                    "delays are fixed (bit 11), but {} is {least} and {} {delay}",
                    at(sub::MINIMUM_DELAY_TIME),
                    at(sub::DELAY_TIME)
                ),
            );
        }
        let unknown_cycle = values.sync0_cycle_time.is_none_or(|time| time == Nanos::ZERO);
        if types.dc_subordinated() && unknown_cycle && index == OUTPUT_PARAMETER {
            self.asks(
                NoteKind::NoSync0Cycle,
                format!(
                    "subordinated cycles are announced, but {} does not say which",
                    at(sub::SYNC0_CYCLE_TIME)
                ),
            );
        }
        if copies_too_long(object) {
            let time = |time: Option<Nanos>| time.unwrap_or_default();
            self.contradicts(
                NoteKind::CopyLongerThanCycle,
                format!(
                    "{} is {}, the minimum cycle in {} {}",
                    at(sub::CALC_AND_COPY_TIME),
                    time(values.calc_and_copy_time),
                    at(sub::MINIMUM_CYCLE_TIME),
                    time(values.minimum_cycle_time)
                ),
            );
        }
        let missing: Vec<String> = table::SUBS
            .into_iter()
            .filter(|sub| object.entry(*sub).is_none())
            .filter(|sub| *sub != sub::SHIFT_TIME || types.shift() != ShiftBy::LocalTimer)
            .filter(|sub| columns(types).any(|column| is_mandatory(index, *sub, column)))
            .map(|sub| format!("{sub:02X}"))
            .collect();
        if !missing.is_empty() {
            self.asks(
                NoteKind::Missing,
                format!(
                    "modes that it announces ask for sub-indices \
                of 0x{index:04X} that it does not have: {}",
                    missing.join(", ")
                ),
            );
        }
    }
}
