//! Descriptors: reading, writing, copying and closing them; pipes, event counters, timers.

use std::fs;
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};

use isocat_wire::time::Time;
use rustix::event::{PollFd, PollFlags, Timespec, poll};

use super::wait::Pollable;
use super::{Answer, Errno, Outcome, done, error};
use crate::kernel::{EventCounter, Kind, ObjectId, Readiness, TaskId, Timer};
use crate::supervisor::Supervisor;
use crate::supervisor::program::{Descriptor, left};
use crate::supervisor::vdso::PAGE_DESCRIPTOR;
use crate::sys;

const CLOSE_ON_EXEC: i32 = libc::O_CLOEXEC;
const NON_BLOCKING: i32 = libc::O_NONBLOCK;
/// Largest number of bytes that one call reads or writes here; a longer call is done in part, as is
/// allowed.
const MOST: usize = 1 << 20;
/// Number of random bytes in a file of random bytes.
const RANDOM: usize = 1 << 16;

impl Supervisor<'_> {
    pub(super) fn descriptor_call(
        &mut self,
        task: TaskId,
        number: i64,
        a: [u64; 6],
        first: bool,
    ) -> Answer {
        match number {
            libc::SYS_read | libc::SYS_readv => self.read_call(task, number, a, first),
            libc::SYS_write | libc::SYS_writev => self.write_call(task, number, a, first),
            libc::SYS_close => {
                self.forget_descriptor(task, a[0] as i32);
                Ok(Outcome::Pass)
            }
            libc::SYS_close_range => self.close_range(task, a),
            libc::SYS_dup => self.copy(task, a, None, false),
            libc::SYS_dup2 if a[0] == a[1] => Ok(Outcome::Pass),
            libc::SYS_dup2 | libc::SYS_dup3 => {
                let close_on_exec = number == libc::SYS_dup3 && a[2] as i32 & CLOSE_ON_EXEC != 0;
                self.copy(task, a, Some(a[1] as i32), close_on_exec)
            }
            libc::SYS_fcntl => self.fcntl(task, a),
            libc::SYS_pipe | libc::SYS_pipe2 => {
                let flags = if number == libc::SYS_pipe2 { a[1] as i32 } else { 0 };
                let (reader, writer) = self.objects.add_pipe(flags & NON_BLOCKING != 0);
                self.install_two(task, [reader, writer], flags & CLOSE_ON_EXEC != 0, a[0])
            }
            libc::SYS_eventfd | libc::SYS_eventfd2 => {
                let flags = if number == libc::SYS_eventfd2 { a[1] as i32 } else { 0 };
                let counter =
                    EventCounter::new(u64::from(a[0] as u32), flags & libc::EFD_SEMAPHORE != 0);
                let object = self.objects.add(Kind::Event(counter), flags & NON_BLOCKING != 0);
                self.install(task, object, flags & CLOSE_ON_EXEC != 0)
            }
            libc::SYS_timerfd_create => {
                if self.base(a[0] as i32).is_none() {
                    return error(libc::EINVAL);
                }
                let flags = a[1] as i32;
                let timer = Kind::Timer(Timer::default());
                let object = self.objects.add(timer, flags & NON_BLOCKING != 0);
                self.timer_clocks.insert(object, a[0] as i32);
                self.install(task, object, flags & CLOSE_ON_EXEC != 0)
            }
            libc::SYS_timerfd_settime => self.set_timer(task, a),
            libc::SYS_timerfd_gettime => {
                let id = self.object(task, a[0]).ok_or(Errno(libc::EBADF))?;
                self.write_timer(task, id, a[1])?;
                done(0)
            }
            libc::SYS_open => self.open(task, a[0]),
            libc::SYS_openat => self.open(task, a[1]),
            libc::SYS_creat => Ok(Outcome::Pass),
            libc::SYS_openat2 => error(libc::ENOSYS),
            // The C library and common tools fall back to read and write.
            _ => match [a[0], a[1], a[2]].iter().any(|place| self.object(task, *place).is_some()) {
                true => error(libc::EINVAL),
                false => Ok(Outcome::Pass),
            },
        }
    }

    /// Opens a file. Random bytes come from the seed, and hardware clocks do not exist.
    fn open(&mut self, task: TaskId, path: u64) -> Answer {
        let path = self.read_text(task, path)?;
        if path == "/dev/urandom" || path == "/dev/random" {
            let mut bytes = vec![0; RANDOM];
            self.host.random(&mut bytes);
            let file = sys::memory("random", &bytes)?;
            let call = self.thread(task).call.id;
            let number = self.listener().add_descriptor(call, file.as_fd(), None, true)?;
            return done(number.into());
        }
        if path.starts_with("/dev/ptp") || path.starts_with("/dev/rtc") {
            return self.refuse("a hardware clock", libc::ENODEV);
        }
        Ok(Outcome::Pass)
    }

    fn read_call(&mut self, task: TaskId, number: i64, a: [u64; 6], first: bool) -> Answer {
        let Some(id) = self.object(task, a[0]) else { return Ok(Outcome::Pass) };
        let parts = match number {
            libc::SYS_readv => self.parts(task, a[1], a[2])?,
            _ => vec![(a[1], a[2] as usize)],
        };
        let Some(kind) = self.objects.get_mut(id) else { return error(libc::EBADF) };
        let taken = match kind {
            Kind::Packet(_) => return self.read_packet(task, id, parts, first),
            Kind::Outside(_) => return self.outside_transfer(id),
            Kind::Epoll(_) => return error(libc::EINVAL),
            Kind::Pipe(_) => return self.read_pipe(task, id, &parts),
            Kind::Timer(timer) => timer.take(),
            Kind::Event(counter) => counter.take(),
        };
        let Some(value) = taken else { return self.later(task, id) };
        if parts.iter().map(|(_, len)| len).sum::<usize>() < 8 {
            return error(libc::EINVAL);
        }
        self.write_words(task, parts[0].0, &[value])?;
        // A pipe that was full can be written to again.
        self.objects.changed(id);
        self.touch(&[id]);
        done(8)
    }

    fn write_call(&mut self, task: TaskId, number: i64, a: [u64; 6], first: bool) -> Answer {
        let Some(id) = self.object(task, a[0]) else { return Ok(Outcome::Pass) };
        let parts = match number {
            libc::SYS_writev => self.parts(task, a[1], a[2])?,
            _ => vec![(a[1], a[2] as usize)],
        };
        match self.objects.get(id) {
            Some(Kind::Packet(_)) if first => self.write_packet(task, id, parts),
            // Virtual time stands still until everything is written, so the speed of the reader
            // makes no difference.
            Some(Kind::Outside(_)) => Ok(Outcome::Pass),
            Some(Kind::Pipe(_)) => self.write_pipe(task, id, &parts),
            Some(Kind::Event(_)) => {
                let [value] = self.read_words(task, parts.first().map_or(0, |part| part.0))?;
                let Some(Kind::Event(counter)) = self.objects.get_mut(id) else {
                    return error(libc::EBADF);
                };
                if value == u64::MAX {
                    return error(libc::EINVAL);
                }
                if !counter.add(value) {
                    return self.later(task, id);
                }
                self.objects.changed(id);
                self.touch(&[id]);
                done(8)
            }
            _ => error(libc::EINVAL),
        }
    }

    /// Nothing can be done now: the call waits or returns an error.
    fn later(&mut self, task: TaskId, id: ObjectId) -> Answer {
        match self.objects.is_nonblocking(id) {
            true => error(libc::EAGAIN),
            false => self.wait_for(task, Time::NEVER, &[id]),
        }
    }

    pub(super) fn read_pipe(
        &mut self,
        task: TaskId,
        id: ObjectId,
        parts: &[(u64, usize)],
    ) -> Answer {
        let Some(&Kind::Pipe(end)) = self.objects.get(id) else { return error(libc::EBADF) };
        let wanted: usize = parts.iter().map(|(_, len)| *len).sum();
        let Some(pipe) = end.reads.and_then(|pipe| self.objects.pipe(pipe)) else {
            return error(libc::EBADF);
        };
        let Some(bytes) = pipe.read(wanted.min(MOST)) else { return self.later(task, id) };
        let mut taken = 0;
        for (at, len) in parts {
            let part = (*len).min(bytes.len() - taken);
            self.write(task, *at, &bytes[taken..taken + part])?;
            taken += part;
        }
        self.tell_neighbours(id);
        done(taken as i64)
    }

    pub(super) fn write_pipe(
        &mut self,
        task: TaskId,
        id: ObjectId,
        parts: &[(u64, usize)],
    ) -> Answer {
        let Some(&Kind::Pipe(end)) = self.objects.get(id) else { return error(libc::EBADF) };
        let mut bytes = Vec::new();
        for (at, len) in parts {
            let room = MOST - bytes.len();
            bytes.extend(self.read_bytes(task, *at, (*len).min(room))?);
        }
        let Some(pipe) = end.writes.and_then(|pipe| self.objects.pipe(pipe)) else {
            return error(libc::EBADF);
        };
        if pipe.readers == 0 {
            let process = self.number_of(task);
            sys::kill(process, libc::SIGPIPE);
            return error(libc::EPIPE);
        }
        let Some(written) = pipe.write(&bytes) else { return self.later(task, id) };
        self.tell_neighbours(id);
        done(written as i64)
    }

    /// Tells the other side of a pipe that something has changed.
    fn tell_neighbours(&mut self, id: ObjectId) {
        let Some(&Kind::Pipe(end)) = self.objects.get(id) else { return };
        let others = self.objects.neighbours(end);
        others.iter().for_each(|other| self.objects.changed(*other));
        self.touch(&others);
    }

    /// Handles a call on one of a pair of sockets.
    pub(super) fn pair_call(
        &mut self,
        task: TaskId,
        id: ObjectId,
        number: i64,
        a: [u64; 6],
        _first: bool,
    ) -> Answer {
        let parts = match number {
            libc::SYS_sendto | libc::SYS_recvfrom => vec![(a[1], a[2] as usize)],
            libc::SYS_sendmsg | libc::SYS_recvmsg => {
                let header: [u64; 7] = self.read_words(task, a[1])?;
                if number == libc::SYS_sendmsg && header[5] > 0 {
                    return self.refuse("descriptors in a message", libc::EINVAL);
                }
                if number == libc::SYS_recvmsg {
                    self.write_words(task, a[1] + 40, &[0])?;
                    self.write_u32(task, a[1] + 48, 0)?;
                }
                self.parts(task, header[2], header[3])?
            }
            libc::SYS_getsockopt
            | libc::SYS_setsockopt
            | libc::SYS_getsockname
            | libc::SYS_getpeername => return done(0),
            _ => return error(libc::EOPNOTSUPP),
        };
        let flags =
            if matches!(number, libc::SYS_sendto | libc::SYS_recvfrom) { a[3] } else { a[2] };
        let answer = match number {
            libc::SYS_sendto | libc::SYS_sendmsg => self.write_pipe(task, id, &parts),
            _ => self.read_pipe(task, id, &parts),
        };
        match answer {
            Ok(Outcome::Wait(..)) if flags as i32 & libc::MSG_DONTWAIT != 0 => error(libc::EAGAIN),
            answer => answer,
        }
    }

    /// Writes to `at` the number of bytes that a read would return.
    pub(super) fn waiting_bytes(&mut self, task: TaskId, id: ObjectId, at: u64) -> Answer {
        let bytes = match self.objects.get(id) {
            Some(Kind::Packet(socket)) => socket.peek().map_or(0, |frame| frame.bytes.len()),
            Some(&Kind::Pipe(end)) => {
                end.reads.and_then(|pipe| self.objects.pipe(pipe)).map_or(0, |pipe| pipe.len())
            }
            Some(Kind::Outside(_)) => return Ok(Outcome::Pass),
            _ => return error(libc::ENOTTY),
        };
        self.write_u32(task, at, bytes as u32)?;
        done(0)
    }

    fn set_timer(&mut self, task: TaskId, a: [u64; 6]) -> Answer {
        let id = self.object(task, a[0]).ok_or(Errno(libc::EBADF))?;
        let (interval, value) = self.read_setting(task, a[2])?;
        if a[3] != 0 {
            self.write_timer(task, id, a[3])?;
        }
        let clock = self.timer_clocks.get(&id).copied().unwrap_or(libc::CLOCK_MONOTONIC);
        let base = self.base(clock).unwrap_or(0);
        let first = match value {
            0 => None,
            value if a[1] as i32 & libc::TFD_TIMER_ABSTIME != 0 => {
                Some(super::time::instant(value, base).max(self.now()))
            }
            value => Some(self.ahead(value)),
        };
        let first = first.map(|first| self.host.wakes(first));
        let Some(Kind::Timer(timer)) = self.objects.get_mut(id) else { return error(libc::EINVAL) };
        timer.set(first, interval);
        self.touch(&[id]);
        done(0)
    }

    fn write_timer(&mut self, task: TaskId, id: ObjectId, at: u64) -> Result<(), Errno> {
        let now = self.now();
        let Some(Kind::Timer(timer)) = self.objects.get(id) else {
            return Err(Errno(libc::EINVAL));
        };
        let (interval, next) = (timer.interval(), timer.next().map_or(0, |next| left(next, now).0));
        self.write_timespec(task, at, interval.0 as u64)?;
        self.write_timespec(task, at + 16, next as u64)
    }

    fn close_range(&mut self, task: TaskId, a: [u64; 6]) -> Answer {
        let (from, to) = (a[0] as u32, a[1] as u32);
        let inside = |number: &i32| (from..=to).contains(&(*number as u32));
        let closed: Vec<i32> =
            self.process(task).descriptors.keys().copied().filter(inside).collect();
        const LATER: u64 = 1 << 2;
        for number in closed {
            if a[2] & LATER == 0 {
                self.forget_descriptor(task, number);
            } else if let Some(descriptor) = self.process(task).descriptors.get_mut(&number) {
                descriptor.close_on_exec = true;
            }
        }
        Ok(Outcome::Pass)
    }

    /// Duplicates a descriptor. This is done here if it stands for one of our objects, so that its
    /// number is known.
    fn copy(&mut self, task: TaskId, a: [u64; 6], to: Option<i32>, close_on_exec: bool) -> Answer {
        let Some(object) = self.object(task, a[0]) else {
            if let Some(to) = to {
                self.forget_descriptor(task, to);
            }
            return Ok(Outcome::Pass);
        };
        self.place_copy(task, object, to, close_on_exec)
    }

    fn place_copy(
        &mut self,
        task: TaskId,
        object: ObjectId,
        to: Option<i32>,
        close_on_exec: bool,
    ) -> Answer {
        let ours: OwnedFd = match self.outside.get(&object) {
            Some(ours) => ours.try_clone()?,
            None => sys::stand_in()?,
        };
        let call = self.thread(task).call.id;
        let wanted = to.map(|to| to as u32);
        let number = self.listener().add_descriptor(call, ours.as_fd(), wanted, close_on_exec)?;
        self.objects.retain(object);
        self.forget_descriptor(task, number);
        self.process(task).descriptors.insert(number, Descriptor { object, close_on_exec });
        done(number.into())
    }

    fn fcntl(&mut self, task: TaskId, a: [u64; 6]) -> Answer {
        let (number, command) = (a[0] as i32, a[1] as i32);
        let Some(object) = self.object(task, a[0]) else {
            return match command {
                libc::F_SETLKW | libc::F_OFD_SETLKW => Ok(Outcome::Outside),
                _ => Ok(Outcome::Pass),
            };
        };
        match command {
            libc::F_DUPFD | libc::F_DUPFD_CLOEXEC => {
                let least = a[2] as i32;
                let free = (least..PAGE_DESCRIPTOR as i32)
                    .find(|number| !self.is_open(task, *number))
                    .ok_or(Errno(libc::EMFILE))?;
                self.place_copy(task, object, Some(free), command == libc::F_DUPFD_CLOEXEC)
            }
            libc::F_SETFD => {
                if let Some(descriptor) = self.process(task).descriptors.get_mut(&number) {
                    descriptor.close_on_exec = a[2] as i32 & libc::FD_CLOEXEC != 0;
                }
                Ok(Outcome::Pass)
            }
            libc::F_SETFL => {
                self.objects.set_nonblocking(object, a[2] as i32 & NON_BLOCKING != 0);
                if self.outside.contains_key(&object) { Ok(Outcome::Pass) } else { done(0) }
            }
            libc::F_GETFL if !self.outside.contains_key(&object) => {
                let nonblocking = self.objects.is_nonblocking(object);
                done(i64::from(libc::O_RDWR | if nonblocking { NON_BLOCKING } else { 0 }))
            }
            _ => Ok(Outcome::Pass),
        }
    }

    fn is_open(&mut self, task: TaskId, number: i32) -> bool {
        let process = self.number_of(task);
        fs::symlink_metadata(format!("/proc/{process}/fd/{number}")).is_ok()
    }

    /// Installs two descriptors in the program and writes their numbers to `at`.
    pub(super) fn install_two(
        &mut self,
        task: TaskId,
        objects: [ObjectId; 2],
        close_on_exec: bool,
        at: u64,
    ) -> Answer {
        let mut bytes = Vec::new();
        for object in objects {
            let Outcome::Done(number) = self.install(task, object, close_on_exec)? else {
                return error(libc::EMFILE);
            };
            bytes.extend((number as i32).to_ne_bytes());
        }
        self.write(task, at, &bytes)?;
        done(0)
    }

    /// A read or write on an outside object.
    fn outside_transfer(&mut self, id: ObjectId) -> Answer {
        let ready = self.look_outside(id).0 != 0 || self.objects.is_nonblocking(id);
        Ok(if ready { Outcome::Pass } else { Outcome::Outside })
    }

    /// A call on a descriptor that has no object here: the kernel executes it, and it returns when
    /// it is done.
    pub(super) fn pass_or_outside(&mut self, task: TaskId, number: u64) -> Answer {
        match self.pollable(task, number as i32)? {
            Pollable::Object(id) => self.outside_transfer(id),
            _ => Ok(Outcome::Pass),
        }
    }

    /// How a wait must treat a descriptor.
    pub(super) fn pollable(&mut self, task: TaskId, number: i32) -> Result<Pollable, Errno> {
        if let Some(id) = self.object(task, number as u64) {
            if self.outside.contains_key(&id) {
                self.look_outside(id);
            }
            return Ok(Pollable::Object(id));
        }
        let path = format!("/proc/{}/fd/{number}", self.number_of(task));
        let Ok(about) = fs::metadata(&path) else { return Ok(Pollable::Closed) };
        let kind = about.file_type();
        if !(kind.is_fifo() || kind.is_char_device() || kind.is_socket()) {
            return Ok(Pollable::Always);
        }
        // A terminal or a pipe from outside can be opened a second time and then be waited for
        // here.
        let mut options = fs::OpenOptions::new();
        let again = options.read(true).custom_flags(NON_BLOCKING | libc::O_NOCTTY).open(&path);
        let Ok(again) = again else {
            self.note("a wait on a socket that the program was given: taken as ready");
            return Ok(Pollable::Always);
        };
        let object = self.objects.add(Kind::Outside(Readiness::NONE), false);
        self.outside.insert(object, again.into());
        let descriptor = Descriptor { object, close_on_exec: false };
        self.process(task).descriptors.insert(number, descriptor);
        self.look_outside(object);
        Ok(Pollable::Object(object))
    }

    /// The present readiness of an outside object.
    pub(in crate::supervisor) fn look_outside(&mut self, id: ObjectId) -> Readiness {
        let Some(file) = self.outside.get(&id) else { return Readiness::NONE };
        let mut asked = [PollFd::new(file, PollFlags::IN | PollFlags::OUT)];
        let at_once = Timespec { tv_sec: 0, tv_nsec: 0 };
        let events = match poll(&mut asked, Some(&at_once)) {
            Ok(_) => Readiness(asked[0].revents().bits() as u32),
            Err(_) => Readiness::ERROR,
        };
        if self.objects.set_outside(id, events) {
            self.touch(&[id]);
        }
        events
    }
}
