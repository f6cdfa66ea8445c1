//! The synchronization modes: which event starts which step.

use core::fmt;

use crate::object::{SupportedTypes, SyncType};

/// An event that can start a step of a SubDevice.
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

impl Event {
    /// All events.
    pub const ALL: [Self; 5] = [Self::Sm2, Self::Sm3, Self::Sync0, Self::Sync1, Self::Timer];
}

/// A step of a SubDevice's cycle.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum Step {
    /// Fetch the outputs from the SM2 buffer and calculate; takes the calc and copy time.
    MapOutputs,
    /// The application's own work.
    Application,
    /// The outputs act on the process.
    OutputsValid,
    /// The inputs are latched from the process.
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

/// The synchronization mode of a SubDevice.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default)]
pub enum SyncMode {
    /// Its own timer only.
    #[default]
    FreeRun,
    /// The arrival of frames: SM2, or SM3 if there are no outputs.
    SmSynchronous,
    /// SM2 starts the calculation, SYNC0 lets outputs act.
    DcSync0,
    /// SM2 starts the calculation, SYNC0 lets outputs act; SYNC1, a part of the cycle later,
    /// latches the inputs.
    DcShiftSync1,
    /// SYNC0 starts the calculation, SYNC1 lets outputs act.
    DcSync1,
    /// SYNC0 runs a shorter cycle several times in a bus cycle, and SYNC1 marks the bus cycle.
    DcSubordinated,
}

impl SyncMode {
    /// All modes, least synchronized first.
    pub const ALL: [SyncMode; 6] = [
        Self::FreeRun,
        Self::SmSynchronous,
        Self::DcSync0,
        Self::DcShiftSync1,
        Self::DcSync1,
        Self::DcSubordinated,
    ];

    /// The order in which a mode is chosen if none is asked for. SYNC1 is for devices that are
    /// configured for it or have no other mode.
    pub const PREFERRED: [SyncMode; 5] =
        [Self::DcSync0, Self::DcSync1, Self::DcSubordinated, Self::SmSynchronous, Self::FreeRun];

    /// The name used in segment files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::FreeRun => "free-run",
            Self::SmSynchronous => "sm",
            Self::DcSync0 => "dc-sync0",
            Self::DcShiftSync1 => "dc-shift-sync1",
            Self::DcSync1 => "dc-sync1",
            Self::DcSubordinated => "dc-subordinated",
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
            Self::DcSync0 | Self::DcShiftSync1 => SyncType::DC_SYNC0,
            Self::DcSync1 | Self::DcSubordinated => SyncType::DC_SYNC1,
        }
    }

    /// Value of 0x1C33:01 in this mode. SM-synchronous inputs follow SM2 when outputs are
    /// transmitted.
    pub const fn input_type(self, has_outputs: bool) -> SyncType {
        match self {
            Self::FreeRun => SyncType::FREE_RUN,
            Self::SmSynchronous if has_outputs => SyncType::INPUTS_ON_SM2,
            Self::SmSynchronous => SyncType::SM,
            Self::DcSync0 => SyncType::DC_SYNC0,
            Self::DcShiftSync1 | Self::DcSync1 | Self::DcSubordinated => SyncType::DC_SYNC1,
        }
    }

    /// Whether sub-index 04 of a SubDevice announces this mode.
    pub const fn is_supported(self, types: SupportedTypes) -> bool {
        match self {
            Self::FreeRun => types.free_run(),
            Self::SmSynchronous => types.sm_synchronous(),
            Self::DcSync0 => types.dc_sync0(),
            Self::DcShiftSync1 => types.dc_sync0() && types.dc_sync1(),
            Self::DcSync1 => types.dc_sync1(),
            Self::DcSubordinated => types.dc_sync1() && types.dc_subordinated(),
        }
    }

    /// The mode that 0x1C32:01 and 0x1C33:01 name together; `None` if they cannot be combined or
    /// the mode is unknown. A direction without process data does not count. SYNC1 in both is
    /// `subordinated` if SYNC1 comes a SYNC0 cycle or more after SYNC0, which only the registers
    /// tell.
    pub fn from_types(
        output: SyncType,
        input: SyncType,
        has_outputs: bool,
        has_inputs: bool,
        subordinated: bool,
    ) -> Option<Self> {
        let matches = |mode: &Self| {
            (mode.output_type() == output || !has_outputs)
                && (mode.input_type(has_outputs) == input || !has_inputs)
        };
        let twice_sync1 = if subordinated { Self::DcSubordinated } else { Self::DcSync1 };
        // With one direction only, its type is that of both.
        let order = [Self::FreeRun, Self::SmSynchronous, Self::DcSync0, twice_sync1];
        order.into_iter().chain([Self::DcShiftSync1]).find(matches)
    }

    /// Whether the mode needs the SYNC unit.
    pub const fn uses_dc(self) -> bool {
        !matches!(self, Self::FreeRun | Self::SmSynchronous)
    }

    /// Whether the mode needs SYNC1 too.
    pub const fn uses_sync1(self) -> bool {
        matches!(self, Self::DcShiftSync1 | Self::DcSync1 | Self::DcSubordinated)
    }
}

/// The steps that each event starts in a device: its mode, and how its program uses the events.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default)]
pub struct Chain {
    /// The mode.
    pub mode: SyncMode,
    /// Outputs are transmitted.
    pub has_outputs: bool,
    /// The program has no interrupt from SM2: at SYNC0 it checks whether outputs have arrived.
    pub polls_outputs: bool,
    /// Outputs act at SYNC1 if inputs are latched at SYNC1: 0x1C32:04 says "shift by SYNC1".
    pub outputs_on_sync1: bool,
    /// With subordinated cycles the application runs once, at SYNC1, and not at each SYNC0.
    pub application_on_sync1: bool,
}

impl Chain {
    /// The steps that an event starts, in the order in which the CPU executes them; empty if the
    /// event starts nothing. Without outputs the read of the inputs (SM3) takes the place of SM2,
    /// and there are no steps for outputs.
    ///
    /// If an event latches the inputs, the latch comes first: it is due at the pulse itself, while
    /// the application may run later.
    pub const fn steps(self, event: Event) -> &'static [Step] {
        use Step::{Application, LatchInputs, MapInputs, MapOutputs, OutputsValid};
        use SyncMode as Mode;
        let outputs = self.has_outputs;
        match (self.mode, event) {
            (Mode::FreeRun, Event::Timer) if outputs => &Step::ALL,
            (Mode::SmSynchronous, Event::Sm2) if outputs => &Step::ALL,
            (Mode::FreeRun, Event::Timer) => &[Application, LatchInputs, MapInputs],
            (Mode::SmSynchronous, Event::Sm3) if !outputs => &[Application, LatchInputs, MapInputs],
            (Mode::DcSync0 | Mode::DcShiftSync1 | Mode::DcSubordinated, Event::Sm2)
                if outputs && !self.polls_outputs =>
            {
                &[MapOutputs]
            }
            (Mode::DcSync0, Event::Sync0) => match (outputs, self.polls_outputs) {
                (true, false) => &[LatchInputs, Application, OutputsValid, MapInputs],
                (true, true) => &[LatchInputs, MapOutputs, Application, OutputsValid, MapInputs],
                (false, _) => &[LatchInputs, Application, MapInputs],
            },
            (Mode::DcShiftSync1, Event::Sync0) => {
                match (outputs, self.polls_outputs, self.outputs_on_sync1) {
                    (true, false, false) => &[Application, OutputsValid],
                    (true, true, false) => &[MapOutputs, Application, OutputsValid],
                    (true, true, true) => &[MapOutputs, Application],
                    (true, false, true) | (false, ..) => &[Application],
                }
            }
            (Mode::DcShiftSync1, Event::Sync1) if outputs && self.outputs_on_sync1 => {
                &[OutputsValid, LatchInputs, MapInputs]
            }
            (Mode::DcShiftSync1, Event::Sync1) => &[LatchInputs, MapInputs],
            (Mode::DcSync1, Event::Sync0) if outputs => &[MapOutputs],
            (Mode::DcSync1, Event::Sync1) if outputs => {
                &[LatchInputs, Application, OutputsValid, MapInputs]
            }
            (Mode::DcSync1, Event::Sync1) => &[LatchInputs, Application, MapInputs],
            (Mode::DcSubordinated, Event::Sync0) => {
                match (outputs, self.polls_outputs, self.application_on_sync1) {
                    (true, false, false) => &[Application, OutputsValid],
                    (true, true, false) => &[MapOutputs, Application, OutputsValid],
                    (true, true, true) => &[MapOutputs],
                    (true, false, true) | (false, _, true) => &[],
                    (false, _, false) => &[Application],
                }
            }
            (Mode::DcSubordinated, Event::Sync1) => match (outputs, self.application_on_sync1) {
                (true, true) => &[Application, OutputsValid],
                (false, true) => &[Application],
                (_, false) => &[],
            },
            _ => &[],
        }
    }

    /// The steps that the last SYNC0 before SYNC1 starts in addition: with subordinated cycles it
    /// latches the inputs.
    pub const fn steps_of_last_sync0(self) -> &'static [Step] {
        match self.mode {
            SyncMode::DcSubordinated => &[Step::LatchInputs, Step::MapInputs],
            _ => &[],
        }
    }

    /// Whether the device checks for outputs at this event instead of getting them by SM2.
    pub const fn looks_for_outputs(self, event: Event) -> bool {
        match event {
            Event::Timer => matches!(self.mode, SyncMode::FreeRun),
            Event::Sync0 => {
                self.has_outputs
                    && self.mode.uses_dc()
                    && (self.polls_outputs || matches!(self.mode, SyncMode::DcSync1))
            }
            _ => false,
        }
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
    use std::vec::Vec;

    #[test]
    fn announced_modes_of_real_words() {
        let supported = |word| SyncMode::ALL.map(|mode| mode.is_supported(SupportedTypes(word)));
        // EL2502-0010, AKD2G, an analog terminal with SYNC1, all flags.
        assert_eq!(supported(0x4001), [true, false, false, false, false, false]);
        assert_eq!(supported(0x0427), [true, true, true, false, false, false]);
        assert_eq!(supported(0x080F), [true, true, true, true, true, false]);
        assert_eq!(supported(0x001F), [true; 6]);
        // Subordinated cycles are not possible without SYNC1.
        assert!(!SyncMode::DcSubordinated.is_supported(SupportedTypes(0x0017)));
    }

    #[test]
    fn types_name_a_mode_only_together() {
        let both = |output, input| {
            SyncMode::from_types(SyncType(output), SyncType(input), true, true, false)
        };
        assert_eq!(both(0, 0), Some(SyncMode::FreeRun));
        assert_eq!(both(1, 0x22), Some(SyncMode::SmSynchronous));
        assert_eq!(both(2, 2), Some(SyncMode::DcSync0));
        assert_eq!(both(2, 3), Some(SyncMode::DcShiftSync1));
        assert_eq!(both(3, 3), Some(SyncMode::DcSync1));
        assert_eq!([both(1, 1), both(2, 0x22), both(0, 2), both(3, 2), both(4, 4)], [None; 5]);
        let subordinated = SyncMode::from_types(SyncType(3), SyncType(3), true, true, true);
        assert_eq!(subordinated, Some(SyncMode::DcSubordinated));
        let inputs_only =
            |input, long| SyncMode::from_types(SyncType(0), SyncType(input), false, true, long);
        assert_eq!(inputs_only(1, false), Some(SyncMode::SmSynchronous));
        assert_eq!(inputs_only(0x22, false), None);
        assert_eq!(inputs_only(3, false), Some(SyncMode::DcSync1));
        assert_eq!(inputs_only(3, true), Some(SyncMode::DcSubordinated));
        let outputs_only = SyncMode::from_types(SyncType(2), SyncType(9), true, false, false);
        assert_eq!(outputs_only, Some(SyncMode::DcSync0));
    }

    fn all_chains() -> Vec<Chain> {
        let mut chains = Vec::new();
        for mode in SyncMode::ALL {
            for bits in 0..16 {
                chains.push(Chain {
                    mode,
                    has_outputs: bits & 1 != 0,
                    polls_outputs: bits & 2 != 0,
                    outputs_on_sync1: bits & 4 != 0,
                    application_on_sync1: bits & 8 != 0,
                });
            }
        }
        chains
    }

    /// Whatever its settings, a device starts each step by exactly one event of a bus cycle.
    #[test]
    fn each_step_starts_once_in_each_chain() {
        for chain in all_chains() {
            let events = [Event::Sm2, Event::Sm3, Event::Sync0, Event::Sync1, Event::Timer];
            let mut started: Vec<_> =
                events.iter().flat_map(|&event| chain.steps(event)).copied().collect();
            started.extend(chain.steps_of_last_sync0());
            for step in Step::ALL {
                let of_outputs = matches!(step, Step::MapOutputs | Step::OutputsValid);
                let expected = usize::from(chain.has_outputs || !of_outputs);
                let found = started.iter().filter(|s| **s == step).count();
                assert_eq!(found, expected, "{chain:?} {step:?}");
            }
        }
    }

    #[test]
    fn outputs_are_looked_for_where_sm2_starts_nothing() {
        for chain in all_chains().into_iter().filter(|chain| chain.has_outputs) {
            let events = [Event::Timer, Event::Sync0];
            let looks = events.into_iter().any(|event| chain.looks_for_outputs(event));
            assert_eq!(looks, chain.steps(Event::Sm2).is_empty(), "{chain:?}");
        }
    }

    #[test]
    fn inputs_follow_sm2_when_there_are_outputs() {
        assert_eq!(SyncMode::SmSynchronous.input_type(true), SyncType(0x22));
        assert_eq!(SyncMode::SmSynchronous.input_type(false), SyncType(1));
    }
}
