//! An EtherCAT SubDevice Controller in software, exact to its 10 ns tick.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

pub mod pdi;

pub use pdi::{Pdi, PdiExt};
