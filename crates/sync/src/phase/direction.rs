//! Which clock follows which.

use super::{drive, external};

/// The clock that leads the segment. In all cases the host sends when the reference clock is at the
/// planned phase, so frames and SYNC pulses keep their distance.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Direction {
    /// The reference clock leads by its own quartz, and the host follows. The jitter of the host's
    /// wake-ups has no effect on the clocks of the segment. System time drifts against all other
    /// times, by some 10 ppm.
    #[default]
    FollowReference,
    /// The host's clock leads and the reference clock follows; the host still sends by the
    /// reference. This is for systems that must be in step with the host's time (several segments
    /// at one host, recordings). The price: the delay of a frame behind its time stamp is an error
    /// of the value written to the reference. The whole segment follows this error, smoothed by the
    /// reference's filter alone. Drives that find SYNC pulses unsteady go to SAFEOP with AL status
    /// code 0x0032 (PLL error). [`Drive::injected`](super::Drive::injected) measures the error.
    DriveReference {
        /// How fast the reference may change.
        limits: drive::Limits,
    },
    /// An external time leads: that of another segment through a bridge (object 0x10F4), or that of
    /// a network through the host's hardware clock. Its pairs come from the application. The price
    /// is that of [`Direction::DriveReference`].
    External {
        /// How fast the reference may change.
        limits: drive::Limits,
        /// The properties of the pairs of external time.
        source: external::Source,
    },
}
