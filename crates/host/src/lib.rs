//! A MainDevice on a network interface: raw Ethernet, the host's clock, the real-time loop, and
//! what a machine can do for it.
//!
//! [`Host`] is the whole of it for a program: a MainDevice with its application on a thread of its
//! own. [`Exchange`] is the loop: it drives a MainDevice with a [`RawSocket`], as punctually as the
//! machine lets it, and counts how punctual that was; its [`Link`] is that interface without a MainDevice. [`clock`] is the one host clock. [`RealTime`]
//! asks for what a loop wants of the machine, [`preflight`] looks at what harms it, [`recorder`]
//! hands frames to a file without the loop waiting for it. [`Listener`] hears what others send and
//! sends nothing. [`Veth`] is a pair of interfaces in a network namespace of its own, for trying
//! things on one machine.
//!
//! All of it is Linux; elsewhere the crate is empty. What is unsafe stands in `sys`.
#![cfg(target_os = "linux")]
#![deny(unsafe_code)]

pub mod clock;
mod error;
pub mod exchange;
mod histogram;
mod host;
mod link;
mod listener;
mod namespace;
mod packet;
pub mod preflight;
mod realtime;
pub mod recorder;
mod socket;
mod sys;
mod traffic;

pub use error::LinkError;
pub use exchange::Exchange;
pub use histogram::Histogram;
pub use host::{Ended, Error, FRAME_TIMEOUT, Host, Result, Running, STOP_LIMIT, on_a_socket};
pub use isocat_maindevice::application::Device;
pub use isocat_maindevice::statistics::Statistics;
pub use isocat_maindevice::{
    Application, Config, Cycle, DeviceConfig, Event, QualityWatch, Recovery, SdoError, Segment,
    SubDevice,
};
pub use isocat_wire::{AlStatus, AlStatusCode, Nanos, ObjectAddress};
pub use link::{Arrival, Figures, Link, Waiting, unmarked};
pub use listener::{Heard, Listener};
pub use namespace::Veth;
pub use realtime::{RealTime, Wish};
pub use recorder::Recorder;
pub use socket::{RawSocket, Received};
pub use traffic::Traffic;
