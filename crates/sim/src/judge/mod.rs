//! Judges: each watches a run from outside, in true time, and knows one invariant.
//!
//! They use no formula of the planner or the device model. They compare with physics (true time,
//! the reference clock's oscillator) and with intent (the configured cycle and phase).

mod grid;
pub mod host_phase;
pub mod inputs_cycle;
pub mod lost_pulses;
mod mark;
pub mod missed_events;
mod opportunity;
pub mod outputs_cycle;
pub mod outputs_delay;
pub mod outputs_valid;
pub mod plant;
pub mod samples;
pub mod sync0_error;
pub mod sync_margin;

pub use grid::Grid;
pub(crate) use grid::{ClockTime, Points};
pub use host_phase::HostPhase;
pub use inputs_cycle::InputsCycle;
pub use lost_pulses::LostPulses;
pub(crate) use mark::Mark;
pub use missed_events::MissedEvents;
pub use opportunity::{Late, Opportunity};
pub use outputs_cycle::OutputsCycle;
pub use outputs_delay::OutputsDelay;
pub use outputs_valid::OutputsValid;
pub use samples::Samples;
pub use sync_margin::SyncMargin;
pub use sync0_error::Sync0Error;
