//! Checks that SYNC0 edges are on the configured grid.

use isocat_sync::settling::Settling;
use isocat_wire::time::{Picos, Time, True};

use super::{ClockTime, Grid, Points};
use crate::statistics::Statistics;

/// Watches the SYNC0 edges of one SubDevice against the ideal grid of the reference clock.
///
/// Edges without any spread are also wrong: [`Sync0Error::is_plausible`] rejects them at a
/// SubDevice whose oscillator differs from the reference clock's and is controlled by it.
#[derive(Clone, Debug)]
// In this order: all that a regular cycle touches lies together, and first.
#[repr(C)]
pub struct Sync0Error {
    points: Points,
    /// The last edge, and its error.
    last: Option<(Time<True>, Picos)>,
    statistics: Statistics,
    limit: Picos,
    first_beyond: Option<(Time<True>, Picos)>,
    settling: Settling<Time<True>>,
}

impl Sync0Error {
    /// A judge that expects edges on `grid` with an error of at most `limit`.
    pub fn new(grid: Grid, limit: Picos) -> Self {
        Self {
            points: Points::new(grid),
            limit,
            statistics: Statistics::default(),
            last: None,
            first_beyond: None,
            settling: Settling::default(),
        }
    }

    /// Takes an edge at true time `at`, when the system time of the reference clock was
    /// `reference_ps`; returns its error.
    pub fn edge(&mut self, at: Time<True>, reference_ps: i128) -> Picos {
        self.meet(at, ClockTime::of_ps(reference_ps)).1
    }

    /// The same; returns also the number of its grid point.
    #[inline(always)]
    pub(crate) fn meet(&mut self, at: Time<True>, reference: ClockTime) -> (i64, Picos) {
        let (number, error) = self.points.meet(reference);
        let error = self.follow(at, error);
        let widens = self.statistics.widens(error.0);
        self.settling.sample(at, error);
        // The first one beyond the limit is further out than all before.
        if widens && error.abs() > self.limit && self.first_beyond.is_none() {
            self.first_beyond = Some((at, error));
        }
        (number, error)
    }

    /// Continues the error from the last one: a clock that drifts away leaves its cycle, and its
    /// error continues to increase. After a pause SYNC0 was started again, so its error does not
    /// continue the last one.
    #[inline]
    fn follow(&mut self, at: Time<True>, error: Picos) -> Picos {
        let (cycle, half) = (self.points.cycle().0, self.points.half());
        let last = self.last.filter(|(last, _)| (at - *last).0 <= PAUSE * cycle);
        if last.is_none() && self.last.is_some() {
            self.settling.close();
        }
        let gap = last.map_or(0, |(_, last)| last.0 - error.0);
        // As a rule it is the same cycle, and nothing is to be divided.
        let cycles =
            if gap.unsigned_abs() < half { 0 } else { (gap + cycle / 2).div_euclid(cycle) };
        let error = Picos(error.0 + cycles * cycle);
        self.last = Some((at, error));
        error
    }

    /// Figures of all edges.
    pub fn statistics(&self) -> &Statistics {
        &self.statistics
    }

    /// How the errors go from the first edge on, as long as edges come without a pause.
    pub fn settling(&self) -> &Settling<Time<True>> {
        &self.settling
    }

    /// The error of the last edge; `None` before the first.
    pub fn last(&self) -> Option<Picos> {
        self.last.map(|(_, error)| error)
    }

    /// The largest error allowed.
    pub fn limit(&self) -> Picos {
        self.limit
    }

    /// When the first edge beyond the limit came, and its error.
    pub fn first_beyond(&self) -> Option<(Time<True>, Picos)> {
        self.first_beyond
    }

    /// Whether the edges have the spread of a real clock: they are generated on a grid of 10 ns, so
    /// a clock that is controlled by another one cannot hit the same picosecond each time. Two
    /// clocks that the loop holds together to a part in a million need some thousand edges to move
    /// by a step of that grid.
    pub fn is_plausible(&self) -> bool {
        self.statistics.count() < ENOUGH || self.statistics.least() != self.statistics.largest()
    }
}

/// Number of cycles without an edge that do not count as a pause.
const PAUSE: i64 = 3;
/// Number of edges below which a missing spread tells nothing.
const ENOUGH: u64 = 10_000;

#[cfg(test)]
mod tests {
    use super::*;
    use isocat_wire::time::Nanos;

    fn judge(edges: &[i128]) -> Sync0Error {
        let grid = Grid { cycle: Nanos(1_000_000), phase: Nanos(500_000) };
        let mut judge = Sync0Error::new(grid, Picos(100_000));
        for (i, error) in edges.iter().enumerate() {
            judge.edge(Time::new(i as u64), 500_000_000 + 1_000_000_000 * i as i128 + error);
        }
        judge
    }

    #[test]
    fn both_sides_of_the_limit() {
        assert_eq!(judge(&[0, 100_000, -100_000]).first_beyond(), None);
        let beyond = judge(&[0, 100_000, -100_001]).first_beyond();
        assert_eq!(beyond, Some((Time::new(2), Picos(-100_001))));
    }

    #[test]
    fn a_clock_that_runs_away_leaves_its_cycle() {
        let judge = judge(&[0, 300_000_000, 600_000_000, 900_000_000, 1_200_000_000]);
        assert_eq!(judge.statistics().largest(), 1_200_000_000);
    }

    #[test]
    fn behind_a_pause_it_begins_anew() {
        for (pause, error) in [(3_000_000_000, 900_000_000), (3_000_000_001, -100_000_000)] {
            let grid = Grid { cycle: Nanos(1_000_000), phase: Nanos(0) };
            let mut judge = Sync0Error::new(grid, Picos(100_000));
            judge.edge(Time::new(1), 450_000_000);
            judge.edge(Time::new(1 + pause), 4_900_000_000);
            assert_eq!(judge.last(), Some(Picos(error)), "{pause}");
            for more in 2..=4 {
                judge.edge(Time::new(more + pause), 4_900_000_000);
            }
            let continues = error == 900_000_000;
            assert_eq!(judge.settling().first().is_some(), continues, "{pause}");
        }
    }

    #[test]
    fn too_good_is_wrong() {
        let mut edges = vec![7; ENOUGH as usize];
        assert!(!judge(&edges).is_plausible());
        assert!(judge(&edges[1..]).is_plausible(), "too few to tell");
        edges[5] = 8;
        assert!(judge(&edges).is_plausible());
    }
}
