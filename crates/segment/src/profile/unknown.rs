//! Values that a profile states as `"unknown"`: zeros on the wire, and never a statement.

use isocat_sync::{SupportedTypes, object};
use isocat_wire::dc::AssignActivate;
use isocat_wire::{ObjectAddress, coe::DataType};

use super::OpMode;
use super::draft::{Assumed, Draft, Entry, Item, Placed};

/// Lists the unknown values that a plan uses, and announces the types of the OpModes if 0x1C32:04
/// and 0x1C33:04 do not state any.
pub(super) fn complete(draft: &mut Draft<'_>) {
    let announced = announced(draft);
    for index in [object::OUTPUT_PARAMETER, object::INPUT_PARAMETER] {
        let Some(object) = draft.objects.iter_mut().find(|object| object.index == index) else {
            continue;
        };
        for entry in object.entries.iter_mut().filter(|entry| is_unknown(entry)) {
            let what = ObjectAddress::new(index, entry.sub).to_string();
            let (value, why) = if entry.sub == object::sub::SUPPORTED_TYPES {
                let (types, why) = announced;
                entry.default = types.to_le_bytes().to_vec();
                entry.written = format!("{types:#06x}");
                (entry.written.clone(), why)
            } else {
                (super::rows::UNKNOWN.to_owned(), "its value is not published; it reads 0")
            };
            let item = Placed { at: entry.at, value: Item::Key(what, value) };
            draft.assumed.push(Assumed { item, why: why.to_owned() });
        }
    }
}

/// Whether the value is not known. Empty texts and gaps are known.
pub(super) fn is_unknown(entry: &Entry) -> bool {
    entry.default.is_empty() && !matches!(entry.data_type, DataType::GAP | DataType::VISIBLE_STRING)
}

/// Synchronization modes of a device without mailbox: those of any device, and those of its
/// OpModes.
pub(super) fn any_device(op_modes: &[OpMode]) -> SupportedTypes {
    SupportedTypes(FREE_RUN | SM_SYNCHRONOUS | needed(op_modes))
}

/// Synchronization types for sub-index 04, and the reason.
fn announced(draft: &Draft<'_>) -> (u16, &'static str) {
    match needed(&draft.op_modes) {
        0 => {
            (FREE_RUN | SM_SYNCHRONOUS, "not known, and no OpMode tells; what every device can do")
        }
        types => (types, "not known; its OpModes need it"),
    }
}

/// The types that OpModes need.
fn needed(op_modes: &[OpMode]) -> u16 {
    let mut types = 0;
    for mode in op_modes {
        let word = AssignActivate(mode.assign_activate);
        types |= match (word.makes_sync0(), word.makes_sync1()) {
            (false, false) => SM_SYNCHRONOUS,
            (true, false) => DC_SYNC0,
            (_, true) => DC_SYNC0 | DC_SYNC1 | DC_SUBORDINATED,
        };
    }
    types
}

/// Bits of 0x1C32:04 and 0x1C33:04.
const FREE_RUN: u16 = 1 << 0;
const SM_SYNCHRONOUS: u16 = 1 << 1;
const DC_SYNC0: u16 = 1 << 2;
const DC_SYNC1: u16 = 1 << 3;
const DC_SUBORDINATED: u16 = 1 << 4;
