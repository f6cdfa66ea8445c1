//! The synchronization modes: which event starts which step.

use core::fmt;

use crate::object::{SupportedTypes, SyncType};

/// What a SubDevice can be woken by.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum Event {
    /// The MainDevice wrote the outputs: last byte of SM2 stored.
    Sm2,
    /// The MainDevice read the inputs: last byte of SM3 fetched.
    Sm3,
    /// A SYNC0 pulse.
    Sync0,
    /// A SYNC1 pulse.
    Sync1,
    /// The local timer.
    Timer,
}

/// A piece of a SubDevice's cycle.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum Step {
    /// Fetch the outputs from the SM2 buffer and calculate; takes the calc and copy time.
    MapOutputs,
    /// The application's own work.
    Application,
    /// The outputs act on the process.
    OutputsValid,
    /// The inputs are taken from the process.
    LatchInputs,
    /// Put the inputs into the SM3 buffer; takes the calc and copy time of 0x1C33.
    MapInputs,
}

impl Step {
    /// The steps of a cycle without SYNC, in order.
    pub const ALL: [Step; 5] = [
        Self::MapOutputs,
        Self::Application,
        Self::OutputsValid,
        Self::LatchInputs,
        Self::MapInputs,
    ];
}

/// How a SubDevice is synchronized.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default)]
pub enum SyncMode {
    /// By its own timer only.
    #[default]
    FreeRun,
    /// By the arrival of frames: SM2, or SM3 if there are no outputs.
    SmSynchronous,
    /// SM2 starts, SYNC0 acts.
    DcSync0,
}

impl SyncMode {
    /// All modes, least synchronized first.
    pub const ALL: [SyncMode; 3] = [Self::FreeRun, Self::SmSynchronous, Self::DcSync0];

    /// The name used in segment files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::FreeRun => "free-run",
            Self::SmSynchronous => "sm",
            Self::DcSync0 => "dc-sync0",
        }
    }

    /// The mode with this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|mode| mode.name() == name)
    }

    /// Value of 0x1C32:01 in this mode.
    pub const fn output_type(self) -> SyncType {
        match self {
            Self::FreeRun => SyncType::FREE_RUN,
            Self::SmSynchronous => SyncType::SM,
            Self::DcSync0 => SyncType::DC_SYNC0,
        }
    }

    /// Value of 0x1C33:01 in this mode. SM-synchronous inputs follow SM2 when outputs are transmitted.
    pub const fn input_type(self, has_outputs: bool) -> SyncType {
        match self {
            Self::FreeRun => SyncType::FREE_RUN,
            Self::SmSynchronous if has_outputs => SyncType::INPUTS_ON_SM2,
            Self::SmSynchronous => SyncType::SM,
            Self::DcSync0 => SyncType::DC_SYNC0,
        }
    }

    /// Whether SI4 of a SubDevice announces this mode.
    pub const fn is_supported(self, types: SupportedTypes) -> bool {
        match self {
            Self::FreeRun => types.free_run(),
            Self::SmSynchronous => types.sm_synchronous(),
            Self::DcSync0 => types.dc_sync0(),
        }
    }

    /// The mode that 0x1C32:01 and 0x1C33:01 name together; `None` if they can't be combined or the
    /// mode is unknown. Of a direction without process data only the other's type counts.
    pub fn from_types(
        output: SyncType,
        input: SyncType,
        has_outputs: bool,
        has_inputs: bool,
    ) -> Option<Self> {
        Self::ALL.into_iter().find(|mode| {
            (mode.output_type() == output || !has_outputs)
                && (mode.input_type(has_outputs) == input || !has_inputs)
        })
    }

    /// The steps that an event starts, in the order in which the CPU takes them up; empty if the
    /// event means nothing in this mode. Without outputs the read of the inputs (SM3) stands for
    /// SM2, and the steps for outputs fall away.
    ///
    /// With SYNC0 the latch comes first: it is due at the pulse itself, the application's work is
    /// not.
    pub const fn steps(self, event: Event, has_outputs: bool) -> &'static [Step] {
        match (self, event, has_outputs) {
            (Self::FreeRun, Event::Timer, true) | (Self::SmSynchronous, Event::Sm2, true) => {
                &Step::ALL
            }
            (Self::FreeRun, Event::Timer, false) | (Self::SmSynchronous, Event::Sm3, false) => {
                &[Step::Application, Step::LatchInputs, Step::MapInputs]
            }
            (Self::DcSync0, Event::Sm2, true) => &[Step::MapOutputs],
            (Self::DcSync0, Event::Sync0, true) => {
                &[Step::LatchInputs, Step::Application, Step::OutputsValid, Step::MapInputs]
            }
            (Self::DcSync0, Event::Sync0, false) => {
                &[Step::LatchInputs, Step::Application, Step::MapInputs]
            }
            _ => &[],
        }
    }

    /// Whether the mode needs the SYNC unit.
    pub const fn uses_dc(self) -> bool {
        matches!(self, Self::DcSync0)
    }
}

impl fmt::Display for SyncMode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn el2502_announces_free_run_only() {
        let supported = SyncMode::ALL.map(|mode| mode.is_supported(SupportedTypes(0x4001)));
        assert_eq!(supported, [true, false, false]);
    }

    #[test]
    fn types_name_a_mode_only_together() {
        let both =
            |output, input| SyncMode::from_types(SyncType(output), SyncType(input), true, true);
        assert_eq!(both(0, 0), Some(SyncMode::FreeRun));
        assert_eq!(both(1, 0x22), Some(SyncMode::SmSynchronous));
        assert_eq!(both(2, 2), Some(SyncMode::DcSync0));
        assert_eq!([both(1, 1), both(2, 0x22), both(0, 2), both(3, 3)], [None; 4]);
        let inputs_only = |input| SyncMode::from_types(SyncType(0), SyncType(input), false, true);
        assert_eq!(inputs_only(1), Some(SyncMode::SmSynchronous));
        assert_eq!(inputs_only(0x22), None);
    }

    #[test]
    fn each_step_starts_once_in_each_mode() {
        for mode in SyncMode::ALL {
            let events = [Event::Sm2, Event::Sm3, Event::Sync0, Event::Sync1, Event::Timer];
            let started: std::vec::Vec<_> =
                events.iter().flat_map(|&event| mode.steps(event, true)).collect();
            for step in Step::ALL {
                assert_eq!(started.iter().filter(|s| ***s == step).count(), 1, "{mode} {step:?}");
            }
        }
    }

    #[test]
    fn inputs_follow_sm2_when_there_are_outputs() {
        assert_eq!(SyncMode::SmSynchronous.input_type(true), SyncType(0x22));
        assert_eq!(SyncMode::SmSynchronous.input_type(false), SyncType(1));
    }
}
