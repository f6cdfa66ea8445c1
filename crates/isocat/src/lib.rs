//! isocat: an EtherCAT synchronization engine, as a library.
//!
//! The main job in four lines: describe a segment, run it, and inspect the report.
//!
//! ```
//! use isocat::{Scenario, SegmentFile, run};
//! let mut scenario = Scenario::from(SegmentFile::built_in());
//! scenario.duration = isocat::Nanos::millis(100);
//! let report = run(&scenario);
//! assert!(report.in_sync, "{}", report.verdict);
//! ```
//!
//! This crate is the command (`cli`) with its views ([`picture`], [`html`], [`tool`], `watch`,
//! `metrics`), and re-exports the crates behind it:
//!
//! | crate | modules | function |
//! |---|---|---|
//! | `isocat-descriptions` | [`esi`], [`eni`], [`sii`], [`start_up`], [`document`], [`quantity`] | descriptions of devices and networks, with places in errors |
//! | `isocat-segment` | [`profile`], [`segment_file`], [`scenario`] | devices and segments as users describe them |
//! | `isocat-captures` | [`reading`], [`pairing`] | captures of any tool, and the pairs of frames in them |
//! | `isocat-recorders` | [`capture`], [`waves`], [`trace`], [`series`], [`flight`], [`ring`] | recordings in the formats of other tools |
//! | `isocat-engine` | [`plan`], [`replay`], [`report`], [`scan`], [`calibrate`], [`recording`], [`timeline`], [`diagnosis`], [`status`], [`explain`], `live` | plan, run, judge |
//! | `isocat-diagnose` | [`diagnose`] | the content of a capture, and its faults |
//! | `isocat-conform` | [`conform`] | tests a SubDevice's synchronization |
//! | `isocat-serve` | [`serve`] | the virtual segment for any MainDevice |
//! | `isocat-player` | [`player`] | plays the output of a configuration tool (ENI), and compares it with our plan |
//! | `isocat-host` | `host` | a MainDevice on a network interface |
#![forbid(unsafe_code)]

#[cfg(feature = "cli")]
pub mod cli;
pub mod html;
pub mod json;
#[cfg(feature = "cli")]
mod metrics;
pub mod picture;
pub mod record;
pub mod tool;
#[cfg(feature = "cli")]
pub mod watch;

pub use isocat_captures::{pairing, reading};
pub use isocat_conform as conform;
pub use isocat_descriptions::{StartUp, columns, document, eni, esi, quantity, sii, start_up};
pub use isocat_diagnose as diagnose;
#[cfg(target_os = "linux")]
pub use isocat_engine::live;
pub use isocat_engine::{
    NoTap, Report, Scan, calibrate, catalog, diagnosis, explain, plan, recording, replay, report,
    run, scan, status, timeline,
};
#[cfg(target_os = "linux")]
pub use isocat_host as host;
pub use isocat_player as player;
pub use isocat_recorders::{capture, flight, ring, series, trace, waves};
pub use isocat_segment::{
    Scenario, SegmentFile, fault, keys, new_file, offline, profile, scenario, segment_file,
};
pub use isocat_serve as serve;
pub use isocat_wire::Nanos;
