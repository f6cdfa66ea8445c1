//! Epoll sets: which objects, for which events, told how.

use super::object::{ObjectId, Objects, Readiness};

/// Tell each change once, and not as long as it holds (`EPOLLET`).
const EDGE: u32 = 1 << 31;
/// Tell one change, then nothing until the interest is set anew (`EPOLLONESHOT`).
const ONE_SHOT: u32 = 1 << 30;

/// One member of a set.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Interest {
    /// The number under which the program added it.
    pub descriptor: i32,
    /// What stands behind it.
    pub object: ObjectId,
    /// The events that are asked for, and how they are told.
    pub events: u32,
    /// What the program wants told with them.
    pub data: u64,
    /// The object's changes when it was told last.
    seen: Option<u64>,
}

impl Interest {
    /// A member about which nothing was told yet.
    pub fn new(descriptor: i32, object: ObjectId, events: u32, data: u64) -> Self {
        Self { descriptor, object, events, data, seen: None }
    }
}

/// A set.
#[derive(Debug, Default)]
pub struct Epoll {
    members: Vec<Interest>,
}

impl Epoll {
    /// Adds a member; `false` if it is one already.
    pub fn add(&mut self, interest: Interest) -> bool {
        let new = self.place(interest.descriptor, interest.object).is_none();
        if new {
            self.members.push(interest);
        }
        new
    }

    /// Changes what is asked of a member; `false` if it is none.
    pub fn change(&mut self, interest: Interest) -> bool {
        let place = self.place(interest.descriptor, interest.object);
        place.map(|place| self.members[place] = interest).is_some()
    }

    /// Removes a member; `false` if it is none.
    pub fn remove(&mut self, descriptor: i32, object: ObjectId) -> bool {
        let place = self.place(descriptor, object);
        place.map(|place| self.members.remove(place)).is_some()
    }

    /// Removes all members that stand for an object that is no more.
    pub fn forget(&mut self, object: ObjectId) {
        self.members.retain(|member| member.object != object);
    }

    /// The members' objects.
    pub fn objects(&self) -> impl Iterator<Item = ObjectId> {
        self.members.iter().map(|member| member.object)
    }

    /// Which members are to be told of, at most `most`: events and data of each.
    pub fn ready(&self, objects: &Objects, most: usize) -> Vec<(Interest, u32)> {
        let told = |member: &Interest| {
            let events = wanted(member, objects)?;
            let changed = member.seen != Some(objects.changes(member.object));
            (member.events & EDGE == 0 || changed).then_some((*member, events))
        };
        self.members.iter().filter_map(told).take(most).collect()
    }

    /// These were told of. A set tells first, next time, of those that it did not tell of now.
    pub fn told(&mut self, told: &[(Interest, u32)], changes: impl Fn(ObjectId) -> u64) {
        for (interest, _) in told {
            let Some(place) = self.place(interest.descriptor, interest.object) else { continue };
            let mut member = self.members.remove(place);
            member.seen = Some(changes(member.object));
            if member.events & ONE_SHOT != 0 {
                member.events &= EDGE | ONE_SHOT;
            }
            self.members.push(member);
        }
    }

    fn place(&self, descriptor: i32, object: ObjectId) -> Option<usize> {
        let same = |member: &Interest| (member.descriptor, member.object) == (descriptor, object);
        self.members.iter().position(same)
    }
}

/// The events of a member that hold now, if there are some of those asked for.
fn wanted(member: &Interest, objects: &Objects) -> Option<u32> {
    let asked = member.events & !(EDGE | ONE_SHOT);
    if asked == 0 {
        return None;
    }
    // Errors and ends are told without being asked for.
    let always = Readiness::ERROR | Readiness::HANG_UP;
    let events = objects.readiness(member.object).0 & (asked | always.0);
    (events != 0).then_some(events)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::{EventCounter, Kind};

    const READ: u32 = 1;

    fn counter(count: u64) -> (Objects, ObjectId) {
        let mut objects = Objects::default();
        let id = objects.add(Kind::Event(EventCounter::new(count, false)), false);
        (objects, id)
    }

    fn tell(epoll: &mut Epoll, objects: &Objects) -> usize {
        let ready = epoll.ready(objects, 9);
        epoll.told(&ready, |id| objects.changes(id));
        ready.len()
    }

    #[test]
    fn a_level_is_told_as_long_as_it_holds_and_an_edge_once() {
        let (mut objects, id) = counter(1);
        let mut level = Epoll::default();
        assert!(level.add(Interest::new(3, id, READ, 0)));
        assert!(!level.add(Interest::new(3, id, READ, 0)), "a member already");
        assert_eq!((tell(&mut level, &objects), tell(&mut level, &objects)), (1, 1));
        let mut edge = Epoll::default();
        edge.add(Interest::new(3, id, READ | EDGE, 0));
        assert_eq!((tell(&mut edge, &objects), tell(&mut edge, &objects)), (1, 0));
        objects.changed(id);
        assert_eq!((tell(&mut edge, &objects), tell(&mut edge, &objects)), (1, 0));
    }

    #[test]
    fn one_shot_is_silent_until_it_is_set_anew() {
        let (objects, id) = counter(1);
        let mut epoll = Epoll::default();
        epoll.add(Interest::new(3, id, READ | ONE_SHOT, 7));
        assert_eq!((tell(&mut epoll, &objects), tell(&mut epoll, &objects)), (1, 0));
        assert!(epoll.change(Interest::new(3, id, READ | ONE_SHOT, 7)));
        assert_eq!(tell(&mut epoll, &objects), 1);
        assert!(epoll.remove(3, id) && !epoll.remove(3, id));
    }

    #[test]
    fn members_take_turns_where_there_is_no_room_for_all() {
        let (mut objects, a) = counter(1);
        let b = objects.add(Kind::Event(EventCounter::new(1, false)), false);
        let mut epoll = Epoll::default();
        epoll.add(Interest::new(3, a, READ, 0));
        epoll.add(Interest::new(4, b, READ, 0));
        let mut first = || {
            let ready = epoll.ready(&objects, 1);
            epoll.told(&ready, |id| objects.changes(id));
            ready[0].0.descriptor
        };
        assert_eq!([first(), first(), first()], [3, 4, 3]);
    }
}
