//! Compares the times at which frames met the reference clock with the slack of each SubDevice in
//! the plan.
//!
//! The drift datagram returns the time at which its frame met the reference clock, so the host's
//! time stamps are not involved. From there to the SubDevices the delays are those of the plan. A
//! frame that was later than a SubDevice's slack brought outputs too late for its pulse. A frame
//! that was too early either fetched inputs that were not ready, or brought outputs before those of
//! the previous cycle had acted, or so early that they count as late outputs of that cycle.

use isocat_maindevice::segment::Timing;
use isocat_sim::{Judged, Place};
use isocat_sync::SyncMode;
use isocat_sync::budget::Check;
use isocat_wire::time::Nanos;

use super::{Gap, Verdict, Witness};

/// The frames of all cycles, and their effect on each SubDevice.
pub(super) struct Frames {
    /// By position; `None` without SYNC pulses, or without a reference clock.
    rooms: Vec<Option<Room>>,
    /// The least room of all: a frame within it is in time for every SubDevice.
    least: (Nanos, Nanos),
}

/// The range around the planned time in which frames may meet the reference clock, for one
/// SubDevice.
#[derive(Clone, Copy, Debug)]
pub(super) struct Room {
    late: Side,
    early: Side,
}

#[derive(Clone, Copy, Debug)]
struct Side {
    /// Within this limit, outputs or inputs are in time with the worst clocks that the plan
    /// assumes.
    safe: Nanos,
    /// Beyond this limit they are not in time, even with the best clocks.
    sure: Nanos,
    beyond: Count,
    between: Count,
}

#[derive(Clone, Copy, Default, Debug)]
struct Count {
    cycles: u64,
    worst: Nanos,
    since: Option<Nanos>,
}

impl Frames {
    pub fn new(main: &impl Witness) -> Self {
        let segment = main.segment();
        let timing = segment.timing.as_ref().filter(|_| segment.reference.is_some());
        let room = |position: usize| Room::new(timing?, position);
        let rooms: Vec<_> = (0..segment.devices.len()).map(room).collect();
        let least = |side: fn(&Room) -> Nanos| {
            rooms.iter().flatten().map(side).min().unwrap_or(Nanos(i64::MAX))
        };
        let least = (least(|room| room.late.safe), least(|room| room.early.safe));
        Self { rooms, least }
    }

    /// Whether the plan limits the lateness and earliness of frames, by position.
    pub fn rooms(&self) -> impl Fn(usize) -> bool {
        |position| self.rooms.get(position).is_some_and(Option::is_some)
    }

    /// Takes the lateness of a cycle's frame at the reference clock against the plan.
    pub fn take(&mut self, at: Nanos, error: Nanos) {
        let (late, early) = self.least;
        if error <= late && -error <= early {
            return;
        }
        for room in self.rooms.iter_mut().flatten() {
            room.late.take(at, error);
            room.early.take(at, -error);
        }
    }

    /// Adds the results; for `missing` cycles no time came back.
    pub fn end(&self, main: &impl Witness, missing: u64, verdict: &mut Verdict) {
        for (position, room) in self.rooms.iter().enumerate() {
            let Some(Room { late, early }) = room else { continue };
            let device = &main.segment().devices[position];
            if device.outputs.length == 0 && device.inputs.length == 0 {
                continue;
            }
            let place = Place::device(position);
            if let Count { cycles, worst: by, since: Some(since) } = late.beyond {
                verdict.add(place, Some(since), Judged::FramesTooLate { cycles, by });
            } else if let Count { cycles, worst: by, since: Some(_) } = late.between {
                verdict.doubt(place, Gap::OutputsMaybeLate { cycles, by });
            }
            if let Count { cycles, worst: by, since: Some(since) } = early.beyond {
                verdict.add(place, Some(since), Judged::FramesTooEarly { cycles, by });
            } else if let Count { cycles, worst: by, since: Some(_) } = early.between {
                verdict.doubt(place, Gap::FramesMaybeEarly { cycles, by });
            }
        }
        // Frames of the last two cycles may still be on the wire.
        if missing > UNDER_WAY && self.rooms.iter().any(Option::is_some) {
            verdict.doubt(Place::SEGMENT, Gap::FrameTimes { cycles: missing });
        }
    }
}

impl Room {
    fn new(timing: &Timing, position: usize) -> Option<Self> {
        let (device, budget) = timing.devices.get(position)?;
        if !device.mode.uses_dc() {
            return None;
        }
        let slack = |checks: &[Check]| {
            let lines = budget.lines().filter(|line| checks.contains(&line.check));
            lines.map(|line| line.slack()).min()
        };
        // The plan's jitter is available for late frames.
        let late = slack(&BEFORE_PULSE).map(|slack| slack + timing.cycle.jitter);
        let error = timing.cycle.clock_error;
        // Outputs that come before the pulse of the previous cycle overwrite the ones for that
        // pulse.
        let overwritten = device.outputs_arrival.zip(timing.sync0).map(|(arrival, shift)| {
            let pulse = match device.mode {
                SyncMode::DcSync1 => shift - device.pulses.lead,
                _ => shift,
            };
            let period = device.exchange(&timing.cycle).0;
            let earliest = arrival - device.frame_spread - device.ring_spread;
            Nanos((earliest - pulse).0.rem_euclid(period)) - error
        });
        // A frame that is a quarter of a cycle early counts as one of the previous cycle, and its
        // outputs act a cycle late. The host sends late rather than early, so three quarters are
        // left for late frames.
        let of_cycle_before = device.outputs_arrival.map(|_| {
            let (pulse, period) = (device.pulses.sync0_cycle, device.exchange(&timing.cycle));
            let step = if device.mode == SyncMode::DcSync0 { pulse.min(period) } else { period };
            Nanos(step.0 / 4) - error
        });
        let early = [slack(&[Check::InputsBeforeFrame]), overwritten, of_cycle_before];
        let early = early.into_iter().flatten().min();
        let side = |safe: Option<Nanos>| Side {
            safe: safe.unwrap_or(Nanos(i64::MAX)),
            sure: safe.map_or(Nanos(i64::MAX), |safe| safe + error),
            beyond: Count::default(),
            between: Count::default(),
        };
        late.or(early)?;
        Some(Self { late: side(late), early: side(early) })
    }
}

impl Side {
    fn take(&mut self, at: Nanos, error: Nanos) {
        if error <= self.safe {
            return;
        }
        let count = if error > self.sure { &mut self.beyond } else { &mut self.between };
        count.cycles += 1;
        count.worst = count.worst.max(error - self.safe);
        count.since.get_or_insert(at);
    }
}

/// The lines of the plan whose slack a late frame uses up.
const BEFORE_PULSE: [Check; 3] =
    [Check::OutputsBeforeSync0, Check::OutputsStoredBeforeSync0, Check::InputsReadBeforeSync0];
/// Cycles whose frames may not be back at the end.
const UNDER_WAY: u64 = 2;

#[cfg(test)]
mod tests {
    use super::*;

    /// At the safe limit nothing is reported, one nanosecond later the frame may be late, and
    /// beyond the clocks' error it is late.
    #[test]
    fn what_is_safe_and_what_is_sure() {
        let mut side = Side {
            safe: Nanos(1_000),
            sure: Nanos(1_200),
            beyond: Count::default(),
            between: Count::default(),
        };
        let mut counts = |error| {
            side.take(Nanos(error), Nanos(error));
            (side.between.cycles, side.beyond.cycles)
        };
        assert_eq!(counts(-5_000), (0, 0));
        assert_eq!(counts(1_000), (0, 0));
        assert_eq!(counts(1_001), (1, 0));
        assert_eq!(counts(1_200), (2, 0));
        assert_eq!(counts(1_201), (2, 1));
        assert_eq!(counts(1_300), (2, 2));
        assert_eq!((side.beyond.since, side.beyond.worst), (Some(Nanos(1_201)), Nanos(300)));
        assert_eq!((side.between.since, side.between.worst), (Some(Nanos(1_001)), Nanos(200)));
    }
}
