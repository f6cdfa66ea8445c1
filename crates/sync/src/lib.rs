//! EtherCAT synchronization: the objects, the modes, the arithmetic. The centre of the project.
//!
//! A SubDevice describes its synchronization in two objects, 0x1C32 for outputs and 0x1C33 for
//! inputs; [`object`] holds them as typed values. [`mode`] says which event starts which step in
//! each synchronization mode, and [`table`] which sub-indices a mode needs and who may write them.
//! From the times in the objects and the arrival of the frames [`budget`] makes the plan of one
//! cycle: where SYNC0 must lie, with how much slack, or which line does not fit.
//!
//! The maker of a device states its settings in the ESI: [`opmode`] turns them, for a bus cycle,
//! into the registers of the SYNC unit and names every doubt. [`start`] finds the instant at which
//! all units begin in phase.
//!
//! [`interpolation`] is the one number of a drive beside the sync objects that must agree with the
//! cycle.
//!
//! [`explain`] says in plain words what codes, objects and registers mean and what to do about
//! them.
//!
//! For the MainDevice's clocks, [`delay`] turns port receive times into propagation delays and
//! states their errors, and [`way`] computes delays from cables and chips. [`drift`] judges by
//! measured differences whether clocks have converged, and [`settling`] tells what is left of their
//! phase in operation. [`phase`] is the servo by which the host follows the reference clock.
//!
//! There are no sockets, files, ESC model or simulator here: values go in, values come out.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

pub mod budget;
pub mod delay;
pub mod drift;
pub mod explain;
pub mod interpolation;
pub mod mode;
pub mod moment;
pub mod object;
pub mod opmode;
pub mod phase;
pub mod pulses;
pub mod settling;
pub mod start;
pub mod table;
pub mod way;

pub use mode::{Chain, Event, Step, SyncMode};
pub use moment::Moment;
pub use object::{SupportedTypes, SyncParameters, SyncType};
pub use opmode::OpMode;
pub use pulses::{Pulses, SyncSignal};
