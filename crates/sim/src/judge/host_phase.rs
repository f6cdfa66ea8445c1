//! Checks that cyclic frames find the reference clock at their intended phase.

use isocat_wire::time::Picos;

use super::{ClockTime, Grid, Points};
use crate::statistics::Statistics;

/// Watches the arrival of cyclic frames at the reference clock.
#[derive(Clone, Debug)]
pub struct HostPhase {
    points: Points,
    statistics: Statistics,
    last: Option<Picos>,
}

impl HostPhase {
    /// Expects frames on `grid`.
    pub fn new(grid: Grid) -> Self {
        Self { points: Points::new(grid), statistics: Statistics::default(), last: None }
    }

    /// Takes a cyclic frame that began to enter the reference SubDevice when its system time was
    /// `reference_ps`.
    pub fn frame(&mut self, reference_ps: i128) -> Picos {
        self.meet(ClockTime::of_ps(reference_ps))
    }

    /// The same for a time as the clock shows it.
    pub(crate) fn meet(&mut self, reference: ClockTime) -> Picos {
        let (_, error) = self.points.meet(reference);
        self.statistics.push(error.0);
        self.last = Some(error);
        error
    }

    /// Lateness of the frames (negative: early).
    pub fn statistics(&self) -> &Statistics {
        &self.statistics
    }

    /// Lateness of the last frame; `None` before the first.
    pub fn last(&self) -> Option<Picos> {
        self.last
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isocat_wire::time::Nanos;

    #[test]
    fn late_is_positive() {
        let mut judge = HostPhase::new(Grid { cycle: Nanos(1_000), phase: Nanos(0) });
        assert_eq!(judge.frame(5_000_007), Picos(7));
        assert_eq!(judge.frame(4_999_993), Picos(-7));
        assert_eq!((judge.statistics().worst(), judge.last()), (7, Some(Picos(-7))));
    }
}
