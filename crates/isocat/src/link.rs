//! The real wire: raw Ethernet on a network interface, the host's clock, and what a machine can do for
//! real time.
//!
//! [`RawSocket`] carries EtherCAT frames, with the kernel's stamp of each arrival; [`clock`] is the one host
//! clock; [`Veth`] is a pair of interfaces in a network namespace of its own for trying things on one
//! machine; [`RealTime`] asks for what a loop wants of the machine, [`preflight`] looks at what harms it. All of it is Linux. What is unsafe stands in `sys`.

pub mod clock;
mod error;
mod histogram;
mod namespace;
pub mod preflight;
mod realtime;
mod socket;
mod sys;
mod traffic;

pub use error::LinkError;
pub use histogram::Histogram;
pub use namespace::Veth;
pub use realtime::{RealTime, Wish};
pub(crate) use socket::timespec;
pub use socket::{RawSocket, Received};
pub use traffic::Traffic;
