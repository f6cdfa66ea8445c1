//! One course of drift frames: from a known difference, at known instants, with reads of the
//! result.

use isocat_wire::register;
use isocat_wire::time::Nanos;

use super::bus::Trouble;
use super::clocks::{Clocks, Fix};

/// What a course sends.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Asked {
    /// Register 0x0930.
    pub start: u16,
    /// Registers 0x0934 and 0x0935.
    pub depths: [u8; 2],
    /// Lead of the followers at the beginning, ns.
    pub ahead: i64,
    /// Number of drift frames.
    pub frames: usize,
    /// Time from one drift frame to the next.
    pub interval: Nanos,
    /// Movement of the reference's time from each drift frame to the next, ns. It adds a drift of
    /// known size to that of the crystals.
    pub lead: i64,
    /// Number of drift frames between two reads of register 0x0932.
    pub look_every: usize,
    /// Pause after the last drift frame, in which the clocks run freely.
    pub pause: Nanos,
}

/// What happened. All instants are the reference's local time, ns.
#[derive(Clone, Debug)]
pub(super) struct Course {
    pub asked: Asked,
    /// Instant of the fix from which the offsets come, and its latches.
    pub fixed_at: f64,
    pub fixed: Vec<i64>,
    /// Lead of each follower at that instant, ns, and its standard error.
    pub ahead: Vec<(f64, f64)>,
    /// Instant when the loops were cleared.
    pub reset_at: i64,
    /// The drift frames.
    pub frames: Vec<Frame>,
    /// Drift frames that did not come back.
    pub lost: usize,
    /// Register 0x0932, and the number of drift frames sent before the read.
    pub looks: Vec<(usize, Vec<i16>)>,
    /// Lead of each follower after the last drift frame, and after the pause.
    pub behind: Ahead,
    pub later: Ahead,
}

/// A drift frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frame {
    /// Instant when it passed.
    pub at: i64,
    /// Movement of the reference's time at that instant, ns.
    pub lead: i64,
    /// Whether it came back. Otherwise it may have passed or not, and its instant is that of the
    /// host's clock.
    pub came_back: bool,
}

/// Lead of the followers at an instant.
#[derive(Clone, Debug)]
pub(super) struct Ahead {
    pub at: f64,
    /// ns, and standard error.
    pub by: Vec<(f64, f64)>,
    /// The latches that it comes from.
    pub latches: Vec<i64>,
}

/// Register 0x0930 by default.
pub(super) const START: u16 = 0x1000;

/// Runs one course. Starts over if too many of its drift frames are lost; in a short course that is
/// one.
pub(super) fn run(clocks: &mut Clocks<'_, '_>, asked: Asked) -> Result<Course, Trouble> {
    for _ in 1..MOST_TRIES {
        let course = attempt(clocks, asked)?;
        if course.lost * MOST_LOST <= asked.frames {
            return Ok(course);
        }
    }
    attempt(clocks, asked)
}

fn attempt(clocks: &mut Clocks<'_, '_>, asked: Asked) -> Result<Course, Trouble> {
    clocks.reset(asked.depths, asked.start)?;
    clocks.set_delays(0)?;
    // This fix is short: until the first drift frame the clocks drift apart.
    let fix = clocks.fix(FEW_LATCHES, SHORT_PACE)?;
    let left = clocks.set_ahead(&fix, asked.ahead)?;
    let ahead: Vec<(f64, f64)> =
        left.iter().zip(&fix.spots).map(|(left, spot)| (*left, spot.error)).collect();
    let moved: Vec<f64> =
        left.iter().zip(&fix.spots).map(|(left, spot)| left - spot.apart).collect();
    let reset_at = clocks.reset(asked.depths, asked.start)?;
    let mut course = Course {
        asked,
        fixed_at: fix.at,
        fixed: fix.instants(),
        ahead,
        reset_at,
        frames: Vec::with_capacity(asked.frames),
        lost: 0,
        looks: Vec::new(),
        behind: Ahead { at: 0.0, by: Vec::new(), latches: Vec::new() },
        later: Ahead { at: 0.0, by: Vec::new(), latches: Vec::new() },
    };
    send(clocks, &mut course)?;
    let behind = clocks.fix(LATCHES, LONG_PACE)?;
    clocks.bus.wait(asked.pause)?;
    let later = clocks.fix(LATCHES, LONG_PACE)?;
    course.behind = Ahead::of(&behind, &moved);
    course.later = Ahead::of(&later, &moved);
    Ok(course)
}

/// The drift frames and the looks.
fn send(clocks: &mut Clocks<'_, '_>, course: &mut Course) -> Result<(), Trouble> {
    let asked = course.asked;
    let mut due = clocks.bus.now() + asked.interval;
    for number in 0..asked.frames {
        clocks.bus.wait_until(due)?;
        let lead = asked.lead * number as i64;
        let sent = clocks.bus.now();
        match clocks.drift_frame(lead, lead + asked.lead)? {
            Some(at) => course.frames.push(Frame { at, lead, came_back: true }),
            None => {
                course.lost += 1;
                let at = clocks.local_at(sent);
                course.frames.push(Frame { at, lead, came_back: false });
            }
        }
        let count = number + 1;
        if count % asked.look_every == 0 {
            let bytes = clocks.shown(register::SPEED_COUNTER_DIFFERENCE.address, 2)?;
            let speeds = bytes.iter().map(|bytes| i16::from_le_bytes([bytes[0], bytes[1]]));
            course.looks.push((count, speeds.collect()));
        }
        // A delay of this machine is not caught up: even intervals matter more than their number.
        due = (due + asked.interval).max(clocks.bus.now());
    }
    if asked.lead != 0 {
        clocks.end_lead()?;
    }
    Ok(())
}

impl Ahead {
    fn of(fix: &Fix, moved: &[f64]) -> Self {
        let by = fix.spots.iter().zip(moved);
        let by = by.map(|(spot, moved)| (spot.apart + moved, spot.error)).collect();
        Self { at: fix.at, by, latches: fix.instants() }
    }
}

/// Latches of a fix that is used to set clocks, and their pace.
pub(super) const FEW_LATCHES: usize = 16;
pub(super) const SHORT_PACE: Nanos = Nanos(800_000);
/// Latches of a fix after drift frames. They take about 100 ms, so that clocks 0.4 ppm apart show a
/// whole tooth of copper's jitter.
const LATCHES: usize = 48;
const LONG_PACE: Nanos = Nanos(2_000_000);
/// How often a course is tried.
const MOST_TRIES: usize = 5;
/// A course may lose one frame in this many.
const MOST_LOST: usize = 50;
