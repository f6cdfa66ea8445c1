//! A run on a real network interface: the main job in host time.
//!
//! [`job`] is the main job with `isocat-host`: way up, time in operation, the registers and objects
//! at the end, way down. [`scan`] only identifies the devices and runs nothing. `judge` states the
//! reasons against the segment being in sync, only from what was read from it: a live run does not
//! know true time.

mod capture;
pub mod job;
mod judge;
pub mod scan;

pub use capture::{BothSinks, CaptureSink};
pub use job::{Job, Outcome};
