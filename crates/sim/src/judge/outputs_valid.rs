//! Checks that outputs of one cycle become valid at the same time.

use isocat_wire::time::{Picos, Time, True};

use crate::statistics::Statistics;

/// Most open cycles at a time: outputs become valid within a cycle of their SYNC0.
const OPEN: usize = 4;

/// Watches when the outputs of each cycle become valid at the synchronized SubDevices.
#[derive(Clone, Debug)]
pub struct OutputsValid {
    devices: usize,
    open: [Slot; OPEN],
    spread: Statistics,
}

#[derive(Clone, Copy, Debug)]
struct Slot {
    cycle: i64,
    count: usize,
    first: Time<True>,
    last: Time<True>,
}

impl Slot {
    /// Of no cycle.
    const FREE: Self = Self { cycle: i64::MIN, count: 0, first: Time::ZERO, last: Time::ZERO };
}

impl OutputsValid {
    /// Expects `devices` SubDevices in each cycle.
    pub fn new(devices: usize) -> Self {
        Self { devices, open: [Slot::FREE; OPEN], spread: Statistics::default() }
    }

    /// Takes outputs of cycle number `cycle` that became valid at one of the SubDevices.
    #[inline(always)]
    pub fn valid(&mut self, cycle: i64, at: Time<True>) {
        let slot = &mut self.open[cycle.rem_euclid(OPEN as i64) as usize];
        if slot.cycle != cycle {
            *slot = Slot { cycle, count: 0, first: at, last: at };
        }
        slot.count += 1;
        slot.first = slot.first.min(at);
        slot.last = slot.last.max(at);
        if slot.count == self.devices {
            let Picos(spread) = slot.last - slot.first;
            self.spread.push(spread);
            // This cycle is complete: a further report of it would open a slot that never fills.
            *slot = Slot::FREE;
        }
    }

    /// Time from the first to the last SubDevice, over all cycles in which all of them took part.
    pub fn spread(&self) -> &Statistics {
        &self.spread
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_complete_cycles_count() {
        let mut judge = OutputsValid::new(2);
        judge.valid(1, Time::new(1_000));
        judge.valid(2, Time::new(2_000));
        judge.valid(2, Time::new(2_030));
        judge.valid(5, Time::new(5_000));
        assert_eq!((judge.spread().count(), judge.spread().largest()), (1, 30));
    }
}
