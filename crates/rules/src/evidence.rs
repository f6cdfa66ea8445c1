//! What a door knows of a segment in operation. `None` is unknown, never "no".

use alloc::vec::Vec;
use core::ops::Range;

use isocat_sync::SyncMode;
use isocat_wire::time::{Nanos, Picos};
use isocat_wire::{AlState, AlStatusCode};

/// The evidence of a stretch of time in operation.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Evidence {
    /// Mean time from one cyclic frame to the next.
    pub cycle: Option<Nanos>,
    /// The longest time without a drift datagram that reached the clocks; `None` also where no
    /// clock is to be kept.
    pub longest_drift_gap: Option<Nanos>,
    /// How the frames move against the reference clock.
    pub slide: Option<Slide>,
    /// Senders of frames that took turns, with the number of frames of each.
    pub talkers: Option<Vec<u64>>,
    /// Number of frames that left before the program took the answer to the last one of their kind,
    /// though it had come; and number of all such frames. `None` also where the program's sockets
    /// can't be seen.
    pub untaken: Option<[u64; 2]>,
    /// By position.
    pub devices: Vec<DeviceEvidence>,
}

/// The movement of the frames through the cycle of the reference clock.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Slide {
    /// Movement in a second; positive: frames come later and later.
    pub per_second: Nanos,
    /// The part of that which the scatter of the frames explains.
    pub uncertainty: Nanos,
}

/// The evidence about one SubDevice.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct DeviceEvidence {
    /// Its state, and its AL status code.
    pub state: Option<(AlState, AlStatusCode)>,
    /// Whether it was in OP, though it may have left it since: then what is known of it counts.
    pub operated: bool,
    /// Its synchronization mode.
    pub mode: Option<SyncMode>,
    /// Register 0x0981: what is activated.
    pub activation: Option<u8>,
    /// Register 0x09A0: the cycle of SYNC0, while SYNC0 is activated.
    pub sync0_cycle: Option<Nanos>,
    /// The phase of SYNC0 in its cycle by the clock of the segment, while SYNC0 is activated.
    pub sync0_phase: Option<Nanos>,
    /// By how much the next pulse of SYNC0 is overdue by the clock of the SubDevice; zero if it is
    /// to come.
    pub sync0_overdue: Option<Nanos>,
    /// Mean time from the instant at which a frame leaves to SYNC0, by the reference clock;
    /// negative if SYNC0 comes shortly before.
    pub frame_to_sync0: Option<Picos>,
    /// Bytes of outputs, and of inputs.
    pub lengths: Option<[u32; 2]>,
    /// Whether outputs came to it, and whether inputs of it were fetched.
    pub exchanged: [Option<bool>; 2],
    /// Mean time from one datagram that brings its outputs to the next, and from one that fetches
    /// its inputs to the next.
    pub carried_each: [Option<Nanos>; 2],
    /// The interpolation time of a drive (0x60C2), as a MainDevice wrote it.
    pub interpolation: Option<Nanos>,
    /// Logical bits that it takes outputs from, and gives inputs to.
    pub logical: Option<[Vec<Range<u64>>; 2]>,
    /// Whether the process data watchdog guards its outputs.
    pub guarded: Option<bool>,
    /// The time of that watchdog (0x0400, 0x0420).
    pub watchdog: Option<Nanos>,
    /// The largest change of the offset (0x0920) or the delay (0x0928) of its clock in operation.
    pub clock_set: Option<Nanos>,
}
