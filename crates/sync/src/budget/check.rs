//! The demands on a cycle, in words, and the sign of a violation.

use core::fmt;

use isocat_wire::{AlStatusCode, ObjectAddress, register};

use crate::mode::SyncMode;
use crate::object::{INPUT_PARAMETER, OUTPUT_PARAMETER, sub};

/// A demand on the cycle.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum Check {
    /// The frames of a cycle have passed before those of the next cycle begin.
    FramesInCycle,
    /// The cycle is not shorter than the SubDevice's minimum.
    MinimumCycle,
    /// The SYNC cycles are not longer than the SubDevice takes.
    LongestSyncCycle,
    /// The SYNC0 cycle is a multiple of the SubDevice's step.
    Sync0InSteps,
    /// Outputs are copied and calculated before the pulse that lets them act.
    OutputsBeforeSync0,
    /// Outputs are stored before the SYNC0 that fetches them.
    OutputsStoredBeforeSync0,
    /// Inputs of a SubDevice without outputs are read before the SYNC0 that counts the reads.
    InputsReadBeforeSync0,
    /// SYNC1 leaves enough time after SYNC0 to copy and calculate.
    Sync1CoversCopy,
    /// SYNC1 comes before the next SYNC0.
    Sync1BeforeNextSync0,
    /// Inputs are in the buffer before the frame that fetches them.
    InputsBeforeFrame,
    /// The shift of Outputs Valid is not shorter than the hardware needs.
    ShiftCoversDelay,
    /// The shift of Input Latch is not shorter than the hardware needs.
    InputShiftCoversDelay,
    /// Outputs become valid before the next pulse.
    OutputsValidInCycle,
    /// SYNC0 is no longer active when its next pulse is due; otherwise that pulse makes no edge.
    Sync0FallsInCycle,
    /// New outputs arrive before the process data watchdog expires.
    OutputsBeforeWatchdog,
    /// SYNC0 is within the requested distance of its grid.
    Sync0WithinLimit,
    /// The spread of the outputs behind their pulse is within the requested limit.
    OutputsSpreadWithinLimit,
}

/// Where a demand is stated.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Source {
    /// An entry of the SubDevice's dictionary.
    Object(ObjectAddress),
    /// A register.
    Register(u16),
}

/// `0x1C32:05`, `0x0420`.
impl fmt::Display for Source {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Object(object) => write!(f, "{object}"),
            Self::Register(address) => write!(f, "0x{address:04X}"),
        }
    }
}

/// The sign that a demand was not met.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Sign {
    /// A counter of the SubDevice.
    Counter(ObjectAddress),
    /// The SubDevice refuses SAFEOP with this AL status code.
    Refusal(AlStatusCode),
    /// The SubDevice falls out of OP with this AL status code.
    Fall(AlStatusCode),
    /// Only an observer with true time can see it; this names the judge.
    Judge(&'static str),
}

impl Check {
    /// The demands of one SubDevice, in the order of its cycle.
    pub const OF_DEVICE: [Check; 16] = [
        Self::MinimumCycle,
        Self::LongestSyncCycle,
        Self::Sync0InSteps,
        Self::OutputsStoredBeforeSync0,
        Self::Sync1CoversCopy,
        Self::OutputsBeforeSync0,
        Self::InputsReadBeforeSync0,
        Self::Sync1BeforeNextSync0,
        Self::InputsBeforeFrame,
        Self::ShiftCoversDelay,
        Self::InputShiftCoversDelay,
        Self::OutputsValidInCycle,
        Self::Sync0FallsInCycle,
        Self::OutputsBeforeWatchdog,
        Self::Sync0WithinLimit,
        Self::OutputsSpreadWithinLimit,
    ];

    /// Whether it is about time in the cycle, and not about the limits of synchronization or of a
    /// SYNC unit. Its slack then tells how much later an event may be.
    pub const fn is_of_cycle(self) -> bool {
        !matches!(
            self,
            Self::Sync0WithinLimit
                | Self::OutputsSpreadWithinLimit
                | Self::LongestSyncCycle
                | Self::Sync0InSteps
        )
    }

    /// What helps if the demand is not met.
    pub const fn remedy(self) -> &'static str {
        match self {
            Self::FramesInCycle => {
                "a longer cycle, fewer bytes, or slower cycles for devices that need no faster"
            }
            Self::MinimumCycle => "a longer cycle, or another mode",
            Self::LongestSyncCycle => "a shorter cycle, or another mode",
            Self::Sync0InSteps => {
                "a SYNC0 cycle that is a multiple of the device's step, or another mode"
            }
            Self::OutputsBeforeSync0
            | Self::OutputsStoredBeforeSync0
            | Self::InputsReadBeforeSync0 => {
                "a later SYNC0 (shift), a longer cycle, or a host with less jitter"
            }
            Self::Sync1CoversCopy => "a longer sync1",
            Self::Sync1BeforeNextSync0 => "a shorter sync1",
            Self::InputsBeforeFrame => {
                "an earlier SYNC0 (shift), a shorter shift of the inputs, or a longer cycle"
            }
            Self::ShiftCoversDelay => "a longer shift",
            Self::InputShiftCoversDelay => "a longer input_shift",
            Self::OutputsValidInCycle => "a shorter shift, or a longer cycle",
            Self::Sync0FallsInCycle => {
                "a program that reads 0x098E sooner, a pulse that ends by itself and sooner (0x0982), or a longer cycle"
            }
            Self::OutputsBeforeWatchdog => "a shorter cycle, or a longer watchdog",
            Self::Sync0WithinLimit => {
                "a shorter cycle, clocks that deviate less, or a larger sync0_limit"
            }
            Self::OutputsSpreadWithinLimit => {
                "a shift by a local timer or SYNC1 where the device has one, or a larger outputs_spread"
            }
        }
    }

    /// Short name, for programs.
    pub const fn name(self) -> &'static str {
        match self {
            Self::FramesInCycle => "frames-in-cycle",
            Self::MinimumCycle => "minimum-cycle",
            Self::LongestSyncCycle => "longest-sync-cycle",
            Self::Sync0InSteps => "sync0-in-steps",
            Self::OutputsBeforeSync0 => "outputs-before-sync0",
            Self::OutputsStoredBeforeSync0 => "outputs-stored-before-sync0",
            Self::InputsReadBeforeSync0 => "inputs-read-before-sync0",
            Self::Sync1CoversCopy => "sync1-covers-copy",
            Self::Sync1BeforeNextSync0 => "sync1-before-next-sync0",
            Self::InputsBeforeFrame => "inputs-before-frame",
            Self::ShiftCoversDelay => "shift-covers-delay",
            Self::InputShiftCoversDelay => "input-shift-covers-delay",
            Self::OutputsValidInCycle => "outputs-valid-in-cycle",
            Self::Sync0FallsInCycle => "sync0-falls-in-cycle",
            Self::OutputsBeforeWatchdog => "outputs-before-watchdog",
            Self::Sync0WithinLimit => "sync0-within-limit",
            Self::OutputsSpreadWithinLimit => "outputs-spread-within-limit",
        }
    }

    /// The object or register that states the demand, or counts violations; `None` for the demand
    /// of the frames.
    pub const fn source(self) -> Option<Source> {
        let (index, sub) = match self {
            Self::FramesInCycle => return None,
            Self::OutputsBeforeWatchdog => {
                return Some(Source::Register(register::WATCHDOG_TIME_PROCESS_DATA.address));
            }
            Self::Sync0FallsInCycle => {
                return Some(Source::Register(register::SYNC_PULSE_LENGTH.address));
            }
            Self::LongestSyncCycle | Self::Sync0InSteps => {
                return Some(Source::Register(register::SYNC0_CYCLE.address));
            }
            Self::Sync0WithinLimit => {
                return Some(Source::Register(register::SYSTEM_TIME_DIFFERENCE.address));
            }
            Self::OutputsSpreadWithinLimit => (OUTPUT_PARAMETER, sub::MINIMUM_DELAY_TIME),
            Self::Sync1BeforeNextSync0 => (OUTPUT_PARAMETER, sub::CYCLE_TIME),
            Self::MinimumCycle => (OUTPUT_PARAMETER, sub::MINIMUM_CYCLE_TIME),
            Self::OutputsBeforeSync0 | Self::OutputsStoredBeforeSync0 | Self::Sync1CoversCopy => {
                (OUTPUT_PARAMETER, sub::CALC_AND_COPY_TIME)
            }
            Self::InputsReadBeforeSync0 => (INPUT_PARAMETER, sub::SM_EVENT_MISSED),
            Self::InputsBeforeFrame => (INPUT_PARAMETER, sub::CALC_AND_COPY_TIME),
            Self::ShiftCoversDelay => (OUTPUT_PARAMETER, sub::DELAY_TIME),
            Self::InputShiftCoversDelay => (INPUT_PARAMETER, sub::DELAY_TIME),
            Self::OutputsValidInCycle => (OUTPUT_PARAMETER, sub::SHIFT_TIME),
        };
        Some(Source::Object(ObjectAddress::new(index, sub)))
    }

    /// The demand in words: what must not exceed what.
    pub const fn words(self) -> &'static str {
        match self {
            Self::FramesInCycle => {
                "all frames of a cycle with their gaps, and one acyclic frame + send jitter + clock error <= cycle"
            }
            Self::InputsReadBeforeSync0 => {
                "inputs read (SM3) + send jitter + clock error <= SYNC0 that counts the reads"
            }
            Self::MinimumCycle => "minimum cycle time (plus send jitter in SM mode) <= cycle",
            Self::LongestSyncCycle => {
                "SYNC cycle <= longest one that the device takes (maximum_cycle_time)"
            }
            Self::Sync0InSteps => {
                "SYNC0 cycle rounded up to a multiple of the device's step (cycle_granularity) <= SYNC0 cycle"
            }
            Self::OutputsBeforeSync0 => {
                "outputs stored + send jitter + clock error + calc and copy time <= SYNC0"
            }
            Self::OutputsStoredBeforeSync0 => {
                "outputs stored + send jitter + clock error <= SYNC0 that fetches them"
            }
            Self::Sync1CoversCopy => "calc and copy time <= SYNC1 - SYNC0",
            Self::Sync1BeforeNextSync0 => "SYNC1 - SYNC0 < SYNC0 cycle",
            Self::InputsBeforeFrame => {
                "pulse of Input Latch + input shift + calc and copy time + clock error <= next frame"
            }
            Self::ShiftCoversDelay => "delay time <= shift time",
            Self::InputShiftCoversDelay => "delay time <= shift time of the inputs",
            Self::OutputsValidInCycle => "acting pulse to outputs valid <= cycle of the pulse",
            Self::Sync0FallsInCycle => {
                "pulse length, or time until it is acknowledged, + clock error <= SYNC0 cycle"
            }
            Self::OutputsBeforeWatchdog => "cycle + send jitter <= watchdog of the process data",
            Self::Sync0WithinLimit => {
                "clock error + tick of the pulse <= SYNC0 error that is allowed (sync0_limit)"
            }
            Self::OutputsSpreadWithinLimit => {
                "spread of outputs behind their pulse <= spread that is allowed (outputs_spread)"
            }
        }
    }

    /// The usual sign that it was not met in a SubDevice of this mode; see
    /// [`Demand::sign`](super::Demand::sign).
    pub(super) fn sign(self, mode: SyncMode) -> Sign {
        let output = |sub| Sign::Counter(ObjectAddress::new(OUTPUT_PARAMETER, sub));
        match self {
            Self::FramesInCycle => Sign::Judge("frames on their phase"),
            Self::MinimumCycle if mode.uses_dc() => Sign::Refusal(AlStatusCode::DC_SYNC0_CYCLE),
            Self::LongestSyncCycle => Sign::Refusal(AlStatusCode::DC_SYNC0_CYCLE),
            Self::Sync0InSteps => Sign::Refusal(AlStatusCode::DC_INVALID_SYNC_CYCLE),
            Self::MinimumCycle | Self::OutputsValidInCycle => output(sub::CYCLE_TIME_TOO_SMALL),
            Self::OutputsBeforeSync0 => output(sub::SM_EVENT_MISSED),
            // The device fetches the outputs of the previous cycle and cannot tell, since they are
            // new to it too.
            Self::OutputsStoredBeforeSync0 => Sign::Judge("outputs fetched in their cycle"),
            // Each read resets the counter, so it never shows a read that is missed now and then.
            Self::InputsReadBeforeSync0 => Sign::Judge("inputs read between two pulses"),
            Self::Sync0FallsInCycle => Sign::Judge("an edge for each pulse of SYNC0"),
            Self::OutputsBeforeWatchdog => Sign::Fall(AlStatusCode::WATCHDOG),
            Self::Sync1CoversCopy | Self::ShiftCoversDelay => output(sub::SHIFT_TIME_TOO_SHORT),
            Self::InputShiftCoversDelay => {
                Sign::Counter(ObjectAddress::new(INPUT_PARAMETER, sub::SHIFT_TIME_TOO_SHORT))
            }
            Self::Sync1BeforeNextSync0 => {
                Sign::Refusal(AlStatusCode::INVALID_DC_SYNC_CONFIGURATION)
            }
            Self::InputsBeforeFrame => Sign::Judge("inputs fetched in their cycle"),
            Self::Sync0WithinLimit => Sign::Judge("SYNC0 on its grid"),
            Self::OutputsSpreadWithinLimit => Sign::Judge("outputs evenly behind their pulse"),
        }
    }
}

/// `0x1C32:0B counts`, `AL status code 0x0036 ...`, `judge: frames on their phase`.
impl fmt::Display for Sign {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Counter(object) => write!(f, "{object} counts"),
            Self::Refusal(code) => write!(f, "SAFEOP refused, AL status code {code}"),
            Self::Fall(code) => write!(f, "OP left, AL status code {code}"),
            Self::Judge(name) => write!(f, "judge: {name}"),
        }
    }
}
