//! From an OpMode of a device description (ESI, `Dc/OpMode`) to the registers of the SYNC unit.
//!
//! An [`OpMode`] has the terms of the file: fixed times, or factors of a bus cycle that the maker
//! does not know. [`OpMode::registers`] resolves it for one bus cycle and names every [`Warning`]:
//! many published files contain values that contradict each other, and each such case has one
//! defined answer here. A value that cannot be written to a register is a [`Problem`].
//! [`OpMode::bus_cycles`] are the bus cycles at which the pulses repeat with the bus.
//!
//! The ESC defines the relation between 0x09A0 (R0) and 0x09A4 (R1): SYNC1 comes R1 after a SYNC0,
//! and the next SYNC1 comes R1 after the first SYNC0 that follows. So SYNC1 repeats after N =
//! floor(R1 / R0) + 1 cycles of SYNC0.

mod bus_cycles;
mod warning;

use core::fmt;

use isocat_wire::dc::AssignActivate;
use isocat_wire::time::Nanos;

pub use bus_cycles::BusCycles;
pub use warning::{Warning, WarningKind, Warnings};

use crate::mode::SyncMode;
use crate::pulses::Pulses;

/// One OpMode of a device description.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default)]
pub struct OpMode {
    /// AssignActivate: the value for 0x0980 and 0x0981.
    pub assign_activate: AssignActivate,
    /// CycleTimeSync0.
    pub sync0: CycleTime,
    /// ShiftTimeSync0.
    pub shift0: ShiftTime,
    /// CycleTimeSync1.
    pub sync1: CycleTime,
    /// ShiftTimeSync1, ns; 0 if it is missing.
    pub shift1: i64,
}

/// A cycle time of an OpMode: fixed, or a factor. A missing element is the default.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default)]
pub struct CycleTime {
    /// The element's text, ns; 0 if the factor is used.
    pub value: i64,
    /// The attribute Factor; `None` if it is missing.
    pub factor: Option<i32>,
}

/// The shift of SYNC0 in an OpMode. A missing element is the default.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default)]
pub struct ShiftTime {
    /// The element's text, ns; may be negative.
    pub value: i64,
    /// The attribute Factor: this many SYNC0 cycles, or a part of one, are added.
    pub factor: Option<i32>,
    /// The attribute Input: the shift counts from the point at which inputs must be latched, and
    /// not from the point at which outputs have arrived.
    pub input: bool,
}

/// What is known of the device's SYNC unit in addition to the OpMode.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Unit {
    /// The shortest SYNC0 cycle that it supports.
    pub least_sync0: Nanos,
    /// Dc@TimeLoopControlOnly: it has a system time and no SYNC unit.
    pub clock_only: bool,
}

impl Default for Unit {
    fn default() -> Self {
        Self { least_sync0: LEAST_SYNC0, clock_only: false }
    }
}

/// The register values of an OpMode for one bus cycle.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Registers {
    /// 0x0980 and 0x0981; zero if nothing is to be activated.
    pub assign_activate: AssignActivate,
    /// R0, register 0x09A0, ns; 0 without pulses.
    pub sync0_cycle: u32,
    /// R1, register 0x09A4, ns; 0 without SYNC1.
    pub sync1: u32,
    /// N: cycles of SYNC0 from one SYNC1 to the next; 1 without SYNC1, 0 without pulses.
    pub count: u32,
    /// s0: the distance of SYNC0 behind the reference point, as the file states it. It may be
    /// negative or longer than the period.
    pub shift: Nanos,
    /// The reference point is that of the inputs.
    pub input_based: bool,
    /// The bus cycle of these values.
    pub bus: Nanos,
    /// Every doubt, in the order in which it was found.
    pub warnings: Warnings,
}

/// Why an OpMode cannot be put into registers.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Problem {
    /// The bus cycle is 0 or negative, or does not fit into a register of 32 bits.
    BusCycle(Nanos),
    /// A value does not fit into its register of 32 bits.
    Register {
        /// The register's address.
        register: u16,
        /// The value, limited to the range of an i64.
        value: i64,
    },
    /// The shift does not fit into an i64.
    Shift,
}

impl OpMode {
    /// The registers for a bus cycle.
    pub fn registers(&self, bus: Nanos, unit: &Unit) -> Result<Registers, Problem> {
        if bus.0 <= 0 || bus.0 > u32::MAX.into() {
            return Err(Problem::BusCycle(bus));
        }
        let mut warnings = Warnings::default();
        let word = self.assign_activate;
        if word.0 & AssignActivate::RESERVED != 0 {
            warnings.push(Warning::ReservedBits { word });
        }
        if let Some(warning) = self.why_no_pulses(unit) {
            warnings.push(warning);
            let assign_activate = match warning {
                Warning::ClockOnly | Warning::NotActivated { .. } => AssignActivate::OFF,
                _ => word,
            };
            return Ok(Registers {
                assign_activate,
                sync0_cycle: 0,
                sync1: 0,
                count: 0,
                shift: Nanos::ZERO,
                input_based: false,
                bus,
                warnings,
            });
        }
        if word.unit_at_pdi() {
            warnings.push(Warning::UnitAtPdi);
        }
        let sync0_cycle = self.sync0_cycle(bus, unit, &mut warnings)?;
        let sync1 = self.sync1(bus, sync0_cycle, &mut warnings)?;
        let count = self.count(sync0_cycle, sync1);
        let shift = self.shift(sync0_cycle)?;
        let registers = Registers {
            assign_activate: word,
            sync0_cycle,
            sync1,
            count,
            shift,
            input_based: self.shift0.input,
            bus,
            warnings,
        };
        Ok(registers.with_doubts(self))
    }

    /// The reason why there are no pulses, if there are none.
    fn why_no_pulses(&self, unit: &Unit) -> Option<Warning> {
        let word = self.assign_activate;
        let asked = word.activation().sync0() || word.activation().sync1();
        if !word.activates() && asked {
            Some(Warning::NotActivated { word })
        } else if !word.activates() {
            Some(Warning::SyncOff)
        } else if unit.clock_only {
            Some(Warning::ClockOnly)
        } else if !asked {
            Some(Warning::NoPulses { word })
        } else {
            None
        }
    }

    /// Computes R0.
    fn sync0_cycle(
        &self,
        bus: Nanos,
        unit: &Unit,
        warnings: &mut Warnings,
    ) -> Result<u32, Problem> {
        let CycleTime { value, factor } = self.sync0;
        let fixed = value > 0;
        let cycle = if fixed {
            if let Some(factor) = factor.filter(|factor| *factor != 0) {
                warnings.push(Warning::Sync0ValueAndFactor { value, factor });
            }
            i128::from(value)
        } else if value < 0 {
            warnings.push(Warning::NegativeSync0 { value });
            bus.0.into()
        } else {
            match factor.unwrap_or(0) {
                0 => {
                    warnings.push(Warning::Sync0Undefined);
                    bus.0.into()
                }
                factor => scaled(bus.0.into(), factor, warnings),
            }
        };
        let value = cycle.min(i64::MAX.into()) as i64;
        let register = u32::try_from(value).ok().filter(|register| *register > 0);
        let cycle = register.ok_or(Problem::Register { register: SYNC0_CYCLE, value })?;
        if i64::from(cycle) < unit.least_sync0.0 {
            let least = unit.least_sync0;
            warnings.push(Warning::BelowLeast { cycle: Nanos(cycle.into()), least });
        }
        Ok(cycle)
    }

    /// Computes R1.
    fn sync1(&self, bus: Nanos, sync0: u32, warnings: &mut Warnings) -> Result<u32, Problem> {
        let CycleTime { value, factor } = self.sync1;
        if !self.assign_activate.makes_sync1() {
            if value != 0 || factor.is_some_and(|factor| factor != 0) || self.shift1 != 0 {
                warnings.push(Warning::Sync1Unused);
            }
            return Ok(0);
        }
        if !self.assign_activate.makes_sync0() {
            warnings.push(Warning::Sync1Alone);
        }
        let (sync0, shift) = (i128::from(sync0), i128::from(self.shift1));
        let too_long = |value: i128| {
            let value = value.clamp(i64::MIN.into(), i64::MAX.into()) as i64;
            Problem::Register { register: SYNC1_CYCLE, value }
        };
        if value > 0 {
            if let Some(factor) = factor.filter(|factor| *factor != 0) {
                warnings.push(Warning::Sync1ValueAndFactor { value, factor });
            }
            if shift != 0 {
                warnings.push(Warning::Sync1FixedAndShift { value, shift: self.shift1 });
            }
            return u32::try_from(value).map_err(|_| too_long(value.into()));
        }
        let period = if value < 0 {
            warnings.push(Warning::NegativeSync1 { value });
            sync0
        } else {
            match factor.unwrap_or(0) {
                0 => {
                    warnings.push(Warning::Sync1Undefined);
                    sync0
                }
                factor if factor > 0 => sync0 * i128::from(factor),
                factor => scaled(bus.0.into(), factor, warnings),
            }
        };
        let distance = period - sync0 + shift;
        let register = if distance < 0 {
            // SYNC1 then comes later in a SYNC0 cycle by as much as it would have been too early.
            warnings.push(Warning::Sync1BeforeSync0 { by: nanos(-distance) });
            distance.rem_euclid(sync0)
        } else {
            distance
        };
        let found = sync0 * (register / sync0 + 1);
        if found != period {
            warnings.push(Warning::Sync1Period { wanted: nanos(period), found: nanos(found) });
        }
        u32::try_from(register).map_err(|_| too_long(register))
    }

    /// Computes N of R0 and R1.
    fn count(&self, sync0_cycle: u32, sync1: u32) -> u32 {
        match self.assign_activate.makes_sync1() {
            // 1 ns and 2^32 - 1 ns would be 2^32 cycles; one less makes no difference.
            true => (sync1 / sync0_cycle).saturating_add(1),
            false => 1,
        }
    }

    /// Computes s0.
    fn shift(&self, sync0: u32) -> Result<Nanos, Problem> {
        let ShiftTime { value, factor, .. } = self.shift0;
        let sync0 = i64::from(sync0);
        let part = match factor.unwrap_or(0) {
            0 => Some(0),
            factor if factor > 0 => sync0.checked_mul(factor.into()),
            factor => Some(sync0 / i64::from(factor.unsigned_abs())),
        };
        let shift = part.and_then(|part| part.checked_add(value));
        shift.map(Nanos).ok_or(Problem::Shift)
    }
}

impl Registers {
    /// P1: the time after which the pulses repeat; 0 without pulses. A grid for start times must
    /// contain it.
    pub const fn period(&self) -> Nanos {
        Nanos(self.sync0_cycle as i64 * self.count as i64)
    }

    /// Whether SYNC1 is generated.
    pub(crate) const fn has_sync1(&self) -> bool {
        self.count > 0 && self.assign_activate.makes_sync1()
    }

    /// Time from the last SYNC0 at or before SYNC1 to SYNC1.
    pub fn behind_sync0(&self) -> Nanos {
        Nanos(self.sync1.checked_rem(self.sync0_cycle).unwrap_or(0).into())
    }

    /// The shift within one period of the pulses.
    pub fn phase(&self) -> Nanos {
        Nanos(self.shift.0.checked_rem_euclid(self.period().0).unwrap_or(0))
    }

    /// The synchronization modes in which a device with these registers may run, the likeliest
    /// first. The OpMode itself does not tell: 0x1C32:01 and 0x1C33:01 decide. A stack that derives
    /// them from the registers uses the first.
    pub const fn modes(&self) -> &'static [SyncMode] {
        if self.count == 0 {
            return &[SyncMode::SmSynchronous, SyncMode::FreeRun];
        }
        match (self.assign_activate.makes_sync0(), self.assign_activate.makes_sync1()) {
            (true, false) => &[SyncMode::DcSync0],
            (true, true) if self.sync1 >= self.sync0_cycle => &[SyncMode::DcSubordinated],
            // Both pulses come at once, so SYNC1 adds nothing.
            (true, true) if self.sync1 == 0 => &[SyncMode::DcSync0, SyncMode::DcSync1],
            (true, true) => &[SyncMode::DcShiftSync1, SyncMode::DcSync1],
            (false, _) => &[SyncMode::DcSync1],
        }
    }

    /// The pulses, for a mode of [`modes`](Self::modes).
    pub fn pulses(&self, mode: SyncMode) -> Pulses {
        let lead = match mode {
            SyncMode::DcSync1 | SyncMode::DcSubordinated => Nanos(self.sync1.into()),
            _ => Nanos::ZERO,
        };
        let (sync0_cycle, sync1) = (Nanos(self.sync0_cycle.into()), Nanos(self.sync1.into()));
        Pulses { sync0_cycle, sync1, lead }
    }

    /// Adds the doubts about the positions of the pulses to each other and to the bus cycle.
    fn with_doubts(mut self, of: &OpMode) -> Self {
        let (sync0, bus, period) = (i64::from(self.sync0_cycle), self.bus.0, self.period().0);
        let (cycle, bus_cycle) = (Nanos(sync0), self.bus);
        if bus % sync0 != 0 && sync0 % bus != 0 {
            self.warnings.push(match of.sync0.value > 0 {
                true => Warning::FixedSync0 { cycle, bus: bus_cycle },
                false => Warning::Sync0OffBus { cycle, bus: bus_cycle },
            });
        } else if period > bus && period % bus == 0 {
            let times = (period / bus).min(u32::MAX.into()) as u32;
            self.warnings.push(Warning::SlowerThanBus { times });
        } else if period < bus && bus % period == 0 {
            let times = (bus / period).min(u32::MAX.into()) as u32;
            self.warnings.push(Warning::FasterThanBus { times });
        } else if period != bus {
            let period = Nanos(period);
            self.warnings.push(Warning::PeriodOffBus { period, bus: bus_cycle });
        }
        if self.has_sync1() && self.assign_activate.makes_sync0() && self.sync1 == 0 {
            self.warnings.push(Warning::PulsesCoincide);
        }
        let off_tick = |ns: u32| !ns.is_multiple_of(TICK);
        if off_tick(self.sync0_cycle) || off_tick(self.sync1) {
            self.warnings.push(Warning::OffTick);
        }
        if self.shift.0.unsigned_abs() >= period.max(bus).unsigned_abs() {
            self.warnings.push(Warning::LongShift { shift: self.shift, phase: self.phase() });
        }
        self
    }
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::BusCycle(bus) => {
                write!(f, "a bus cycle of {bus}; expected 1 ns to {}", Nanos(u32::MAX.into()))
            }
            Self::Register { register, value } => write!(
                f,
                "register 0x{register:04X} would have to hold {value} ns; it holds up to {} ns",
                u32::MAX
            ),
            Self::Shift => f.write_str("ShiftTimeSync0 and its Factor are more than 2^63 ns"),
        }
    }
}

impl core::error::Error for Problem {}

/// A part or a multiple of the bus cycle. A part that is not a whole number of ns is rounded down.
fn scaled(bus: i128, factor: i32, warnings: &mut Warnings) -> i128 {
    let parts = i128::from(factor.unsigned_abs());
    if factor > 0 {
        return bus * parts;
    }
    if bus % parts != 0 {
        warnings.push(Warning::BrokenPart { bus: nanos(bus), parts: factor.unsigned_abs() });
    }
    bus / parts
}

/// Converts to ns and saturates.
fn nanos(value: i128) -> Nanos {
    Nanos(value.clamp(i64::MIN.into(), i64::MAX.into()) as i64)
}

/// The shortest SYNC0 cycle in the makers' published OpModes and manuals.
const LEAST_SYNC0: Nanos = Nanos(10_000);
/// An ESC generates its pulses in steps of 10 ns.
const TICK: u32 = 10;
const SYNC0_CYCLE: u16 = isocat_wire::register::SYNC0_CYCLE.address;
const SYNC1_CYCLE: u16 = isocat_wire::register::SYNC1_CYCLE.address;

#[cfg(test)]
mod tests;
