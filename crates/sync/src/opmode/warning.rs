//! The doubts about an OpMode, by name.

use core::fmt;

use isocat_wire::dc::AssignActivate;
use isocat_wire::time::Nanos;

macro_rules! warnings {
    ($($(#[doc = $doc:literal])+ $kind:ident $({ $($field:ident: $type:ty),+ })? = $name:literal,)+) => {
        /// A doubt about an OpMode at one bus cycle. The registers are those of the answer that the
        /// text describes.
        #[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
        #[expect(missing_docs, reason = "fields are the figures that the text prints")]
        pub enum Warning {
            $($(#[doc = $doc])+ $kind $({ $($field: $type),+ })?,)+
        }

        /// The kind of a [`Warning`].
        #[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
        pub enum WarningKind {
            $($(#[doc = $doc])+ $kind,)+
        }

        impl Warning {
            /// Its kind, without the figures.
            pub const fn kind(&self) -> WarningKind {
                match self {
                    $(Self::$kind { .. } => WarningKind::$kind,)+
                }
            }

            /// A short name, for lists and counts.
            pub const fn name(&self) -> &'static str {
                self.kind().name()
            }
        }

        impl WarningKind {
            /// All kinds.
            pub const ALL: &[Self] = &[$(Self::$kind,)+];

            /// A short name, for lists and counts.
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$kind => $name,)+
                }
            }

            /// What it means, in a sentence.
            pub const fn means(self) -> &'static str {
                match self {
                    $(Self::$kind => concat!($($doc),+).trim_ascii_start(),)+
                }
            }
        }
    };
}

warnings! {
    /// The OpMode leaves the SYNC unit off.
    SyncOff = "sync-off",
    /// SYNC0 or SYNC1 is requested, but the unit is not switched on.
    NotActivated { word: AssignActivate } = "not-activated",
    /// The unit is switched on but generates no pulse: it serves time stamps.
    NoPulses { word: AssignActivate } = "no-pulses",
    /// The device has a system time but no SYNC unit.
    ClockOnly = "clock-only",
    /// The SYNC unit belongs to the PDI.
    UnitAtPdi = "unit-at-pdi",
    /// Bits of AssignActivate without a meaning are set.
    ReservedBits { word: AssignActivate } = "reserved-bits",
    /// CycleTimeSync0 is missing, or 0 without a factor.
    Sync0Undefined = "sync0-undefined",
    /// CycleTimeSync0 is below 0.
    NegativeSync0 { value: i64 } = "negative-sync0",
    /// CycleTimeSync0 has both a time and a factor.
    Sync0ValueAndFactor { value: i64, factor: i32 } = "sync0-value-and-factor",
    /// SYNC0 is faster than that of any known device, or than this device supports.
    BelowLeast { cycle: Nanos, least: Nanos } = "below-least",
    /// The bus cycle cannot be divided into this many whole nanoseconds.
    BrokenPart { bus: Nanos, parts: u32 } = "broken-part",
    /// The SYNC0 cycle is fixed and fits other bus cycles only.
    FixedSync0 { cycle: Nanos, bus: Nanos } = "fixed-sync0",
    /// Neither the SYNC0 cycle nor the bus cycle is a multiple of the other.
    Sync0OffBus { cycle: Nanos, bus: Nanos } = "sync0-off-bus",
    /// The device runs slower than the bus.
    SlowerThanBus { times: u32 } = "slower-than-bus",
    /// The device runs faster than the bus, but no SYNC1 marks the bus cycle.
    FasterThanBus { times: u32 } = "faster-than-bus",
    /// The period of the pulses does not match the bus cycle.
    PeriodOffBus { period: Nanos, bus: Nanos } = "period-off-bus",
    /// Times for SYNC1 are given, but SYNC1 is off.
    Sync1Unused = "sync1-unused",
    /// SYNC1 is requested without SYNC0.
    Sync1Alone = "sync1-alone",
    /// CycleTimeSync1 is missing, or 0 without a factor, although SYNC1 is on.
    Sync1Undefined = "sync1-undefined",
    /// CycleTimeSync1 is below 0.
    NegativeSync1 { value: i64 } = "negative-sync1",
    /// CycleTimeSync1 has both a time and a factor.
    Sync1ValueAndFactor { value: i64, factor: i32 } = "sync1-value-and-factor",
    /// Both a fixed CycleTimeSync1 and a ShiftTimeSync1 are given.
    Sync1FixedAndShift { value: i64, shift: i64 } = "sync1-fixed-and-shift",
    /// SYNC1 would have to come before the SYNC0 that it follows.
    Sync1BeforeSync0 { by: Nanos } = "sync1-before-sync0",
    /// The ESC generates SYNC1 with another period than the file asks for.
    Sync1Period { wanted: Nanos, found: Nanos } = "sync1-period",
    /// SYNC1 falls on SYNC0.
    PulsesCoincide = "pulses-coincide",
    /// A time is not a multiple of the ESC's step of 10 ns.
    OffTick = "off-tick",
    /// The shift is longer than the cycle.
    LongShift { shift: Nanos, phase: Nanos } = "long-shift",
}

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::SyncOff => f.write_str(
                "the OpMode leaves the SYNC unit off: Free Run or SM-synchronous, the file does \
                 not say which",
            ),
            Self::NotActivated { word } => write!(
                f,
                "AssignActivate {word} asks for pulses and does not switch the unit on (bit 8): \
                 it stays off"
            ),
            Self::NoPulses { word } => write!(
                f,
                "AssignActivate {word} switches the unit on without a pulse: for time stamps \
                 only; stacks that look at 0x0981 may refuse SAFEOP with 0x0030"
            ),
            Self::ClockOnly => f.write_str(
                "TimeLoopControlOnly: the device has a system time and no SYNC unit, nothing is \
                 written to it",
            ),
            Self::UnitAtPdi => f.write_str(
                "the SYNC unit belongs to the PDI: the device programs it, the registers are what \
                 it should come to",
            ),
            Self::ReservedBits { word } => {
                write!(f, "AssignActivate {word} has bits that mean nothing (0x00CE)")
            }
            Self::Sync0Undefined => {
                f.write_str("CycleTimeSync0 is not given: the bus cycle is taken")
            }
            Self::NegativeSync0 { value } => {
                write!(f, "CycleTimeSync0 of {value} ns is below 0: the bus cycle is taken")
            }
            Self::Sync0ValueAndFactor { value, factor } => write!(
                f,
                "CycleTimeSync0 has a time, {value} ns, and a factor, {factor}: the time counts"
            ),
            Self::BelowLeast { cycle, least } => {
                write!(f, "a SYNC0 cycle of {cycle} is below the least known, {least}")
            }
            Self::BrokenPart { bus, parts } => write!(
                f,
                "a bus cycle of {bus} has no {parts} equal parts of whole nanoseconds: rounded \
                 down, pulses drift against the bus"
            ),
            Self::FixedSync0 { cycle, bus } => write!(
                f,
                "the fixed SYNC0 cycle of {cycle} does not go into a bus cycle of {bus}: choose a \
                 multiple of it"
            ),
            Self::Sync0OffBus { cycle, bus } => {
                write!(f, "a SYNC0 cycle of {cycle} is in no step with a bus cycle of {bus}")
            }
            Self::SlowerThanBus { times } => write!(
                f,
                "the device takes one of {times} cycles of the bus: outputs in between are \
                 overwritten"
            ),
            Self::FasterThanBus { times } => write!(
                f,
                "{times} pulses in a bus cycle, and no SYNC1 marks it: a device that counts SM \
                 events against SYNC0 counts misses"
            ),
            Self::PeriodOffBus { period, bus } => {
                write!(f, "the pulses repeat every {period}, in no step with a bus cycle of {bus}")
            }
            Self::Sync1Unused => {
                f.write_str("times for SYNC1 are given and SYNC1 is off: they have no effect")
            }
            Self::Sync1Alone => f.write_str(
                "SYNC1 without SYNC0: SYNC0's cycle is set all the same; stacks that look at \
                 0x0981 may refuse SAFEOP with 0x0030",
            ),
            Self::Sync1Undefined => {
                f.write_str("CycleTimeSync1 is not given and SYNC1 is on: it follows each SYNC0")
            }
            Self::NegativeSync1 { value } => {
                write!(f, "CycleTimeSync1 of {value} ns is below 0: SYNC1 follows each SYNC0")
            }
            Self::Sync1ValueAndFactor { value, factor } => write!(
                f,
                "CycleTimeSync1 has a time, {value} ns, and a factor, {factor}: the time counts"
            ),
            Self::Sync1FixedAndShift { value, shift } => write!(
                f,
                "CycleTimeSync1 is fixed at {value} ns: ShiftTimeSync1 of {shift} ns is not added"
            ),
            Self::Sync1BeforeSync0 { by } => write!(
                f,
                "SYNC1 would have to come {by} before SYNC0: it comes as much before the next one"
            ),
            Self::Sync1Period { wanted, found } => write!(
                f,
                "SYNC1 is asked for every {wanted}, the ESC makes it every {found} with these \
                 values"
            ),
            Self::PulsesCoincide => f.write_str("SYNC1 falls on SYNC0: it adds nothing"),
            Self::OffTick => f.write_str(
                "a time is no multiple of 10 ns, the ESC's step: pulses spread by a \
                 step",
            ),
            Self::LongShift { shift, phase } => write!(
                f,
                "a shift of {shift} is longer than the cycle: what counts is {phase} within it"
            ),
        }
    }
}

/// The warnings of one OpMode, in the order in which they were found.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Warnings {
    list: [Option<Warning>; MOST],
}

impl Warnings {
    pub(super) fn push(&mut self, warning: Warning) {
        let free = self.list.iter_mut().find(|place| place.is_none());
        *free.expect("no OpMode has as many doubts as there are kinds") = Some(warning);
    }

    /// The warnings.
    pub fn iter(&self) -> impl Iterator<Item = Warning> + '_ {
        self.list.iter().copied().flatten()
    }

    /// Whether there are no warnings.
    pub fn is_empty(&self) -> bool {
        self.list[0].is_none()
    }
}

/// Enough for every doubt that one OpMode can have at once: reserved bits, unit at the PDI, three
/// of SYNC0, four of SYNC1, four of their positions, and some spare.
const MOST: usize = 16;
