//! The device: an I/O block whose outputs are wired to its inputs, four bytes each way.

use isocat_subdevice::description::{Behaviour, Mailbox, ProcessDataArea};
use isocat_subdevice::{Description, Entry, Object};
use isocat_wire::coe::DataType;
use isocat_wire::coe::info::{Access, ObjectCode};
use isocat_wire::sii::MailboxArea;

/// What is fixed about the device.
pub static DESCRIPTION: Description = Description {
    objects: &[
        object(0x1000, "Device type", ObjectCode::VAR, DataType::UNSIGNED32, &DEVICE_TYPE),
        object(0x1018, "Identity", ObjectCode::RECORD, DataType::IDENTITY, &IDENTITY),
        object(0x1600, "RxPDO", ObjectCode::RECORD, DataType::PDO_MAPPING, &RX_PDO),
        object(0x1A00, "TxPDO", ObjectCode::RECORD, DataType::PDO_MAPPING, &TX_PDO),
        object(0x1C00, "SM types", ObjectCode::ARRAY, DataType::UNSIGNED8, &SM_TYPES),
        object(0x1C12, "RxPDO assign", ObjectCode::ARRAY, DataType::UNSIGNED16, &RX_ASSIGNMENT),
        object(0x1C13, "TxPDO assign", ObjectCode::ARRAY, DataType::UNSIGNED16, &TX_ASSIGNMENT),
        object(0x1C32, "SM output", ObjectCode::RECORD, DataType::SYNC_PAR, &SYNC_OUTPUT),
        object(0x1C33, "SM input", ObjectCode::RECORD, DataType::SYNC_PAR, &SYNC_INPUT),
        object(0x6000, "Inputs", ObjectCode::VAR, DataType::UNSIGNED32, &INPUTS),
        object(0x7000, "Outputs", ObjectCode::VAR, DataType::UNSIGNED32, &OUTPUTS),
    ],
    mailbox: Some(Mailbox {
        receive: MailboxArea { start: 0x1000, length: 64 },
        send: MailboxArea { start: 0x1080, length: 64 },
    }),
    outputs: ProcessDataArea { sync_manager: 2, start: 0x1100, max_length: 4 },
    inputs: ProcessDataArea { sync_manager: 3, start: 0x1400, max_length: 4 },
    behaviour: Behaviour::DEFAULT,
};

/// Bytes of the dictionary's values.
pub const STORE: usize = end(&OUTPUTS) as usize;

const DEVICE_TYPE: [Entry; 1] =
    placed(0, [entry(0, "Device type", DataType::UNSIGNED32, 0, RO, &[0x91, 1, 3, 0])]);
const IDENTITY: [Entry; 5] = placed(
    end(&DEVICE_TYPE),
    [
        entry(0, "Entries", DataType::UNSIGNED8, 0, RO, &[4]),
        entry(1, "Vendor", DataType::UNSIGNED32, 16, RO, &[]),
        entry(2, "Product", DataType::UNSIGNED32, 48, RO, &[1]),
        entry(3, "Revision", DataType::UNSIGNED32, 80, RO, &[1]),
        entry(4, "Serial", DataType::UNSIGNED32, 112, RO, &[]),
    ],
);
const RX_PDO: [Entry; 2] = mapping(end(&IDENTITY), &0x7000_0020u32.to_le_bytes());
const TX_PDO: [Entry; 2] = mapping(end(&RX_PDO), &0x6000_0020u32.to_le_bytes());
const SM_TYPES: [Entry; 5] = placed(
    end(&TX_PDO),
    [
        entry(0, "Entries", DataType::UNSIGNED8, 0, RO, &[4]),
        entry(1, "SM0", DataType::UNSIGNED8, 16, RO, &[1]),
        entry(2, "SM1", DataType::UNSIGNED8, 24, RO, &[2]),
        entry(3, "SM2", DataType::UNSIGNED8, 32, RO, &[3]),
        entry(4, "SM3", DataType::UNSIGNED8, 40, RO, &[4]),
    ],
);
const RX_ASSIGNMENT: [Entry; 2] = assignment(end(&SM_TYPES), &0x1600u16.to_le_bytes());
const TX_ASSIGNMENT: [Entry; 2] = assignment(end(&RX_ASSIGNMENT), &0x1A00u16.to_le_bytes());
const SYNC_OUTPUT: [Entry; 14] = sync_parameter(end(&TX_ASSIGNMENT));
const SYNC_INPUT: [Entry; 14] = sync_parameter(end(&SYNC_OUTPUT));
const INPUTS: [Entry; 1] = placed(
    end(&SYNC_INPUT),
    [entry(0, "Inputs", DataType::UNSIGNED32, 0, RO.with(Access::TX_MAPPABLE), &[])],
);
const OUTPUTS: [Entry; 1] = placed(
    end(&INPUTS),
    [entry(0, "Outputs", DataType::UNSIGNED32, 0, RO.with(Access::RX_MAPPABLE), &[])],
);

/// The bytes of a time.
macro_rules! ns {
    ($ns:literal) => {
        const { &u32::to_le_bytes($ns) }
    };
}

const RO: Access = Access::READ;
const RW: Access = RO.with(Access::WRITE);
const RW_PREOP: Access = RO.with(Access::WRITE_PREOP);

/// A PDO with one entry of 32 bits.
const fn mapping(store: u16, entry_value: &'static [u8; 4]) -> [Entry; 2] {
    let entries = [
        entry(0, "Entries", DataType::UNSIGNED8, 0, RO, &[1]),
        entry(1, "Entry", DataType::UNSIGNED32, 16, RO, entry_value),
    ];
    placed(store, entries)
}

/// An assignment of one PDO.
const fn assignment(store: u16, pdo: &'static [u8; 2]) -> [Entry; 2] {
    let entries = [
        entry(0, "Entries", DataType::UNSIGNED8, 0, RW_PREOP, &[1]),
        entry(1, "PDO", DataType::UNSIGNED16, 16, RW_PREOP, pdo),
    ];
    placed(store, entries)
}

/// 0x1C32 or 0x1C33: Free Run, SM-synchronous and DC SYNC0; at least 250 us a cycle, 20 us from SM2 to
/// outputs ready, 10 us from SYNC0 to valid outputs.
const fn sync_parameter(store: u16) -> [Entry; 14] {
    let entries = [
        entry(0x00, "Entries", DataType::UNSIGNED8, 0, RO, &[32]),
        entry(0x01, "Sync type", DataType::UNSIGNED16, 16, RW_PREOP, &[]),
        entry(0x02, "Cycle time", DataType::UNSIGNED32, 32, RW, &[]),
        entry(0x03, "Shift time", DataType::UNSIGNED32, 64, RW, &[]),
        entry(0x04, "Sync types supported", DataType::UNSIGNED16, 96, RO, &[0x07, 0]),
        entry(0x05, "Minimum cycle", DataType::UNSIGNED32, 112, RO, ns!(250_000)),
        entry(0x06, "Calc and copy", DataType::UNSIGNED32, 144, RO, ns!(20_000)),
        entry(0x08, "Command", DataType::UNSIGNED16, 208, RW, &[]),
        entry(0x09, "Delay time", DataType::UNSIGNED32, 224, RO, ns!(10_000)),
        entry(0x0A, "SYNC0 cycle", DataType::UNSIGNED32, 256, RO, &[]),
        entry(0x0B, "SM event missed", DataType::UNSIGNED16, 288, RO, &[]),
        entry(0x0C, "Cycle time too small", DataType::UNSIGNED16, 304, RO, &[]),
        entry(0x0D, "Shift time too short", DataType::UNSIGNED16, 320, RO, &[]),
        entry(0x20, "Sync error", DataType::BOOLEAN, 480, RO, &[]),
    ];
    placed(store, entries)
}

const fn object(
    index: u16,
    name: &'static str,
    code: ObjectCode,
    data_type: DataType,
    entries: &'static [Entry],
) -> Object {
    Object { index, name, code, data_type, entries }
}

const fn entry(
    sub: u8,
    name: &'static str,
    data_type: DataType,
    complete_access_offset: u32,
    access: Access,
    default: &'static [u8],
) -> Entry {
    let Some(bits) = data_type.bits() else { panic!("types of this device have a fixed length") };
    Entry { sub, name, data_type, bits, complete_access_offset, access, store: 0, default }
}

/// The entries with their values one behind the other from `store` on.
const fn placed<const N: usize>(store: u16, mut entries: [Entry; N]) -> [Entry; N] {
    let (mut at, mut number) = (store, 0);
    while number < N {
        entries[number].store = at;
        at += entries[number].len() as u16;
        number += 1;
    }
    entries
}

/// The first byte behind the values of these entries.
const fn end(entries: &[Entry]) -> u16 {
    let last = &entries[entries.len() - 1];
    last.store + last.len() as u16
}
