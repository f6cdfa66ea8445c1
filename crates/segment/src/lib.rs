//! A segment as its users write it down, and what a run is made of.
//!
//! Data's way: a [`segment_file`] names devices by their [`profile`], or by a maker's description of which a profile is made; both
//! become a [`scenario`]: simulated devices, a host, and the configuration of the MainDevice. [`offline`] tells of a scenario what a
//! scan would find, before anything is sent. A [`chip_file`] holds what was measured of the chips of a real segment, for a scenario.
//!
//! What is to go wrong is written as lines, which [`mod@fault`] reads for segment files and for everybody else.
//!
//! The keys of both files are declared in tables: [`keys`] has them all, and makes schemas and pages of them.
#![forbid(unsafe_code)]

pub mod chip_file;
mod chips;
pub mod fault;
pub mod keys;
pub mod new_file;
pub mod offline;
pub mod profile;
pub mod scenario;
pub mod segment_file;

pub use chip_file::ChipFile;
pub use scenario::Scenario;
pub use segment_file::SegmentFile;
