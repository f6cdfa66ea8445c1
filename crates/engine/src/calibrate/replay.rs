//! What each law would have done in a course. The software ESC gets the drift frames that the
//! device got, at the same instants, and a crystal that runs as the device's does.

use isocat_esc::{DriftLaw, ET1100, Esc, Passing};
use isocat_sim::random::Stream;
use isocat_wire::datagram::Address;
use isocat_wire::frame;
use isocat_wire::register;
use isocat_wire::time::Device;
use isocat_wire::{Command, PortNumber, Time};

use super::course::{Ahead, Course};
use super::jitter::{Drawn, Saw, normal};

/// The known properties of one follower in a course, with their errors.
#[derive(Clone, Debug)]
pub(super) struct Known {
    /// Its index among the followers.
    pub follower: usize,
    /// How much faster its crystal runs than the reference's, and the standard error of it.
    pub faster: (f64, f64),
    /// Jitter of each hop on the path to it.
    pub way: Vec<Saw>,
}

/// The numbers that a course shows, or would show: one for each read, the phase after it, and the
/// speed in the pause.
pub(super) fn shown(course: &Course, follower: usize) -> Vec<f64> {
    let mut all: Vec<f64> =
        course.looks.iter().map(|(_, speeds)| f64::from(speeds[follower])).collect();
    let (behind, later) = (course.behind.by[follower].0, course.later.by[follower].0);
    all.push(behind);
    all.push((later - behind) / (course.later.at - course.behind.at) * 1e9);
    all
}

/// Variance of each of these numbers from the readings alone.
pub(super) fn reading_variances(course: &Course, follower: usize) -> Vec<f64> {
    let mut all = vec![LOOK_VARIANCE; course.looks.len()];
    let square = |ahead: &Ahead| ahead.by[follower].1 * ahead.by[follower].1;
    let (behind, later) = (square(&course.behind), square(&course.later));
    let span = (course.later.at - course.behind.at) / 1e9;
    all.push(behind);
    all.push((behind + later) / (span * span) + SPEED_VARIANCE);
    all
}

/// One draw of the unknown quantities of a course. It is the same for each law.
pub(super) struct Unknowns {
    /// Lead of the follower at the beginning of the course, ns.
    ahead: f64,
    crystal: Crystal,
    /// Count of the follower's crystal when each drift frame passed; `None`: the frame was lost on
    /// its way there.
    frames: Vec<Option<u64>>,
    /// Average lateness of the latches of the two fixes after the drift frames.
    late: [f64; 2],
}

impl Unknowns {
    /// Draws the unknown quantities.
    pub fn draw(course: &Course, known: &Known, chance: &mut Stream) -> Self {
        let (ahead, ahead_error) = course.ahead[known.follower];
        let way: Vec<Drawn> = known.way.iter().map(|saw| saw.draw(chance)).collect();
        let late =
            |at: i64| -> f64 { way.iter().map(|saw| saw.late(at as f64 - course.fixed_at)).sum() };
        let late_on_average = |latches: &[i64]| {
            let sum: f64 = latches.iter().map(|at| late(*at)).sum();
            sum / latches.len().max(1) as f64
        };
        // A late latch shows a clock farther ahead than it is.
        let ahead = ahead + ahead_error * normal(chance) - late_on_average(&course.fixed);
        let faster = known.faster.0 + known.faster.1 * normal(chance);
        let crystal = Crystal { from: course.fixed_at, faster };
        let frames = course.frames.iter().map(|frame| {
            // The place of the reference within its tick of 10 ns is not known either: it shows the
            // last tick.
            let within = chance.up_to(TICK_STEPS) as f64 / TICK_STEPS as f64 * TICK;
            // A lost frame was lost either on its way there or on its way back.
            let passed = frame.came_back || chance.up_to(1) == 0;
            passed.then(|| crystal.count(frame.at as f64 + within + late(frame.at)))
        });
        let frames = frames.collect();
        let late = [&course.behind, &course.later].map(|seen| late_on_average(&seen.latches));
        Self { ahead, crystal, frames, late }
    }
}

/// The numbers that a law would have shown with one draw of the unknown quantities.
pub(super) fn predict(course: &Course, law: DriftLaw, unknowns: &Unknowns) -> Vec<f64> {
    let mut model = Model::new(course, law, unknowns);
    let mut looks = course.looks.iter().map(|(count, _)| *count).peekable();
    let mut all = Vec::with_capacity(course.looks.len() + 2);
    for (number, (frame, count)) in course.frames.iter().zip(&unknowns.frames).enumerate() {
        if let Some(count) = count {
            model.write(0x0910, &mut ((frame.at + frame.lead) as u32).to_le_bytes(), *count);
        }
        if looks.next_if_eq(&(number + 1)).is_some() {
            model.settle();
            all.push(f64::from(model.esc.register(register::SPEED_COUNTER_DIFFERENCE)));
        }
    }
    model.settle();
    let behind = model.ahead(course.behind.at) + unknowns.late[0];
    let later = model.ahead(course.later.at) + unknowns.late[1];
    all.push(behind);
    all.push((later - behind) / (course.later.at - course.behind.at) * 1e9);
    all
}

/// The follower's crystal.
#[derive(Clone, Copy)]
struct Crystal {
    /// Local time of the reference at which it has counted [`ORIGIN`].
    from: f64,
    /// How much faster than the reference's it runs.
    faster: f64,
}

impl Crystal {
    /// Its count at a local time of the reference, ns.
    fn count(&self, at: f64) -> u64 {
        let since = at - self.from;
        (ORIGIN as i64 + (since + since * self.faster).round() as i64).max(0) as u64
    }
}

/// A software model of a follower.
struct Model {
    esc: Esc<Vec<u8>>,
    crystal: Crystal,
    last: u64,
}

impl Model {
    fn new(course: &Course, law: DriftLaw, unknowns: &Unknowns) -> Self {
        let mut image = vec![0; 128];
        // The image sets an on-chip bus as PDI, SYNC unit on, and the check byte of these words.
        image[..4].copy_from_slice(&[0x80, 0x0E, 0x00, 0xEE]);
        let words: [u8; 14] = std::array::from_fn(|at| image[at]);
        image[14] = isocat_wire::sii::checksum(&words);
        let ram = vec![0; usize::from(ET1100.ram_kib) * 1024];
        let mut esc = Esc::new(&ET1100, image, ram).with_drift_law(law);
        esc.set_port(PortNumber::P0, true);
        let mut model = Self { esc, crystal: unknowns.crystal, last: 0 };
        let local = model.esc.system_time(Time::new(ORIGIN)).count();
        // The model's time line is that of the reference, which begins at the fix.
        let offset = (course.fixed_at + unknowns.ahead).round() as i64 - local as i64;
        let mut depths = course.asked.depths;
        model.write(0x0920, &mut offset.to_le_bytes(), ORIGIN);
        model.write(0x0934, &mut depths, ORIGIN + 20_000);
        let reset = model.crystal.count(course.reset_at as f64);
        model.write(0x0930, &mut course.asked.start.to_le_bytes(), reset);
        model
    }

    /// A frame with one write to all devices. Its end takes effect with the next frame, or when it
    /// is [settled](Self::settle).
    fn write(&mut self, address: u16, data: &mut [u8], at: u64) {
        let start = at.max(self.last + 20);
        self.last = start + FRAME;
        let (start, end): (Time<Device>, Time<Device>) = (Time::new(start), Time::new(self.last));
        let address = Address::Broadcast(address).raw();
        self.esc.begin_frame(start);
        self.esc.datagram(&mut Passing { command: Command::Bwr, address, irq: 0, wkc: 0, data });
        self.esc.close_frame(end, true);
    }

    /// Registers take effect on the tick after their frame.
    fn settle(&mut self) {
        let behind = Time::new(self.last + 10);
        while self.esc.step(behind).is_some() {}
    }

    /// Lead of its system time over the reference's local time, ns, with ticks averaged.
    fn ahead(&self, at: f64) -> f64 {
        let device = self.crystal.count(at);
        let shown = |tick: u64| self.esc.system_time(Time::new(device + tick)).count() as i64;
        let first = shown(0);
        let more: i64 = (0..10).map(|tick| shown(tick) - first).sum();
        (first as f64 - at) + more as f64 / 10.0
    }
}

/// Tick of receive times, ns.
const TICK: f64 = 10.0;
/// Steps of an instant within a tick.
const TICK_STEPS: u64 = 1 << 24;
/// How long the shortest frame takes on the wire, ns.
const FRAME: u64 = frame::duration_ns(0);
/// Count of the model's crystal at the fix, ns.
const ORIGIN: u64 = 1_000_000_000;
/// Register 0x0932 has whole numbers, and rounding differs by one unit.
const LOOK_VARIANCE: f64 = 1.0;
/// A unit of the speed counter difference is 11.9 ppb. The variance covers rounding, and what the
/// dividers' phase adds in a pause.
const SPEED_VARIANCE: f64 = 9.0 * 9.0;
