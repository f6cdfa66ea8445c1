//! Collects the events of SubDevices that the observer of a segment needs.

use isocat_subdevice::{Event, Step};

use crate::brief::{Brief, Parts};
use crate::observation::{Observation, Observed};
use crate::oscillator::Factor;

/// The events that were seen, as far as they are needed: most steps of most SubDevices are not.
#[derive(Debug)]
pub struct Watcher {
    seen: Vec<Observation>,
    /// The kinds of events that are kept: see [`kind`].
    keeps: u16,
    /// Regular events and their steps, if they are noted briefly: the first ones of these.
    briefs: Vec<Brief>,
    noted: usize,
    /// The number of briefs for which there is room; 0: events are not noted briefly. What finds no
    /// room is seen as any other event, so that nothing has to grow while a SubDevice advances.
    room: usize,
    /// Whether the state of a SubDevice has changed since they were taken last.
    changed: bool,
}

impl Watcher {
    /// Keeps nothing.
    pub const fn blind() -> Self {
        Self::keeping(0)
    }

    const fn keeping(keeps: u16) -> Self {
        Self { seen: Vec::new(), keeps, briefs: Vec::new(), noted: 0, room: 0, changed: false }
    }

    /// Keeps all events.
    pub const fn of_everything() -> Self {
        Self::keeping(EVERYTHING)
    }

    /// Keeps the events that the judges of a run need before they begin: changes of state.
    pub(crate) fn for_judges() -> Self {
        Self { seen: Vec::with_capacity(256), ..Self::keeping(STATES) }
    }

    /// Keeps the events that the judges of a served segment need: it does not follow the age of
    /// inputs.
    pub(crate) fn for_served() -> Self {
        let keeps = JUDGED & !kind(Observed::Began(Step::LatchInputs));
        Self { seen: Vec::with_capacity(1024), ..Self::keeping(keeps) }
    }

    /// From now on keeps what tells samples of inputs, too.
    pub(crate) fn keep_samples(&mut self) {
        self.keeps |= kind(Observed::Began(Step::LatchInputs));
    }

    /// From now on keeps all events.
    pub(crate) fn keep_everything(&mut self) {
        (self.keeps, self.room) = (EVERYTHING, 0);
    }

    /// From now on keeps only the events that the judges of a run need, and notes regular ones
    /// briefly; `timed`: of a segment in which one of its `devices` SubDevices has SYNC0.
    pub(crate) fn keep_for_judges(&mut self, timed: bool, devices: usize) {
        self.keeps = if timed { JUDGED } else { JUDGED & !TIMED };
        // As a rule each SubDevice has one in a cycle.
        self.make_room(devices + SPARE_ROOM);
    }

    fn make_room(&mut self, room: usize) {
        self.briefs.resize(room, Brief::NONE);
        self.room = room;
    }

    /// Whether regular events are noted [briefly](Self::new_brief), and there is room for one more.
    #[inline(always)]
    pub(crate) const fn is_brief(&self) -> bool {
        self.noted < self.room
    }

    /// The last brief, if it is of this SubDevice and these parts can be added to it: it has only
    /// parts that come before them, and nothing else was seen since.
    #[inline(always)]
    pub(crate) fn last_brief(&mut self, device: u32, parts: Parts) -> Option<&mut Brief> {
        let last = self.briefs.get_mut(self.noted.wrapping_sub(1))?;
        let is_next = last.device == device
            && last.before as usize == self.seen.len()
            && last.has.come_before(parts);
        if !is_next {
            return None;
        }
        last.has = last.has.with(parts);
        Some(last)
    }

    /// A new brief of a SubDevice, with the version of its state, and with these parts; `factor` is
    /// that of its oscillator. Call this only if the watcher [is brief](Self::is_brief).
    #[inline(always)]
    pub(crate) fn new_brief(
        &mut self,
        device: u32,
        version: u32,
        factor: Factor,
        parts: Parts,
    ) -> &mut Brief {
        let brief = &mut self.briefs[self.noted];
        self.noted += 1;
        brief.before = self.seen.len() as u32;
        (brief.device, brief.version, brief.factor, brief.has) = (device, version, factor, parts);
        brief
    }

    /// Notes that the state of a SubDevice changes.
    pub(crate) fn note_change(&mut self) {
        self.changed = true;
    }

    /// The regular events that were noted, and whether the state of a SubDevice has changed
    /// meanwhile.
    pub(crate) fn briefs(&self) -> (&[Brief], bool) {
        (&self.briefs[..self.noted], self.changed)
    }

    /// Keeps an event if it is needed.
    #[inline(always)]
    pub(crate) fn see(&mut self, observation: Observation) {
        if self.keeps(observation.event) {
            self.seen.push(observation);
        }
    }

    /// Whether all events are kept, as for somebody who looks on all the time.
    pub(crate) const fn keeps_everything(&self) -> bool {
        self.keeps == EVERYTHING
    }

    /// Whether events of this kind are kept.
    #[inline(always)]
    pub(crate) const fn keeps(&self, event: Observed) -> bool {
        self.keeps & kind(event) != 0
    }

    /// Whether the beginning or the end of any step is kept.
    #[inline(always)]
    pub(crate) const fn keeps_steps(&self) -> bool {
        self.keeps & (kind(Observed::Acknowledged(Event::Sync0)) - 1) != 0
    }

    /// Whether the beginning of this step is kept, or its end.
    #[inline(always)]
    pub(crate) const fn keeps_step(&self, step: Step) -> bool {
        self.keeps & (kind(Observed::Began(step)) | kind(Observed::Finished(step))) != 0
    }

    /// Whether the beginning or the end of a step is kept during which others may come, and which
    /// does all at its end.
    #[inline(always)]
    pub(crate) const fn keeps_work(&self) -> bool {
        self.keeps_step(Step::Application) || self.keeps_step(Step::MapInputs)
    }

    /// The events that were kept and not taken yet, in order.
    pub(crate) fn seen(&self) -> &[Observation] {
        &self.seen
    }

    /// Forgets them, and what was noted.
    pub(crate) fn clear(&mut self) {
        self.seen.clear();
        if self.noted > 0 && self.noted == self.room {
            self.make_room(2 * self.room);
        }
        (self.noted, self.changed) = (0, false);
    }

    /// Takes the events that were kept since the last call, in order.
    pub fn take(&mut self) -> impl Iterator<Item = Observation> + '_ {
        self.seen.drain(..)
    }
}

/// Whether judges need an event.
#[inline]
pub(crate) const fn is_judged(event: Observed) -> bool {
    JUDGED & kind(event) != 0
}

/// One bit for each kind of event: each step's beginning and end, acknowledges, and all others.
#[inline]
const fn kind(event: Observed) -> u16 {
    match event {
        Observed::Began(step) => 1 << step as u16,
        Observed::Finished(step) => 1 << (step as u16 + STEPS),
        Observed::Acknowledged(_) => 1 << (2 * STEPS),
        Observed::State(..) => STATES,
        _ => OTHERS,
    }
}

const STEPS: u16 = Step::ALL.len() as u16;
const OTHERS: u16 = 1 << (2 * STEPS + 1);
const STATES: u16 = 1 << (2 * STEPS + 2);
const EVERYTHING: u16 = u16::MAX;
/// Room for further briefs besides one of each SubDevice.
const SPARE_ROOM: usize = 64;
const JUDGED: u16 = OTHERS
    | STATES
    | kind(Observed::Began(Step::MapOutputs))
    | kind(Observed::Finished(Step::MapOutputs))
    | kind(Observed::Began(Step::OutputsValid))
    | kind(Observed::Began(Step::LatchInputs));
/// What matters only at SubDevices with SYNC0: whether outputs are ready in time.
const TIMED: u16 =
    kind(Observed::Began(Step::MapOutputs)) | kind(Observed::Finished(Step::MapOutputs));

#[cfg(test)]
mod tests {
    use isocat_wire::{AlState, AlStatusCode, Time};

    use super::*;

    #[test]
    fn each_watcher_keeps_what_it_needs() {
        let steps = Step::ALL.into_iter();
        let events: Vec<Observed> = (steps.clone().map(Observed::Began))
            .chain(steps.map(Observed::Finished))
            .chain([
                Observed::Acknowledged(Event::Sync0),
                Observed::Sm2,
                Observed::SmEventMissed(1),
                Observed::State(AlState::Op, AlStatusCode::NO_ERROR),
            ])
            .collect();
        let kept = |mut watcher: Watcher| {
            for event in &events {
                let (device_at, content) = (Time::ZERO, Default::default());
                watcher.see(Observation { device: 0, device_at, event: *event, content });
            }
            watcher.take().map(|seen| seen.event).collect::<Vec<_>>()
        };
        assert_eq!(kept(Watcher::blind()), []);
        assert_eq!(kept(Watcher::of_everything()), events);
        use Observed::*;
        let map = [Began(Step::MapOutputs), Began(Step::OutputsValid)];
        let state = State(AlState::Op, AlStatusCode::NO_ERROR);
        let others = [Finished(Step::MapOutputs), Sm2, SmEventMissed(1), state];
        assert_eq!(kept(Watcher::for_served()), [&map[..], &others].concat());
        let map = [&map[..], &[Began(Step::LatchInputs)]].concat();
        let mut sampling = Watcher::for_served();
        sampling.keep_samples();
        assert_eq!(kept(sampling), [&map[..], &others].concat());
        assert_eq!(kept(Watcher::for_judges()), [state]);
        let mut timed = Watcher::for_judges();
        timed.keep_for_judges(true, 1);
        assert_eq!(kept(timed), [&map[..], &others].concat());
        let mut untimed = Watcher::for_judges();
        untimed.keep_for_judges(false, 1);
        let steps = [Began(Step::OutputsValid), Began(Step::LatchInputs)];
        assert_eq!(kept(untimed), [&steps[..], &others[1..]].concat());
    }

    /// Parts go into the last brief only if they come behind all that is in it, and if nothing else
    /// came between; beyond the room nothing is noted.
    #[test]
    fn briefs_are_of_one_subdevice_and_in_order() {
        let mut watcher = Watcher::for_judges();
        assert!(!watcher.is_brief(), "the judging has not begun");
        watcher.keep_for_judges(true, 1);
        let note = |watcher: &mut Watcher, device, parts| {
            let is_last = watcher.last_brief(device, parts).is_some();
            if !is_last {
                watcher.new_brief(device, 1, Factor::NONE, parts);
            }
            is_last
        };
        assert!(!note(&mut watcher, 3, Parts::STORED));
        assert!(note(&mut watcher, 3, Parts::MAPPED) && note(&mut watcher, 3, Parts::SYNC0));
        assert!(!note(&mut watcher, 3, Parts::MAPPED), "it comes before the pulse");
        assert!(!note(&mut watcher, 4, Parts::VALID), "another SubDevice");
        let (device_at, content) = (Time::ZERO, Default::default());
        watcher.see(Observation { device: 4, device_at, event: Observed::Sm2, content });
        assert!(!note(&mut watcher, 4, Parts::LATCHED), "something else came between");
        let noted: Vec<_> = watcher.briefs().0.iter().map(|it| (it.device, it.before)).collect();
        assert_eq!(noted, [(3, 0), (3, 0), (4, 0), (4, 1)]);
        let more = (0..).take_while(|_| watcher.is_brief() && !note(&mut watcher, 5, Parts::NONE));
        assert_eq!(more.count(), 1 + SPARE_ROOM - 4);
        watcher.clear();
        assert!(watcher.is_brief() && watcher.briefs().0.is_empty());
        watcher.keep_everything();
        assert!(!watcher.is_brief());
    }
}
