//! Helpers to write the parts of a [`Description`](crate::Description) as constants, which a
//! firmware keeps in its flash.
//!
//! Each function returns the entries of one object. Their values follow each other in the stack's
//! value store, from the byte at which the values of the previous object [`end`].
//!
//! ```
//! use isocat_subdevice::describe::{end, mapping, object, value};
//! use isocat_subdevice::{Entry, Object};
//! use isocat_wire::coe::DataType;
//! use isocat_wire::coe::info::{Access, ObjectCode};
//!
//! const RIGHTS: Access = Access::READ.with(Access::RX_MAPPABLE);
//! const OUTPUTS: [Entry; 1] = value(0, "Outputs", DataType::UNSIGNED32, RIGHTS, &[]);
//! const RX_PDO: [Entry; 2] = mapping(end(&OUTPUTS), &0x7000_0020u32.to_le_bytes());
//! const OBJECTS: [Object; 2] = [
//!     object(0x1600, "RxPDO", ObjectCode::RECORD, DataType::PDO_MAPPING, &RX_PDO),
//!     object(0x7000, "Outputs", ObjectCode::VAR, DataType::UNSIGNED32, &OUTPUTS),
//! ];
//! assert_eq!(end(OBJECTS[0].entries), 9, "4 bytes of outputs, then 1 and 4 of the mapping");
//! ```

use isocat_wire::coe::DataType;
use isocat_wire::coe::info::{Access, ObjectCode};

use crate::description::{Entry, Object};

/// Readable in every state.
pub const RO: Access = Access::READ;
/// Readable and writable in every state.
pub const RW: Access = RO.with(Access::WRITE);
/// Readable in every state, writable in PREOP only.
pub const RW_PREOP: Access = RO.with(Access::WRITE_PREOP);

/// An object of the dictionary. The objects of a description ascend by `index`.
pub const fn object(
    index: u16,
    name: &'static str,
    code: ObjectCode,
    data_type: DataType,
    entries: &'static [Entry],
) -> Object {
    Object { index, name, code, data_type, entries }
}

/// An entry whose length follows from its type. `complete_access_offset` is in bits, see [`Entry`];
/// `default` is empty for zeros.
///
/// # Panics
///
/// If the type has no fixed length; this happens when the constant is compiled.
pub const fn entry(
    sub: u8,
    name: &'static str,
    data_type: DataType,
    complete_access_offset: u32,
    access: Access,
    default: &'static [u8],
) -> Entry {
    let Some(bits) = data_type.bits() else { panic!("the type has no fixed length") };
    Entry { sub, name, data_type, bits, complete_access_offset, access, store: 0, default }
}

/// The entries, with their values one after the other from byte `store` of the value store on.
pub const fn placed<const N: usize>(store: u16, mut entries: [Entry; N]) -> [Entry; N] {
    let (mut at, mut number) = (store, 0);
    while number < N {
        entries[number].store = at;
        at += entries[number].len() as u16;
        number += 1;
    }
    entries
}

/// The first byte of the value store after the values of these entries.
pub const fn end(entries: &[Entry]) -> u16 {
    let last = &entries[entries.len() - 1];
    last.store + last.len() as u16
}

/// The only entry of a VAR.
pub const fn value(
    store: u16,
    name: &'static str,
    data_type: DataType,
    access: Access,
    default: &'static [u8],
) -> [Entry; 1] {
    placed(store, [entry(0, name, data_type, 0, access, default)])
}

/// 0x1018, Identity; the SII contains the same values.
pub const fn identity(
    store: u16,
    vendor: &'static [u8; 4],
    product: &'static [u8; 4],
    revision: &'static [u8; 4],
    serial: &'static [u8; 4],
) -> [Entry; 5] {
    let entries = [
        entry(0, "Entries", DataType::UNSIGNED8, 0, RO, &[4]),
        entry(1, "Vendor", DataType::UNSIGNED32, 16, RO, vendor),
        entry(2, "Product", DataType::UNSIGNED32, 48, RO, product),
        entry(3, "Revision", DataType::UNSIGNED32, 80, RO, revision),
        entry(4, "Serial", DataType::UNSIGNED32, 112, RO, serial),
    ];
    placed(store, entries)
}

/// 0x1C00, types of the SyncManagers, of a device with mailbox, outputs (SM2) and inputs (SM3).
pub const fn sync_manager_types(store: u16) -> [Entry; 5] {
    let entries = [
        entry(0, "Entries", DataType::UNSIGNED8, 0, RO, &[4]),
        entry(1, "SM0", DataType::UNSIGNED8, 16, RO, &[1]),
        entry(2, "SM1", DataType::UNSIGNED8, 24, RO, &[2]),
        entry(3, "SM2", DataType::UNSIGNED8, 32, RO, &[3]),
        entry(4, "SM3", DataType::UNSIGNED8, 40, RO, &[4]),
    ];
    placed(store, entries)
}

/// A PDO (0x1600 and following, 0x1A00 and following) with one entry: index, sub-index and bits in
/// the CoE coding.
pub const fn mapping(store: u16, mapped: &'static [u8; 4]) -> [Entry; 2] {
    let entries = [
        entry(0, "Entries", DataType::UNSIGNED8, 0, RO, &[1]),
        entry(1, "Entry", DataType::UNSIGNED32, 16, RO, mapped),
    ];
    placed(store, entries)
}

/// 0x1C12 or 0x1C13, assignment of one PDO by its index.
pub const fn assignment(store: u16, pdo: &'static [u8; 2]) -> [Entry; 2] {
    let entries = [
        entry(0, "Entries", DataType::UNSIGNED8, 0, RW_PREOP, &[1]),
        entry(1, "PDO", DataType::UNSIGNED16, 16, RW_PREOP, pdo),
    ];
    placed(store, entries)
}

/// The statements of a device about its synchronization in 0x1C32 and 0x1C33, as the bytes of the
/// entries.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct SyncStatement {
    /// Sub-index 04, the bits of [`SupportedTypes`](isocat_sync::SupportedTypes).
    pub supported: &'static [u8; 2],
    /// Sub-index 05, shortest cycle, ns.
    pub minimum_cycle: &'static [u8; 4],
    /// Sub-index 06, time from the SyncManager's event until outputs are ready (0x1C33: from Input
    /// Latch until inputs are), ns.
    pub calc_and_copy: &'static [u8; 4],
    /// Sub-index 09, time from the pulse to valid outputs (0x1C33: to Input Latch), ns.
    pub delay: &'static [u8; 4],
}

/// 0x1C32 or 0x1C33, with all its counters.
pub const fn sync_parameter(store: u16, states: SyncStatement) -> [Entry; 14] {
    let SyncStatement { supported, minimum_cycle, calc_and_copy, delay } = states;
    let entries = [
        entry(0x00, "Entries", DataType::UNSIGNED8, 0, RO, &[32]),
        entry(0x01, "Sync type", DataType::UNSIGNED16, 16, RW_PREOP, &[]),
        entry(0x02, "Cycle time", DataType::UNSIGNED32, 32, RW, &[]),
        entry(0x03, "Shift time", DataType::UNSIGNED32, 64, RW, &[]),
        entry(0x04, "Sync types supported", DataType::UNSIGNED16, 96, RO, supported),
        entry(0x05, "Minimum cycle", DataType::UNSIGNED32, 112, RO, minimum_cycle),
        entry(0x06, "Calc and copy", DataType::UNSIGNED32, 144, RO, calc_and_copy),
        entry(0x08, "Command", DataType::UNSIGNED16, 208, RW, &[]),
        entry(0x09, "Delay time", DataType::UNSIGNED32, 224, RO, delay),
        entry(0x0A, "SYNC0 cycle", DataType::UNSIGNED32, 256, RO, &[]),
        entry(0x0B, "SM event missed", DataType::UNSIGNED16, 288, RO, &[]),
        entry(0x0C, "Cycle time too small", DataType::UNSIGNED16, 304, RO, &[]),
        entry(0x0D, "Shift time too short", DataType::UNSIGNED16, 320, RO, &[]),
        entry(0x20, "Sync error", DataType::BOOLEAN, 480, RO, &[]),
    ];
    placed(store, entries)
}
