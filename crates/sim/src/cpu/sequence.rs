//! The times of the steps of an event, as far as they can be done as a whole.

use isocat_subdevice::{MAX_STEPS, Step};
use isocat_wire::time::Nanos;

use crate::brief::{NotedSteps, Parts};

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
    /// See [`Sequence::noted`].
    noted: NotedSteps,
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
    /// Its number among the steps of the event.
    pub(super) fn number(&self) -> u8 {
        self.number
    }

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
        Self {
            spans: [none; MAX_STEPS + 1],
            end: 0,
            in_order: true,
            whole: true,
            noted: NotedSteps::NONE,
        }
    };

    /// Becomes the `count` steps that `times` puts; it returns whether each of them ends before the
    /// next one begins, and when the last one ends.
    #[inline(always)]
    pub(super) fn take(&mut self, count: usize, times: impl FnOnce(&mut Self) -> (bool, Nanos)) {
        self.whole = true;
        let (in_order, end) = times(self);
        // The rest may be another event's.
        self.spans[count].step = None;
        (self.end, self.in_order) = (end.0 as u32, in_order);
    }

    /// Puts the next step; it has this number.
    #[inline(always)]
    pub(super) fn put(&mut self, number: usize, step: Step, after: u32, until: u32) {
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

    /// Notes which steps judges need.
    pub(crate) fn note_all(&mut self) {
        self.noted = self.first_noted(MAX_STEPS);
    }

    /// The steps that judges need, if they were [noted](Self::note_all).
    #[inline]
    pub(crate) fn noted(&self) -> NotedSteps {
        self.noted
    }

    /// The steps that judges need, among the first `count` steps.
    pub(crate) fn first_noted(&self, count: usize) -> NotedSteps {
        let mut noted = NotedSteps::NONE;
        for (place, span) in (0..).zip(&self.spans[..count]) {
            let (part, at) = match span.step {
                None => break,
                Some(Step::MapOutputs) => (Parts::MAPPED, &mut noted.mapped),
                Some(Step::OutputsValid) => (Parts::VALID, &mut noted.valid),
                Some(Step::LatchInputs) => (Parts::LATCHED, &mut noted.latched),
                Some(Step::Application | Step::MapInputs) => continue,
            };
            (*at, noted.parts) = (place, noted.parts.with(part));
        }
        noted
    }

    /// Number of parts of a [`Plan`](super::Plan) that the first `count` steps are. A step during
    /// which another one comes is two parts.
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
