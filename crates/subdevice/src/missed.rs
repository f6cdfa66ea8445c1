//! The counter of missed SM events, sub-index 0B of the sync objects.

use crate::description::MissedEvents;

/// The counter and its rule.
///
/// It leaks: an event that came takes one, a missing one adds three, so that it tells frequent losses
/// from rare ones. It does not grow once it is above the limit.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) struct MissedCounter {
    count: u16,
    /// SYNC0 pulses since the last event, as far as the Slave Stack Code counts them.
    window: u8,
}

impl MissedCounter {
    /// A SYNC0 pulse; `updated` says whether the event that must come before it came.
    pub fn sync0(&mut self, updated: bool, rule: MissedEvents, limit: u16) {
        let missed = match rule {
            MissedEvents::Counted => !updated,
            MissedEvents::SlaveStackCode => {
                if updated {
                    self.window = 0;
                }
                let missed = self.window > GRACE;
                self.window = (self.window + 1).min(GRACE + 1);
                missed
            }
        };
        if updated {
            self.count = self.count.saturating_sub(1);
        }
        if missed && self.count <= limit {
            self.count = self.count.saturating_add(PENALTY);
        }
    }

    /// The inputs of a device without outputs were read: the count starts anew.
    pub fn restart(&mut self) {
        self.count = 0;
    }

    /// Clears the count.
    pub fn clear(&mut self) {
        *self = Self::default();
    }

    /// Value of sub-index 0B.
    pub const fn count(&self) -> u16 {
        self.count
    }

    /// Whether so many events are missing that the device must leave OP.
    pub fn exceeded(&self, rule: MissedEvents, limit: u16) -> bool {
        match rule {
            MissedEvents::Counted => self.count > limit,
            MissedEvents::SlaveStackCode => self.count >= limit.max(1),
        }
    }
}

/// What a missing event adds.
const PENALTY: u16 = 3;
/// Missing events that the Slave Stack Code lets pass.
const GRACE: u8 = 1;

#[cfg(test)]
mod tests {
    use super::*;

    /// Counts after each SYNC0, and at which SYNC0 the limit is exceeded.
    fn run(
        rule: MissedEvents,
        limit: u16,
        updates: &[bool],
    ) -> (std::vec::Vec<u16>, Option<usize>) {
        let mut counter = MissedCounter::default();
        let mut exceeded = None;
        let counts = updates.iter().enumerate().map(|(cycle, &updated)| {
            counter.sync0(updated, rule, limit);
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

    /// Frames stop after a good one: the error comes at the fourth SYNC0, three frames missing.
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

    #[test]
    fn the_count_stops_above_the_limit_and_saturates() {
        let (counts, _) = run(MissedEvents::Counted, 4, &[false; 100]);
        assert_eq!(counts.last(), Some(&6));
        let (counts, _) = run(MissedEvents::Counted, u16::MAX, &[false; 30_000]);
        assert_eq!(counts.last(), Some(&u16::MAX));
    }
}
