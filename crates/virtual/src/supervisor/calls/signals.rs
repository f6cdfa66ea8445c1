//! Signals, and the timers that send them.

use std::fs;

use isocat_wire::time::{Nanos, Time};

use super::{Answer, Errno, Outcome, done, error};
use crate::kernel::{Source, TaskId, Timer};
use crate::supervisor::Supervisor;
use crate::supervisor::program::{OwnTimer, left};

/// The kernel restarts such a call after the signal's handler, if the handler was installed so.
const RESTART: i32 = 512;
/// The timer of `setitimer` and `alarm`.
const OLD_TIMER: i32 = -1;

/// The kernel's information about a thread's signals.
#[derive(Clone, Copy, Debug, Default)]
struct Signals {
    pending: u64,
    shared: u64,
    blocked: u64,
    ignored: u64,
    caught: u64,
}

/// Whether a call sends a signal to a thread or a process.
pub(in crate::supervisor) fn sends_signal(number: i64) -> bool {
    matches!(
        number,
        libc::SYS_kill
            | libc::SYS_tkill
            | libc::SYS_tgkill
            | libc::SYS_rt_sigqueueinfo
            | libc::SYS_rt_tgsigqueueinfo
    )
}

impl Supervisor<'_> {
    pub(super) fn signal_call(
        &mut self,
        task: TaskId,
        number: i64,
        a: [u64; 6],
        first: bool,
    ) -> Answer {
        match number {
            _ if sends_signal(number) => self.send_signal(number, a),
            // The kernel waits with another mask and returns after the signal.
            libc::SYS_rt_sigsuspend | libc::SYS_pause => Ok(Outcome::Outside),
            libc::SYS_rt_sigtimedwait => self.wait_for_signal(task, a, first),
            libc::SYS_alarm => {
                let due = (a[0] > 0).then(|| self.ahead(a[0] * 1_000_000_000));
                let before = self.set_old_timer(task, due, Nanos::ZERO);
                done((before.0 / 1_000_000_000).max(i64::from(before.0 > 0)))
            }
            libc::SYS_setitimer | libc::SYS_getitimer if a[0] as i32 != libc::ITIMER_REAL => {
                self.refuse("an interval timer of processor time", libc::EINVAL)
            }
            libc::SYS_setitimer => self.set_interval_timer(task, a),
            libc::SYS_getitimer => {
                let (interval, next) = self.old_timer(task);
                self.write_micros(task, a[1], interval, next)?;
                done(0)
            }
            libc::SYS_timer_create => self.create_timer(task, a),
            _ => self.own_timer_call(task, number, a),
        }
    }

    /// Sends a signal from the program to itself or its children.
    fn send_signal(&mut self, number: i64, a: [u64; 6]) -> Answer {
        let target = a[0] as i32;
        let known = target <= 0
            || self.processes.iter().any(|process| process.number == target)
            || self.task_of(target).is_some();
        if !known && target > 1 && number != libc::SYS_kill {
            return error(libc::ESRCH);
        }
        Ok(Outcome::Pass)
    }

    fn wait_for_signal(&mut self, task: TaskId, a: [u64; 6], first: bool) -> Answer {
        let [wanted] = self.read_words(task, a[0])?;
        let signals = self.signals_of(task);
        if (signals.pending | signals.shared) & wanted != 0 {
            return Ok(Outcome::Pass);
        }
        if first {
            self.thread(task).until = match a[2] {
                0 => Time::NEVER,
                at => self.after(task, at)?,
            };
        }
        let until = self.thread(task).until;
        match self.now() < until {
            true => self.wait(task, until, vec![Source::Signal]),
            false => error(libc::EAGAIN),
        }
    }

    fn signals_of(&self, task: TaskId) -> Signals {
        let thread = &self.threads[task.0 as usize];
        let process = self.processes[thread.process.0].number;
        let path = format!("/proc/{process}/task/{}/status", thread.number);
        let mut signals = Signals::default();
        for line in fs::read_to_string(path).unwrap_or_default().lines() {
            let Some((name, value)) = line.split_once(":\t") else { continue };
            let place = match name {
                "SigPnd" => &mut signals.pending,
                "ShdPnd" => &mut signals.shared,
                "SigBlk" => &mut signals.blocked,
                "SigIgn" => &mut signals.ignored,
                "SigCgt" => &mut signals.caught,
                _ => continue,
            };
            *place = u64::from_str_radix(value.trim(), 16).unwrap_or(0);
        }
        signals
    }

    /// Interrupts waiting threads that have a handler for a pending signal.
    pub(in crate::supervisor) fn interrupt_by_signals(&mut self) {
        let mut served: Vec<(usize, u64)> = Vec::new();
        for task in self.scheduler.alive().collect::<Vec<_>>() {
            if !self.scheduler.is_waiting(task) {
                continue;
            }
            let process = self.threads[task.0 as usize].process.0;
            let signals = self.signals_of(task);
            let taken = served.iter().filter(|(other, _)| *other == process);
            let taken = taken.fold(0, |all, (_, taken)| all | taken);
            let shared = signals.shared & !taken;
            let handled = (signals.pending | shared) & signals.caught & !signals.blocked;
            let awaited = self.scheduler.sources(task).contains(&Source::Signal)
                && signals.pending | shared != 0;
            if handled != 0 {
                // One thread is enough for a signal to the whole process.
                served.push((process, handled & shared));
                self.thread(task).interrupted = true;
                self.scheduler.wake(task);
            } else if awaited {
                self.scheduler.wake(task);
            }
        }
    }

    /// The result of a call that a signal interrupted.
    pub(super) fn interrupted(&mut self, task: TaskId) -> Answer {
        self.futexes.leave(task);
        let number = self.thread(task).call.number;
        let restarts = matches!(
            number,
            libc::SYS_read
                | libc::SYS_readv
                | libc::SYS_write
                | libc::SYS_writev
                | libc::SYS_wait4
                | libc::SYS_waitid
                | libc::SYS_futex
                | libc::SYS_recvfrom
                | libc::SYS_recvmsg
        );
        error(if restarts { RESTART } else { libc::EINTR })
    }

    fn set_interval_timer(&mut self, task: TaskId, a: [u64; 6]) -> Answer {
        let [interval, micros, seconds, rest] = self.read_words(task, a[1])?;
        let ns = |seconds: u64, micros: u64| {
            seconds.saturating_mul(1_000_000_000).saturating_add(micros.saturating_mul(1_000))
        };
        let (before_interval, before) = self.old_timer(task);
        let value = ns(seconds, rest);
        let due = (value > 0).then(|| self.ahead(value));
        self.set_old_timer(task, due, Nanos(ns(interval, micros) as i64));
        if a[2] != 0 {
            self.write_micros(task, a[2], before_interval, before)?;
        }
        done(0)
    }

    fn write_micros(
        &mut self,
        task: TaskId,
        at: u64,
        interval: Nanos,
        value: Nanos,
    ) -> Result<(), Errno> {
        let parts =
            |span: Nanos| [span.0 as u64 / 1_000_000_000, span.0 as u64 / 1_000 % 1_000_000];
        let ([a, b], [c, d]) = (parts(interval), parts(value));
        self.write_words(task, at, &[a, b, c, d])
    }

    /// Interval of the timer of `setitimer`, and the time left.
    fn old_timer(&mut self, task: TaskId) -> (Nanos, Nanos) {
        let now = self.now();
        let timers = &self.process(task).timers;
        let own = timers.iter().find(|own| own.id == OLD_TIMER);
        own.map_or((Nanos::ZERO, Nanos::ZERO), |own| {
            let next = own.timer.next().map_or(Nanos::ZERO, |next| left(next, now));
            (own.timer.interval(), next)
        })
    }

    /// Sets the timer of `setitimer`. Returns the time that was left.
    fn set_old_timer(
        &mut self,
        task: TaskId,
        due: Option<Time<isocat_wire::time::Host>>,
        interval: Nanos,
    ) -> Nanos {
        let (_, before) = self.old_timer(task);
        let due = due.map(|due| self.host.wakes(due));
        let timers = &mut self.process(task).timers;
        timers.retain(|own| own.id != OLD_TIMER);
        let mut timer = Timer::default();
        timer.set(due, interval);
        let signal = libc::SIGALRM;
        timers.push(OwnTimer { id: OLD_TIMER, timer, signal, ..OwnTimer::default() });
        before
    }

    fn create_timer(&mut self, task: TaskId, a: [u64; 6]) -> Answer {
        if self.base(a[0] as i32).is_none() {
            return error(libc::EINVAL);
        }
        let timers = &self.process(task).timers;
        let id = (0..).find(|id| !timers.iter().any(|own| own.id == *id)).unwrap_or(0);
        let mut own = OwnTimer {
            id,
            clock: a[0] as i32,
            signal: libc::SIGALRM,
            value: id as u64,
            ..OwnTimer::default()
        };
        if a[1] != 0 {
            let [value, what, to] = self.read_words(task, a[1])?;
            own.value = value;
            own.signal = what as i32;
            match (what >> 32) as i32 {
                libc::SIGEV_NONE => own.signal = 0,
                libc::SIGEV_SIGNAL => {}
                libc::SIGEV_THREAD_ID => own.thread = Some(to as i32),
                _ => return error(libc::EINVAL),
            }
        }
        self.process(task).timers.push(own);
        self.write_u32(task, a[2], id as u32)?;
        done(0)
    }

    fn own_timer_call(&mut self, task: TaskId, number: i64, a: [u64; 6]) -> Answer {
        let (id, now) = (a[0] as i32, self.now());
        let place = self.process(task).timers.iter().position(|own| own.id == id);
        let Some(place) = place.filter(|_| id >= 0) else { return error(libc::EINVAL) };
        let own = &self.process(task).timers[place];
        let (interval, next) = (own.timer.interval(), own.timer.next());
        let (clock, rest) = (own.clock, next.map_or(0, |next| left(next, now).0 as u64));
        match number {
            libc::SYS_timer_delete => {
                self.process(task).timers.remove(place);
                done(0)
            }
            libc::SYS_timer_getoverrun => done(0),
            libc::SYS_timer_gettime => {
                self.write_timespec(task, a[1], interval.0 as u64)?;
                self.write_timespec(task, a[1] + 16, rest)?;
                done(0)
            }
            _ => {
                let (new_interval, value) = self.read_setting(task, a[2])?;
                if a[3] != 0 {
                    self.write_timespec(task, a[3], interval.0 as u64)?;
                    self.write_timespec(task, a[3] + 16, rest)?;
                }
                let base = self.base(clock).unwrap_or(0);
                let due = match (value, a[1] as i32 & libc::TIMER_ABSTIME) {
                    (0, _) => None,
                    (value, 0) => Some(self.ahead(value)),
                    (value, _) => Some(super::time::instant(value, base).max(now)),
                };
                let due = due.map(|due| self.host.wakes(due));
                self.process(task).timers[place].timer.set(due, new_interval);
                done(0)
            }
        }
    }
}
