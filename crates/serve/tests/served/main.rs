//! The served segment in the caller's own time: process data, rings, what is expected of a run,
//! and the bus in virtual time.

mod acknowledge;
mod bus;
mod claims;
mod core;
mod expect;
mod line;
mod ring;
mod which_cycle;
