//! What each law would have done in a course: the software ESC gets the drift frames that the
//! device got, at the same instants, on a crystal that runs as the device's does.

use isocat_esc::{DriftLaw, ET1100, Esc};
use isocat_sim::random::Stream;
use isocat_wire::datagram::Address;
use isocat_wire::frame::{self, FrameWriter};
use isocat_wire::register;
use isocat_wire::time::Device;
use isocat_wire::{Command, PortNumber, Time};

use super::course::{Ahead, Course};
use super::jitter::{Drawn, Saw, normal};

/// What is known of one follower in a course, and how well.
#[derive(Clone, Debug)]
pub(super) struct Known {
    /// Its index among the followers.
    pub follower: usize,
    /// How much faster its crystal runs than the reference's, and the standard error of it.
    pub faster: (f64, f64),
    /// Jitter of each hop on the way to it.
    pub way: Vec<Saw>,
}

/// What a course shows, or would show: one number for each look, the phase behind it, and the speed
/// in the pause.
pub(super) fn shown(course: &Course, follower: usize) -> Vec<f64> {
    let mut all: Vec<f64> =
        course.looks.iter().map(|(_, speeds)| f64::from(speeds[follower])).collect();
    let (behind, later) = (course.behind.by[follower].0, course.later.by[follower].0);
    all.push(behind);
    all.push((later - behind) / (course.later.at - course.behind.at) * 1e9);
    all
}

/// Variance of each of these numbers by the readings alone.
pub(super) fn reading_variances(course: &Course, follower: usize) -> Vec<f64> {
    let mut all = vec![LOOK_VARIANCE; course.looks.len()];
    let square = |ahead: &Ahead| ahead.by[follower].1 * ahead.by[follower].1;
    let (behind, later) = (square(&course.behind), square(&course.later));
    let span = (course.later.at - course.behind.at) / 1e9;
    all.push(behind);
    all.push((behind + later) / (span * span) + SPEED_VARIANCE);
    all
}

/// What a law would have shown, with one draw of what is not known exactly.
pub(super) fn predict(
    course: &Course,
    law: DriftLaw,
    known: &Known,
    chance: &mut Stream,
) -> Vec<f64> {
    let (ahead, ahead_error) = course.ahead[known.follower];
    let way: Vec<Drawn> = known.way.iter().map(|saw| saw.draw(chance)).collect();
    let late = |since: f64| way.iter().map(|saw| saw.late(since)).sum::<f64>();
    let late_on_average = |latches: &[i64]| {
        let sum: f64 = latches.iter().map(|at| late(*at as f64 - course.fixed_at)).sum();
        sum / latches.len().max(1) as f64
    };
    // A latch that came late shows a clock farther ahead than it is.
    let ahead = ahead + ahead_error * normal(chance) - late_on_average(&course.fixed);
    let faster = known.faster.0 + known.faster.1 * normal(chance);
    let mut model = Model::new(course, law, ahead, faster);
    let mut looks = course.looks.iter().map(|(count, _)| *count).peekable();
    let mut all = Vec::with_capacity(course.looks.len() + 2);
    for (number, frame) in course.frames.iter().enumerate() {
        // Where within a tick the reference was nobody knows either.
        let within = WITHIN_TICK * normal(chance);
        // A lost frame was lost on its way there or on its way back.
        if frame.came_back || normal(chance) >= 0.0 {
            let late = late(frame.at as f64 - course.fixed_at) + within;
            model.drift_frame(frame.at, frame.lead, late);
        }
        if looks.next_if_eq(&(number + 1)).is_some() {
            all.push(f64::from(model.esc.register(register::SPEED_COUNTER_DIFFERENCE)));
        }
    }
    let seen = |ahead: &Ahead| model.ahead(ahead.at) + late_on_average(&ahead.latches);
    let (behind, later) = (seen(&course.behind), seen(&course.later));
    all.push(behind);
    all.push((later - behind) / (course.later.at - course.behind.at) * 1e9);
    all
}

/// A follower in software.
struct Model {
    esc: Esc<Vec<u8>>,
    /// Local time of the reference at which the model's crystal has counted [`ORIGIN`].
    from: f64,
    faster: f64,
    last: u64,
}

impl Model {
    fn new(course: &Course, law: DriftLaw, ahead: f64, faster: f64) -> Self {
        let mut image = vec![0; 128];
        // An on-chip bus as PDI, SYNC unit on, and the check byte of these words.
        image[..4].copy_from_slice(&[0x80, 0x0E, 0x00, 0xEE]);
        let words: [u8; 14] = std::array::from_fn(|at| image[at]);
        image[14] = isocat_wire::sii::checksum(&words);
        let ram = vec![0; usize::from(ET1100.ram_kib) * 1024];
        let mut esc = Esc::new(&ET1100, image, ram).with_drift_law(law);
        esc.set_port(PortNumber::P0, true);
        let mut model = Self { esc, from: course.fixed_at, faster, last: 0 };
        let local = model.esc.system_time(Time::new(ORIGIN)).count();
        // The model's time line is that of the reference, which begins at the fix.
        let offset = (course.fixed_at + ahead).round() as i64 - local as i64;
        let [time_depth, speed_depth] = course.asked.depths;
        model.write(0x0920, &offset.to_le_bytes(), ORIGIN);
        model.write(0x0934, &[time_depth, speed_depth], ORIGIN + 20_000);
        let reset = model.device(course.reset_at as f64);
        model.write(0x0930, &course.asked.start.to_le_bytes(), reset);
        model
    }

    /// What its crystal has counted at a local time of the reference.
    fn device(&self, at: f64) -> u64 {
        let since = at - self.from;
        (ORIGIN as i64 + (since + since * self.faster).round() as i64).max(0) as u64
    }

    fn drift_frame(&mut self, at: i64, lead: i64, late: f64) {
        // The reference tells the last tick of 10 ns, so it was later by half a tick on the
        // average.
        let device = self.device(at as f64 + 5.0 + late);
        self.write(0x0910, &((at + lead) as u32).to_le_bytes(), device);
    }

    fn write(&mut self, address: u16, data: &[u8], at: u64) {
        let mut bytes = [0; 64];
        let mut writer = FrameWriter::new(&mut bytes, [0; 6]);
        let pushed = writer.push(Command::Bwr, 0, Address::Broadcast(address), data);
        assert!(pushed.is_ok(), "a datagram of 8 bytes fits");
        let len = writer.finish();
        let start = at.max(self.last + 20);
        self.last = start + frame::duration_ns(len);
        let (start, end): (Time<Device>, Time<Device>) = (Time::new(start), Time::new(self.last));
        self.esc.process(&mut bytes[..len], start, end, true);
        // Registers take effect on the tick behind their frame.
        let behind = Time::new(self.last + 10);
        while self.esc.step(behind).is_some() {}
    }

    /// How far its system time is ahead of the reference's local time, ns, ticks averaged.
    fn ahead(&self, at: f64) -> f64 {
        let device = self.device(at);
        let shown = |tick: u64| self.esc.system_time(Time::new(device + tick)).count() as i64;
        let first = shown(0);
        let more: i64 = (0..10).map(|tick| shown(tick) - first).sum();
        (first as f64 - at) + more as f64 / 10.0
    }
}

/// Standard deviation of an instant within a tick of 10 ns.
const WITHIN_TICK: f64 = 2.89;
/// The model's crystal has counted so much at the fix, ns.
const ORIGIN: u64 = 1_000_000_000;
/// Register 0x0932 has whole numbers, and rounding differs: one unit.
const LOOK_VARIANCE: f64 = 1.0;
/// A unit of the speed counter difference is 11.9 ppb: rounding, and what the dividers' phase adds
/// in a pause.
const SPEED_VARIANCE: f64 = 9.0 * 9.0;
