//! Events of a run, as the judges see them.

use isocat_subdevice::{Event, Step};
use isocat_wire::time::{Device, Time, True};
use isocat_wire::{AlState, AlStatusCode};

use crate::sampling::Sample;

/// One event at one SubDevice.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Observation {
    /// Position of the SubDevice.
    pub device: usize,
    /// When, by the SubDevice's own oscillator.
    /// [`Oscillator::when`](crate::oscillator::Oscillator::when) converts it to true time, which
    /// only few events need.
    pub device_at: Time<Device>,
    /// The event.
    pub event: Observed,
    /// The process data that it concerns.
    pub content: Content,
}

/// The origin of process data, by labels that the ESC keeps with its buffers. Zero if an event
/// concerns no process data, or if their origin is unknown.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Content {
    /// When the first bit of the frame left the MainDevice. For SM2 this is the frame that stored
    /// outputs, for steps of outputs the one that brought them, for SM3 the frame that fetched
    /// inputs.
    pub frame: Time<True>,
    /// For SM3: when the fetched inputs were latched, by the SubDevice's own oscillator.
    pub latched: Time<Device>,
}

/// An event at a SubDevice.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
// The kind has a byte of its own, since it is read far more often than anything else.
#[repr(u8)]
pub enum Observed {
    /// Outputs were stored: the SM2 event.
    Sm2,
    /// Inputs were fetched: the SM3 event.
    Sm3,
    /// A SYNC0 edge.
    Sync0,
    /// A SYNC1 edge.
    Sync1,
    /// A pulse of SYNC0 or SYNC1 was due and made no edge: the signal was still active from the
    /// previous pulse.
    StillActive(Event),
    /// The device's program acknowledged SYNC0 or SYNC1, in acknowledge mode.
    Acknowledged(Event),
    /// A step of the cycle began.
    Began(Step),
    /// A step of the cycle ended.
    Finished(Step),
    /// A device that oversamples took a sample, or one of its outputs began to act.
    Sampled(Sample),
    /// An expected SM event was missed; the value is that of the counter.
    SmEventMissed(u16),
    /// Outputs became safe in OP: the process data watchdog of a device without a program expired.
    OutputsSafe,
    /// The state changed.
    State(AlState, AlStatusCode),
}
