//! The time driver of embassy-time. Its clock is that of the run on the calling thread.

use std::task::Waker;

use embassy_time_driver::{Driver, TICK_HZ, time_driver_impl};

use crate::clock::Clock;

struct VirtualTime;

time_driver_impl!(static DRIVER: VirtualTime = VirtualTime);

impl Driver for VirtualTime {
    fn now(&self) -> u64 {
        ticks(Clock::of_this_thread().now())
    }

    fn schedule_wake(&self, at: u64, waker: &Waker) {
        let clock = Clock::of_this_thread();
        clock.note_embassy();
        clock.wake_host_at(nanos(at), waker);
    }
}

const SECOND: u128 = 1_000_000_000;

/// The number of ticks that have passed.
fn ticks(nanos: u64) -> u64 {
    (u128::from(nanos) * u128::from(TICK_HZ) / SECOND) as u64
}

/// The first nanosecond at which this number of ticks has passed.
fn nanos(ticks: u64) -> u64 {
    let nanos = (u128::from(ticks) * SECOND).div_ceil(u128::from(TICK_HZ));
    u64::try_from(nanos).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tick_has_come_at_its_first_nanosecond_and_not_before() {
        for tick in [1, 2, 999, 1_000_003] {
            assert_eq!(ticks(nanos(tick)), tick);
            assert_eq!(ticks(nanos(tick) - 1), tick - 1);
        }
        assert_eq!(nanos(u64::MAX), u64::MAX, "never");
    }
}
