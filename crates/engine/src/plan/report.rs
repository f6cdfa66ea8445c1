//! The plan as a document. All times are nanoseconds; phases count from the frame at the reference
//! clock.

use isocat_sync::SyncMode;
use isocat_sync::budget::Check;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Serialize;

use super::what_if::WhatIf;
pub use crate::report::Note;
use crate::report::settling::Settling;
use crate::report::{OpMode, Ring, typed};

/// Version of the document; it changes whenever a reader could be misled by an older schema.
pub const FORMAT: &str = "isocat-plan/3";

/// JSON schema of the document, draft 2020-12.
#[cfg(feature = "schema")]
pub fn schema() -> serde_json::Value {
    isocat_descriptions::schema::of::<PlanReport>(FORMAT)
}

/// The whole document.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct PlanReport {
    /// [`FORMAT`].
    pub format: &'static str,
    /// Version of the program.
    pub version: &'static str,
    /// File with the description of the segment.
    pub segment_file: String,
    /// Whether every line has slack of 0 or more.
    pub fits: bool,
    /// One sentence for people.
    pub verdict: String,
    /// Figures of the lines that no source states.
    pub assumptions: Vec<String>,
    /// Known pitfalls of such a segment in practice.
    pub warnings: Vec<Note>,
    /// Figures of the segment.
    pub segment: Segment,
    /// The frames of the fullest cycle.
    pub frames: Vec<Frame>,
    /// The demand of the frames.
    pub frames_line: Line,
    /// The SubDevices, by position.
    pub devices: Vec<Device>,
    /// Suggested changes; null unless asked for.
    pub suggestion: Option<Suggestion>,
    /// Results of a run; null unless asked for.
    pub proof: Option<ProofSummary>,
    /// Effects of the loss of each cable and SubDevice; null unless asked for.
    pub what_if: Option<WhatIf>,
}

/// Figures of the segment.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Segment {
    /// Bus cycle.
    pub cycle_ns: i64,
    /// The cable that closes a ring: the plan includes frames that take the long way after a cut.
    /// Null if the segment hangs on one port.
    pub ring: Option<Ring>,
    /// Position of the SubDevice whose clock leads; null without clocks.
    pub reference: Option<usize>,
    /// Phase of the frame in the system-time cycle.
    pub send_phase_ns: i64,
    /// Largest lateness of a frame.
    pub send_jitter_ns: i64,
    /// Largest difference of two clocks.
    pub clock_error_ns: i64,
    /// Phase of the pulse at which outputs act, the same for all SubDevices with DC; null without.
    pub acting_phase_ns: Option<i64>,
    /// Its earliest phase, at which all outputs are ready. Null if no SubDevice has outputs.
    pub output_reference_ns: Option<i64>,
    /// Its latest phase, at which all inputs are in time for the next frame. Null if no SubDevice
    /// has inputs.
    pub input_reference_ns: Option<i64>,
    /// Least slack of all lines of the cycle, or of all lines if one does not fit.
    pub least_slack_ns: i64,
}

/// A frame of the cycle. Times count from the first bit of the first one, in the fullest cycle.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Frame {
    /// It is sent in the bus cycles whose number (system time divided by the bus cycle) is a
    /// multiple of this.
    pub every: u32,
    /// How much earlier it is in cycles without the frames of other groups before it.
    pub spread_ns: i64,
    /// First bit of the preamble.
    pub begin_ns: i64,
    /// Last bit of the check sequence.
    pub end_ns: i64,
    /// Bytes from the destination address to the padding.
    pub bytes: usize,
    /// Its datagrams.
    pub datagrams: Vec<Datagram>,
}

/// A datagram of a frame.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Datagram {
    /// Command, in its usual letters.
    pub command: String,
    /// Address.
    pub address: String,
    /// Bytes of data.
    pub bytes: usize,
    /// First byte of its data on the wire.
    pub begin_ns: i64,
    /// End of the last byte of its data on the wire.
    pub end_ns: i64,
    /// First and last position of the SubDevices whose process data it carries (of those between,
    /// only the ones that are exchanged equally often); null for other datagrams.
    pub devices: Option<[usize; 2]>,
}

/// A SubDevice.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Device {
    /// Place in processing order, from 0.
    pub position: usize,
    /// Name in the segment file.
    pub name: String,
    /// Profile.
    pub profile: String,
    /// How its ESI file was read, and what is doubtful in it; empty for a profile.
    pub description: Vec<Doubt>,
    /// Synchronization mode.
    #[serde(serialize_with = "typed::text")]
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub mode: SyncMode,
    /// The OpMode of its description; null for a device without.
    pub op_mode: Option<OpMode>,
    /// Why no higher mode is used; empty if this is the requested or the highest one.
    pub mode_reason: String,
    /// Propagation delay from the reference clock.
    pub delay_ns: i64,
    /// Its process data are exchanged in every n-th bus cycle.
    pub every: u32,
    /// Register 0x09A0; null without SYNC.
    pub sync0_cycle_ns: Option<i64>,
    /// Phase of SYNC0 in its cycle; null without.
    pub sync0_phase_ns: Option<i64>,
    /// Register 0x09A4; null without SYNC1.
    pub sync1_ns: Option<i64>,
    /// Time from a SYNC pulse until its program acknowledges it, in acknowledge mode (0x0982 is 0);
    /// null if pulses end by themselves, and without DC.
    pub acknowledge_ns: Option<i64>,
    /// Earliest phase of the acting pulse with regard to its outputs; null without DC or outputs.
    pub earliest_phase_ns: Option<i64>,
    /// Latest phase of the acting pulse with regard to its inputs; null without DC or inputs.
    pub latest_phase_ns: Option<i64>,
    /// The events of its cycle.
    pub moments: Vec<Moment>,
    /// Its demands on the cycle.
    pub lines: Vec<Line>,
}

impl Device {
    /// Its position with its OpMode, if it has one.
    pub(super) fn placed_op_mode(&self) -> Option<(usize, &OpMode)> {
        Some((self.position, self.op_mode.as_ref()?))
    }

    /// Its line of the cycle with the least slack; where a line does not fit, the one that lacks
    /// most.
    pub fn tightest(&self) -> Option<&Line> {
        let counts = |line: &&Line| line.check.is_of_cycle() || line.slack_ns < 0;
        self.lines.iter().filter(counts).min_by_key(|line| line.slack_ns)
    }
}

/// Something that could be read in more than one way, and how it was read.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Doubt {
    /// Its fixed name, for programs: `revision`, `opmode`, `sync-off` …
    pub kind: String,
    /// Description, with the figures.
    pub what: String,
}

impl From<&isocat_segment::profile::Doubt> for Doubt {
    fn from(doubt: &isocat_segment::profile::Doubt) -> Self {
        Self { kind: doubt.kind.name().to_owned(), what: doubt.what.clone() }
    }
}

/// An event of the cycle in which the frame is sent, in the reference clock's time from the begin
/// of that bus cycle.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Moment {
    /// The event.
    #[serde(serialize_with = "typed::text")]
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub event: isocat_sync::Moment,
    /// Earliest time.
    pub earliest_ns: i64,
    /// Latest time.
    pub latest_ns: i64,
    /// Measured times; null without a proof.
    pub measured: Option<Seen>,
}

/// Times of an event in a run, in true time.
#[derive(Clone, Copy, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Seen {
    /// Number of occurrences.
    pub count: u64,
    /// The earliest time.
    pub earliest_ns: f64,
    /// The latest time.
    pub latest_ns: f64,
}

/// One line of the budget.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Line {
    /// Short name of the demand, for programs.
    #[serde(serialize_with = "typed::check")]
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub check: Check,
    /// The object that states it; null if none does.
    pub object: Option<String>,
    /// The formula in words.
    pub demand: &'static str,
    /// Time needed.
    pub needed_ns: i64,
    /// Time available.
    pub available_ns: i64,
    /// Time left; negative if it does not fit.
    pub slack_ns: i64,
    /// The figures of the time needed.
    pub needed: Vec<Term>,
    /// The figures of the time available.
    pub available: Vec<Term>,
    /// The sign of a violation.
    pub sign: String,
    /// The worst case of a run in true time; null without a proof, and if nothing can be observed.
    pub measured: Option<Measured>,
}

/// One figure of a line, with its sign.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Term {
    /// Name of the figure.
    pub what: &'static str,
    /// Value.
    pub value_ns: i64,
    /// Its origin: wire, asked for, plan, profile, chip, ESI, measured, computed, assumed, or the
    /// object and whether the device measured it.
    pub origin: String,
}

/// The worst case of one line in a run, in true time.
#[derive(Clone, Copy, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Measured {
    /// Number of observations.
    pub count: u64,
    /// Largest time that was needed.
    pub needed_ns: f64,
    /// Least slack.
    pub slack_ns: f64,
    /// Time needed as a share of the bound: above 1 the bound does not hold.
    pub of_bound: f64,
}

/// Suggested changes.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Suggestion {
    /// Whether a line fails at this phase too, and so at any phase: then the phase is not the
    /// reason.
    pub no_shift_helps: bool,
    /// Phase of the acting pulse after the frame with the most even slack; null without DC.
    pub shift_ns: Option<i64>,
    /// The same as the phase of the frame, with the acting pulse at 0; null without DC.
    pub send_phase_ns: Option<i64>,
    /// Least slack of the lines that depend on the phase, with that phase; null without DC.
    pub slack_ns: Option<i64>,
    /// Shift of Outputs Valid with which all outputs that can be shifted act together with the
    /// slowest; null if there is nothing to shift.
    pub outputs_shift_ns: Option<i64>,
    /// Positions of the SubDevices whose outputs can be shifted.
    pub outputs_shiftable: Vec<usize>,
    /// The smallest cycle that fits, with all other settings unchanged but for the next two; null
    /// if none of those tried fits.
    pub smallest_cycle_ns: Option<i64>,
    /// Cycles of the SubDevices slower than the bus at that cycle: they keep their ratio to it.
    pub own_cycles: Vec<OwnCycle>,
    /// Whether the segment file has a shift, which that cycle leaves to the plan.
    pub drops_shift: bool,
    /// The cycles that were tried; null if there is none that all SubDevices take.
    pub cycles: Option<TriedCycles>,
}

/// The cycle of a SubDevice that is slower than the bus.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct OwnCycle {
    /// Place in processing order, from 0.
    pub position: usize,
    /// Its cycle.
    pub cycle_ns: i64,
}

/// Cycles that were tried: multiples of a step within a range, which SubDevices may narrow.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct TriedCycles {
    /// Every one is a multiple of this.
    pub step_ns: i64,
    /// The shortest.
    pub least_ns: i64,
    /// The longest, at most 1 s.
    pub most_ns: i64,
}

/// Results of a run.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct ProofSummary {
    /// Seed of all randomness.
    pub seed: u64,
    /// Virtual time from the beginning of operation.
    pub judged_ns: i64,
    /// Whether the plan fits, no line and no event exceeded its bound, and nothing else was wrong.
    pub holds: bool,
    /// A bound is tight if the time that was needed, plus twice the clock error, is at least the
    /// bound divided by this.
    pub factor: f64,
    /// Number of lines whose bound is not that tight: their figures are stated by the device, which
    /// does not need that much.
    pub loose: usize,
    /// What was left of the clocks' phase when operation was reached, and how it went in true time:
    /// SYNC0 edges against the ideal grid of the reference clock; null without SYNC0.
    pub settling: Option<Settling>,
    /// Bounds that were exceeded, and findings of the run's judges.
    pub findings: Vec<String>,
}
