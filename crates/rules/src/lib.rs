//! The rulebook: a segment is held against what was intended, at every door by the same rules.
//!
//! 1. [`claims`] are what a segment file, a description or a plan states: mode, cycle, phase,
//!    state, watchdog and process data of each SubDevice, and the cycle of the bus.
//! 2. [`evidence`] is what a door knows of a segment that runs: the simulator from its devices, a
//!    capture from its frames. What a door cannot know stays `None`.
//! 3. [`book`] has the rules as data. Each is a function from claims and evidence to what it found;
//!    it says which evidence it lacks instead of passing. [`judge`] runs all of them.
//! 4. [`breach`] has the kinds of what they find, and a breach prints as a sentence. [`kind`] is
//!    how kinds of findings are declared anywhere in the project: a name, a meaning, figures.
//!
//! A rule knows no formula of the planner: it compares what was wished with what was seen.
#![no_std]
#![forbid(unsafe_code)]

extern crate alloc;
#[cfg(test)]
extern crate std;

pub mod book;
pub mod breach;
pub mod claims;
pub mod evidence;
pub mod kind;
mod rules;
pub mod trail;
mod words;

pub use book::{Breached, Rule, Ruling, Unchecked, judge};
pub use breach::Breach;
pub use claims::{Claims, DeviceClaims};
pub use evidence::{DeviceEvidence, Evidence};
