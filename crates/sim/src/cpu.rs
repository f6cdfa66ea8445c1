//! A SubDevice's CPU: when the steps of a cycle begin and end.

mod model;
mod plan;
mod sequence;

use isocat_subdevice::{Event, MAX_STEPS, Step, Steps};
use isocat_wire::time::{Device, Nanos, Time};

use crate::random::Stream;
use model::{Bounds, FAR, at_random};
pub use model::{CpuModel, Overrun, Unevenness};
pub use plan::{Action, Part, Plan, What};
pub use sequence::{Sequence, Span};

/// The planned actions of a CPU.
#[derive(Clone, Debug)]
pub struct Cpu {
    model: CpuModel,
    /// A few actions: steps of two overlapping cycles. They are sorted by time from `done` on,
    /// soonest first; earlier entries are done.
    agenda: Vec<(Time<Device>, Action)>,
    done: u32,
    /// When the first of them is due.
    due: Time<Device>,
    polling: bool,
    /// Whether its times never vary.
    even: bool,
    bounds: Bounds,
    jitter: Stream,
}
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
        self.due = self.agenda.get(self.done as usize).map_or(Time::NEVER, |(at, _)| *at);
    }

    /// Takes the next action.
    pub fn pop(&mut self) -> Option<(Time<Device>, Action)> {
        let next = *self.agenda.get(self.done as usize)?;
        self.done += 1;
        if self.done as usize == self.agenda.len() {
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
        plan.clear();
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
        sequence.take(steps.len(), |sequence| {
            self.times(&mut jitter, steps, at, |number, step, begin, end| {
                sequence.put(number, step, begin.0 as u32, end.0 as u32);
                all |= begin.0 | end.0;
            })
        });
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
            Some((one_in, by)) if jitter.up_to(u64::from(one_in.get()) - 1) == 0 => by,
            _ => 0,
        }
    }

    /// Inserts an action after all actions at the same instant, so that a step begins before it
    /// ends. Ends of earlier steps come before beginnings of later ones by the order of insertion.
    fn insert(&mut self, at: Time<Device>, action: Action) {
        if self.agenda.len() == self.agenda.capacity() {
            self.agenda.drain(..self.done as usize);
            self.done = 0;
        }
        // Most actions belong at the end, since steps are started in the order of their due times.
        self.agenda.push((at, action));
        let mut place = self.agenda.len() - 1;
        while place > self.done as usize && self.agenda[place - 1].0 > at {
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
            let parts = |plan: &Plan| plan.all().to_vec();
            assert_eq!(parts(&plan), parts(&same));
            let spans = &drawn.spans()[..steps.len()];
            assert!(spans.is_sorted_by_key(|span| span.until()));
            assert_eq!(spans.iter().map(|span| span.until()).max(), Some(drawn.end()));
            assert_eq!(drawn.parts(spans.len()), plan.all().len());
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
