//! A MainDevice that plays a start-up list. What a configuration tool wrote (ENI) is executed to
//! the letter: on a virtual segment in virtual time, where the segment's judges give the verdict,
//! or on a real interface, where the verdict engine judges by what the wire shows.
//!
//! The way of the data: [`virtual_segment`] makes a [`Scenario`](isocat_segment::Scenario) from the
//! ENI, because an ENI describes what is written and not the devices that take it.
//! [`play`](fn@play) brings that segment up: `line` sends frames, `step` executes one command of
//! the list, `mailbox` one SDO download, `clock` measures what no list can know (offsets, delays),
//! and `cyclic` is the exchange with the frames of the list. All of it uses a `wire`: the virtual
//! bus, or a real interface (`real`). [`differences`] compares the list with that of isocat's plan,
//! [`found`] with the SubDevices that a scan found. [`report`] makes a document of all of it.
//!
//! The player has no formulas for servo, grid or delay: it uses those of `isocat-sync`, like
//! isocat's own MainDevice.
#![forbid(unsafe_code)]

mod clock;
mod cyclic;
pub mod differences;
pub mod failure;
pub mod found;
mod line;
mod mailbox;
mod play;
#[cfg(target_os = "linux")]
pub mod real;
pub mod report;
mod step;
mod tally;
pub mod virtual_segment;
mod wire;

pub use failure::Failure;
pub use play::{Done, Played, Settings, Unit, play, play_with};
pub use report::Report;
