//! Counts the cycles between the start of process data and the first occasion at which they can
//! take effect.

use isocat_wire::time::{Nanos, Picos, Time, True};

use super::Grid;

/// The first occasion of process data after their start: the first point of one grid after a point
/// of another. Both grids are intent and define the phrase "in its cycle". The distance seen
/// between a real start and a real occasion then tells the number of cycles by which it was late.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[repr(C)]
pub struct Opportunity {
    /// The times from start to effect from which on an effect is late: if the start may be late,
    /// and if the occasion may be. These are all that a regular cycle needs.
    late_since: Picos,
    late_until: Picos,
    /// Distance from a point of the first grid to the next point of the second, if both have the
    /// same cycle; above zero, and at most `step`.
    distance: Picos,
    /// The shorter of both cycles, in which missed occasions are counted.
    step: Picos,
    /// The longer of both cycles, which counts as a whole cycle.
    cycle: Picos,
}

impl Opportunity {
    /// The opportunity from points of `start` to points of `occasion`. `None` if a cycle is zero.
    pub fn new(start: Grid, occasion: Grid) -> Option<Self> {
        let (step, cycle) = (start.cycle.min(occasion.cycle).0, start.cycle.max(occasion.cycle).0);
        let distance = (occasion.phase.0 - start.phase.0).checked_rem_euclid(step)?;
        let distance = Picos::from(Nanos(if distance == 0 { step } else { distance }));
        let (step, cycle) = (Picos::from(Nanos(step)), Nanos(cycle).into());
        let late = |room| step + distance - room;
        let (late_since, late_until) = (late(room_of_start(step)), late(room_of_occasion(step)));
        Some(Self { distance, step, cycle, late_since, late_until })
    }

    /// Number of whole cycles by which an effect, `seen` after its start, was late; 0 is in its
    /// cycle. A start may be up to a quarter of a step before its grid point and three quarters
    /// after it, since a host sends late and not early.
    #[inline]
    pub fn cycles_late_since_frame(&self, seen: Picos) -> i64 {
        // As a rule it is in time, and nothing is to be divided.
        if seen < self.late_since { 0 } else { self.cycles_late(seen, room_of_start(self.step)) }
    }

    /// The same if the occasion may be late: it is the frame that fetches the data.
    #[inline]
    pub fn cycles_late_until_frame(&self, seen: Picos) -> i64 {
        if seen < self.late_until { 0 } else { self.cycles_late(seen, room_of_occasion(self.step)) }
    }

    #[cold]
    fn cycles_late(&self, seen: Picos, room: Picos) -> i64 {
        let steps = (seen.0 - self.distance.0 + room.0).div_euclid(self.step.0);
        // A negative count means that the start was late by more than three quarters of a step, but
        // still in time.
        (steps.max(0).saturating_mul(self.step.0)) / self.cycle.0
    }
}

/// By how much a start may be late.
fn room_of_start(step: Picos) -> Picos {
    Picos(step.0 / 4 * 3)
}

/// By how much an occasion may be late.
fn room_of_occasion(step: Picos) -> Picos {
    Picos(step.0 / 4)
}

/// Late process data: number, first time, worst cases.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Late {
    count: u64,
    first: Option<Time<True>>,
    cycles: u64,
    age: Picos,
}

impl Late {
    /// Takes process data that took effect at `at`, late by this number of `cycles` and with this
    /// age. Data in its cycle is not counted.
    #[inline]
    pub fn take(&mut self, at: Time<True>, cycles: i64, age: Picos) {
        if let Ok(cycles @ 1..) = u64::try_from(cycles) {
            self.note(at, cycles, age);
        }
    }

    #[cold]
    fn note(&mut self, at: Time<True>, cycles: u64, age: Picos) {
        self.count += 1;
        self.first.get_or_insert(at);
        self.cycles = self.cycles.max(cycles);
        self.age = self.age.max(age);
    }

    /// Number of late occurrences.
    pub fn count(&self) -> u64 {
        self.count
    }
    /// When the first occurred.
    pub fn first(&self) -> Option<Time<True>> {
        self.first
    }
    /// Largest number of cycles.
    pub fn cycles(&self) -> u64 {
        self.cycles
    }
    /// Largest age of late data.
    pub fn age(&self) -> Picos {
        self.age
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(cycle: i64, phase: i64) -> Grid {
        Grid { cycle: Nanos::micros(cycle), phase: Nanos::micros(phase) }
    }

    fn us(us: i64) -> Picos {
        Nanos::micros(us).into()
    }

    #[test]
    fn a_whole_cycle_begins_where_the_next_occasion_lies() {
        let late = Opportunity::new(grid(1000, 0), grid(1000, 650)).unwrap();
        for (sent_late, seen, cycles) in
            [(0, 650, 0), (600, 50, 0), (0, 1650, 1), (740, 910, 1), (0, 2650, 2), (-200, 850, 0)]
        {
            assert_eq!(late.cycles_late_since_frame(us(seen)), cycles, "sent {sent_late} us late");
        }
        // The smallest step: a frame three quarters of a cycle late counts for the same cycle, a
        // later one for the next.
        let edge = 650 + 1000 - 750;
        assert_eq!(late.cycles_late_since_frame(us(edge)), 1);
        assert_eq!(late.cycles_late_since_frame(us(edge) - Picos(1)), 0);
    }

    #[test]
    fn a_frame_may_take_inputs_along_late_but_not_in_the_next_cycle() {
        let late = Opportunity::new(grid(1000, 650), grid(1000, 0)).unwrap();
        for (seen, cycles) in [(350, 0), (350 + 740, 0), (350 + 1000, 1), (350 + 2000, 2)] {
            assert_eq!(late.cycles_late_until_frame(us(seen)), cycles, "{seen}");
        }
        let edge = us(350 + 750);
        assert_eq!(late.cycles_late_until_frame(edge), 1);
        assert_eq!(late.cycles_late_until_frame(edge - Picos(1)), 0);
    }

    #[test]
    fn phases_that_fall_together_are_a_cycle_apart() {
        let late = Opportunity::new(grid(1000, 100), grid(1000, 100)).unwrap();
        assert_eq!(late.cycles_late_since_frame(us(1000)), 0);
        assert_eq!(late.cycles_late_since_frame(us(2000)), 1);
    }

    #[test]
    fn the_longer_cycle_counts() {
        // Frames every 250 us, pulses every 1 ms: data that waits for its pulse is not late.
        let slow = Opportunity::new(grid(250, 0), grid(1000, 650)).unwrap();
        for (seen, cycles) in [(150, 0), (400, 0), (900, 0), (1150, 1), (1900, 1), (2150, 2)] {
            assert_eq!(slow.cycles_late_since_frame(us(seen)), cycles, "{seen}");
        }
        // Pulses every 250 us: four of them make a cycle.
        let fast = Opportunity::new(grid(1000, 0), grid(250, 100)).unwrap();
        for (seen, cycles) in [(100, 0), (850, 0), (1100, 1), (1850, 1), (2100, 2)] {
            assert_eq!(fast.cycles_late_since_frame(us(seen)), cycles, "{seen}");
        }
        assert_eq!(Opportunity::new(grid(0, 0), grid(1000, 0)), None);
    }

    #[test]
    fn the_first_is_dated_and_the_worst_is_kept() {
        let mut late = Late::default();
        for (at, cycles) in [(5, 0), (6, 1), (7, 3), (8, 2), (9, -1)] {
            late.take(Time::new(at), cycles, us(cycles));
        }
        assert_eq!((late.count(), late.first(), late.cycles()), (3, Some(Time::new(6)), 3));
        assert_eq!(late.age(), us(3));
    }
}
