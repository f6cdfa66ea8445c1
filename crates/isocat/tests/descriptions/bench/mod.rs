//! One device of a profile behind the software ESC, and the hands of a MainDevice at its mailbox.

use isocat::profile::Profile;
use isocat_esc::Esc;
use isocat_subdevice::SubDevice;
use isocat_wire::coe::info::EntryDescription;
use isocat_wire::coe::sdo::{Initiate, SegmentCommand};
use isocat_wire::datagram::Address;
use isocat_wire::frame::FrameWriter;
use isocat_wire::mailbox::{HEADER_LEN, Header, Protocol, next_counter};
use isocat_wire::register::{self, Value, sync_manager};
use isocat_wire::sii::MailboxArea;
use isocat_wire::sync_manager::SyncManager;
use isocat_wire::time::{Device, Time};
use isocat_wire::{AbortCode, AlControl, AlState, AutoIncrementAddress, Command, Nanos, Register};

/// A device in PREOP.
pub struct Bench {
    esc: Esc<Vec<u8>>,
    device: SubDevice<(), Vec<u8>>,
    receive: MailboxArea,
    send: MailboxArea,
    now: Time<Device>,
    counter: u8,
}

impl Bench {
    pub fn new(profile: &Profile) -> Self {
        let mailbox = profile.description.mailbox.expect("a mailbox");
        let ram = vec![0; usize::from(profile.esc().ram_kib) * 1024];
        let store = vec![0; profile.description.store_len()];
        let mut bench = Self {
            esc: Esc::new(profile.esc(), profile.sii.to_vec(), ram),
            device: SubDevice::new(&profile.description, store, ()),
            receive: mailbox.receive,
            send: mailbox.send,
            now: Time::new(10_000_000),
            counter: 0,
        };
        let sm =
            |area: MailboxArea, control| SyncManager::new(area.start, area.length, control, true);
        bench.set(sync_manager(0), sm(mailbox.receive, SyncManager::MAILBOX_OUT));
        bench.set(sync_manager(1), sm(mailbox.send, SyncManager::MAILBOX_IN));
        bench.set(register::AL_CONTROL, AlControl::request(AlState::PreOp));
        assert_eq!(bench.device.state(), AlState::PreOp, "{}", profile.id);
        bench
    }

    /// Reads an entry or a whole object, in segments if need be.
    pub fn read(&mut self, index: u16, sub: u8, complete: bool) -> Result<Vec<u8>, AbortCode> {
        let [low, high] = index.to_le_bytes();
        let command = 0x40 | u8::from(complete) << 4;
        let answer = self.sdo(&[command, low, high, sub, 0, 0, 0, 0])?;
        let initiate = Initiate::parse(answer.first_chunk().expect("8 bytes"));
        if initiate.command.expedited() {
            return Ok(answer[4..][..initiate.command.expedited_len()].to_vec());
        }
        let mut data = answer[8..].to_vec();
        let mut toggle = 0;
        while data.len() < initiate.value() as usize {
            let segment = self.sdo(&[0x60 | toggle, 0, 0, 0, 0, 0, 0, 0])?;
            let command = SegmentCommand(segment[0]);
            data.extend(&segment[1..][..command.data_len(segment.len() - 1)]);
            toggle ^= 0x10;
        }
        Ok(data)
    }

    /// Writes an entry.
    pub fn write(&mut self, index: u16, sub: u8, data: &[u8]) -> Result<(), AbortCode> {
        let [low, high] = index.to_le_bytes();
        let mut body = vec![0x21, low, high, sub];
        body.extend((data.len() as u32).to_le_bytes());
        body.extend(data);
        self.sdo(&body).map(|_| ())
    }

    /// What SDO information tells of an entry, and its name.
    pub fn describe(
        &mut self,
        index: u16,
        sub: u8,
    ) -> Result<(EntryDescription, String), AbortCode> {
        let [low, high] = index.to_le_bytes();
        let answer = self.service(&[0, 0x80, 5, 0, 0, 0, low, high, sub, 0]);
        let body = &answer[6..];
        if answer[2] & 0x7F == 7 {
            return Err(AbortCode(u32::from_le_bytes(body[..4].try_into().expect("4 bytes"))));
        }
        let name = String::from_utf8(body[EntryDescription::LEN..].to_vec()).expect("a name");
        Ok((EntryDescription::parse(body.first_chunk().expect("a description")), name))
    }

    fn sdo(&mut self, body: &[u8]) -> Result<Vec<u8>, AbortCode> {
        let answer = self.service(&[&[0, 0x20][..], body].concat());
        if answer[2] == 0x80 {
            let code = answer[6..10].try_into().expect("4 bytes");
            return Err(AbortCode(u32::from_le_bytes(code)));
        }
        Ok(answer[2..].to_vec())
    }

    /// A CoE service and its answer, CoE headers included.
    fn service(&mut self, body: &[u8]) -> Vec<u8> {
        self.counter = next_counter(self.counter);
        let header = Header::new(body.len() as u16, 0, Protocol::COE, self.counter);
        let mut message = [&header.emit()[..], body].concat();
        message.resize(usize::from(self.receive.length), 0);
        assert_eq!(self.datagram(Command::Apwr, self.receive.start, &message).0, 1);
        let empty = vec![0; usize::from(self.send.length)];
        let (counter, answer) = self.datagram(Command::Aprd, self.send.start, &empty);
        assert_eq!(counter, 1, "{body:02X?} is not answered");
        let header = Header::parse(answer.first_chunk().expect("a header"));
        assert_eq!(header.protocol, Protocol::COE, "{body:02X?}: {answer:02X?}");
        answer[HEADER_LEN..][..usize::from(header.length)].to_vec()
    }

    fn set<T: Value>(&mut self, register: Register<T>, value: T) {
        let bytes = value.to_bytes();
        self.datagram(Command::Apwr, register.address, bytes.as_ref());
    }

    /// One datagram in a frame of its own, and the device's look at it.
    fn datagram(&mut self, command: Command, address: u16, data: &[u8]) -> (u16, Vec<u8>) {
        let mut buffer = [0; 1514];
        let mut frame = FrameWriter::new(&mut buffer, [2; 6]);
        let place = Address::Position(AutoIncrementAddress(0), address);
        let at = frame.push(command, 0, place, data).expect("it fits into a frame");
        let len = frame.finish();
        let end = self.now + Nanos::micros(130);
        self.esc.process(&mut buffer[..len], self.now, end, true);
        self.now = end;
        for _ in 0..2 {
            while self.esc.step(self.now).is_some() {}
            self.device.poll(self.now, &mut self.esc.pdi(self.now));
            self.now += Nanos::micros(10);
        }
        let behind = at + data.len();
        let counter = u16::from_le_bytes([buffer[behind], buffer[behind + 1]]);
        (counter, buffer[at..behind].to_vec())
    }
}
