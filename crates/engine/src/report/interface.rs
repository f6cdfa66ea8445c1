//! What a run on a real interface says of itself.
//!
//! Nobody there knows true time: a figure was read from the SubDevice over the wire (`registers`), is what
//! the MainDevice measured or counted with its own clock (`main_device`, `punctuality`, `machine`), or was
//! computed before the run (`plan`).

mod build;
mod text;

use std::fmt;

pub use build::Asked;
use isocat_sync::SyncMode;
use schemars::JsonSchema;
use serde::Serialize;

use super::quality::Quality;
use super::typed;
use super::{
    Counters, DeviceRegisters, Finding, PlanLine, SegmentMainDevice, SegmentPlan, ServiceNote, Span,
};

/// Version of the document; changes whenever a reader could be misled by an older schema.
pub const FORMAT: &str = "isocat-interface-report/5";

/// JSON schema of the document, draft 2020-12.
pub fn schema() -> serde_json::Value {
    super::schema_of::<InterfaceReport>()
}

/// The whole document. All times are nanoseconds of host time unless their name says otherwise.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct InterfaceReport {
    /// [`FORMAT`].
    pub format: &'static str,
    /// Version of the program.
    pub version: &'static str,
    /// Network interface.
    pub interface: String,
    /// Its network namespace; null: that of the program.
    pub namespace: Option<String>,
    /// Where the expected segment was described; null: whatever was there was taken.
    pub segment_file: Option<String>,
    /// Whether every SubDevice ran as it was asked to, by what was read from it.
    pub in_sync: bool,
    /// One sentence for people.
    pub verdict: String,
    /// Why not, in the order of time; what has no time of its own comes last.
    pub findings: Vec<Finding>,
    /// What is no reason for the verdict but may explain it.
    pub notes: Vec<String>,
    /// Optional services that SubDevices answered badly, and what was taken instead; nothing against the segment.
    pub services: Vec<ServiceNote>,
    /// What ended the run: time, signal, bring-up, silence, interface.
    #[serde(serialize_with = "typed::text")]
    #[schemars(with = "String")]
    pub ended_by: EndedBy,
    /// Bus cycle.
    pub cycle_ns: i64,
    /// Time that was asked for, from the moment when all SubDevices were in OP.
    pub asked_ns: i64,
    /// Time in operation that was judged; 0 if it never began.
    pub judged_ns: i64,
    /// The machine before the run.
    pub machine: Machine,
    /// How punctual the machine was in operation.
    pub punctuality: Punctuality,
    /// Counted or measured by the MainDevice, the way up included.
    pub main_device: SegmentMainDevice,
    /// Computed before the run; null if the run did not come so far.
    pub plan: Option<SegmentPlan>,
    /// What was read in the background; null if the segment file does not ask for it, or operation was not reached.
    pub quality: Option<Quality>,
    /// Figures of each SubDevice, by position.
    pub devices: Vec<InterfaceDevice>,
}

/// What ended a run on an interface.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum EndedBy {
    /// The time that was asked for is over.
    Time,
    /// A signal.
    Signal,
    /// The way up failed.
    BringUp,
    /// Nothing came back any more.
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
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Machine {
    /// What was granted for real time.
    pub granted: Vec<String>,
    /// What was refused, each with what to do about it.
    pub refused: Vec<String>,
    /// Settings that harm.
    pub harms: Vec<Harm>,
    /// Lateness of sleeps that end at the beginning of a cycle, measured before the run.
    pub wake_up_lateness: Option<Series>,
}

/// A setting of the machine that harms a real-time loop.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Harm {
    /// What.
    pub what: String,
    /// Where it was read.
    pub source: String,
    /// What to do about it.
    pub advice: String,
}

/// How punctual the machine was in operation.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Punctuality {
    /// When the first frame of a cycle was handed to the kernel, less when it was due; null without cycles.
    pub send_lateness: Option<Series>,
    /// Lateness that the plan keeps free.
    pub jitter_ns: i64,
    /// Cycles that were later than that.
    pub beyond_jitter: u64,
    /// From handing a frame to the kernel until the kernel had it back; null if none came back.
    pub round_trip: Option<Series>,
    /// Cycles left out.
    pub cycles_skipped: u64,
    /// Frames that did not come back.
    pub frames_lost: u64,
    /// Datagrams of process data with a wrong working counter.
    pub working_counter_errors: u64,
    /// EtherCAT frames that came in and were not ours, or came too late, the way up included.
    pub frames_foreign: u64,
    /// Of these, frames with another source address.
    pub frames_of_others: u64,
    /// How often the host lost its lock on the reference clock.
    pub locks_lost: u64,
    /// Whether it was locked at the end; null without clocks.
    pub locked: Option<bool>,
}

/// A series of spans with its distribution.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
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
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Bucket {
    /// They do not exceed this and exceed the bucket before; null: the rest.
    pub up_to_ns: Option<i64>,
    /// How many, to one part in eight at the edge.
    pub count: u64,
}

/// Figures of one SubDevice.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct InterfaceDevice {
    /// Place in processing order, from 0.
    pub position: usize,
    /// Name in the segment file, else in its SII.
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
    #[schemars(with = "String")]
    pub mode: SyncMode,
    /// Why not a higher mode; empty if this is the one asked for or the highest.
    pub mode_reason: String,
    /// Read over the wire at the end, 0x092C too; of a way up that failed, as last read. A state that could not be read
    /// at the end is "unknown".
    pub registers: DeviceRegisters,
    /// Counters of 0x1C32 when the time in operation began.
    pub output_counters_before: Counters,
    /// Counters of 0x1C33 when the time in operation began.
    pub input_counters_before: Counters,
    /// Lines of the timing budget.
    pub plan: Vec<PlanLine>,
    /// Its process data, as the MainDevice's application sees them.
    pub application: String,
}
