//! EtherCAT SubDevice stack: everything on the local CPU behind the ESC's PDI.
//!
//! The way of an event, from the ESC to the process:
//!
//! 1. [`SubDevice`] is called by the main loop and by interrupts, over [`isocat_esc::Pdi`];
//! 2. its state machine answers AL control, after checking what the MainDevice has set up;
//! 3. its mailbox takes requests from SM0 and passes them to the server of their protocol: CoE
//!    reads and writes the dictionary, SoE the parameters of drives. A [`Description`] defines the
//!    device ([`describe`] helps to write one), and the values are in a store of the caller;
//! 4. its [`SyncEngine`] converts SM2, SYNC0, SYNC1 and the local timer into [`Steps`]: the parts
//!    of the cycle that start, their times, and the counters of late ones;
//! 5. each step has its effect at its own instant: process data move between the ESC's buffers and
//!    the [`Application`], outputs become valid, inputs are latched.
//!
//! [`Drive`] and [`Io`] are two applications to start from.
//!
//! The stack uses no allocation, no clock and no frames: `now` and the ESC are arguments of every
//! call. Times are those of the device's oscillator, `Time<Device>`.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

pub mod application;
mod assignment;
mod checks;
mod coe;
pub mod describe;
pub mod description;
mod dictionary;
pub mod drive;
mod emulated;
mod esm;
pub mod io;
mod mailbox;
mod measurement;
pub mod misbehaviour;
mod missed;
mod objects;
mod parameters;
mod prepared;
mod process_data;
mod regular;
mod services;
mod soe;
mod stack;
mod steps;
mod sync_engine;
#[cfg(test)]
mod tests;

pub use application::Application;
pub use description::{Description, Entry, Object, Parameter, Speaks};
pub use drive::Drive;
pub use io::{Io, IoOf};
pub use isocat_sync::{Chain, Event, Step, SyncMode};
pub use mailbox::{MAX_MAILBOX, MIN_MAILBOX};
pub use misbehaviour::{BadAnswer, Misbehaviour, Misbehaviours};
pub use objects::MAX_TRANSFER;
pub use prepared::{Place, Prepared};
pub use process_data::{MAX_AREAS, MAX_PROCESS_DATA};
pub use stack::SubDevice;
pub use steps::{MAX_STEPS, Steps};
pub use sync_engine::SyncEngine;
