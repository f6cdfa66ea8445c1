//! A SubDevice's CPU: when the steps of a cycle begin and end.

use isocat_subdevice::{Event, MAX_STEPS, Step, Steps};
use isocat_wire::time::{Device, Nanos, Time};

use crate::random::Stream;

/// How long a SubDevice's CPU takes, in ns of its own oscillator.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct CpuModel {
    /// Time from an event to the answer of the main loop (state changes, mailbox).
    pub reaction: Nanos,
    /// Time from the SM2 event until outputs are copied and calculated, including interrupt
    /// latency: the value that 0x1C32:06 should state.
    pub copy_outputs: Nanos,
    /// Time of the application's work.
    pub application: Nanos,
    /// Time from Input Latch until inputs are in the buffer: the value that 0x1C33:06 should state.
    pub copy_inputs: Nanos,
    /// Spread, peak to peak, of the time at which the steps of an event begin: interrupts are
    /// sometimes delayed.
    pub jitter: Nanos,
    /// Time from a SYNC pulse until the program reads 0x098E (SYNC1: 0x098F), if its signal stays
    /// active until then: register 0x0982 is 0. It spreads by [`CpuModel::jitter`] like the steps.
    pub acknowledge: Nanos,
    /// Variation of the times above.
    pub unevenness: Unevenness,
}

/// How a CPU's times vary from cycle to cycle. By default they do not vary.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Unevenness {
    /// Longest interrupt latency: from the SM2 event until the outputs are fetched; it is usually
    /// much shorter. It is part of the copy time, not added to it.
    pub latency: Nanos,
    /// How much faster than their stated, longest time copying and the application may be, in
    /// percent, with a uniform distribution.
    pub variation: u8,
    /// Rare cycles in which the application takes longer than its longest time.
    pub overrun: Option<Overrun>,
    /// Spread, peak to peak, of the local timer that shifts outputs and inputs, and of other
    /// delayed actions.
    pub timer_jitter: Nanos,
}

/// An application that takes too long in random cycles.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Overrun {
    /// It happens once in this number of cycles, on average.
    pub one_in: u32,
    /// The additional time.
    pub by: Nanos,
}

impl Default for CpuModel {
    fn default() -> Self {
        Self {
            reaction: Nanos(50_000),
            copy_outputs: Nanos(20_000),
            application: Nanos(10_000),
            copy_inputs: Nanos(10_000),
            jitter: Nanos(0),
            acknowledge: Nanos(0),
            unevenness: Unevenness::default(),
        }
    }
}

/// An action of the CPU at an instant.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Action {
    /// A step ends. It is the first action: steps that end at an instant end before others begin.
    Finish(Step),
    /// A SYNC pulse is acknowledged.
    Acknowledge(Event),
    /// A step begins.
    Begin(Step),
    /// The main loop runs.
    Poll,
}

/// The actions that one event starts, in the order of time.
#[derive(Clone, Copy, Debug)]
pub struct Plan {
    parts: [Part; MAX_PARTS],
    len: u8,
}

/// A part of a plan: an action, or a step from its beginning to its end.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Part {
    /// Time from the event to the action, or to the beginning of the step.
    pub after: Nanos,
    /// Time from the event to the end of the step.
    pub until: Nanos,
    /// What happens.
    pub what: What,
}

/// The content of a part.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum What {
    /// A step, during which no other action of the plan happens.
    Step(Step),
    /// One action.
    Action(Action),
}

impl Plan {
    /// Nothing.
    pub const NONE: Self = Self {
        parts: [Part { after: Nanos::ZERO, until: Nanos::ZERO, what: What::Action(Action::Poll) };
            MAX_PARTS],
        len: 0,
    };

    /// Inserts an action after all that are due no later.
    fn insert(&mut self, after: Nanos, action: Action) {
        let mut place = usize::from(self.len);
        while place > 0 && self.parts[place - 1].after > after {
            self.parts[place] = self.parts[place - 1];
            place -= 1;
        }
        self.parts[place] = Part { after, until: after, what: What::Action(action) };
        self.len += 1;
    }

    /// Makes one part of the beginning and the end of each step between which nothing happens.
    fn join(&mut self) {
        let mut joined = 0;
        let mut number = 0;
        while number < usize::from(self.len) {
            let mut part = self.parts[number];
            number += 1;
            if let What::Action(Action::Begin(step)) = part.what
                && let Some(next) = self.part(number)
                && next.what == What::Action(Action::Finish(step))
            {
                part = Part { until: next.after, what: What::Step(step), ..part };
                number += 1;
            }
            self.parts[joined] = part;
            joined += 1;
        }
        self.len = joined as u8;
    }

    /// Becomes the plan of a sequence.
    pub fn take_sequence(&mut self, sequence: &Sequence) {
        self.len = 0;
        for (part, span) in self.parts.iter_mut().zip(sequence.spans()) {
            let Some(step) = span.step else { break };
            *part = Part { after: span.after(), until: span.until(), what: What::Step(step) };
            self.len += 1;
        }
    }

    /// One of the parts.
    #[inline]
    pub fn part(&self, number: usize) -> Option<Part> {
        (number < MAX_PARTS.min(self.len.into())).then(|| self.parts[number])
    }
}

/// A plan of which each step ends before the next one begins.
#[derive(Clone, Copy, Debug)]
pub struct Sequence {
    /// The steps in order; the rest has none.
    spans: [Span; MAX_STEPS + 1],
    end: u32,
}

/// A step with the times from the event to its beginning and its end, ns.
#[derive(Clone, Copy, Debug)]
pub struct Span {
    /// The step; `None` behind the last one.
    pub step: Option<Step>,
    /// Its place in the sequence.
    pub number: u8,
    after: u32,
    until: u32,
}

impl Span {
    /// Time from the event to its beginning.
    #[inline]
    pub fn after(&self) -> Nanos {
        Nanos(self.after.into())
    }

    /// Time from the event to its end.
    #[inline]
    pub fn until(&self) -> Nanos {
        Nanos(self.until.into())
    }
}

impl Sequence {
    /// The plan as a sequence; `None` if it is none, or takes longer than 4 s.
    pub fn of(plan: &Plan) -> Option<Self> {
        let none = Span { step: None, number: 0, after: 0, until: 0 };
        let mut sequence = Self { spans: [none; MAX_STEPS + 1], end: 0 };
        for number in 0..plan.len.into() {
            let Part { after, until, what: What::Step(step) } = plan.part(number)? else {
                return None;
            };
            let (after, until) = (u32::try_from(after.0).ok()?, u32::try_from(until.0).ok()?);
            let span = Span { step: Some(step), number: number as u8, after, until };
            *sequence.spans.get_mut(number)? = span;
            sequence.end = sequence.end.max(until);
        }
        // The last one remains free.
        sequence.spans[MAX_STEPS].step.is_none().then_some(sequence)
    }

    /// Time from the event to the end of the last step.
    #[inline]
    pub fn end(&self) -> Nanos {
        Nanos(self.end.into())
    }

    /// The steps in order, up to the first one that is none.
    #[inline]
    pub fn spans(&self) -> &[Span] {
        &self.spans
    }
}

/// Most parts of a plan: the beginning and the end of each step, and an acknowledge.
const MAX_PARTS: usize = 2 * MAX_STEPS + 1;

/// The planned actions of a CPU.
#[derive(Clone, Debug)]
pub struct Cpu {
    model: CpuModel,
    /// A few actions: steps of two overlapping cycles. They are sorted by time from `done` on,
    /// soonest first; earlier entries are done.
    agenda: Vec<(Time<Device>, Action)>,
    done: usize,
    /// When the first of them is due.
    due: Time<Device>,
    polling: bool,
    /// Whether its times never vary.
    even: bool,
    jitter: Stream,
}

impl Cpu {
    /// An idle CPU.
    pub fn new(model: CpuModel, jitter: Stream) -> Self {
        let even = model.jitter == Nanos::ZERO && model.unevenness == Unevenness::default();
        Self {
            model,
            agenda: Vec::with_capacity(16),
            done: 0,
            due: Time::NEVER,
            polling: false,
            even,
            jitter,
        }
    }

    /// The times that it takes.
    pub fn model(&self) -> &CpuModel {
        &self.model
    }

    /// Switches it off: all planned actions are dropped.
    pub fn power_off(&mut self) {
        self.agenda.clear();
        (self.done, self.due) = (0, Time::NEVER);
        self.polling = false;
    }

    /// When its next action is due.
    #[inline]
    pub const fn next(&self) -> Time<Device> {
        self.due
    }

    fn note_due(&mut self) {
        self.due = self.agenda.get(self.done).map_or(Time::NEVER, |(at, _)| *at);
    }

    /// Takes the next action.
    pub fn pop(&mut self) -> Option<(Time<Device>, Action)> {
        let next = *self.agenda.get(self.done)?;
        self.done += 1;
        if self.done == self.agenda.len() {
            self.agenda.clear();
            self.done = 0;
        }
        self.note_due();
        if next.1 == Action::Poll {
            self.polling = false;
        }
        Some(next)
    }

    /// Lets the main loop run soon after an event at `at`.
    pub fn wake(&mut self, at: Time<Device>) {
        if !self.polling {
            self.polling = true;
            self.insert(at + self.model.reaction, Action::Poll);
        }
    }

    /// Starts the steps of an event at `at`. Steps of the CPU run one after another; actions of the
    /// hardware happen at their own instant. `pulse` is a SYNC pulse that must also be
    /// acknowledged; it causes the same interrupt, so it is as late as the steps.
    pub fn start(&mut self, at: Time<Device>, steps: &Steps, pulse: Option<Event>) {
        let mut plan = Plan::NONE;
        self.plan(steps, pulse, &mut plan);
        self.put(at, &plan, 0, false);
    }

    /// What an event starts, as [`start`](Self::start) would start it. Call this only once for each
    /// event, since variations are drawn, unless the CPU is [even](Self::is_even).
    pub fn plan(&mut self, steps: &Steps, pulse: Option<Event>, plan: &mut Plan) {
        plan.len = 0;
        if steps.is_empty() && pulse.is_none() {
            return;
        }
        let of = |(step, _): &(Step, Nanos)| *step == Step::MapOutputs;
        let synchronized = !steps.as_slice().iter().any(of);
        // The copy time of the outputs is already the longest, so no jitter is added to it.
        let is_late = (synchronized || pulse.is_some()) && !self.even;
        let late = if is_late { self.jitter.up_to(self.model.jitter.0.max(0) as u64) } else { 0 };
        let late = Nanos(late as i64);
        if let Some(pulse) = pulse {
            plan.insert(late + self.model.acknowledge, Action::Acknowledge(pulse));
        }
        let at = if synchronized { late } else { Nanos::ZERO };
        let mut free = at;
        let mut latched = at;
        // As a rule each step ends before the next one begins.
        let mut spans = [(Nanos::ZERO, Nanos::ZERO); MAX_STEPS];
        let mut in_order = pulse.is_none();
        for (i, &(step, delay)) in steps.as_slice().iter().enumerate() {
            let of_hardware = matches!(step, Step::OutputsValid | Step::LatchInputs);
            let mut due = at + delay;
            if of_hardware && delay > Nanos::ZERO {
                due += self.at_random(self.model.unevenness.timer_jitter);
            }
            let mut begin =
                if of_hardware && (delay > Nanos::ZERO || i == 0) { due } else { due.max(free) };
            let end = match step {
                Step::MapOutputs => {
                    let end = begin + self.varied(self.model.copy_outputs);
                    begin = (begin + self.latency()).min(end);
                    end
                }
                Step::Application => begin + self.varied(self.model.application) + self.overrun(),
                // It counts from the latch, so it includes the application's work in between.
                Step::MapInputs => begin.max(latched + self.varied(self.model.copy_inputs)),
                Step::OutputsValid | Step::LatchInputs => begin,
            };
            if step == Step::LatchInputs {
                latched = begin;
            }
            in_order &= free <= begin && begin <= end;
            spans[i] = (begin, end);
            free = free.max(end);
        }
        let steps = steps.iter().zip(spans).map(|((step, _), (begin, end))| (step, begin, end));
        if in_order {
            for (part, (step, after, until)) in plan.parts.iter_mut().zip(steps) {
                *part = Part { after, until, what: What::Step(step) };
                plan.len += 1;
            }
            return;
        }
        for (step, begin, end) in steps {
            plan.insert(begin, Action::Begin(step));
            plan.insert(end, Action::Finish(step));
        }
        plan.join();
    }

    /// Whether its times never vary.
    pub fn is_even(&self) -> bool {
        self.even
    }

    /// Puts the plan of an event at `at` onto the agenda, from part number `from` on; `half`: its
    /// step has already begun.
    pub fn put(&mut self, at: Time<Device>, plan: &Plan, from: usize, half: bool) {
        for number in from.. {
            let Some(Part { after, until, what }) = plan.part(number) else { return };
            match what {
                What::Step(step) => {
                    if !half || number > from {
                        self.insert(at + after, Action::Begin(step));
                    }
                    self.insert(at + until, Action::Finish(step));
                }
                What::Action(action) => self.insert(at + after, action),
            }
        }
    }

    /// Whether nothing is on the agenda.
    #[inline]
    pub fn is_idle(&self) -> bool {
        self.agenda.is_empty()
    }

    /// A random time of at most `most`.
    #[inline]
    fn at_random(&mut self, most: Nanos) -> Nanos {
        // Without variation nothing is drawn, so that other random numbers stay the same.
        match most.0 {
            1.. => Nanos(self.jitter.up_to(most.0 as u64) as i64),
            _ => Nanos::ZERO,
        }
    }

    #[inline]
    fn varied(&mut self, longest: Nanos) -> Nanos {
        if self.even {
            return longest;
        }
        let variation = i64::from(self.model.unevenness.variation.min(100));
        longest - self.at_random(Nanos(longest.0 / 100 * variation))
    }

    #[inline]
    fn latency(&mut self) -> Nanos {
        match self.model.unevenness.latency.0 {
            worst @ 1.. => Nanos(self.jitter.lateness(worst as u64) as i64),
            _ => Nanos::ZERO,
        }
    }

    #[inline]
    fn overrun(&mut self) -> Nanos {
        match self.model.unevenness.overrun {
            Some(Overrun { one_in, by })
                if self.jitter.up_to(u64::from(one_in.max(1)) - 1) == 0 =>
            {
                by
            }
            _ => Nanos::ZERO,
        }
    }

    /// Inserts an action after all actions at the same instant, so that a step begins before it
    /// ends. Ends of earlier steps come before beginnings of later ones by the order of insertion.
    fn insert(&mut self, at: Time<Device>, action: Action) {
        if self.agenda.len() == self.agenda.capacity() {
            self.agenda.drain(..self.done);
            self.done = 0;
        }
        // Most actions belong at the end, since steps are started in the order of their due times.
        self.agenda.push((at, action));
        let mut place = self.agenda.len() - 1;
        while place > self.done && self.agenda[place - 1].0 > at {
            self.agenda.swap(place - 1, place);
            place -= 1;
        }
        self.note_due();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn agenda(cpu: &mut Cpu) -> Vec<(u64, Action)> {
        core::iter::from_fn(|| cpu.pop()).map(|(at, action)| (at.count(), action)).collect()
    }

    #[test]
    fn what_ends_at_an_instant_comes_before_what_begins_there() {
        let mut cpu = Cpu::new(CpuModel::default(), Stream::new(1, "test", 0));
        cpu.insert(Time::new(5), Action::Begin(Step::MapOutputs));
        cpu.insert(Time::new(9), Action::Finish(Step::MapOutputs));
        cpu.insert(Time::new(9), Action::Begin(Step::Application));
        cpu.insert(Time::new(9), Action::Finish(Step::Application));
        let order = agenda(&mut cpu).into_iter().map(|(_, action)| action).collect::<Vec<_>>();
        use Action::*;
        let (map, application) = (Step::MapOutputs, Step::Application);
        assert_eq!(order, [Begin(map), Finish(map), Begin(application), Finish(application)]);
    }

    #[test]
    fn one_wake_up_polls_once() {
        let mut cpu = Cpu::new(CpuModel::default(), Stream::new(1, "test", 0));
        cpu.wake(Time::new(0));
        cpu.wake(Time::new(10));
        assert_eq!(agenda(&mut cpu), [(50_000, Action::Poll)]);
        cpu.wake(Time::new(60_000));
        assert_eq!(cpu.next(), Time::new(110_000));
    }

    /// In a thousand cycles no time exceeds the longest one, times vary over the allowed range, and
    /// overruns have the given rate.
    #[test]
    fn uneven_times_stay_within_what_is_stated() {
        let unevenness = Unevenness {
            latency: Nanos(4_000),
            variation: 50,
            overrun: Some(Overrun { one_in: 100, by: Nanos(500_000) }),
            timer_jitter: Nanos(300),
        };
        let model = CpuModel { unevenness, ..CpuModel::default() };
        let mut cpu = Cpu::new(model, Stream::new(7, "test", 0));
        let (mut latencies, mut copies, mut overruns, mut acts) = (vec![], vec![], 0, vec![]);
        for cycle in 0..1_000u64 {
            let start = Time::new(cycle * 1_000_000);
            let mut steps = Steps::EMPTY;
            steps.push(Step::MapOutputs, Nanos::ZERO);
            steps.push(Step::Application, Nanos::ZERO);
            steps.push(Step::OutputsValid, Nanos(100_000));
            cpu.start(start, &steps, None);
            for (at, action) in agenda(&mut cpu) {
                let at = at - start.count();
                match action {
                    Action::Begin(Step::MapOutputs) => latencies.push(at),
                    Action::Finish(Step::MapOutputs) => copies.push(at),
                    Action::Finish(Step::Application) => overruns += u32::from(at > 500_000),
                    Action::Begin(Step::OutputsValid) => acts.push(at),
                    _ => {}
                }
            }
        }
        let range = |values: &[u64]| (*values.iter().min().unwrap(), *values.iter().max().unwrap());
        let (least, most) = range(&latencies);
        assert!(least < 200 && (2_500..=4_000).contains(&most), "{least} {most}");
        let (least, most) = range(&copies);
        assert!((10_000..10_300).contains(&least) && (19_700..=20_000).contains(&most), "{most}");
        assert!((3..=25).contains(&overruns), "{overruns} of 1000, one in 100 asked");
        let (least, most) = range(&acts);
        assert!((100_000..100_010).contains(&least) && (100_290..=100_300).contains(&most));
    }

    /// With and without steps; it is as late as the steps if the interrupt is late.
    #[test]
    fn a_pulse_is_acknowledged_in_its_time() {
        let mut steps = Steps::EMPTY;
        steps.push(Step::Application, Nanos::ZERO);
        let model = CpuModel { acknowledge: Nanos(30_000), ..CpuModel::default() };
        let mut cpu = Cpu::new(model, Stream::new(1, "test", 0));
        cpu.start(Time::new(0), &steps, Some(Event::Sync0));
        cpu.start(Time::new(100_000), &Steps::EMPTY, Some(Event::Sync1));
        let all = agenda(&mut cpu);
        assert_eq!(all.last(), Some(&(130_000, Action::Acknowledge(Event::Sync1))));
        assert!(all.contains(&(30_000, Action::Acknowledge(Event::Sync0))), "{all:?}");

        let mut cpu =
            Cpu::new(CpuModel { jitter: Nanos(2_000), ..model }, Stream::new(1, "test", 0));
        let mut spread = (u64::MAX, 0);
        for cycle in 0..1_000 {
            let start = cycle * 1_000_000;
            cpu.start(Time::new(start), &steps, Some(Event::Sync0));
            let all = agenda(&mut cpu);
            let at = |wanted| all.iter().find(|(_, action)| *action == wanted).unwrap().0 - start;
            let read = at(Action::Acknowledge(Event::Sync0));
            assert_eq!(read - 30_000, at(Action::Begin(Step::Application)));
            spread = (spread.0.min(read), spread.1.max(read));
        }
        assert!((30_000..30_050).contains(&spread.0), "{spread:?}");
        assert!((31_950..=32_000).contains(&spread.1), "{spread:?}");
    }
}
