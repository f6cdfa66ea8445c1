//! Which clock follows which.

use super::{drive, external};

/// Which clock leads the segment. Whatever it is, the host sends when the reference clock is at the phase
/// planned, so frames and SYNC pulses keep their distance.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Direction {
    /// The reference clock leads, by its own quartz; the host follows. Nothing of the host's is in the
    /// clocks of the segment, whatever its wake-ups are like. System time drifts against all other
    /// times, by some 10 ppm.
    #[default]
    FollowReference,
    /// The host's clock leads; the reference clock follows, and the host goes on to send by the reference.
    /// For what must be in step with the host's time (several segments at one host, recordings). The price:
    /// what is written to the reference is off by what held the frame up behind its time stamp, and the whole
    /// segment follows that, softened by the reference's filter alone. Drives that find SYNC pulses unsteady go
    /// to SAFEOP with AL status code 0x0032 (PLL error). [`Drive::injected`](super::Drive::injected) tells how
    /// much it is.
    DriveReference {
        /// How fast the reference may be led.
        limits: drive::Limits,
    },
    /// An external time leads: another segment's by way of a bridge (object 0x10F4), or a network's by way of
    /// the host's hardware clock. Its pairs come from the application. The price is that of
    /// [`Direction::DriveReference`].
    External {
        /// How fast the reference may be led.
        limits: drive::Limits,
        /// What the pairs of external time are like.
        source: external::Source,
    },
}
