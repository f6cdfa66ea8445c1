//! The simulator in a web page: what the page says goes in as a JSON text, pictures and figures come back as one.
//!
//! [`keys`] are those of the page, [`state`] reads what it says, with the words of the address line. One part of the page is a whole run
//! ([`run`]: real MainDevice, real ESC model, judges; [`pictures`] of it), the other the SYNC unit of one ESC alone
//! ([`pulses`]). [`presets`] are states worth a look. [`answer`] puts it together; [`door`] is the way in from the page.

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
