//! Segments of plain SubDevices, and frames through them, without any MainDevice.
#![allow(dead_code, reason = "each test file uses its part")]

use isocat_esc::{Chip, XMC4800};
use isocat_sim::{
    Cable, ClockModel, Connection, CpuModel, DeviceSetup, Lost, MainPort, Returned, Segment,
};
use isocat_subdevice::Description;
use isocat_subdevice::description::{Behaviour, ProcessDataArea};
use isocat_wire::datagram::{Address, datagrams};
use isocat_wire::frame::{FrameWriter, MAX_LEN, payload};
use isocat_wire::register::{self, features};
use isocat_wire::time::{Local, Picos, Time, True};
use isocat_wire::{AutoIncrementAddress, Command, PortNumber};

/// Four MII ports, all of them on Auto, 64-bit clock.
pub static WIDE: Chip =
    Chip { name: "wide", port_descriptor: 0xFF, dl_control: 0x0007_0001, ..XMC4800 };
/// The same with a 32-bit clock.
pub static NARROW: Chip =
    Chip { name: "narrow", features: XMC4800.features & !features::DC_64_BIT, ..WIDE };
/// The same without distributed clocks.
pub static PLAIN: Chip = Chip {
    name: "plain",
    features: XMC4800.features & !(features::DC_64_BIT | features::DC),
    ..WIDE
};

static DESCRIPTION: Description = Description {
    objects: &[],
    mailbox: None,
    outputs: ProcessDataArea { sync_manager: 2, start: 0x1000, max_length: 0 },
    inputs: ProcessDataArea { sync_manager: 3, start: 0x1000, max_length: 0 },
    further_outputs: &[],
    further_inputs: &[],
    behaviour: Behaviour::DEFAULT,
};

/// The place of a SubDevice: its parent and the parent's port, and its own port upstream.
pub type Link = (Option<(usize, PortNumber)>, PortNumber);

pub fn device(chip: &'static Chip, clock: ClockModel, local_time: Time<Local>) -> DeviceSetup {
    DeviceSetup {
        chip: *chip,
        sii: vec![0; 256].into(),
        description: DESCRIPTION.clone(),
        application: Box::new(()),
        cpu: CpuModel::default(),
        clock,
        local_time,
        sampling: None,
    }
}

/// Cables of different, odd lengths, so that arrivals fall anywhere between two ticks.
pub fn cable(number: usize) -> Cable {
    Cable::of_length(3_000 + (number as u64 * 7_919) % 17_000)
}

/// SubDevices of one chip with these connections and ideal clocks; hops do not jitter.
pub fn segment(links: &[Link], chip: impl Fn(usize) -> &'static Chip) -> Segment {
    let connection = |(number, (parent, port)): (usize, &Link)| {
        let clock = ClockModel::constant(0);
        // Every counter starts at another value; some wrap at 32 bits while the frame is in flight.
        let local = (number as u64 * 0x3_1234_5677).wrapping_sub(5_100_000);
        let device = device(chip(number), clock, Time::new(local));
        let connection = Connection::new(*parent, cable(number), device);
        Connection { port: *port, hop_jitter: false, ..connection }
    };
    Segment::new(links.iter().enumerate().map(connection).collect(), 1)
}

/// A line.
pub fn line(count: usize) -> Vec<Link> {
    let parent = |number: usize| number.checked_sub(1).map(|parent| (parent, PortNumber::P1));
    (0..count).map(|number| (parent(number), PortNumber::P0)).collect()
}

pub fn micros(us: u64) -> Time<True> {
    Time::new(us * 1_000_000)
}

/// A frame with one datagram.
pub fn frame(command: Command, address: Address, data: &[u8]) -> Vec<u8> {
    let mut buffer = [0; MAX_LEN];
    let mut writer = FrameWriter::new(&mut buffer, [0x10; 6]);
    writer.push(command, 0, address, data).expect("it fits");
    let len = writer.finish();
    buffer[..len].to_vec()
}

/// Data and working counter of the first datagram.
pub fn answer(bytes: &[u8]) -> (Vec<u8>, u16) {
    let first = datagrams(payload(bytes).expect("a frame")).next().expect("a datagram");
    let first = first.expect("a whole datagram");
    (first.data.to_vec(), first.wkc)
}

/// Sends one datagram from a port; returns its working counter, and where the frame went.
pub fn send_from(
    segment: &mut Segment,
    port: MainPort,
    at: Time<True>,
    (command, address, data): (Command, Address, &[u8]),
) -> (u16, Result<Returned, Lost>) {
    let mut bytes = frame(command, address, data);
    let fate = segment.pass_from(port, &mut bytes, at, &mut isocat_sim::Watcher::blind());
    (answer(&bytes).1, fate)
}

/// Sends a BRD of the type register from the primary port: returns the number of SubDevices that
/// answer, if the frame is back.
pub fn count(segment: &mut Segment, at: Time<True>) -> Result<u16, Lost> {
    let datagram = (Command::Brd, Address::Broadcast(0x0000), &[0][..]);
    let (wkc, fate) = send_from(segment, MainPort::Primary, at, datagram);
    fate.map(|_| wkc)
}

/// Writes a register of the SubDevice at a position.
pub fn write(segment: &mut Segment, at: Time<True>, position: u16, address: u16, data: &[u8]) {
    let to = Address::Position(AutoIncrementAddress::of_position(position), address);
    let (wkc, fate) = send_from(segment, MainPort::Primary, at, (Command::Apwr, to, data));
    assert_eq!((wkc, fate.map(|_| ())), (1, Ok(())), "write of {address:#06x}");
}

/// Lets all ESCs latch a frame from a port.
pub fn latch(segment: &mut Segment, port: MainPort, at: Time<True>) -> u16 {
    let datagram = (Command::Bwr, Address::Broadcast(0x0900), &[0; 4][..]);
    let (wkc, fate) = send_from(segment, port, at, datagram);
    assert!(fate.is_ok(), "{fate:?}");
    wkc
}

/// Receive times of the ports of an ESC.
pub fn receive_times(segment: &Segment, device: usize) -> [u32; 4] {
    [
        register::RECEIVE_TIME_0,
        register::RECEIVE_TIME_1,
        register::RECEIVE_TIME_2,
        register::RECEIVE_TIME_3,
    ]
    .map(|times| segment.devices()[device].esc.register(times))
}

/// Counters of an ESC by port.
pub struct Counters {
    pub invalid: [u8; 4],
    pub forwarded: [u8; 4],
    pub lost_links: [u8; 4],
}

pub fn counters(segment: &Segment, device: usize) -> Counters {
    let esc = &segment.devices()[device].esc;
    let errors = esc.register(register::RX_ERRORS).to_le_bytes();
    Counters {
        invalid: [errors[0], errors[2], errors[4], errors[6]],
        forwarded: esc.register(register::FORWARDED_RX_ERRORS).to_le_bytes(),
        lost_links: esc.register(register::LOST_LINKS).to_le_bytes(),
    }
}

/// When a frame reaches a port of a SubDevice, in true time.
pub fn arrival(segment: &Segment, from: MainPort, device: usize, port: PortNumber) -> Picos {
    let path = segment.path_from(from);
    let mut all = path.entries.iter().chain(&path.returns);
    all.find(|a| (a.device, a.port) == (device, port)).expect("the frame gets there").after
}
