//! The DC registers as a side reads them.
//!
//! Times of 64 bits are consistent however many accesses read them: the upper bytes belong to the
//! moment at which the same side read the first byte. System time is different on the wire, where
//! all datagrams of a frame see the time of the frame's start.

use core::ops::Range;

use isocat_wire::time::Device;
use isocat_wire::{Register, Time, register};

use super::{DcUnit, latch};
use crate::memory::Registers;
use crate::sync_manager::Side;

/// The running times when each side last read their first bytes, in the order of [`Slot`].
pub(crate) type Held = [[u64; 8]; 2];

/// A running time. The latch times follow behind the last of these.
#[derive(Clone, Copy)]
enum Slot {
    System,
    ReceiveEpu,
    Start,
    Sync1Next,
    Latch,
}

impl DcUnit {
    /// Updates the registers in `range` before a side reads them. `now` is the instant of a PDI
    /// access, or the start of the frame.
    pub fn show(
        &mut self,
        side: Side,
        range: &Range<u16>,
        now: Time<Device>,
        registers: &mut Registers,
    ) {
        let overlaps = |first: u16, end: u16| range.start < end && range.end > first;
        if overlaps(0x0910, 0x0918) {
            let system = self.system(now);
            match side {
                Side::Ecat => {
                    let here = self.narrow(system.wrapping_sub(u64::from(self.delay)));
                    registers.store(register::SYSTEM_TIME, here);
                }
                Side::Pdi => {
                    let (time, slot) = (register::SYSTEM_TIME, Slot::System as usize);
                    self.show_time(side, slot, time, range, system, registers);
                }
            }
        }
        if overlaps(0x0918, 0x0920) {
            let (current, slot) = (self.receive_epu, Slot::ReceiveEpu as usize);
            self.show_time(side, slot, register::RECEIVE_TIME_EPU, range, current, registers);
        }
        if overlaps(0x0984, 0x09A0) {
            self.sync.show(now, registers);
            // While the unit is at rest the register keeps the start time that was written.
            let (sync0, sync1) = self.sync.next_pulses(registers);
            if let Some(next) = sync0 {
                let (time, slot) = (register::SYNC_START_TIME, Slot::Start as usize);
                self.show_time(side, slot, time, range, next, registers);
            }
            if let Some(next) = sync1 {
                let (time, slot) = (register::SYNC1_NEXT, Slot::Sync1Next as usize);
                self.show_time(side, slot, time, range, next, registers);
            }
        }
        if overlaps(0x09AE, 0x09D0) {
            self.latch.show(registers);
            let times = self.latch.times();
            for (number, (time, current)) in latch::TIMES.into_iter().zip(times).enumerate() {
                let slot = Slot::Latch as usize + number;
                self.show_time(side, slot, time, range, current, registers);
            }
        }
    }

    fn show_time(
        &mut self,
        side: Side,
        slot: usize,
        time: Register<u64>,
        range: &Range<u16>,
        current: u64,
        registers: &mut Registers,
    ) {
        if range.end <= time.address || range.start >= time.address + 8 {
            return;
        }
        let held = &mut self.held[side as usize][slot];
        if range.contains(&time.address) {
            *held = current;
        }
        let shown = *held;
        registers.store(time, self.narrow(shown));
    }
}
