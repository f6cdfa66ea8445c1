//! The simulator in a web page: takes the page's state as JSON, and returns pictures and figures as
//! JSON.
//!
//! [`keys`] are those of the page; [`state`] reads their values from the texts of the address line.
//! One part of the page is a whole run ([`run`]: real MainDevice, real ESC model, judges; its
//! [`pictures`]), the other part is the SYNC unit of a single ESC ([`pulses`]). [`presets`] are
//! interesting states. [`answer`] builds the answer; [`door`] is the interface to the page.

pub mod answer;
mod counter;
pub mod door;
mod edges;
pub mod keys;
pub mod pictures;
pub mod presets;
pub mod pulses;
pub mod run;
pub mod state;

pub use answer::answer;
