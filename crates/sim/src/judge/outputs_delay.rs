//! Checks that outputs follow SYNC0 after the same time in every cycle.

use isocat_wire::time::{Picos, Time, True};

use super::Mark;
use crate::statistics::Statistics;

/// Watches the time from the acting pulse to valid outputs of one SubDevice.
#[derive(Clone, Debug, Default)]
// In this order: all that a regular cycle touches lies together, and first.
#[repr(C)]
pub struct OutputsDelay {
    sync0: Mark<True>,
    delay: Statistics,
    limit: Picos,
    first_beyond: Option<Time<True>>,
}

impl OutputsDelay {
    /// A judge that allows a spread of at most `limit`.
    pub fn new(limit: Picos) -> Self {
        Self { limit, ..Self::default() }
    }

    /// Takes an acting SYNC0.
    pub fn sync0(&mut self, at: Time<True>) {
        self.sync0.set(at);
    }

    /// Takes the instant at which outputs became valid.
    pub fn valid(&mut self, at: Time<True>) {
        if let Some(sync0) = self.sync0.take() {
            self.take(sync0, at);
        }
    }

    /// Takes an acting SYNC0, and the instant at which outputs became valid.
    #[inline]
    pub(crate) fn cycle(&mut self, sync0: Time<True>, at: Time<True>) {
        self.sync0.clear();
        self.take(sync0, at);
    }

    #[inline(always)]
    fn take(&mut self, sync0: Time<True>, at: Time<True>) {
        // Only a value further out than all before makes the spread larger.
        if self.delay.widens((at - sync0).0)
            && self.spread() > self.limit
            && self.first_beyond.is_none()
        {
            self.first_beyond = Some(at);
        }
    }

    /// Time from SYNC0 to valid outputs.
    pub fn delay(&self) -> &Statistics {
        &self.delay
    }

    /// Longest less shortest time.
    pub fn spread(&self) -> Picos {
        Picos(self.delay.largest() - self.delay.least())
    }

    /// The largest spread allowed.
    pub fn limit(&self) -> Picos {
        self.limit
    }

    /// When the spread first exceeded the limit.
    pub fn first_beyond(&self) -> Option<Time<True>> {
        self.first_beyond
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_sides_of_the_limit() {
        let limit = Picos(1_000_000);
        let mut judge = OutputsDelay::new(limit);
        for (cycle, delay) in [(0, 30_000_000), (1_000_000_000, 31_000_000)] {
            judge.sync0(Time::new(cycle));
            judge.valid(Time::new(cycle + delay));
        }
        assert_eq!((judge.spread(), judge.first_beyond()), (limit, None));
        judge.sync0(Time::new(2_000_000_000));
        judge.valid(Time::new(2_031_000_001));
        assert_eq!(judge.first_beyond(), Some(Time::new(2_031_000_001)));
    }
}
