//! PDO assignment (0x1C12, 0x1C13) and mapping (0x1600.., 0x1A00..): checks of written values, and
//! the resulting lengths.

use core::ops::RangeInclusive;

use isocat_sync::object::{INPUT_ASSIGNMENT, OUTPUT_ASSIGNMENT};
use isocat_wire::coe::info::Access;
use isocat_wire::{AbortCode, ObjectAddress};

use crate::description::ProcessDataArea;
use crate::dictionary::Values;

/// Indices of the RxPDOs (outputs).
pub(crate) const RX_PDOS: RangeInclusive<u16> = 0x1600..=0x17FF;
/// Indices of the TxPDOs (inputs).
pub(crate) const TX_PDOS: RangeInclusive<u16> = 0x1A00..=0x1BFF;

/// An assigned PDO does not exist, or one of its entries is missing.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct NotComputable;

/// Bytes of the process data by an assignment object; `None` if the device has no such object.
pub(crate) fn length(
    dictionary: &Values<'_>,
    assignment: u16,
) -> Result<Option<u32>, NotComputable> {
    let Some(count) = dictionary.value(assignment, 0) else { return Ok(None) };
    let mut bits = 0;
    for slot in 1..=count {
        let sub = u8::try_from(slot).map_err(|_| NotComputable)?;
        let pdo = dictionary.value(assignment, sub).ok_or(NotComputable)? as u16;
        if pdo != EMPTY {
            bits += pdo_bits(dictionary, pdo)?;
        }
    }
    Ok(Some(bits.div_ceil(8)))
}

/// The assignment object of a SyncManager: 0x1C10 and its number.
pub(crate) fn of_sync_manager(area: ProcessDataArea) -> u16 {
    FIRST_ASSIGNMENT + u16::from(area.sync_manager)
}

/// Whether the values of this object can only be changed while its sub-index 0 is 0.
pub(crate) fn is_guarded_by_count(index: u16) -> bool {
    RX_PDOS.contains(&index)
        || TX_PDOS.contains(&index)
        || (FIRST_ASSIGNMENT..=LAST_ASSIGNMENT).contains(&index)
}

/// Checks a value that the MainDevice writes into an assignment or mapping object.
pub(crate) fn check_write(
    dictionary: &Values<'_>,
    address: ObjectAddress,
    value: u32,
) -> Result<(), AbortCode> {
    let ObjectAddress { index, sub } = address;
    if !is_guarded_by_count(index) {
        return Ok(());
    }
    if sub == 0 {
        let slots = dictionary.object(index).map_or(0, |object| object.max_sub());
        return if value > u32::from(slots) { Err(AbortCode::TOO_HIGH) } else { Ok(()) };
    }
    match index {
        OUTPUT_ASSIGNMENT => check_assigned(value, RX_PDOS),
        INPUT_ASSIGNMENT => check_assigned(value, TX_PDOS),
        _ if RX_PDOS.contains(&index) => check_mapped(dictionary, value, Access::RX_MAPPABLE),
        _ if TX_PDOS.contains(&index) => check_mapped(dictionary, value, Access::TX_MAPPABLE),
        _ => Ok(()),
    }
}

fn check_assigned(value: u32, range: RangeInclusive<u16>) -> Result<(), AbortCode> {
    let fits = u16::try_from(value).is_ok_and(|pdo| pdo == EMPTY || range.contains(&pdo));
    if fits { Ok(()) } else { Err(AbortCode::VALUE_RANGE) }
}

/// Checks an entry of a mapping object: index, sub-index and bits of the mapped entry. Index 0
/// reserves bits.
fn check_mapped(dictionary: &Values<'_>, value: u32, right: Access) -> Result<(), AbortCode> {
    let (index, sub, bits) = ((value >> 16) as u16, (value >> 8) as u8, value as u8);
    if index == 0 {
        return Ok(());
    }
    let object = dictionary.object(index).ok_or(AbortCode::NO_OBJECT)?;
    let entry = object.entry(sub).ok_or(AbortCode::NO_SUBINDEX)?;
    if !entry.access.has(right) {
        Err(AbortCode::NOT_MAPPABLE)
    } else if entry.bits != u16::from(bits) {
        Err(AbortCode::PARAMETER_INCOMPATIBLE)
    } else {
        Ok(())
    }
}

fn pdo_bits(dictionary: &Values<'_>, pdo: u16) -> Result<u32, NotComputable> {
    let count = dictionary.value(pdo, 0).ok_or(NotComputable)?;
    let mut bits = 0;
    for slot in 1..=count {
        let sub = u8::try_from(slot).map_err(|_| NotComputable)?;
        bits += dictionary.value(pdo, sub).ok_or(NotComputable)? & 0xFF;
    }
    Ok(bits)
}

/// A slot of an assignment object without a PDO.
const EMPTY: u16 = 0;
/// Assignment object of SM0.
const FIRST_ASSIGNMENT: u16 = 0x1C10;
/// Assignment object of SM31.
const LAST_ASSIGNMENT: u16 = 0x1C2F;
