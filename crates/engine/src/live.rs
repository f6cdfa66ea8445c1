//! A run on a real network interface: the main job in host time.
//!
//! [`job`] is the main job with `isocat-host`: way up, time in operation, what registers and objects say at the end, way down. [`scan`]
//! looks at what is there and runs nothing. `judge` says what speaks against the segment being in sync, by what was read from
//! it alone: nobody here knows true time.

mod capture;
pub mod job;
mod judge;
pub mod scan;

pub use capture::{BothSinks, CaptureSink};
pub use job::{Job, Outcome};
