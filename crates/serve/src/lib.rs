//! The virtual segment on a network interface, for anybody's MainDevice.
//!
//! Data's way: [`service`] takes frames from a raw socket, with the kernel's stamp of their arrival, and hands
//! them to the [`server`]; the answer goes back before anything else is done. Then [`conduct`] looks what the
//! MainDevice did ([`deed`] names its steps), the simulation's judges look how the SubDevices fared, and
//! [`verdict`] puts that into words. [`fault`] is what can be done to the segment meanwhile, asked for through
//! [`control`]. [`summary`] tells it all at the end.
//!
//! Only `service` and `control` know sockets; the rest takes frames and host time, so that tests need neither
//! root nor a network.

pub mod conduct;
pub mod control;
pub mod deed;
pub mod fault;
pub mod server;
pub mod service;
pub mod status;
pub mod summary;
mod text;
pub mod verdict;

pub use fault::Fault;
pub use server::{Answer, Event, Server};
pub use summary::Summary;
