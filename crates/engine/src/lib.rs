//! Plans a segment, runs it, and says how good it was.
//!
//! How data flow: [`plan`] computes the timing of a [`Scenario`] before anything is sent, and
//! [`plan::proof`] compares that with true time. A run in virtual time ([`run`]) ends in a
//! [`report`]; [`recording`] keeps the data for pictures, [`timeline`] the cycles of one SubDevice,
//! [`moment`] by moment; [`diagnosis`] looks for causes in both. [`scan`] identifies a segment
//! before any cycle, [`rescue`] finds the line that makes it silent, and [`calibrate`] measures the
//! behaviour of its chips that no data sheet states. [`verdict`] judges a segment by what its wire
//! shows. `sweep` runs a segment many times, on several threads. While a segment runs, [`status`]
//! holds its present state. On Linux, [`live`]
//! does the same jobs on a real interface. [`explain`] gives codes, objects and registers their
//! meaning.
#![forbid(unsafe_code)]

pub mod calibrate;
pub mod catalog;
pub mod diagnosis;
pub mod explain;
pub mod fold;
#[cfg(target_os = "linux")]
pub mod live;
pub mod moment;
pub mod plan;
pub mod recording;
pub mod replay;
pub mod report;
pub mod rescue;
pub mod scan;
pub mod status;
#[cfg(not(target_family = "wasm"))]
pub mod sweep;
pub mod timeline;
pub mod verdict;

use isocat_segment::Scenario;
use isocat_sim::run::Progress;
use isocat_sim::{Outcome, Run, Tap};
pub use report::Report;
pub use scan::Scan;

/// Runs a scenario in virtual time and reports on it.
pub fn run(scenario: &Scenario) -> Report {
    let outcome = unwatched(scenario.run(), &mut |_| {});
    Report::new(scenario, &outcome)
}

/// Does a run without a tap. This crate compiles it, so that callers that are optimized for size,
/// such as the library for Python, run it at full speed too.
pub fn unwatched(run: Run, progress: &mut dyn FnMut(Progress)) -> Outcome<NoTap> {
    run.execute(None, progress)
}

/// Does a run with a tap of any type. It is compiled once for all of them: a run has a lot of code.
pub fn watched<'tap>(
    run: Run,
    tap: &'tap mut dyn Tap,
    progress: &mut dyn FnMut(Progress),
) -> Outcome<&'tap mut dyn Tap> {
    run.execute(Some(tap), progress)
}

/// The tap type of a run without a tap. No value of it exists, so its calls cost nothing.
#[derive(Debug)]
pub enum NoTap {}

impl Tap for NoTap {
    fn frame(&mut self, _: isocat_wire::Time<isocat_wire::time::True>, _: bool, _: &[u8]) {
        match *self {}
    }
}
