//! What a segment is meant to do, as far as somebody stated it. `None` is no claim.

use alloc::vec::Vec;

use isocat_sync::SyncMode;
use isocat_wire::time::Nanos;

/// The claims about a segment.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Claims {
    /// The time from one frame with process data to the next.
    pub cycle: Option<Nanos>,
    /// Largest distance between SYNC0 pulses that are to come at one instant.
    pub sync0_limit: Nanos,
    /// By position.
    pub devices: Vec<DeviceClaims>,
}

/// The claims about one SubDevice.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct DeviceClaims {
    /// It is to be in OP; false for one that may be absent.
    pub operates: bool,
    /// The synchronization mode that was asked for by name.
    pub mode: Option<SyncMode>,
    /// The cycle of its SYNC0 (0x09A0).
    pub sync0_cycle: Option<Nanos>,
    /// The time from the beginning of a cycle, when its frame leaves, to SYNC0.
    pub shift: Option<Nanos>,
    /// Whether its SYNC0 is to come at one instant with that of others of which this is true, too.
    pub in_phase: bool,
    /// Whether it has process data.
    pub has_data: bool,
    /// The time from one exchange of its process data to the next.
    pub cycle: Option<Nanos>,
    /// The interpolation time of a drive (0x60C2), if one is written: the time from one set point
    /// to the next.
    pub interpolation: Option<Nanos>,
    /// Whether its outputs, if it has some, are guarded by the process data watchdog.
    pub guarded: bool,
    /// The time of that watchdog.
    pub watchdog: Option<Nanos>,
}
