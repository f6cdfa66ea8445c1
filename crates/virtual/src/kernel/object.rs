//! The objects behind the descriptors of programs.

use std::ops::{BitOr, BitOrAssign};

use isocat_wire::time::{Host, Time};

use super::epoll::Epoll;
use super::event::EventCounter;
use super::packet::{Arrived, PacketSocket};
use super::pipe::{End, Pipe, PipeId};
use super::timer::Timer;

/// The number of an open file description. Duplicated descriptors share one.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct ObjectId(pub u32);

/// The kind of an object.
#[derive(Debug)]
pub enum Kind {
    /// A socket on a virtual interface.
    Packet(PacketSocket),
    /// A timer.
    Timer(Timer),
    /// An event counter.
    Event(EventCounter),
    /// An end of a pipe, or of a pair of sockets.
    Pipe(End),
    /// An epoll set of other objects.
    Epoll(Epoll),
    /// An object outside of the supervisor; [`Objects::set_outside`] sets its readiness.
    Outside(Readiness),
}

/// The readiness of an object, as bits of `poll`.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Readiness(pub u32);

impl Readiness {
    /// No bit is set.
    pub const NONE: Self = Self(0);
    /// Something can be read.
    pub const READ: Self = Self(0x001 | 0x040);
    /// Something can be written.
    pub const WRITE: Self = Self(0x004 | 0x100);
    /// The object has no reader for what is written.
    pub const ERROR: Self = Self(0x008);
    /// The object has no writer any more.
    pub const HANG_UP: Self = Self(0x010);

    fn when(self, holds: bool) -> Self {
        if holds { self } else { Self::NONE }
    }
}

impl BitOr for Readiness {
    type Output = Self;

    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

impl BitOrAssign for Readiness {
    fn bitor_assign(&mut self, other: Self) {
        self.0 |= other.0;
    }
}

/// All open file descriptions, and the pipes between them.
#[derive(Debug, Default)]
pub struct Objects {
    slots: Vec<Option<Object>>,
    pipes: Vec<Option<Pipe>>,
}

#[derive(Debug)]
struct Object {
    /// Number of descriptors of all processes that refer to the object.
    references: u32,
    nonblocking: bool,
    changes: u64,
    kind: Kind,
}

impl Objects {
    /// Adds an object with one descriptor.
    pub fn add(&mut self, kind: Kind, nonblocking: bool) -> ObjectId {
        let object = Some(Object { references: 1, nonblocking, changes: 0, kind });
        ObjectId(put(&mut self.slots, object))
    }

    /// Adds a pipe. Returns its reading end, then its writing end.
    pub fn add_pipe(&mut self, nonblocking: bool) -> (ObjectId, ObjectId) {
        let pipe = PipeId(put(&mut self.pipes, Some(Pipe::new(false))));
        let reader = End { reads: Some(pipe), writes: None };
        let writer = End { reads: None, writes: Some(pipe) };
        (self.add(Kind::Pipe(reader), nonblocking), self.add(Kind::Pipe(writer), nonblocking))
    }

    /// Adds two sockets that are connected to each other.
    pub fn add_pair(&mut self, datagrams: bool, nonblocking: bool) -> (ObjectId, ObjectId) {
        let [there, back] =
            [(); 2].map(|()| PipeId(put(&mut self.pipes, Some(Pipe::new(datagrams)))));
        let one = End { reads: Some(back), writes: Some(there) };
        let other = End { reads: Some(there), writes: Some(back) };
        (self.add(Kind::Pipe(one), nonblocking), self.add(Kind::Pipe(other), nonblocking))
    }

    /// Counts another descriptor of the object.
    pub fn retain(&mut self, id: ObjectId) {
        if let Some(object) = &mut self.slots[id.0 as usize] {
            object.references += 1;
        }
    }

    /// Removes a descriptor of the object. Returns the objects whose state changed by that: the
    /// last descriptor ends the object, and the end of one side of a pipe is visible at the other
    /// side.
    pub fn release(&mut self, id: ObjectId) -> Vec<ObjectId> {
        let slot = &mut self.slots[id.0 as usize];
        let Some(object) = slot else { return Vec::new() };
        object.references -= 1;
        if object.references > 0 {
            return Vec::new();
        }
        let ended = slot.take();
        for object in self.slots.iter_mut().flatten() {
            if let Kind::Epoll(epoll) = &mut object.kind {
                epoll.forget(id);
            }
        }
        match ended.map(|object| object.kind) {
            Some(Kind::Pipe(end)) => self.end_of_pipe(end),
            _ => Vec::new(),
        }
    }

    fn end_of_pipe(&mut self, end: End) -> Vec<ObjectId> {
        for (pipe, reads) in [(end.reads, true), (end.writes, false)] {
            let Some(id) = pipe else { continue };
            let slot = &mut self.pipes[id.0 as usize];
            let Some(pipe) = slot else { continue };
            let count = if reads { &mut pipe.readers } else { &mut pipe.writers };
            *count -= 1;
            if pipe.readers == 0 && pipe.writers == 0 {
                *slot = None;
            }
        }
        self.neighbours(end)
    }

    /// The objects at the other side of a pipe, which see the actions at an end.
    pub fn neighbours(&self, end: End) -> Vec<ObjectId> {
        let others = |other: End| {
            other.reads.is_some() && other.reads == end.writes
                || other.writes.is_some() && other.writes == end.reads
        };
        let all = self.slots.iter().enumerate();
        all.filter(|(_, slot)| {
            slot.as_ref()
                .is_some_and(|object| matches!(object.kind, Kind::Pipe(other) if others(other)))
        })
        .map(|(at, _)| ObjectId(at as u32))
        .collect()
    }

    /// The kind of the object; `None` if it does not exist any more.
    pub fn get(&self, id: ObjectId) -> Option<&Kind> {
        self.slots.get(id.0 as usize)?.as_ref().map(|object| &object.kind)
    }

    /// The kind of the object, to change it.
    pub fn get_mut(&mut self, id: ObjectId) -> Option<&mut Kind> {
        self.slots.get_mut(id.0 as usize)?.as_mut().map(|object| &mut object.kind)
    }

    /// A pipe whose ends are open.
    pub fn pipe(&mut self, id: PipeId) -> Option<&mut Pipe> {
        self.pipes[id.0 as usize].as_mut()
    }

    /// Whether calls on the object return at once.
    pub fn is_nonblocking(&self, id: ObjectId) -> bool {
        self.slots[id.0 as usize].as_ref().is_some_and(|object| object.nonblocking)
    }

    /// Sets whether calls on the object return at once (`O_NONBLOCK`).
    pub fn set_nonblocking(&mut self, id: ObjectId, nonblocking: bool) {
        if let Some(object) = &mut self.slots[id.0 as usize] {
            object.nonblocking = nonblocking;
        }
    }

    /// Counts a change: there is something new to read, or new space to write.
    pub fn changed(&mut self, id: ObjectId) {
        if let Some(object) = &mut self.slots[id.0 as usize] {
            object.changes += 1;
        }
    }

    /// Number of changes of the object.
    pub fn changes(&self, id: ObjectId) -> u64 {
        self.slots[id.0 as usize].as_ref().map_or(0, |object| object.changes)
    }

    /// Sets the readiness of an outside object. Returns whether it has changed.
    pub fn set_outside(&mut self, id: ObjectId, now: Readiness) -> bool {
        let Some(Kind::Outside(before)) = self.get_mut(id) else { return false };
        let is_new = now.0 & !before.0 != 0;
        *before = now;
        if is_new {
            self.changed(id);
        }
        is_new
    }

    /// The present readiness of the object.
    pub fn readiness(&self, id: ObjectId) -> Readiness {
        use Readiness as R;
        match self.get(id) {
            None => R::ERROR,
            Some(Kind::Packet(socket)) => R::WRITE | R::READ.when(socket.is_readable()),
            Some(Kind::Timer(timer)) => R::READ.when(timer.is_readable()),
            Some(Kind::Event(counter)) => {
                R::READ.when(counter.is_readable()) | R::WRITE.when(counter.is_writable())
            }
            Some(Kind::Epoll(epoll)) => R::READ.when(!epoll.ready(self, 1).is_empty()),
            Some(Kind::Outside(readiness)) => *readiness,
            Some(Kind::Pipe(end)) => self.readiness_of_end(*end),
        }
    }

    fn readiness_of_end(&self, end: End) -> Readiness {
        use Readiness as R;
        let pipe = |id: PipeId| self.pipes[id.0 as usize].as_ref();
        let mut readiness = R::NONE;
        if let Some(pipe) = end.reads.and_then(pipe) {
            let ended = pipe.writers == 0;
            readiness |= R::READ.when(pipe.is_readable() || ended && end.writes.is_some());
            readiness |= R::HANG_UP.when(ended);
        }
        if let Some(pipe) = end.writes.and_then(pipe) {
            readiness |= R::WRITE.when(pipe.is_writable() || pipe.readers == 0);
            readiness |= R::ERROR.when(pipe.readers == 0 && end.reads.is_none());
        }
        readiness
    }

    /// The objects whose changes a wait on this one must see: itself, and the members of a set.
    pub fn watched(&self, id: ObjectId) -> Vec<ObjectId> {
        let mut all = vec![id];
        if let Some(Kind::Epoll(epoll)) = self.get(id) {
            epoll.objects().for_each(|member| all.extend(self.watched(member)));
        }
        all
    }

    /// The instant at which the next timer expires.
    pub fn next_timer(&self) -> Time<Host> {
        let timers = self.slots.iter().flatten().filter_map(|object| match &object.kind {
            Kind::Timer(timer) => timer.next(),
            _ => None,
        });
        timers.min().unwrap_or(Time::NEVER)
    }

    /// Lets timers expire up to `now`. Returns those that did.
    pub fn fire_timers(&mut self, now: Time<Host>) -> Vec<ObjectId> {
        let mut fired = Vec::new();
        for (at, object) in self.slots.iter_mut().enumerate() {
            let Some(object) = object else { continue };
            if let Kind::Timer(timer) = &mut object.kind
                && timer.fire(now) > 0
            {
                object.changes += 1;
                fired.push(ObjectId(at as u32));
            }
        }
        fired
    }

    /// Delivers a frame to all sockets that accept it. Returns these.
    pub fn deliver(&mut self, frame: &Arrived) -> Vec<ObjectId> {
        let mut takers = Vec::new();
        for (at, object) in self.slots.iter_mut().enumerate() {
            let Some(object) = object else { continue };
            if let Kind::Packet(socket) = &mut object.kind
                && socket.offer(frame)
            {
                object.changes += 1;
                takers.push(ObjectId(at as u32));
            }
        }
        takers
    }

    /// The outside objects.
    pub fn outside(&self) -> impl Iterator<Item = ObjectId> {
        let all = self.slots.iter().enumerate();
        let outside = |object: &Object| matches!(object.kind, Kind::Outside(_));
        all.filter(move |(_, slot)| slot.as_ref().is_some_and(outside))
            .map(|(at, _)| ObjectId(at as u32))
    }

    /// Takes a frame from a packet socket.
    pub fn receive(&mut self, id: ObjectId) -> Option<Arrived> {
        match self.get_mut(id)? {
            Kind::Packet(socket) => socket.take(),
            _ => None,
        }
    }
}

/// Puts a value into a free slot and returns its index.
fn put<T>(slots: &mut Vec<Option<T>>, new: Option<T>) -> u32 {
    let free = slots.iter().position(Option::is_none);
    let place = free.unwrap_or(slots.len());
    match free {
        Some(place) => slots[place] = new,
        None => slots.push(new),
    }
    place as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use isocat_wire::time::Nanos;

    #[test]
    fn the_last_descriptor_ends_an_object() {
        let mut objects = Objects::default();
        let id = objects.add(Kind::Event(EventCounter::new(1, false)), false);
        objects.retain(id);
        objects.release(id);
        assert!(objects.get(id).is_some());
        objects.release(id);
        assert!(objects.get(id).is_none());
        assert_eq!(objects.add(Kind::Timer(Timer::default()), false), id, "its place is free");
    }

    #[test]
    fn the_end_of_a_pipe_is_noticed_at_the_other() {
        let mut objects = Objects::default();
        let (reader, writer) = objects.add_pipe(false);
        assert_eq!(objects.readiness(reader), Readiness::NONE);
        assert_eq!(objects.readiness(writer), Readiness::WRITE);
        assert_eq!(objects.release(writer), [reader]);
        assert_eq!(objects.readiness(reader), Readiness::HANG_UP);
    }

    #[test]
    fn what_one_socket_of_a_pair_writes_the_other_reads() {
        let mut objects = Objects::default();
        let (one, other) = objects.add_pair(false, true);
        let Some(&Kind::Pipe(end)) = objects.get(one) else { panic!("a pair") };
        objects.pipe(end.writes.expect("writes")).expect("open").write(b"hello");
        assert_eq!(objects.neighbours(end), [other]);
        assert_eq!(objects.readiness(other), Readiness::READ | Readiness::WRITE);
        assert_eq!(objects.readiness(one), Readiness::WRITE);
    }

    #[test]
    fn a_set_within_a_set_is_watched_with_its_members() {
        let mut objects = Objects::default();
        let mut timer = Timer::default();
        timer.set(Some(Time::new(10)), Nanos::ZERO);
        let timer = objects.add(Kind::Timer(timer), false);
        let mut inner = Epoll::default();
        inner.add(super::super::epoll::Interest::new(5, timer, 1, 0));
        let inner = objects.add(Kind::Epoll(inner), false);
        let mut outer = Epoll::default();
        outer.add(super::super::epoll::Interest::new(6, inner, 1, 0));
        let outer = objects.add(Kind::Epoll(outer), false);
        assert_eq!(objects.watched(outer), [outer, inner, timer]);
        assert_eq!(objects.readiness(outer), Readiness::NONE);
        assert_eq!(objects.next_timer(), Time::new(10));
        assert_eq!(objects.fire_timers(Time::new(10)), [timer]);
        assert_eq!(objects.readiness(outer), Readiness::READ);
    }
}
