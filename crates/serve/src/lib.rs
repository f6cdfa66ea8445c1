//! The virtual segment on a network interface, for any MainDevice.
//!
//! The way of the data: [`service`] takes frames from a raw socket, with the kernel's stamp of
//! their arrival, and hands them to the [`server`]; the answer is sent before anything else is
//! done. Then [`conduct`] records what the MainDevice did ([`deed`] names its steps), the
//! simulation's judges check the SubDevices, and [`verdict`] collects their results, with what the
//! rules find when they hold the segment (`evidence`) against the claims of its file. An [`Order`]
//! is a fault for the segment, which [`control`] accepts meanwhile. `expect` compares the segment
//! file's expectations with all of it, and [`summary`] reports it at the end.
//!
//! Only `service` and `control` use sockets and Linux. The rest is a core for other interfaces and
//! for tests: frames and instants go in, and answers come out with the instant at which their last
//! bit is back, on any clock. Devices may have applications of the caller
//! ([`Setup::with_application`]), and the caller can read and set their process data
//! ([`Server::outputs`], [`Server::set_inputs`]). A [`Bus`] is a server in virtual time that also
//! keeps the answers under way, for interfaces that a program or a test drives.
#![forbid(unsafe_code)]

pub mod bus;
pub mod conduct;
#[cfg(target_os = "linux")]
pub mod control;
pub mod deed;
mod evidence;
mod expect;
mod process_data;
pub mod server;
#[cfg(target_os = "linux")]
pub mod service;
mod setup;
pub mod status;
pub mod summary;
mod taps;
mod text;
pub mod verdict;

pub use bus::Bus;
pub use isocat_segment::fault::Order;
pub use server::{Answer, Event, Server};
pub use setup::Setup;
pub use summary::Summary;
