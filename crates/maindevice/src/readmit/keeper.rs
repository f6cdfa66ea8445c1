//! Those that are lost or out of OP: who is in hand, and when somebody is tried again.

use alloc::vec;
use alloc::vec::Vec;

use isocat_wire::time::{Host, Nanos, Time};

use super::Outcomes;
use crate::config::{Readmission, Recovery};
use crate::error::Cause;
use crate::segment::Segment;

/// What is known of those that are lost or out of OP.
#[derive(Default)]
pub(crate) struct Keeper {
    /// By position.
    absences: Vec<Absence>,
    /// How those came out of it that were being taken up.
    pub outcomes: Outcomes,
}

/// One SubDevice's troubles.
#[derive(Clone, Copy, Default)]
struct Absence {
    /// A procedure has it in hand since.
    busy: Option<Time<Host>>,
    /// Not again before.
    not_before: Time<Host>,
    /// Another device stands in its place.
    taken: bool,
    /// Attempts to bring it back to OP since it was last well.
    attempts: u32,
}

impl Keeper {
    /// For so many SubDevices.
    pub fn new(count: usize) -> Self {
        Self { absences: vec![Absence::default(); count], ..Self::default() }
    }

    /// Who of those found is to be taken up now.
    pub fn wanted(
        &self,
        places: &[Option<usize>],
        segment: &Segment,
        now: Time<Host>,
    ) -> Vec<usize> {
        let wanted = |position: &usize| {
            let absence = &self.absences[*position];
            places[*position].is_some()
                && !segment.devices[*position].admitted
                && !absence.taken
                && absence.busy.is_none()
                && now >= absence.not_before
        };
        (0..places.len().min(self.absences.len())).filter(wanted).collect()
    }

    /// A procedure has it in hand.
    pub fn begin(&mut self, position: usize, now: Time<Host>) {
        self.absences[position].busy = Some(now);
    }

    /// It is admitted; how long it took.
    pub fn admitted(&mut self, position: usize, now: Time<Host>) -> Nanos {
        let busy = self.absences[position].busy;
        self.absences[position] = Absence::default();
        now - busy.unwrap_or(now)
    }

    /// It was not admitted; when it is tried again.
    pub fn failed(
        &mut self,
        position: usize,
        cause: &Cause,
        policy: Readmission,
        now: Time<Host>,
    ) -> Option<Nanos> {
        let absence = &mut self.absences[position];
        absence.busy = None;
        absence.taken = matches!(cause, Cause::Identity { .. });
        absence.not_before = now + policy.pause;
        (!absence.taken).then_some(policy.pause)
    }

    /// Whether another device stands in its place.
    pub fn is_out(&self, position: usize) -> bool {
        self.absences.get(position).is_some_and(|absence| absence.taken)
    }

    /// Nobody stands in its place any more.
    pub fn is_absent(&mut self, position: usize) {
        self.absences[position].taken = false;
    }

    /// Whether a SubDevice that left OP is to be brought back now; which attempt it is.
    pub fn attempt(&mut self, position: usize, policy: Recovery, now: Time<Host>) -> Option<u32> {
        let absence = self.absences.get_mut(position)?;
        if absence.busy.is_some() {
            return None;
        }
        match policy {
            Recovery::Never => return None,
            Recovery::Once if absence.attempts > 0 => return None,
            Recovery::Once => {}
            Recovery::BackOff { first, longest } => {
                if absence.attempts == 0 && absence.not_before == Time::ZERO {
                    absence.not_before = now + first;
                } else if now - absence.not_before > longest {
                    // It was well for so long.
                    (absence.attempts, absence.not_before) = (0, now + first);
                }
                if now < absence.not_before {
                    return None;
                }
            }
        }
        absence.busy = Some(now);
        absence.attempts += 1;
        Some(absence.attempts)
    }

    /// An attempt to bring it back to OP ended; how long it took, and when there may be another.
    pub fn attempted(
        &mut self,
        position: usize,
        policy: Recovery,
        now: Time<Host>,
    ) -> (Nanos, Option<Nanos>) {
        let absence = &mut self.absences[position];
        let after = now - absence.busy.take().unwrap_or(now);
        let Recovery::BackOff { first, longest } = policy else { return (after, None) };
        let doubled = first.0.saturating_mul(1 << absence.attempts.min(30));
        let pause = Nanos(doubled.min(longest.0));
        absence.not_before = now + pause;
        (after, Some(pause))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::readmit::places::tests::fork;

    #[test]
    fn attempts_follow_the_policy() {
        let ms = |ms: u64| Time::new(1_000_000 * ms);
        let mut keeper = Keeper::new(1);
        assert_eq!(keeper.attempt(0, Recovery::Never, ms(1)), None);
        assert_eq!(keeper.attempt(0, Recovery::Once, ms(1)), Some(1));
        assert_eq!(keeper.attempt(0, Recovery::Once, ms(2)), None, "one is under way");
        assert_eq!(keeper.attempted(0, Recovery::Once, ms(5)), (Nanos::millis(4), None));
        assert_eq!(keeper.attempt(0, Recovery::Once, ms(100_000)), None);

        let policy = Recovery::BackOff { first: Nanos::millis(10), longest: Nanos::millis(30) };
        let mut keeper = Keeper::new(1);
        assert_eq!(keeper.attempt(0, policy, ms(100)), None, "the first pause begins");
        assert_eq!(keeper.attempt(0, policy, ms(110)), Some(1));
        assert_eq!(keeper.attempted(0, policy, ms(111)).1, Some(Nanos::millis(20)));
        assert_eq!(keeper.attempt(0, policy, ms(130)), None);
        assert_eq!(keeper.attempt(0, policy, ms(131)), Some(2));
        assert_eq!(keeper.attempted(0, policy, ms(131)).1, Some(Nanos::millis(30)), "no longer");
        assert_eq!(keeper.attempt(0, policy, ms(161)), Some(3));
        assert_eq!(keeper.attempted(0, policy, ms(161)).1, Some(Nanos::millis(30)));
        // Well for longer than the longest pause: it begins anew.
        assert_eq!(keeper.attempt(0, policy, ms(300)), None);
        assert_eq!(keeper.attempt(0, policy, ms(310)), Some(1));
    }

    #[test]
    fn another_device_is_not_asked_again_until_it_is_gone() {
        let ms = |ms: u64| Time::new(1_000_000 * ms);
        let (mut keeper, mut segment) = (Keeper::new(4), fork());
        segment.devices[3].admitted = false;
        let places = [Some(0), Some(1), Some(2), Some(3)];
        let policy = Readmission { pause: Nanos::millis(10) };
        let place = crate::Place { position: 3, name: Default::default() };
        let other = Cause::Identity { place, expected: (1, 2), found: (1, 3) };
        assert_eq!(keeper.wanted(&places, &segment, ms(1)), [3]);
        keeper.begin(3, ms(1));
        assert_eq!(keeper.wanted(&places, &segment, ms(1)), []);
        assert_eq!(keeper.failed(3, &other, policy, ms(2)), None);
        assert_eq!(keeper.wanted(&places, &segment, ms(1_000)), []);
        keeper.is_absent(3);
        assert_eq!(keeper.wanted(&places, &segment, ms(1_000)), [3]);
        keeper.begin(3, ms(1_000));
        assert_eq!(keeper.failed(3, &Cause::Empty, policy, ms(1_001)), Some(policy.pause));
        assert_eq!(keeper.wanted(&places, &segment, ms(1_010)), []);
        assert_eq!(keeper.wanted(&places, &segment, ms(1_011)), [3]);
        assert_eq!(keeper.admitted(3, ms(1_012)), Nanos::ZERO);
    }
}
