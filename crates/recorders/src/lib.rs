//! What a simulated segment did, as files that other people's tools read.
//!
//! Each recorder is an [`isocat_sim::Tap`]: [`capture`] writes frames (pcapng), [`waves`] the signals of each SubDevice (VCD),
//! [`trace`] its events on a time line (Perfetto), [`series`] one row a cycle and SubDevice (CSV, Parquet). None knows a plan, a report
//! or another recorder. The way back, frames out of anybody's
//! capture, is `isocat-captures`.
//!
//! [`flight`] is for wires as well: it keeps the last seconds of frames ([`ring`]) and writes them
//! when something happens.
#![forbid(unsafe_code)]

pub mod capture;
pub mod flight;
pub mod parquet;
pub mod ring;
pub mod series;
pub mod trace;
pub mod waves;
