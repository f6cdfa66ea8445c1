//! The report of a run on a real interface.
//!
//! True time is not known there. A figure was read from the SubDevice over the wire (`registers`),
//! was measured or counted by the MainDevice with its own clock (`main_device`, `punctuality`,
//! `machine`), or was computed before the run (`plan`).

mod build;
mod text;

use std::collections::BTreeMap;
use std::fmt;

pub use build::Asked;
use isocat_sync::SyncMode;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Serialize;

use super::quality::Quality;
use super::typed::{self, FigureDocument};
use super::{
    Counters, DeviceRegisters, Finding, PlanLine, SegmentMainDevice, SegmentPlan, ServiceNote, Span,
};
use crate::verdict::Answer;

/// Version of the document; it changes whenever a reader could be misled by an older schema.
pub const FORMAT: &str = "isocat-interface-report/7";

/// JSON schema of the document, draft 2020-12.
#[cfg(feature = "schema")]
pub fn schema() -> serde_json::Value {
    isocat_descriptions::schema::of::<InterfaceReport>(FORMAT)
}

/// The whole document. All times are nanoseconds of host time unless their name says otherwise.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct InterfaceReport {
    /// [`FORMAT`].
    pub format: &'static str,
    /// Version of the program.
    pub version: &'static str,
    /// Network interface.
    pub interface: String,
    /// Its network namespace; null for that of the program.
    pub namespace: Option<String>,
    /// File with the description of the expected segment; null if any segment was accepted.
    pub segment_file: Option<String>,
    /// Whether the answer is "in-sync".
    pub in_sync: bool,
    /// The result of all that is known of the time in operation: in-sync; except, if there are
    /// findings; not-known, if there are none and an entry of `unknown` decides.
    #[serde(serialize_with = "typed::text")]
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub answer: Answer,
    /// One sentence for people.
    pub verdict: String,
    /// Why it was not in sync, in the order of time; findings without a time come last.
    pub findings: Vec<Finding>,
    /// What is not known, and why; entries that leave the answer open come first.
    pub unknown: Vec<Unknown>,
    /// Departures and returns of SubDevices that may be absent.
    pub visits: Vec<Finding>,
    /// Facts that are no reason for the verdict but may explain it.
    pub notes: Vec<String>,
    /// Optional services that SubDevices answered badly, and what was used instead; they do not
    /// count against the segment.
    pub services: Vec<ServiceNote>,
    /// The reason for the end of the run: time, signal, bring-up, silence, interface.
    #[serde(serialize_with = "typed::text")]
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub ended_by: EndedBy,
    /// Bus cycle.
    pub cycle_ns: i64,
    /// Requested time, from the moment when all SubDevices were in OP.
    pub asked_ns: i64,
    /// Time in operation that was judged; 0 if it never began.
    pub judged_ns: i64,
    /// The machine before the run.
    pub machine: Machine,
    /// Punctuality of the machine in operation.
    pub punctuality: Punctuality,
    /// Counted or measured by the MainDevice, including the way up.
    pub main_device: SegmentMainDevice,
    /// Computed before the run; null if the run ended before that.
    pub plan: Option<SegmentPlan>,
    /// Results of the background reads; null if the segment file does not ask for them, or
    /// operation was not reached.
    pub quality: Option<Quality>,
    /// Figures of each SubDevice, by position.
    pub devices: Vec<InterfaceDevice>,
}

/// Something that is not known.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Unknown {
    /// Position of the SubDevice; null for the segment.
    pub position: Option<usize>,
    /// Its name.
    pub device: Option<String>,
    /// Whether it leaves the answer open; otherwise it is something that no wire shows, and changes
    /// no answer.
    pub decides: bool,
    /// Description in words.
    pub what: String,
    /// Short name of the kind, for programs. docs/verdict.md describes each.
    pub kind: &'static str,
    /// The figures of the kind by name; times are nanoseconds.
    #[cfg_attr(feature = "schema", schemars(schema_with = "typed::figures"))]
    pub figures: BTreeMap<String, FigureDocument>,
}

/// The reason for the end of a run on an interface.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum EndedBy {
    /// The requested time is over.
    Time,
    /// A signal.
    Signal,
    /// The way up failed.
    BringUp,
    /// No frame came back any more.
    Silence,
    /// The interface failed.
    Interface,
}

impl fmt::Display for EndedBy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Time => "time",
            Self::Signal => "signal",
            Self::BringUp => "bring-up",
            Self::Silence => "silence",
            Self::Interface => "interface",
        })
    }
}

/// The machine that the MainDevice runs on.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Machine {
    /// Real-time settings that were granted.
    pub granted: Vec<String>,
    /// Real-time settings that were refused, each with advice.
    pub refused: Vec<String>,
    /// Settings that are harmful.
    pub harms: Vec<Harm>,
    /// Lateness of sleeps that end at the beginning of a cycle, measured before the run.
    pub wake_up_lateness: Option<Series>,
}

/// A setting of the machine that harms a real-time loop.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Harm {
    /// The setting.
    pub what: String,
    /// Where the setting was read.
    pub source: String,
    /// What to change.
    pub advice: String,
}

/// Punctuality of the machine in operation.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Punctuality {
    /// Time when the first frame of a cycle was handed to the kernel, less its due time; null
    /// without cycles.
    pub send_lateness: Option<Series>,
    /// Lateness that the plan allows.
    pub jitter_ns: i64,
    /// Cycles that were later than that.
    pub beyond_jitter: u64,
    /// Time from handing a frame to the kernel until the kernel had it back; null if none came
    /// back.
    pub round_trip: Option<Series>,
    /// Skipped cycles.
    pub cycles_skipped: u64,
    /// Frames that did not come back.
    pub frames_lost: u64,
    /// Datagrams of process data with a wrong working counter.
    pub working_counter_errors: u64,
    /// EtherCAT frames that arrived and were not ours, or too late, including the way up.
    pub frames_foreign: u64,
    /// Of these, frames with another source address.
    pub frames_of_others: u64,
    /// How often the host lost its lock on the reference clock.
    pub locks_lost: u64,
    /// Whether it was locked at the end; null without clocks.
    pub locked: Option<bool>,
}

/// A series of spans with its distribution.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Series {
    /// Count, mean, deviation, least and largest.
    pub span: Span,
    /// Half of the values do not exceed it, to one part in eight.
    pub p50_ns: i64,
    /// 99 % of the values do not exceed it, to one part in eight.
    pub p99_ns: i64,
    /// Counts by size; empty sizes are left out.
    pub buckets: Vec<Bucket>,
}

/// Values of a series of about one size.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Bucket {
    /// Upper limit of its values, which exceed the limit of the bucket before; null for the rest.
    pub up_to_ns: Option<i64>,
    /// Number of values, to one part in eight at the edge.
    pub count: u64,
}

/// Figures of one SubDevice.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct InterfaceDevice {
    /// Place in processing order, from 0.
    pub position: usize,
    /// Name in the segment file, or else in its SII.
    pub name: String,
    /// Vendor id in its SII.
    pub vendor_id: u32,
    /// Product code in its SII.
    pub product_code: u32,
    /// Revision number in its SII.
    pub revision: u32,
    /// Serial number in its SII.
    pub serial: u32,
    /// Synchronization mode: free-run, sm, dc-sync0.
    #[serde(serialize_with = "typed::text")]
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub mode: SyncMode,
    /// Why no higher mode is used; empty if this is the requested or the highest one.
    pub mode_reason: String,
    /// Registers read over the wire at the end, including 0x092C; if the way up failed, as last
    /// read. A state that could not be read at the end is "unknown".
    pub registers: DeviceRegisters,
    /// Counters of 0x1C32 at the beginning of the time in operation.
    pub output_counters_before: Counters,
    /// Counters of 0x1C33 at the beginning of the time in operation.
    pub input_counters_before: Counters,
    /// Lines of the timing budget.
    pub plan: Vec<PlanLine>,
    /// Its process data, as seen by the MainDevice's application.
    pub application: String,
}
