//! A SubDevice's CPU: when the steps of a cycle begin and end.

use isocat_subdevice::{Step, Steps};
use isocat_wire::time::{Device, Nanos, Time};

use crate::random::Stream;

/// How long a SubDevice's CPU takes for what, in ns of its own oscillator.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct CpuModel {
    /// From an event to the answer of the main loop (state changes, mailbox).
    pub reaction: Nanos,
    /// From the SM2 event until outputs are copied and calculated, interrupt latency included: what
    /// 0x1C32:06 should say.
    pub copy_outputs: Nanos,
    /// The application's own work.
    pub application: Nanos,
    /// From Input Latch until inputs stand in the buffer: what 0x1C33:06 should say.
    pub copy_inputs: Nanos,
    /// Spread, peak to peak, with which the steps of an event begin: interrupts do not always come
    /// through at once.
    pub jitter: Nanos,
}

impl Default for CpuModel {
    fn default() -> Self {
        Self {
            reaction: Nanos(50_000),
            copy_outputs: Nanos(20_000),
            application: Nanos(10_000),
            copy_inputs: Nanos(10_000),
            jitter: Nanos(0),
        }
    }
}

/// Something the CPU does at an instant.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Action {
    /// A step ends. Stands first: what ends at an instant is done before what begins there.
    Finish(Step),
    /// A step begins.
    Begin(Step),
    /// The main loop runs.
    Poll,
}

/// What a CPU is going to do.
#[derive(Clone, Debug)]
pub struct Cpu {
    model: CpuModel,
    /// Few at a time: steps of two overlapping cycles. Sorted by time from `done` on, soonest first;
    /// what stands before is done.
    agenda: Vec<(Time<Device>, Action)>,
    done: usize,
    polling: bool,
    jitter: Stream,
}

impl Cpu {
    /// An idle CPU.
    pub fn new(model: CpuModel, jitter: Stream) -> Self {
        Self { model, agenda: Vec::with_capacity(16), done: 0, polling: false, jitter }
    }

    /// How long it takes for what.
    pub fn model(&self) -> &CpuModel {
        &self.model
    }

    /// It loses its power, and all that it was going to do.
    pub fn power_off(&mut self) {
        self.agenda.clear();
        self.done = 0;
        self.polling = false;
    }

    /// When it does something next.
    pub fn next(&self) -> Time<Device> {
        self.agenda.get(self.done).map_or(Time::NEVER, |(at, _)| *at)
    }

    /// Takes the next thing to do.
    pub fn pop(&mut self) -> Option<(Time<Device>, Action)> {
        let next = *self.agenda.get(self.done)?;
        self.done += 1;
        if self.done == self.agenda.len() {
            self.agenda.clear();
            self.done = 0;
        }
        if next.1 == Action::Poll {
            self.polling = false;
        }
        Some(next)
    }

    /// Has the main loop run soon after an event at `at`.
    pub fn wake(&mut self, at: Time<Device>) {
        if !self.polling {
            self.polling = true;
            self.insert(at + self.model.reaction, Action::Poll);
        }
    }

    /// Starts the steps of an event at `at`. Steps of the CPU run one after another; what the hardware
    /// does happens at its own instant.
    pub fn start(&mut self, at: Time<Device>, steps: &Steps) {
        if steps.is_empty() {
            return;
        }
        let of = |(step, _): &(Step, Nanos)| *step == Step::MapOutputs;
        let synchronized = !steps.as_slice().iter().any(of);
        // The copy time of the outputs is the longest that the device needs: nothing is added to it.
        let late =
            if synchronized { self.jitter.up_to(self.model.jitter.0.max(0) as u64) } else { 0 };
        let at = at + Nanos(late as i64);
        let mut free = at;
        let mut latched = at;
        for (i, &(step, delay)) in steps.as_slice().iter().enumerate() {
            let of_hardware = matches!(step, Step::OutputsValid | Step::LatchInputs);
            let due = at + delay;
            let begin =
                if of_hardware && (delay > Nanos::ZERO || i == 0) { due } else { due.max(free) };
            let end = match step {
                Step::MapOutputs => begin + self.model.copy_outputs,
                Step::Application => begin + self.model.application,
                // Counted from the latch, so the application's work in between is part of it.
                Step::MapInputs => begin.max(latched + self.model.copy_inputs),
                Step::OutputsValid | Step::LatchInputs => begin,
            };
            if step == Step::LatchInputs {
                latched = begin;
            }
            self.insert(begin, Action::Begin(step));
            self.insert(end, Action::Finish(step));
            free = free.max(end);
        }
    }

    /// Inserts behind all that is due at the same instant, so that a step's beginning stands before its
    /// end; but ends of earlier steps stand before beginnings of later ones by the order of insertion.
    fn insert(&mut self, at: Time<Device>, action: Action) {
        if self.agenda.len() == self.agenda.capacity() {
            self.agenda.drain(..self.done);
            self.done = 0;
        }
        // Most come last: steps are started in the order in which they are due.
        self.agenda.push((at, action));
        let mut place = self.agenda.len() - 1;
        while place > self.done && self.agenda[place - 1].0 > at {
            self.agenda.swap(place - 1, place);
            place -= 1;
        }
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
}
