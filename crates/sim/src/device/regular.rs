//! A SubDevice in regular operation: nothing happens but ends of cyclic frames, SYNC pulses, and
//! the steps that they start, one after another.
//!
//! As long as nothing else is due, watchdogs and timeouts are not checked, so that the PDI watchdog
//! is restarted only once, at the end. Everything irregular is left to [`Device::live`], which can
//! take over after each event and each step.

use isocat_esc::EscEvent;
use isocat_subdevice::{Event, Place, Step};
use isocat_wire::AlState;
use isocat_wire::time::{Device as DeviceClock, Nanos, Time};

use super::Device;
use crate::cpu::{Action, Plan, Sequence, What};
use crate::observation::{Content, Observed};
use crate::watcher::Watcher;

/// The steps of an event as a sequence, if they never vary; `None` if they are none.
pub(super) type Kept = Option<Sequence>;

/// Why the short way ends.
#[derive(PartialEq, Eq)]
enum End {
    /// Everything up to the limit has happened.
    Done,
    /// Something that is not regular comes next.
    Irregular,
}

impl Device {
    /// Lets events happen up to and including `limit`, as long as they are regular. `false`:
    /// [`Device::live`] must go on.
    #[inline]
    pub(super) fn regular(&mut self, limit: Time<DeviceClock>, watch: &mut Watcher) -> bool {
        if !self.regular {
            self.regular = self.lane && self.is_bare() && self.stack.is_regular();
        }
        if !self.regular || self.esc.rest_until().min(self.timeout) <= limit {
            return false;
        }
        let mut worked = None;
        let end = self.events(limit, &mut worked, watch);
        if let Some(at) = worked {
            self.esc.note_pdi(at);
        }
        if end == End::Irregular {
            return false;
        }
        self.quiet_until = self.esc.quiet_until().min(self.timeout).min(self.present.due());
        true
    }

    /// The events up to `limit`. `worked`: when the CPU last accessed the ESC.
    #[inline(always)]
    fn events(
        &mut self,
        limit: Time<DeviceClock>,
        worked: &mut Option<Time<DeviceClock>>,
        watch: &mut Watcher,
    ) -> End {
        if !self.cpu.is_idle() {
            return End::Irregular;
        }
        loop {
            let Some((frame, sync)) = self.esc.cyclic_dues() else { return End::Irregular };
            if self.esc.rest_until().min(self.timeout) <= limit {
                return End::Irregular;
            }
            let at = frame.min(sync);
            // What the CPU does at an instant, it does before all that the ESC does then; but where
            // it accesses the ESC, a frame that ends at the instant has ended.
            let due = self.present.due();
            if due <= at.min(limit) {
                if due == frame {
                    return End::Irregular;
                }
                self.go_on((frame + Nanos(-1)).min(sync).min(limit), worked, watch);
                continue;
            }
            if at > limit {
                return End::Done;
            }
            let mut started: Option<Place> = None;
            if frame > sync {
                let (event, observed) = match self.esc.step_sync() {
                    Some(EscEvent::Sync0) => (Event::Sync0, Observed::Sync0),
                    Some(EscEvent::Sync1) => (Event::Sync1, Observed::Sync1),
                    _ => {
                        self.look_for_lost_pulses(at, watch);
                        continue;
                    }
                };
                self.report(at, observed, Content::default(), watch);
                let is_alone = self.start(at, event, &mut started);
                self.look_in_lane(at, watch);
                *worked = Some(at);
                if !is_alone {
                    return End::Irregular;
                }
                if self.stack.state() != AlState::Op {
                    if let Some(place) = started {
                        self.begin_later(at, place);
                    }
                    return End::Irregular;
                }
            } else {
                let Some(events) = self.esc.end_regular_frame() else { return End::Irregular };
                if events == 0 {
                    continue;
                }
                let [outputs, inputs] = self.sm_events;
                if events & !(outputs | inputs) != 0 {
                    // What is not of the process data's first SyncManagers.
                    if let Some(at) = worked.take() {
                        self.esc.note_pdi(at);
                    }
                    self.esc_event(at, EscEvent::FrameEnd { al_events: events }, watch);
                    return End::Irregular;
                }
                let content = Content { frame: self.frame, ..Content::default() };
                *worked = Some(at);
                let mut is_alone = true;
                if events & outputs != 0 {
                    self.report(at, Observed::Sm2, content, watch);
                    is_alone = self.start(at, Event::Sm2, &mut started);
                }
                if events & inputs != 0 {
                    let sync_manager = self.stack.description().inputs.sync_manager;
                    let latched = Time::new(self.esc.label(sync_manager));
                    self.report(at, Observed::Sm3, Content { latched, ..content }, watch);
                    is_alone &= self.start(at, Event::Sm3, &mut started);
                }
                if !is_alone {
                    return End::Irregular;
                }
            }
            if let Some(place) = started {
                self.follow(at, place, limit, worked, watch);
            }
        }
    }

    /// Takes what an event starts. `false`: steps of two events overlap, and are on the agenda of
    /// the CPU. `started`: a sequence that begins now.
    #[inline(always)]
    fn start(&mut self, at: Time<DeviceClock>, event: Event, started: &mut Option<Place>) -> bool {
        let pdi = &mut self.esc.pdi_in_lane(at);
        let begun = self.stack.handle_regular_event(at, event, pdi, &mut self.prepared);
        if begun.steps.is_empty() {
            return true;
        }
        let is_free = self.present.is_over() && started.is_none();
        match begun.made {
            Some(kept) if is_free && self.cpu.is_even() => {
                let sequence = kept.get_or_insert_with(|| {
                    let mut plan = Plan::NONE;
                    self.cpu.plan(begun.steps, None, &mut plan);
                    Sequence::of(&plan)
                });
                if sequence.is_some() {
                    *started = Some(begun.place);
                } else {
                    self.present.take_new(at, |plan| self.cpu.plan(begun.steps, None, plan));
                }
            }
            _ if is_free => {
                self.present.take_new(at, |plan| self.cpu.plan(begun.steps, None, plan));
            }
            _ => {
                // Two events overlap.
                let steps = *begun.steps;
                if let Some(place) = started.take() {
                    self.begin_later(at, place);
                }
                let (before, from, half) = self.present.rest();
                self.cpu.put(self.present.at, before, from, half);
                self.present.clear();
                self.cpu.start(at, &steps, None);
                return false;
            }
        }
        true
    }

    #[inline]
    fn sequence(&self, place: Place) -> Option<&Sequence> {
        self.prepared.made(place)?.as_ref()
    }

    /// Leaves all steps of a sequence for later.
    fn begin_later(&mut self, at: Time<DeviceClock>, place: Place) {
        if let Some(&sequence) = self.sequence(place) {
            self.present.take_new(at, |plan| plan.take_sequence(&sequence));
        }
    }

    /// Does the steps that an event has started, if all of them end before anything else happens.
    #[inline(always)]
    fn follow(
        &mut self,
        at: Time<DeviceClock>,
        place: Place,
        limit: Time<DeviceClock>,
        worked: &mut Option<Time<DeviceClock>>,
        watch: &mut Watcher,
    ) {
        let Some(&sequence) = self.sequence(place) else { return };
        let end = at + sequence.end();
        let dues = self.esc.cyclic_dues();
        let alone = dues.is_some_and(|(frame, sync)| end < frame && end <= sync);
        if !alone || end > limit || !self.stack.does_whole_steps() {
            return self.begin_later(at, place);
        }
        for (number, (step, after, until)) in sequence.steps().enumerate() {
            let (begin, end) = (at + after, at + until);
            // A buffer that changed hands may have started a watchdog.
            if self.esc.rest_until() <= limit {
                self.begin_later(at, place);
                return self.present.go_on(number, false, begin);
            }
            *worked = Some(end);
            if step == Step::LatchInputs {
                self.esc.label_pdi(begin.count());
            }
            let content = match step {
                Step::MapOutputs => {
                    let pdi = &mut self.esc.pdi_in_lane(begin);
                    self.stack.whole_step(end, Step::MapOutputs, pdi);
                    let label = self.esc.label(self.stack.description().outputs.sync_manager);
                    self.fetched = Time::new(label);
                    let content = Content { frame: self.fetched, ..Content::default() };
                    self.report(begin, Observed::Began(step), content, watch);
                    self.outputs_mapped();
                    self.report(end, Observed::Finished(step), content, watch);
                    continue;
                }
                Step::MapInputs => {
                    let pdi = &mut self.esc.pdi_in_lane(end);
                    self.stack.whole_step(end, Step::MapInputs, pdi);
                    Content::default()
                }
                Step::OutputsValid => {
                    self.stack.whole_step(end, Step::OutputsValid, &mut super::Nowhere);
                    let acted = self.application().take_acted();
                    let frame = if acted { self.mapped } else { Time::ZERO };
                    Content { frame, ..Content::default() }
                }
                Step::Application => {
                    self.stack.whole_step(end, Step::Application, &mut super::Nowhere);
                    Content::default()
                }
                Step::LatchInputs => {
                    self.stack.whole_step(end, Step::LatchInputs, &mut super::Nowhere);
                    Content::default()
                }
            };
            self.report(begin, Observed::Began(step), content, watch);
            self.report(end, Observed::Finished(step), Content::default(), watch);
        }
    }

    /// Does what is due up to `limit` of what the last event has started.
    #[inline(always)]
    fn go_on(
        &mut self,
        limit: Time<DeviceClock>,
        worked: &mut Option<Time<DeviceClock>>,
        watch: &mut Watcher,
    ) {
        let at = self.present.at;
        let (mut number, mut half) = self.present.place();
        let mut due = Time::NEVER;
        while let Some(part) = self.present.part(number) {
            let (begin, end) = (at + part.after, at + part.until);
            due = if half { end } else { begin };
            // A buffer that changed hands may have started a watchdog.
            if due > limit || self.esc.rest_until() <= limit {
                break;
            }
            *worked = Some(end);
            match part.what {
                What::Step(step) if half => self.finish_in_lane(end, step, watch),
                What::Step(step) if end > limit => {
                    *worked = Some(begin);
                    self.begin_in_lane(begin, step, watch);
                    (half, due) = (true, end);
                    break;
                }
                What::Step(Step::Application) => {
                    self.step_apart(Step::Application, (begin, end), watch);
                }
                What::Step(Step::OutputsValid) => {
                    self.step_apart(Step::OutputsValid, (begin, end), watch);
                }
                What::Step(Step::LatchInputs) => {
                    self.step_apart(Step::LatchInputs, (begin, end), watch);
                }
                What::Step(Step::MapOutputs) => {
                    self.step_at_esc(Step::MapOutputs, (begin, end), watch);
                }
                What::Step(Step::MapInputs) => {
                    self.step_at_esc(Step::MapInputs, (begin, end), watch);
                }
                What::Action(Action::Begin(step)) => self.begin_in_lane(begin, step, watch),
                What::Action(Action::Finish(step)) => self.finish_in_lane(begin, step, watch),
                What::Action(Action::Acknowledge(_) | Action::Poll) => {
                    unreachable!("in regular operation a plan has steps only")
                }
            }
            (number, half, due) = (number + 1, false, Time::NEVER);
        }
        self.present.go_on(number, half, due);
    }

    fn begin_in_lane(&mut self, at: Time<DeviceClock>, step: Step, watch: &mut Watcher) {
        self.stack.begin(at, step, &mut self.esc.pdi_in_lane(at));
        let content = Content { frame: self.began(at, step), ..Content::default() };
        self.report(at, Observed::Began(step), content, watch);
    }

    fn finish_in_lane(&mut self, at: Time<DeviceClock>, step: Step, watch: &mut Watcher) {
        self.stack.finish(at, step, &mut self.esc.pdi_in_lane(at));
        let frame = if step == Step::MapOutputs { self.outputs_mapped() } else { Time::ZERO };
        self.report(at, Observed::Finished(step), Content { frame, ..Content::default() }, watch);
    }

    /// A step that does not access the ESC.
    #[inline]
    fn step_apart(
        &mut self,
        step: Step,
        (begin, end): (Time<DeviceClock>, Time<DeviceClock>),
        watch: &mut Watcher,
    ) {
        self.stack.begin(begin, step, &mut super::Nowhere);
        let content = Content { frame: self.began(begin, step), ..Content::default() };
        self.report(begin, Observed::Began(step), content, watch);
        self.stack.finish(end, step, &mut super::Nowhere);
        self.report(end, Observed::Finished(step), Content::default(), watch);
    }

    /// A step that accesses the ESC.
    #[inline]
    fn step_at_esc(
        &mut self,
        step: Step,
        (begin, end): (Time<DeviceClock>, Time<DeviceClock>),
        watch: &mut Watcher,
    ) {
        self.stack.begin(begin, step, &mut self.esc.pdi_in_lane(begin));
        let content = Content { frame: self.began(begin, step), ..Content::default() };
        self.report(begin, Observed::Began(step), content, watch);
        self.stack.finish(end, step, &mut self.esc.pdi_in_lane(end));
        let frame = if step == Step::MapOutputs { self.outputs_mapped() } else { Time::ZERO };
        self.report(end, Observed::Finished(step), Content { frame, ..Content::default() }, watch);
    }
}
