//! The call behind mutexes, condition variables and joins.

use std::fs;

use isocat_wire::time::Time;

use super::{Answer, Errno, done, error};
use crate::kernel::{FutexKey, PiLock, Source, TaskId};
use crate::supervisor::Supervisor;

const PRIVATE: u64 = libc::FUTEX_PRIVATE_FLAG as u64;
const REAL_TIME: u64 = libc::FUTEX_CLOCK_REALTIME as u64;
/// Locks with priority inheritance have separate queues, apart from those of their words.
const PI: u64 = 1 << 63;
const LOCK_PI2: i32 = 13;

impl Supervisor<'_> {
    pub(super) fn futex(&mut self, task: TaskId, a: [u64; 6], first: bool) -> Answer {
        let operation = a[1] as i32 & libc::FUTEX_CMD_MASK;
        if !first {
            return self.futex_again(task, a, operation);
        }
        let most = |count: u64| usize::try_from(count as i32).unwrap_or(0);
        match operation {
            libc::FUTEX_WAIT | libc::FUTEX_WAIT_BITSET => self.futex_wait(task, a, operation),
            libc::FUTEX_WAKE => self.futex_wake(task, a, !0, most(a[2])),
            libc::FUTEX_WAKE_BITSET => self.futex_wake(task, a, a[5] as u32, most(a[2])),
            libc::FUTEX_REQUEUE | libc::FUTEX_CMP_REQUEUE => {
                if operation == libc::FUTEX_CMP_REQUEUE && self.read_u32(task, a[0])? != a[5] as u32
                {
                    return error(libc::EAGAIN);
                }
                let (from, to) =
                    (self.futex_key(task, a[0], a[1]), self.futex_key(task, a[4], a[1]));
                let woken = self.wake_key(from, !0, most(a[2]));
                let moved = self.futexes.requeue(from, to, most(a[3]));
                done((woken + moved) as i64)
            }
            libc::FUTEX_WAKE_OP => self.futex_wake_op(task, a, most(a[2]), most(a[3])),
            libc::FUTEX_LOCK_PI | LOCK_PI2 | libc::FUTEX_TRYLOCK_PI => {
                self.lock_pi(task, a, operation)
            }
            libc::FUTEX_UNLOCK_PI => self.unlock_pi(task, a),
            // Condition variables over such locks are not used by any present C library.
            other => self.refuse(&format!("futex operation {other}"), libc::ENOSYS),
        }
    }

    fn futex_wait(&mut self, task: TaskId, a: [u64; 6], operation: i32) -> Answer {
        if self.read_u32(task, a[0])? != a[2] as u32 {
            return error(libc::EAGAIN);
        }
        let bits = if operation == libc::FUTEX_WAIT { !0 } else { a[5] as u32 };
        if bits == 0 {
            return error(libc::EINVAL);
        }
        let until = match (a[3], operation) {
            (0, _) => Time::NEVER,
            (at, libc::FUTEX_WAIT) => {
                let due = self.after(task, at)?;
                self.host.wakes(due)
            }
            (at, _) => self.futex_deadline(task, at, a[1] & REAL_TIME != 0)?,
        };
        self.queue(task, self.futex_key(task, a[0], a[1]), bits, until)
    }

    /// Reads an instant from memory, of the monotonic or the real-time clock.
    fn futex_deadline(
        &mut self,
        task: TaskId,
        at: u64,
        real_time: bool,
    ) -> Result<Time<isocat_wire::time::Host>, Errno> {
        let reading = self.read_timespec(task, at)?;
        let due = super::time::instant(reading, if real_time { self.epoch } else { 0 });
        let due = due.max(self.now());
        Ok(self.host.wakes(due))
    }

    fn queue(
        &mut self,
        task: TaskId,
        key: FutexKey,
        bits: u32,
        until: Time<isocat_wire::time::Host>,
    ) -> Answer {
        self.futexes.wait(task, key, bits);
        self.wait(task, until, vec![Source::Futex(key)])
    }

    fn futex_again(&mut self, task: TaskId, a: [u64; 6], operation: i32) -> Answer {
        if self.futexes.is_woken(task) {
            return done(0);
        }
        let until = self.thread(task).until;
        if self.now() >= until {
            return error(libc::ETIMEDOUT);
        }
        // It was not woken by another task but must check again: the owner of the lock may have
        // ended.
        let is_lock = matches!(operation, libc::FUTEX_LOCK_PI | LOCK_PI2);
        if is_lock {
            return self.lock_pi(task, a, operation);
        }
        if self.read_u32(task, a[0])? != a[2] as u32 {
            return done(0);
        }
        let sources = self.scheduler.sources(task).to_vec();
        self.wait(task, until, sources)
    }

    fn futex_wake(&mut self, task: TaskId, a: [u64; 6], bits: u32, most: usize) -> Answer {
        let key = self.futex_key(task, a[0], a[1]);
        done(self.wake_key(key, bits, most) as i64)
    }

    fn wake_key(&mut self, key: FutexKey, bits: u32, most: usize) -> usize {
        let woken = self.futexes.wake(key, bits, most);
        woken.iter().for_each(|task| self.scheduler.wake(*task));
        woken.len()
    }

    /// Wakes on one word, changes another, and wakes on that one if the condition holds
    /// (`FUTEX_WAKE_OP`).
    fn futex_wake_op(&mut self, task: TaskId, a: [u64; 6], most: usize, more: usize) -> Answer {
        let code = a[5] as u32;
        let (operation, compare) = (code >> 28 & 7, code >> 24 & 15);
        let (operand, against) = (code >> 12 & 0xFFF, code & 0xFFF);
        let operand = if code >> 31 != 0 { 1 << (operand & 31) } else { operand };
        let old = self.read_u32(task, a[4])?;
        let new = match operation {
            0 => operand,
            1 => old.wrapping_add(operand),
            2 => old | operand,
            3 => old & !operand,
            4 => old ^ operand,
            _ => return error(libc::ENOSYS),
        };
        self.write_u32(task, a[4], new)?;
        let (old, against) = (old as i32, against as i32);
        let holds = match compare {
            0 => old == against,
            1 => old != against,
            2 => old < against,
            3 => old <= against,
            4 => old > against,
            5 => old >= against,
            _ => return error(libc::ENOSYS),
        };
        let mut woken = self.wake_key(self.futex_key(task, a[0], a[1]), !0, most);
        if holds {
            woken += self.wake_key(self.futex_key(task, a[4], a[1]), !0, more);
        }
        done(woken as i64)
    }

    fn lock_pi(&mut self, task: TaskId, a: [u64; 6], operation: i32) -> Answer {
        let thread = self.thread(task).number as u32;
        let word = self.read_u32(task, a[0])?;
        match PiLock::ask(word, thread) {
            PiLock::Taken(word) => {
                self.write_u32(task, a[0], word)?;
                done(0)
            }
            PiLock::Own => error(libc::EDEADLK),
            PiLock::Held(_) if operation == libc::FUTEX_TRYLOCK_PI => error(libc::EAGAIN),
            PiLock::Held(word) => {
                self.write_u32(task, a[0], word)?;
                let real_time = operation == libc::FUTEX_LOCK_PI || a[1] & REAL_TIME != 0;
                let until = match a[3] {
                    0 => Time::NEVER,
                    at => self.futex_deadline(task, at, real_time)?,
                };
                self.queue(task, self.pi_key(task, a), !0, until)
            }
        }
    }

    fn unlock_pi(&mut self, task: TaskId, a: [u64; 6]) -> Answer {
        let thread = self.thread(task).number as u32;
        if !PiLock::is_owner(self.read_u32(task, a[0])?, thread) {
            return error(libc::EPERM);
        }
        let key = self.pi_key(task, a);
        let woken = self.futexes.wake(key, !0, 1);
        let next = woken.first().map(|next| self.threads[next.0 as usize].number as u32);
        let word = PiLock::hand_over(next, self.futexes.count(key) > 0);
        self.write_u32(task, a[0], word)?;
        woken.iter().for_each(|task| self.scheduler.wake(*task));
        done(0)
    }

    fn pi_key(&self, task: TaskId, a: [u64; 6]) -> FutexKey {
        let key = self.futex_key(task, a[0], a[1]);
        FutexKey { space: key.space | PI, ..key }
    }

    /// The key of a word, in the memory of one process or in shared memory.
    fn futex_key(&self, task: TaskId, at: u64, flags: u64) -> FutexKey {
        let process = &self.processes[self.threads[task.0 as usize].process.0];
        let own = FutexKey { space: process.space, place: at };
        match flags & PRIVATE != 0 || self.processes.len() == 1 {
            true => own,
            false => shared_place(process.number, at).unwrap_or(own),
        }
    }

    /// A thread of this memory ended: tasks that wait on words check them again, since the kernel
    /// may have changed the words.
    pub(in crate::supervisor) fn wake_changed_words(&mut self, space: u64) {
        for task in self.scheduler.alive().collect::<Vec<_>>() {
            let here = self.futexes.key_of(task).is_some_and(|key| key.space & !PI == space);
            if here && self.scheduler.is_waiting(task) {
                self.scheduler.wake(task);
            }
        }
    }
}

/// The place in shared memory behind an address: the file or mapping, and the offset. `None`: the
/// address is private to the process.
fn shared_place(process: i32, at: u64) -> Option<FutexKey> {
    let maps = fs::read_to_string(format!("/proc/{process}/maps")).ok()?;
    for line in maps.lines() {
        let mut fields = line.split_ascii_whitespace();
        let (from, to) = fields.next()?.split_once('-')?;
        let hex = |text: &str| u64::from_str_radix(text, 16).ok();
        let (from, to) = (hex(from)?, hex(to)?);
        if !(from..to).contains(&at) {
            continue;
        }
        let is_shared = fields.next()?.ends_with('s');
        let offset = hex(fields.next()?)?;
        let device = fields.next()?.bytes().fold(0u64, |sum, byte| sum * 31 + u64::from(byte));
        let file: u64 = fields.next()?.parse().ok()?;
        let space = 1 << 62 | (file << 16 ^ device) & !(3 << 62);
        return is_shared.then_some(FutexKey { space, place: offset + at - from });
    }
    None
}
