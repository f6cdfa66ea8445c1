//! Waits for one of several objects: `poll`, `select`, `epoll`.

use isocat_wire::time::{Host as Clock, Time};

use super::{Answer, Errno, done, error};
use crate::kernel::{Epoll, Interest, Kind, ObjectId, TaskId};
use crate::supervisor::Supervisor;

/// Number of descriptors in one `select`, which limits their numbers.
const MOST_SELECTED: usize = 1024;
/// Largest number of descriptors in one `poll`.
const MOST_POLLED: usize = 4096;
/// Largest number of events that one `epoll_wait` returns.
const MOST_EVENTS: usize = 1024;
const IN: u32 = 0x001;
const PRIORITY: u32 = 0x002;
const OUT: u32 = 0x004;
const ERROR: u32 = 0x008;
const HANG_UP: u32 = 0x010;
const INVALID: u32 = 0x020;
const MILLI: u64 = 1_000_000;

impl Supervisor<'_> {
    pub(super) fn wait_call(
        &mut self,
        task: TaskId,
        number: i64,
        a: [u64; 6],
        first: bool,
    ) -> Answer {
        match number {
            libc::SYS_epoll_create | libc::SYS_epoll_create1 => {
                let flags = if number == libc::SYS_epoll_create1 { a[0] as i32 } else { 0 };
                let object = self.objects.add(Kind::Epoll(Epoll::default()), false);
                self.install(task, object, flags & libc::EPOLL_CLOEXEC != 0)
            }
            libc::SYS_epoll_ctl => self.epoll_control(task, a),
            libc::SYS_poll => {
                let until = self.patience(task, first, millis(a[2]))?;
                self.poll(task, a, until)
            }
            libc::SYS_ppoll => {
                let span = self.span_at(task, first, a[2])?;
                let until = self.patience(task, first, span)?;
                self.poll(task, a, until)
            }
            libc::SYS_select => {
                let span = match a[4] {
                    at if at != 0 && first => {
                        let [seconds, micros] = self.read_words(task, at)?;
                        Some(seconds.saturating_mul(1_000_000_000).saturating_add(micros * 1_000))
                    }
                    _ => None,
                };
                let until = self.patience(task, first, span)?;
                self.select(task, a, until)
            }
            libc::SYS_pselect6 => {
                let span = self.span_at(task, first, a[4])?;
                let until = self.patience(task, first, span)?;
                self.select(task, a, until)
            }
            libc::SYS_epoll_pwait2 => {
                let span = self.span_at(task, first, a[3])?;
                let until = self.patience(task, first, span)?;
                self.epoll(task, a, until)
            }
            _ => {
                let until = self.patience(task, first, millis(a[3]))?;
                self.epoll(task, a, until)
            }
        }
    }

    fn span_at(&mut self, task: TaskId, first: bool, at: u64) -> Result<Option<u64>, Errno> {
        if at == 0 || !first { Ok(None) } else { self.read_timespec(task, at).map(Some) }
    }

    /// The end of a call's wait: a span after its start, or never without a span.
    fn patience(
        &mut self,
        task: TaskId,
        first: bool,
        span: Option<u64>,
    ) -> Result<Time<Clock>, Errno> {
        if first {
            let until = match span {
                None => Time::NEVER,
                Some(0) => self.now(),
                Some(span) => {
                    let due = self.ahead(span);
                    self.host.wakes(due)
                }
            };
            self.thread(task).until = until;
        }
        Ok(self.thread(task).until)
    }

    fn poll(&mut self, task: TaskId, a: [u64; 6], until: Time<Clock>) -> Answer {
        let count = a[1] as usize;
        if count > MOST_POLLED {
            return error(libc::EINVAL);
        }
        let mut entries = self.read_bytes(task, a[0], 8 * count)?;
        let (mut ready, mut objects) = (0, Vec::new());
        for entry in entries.chunks_exact_mut(8) {
            let descriptor = i32::from_ne_bytes([entry[0], entry[1], entry[2], entry[3]]);
            let asked = u32::from(u16::from_ne_bytes([entry[4], entry[5]]));
            let mut events = 0;
            if descriptor >= 0 {
                events = match self.pollable(task, descriptor)? {
                    Pollable::Object(id) => {
                        objects.push(id);
                        self.objects.readiness(id).0 & (asked | ERROR | HANG_UP)
                    }
                    Pollable::Always => asked & (IN | OUT | 0x140),
                    Pollable::Closed => INVALID,
                };
            }
            ready += i64::from(events != 0);
            entry[6..].copy_from_slice(&(events as u16).to_ne_bytes());
        }
        if ready == 0 && self.now() < until {
            return self.wait_for(task, until, &objects);
        }
        self.write(task, a[0], &entries)?;
        done(ready)
    }

    fn select(&mut self, task: TaskId, a: [u64; 6], until: Time<Clock>) -> Answer {
        let count = (a[0] as i32).clamp(0, MOST_SELECTED as i32) as usize;
        let bytes = count.div_ceil(64) * 8;
        let sets = [a[1], a[2], a[3]];
        let mut asked = [vec![0; bytes], vec![0; bytes], vec![0; bytes]];
        for (set, at) in asked.iter_mut().zip(sets).filter(|(_, at)| *at != 0) {
            self.read(task, at, set)?;
        }
        let mut found = [vec![0; bytes], vec![0; bytes], vec![0; bytes]];
        let (mut ready, mut objects) = (0, Vec::new());
        let kinds = [IN | HANG_UP | ERROR, OUT | ERROR, PRIORITY];
        for descriptor in 0..count {
            let (byte, bit) = (descriptor / 8, 1u8 << (descriptor % 8));
            if asked.iter().all(|set| set[byte] & bit == 0) {
                continue;
            }
            let events = match self.pollable(task, descriptor as i32)? {
                Pollable::Object(id) => {
                    objects.push(id);
                    self.objects.readiness(id).0
                }
                Pollable::Always => IN | OUT,
                Pollable::Closed => return error(libc::EBADF),
            };
            for ((asked, found), kind) in asked.iter().zip(&mut found).zip(kinds) {
                if asked[byte] & bit != 0 && events & kind != 0 {
                    found[byte] |= bit;
                    ready += 1;
                }
            }
        }
        if ready == 0 && self.now() < until {
            return self.wait_for(task, until, &objects);
        }
        for (set, at) in found.iter().zip(sets).filter(|(_, at)| *at != 0) {
            self.write(task, at, set)?;
        }
        done(ready)
    }

    fn epoll(&mut self, task: TaskId, a: [u64; 6], until: Time<Clock>) -> Answer {
        let Some(id) = self.object(task, a[0]) else { return error(libc::EBADF) };
        let Some(Kind::Epoll(set)) = self.objects.get(id) else { return error(libc::EINVAL) };
        let most = a[2] as i32;
        if most <= 0 {
            return error(libc::EINVAL);
        }
        let ready = set.ready(&self.objects, (most as usize).min(MOST_EVENTS));
        if ready.is_empty() {
            return match self.now() < until {
                true => self.wait_for(task, until, &[id]),
                false => done(0),
            };
        }
        let events = ready.iter().flat_map(|(interest, events)| {
            // The structure is packed: 32 bits of events, 64 of data.
            events.to_ne_bytes().into_iter().chain(interest.data.to_ne_bytes())
        });
        let bytes: Vec<u8> = events.collect();
        self.write(task, a[1], &bytes)?;
        let changes: Vec<(ObjectId, u64)> = ready
            .iter()
            .map(|(interest, _)| (interest.object, self.objects.changes(interest.object)))
            .collect();
        if let Some(Kind::Epoll(set)) = self.objects.get_mut(id) {
            set.told(&ready, |id| {
                changes.iter().find(|(other, _)| *other == id).map_or(0, |(_, count)| *count)
            });
        }
        done(ready.len() as i64)
    }

    fn epoll_control(&mut self, task: TaskId, a: [u64; 6]) -> Answer {
        let Some(id) = self.object(task, a[0]) else { return error(libc::EBADF) };
        let descriptor = a[2] as i32;
        let object = match self.pollable(task, descriptor)? {
            Pollable::Object(object) if object != id => object,
            Pollable::Object(_) => return error(libc::EINVAL),
            // As in a real kernel, a file cannot be waited for.
            Pollable::Always => return error(libc::EPERM),
            Pollable::Closed => return error(libc::EBADF),
        };
        let operation = a[1] as i32;
        let mut interest = Interest::new(descriptor, object, 0, 0);
        if operation != libc::EPOLL_CTL_DEL {
            let bytes = self.read_bytes(task, a[3], 12)?;
            let word =
                |at: usize| bytes[at..].first_chunk().map_or(0, |bytes| u32::from_ne_bytes(*bytes));
            let data = u64::from(word(8)) << 32 | u64::from(word(4));
            interest = Interest::new(descriptor, object, word(0), data);
        }
        let Some(Kind::Epoll(set)) = self.objects.get_mut(id) else { return error(libc::EINVAL) };
        let answer = match operation {
            libc::EPOLL_CTL_ADD if !set.add(interest) => return error(libc::EEXIST),
            libc::EPOLL_CTL_MOD if !set.change(interest) => return error(libc::ENOENT),
            libc::EPOLL_CTL_DEL if !set.remove(descriptor, object) => return error(libc::ENOENT),
            libc::EPOLL_CTL_ADD | libc::EPOLL_CTL_MOD | libc::EPOLL_CTL_DEL => done(0),
            _ => return error(libc::EINVAL),
        };
        // A thread may be waiting on the set, whose members have changed.
        self.touch(&[id]);
        answer
    }
}

/// How a wait must treat a descriptor.
pub(super) enum Pollable {
    /// The descriptor stands for this object.
    Object(ObjectId),
    /// The descriptor can always be read and written, as a file can.
    Always,
    /// There is no such descriptor.
    Closed,
}

/// A span in ms; `None` if it is negative.
fn millis(span: u64) -> Option<u64> {
    u64::try_from(span as i32).ok().map(|span| span * MILLI)
}
