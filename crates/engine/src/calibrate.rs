//! Measures what no data sheet of a segment states: crystals, the sign of 0x092C, the law of each
//! drift loop, delay and jitter of each hop, times of EEPROM and state changes.
//!
//! How data flow: `found` identifies the segment and refuses one that is in operation. `bus` sends
//! single frames by position, in virtual time or on a socket ([`isocat_conform::wire`]). `clocks`
//! makes latches and drift frames of them, and `course` a whole course of drift frames. `replay`
//! gives the same frames at the same instants to the software ESC with each law that is possible.
//! `judge` compares the results by their `likelihood`, with the `jitter` of the hops as the latches
//! show it. `hops`, `t_diff` and `response` need no drift frame. At the end everything that was
//! written is restored, whatever happened. [`report::calibrate`](crate::report::calibrate) reports
//! the result.
//!
//! The host's clock only paces the frames. The computation uses instants of the reference clock,
//! which each drift frame carries.

pub(crate) mod bus;
mod clocks;
mod course;
mod found;
mod hops;
mod jitter;
mod judge;
mod likelihood;
mod replay;
mod response;
mod t_diff;

use std::sync::atomic::AtomicBool;

use isocat_conform::wire::Wire;
use isocat_wire::dc::{DifferencePolarity, SystemTimeDifference};
use isocat_wire::register::{self, Value};
use isocat_wire::time::Nanos;

use bus::Bus;
use clocks::{Clocks, Fix};
use course::{Asked, Course, FEW_LATCHES, SHORT_PACE, START};
use found::Found;
use jitter::Saw;
use replay::Known;

pub use bus::{Operating, Trouble};
pub use found::PortKind;
pub use hops::{Hop, Spread};
pub use jitter::Jitter;
pub use judge::{Fit, Judgement, MOST_MISFIT, TOLD_APART, Verdict};
pub use response::{Response, StateChange, Times};

/// A step of the calibration, to show its progress.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Step {
    /// Identification of the segment.
    Look,
    /// EEPROM and state changes.
    Response,
    /// Round trips and latches.
    Hops,
    /// Crystals, first measurement.
    Crystals,
    /// The sign of 0x092C.
    Polarity,
    /// One of the courses of drift frames: number and count.
    Course(usize, usize),
    /// Crystals, second measurement.
    Drift,
    /// Comparison with the behaviour of each law.
    Judge,
}

/// What was measured.
#[derive(Clone, PartialEq, Debug)]
pub struct Calibration {
    /// Position of the reference clock.
    pub reference: usize,
    /// The devices, by position.
    pub devices: Vec<Device>,
    /// Courses of drift frames that were run.
    pub courses: usize,
    /// Drift frames in them, and the number that did not come back.
    pub drift_frames: (usize, usize),
    /// Shortest and longest interval of the drift frames that were due each millisecond.
    pub paced: (Nanos, Nanos),
    /// Frames sent, and the number that did not come back.
    pub frames: (u64, u64),
    /// Clocks that could not be restored, and why.
    pub left_changed: Vec<(usize, Trouble)>,
}

/// What was measured at one device.
#[derive(Clone, PartialEq, Debug)]
pub struct Device {
    /// Its position.
    pub position: usize,
    /// Type of its ESC, register 0x0000.
    pub kind: u8,
    /// Whether it has receive times, register 0x0900.
    pub has_times: bool,
    /// Whether it has a system clock, register 0x0920.
    pub has_clock: bool,
    /// Measurement of its clock; `None` for the reference and without a clock.
    pub clock: Option<Clock>,
    /// The hop to it and the round trip behind it; `None` without receive times.
    pub hop: Option<Hop>,
    /// EEPROM and state changes.
    pub response: Response,
}

/// What was measured at one clock other than the reference.
#[derive(Clone, PartialEq, Debug)]
pub struct Clock {
    /// How much faster its crystal runs than the reference's, parts per billion, and the standard
    /// error.
    pub crystal_ppb: (f64, f64),
    /// How much that changed until the end of the calibration, and the standard error.
    pub crystal_change_ppb: (f64, f64),
    /// Time span of each measurement.
    pub window: Nanos,
    /// Meaning of bit 31 of 0x092C; `None` if it was not determined.
    pub polarity: Option<DifferencePolarity>,
    /// Standard deviation of latches against the reference, ns, including the grain of the ticks.
    pub latch_deviation: f64,
    /// Jitter of the path from the clock above.
    pub jitter: Jitter,
    /// The law of the drift loop.
    pub law: Judgement,
}

/// Calibrates the segment behind a wire. `stop` ends it early; `progress` is called at each step.
///
/// In every case delays, offsets, filters and states are restored at the end. An error says why
/// there are no figures.
pub fn calibrate(
    wire: &mut dyn Wire,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(Step),
) -> Result<Calibration, Trouble> {
    let mut bus = Bus::new(wire, stop);
    progress(Step::Look);
    let found = found::look(&mut bus)?;
    // Nothing was written so far, and nothing is without two clocks.
    Clocks::new(&mut bus, &found)?;
    let result = measure(&mut bus, &found, progress);
    let left_changed = found::put_back(&mut bus, &found);
    let frames = (bus.sent, bus.lost);
    match result {
        Ok(calibration) => Ok(Calibration { left_changed, frames, ..calibration }),
        // The first device that was not restored is named; the others have the same reason.
        Err(trouble @ Trouble::NotPutBack { .. }) => Err(trouble),
        Err(trouble) => match left_changed.into_iter().next() {
            None => Err(trouble),
            Some((position, left)) => {
                Err(Trouble::NotPutBack { position, why: Box::new(left), first: Box::new(trouble) })
            }
        },
    }
}

fn measure(
    bus: &mut Bus<'_>,
    found: &[Found],
    progress: &mut dyn FnMut(Step),
) -> Result<Calibration, Trouble> {
    progress(Step::Response);
    let responses = response::measure(bus, found)?;
    progress(Step::Hops);
    let mut hops = hops::measure(bus, found)?;
    for (hop, t_diff) in hops.iter_mut().zip(t_diff::measure(bus, found)?) {
        if let Some(hop) = hop {
            hop.t_diff = t_diff;
        }
    }
    let mut clocks = Clocks::new(bus, found)?;
    let reference = clocks.reference;
    progress(Step::Crystals);
    let (early, at) = crystals(&mut clocks, CRYSTAL_WINDOW)?;
    let first = early.each(&clocks);
    progress(Step::Polarity);
    let polarities = polarities(&mut clocks)?;
    let asked = courses(&first);
    let mut run = Vec::with_capacity(asked.len());
    for (number, asked) in asked.iter().enumerate() {
        progress(Step::Course(number, COURSES));
        run.push(course::run(&mut clocks, *asked)?);
    }
    progress(Step::Drift);
    let (late, end) = crystals(&mut clocks, DRIFT_WINDOW)?;
    let last = late.each(&clocks);
    progress(Step::Judge);
    let followers: Vec<usize> = clocks.followers.iter().map(|(position, _)| *position).collect();
    let above = jitter::above(found, reference, &followers);
    let fixes = [&early.first, &early.last, &late.first, &late.last];
    let slips: Vec<(f64, f64)> = above
        .iter()
        .enumerate()
        .map(|(follower, above)| {
            let (ppb, error) =
                above.map_or((0.0, 0.0), |above| (first[above].ppb, first[above].error));
            let crystal = first[follower];
            ((crystal.ppb - ppb) / 1e9, crystal.error.hypot(error).hypot(WANDER_PPB) / 1e9)
        })
        .collect();
    let jitters: Vec<Jitter> = above
        .iter()
        .enumerate()
        .map(|(follower, above)| {
            let (deviation, latches) = jitter::measure(&fixes, (follower, *above), slips[follower]);
            let port = jitter::entry(&found[followers[follower]]);
            let above = above.map_or(reference, |above| followers[above]);
            Jitter { above, port, deviation, latches }
        })
        .collect();
    let saw =
        |follower: usize| Saw { period: jitter::period(&jitters[follower]), slip: slips[follower] };
    let way = |follower: usize| {
        std::iter::successors(Some(follower), |at| above[*at]).map(saw).collect::<Vec<Saw>>()
    };
    let mut devices: Vec<Device> = found
        .iter()
        .zip(responses)
        .zip(hops)
        .map(|((found, response), hop)| Device {
            position: found.position,
            kind: found.kind,
            has_times: found.has_times,
            has_clock: found.clock.is_some(),
            clock: None,
            hop,
            response,
        })
        .collect();
    for (follower, (position, _)) in clocks.followers.iter().enumerate() {
        let way = way(follower);
        let (first, last) = (first[follower], last[follower]);
        let (first, last) = (first.with_jitter(&way, &early), last.with_jitter(&way, &late));
        let change = last.ppb - first.ppb;
        let known = |course: &Course| {
            let share = (course.fixed_at - at) / (end - at);
            let ppb = first.ppb + change * share.clamp(0.0, 1.0);
            // Half of the change may have come at any time.
            let error = first.error.hypot(change / 2.0).hypot(WANDER_PPB);
            Known { follower, faster: (ppb / 1e9, error / 1e9), way: way.clone() }
        };
        let known: Vec<Known> = run.iter().map(known).collect();
        devices[*position].clock = Some(Clock {
            crystal_ppb: (first.ppb, first.error),
            crystal_change_ppb: (change, first.error.hypot(last.error)),
            window: CRYSTAL_WINDOW,
            polarity: polarities[follower],
            latch_deviation: first.deviation,
            jitter: jitters[follower],
            law: judge::judge(&run, &known),
        });
    }
    Ok(Calibration {
        reference,
        devices,
        courses: run.len(),
        drift_frames: (
            run.iter().map(|course| course.frames.len()).sum(),
            run.iter().map(|course| course.lost).sum(),
        ),
        paced: paced(&run),
        frames: (0, 0),
        left_changed: Vec::new(),
    })
}

/// A crystal compared with the reference's.
#[derive(Clone, Copy)]
struct Crystal {
    ppb: f64,
    error: f64,
    deviation: f64,
}

/// The clocks' readings at both ends of a time without drift frames.
struct Window {
    first: Fix,
    last: Fix,
}

impl Window {
    fn span(&self) -> f64 {
        self.last.at - self.first.at
    }

    /// How much faster each follower's crystal is.
    fn each(&self, clocks: &Clocks<'_, '_>) -> Vec<Crystal> {
        let one = |(first, last): (&clocks::Spot, &clocks::Spot)| Crystal {
            ppb: wrapped(last.apart - first.apart) / self.span() * 1e9,
            error: first.error.hypot(last.error) / self.span() * 1e9,
            deviation: ((first.deviation.powi(2) + last.deviation.powi(2)) / 2.0).sqrt(),
        };
        let spots = self.first.spots.iter().zip(&self.last.spots);
        spots.take(clocks.followers.len()).map(one).collect()
    }
}

impl Crystal {
    /// The same, with the error that jitter on the path may add to all latches of a fix alike.
    fn with_jitter(self, way: &[Saw], window: &Window) -> Self {
        let more = way.iter().fold(0.0f64, |sum, saw| {
            let at = |fix: &Fix| saw.error_of_mean(&fix.instants());
            sum.hypot(at(&window.first)).hypot(at(&window.last))
        });
        Self { error: self.error.hypot(more / window.span() * 1e9), ..self }
    }
}

/// The clocks at both ends of a time without drift frames, and its middle in the reference's local
/// time.
fn crystals(clocks: &mut Clocks<'_, '_>, window: Nanos) -> Result<(Window, f64), Trouble> {
    clocks.reset([0, 12], START)?;
    let first = clocks.fix(CRYSTAL_LATCHES, CRYSTAL_PACE)?;
    clocks.bus.wait(window)?;
    let last = clocks.fix(CRYSTAL_LATCHES, CRYSTAL_PACE)?;
    let middle = f64::midpoint(first.at, last.at);
    Ok((Window { first, last }, middle))
}

/// Clocks are compared by their lower 32 bits.
fn wrapped(difference: f64) -> f64 {
    difference - (difference / WRAP).round() * WRAP
}

/// Meaning of bit 31 of 0x092C. A delay that is too long by a known amount makes the local copy lag
/// by that amount, and one that is too short makes it lead. Only an answer of the right size to
/// both counts.
fn polarities(clocks: &mut Clocks<'_, '_>) -> Result<Vec<Option<DifferencePolarity>>, Trouble> {
    let longer = lag(clocks, LAG)?;
    let shorter = lag(clocks, -LAG)?;
    let each = longer.into_iter().zip(shorter).map(|(longer, shorter)| {
        let right_size =
            |shown: SystemTimeDifference| (i64::from(shown.magnitude()) - LAG).abs() < LAG / 4;
        let told = right_size(longer)
            && right_size(shorter)
            && longer.is_negative() != shorter.is_negative();
        told.then(|| match longer.is_negative() {
            true => DifferencePolarity::PositiveAhead,
            false => DifferencePolarity::NegativeAhead,
        })
    });
    Ok(each.collect())
}

/// Register 0x092C of all followers after one drift frame, while their delays are too long by `by`.
fn lag(clocks: &mut Clocks<'_, '_>, by: i64) -> Result<Vec<SystemTimeDifference>, Trouble> {
    for _ in 0..POLARITY_TRIES {
        clocks.reset([0, 12], START)?;
        let fix: Fix = clocks.fix(FEW_LATCHES, SHORT_PACE)?;
        clocks.set_ahead(&fix, USUAL_DELAY)?;
        clocks.set_delays((USUAL_DELAY + by) as u32)?;
        clocks.reset([0, 12], START)?;
        if clocks.drift_frame(0, 0)?.is_none() {
            continue;
        }
        let shown = clocks.shown(register::SYSTEM_TIME_DIFFERENCE.address, 4)?;
        return Ok(shown
            .iter()
            .map(|b| SystemTimeDifference::from_bytes([b[0], b[1], b[2], b[3]]))
            .collect());
    }
    Err(Trouble::Lost { address: register::SYSTEM_TIME.address })
}

/// The courses that are run. Each shows a different property: a single huge difference, the phase
/// part at three paces, the speed part at two filter depths over more than one block, and the
/// smallest depth.
fn courses(crystals: &[Crystal]) -> [Asked; COURSES] {
    let usual = Asked {
        start: START,
        depths: [0, 12],
        ahead: 500,
        frames: 256,
        interval: Nanos::millis(1),
        lead: 0,
        look_every: 64,
        pause: Nanos::millis(500),
    };
    let lead = lead(crystals);
    [
        Asked { ahead: 10_000_000, frames: 1, look_every: 1, ..usual },
        Asked { interval: Nanos::micros(100), ..usual },
        // A difference large against jitter shows the share of it that each frame removes.
        Asked { ahead: 4_000, ..usual },
        Asked { interval: Nanos::millis(4), ahead: 2_000, ..usual },
        // Another speed counter start: the steps of phase and the units of speed depend on it.
        Asked { start: OTHER_START, ahead: 2_000, ..usual },
        // The reads do not lie where a block of 256 or 4096 ends: a lost frame must not move a read
        // across that border.
        Asked { depths: [0, 8], ahead: 0, frames: 1_200, lead, look_every: 100, ..usual },
        Asked { depths: [0, 12], ahead: 0, frames: 4_500, lead, look_every: 500, ..usual },
        Asked { depths: [4, 0], frames: 300, look_every: 300, ..usual },
    ]
}

/// Movement of the reference's time from one drift frame to the next, ns at 1 ms. It gives each
/// clock a visible drift: crystals of one maker may be almost alike.
fn lead(crystals: &[Crystal]) -> i64 {
    let least = |lead: i64| {
        let drifts = crystals.iter().map(|crystal| (crystal.ppb - lead as f64 * 1_000.0).abs());
        drifts.fold(f64::INFINITY, f64::min)
    };
    let enough = |lead: &i64| least(*lead) >= LEAST_DRIFT_PPB;
    LEADS.into_iter().find(enough).unwrap_or_else(|| {
        LEADS.into_iter().max_by(|a, b| least(*a).total_cmp(&least(*b))).unwrap_or(0)
    })
}

/// Shortest and longest interval of the courses with an interval of 1 ms.
fn paced(courses: &[Course]) -> (Nanos, Nanos) {
    let each = courses.iter().filter(|course| course.asked.interval == Nanos::millis(1));
    let gaps = each.flat_map(|course| course.frames.windows(2).map(|pair| pair[1].at - pair[0].at));
    let (least, most) =
        gaps.fold((i64::MAX, 0), |(least, most), gap| (least.min(gap), most.max(gap)));
    (Nanos(least.min(most)), Nanos(most))
}

/// Time from one fix to the other: with an error of 1.5 ns each it gives 0.2 ppb.
const CRYSTAL_WINDOW: Nanos = Nanos::millis(10_000);
/// The same for the second measurement.
const DRIFT_WINDOW: Nanos = Nanos::millis(5_000);
/// Latches of one end, and their pace. They take about half a second, in which clocks 0.12 ppm
/// apart show their jitter.
const CRYSTAL_LATCHES: usize = 128;
const CRYSTAL_PACE: Nanos = Nanos::millis(4);
const WRAP: f64 = 4_294_967_296.0;
/// A crystal may wander within a minute by this much more than the two measurements show.
const WANDER_PPB: f64 = 5.0;
/// The error that is given to delays: more than clocks 200 ppm apart drift from the fix to the
/// drift frame on a slow host.
const LAG: i64 = 20_000;
/// A delay that is larger than [`LAG`].
const USUAL_DELAY: i64 = 100_000;
const POLARITY_TRIES: usize = 5;
/// Number of courses.
const COURSES: usize = 8;
/// Register 0x0930 in the course with another start value.
const OTHER_START: u16 = 0x0400;
/// Drifts of known size that may be added, ns each millisecond. The first one that leaves each
/// clock enough drift is used.
const LEADS: [i64; 7] = [0, 6, -6, 12, -12, 24, -24];
const LEAST_DRIFT_PPB: f64 = 3_000.0;
