//! The device of the stories: a dictionary with all kinds of objects.

use std::sync::OnceLock;

use isocat_subdevice::description::{Behaviour, Mailbox, ProcessDataArea, Speaks};
use isocat_subdevice::{Application, Description, Entry, Object};
use isocat_wire::coe::DataType;
use isocat_wire::coe::info::{Access, ObjectCode};
use isocat_wire::sii::MailboxArea;
use isocat_wire::{AbortCode, ObjectAddress};

/// Receive mailbox, SM0.
pub const RECEIVE: u16 = 0x1000;
/// Send mailbox, SM1.
pub const SEND: u16 = 0x1080;
/// Bytes of each mailbox.
pub const MAILBOX: usize = 64;
/// Outputs, SM2, and inputs, SM3.
pub const OUTPUTS: u16 = 0x1100;
pub const INPUTS: u16 = 0x1400;
/// Bytes of outputs, and of inputs.
pub const PROCESS_DATA: u16 = 7;
/// Text that takes several segments.
pub const TEXT: ObjectAddress = ObjectAddress::new(0x1008, 0);
/// Length of the text.
pub const TEXT_LEN: usize = 100;
/// Bytes that take many segments, writable in every state.
pub const BLOB: ObjectAddress = ObjectAddress::new(0x2001, 0);
/// Length of the bytes.
pub const BLOB_LEN: usize = 600;
/// Values that no story can change: object and value.
pub const FIXED: [(ObjectAddress, &[u8]); 4] = [
    (ObjectAddress::new(0x1000, 0), &[0x92, 1, 2, 0]),
    (ObjectAddress::new(0x1C00, 3), &[3]),
    (ObjectAddress::new(0x1C32, 4), &[0x27, 0]),
    (ObjectAddress::new(0x2000, 5), &[1, 2, 3]),
];
/// Objects of most requests.
pub const INDICES: [u16; 20] = [
    0x1000, 0x1008, 0x100A, 0x10F1, 0x1600, 0x1A00, 0x1C00, 0x1C12, 0x1C13, 0x1C32, 0x1C33, 0x2000,
    0x2001, 0x2002, 0x2003, 0x2004, 0x3000, 0x6040, 0x6041, 0x607A,
];

/// An application that refuses every write of 0x2004.
pub struct Refusing;

impl Application for Refusing {
    fn write_object(&mut self, object: ObjectAddress, _: &[u8]) -> Result<(), AbortCode> {
        if object.index == 0x2004 { Err(AbortCode::LOCAL_CONTROL) } else { Ok(()) }
    }
}

/// The device.
pub fn description() -> &'static Description {
    static DEVICE: OnceLock<Description> = OnceLock::new();
    DEVICE.get_or_init(|| {
        let area = |sync_manager, start| ProcessDataArea { sync_manager, start, max_length: 64 };
        let mailbox = |start| MailboxArea { start, length: MAILBOX as u16 };
        Description {
            objects: objects(),
            mailbox: Some(Mailbox {
                receive: mailbox(RECEIVE),
                send: mailbox(SEND),
                speaks: Speaks::COE,
            }),
            outputs: area(2, OUTPUTS),
            inputs: area(3, INPUTS),
            further_outputs: &[],
            further_inputs: &[],
            behaviour: Behaviour { shift_outputs: true, ..Behaviour::default() },
        }
    })
}

const RO: Access = Access::READ;
const RW: Access = Access::READ.with(Access::WRITE);
const PREOP: Access = Access::READ.with(Access::WRITE_PREOP);

fn objects() -> &'static [Object] {
    use DataType as T;
    let word = |value: u16| value.to_le_bytes().to_vec();
    let long = |value: u32| value.to_le_bytes().to_vec();
    let mut all = vec![
        var(0x1000, T::UNSIGNED32, RO, long(0x0002_0192)),
        var(0x1008, T::VISIBLE_STRING, RW, vec![b'a'; TEXT_LEN]),
        var(0x100A, T::VISIBLE_STRING, RO, b"08".to_vec()),
        record(
            0x10F1,
            vec![
                (0, 0, T::UNSIGNED8, RO, vec![2]),
                (1, 16, T::UNSIGNED32, RW, long(1)),
                (2, 48, T::UNSIGNED16, RW, word(4)),
            ],
        ),
    ];
    for (index, mapped) in [
        (0x1600, [0x6040_0010, 0x607A_0020, 0x6060_0008]),
        (0x1A00, [0x6041_0010, 0x6064_0020, 0x6061_0008]),
    ] {
        let mut rows = vec![(0, 0, T::UNSIGNED8, PREOP, vec![3])];
        for (sub, value) in (1..).zip(mapped) {
            rows.push((sub, 32 * u32::from(sub) - 16, T::UNSIGNED32, PREOP, long(value)));
        }
        all.push(record(index, rows));
    }
    let types = (1..=4u8).map(|sm| (sm, 8 + 8 * u32::from(sm), T::UNSIGNED8, RO, vec![sm]));
    let count = [(0, 0, T::UNSIGNED8, RO, vec![4])];
    all.push(array(0x1C00, count.into_iter().chain(types).collect()));
    for (index, pdo) in [(0x1C12, 0x1600), (0x1C13, 0x1A00)] {
        let mut rows = vec![(0, 0, T::UNSIGNED8, PREOP, vec![1])];
        for sub in 1..=3u8 {
            let value = if sub == 1 { pdo } else { 0 };
            rows.push((sub, 16 * u32::from(sub), T::UNSIGNED16, PREOP, word(value)));
        }
        all.push(array(index, rows));
    }
    for index in [0x1C32, 0x1C33] {
        let mut rows = vec![
            (0, 0, T::UNSIGNED8, RO, vec![32]),
            (1, 16, T::UNSIGNED16, RW, word(0)),
            (2, 32, T::UNSIGNED32, RW, long(0)),
            (3, 64, T::UNSIGNED32, RW, long(0)),
            (4, 96, T::UNSIGNED16, RO, word(0x27)),
            (5, 112, T::UNSIGNED32, RO, long(250_000)),
            (6, 144, T::UNSIGNED32, RO, long(60_000)),
            (8, 208, T::UNSIGNED16, RW, word(0)),
            (9, 224, T::UNSIGNED32, RO, long(30_000)),
        ];
        rows.extend([(11, 288), (12, 304)].map(|(s, at)| (s, at, T::UNSIGNED16, RO, word(0))));
        rows.push((32, 480, T::BOOLEAN, RO, vec![0]));
        all.push(record(index, rows));
    }
    all.push(record(
        0x2000,
        vec![
            (0, 0, T::UNSIGNED8, RO, vec![5]),
            (1, 16, T::BOOLEAN, RW, vec![1]),
            (2, 17, T::BIT3, RW, vec![5]),
            (3, 20, T::GAP, Access::default(), Vec::new()),
            (4, 24, T::UNSIGNED16, Access::WRITE, word(0)),
            (5, 40, T::UNSIGNED24, RO, vec![1, 2, 3]),
        ],
    ));
    all.push(var(0x2001, T::OCTET_STRING, RW, vec![7; BLOB_LEN]));
    // Longer than a transfer of the stack.
    all.push(var(0x2002, T::OCTET_STRING, RW, vec![7; isocat_subdevice::MAX_TRANSFER + 76]));
    let mut rows = vec![(0, 0, T::UNSIGNED8, RO, vec![200])];
    rows.extend((1..=200).map(|sub| (sub, 32 * u32::from(sub) - 16, T::UNSIGNED32, RW, long(1))));
    all.push(array(0x2003, rows));
    all.push(var(0x2004, T::UNSIGNED32, RW, long(0)));
    // So many objects that their list takes fragments.
    all.extend((0x3000..0x3060).map(|index| var(index, T::UNSIGNED8, RO, vec![0])));
    let (rx, tx) = (RW.with(Access::RX_MAPPABLE), RO.with(Access::TX_MAPPABLE));
    all.push(var(0x6040, T::UNSIGNED16, rx, word(0)));
    all.push(var(0x6041, T::UNSIGNED16, tx, word(0)));
    all.push(var(0x6060, T::INTEGER8, rx, vec![0]));
    all.push(var(0x6061, T::INTEGER8, tx, vec![0]));
    all.push(var(0x6064, T::INTEGER32, tx, long(0)));
    all.push(var(0x607A, T::INTEGER32, rx, long(0)));
    place(all)
}

/// Sub-index, bit of complete access, type, access, value.
type Row = (u8, u32, DataType, Access, Vec<u8>);
type Draft = (u16, ObjectCode, Vec<Row>);

fn var(index: u16, data_type: DataType, access: Access, value: Vec<u8>) -> Draft {
    (index, ObjectCode::VAR, vec![(0, 0, data_type, access, value)])
}

fn record(index: u16, rows: Vec<Row>) -> Draft {
    (index, ObjectCode::RECORD, rows)
}

fn array(index: u16, rows: Vec<Row>) -> Draft {
    (index, ObjectCode::ARRAY, rows)
}

/// The static form; each entry gets a place in the value store.
fn place(drafts: Vec<Draft>) -> &'static [Object] {
    let mut store = 0;
    let objects = drafts.into_iter().map(|(index, code, rows)| {
        let data_type = rows.last().expect("an object has entries").2;
        let entries = rows.into_iter().map(|(sub, at, data_type, access, default)| {
            let len = 8 * default.len() as u16;
            let bits = if data_type == DataType::GAP { 4 } else { data_type.bits().unwrap_or(len) };
            let entry = Entry {
                sub,
                name: "an entry with a name that is longer than a mailbox would like to have it",
                data_type,
                bits,
                complete_access_offset: at,
                access,
                store,
                default: Vec::leak(default),
            };
            store += entry.len() as u16;
            entry
        });
        let entries = Vec::leak(entries.collect());
        Object { index, name: "an object", code, data_type, entries }
    });
    Vec::leak(objects.collect())
}
