//! A MainDevice on a network interface: raw Ethernet, the host's clock, the real-time loop, and
//! settings of the machine.
//!
//! [`Host`] is the complete host for a program: a MainDevice with its application on its own
//! thread. [`Exchange`] is the loop: it drives a MainDevice with a [`RawSocket`], as punctually as
//! the machine allows, and counts how punctual it was. Its [`Link`] is the interface without a
//! MainDevice. [`clock`] is the host clock. [`RealTime`] asks for what a loop needs of the machine,
//! and [`preflight`] reports what harms it. [`recorder`] hands frames to a file without blocking
//! the loop. [`Listener`] receives what others send, and sends nothing. [`Veth`] is a pair of
//! interfaces in its own network namespace, for tests on one machine.
//!
//! All of it needs Linux; on other systems the crate is empty. All unsafe code is in `sys`.
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
