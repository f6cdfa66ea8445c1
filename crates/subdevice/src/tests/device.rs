//! The device under test: a dictionary with all kinds of objects.

use std::boxed::Box;
use std::vec::Vec;

use isocat_wire::coe::DataType;
use isocat_wire::coe::info::{Access, ObjectCode};
use isocat_wire::sii::MailboxArea;

use crate::description::{Behaviour, Description, Entry, Mailbox, Object, ProcessDataArea, Speaks};

pub const RO: Access = Access::READ;
pub const RW: Access = Access::READ.with(Access::WRITE);
pub const RW_PREOP: Access = Access::READ.with(Access::WRITE_PREOP);

/// A text longer than a mailbox.
pub const NAME: &str = "a name that is much longer than what a mailbox of 64 bytes can take at once, \
    so that it has to come in segments, of which the last one is a short one";

/// A device with outputs and inputs of 7 bytes, mailboxes of 64 bytes and all modes.
pub fn description(change: impl FnOnce(&mut Builder)) -> &'static Description {
    let mut builder = Builder { objects: Vec::new(), behaviour: Behaviour::default() };
    builder.var(0x1000, "Device type", DataType::UNSIGNED32, RO, &[0x92, 1, 2, 0]);
    builder.var(0x1008, "Device name", DataType::VISIBLE_STRING, RW, NAME.as_bytes());
    builder.var(0x100A, "Software version", DataType::VISIBLE_STRING, RO, b"08");
    builder.object(0x10F1, "Error settings", ObjectCode::RECORD, DataType(0x0027), |o| {
        o.entry(0, 0, DataType::UNSIGNED8, RO, &[2]);
        o.entry(1, 16, DataType::UNSIGNED32, RW, &[1, 0, 0, 0]);
        o.entry(2, 48, DataType::UNSIGNED16, RW, &[4, 0]);
    });
    for (index, mapped) in [
        (0x1600, [0x6040_0010, 0x607A_0020, 0x6060_0008]),
        (0x1A00, [0x6041_0010, 0x6064_0020, 0x6061_0008u32]),
    ] {
        builder.object(index, "PDO", ObjectCode::RECORD, DataType::PDO_MAPPING, |o| {
            o.entry(0, 0, DataType::UNSIGNED8, RW_PREOP, &[3]);
            for (i, value) in mapped.iter().enumerate() {
                let offset = 16 + 32 * i as u32;
                let default = value.to_le_bytes();
                o.entry(i as u8 + 1, offset, DataType::UNSIGNED32, RW_PREOP, &default);
            }
        });
    }
    builder.object(0x1C00, "SM types", ObjectCode::ARRAY, DataType::UNSIGNED8, |o| {
        o.entry(0, 0, DataType::UNSIGNED8, RO, &[4]);
        for i in 1..=4 {
            o.entry(i, 8 + 8 * u32::from(i), DataType::UNSIGNED8, RO, &[i]);
        }
    });
    for (index, pdo) in [(0x1C12, 0x1600u16), (0x1C13, 0x1A00)] {
        builder.object(index, "Assignment", ObjectCode::ARRAY, DataType::UNSIGNED16, |o| {
            o.entry(0, 0, DataType::UNSIGNED8, RW_PREOP, &[1]);
            let pdo = pdo.to_le_bytes();
            for i in 1..=3u8 {
                let default = if i == 1 { &pdo[..] } else { &[] };
                let offset = 16 * u32::from(i);
                o.entry(i, offset, DataType::UNSIGNED16, RW_PREOP, default);
            }
        });
    }
    for index in [0x1C32, 0x1C33] {
        builder.object(index, "Sync", ObjectCode::RECORD, DataType::SYNC_PAR, sync_parameter);
    }
    builder.object(0x2000, "Bits", ObjectCode::RECORD, DataType(0x0040), |o| {
        o.entry(0, 0, DataType::UNSIGNED8, RO, &[5]);
        o.entry(1, 16, DataType::BOOLEAN, RW, &[1]);
        o.entry(2, 17, DataType::BIT3, RW, &[0b101]);
        o.entry(3, 20, DataType::GAP, Access::default(), &[]);
        o.entry(4, 24, DataType::UNSIGNED16, Access::WRITE, &[]);
        o.entry(5, 40, DataType::UNSIGNED24, RO, &[1, 2, 3]);
    });
    let (rx, tx) = (RW.with(Access::RX_MAPPABLE), RO.with(Access::TX_MAPPABLE));
    builder.var(0x6040, "Control word", DataType::UNSIGNED16, rx, &[]);
    builder.var(0x6041, "Status word", DataType::UNSIGNED16, tx, &[]);
    builder.var(0x6060, "Mode", DataType::INTEGER8, rx, &[]);
    builder.var(0x6061, "Mode display", DataType::INTEGER8, tx, &[]);
    builder.var(0x6064, "Actual position", DataType::INTEGER32, tx, &[]);
    builder.var(0x607A, "Target position", DataType::INTEGER32, rx, &[]);
    change(&mut builder);
    Box::leak(Box::new(builder.finish()))
}

fn sync_parameter(o: &mut ObjectBuilder) {
    o.entry(0, 0, DataType::UNSIGNED8, RO, &[32]);
    o.entry(1, 16, DataType::UNSIGNED16, RW_PREOP, &[]);
    o.entry(2, 32, DataType::UNSIGNED32, RW, &[]);
    o.entry(3, 64, DataType::UNSIGNED32, RW, &[]);
    o.entry(4, 96, DataType::UNSIGNED16, RO, &[0x27, 0]);
    o.entry(5, 112, DataType::UNSIGNED32, RO, &250_000u32.to_le_bytes());
    o.entry(6, 144, DataType::UNSIGNED32, RO, &60_000u32.to_le_bytes());
    o.entry(8, 208, DataType::UNSIGNED16, RW, &[]);
    o.entry(9, 224, DataType::UNSIGNED32, RO, &30_000u32.to_le_bytes());
    o.entry(10, 256, DataType::UNSIGNED32, RO, &[]);
    for (sub, offset) in [(11, 288), (12, 304), (13, 320), (14, 336)] {
        o.entry(sub, offset, DataType::UNSIGNED16, RO, &[]);
    }
    for (sub, offset) in [(15, 352), (16, 384), (17, 416), (18, 448)] {
        o.entry(sub, offset, DataType::UNSIGNED32, RO, &[]);
    }
    o.entry(32, 480, DataType::BOOLEAN, RO.with(Access::TX_MAPPABLE), &[]);
}

pub struct Builder {
    pub objects: Vec<Object>,
    pub behaviour: Behaviour,
}

impl Builder {
    pub fn var(
        &mut self,
        index: u16,
        name: &'static str,
        data_type: DataType,
        access: Access,
        default: &[u8],
    ) {
        self.object(index, name, ObjectCode::VAR, data_type, |o| {
            o.entry(0, 0, data_type, access, default);
        });
    }

    pub fn object(
        &mut self,
        index: u16,
        name: &'static str,
        code: ObjectCode,
        data_type: DataType,
        fill: impl FnOnce(&mut ObjectBuilder),
    ) {
        let mut object = ObjectBuilder { entries: Vec::new() };
        fill(&mut object);
        let entries = Vec::leak(object.entries);
        self.objects.push(Object { index, name, code, data_type, entries });
    }

    /// Changes an entry's value after power-on.
    pub fn preset(&mut self, index: u16, sub: u8, value: &[u8]) {
        self.edit(index, sub, |entry| entry.default = Vec::leak(value.to_vec()));
    }

    pub fn edit(&mut self, index: u16, sub: u8, change: impl FnOnce(&mut Entry)) {
        let object = self.objects.iter_mut().find(|o| o.index == index).unwrap();
        let mut entries = object.entries.to_vec();
        change(entries.iter_mut().find(|entry| entry.sub == sub).unwrap());
        object.entries = Vec::leak(entries);
    }

    fn finish(mut self) -> Description {
        self.objects.sort_by_key(|object| object.index);
        let mut store = 0;
        for object in &mut self.objects {
            let mut entries = object.entries.to_vec();
            for entry in &mut entries {
                entry.store = store;
                store += entry.len() as u16;
            }
            object.entries = Vec::leak(entries);
        }
        Description {
            objects: Vec::leak(self.objects),
            mailbox: Some(Mailbox {
                receive: MailboxArea { start: 0x1000, length: 64 },
                send: MailboxArea { start: 0x1080, length: 64 },
                speaks: Speaks::COE,
            }),
            outputs: ProcessDataArea { sync_manager: 2, start: 0x1100, max_length: 64 },
            inputs: ProcessDataArea { sync_manager: 3, start: 0x1400, max_length: 64 },
            further_outputs: &[],
            further_inputs: &[],
            behaviour: self.behaviour,
        }
    }
}

pub struct ObjectBuilder {
    entries: Vec<Entry>,
}

impl ObjectBuilder {
    pub fn entry(&mut self, sub: u8, at: u32, data_type: DataType, access: Access, default: &[u8]) {
        let bits = data_type.bits().unwrap_or(8 * default.len() as u16);
        self.entries.push(Entry {
            sub,
            name: "an entry",
            data_type,
            bits: if data_type == DataType::GAP { 4 } else { bits },
            complete_access_offset: at,
            access,
            store: 0,
            default: Vec::leak(default.to_vec()),
        });
    }
}
