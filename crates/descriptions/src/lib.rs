//! Descriptions of EtherCAT devices and networks as typed values.
//!
//! [`esi`] reads makers' device descriptions, [`eni`] reads and writes network descriptions, [`sii`] contents of EEPROMs. [`start_up`] is the list of what a
//! MainDevice writes to each SubDevice on the way up, in ENI's shape. [`document`] gives errors in files their place (file, line,
//! column, expected, found), [`quantity`] reads durations, lengths and clock deviations, [`columns`] lays out text for a terminal,
//! [`markup`] for XML.
//!
//! Nothing here knows a simulator, a MainDevice or a plan: bytes of a file come in, values with their places come out.
#![forbid(unsafe_code)]

pub mod columns;
pub mod document;
pub mod eni;
pub mod esi;
pub mod limits;
pub mod markup;
pub mod quantity;
pub mod sii;
pub mod start_up;

pub use document::{FileError, Wrong};
pub use start_up::StartUp;
