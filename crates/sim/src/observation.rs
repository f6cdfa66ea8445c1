//! What judges see of a run: events as they happen.

use isocat_subdevice::Step;
use isocat_wire::time::{Device, Time};
use isocat_wire::{AlState, AlStatusCode};

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
    /// A step of the cycle began.
    Began(Step),
    /// A step of the cycle ended.
    Finished(Step),
    /// An expected SM event was missed; the counter's new value.
    SmEventMissed(u16),
    /// The state changed.
    State(AlState, AlStatusCode),
}
