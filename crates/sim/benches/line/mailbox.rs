//! A device of the line with a mailbox and an object dictionary, and one request to all of them.

use isocat_subdevice::Entry;
use isocat_subdevice::describe::{
    RO, SyncStatement, assignment, end, entry, identity, mapping, object, placed,
    sync_manager_types, sync_parameter, value,
};
use isocat_subdevice::description::{Behaviour, Description, Mailbox, ProcessDataArea, Speaks};
use isocat_wire::coe::info::{Access, ObjectCode};
use isocat_wire::coe::sdo::{self, Initiate};
use isocat_wire::coe::{self, DataType, Service};
use isocat_wire::mailbox::{self, Protocol};
use isocat_wire::sii::MailboxArea;
use isocat_wire::sync_manager::SyncManager;
use isocat_wire::{Command, ObjectAddress, register};

use super::{BYTES, INPUTS_AT, Line, OUTPUTS_AT};

/// A device with CoE, whose outputs and inputs are those of the device without.
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
        object(0x6000, "Inputs", ObjectCode::VAR, DataType::OCTET_STRING, &INPUTS),
        object(0x7000, "Outputs", ObjectCode::VAR, DataType::OCTET_STRING, &OUTPUTS),
    ],
    mailbox: Some(Mailbox { receive: RECEIVE, send: SEND, speaks: Speaks::COE }),
    outputs: ProcessDataArea { sync_manager: 2, start: OUTPUTS_AT, max_length: BYTES },
    inputs: ProcessDataArea { sync_manager: 3, start: INPUTS_AT, max_length: BYTES },
    further_outputs: &[],
    further_inputs: &[],
    behaviour: Behaviour::DEFAULT,
};

/// The mailbox to the SubDevice, as long as makers usually have it.
const RECEIVE: MailboxArea = MailboxArea { start: 0x1200, length: 128 };
/// The mailbox to the MainDevice.
const SEND: MailboxArea = MailboxArea { start: 0x1280, length: 128 };

impl Line {
    /// Sets the SyncManagers of the mailboxes.
    pub(super) fn open_mailbox(&mut self) {
        let areas = [(0, RECEIVE, SyncManager::MAILBOX_OUT), (1, SEND, SyncManager::MAILBOX_IN)];
        for (number, area, control) in areas {
            let manager = SyncManager::new(area.start, area.length, control, true);
            self.write(register::sync_manager(number), manager);
        }
    }

    /// Sends a request to all, and reads all answers; they are equal.
    pub(super) fn ask(&mut self) {
        let request = request();
        self.broadcast(Command::Bwr, RECEIVE.start, &request);
        let empty = [0; SEND.length as usize];
        let (answer, count) = self.broadcast(Command::Brd, SEND.start, &empty);
        assert_eq!(usize::from(count), self.count & 0xFFFF, "not all have answered");
        assert!(is_answer(&answer), "{answer:02X?}");
    }
}

/// An upload of the vendor, as long as the mailbox.
fn request() -> [u8; RECEIVE.length as usize] {
    let object = ObjectAddress::new(0x1018, 1);
    let upload =
        Initiate { command: sdo::Command::upload_request(false), object, data: [0; 4] }.emit();
    let len = (coe::HEADER_LEN + upload.len()) as u16;
    let mut bytes = [0; RECEIVE.length as usize];
    let (head, body) = bytes.split_at_mut(mailbox::HEADER_LEN);
    head.copy_from_slice(&mailbox::Header::new(len, 0, Protocol::COE, 1).emit());
    let (head, body) = body.split_at_mut(coe::HEADER_LEN);
    head.copy_from_slice(&coe::Header::new(Service::SDO_REQUEST).emit());
    body[..upload.len()].copy_from_slice(&upload);
    bytes
}

/// Whether this is the answer to the request.
fn is_answer(bytes: &[u8]) -> bool {
    let vendor = mailbox::HEADER_LEN + coe::HEADER_LEN + 4;
    bytes.get(vendor..vendor + VENDOR.len()).is_some_and(|found| found == VENDOR)
}

const VENDOR: &[u8; 4] = &[1, 0, 0, 0];
const DEVICE_TYPE: [Entry; 1] = value(0, "Device type", DataType::UNSIGNED32, RO, &[0x91, 1, 3, 0]);
const IDENTITY: [Entry; 5] =
    identity(end(&DEVICE_TYPE), VENDOR, &[1, 0, 0, 0], &[1, 0, 0, 0], &[0; 4]);
const RX_PDO: [Entry; 2] = mapping(end(&IDENTITY), &0x7000_0080u32.to_le_bytes());
const TX_PDO: [Entry; 2] = mapping(end(&RX_PDO), &0x6000_0080u32.to_le_bytes());
const SM_TYPES: [Entry; 5] = sync_manager_types(end(&TX_PDO));
const RX_ASSIGNMENT: [Entry; 2] = assignment(end(&SM_TYPES), &0x1600u16.to_le_bytes());
const TX_ASSIGNMENT: [Entry; 2] = assignment(end(&RX_ASSIGNMENT), &0x1A00u16.to_le_bytes());
const SYNC_OUTPUT: [Entry; 14] = sync_parameter(end(&TX_ASSIGNMENT), SYNC);
const SYNC_INPUT: [Entry; 14] = sync_parameter(end(&SYNC_OUTPUT), SYNC);
const INPUTS: [Entry; 1] = data(end(&SYNC_INPUT), RO.with(Access::TX_MAPPABLE));
const OUTPUTS: [Entry; 1] = data(end(&INPUTS), RO.with(Access::RX_MAPPABLE));

const fn data(store: u16, access: Access) -> [Entry; 1] {
    let whole = entry(0, "Data", DataType::UNSIGNED8, 0, access, &[]);
    let bits = 8 * BYTES;
    placed(store, [Entry { data_type: DataType::OCTET_STRING, bits, ..whole }])
}

/// As the device without a mailbox has it.
const SYNC: SyncStatement = SyncStatement {
    supported: &[0x07, 0],
    minimum_cycle: &250_000u32.to_le_bytes(),
    calc_and_copy: &20_000u32.to_le_bytes(),
    delay: &[0; 4],
};
