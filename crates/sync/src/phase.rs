//! The clock servo: the host follows the reference clock, to an explicit phase.
//!
//! Each cycle gives one pair: the host time at which a frame was sent, and the system time that the
//! reference clock wrote into it. From these pairs the [`Servo`] keeps a line (offset and rate) that says
//! at which host time a given system time will come; frames are sent when the phase target comes.
//! Lateness of a single wake-up is in both members of the pair and therefore does not disturb the
//! line. The target is a phase of system time and not of a sample, so it is the same after every start.
//!
//! How the line lies among the pairs depends on what the stamps are like ([`Settings::stamp_noise`]):
//!
//! - Exact stamps: the noise is the 10 ns grain of the reference, as often too early as too late. The
//!   line is a filter with growing memory (`least_squares`): the first samples are weighted as a
//!   least-squares fit weights them, so it locks within a few cycles; then the weights stay at what the
//!   bandwidth asks for. Gains follow from bandwidth and sample interval, so one setting serves every cycle
//!   time.
//! - Stamps of a program: it stamps a frame before it hands it over, so a stamp is never too late, only too
//!   early: by some microseconds always, by a millisecond when the program was interrupted in between.
//!   Seen from the stamp the reference is then later than the line says, never earlier. The line lies
//!   under the pairs and touches those of frames that left at once (`envelope`): among n of them
//!   the earliest is off by an n-th of the noise, where a mean is off by all of it.
//!
//! The plan keeps time for frames that are late, not for early ones: a line of the earliest is the one to
//! send by.
//!
//! A pair far off the line is an outlier and not used; many in a row mean that the line is wrong, and begin it
//! anew. Neither kind of line has an integrator that could wind up: the rate is clamped to what quartz
//! clocks do, and without samples the line is extended as it is.
//!
//! The other way round, [`drive`] leads the reference clock after the host's clock or after an
//! [`external`] one. [`Direction`] says which way, and what follows from that.

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
