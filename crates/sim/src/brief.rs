//! Regular events as judges need them: one short record of what happens at a SubDevice in a cycle
//! takes the place of an [`Observation`](crate::observation::Observation) for each event and step.

use isocat_wire::time::{Device, Time, True};

use crate::oscillator::Factor;

/// Regular events at a SubDevice, with the steps that they started, as far as these were done
/// before anything else happened. They came in the order of [`Parts`]; what [`has`](Self::has) does
/// not name has no meaning.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Brief {
    /// Position of the SubDevice.
    pub device: u32,
    /// The state of the SubDevice, as
    /// [`Device::state_version`](crate::device::Device::state_version) tells it.
    pub version: u32,
    /// Number of observations that came before it.
    pub before: u32,
    /// What it consists of.
    pub has: Parts,
    /// The factor of its oscillator.
    pub factor: Factor,
    /// The end of a frame, by the SubDevice's own oscillator, and when the first bit of that frame
    /// left the MainDevice.
    pub frame_end: Time<Device>,
    pub frame: Time<True>,
    /// When the inputs were latched that the frame fetched.
    pub fetched: Time<Device>,
    /// When outputs were mapped.
    pub mapped: Time<Device>,
    /// The pulse.
    pub pulse: Time<Device>,
    /// When outputs became valid, and the frame that brought them; zero if they are not new.
    pub valid: Time<Device>,
    pub acted: Time<True>,
    /// When inputs were latched.
    pub latched: Time<Device>,
}

impl Brief {
    /// Nothing.
    pub const NONE: Self = Self {
        device: 0,
        version: 0,
        before: 0,
        has: Parts::NONE,
        factor: Factor::NONE,
        frame_end: Time::ZERO,
        frame: Time::ZERO,
        fetched: Time::ZERO,
        mapped: Time::ZERO,
        pulse: Time::ZERO,
        valid: Time::ZERO,
        acted: Time::ZERO,
        latched: Time::ZERO,
    };
}

/// A set of parts of a [`Brief`].
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) struct Parts(u8);

impl Parts {
    pub const NONE: Self = Self(0);
    /// The frame stored outputs.
    pub const STORED: Self = Self(1);
    /// The frame fetched inputs.
    pub const FETCHED: Self = Self(1 << 1);
    /// Step [`MapOutputs`](isocat_subdevice::Step::MapOutputs), from its beginning to its end.
    pub const MAPPED: Self = Self(1 << 2);
    pub const SYNC0: Self = Self(1 << 3);
    pub const SYNC1: Self = Self(1 << 4);
    /// The beginning of step [`OutputsValid`](isocat_subdevice::Step::OutputsValid).
    pub const VALID: Self = Self(1 << 5);
    /// The beginning of step [`LatchInputs`](isocat_subdevice::Step::LatchInputs).
    pub const LATCHED: Self = Self(1 << 6);
    /// A whole cycle with SYNC0, in which outputs are mapped after SM2.
    pub const CYCLE: Self = Self::STORED
        .with(Self::FETCHED)
        .with(Self::MAPPED)
        .with(Self::SYNC0)
        .with(Self::VALID)
        .with(Self::LATCHED);
    /// The pulse is that of SYNC0 or that of SYNC1.
    pub const PULSE: Self = Self(Self::SYNC0.0 | Self::SYNC1.0);

    /// These, if `really`; otherwise none.
    #[inline]
    pub fn only_if(self, really: bool) -> Self {
        Self(if really { self.0 } else { 0 })
    }

    /// Whether one of these is among them.
    #[inline]
    pub const fn any(self, of: Self) -> bool {
        self.0 & of.0 != 0
    }

    /// These, too.
    #[inline]
    pub const fn with(self, others: Self) -> Self {
        Self(self.0 | others.0)
    }

    /// These, but not those.
    #[inline]
    pub const fn without(self, others: Self) -> Self {
        Self(self.0 & !others.0)
    }

    /// Whether each of them comes before the first one of these.
    #[inline]
    pub const fn come_before(self, others: Self) -> bool {
        self.0 < others.0 & others.0.wrapping_neg()
    }
}

/// Which steps of an event judges need, and where they stand among all of its steps.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct NotedSteps {
    /// Some of [`Parts::MAPPED`], [`Parts::VALID`], [`Parts::LATCHED`].
    pub parts: Parts,
    pub mapped: u8,
    pub valid: u8,
    pub latched: u8,
}

impl NotedSteps {
    /// None.
    pub const NONE: Self = Self { parts: Parts::NONE, mapped: 0, valid: 0, latched: 0 };
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_come_in_their_order() {
        let frame = Parts::STORED.with(Parts::FETCHED);
        assert!(Parts::NONE.come_before(frame) && frame.come_before(Parts::MAPPED));
        assert!(frame.come_before(Parts::SYNC0) && frame.come_before(Parts::VALID));
        assert!(!frame.come_before(Parts::FETCHED) && !Parts::SYNC0.come_before(Parts::MAPPED));
        let steps = Parts::MAPPED.with(Parts::LATCHED);
        assert!(frame.come_before(steps) && !frame.with(Parts::SYNC0).come_before(steps));
        assert!(!Parts::SYNC0.come_before(Parts::PULSE) && !Parts::LATCHED.come_before(frame));
    }
}
