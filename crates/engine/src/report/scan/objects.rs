//! The sync objects in words, entry by entry.

use isocat_maindevice::segment::{SubDevice, SyncEntry as Found, SyncObject as FoundObject};
use isocat_sync::object::{self, ShiftBy, SupportedTypes, SyncType, sub};
use isocat_sync::table::{self, Column};
use isocat_wire::coe::info::Access;
use isocat_wire::time::Nanos;

use super::{SyncEntry, SyncObject};

pub(super) fn sync_object(
    device: &SubDevice,
    index: u16,
    found: Option<&FoundObject>,
) -> Option<SyncObject> {
    let found = found?;
    let entries = found.entries.iter().map(|entry| SyncEntry {
        sub: entry.sub,
        name: name(entry),
        value: entry.number(),
        in_words: in_words(found, entry),
        writable: writable(entry),
        doubt: doubt(device, index, found, entry),
    });
    Some(SyncObject { index, entries: entries.collect() })
}

fn name(entry: &Found) -> String {
    match entry.sub {
        0 => "highest sub-index".to_owned(),
        sub => object::name(sub).unwrap_or(entry.name()).to_owned(),
    }
}

/// Whether SDO information lets it be written in PREOP; `None` if there is none.
pub(super) fn writable(entry: &Found) -> Option<bool> {
    let (description, _) = entry.description.as_ref()?;
    Some(description.access.has_any(Access::WRITE_PREOP))
}

fn in_words(object: &FoundObject, entry: &Found) -> String {
    let bytes = match &entry.value {
        Ok(bytes) => bytes,
        Err(code) => return format!("can't be read: abort {code}"),
    };
    let Some(value) = entry.number() else { return format!("{} bytes", bytes.len()) };
    match entry.sub {
        sub::SYNC_TYPE => SyncType(value as u16).to_string(),
        sub::SUPPORTED_TYPES => SupportedTypes(value as u16).to_string(),
        sub::SYNC_ERROR => if value & 1 != 0 { "set" } else { "not set" }.to_owned(),
        sub if value == 0 && NOT_STATED_AS_0.contains(&sub) => not_stated(object).to_owned(),
        sub if TIMES.contains(&sub) => Nanos::from_u32(value).to_string(),
        _ => value.to_string(),
    }
}

/// The doubt about one entry, by itself and with its neighbours.
fn doubt(device: &SubDevice, index: u16, object: &FoundObject, entry: &Found) -> Option<String> {
    let bytes = entry.value.as_ref().ok()?;
    if let Some(bits) = wrong_length(entry) {
        return Some(format!("{} bytes, but described as {bits} bits", bytes.len()));
    }
    let announced = object.values.supported;
    match entry.sub {
        sub::SYNC_TYPE => {
            let shown = object.values.sync_type?;
            shown_type(shown, announced?)
        }
        sub::SHIFT_TIME => (announced?.shift() == ShiftBy::LocalTimer
            && writable(entry) == Some(false))
        .then(|| "a shift by local timer is announced, but it can't be written".to_owned()),
        sub::SUPPORTED_TYPES if announced?.shift() == ShiftBy::Reserved => {
            Some("11 in bits 6:5 means nothing".to_owned())
        }
        sub::SUPPORTED_TYPES
            if announced?.delay_should_be_measured() && announced?.delay_fixed() =>
        {
            Some("delays can't be both fixed and to be measured".to_owned())
        }
        sub::CALC_AND_COPY_TIME if copies_too_long(object) => {
            Some("longer than the minimum cycle".to_owned())
        }
        sub if COUNTERS.contains(&sub) && entry.number().is_some_and(|count| count > 0) => {
            Some("counted before the scan".to_owned())
        }
        sub if entry.number() == Some(0) && is_unstated(device, index, object, sub) => {
            Some("a mode that 04 announces asks for it".to_owned())
        }
        _ => None,
    }
}

/// The number of bits in SDO information, if the value has another number of bytes.
pub(super) fn wrong_length(entry: &Found) -> Option<u16> {
    let (description, _) = entry.description.as_ref()?;
    let bytes = entry.value.as_ref().ok()?;
    (bytes.len() != usize::from(description.bits).div_ceil(8)).then_some(description.bits)
}

/// Why sub-index 04 does not announce the type in sub-index 01.
pub(super) fn shown_type(shown: SyncType, announced: SupportedTypes) -> Option<String> {
    let fits = match shown {
        SyncType::FREE_RUN => announced.free_run(),
        SyncType::SM | SyncType::INPUTS_ON_SM2 => announced.sm_synchronous(),
        SyncType::DC_SYNC0 => announced.dc_sync0(),
        SyncType::DC_SYNC1 => announced.dc_sync1() || announced.dc_subordinated(),
        _ => return Some("no type that is known".to_owned()),
    };
    (!fits && announced.0 & MODES != 0).then(|| "not among those that 04 announces".to_owned())
}

/// Meaning of a time of 0 for an action that always takes time.
pub(super) fn not_stated(object: &FoundObject) -> &'static str {
    match object.values.supported.is_some_and(SupportedTypes::dynamic_times) {
        true => "0, not stated: measured in OP",
        false => "0, not stated",
    }
}

/// Whether a time of 0 is not stated: an announced mode requires it.
pub(super) fn is_unstated(device: &SubDevice, index: u16, object: &FoundObject, sub: u8) -> bool {
    let synchronized = columns(object.values.supported.unwrap_or_default())
        .any(|column| column != Column::FreeRun && is_mandatory(index, sub, column));
    let in_use = match index {
        object::OUTPUT_PARAMETER => device.outputs.length > 0,
        _ => device.inputs.length > 0,
    };
    in_use && synchronized && NOT_STATED_AS_0.contains(&sub)
}

/// Whether copying takes longer than the minimum cycle, if both are stated.
pub(super) fn copies_too_long(object: &FoundObject) -> bool {
    let stated = |time: Option<Nanos>| time.filter(|time| *time > Nanos::ZERO);
    let copy = stated(object.values.calc_and_copy_time);
    copy.zip(stated(object.values.minimum_cycle_time)).is_some_and(|(copy, cycle)| copy > cycle)
}

/// Whether a mode requires a sub-index without a condition.
pub(super) fn is_mandatory(index: u16, sub: u8, column: Column) -> bool {
    table::lookup(index, sub, column).is_some_and(|cell| cell.need == table::Need::Mandatory)
}

/// The modes that sub-index 04 announces, as columns of the tables.
pub(super) fn columns(types: SupportedTypes) -> impl Iterator<Item = Column> {
    let local = types.shift() == ShiftBy::LocalTimer;
    [
        types.free_run().then_some(Column::FreeRun),
        types.sm_synchronous().then_some(Column::Sm),
        types.dc_sync0().then_some(if local { Column::DcShift } else { Column::Dc }),
        (types.dc_sync0() && types.shift() == ShiftBy::Sync1).then_some(Column::DcShiftSync1),
        types.dc_sync1().then_some(Column::DcSync1),
        types.dc_subordinated().then_some(Column::DcSubordinated),
    ]
    .into_iter()
    .flatten()
}

/// Sub-indices of the error counters, and of the error itself.
pub(super) const COUNTERS: [u8; 4] =
    [sub::SM_EVENT_MISSED, sub::CYCLE_TIME_TOO_SMALL, sub::SHIFT_TIME_TOO_SHORT, sub::SYNC_ERROR];
/// Bits of sub-index 04 that are modes.
pub(super) const MODES: u16 = 0x1F;

const TIMES: [u8; 11] = [
    sub::CYCLE_TIME,
    sub::SHIFT_TIME,
    sub::MINIMUM_CYCLE_TIME,
    sub::CALC_AND_COPY_TIME,
    sub::MINIMUM_DELAY_TIME,
    sub::DELAY_TIME,
    sub::SYNC0_CYCLE_TIME,
    sub::MINIMUM_CYCLE_DISTANCE,
    sub::MAXIMUM_CYCLE_DISTANCE,
    sub::MINIMUM_SM_SYNC_DISTANCE,
    sub::MAXIMUM_SM_SYNC_DISTANCE,
];

/// Times that cannot really be 0 ns.
pub(super) const NOT_STATED_AS_0: [u8; 3] =
    [sub::MINIMUM_CYCLE_TIME, sub::CALC_AND_COPY_TIME, sub::DELAY_TIME];
