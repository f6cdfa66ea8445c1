//! Checks that outputs act in the cycle whose frame brought them.
//!
//! Cycle k's outputs travel in the frame that leaves in cycle k. They are in their cycle if they
//! act at the first acting pulse of this SubDevice after the intended send time of that frame. A
//! whole cycle later is late, even if it is regular. The frame of the outputs is known by their
//! content: the simulator carries the frame next to the buffer, so neither the plan nor the time of
//! an event decides it.

use isocat_wire::time::{Nanos, Picos, Time, True};

use super::{Late, Mark, Opportunity};
use crate::statistics::Statistics;

/// Most frames whose outputs wait at a time: three buffers, and the outputs of the application.
const WAITING: usize = 4;

/// How the outputs of a SubDevice are bound to the cycle.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Bound {
    /// They are not bound: Free Run has no bus cycle.
    #[default]
    Free,
    /// To the SM2 event: outputs act before newer ones are stored. The value is the time from frame
    /// to frame.
    Sm2(Picos),
    /// To a pulse; the opportunity tells the first one.
    Pulse(Opportunity),
    /// To the first pulse after the SM2 event, if the send times of frames are unknown.
    NextPulse {
        /// Time from pulse to pulse.
        pulse: Nanos,
        /// Time from frame to frame.
        frame: Nanos,
    },
}

/// Watches which frame brought the acting outputs of one SubDevice.
#[derive(Clone, Debug, Default)]
// In this order: all that a regular cycle touches lies together, and last.
#[repr(C)]
pub struct OutputsCycle {
    late: Late,
    /// Frames that stored outputs, with the number of pulses at that time.
    stored: [(Time<True>, u64); WAITING],
    next: usize,
    /// The last frame that stored outputs.
    newest: Time<True>,
    /// The frame whose outputs acted last.
    acted: Time<True>,
    /// Number of acting pulses so far, and the last one.
    pulses: u64,
    pulse: Mark<True>,
    age: Statistics,
}

impl OutputsCycle {
    /// Takes a `frame` that stored outputs.
    #[inline]
    pub fn stored(&mut self, frame: Time<True>) {
        self.newest = frame;
        self.stored[self.next % WAITING] = (frame, self.pulses);
        self.next = self.next.wrapping_add(1);
    }

    /// Takes a pulse at which outputs act.
    #[inline]
    pub fn pulse(&mut self, at: Time<True>) {
        self.pulses += 1;
        self.pulse.set(at);
    }

    /// Takes outputs of a `frame` that act at `at`. Outputs that act repeatedly are judged only the
    /// first time, and the very first outputs are not judged.
    #[inline(always)]
    pub fn acted(&mut self, frame: Time<True>, at: Time<True>, bound: &Bound) {
        if frame == Time::ZERO || frame == self.acted {
            return;
        }
        let seen = self.acted != Time::ZERO;
        self.acted = frame;
        if !seen {
            // The first outputs may have acted before judging began.
            return;
        }
        let age = at - frame;
        self.age.push(age.0);
        let cycles = match *bound {
            Bound::Pulse(ref opportunity) => self
                .pulse
                .get()
                .map_or(0, |pulse| opportunity.cycles_late_since_frame(pulse - frame)),
            _ => self.cycles_late(frame, bound),
        };
        self.late.take(at, cycles, age);
    }

    /// Number of cycles by which outputs are late that are bound to no opportunity.
    #[inline(never)]
    fn cycles_late(&self, frame: Time<True>, bound: &Bound) -> i64 {
        match *bound {
            Bound::Free | Bound::Pulse(_) => 0,
            Bound::Sm2(cycle) => self.newer(frame, cycle),
            Bound::NextPulse { pulse, frame: every } => self.passed(frame, pulse, every),
        }
    }

    /// Number of cycles by which the newest stored outputs are newer than these.
    #[inline]
    fn newer(&self, frame: Time<True>, cycle: Picos) -> i64 {
        let newer = (self.newest - frame).0;
        if newer <= 0 {
            return 0;
        }
        let cycle = cycle.0.max(1);
        ((newer + cycle / 2) / cycle).max(1)
    }

    /// Number of frame cycles in which pulses came before these outputs acted.
    fn passed(&self, frame: Time<True>, pulse: Nanos, every: Nanos) -> i64 {
        let stored = self.stored.iter().find(|(stored, _)| *stored == frame);
        let Some((_, before)) = stored else { return 0 };
        // The last of these pulses is the one at which they act.
        let passed = self.pulses.saturating_sub(*before + 1) as i64;
        passed.saturating_mul(pulse.0) / pulse.0.max(every.0).max(1)
    }

    /// Time from the first bit of the frame at the MainDevice to the first action of its outputs.
    pub fn age(&self) -> &Statistics {
        &self.age
    }

    /// Outputs that acted later than in their cycle.
    pub fn late(&self) -> &Late {
        &self.late
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::judge::Grid;

    const CYCLE: Nanos = Nanos::micros(1_000);

    fn at(us: u64) -> Time<True> {
        Time::new(us * 1_000_000)
    }

    fn late(judge: &OutputsCycle) -> (u64, u64) {
        (judge.late().count(), judge.late().cycles())
    }

    #[test]
    fn outputs_that_miss_their_pulse_are_a_cycle_late() {
        let [frames, pulse] = [0, 650].map(|us| Grid { cycle: CYCLE, phase: Nanos::micros(us) });
        let bound = Bound::Pulse(Opportunity::new(frames, pulse).unwrap());
        let mut judge = OutputsCycle::default();
        judge.pulse(at(1_650));
        // Old outputs may have acted before, so they are not judged.
        judge.acted(at(10), at(680), &bound);
        assert_eq!((late(&judge), judge.age().count()), ((0, 0), 0));
        judge.acted(at(1_000), at(1_680), &bound);
        assert_eq!((late(&judge), judge.age().largest()), ((0, 0), 680_000_000));
        judge.pulse(at(3_650));
        judge.acted(at(2_000), at(3_680), &bound);
        assert_eq!((late(&judge), judge.late().first()), ((1, 1), Some(at(3_680))));
        // The same outputs act again after a lost frame, which is not judged again.
        judge.pulse(at(4_650));
        judge.acted(at(2_000), at(4_680), &bound);
        assert_eq!((late(&judge), judge.age().count()), ((1, 1), 2));
    }

    #[test]
    fn a_pulse_that_passes_stored_outputs_by_makes_them_late() {
        let bound = Bound::NextPulse { pulse: CYCLE, frame: CYCLE };
        let mut judge = OutputsCycle::default();
        judge.acted(at(10), at(680), &bound);
        judge.stored(at(1_000));
        judge.pulse(at(1_100));
        judge.acted(at(1_000), at(1_130), &bound);
        assert_eq!(late(&judge), (0, 0));
        judge.stored(at(2_000));
        judge.pulse(at(2_100));
        judge.stored(at(3_000));
        judge.pulse(at(3_100));
        judge.acted(at(2_000), at(3_130), &bound);
        assert_eq!(late(&judge), (1, 1));
    }

    #[test]
    fn newer_outputs_end_a_cycle_without_pulses() {
        let mut judge = OutputsCycle::default();
        judge.acted(at(10), at(680), &Bound::Free);
        judge.stored(at(1_000));
        judge.acted(at(1_000), at(1_999), &Bound::Sm2(CYCLE.into()));
        assert_eq!(late(&judge), (0, 0));
        judge.stored(at(2_000));
        judge.stored(at(3_000));
        judge.acted(at(2_000), at(3_001), &Bound::Sm2(CYCLE.into()));
        assert_eq!(late(&judge), (1, 1));
        // Free Run has no bound, and outputs of unknown origin are not judged.
        judge.acted(at(3_000), at(9_000), &Bound::Free);
        judge.acted(Time::ZERO, at(9_000), &Bound::Sm2(CYCLE.into()));
        assert_eq!((late(&judge), judge.age().count()), ((1, 1), 3));
    }
}
