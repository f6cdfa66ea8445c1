//! The live view: a running segment, on a terminal, as lines, or as a gate for scripts.
//!
//! A [`source`] gives a [`Status`](isocat_engine::status::Status) about ten times per second: from
//! a simulation paced by the host's clock, from a real wire, or from a service. `trend` keeps the
//! history of the figures, `gate` waits until they have been good for long enough. A `view`
//! (selection and sort order) is drawn by `screen` and `cycle`, or printed as the lines of `plain`.
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
