//! The distance from certain frames to SYNC0: its course, and how often frames passed it.

use super::Grid;
use crate::known::Known;

/// A frame at the reference clock.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    pub number: usize,
    /// By the stamps, ns from the first frame.
    pub at_ns: u64,
    /// System time of its last bit, ns.
    pub end: u64,
    /// From its first bit to its last, ns.
    pub duration: i64,
}

/// How frames lie among the pulses of SYNC0 when all is well.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Rate {
    /// Frames in a cycle of SYNC0.
    frames: u64,
    /// Cycles of SYNC0 from one frame to the next; this or the other is 1.
    cycles: u64,
}

impl Rate {
    /// The rate of frames that are `interval` apart.
    pub fn of(cycle: u64, interval: u64) -> Self {
        let whole = |long: u64, short: u64| (long.saturating_add(short / 2) / short.max(1)).max(1);
        Self { frames: whole(cycle, interval), cycles: whole(interval, cycle) }
    }

    /// Whether frames with this rate are `interval` apart, to an eighth of the shorter cycle.
    pub fn fits(self, cycle: u64, interval: u64) -> bool {
        let all = [interval.saturating_mul(self.frames), cycle.saturating_mul(self.cycles)];
        let most = self.frames * interval.min(cycle) / 8;
        cycle.is_multiple_of(self.frames) && all[0].abs_diff(all[1]) <= most
    }
}

/// A frame with too many or too few pulses before it.
#[derive(Clone, Copy, Debug)]
struct Open {
    /// By how many pulses too many.
    by: i64,
    /// The time since the last frame that was in its place, ns.
    since: u64,
    /// Frames since that one.
    frames: u64,
}

/// From the end of cyclic frames at the reference clock to the next SYNC0 of a grid. Where frames
/// come several times in a cycle of SYNC0, those that are meant to come last before it.
///
/// Between two pulses there is one frame, or as many as the rate says. A frame that passes a pulse
/// leaves one behind without any, and the next one follows it before the next pulse. That is so
/// however unevenly frames come, and needs no guess where one belongs.
#[derive(Clone, Debug)]
pub(crate) struct Distance {
    pub grid: Grid,
    rate: Rate,
    /// The pulses among which frames lie, ns: of SYNC0, or where its cycle has several frames as
    /// many as these.
    step: Grid,
    /// From the first bit of the last one to its last bit, ns.
    pub frame_ns: i64,
    /// Frames that were measured.
    pub count: u64,
    /// Shortest and longest distance, ns. They continue below 0 and beyond the cycle where frames
    /// move past SYNC0.
    pub shortest: Known<i64>,
    pub longest: Known<i64>,
    /// The first and the last distance.
    pub first: Known<i64>,
    pub last: Known<i64>,
    /// The last frame.
    before: Option<Sample>,
    /// It is out of place: the next one tells what it was.
    open: Option<Open>,
    /// By how many pulses frames have moved past those before which they were at first.
    turns: i64,
    /// Frames whose distance was below 0 or not below the cycle, and the first of them.
    pub outside: u64,
    pub first_outside: Option<Known<i64>>,
    /// How often a frame was missing, and the longest time without one, ns.
    pub missing: u64,
    pub gap: Known<u64>,
    sum: i128,
    course: Course,
}

/// The distances in the order of time, as the sums of a few parts of equal length. When all parts
/// are full, each pair becomes one.
#[derive(Clone, Copy, Debug)]
struct Course {
    sums: [i128; PARTS],
    /// Parts that have begun.
    begun: usize,
    /// Frames of a full part.
    length: u64,
    /// Frames of the last part.
    filled: u64,
}

/// Pulses that frames may miss, or move past.
const MOST_PULSES: i64 = 1 << 24;
/// Frames of the last part of a course from which on it counts.
const LEARNING: u64 = 32;
/// Parts of a course.
const PARTS: usize = 16;

impl Default for Course {
    fn default() -> Self {
        Self { sums: [0; PARTS], begun: 1, length: 1, filled: 0 }
    }
}

impl Course {
    fn push(&mut self, ns: i64) {
        if self.filled == self.length && self.begun == PARTS {
            for part in 0..PARTS / 2 {
                self.sums[part] = self.sums[2 * part] + self.sums[2 * part + 1];
            }
            self.begun = PARTS / 2;
            self.length *= 2;
            self.filled = self.length;
        }
        if self.filled == self.length {
            self.sums[self.begun] = 0;
            self.begun += 1;
            self.filled = 0;
        }
        self.sums[self.begun - 1] += i128::from(ns);
        self.filled += 1;
    }

    /// Whether the distances went the same way all the time: three quarters of the steps from part
    /// to part are at least half as long as the mean step. A jump is one step among many.
    fn is_steady(&self) -> bool {
        let full = if self.filled == self.length { self.begun } else { self.begun - 1 };
        let Some(steps) = full.checked_sub(1).filter(|steps| *steps > 0) else { return false };
        let way = self.sums[full - 1] - self.sums[0];
        let least = way.abs() / (2 * steps as i128);
        let step = |pair: &&[i128]| (pair[1] - pair[0]) * way.signum() >= least.max(1);
        self.sums[..full].windows(2).filter(step).count() * 4 >= steps * 3
    }
}

impl Distance {
    /// `None`: the rate doesn't divide the cycle.
    pub(super) fn new(grid: Grid, rate: Rate) -> Option<Self> {
        let none = Known { value: 0, frame: 0 };
        let step = grid.cycle / rate.frames;
        Some(Self {
            grid,
            rate,
            step: Grid { cycle: step, phase: grid.phase.checked_rem(step)? },
            frame_ns: 0,
            count: 0,
            shortest: none,
            longest: none,
            first: none,
            last: none,
            before: None,
            open: None,
            turns: 0,
            outside: 0,
            first_outside: None,
            missing: 0,
            gap: Known { value: 0, frame: 0 },
            sum: 0,
            course: Course::default(),
        })
    }

    pub(super) fn rate(&self) -> Rate {
        self.rate
    }

    /// The usual time from one frame to the next, ns.
    pub fn interval(&self) -> u64 {
        self.step.cycle.saturating_mul(self.rate.cycles)
    }

    /// Takes one more frame. Calls `told` with each distance that is known from now on, which is
    /// that of the frame before where that one was out of place.
    pub(super) fn push(&mut self, sample: Sample, mut told: impl FnMut(Sample, i64)) {
        self.frame_ns = sample.duration;
        let Some(before) = self.before.replace(sample) else {
            return self.take(sample, 0, &mut told);
        };
        let since = sample.end.wrapping_sub(before.end);
        let passed = self.pulse(sample.end) - self.pulse(before.end);
        let more = passed - i128::from(self.rate.cycles);
        let goes_on = |more: &i64| passed >= 0 && more.abs() <= MOST_PULSES;
        let Some(more) = i64::try_from(more).ok().filter(goes_on) else {
            // The clock was set.
            self.open = None;
            return self.take(sample, 0, &mut told);
        };
        let mut out = Open { by: more, since, frames: 1 };
        if let Some(open) = self.open.take() {
            self.close(before, open, more, &mut told);
            // Of several pulses, this frame makes up for some.
            if open.by.signum() == -more.signum() {
                let (since, frames) = (open.since.saturating_add(since), open.frames + 1);
                out = Open { by: open.by + more, since, frames };
            }
        }
        match out.by {
            0 => self.take(sample, 0, &mut told),
            _ => self.open = Some(out),
        }
    }

    /// Operation ends for some time: the next frame does not follow the last one.
    pub(super) fn pause(&mut self) {
        self.before = None;
        self.open = None;
    }

    /// The number of the last pulse before an instant. A frame that ends with a pulse came before
    /// it.
    fn pulse(&self, at: u64) -> i128 {
        (i128::from(at) - i128::from(self.step.phase) - 1).div_euclid(self.step.cycle.into())
    }

    /// Decides what a frame out of place was. `more`: by how many pulses too many the next frame
    /// came behind it.
    fn close(&mut self, sample: Sample, open: Open, more: i64, told: &mut impl FnMut(Sample, i64)) {
        let Open { by, since, frames } = open;
        let usual = frames.saturating_mul(self.interval());
        let half = self.step.cycle / 2;
        match (by > 0, more.signum()) {
            // The next one is where it should be: this one alone was late, or early.
            (true, -1) => self.take(sample, -by.min(-more), told),
            (false, 1) => self.take(sample, (-by).min(more), told),
            // It stays so. One that came soon after the one before has moved past the pulse.
            (true, _) if since < usual.saturating_add(half) => {
                self.turn(by);
                self.take(sample, 0, told);
            }
            (false, _) if since > usual - half.min(usual) => {
                self.turn(by);
                self.take(sample, 0, told);
            }
            // Frames before it are missing. Of several in a cycle the others tell it.
            (true, _) => {
                if self.rate.frames == 1 {
                    self.missing += 1;
                    if since > self.gap.value {
                        self.gap = Known { value: since, frame: sample.number };
                    }
                }
                self.take(sample, 0, told);
            }
            // It is one too many.
            (false, _) => {}
        }
    }

    fn turn(&mut self, by: i64) {
        self.turns = (self.turns - by).clamp(-MOST_PULSES, MOST_PULSES);
    }

    /// Takes the distance of a frame that is alone `early` pulses before where it should be.
    fn take(&mut self, sample: Sample, early: i64, told: &mut impl FnMut(Sample, i64)) {
        let ahead = self.step.ahead(sample.end) as i64;
        let ns = ahead.saturating_add((self.turns + early).saturating_mul(self.step.cycle as i64));
        // SYNC0 comes at some of the pulses only: the next frame may be the one for it.
        if sample.end.wrapping_add_signed(ns) % self.grid.cycle != self.grid.phase {
            return;
        }
        told(sample, ns);
        self.keep(Known { value: ns, frame: sample.number });
    }

    fn keep(&mut self, known: Known<i64>) {
        let ns = known.value;
        if self.count == 0 {
            (self.first, self.shortest, self.longest) = (known, known, known);
        }
        self.count += 1;
        self.sum += i128::from(ns);
        self.course.push(ns);
        self.last = known;
        if ns < self.shortest.value {
            self.shortest = known;
        }
        if ns > self.longest.value {
            self.longest = known;
        }
        if !(0..self.grid.cycle as i64).contains(&ns) {
            self.outside += 1;
            self.first_outside.get_or_insert(known);
        }
    }

    /// The mean of that part of the time in which frames came earliest, ns: what is late at times
    /// is punctual at others.
    pub fn punctual(&self) -> i64 {
        let course = &self.course;
        let frames = |part| match part + 1 == course.begun {
            true => course.filled,
            false => course.length,
        };
        let parts = (0..course.begun).filter(|part| frames(*part) >= LEARNING.min(course.length));
        let means = parts.map(|part| (course.sums[part] / i128::from(frames(part))) as i64);
        means.max().unwrap_or_else(|| self.mean())
    }

    /// Whether frames drifted through more than half a cycle in one direction: they do not follow
    /// the reference clock.
    pub fn slides(&self) -> bool {
        let way = self.last.value - self.first.value;
        way.abs() > self.step.cycle as i64 / 2 && self.course.is_steady()
    }

    /// The mean, ns.
    pub fn mean(&self) -> i64 {
        (self.sum / i128::from(self.count)) as i64
    }
}
