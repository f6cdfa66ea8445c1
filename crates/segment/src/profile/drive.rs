//! Layout of a drive's process data.

use super::draft::Area;
use super::{ApplicationKind, DriveLayout};

/// The layout of a drive, if control word, status word, target position and actual position are at
/// whole bytes.
pub(super) fn layout(outputs: &Option<Area>, inputs: &Option<Area>) -> Option<DriveLayout> {
    Some(DriveLayout {
        control: byte_of(outputs, 0x6040, 16)?,
        target: byte_of(outputs, 0x607A, 32)?,
        mode: byte_of(outputs, 0x6060, 8),
        status: byte_of(inputs, 0x6041, 16)?,
        position: byte_of(inputs, 0x6064, 32)?,
        mode_display: byte_of(inputs, 0x6061, 8),
    })
}

/// A drive of a profile, with the layout of its PDOs.
pub(super) fn of_profile(outputs: &Option<Area>, inputs: &Option<Area>) -> ApplicationKind {
    const USUAL: DriveLayout = DriveLayout {
        control: 0,
        target: 2,
        mode: Some(6),
        status: 0,
        position: 2,
        mode_display: Some(6),
    };
    match layout(outputs, inputs) {
        Some(layout) if layout != USUAL => ApplicationKind::DriveAt(layout),
        _ => ApplicationKind::Drive,
    }
}

/// Whether an area has an object with this number of bits at a whole byte.
pub(super) fn has(area: &Option<Area>, (index, bits): (u16, u8)) -> bool {
    byte_of(area, index, bits).is_some()
}

/// The byte at which the recommended PDOs have an object with this number of bits.
fn byte_of(area: &Option<Area>, index: u16, bits: u8) -> Option<u8> {
    let area = area.as_ref()?;
    let assigned =
        area.recommended.iter().filter_map(|pdo| area.pdos.iter().find(|p| p.index == pdo.value));
    let mut at = 0;
    for entry in assigned.flat_map(|pdo| &pdo.entries) {
        if entry.object.is_some_and(|object| object.index == index) && entry.bits == bits {
            return u8::try_from(at / 8).ok().filter(|_| at % 8 == 0);
        }
        at += u32::from(entry.bits);
    }
    None
}
