//! Checks that inputs arrive with the first frame after their event.
//!
//! The event is the pulse (or the SM event) that starts the latch, not the latch itself: a shift of
//! Input Latch moves the latch within its cycle. Inputs that come with a later frame are a whole
//! cycle late, even if they are regularly late. The inputs of a frame are known by their content,
//! as in [`super::OutputsCycle`].

use isocat_wire::time::{Device, Picos, Time, True};

use super::{Late, Opportunity};
use crate::statistics::Statistics;

/// Most inputs in transit at a time: three buffers, and those that are being copied.
const UNDER_WAY: usize = 4;

/// How the inputs of a SubDevice are bound to the cycle.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Bound {
    /// They are not bound, or the send times of frames are unknown.
    #[default]
    Free,
    /// To the event of a frame. The inputs are due with the next frame if a timer shifts their
    /// latch. Otherwise they must be in the buffer at the next event, when the next frame has
    /// passed, so they are due with the frame after it.
    Frame(FrameBound),
    /// To a pulse; the opportunity tells the first frame.
    Pulse(Opportunity),
}

/// How inputs are bound to the event of a frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct FrameBound {
    /// Time from frame to frame.
    cycle: Picos,
    /// The number of the frame with which they are due, counted from the frame of the event.
    due: i64,
    /// The time from frame to frame from which on they are late.
    late: Picos,
}

impl FrameBound {
    /// The binding with frames every `cycle`, if 0x1C33:03 shifts the latch (`shifted`) or not.
    pub fn new(cycle: Picos, shifted: bool) -> Self {
        let (cycle, due) = (cycle.max(Picos(1)), if shifted { 1 } else { 2 });
        let late = Picos((due + 1i64).saturating_mul(cycle.0)) - Picos(cycle.0 / 2);
        Self { cycle, due, late }
    }

    /// Number of cycles by which inputs were late that came `since` after the frame of their event.
    #[inline]
    fn cycles_late(&self, since: Picos) -> i64 {
        // As a rule they are in time, and nothing is to be divided.
        if since < self.late { 0 } else { (since.0 + self.cycle.0 / 2) / self.cycle.0 - self.due }
    }
}

/// Inputs that were fetched.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Fetched {
    /// The frame that fetched them.
    pub frame: Time<True>,
    /// When they were latched, as told to [`InputsCycle::latched`].
    pub latched: Time<Device>,
    /// When the last bit of the frame arrives at the MainDevice.
    pub arrive: Time<True>,
}

/// Watches which inputs the frames of one SubDevice bring.
#[derive(Clone, Debug, Default)]
// In this order: all that a regular cycle touches lies together, and last.
#[repr(C)]
pub struct InputsCycle {
    late: Late,
    age: Statistics,
    /// The last event that starts a latch: a pulse, or the frame of an SM event.
    event: Time<True>,
    next: usize,
    latched: [Latch; UNDER_WAY],
}

/// A latch of inputs.
#[derive(Clone, Copy, Debug, Default)]
struct Latch {
    at: Time<Device>,
    /// The same in true time.
    true_at: Time<True>,
    /// The event that started it.
    event: Time<True>,
}

impl InputsCycle {
    /// Takes an event that starts a latch: the time of the pulse, or for an SM event the send time
    /// of its frame.
    #[inline]
    pub fn event(&mut self, at: Time<True>) {
        self.event = at;
    }

    /// Takes a latch of inputs, with its true time.
    #[inline]
    pub fn latched(&mut self, at: Time<Device>, true_at: Time<True>) {
        self.latched[self.next % UNDER_WAY] = Latch { at, true_at, event: self.event };
        self.next = self.next.wrapping_add(1);
    }

    /// Takes inputs that no earlier frame had fetched; `true_time` converts the time of a latch
    /// that was not seen.
    #[inline(always)]
    pub fn fetched(
        &mut self,
        fetched: &Fetched,
        bound: &Bound,
        true_time: impl FnOnce(Time<Device>) -> Time<True>,
    ) {
        let known = self.find(fetched.latched);
        let unknown = || (true_time(fetched.latched), Time::ZERO);
        let (true_at, event) = known.map_or_else(unknown, |latch| (latch.true_at, latch.event));
        let age = fetched.arrive - true_at;
        self.age.push(age.0);
        if event == Time::ZERO {
            return;
        }
        let since = fetched.frame - event;
        let cycles = match *bound {
            Bound::Pulse(ref opportunity) => opportunity.cycles_late_until_frame(since),
            Bound::Frame(ref frame) => frame.cycles_late(since),
            Bound::Free => 0,
        };
        self.late.take(fetched.arrive, cycles, age);
    }

    /// The latch at this time.
    #[inline]
    fn find(&self, at: Time<Device>) -> Option<&Latch> {
        // As a rule it is the last one. Of two at the same time, which follow each other, the
        // search finds one.
        let [last, before] =
            [1, 2].map(|back| &self.latched[self.next.wrapping_sub(back) % UNDER_WAY]);
        if last.at == at && before.at != at {
            return Some(last);
        }
        self.latched.iter().find(|latch| latch.at == at)
    }

    /// Time from Input Latch to the last bit of the first frame with these inputs at the
    /// MainDevice.
    pub fn age(&self) -> &Statistics {
        &self.age
    }

    /// Inputs that came with a later frame than the first.
    pub fn late(&self) -> &Late {
        &self.late
    }
}

#[cfg(test)]
mod tests {
    use isocat_wire::Nanos;

    use super::*;
    use crate::judge::Grid;

    const CYCLE: Nanos = Nanos::micros(1_000);

    fn at(us: u64) -> Time<True> {
        Time::new(us * 1_000_000)
    }

    /// Latches inputs after an event, and fetches them by a frame that is back 10 us later.
    fn fetch(judge: &mut InputsCycle, event: u64, latch: u64, frame: u64, bound: Bound) {
        judge.event(at(event));
        let latched = Time::new(latch * 1_000);
        judge.latched(latched, at(latch));
        let arrive = at(frame + 10);
        judge.fetched(&Fetched { frame: at(frame), latched, arrive }, &bound, |_| at(latch));
    }

    #[test]
    fn a_latch_behind_the_frame_comes_with_the_next_one() {
        let [pulse, frames] = [650, 0].map(|us| Grid { cycle: CYCLE, phase: Nanos::micros(us) });
        let bound = Bound::Pulse(Opportunity::new(pulse, frames).unwrap());
        let mut judge = InputsCycle::default();
        fetch(&mut judge, 5_650, 5_990, 6_000, bound);
        assert_eq!((judge.late().count(), judge.age().largest()), (0, 20_000_000));
        fetch(&mut judge, 6_650, 7_150, 8_000, bound);
        assert_eq!((judge.late().count(), judge.late().cycles()), (1, 1));
        assert_eq!(judge.late().first(), Some(at(8_010)));
        assert_eq!(judge.late().age(), Nanos::micros(860).into());
    }

    #[test]
    fn inputs_of_a_frame_come_with_the_next_frame_or_the_one_behind_it() {
        let mut judge = InputsCycle::default();
        let bound = |shifted| Bound::Frame(FrameBound::new(CYCLE.into(), shifted));
        fetch(&mut judge, 1_000, 1_900, 2_000, bound(true));
        fetch(&mut judge, 2_000, 2_900, 3_020, bound(true));
        // It was done when the next frame was in flight, which is in time for the next event.
        fetch(&mut judge, 3_000, 3_990, 5_000, bound(false));
        assert_eq!(judge.late().count(), 0);
        fetch(&mut judge, 5_000, 5_999, 7_000, bound(true));
        assert_eq!((judge.late().count(), judge.late().cycles()), (1, 1));
        fetch(&mut judge, 7_000, 8_500, 10_000, bound(false));
        assert_eq!((judge.late().count(), judge.late().cycles()), (2, 1));
    }

    #[test]
    fn what_was_latched_before_anybody_looked_has_an_age_only() {
        let mut judge = InputsCycle::default();
        let latched = Time::new(500_000);
        let fetched = Fetched { frame: at(9_000), latched, arrive: at(9_010) };
        let bound = Bound::Frame(FrameBound::new(CYCLE.into(), true));
        judge.fetched(&fetched, &bound, |_| at(500));
        assert_eq!((judge.late().count(), judge.age().count()), (0, 1));
    }
}
