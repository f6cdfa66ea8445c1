//! The clock servo: the host follows the reference clock, to an explicit phase.
//!
//! Each cycle gives one pair: the host time at which a frame was sent, and the system time that the
//! reference clock wrote into it. From these pairs the [`Servo`] keeps a line (offset and rate),
//! which tells at which host time a given system time will come; frames are sent when the target
//! phase comes. A late wake-up shifts both members of the pair and therefore does not disturb the
//! line. The target is a phase of system time and not of a sample, so it is the same after every
//! start.
//!
//! How the line is fitted depends on the time stamps ([`Settings::stamp_noise`]):
//!
//! - Exact stamps: the noise is the 10 ns grain of the reference, early as often as late. The line
//!   is a filter with growing memory (`least_squares`). It weights the first samples as a
//!   least-squares fit does, so it locks within a few cycles; later the weights stay at the values
//!   of the bandwidth. Gains follow from bandwidth and sample interval, so one setting serves every
//!   cycle time.
//! - Stamps of a program: the program stamps a frame before it hands it over, so a stamp is never
//!   too late. It is too early: always by some microseconds, and by a millisecond if the program
//!   was interrupted in between. Seen from the stamp, the reference is then later than the line,
//!   never earlier. The line lies under the pairs and touches those of frames that left at once
//!   (`envelope`). Among n of them the earliest has an n-th of the noise as its error, where a mean
//!   has all of it.
//!
//! The plan allows for late frames, not for early ones, so frames are sent by the line of the
//! earliest.
//!
//! A pair far off the line is an outlier and is not used; many in a row mean that the line is
//! wrong, and restart it. Neither kind of line has an integrator that could wind up: the rate is
//! limited to that of quartz clocks, and without samples the line is extended unchanged.
//!
//! In the other direction, [`drive`] lets the reference clock follow the host's clock or an
//! [`external`] one. [`Direction`] says which clock leads, and what follows from that.

mod direction;
pub mod drive;
mod envelope;
pub mod external;
mod least_squares;
mod line;
mod servo;
mod settings;
#[cfg(test)]
mod tests;

pub use direction::Direction;
pub use drive::Drive;
pub use servo::{Servo, State, Uncertainty};
pub use settings::Settings;
