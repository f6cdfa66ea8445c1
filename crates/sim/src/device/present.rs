//! What the last event has started, as far as it is still to be done.

use isocat_wire::time::{Device, Time};

use crate::cpu::{Cpu, Part, Plan};

/// The plan of an event in progress.
#[derive(Clone, Debug)]
pub(super) struct Present {
    /// The event.
    pub at: Time<Device>,
    plan: Box<Plan>,
    /// Number of the next part.
    next: usize,
    /// Whether the step of that part has begun.
    half: bool,
    /// When the next action is due.
    due: Time<Device>,
}

impl Present {
    /// Nothing.
    pub fn none() -> Self {
        let plan = Box::new(Plan::NONE);
        Self { at: Time::ZERO, plan, next: 0, half: false, due: Time::NEVER }
    }

    /// Puts all that is left onto the agenda of the CPU.
    pub fn put_onto(&mut self, cpu: &mut Cpu) {
        if !self.is_over() {
            cpu.put(self.at, &self.plan, self.next, self.half);
            self.clear();
        }
    }

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

    /// Takes the plan that `make` writes, of an event at `at`.
    #[inline]
    pub fn take_new(&mut self, at: Time<Device>, make: impl FnOnce(&mut Plan)) {
        self.at = at;
        make(&mut self.plan);
        (self.next, self.half) = (0, false);
        self.note_due();
    }

    /// The number of the next part, and whether its step has begun.
    #[inline]
    pub const fn place(&self) -> (usize, bool) {
        (self.next, self.half)
    }

    /// One of the parts.
    #[inline]
    pub fn part(&self, number: usize) -> Option<Part> {
        self.plan.part(number)
    }

    /// The next part is this one, and the next action is due then. `half`: its step has begun.
    #[inline]
    pub fn go_on(&mut self, number: usize, half: bool, due: Time<Device>) {
        (self.next, self.half, self.due) = (number, half, due);
    }

    /// The parts before this one are done.
    pub fn skip_to(&mut self, number: usize) {
        (self.next, self.half) = (number, false);
        self.note_due();
    }

    #[inline]
    fn note_due(&mut self) {
        self.due = self.plan.part(self.next).map_or(Time::NEVER, |part| self.at + part.after);
    }
}
