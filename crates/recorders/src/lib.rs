//! Writes what a simulated segment did to files for other tools.
//!
//! Each recorder is an [`isocat_sim::Tap`]: [`capture`] writes frames (pcapng), [`waves`] the
//! signals of each SubDevice (VCD), [`trace`] its events on a time line (Perfetto), [`series`] one
//! row for each cycle and SubDevice (CSV, Parquet). No recorder knows a plan, a report or another
//! recorder. `isocat-captures` is the way back: it reads frames from captures.
//!
//! [`flight`] also works on real wires: it keeps the last seconds of frames ([`ring`]) and writes
//! them to a file when something happens.
#![forbid(unsafe_code)]

pub mod capture;
pub mod flight;
pub mod parquet;
pub mod ring;
pub mod series;
pub mod trace;
pub mod waves;
