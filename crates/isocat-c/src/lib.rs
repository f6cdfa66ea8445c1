//! libisocat: the virtual segment for programs in C, in deterministic virtual time.
//!
//! `include/isocat.h` is generated from this crate: comments on exported items are written for
//! readers of that header. The way of the data: a [`segment`] is read, and may get an
//! [`application`] of the caller; a [`bus`] is made from it, whose [`device`]s can be read while
//! frames pass; a [`verdict`] tells the result. A [`plan`] needs no bus. Errors are [`failure`]s.
//!
//! The library has no thread, no clock and no global state. Each function locks the handle that it
//! works on and catches panics, so a call from a callback or from a second thread is an error and
//! nothing worse. What C passes is trusted in `sys`, which has all unsafe code; the other files
//! only export names.
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
