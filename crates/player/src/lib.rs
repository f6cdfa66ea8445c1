//! A MainDevice that plays a start-up list: what a configuration tool wrote (ENI) is executed to the letter, on a virtual
//! segment in virtual time, where the segment's judges say what came of it, or on a real interface, where the verdict engine
//! says it by what the wire shows.
//!
//! Data's way: [`virtual_segment`] makes a [`Scenario`](isocat_segment::Scenario) of the ENI, as an ENI describes what is
//! written and not the devices that take it. [`play`](fn@play) brings that segment up: `line` sends frames, `step` does one
//! command of the list, `mailbox` one SDO download, `clock` measures what no list can know (offsets, delays), `cyclic` is the
//! exchange with the frames of the list. All of it goes over a `wire`: the virtual bus, or a real interface (`real`).
//! [`differences`] compares the list with the one that our plan would write, [`found`] with what answers to a scan.
//! [`report`] is all of it as a document.
//!
//! The player has no servo, grid or delay formula of its own: those of `isocat-sync` are the ones that our MainDevice uses.
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
