//! The DC unit: local and system time, receive times, the drift loop, the SYNC and the latch unit.

pub(crate) mod clock;
pub(crate) mod drift_loop;
pub(crate) mod latch;
mod show;
pub(crate) mod sync;

use isocat_wire::register::{self, features};
use isocat_wire::time::{Dc, Device, Local};
use isocat_wire::{PortNumber, Register, Time};

use crate::chip::Chip;
use crate::memory::{Registers, Shadow};
use clock::Clock;
use drift_loop::{DriftLoop, DriftModel, ProportionalIntegral};
use latch::{LatchInput, LatchUnit};
use sync::SyncUnit;

/// The DC unit of one ESC.
pub(crate) struct DcUnit {
    clock: Clock,
    drift: DriftLoop,
    model: &'static dyn DriftModel,
    /// The SYNC unit.
    pub sync: SyncUnit,
    /// The latch unit.
    pub latch: LatchUnit,
    /// Register 0x0920 as it is in force.
    offset: u64,
    /// Register 0x0928 as it is in force.
    delay: u32,
    /// Register 0x0918.
    receive_epu: u64,
    ports: PortStamps,
    held: show::Held,
    wide: bool,
    enhanced: bool,
}

/// What reverse mode (0x0936) needs: the time stamps of ports 1-3 that no register shows yet.
#[derive(Clone, Copy)]
struct PortStamps {
    hidden: [Option<u32>; 3],
    /// The start of the last frame that latched.
    latched: Time<Device>,
}

impl DcUnit {
    /// At power-on: the local time is `local` at `now`.
    pub fn new(chip: &Chip, local: u64, now: Time<Device>) -> Self {
        Self {
            clock: Clock::new(local, now),
            drift: DriftLoop::new(),
            model: &ProportionalIntegral::DEFAULT,
            sync: SyncUnit::new(),
            latch: LatchUnit::new(),
            offset: 0,
            delay: 0,
            receive_epu: 0,
            ports: PortStamps { hidden: [None; 3], latched: Time::ZERO },
            held: [[0; 8]; 2],
            wide: chip.counts_64_bit(),
            enhanced: chip.has(features::ENHANCED_SYNC_ACTIVATION),
        }
    }

    /// A reset at `now`: all but what the world outside determines, which are the pins, and the model.
    pub fn restart(&mut self, chip: &Chip, local: u64, now: Time<Device>) {
        let (mut latch, model) = (self.latch, self.model);
        latch.reset();
        *self = Self { latch, model, ..Self::new(chip, local, now) };
    }

    /// Another model of the drift loop.
    pub fn set_model(&mut self, model: &'static dyn DriftModel) {
        self.model = model;
    }

    /// Reset values of its registers.
    pub fn reset_registers(&self, registers: &mut Registers) {
        registers.store(register::SPEED_COUNTER_START, drift_loop::START);
        registers.store(register::TIME_FILTER_DEPTH, drift_loop::TIME_FILTER_DEPTH);
        registers.store(register::SPEED_FILTER_DEPTH, drift_loop::SPEED_FILTER_DEPTH);
    }

    /// What 0x0900 shows, in the width of the counter.
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

    /// A frame arrived at a port whose receive times are wanted.
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
        }
        registers.store(RECEIVE_TIMES[port.index()], stamp);
    }

    /// A good frame that began at `start` wrote 0x0900, so that receive times are latched.
    pub fn latch_ports(&mut self, start: Time<Device>, registers: &mut Registers) {
        self.ports.latched = start;
        if registers.load(register::RECEIVE_TIME_LATCH_MODE) & 1 != 0 {
            for (receive, hidden) in RECEIVE_TIMES[1..].iter().zip(self.ports.hidden) {
                if let Some(stamp) = hidden {
                    registers.store(*receive, stamp);
                }
            }
        }
    }

    /// Takes over what a good frame wrote; it arrived at `start` and ended at `end`.
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
        if shadow.touches(0x0930..0x0932) {
            let bandwidth = registers.load(register::SPEED_COUNTER_START) & 0x7FFF;
            registers.store(register::SPEED_COUNTER_START, bandwidth);
            self.drift.reset();
            self.adjust(end, registers);
        } else if self.enhanced && shadow.touches(0x0934..0x0936) {
            // Newer cores do this. No register names them; the enhanced SYNC activation came with them.
            if shadow.byte(0x0934).is_some() {
                self.drift.reset_time_filter();
            }
            if shadow.byte(0x0935).is_some() {
                self.drift.reset_speed_filter();
            }
            self.adjust(end, registers);
        }
        if shadow.touches(0x0928..0x092C) {
            self.delay = registers.load(register::SYSTEM_TIME_DELAY);
        }
        if shadow.touches(0x0920..0x0928) {
            let offset = registers.load(register::SYSTEM_TIME_OFFSET);
            let step = offset.wrapping_sub(self.offset);
            let step = if self.wide { step as i64 } else { i64::from(step as u32 as i32) };
            let cycle = registers.load(register::SYNC0_CYCLE);
            self.offset = self.offset.wrapping_add_signed(step);
            self.sync.jump(end, u64::from(cycle), self.system(end), self.wide);
            self.reschedule(end);
        }
        if shadow.touches(0x09A8..0x09AA) {
            self.latch.configure(registers);
        }
        if shadow.touches(0x0981..0x0982) || shadow.touches(0x0990..0x0998) {
            self.activate(end, shadow.touches(0x0990..0x0998), registers);
        }
    }

    /// The activation register or the start time was written.
    pub fn activate(&mut self, now: Time<Device>, start_written: bool, registers: &mut Registers) {
        let system = self.system(now);
        let unit = sync::Start { now, system, wide: self.wide, enhanced: self.enhanced };
        self.sync.activate(unit, start_written, registers);
        self.reschedule(now);
    }

    /// Handles the SYNC unit's earliest due time; see [`SyncUnit::fire`].
    pub fn fire(&mut self, registers: &Registers) -> Option<sync::Output> {
        let now = self.sync.due();
        let output = self.sync.fire(self.system(now), registers);
        self.reschedule(now);
        output
    }

    /// The pin of a latch input has this level from `at` on.
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

    /// A received system time steers the drift loop.
    fn follow(
        &mut self,
        start: Time<Device>,
        end: Time<Device>,
        shadow: &Shadow,
        registers: &mut Registers,
    ) {
        let copy = (self.system(start) as u32).wrapping_sub(self.delay);
        // Bytes that were not written agree with the local copy.
        let mut received = copy.to_le_bytes();
        for (address, byte) in (0x0910..).zip(&mut received) {
            *byte = shadow.byte(address).unwrap_or(*byte);
        }
        let received = u32::from_le_bytes(received);
        self.drift.follow(
            start,
            copy.wrapping_sub(received) as i32,
            received,
            registers.load(register::SPEED_COUNTER_START),
            (
                registers.load(register::TIME_FILTER_DEPTH),
                registers.load(register::SPEED_FILTER_DEPTH),
            ),
            self.model,
        );
        self.adjust(end, registers);
    }

    /// Gives the clock the speed that the drift loop wants from `now` on.
    fn adjust(&mut self, now: Time<Device>, registers: &mut Registers) {
        let start = registers.load(register::SPEED_COUNTER_START);
        registers.store(register::SYSTEM_TIME_DIFFERENCE, self.drift.difference());
        registers.store(register::SPEED_COUNTER_DIFFERENCE, self.drift.mean());
        self.clock.adjust(now, start, self.drift.applied());
        self.reschedule(now);
    }

    /// Places the SYNC unit's due times anew after the clock changed or a pulse was given.
    fn reschedule(&mut self, now: Time<Device>) {
        let system = self.system(now);
        let clock = &self.clock;
        self.sync.schedule(|target| clock.after(now, target.wrapping_sub(system) as i64));
    }

    /// Local time plus offset in 64 bits, whatever the width of the counter.
    pub fn system(&self, at: Time<Device>) -> u64 {
        self.clock.local(at).wrapping_add(self.offset)
    }

    /// Cuts to the width of the counter.
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
