//! Outputs act in the cycle whose frame brought them.
//!
//! Cycle k's outputs travel in the frame that leaves in cycle k. They act in their cycle if they
//! act at the first pulse behind the instant at which that frame was to leave, of those pulses at
//! which outputs of this SubDevice act. A whole cycle later is late, however regular it is. Which
//! frame brought the outputs is known by their content: the simulator carries the frame beside the
//! buffer, so neither the plan nor the time of an event decides it.

use isocat_wire::time::{Nanos, Picos, Time, True};

use super::{Late, Opportunity};
use crate::statistics::Statistics;

/// Frames whose outputs may wait at a time: three buffers, and what the application has.
const WAITING: usize = 4;

/// What binds the outputs of a SubDevice to the cycle.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Bound {
    /// Nothing: Free Run has no cycle of the bus.
    Free,
    /// The SM2 event: outputs act before newer ones are stored. The distance of two frames is the
    /// cycle.
    Sm2(Nanos),
    /// A pulse, and which of them is the first opportunity.
    Pulse(Opportunity),
    /// A pulse, where nobody knows when frames are to leave: the first pulse behind the SM2 event.
    NextPulse {
        /// From pulse to pulse.
        pulse: Nanos,
        /// From frame to frame.
        frame: Nanos,
    },
}

/// Watches one SubDevice: which frame brought the outputs that act.
#[derive(Clone, Debug, Default)]
pub struct OutputsCycle {
    /// Pulses at which outputs act, so far, and the last one.
    pulses: u64,
    pulse: Option<Time<True>>,
    /// Frames that stored outputs, with the pulses that there had been.
    stored: [(Time<True>, u64); WAITING],
    next: usize,
    /// The frame that stored outputs last, and the one whose outputs acted last.
    newest: Time<True>,
    acted: Time<True>,
    age: Statistics,
    late: Late,
}

impl OutputsCycle {
    /// A `frame` stored outputs.
    pub fn stored(&mut self, frame: Time<True>) {
        self.newest = frame;
        self.stored[self.next] = (frame, self.pulses);
        self.next = (self.next + 1) % WAITING;
    }

    /// A pulse at which outputs act.
    pub fn pulse(&mut self, at: Time<True>) {
        self.pulses += 1;
        self.pulse = Some(at);
    }

    /// Outputs that a `frame` brought act at `at`. Outputs that act again are judged by the first
    /// time alone, and those that act first of all are not judged.
    pub fn acted(&mut self, frame: Time<True>, at: Time<True>, bound: Bound) {
        if frame == Time::ZERO || frame == self.acted {
            return;
        }
        let seen = self.acted != Time::ZERO;
        self.acted = frame;
        if !seen {
            // The first that are seen may have acted before anybody looked.
            return;
        }
        let age = at - frame;
        self.age.push(age.0);
        let cycles = match bound {
            Bound::Free => 0,
            Bound::Sm2(cycle) => self.newer(frame, cycle),
            Bound::Pulse(opportunity) => {
                self.pulse.map_or(0, |pulse| opportunity.cycles_late_since_frame(pulse - frame))
            }
            Bound::NextPulse { pulse, frame: every } => self.passed(frame, pulse, every),
        };
        self.late.take(at, cycles, age);
    }

    /// Cycles by which outputs that were stored since are newer.
    fn newer(&self, frame: Time<True>, cycle: Nanos) -> i64 {
        let newer = (self.newest - frame).0;
        if newer <= 0 {
            return 0;
        }
        let cycle = Picos::from(cycle).0.max(1);
        ((newer + cycle / 2) / cycle).max(1)
    }

    /// Cycles of frames in which pulses passed these outputs by before they acted.
    fn passed(&self, frame: Time<True>, pulse: Nanos, every: Nanos) -> i64 {
        let stored = self.stored.iter().find(|(stored, _)| *stored == frame);
        let Some((_, before)) = stored else { return 0 };
        // One of them is the pulse at which they act.
        let passed = self.pulses.saturating_sub(*before + 1) as i64;
        passed.saturating_mul(pulse.0) / pulse.0.max(every.0).max(1)
    }

    /// From the first bit of the frame at the MainDevice to the first time that its outputs act.
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
        // Outputs of long ago, which may have acted before: they say nothing.
        judge.acted(at(10), at(680), bound);
        assert_eq!((late(&judge), judge.age().count()), ((0, 0), 0));
        judge.acted(at(1_000), at(1_680), bound);
        assert_eq!((late(&judge), judge.age().largest()), ((0, 0), 680_000_000));
        judge.pulse(at(3_650));
        judge.acted(at(2_000), at(3_680), bound);
        assert_eq!((late(&judge), judge.late().first()), ((1, 1), Some(at(3_680))));
        // The same outputs act again where a frame was lost: that says nothing new of them.
        judge.pulse(at(4_650));
        judge.acted(at(2_000), at(4_680), bound);
        assert_eq!((late(&judge), judge.age().count()), ((1, 1), 2));
    }

    #[test]
    fn a_pulse_that_passes_stored_outputs_by_makes_them_late() {
        let bound = Bound::NextPulse { pulse: CYCLE, frame: CYCLE };
        let mut judge = OutputsCycle::default();
        judge.acted(at(10), at(680), bound);
        judge.stored(at(1_000));
        judge.pulse(at(1_100));
        judge.acted(at(1_000), at(1_130), bound);
        assert_eq!(late(&judge), (0, 0));
        judge.stored(at(2_000));
        judge.pulse(at(2_100));
        judge.stored(at(3_000));
        judge.pulse(at(3_100));
        judge.acted(at(2_000), at(3_130), bound);
        assert_eq!(late(&judge), (1, 1));
    }

    #[test]
    fn newer_outputs_end_a_cycle_without_pulses() {
        let mut judge = OutputsCycle::default();
        judge.acted(at(10), at(680), Bound::Free);
        judge.stored(at(1_000));
        judge.acted(at(1_000), at(1_999), Bound::Sm2(CYCLE));
        assert_eq!(late(&judge), (0, 0));
        judge.stored(at(2_000));
        judge.stored(at(3_000));
        judge.acted(at(2_000), at(3_001), Bound::Sm2(CYCLE));
        assert_eq!(late(&judge), (1, 1));
        // Free Run is bound to nothing, and an unknown origin says nothing.
        judge.acted(at(3_000), at(9_000), Bound::Free);
        judge.acted(Time::ZERO, at(9_000), Bound::Sm2(CYCLE));
        assert_eq!((late(&judge), judge.age().count()), ((1, 1), 3));
    }
}
