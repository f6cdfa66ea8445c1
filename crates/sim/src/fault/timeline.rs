//! The planned faults, those in force, and those that have happened, in the order of time.

use std::collections::VecDeque;

use isocat_wire::time::{Nanos, Picos, Time, True};

use crate::device::DeviceSetup;
use crate::fault::{Fault, Foreign, MILLION, Moment, Planned, When, is_of_the_wire};
use crate::oscillator::Bend;
use crate::random::Stream;

/// The faults of a run.
///
/// - [`new`](Self::new) takes the planned faults; [`order`](Self::order) adds a fault during the
///   run.
/// - The simulation applies the faults at their instants; code that knows of a [`Moment`] reports
///   it with [`reached`](Self::reached).
/// - [`happened`](Self::happened) returns the faults that have happened.
pub struct Timeline {
    pub(super) seed: u64,
    /// Faults whose moment has not been reached.
    waiting: Vec<Planned>,
    /// The next actions, ascending by time and then in the order of their announcement.
    queue: Vec<Entry>,
    pub(super) active: Vec<Active>,
    pub(super) spares: Vec<Option<DeviceSetup>>,
    /// Frames that another MainDevice sends now.
    pub(super) foreign: Vec<Foreign>,
    happened: VecDeque<Happened>,
    /// The faults of `happened` since the last call of [`Self::take_news`].
    news: Vec<Happened>,
    /// Number of faults that are no longer in `happened`.
    left_out: u64,
    chance: Stream,
    next_id: u64,
}

/// A fault that began or ended.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Happened {
    /// When.
    pub at: Time<True>,
    /// The fault.
    pub fault: Fault,
    /// True if it began, false if it ended.
    pub begins: bool,
    /// Its duration, if it begins and the duration is known.
    pub lasts: Option<Nanos>,
}

struct Entry {
    at: Time<True>,
    order: u64,
    action: Action,
}

#[derive(Clone, Debug)]
pub(super) enum Action {
    /// A fault begins, and ends after `lasts`.
    Begin { fault: Fault, lasts: Option<Nanos> },
    /// A fault in force ends.
    End(u64),
    /// A fault in force continues: a flapping cable, another MainDevice.
    Again(u64),
    /// A cable of this length, mm, replaces another one.
    Lay { cable: usize, millimetres: u64 },
    /// The spare SubDevice is put in its place.
    Swap { device: usize, spare: usize },
}

/// A fault in force, and how to undo it.
pub(super) struct Active {
    pub id: u64,
    pub fault: Fault,
    pub undo: Undo,
}

pub(super) enum Undo {
    /// The fault itself tells how to undo it.
    Plain,
    /// The changes of the clock.
    Bends(Vec<Bend>),
    /// The former content of register 0x0981.
    Activation(u8),
    /// Whether the cable is pulled at present.
    Pulled(bool),
}

/// Most faults that are kept in `happened`.
const MOST_HAPPENED: usize = 1_000;

impl Timeline {
    /// The planned faults of a run with this seed. Instants count from the power-on of the segment.
    pub fn new(planned: Vec<Planned>, seed: u64) -> Self {
        let mut timeline = Self {
            seed,
            waiting: Vec::new(),
            queue: Vec::new(),
            active: Vec::new(),
            spares: Vec::new(),
            foreign: Vec::new(),
            happened: VecDeque::new(),
            news: Vec::new(),
            left_out: 0,
            chance: Stream::new(seed, "faults", 0),
            next_id: 0,
        };
        for fault in planned {
            match fault.when {
                When::At(at) => timeline.schedule(&fault, Time::ZERO + Picos::from(at)),
                When::After(..) => timeline.waiting.push(fault),
            }
        }
        timeline
    }

    /// Adds SubDevices that may replace others.
    pub fn with_spares(mut self, spares: Vec<DeviceSetup>) -> Self {
        self.spares = spares.into_iter().map(Some).collect();
        self
    }

    /// Lets a fault begin at `at`, and end after `lasts` if it is given.
    pub fn order(&mut self, at: Time<True>, fault: Fault, lasts: Option<Nanos>) {
        self.push(at, Action::Begin { fault, lasts });
    }

    /// Reports that the MainDevice reached a moment.
    pub fn reached(&mut self, moment: Moment, at: Time<True>) {
        let is_due = |fault: &mut Planned| match (fault.when, moment) {
            (When::After(Moment::Cycle(wanted), _), Moment::Cycle(number)) => number >= wanted,
            (When::After(wanted, _), _) => wanted == moment,
            (When::At(_), _) => false,
        };
        let due: Vec<Planned> = self.waiting.extract_if(.., is_due).collect();
        for fault in due {
            let When::After(_, later) = fault.when else { continue };
            self.schedule(&fault, at + Picos::from(later));
        }
    }

    /// Whether a fault waits for a cycle.
    pub(crate) fn counts_cycles(&self) -> bool {
        let counts = |fault: &Planned| matches!(fault.when, When::After(Moment::Cycle(_), _));
        self.waiting.iter().any(counts)
    }

    /// Whether a planned fault has not begun yet.
    pub fn is_to_come(&self) -> bool {
        let begins = |entry: &Entry| matches!(entry.action, Action::Begin { .. });
        !self.waiting.is_empty() || self.queue.iter().any(begins)
    }

    /// When the next action is due.
    pub fn next(&self) -> Option<Time<True>> {
        self.queue.first().map(|entry| entry.at)
    }

    /// The faults so far, in the order of time; only the last ones if there were very many.
    pub fn happened(&self) -> impl ExactSizeIterator<Item = &Happened> {
        self.happened.iter()
    }

    /// Takes the faults that began or ended since the last call.
    pub fn take_news(&mut self) -> Vec<Happened> {
        std::mem::take(&mut self.news)
    }

    /// The SubDevices that may replace others and have not yet.
    pub(crate) fn spares(&self) -> impl Iterator<Item = &DeviceSetup> {
        self.spares.iter().flatten()
    }

    /// Adds a SubDevice that may replace another; returns its number.
    pub fn add_spare(&mut self, setup: DeviceSetup) -> usize {
        self.spares.push(Some(setup));
        self.spares.len() - 1
    }

    /// Number of faults that are no longer kept.
    pub fn left_out(&self) -> u64 {
        self.left_out
    }

    /// The faults in force.
    pub fn in_force(&self) -> impl Iterator<Item = &Fault> {
        self.active.iter().map(|active| &active.fault)
    }

    /// Takes the frames that another MainDevice sends now.
    pub(crate) fn take_foreign(&mut self) -> Vec<Foreign> {
        std::mem::take(&mut self.foreign)
    }

    /// Whether no fault is planned or in force.
    pub fn is_empty(&self) -> bool {
        self.waiting.is_empty() && self.queue.is_empty() && self.active.is_empty()
    }

    /// Takes the next action that is due by `now`; actions on cables and power are taken by `wire`,
    /// which is later.
    pub(super) fn take(
        &mut self,
        now: Time<True>,
        wire: Time<True>,
    ) -> Option<(Time<True>, Action)> {
        let due = self.queue.iter().position(|entry| {
            entry.at <= now || entry.at <= wire && self.is_wired(&entry.action)
        })?;
        let Entry { at, action, .. } = self.queue.remove(due);
        Some((at, action))
    }

    fn is_wired(&self, action: &Action) -> bool {
        let of_active = |id: &u64| {
            self.active.iter().find(|active| active.id == *id).map(|active| &active.fault)
        };
        match action {
            Action::Begin { fault, .. } => is_of_the_wire(fault),
            Action::End(id) | Action::Again(id) => of_active(id).is_some_and(is_of_the_wire),
            Action::Lay { .. } | Action::Swap { .. } => false,
        }
    }

    pub(super) fn push(&mut self, at: Time<True>, action: Action) {
        let order = self.next_id();
        let place = self.queue.partition_point(|entry| (entry.at, entry.order) <= (at, order));
        self.queue.insert(place, Entry { at, order, action });
    }

    pub(super) fn next_id(&mut self) -> u64 {
        self.next_id += 1;
        self.next_id
    }

    pub(super) fn note(&mut self, happened: Happened) {
        if self.happened.len() >= MOST_HAPPENED {
            self.happened.pop_front();
            self.left_out += 1;
        }
        // Changes of cables are noted before their time, so it is inserted by time.
        let place = self.happened.partition_point(|other| other.at <= happened.at);
        self.happened.insert(place, happened.clone());
        if self.news.len() < MOST_HAPPENED {
            self.news.push(happened);
        }
    }

    /// Schedules every occurrence of a planned fault, with random decisions.
    fn schedule(&mut self, planned: &Planned, first: Time<True>) {
        let Planned { within, ppm, times, every, lasts, ref fault, .. } = *planned;
        for round in 0..times {
            let later = Nanos(self.chance.up_to(within.0.max(0) as u64) as i64);
            let comes = self.chance.up_to(u64::from(MILLION) - 1) < u64::from(ppm);
            let at = first + Picos::from(Nanos(every.0 * i64::from(round)) + later);
            if comes {
                self.push(at, Action::Begin { fault: fault.clone(), lasts });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn instants(timeline: &mut Timeline) -> Vec<u64> {
        let all = std::iter::from_fn(|| timeline.take(Time::NEVER, Time::NEVER));
        all.map(|(at, _)| at.as_nanos()).collect()
    }

    #[test]
    fn faults_come_as_often_as_planned_within_their_span_and_by_chance() {
        let pull = Planned {
            within: Nanos(500),
            times: 1_000,
            every: Nanos(1_000),
            ..Planned::once(When::At(Nanos(10_000)), Fault::Pull { cable: 0 })
        };
        let all = instants(&mut Timeline::new(vec![pull.clone()], 1));
        assert_eq!(all.len(), 1_000);
        for (round, at) in all.iter().enumerate() {
            let first = 10_000 + 1_000 * round as u64;
            assert!((first..=first + 500).contains(at), "{round}: {at}");
        }
        assert!(all.iter().any(|at| at % 1_000 < 50) && all.iter().any(|at| at % 1_000 > 450));
        let some = instants(&mut Timeline::new(vec![Planned { ppm: 300_000, ..pull.clone() }], 1));
        assert!((250..350).contains(&some.len()), "{}", some.len());
        let again = instants(&mut Timeline::new(vec![Planned { ppm: 300_000, ..pull }], 1));
        assert_eq!(some, again, "the same seed gives the same faults");
    }

    #[test]
    fn faults_wait_for_their_moment() {
        let after = |moment| When::After(moment, Nanos(5));
        let planned = [after(Moment::InOperation), after(Moment::Cycle(7))];
        let planned = planned.map(|when| Planned::once(when, Fault::Stall)).to_vec();
        let mut timeline = Timeline::new(planned, 1);
        assert_eq!((timeline.next(), timeline.counts_cycles()), (None, true));
        timeline.reached(Moment::Cycle(6), Time::new(1_000_000));
        assert_eq!(timeline.next(), None);
        timeline.reached(Moment::Cycle(7), Time::new(2_000_000));
        timeline.reached(Moment::InOperation, Time::new(3_000_000));
        timeline.reached(Moment::InOperation, Time::new(4_000_000));
        assert_eq!(instants(&mut timeline), [2_005, 3_005]);
    }
}
