//! Descriptions of EtherCAT devices and networks as typed values.
//!
//! [`esi`] reads device descriptions by vendors, [`eni`] reads and writes network descriptions,
//! [`sii`] contents of EEPROMs. [`start_up`] is the list of a MainDevice's writes to each SubDevice
//! on the way up, in the structure of ENI. [`document`] gives errors in files their place (file,
//! line, column, expected, found), [`quantity`] reads durations, lengths and clock deviations,
//! [`columns`] formats text for a terminal, [`markup`] for XML.
//!
//! This crate does not depend on a simulator, a MainDevice or a plan: bytes of a file come in,
//! values with their places come out.
#![forbid(unsafe_code)]

pub mod columns;
pub mod document;
pub mod eni;
pub mod esi;
pub mod limits;
pub mod markup;
pub mod quantity;
#[cfg(feature = "schema")]
pub mod schema;
pub mod sii;
pub mod start_up;

pub use document::{FileError, Wrong};
pub use start_up::StartUp;
