//! Outputs follow SYNC0 after the same time in every cycle.

use isocat_wire::time::{Picos, Time, True};

use crate::statistics::Statistics;

/// Largest spread of the time from SYNC0 to valid outputs with which a SubDevice counts as synchronized:
/// the distance of minimum and maximum delay time, 0x1C32:07 and :09, that ETG.1020 allows.
pub const LIMIT: Picos = Picos(1_000_000);

/// Watches one SubDevice: from SYNC0 to valid outputs.
#[derive(Clone, Debug, Default)]
pub struct OutputsDelay {
    sync0: Option<Time<True>>,
    delay: Statistics,
    first_beyond: Option<Time<True>>,
}

impl OutputsDelay {
    /// SYNC0 acts.
    pub fn sync0(&mut self, at: Time<True>) {
        self.sync0 = Some(at);
    }

    /// Outputs have become valid.
    pub fn valid(&mut self, at: Time<True>) {
        let Some(sync0) = self.sync0.take() else { return };
        self.delay.push((at - sync0).0);
        if self.spread() > LIMIT && self.first_beyond.is_none() {
            self.first_beyond = Some(at);
        }
    }

    /// From SYNC0 to valid outputs.
    pub fn delay(&self) -> &Statistics {
        &self.delay
    }

    /// Longest less shortest.
    pub fn spread(&self) -> Picos {
        Picos(self.delay.largest() - self.delay.least())
    }

    /// When the spread first passed the limit.
    pub fn first_beyond(&self) -> Option<Time<True>> {
        self.first_beyond
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_sides_of_the_limit() {
        let mut judge = OutputsDelay::default();
        for (cycle, delay) in [(0, 30_000_000), (1_000_000_000, 31_000_000)] {
            judge.sync0(Time::new(cycle));
            judge.valid(Time::new(cycle + delay));
        }
        assert_eq!((judge.spread(), judge.first_beyond()), (LIMIT, None));
        judge.sync0(Time::new(2_000_000_000));
        judge.valid(Time::new(2_031_000_001));
        assert_eq!(judge.first_beyond(), Some(Time::new(2_031_000_001)));
    }
}
