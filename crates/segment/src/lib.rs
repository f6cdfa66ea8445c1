//! A segment as its users describe it, and how a run is made from it.
//!
//! How data flow: a [`segment_file`] names devices by their [`profile`], or by an ESI file from
//! which a profile is made. Both become a [`scenario`]: simulated devices, a host, and the
//! configuration of the MainDevice. [`offline`] computes from a scenario what a scan would find,
//! before anything is sent. A [`chip_file`] adds the measured properties of the chips of a real
//! segment to a scenario.
//!
//! Faults are written as lines, which [`mod@fault`] reads for segment files and all other users.
//!
//! The keys of both files are declared in tables: [`keys`] lists them all, and makes schemas and
//! pages from them.
#![forbid(unsafe_code)]

pub mod chip_file;
mod chips;
mod claims;
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
