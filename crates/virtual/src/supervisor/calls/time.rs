//! Clocks and sleeps.

use isocat_wire::time::{Host as Clock, Nanos, Time};

use super::{done, error};
use crate::kernel::TaskId;
use crate::supervisor::{Answer, Errno, START, Supervisor};

const SECOND: u64 = 1_000_000_000;
const ABSOLUTE: u64 = libc::TIMER_ABSTIME as u64;
/// The tick of `times`: a hundredth of a second.
const TICK: u64 = SECOND / 100;

/// The instant of a clock reading.
pub(super) fn instant(reading: u64, base: u64) -> Time<Clock> {
    Time::new(reading.saturating_sub(base))
}

impl Supervisor<'_> {
    /// The difference between a clock and virtual time; `None` if there is no such clock.
    pub(super) fn base(&self, clock: i32) -> Option<u64> {
        match clock {
            libc::CLOCK_REALTIME
            | libc::CLOCK_REALTIME_COARSE
            | libc::CLOCK_REALTIME_ALARM
            | libc::CLOCK_TAI => Some(self.epoch),
            libc::CLOCK_MONOTONIC
            | libc::CLOCK_MONOTONIC_RAW
            | libc::CLOCK_MONOTONIC_COARSE
            | libc::CLOCK_BOOTTIME
            | libc::CLOCK_BOOTTIME_ALARM
            | libc::CLOCK_PROCESS_CPUTIME_ID
            | libc::CLOCK_THREAD_CPUTIME_ID => Some(0),
            // These are descriptors of hardware clocks, and CPU clocks of other processes.
            _ => None,
        }
    }

    pub(super) fn time_call(
        &mut self,
        task: TaskId,
        number: i64,
        a: [u64; 6],
        first: bool,
    ) -> Answer {
        let now = self.now().count();
        match number {
            libc::SYS_clock_gettime => {
                let Some(base) = self.base(a[0] as i32) else { return error(libc::EINVAL) };
                let processor = [libc::CLOCK_PROCESS_CPUTIME_ID, libc::CLOCK_THREAD_CPUTIME_ID];
                let since = if processor.contains(&(a[0] as i32)) { START.count() } else { 0 };
                self.write_timespec(task, a[1], now + base - since)?;
                done(0)
            }
            libc::SYS_gettimeofday => {
                let micros = (now + self.epoch) / 1_000;
                if a[0] != 0 {
                    self.write_words(task, a[0], &[micros / 1_000_000, micros % 1_000_000])?;
                }
                done(0)
            }
            libc::SYS_time => {
                let seconds = (now + self.epoch) / SECOND;
                if a[0] != 0 {
                    self.write_words(task, a[0], &[seconds])?;
                }
                done(seconds as i64)
            }
            libc::SYS_clock_getres => {
                if self.base(a[0] as i32).is_none() {
                    return error(libc::EINVAL);
                }
                if a[1] != 0 {
                    self.write_words(task, a[1], &[0, 1])?;
                }
                done(0)
            }
            libc::SYS_times => {
                let ticks = (now - START.count()) / TICK;
                if a[0] != 0 {
                    self.write_words(task, a[0], &[ticks, 0, 0, 0])?;
                }
                done((now / TICK) as i64)
            }
            libc::SYS_getrusage => {
                let micros = (now - START.count()) / 1_000;
                let mut usage = [0; 18];
                (usage[0], usage[1]) = (micros / 1_000_000, micros % 1_000_000);
                self.write_words(task, a[1], &usage)?;
                done(0)
            }
            libc::SYS_nanosleep | libc::SYS_clock_nanosleep => self.sleep(task, number, a, first),
            libc::SYS_sched_yield if first => {
                let now = self.now();
                self.wait(task, now, Vec::new())
            }
            libc::SYS_sched_yield => done(0),
            // The program may not set clocks.
            _ => error(libc::EPERM),
        }
    }

    fn sleep(&mut self, task: TaskId, number: i64, a: [u64; 6], first: bool) -> Answer {
        if !first {
            let until = self.thread(task).until;
            return if self.now() < until { self.wait(task, until, Vec::new()) } else { done(0) };
        }
        let due = match number {
            libc::SYS_nanosleep => self.after(task, a[0])?,
            _ if a[1] & ABSOLUTE != 0 => {
                let base = self.base(a[0] as i32).ok_or(Errno(libc::EINVAL))?;
                instant(self.read_timespec(task, a[2])?, base).max(self.now())
            }
            _ => self.after(task, a[2])?,
        };
        let until = self.host.wakes(due);
        self.wait(task, until, Vec::new())
    }

    /// The instant that lies ahead by the span at address `at`.
    pub(super) fn after(&mut self, task: TaskId, at: u64) -> Result<Time<Clock>, Errno> {
        let span = self.read_timespec(task, at)?;
        Ok(self.ahead(span))
    }

    /// The instant that lies ahead by this many ns.
    pub(super) fn ahead(&self, span: u64) -> Time<Clock> {
        Time::new(self.now().count().saturating_add(span))
    }

    /// Reads a time of seconds and nanoseconds, in ns; the largest value if it does not fit.
    pub(super) fn read_timespec(&mut self, task: TaskId, at: u64) -> Result<u64, Errno> {
        let [seconds, nanos] = self.read_words(task, at)?;
        if (seconds as i64) < 0 || nanos >= SECOND {
            return Err(Errno(libc::EINVAL));
        }
        Ok(seconds.saturating_mul(SECOND).saturating_add(nanos))
    }

    pub(super) fn write_timespec(&mut self, task: TaskId, at: u64, ns: u64) -> Result<(), Errno> {
        self.write_words(task, at, &[ns / SECOND, ns % SECOND])
    }

    /// Reads the setting of a timer: interval and value, in ns.
    pub(super) fn read_setting(&mut self, task: TaskId, at: u64) -> Result<(Nanos, u64), Errno> {
        let interval = self.read_timespec(task, at)?;
        let value = self.read_timespec(task, at + 16)?;
        Ok((Nanos(interval.min(i64::MAX as u64) as i64), value))
    }
}
