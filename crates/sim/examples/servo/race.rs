//! One law on one host, with the reference clock of a simulated ESC.

use isocat_esc::XMC4800;
use isocat_sim::host::HostMachine;
use isocat_sim::random::Stream;
use isocat_sim::{
    Cable, ClockModel, Connection, CpuModel, DeviceSetup, HostModel, MainPort, Segment,
};
use isocat_subdevice::Description;
use isocat_subdevice::description::{Behaviour, ProcessDataArea};
use isocat_wire::datagram::Address;
use isocat_wire::frame::{FrameWriter, MAX_LEN};
use isocat_wire::register;
use isocat_wire::time::{Dc, Nanos, Picos, Time, True};
use isocat_wire::{AutoIncrementAddress, Command};

use super::hosts::Course;
use super::laws::{Entry, Grid, Heard};

/// The cycle of all races, 1 ms, and the target phase of frames.
pub const GRID: Grid = Grid { cycle: 1_000_000, target: 300_000 };
/// How long a race lasts.
pub const LENGTH: Nanos = Nanos(6_000_000_000);
/// Time after which a law that settles has settled.
pub const SETTLED: Picos = Picos(3_000_000_000_000);
/// Largest phase error of a deadline in lock.
pub const LOCK: i64 = 1_000_000;

/// A race, cycle by cycle.
pub struct Track {
    /// True time of the first deadline.
    pub begin: Time<True>,
    /// The cycles.
    pub points: Vec<Point>,
}

/// One cycle of a race in true time.
#[derive(Clone, Copy)]
pub struct Point {
    /// Time since the first deadline.
    pub at: Picos,
    /// The commanded phase: the reference's phase for a frame that leaves at the deadline without
    /// any delay, less the target, ps.
    pub deadline: i64,
    /// How much later the frame arrived, ps. It is not folded: a whole cycle counts as late.
    pub late: i64,
}

static PLAIN: Description = Description {
    objects: &[],
    mailbox: None,
    outputs: ProcessDataArea { sync_manager: 2, start: 0x1000, max_length: 0 },
    inputs: ProcessDataArea { sync_manager: 3, start: 0x1000, max_length: 0 },
    further_outputs: &[],
    further_inputs: &[],
    behaviour: Behaviour::DEFAULT,
};

fn segment(reference_ppb: i64, seed: u64) -> Segment {
    let device = DeviceSetup {
        chip: XMC4800,
        sii: vec![0; 256].into(),
        description: PLAIN.clone(),
        application: Box::new(()),
        cpu: CpuModel::default(),
        clock: ClockModel::constant(reference_ppb),
        local_time: Time::new(777_000_000_123),
        sampling: None,
    };
    // Laws are compared to a tick; the jitter of a hop is the same for all of them.
    let connection = Connection::new(None, Cable::of_length(10_000), device);
    Segment::new(vec![Connection { hop_jitter: false, ..connection }], seed)
}

/// Runs a law on a course. Every seed is another start: the host deviates up to 100 ppm from the
/// reference (the first two by exactly that), at any phase.
pub fn run(law: &Entry, course: &Course, seed: u64) -> Track {
    let mut chance = Stream::new(seed, "start", 0);
    let off = match seed {
        0 => -100_000,
        1 => 100_000,
        _ => chance.up_to(200_000) as i64 - 100_000,
    };
    let reference_ppb = chance.up_to(40_000) as i64 - 20_000;
    let model = HostModel { clock_ppb: reference_ppb + off, ..course.host };
    let mut host = HostMachine::new(model, seed);
    let mut segment = segment(reference_ppb, seed);
    let mut law = (law.make)(GRID, course.stamp_noise);
    let begin = Time::<True>::new((10_000_000 + chance.up_to(GRID.cycle as u64)) * 1_000);
    let end = begin + Picos::from(LENGTH);
    let mut deadline = host.now(begin);
    let mut now = begin;
    let mut points = Vec::with_capacity((LENGTH.0 / GRID.cycle) as usize + 1);
    while now < end {
        now = host.wake_up(deadline).max(now);
        if let Some(later) = law.put_off(deadline, host.now(now)) {
            deadline = later;
            continue;
        }
        let start = now;
        let exchange = exchange(&mut host, &mut segment, start);
        let due = host.when(deadline) + Picos::from(model.latency) + exchange.way;
        points.push(Point {
            at: start - begin,
            deadline: phase_error(&segment, due),
            late: (exchange.arrival - due).0,
        });
        now = exchange.back;
        let stamp = host.now(start);
        let (back, dc) = (host.now(now), exchange.dc);
        deadline = law.next(Heard { deadline, stamp, back, dc });
    }
    Track { begin, points }
}

/// A frame to the reference and back.
struct Exchange {
    /// When its first bit arrives at the reference.
    arrival: Time<True>,
    /// Time from the port to the reference.
    way: Picos,
    /// When the program has it.
    back: Time<True>,
    dc: Time<Dc>,
}

fn exchange(host: &mut HostMachine, segment: &mut Segment, at: Time<True>) -> Exchange {
    let mut bytes = [0; MAX_LEN];
    let mut writer = FrameWriter::new(&mut bytes, [0x10; 6]);
    let system_time = register::SYSTEM_TIME.address;
    let to = Address::Position(AutoIncrementAddress::of_position(0), system_time);
    let data = writer.push(Command::Armw, 0, to, &[0; 8]).expect("a frame has room");
    let len = writer.finish();
    let start = host.send(MainPort::Primary, at, len);
    let returned = segment
        .pass(&mut bytes[..len], start, &mut isocat_sim::Watcher::blind())
        .expect("nothing is pulled");
    let way = segment.path().entries[0].after;
    let dc = bytes[data..].first_chunk().map_or(0, |raw| u64::from_le_bytes(*raw));
    let back = host.receive(returned.last_bit);
    Exchange { arrival: start + way, way, back, dc: Time::new(dc) }
}

/// The phase error by the reference clock, interpolated between its ticks, ps.
fn phase_error(segment: &Segment, at: Time<True>) -> i64 {
    let cycle = i128::from(GRID.cycle) * 1_000;
    let system = segment.devices()[0].system_time_ps(at);
    let phase = (system - i128::from(GRID.target) * 1_000).rem_euclid(cycle);
    (if phase > cycle / 2 { phase - cycle } else { phase }) as i64
}
