//! The moments of a cycle: the events at a SubDevice from one exchange of process data to the next.

use core::fmt;

/// A moment of a SubDevice's cycle.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Moment {
    /// The first bit of a frame with process data leaves the MainDevice.
    Frame,
    /// Outputs are stored: the SM2 event.
    Sm2,
    /// Inputs are fetched: the SM3 event. In a plan this is the start of the frame that fetches
    /// them, in a run its end.
    Sm3,
    /// A SYNC0 edge.
    Sync0,
    /// A SYNC1 edge.
    Sync1,
    /// Outputs are fetched from the ESC.
    OutputsFetched,
    /// Outputs are copied and calculated.
    OutputsReady,
    /// The application begins.
    ApplicationBegins,
    /// The application ends.
    ApplicationEnds,
    /// Outputs act on the process.
    OutputsValid,
    /// Inputs are latched from the process.
    InputLatch,
    /// The mapping of inputs begins.
    InputsBegin,
    /// Inputs are in the SM3 buffer.
    InputsAvailable,
}

impl Moment {
    /// All moments.
    pub const ALL: [Self; 13] = [
        Self::Frame,
        Self::Sm2,
        Self::Sm3,
        Self::Sync0,
        Self::Sync1,
        Self::OutputsFetched,
        Self::OutputsReady,
        Self::ApplicationBegins,
        Self::ApplicationEnds,
        Self::OutputsValid,
        Self::InputLatch,
        Self::InputsBegin,
        Self::InputsAvailable,
    ];

    /// The moments of a plan, in the order of the cycle.
    pub const PLANNED: [Self; 8] = [
        Self::Sm2,
        Self::OutputsReady,
        Self::Sync0,
        Self::Sync1,
        Self::OutputsValid,
        Self::InputLatch,
        Self::InputsAvailable,
        Self::Sm3,
    ];

    /// The name in plans and status.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Frame => "frame sent",
            Self::Sm2 => "outputs stored (SM2)",
            Self::Sm3 => "inputs fetched",
            Self::Sync0 => "SYNC0",
            Self::Sync1 => "SYNC1",
            Self::OutputsFetched => "outputs fetched",
            Self::OutputsReady => "outputs ready",
            Self::ApplicationBegins => "application begins",
            Self::ApplicationEnds => "application ends",
            Self::OutputsValid => "Outputs Valid",
            Self::InputLatch => "Input Latch",
            Self::InputsBegin => "input mapping begins",
            Self::InputsAvailable => "inputs available",
        }
    }

    /// The moment with this name.
    pub fn of_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|moment| moment.name() == name)
    }

    /// The text in a timeline. Actions of a SubDevice are indented below the events that start
    /// them.
    pub const fn words(self) -> &'static str {
        match self {
            Self::Frame => "frame leaves the MainDevice",
            Self::Sm2 => "SM2 event: outputs stored",
            Self::Sm3 => "SM3 event: inputs fetched",
            Self::Sync0 => "SYNC0",
            Self::Sync1 => "SYNC1",
            Self::OutputsFetched => "  outputs fetched",
            Self::OutputsReady => "  outputs copied and calculated",
            Self::ApplicationBegins => "  application begins",
            Self::ApplicationEnds => "  application ends",
            Self::OutputsValid => "  Outputs Valid",
            Self::InputLatch => "  Input Latch",
            Self::InputsBegin => "  input mapping begins",
            Self::InputsAvailable => "  inputs available",
        }
    }

    /// Whether it happens at each SYNC0 with subordinated cycles.
    pub const fn is_of_each_pulse(self) -> bool {
        matches!(
            self,
            Self::Sync0 | Self::OutputsValid | Self::ApplicationBegins | Self::ApplicationEnds
        )
    }
}

/// Its name.
impl fmt::Display for Moment {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_is_found_by_its_name_and_stands_at_its_number() {
        for (number, moment) in Moment::ALL.into_iter().enumerate() {
            assert_eq!(moment as usize, number, "{moment}");
            assert_eq!(Moment::of_name(moment.name()), Some(moment));
        }
        assert_eq!(Moment::of_name("outputs"), None);
    }
}
