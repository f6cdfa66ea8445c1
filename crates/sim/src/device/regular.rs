//! A SubDevice in regular operation: nothing happens but ends of cyclic frames, SYNC pulses, and
//! the steps that they start, one after another.
//!
//! As long as nothing else is due, watchdogs and timeouts are not checked, so that the PDI watchdog
//! is restarted only once, at the end. Everything irregular is left to [`Device::live`], which can
//! take over after each event and each step.

use isocat_esc::EscEvent;
use isocat_subdevice::{Event, Place, Step};
use isocat_wire::AlState;
use isocat_wire::time::{Device as DeviceClock, Nanos, Time, True};

use super::Device;
use super::present::Present;
use crate::cpu::{Action, Cpu, Sequence, Span, What};
use crate::observation::{Content, Observed};
use crate::watcher::Watcher;

/// What is known of the times of an event's steps.
#[derive(Clone, Copy, Debug)]
pub(super) enum Kept {
    /// They are always the same.
    Same(Sequence),
    /// They are drawn each time.
    Drawn,
    /// The steps cannot be done as a whole, or take very long.
    Planned,
}

/// Something that is not regular comes next.
struct Irregular;

impl Device {
    /// Lets events happen up to and including `limit`, as long as they are regular. `false`:
    /// [`Device::live`] must go on.
    pub(super) fn regular(&mut self, limit: Time<DeviceClock>, watch: &mut Watcher) -> bool {
        if !self.regular {
            self.regular = self.lane && self.is_bare() && self.stack.is_regular();
        }
        if !self.regular {
            return false;
        }
        let mut worked = None;
        let end = self.events(limit, &mut worked, watch);
        if let Some(at) = worked {
            self.esc.note_pdi(at);
        }
        let Ok(next) = end else { return false };
        // The PDI watchdog may have been started.
        self.quiet_until = next.min(self.esc.rest_until());
        true
    }

    /// The events up to `limit`; returns when the next one is due. `worked`: when the CPU last
    /// accessed the ESC.
    #[inline(always)]
    fn events(
        &mut self,
        limit: Time<DeviceClock>,
        worked: &mut Option<Time<DeviceClock>>,
        watch: &mut Watcher,
    ) -> Result<Time<DeviceClock>, Irregular> {
        if !self.cpu.is_idle() {
            return Err(Irregular);
        }
        loop {
            let Some((frame, sync)) = self.esc.cyclic_dues() else { return Err(Irregular) };
            let (mut rest, timeout) = (self.esc.rest_until(), self.timeout);
            if rest <= limit {
                rest = self.esc.find_rest();
            }
            if rest <= limit || timeout <= limit && self.stack.timer() != Some(timeout) {
                return Err(Irregular);
            }
            // What comes before the tick of a local timer comes first.
            let until = limit.min(timeout);
            let at = frame.min(sync);
            let due = self.present.due();
            let next = at.min(due);
            let (at, until, started) = if next > until {
                if timeout > limit {
                    return Ok(next.min(rest).min(timeout));
                }
                let started = self.timer_tick(timeout, worked, watch)?;
                (timeout, limit.min(self.timeout), started)
            } else if due <= at {
                // What the CPU does at an instant, it does before all that the ESC does then; but
                // where it accesses the ESC, a frame that ends at the instant has ended.
                if due == frame {
                    return Err(Irregular);
                }
                self.go_on((frame + Nanos(-1)).min(sync).min(until), worked, watch);
                continue;
            } else if frame > sync {
                (at, until, self.pulse(at, worked, watch)?)
            } else {
                (at, until, self.frame_end(at, worked, watch)?)
            };
            if let Some(place) = started
                && !self.follow(at, place, until, worked, watch)
            {
                return Err(Irregular);
            }
        }
    }

    /// The timer of Free Run ticks; returns the steps that it starts. The main loop runs, too.
    #[inline(never)]
    fn timer_tick(
        &mut self,
        at: Time<DeviceClock>,
        worked: &mut Option<Time<DeviceClock>>,
        watch: &mut Watcher,
    ) -> Result<Option<Place>, Irregular> {
        let pdi = &mut self.esc.pdi_in_lane(at);
        let (started, polled) = self.stack.regular_tick(at, pdi, &mut self.prepared);
        *worked = Some(at);
        if !polled {
            self.note_timeout();
            debug_assert!(self.stack.is_regular());
            return Ok(started);
        }
        self.look(at, watch);
        if !self.stack.is_regular() {
            if let Some(place) = started {
                self.start(at, place);
            }
            return Err(Irregular);
        }
        Ok(started)
    }

    /// The SYNC unit's due time has come; returns the steps that the pulse starts.
    #[inline(always)]
    fn pulse(
        &mut self,
        at: Time<DeviceClock>,
        worked: &mut Option<Time<DeviceClock>>,
        watch: &mut Watcher,
    ) -> Result<Option<Place>, Irregular> {
        let pulse = self.esc.step_sync();
        if let Some(event) = pulse
            && !self.stack.sync().mode().uses_dc()
        {
            // The device does not use it, but may have to acknowledge it.
            if let Some(at) = worked.take() {
                self.esc.note_pdi(at);
            }
            self.esc_event(at, event, watch);
            return Err(Irregular);
        }
        let started = match pulse {
            Some(EscEvent::Sync0) => {
                self.report_pulse(at, Event::Sync0, watch);
                let pdi = &mut self.esc.pdi_in_lane(at);
                self.stack.handle_regular_event(at, Event::Sync0, pdi, &mut self.prepared)
            }
            Some(EscEvent::Sync1) => {
                self.report_pulse(at, Event::Sync1, watch);
                // Few devices have it, so it is not part of this function.
                let pdi = &mut self.esc.pdi_in_lane(at);
                self.stack.handle_event_in_place(at, Event::Sync1, pdi, &mut self.prepared)
            }
            _ => {
                self.look_for_lost_pulses(at, watch);
                return Ok(None);
            }
        };
        self.look_in_lane(at, watch);
        *worked = Some(at);
        if self.stack.state() != AlState::Op {
            if let Some(place) = started {
                self.start(at, place);
            }
            return Err(Irregular);
        }
        Ok(started)
    }

    /// A frame has ended; returns the steps that its SM event starts.
    #[inline(always)]
    fn frame_end(
        &mut self,
        at: Time<DeviceClock>,
        worked: &mut Option<Time<DeviceClock>>,
        watch: &mut Watcher,
    ) -> Result<Option<Place>, Irregular> {
        let Some(events) = self.esc.end_regular_frame() else { return Err(Irregular) };
        if events == 0 {
            return Ok(None);
        }
        let [outputs, inputs] = self.sm_events;
        if events & !(outputs | inputs) != 0 {
            // What is not of the process data's first SyncManagers.
            if let Some(at) = worked.take() {
                self.esc.note_pdi(at);
            }
            self.esc_event(at, EscEvent::FrameEnd { al_events: events }, watch);
            return Err(Irregular);
        }
        *worked = Some(at);
        self.report_frame_end(at, (events & outputs != 0, events & inputs != 0), watch);
        let mut started = None;
        if events & outputs != 0 {
            let pdi = &mut self.esc.pdi_in_lane(at);
            started = self.stack.handle_regular_event(at, Event::Sm2, pdi, &mut self.prepared);
        }
        if events & inputs != 0 {
            let pdi = &mut self.esc.pdi_in_lane(at);
            let other = self.stack.handle_regular_event(at, Event::Sm3, pdi, &mut self.prepared);
            // SM3 starts steps only of a device without outputs, where SM2 starts none.
            debug_assert!(started.is_none() || other.is_none());
            started = started.or(other);
        }
        Ok(started)
    }

    /// Does the steps that an event has started, if each can be done at once and all of them end
    /// before anything else happens; otherwise they wait for their time. `false`: they are on the
    /// agenda of the CPU.
    #[inline(always)]
    fn follow(
        &mut self,
        at: Time<DeviceClock>,
        place: Place,
        limit: Time<DeviceClock>,
        worked: &mut Option<Time<DeviceClock>>,
        watch: &mut Watcher,
    ) -> bool {
        let sequence = match self.prepared.made(place) {
            Some(Kept::Same(sequence)) => sequence,
            Some(Kept::Drawn) if self.cpu.draw(self.prepared.steps(place), &mut self.drawn) => {
                if watch.keeps_steps() {
                    self.drawn.note_all();
                }
                &self.drawn
            }
            _ => return self.start(at, place),
        };
        let end = at + sequence.end();
        let dues = self.esc.cyclic_dues();
        let alone = dues.is_some_and(|(frame, sync)| end < frame && end <= sync);
        if !alone || end > limit || !self.present.is_over() || !may_be_whole(sequence, watch) {
            return put_off(&mut self.cpu, &mut self.present, at, sequence);
        }
        let mut acted = Time::ZERO;
        for (done, span) in sequence.spans().iter().enumerate() {
            let Some(step) = span.step else { break };
            // A buffer that changed hands may have started a watchdog.
            if self.esc.rest_until() <= limit {
                if let Some(last) = done.checked_sub(1) {
                    *worked = Some(at + sequence.spans()[last].until());
                }
                self.report_first(at, sequence, done, acted, watch);
                let begun = put_off(&mut self.cpu, &mut self.present, at, sequence);
                self.present.skip_to(sequence.parts(done));
                return begun;
            }
            match step {
                Step::MapOutputs => {
                    let buffers = &mut self.esc.buffers(at + span.after());
                    self.stack.whole_step(Step::MapOutputs, buffers);
                    let label = self.esc.label(self.stack.description().outputs.sync_manager);
                    self.fetched = Time::new(label);
                    if self.stack.application_mut().take_mapped() {
                        self.mapped = self.fetched;
                    }
                }
                Step::Application => {
                    self.stack.whole_step(Step::Application, &mut super::Nowhere);
                }
                Step::OutputsValid => {
                    self.stack.whole_step(Step::OutputsValid, &mut super::Nowhere);
                    if self.stack.application_mut().take_acted() {
                        acted = self.mapped;
                    }
                }
                Step::LatchInputs => {
                    self.esc.label_pdi((at + span.after()).count());
                    self.stack.whole_step(Step::LatchInputs, &mut super::Nowhere);
                }
                Step::MapInputs => {
                    let buffers = &mut self.esc.buffers(at + span.until());
                    self.stack.whole_step(Step::MapInputs, buffers);
                }
            }
        }
        *worked = Some(end);
        if watch.keeps_steps() {
            if watch.is_brief() {
                self.note_steps(at, sequence, sequence.noted(), acted, watch);
            } else {
                self.report_steps(at, sequence.spans(), acted, watch);
            }
        }
        true
    }

    /// Reports the end of a frame that stored outputs, or fetched inputs.
    #[inline(always)]
    fn report_frame_end(
        &self,
        at: Time<DeviceClock>,
        (stored, fetched): (bool, bool),
        watch: &mut Watcher,
    ) {
        if !watch.keeps(Observed::Sm2) {
            return;
        }
        if watch.is_brief() {
            return self.note_frame_end(at, stored, fetched, watch);
        }
        let content = Content { frame: self.frame, ..Content::default() };
        if stored {
            self.report(at, Observed::Sm2, content, watch);
        }
        if fetched {
            let sync_manager = self.stack.description().inputs.sync_manager;
            let latched = Time::new(self.esc.label(sync_manager));
            self.report(at, Observed::Sm3, Content { latched, ..content }, watch);
        }
    }

    /// Reports a pulse.
    #[inline(always)]
    fn report_pulse(&self, at: Time<DeviceClock>, pulse: Event, watch: &mut Watcher) {
        if !watch.keeps(Observed::Sync0) {
            return;
        }
        if watch.is_brief() {
            return self.note_pulse(at, pulse == Event::Sync1, watch);
        }
        let observed = if pulse == Event::Sync0 { Observed::Sync0 } else { Observed::Sync1 };
        self.report(at, observed, Content::default(), watch);
    }

    /// Reports the first `done` steps of an event, as [`follow`](Self::follow) reports all of them.
    #[cold]
    fn report_first(
        &self,
        at: Time<DeviceClock>,
        sequence: &Sequence,
        done: usize,
        acted: Time<True>,
        watch: &mut Watcher,
    ) {
        if watch.is_brief() {
            self.note_steps(at, sequence, sequence.first_noted(done), acted, watch);
        } else {
            self.report_steps(at, &sequence.spans()[..done], acted, watch);
        }
    }

    /// Reports these steps of an event. `acted`: the frame of the outputs that have acted.
    #[inline(never)]
    fn report_steps(
        &self,
        at: Time<DeviceClock>,
        spans: &[Span],
        acted: Time<True>,
        watch: &mut Watcher,
    ) {
        for span in spans {
            let Some(step) = span.step else { return };
            if !watch.keeps_step(step) {
                continue;
            }
            let content = |frame| Content { frame, ..Content::default() };
            let (began, finished) = match step {
                Step::MapOutputs => (self.fetched, self.fetched),
                Step::OutputsValid => (acted, Time::ZERO),
                _ => (Time::ZERO, Time::ZERO),
            };
            self.report(at + span.after(), Observed::Began(step), content(began), watch);
            self.report(at + span.until(), Observed::Finished(step), content(finished), watch);
        }
    }

    /// Lets the steps of an event wait for their time. `false`: steps of two events overlap, and
    /// are on the agenda of the CPU.
    #[inline(never)]
    fn start(&mut self, at: Time<DeviceClock>, place: Place) -> bool {
        let Self { cpu, present, prepared, stack, .. } = self;
        if let Some(Kept::Same(sequence)) = prepared.made(place) {
            return put_off(cpu, present, at, sequence);
        }
        let steps = prepared.steps(place);
        if !present.is_over() {
            present.put_onto(cpu);
            cpu.start(at, steps, None);
            return false;
        }
        present.take_new(at, |plan| cpu.plan(steps, None, plan));
        if prepared.made(place).is_none() {
            let kept = match (stack.does_whole_steps(), cpu.is_even()) {
                (false, _) => Kept::Planned,
                (true, false) => Kept::Drawn,
                (true, true) => {
                    let mut sequence = Sequence::NONE;
                    let is_short = cpu.draw(steps, &mut sequence);
                    sequence.note_all();
                    if is_short { Kept::Same(sequence) } else { Kept::Planned }
                }
            };
            prepared.keep_made(place, kept);
        }
        true
    }

    /// Does what is due up to `limit` of what the last event has started.
    #[inline(never)]
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
                What::Step(step) => {
                    self.begin_in_lane(begin, step, watch);
                    self.finish_in_lane(end, step, watch);
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
}

/// Whether each step of an event may be done at once at its end. If others come during a step and
/// it is observed, its beginning is reported before them.
#[inline(always)]
fn may_be_whole(sequence: &Sequence, watch: &Watcher) -> bool {
    sequence.in_order() || sequence.is_whole() && !watch.keeps_work()
}

/// Lets steps with these times wait, as [`Device::start`] does.
#[inline(never)]
fn put_off(
    cpu: &mut Cpu,
    present: &mut Present,
    at: Time<DeviceClock>,
    sequence: &Sequence,
) -> bool {
    let alone = present.is_over();
    present.put_onto(cpu);
    present.take_new(at, |plan| plan.take_sequence(sequence));
    if !alone {
        present.put_onto(cpu);
    }
    alone
}
