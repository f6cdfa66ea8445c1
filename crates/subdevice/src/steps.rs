//! The steps that an event starts: a short list, each with its delay.

use isocat_sync::Step;
use isocat_wire::Nanos;

/// Most steps that one event can start.
pub const MAX_STEPS: usize = Step::ALL.len();

/// The steps that one event starts, each with the time from the event until it is due, ns, in the
/// order of their due times.
///
/// [`Step::MapOutputs`], [`Step::Application`] and [`Step::MapInputs`] need the CPU: they run one
/// after another in this order, none before it is due. [`Step::OutputsValid`] and
/// [`Step::LatchInputs`] are actions of the output stage and of the converters. With a delay, or as
/// the first of the list, they happen at the event + delay, independent of the CPU; without a delay
/// they follow the steps before them.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Steps {
    list: [(Step, Nanos); MAX_STEPS],
    len: usize,
}

impl Steps {
    /// No steps.
    pub const EMPTY: Self = Self { list: [(Step::MapOutputs, Nanos::ZERO); MAX_STEPS], len: 0 };

    /// Inserts a step after all that are due no later. An event starts no step twice, so the list
    /// always has enough space.
    pub fn push(&mut self, step: Step, delay: Nanos) {
        let mut at = self.len;
        // Most steps are pushed in order, so that none moves.
        while at > 0 && self.list[at - 1].1 > delay {
            self.list[at] = self.list[at - 1];
            at -= 1;
        }
        self.list[at] = (step, delay);
        self.len += 1;
    }

    /// The steps and their delays.
    #[inline]
    pub fn as_slice(&self) -> &[(Step, Nanos)] {
        &self.list[..self.len]
    }

    /// The steps and their delays, one after another.
    #[inline]
    pub fn iter(&self) -> impl Iterator<Item = (Step, Nanos)> + '_ {
        self.as_slice().iter().copied()
    }

    /// Number of steps.
    #[inline]
    pub const fn len(&self) -> usize {
        self.len
    }

    /// Whether there are no steps.
    #[inline]
    pub const fn is_empty(&self) -> bool {
        self.len == 0
    }
}

impl IntoIterator for Steps {
    type Item = (Step, Nanos);
    type IntoIter = core::iter::Take<core::array::IntoIter<(Step, Nanos), MAX_STEPS>>;
    fn into_iter(self) -> Self::IntoIter {
        self.list.into_iter().take(self.len)
    }
}

impl Default for Steps {
    fn default() -> Self {
        Self::EMPTY
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_stand_in_the_order_in_which_they_are_due() {
        let mut steps = Steps::EMPTY;
        for (step, delay) in [
            (Step::LatchInputs, 5),
            (Step::Application, 0),
            (Step::OutputsValid, 4),
            (Step::MapInputs, 5),
        ] {
            steps.push(step, Nanos(delay));
        }
        let order: std::vec::Vec<_> = steps.into_iter().map(|(step, _)| step).collect();
        use Step::*;
        assert_eq!(order, [Application, OutputsValid, LatchInputs, MapInputs]);
    }
}
