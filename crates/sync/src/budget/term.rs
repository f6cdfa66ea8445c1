//! The figures of a line: what each one is, and where it comes from.

use core::fmt;

use isocat_wire::ObjectAddress;
use isocat_wire::time::Nanos;

use crate::object::{INPUT_PARAMETER, OUTPUT_PARAMETER, sub};

/// Where a figure comes from.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default)]
pub enum Origin {
    /// The wire: 80 ns per byte at 100 Mbit/s.
    #[default]
    Wire,
    /// The user asked for it.
    Intent,
    /// The plan chose it.
    Plan,
    /// An entry of the device's dictionary, as the device states it.
    Object(ObjectAddress),
    /// The device's ESI or SII.
    Esi,
    /// Measured on the segment.
    Measured,
    /// An entry of the device's dictionary that the device filled by a measurement, on command of
    /// sub-index 08.
    MeasuredByDevice(ObjectAddress),
    /// Computed from the errors that drift loops, thresholds and hops leave between clocks.
    Computed,
    /// Reset value of the chip's registers.
    Chip,
    /// The device's profile states it: cables, chips, CPUs.
    Profile,
    /// No source states it; it is assumed.
    Assumed,
}

impl fmt::Display for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Wire => f.pad("wire"),
            Self::Intent => f.pad("asked for"),
            Self::Plan => f.pad("plan"),
            Self::Object(object) => write!(f, "{object}"),
            Self::Esi => f.pad("ESI"),
            Self::Measured => f.pad("measured"),
            Self::MeasuredByDevice(object) => write!(f, "{object}, measured by the device"),
            Self::Computed => f.pad("computed from drift loops and hops"),
            Self::Chip => f.pad("chip"),
            Self::Profile => f.pad("profile"),
            Self::Assumed => f.pad("assumed"),
        }
    }
}

/// Where the figures of a [`Device`](super::Device) come from.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Origins {
    /// Of the propagation delay.
    pub delay: Origin,
    /// Of the minimum cycle.
    pub minimum_cycle: Origin,
    /// Of calc and copy time of the outputs.
    pub output_calc_and_copy: Origin,
    /// Of the delay of the outputs.
    pub output_delay: Origin,
    /// Of calc and copy time of the inputs.
    pub input_calc_and_copy: Origin,
    /// Of the shift of the inputs.
    pub input_shift: Origin,
    /// Of the delay of the inputs.
    pub input_delay: Origin,
    /// Of the distance from SYNC0 to SYNC1.
    pub sync1: Origin,
    /// Of the cycle of SYNC0.
    pub sync0_cycle: Origin,
    /// Of the spread behind a pulse.
    pub pulse_jitter: Origin,
    /// Of the watchdog.
    pub watchdog: Origin,
}

impl Default for Origins {
    /// Everything that an object can state is stated; delays are measured.
    fn default() -> Self {
        let output = |sub| Origin::Object(ObjectAddress::new(OUTPUT_PARAMETER, sub));
        let input = |sub| Origin::Object(ObjectAddress::new(INPUT_PARAMETER, sub));
        Self {
            delay: Origin::Measured,
            minimum_cycle: output(sub::MINIMUM_CYCLE_TIME),
            output_calc_and_copy: output(sub::CALC_AND_COPY_TIME),
            output_delay: output(sub::DELAY_TIME),
            input_calc_and_copy: input(sub::CALC_AND_COPY_TIME),
            input_shift: input(sub::SHIFT_TIME),
            input_delay: input(sub::DELAY_TIME),
            sync1: Origin::Plan,
            sync0_cycle: Origin::Intent,
            pulse_jitter: Origin::Assumed,
            watchdog: Origin::Chip,
        }
    }
}

/// The meaning of a figure.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum Quantity {
    /// Phase at which the frame meets the reference clock.
    Send,
    /// From the cycle's first bit to the last bit of the frame with the outputs.
    FrameEnd,
    /// From the cycle's first bit to the first bit of the frame that fetches the inputs.
    FrameBegin,
    /// All frames of a cycle.
    Frames,
    /// One short acyclic frame.
    Acyclic,
    /// From the reference clock to the SubDevice.
    Propagation,
    /// How late the host may send a frame.
    SendJitter,
    /// Lateness of a frame that the hops on its way cause, against the best case.
    HopJitter,
    /// How much two clocks may differ.
    ClockError,
    /// Largest difference of a SubDevice's own count of a span from system time.
    ClockSpeed,
    /// The difference where the deviation of its oscillator is stated.
    StatedClockSpeed,
    /// The difference for spans that do not begin at a pulse.
    Deviation,
    /// How far a clock under a drift loop may move in a span.
    Moved,
    /// Ticks on which pulses come.
    Tick,
    /// Largest SYNC0 error that counts as synchronized.
    Sync0Limit,
    /// Spread of outputs behind their pulse.
    OutputsSpread,
    /// Largest spread of outputs that counts as synchronized.
    OutputsSpreadLimit,
    /// Bus cycle.
    Cycle,
    /// A SubDevice's own cycle, of several bus cycles.
    OwnCycle,
    /// Frames of other groups that go before its own in some cycles.
    OtherGroups,
    /// The difference of another way through the ring, which is whole or cut.
    RingWay,
    /// SYNC0 cycle.
    Sync0Cycle,
    /// Minimum cycle time.
    MinimumCycle,
    /// Longest SYNC cycle.
    LongestCycle,
    /// Whole steps of the SYNC0 cycle before the last one.
    StepsBefore,
    /// The step of which a SYNC0 cycle must be a multiple.
    CycleStep,
    /// Phase of the pulse at which outputs act.
    ActingPulse,
    /// Distance of the pulse that counts here before the acting one.
    Lead,
    /// From SYNC0 to SYNC1.
    Sync1,
    /// From the last SYNC0 to SYNC1.
    BehindSync0,
    /// Calc and copy time of the outputs.
    OutputCalcAndCopy,
    /// Delay time of the outputs.
    OutputDelay,
    /// Shift time of the outputs.
    OutputShift,
    /// Calc and copy time of the inputs.
    InputCalcAndCopy,
    /// Delay time of the inputs.
    InputDelay,
    /// Shift time of the inputs.
    InputShift,
    /// How long outputs stay valid without new ones.
    Watchdog,
    /// Lateness of a SubDevice's steps behind their pulse.
    PulseJitter,
    /// Length of a SYNC pulse.
    PulseLength,
    /// Time from a SYNC pulse until the device's program acknowledges it.
    Acknowledge,
    /// The nanosecond that turns "less than" into "not more than".
    Strictly,
}

impl Quantity {
    /// The meaning in words.
    pub const fn words(self) -> &'static str {
        match self {
            Self::Send => "frame meets the reference clock",
            Self::FrameEnd => "frame to its last bit",
            Self::FrameBegin => "frames before it",
            Self::Frames => "frames with gaps",
            Self::Acyclic => "one acyclic frame",
            Self::Propagation => "propagation",
            Self::SendJitter => "send jitter",
            Self::HopJitter => "jitter of hops",
            Self::ClockError => "clock error",
            Self::ClockSpeed => "100 ppm of it and a tick",
            Self::StatedClockSpeed => "deviation of its clock over it and a tick",
            Self::Deviation => "deviation of its clock over it",
            Self::Moved => "share of the clock error in it",
            Self::Tick => "tick of the pulse",
            Self::Sync0Limit => "limit of the SYNC0 error",
            Self::OutputsSpread => "spread of outputs behind the pulse",
            Self::OutputsSpreadLimit => "limit of the spread",
            Self::Cycle => "cycle",
            Self::OwnCycle => "its own cycle",
            Self::OtherGroups => "frames of other groups before it",
            Self::RingWay => "another way through the ring",
            Self::Sync0Cycle => "SYNC0 cycle",
            Self::MinimumCycle => "minimum cycle",
            Self::LongestCycle => "longest cycle",
            Self::StepsBefore => "steps before the last",
            Self::CycleStep => "step of the device",
            Self::ActingPulse => "acting pulse",
            Self::Lead => "pulse before the acting one",
            Self::Sync1 => "SYNC0 to SYNC1",
            Self::BehindSync0 => "SYNC1 behind its SYNC0",
            Self::OutputCalcAndCopy => "calc and copy of outputs",
            Self::OutputDelay => "delay of outputs",
            Self::OutputShift => "shift of outputs",
            Self::InputCalcAndCopy => "calc and copy of inputs",
            Self::InputDelay => "delay of inputs",
            Self::InputShift => "shift of inputs",
            Self::Watchdog => "watchdog of the process data",
            Self::PulseJitter => "jitter behind the pulse",
            Self::PulseLength => "length of the pulse",
            Self::Acknowledge => "acknowledge behind the pulse",
            Self::Strictly => "less, not equal",
        }
    }
}

/// One figure, with the sign with which it counts.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Term {
    /// What it is.
    pub quantity: Quantity,
    /// How much.
    pub value: Nanos,
    /// Where from.
    pub origin: Origin,
}

/// A sum of figures.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Sum {
    terms: [Option<Term>; MOST_TERMS],
}

const MOST_TERMS: usize = 9;

impl Sum {
    /// The figures.
    pub fn terms(&self) -> impl Iterator<Item = Term> + '_ {
        self.terms.iter().flatten().copied()
    }

    /// The sum of the figures.
    pub fn total(&self) -> Nanos {
        self.terms().fold(Nanos::ZERO, |sum, term| sum + term.value)
    }

    /// The sum with one more figure, even if that is zero.
    pub(super) fn and(mut self, quantity: Quantity, value: Nanos, origin: Origin) -> Self {
        let free = self.terms.iter_mut().find(|term| term.is_none());
        let free = free.expect("no line has more figures");
        *free = Some(Term { quantity, value, origin });
        self
    }

    /// The sum with one more figure, unless that is zero, as it usually is.
    pub(super) fn if_any(self, quantity: Quantity, value: Nanos, origin: Origin) -> Self {
        if value == Nanos::ZERO { self } else { self.and(quantity, value, origin) }
    }
}
