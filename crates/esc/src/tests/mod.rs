//! Tests of the ESC from both of its sides. Vector numbers are those of the project's list of
//! captures from real chips.

mod acknowledge;
mod clocks;
mod drift_loop;
mod eeprom;
mod events;
mod frames;
mod latch;
mod leds;
mod mailbox;
mod mii;
mod next_frame;
mod process_data;
mod registers;
mod regular;
mod sync_edges;
mod sync_managers;
mod sync_signals;
mod sync_start;
mod system_time_by_pdi;
mod watchdogs;

use std::vec;
use std::vec::Vec;

use isocat_wire::datagram::{Address, datagrams};
use isocat_wire::frame::{FrameWriter, MAX_LEN, duration_ns, payload};
use isocat_wire::register::Value;
use isocat_wire::sii;
use isocat_wire::time::Device;
use isocat_wire::{AutoIncrementAddress, Command, PortNumber, Register, StationAddress, Time};

use crate::{Chip, Esc, EscEvent, Pdi, PdiExt, Processed};

/// An ESC, a clock and a MainDevice that sends one datagram in each frame.
struct Bench {
    esc: Esc<Vec<u8>>,
    now: u64,
    events: Vec<(u64, EscEvent)>,
    processed: Processed,
    irq: u16,
}

/// PDI on an on-chip bus, SYNC and latch units on, SYNC0 and SYNC1 mapped to AL events, 100 us
/// pulses.
const SII: [u8; 14] = [0x80, 0x0E, 0x00, 0xEE, 0x10, 0x27, 0, 0, 0x34, 0x12, 0, 0, 0, 0];

fn image(configuration: [u8; 14]) -> Vec<u8> {
    let mut image = vec![0; 256];
    image[..14].copy_from_slice(&configuration);
    image[14] = sii::checksum(&configuration);
    image[0x10..0x18].copy_from_slice(&[0x02, 0, 0, 0, 0x52, 0x2C, 0x4C, 0x04]);
    image
}

impl Bench {
    fn new(chip: &'static Chip) -> Self {
        Self::with(chip, SII)
    }

    fn with(chip: &'static Chip, configuration: [u8; 14]) -> Self {
        let ram = vec![0; usize::from(chip.ram_kib) * 1024];
        let mut esc = Esc::new(chip, image(configuration), ram);
        esc.set_port(PortNumber::P0, true);
        let (events, processed) = (Vec::new(), Processed::default());
        let mut bench = Self { esc, now: 1_000, events, processed, irq: 0 };
        bench.write(register::STATION_ADDRESS, 0x1001);
        bench
    }

    /// Handles all events of the ESC until `now`.
    fn run_to(&mut self, now: u64) {
        self.now = now;
        while let Some((at, event)) = self.esc.step(Time::new(now)) {
            assert!(self.events.last().is_none_or(|(last, _)| *last <= at.count()));
            self.events.push((at.count(), event));
        }
        assert!(self.esc.next_event().count() > now);
    }

    /// Sends datagrams in one frame and handles its end. Returns data and working counters as they
    /// come back.
    fn frame(&mut self, good: bool, list: &[(Command, Address, &[u8])]) -> Vec<(Vec<u8>, u16)> {
        let mut buffer = [0; MAX_LEN];
        let mut writer = FrameWriter::new(&mut buffer, [0x10; 6]);
        for (index, (command, address, data)) in list.iter().enumerate() {
            writer.push(*command, index as u8, *address, data).expect("the frame has room");
        }
        let len = writer.finish();
        self.run_to(self.now);
        let (start, end) = (self.now, self.now + duration_ns(len));
        let frame = &mut buffer[..len];
        self.processed = self.esc.process(frame, Time::new(start), Time::new(end), good);
        assert_eq!(frame[6], 0x12, "the first ESC marks the source address");
        self.run_to(end);
        let payload = payload(frame).expect("the frame stays a frame");
        let found: Vec<_> = datagrams(payload).map(|d| d.expect("whole datagrams")).collect();
        self.irq = found[0].header.irq;
        found.into_iter().map(|d| (d.data.to_vec(), d.wkc)).collect()
    }

    fn send(&mut self, command: Command, address: Address, data: &[u8]) -> (Vec<u8>, u16) {
        self.frame(true, &[(command, address, data)]).remove(0)
    }

    /// FPRD of `len` zeros.
    fn fprd(&mut self, ado: u16, len: usize) -> (Vec<u8>, u16) {
        self.send(Command::Fprd, station(ado), &vec![0; len])
    }

    /// FPWR.
    fn fpwr(&mut self, ado: u16, data: &[u8]) -> u16 {
        self.send(Command::Fpwr, station(ado), data).1
    }

    /// BWR.
    fn bwr(&mut self, ado: u16, data: &[u8]) -> u16 {
        self.send(Command::Bwr, Address::Broadcast(ado), data).1
    }

    /// Reads a register by FPRD, which must count.
    fn read<T: Value>(&mut self, register: Register<T>) -> T {
        let (data, wkc) = self.fprd(register.address, T::LEN);
        assert_eq!(wkc, 1, "register {:#06x} answers", register.address);
        let mut bytes = T::Bytes::default();
        bytes.as_mut().copy_from_slice(&data);
        T::from_bytes(bytes)
    }

    /// Writes a register by APWR, which must count.
    fn write<T: Value>(&mut self, register: Register<T>, value: T) {
        let address = Address::Position(AutoIncrementAddress(0), register.address);
        let (_, wkc) = self.send(Command::Apwr, address, value.to_bytes().as_ref());
        assert_eq!(wkc, 1, "register {:#06x} takes a write", register.address);
    }

    fn pdi(&mut self) -> impl Pdi + '_ {
        self.esc.pdi(Time::new(self.now))
    }

    fn pdi_read<T: Value>(&mut self, register: Register<T>) -> T {
        self.pdi().load(register)
    }

    fn pdi_bytes(&mut self, address: u16, len: usize) -> Vec<u8> {
        let mut data = vec![0xEE; len];
        self.pdi().read(address, &mut data);
        data
    }

    /// Takes all recorded events except frame ends.
    fn take_events(&mut self) -> Vec<(u64, EscEvent)> {
        let mut events = core::mem::take(&mut self.events);
        events.retain(|(_, event)| !matches!(event, EscEvent::FrameEnd { .. }));
        events
    }

    /// The AL events that the last frame newly set.
    fn last_al_events(&self) -> u32 {
        match self.events.last() {
            Some((_, EscEvent::FrameEnd { al_events })) => *al_events,
            other => panic!("expected the end of a frame, found {other:?}"),
        }
    }
}

fn station(ado: u16) -> Address {
    Address::Station(StationAddress(0x1001), ado)
}

fn device(ns: u64) -> Time<Device> {
    Time::new(ns)
}

use isocat_wire::register;
