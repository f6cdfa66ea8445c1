//! What an event lets a CPU do, as actions in the order of time.

use isocat_subdevice::{Event, MAX_STEPS, Step};
use isocat_wire::time::Nanos;

use super::sequence::Sequence;

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

    /// Becomes a plan of nothing.
    pub(super) fn clear(&mut self) {
        self.len = 0;
    }

    /// Inserts an action after all that are due no later.
    pub(super) fn insert(&mut self, after: Nanos, action: Action) {
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
    pub(super) fn add(
        &mut self,
        steps: impl Iterator<Item = (Step, Nanos, Nanos)>,
        in_order: bool,
    ) {
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
        self.clear();
        let spans = sequence.spans().iter().take_while(|span| span.step.is_some());
        // What begins at an instant stands in the order of the steps, not in that of their ends.
        let all = (0..spans.clone().count()).filter_map(|number| {
            let span = spans.clone().find(|span| usize::from(span.number()) == number)?;
            Some((span.step?, span.after(), span.until()))
        });
        self.add(all, sequence.in_order());
    }

    /// All of the parts.
    #[cfg(test)]
    pub fn all(&self) -> &[Part] {
        &self.parts[..self.len.into()]
    }

    /// One of the parts.
    #[inline]
    pub fn part(&self, number: usize) -> Option<Part> {
        (number < MAX_PARTS.min(self.len.into())).then(|| self.parts[number])
    }
}

/// Most parts of a plan: the beginning and the end of each step, and an acknowledge.
const MAX_PARTS: usize = 2 * MAX_STEPS + 1;
