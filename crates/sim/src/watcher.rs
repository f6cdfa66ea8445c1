//! Collects the events of SubDevices that the observer of a segment needs.

use isocat_subdevice::{Event, Step};

use crate::observation::{Observation, Observed};

/// The events that were seen, as far as they are needed: most steps of most SubDevices are not.
#[derive(Debug)]
pub struct Watcher {
    seen: Vec<Observation>,
    /// The kinds of events that are kept: see [`kind`].
    keeps: u16,
}

impl Watcher {
    /// Keeps nothing.
    pub const fn blind() -> Self {
        Self { seen: Vec::new(), keeps: 0 }
    }

    /// Keeps all events.
    pub const fn of_everything() -> Self {
        Self { seen: Vec::new(), keeps: EVERYTHING }
    }

    /// Keeps the events that the judges of a run need.
    pub(crate) fn for_judges() -> Self {
        Self { seen: Vec::with_capacity(256), keeps: JUDGED }
    }

    /// Keeps the events that the judges of a served segment need: it does not follow the age of
    /// inputs.
    pub(crate) fn for_served() -> Self {
        let keeps = JUDGED & !kind(Observed::Began(Step::LatchInputs));
        Self { seen: Vec::with_capacity(1024), keeps }
    }

    /// From now on keeps all events.
    pub(crate) fn keep_everything(&mut self) {
        self.keeps = EVERYTHING;
    }

    /// From now on keeps only the events that the judges of a run need; `timed`: of a segment in
    /// which a SubDevice has SYNC0.
    pub(crate) fn keep_for_judges(&mut self, timed: bool) {
        self.keeps = if timed { JUDGED } else { JUDGED & !TIMED };
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

    /// Forgets them.
    pub(crate) fn clear(&mut self) {
        self.seen.clear();
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
        _ => OTHERS,
    }
}

const STEPS: u16 = Step::ALL.len() as u16;
const OTHERS: u16 = 1 << (2 * STEPS + 1);
const EVERYTHING: u16 = u16::MAX;
const JUDGED: u16 = OTHERS
    | kind(Observed::Began(Step::MapOutputs))
    | kind(Observed::Finished(Step::MapOutputs))
    | kind(Observed::Began(Step::OutputsValid))
    | kind(Observed::Began(Step::LatchInputs));
/// What matters only at SubDevices with SYNC0: whether outputs are ready in time.
const TIMED: u16 =
    kind(Observed::Began(Step::MapOutputs)) | kind(Observed::Finished(Step::MapOutputs));

#[cfg(test)]
mod tests {
    use isocat_wire::Time;

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
        let others = [Finished(Step::MapOutputs), Sm2, SmEventMissed(1)];
        assert_eq!(kept(Watcher::for_served()), [&map[..], &others].concat());
        let map = [&map[..], &[Began(Step::LatchInputs)]].concat();
        assert_eq!(kept(Watcher::for_judges()), [&map[..], &others].concat());
        let mut untimed = Watcher::for_judges();
        untimed.keep_for_judges(false);
        let steps = [Began(Step::OutputsValid), Began(Step::LatchInputs)];
        assert_eq!(kept(untimed), [&steps[..], &[Sm2, SmEventMissed(1)]].concat());
    }
}
