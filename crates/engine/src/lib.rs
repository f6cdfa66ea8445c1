//! Plans a segment, runs it, and says how good it was.
//!
//! Data's way: what a [`Scenario`]'s timing will be, [`plan`] tells before anything is sent, and
//! [`plan::proof`] holds that against true time. A run in virtual time ([`run`]) ends in a
//! [`report`]; [`recording`] keeps what pictures are drawn of, [`timeline`] the cycles of one
//! SubDevice, [`moment`] by moment; [`diagnosis`] looks for causes in both. [`scan`] tells what a
//! segment is before any cycle, [`calibrate`] measures what its chips do that no data sheet tells.
//! [`verdict`] judges a segment by what its wire shows. `sweep` runs a segment many times, on several threads. While a segment runs, [`status`] is what is known of it. On Linux, [`live`] does the same jobs
//! on a real interface. [`explain`] gives codes, objects and registers their meaning; [`fold`] lets views tell equal devices as one.
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
pub mod scan;
pub mod status;
#[cfg(not(target_family = "wasm"))]
pub mod sweep;
pub mod timeline;
pub mod verdict;

use isocat_segment::Scenario;
pub use report::Report;
pub use scan::Scan;

/// Runs a scenario in virtual time and reports on it.
pub fn run(scenario: &Scenario) -> Report {
    let outcome = scenario.run().execute(None::<NoTap>, &mut |_| {});
    Report::new(scenario, &outcome)
}

/// The tap of a run without a tap. No value of it exists, so its calls cost nothing.
#[derive(Debug)]
pub enum NoTap {}

impl isocat_sim::Tap for NoTap {
    fn frame(&mut self, _: isocat_wire::Time<isocat_wire::time::True>, _: bool, _: &[u8]) {
        match *self {}
    }
}
