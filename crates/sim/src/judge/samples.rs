//! A device that oversamples has whole sets: as many SYNC0 pulses as samples from one set to the
//! next.

use isocat_wire::time::{Time, True};

use crate::statistics::Statistics;

/// Watches the samples of one SubDevice in one direction.
#[derive(Clone, Debug, Default)]
pub struct Samples {
    last: Option<Time<True>>,
    distance: Statistics,
    /// Pulses of the present set, and when the last one was.
    pulses: u64,
    last_pulse: Time<True>,
    /// A set was seen from its beginning.
    begun: bool,
    /// No sample of the outputs acted since they were valid.
    silent: bool,
    sets: u64,
    incomplete: u64,
    first: Option<(Time<True>, u64)>,
}

impl Samples {
    /// The SubDevice changed its state: what it was at is no set, and the next sample follows none.
    pub fn interrupted(&mut self) {
        (self.last, self.pulses, self.begun, self.silent) = (None, 0, false, false);
    }

    /// A pulse that takes a sample, or at which one is to act.
    pub fn pulse(&mut self, at: Time<True>) {
        self.pulses += 1;
        self.last_pulse = at;
    }

    /// A sample was taken, or began to act.
    pub fn sample(&mut self, at: Time<True>) {
        // One that the first sample of the next set takes the place of at once never acted.
        if let Some(last) = self.last.replace(at).filter(|last| *last != at) {
            self.distance.push((at - last).0);
        }
        self.silent = false;
    }

    /// A set of inputs was handed over, with the samples of all pulses so far. It ought to have so
    /// many. The first one is not counted: the judging began within it.
    pub fn handed_over(&mut self, at: Time<True>, expected: u64) {
        let found = std::mem::take(&mut self.pulses);
        self.next_set(at, found, expected);
    }

    /// A sample of inputs was taken that none hands over: twice as many as a set has are one set
    /// that was missed.
    pub fn waits(&mut self, at: Time<True>, expected: u64) {
        if self.pulses > expected.saturating_mul(2) {
            let found = std::mem::replace(&mut self.pulses, 1) - 1;
            self.count(at, false, found);
        }
    }

    /// A set of outputs begins to act. The pulse of this instant belongs to it, those before to the
    /// last one.
    pub fn begins(&mut self, at: Time<True>, expected: u64) {
        let own = u64::from(self.last_pulse == at && self.pulses > 0);
        let found = std::mem::replace(&mut self.pulses, own) - own;
        self.next_set(at, found, expected);
    }

    /// Outputs are valid: where no sample acted since the last time, the set that came was not
    /// given at all.
    pub fn valid(&mut self, at: Time<True>) {
        if std::mem::replace(&mut self.silent, true) {
            self.count(at, false, 0);
        }
    }

    fn next_set(&mut self, at: Time<True>, found: u64, expected: u64) {
        if std::mem::replace(&mut self.begun, true) {
            self.count(at, found == expected, found);
        }
    }

    fn count(&mut self, at: Time<True>, is_whole: bool, found: u64) {
        self.sets += 1;
        if !is_whole {
            self.incomplete += 1;
            self.first.get_or_insert((at, found));
        }
    }

    /// From one sample to the next, across sets.
    pub fn distance(&self) -> &Statistics {
        &self.distance
    }

    /// Sets that were handed over, or given.
    pub fn sets(&self) -> u64 {
        self.sets
    }

    /// Sets with more or fewer samples than they ought to have.
    pub fn incomplete(&self) -> u64 {
        self.incomplete
    }

    /// When the first of these was handed over, and how many samples it had.
    pub fn first_incomplete(&self) -> Option<(Time<True>, u64)> {
        self.first
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn take(judge: &mut Samples, at: u64) {
        judge.sample(Time::new(at));
        judge.pulse(Time::new(at));
        judge.waits(Time::new(at), 4);
    }

    #[test]
    fn a_set_of_inputs_is_whole_with_exactly_its_samples() {
        let mut judge = Samples::default();
        let mut now = 0;
        let mut set = |judge: &mut Samples, samples: u64| {
            for _ in 0..samples {
                now += 100;
                take(judge, now);
            }
            judge.handed_over(Time::new(now), 4);
        };
        // The judging began in the middle of it.
        set(&mut judge, 2);
        set(&mut judge, 4);
        assert_eq!((judge.sets(), judge.incomplete()), (1, 0));
        set(&mut judge, 3);
        set(&mut judge, 5);
        set(&mut judge, 0);
        assert_eq!((judge.sets(), judge.incomplete()), (4, 3));
        assert_eq!(judge.first_incomplete(), Some((Time::new(900), 3)));
        assert_eq!((judge.distance().count(), judge.distance().least()), (13, 100));
    }

    #[test]
    fn a_set_that_is_never_handed_over_is_found() {
        let mut judge = Samples::default();
        (1..=8).for_each(|now| take(&mut judge, now));
        assert_eq!(judge.incomplete(), 0, "the next one may be late");
        take(&mut judge, 9);
        assert_eq!(judge.first_incomplete(), Some((Time::new(9), 8)));
    }

    /// The last pulse of a set comes with the one at which the next set begins, or before it.
    #[test]
    fn a_set_of_outputs_is_whole_with_exactly_its_pulses() {
        let found = |pulses: u64| {
            let mut judge = Samples::default();
            for pulse in 0..=3 * pulses {
                let at = Time::new(1_000 + 100 * pulse);
                judge.pulse(at);
                judge.sample(at);
                if pulse.is_multiple_of(pulses) {
                    judge.begins(at, 4);
                    judge.sample(at);
                }
            }
            let distance = judge.distance();
            assert_eq!((distance.least(), distance.largest()), (100, 100));
            (judge.sets(), judge.incomplete(), judge.first_incomplete().map(|(_, found)| found))
        };
        assert_eq!(found(3), (3, 3, Some(3)));
        assert_eq!(found(4), (3, 0, None));
        assert_eq!(found(5), (3, 3, Some(5)));
    }

    #[test]
    fn what_a_change_of_state_interrupts_is_no_set() {
        let mut judge = Samples::default();
        for now in [10, 20, 30, 990, 1_000] {
            if now == 990 {
                judge.interrupted();
            }
            judge.sample(Time::new(now));
            judge.pulse(Time::new(now));
            judge.handed_over(Time::new(now), 1);
        }
        assert_eq!((judge.sets(), judge.incomplete()), (3, 0));
        assert_eq!((judge.distance().count(), judge.distance().largest()), (3, 10));
    }

    #[test]
    fn outputs_that_no_sample_gives_are_found() {
        let mut judge = Samples::default();
        // The judging began behind the samples of this one.
        judge.valid(Time::new(5));
        for now in [10, 20] {
            judge.pulse(Time::new(now));
            judge.begins(Time::new(now), 1);
            judge.sample(Time::new(now));
            judge.valid(Time::new(now + 5));
        }
        assert_eq!((judge.sets(), judge.incomplete()), (1, 0));
        judge.valid(Time::new(35));
        assert_eq!(judge.first_incomplete(), Some((Time::new(35), 0)));
        judge.valid(Time::new(45));
        assert_eq!(judge.incomplete(), 2);
    }
}
