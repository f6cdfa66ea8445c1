//! A point of time that may be missing.

use isocat_wire::time::{Scale, Time};

/// A point of time, or none: half the size of an `Option`, and set and taken in one step.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Mark<S: Scale>(Time<S>);

impl<S: Scale> Default for Mark<S> {
    fn default() -> Self {
        Self(Time::NEVER)
    }
}

impl<S: Scale> From<Option<Time<S>>> for Mark<S> {
    #[inline]
    fn from(at: Option<Time<S>>) -> Self {
        Self(at.unwrap_or(Time::NEVER))
    }
}

impl<S: Scale> Mark<S> {
    #[inline]
    pub fn set(&mut self, at: Time<S>) {
        self.0 = at;
    }

    #[inline]
    pub fn clear(&mut self) {
        self.0 = Time::NEVER;
    }

    #[inline]
    pub fn take(&mut self) -> Option<Time<S>> {
        std::mem::take(self).get()
    }

    #[inline]
    pub fn get(self) -> Option<Time<S>> {
        (self.0 != Time::NEVER).then_some(self.0)
    }
}
