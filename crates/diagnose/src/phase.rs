//! Where cyclic frames lie against SYNC0, in the time of the reference clock.
//!
//! A drift datagram (FRMW, ARMW) returns the reference's system time at the instant at which its
//! frame reached the reference. SYNC0 comes at the start time and once per cycle after it, in the
//! same time. So the distance from a frame to the next SYNC0 is known to the clock's 10 ns, however
//! inaccurate the stamps of the capture are.

use isocat_rules::evidence::Slide;
use isocat_rules::trail::Trail;
use isocat_wire::frame;
use isocat_wire::time::Picos;

use crate::known::Known;
pub(crate) use crate::measured::Grid;

impl Grid {
    /// The grid of a SYNC unit that starts at `start`.
    pub(crate) fn new(cycle: u32, start: u64) -> Option<Self> {
        let cycle = u64::from(cycle);
        Some(Self { cycle, phase: start.checked_rem(cycle)? })
    }

    /// From `at` to the next SYNC0, ns: 0 to `cycle` - 1.
    pub(crate) fn ahead(self, at: u64) -> u64 {
        let since = (at % self.cycle + self.cycle - self.phase) % self.cycle;
        (self.cycle - since) % self.cycle
    }
}

/// From the end of cyclic frames at the reference clock to the next SYNC0 of a grid.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Distance {
    pub grid: Grid,
    /// Frames that were measured.
    pub count: u64,
    /// Shortest and longest distance, ns. They continue below 0 and beyond the cycle where frames
    /// move past SYNC0.
    pub shortest: Known<i64>,
    pub longest: Known<i64>,
    /// The first and the last distance.
    pub first: Known<i64>,
    pub last: Known<i64>,
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

impl Course {
    fn new(ns: i64) -> Self {
        let mut sums = [0; PARTS];
        sums[0] = ns.into();
        Self { sums, begun: 1, length: 1, filled: 1 }
    }

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
    fn new(grid: Grid, ns: i64, frame: usize) -> Self {
        let known = Known { value: ns, frame };
        Self {
            grid,
            count: 1,
            shortest: known,
            longest: known,
            first: known,
            last: known,
            recent: ns,
            home: ns,
            outside: 0,
            first_outside: None,
            sum: ns.into(),
            course: Course::new(ns),
        }
    }

    /// Takes the distance of one more frame, which came `since` ns after the one before; returns it
    /// unwrapped, as a continuation of those before.
    fn push(&mut self, ns: i64, frame: usize, since: u64) -> i64 {
        let cycle = self.grid.cycle as i64;
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
        let next = i64::try_from(since)
            .ok()
            .filter(|since| (cycle / 4..=cycle + cycle / 32).contains(since));
        let next = next.map(|since| self.last.value + cycle - since);
        let next = next.filter(|next| (0..cycle).contains(next) && (ns - next).abs() < cycle / 32);
        let ns = match next {
            Some(_) => ns,
            None if self.count < LEARNING || is_home => back,
            None => near(cycle / 4),
        };
        // The punctual ones tell where frames belong, also after many late ones.
        self.recent += (ns - self.recent) / if ns > self.recent { 4 } else { 32 };
        let weight = if self.count < LEARNING { 4 } else { 1024 };
        self.home += (ns - self.home) / weight;
        let known = Known { value: ns, frame };
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
        if !(0..cycle).contains(&ns) {
            self.outside += 1;
            self.first_outside.get_or_insert(known);
        }
        ns
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
        way.abs() > self.grid.cycle as i64 / 2 && self.course.is_steady()
    }

    /// The mean, ns.
    pub fn mean(&self) -> i64 {
        (self.sum / i128::from(self.count)) as i64
    }
}

/// The distances of all grids since operation began.
#[derive(Clone, Debug, Default)]
pub(crate) struct Phases {
    pub grids: Vec<Distance>,
    /// The course of the distances to the grid with the shortest cycle.
    trail: Trail,
    trailed: Option<Grid>,
    /// The reference's system time at the first frame, ns.
    since: Option<u64>,
    /// The reference's system time at the last frame, ns.
    last: Option<u64>,
    /// How long the frames take from their first bit to their last, ns: the last one.
    frame_ns: u64,
}

impl Phases {
    /// Takes a cyclic frame of `len` bytes that reached the reference at system time `at`. Calls
    /// `told` with the distance to each grid.
    pub fn cyclic(
        &mut self,
        grids: &[Grid],
        at: u64,
        len: usize,
        frame: usize,
        mut told: impl FnMut(Grid, i64),
    ) {
        self.frame_ns = frame::duration_ns(len);
        let end = at.wrapping_add(self.frame_ns);
        let shortest = || grids.iter().min_by_key(|grid| grid.cycle).copied();
        self.trailed = self.trailed.or_else(shortest);
        let since = at.wrapping_sub(*self.since.get_or_insert(at));
        let interval = at.wrapping_sub(self.last.replace(at).unwrap_or(at));
        let mut told = |grid: Grid, ns: i64| {
            if self.trailed == Some(grid) {
                // A frame that comes later is nearer to SYNC0.
                self.trail.take(since.saturating_mul(1_000), Picos(-ns * 1_000));
            }
            told(grid, ns);
        };
        for grid in grids {
            let ns = grid.ahead(end) as i64;
            match self.grids.iter().position(|distance| distance.grid == *grid) {
                Some(place) => told(*grid, self.grids[place].push(ns, frame, interval)),
                None if self.grids.len() < MOST_GRIDS => {
                    self.grids.push(Distance::new(*grid, ns, frame));
                    told(*grid, ns);
                }
                None => {}
            }
        }
    }

    /// How frames, which come each `cycle` ns, move against the reference clock. `None`: not known,
    /// or they come several times in a cycle of each SYNC0.
    pub fn slide(&self, cycle: u64) -> Option<Slide> {
        let trailed = self.trailed.filter(|grid| grid.cycle <= cycle + cycle / 2)?;
        self.of(trailed)?;
        self.trail.slide()
    }

    /// From the first bit of a cyclic frame to its last, ns.
    pub fn frame_ns(&self) -> i64 {
        self.frame_ns as i64
    }

    /// The distances of one grid.
    pub fn of(&self, grid: Grid) -> Option<&Distance> {
        self.grids.iter().find(|distance| distance.grid == grid)
    }
}

/// Grids that are kept apart.
pub(crate) const MOST_GRIDS: usize = 64;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_next_pulse() {
        let grid = Grid::new(1000, 12_300).expect("a cycle");
        for (at, ahead) in [(300, 0), (299, 1), (301, 999), (1_300, 0), (12_800, 500)] {
            assert_eq!(grid.ahead(at), ahead, "{at}");
        }
        assert_eq!(Grid::new(0, 7), None);
    }

    #[test]
    fn frames_that_wander_past_sync0_go_on() {
        let grid = Grid::new(1_000_000, 0).expect("a cycle");
        let mut phases = Phases::default();
        for cycle in 0..2000_u64 {
            // Each cycle 1 us later, from 500 us before SYNC0 on.
            phases.cyclic(&[grid], cycle * 1_001_000 + 500_000, 60, cycle as usize, |_, _| {});
        }
        let distance = phases.of(grid).expect("measured");
        let duration = frame::duration_ns(60) as i64;
        assert_eq!(distance.first.value, 500_000 - duration);
        assert_eq!(distance.last.value, 500_000 - duration - 1_999_000);
        assert_eq!(distance.first_outside.map(|k| k.frame), Some(495));
        assert_eq!((distance.count, distance.outside), (2000, 1505));
    }

    /// Frames that lie 600 us later from the middle of the time on have jumped once, and do not
    /// slide; those that become later with each cycle do. Both with lateness of up to 100 us.
    #[test]
    fn a_jump_is_no_slide() {
        let grid = Grid::new(1_000_000, 0).expect("a cycle");
        let measured = |frames: u64, late: fn(u64, u64) -> u64| {
            let mut phases = Phases::default();
            for cycle in 0..frames {
                let jitter = cycle * 7_919 % 100 * 1_000;
                let at = cycle * 1_000_000 + 50_000 + jitter + late(cycle, frames);
                phases.cyclic(&[grid], at, 60, cycle as usize, |_, _| {});
            }
            *phases.of(grid).expect("measured")
        };
        for frames in [100, 1_000, 1_023, 1_024, 1_025, 30_000] {
            let jumped = |cycle, frames| if cycle < frames / 2 { 0 } else { 600_000 };
            assert!(!measured(frames, jumped).slides(), "{frames} with a jump");
            let slid = |cycle, frames| cycle * 700_000 / frames;
            assert!(measured(frames, slid).slides(), "{frames} that slide");
        }
    }

    /// Where frames are late by up to 0.4 of a cycle, at times eight in a row by all of it, those
    /// that are punctual again are not taken for later ones still.
    #[test]
    fn late_frames_do_not_move_where_frames_belong() {
        let grid = Grid::new(1_000_000, 0).expect("a cycle");
        let mut phases = Phases::default();
        for cycle in 0..4000_u64 {
            let late = if cycle % 100 < 8 { 400_000 } else { cycle * 104_729 % 400_000 };
            phases.cyclic(&[grid], cycle * 1_000_000 + 480_000 + late, 60, 0, |_, _| {});
        }
        let distance = phases.of(grid).expect("measured");
        assert_eq!(distance.outside, 0, "{:?}", distance.shortest);
    }

    /// Some hundred or thousand frames that are all late by 0.4 of a cycle, between punctual ones.
    #[test]
    fn frames_come_back_to_where_they_were() {
        let grid = Grid::new(1_000_000, 0).expect("a cycle");
        let punctual = 1_000_000 - 480_000 - frame::duration_ns(60) as i64;
        for late in [500..700, 100..1_100, 100..5_000] {
            let mut phases = Phases::default();
            for cycle in 0..late.end + 300 {
                let late = if late.contains(&cycle) { 400_000 } else { 0 };
                phases.cyclic(&[grid], cycle * 1_000_000 + 480_000 + late, 60, 0, |_, _| {});
            }
            let distance = phases.of(grid).expect("measured");
            assert_eq!((distance.outside, distance.slides()), (0, false), "{late:?}: {distance:?}");
            assert_eq!(distance.longest.value, punctual);
            // A course has sixteen parts at most, so a short stretch may be part of a later one.
            assert!(distance.punctual() > punctual - 200_000, "{late:?}");
        }
    }

    #[test]
    fn a_late_frame_alone_is_not_one_of_the_next_cycle() {
        let grid = Grid::new(1_000_000, 0).expect("a cycle");
        let mut phases = Phases::default();
        for cycle in 0..100_u64 {
            let late = if cycle == 50 { 300_000 } else { 0 };
            phases.cyclic(
                &[grid],
                cycle * 1_000_000 + 800_000 + late,
                60,
                cycle as usize,
                |_, _| {},
            );
        }
        let distance = phases.of(grid).expect("measured");
        assert_eq!((distance.outside, distance.shortest.frame), (1, 50));
        assert_eq!(distance.shortest.value, -100_000 - frame::duration_ns(60) as i64);
    }
}
