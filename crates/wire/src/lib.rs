//! EtherCAT on the wire: bytes, names and time scales, without behaviour.
//!
//! The modules follow a frame from the outside to the inside:
//!
//! 1. [`frame`]: the Ethernet and EtherCAT headers around the datagrams, a writer for frames;
//! 2. [`datagram`] and [`command`]: one command in a frame, its [`address`], its working counter;
//! 3. [`register`]: every ESC register as one constant of address, value type and width. The values
//!    with an inner structure are in [`al`], [`dl`], [`dc`], [`fmmu`], [`sync_manager`],
//!    [`eeprom`];
//! 4. [`sii`]: the device's EEPROM image;
//! 5. [`mailbox`] and [`coe`]: the acyclic channel and the object protocol in it; [`soe`], the
//!    parameters of drives; [`foe`], [`eoe`] and [`aoe`], as far as a device needs them to answer
//!    that it has no files and no ports.
//!
//! In addition there is [`time`]: points on six clocks that must not be mixed.
//!
//! These rules hold everywhere in this crate. Parsing never panics, whatever the bytes. Unknown
//! codes are kept, and parsed values are written as the same bytes. Multi-byte fields are
//! little-endian unless stated otherwise.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

pub mod address;
pub mod al;
pub mod aoe;
pub mod coe;
pub mod command;
pub mod datagram;
pub mod dc;
pub mod dl;
pub mod eeprom;
pub mod eoe;
pub mod fmmu;
pub mod foe;
pub mod frame;
pub mod mailbox;
pub mod register;
pub mod sii;
pub mod soe;
pub mod sync_manager;
pub mod time;

pub use address::{AutoIncrementAddress, ObjectAddress, PortNumber, StationAddress};
pub use al::{AlControl, AlState, AlStatus, AlStatusCode};
pub use coe::AbortCode;
pub use command::Command;
pub use register::Register;
pub use time::{Nanos, Picos, Time};
