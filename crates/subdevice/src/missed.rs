//! The counter of missed SM events, sub-index 0B of the sync objects.

use crate::description::MissedEvents;

/// The counter and its rule.
///
/// Two rules leak: an event in time subtracts one and a missing one adds three. So frequent losses
/// differ from rare ones, and the counter does not grow once it is above the limit. The third rule
/// is the balance of events and pulses.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) struct MissedCounter {
    count: u16,
    /// Number of pulses since the last event, as far as the Slave Stack Code counts them.
    window: u32,
    /// Events minus pulses.
    balance: i16,
    /// Whether a pulse has come in OP.
    balanced: bool,
}

impl MissedCounter {
    /// Takes an event in OP: SM2, or SM3 without outputs.
    #[inline]
    pub fn event(&mut self, rule: MissedEvents) {
        if rule == MissedEvents::Balance {
            self.balance = self.balance.saturating_add(1);
        }
    }

    /// Takes the pulse at which outputs must be ready; `updated` tells whether they are. `grace`:
    /// number of pulses without an event that the Slave Stack Code ignores.
    #[inline]
    pub fn pulse(&mut self, updated: bool, op: bool, rule: MissedEvents, limit: u16, grace: u32) {
        let missed = match rule {
            MissedEvents::Counted => !updated,
            MissedEvents::SlaveStackCode => {
                if updated {
                    self.window = 0;
                }
                let missed = self.window > grace;
                self.window = self.window.saturating_add(1).min(grace.saturating_add(1));
                missed
            }
            MissedEvents::Balance => {
                // OP begins between an event and its pulse, or between a pulse and the next event.
                // The first pulse without an event then belongs to the cycle in which OP began.
                let began_between = op && !self.balanced && self.balance == 0;
                self.balanced |= op;
                if op && !began_between {
                    self.balance = self.balance.saturating_sub(1);
                }
                return;
            }
        };
        if updated {
            self.in_time();
        }
        if missed && self.count <= limit {
            self.count = self.count.saturating_add(PENALTY);
        }
    }

    /// Takes a pulse at which outputs are ready, with the rule that counts each one.
    #[inline]
    pub fn in_time(&mut self) {
        self.count = self.count.saturating_sub(1);
    }

    /// Called when the inputs of a device without outputs were read: the count starts again.
    #[inline]
    pub fn restart(&mut self) {
        self.count = 0;
    }

    /// Clears the count.
    pub fn clear(&mut self) {
        *self = Self::default();
    }

    /// Value of sub-index 0B.
    #[inline]
    pub const fn count(&self) -> u16 {
        // One of them is 0, since a device uses one rule.
        self.count.saturating_add(self.balance.unsigned_abs())
    }

    /// Whether one more missing event would not exceed the limit, with any rule.
    #[inline]
    pub const fn bears_a_miss(&self, limit: u16) -> bool {
        self.count() == 0 && limit > PENALTY
    }

    /// Whether the device must leave OP because too many events are missing.
    #[inline]
    pub fn exceeded(&self, rule: MissedEvents, limit: u16) -> bool {
        match rule {
            MissedEvents::Counted => self.count > limit,
            MissedEvents::Balance => self.balance.unsigned_abs() > limit,
            MissedEvents::SlaveStackCode => self.count >= limit.max(1),
        }
    }
}

/// Amount that a missing event adds.
const PENALTY: u16 = 3;

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the counts after each SYNC0, and the SYNC0 at which the limit is exceeded.
    fn run(
        rule: MissedEvents,
        limit: u16,
        updates: &[bool],
    ) -> (std::vec::Vec<u16>, Option<usize>) {
        let mut counter = MissedCounter::default();
        let mut exceeded = None;
        let counts = updates.iter().enumerate().map(|(cycle, &updated)| {
            if updated {
                counter.event(rule);
            }
            counter.pulse(updated, true, rule, limit, 1);
            if exceeded.is_none() && counter.exceeded(rule, limit) {
                exceeded = Some(cycle);
            }
            counter.count()
        });
        (counts.collect(), exceeded)
    }

    #[test]
    fn two_misses_in_a_row_exceed_the_default_limit() {
        let (counts, exceeded) = run(MissedEvents::Counted, 4, &[true, false, true, false, true]);
        assert_eq!(counts, [0, 3, 2, 5, 4]);
        assert_eq!(exceeded, Some(3), "one of two missing is too much");
        let (counts, exceeded) = run(MissedEvents::Counted, 4, &[true, false, false]);
        assert_eq!((counts.as_slice(), exceeded), (&[0, 3, 6][..], Some(2)));
    }

    #[test]
    fn with_a_limit_of_nine_the_fourth_miss_in_a_row_is_the_error() {
        let (counts, exceeded) = run(MissedEvents::Counted, 9, &[true, false, false, false, false]);
        assert_eq!((counts.as_slice(), exceeded), (&[0, 3, 6, 9, 12][..], Some(4)));
    }

    #[test]
    fn one_of_four_missing_does_no_harm() {
        let quarter = [false, true, true, true].repeat(1000);
        let (counts, exceeded) = run(MissedEvents::Counted, 4, &quarter);
        assert_eq!((counts.iter().max(), exceeded), (Some(&3), None));
        let third = [false, true, true].repeat(10);
        assert!(run(MissedEvents::Counted, 4, &third).1.is_some());
    }

    /// Frames stop after a good one: the error comes at the fourth SYNC0, with three frames
    /// missing.
    #[test]
    fn slave_stack_code_lets_the_first_miss_pass() {
        let rule = MissedEvents::SlaveStackCode;
        let (counts, exceeded) = run(rule, 4, &[true, false, false, false]);
        assert_eq!((counts.as_slice(), exceeded), (&[0, 0, 3, 6][..], Some(3)));
        let half = [true, false].repeat(1000);
        assert_eq!(run(rule, 4, &half).0.iter().max(), Some(&0), "single misses never count");
        let (counts, exceeded) = run(rule, 3, &[true, false, false]);
        assert_eq!((counts.as_slice(), exceeded), (&[0, 0, 3][..], Some(2)), "at the limit");
    }

    /// Every loss remains: the third one in total is the error.
    #[test]
    fn the_balance_forgets_nothing() {
        let rule = MissedEvents::Balance;
        let (counts, exceeded) = run(rule, 2, &[true, false, false, false]);
        assert_eq!((counts.as_slice(), exceeded), (&[0, 1, 2, 3][..], Some(3)));
        let (counts, exceeded) = run(rule, 2, &[true, true, false].repeat(3));
        assert_eq!((counts.as_slice(), exceeded), (&[0, 0, 1, 1, 1, 2, 2, 2, 3][..], Some(8)));
        // The cycle in which OP begins has no event.
        let (counts, _) = run(rule, 2, &[false, true, false]);
        assert_eq!(counts, [0, 0, 1]);
        // Twice as many events as pulses is also an error.
        let mut counter = MissedCounter::default();
        for _ in 0..3 {
            assert!(!counter.exceeded(rule, 2));
            counter.event(rule);
            counter.event(rule);
            counter.pulse(true, true, rule, 2, 1);
        }
        assert!(counter.exceeded(rule, 2));
        // Before OP there is no balance.
        let mut counter = MissedCounter::default();
        counter.pulse(false, false, rule, 2, 1);
        assert_eq!(counter.count(), 0);
    }

    #[test]
    fn slave_stack_code_waits_for_all_pulses_of_a_subordinated_cycle() {
        let mut counter = MissedCounter::default();
        let (rule, limit, grace) = (MissedEvents::SlaveStackCode, 4, 4);
        counter.pulse(true, true, rule, limit, grace);
        for _ in 0..4 {
            counter.pulse(false, true, rule, limit, grace);
            assert_eq!(counter.count(), 0);
        }
        counter.pulse(false, true, rule, limit, grace);
        assert_eq!(counter.count(), 3);
    }

    #[test]
    fn the_count_stops_above_the_limit_and_saturates() {
        let (counts, _) = run(MissedEvents::Counted, 4, &[false; 100]);
        assert_eq!(counts.last(), Some(&6));
        let (counts, _) = run(MissedEvents::Counted, u16::MAX, &[false; 30_000]);
        assert_eq!(counts.last(), Some(&u16::MAX));
    }
}
