//! What judges see of a run: events as they happen.

use isocat_subdevice::{Event, Step};
use isocat_wire::time::{Device, Time, True};
use isocat_wire::{AlState, AlStatusCode};

use crate::sampling::Sample;

/// One event at one SubDevice.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Observation {
    /// Position of the SubDevice.
    pub device: usize,
    /// When, as the SubDevice's own oscillator counts. In true time that is
    /// [`Oscillator::when`](crate::oscillator::Oscillator::when), for those few that somebody judges.
    pub device_at: Time<Device>,
    /// What.
    pub event: Observed,
    /// Which process data it concerns.
    pub content: Content,
}

/// Where process data come from: known beside the bytes, by labels that the ESC keeps with its
/// buffers. Zero where an event concerns none, or where their origin is not known.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Content {
    /// When the first bit of the frame left the MainDevice: with SM2 the frame that stored outputs,
    /// with steps of outputs the one that brought them, with SM3 the frame that fetched inputs.
    pub frame: Time<True>,
    /// With SM3: when the inputs were latched that the frame fetched, as the SubDevice's own
    /// oscillator counts.
    pub latched: Time<Device>,
}

/// What happened at a SubDevice.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Observed {
    /// Outputs were stored: the SM2 event.
    Sm2,
    /// Inputs were fetched: the SM3 event.
    Sm3,
    /// A SYNC0 edge.
    Sync0,
    /// A SYNC1 edge.
    Sync1,
    /// A pulse of SYNC0 or SYNC1 was due and made no edge: the signal was still active from the one before.
    StillActive(Event),
    /// The device's program acknowledged SYNC0 or SYNC1, in acknowledge mode.
    Acknowledged(Event),
    /// A step of the cycle began.
    Began(Step),
    /// A step of the cycle ended.
    Finished(Step),
    /// A device that oversamples took a sample, or one of its outputs began to act.
    Sampled(Sample),
    /// An expected SM event was missed; the counter's new value.
    SmEventMissed(u16),
    /// The state changed.
    State(AlState, AlStatusCode),
}
