//! The virtual segment on a network interface, for anybody's MainDevice.
//!
//! Data's way: [`service`] takes frames from a raw socket, with the kernel's stamp of their
//! arrival, and hands them to the [`server`]; the answer goes back before anything else is done.
//! Then [`conduct`] looks what the MainDevice did ([`deed`] names its steps), the simulation's
//! judges look how the SubDevices fared, and [`verdict`] puts that into words. An [`Order`] is what
//! can be done to the segment meanwhile, asked for through [`control`]. `expect` holds what the
//! segment file expects against all of it, and [`summary`] tells it at the end.
//!
//! Only `service` and `control` know sockets and Linux. The rest is a core for other doors and for
//! tests: frames and instants go in, answers come out with the instant at which their last bit is
//! back, whatever clock the instants are from. Devices may have applications of the caller's own
//! ([`Setup::with_application`]), and the caller sees and sets their process data
//! ([`Server::outputs`], [`Server::set_inputs`]). A [`Bus`] is a server in virtual time, with the
//! answers that are under way: for doors that a program or a test drives.
#![forbid(unsafe_code)]

pub mod bus;
pub mod conduct;
#[cfg(target_os = "linux")]
pub mod control;
pub mod deed;
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
