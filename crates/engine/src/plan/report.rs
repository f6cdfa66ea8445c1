//! The plan as a document. All times are nanoseconds; phases count from the frame at the reference clock.

use isocat_sync::SyncMode;
use isocat_sync::budget::Check;
use schemars::JsonSchema;
use serde::Serialize;

use super::what_if::WhatIf;
pub use crate::report::Note;
use crate::report::{Ring, typed};

/// Version of the document; changes whenever a reader could be misled by an older schema.
pub const FORMAT: &str = "isocat-plan/3";

/// JSON schema of the document, draft 2020-12.
pub fn schema() -> serde_json::Value {
    crate::report::schema_of::<PlanReport>()
}

/// The whole document.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct PlanReport {
    /// [`FORMAT`].
    pub format: &'static str,
    /// Version of the program.
    pub version: &'static str,
    /// Where the segment was described.
    pub segment_file: String,
    /// Whether every line has slack of 0 or more.
    pub fits: bool,
    /// One sentence for people.
    pub verdict: String,
    /// Figures that count in a line and that nobody states.
    pub assumptions: Vec<String>,
    /// What the field falls into with such a segment.
    pub warnings: Vec<Note>,
    /// Figures of the segment.
    pub segment: Segment,
    /// The frames of the fullest cycle.
    pub frames: Vec<Frame>,
    /// The demand of the frames.
    pub frames_line: Line,
    /// The SubDevices, by position.
    pub devices: Vec<Device>,
    /// What fits better; null unless it was asked for.
    pub suggestion: Option<Suggestion>,
    /// What a run showed; null unless it was asked for.
    pub proof: Option<ProofSummary>,
    /// What becomes of the segment when a cable or a SubDevice goes; null unless it was asked for.
    pub what_if: Option<WhatIf>,
}

/// Figures of the segment.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Segment {
    /// Bus cycle.
    pub cycle_ns: i64,
    /// What makes a ring of it: the plan counts with frames that go the long way behind a cut. Null if it hangs on one port.
    pub ring: Option<Ring>,
    /// Position of the SubDevice whose clock leads; null without clocks.
    pub reference: Option<usize>,
    /// Phase of the frame in the system-time cycle.
    pub send_phase_ns: i64,
    /// How late a frame may be.
    pub send_jitter_ns: i64,
    /// How much two clocks may differ.
    pub clock_error_ns: i64,
    /// Phase of the pulse at which outputs act, the same for all SubDevices with DC; null without.
    pub acting_phase_ns: Option<i64>,
    /// Earliest phase of it: all outputs are ready. Null if nobody has outputs.
    pub output_reference_ns: Option<i64>,
    /// Latest phase of it: all inputs are in time for the next frame. Null if nobody has inputs.
    pub input_reference_ns: Option<i64>,
    /// Least slack of all lines of the cycle; of all lines where one does not fit.
    pub least_slack_ns: i64,
}

/// A frame of the cycle. Times count from the first bit of the first one, in the fullest cycle.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Frame {
    /// It travels in the bus cycles whose number, system time divided by the bus cycle, is a multiple of this.
    pub every: u32,
    /// By how much it is earlier where the frames of other groups do not go before it.
    pub spread_ns: i64,
    /// First bit of the preamble.
    pub begin_ns: i64,
    /// Last bit of the check sequence.
    pub end_ns: i64,
    /// Bytes from the destination address to the padding.
    pub bytes: usize,
    /// What is in it.
    pub datagrams: Vec<Datagram>,
}

/// A datagram of a frame.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Datagram {
    /// Command, in its usual letters.
    pub command: String,
    /// Address.
    pub address: String,
    /// Bytes of data.
    pub bytes: usize,
    /// First byte of its data on the wire.
    pub begin_ns: i64,
    /// Behind the last byte of its data on the wire.
    pub end_ns: i64,
    /// First and last position of the SubDevices whose process data it carries, of those between them only the ones that
    /// are exchanged as often; null for others.
    pub devices: Option<[usize; 2]>,
}

/// A SubDevice.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Device {
    /// Place in processing order, from 0.
    pub position: usize,
    /// Name in the segment file.
    pub name: String,
    /// Profile.
    pub profile: String,
    /// How its maker's description (ESI) was read and what is doubtful in it; empty for a profile.
    pub description: Vec<Doubt>,
    /// Synchronization mode.
    #[serde(serialize_with = "typed::text")]
    #[schemars(with = "String")]
    pub mode: SyncMode,
    /// Why not a higher mode; empty if this is the one asked for or the highest.
    pub mode_reason: String,
    /// Propagation delay from the reference clock.
    pub delay_ns: i64,
    /// Its process data travel in every so many bus cycles.
    pub every: u32,
    /// Register 0x09A0; null without SYNC.
    pub sync0_cycle_ns: Option<i64>,
    /// Phase of SYNC0 in its cycle; null without.
    pub sync0_phase_ns: Option<i64>,
    /// Register 0x09A4; null without SYNC1.
    pub sync1_ns: Option<i64>,
    /// From a SYNC pulse until its program acknowledges it, in acknowledge mode (0x0982 is 0); null where pulses end by
    /// themselves, and without DC.
    pub acknowledge_ns: Option<i64>,
    /// Earliest phase of the acting pulse for its outputs' sake; null without DC or outputs.
    pub earliest_phase_ns: Option<i64>,
    /// Latest phase of the acting pulse for its inputs' sake; null without DC or inputs.
    pub latest_phase_ns: Option<i64>,
    /// The events of its cycle.
    pub moments: Vec<Moment>,
    /// Its demands on the cycle.
    pub lines: Vec<Line>,
}

impl Device {
    /// Its line of the cycle with the least slack; where a line does not fit, the one that lacks most.
    pub fn tightest(&self) -> Option<&Line> {
        let counts = |line: &&Line| line.check.is_of_cycle() || line.slack_ns < 0;
        self.lines.iter().filter(counts).min_by_key(|line| line.slack_ns)
    }
}

/// What could be read in more than one way, and how it was.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Doubt {
    /// Its fixed name, for programs: `revision`, `opmode`, `sync-off` …
    pub kind: String,
    /// What, with the figures.
    pub what: String,
}

impl From<&isocat_segment::profile::Doubt> for Doubt {
    fn from(doubt: &isocat_segment::profile::Doubt) -> Self {
        Self { kind: doubt.kind.to_owned(), what: doubt.what.clone() }
    }
}

/// An event of the cycle in which the frame is sent, by the reference clock: from the begin of that bus cycle on.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Moment {
    /// What happens.
    #[serde(serialize_with = "typed::text")]
    #[schemars(with = "String")]
    pub event: isocat_sync::Moment,
    /// Not before.
    pub earliest_ns: i64,
    /// Not after.
    pub latest_ns: i64,
    /// When it really happened; null unless it was proven.
    pub measured: Option<Seen>,
}

/// When something happened in a run, in true time.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Seen {
    /// How often it was seen.
    pub count: u64,
    /// The earliest time.
    pub earliest_ns: f64,
    /// The latest time.
    pub latest_ns: f64,
}

/// One line of the budget.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Line {
    /// Short name of the demand, for programs.
    #[serde(serialize_with = "typed::check")]
    #[schemars(with = "String")]
    pub check: Check,
    /// The object that states it; null where none does.
    pub object: Option<String>,
    /// The formula in words.
    pub demand: &'static str,
    /// Time needed.
    pub needed_ns: i64,
    /// Time there is.
    pub available_ns: i64,
    /// What is left; negative if it does not fit.
    pub slack_ns: i64,
    /// The figures of the time needed.
    pub needed: Vec<Term>,
    /// The figures of the time there is.
    pub available: Vec<Term>,
    /// What shows if it does not fit.
    pub sign: String,
    /// The worst case of a run in true time; null unless it was proven, and where nothing can be seen of it.
    pub measured: Option<Measured>,
}

/// One figure of a line, with the sign with which it counts.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Term {
    /// What it is.
    pub what: &'static str,
    /// How much.
    pub value_ns: i64,
    /// Where it comes from: wire, asked for, plan, profile, chip, ESI, measured, computed, assumed, or the object and
    /// whether the device measured it.
    pub origin: String,
}

/// The worst case of one line in a run, in true time.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Measured {
    /// How often it was seen.
    pub count: u64,
    /// Largest time that was needed.
    pub needed_ns: f64,
    /// Least slack.
    pub slack_ns: f64,
    /// Time needed as a share of the bound: above 1 the bound does not hold.
    pub of_bound: f64,
}

/// What fits better.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Suggestion {
    /// Whether a line fails at this phase too, and so at any: what fails then is not the phase's.
    pub no_shift_helps: bool,
    /// Phase of the acting pulse behind the frame with the most even slack; null without DC.
    pub shift_ns: Option<i64>,
    /// The same as the phase of the frame, with the acting pulse at 0; null without DC.
    pub send_phase_ns: Option<i64>,
    /// Least slack of the lines that the phase decides, with that phase; null without DC.
    pub slack_ns: Option<i64>,
    /// Shift of Outputs Valid with which all outputs that can be shifted act with the slowest; null if there is
    /// nothing to shift.
    pub outputs_shift_ns: Option<i64>,
    /// Positions of the SubDevices that can be shifted so.
    pub outputs_shiftable: Vec<usize>,
    /// The smallest cycle that fits, other wishes unchanged; null if none up to a second does.
    pub smallest_cycle_ns: Option<i64>,
    /// Cycles that were tried are multiples of this.
    pub cycle_step_ns: i64,
}

/// What a run showed.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct ProofSummary {
    /// Seed of all randomness.
    pub seed: u64,
    /// Virtual time from operation on.
    pub judged_ns: i64,
    /// Whether the plan fits, no line and no event went beyond its bound, and nothing else was wrong.
    pub holds: bool,
    /// A bound is tight if what was needed, and twice the clock error, is at least the bound divided by this.
    pub factor: f64,
    /// Lines whose bound is not that tight: figures that the device states and does not need.
    pub loose: usize,
    /// What went beyond its bound, and what the judges of the run found.
    pub findings: Vec<String>,
}
