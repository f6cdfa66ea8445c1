//! isocat: an EtherCAT synchronization engine, as a library.
//!
//! The main job in four lines: describe a segment, run it, look at the report.
//!
//! ```
//! use isocat::{Scenario, SegmentFile, run};
//! let mut scenario = Scenario::from(SegmentFile::built_in());
//! scenario.duration = isocat::Nanos::millis(100);
//! let report = run(&scenario);
//! assert!(report.in_sync, "{}", report.verdict);
//! ```
//!
//! Data's way: a [`segment_file`] names devices by their [`profile`], or by a maker's description ([`esi`]) of
//! which a profile is made; both become a [`scenario`], which `isocat-sim` runs in virtual time; of the
//! outcome comes a [`report`], and of what happens, if wanted, a [`capture`], [`waves`], a [`trace`] and a [`series`]. What a scenario's timing will be,
//! [`plan`] tells before anything is sent; what is found out about a segment before any cycle, [`scan`]. On Linux, `live` does the same job on a real interface, with the
//! sockets of `link`. [`document`]
//! gives errors in files their place, [`quantity`] reads durations, lengths and
//! clock deviations. Serialized forms exist in
//! this crate only.
#![deny(unsafe_code)]

pub mod capture;
#[cfg(feature = "cli")]
pub mod cli;
#[cfg(feature = "conform")]
pub mod conform;
pub mod diagnosis;
pub mod document;
#[cfg(feature = "xml")]
pub mod eni;
#[cfg(feature = "xml")]
pub mod esi;
pub mod explain;
pub mod html;
#[cfg(target_os = "linux")]
pub mod link;
#[cfg(target_os = "linux")]
pub mod live;
#[cfg(feature = "cli")]
pub mod metrics;
pub mod picture;
pub mod plan;
pub mod profile;
pub mod quantity;
pub mod recording;
pub mod report;
pub mod scan;
pub mod scenario;
pub mod segment_file;
pub mod series;
#[cfg(target_os = "linux")]
pub mod serve;
pub mod start_up;
pub mod status;
pub mod timeline;
pub mod trace;
#[cfg(feature = "cli")]
pub mod watch;
pub mod waves;

pub use isocat_wire::Nanos;
pub use report::Report;
pub use scan::Scan;
pub use scenario::Scenario;
pub use segment_file::SegmentFile;
pub use start_up::StartUp;

/// Runs a scenario in virtual time and reports on it.
pub fn run(scenario: &Scenario) -> Report {
    let outcome = scenario.run().execute(None::<NoTap>, &mut |_| {});
    Report::new(scenario, &outcome)
}

/// Nobody listens.
#[derive(Debug)]
pub enum NoTap {}

impl isocat_sim::Tap for NoTap {
    fn frame(&mut self, _: isocat_wire::Time<isocat_wire::time::True>, _: bool, _: &[u8]) {
        match *self {}
    }
}
