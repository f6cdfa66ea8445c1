//! The DC unit: local and system time, receive times, the drift loop, the SYNC unit and the latch
//! unit.

pub(crate) mod clock;
pub(crate) mod drift_law;
pub(crate) mod drift_loop;
pub(crate) mod latch;
mod show;
pub(crate) mod sync;

use core::ops::Range;

use isocat_wire::dc::DifferencePolarity;
use isocat_wire::register::{self, features};
use isocat_wire::time::{Dc, Device, Local};
use isocat_wire::{PortNumber, Register, Time};

use crate::chip::Chip;
use crate::memory::{Registers, Shadow};
use clock::Clock;
use drift_law::DriftLaw;
use drift_loop::{DriftLoop, Settings};
use latch::{LatchInput, LatchUnit};
use sync::{StartWritten, SyncUnit};

/// The DC unit of one ESC.
pub(crate) struct DcUnit {
    clock: Clock,
    drift: DriftLoop,
    law: DriftLaw,
    polarity: DifferencePolarity,
    /// The SYNC unit.
    pub sync: SyncUnit,
    /// The latch unit.
    pub latch: LatchUnit,
    /// Register 0x0920 in force.
    offset: u64,
    /// Register 0x0928 in force.
    delay: u32,
    /// Register 0x0918.
    receive_epu: u64,
    ports: PortStamps,
    /// See [`Chip::stamps_next_frame`].
    stamps_next_frame: bool,
    held: show::Held,
    wide: bool,
    enhanced: bool,
}

/// The state between the arrivals at ports 1-3 and their registers.
#[derive(Clone, Copy)]
struct PortStamps {
    /// Time stamps that no register shows yet; reverse mode (0x0936) may need them.
    hidden: [Option<u32>; 3],
    /// The start of the last frame that latched receive times.
    latched: Time<Device>,
    /// Ports that stamp the next frame; bit 0 is port 1. See [`Chip::stamps_next_frame`].
    enabled: u8,
}

impl DcUnit {
    /// A unit at power-on, whose local time is `local` at `now`.
    pub fn new(chip: &Chip, local: u64, now: Time<Device>) -> Self {
        Self {
            clock: Clock::new(local, now),
            drift: DriftLoop::new(now),
            law: chip.drift_law,
            polarity: chip.difference_polarity,
            sync: SyncUnit::new(),
            latch: LatchUnit::new(),
            offset: 0,
            delay: 0,
            receive_epu: 0,
            ports: PortStamps { hidden: [None; 3], latched: Time::ZERO, enabled: 0 },
            stamps_next_frame: chip.stamps_next_frame,
            held: [[0; 8]; 2],
            wide: chip.counts_64_bit(),
            enhanced: chip.has(features::ENHANCED_SYNC_ACTIVATION),
        }
    }

    /// A reset at `now`. It keeps the levels of the pins, which are set from outside, and the law
    /// of the drift loop.
    pub fn restart(&mut self, chip: &Chip, local: u64, now: Time<Device>) {
        let (mut latch, law) = (self.latch, self.law);
        latch.reset();
        *self = Self { latch, law, ..Self::new(chip, local, now) };
    }

    /// Replaces the drift law of the chip.
    pub fn set_drift_law(&mut self, law: DriftLaw) {
        self.law = law;
    }

    /// Writes the reset values of its registers.
    pub fn reset_registers(&self, registers: &mut Registers) {
        registers.store(register::SPEED_COUNTER_START, drift_loop::START);
        registers.store(register::TIME_FILTER_DEPTH, drift_loop::TIME_FILTER_DEPTH);
        registers.store(register::SPEED_FILTER_DEPTH, drift_loop::SPEED_FILTER_DEPTH);
    }

    /// The local time as 0x0900 shows it, in the width of the counter.
    pub fn local_time(&self, at: Time<Device>) -> Time<Local> {
        Time::new(self.narrow(self.clock.local(at)))
    }

    /// Local time plus offset, in the width of the counter.
    pub fn system_time(&self, at: Time<Device>) -> Time<Dc> {
        Time::new(self.narrow(self.system(at)))
    }

    /// The first instant at or after `from` at which the system time has reached `system`.
    pub fn first_reaching(&self, system: Time<Dc>, from: Time<Device>) -> Time<Device> {
        let ahead = system.count().wrapping_sub(self.system(from));
        let ahead = if self.wide { ahead as i64 } else { i64::from(ahead as u32 as i32) };
        self.clock.after(from, ahead)
    }

    /// A frame arrived at a port that records receive times.
    pub fn receive_at_port(
        &mut self,
        port: PortNumber,
        at: Time<Device>,
        registers: &mut Registers,
    ) {
        let stamp = self.clock.local(at) as u32;
        let reverse = registers.load(register::RECEIVE_TIME_LATCH_MODE) & 1 != 0;
        if port != PortNumber::P0 {
            self.ports.hidden[port.index() - 1] = Some(stamp);
            if reverse && at > self.ports.latched {
                return;
            }
            if self.stamps_next_frame && !reverse {
                let bit = 1 << (port.index() - 1);
                if self.ports.enabled & bit == 0 || at < self.ports.latched {
                    return;
                }
                self.ports.enabled &= !bit;
            }
        }
        registers.store(RECEIVE_TIMES[port.index()], stamp);
    }

    /// Whether this port stamps the next frame that arrives there, whatever the frame contains.
    pub fn awaits_frame(&self, port: PortNumber) -> bool {
        port != PortNumber::P0 && self.ports.enabled & 1 << (port.index() - 1) != 0
    }

    /// A good frame that began at `start` wrote 0x0900, so that receive times are latched.
    pub fn latch_ports(&mut self, start: Time<Device>, registers: &mut Registers) {
        self.ports.latched = start;
        let reverse = registers.load(register::RECEIVE_TIME_LATCH_MODE) & 1 != 0;
        self.ports.enabled = if self.stamps_next_frame && !reverse { 0b111 } else { 0 };
        if reverse {
            for (receive, hidden) in RECEIVE_TIMES[1..].iter().zip(self.ports.hidden) {
                if let Some(stamp) = hidden {
                    registers.store(*receive, stamp);
                }
            }
        }
    }

    /// Applies what a good frame wrote; the frame arrived at `start` and ended at `end`.
    pub fn end_frame(
        &mut self,
        (start, end): (Time<Device>, Time<Device>),
        shadow: &Shadow,
        registers: &mut Registers,
    ) {
        if shadow.byte(0x0900).or(shadow.byte(0x0901)).is_some() || shadow.touches(0x0902..0x0904) {
            self.receive_epu = self.clock.local(start);
            registers.store(register::RECEIVE_TIME_EPU, self.narrow(self.receive_epu));
        }
        if shadow.byte(0x0910).is_some() {
            self.follow(start, end, shadow, registers);
        }
        self.set_time_unit(end, |range| shadow.touches(range), registers);
        if shadow.touches(0x09A8..0x09AA) {
            self.latch.configure(registers);
        }
        if shadow.touches(0x0981..0x0982) || shadow.touches(0x0990..0x0998) {
            let written = StartWritten {
                lower: shadow.byte(0x0993).is_some(),
                upper: shadow.byte(0x0997).is_some(),
            };
            self.activate(end, written, registers);
        }
    }

    /// Applies settings of the system time (0x0920-0x0935) that were written and are in force in
    /// `registers`; `touched` tells which.
    pub fn set_time_unit(
        &mut self,
        now: Time<Device>,
        touched: impl Fn(Range<u16>) -> bool,
        registers: &mut Registers,
    ) {
        if touched(0x0930..0x0932) {
            let bandwidth = registers.load(register::SPEED_COUNTER_START) & 0x7FFF;
            registers.store(register::SPEED_COUNTER_START, bandwidth);
            self.drift.reset(now);
            self.adjust(now, 0, registers);
        } else if self.enhanced && touched(0x0934..0x0936) {
            // Newer cores do this. No register identifies them; they appeared with the enhanced
            // SYNC activation.
            if touched(0x0934..0x0935) {
                self.drift.reset_time_filter(now);
            }
            if touched(0x0935..0x0936) {
                self.drift.reset_speed_filter();
            }
            self.adjust(now, 0, registers);
        }
        if touched(0x0928..0x092C) {
            self.delay = registers.load(register::SYSTEM_TIME_DELAY);
        }
        if touched(0x0920..0x0928) {
            let offset = registers.load(register::SYSTEM_TIME_OFFSET);
            let step = offset.wrapping_sub(self.offset);
            let step = if self.wide { step as i64 } else { i64::from(step as u32 as i32) };
            self.offset = self.offset.wrapping_add_signed(step);
            let cycle = sync::sync0_cycle(registers);
            self.sync.jump(now, cycle, self.system(now), self.wide);
            self.reschedule(now);
        }
    }

    /// Handles a write to the activation register or the start time.
    pub fn activate(
        &mut self,
        now: Time<Device>,
        written: StartWritten,
        registers: &mut Registers,
    ) {
        let system = self.system(now);
        let unit = sync::Start { now, system, wide: self.wide, enhanced: self.enhanced };
        self.sync.activate(unit, written, registers);
        self.reschedule(now);
    }

    /// Handles the SYNC unit's earliest due time; see [`SyncUnit::fire`].
    #[inline(never)]
    pub fn fire(&mut self, registers: &Registers) -> Option<sync::Output> {
        if self.sync.fire_sync0(registers) {
            return Some(sync::Output::Sync0);
        }
        self.fire_any(registers)
    }

    /// The same whatever is due.
    #[inline(never)]
    fn fire_any(&mut self, registers: &Registers) -> Option<sync::Output> {
        let now = self.sync.due();
        if self.sync.is_rough() {
            // The pulse is not due yet, but near: its due time can be placed exactly now.
            self.reschedule(now);
            return None;
        }
        let system = self.sync.reached().unwrap_or_else(|| self.system(now));
        debug_assert_eq!(system, self.system(now));
        let output = self.sync.fire(system, registers);
        if output != Some(sync::Output::Sync0) || !self.sync.schedule_roughly(now, system) {
            self.reschedule(now);
        }
        output
    }

    /// Sets the pin of a latch input to this level from `at` on.
    pub fn set_latch_input(
        &mut self,
        input: LatchInput,
        level: bool,
        at: Time<Device>,
        registers: &Registers,
    ) {
        if self.latch.due() < at {
            self.sample_latches(registers);
        }
        self.latch.set(input, level, at);
    }

    /// Handles the latch unit's earliest due time; see [`LatchUnit::sample`].
    pub fn sample_latches(&mut self, registers: &Registers) -> bool {
        self.latch.sample(self.system(self.latch.due()), registers)
    }

    /// Steers the drift loop by a received system time.
    fn follow(
        &mut self,
        start: Time<Device>,
        end: Time<Device>,
        shadow: &Shadow,
        registers: &mut Registers,
    ) {
        let copy = (self.system(start) as u32).wrapping_sub(self.delay);
        self.compare((start, end), copy, |address| shadow.byte(address), registers);
    }

    /// Handles a frame that brought these lower four bytes of the system time and wrote nothing
    /// else. It arrived at `start` and ended at `end`. The result is that of [`Self::end_frame`].
    #[inline]
    pub fn follow_whole(
        &mut self,
        times: (Time<Device>, Time<Device>),
        received: [u8; 4],
        registers: &mut Registers,
    ) {
        self.steer(times, None, u32::from_le_bytes(received), registers);
    }

    /// Handles a system time of another segment that the PDI has written. It belongs to the last
    /// positive edge of LATCH0, which both segments have seen. See [`Chip::system_time_by_pdi`].
    pub fn follow_latch(
        &mut self,
        now: Time<Device>,
        written: [Option<u8>; 4],
        registers: &mut Registers,
    ) {
        let [edge, ..] = self.latch.times();
        let byte = |address: u16| written[usize::from(address - 0x0910)];
        self.compare((now, now), edge as u32, byte, registers);
    }

    /// Compares the own time `copy` with the time that was written at `at`, and steers from `from`
    /// on.
    fn compare(
        &mut self,
        (at, from): (Time<Device>, Time<Device>),
        copy: u32,
        written: impl Fn(u16) -> Option<u8>,
        registers: &mut Registers,
    ) {
        // Bytes that were not written are taken from the own time.
        let mut received = copy.to_le_bytes();
        for (address, byte) in (0x0910..).zip(&mut received) {
            *byte = written(address).unwrap_or(*byte);
        }
        self.steer((at, from), Some(copy), u32::from_le_bytes(received), registers);
    }

    /// Compares the own time, if it is not this `copy`, with the time received at `at`, and steers
    /// from `from` on.
    #[inline(never)]
    fn steer(
        &mut self,
        (at, from): (Time<Device>, Time<Device>),
        copy: Option<u32>,
        received: u32,
        registers: &mut Registers,
    ) {
        let copy = copy.unwrap_or_else(|| {
            let system = self.clock.local_now(at).wrapping_add(self.offset);
            (system as u32).wrapping_sub(self.delay)
        });
        let settings = Settings {
            start: registers.load(register::SPEED_COUNTER_START),
            time_depth: registers.load(register::TIME_FILTER_DEPTH),
            speed_depth: registers.load(register::SPEED_FILTER_DEPTH),
        };
        let difference = copy.wrapping_sub(received) as i32;
        let step = self.drift.follow(at, difference, received == 0, settings, &self.law);
        self.run_on(from, step, registers);
        if !self.place_sync0(from) {
            self.reschedule(from);
        }
    }

    /// Places the next SYNC0 pulse, if nothing else is planned and it comes soon after `now`, from
    /// where the clock counts. Otherwise nothing is done, and [`Self::reschedule`] must place it.
    #[inline(always)]
    fn place_sync0(&mut self, now: Time<Device>) -> bool {
        let (Some(next), Some(local)) = (self.sync.only_sync0(), self.clock.counted(now)) else {
            return false;
        };
        let system = local.wrapping_add(self.offset);
        let Some((due, passed)) = self.clock.soon(next.wrapping_sub(system) as i64) else {
            return false;
        };
        self.sync.place_sync0(due, system.wrapping_add(passed));
        true
    }

    /// Moves the local time by `step` ns. From `now` on the clock runs at the speed that the drift
    /// loop asks for.
    #[inline(never)]
    fn adjust(&mut self, now: Time<Device>, step: i64, registers: &mut Registers) {
        self.run_on(now, step, registers);
        self.reschedule(now);
    }

    /// The same without the SYNC unit.
    #[inline(always)]
    fn run_on(&mut self, now: Time<Device>, step: i64, registers: &mut Registers) {
        let start = registers.load(register::SPEED_COUNTER_START);
        registers.store(register::SYSTEM_TIME_DIFFERENCE, self.drift.difference(self.polarity));
        registers.store(register::SPEED_COUNTER_DIFFERENCE, self.drift.mean());
        self.clock.adjust(now, start, self.drift.applied(), step);
    }

    /// Places the due times of the SYNC unit again after the clock changed or a pulse was given.
    #[inline(never)]
    fn reschedule(&mut self, now: Time<Device>) {
        let system = self.system(now);
        let clock = &self.clock;
        self.sync.schedule(|target| {
            let (at, passed) = clock.passed(now, target.wrapping_sub(system) as i64);
            (at, passed.map(|passed| system.wrapping_add(passed)))
        });
    }

    /// Local time plus offset in 64 bits, whatever the width of the counter.
    #[inline]
    pub fn system(&self, at: Time<Device>) -> u64 {
        self.clock.local(at).wrapping_add(self.offset)
    }

    /// Cuts a time to the width of the counter.
    pub fn narrow(&self, time: u64) -> u64 {
        if self.wide { time } else { time & 0xFFFF_FFFF }
    }
}

const RECEIVE_TIMES: [Register<u32>; 4] = [
    register::RECEIVE_TIME_0,
    register::RECEIVE_TIME_1,
    register::RECEIVE_TIME_2,
    register::RECEIVE_TIME_3,
];
