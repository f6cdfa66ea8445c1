//! The device: an I/O block whose outputs are wired to its inputs, four bytes each way.

use isocat_subdevice::describe::{
    RO, SyncStatement, assignment, end, identity, mapping, object, sync_manager_types,
    sync_parameter, value,
};
use isocat_subdevice::description::{Behaviour, Mailbox, ProcessDataArea, Speaks};
use isocat_subdevice::{Description, Entry};
use isocat_wire::coe::DataType;
use isocat_wire::coe::info::{Access, ObjectCode};
use isocat_wire::sii::MailboxArea;

/// The fixed properties of the device.
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
    mailbox: Some(MAILBOX),
    outputs: ProcessDataArea { sync_manager: 2, start: 0x1100, max_length: PROCESS_DATA },
    inputs: ProcessDataArea { sync_manager: 3, start: 0x1400, max_length: PROCESS_DATA },
    further_outputs: &[],
    further_inputs: &[],
    behaviour: Behaviour::DEFAULT,
};

/// Bytes of the dictionary's values, of the images of the process data, and of the mailbox.
pub const STORE: usize = end(&OUTPUTS) as usize + 2 * PROCESS_DATA as usize + MAILBOX.store_len();
const MAILBOX: Mailbox = Mailbox {
    receive: MailboxArea { start: 0x1000, length: 64 },
    send: MailboxArea { start: 0x1080, length: 64 },
    speaks: Speaks::COE,
};
/// Bytes of outputs, and of inputs.
const PROCESS_DATA: u16 = 4;

const DEVICE_TYPE: [Entry; 1] = value(0, "Device type", DataType::UNSIGNED32, RO, &[0x91, 1, 3, 0]);
const IDENTITY: [Entry; 5] =
    identity(end(&DEVICE_TYPE), &[0; 4], &[1, 0, 0, 0], &[1, 0, 0, 0], &[0; 4]);
const RX_PDO: [Entry; 2] = mapping(end(&IDENTITY), &0x7000_0020u32.to_le_bytes());
const TX_PDO: [Entry; 2] = mapping(end(&RX_PDO), &0x6000_0020u32.to_le_bytes());
const SM_TYPES: [Entry; 5] = sync_manager_types(end(&TX_PDO));
const RX_ASSIGNMENT: [Entry; 2] = assignment(end(&SM_TYPES), &0x1600u16.to_le_bytes());
const TX_ASSIGNMENT: [Entry; 2] = assignment(end(&RX_ASSIGNMENT), &0x1A00u16.to_le_bytes());
const SYNC_OUTPUT: [Entry; 14] = sync_parameter(end(&TX_ASSIGNMENT), SYNC);
const SYNC_INPUT: [Entry; 14] = sync_parameter(end(&SYNC_OUTPUT), SYNC);
const INPUTS: [Entry; 1] =
    value(end(&SYNC_INPUT), "Inputs", DataType::UNSIGNED32, RO.with(Access::TX_MAPPABLE), &[]);
const OUTPUTS: [Entry; 1] =
    value(end(&INPUTS), "Outputs", DataType::UNSIGNED32, RO.with(Access::RX_MAPPABLE), &[]);

/// 0x1C32 and 0x1C33: Free Run, SM-synchronous and DC SYNC0; a cycle of at least 250 us, 20 us from
/// SM2 until outputs are ready, 10 us from SYNC0 to valid outputs.
const SYNC: SyncStatement = SyncStatement {
    supported: &[0x07, 0],
    minimum_cycle: &250_000u32.to_le_bytes(),
    calc_and_copy: &20_000u32.to_le_bytes(),
    delay: &10_000u32.to_le_bytes(),
};
