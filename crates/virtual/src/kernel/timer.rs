//! Timers: those of `timerfd`, and those of a process that send signals.

use isocat_wire::time::{Host, Nanos, Time};

/// A timer that expires once or periodically.
#[derive(Debug, Default)]
pub struct Timer {
    /// The instant of the next expiry.
    next: Option<Time<Host>>,
    interval: Nanos,
    expired: u64,
}

impl Timer {
    /// Sets the timer: first an instant, then this interval; an interval of 0 means once. Earlier
    /// expiries are cleared.
    pub fn set(&mut self, first: Option<Time<Host>>, interval: Nanos) {
        (self.next, self.interval, self.expired) = (first, interval, 0);
    }

    /// The instant of the next expiry.
    pub fn next(&self) -> Option<Time<Host>> {
        self.next
    }

    /// Its interval; 0 means that it expires once.
    pub fn interval(&self) -> Nanos {
        self.interval
    }

    /// Lets the timer expire up to `now`. Returns the number of expiries.
    pub fn fire(&mut self, now: Time<Host>) -> u64 {
        let Some(next) = self.next.filter(|next| *next <= now) else { return 0 };
        let mut times = 1;
        self.next = (self.interval > Nanos::ZERO).then(|| {
            times += ((now - next).0 / self.interval.0) as u64;
            next + Nanos(self.interval.0 * times as i64)
        });
        self.expired += times;
        times
    }

    /// The result of a read: the number of expiries since the last read. `None` if there were none.
    pub fn take(&mut self) -> Option<u64> {
        Some(std::mem::take(&mut self.expired)).filter(|times| *times > 0)
    }

    /// Whether a read would return a value.
    pub fn is_readable(&self) -> bool {
        self.expired > 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_expires_at_its_instant_and_not_a_nanosecond_before() {
        let mut timer = Timer::default();
        timer.set(Some(Time::new(1_000)), Nanos::ZERO);
        assert_eq!(timer.fire(Time::new(999)), 0);
        assert_eq!(timer.fire(Time::new(1_000)), 1);
        assert_eq!((timer.take(), timer.take(), timer.next()), (Some(1), None, None));
    }

    #[test]
    fn intervals_that_were_slept_through_count() {
        let mut timer = Timer::default();
        timer.set(Some(Time::new(1_000)), Nanos(100));
        assert_eq!(timer.fire(Time::new(1_299)), 3);
        assert_eq!(timer.next(), Some(Time::new(1_300)));
        assert_eq!(timer.fire(Time::new(1_300)), 1);
        assert_eq!(timer.take(), Some(4));
    }
}
