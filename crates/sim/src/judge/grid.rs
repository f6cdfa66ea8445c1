//! A grid in system time, and its points one after another.

use isocat_wire::time::{Nanos, Picos};

/// A grid in system time: every `cycle`, at `phase`.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Grid {
    /// Distance of two points.
    pub cycle: Nanos,
    /// Position of a point in the cycle.
    pub phase: Nanos,
}

impl Grid {
    /// Distance of a point of system time, in ps, from the nearest grid point; negative if it is
    /// earlier.
    pub fn error(&self, system_ps: i128) -> Picos {
        if let Some((since, cycle)) = self.short(system_ps) {
            let into = since.rem_euclid(cycle);
            return Picos(if into > cycle / 2 { into - cycle } else { into });
        }
        let cycle = i128::from(self.cycle.0) * 1000;
        let into = (system_ps - i128::from(self.phase.0) * 1000).rem_euclid(cycle);
        Picos((if into > cycle / 2 { into - cycle } else { into }) as i64)
    }

    /// Number of the nearest grid point.
    pub fn index(&self, system_ps: i128) -> i64 {
        if let Some((since, cycle)) = self.short(system_ps) {
            return (since + cycle / 2).div_euclid(cycle);
        }
        let cycle = i128::from(self.cycle.0) * 1000;
        let since = system_ps - i128::from(self.phase.0) * 1000 + cycle / 2;
        since.div_euclid(cycle) as i64
    }

    /// The time since a grid point and the cycle, ps, if they are short: division of 64 bits is
    /// much faster, and enough for 50 days.
    #[inline]
    fn short(&self, system_ps: i128) -> Option<(i64, i64)> {
        const SHORT: i64 = i64::MAX / 2;
        let (cycle, phase) = (self.cycle.0.checked_mul(1000)?, self.phase.0.checked_mul(1000)?);
        let since = i64::try_from(system_ps).ok()?.checked_sub(phase)?;
        (since.abs() < SHORT && cycle > 0 && cycle < SHORT).then_some((since, cycle))
    }
}

/// A point of system time, finer than a clock shows it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct ClockTime {
    /// What the clock shows, ns.
    pub shown: u64,
    /// What has passed since it began to show that.
    pub since: Picos,
}

impl ClockTime {
    /// A point in ps, which is not before time zero.
    pub fn of_ps(ps: i128) -> Self {
        Self { shown: ps.div_euclid(1000) as u64, since: Picos(ps.rem_euclid(1000) as i64) }
    }

    /// The same in ps.
    #[inline]
    pub fn ps(self) -> i128 {
        i128::from(self.shown) * 1000 + i128::from(self.since.0)
    }
}

/// A grid whose points are met one after another.
#[derive(Clone, Debug)]
#[repr(C)]
pub(crate) struct Points {
    /// The point that is expected next, ns of system time, and its number.
    next: u64,
    number: i64,
    /// A time nearer to it than this, ps, is nearest to it: half of the cycle. Zero if the next
    /// point is not known.
    near: u64,
    /// The last point after which the next one is kept: then the counter is not about to wrap.
    last: u64,
    /// The cycle, and half of it, ps; zero if it is too long for that.
    cycle: Picos,
    half: u64,
    grid: Grid,
}

impl Points {
    pub fn new(grid: Grid) -> Self {
        let half = grid.cycle.0.checked_mul(1000).map_or(0, |cycle| (cycle.max(0) / 2) as u64);
        let last = u64::MAX.saturating_sub((grid.cycle.0 as u64).saturating_mul(2));
        Self { next: 0, number: 0, near: 0, last, cycle: grid.cycle.into(), half, grid }
    }

    /// The cycle.
    pub fn cycle(&self) -> Picos {
        self.cycle
    }

    /// Half of it, ps; zero if the cycle is too long for that.
    pub fn half(&self) -> u64 {
        self.half
    }

    /// Number of the grid point that is nearest to a point of system time, and the distance from
    /// it: [`Grid::index`] and [`Grid::error`].
    #[inline]
    pub fn meet(&mut self, time: ClockTime) -> (i64, Picos) {
        // As a rule it is the point that follows the last one, and nothing is to be divided.
        let Some(error) = self.expected(time) else { return self.find(time.ps()) };
        let number = self.number;
        self.expect_after(self.next, number);
        (number, error)
    }

    /// The distance from the point that was expected, if that is the nearest one.
    #[inline]
    fn expected(&self, time: ClockTime) -> Option<Picos> {
        let ns = time.shown.wrapping_sub(self.next) as i64;
        let error = ns.checked_mul(1000)?.checked_add(time.since.0)?;
        (error.unsigned_abs() < self.near).then_some(Picos(error))
    }

    #[inline]
    fn expect_after(&mut self, point: u64, number: i64) {
        self.number = number.wrapping_add(1);
        self.next = point.wrapping_add(self.grid.cycle.0 as u64);
        // Where the counter wraps, no next point is kept; the search finds it.
        if point > self.last {
            self.near = 0;
        }
    }

    #[cold]
    fn find(&mut self, system_ps: i128) -> (i64, Picos) {
        let (number, error) = (self.grid.index(system_ps), self.grid.error(system_ps));
        // Of two points that are equally near, number and distance are those of different ones.
        let is_near = error.0.unsigned_abs() < self.half;
        let point = u64::try_from((system_ps - i128::from(error.0)) / 1000);
        self.near = if is_near && point.is_ok() { self.half } else { 0 };
        if let Ok(point) = point {
            self.expect_after(point, number);
        }
        (number, error)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_are_signed_and_at_most_half_a_cycle() {
        let grid = Grid { cycle: Nanos(1_000), phase: Nanos(100) };
        assert_eq!(grid.error(5_100_000), Picos(0));
        assert_eq!(grid.error(5_100_001), Picos(1));
        assert_eq!(grid.error(5_099_999), Picos(-1));
        assert_eq!(grid.error(5_600_000), Picos(500_000));
        assert_eq!(grid.error(5_600_001), Picos(-499_999));
        assert_eq!((grid.index(5_099_999), grid.index(5_100_001)), (5, 5));
    }

    /// Next points, the same again, steps back, jumps, both sides of half a cycle, and both ends of
    /// the counter.
    #[test]
    fn points_that_are_met_are_those_that_a_division_finds() {
        let near = [0, 1, 499, 500, 501, 999];
        let ends = [0, 1 << 32, u64::MAX / 1_000, u64::MAX - 5_000, u64::MAX];
        for (cycle, phase) in [(1_000, 100), (1_000, 0), (1_000, -700), (999, 1), (1, 0)] {
            let grid = Grid { cycle: Nanos(cycle), phase: Nanos(phase) };
            let mut points = Points::new(grid);
            for end in ends {
                for cycles in [0, 1, 2, 3, 3, 4, 90, 91, 90, 91, -1, -2, -1, 0] {
                    for ps in (0..12).flat_map(|ns| near.map(|ps| 1_000 * ns + ps)) {
                        let ns = (cycles * cycle + phase + 500 * (ps % 3) - 5) as u64;
                        let (shown, since) = (end.wrapping_add(ns), Picos(ps));
                        let time = ClockTime { shown, since };
                        let found = (grid.index(time.ps()), grid.error(time.ps()));
                        assert_eq!(points.meet(time), found, "{grid:?} {time:?}");
                        let shown = shown.wrapping_add(cycle as u64);
                        let next = ClockTime { shown, since };
                        let found = (grid.index(next.ps()), grid.error(next.ps()));
                        assert_eq!(points.clone().meet(next), found, "{grid:?} {next:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn grids_that_are_no_grids_do_not_overflow() {
        for cycle in [i64::MAX, i64::MAX / 1_000, i64::MAX / 1_000 + 1] {
            let grid = Grid { cycle: Nanos(cycle), phase: Nanos(0) };
            let mut points = Points::new(grid);
            for shown in [5, cycle as u64 + 7, cycle as u64 * 2 - 3] {
                let time = ClockTime { shown, since: Picos(3) };
                let number = points.meet(time).0;
                assert_eq!(number, grid.index(time.ps()));
            }
        }
    }
}
