//! The live view: a segment that runs, on a terminal, as lines, or as a gate for scripts.
//!
//! A [`source`] gives a [`Status`](isocat_engine::status::Status) about ten times a second: of a
//! simulation paced by the host's clock, of a real wire, of a service. `trend` keeps what the
//! figures were, `gate` waits until they are good for long enough. What is shown is a `view` (what
//! is selected, how it is sorted) drawn by `screen` and `cycle`, or the lines of `plain`.
//! `terminal` is the loop with a terminal.

mod cycle;
pub(crate) mod gate;
pub(crate) mod plain;
mod screen;
pub mod source;
pub(crate) mod terminal;
#[cfg(test)]
mod tests;
pub(crate) mod trend;
pub(crate) mod view;
mod words;

pub(crate) use gate::Gate;
pub use source::Source;
pub(crate) use trend::Trend;
pub(crate) use view::View;
