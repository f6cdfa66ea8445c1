//! A run on a real network interface: the main job in host time.
//!
//! [`exchange`] drives a MainDevice with a raw socket, as punctually as the machine lets it, and counts how
//! punctual that was. [`job`] is the main job with it: way up, time in operation, what registers and objects say
//! at the end, way down. [`scan`] looks at what is there and runs nothing. `judge` says what speaks against the segment being in sync, by what was read from
//! it alone: nobody here knows true time. [`recorder`] writes frames to a file without the loop waiting for it.

pub mod exchange;
pub mod job;
mod judge;
pub mod recorder;
pub mod scan;

pub use exchange::{Exchange, Figures, Waiting};
pub use job::{Job, Outcome};
pub use recorder::Recorder;
