//! The synchronization modes by name.

use super::{Entry, entry};
use crate::SyncMode;

/// The explanation of a mode.
pub fn explain(mode: SyncMode) -> &'static Entry {
    match mode {
        SyncMode::FreeRun => &FREE_RUN,
        SyncMode::SmSynchronous => &SM,
        SyncMode::DcSync0 => &SYNC0,
        SyncMode::DcShiftSync1 => &SHIFT_SYNC1,
        SyncMode::DcSync1 => &SYNC1,
        SyncMode::DcSubordinated => &SUBORDINATED,
    }
}

static FREE_RUN: Entry = entry(
    "The device runs by its own timer and takes whatever stands in its buffers. No relation to \
     the bus: outputs act up to a device cycle late, and not at the same time as others. \
     0x1C32:01 = 0, 0x1C33:01 = 0, SYNC unit off.",
    &[],
    &["0x1C32:02: its own cycle"],
    &["for slow I/O; for drives choose another"],
);
static SM: Entry = entry(
    "The arrival of the frame starts the device's cycle: SM2, or SM3 without outputs. Outputs act \
     a calculation after the frame, so each device later than the one before, with the host's \
     jitter. 0x1C32:01 = 1, 0x1C33:01 = 0x22 (1 without outputs), SYNC unit off.",
    &[],
    &["0x1C32:05: cycle at least this plus the host's jitter", "0x1C32:0C"],
    &["for one axis, or a quiet host; no clocks needed"],
);
static SYNC0: Entry = entry(
    "The frame brings the outputs, SYNC0 lets them act and takes the inputs: at all devices at \
     one instant. 0x1C32:01 = 2, 0x1C33:01 = 2, AssignActivate 0x0300.",
    &[],
    &["0x1C32:06 and :09 for the phase of SYNC0", "0x092C before, 0x1C32:0B after"],
    &["SYNC0 behind the frame by arrival + jitter + 0x1C32:06; the host locked onto the \
         reference clock"],
);
static SHIFT_SYNC1: Entry = entry(
    "As with SYNC0, and SYNC1, a part of the cycle later, takes the inputs (or lets the outputs \
     act too, by 0x1C32:04 bits 6:5 = 10). 0x1C32:01 = 2, 0x1C33:01 = 3, AssignActivate 0x0700.",
    &[],
    &["0x09A4: the distance, above 0 and below 0x09A0", "0x1C33:06"],
    &["a larger 0x09A4 for fresher inputs, as long as they are ready before the frame"],
);
static SYNC1: Entry = entry(
    "SYNC0 lets the device fetch outputs and calculate, SYNC1 lets them act. 0x1C32:01 = 3, \
     0x1C33:01 = 3, AssignActivate 0x0700.",
    &[],
    &["0x1C32:06: 0x09A4 must be at least this", "the frame must have come before SYNC0"],
    &["0x09A4 = 0x1C32:06 or more, below 0x09A0"],
);
static SUBORDINATED: Entry = entry(
    "The device runs a short cycle by SYNC0, several times in a bus cycle, which SYNC1 marks: \
     oversampling, drives with a fixed inner cycle. 0x1C32:01 = 3, 0x1C33:01 = 3, AssignActivate \
     0x0700.",
    &[],
    &["0x1C32:0A: the SYNC0 cycle it needs", "0x1C32:04 bit 4"],
    &["0x09A0 = 0x1C32:0A, the bus cycle a multiple of it, 0x09A4 = bus cycle - 0x09A0"],
);
