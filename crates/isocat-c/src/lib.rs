//! libisocat: the virtual segment for programs in C, in deterministic virtual time.
//!
//! `include/isocat.h` is made of this crate: comments at what is exported are written for readers
//! of that header. Data's way: a [`segment`] is read, and may get an [`application`] of the
//! caller's own; a [`bus`] is made of it, whose [`device`]s can be looked at while frames pass; a
//! [`verdict`] tells what came of it. A [`plan`] needs no bus. What goes wrong is a [`failure`].
//!
//! The library has no thread, no clock and no state of its own. Each function locks the handle that
//! it works on and catches panics, so that a call from a callback, or from a second thread, is an
//! error and nothing worse. What C hands over is taken at its word in `sys`, where all unsafe code
//! stands; the other files export names and nothing more.
#![deny(unsafe_code)]
#![allow(non_camel_case_types, reason = "names are as C has them")]
#![allow(clippy::missing_safety_doc, reason = "the header says once what pointers are to be")]

#[allow(unsafe_code, reason = "exports names")]
pub mod application;
#[allow(unsafe_code, reason = "exports names")]
pub mod bus;
#[allow(unsafe_code, reason = "exports names")]
pub mod device;
#[allow(unsafe_code, reason = "exports names")]
pub mod failure;
#[allow(unsafe_code, reason = "exports names")]
pub mod plan;
#[allow(unsafe_code, reason = "exports names")]
pub mod segment;
mod sys;
#[allow(unsafe_code, reason = "exports names")]
pub mod verdict;

#[cfg(test)]
#[allow(unsafe_code, reason = "calls what C calls")]
mod tests;
