//! What the last event has started, as far as it is still to be done.

use isocat_wire::time::{Device, Time};

use crate::cpu::{Part, Plan};

/// The plan of an event in progress.
#[derive(Clone, Debug)]
pub(super) struct Present {
    /// The event.
    pub at: Time<Device>,
    plan: Plan,
    /// Number of the next part.
    next: usize,
    /// Whether the step of that part has begun.
    half: bool,
    /// When the next action is due.
    due: Time<Device>,
}

impl Present {
    /// Nothing.
    pub const NONE: Self =
        Self { at: Time::ZERO, plan: Plan::NONE, next: 0, half: false, due: Time::NEVER };

    /// Removes all that is left.
    pub fn clear(&mut self) {
        self.due = Time::NEVER;
    }

    /// When the next action is due; never, if nothing is left.
    #[inline]
    pub const fn due(&self) -> Time<Device> {
        self.due
    }

    /// Whether nothing is left.
    #[inline]
    pub fn is_over(&self) -> bool {
        self.due == Time::NEVER
    }

    /// The plan, the number of its next part, and whether the step of that part has begun.
    pub fn rest(&self) -> (&Plan, usize, bool) {
        (&self.plan, self.next, self.half)
    }

    /// Takes the plan of an event at `at`.
    #[inline]
    pub fn take(&mut self, at: Time<Device>, plan: &Plan) {
        self.at = at;
        self.plan.copy(plan);
        (self.next, self.half) = (0, false);
        self.note_due();
    }

    /// The next part, and whether its step has begun; `None` if nothing is left.
    #[inline]
    pub fn part(&self) -> Option<(Part, bool)> {
        self.plan.part(self.next).map(|part| (part, self.half))
    }

    /// The step of the next part has begun; it ends at `until`.
    pub fn begun(&mut self, until: Time<Device>) {
        (self.half, self.due) = (true, until);
    }

    /// The next part is done.
    #[inline]
    pub fn done(&mut self) {
        self.next += 1;
        self.half = false;
        self.note_due();
    }

    #[inline]
    fn note_due(&mut self) {
        self.due = self.plan.part(self.next).map_or(Time::NEVER, |part| self.at + part.after);
    }
}
