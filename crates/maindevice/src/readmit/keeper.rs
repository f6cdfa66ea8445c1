//! SubDevices that are lost or out of OP: which of them a procedure handles, and when the next
//! attempt is.

use alloc::vec;
use alloc::vec::Vec;

use isocat_wire::time::{Host, Nanos, Time};

use super::Outcomes;
use crate::config::{Readmission, Recovery};
use crate::error::Cause;
use crate::segment::Segment;

/// What is known of the SubDevices that are lost or out of OP.
#[derive(Default)]
pub(crate) struct Keeper {
    /// By position.
    absences: Vec<Absence>,
    /// Results of the re-admissions.
    pub outcomes: Outcomes,
}

/// The state of one SubDevice.
#[derive(Clone, Copy, Default)]
struct Absence {
    /// Since when a procedure handles it; `None`: none does.
    busy: Option<Time<Host>>,
    /// No further attempt before this time.
    not_before: Time<Host>,
    /// Whether another device is in its place, or it failed in bring-up. It is not tried again
    /// before it is absent.
    taken: bool,
    /// Whether it was out of OP when its state was last read.
    fallen: bool,
    /// When it was first seen in OP again after it last left OP; `None` before that, and if it
    /// never left OP.
    well_since: Option<Time<Host>>,
    /// Number of attempts to recover it since it was last in order.
    attempts: u32,
    /// How often it kept its error through an acknowledgement since it was last recovered.
    kept_error: u32,
}

impl Keeper {
    /// A keeper for `count` SubDevices.
    pub fn new(count: usize) -> Self {
        Self { absences: vec![Absence::default(); count], ..Self::default() }
    }

    /// The SubDevices to re-admit now.
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

    /// Called when it was left out in bring-up: it is not tried again before it is absent.
    pub fn leave_out(&mut self, position: usize) {
        self.absences[position].taken = true;
    }

    /// Called when a procedure starts to handle it.
    pub fn begin(&mut self, position: usize, now: Time<Host>) {
        self.absences[position].busy = Some(now);
    }

    /// Called when it is admitted; returns the time that it took.
    pub fn admitted(&mut self, position: usize, now: Time<Host>) -> Nanos {
        let busy = self.absences[position].busy;
        self.absences[position] = Absence::default();
        now - busy.unwrap_or(now)
    }

    /// Called when it was not admitted; returns the time until the next attempt.
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

    /// Whether another device is in its place.
    pub fn is_out(&self, position: usize) -> bool {
        self.absences.get(position).is_some_and(|absence| absence.taken)
    }

    /// Called when no SubDevice answers in its place any more.
    pub fn is_absent(&mut self, position: usize) {
        self.absences[position].taken = false;
    }

    /// The number of the attempt if a SubDevice that left OP is to be recovered now.
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
                if !absence.fallen {
                    absence.fallen = true;
                    if absence.well_since.is_some_and(|since| now - since > longest) {
                        absence.attempts = 0;
                    }
                    if absence.attempts == 0 {
                        absence.not_before = now + first;
                    }
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

    /// Called when a SubDevice is in OP.
    pub fn is_well(&mut self, position: usize, now: Time<Host>) {
        let Some(absence) = self.absences.get_mut(position) else { return };
        if core::mem::take(&mut absence.fallen) {
            absence.well_since = Some(now);
            absence.kept_error = 0;
        }
    }

    /// Called when a SubDevice no longer answers: it is lost, and no longer counts as out of OP.
    pub fn is_lost(&mut self, position: usize) {
        if let Some(absence) = self.absences.get_mut(position) {
            // Its attempt ends too, so that it can be re-admitted.
            (absence.fallen, absence.busy) = (false, None);
        }
    }

    /// When the next attempt to recover a SubDevice may begin; `None` if none is planned.
    pub fn next_attempt(&self) -> Option<Time<Host>> {
        let waits = |absence: &&Absence| absence.fallen && absence.busy.is_none();
        self.absences.iter().filter(waits).map(|absence| absence.not_before).min()
    }

    /// Whether acknowledging its error has not helped often enough, so that only INIT is left.
    pub fn needs_init(&self, position: usize) -> bool {
        let kept = |absence: &Absence| absence.kept_error >= ACKNOWLEDGEMENTS;
        self.absences.get(position).is_some_and(kept)
    }

    /// Called when a SubDevice kept its error through an acknowledgement.
    pub fn kept_error(&mut self, position: usize) {
        let absence = &mut self.absences[position];
        absence.kept_error = absence.kept_error.saturating_add(1);
    }

    /// Called at the end of an attempt; `well` if the SubDevice is in OP. Returns the time that it
    /// took, and the time until another attempt.
    pub fn attempted(
        &mut self,
        position: usize,
        policy: Recovery,
        now: Time<Host>,
        well: bool,
    ) -> (Nanos, Option<Nanos>) {
        if well {
            self.is_well(position, now);
            self.absences[position].kept_error = 0;
        }
        let absence = &mut self.absences[position];
        let after = now - absence.busy.take().unwrap_or(now);
        let Recovery::BackOff { first, longest } = policy else { return (after, None) };
        let doubled = first.0.saturating_mul(1 << absence.attempts.min(30));
        let pause = Nanos(doubled.min(longest.0));
        absence.not_before = now + pause;
        (after, Some(pause))
    }
}

/// Acknowledgements that may be in vain before INIT: a device that is busy may miss one.
const ACKNOWLEDGEMENTS: u32 = 3;

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
        assert_eq!(keeper.attempted(0, Recovery::Once, ms(5), false), (Nanos::millis(4), None));
        assert_eq!(keeper.attempt(0, Recovery::Once, ms(100_000)), None);

        let policy = Recovery::BackOff { first: Nanos::millis(10), longest: Nanos::millis(30) };
        let mut keeper = Keeper::new(1);
        let failed = |keeper: &mut Keeper, at| keeper.attempted(0, policy, ms(at), false).1;
        assert_eq!(keeper.next_attempt(), None);
        assert_eq!(keeper.attempt(0, policy, ms(100)), None, "the first pause begins");
        assert_eq!(keeper.next_attempt(), Some(ms(110)));
        assert_eq!(keeper.attempt(0, policy, ms(110)), Some(1));
        assert_eq!(keeper.next_attempt(), None, "one is under way");
        assert_eq!(failed(&mut keeper, 111), Some(Nanos::millis(20)));
        assert_eq!(keeper.attempt(0, policy, ms(130)), None);
        assert_eq!(keeper.attempt(0, policy, ms(131)), Some(2));
        assert_eq!(failed(&mut keeper, 131), Some(Nanos::millis(30)), "no longer");
        assert_eq!(keeper.attempt(0, policy, ms(161)), Some(3));
        assert_eq!(keeper.attempted(0, policy, ms(161), true).1, Some(Nanos::millis(30)));
        // It was in OP for exactly the longest pause, so the next attempt continues the count.
        assert_eq!(keeper.attempt(0, policy, ms(191)), Some(4));
        assert_eq!(keeper.attempted(0, policy, ms(191), true).1, Some(Nanos::millis(30)));
        // It was longer in OP, so the count starts again.
        assert_eq!(keeper.attempt(0, policy, ms(222)), None);
        assert_eq!(keeper.attempt(0, policy, ms(231)), None);
        assert_eq!(keeper.attempt(0, policy, ms(232)), Some(1));
    }

    #[test]
    fn a_kept_error_leads_to_init_after_three_acknowledgements() {
        let ms = |ms: u64| Time::new(1_000_000 * ms);
        let mut keeper = Keeper::new(1);
        for _ in 0..2 {
            keeper.kept_error(0);
            assert!(!keeper.needs_init(0));
        }
        keeper.kept_error(0);
        assert!(keeper.needs_init(0));
        keeper.attempted(0, Recovery::Never, ms(1), false);
        assert!(keeper.needs_init(0), "nothing else has helped meanwhile");
        keeper.attempted(0, Recovery::Never, ms(2), true);
        assert!(!keeper.needs_init(0));
    }

    /// The states may be read more seldom than both pauses together; a late reading is no recovery.
    #[test]
    fn a_look_that_comes_late_is_no_recovery() {
        let ms = |ms: u64| Time::new(1_000_000 * ms);
        let policy = Recovery::BackOff { first: Nanos::millis(50), longest: Nanos::millis(500) };
        let mut keeper = Keeper::new(1);
        assert_eq!(keeper.attempt(0, policy, ms(1_000)), None);
        assert_eq!(keeper.attempt(0, policy, ms(2_000)), Some(1));
        keeper.attempted(0, policy, ms(2_010), false);
        assert_eq!(keeper.attempt(0, policy, ms(9_000)), Some(2), "it was not well in between");
        keeper.attempted(0, policy, ms(9_010), false);
        // When it is lost, its planned attempt is dropped.
        keeper.is_lost(0);
        assert_eq!(keeper.next_attempt(), None);
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
