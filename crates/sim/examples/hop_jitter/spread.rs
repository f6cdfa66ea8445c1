//! A line whose clocks are controlled by one drift datagram in each cycle: measures the spread of
//! SYNC0 and 0x092C, hop by hop.
//!
//! All settings are those of a MainDevice, except the delays, which are the true ones. What remains
//! is the effect of the drift loop, the ticks and the jitter of the hops.

use isocat_sim::observation::{Observation, Observed};
use isocat_sim::random::Stream;
use isocat_sim::{ClockModel, Connection, Segment, Statistics, Watcher};
use isocat_wire::datagram::Address;
use isocat_wire::dc::DifferencePolarity;
use isocat_wire::dc::SyncActivation;
use isocat_wire::frame::{FrameWriter, MAX_LEN};
use isocat_wire::register::{self, Register, Value};
use isocat_wire::time::{Picos, Time, True};
use isocat_wire::{AutoIncrementAddress, Command};

use crate::line;

/// The settings of a measurement.
#[derive(Clone, Copy, Debug)]
pub struct Course {
    /// SubDevices in the line.
    pub devices: usize,
    /// Whether hops jitter.
    pub hop_jitter: bool,
    /// Number of drift datagrams every 100 us at first, and then every cycle before the
    /// measurement.
    pub settling: [usize; 2],
    /// Number of cycles that are measured.
    pub cycles: usize,
}

/// The results of one SubDevice.
#[derive(Clone, Debug)]
pub struct Spread {
    /// Hops from the reference clock, the first SubDevice.
    pub hops: usize,
    /// SYNC0 against the grid of the reference clock, ps.
    pub sync0: Statistics,
    /// 0x092C after each cycle, with its sign, ns.
    pub difference: Statistics,
}

impl Spread {
    /// Mean, standard deviation and largest absolute value of SYNC0, ns.
    pub fn sync0_ns(&self) -> [f64; 3] {
        figures(&self.sync0).map(|ps| ps / 1_000.0)
    }

    /// The same of 0x092C.
    pub fn difference_ns(&self) -> [f64; 3] {
        figures(&self.difference)
    }
}

fn figures(statistics: &Statistics) -> [f64; 3] {
    let worst = statistics.least().abs().max(statistics.largest().abs());
    [statistics.mean(), statistics.standard_deviation(), worst as f64]
}

/// Bus cycle and period of SYNC0.
const CYCLE: Picos = Picos(1_000_000_000);
const CYCLE_NS: u64 = 1_000_000;
/// Register 0x0934 while drift datagrams follow each other closely, and with one in each cycle: the
/// MainDevice's settings.
const IN_BURST: u8 = 6;
const IN_OPERATION: u8 = 4;
/// Time from one drift datagram to the next at first.
const BURST: Picos = Picos(100_000_000);
/// Largest lateness of the host after the cycle's start; lateness is uniformly distributed.
const LATENESS_PS: u64 = 20_000_000;

/// Controls the clocks of a line and measures those at these numbers of hops.
pub fn spread(course: &Course, hops: &[usize]) -> Vec<Spread> {
    let connections = line::connections(course.devices).into_iter();
    let connections = connections
        .enumerate()
        .map(|(position, mut connection)| {
            // Deviations of up to ±20 ppm, without any relation to each other and to the cycle.
            let ppb = Stream::new(7, "clock", position as u64).up_to(40_000);
            connection.device.clock = ClockModel::constant(ppb as i64 - 20_000);
            Connection { hop_jitter: course.hop_jitter, ..connection }
        })
        .collect();
    let mut line = Clocks { segment: Segment::new(connections, 7), now: Time::new(1_000_000_000) };
    line.set_up();
    for _ in 0..course.settling[0] {
        line.lead(BURST, &mut Watcher::blind());
    }
    for device in 0..course.devices {
        line.write(device, register::TIME_FILTER_DEPTH, IN_OPERATION);
    }
    line.start_sync0();
    for _ in 0..course.settling[1] {
        line.lead(CYCLE, &mut Watcher::blind());
    }
    let mut all: Vec<Spread> = hops
        .iter()
        .map(|hops| Spread {
            hops: *hops,
            sync0: Statistics::default(),
            difference: Statistics::default(),
        })
        .collect();
    let mut watcher = Watcher::of_everything();
    for _ in 0..course.cycles {
        line.lead(CYCLE, &mut watcher);
        let edges: Vec<Observation> = watcher.take().collect();
        for one in &mut all {
            let device = &line.segment.devices()[one.hops];
            let shown = device.esc.register(register::SYSTEM_TIME_DIFFERENCE);
            one.difference.push(shown.nanos(DifferencePolarity::PositiveAhead).0);
            for edge in edges.iter().filter(|edge| edge.device == one.hops) {
                if edge.event == Observed::Sync0 {
                    one.sync0.push(line.off_grid(edge));
                }
            }
        }
    }
    all
}

struct Clocks {
    segment: Segment,
    now: Time<True>,
}

impl Clocks {
    /// Sets delays, offsets and filters.
    fn set_up(&mut self) {
        // No frame has been sent, so these are the mean times.
        let entries = self.segment.path().entries.clone();
        for entry in &entries {
            let station = line::REFERENCE.wrapping_add(entry.device as u16);
            let delay = (entry.after - entries[0].after).0 as u64 / 1_000;
            self.write(entry.device, register::STATION_ADDRESS, station);
            self.write(entry.device, register::SYSTEM_TIME_DELAY, delay as u32);
            self.write(entry.device, register::TIME_FILTER_DEPTH, IN_BURST);
            self.write(entry.device, register::SPEED_FILTER_DEPTH, 6);
        }
        let time = |segment: &Segment, device: usize, at| {
            let device = &segment.devices()[device];
            device.esc.system_time(device.oscillator().read(at)).count()
        };
        for device in 1..entries.len() {
            let at = self.now;
            let off = time(&self.segment, 0, at).wrapping_sub(time(&self.segment, device, at));
            self.write(device, register::SYSTEM_TIME_OFFSET, off);
        }
    }

    fn start_sync0(&mut self) {
        let reference = &self.segment.devices()[0];
        let now = reference.esc.system_time(reference.oscillator().read(self.now)).count();
        // The start is after all these writes.
        let ahead = 10 * CYCLE_NS * self.segment.devices().len() as u64;
        let start = (now + ahead).next_multiple_of(CYCLE_NS) + CYCLE_NS / 2;
        for device in 0..self.segment.devices().len() {
            self.write(device, register::SYNC0_CYCLE, CYCLE_NS as u32);
            self.write(device, register::SYNC_START_TIME, start);
            let bits = SyncActivation::ACTIVE | SyncActivation::SYNC0;
            self.write(device, register::SYNC_ACTIVATION, SyncActivation(bits));
        }
    }

    /// Sends one drift datagram, and processes all events up to the next.
    fn lead(&mut self, until_next: Picos, watch: &mut Watcher) {
        let at = self.now + Picos((self.now.count() / 977 * 7_919 % LATENESS_PS) as i64);
        let time = Address::Station(
            isocat_wire::StationAddress(line::REFERENCE),
            register::SYSTEM_TIME.address,
        );
        self.send(Command::Frmw, time, &[0; 8], at, watch);
        self.now += until_next;
        self.segment.live(self.now, watch);
    }

    fn write<T: Value>(&mut self, device: usize, register: Register<T>, value: T) {
        let position = AutoIncrementAddress::of_position(device as u16);
        let to = Address::Position(position, register.address);
        self.send(Command::Apwr, to, value.to_bytes().as_ref(), self.now, &mut Watcher::blind());
        // This is longer than any frame needs to come back.
        self.now += Picos(1_000_000_000);
    }

    fn send(
        &mut self,
        command: Command,
        address: Address,
        data: &[u8],
        at: Time<True>,
        watch: &mut Watcher,
    ) {
        let mut buffer = [0; MAX_LEN];
        let mut writer = FrameWriter::new(&mut buffer, [0x10; 6]);
        writer.push(command, 0, address, data).expect("room for one");
        let len = writer.finish();
        self.segment.pass(&mut buffer[..len], at, watch).expect("no cable is disturbed");
    }

    /// How much later than the grid of the reference clock an edge is, ps.
    fn off_grid(&self, edge: &Observation) -> i64 {
        let at = self.segment.devices()[edge.device].oscillator().when(edge.device_at);
        let (cycle, half) = (CYCLE.0 as i128, CYCLE.0 as i128 / 2);
        (self.segment.devices()[0].system_time_ps(at).rem_euclid(cycle) - half) as i64
    }
}
