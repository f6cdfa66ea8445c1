//! Shows frames of a served segment to a tap, in the form of a simulated run.

use isocat_sim::{MainPort, Passage, Tap};
use isocat_wire::time::{Time, True};

/// Shows a frame as it left, and its answer.
pub fn show(tap: &mut dyn Tap, passage: &Passage, before: &[u8], after: &[u8]) {
    show_frame(tap, passage.from, passage.start, true, before);
    match passage.fate {
        Ok(back) if back.good => show_frame(tap, back.port, back.first_bit, false, after),
        Ok(_) => tap.lost(passage.start, passage.from.into(), None),
        Err(why) => tap.lost(passage.start, passage.from.into(), Some(why)),
    }
}

/// Shows a frame at a port of the MainDevice.
pub fn show_frame(tap: &mut dyn Tap, at_port: MainPort, at: Time<True>, sent: bool, bytes: &[u8]) {
    match at_port {
        MainPort::Primary => tap.frame(at, sent, bytes),
        MainPort::Secondary => tap.secondary_frame(at, sent, bytes),
    }
}
