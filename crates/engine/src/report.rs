//! The report of a run: one document, for people and for machines.
//!
//! The origin of every figure is known: `true_time` was measured by the simulation's judges in true
//! time, `registers` was read from the SubDevice over the wire, `main_device` is what the
//! MainDevice measured or counted with its own clock, `plan` was computed before the run.

pub mod age;
pub mod alike;
mod build;
pub mod calibrate;
mod expected;
#[cfg(target_os = "linux")]
pub mod interface;
mod note;
pub mod op_mode;
pub mod plant;
pub mod quality;
pub mod samples;
pub mod scan;
mod services;
pub mod settling;
mod text;
pub mod times;
pub mod typed;
pub mod words;

pub use build::{span, spread};
pub use expected::{Expected, FaultNote, write_expected};
use isocat_maindevice::Stage;
use isocat_segment::profile::Doubt;
use isocat_segment::{Scenario, segment_file};
use isocat_sim::Kind;
use isocat_sync::SyncMode;
use isocat_wire::AlState;
pub use note::NoteKind;
pub use op_mode::OpMode;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Serialize;
pub use services::ServiceNote;
pub(crate) use text::{BAD, GOOD, QUIET};

use crate::diagnosis::Diagnosis;
#[cfg(feature = "schema")]
use typed::KindDocument;
use typed::StateRead;

/// Version of the document; it changes whenever a reader could be misled by an older schema.
pub const FORMAT: &str = "isocat-run-report/9";

/// JSON schema of the document, draft 2020-12.
#[cfg(feature = "schema")]
pub fn schema() -> serde_json::Value {
    isocat_descriptions::schema::of::<Report>(FORMAT)
}

/// The whole document. All times are nanoseconds unless their name says otherwise.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Report {
    /// [`FORMAT`].
    pub format: &'static str,
    /// Version of the program.
    pub version: &'static str,
    /// File with the description of the segment.
    pub segment_file: String,
    /// Seed of all randomness; it makes the run repeatable.
    pub seed: u64,
    /// Whether every SubDevice ran as asked.
    pub in_sync: bool,
    /// One sentence for people.
    pub verdict: String,
    /// The expectations, and whether they were met; empty if the segment file has none.
    pub expected: Vec<Expected>,
    /// Injected faults, in the order of time; of very many only the last.
    pub faults: Vec<FaultNote>,
    /// Why it was not in sync, in the order of time; findings without a time come last.
    pub findings: Vec<Finding>,
    /// Causes and remedies, those with a cause first; empty in sync, and in a report of a sweep,
    /// which records nothing.
    pub diagnoses: Vec<Diagnosis>,
    /// Departures and returns of SubDevices that may be absent; they do not count against the
    /// segment.
    pub visits: Vec<Finding>,
    /// Optional services that SubDevices answered badly, and what was used instead; they do not
    /// count against the segment.
    pub services: Vec<ServiceNote>,
    /// Bus cycle.
    pub cycle_ns: i64,
    /// Virtual time that was judged, from the moment when all SubDevices were in OP.
    pub judged_ns: i64,
    /// Figures of the segment.
    pub segment: Segment,
    /// Results of the background reads; null if the segment file does not ask for them, or
    /// operation was not reached.
    pub quality: Option<quality::Quality>,
    /// Effects of late outputs on the machines of the segment file; null if it has none.
    pub plants: Option<plant::Plants>,
    /// Figures of each SubDevice, by position.
    pub devices: Vec<Device>,
}

impl Report {
    /// Whether the run was as expected: all expectations were met, or without expectations it was
    /// in sync.
    pub fn as_expected(&self) -> bool {
        match &self.expected[..] {
            [] => self.in_sync,
            all => all.iter().all(|one| one.met),
        }
    }
}

/// Something worth knowing, in plans and scans.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Note {
    /// Position of the SubDevice; null for the segment.
    pub position: Option<usize>,
    /// Its name.
    pub device: Option<String>,
    /// Short name of the kind, for programs.
    #[serde(serialize_with = "typed::text")]
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub kind: NoteKind,
    /// Description, with the figures.
    pub what: String,
}

/// Something that keeps the segment from being in sync.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Finding {
    /// Position of the SubDevice; null for the segment.
    pub position: Option<usize>,
    /// Its name.
    pub device: Option<String>,
    /// Stage of the way up at which it happened; null in operation.
    #[serde(serialize_with = "typed::some_text")]
    #[cfg_attr(feature = "schema", schemars(with = "Option<String>"))]
    pub stage: Option<Stage>,
    /// Its time from the beginning of the judged time; null if it exists from that beginning.
    pub since_ns: Option<i64>,
    /// Description, with the figures: a sentence for people, which may change.
    pub what: String,
    /// Description for programs.
    #[serde(flatten, serialize_with = "typed::kind")]
    #[cfg_attr(feature = "schema", schemars(with = "KindDocument"))]
    pub kind: Kind,
}

/// The cable that closes a ring: it leads to the secondary port of the MainDevice.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Ring {
    /// Position of the SubDevice at its other end.
    pub position: usize,
    /// The port of that SubDevice.
    pub port: u8,
    /// Length of the cable.
    pub cable_mm: i64,
}

impl Ring {
    pub(crate) fn of(scenario: &Scenario) -> Option<Self> {
        let segment_file::Ring { device, port, cable } = scenario.ring?;
        Some(Self { position: device, port: port.index() as u8, cable_mm: cable.0 })
    }
}

/// Figures of the segment.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Segment {
    /// The cable that closes a ring; null if the segment hangs on one port.
    pub ring: Option<Ring>,
    /// In a ring, copies of frames that did not come back, as counted by the MainDevice: each frame
    /// leaves as two copies.
    pub copies_lost: u64,
    /// Measured by the judges.
    pub true_time: SegmentTrueTime,
    /// Counted or measured by the MainDevice.
    pub main_device: SegmentMainDevice,
    /// Computed before the run; null if the run ended before that.
    pub plan: Option<SegmentPlan>,
}

/// The segment in true time.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct SegmentTrueTime {
    /// Time from power-on until all SubDevices were in OP and SYNC0 was on its grid; null if that
    /// never happened.
    pub time_to_synchronization_ns: Option<i64>,
    /// What was left of the clocks' phase when operation was reached, and how it went: SYNC0 edges
    /// against the ideal grid of the reference clock; null without SYNC0.
    pub settling: Option<settling::Settling>,
    /// Arrival of cyclic frames at the reference clock, less their due time.
    pub host_phase_error: Option<Spread>,
    /// Time from the first to the last SubDevice in DC mode whose outputs became valid, cycle by
    /// cycle; null with fewer than two.
    pub outputs_valid_spread: Option<Span>,
}

/// The segment as seen by the MainDevice.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct SegmentMainDevice {
    /// Position of the SubDevice whose clock leads; null without clocks.
    pub reference: Option<usize>,
    /// Frames until all SubDevices were in OP, or until the way up failed.
    pub bring_up_frames: u64,
    /// Of these, frames that distributed the system time to make the clocks converge.
    pub drift_frames: u64,
    /// The largest 0x092C when the clocks counted as converged, or later when one joined; null
    /// without readings.
    pub difference_at_lock: Option<settling::Difference>,
    /// All frames sent.
    pub frames_sent: u64,
    /// Frames that did not come back.
    pub frames_lost: u64,
    /// Process data cycles.
    pub cycles: u64,
    /// Datagrams of process data with a wrong working counter.
    pub working_counter_errors: u64,
    /// Phase error of the servo, by the time stamps in the frames.
    pub host_phase_error: Option<Spread>,
    /// How much faster the reference clock runs than the host's, parts per billion.
    pub reference_rate_ppb: Option<i64>,
    /// Standard error of that rate, from the deviations of the samples from the servo's line;
    /// rounded up.
    pub reference_rate_error_ppb: Option<i64>,
    /// Standard error of the reference clock's phase in the servo; rounded up. It does not include
    /// what no sample shows: the constant time from stamp to wire.
    pub reference_phase_error_ns: Option<i64>,
}

/// Figures of the plan for the segment.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct SegmentPlan {
    /// Phase of the frame in the system-time cycle.
    pub send_phase_ns: i64,
    /// Phase of SYNC0; null if no SubDevice uses it.
    pub sync0_phase_ns: Option<i64>,
    /// Largest lateness of a frame in the plan.
    pub jitter_ns: i64,
}

/// Figures of one SubDevice.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Device {
    /// Place in processing order, from 0.
    pub position: usize,
    /// Name in the segment file.
    pub name: String,
    /// Profile.
    pub profile: String,
    /// Line of the segment file at which its table begins; with `count` that of several.
    pub line: usize,
    /// Synchronization mode: free-run, sm, dc-sync0.
    #[serde(serialize_with = "typed::text")]
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub mode: SyncMode,
    /// The OpMode of its description; null for a device without.
    pub op_mode: Option<OpMode>,
    /// Why no higher mode is used; empty if this is the requested or the highest one.
    pub mode_reason: String,
    /// Cycle of its work: SYNC0, bus or its own timer; null if no source states it.
    pub cycle_ns: Option<i64>,
    /// Measured by the judges.
    pub true_time: DeviceTrueTime,
    /// Read over the wire.
    pub registers: DeviceRegisters,
    /// Lines of the timing budget.
    pub plan: Vec<PlanLine>,
    /// Its process data, as seen by the MainDevice's application.
    pub application: String,
    /// Values that its maker does not publish.
    pub assumptions: Vec<Assumption>,
}

impl Device {
    /// Its position with its OpMode, if it has one.
    fn placed_op_mode(&self) -> Option<(usize, &OpMode)> {
        Some((self.position, self.op_mode.as_ref()?))
    }
}

/// One SubDevice in true time.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct DeviceTrueTime {
    /// The constant deviation of its oscillator.
    pub clock: Oscillator,
    /// SYNC0 edges against the ideal grid of the reference clock; null without SYNC0.
    pub sync0_error: Option<Spread>,
    /// Time from the SM2 event to the next SYNC0, also if outputs act at SYNC1.
    pub sm2_to_sync0: Option<Span>,
    /// Time from the end of copying and calculating to the pulse at which outputs act, SYNC0 or
    /// SYNC1: the remaining slack; negative if the pulse came first.
    pub sync0_margin: Option<Span>,
    /// Time from the pulse at which outputs act, SYNC0 or SYNC1, to valid outputs.
    pub outputs_delay: Option<Span>,
    /// Age of outputs at their first effect, from the first bit of their frame at the MainDevice;
    /// null without outputs.
    pub outputs_age: Option<Span>,
    /// Frames whose outputs acted a whole cycle or more too late.
    pub outputs_late: u64,
    /// Age of inputs on arrival: from Input Latch to the last bit, back at the MainDevice, of the
    /// first frame with these inputs; null without inputs.
    pub inputs_age: Option<Span>,
    /// Inputs that arrived a whole cycle or more later than with the first possible frame.
    pub inputs_late: u64,
    /// Samples of its inputs; null unless it oversamples inputs.
    pub input_samples: Option<samples::Samples>,
    /// Samples of its outputs; null unless it oversamples outputs.
    pub output_samples: Option<samples::Samples>,
    /// SYNC0 edges that came while no outputs were ready.
    pub missed_events: u64,
    /// Highest value of 0x1C32:0B.
    pub highest_missed_counter: u16,
    /// State at the end of the judged time.
    #[serde(serialize_with = "typed::text")]
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub state: AlState,
}

/// Deviation of a simulated oscillator.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Oscillator {
    /// Frequency deviation from true time, parts per billion (positive: faster).
    pub deviation_ppb: i64,
    /// Largest deviation in either direction that the seed could draw, parts per billion; null if
    /// the segment file states the value.
    pub drawn_within_ppb: Option<i64>,
}

/// One SubDevice according to its registers and objects.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct DeviceRegisters {
    /// AL status, 0x0130.
    #[serde(serialize_with = "typed::text")]
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub al_status: StateRead,
    /// AL status code, 0x0134.
    pub al_status_code: u16,
    /// Propagation delay, 0x0928; null without clock.
    pub delay_ns: Option<i64>,
    /// Half the width of the interval around it that holds the true delay with a confidence of 95
    /// %, whole ns. It covers quantization and noise of the measurement, and unknown delays of the
    /// chips; null if it was not measured.
    pub delay_error_ns: Option<i64>,
    /// Why the receive times do not determine the delay although there is a clock; 0x0928 then
    /// holds the middle of the possible values. Null otherwise.
    pub delay_unknown: Option<String>,
    /// Times that the SubDevice measured itself on the way up; null if it was not asked to.
    pub measured_times: Option<times::MeasuredTimes>,
    /// System time difference, 0x092C, at the end of the drift phase; null without clock.
    pub system_time_difference_ns: Option<i64>,
    /// 0x1C32:01; null without the object.
    pub output_sync_type: Option<u16>,
    /// 0x1C33:01; null without the object.
    pub input_sync_type: Option<u16>,
    /// Counters of 0x1C32.
    pub output_counters: Counters,
    /// Counters of 0x1C33.
    pub input_counters: Counters,
}

/// Sub-indices 0B, 0C, 0D and 20; null if the SubDevice does not have them.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Counters {
    /// 0B.
    pub sm_event_missed: Option<u32>,
    /// 0C.
    pub cycle_time_too_small: Option<u32>,
    /// 0D.
    pub shift_time_too_short: Option<u32>,
    /// 20.
    pub sync_error: Option<u32>,
}

/// A series of spans in ns, rounded to the picosecond.
#[derive(Clone, Copy, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Span {
    /// Values.
    pub count: u64,
    /// Mean.
    pub mean_ns: f64,
    /// Standard deviation.
    pub standard_deviation_ns: f64,
    /// Least.
    pub min_ns: f64,
    /// Largest.
    pub max_ns: f64,
}

/// A series of errors in ns whose ideal value is zero, rounded to the picosecond.
#[derive(Clone, Copy, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Spread {
    /// Values.
    pub count: u64,
    /// Mean.
    pub mean_ns: f64,
    /// Standard deviation.
    pub standard_deviation_ns: f64,
    /// Least.
    pub min_ns: f64,
    /// Largest.
    pub max_ns: f64,
    /// Value farthest from zero, without its sign.
    pub worst_ns: f64,
}

impl Spread {
    /// The same series as spans, whose ideal value need not be zero.
    pub fn span(&self) -> Span {
        let Spread { count, mean_ns, standard_deviation_ns, min_ns, max_ns, .. } = *self;
        Span { count, mean_ns, standard_deviation_ns, min_ns, max_ns }
    }
}

/// One line of a SubDevice's timing budget.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct PlanLine {
    /// The object that states the demand.
    pub object: String,
    /// The demand in words.
    pub demand: String,
    /// Time needed.
    pub needed_ns: i64,
    /// Time available.
    pub available_ns: i64,
    /// Time left; negative if it does not fit.
    pub slack_ns: i64,
}

/// A value that a device's maker does not publish, or a doubt about its ESI file.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Assumption {
    /// Object or key.
    pub item: String,
    /// Assumed value.
    pub value: String,
    /// Reason.
    pub why: String,
    /// Name of the doubt, if it is one about the description.
    #[serde(skip)]
    #[cfg_attr(feature = "schema", schemars(skip))]
    pub doubt: Option<&'static str>,
}

/// A doubt about an ESI file.
impl From<&Doubt> for Assumption {
    fn from(doubt: &Doubt) -> Self {
        let item = format!("description: {}", doubt.kind);
        let why = doubt.what.clone();
        Self { item, value: String::new(), why, doubt: Some(doubt.kind.name()) }
    }
}
