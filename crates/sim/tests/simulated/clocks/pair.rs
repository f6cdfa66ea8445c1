//! A reference ESC and a follower, with a MainDevice's start-up of their clocks.

use isocat_esc::{Chip, DriftLaw, ET1100, Esc, EscEvent, Pdi};
use isocat_sim::oscillator::Oscillator;
use isocat_wire::datagram::{Address, datagrams};
use isocat_wire::frame::{self, FrameWriter};
use isocat_wire::register::{self, Value};
use isocat_wire::time::{Device, Picos, True};
use isocat_wire::{AutoIncrementAddress, Command, PortNumber, Register, StationAddress, Time, sii};

/// Delay from the reference to the follower.
const DELAY: Picos = Picos(755_000);
/// System time of the reference at its power-on, less its local time: a day in 2025.
pub const EPOCH: u64 = 800_000_000_123_456_789;
/// Station address of the reference.
const REFERENCE: StationAddress = StationAddress(0x1001);

/// An ESC on its oscillator.
pub struct Node {
    pub esc: Esc<Vec<u8>>,
    pub clock: Oscillator,
    /// Time after which the local CPU acknowledges SYNC pulses, ns.
    acknowledge: Option<u64>,
    acknowledge_at: Time<Device>,
}

/// A SYNC edge of the follower.
#[derive(Clone, Copy, Debug)]
pub struct Edge {
    pub event: EscEvent,
    pub at: Time<True>,
    /// The follower's system time at that tick.
    pub system: u64,
}

/// Both ESCs, and true time.
pub struct Pair {
    pub reference: Node,
    pub follower: Node,
    pub now: Time<True>,
    pub edges: Vec<Edge>,
    /// The frame of a FRMW, and the place of its data.
    distribution: ([u8; 64], usize, usize),
}

impl Node {
    fn new(chip: &'static Chip, ppb: i64, pulse_ticks: u16) -> Self {
        let mut image = vec![0; 128];
        // PDI on an on-chip bus, SYNC and latch units on, SYNC0 and SYNC1 mapped to AL events.
        image[..4].copy_from_slice(&[0x80, 0x0E, 0x00, 0xEE]);
        image[4..6].copy_from_slice(&pulse_ticks.to_le_bytes());
        let configuration = image[..14].try_into().expect("14 bytes");
        image[14] = sii::checksum(configuration);
        let mut esc = Esc::new(chip, image, vec![0; usize::from(chip.ram_kib) * 1024]);
        esc.set_port(PortNumber::P0, true);
        let acknowledge = (pulse_ticks == 0).then_some(2_000);
        let clock = Oscillator::new(ppb);
        Self { esc, clock, acknowledge, acknowledge_at: Time::NEVER }
    }

    /// Processes all events until `limit`.
    fn advance(&mut self, limit: Time<True>, edges: &mut Vec<Edge>) {
        let limit: Time<Device> = self.clock.read(limit);
        loop {
            if self.acknowledge_at < self.esc.next_event() && self.acknowledge_at <= limit {
                let mut pdi = self.esc.pdi(self.acknowledge_at);
                pdi.read(register::SYNC0_STATUS.address, &mut [0; 2]);
                self.acknowledge_at = Time::NEVER;
                continue;
            }
            let Some((at, event)) = self.esc.step(limit.min(self.acknowledge_at)) else {
                if self.acknowledge_at <= limit {
                    continue;
                }
                return;
            };
            if let EscEvent::Sync0 | EscEvent::Sync1 = event {
                let system = self.esc.system_time(at).count();
                edges.push(Edge { event, at: self.clock.when(at), system });
                if let Some(after) = self.acknowledge {
                    self.acknowledge_at = Time::new(at.count() + after);
                }
            }
        }
    }

    fn process(&mut self, bytes: &mut [u8], at: Time<True>, edges: &mut Vec<Edge>) {
        self.advance(at, edges);
        let end = at + Picos(frame::duration_ns(bytes.len()) as i64 * 1_000);
        self.esc.process(bytes, self.clock.read(at), self.clock.read(end), true);
    }
}

impl Pair {
    /// A reference that deviates by `ppb.0` and a follower that deviates by `ppb.1` and whose local
    /// time begins at `local`. SYNC pulses have `pulse` ticks.
    pub fn new(chip: &'static Chip, ppb: (i64, i64), local: u64, pulse: u16) -> Self {
        let mut bytes = [0; 64];
        let mut writer = FrameWriter::new(&mut bytes, [0x10; 6]);
        let address = Address::Station(REFERENCE, register::SYSTEM_TIME.address);
        let data = writer.push(Command::Frmw, 0, address, &[0; 8]).expect("the frame has room");
        let len = writer.finish();
        let mut follower = Node::new(chip, ppb.1, pulse);
        follower.esc = follower.esc.with_local_time(Time::new(local));
        let mut pair = Self {
            reference: Node::new(&ET1100, ppb.0, pulse),
            follower,
            now: Time::new(50_000_000),
            edges: vec![],
            distribution: (bytes, len, data),
        };
        pair.write(0, register::STATION_ADDRESS, REFERENCE.0);
        pair.write(1, register::STATION_ADDRESS, 0x1002);
        pair.write(0, register::SYSTEM_TIME_OFFSET, EPOCH);
        pair
    }

    /// The same pair with another law of the follower's drift loop.
    pub fn with_law(mut self, law: DriftLaw) -> Self {
        self.follower.esc = self.follower.esc.with_drift_law(law);
        self
    }

    /// Register 0x092C of the follower, ns: positive when it is ahead.
    pub fn shown(&mut self) -> i64 {
        let polarity = self.follower.esc.chip().difference_polarity;
        self.read(1, register::SYSTEM_TIME_DIFFERENCE).nanos(polarity).0
    }

    /// Runs for `ns` of true time.
    pub fn run(&mut self, ns: u64) {
        self.run_to(Time::new(self.now.count() + ns * 1_000));
    }

    pub fn run_to(&mut self, at: Time<True>) {
        assert!(at >= self.now, "true time goes on");
        self.now = at;
        self.reference.advance(at, &mut vec![]);
        self.follower.advance(at, &mut self.edges);
    }

    /// Sends a frame of one datagram now; returns its data and working counter. True time advances
    /// by 20 us.
    pub fn send(&mut self, command: Command, address: Address, data: &[u8]) -> (Vec<u8>, u16) {
        let mut bytes = [0; 128];
        let mut writer = FrameWriter::new(&mut bytes, [0x10; 6]);
        writer.push(command, 0, address, data).expect("the frame has room");
        let len = writer.finish();
        self.pass(&mut bytes[..len]);
        let payload = frame::payload(&bytes[..len]).expect("the frame stays a frame");
        let back = datagrams(payload).next().and_then(Result::ok).expect("one datagram");
        let answer = (back.data.to_vec(), back.wkc);
        self.run(20_000);
        answer
    }

    fn pass(&mut self, bytes: &mut [u8]) {
        self.reference.process(bytes, self.now, &mut vec![]);
        self.follower.process(bytes, self.now + DELAY, &mut self.edges);
    }

    /// Sends an APWR, whose working counter must be 1. Device 0 is the reference, 1 the follower.
    pub fn write<T: Value>(&mut self, device: u16, register: Register<T>, value: T) {
        let position = AutoIncrementAddress(0u16.wrapping_sub(device));
        let address = Address::Position(position, register.address);
        let (_, wkc) = self.send(Command::Apwr, address, value.to_bytes().as_ref());
        assert_eq!(wkc, 1, "register {:#06x} of device {device} takes a write", register.address);
    }

    /// Sends an APRD, whose working counter must be 1.
    pub fn read<T: Value>(&mut self, device: u16, register: Register<T>) -> T {
        let position = AutoIncrementAddress(0u16.wrapping_sub(device));
        let address = Address::Position(position, register.address);
        let (data, wkc) = self.send(Command::Aprd, address, &vec![0; T::LEN]);
        assert_eq!(wkc, 1, "register {:#06x} of device {device} answers", register.address);
        let mut bytes = T::Bytes::default();
        bytes.as_mut().copy_from_slice(&data);
        T::from_bytes(bytes)
    }

    /// Sets delay and offset like a MainDevice, from receive times of one frame.
    pub fn set_offset(&mut self) {
        self.send(Command::Bwr, Address::Broadcast(register::RECEIVE_TIME_0.address), &[0; 4]);
        let reference = self.read(0, register::RECEIVE_TIME_EPU);
        let follower = self.read(1, register::RECEIVE_TIME_EPU);
        let delay = DELAY.0 as u64 / 1_000;
        let offset = reference.wrapping_add(EPOCH + delay).wrapping_sub(follower);
        self.write_offset(offset, delay as u32);
    }

    /// Sets delay and offset of the follower; a 32-bit ESC uses the lower half.
    pub fn write_offset(&mut self, offset: u64, delay: u32) {
        let position = Address::Position(AutoIncrementAddress(0xFFFF), 0x0920);
        let (_, wkc) = self.send(Command::Apwr, position, &offset.to_le_bytes());
        assert_eq!(wkc, 1);
        self.write(1, register::SYSTEM_TIME_DELAY, delay);
    }

    /// Sets filter depths and bandwidth; the latter resets the loop.
    pub fn set_loop(&mut self, start: u16, (time_depth, speed_depth): (u8, u8)) {
        self.write(1, register::TIME_FILTER_DEPTH, time_depth);
        self.write(1, register::SPEED_FILTER_DEPTH, speed_depth);
        self.write(1, register::SPEED_COUNTER_START, start);
    }

    /// Sends one FRMW now, then runs for `interval` ns of true time.
    pub fn distribute(&mut self, interval: u64) {
        let (mut bytes, len, data) = self.distribution;
        self.pass(&mut bytes[..len]);
        assert_eq!(bytes[data + 8], 2, "the reference read, the follower written");
        self.run(interval);
    }

    /// When the reference's oscillator counts this system time.
    pub fn due(&self, system: u64) -> Time<True> {
        self.reference.clock.when(Time::<Device>::new(system.wrapping_sub(EPOCH)))
    }

    /// The follower's system time less the reference's, ps, now, without the 10 ns resolution of
    /// either. For 32 bits it must be within 2.1 s.
    pub fn difference(&self) -> i64 {
        let continuous = |node: &Node| {
            let count = node.clock.read::<Device>(self.now).count();
            let tick = Time::<Device>::new(count / 10 * 10);
            let since = (self.now - node.clock.when(tick)).0;
            (node.esc.system_time(tick).count() as u32, since)
        };
        let (reference, follower) = (continuous(&self.reference), continuous(&self.follower));
        i64::from(follower.0.wrapping_sub(reference.0) as i32) * 1_000 + follower.1 - reference.1
    }
}
