//! Unmodified MainDevice programs in deterministic virtual time.
//!
//! A program runs under a [`supervisor`], a parent process that answers its system calls. Packet
//! sockets on the interfaces that the caller names become a [`Wire`]. Clocks, sleeps, waits and
//! threads run in virtual time: one thread runs at a time, and time advances only when all wait.
//! The virtual [`kernel`] decides which thread waits, for what, and until when; it knows nothing of
//! system calls.
//!
//! The supervisor uses seccomp's user notifications. It needs Linux 6.6 or newer on x86-64, but no
//! privileges, no preloaded library and no change to the program, which may be linked statically or
//! dynamically and written in any language.
#![deny(unsafe_code)]

pub mod kernel;
#[cfg(all(target_os = "linux", target_arch = "x86_64"))]
pub mod supervisor;
#[cfg(all(target_os = "linux", target_arch = "x86_64"))]
mod sys;
pub mod wire;

pub use wire::{Wire, WireAnswer};
