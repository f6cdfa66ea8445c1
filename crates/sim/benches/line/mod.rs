//! A line of equal SubDevices with 16 bytes of outputs and 16 of inputs, in OP with DC SYNC0. The
//! cost of a simulated segment is measured on it.
//!
//! Each SubDevice is complete: an ESC, the stack with its sync engine and an I/O application that
//! copies outputs to inputs, a CPU that takes time for each step, and an oscillator. [`Line`] is
//! brought up by frames but without a MainDevice, so that its cycles only cost what the segment
//! costs; [`world`] is the same line with a MainDevice.

#![allow(dead_code, reason = "bench, example and tests use different parts")]

mod mailbox;

use isocat_esc::LAN9252;
use isocat_maindevice::{AssumedTimes, Config, DeviceConfig, Event, Motion};
use isocat_sim::buffer::Buffer;
use isocat_sim::burst::Leaving;
use isocat_sim::segment::Segment;
use isocat_sim::{
    Cable, ClockModel, Connection, CpuModel, DeviceSetup, HostModel, MainPort, Setup, Tap, Watcher,
    World,
};
use isocat_subdevice::description::{Behaviour, Description, ProcessDataArea};
use isocat_subdevice::io::IoOf;
use isocat_sync::SyncMode;
use isocat_wire::datagram::{Address, Layouts};
use isocat_wire::dc::SyncActivation;
use isocat_wire::fmmu::Fmmu;
use isocat_wire::frame::{self, FrameWriter};
use isocat_wire::register::{self, Register, Value, sync_manager};
use isocat_wire::sii::{Header, PdoEntryRecord, PdoRecord, SmRecord, Writer, category, sm_type};
use isocat_wire::sync_manager::SyncManager;
use isocat_wire::time::{Nanos, Picos, Time, True};
use isocat_wire::{AlControl, AlState, AutoIncrementAddress, Command, PortNumber, StationAddress};

/// Bytes in each direction.
pub const BYTES: u16 = 16;
/// Number of SubDevices whose data one LRW carries, in addition to the drift datagram and AL
/// status.
const PER_CHUNK: usize = 90;
const OUTPUTS_AT: u16 = 0x1000;
const INPUTS_AT: u16 = 0x1400;
/// Station address of the reference clock, the first SubDevice.
pub const REFERENCE: u16 = 0x1001;
const SOURCE: [u8; 6] = [0x10; 6];

/// A device without mailbox and dictionary.
static DESCRIPTION: Description = Description {
    objects: &[],
    mailbox: None,
    outputs: ProcessDataArea { sync_manager: 2, start: OUTPUTS_AT, max_length: BYTES },
    inputs: ProcessDataArea { sync_manager: 3, start: INPUTS_AT, max_length: BYTES },
    further_outputs: &[],
    further_inputs: &[],
    behaviour: Behaviour::DEFAULT,
};

/// The line's connections. Clocks deviate by up to ±20 ppm.
pub fn connections(count: usize) -> Vec<Connection> {
    connections_of(count, &DESCRIPTION)
}

fn connections_of(count: usize, description: &Description) -> Vec<Connection> {
    let sii: std::sync::Arc<[u8]> = sii().into();
    let device = |position: usize| DeviceSetup {
        chip: LAN9252,
        sii: sii.clone(),
        description: description.clone(),
        application: Box::new(IoOf::<32>::default()),
        cpu: CpuModel::default(),
        // The first one is the reference clock, and it runs in true time, since no host follows it
        // here.
        clock: ClockModel::constant(((position as i64 * 7919 + 20) % 41 - 20) * 1000),
        local_time: Time::ZERO,
        sampling: None,
    };
    (0..count)
        .map(|position| {
            let parent = position.checked_sub(1).map(|parent| (parent, PortNumber::P1));
            Connection::new(parent, Cable::of_length(1_000), device(position))
        })
        .collect()
}

/// The cycle of a line: long enough for its frames at 100 Mbit/s and for their way.
pub fn cycle_of(count: usize) -> Nanos {
    Nanos::millis(1 + 3 * count as i64 / 1000)
}

/// A line in OP.
pub struct Line {
    /// The segment.
    pub segment: Segment,
    count: usize,
    cycle: Picos,
    now: Time<True>,
    /// Cycles begin here and at all multiples of the cycle after it.
    origin: Time<True>,
    /// The frames of a cycle as they are sent, and on their way.
    frames: Vec<Vec<u8>>,
    leaving: Vec<Leaving>,
    /// Room for another one.
    buffer: Vec<u8>,
    number: u8,
}

impl Line {
    /// `count` SubDevices, brought up to OP. Panics if one does not come up.
    pub fn new(count: usize) -> Self {
        Self::of(connections(count), &DESCRIPTION)
    }

    /// The same with hops that take each frame the same time.
    pub fn with_constant_hops(count: usize) -> Self {
        let mut connections = connections(count);
        connections.iter_mut().for_each(|connection| connection.hop_jitter = false);
        Self::of(connections, &DESCRIPTION)
    }

    /// The same of devices with a mailbox and an object dictionary. Each has answered a request.
    pub fn with_mailbox(count: usize) -> Self {
        let description = &mailbox::DESCRIPTION;
        Self::of(connections_of(count, description), description)
    }

    fn of(connections: Vec<Connection>, description: &Description) -> Self {
        let count = connections.len();
        let segment = Segment::new(connections, 1);
        let frames = cyclic_frames(count);
        let leaving = frames.iter().map(|_| Leaving::new(Buffer::new(), Time::ZERO)).collect();
        let mut line = Self {
            segment,
            count,
            cycle: cycle_of(count).into(),
            now: Time::new(1_000_000_000),
            origin: Time::ZERO,
            frames,
            leaving,
            buffer: Vec::with_capacity(frame::MAX_LEN),
            number: 0,
        };
        line.set_up();
        if description.mailbox.is_some() {
            line.open_mailbox();
        }
        line.change(AlState::PreOp);
        if description.mailbox.is_some() {
            line.ask();
        }
        line.start_sync();
        line.change(AlState::SafeOp);
        line.write(register::AL_CONTROL, AlControl::request(AlState::Op));
        let cycles = (line.now - line.origin).0 / line.cycle.0 + 1;
        line.now = line.origin + Picos(cycles * line.cycle.0);
        // SYNC starts 100 ms ahead and must have run for 200 ms.
        let cycles = 8 + 310_000_000_000 / line.cycle.0;
        for _ in 0..cycles {
            line.exchange(false);
        }
        line.assert_state(AlState::Op);
        // Wait until outputs have reached the inputs of all, whatever the cycle in which each of
        // them reached OP.
        for _ in 0..8 {
            line.exchange(false);
        }
        line.exchange(true);
        line
    }

    /// Runs one cycle: all its frames pass, and all events up to the next cycle happen. In one
    /// cycle of 16 every answer must be right: to check them is no work of the segment.
    pub fn cycle(&mut self) {
        self.exchange(self.number.is_multiple_of(16));
    }

    /// Moves this and all further cycles by this time, and runs one with a watcher; returns the
    /// bytes of its last frame as it comes back.
    pub fn moved_cycle(&mut self, by: Picos, watch: &mut Watcher) -> &[u8] {
        self.now += by;
        self.exchange_watched(false, watch);
        self.leaving.last().map_or(&[], |leaving| leaving.frame.frame())
    }

    /// Asserts that every SubDevice is in this state.
    pub fn assert_state(&self, state: AlState) {
        for (position, device) in self.segment.devices().iter().enumerate() {
            let (is, code) = (device.stack.state(), device.stack.status_code());
            assert_eq!(is, state, "SubDevice {position} of {}: {code}", self.count);
        }
    }

    /// Asserts that the inputs of every SubDevice are the outputs of an earlier cycle: the
    /// applications ran.
    pub fn assert_applications_ran(&self) {
        for (position, device) in self.segment.devices().iter().enumerate() {
            assert_eq!(device.stack.sync().sm_event_missed(), 0, "SubDevice {position}");
            assert_eq!(device.stack.sync().cycle_time_too_small(), 0, "SubDevice {position}");
        }
    }

    fn exchange(&mut self, check: bool) {
        self.exchange_watched(check, &mut Watcher::blind());
    }

    fn exchange_watched(&mut self, check: bool, watch: &mut Watcher) {
        let start = self.now;
        let mut at = start;
        self.number = self.number.wrapping_add(1);
        for (frame, leaving) in self.frames.iter().zip(&mut self.leaving) {
            leaving.frame.room()[..frame.len()].copy_from_slice(frame);
            leaving.frame.set_len(frame.len());
            let bytes = leaving.frame.frame_mut();
            let offset = frame::payload_offset(bytes).expect("a frame of datagrams");
            let mut layouts = Layouts::new();
            while let Some(Ok(layout)) = layouts.next(&bytes[offset..]) {
                if layout.header.command() == Ok(Command::Lrw) {
                    bytes[offset + layout.data()..offset + layout.wkc()].fill(self.number);
                }
            }
            leaving.start = at;
            at += Picos((frame.len() + frame::WIRE_OVERHEAD) as i64 * 80_000);
        }
        self.segment.pass_all(MainPort::Primary, &mut self.leaving, watch);
        for number in 0..self.leaving.len() {
            let leaving = &self.leaving[number];
            let end = leaving.fate.expect("no cable is disturbed").last_bit;
            assert!(end > leaving.start || self.count < 100);
            if check {
                self.check(number);
            }
        }
        assert!(at - start < self.cycle, "the frames do not fit the cycle");
        self.now = start + self.cycle;
    }

    fn check(&self, frame: usize) {
        let payload =
            frame::payload(self.leaving[frame].frame.frame()).expect("a frame of datagrams");
        for datagram in isocat_wire::datagram::datagrams(payload) {
            let datagram = datagram.expect("a whole datagram");
            let devices = match datagram.header.command() {
                Ok(Command::Lrw) => 3 * datagram.header.len as usize / usize::from(BYTES),
                _ => self.count,
            };
            assert_eq!(usize::from(datagram.wkc), devices & 0xFFFF, "frame {frame}: {datagram}");
            if datagram.header.command() == Ok(Command::Brd) {
                assert_eq!(datagram.data, [AlState::Op as u8, 0], "{datagram}");
            }
            if datagram.header.command() == Ok(Command::Lrw) {
                // The data is two or three cycles old, depending on the phase of SYNC0 in the
                // cycle.
                let age = self.number.wrapping_sub(datagram.data[0]);
                let same = datagram.data.iter().all(|byte| *byte == datagram.data[0]);
                assert!(same && (1..=3).contains(&age), "age {age}: {datagram}");
            }
        }
    }

    fn set_up(&mut self) {
        // No frame has been sent, so these are the mean times.
        let entries = self.segment.path().entries.clone();
        let outputs = SyncManager::new(OUTPUTS_AT, BYTES, SyncManager::OUTPUTS, true);
        let inputs = SyncManager::new(INPUTS_AT, BYTES, SyncManager::INPUTS, true);
        self.write(sync_manager(2), outputs);
        self.write(sync_manager(3), inputs);
        let mut buffer = vec![0; frame::MAX_LEN];
        for chunk in entries.chunks(20) {
            let mut writer = FrameWriter::new(&mut buffer, SOURCE);
            for entry in chunk {
                let logical = u32::try_from(entry.device).unwrap() * u32::from(BYTES);
                let mut fmmus = [0; 32];
                let pair = [(OUTPUTS_AT, Fmmu::WRITE), (INPUTS_AT, Fmmu::READ)];
                for (bytes, (physical, kind)) in fmmus.chunks_exact_mut(16).zip(pair) {
                    let fmmu = Fmmu::bytes(logical, BYTES, physical, kind);
                    bytes.copy_from_slice(&fmmu.to_bytes());
                }
                let delay = ((entry.after - entries[0].after).0 / 1000) as u32;
                let position = AutoIncrementAddress(0u16.wrapping_sub(entry.device as u16));
                let station = REFERENCE.wrapping_add(entry.device as u16).to_le_bytes();
                for (address, data) in [
                    (register::STATION_ADDRESS.address, &station[..]),
                    (register::fmmu(0).address, &fmmus),
                    (register::SYSTEM_TIME_DELAY.address, &delay.to_le_bytes()),
                ] {
                    writer
                        .push(Command::Apwr, 0, Address::Position(position, address), data)
                        .expect("20 SubDevices fit a frame");
                }
            }
            let len = writer.finish();
            self.pass(&mut buffer[..len]);
        }
    }

    fn start_sync(&mut self) {
        let cycle = self.cycle.0 as u64 / 1000;
        let reference = &self.segment.devices()[0];
        let now = reference.esc.system_time(reference.oscillator().read(self.now)).count();
        // Cycles count from `now` on; SYNC0 comes at 85 % of them.
        self.origin = self.now;
        let lead = 100_000_000_u64.next_multiple_of(cycle);
        self.write(register::SYNC0_CYCLE, cycle as u32);
        self.write(register::SYNC_START_TIME, now + lead + cycle * 85 / 100);
        let bits = SyncActivation::ACTIVE | SyncActivation::SYNC0;
        self.write(register::SYNC_ACTIVATION, SyncActivation(bits));
    }

    fn change(&mut self, state: AlState) {
        self.write(register::AL_CONTROL, AlControl::request(state));
        self.now += Picos(1_000_000_000);
        self.segment.advance(self.now, &mut isocat_sim::Watcher::blind());
        self.assert_state(state);
    }

    fn write<T: Value>(&mut self, register: Register<T>, value: T) {
        self.broadcast(Command::Bwr, register.address, value.to_bytes().as_ref());
    }

    /// One datagram to all; returns its data and its working counter.
    fn broadcast(&mut self, command: Command, address: u16, data: &[u8]) -> (Vec<u8>, u16) {
        let mut buffer = vec![0; frame::MAX_LEN];
        let mut writer = FrameWriter::new(&mut buffer, SOURCE);
        let address = Address::Broadcast(address);
        let at = writer.push(command, 0, address, data).expect("room for one");
        let len = writer.finish();
        self.pass(&mut buffer[..len]);
        let end = at + data.len();
        (buffer[at..end].to_vec(), u16::from_le_bytes([buffer[end], buffer[end + 1]]))
    }

    /// Passes a frame of the bring-up and waits until it is over everywhere.
    fn pass(&mut self, bytes: &mut [u8]) {
        self.segment
            .pass(bytes, self.now, &mut isocat_sim::Watcher::blind())
            .expect("no cable is disturbed");
        self.now += self.segment.path().round_trip;
        self.now += Picos(1_000_000_000);
    }
}

/// The drift datagram, one LRW for each chunk, and AL status last, like the MainDevice's cycle.
fn cyclic_frames(count: usize) -> Vec<Vec<u8>> {
    let mut frames = Vec::new();
    let chunks = count.div_ceil(PER_CHUNK);
    for chunk in 0..chunks {
        let mut buffer = vec![0; frame::MAX_LEN];
        let mut writer = FrameWriter::new(&mut buffer, SOURCE);
        if chunk == 0 {
            let time = Address::Station(StationAddress(REFERENCE), register::SYSTEM_TIME.address);
            writer.push(Command::Frmw, 0, time, &[0; 8]).expect("room in an empty frame");
        }
        let first = chunk * PER_CHUNK;
        let devices = PER_CHUNK.min(count - first);
        let logical = Address::Logical(first as u32 * u32::from(BYTES));
        let data = vec![0; devices * usize::from(BYTES)];
        writer.push(Command::Lrw, 0, logical, &data).expect("a chunk fits");
        if chunk == chunks - 1 {
            let status = Address::Broadcast(register::AL_STATUS.address);
            writer.push(Command::Brd, 0, status, &[0; 2]).expect("room beside a chunk");
        }
        let len = writer.finish();
        buffer.truncate(len);
        frames.push(buffer);
    }
    frames
}

fn sii() -> Vec<u8> {
    let mut image = vec![0; 512];
    // SPI; SYNC unit on; SYNC0 pulses of 1 us.
    let configuration = [0x05, 0x04, 0, 0, 100, 0, 0, 0, 0, 0, 0, 0, 0, 0];
    let header =
        Header { configuration, vendor_id: 1, product_code: 1, size: 3, ..Header::default() };
    let mut writer = Writer::new(&mut image, &header).expect("room for the header");
    let manager = |start, length, control, kind| SmRecord {
        start,
        length,
        control,
        status: 0,
        enable: 1,
        kind,
    };
    let unused = manager(0, 0, 0, sm_type::UNUSED);
    let managers: Vec<u8> = [
        unused,
        unused,
        manager(OUTPUTS_AT, BYTES, SyncManager::OUTPUTS, sm_type::OUTPUTS),
        manager(INPUTS_AT, BYTES, SyncManager::INPUTS, sm_type::INPUTS),
    ]
    .iter()
    .flat_map(SmRecord::emit)
    .collect();
    writer.category(category::SYNC_MANAGER, &managers).expect("room");
    for (kind, index, sm) in [(category::TX_PDO, 0x1A00, 3), (category::RX_PDO, 0x1600, 2)] {
        let head = PdoRecord { index, entries: 2, sm, sync_unit: 0, name: 0, flags: 0x11 };
        let mut data = head.emit().to_vec();
        for sub in 1..=2 {
            let object = if sm == 3 { 0x6000 } else { 0x7000 };
            let entry =
                PdoEntryRecord { index: object, sub, name: 0, data_type: 0x1B, bits: 64, flags: 0 };
            data.extend(entry.emit());
        }
        writer.category(kind, &data).expect("room");
    }
    writer.finish().expect("room for the end mark");
    image
}

/// An observer that does nothing.
pub struct NoTap;

impl Tap for NoTap {
    fn frame(&mut self, _: Time<True>, _: bool, _: &[u8]) {}
}

/// The line with a MainDevice, which has brought it into operation. Returns the error if it cannot.
pub fn world(count: usize) -> Result<World<Motion, NoTap>, String> {
    world_of(connections(count), |_| {})
}

/// The same with given SubDevices and an adjusted configuration.
pub fn world_of(
    segment: Vec<Connection>,
    adjust: impl FnOnce(&mut Config),
) -> Result<World<Motion, NoTap>, String> {
    let count = segment.len();
    let mut config = Config::new(cycle_of(count));
    // Procedures of all SubDevices send at once, so their frames wait for each other at the port.
    config.timeouts.frame = Nanos::millis(100);
    // With long cycles the drift loops get few times, and then need a minute for the last 100 ns.
    config.drift_threshold = Nanos(300);
    let assumed = AssumedTimes {
        outputs_calc_and_copy: Some(Nanos(20_000)),
        inputs_calc_and_copy: Some(Nanos(20_000)),
        ..AssumedTimes::default()
    };
    let device = DeviceConfig { mode: Some(SyncMode::DcSync0), assumed, ..DeviceConfig::default() };
    config.devices = vec![device; count];
    adjust(&mut config);
    let setup = Setup::new(1, config, HostModel::default(), segment);
    let mut world = World::new(setup, Motion::default(), None);
    let limit = Time::new(300_000_000_000_000);
    loop {
        let more = world.step(limit);
        while let Some(event) = world.poll_event() {
            match event {
                Event::InOperation { .. } => return Ok(world),
                Event::Failed(error) => return Err(error.to_string()),
                _ => {}
            }
        }
        if !more {
            return Err("not in operation after 300 s of virtual time".into());
        }
    }
}

/// Runs a world for this number of cycles; returns the number of wrong working counters.
pub fn run_cycles(world: &mut World<Motion, NoTap>, cycles: u64) -> u64 {
    let before = world.main().statistics().working_counter_errors;
    let end = world.main().statistics().cycles + cycles;
    while world.main().statistics().cycles < end && world.step(Time::NEVER) {
        while world.poll_event().is_some() {}
    }
    world.main().statistics().working_counter_errors - before
}
