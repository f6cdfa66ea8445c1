//! The distance from certain frames to SYNC0: its course, and how often frames passed it.

use super::Grid;
use crate::known::Known;

/// From the end of cyclic frames at the reference clock to the next SYNC0 of a grid. Where frames
/// come several times in a cycle of SYNC0, those that are meant to come last before it.
#[derive(Clone, Debug)]
pub(crate) struct Distance {
    pub grid: Grid,
    /// The time from one frame to the next, ns: the cycle of SYNC0, or a whole fraction of it.
    pub step: u64,
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
    /// The distance of the last frame to the end of its step, ns, and the system time at its end.
    taken: Option<(i64, u64)>,
    /// Frames after the first one, with those that are not meant for SYNC0.
    seen: u64,
    /// Where punctual frames lay last: a moving mean that follows early frames sooner than late
    /// ones.
    recent: i64,
    /// Where frames have been for a long time.
    home: i64,
    /// Frames whose distance was below 0 or not below the cycle, and the first of them.
    pub outside: u64,
    pub first_outside: Option<Known<i64>>,
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

/// Frames after which it is known where punctual ones lie.
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
    /// `step`: a whole fraction of the cycle of `grid`.
    pub fn new(grid: Grid, step: u64, frame_ns: i64) -> Self {
        let none = Known { value: 0, frame: 0 };
        Self {
            grid,
            step,
            frame_ns,
            count: 0,
            shortest: none,
            longest: none,
            first: none,
            last: none,
            taken: None,
            seen: 0,
            recent: 0,
            home: 0,
            outside: 0,
            first_outside: None,
            sum: 0,
            course: Course::default(),
        }
    }

    /// Takes one more frame, whose last bit was at the reference at the system time `end`; returns
    /// its distance unwrapped, as a continuation of those before. `None`: the next frame is the one
    /// for this SYNC0.
    pub fn push(&mut self, end: u64, frame: usize) -> Option<i64> {
        let fine = Grid { cycle: self.step, phase: self.grid.phase % self.step };
        let ns = self.unwrapped(fine.ahead(end) as i64, end);
        // SYNC0 comes at some ends of a step only.
        if end.wrapping_add_signed(ns) % self.grid.cycle != self.grid.phase {
            return None;
        }
        self.take(Known { value: ns, frame });
        Some(ns)
    }

    /// A distance that continues the ones before: below 0 and beyond the step where frames move
    /// past the ends of steps.
    fn unwrapped(&mut self, ns: i64, end: u64) -> i64 {
        let cycle = self.step as i64;
        let Some((last, then)) = self.taken.replace((ns, end)) else {
            self.recent = ns;
            self.home = ns;
            return ns;
        };
        // Takes the value nearest to the last few distances, so that frames that drift through the
        // cycle have continuous values. Hosts tend to be late rather than early: a frame counts as
        // late by at most three quarters of a cycle, or as early by at most one quarter.
        let near = |early: i64| ns + (self.recent - ns + early).div_euclid(cycle) * cycle;
        // The first ones may have been late themselves. And after a time in which all were late, a
        // frame where they have always been is punctual again.
        let back = near(cycle / 2);
        let is_home = (back - self.home).abs() < cycle / 8;
        // The frame of the next cycle comes as much sooner or later behind the one before as it is
        // more or less late. That tells where it is after long lateness, too, but is no proof that
        // it passed SYNC0.
        let next = i64::try_from(end.wrapping_sub(then))
            .ok()
            .filter(|since| (cycle / 4..=cycle + cycle / 32).contains(since));
        let next = next.map(|since| last + cycle - since);
        let next = next.filter(|next| (0..cycle).contains(next) && (ns - next).abs() < cycle / 32);
        self.seen += 1;
        let ns = match next {
            Some(_) => ns,
            None if self.seen < LEARNING || is_home => back,
            None => near(cycle / 4),
        };
        // The punctual ones tell where frames belong, also after many late ones.
        self.recent += (ns - self.recent) / if ns > self.recent { 4 } else { 32 };
        let weight = if self.seen < LEARNING { 4 } else { 1024 };
        self.home += (ns - self.home) / weight;
        self.taken = Some((ns, end));
        ns
    }

    fn take(&mut self, known: Known<i64>) {
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
        way.abs() > self.step as i64 / 2 && self.course.is_steady()
    }

    /// The mean, ns.
    pub fn mean(&self) -> i64 {
        (self.sum / i128::from(self.count)) as i64
    }
}

