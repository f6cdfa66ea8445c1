//! SubDevices that answer truthfully: memory, EEPROM, states, a clock, a mailbox with a few
//! objects. They are far simpler than an ESC, and fast.

use std::collections::VecDeque;

use isocat_wire::al::AlState;
use isocat_wire::command::Command;
use isocat_wire::datagram::Layouts;
use isocat_wire::dl::DlStatus;
use isocat_wire::eeprom::EepromStatus;
use isocat_wire::fmmu::Fmmu;
use isocat_wire::frame::{LOCALLY_ADMINISTERED, payload_offset};
use isocat_wire::mailbox::{self, Protocol, next_counter};
use isocat_wire::register::{self, Value, features};
use isocat_wire::sii::{
    self, MailboxArea, PdoEntryRecord, PdoRecord, SmRecord, Writer, category, sm_type,
};
use isocat_wire::{ObjectAddress, PortNumber};

use super::lies::{Liar, Random};

/// Bytes of memory: registers and a little process RAM.
const MEMORY: usize = 0x1300;
/// The mailbox: SM0 and SM1.
pub const RECEIVE: MailboxArea = MailboxArea { start: 0x1000, length: 64 };
pub const SEND: MailboxArea = MailboxArea { start: 0x1080, length: 64 };
/// Process data: SM2 and SM3.
const OUTPUTS: u16 = 0x1100;
const INPUTS: u16 = 0x1180;
/// Time from one SubDevice to the next, ns.
const HOP: u64 = 300;

/// What a SubDevice can do.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Make {
    pub clock: bool,
    pub mailbox: bool,
}

/// One SubDevice.
pub struct Device {
    pub make: Make,
    pub memory: Vec<u8>,
    sii: Vec<u8>,
    /// Its local clock at true time 0, ns.
    epoch: u64,
    /// Messages that wait for SM1, in their order.
    pub answers: VecDeque<Vec<u8>>,
    counter: u8,
    last_request: u8,
    pub liar: Option<Liar>,
}

/// SubDevices in a line.
pub struct Line {
    pub devices: Vec<Device>,
}

impl Line {
    pub fn new(makes: &[Make]) -> Self {
        let count = makes.len();
        let device = |(at, make): (usize, &Make)| Device::new(*make, at, at + 1 == count);
        Self { devices: makes.iter().enumerate().map(device).collect() }
    }

    /// Passes a frame through all SubDevices; it enters the first one at `now`, ns.
    pub fn pass(&mut self, now: u64, frame: &mut [u8], random: &mut Random) {
        frame[6] |= LOCALLY_ADMINISTERED;
        let Ok(start) = payload_offset(frame) else { return };
        let payload = &mut frame[start..];
        let count = self.devices.len();
        for (at, device) in self.devices.iter_mut().enumerate() {
            let entered = now + HOP * at as u64;
            let returned = now + HOP * (2 * count - at) as u64;
            let mut layouts = Layouts::new();
            while let Some(Ok(layout)) = layouts.next(payload) {
                let header = layout.header;
                let Ok(command) = header.command() else { break };
                let adp = header.adp();
                if command.increments_position() {
                    let next = adp.wrapping_add(1).to_le_bytes();
                    payload[layout.start + 2..layout.start + 4].copy_from_slice(&next);
                }
                let times = Times { entered, returned };
                let wkc_at = layout.wkc();
                let data = &mut payload[layout.data()..wkc_at];
                let count = device.process(command, header.address, times, data, random);
                let wkc = u16::from_le_bytes([payload[wkc_at], payload[wkc_at + 1]]);
                payload[wkc_at..wkc_at + 2].copy_from_slice(&wkc.wrapping_add(count).to_le_bytes());
            }
        }
    }
}

/// When a frame enters a SubDevice, and when it comes back from the SubDevices behind it, true time
/// in ns.
#[derive(Clone, Copy)]
struct Times {
    entered: u64,
    returned: u64,
}

impl Device {
    fn new(make: Make, at: usize, last: bool) -> Self {
        let mut memory = vec![0; MEMORY];
        let dc = if make.clock { features::DC | features::DC_64_BIT } else { 0 };
        // An ET1100 in outline: type, revision, build, FMMUs, SyncManagers, RAM, ports, features.
        memory[..10].copy_from_slice(&[0x11, 0, 2, 0, 8, 8, 8, 0x0F, dc as u8, (dc >> 8) as u8]);
        memory[0x0100] = 1;
        let status = DlStatus(DlStatus::PDI_OPERATIONAL);
        let status = status.with_port(PortNumber::P0, true, false, true);
        let status = status.with_port(PortNumber::P1, !last, last, !last);
        let closed = |status: DlStatus, port| status.with_port(port, false, true, false);
        let status = closed(closed(status, PortNumber::P2), PortNumber::P3);
        memory[0x0110..0x0112].copy_from_slice(&status.to_bytes());
        memory[0x0130] = AlState::Init as u8;
        Self {
            make,
            memory,
            sii: image(make),
            epoch: 1_000_000_000 + 77_777 * at as u64,
            answers: VecDeque::new(),
            counter: 0,
            last_request: 0,
            liar: None,
        }
    }

    /// Processes a datagram; returns the increase of the working counter.
    fn process(
        &mut self,
        command: Command,
        address: u32,
        times: Times,
        data: &mut [u8],
        random: &mut Random,
    ) -> u16 {
        let (adp, ado) = (address as u16, (address >> 16) as u16);
        let station = u16::from_le_bytes([self.memory[0x10], self.memory[0x11]]);
        let mine = match command {
            Command::Fprd | Command::Fpwr | Command::Frmw => adp == station,
            Command::Aprd | Command::Apwr => adp == 0,
            _ => true,
        };
        if let Some(mut liar) = self.liar.take() {
            let count = liar.answer(self, command, ado, mine, data, random, |device, data| {
                device.honest(command, address, mine, times, data)
            });
            self.liar = Some(liar);
            return count;
        }
        self.honest(command, address, mine, times, data)
    }

    fn honest(
        &mut self,
        command: Command,
        address: u32,
        mine: bool,
        times: Times,
        data: &mut [u8],
    ) -> u16 {
        let ado = usize::from((address >> 16) as u16);
        match command {
            Command::Fprd | Command::Aprd | Command::Frmw if mine => {
                u16::from(self.read(ado, times, data))
            }
            Command::Frmw => u16::from(self.compare(ado, times, data)),
            Command::Fpwr | Command::Apwr if mine => u16::from(self.write(ado, times, data)),
            Command::Bwr => u16::from(self.write(ado, times, data)),
            Command::Brd => {
                let mut own = vec![0; data.len()];
                let read = self.read(ado, times, &mut own);
                data.iter_mut().zip(own).for_each(|(byte, own)| *byte |= own);
                u16::from(read)
            }
            Command::Lrw => self.logical(address, data),
            _ => 0,
        }
    }

    fn local(&self, at: u64) -> u64 {
        self.epoch.wrapping_add(at)
    }

    /// Its copy of the system time, less the delay, as ECAT reads it.
    fn system(&self, at: u64) -> u64 {
        let offset = register::SYSTEM_TIME_OFFSET.load(&self.memory);
        let delay = register::SYSTEM_TIME_DELAY.load(&self.memory);
        self.local(at).wrapping_add(offset).wrapping_sub(delay.into())
    }

    fn read(&mut self, at: usize, times: Times, data: &mut [u8]) -> bool {
        let Some(range) = at.checked_add(data.len()).filter(|end| *end <= MEMORY) else {
            return false;
        };
        match at {
            0x0900..0x0A00 if !self.make.clock => return false,
            0x0910 => {
                let now = self.system(times.entered);
                self.memory[0x0910..0x0918].copy_from_slice(&now.to_le_bytes());
            }
            0x0990 => {
                // The next pulse on the grid of the start time.
                let now = self.system(times.entered)
                    + u64::from(register::SYSTEM_TIME_DELAY.load(&self.memory));
                let start = register::SYNC_START_TIME.load(&self.memory);
                let cycle: u64 = register::SYNC0_CYCLE.load(&self.memory).max(1).into();
                let next = match now.checked_sub(start) {
                    Some(since) => start + (since / cycle + 1) * cycle,
                    None => start,
                };
                self.memory[0x0990..0x0998].copy_from_slice(&next.to_le_bytes());
            }
            0x080D if self.make.mailbox => {
                self.memory[at] = if self.answers.is_empty() { 0 } else { 0x08 };
            }
            0x0130 if self.memory[0x0120] & 0x0F != 0 => self.memory[at] = self.memory[0x0120],
            _ if at == usize::from(SEND.start) => {
                let Some(message) = self.answers.pop_front() else { return false };
                data.fill(0);
                data[..message.len()].copy_from_slice(&message);
                return true;
            }
            _ => {}
        }
        data.copy_from_slice(&self.memory[at..range]);
        true
    }

    fn write(&mut self, at: usize, times: Times, data: &[u8]) -> bool {
        let Some(end) = at.checked_add(data.len()).filter(|end| *end <= MEMORY) else {
            return false;
        };
        if (0x0900..0x0A00).contains(&at) && !self.make.clock {
            return false;
        }
        self.memory[at..end].copy_from_slice(data);
        match at {
            0x0120 => self.memory[at] &= 0x0F,
            0x0502 if data.len() >= 6 => self.fetch(),
            0x0502 => self.memory[0x0502..0x0504].copy_from_slice(&[0x40, 0]),
            0x080E => self.memory[0x080F] = data[0] & 2,
            0x0900 => {
                let ports = [times.entered, times.returned, 0, 0];
                for (port, time) in ports.into_iter().enumerate() {
                    let time = self.local(time) as u32;
                    self.memory[0x0900 + 4 * port..][..4].copy_from_slice(&time.to_le_bytes());
                }
                let entered = self.local(times.entered).to_le_bytes();
                self.memory[0x0918..0x0920].copy_from_slice(&entered);
            }
            _ if at == usize::from(RECEIVE.start) && self.make.mailbox => self.serve(data),
            _ => {}
        }
        true
    }

    /// Answers a read command of the EEPROM.
    fn fetch(&mut self) {
        let word = register::EEPROM_ADDRESS.load(&self.memory) as usize;
        for at in 0..8 {
            self.memory[0x0508 + at] = self.sii.get(2 * word + at).copied().unwrap_or(0xFF);
        }
        let status = EepromStatus::READS_8_BYTES.to_le_bytes();
        self.memory[0x0502..0x0504].copy_from_slice(&status);
    }

    /// Takes a drift datagram of another reference: 0x092C shows the difference.
    fn compare(&mut self, at: usize, times: Times, data: &[u8]) -> bool {
        let (0x0910, Some(received)) = (at, data.first_chunk()) else { return true };
        if !self.make.clock {
            return false;
        }
        let behind = u64::from_le_bytes(*received).wrapping_sub(self.system(times.entered)) as i64;
        let shown = (behind.unsigned_abs() as u32) & 0x7FFF_FFFF;
        let sign = if behind > 0 { 1 << 31 } else { 0 };
        self.memory[0x092C..0x0930].copy_from_slice(&(shown | sign).to_le_bytes());
        true
    }

    /// Accesses process data byte-wise through FMMU 0 and 1.
    fn logical(&mut self, address: u32, data: &mut [u8]) -> u16 {
        let mut count = 0;
        let sent = data.to_vec();
        for number in 0..2 {
            let fmmu = register::fmmu(number).load(&self.memory);
            let start = fmmu.logical_start.wrapping_sub(address) as usize;
            let (length, physical) = (usize::from(fmmu.length), usize::from(fmmu.physical_start));
            if !fmmu.is_active() || start + length > data.len() || physical + length > MEMORY {
                continue;
            }
            let memory = &mut self.memory[physical..physical + length];
            if fmmu.kind & Fmmu::WRITE != 0 {
                memory.copy_from_slice(&sent[start..start + length]);
                count += 2;
            } else {
                data[start..start + length].copy_from_slice(memory);
                count += 1;
            }
        }
        count
    }

    /// Puts a message into SM1.
    pub fn put(&mut self, protocol: Protocol, service: &[u8]) {
        self.counter = next_counter(self.counter);
        let header = mailbox::Header::new(service.len() as u16, 0, protocol, self.counter);
        let mut message = header.emit().to_vec();
        message.extend_from_slice(service);
        message.truncate(usize::from(SEND.length));
        self.answers.push_back(message);
    }

    fn serve(&mut self, message: &[u8]) {
        let Some((head, rest)) = message.split_first_chunk() else { return };
        let header = mailbox::Header::parse(head);
        let Some(service) = rest.get(..usize::from(header.length)) else { return };
        if header.counter == self.last_request || service.len() < 10 {
            return;
        }
        self.last_request = header.counter;
        let [_, kind, command, i0, i1, sub, ..] = *service else { return };
        if kind >> 4 != 2 {
            return;
        }
        let object = ObjectAddress::new(u16::from_le_bytes([i0, i1]), sub);
        let mut answer = vec![0, 0x30, 0, i0, i1, sub];
        match (command >> 5, value(object)) {
            (1, Some(_)) => {
                answer[2] = 0x60;
                answer.extend_from_slice(&[0; 4]);
            }
            (2, Some((value, len))) => {
                answer[2] = 0x43 | (4 - len) << 2;
                answer.extend_from_slice(&value.to_le_bytes());
            }
            _ => {
                (answer[1], answer[2]) = (0x20, 0x80);
                answer.extend_from_slice(&0x0602_0000u32.to_le_bytes());
            }
        }
        self.put(Protocol::COE, &answer);
    }
}

/// The value of an entry and its bytes.
fn value(object: ObjectAddress) -> Option<(u32, u8)> {
    Some(match (object.index, object.sub) {
        (0x1C00, 0) => (4, 1),
        (0x1C00, sub @ 1..=4) => (sub.into(), 1),
        (0x1C12 | 0x1C13 | 0x1600 | 0x1A00, 0) => (1, 1),
        (0x1C12, 1) => (0x1600, 2),
        (0x1C13, 1) => (0x1A00, 2),
        (0x1600, 1) => (0x7000_0110, 4),
        (0x1A00, 1) => (0x6000_0110, 4),
        _ => return None,
    })
}

/// The SII of a SubDevice with two bytes of outputs and two of inputs.
fn image(make: Make) -> Vec<u8> {
    let mut header = sii::Header { vendor_id: 0x1234, product_code: 0x5678, ..Default::default() };
    let mut managers = Vec::new();
    let record = |start, length, control, kind| {
        SmRecord { start, length, control, status: 0, enable: 1, kind }.emit()
    };
    if make.mailbox {
        (header.receive, header.send) = (RECEIVE, SEND);
        header.protocols = sii::Header::COE;
        managers.extend(record(RECEIVE.start, RECEIVE.length, 0x26, sm_type::MAILBOX_OUT));
        managers.extend(record(SEND.start, SEND.length, 0x22, sm_type::MAILBOX_IN));
    } else {
        managers.extend([0; 16]);
    }
    managers.extend(record(OUTPUTS, 2, 0x64, sm_type::OUTPUTS));
    managers.extend(record(INPUTS, 2, 0x20, sm_type::INPUTS));
    let pdo = |index, sm, entry| {
        let record = PdoRecord { index, entries: 1, sm, sync_unit: 0, name: 0, flags: 0 };
        let entry =
            PdoEntryRecord { index: entry, sub: 1, name: 0, data_type: 6, bits: 16, flags: 0 };
        [record.emit(), entry.emit()].concat()
    };
    let mut image = vec![0; 0x200];
    let mut writer = Writer::new(&mut image, &header).expect("the header has room");
    let mut category = |kind, data: &[u8]| writer.category(kind, data).expect("there is room");
    category(category::STRINGS, &[1, 4, b'l', b'i', b'a', b'r']);
    category(category::GENERAL, &[0, 0, 0, 1, 0, 0, 0, 0]);
    category(category::SYNC_MANAGER, &managers);
    category(category::TX_PDO, &pdo(0x1A00, 3, 0x6000));
    category(category::RX_PDO, &pdo(0x1600, 2, 0x7000));
    let len = writer.finish().expect("the end mark has room");
    image.truncate(len);
    image
}
