//! The MainDevice: a script of frames.

use core::fmt;

use isocat_wire::coe::sdo::{self, Initiate};
use isocat_wire::coe::{self, Service};
use isocat_wire::datagram::Address;
use isocat_wire::frame::FrameWriter;
use isocat_wire::mailbox::{self, Protocol, next_counter};
use isocat_wire::register::{self, Value, sm_status};
use isocat_wire::sync_manager::SyncManager;
use isocat_wire::time::{Device, Time};
use isocat_wire::{
    AlControl, AlState, AlStatus, AlStatusCode, AutoIncrementAddress, Command, Nanos,
    ObjectAddress, Register,
};

use crate::bench::Bench;
use crate::device::DESCRIPTION;

/// The MainDevice, with the bench at the end of its cable.
pub struct Script {
    /// The device.
    pub bench: Bench,
    /// Counter of the last mailbox message.
    counter: u8,
}

/// A deviation from what is expected.
#[derive(Debug)]
pub enum Failure {
    /// No device answered, or not all of them.
    WorkingCounter { address: u32, expected: u16, found: u16 },
    /// No answer in the mailbox.
    NoAnswer(ObjectAddress),
    /// An answer that does not belong to the request.
    WrongAnswer(ObjectAddress),
    /// A figure that differs.
    Figure { what: &'static str, expected: u64, found: u64 },
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Failure::WorkingCounter { address, expected, found } => {
                write!(f, "address 0x{address:08X}: working counter {found}, expected {expected}")
            }
            Failure::NoAnswer(object) => write!(f, "{object}: no answer in the mailbox"),
            Failure::WrongAnswer(object) => write!(f, "{object}: the answer is to something else"),
            Failure::Figure { what, expected, found } => {
                write!(f, "{what}: {found}, expected {expected}")
            }
        }
    }
}

impl Script {
    /// A MainDevice that has sent nothing.
    pub fn new(bench: Bench) -> Self {
        Self { bench, counter: 0 }
    }

    /// Sends one datagram, which the device changes in place.
    pub fn datagram(
        &mut self,
        command: Command,
        address: Address,
        data: &mut [u8],
        expected: u16,
    ) -> Result<(), Failure> {
        let mut buffer = [0; 128];
        let mut frame = FrameWriter::new(&mut buffer, [0x10; 6]);
        let at = frame.push(command, 0, address, data).expect("the script's data are short");
        let len = frame.finish();
        self.bench.pass(&mut buffer[..len]);
        let (answer, behind) = buffer[at..].split_at(data.len());
        data.copy_from_slice(answer);
        let found = u16::from_le_bytes([behind[0], behind[1]]);
        let address = address.raw();
        if found == expected {
            Ok(())
        } else {
            Err(Failure::WorkingCounter { address, expected, found })
        }
    }

    /// Writes a register.
    pub fn write<T: Value>(&mut self, register: Register<T>, value: T) -> Result<(), Failure> {
        let mut bytes = value.to_bytes();
        self.datagram(Command::Apwr, position(register.address), bytes.as_mut(), 1)
    }

    /// Reads a register.
    pub fn read<T: Value>(&mut self, register: Register<T>) -> Result<T, Failure> {
        let mut bytes = T::Bytes::default();
        self.datagram(Command::Aprd, position(register.address), bytes.as_mut(), 1)?;
        Ok(T::from_bytes(bytes))
    }

    /// Lets time pass without frames.
    pub fn pause(&mut self, span: Nanos) {
        self.bench.until(self.bench.now() + span);
    }

    /// Waits for an instant; returns at once if it has passed.
    pub fn wait_until(&mut self, at: Time<Device>) {
        self.bench.until(self.bench.now().max(at));
    }

    /// Requests a state, and reads the result a little later.
    pub fn ask(&mut self, state: AlState) -> Result<(AlStatus, AlStatusCode), Failure> {
        self.write(register::AL_CONTROL, AlControl::request(state))?;
        self.pause(Nanos::micros(200));
        Ok((self.read(register::AL_STATUS)?, self.read(register::AL_STATUS_CODE)?))
    }

    /// Sets the SyncManagers of the mailbox.
    pub fn set_mailbox(&mut self) -> Result<(), Failure> {
        let areas = DESCRIPTION.mailbox.expect("the device has a mailbox");
        for (number, area, control) in
            [(0, areas.receive, SyncManager::MAILBOX_OUT), (1, areas.send, SyncManager::MAILBOX_IN)]
        {
            let sm = SyncManager::new(area.start, area.length, control, true);
            self.write(register::sync_manager(number), sm)?;
        }
        Ok(())
    }

    /// Reads an object of up to four bytes through the mailbox.
    pub fn sdo(&mut self, object: ObjectAddress) -> Result<u32, Failure> {
        let areas = DESCRIPTION.mailbox.expect("the device has a mailbox");
        self.counter = next_counter(self.counter);
        let request =
            Initiate { command: sdo::Command::upload_request(false), object, data: [0; 4] };
        let mut message = [0; 64];
        let len = (coe::HEADER_LEN + sdo::INITIATE_LEN) as u16;
        let header = mailbox::Header::new(len, 0, Protocol::COE, self.counter);
        message[..SERVICE].copy_from_slice(&header.emit());
        message[SERVICE..BODY].copy_from_slice(&coe::Header::new(Service::SDO_REQUEST).emit());
        message[BODY..BODY + sdo::INITIATE_LEN].copy_from_slice(&request.emit());
        self.datagram(Command::Apwr, position(areas.receive.start), &mut message, 1)?;

        let mut looks = 0;
        while self.read(sm_status(1))? & SyncManager::STATUS_FULL == 0 {
            looks += 1;
            if looks == LOOKS {
                return Err(Failure::NoAnswer(object));
            }
        }
        self.datagram(Command::Aprd, position(areas.send.start), &mut message, 1)?;
        let (head, body) = message.split_at(BODY);
        let service = coe::Header::parse([head[SERVICE], head[SERVICE + 1]]).service;
        let answer = Initiate::parse(body.first_chunk().ok_or(Failure::WrongAnswer(object))?);
        let expedited = answer.command.specifier() == sdo::specifier::RESPONSE_UPLOAD
            && answer.command.expedited();
        if service != Service::SDO_RESPONSE || answer.object != object || !expedited {
            return Err(Failure::WrongAnswer(object));
        }
        let mut value = [0; 4];
        let len = answer.command.expedited_len();
        value[..len].copy_from_slice(&answer.data[..len]);
        Ok(u32::from_le_bytes(value))
    }
}

/// The first and only device of the segment.
fn position(address: u16) -> Address {
    Address::Position(AutoIncrementAddress(0), address)
}

/// Offset of the CoE header in a mailbox message.
const SERVICE: usize = mailbox::HEADER_LEN;
/// Offset of the data after the CoE header.
const BODY: usize = SERVICE + coe::HEADER_LEN;
/// How often SM1 is read for an answer.
const LOOKS: u32 = 100;
