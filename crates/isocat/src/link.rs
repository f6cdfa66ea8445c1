//! The real wire: raw Ethernet on a network interface, the host's clock, and what a machine can do for
//! real time.
//!
//! [`RawSocket`] carries EtherCAT frames, with the kernel's stamp of each arrival; [`clock`] is the one host
//! clock; [`Veth`] is a pair of interfaces in a network namespace of its own for trying things on one
//! machine. All of it is Linux. What is unsafe stands in `sys`.

pub mod clock;
mod error;
mod namespace;
mod socket;
mod sys;

pub use error::LinkError;
pub use namespace::Veth;
pub(crate) use socket::timespec;
pub use socket::{RawSocket, Received};
