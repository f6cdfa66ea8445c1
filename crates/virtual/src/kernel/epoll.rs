//! Epoll sets: their objects, the events asked for, and how events are reported.

use super::object::{ObjectId, Objects, Readiness};

/// Report each change once, and not as long as it holds (`EPOLLET`).
const EDGE: u32 = 1 << 31;
/// Report one change, then nothing until the interest is set again (`EPOLLONESHOT`).
const ONE_SHOT: u32 = 1 << 30;

/// One member of a set.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Interest {
    /// The number under which the program added it.
    pub descriptor: i32,
    /// The object behind the descriptor.
    pub object: ObjectId,
    /// The events that are asked for, and the way to report them.
    pub events: u32,
    /// The data that the program wants reported with the events.
    pub data: u64,
    /// The change counter of the object at the last report.
    seen: Option<u64>,
}

impl Interest {
    /// A member without a report yet.
    pub fn new(descriptor: i32, object: ObjectId, events: u32, data: u64) -> Self {
        Self { descriptor, object, events, data, seen: None }
    }
}

/// An epoll set.
#[derive(Debug, Default)]
pub struct Epoll {
    members: Vec<Interest>,
}

impl Epoll {
    /// Adds a member; `false` if it is already in the set.
    pub fn add(&mut self, interest: Interest) -> bool {
        let new = self.place(interest.descriptor, interest.object).is_none();
        if new {
            self.members.push(interest);
        }
        new
    }

    /// Changes the interest of a member; `false` if it is not in the set.
    pub fn change(&mut self, interest: Interest) -> bool {
        let place = self.place(interest.descriptor, interest.object);
        place.map(|place| self.members[place] = interest).is_some()
    }

    /// Removes a member; `false` if it is not in the set.
    pub fn remove(&mut self, descriptor: i32, object: ObjectId) -> bool {
        let place = self.place(descriptor, object);
        place.map(|place| self.members.remove(place)).is_some()
    }

    /// Removes all members of an object that does not exist any more.
    pub fn forget(&mut self, object: ObjectId) {
        self.members.retain(|member| member.object != object);
    }

    /// The objects of the members.
    pub fn objects(&self) -> impl Iterator<Item = ObjectId> {
        self.members.iter().map(|member| member.object)
    }

    /// The members to report, at most `most`, with the events of each.
    pub fn ready(&self, objects: &Objects, most: usize) -> Vec<(Interest, u32)> {
        let told = |member: &Interest| {
            let events = wanted(member, objects)?;
            let changed = member.seen != Some(objects.changes(member.object));
            (member.events & EDGE == 0 || changed).then_some((*member, events))
        };
        self.members.iter().filter_map(told).take(most).collect()
    }

    /// Notes that these members were reported. They move to the end of the set, so that the next
    /// report begins with the others.
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

/// The present events of a member, if any of those asked for holds.
fn wanted(member: &Interest, objects: &Objects) -> Option<u32> {
    let asked = member.events & !(EDGE | ONE_SHOT);
    if asked == 0 {
        return None;
    }
    // Errors and hang-ups are reported without being asked for.
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
