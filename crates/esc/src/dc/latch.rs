//! The latch unit: system times of edges on the inputs LATCH0 and LATCH1.
//!
//! The pins are sampled once in each tick. An edge is seen at the first tick at or after it and is
//! stamped with the system time of that tick, so up to 11 ns late. A pulse between two ticks is not
//! seen.

use core::ops::Range;

use isocat_wire::register::{self, al_event};
use isocat_wire::time::Device;
use isocat_wire::{Register, Time};

use super::clock::ceil;
use crate::memory::Registers;
use crate::sync_manager::Side;

/// An input of the latch unit.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum LatchInput {
    /// LATCH0, registers 0x09A8, 0x09AE, 0x09B0-0x09BF.
    Latch0,
    /// LATCH1, registers 0x09A9, 0x09AF, 0x09C0-0x09CF.
    Latch1,
}

/// The state of the unit.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LatchUnit([Input; 2]);

#[derive(Clone, Copy, Debug)]
struct Input {
    /// The level of the pin at the last sample.
    level: bool,
    /// The tick at which the other level is sampled; never if the pin keeps its level.
    change: Time<Device>,
    /// System time of the last stored positive and negative edge.
    times: [u64; 2],
    /// Edges that were stored as a single event and not read yet: bit 0 positive, bit 1 negative.
    captured: u8,
}

impl LatchUnit {
    /// The state at power-on: no edge is stored, the pins are low.
    pub const fn new() -> Self {
        Self([Input { level: false, change: Time::NEVER, times: [0; 2], captured: 0 }; 2])
    }

    /// Clears the stored edges; the pins keep their level.
    pub fn reset(&mut self) {
        let Self(inputs) = *self;
        *self = Self::new();
        for (new, old) in self.0.iter_mut().zip(inputs) {
            (new.level, new.change) = (old.level, old.change);
        }
    }

    /// The pin has this level from `at` on.
    pub fn set(&mut self, input: LatchInput, level: bool, at: Time<Device>) {
        let input = &mut self.0[input as usize];
        input.change = if level == input.level { Time::NEVER } else { ceil(at) };
    }

    /// When [`Self::sample`] is due.
    pub fn due(&self) -> Time<Device> {
        let [latch0, latch1] = &self.0;
        latch0.change.min(latch1.change)
    }

    /// Samples the pins that changed, at the earliest due time, when the system time is `system`.
    /// Returns whether a time was stored.
    pub fn sample(&mut self, system: u64, registers: &Registers) -> bool {
        let now = self.due();
        let mut stored = false;
        for (number, input) in self.0.iter_mut().enumerate() {
            if input.change != now {
                continue;
            }
            (input.level, input.change) = (!input.level, Time::NEVER);
            let (edge, bit) = if input.level { (0, 1) } else { (1, 2) };
            let single = single_events(number, registers) & bit;
            if input.captured & single == 0 {
                input.times[edge] = system;
                input.captured |= single;
                stored = true;
            }
        }
        stored
    }

    /// Handles a write to the control registers: edges that are no longer single events lock
    /// nothing.
    pub fn configure(&mut self, registers: &Registers) {
        for (number, input) in self.0.iter_mut().enumerate() {
            input.captured &= single_events(number, registers);
        }
    }

    /// Handles a read of these [`times`]: a read by the owner frees them for the next single event.
    pub fn acknowledge(&mut self, side: Side, times: u8, registers: &Registers) {
        for (number, input) in self.0.iter_mut().enumerate() {
            if owner(number, registers) == side {
                input.captured &= !(times >> (2 * number));
            }
        }
    }

    /// Whether the side owns a unit with a stored single event: 0x0210 bit 0 or 0x0220 bit 1.
    fn event(&self, side: Side, registers: &Registers) -> bool {
        let mut inputs = self.0.iter().enumerate();
        inputs.any(|(number, input)| input.captured != 0 && owner(number, registers) == side)
    }

    /// The bit of the AL event request (0x0220) that comes from here.
    pub fn al_events(&self, registers: &Registers) -> u32 {
        if self.event(Side::Pdi, registers) { al_event::LATCH } else { 0 }
    }

    /// The bit of the ECAT event request (0x0210) that comes from here.
    pub fn ecat_events(&self, registers: &Registers) -> u16 {
        u16::from(self.event(Side::Ecat, registers))
    }

    /// Updates the status registers.
    pub fn show(&self, registers: &mut Registers) {
        let status = |input: &Input| input.captured | u8::from(input.level) << 2;
        registers.store(register::LATCH0_STATUS, status(&self.0[0]));
        registers.store(register::LATCH1_STATUS, status(&self.0[1]));
    }

    /// The stored times, in the order of [`TIMES`].
    pub fn times(&self) -> [u64; 4] {
        let [latch0, latch1] = &self.0;
        [latch0.times[0], latch0.times[1], latch1.times[0], latch1.times[1]]
    }
}

/// The edges of an input that are captured as single events, as bits like those of its status.
fn single_events(number: usize, registers: &Registers) -> u8 {
    let control = [register::LATCH0_CONTROL, register::LATCH1_CONTROL][number];
    registers.load(control) & 0x03
}

fn owner(number: usize, registers: &Registers) -> Side {
    let pdi = registers.load(register::CYCLIC_UNIT_CONTROL) & 0x10 << number != 0;
    if pdi { Side::Pdi } else { Side::Ecat }
}

/// The time registers whose first byte lies in a range that is read: bit 0 stands for 0x09B0, bit 3
/// for 0x09C8. Only the first byte counts, since the others belong to the same moment.
pub(crate) fn times(range: &Range<u16>) -> u8 {
    let bit =
        |(number, time): (usize, &Register<u64>)| u8::from(range.contains(&time.address)) << number;
    TIMES.iter().enumerate().map(bit).sum()
}

/// The time registers.
pub(crate) const TIMES: [Register<u64>; 4] = [
    register::LATCH0_POSITIVE,
    register::LATCH0_NEGATIVE,
    register::LATCH1_POSITIVE,
    register::LATCH1_NEGATIVE,
];
