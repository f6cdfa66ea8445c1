//! The host's clock, and instants that the kernel stamped with another clock.

use isocat_wire::time::{Host, Nanos, Time};
use rustix::thread::clock_nanosleep_absolute;
use rustix::time::{ClockId, Timespec};

use super::sys;

/// The present host time: `CLOCK_MONOTONIC`, ns.
pub fn now() -> Time<Host> {
    Time::new(sys::clock(libc::CLOCK_MONOTONIC))
}

/// Wall time less host time at this moment, ns. Added to later instants of the host's clock it
/// gives a wall time that does not jump.
pub fn wall_offset() -> i64 {
    sys::clock(libc::CLOCK_REALTIME).wrapping_sub(now().count()) as i64
}

/// Sleeps until an instant. A signal may end the sleep early, so the caller must check the clock
/// again.
pub fn sleep_until(at: Time<Host>) {
    let until = timespec(at - Time::ZERO);
    // The only error is a signal.
    let _ = clock_nanosleep_absolute(ClockId::Monotonic, &until);
}

/// Turns the kernel's stamps, which show `CLOCK_REALTIME`, into host time. Both clocks agree on the
/// age of a stamp, so a step of the wall clock harms at most the frames that wait at that moment:
/// an impossible age counts as zero.
#[derive(Debug)]
pub(super) struct Stamps {
    last: Time<Host>,
}

/// The longest plausible age of a stamp: a frame waits longer only if the whole process stands
/// still.
const MOST_AGE: Nanos = Nanos(1_000_000_000);

impl Stamps {
    pub fn new() -> Self {
        Self { last: Time::ZERO }
    }

    /// The instant of a stamp, but never before that of the frame before; and the present one.
    pub fn instant(&mut self, stamp: Option<u64>) -> (Time<Host>, Time<Host>) {
        let wall = sys::clock(libc::CLOCK_REALTIME);
        let now = now();
        (self.at(stamp, wall, now), now)
    }

    fn at(&mut self, stamp: Option<u64>, wall: u64, now: Time<Host>) -> Time<Host> {
        let age = stamp.map_or(0, |stamp| wall.wrapping_sub(stamp) as i64);
        let age = if (0..MOST_AGE.0).contains(&age) { age } else { 0 };
        self.last = (now + Nanos(-age)).max(self.last);
        self.last
    }
}

/// A span in the form of the kernel; zero if it is negative.
pub(super) fn timespec(span: Nanos) -> Timespec {
    let ns = span.0.max(0);
    Timespec { tv_sec: ns / 1_000_000_000, tv_nsec: ns % 1_000_000_000 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_keep_their_age_and_their_order() {
        let mut stamps = Stamps::new();
        let wall = 1_700_000_000_000_000_000;
        assert_eq!(stamps.at(Some(wall - 700), wall, Time::new(5_000)), Time::new(4_300));
        assert_eq!(stamps.at(None, wall, Time::new(5_100)), Time::new(5_100));
        // Stamps are out of order if two processors make them.
        assert_eq!(stamps.at(Some(wall - 900), wall, Time::new(5_200)), Time::new(5_100));
    }

    #[test]
    fn a_wall_clock_that_was_set_does_not_move_frames() {
        let mut stamps = Stamps::new();
        let wall = 1_700_000_000_000_000_000;
        assert_eq!(stamps.at(Some(wall + 5_000_000_000), wall, Time::new(7)), Time::new(7));
        assert_eq!(stamps.at(Some(wall - 5_000_000_000), wall, Time::new(9)), Time::new(9));
    }

    #[test]
    fn sleeping_ends_at_the_instant_or_later() {
        let until = now() + Nanos::millis(2);
        sleep_until(until);
        assert!(now() >= until);
    }
}
