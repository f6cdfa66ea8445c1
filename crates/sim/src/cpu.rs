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

    /// Adds the steps of an event, each with the times of its beginning and its end. `in_order`:
    /// each ends before the next one begins, and there is nothing else.
    fn add(&mut self, steps: impl Iterator<Item = (Step, Nanos, Nanos)>, in_order: bool) {
        if in_order {
            for (part, (step, after, until)) in self.parts.iter_mut().zip(steps) {
                *part = Part { after, until, what: What::Step(step) };
                self.len += 1;
            }
            return;
        }
        for (step, begin, end) in steps {
            self.insert(begin, Action::Begin(step));
            self.insert(end, Action::Finish(step));
        }
        self.join();
    }

    /// Becomes the plan of the steps of an event.
    pub fn take_sequence(&mut self, sequence: &Sequence) {
        self.len = 0;
        let spans = sequence.spans().iter().take_while(|span| span.step.is_some());
        // What begins at an instant stands in the order of the steps, not in that of their ends.
        let all = (0..spans.clone().count()).filter_map(|number| {
            let span = spans.clone().find(|span| usize::from(span.number) == number)?;
            Some((span.step?, span.after(), span.until()))
        });
        self.add(all, sequence.in_order);
    }

    /// One of the parts.
    #[inline]
    pub fn part(&self, number: usize) -> Option<Part> {
        (number < MAX_PARTS.min(self.len.into())).then(|| self.parts[number])
    }
}

/// The times of the steps of an event, in the order in which the steps end.
#[derive(Clone, Copy, Debug)]
pub struct Sequence {
    /// The steps, up to the first one that is none.
    spans: [Span; MAX_STEPS + 1],
    end: u32,
    /// Whether each step ends before the next one begins.
    in_order: bool,
    /// See [`Sequence::is_whole`].
    whole: bool,
}

/// A step with the times from the event to its beginning and its end, ns.
#[derive(Clone, Copy, Debug)]
pub struct Span {
    /// The step; `None` behind the last one.
    pub step: Option<Step>,
    /// Its number among the steps of the event.
    number: u8,
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
    /// Nothing.
    pub const NONE: Self = {
        let none = Span { step: None, number: 0, after: 0, until: 0 };
        Self { spans: [none; MAX_STEPS + 1], end: 0, in_order: true, whole: true }
    };

    /// Puts the next step; it has this number.
    #[inline(always)]
    fn put(&mut self, number: usize, step: Step, after: u32, until: u32) {
        self.whole &= after <= until;
        let mut place = number;
        while let Some(before) = place.checked_sub(1).map(|at| self.spans[at])
            && before.until > until
        {
            // Outputs are fetched at the beginning of their mapping, which thus has two effects.
            self.whole &= before.step != Some(Step::MapOutputs);
            self.spans[place] = before;
            place -= 1;
        }
        self.spans[place] = Span { step: Some(step), number: number as u8, after, until };
    }

    /// Whether each step ends before the next one begins.
    #[inline]
    pub fn in_order(&self) -> bool {
        self.in_order
    }

    /// Whether each step may be done at once at its end, though others come while it is in
    /// progress: all that it does, it does then.
    #[inline]
    pub fn is_whole(&self) -> bool {
        self.whole
    }

    /// Number of parts of a [`Plan`] that the first `count` steps are. A step during which another
    /// one comes is two parts.
    pub fn parts(&self, count: usize) -> usize {
        let done = &self.spans[..count];
        let divided = |(place, span): &(usize, &Span)| {
            let comes = |other: &Span| other.number > span.number && other.after >= span.after;
            done[..*place].iter().any(comes)
        };
        count + done.iter().enumerate().filter(divided).count()
    }

    /// Time from the event to the end of the last step.
    #[inline]
    pub fn end(&self) -> Nanos {
        Nanos(self.end.into())
    }

    /// The steps in the order of their ends, up to the first one that is none.
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
    bounds: Bounds,
    jitter: Stream,
}

/// What the times of steps are drawn from, ns. No time is longer than [`FAR`], so that sums of them
/// stay within their range.
#[derive(Clone, Copy, Debug)]
struct Bounds {
    copy_outputs: Duration,
    application: Duration,
    copy_inputs: Duration,
    timer_jitter: i64,
    latency: i64,
    /// The number of cycles of which one takes longer, and by how much.
    overrun: Option<(u64, i64)>,
}

impl Bounds {
    fn new(model: &CpuModel) -> Self {
        let Unevenness { latency, variation, overrun, timer_jitter } = model.unevenness;
        let bound = |time: Nanos| time.0.clamp(-FAR, FAR);
        let variation = i64::from(variation.min(100));
        let duration = |longest: Nanos| {
            let longest = bound(longest);
            Duration { longest, spread: longest / 100 * variation }
        };
        Self {
            copy_outputs: duration(model.copy_outputs),
            application: duration(model.application),
            copy_inputs: duration(model.copy_inputs),
            timer_jitter: bound(timer_jitter),
            latency: bound(latency),
            overrun: overrun.map(|Overrun { one_in, by }| (one_in.max(1).into(), bound(by))),
        }
    }
}

/// A uniformly distributed time, ns.
#[derive(Clone, Copy, Debug)]
struct Duration {
    longest: i64,
    spread: i64,
}

impl Duration {
    #[inline(always)]
    fn draw(self, jitter: &mut Stream) -> i64 {
        self.longest - at_random(jitter, self.spread)
    }
}

/// A random time of at most `most`.
#[inline(always)]
fn at_random(jitter: &mut Stream, most: i64) -> i64 {
    // Without variation nothing is drawn, so that other random numbers stay the same.
    match most {
        1.. => jitter.up_to(most as u64) as i64,
        _ => 0,
    }
}

/// 36 years.
const FAR: i64 = 1 << 60;

impl Cpu {
    /// An idle CPU.
    pub fn new(model: CpuModel, jitter: Stream) -> Self {
        let even = model.jitter == Nanos::ZERO && model.unevenness == Unevenness::default();
        Self {
            bounds: Bounds::new(&model),
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
        let mut jitter = self.jitter.clone();
        let (late, at) = self.late(&mut jitter, steps, pulse.is_some());
        if let Some(pulse) = pulse {
            plan.insert(late + self.model.acknowledge, Action::Acknowledge(pulse));
        }
        let mut times = [(Step::MapOutputs, Nanos::ZERO, Nanos::ZERO); MAX_STEPS];
        let (in_order, _) = self.times(&mut jitter, steps, at, |number, step, begin, end| {
            times[number] = (step, begin, end);
        });
        self.jitter = jitter;
        plan.add(times.into_iter().take(steps.len()), in_order && pulse.is_none());
    }

    /// The same for an event with steps and without a pulse. `false`: it takes longer than 4 s, and
    /// nothing was drawn.
    pub fn draw(&mut self, steps: &Steps, sequence: &mut Sequence) -> bool {
        if steps.is_empty() {
            return false;
        }
        let mut jitter = self.jitter.clone();
        let (_, at) = self.late(&mut jitter, steps, false);
        let mut all = 0;
        sequence.whole = true;
        let (in_order, end) = self.times(&mut jitter, steps, at, |number, step, begin, end| {
            sequence.put(number, step, begin.0 as u32, end.0 as u32);
            all |= begin.0 | end.0;
        });
        // The rest may be another event's.
        sequence.spans[steps.len()].step = None;
        (sequence.end, sequence.in_order) = (end.0 as u32, in_order);
        let fits = u32::try_from(all).is_ok();
        if fits {
            self.jitter = jitter;
        }
        fits
    }

    /// How late the interrupt of an event is, and with it the steps.
    #[inline(always)]
    fn late(&self, jitter: &mut Stream, steps: &Steps, pulse: bool) -> (Nanos, Nanos) {
        if self.even {
            return (Nanos::ZERO, Nanos::ZERO);
        }
        let of = |(step, _): &(Step, Nanos)| *step == Step::MapOutputs;
        let synchronized = !steps.as_slice().iter().any(of);
        // The copy time of the outputs is already the longest, so no jitter is added to it.
        let late = match synchronized || pulse {
            true => Nanos(jitter.up_to(self.model.jitter.0.clamp(0, FAR) as u64) as i64),
            false => Nanos::ZERO,
        };
        (late, if synchronized { late } else { Nanos::ZERO })
    }

    /// Draws the times from an event to the beginning and the end of each step, and `put`s them
    /// with the number of the step. Returns whether each step ends before the next one begins, as
    /// they do as a rule, and when the last one ends.
    #[inline(always)]
    fn times(
        &self,
        jitter: &mut Stream,
        steps: &Steps,
        at: Nanos,
        mut put: impl FnMut(usize, Step, Nanos, Nanos),
    ) -> (bool, Nanos) {
        let bounds = &self.bounds;
        let mut free = at.0;
        let mut latched = free;
        let mut in_order = true;
        for (i, &(step, delay)) in steps.as_slice().iter().enumerate() {
            let of_hardware = matches!(step, Step::OutputsValid | Step::LatchInputs);
            let delayed = delay > Nanos::ZERO;
            let mut due = at.0 + delay.0.min(FAR);
            if of_hardware && delayed {
                due += at_random(jitter, bounds.timer_jitter);
            }
            let mut begin = if of_hardware && (delayed || i == 0) { due } else { due.max(free) };
            let end = match step {
                Step::MapOutputs => {
                    let end = begin + bounds.copy_outputs.draw(jitter);
                    begin = (begin + self.latency(jitter)).min(end);
                    end
                }
                Step::Application => begin + bounds.application.draw(jitter) + self.overrun(jitter),
                // It counts from the latch, so it includes the application's work in between.
                Step::MapInputs => begin.max(latched + bounds.copy_inputs.draw(jitter)),
                Step::OutputsValid | Step::LatchInputs => begin,
            };
            if step == Step::LatchInputs {
                latched = begin;
            }
            in_order &= free <= begin && begin <= end;
            put(i, step, Nanos(begin), Nanos(end));
            free = free.max(end);
        }
        (in_order, Nanos(free))
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

    #[inline(always)]
    fn latency(&self, jitter: &mut Stream) -> i64 {
        match self.bounds.latency {
            worst @ 1.. => jitter.lateness(worst as u64) as i64,
            _ => 0,
        }
    }

    #[inline(always)]
    fn overrun(&self, jitter: &mut Stream) -> i64 {
        match self.bounds.overrun {
            Some((one_in, by)) if jitter.up_to(one_in - 1) == 0 => by,
            _ => 0,
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

    /// Outputs act during the mapping of inputs, which does all that it does at its end.
    #[test]
    fn what_is_drawn_is_the_plan_in_the_order_of_ends() {
        let unevenness = Unevenness {
            latency: Nanos(4_000),
            variation: 90,
            overrun: Some(Overrun { one_in: 3, by: Nanos(9_000) }),
            timer_jitter: Nanos(12_000),
        };
        let model = CpuModel { jitter: Nanos(2_000), unevenness, ..CpuModel::default() };
        let [mut one, mut other] = [(); 2].map(|()| Cpu::new(model, Stream::new(3, "test", 0)));
        let mut delays = Stream::new(4, "test", 0);
        let (mut drawn, mut moved) = (Sequence::NONE, 0);
        for _ in 0..3_000 {
            let mut steps = Steps::EMPTY;
            for step in Step::ALL {
                if delays.up_to(3) > 0 {
                    steps.push(step, Nanos(delays.up_to(3) as i64 * 5_000));
                }
            }
            let (mut plan, mut same) = (Plan::NONE, Plan::NONE);
            one.plan(&steps, None, &mut plan);
            assert_eq!(other.draw(&steps, &mut drawn), !steps.is_empty());
            if steps.is_empty() {
                continue;
            }
            same.take_sequence(&drawn);
            let parts = |plan: &Plan| plan.parts[..plan.len.into()].to_vec();
            assert_eq!(parts(&plan), parts(&same));
            let spans = &drawn.spans()[..steps.len()];
            assert!(spans.is_sorted_by_key(|span| span.until));
            assert_eq!(spans.iter().map(|span| span.until()).max(), Some(drawn.end()));
            assert_eq!(drawn.parts(spans.len()), plan.len.into());
            // Steps that are whole are done one after another: after each step of the CPU, the
            // parts up to its end are done.
            for (place, span) in spans.iter().enumerate() {
                let of_cpu = [Step::MapOutputs, Step::MapInputs].map(Some).contains(&span.step);
                if of_cpu && drawn.is_whole() {
                    let done = drawn.parts(place + 1);
                    assert!(parts(&plan)[..done].iter().all(|part| part.until <= span.until()));
                    assert!(parts(&plan)[done..].iter().all(|part| part.after >= span.until()));
                }
            }
            moved += u32::from(drawn.is_whole() && !drawn.in_order());
        }
        assert!(moved > 100, "{moved}");
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
