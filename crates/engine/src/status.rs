//! The present state of a running segment.
//!
//! One document serves all readers: the live view, the lines that it prints without a terminal, the
//! metrics, and the answer of `isocat serve` to the request `watch`. [`main_device`] fills it from
//! a MainDevice, [`edges`] adds true time if it is known, and `served` makes it for a served
//! segment. [`board`] hands it from the loop that keeps a cycle to the readers, without a wait in
//! the loop.
//!
//! Each figure states its source: `[t]` measured in true time by the judges of the simulation,
//! `[r]` read from a register or an object, `[m]` from the MainDevice's clock and counts.
//! [`Kind::source`] gives that of errors and margins.

use std::borrow::Cow;

use isocat_sync::phase;
use isocat_wire::AlState;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub mod board;
pub mod edges;
pub mod main_device;
mod names;
mod stage;
#[cfg(target_os = "linux")]
#[cfg(test)]
mod tests;
mod verdict;

pub use board::Board;
pub use main_device::Scribe;
pub use names::{SERVO, servo_name};
pub use stage::Stage;
pub use verdict::{Verdict, place};

/// Texts, mostly fixed ones, which can be set without allocation.
pub type Words = Cow<'static, str>;

/// The present state of a segment.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Status {
    /// Format of this document.
    pub format: u32,
    /// Version of isocat that wrote it.
    pub version: Words,
    /// The segment: the name of a segment file, or another description.
    pub segment: String,
    /// Kind of segment, which decides what can be known.
    pub kind: Kind,
    /// Stage of its way up, "in operation", or "ended".
    #[serde(with = "names::stage")]
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub stage: Stage,
    /// Why it ended or does not come up.
    pub failure: Option<String>,
    /// Present time since the beginning: virtual time in a simulation, otherwise host time.
    pub at_ns: i64,
    /// Begin of the time span of the figures called `recent`; its end is the present.
    pub since_ns: i64,
    /// Time in operation; null before.
    pub operation_ns: Option<i64>,
    /// Bus cycle; 0 before it is known.
    pub cycle_ns: i64,
    /// SYNC errors beyond this limit are named in the verdict.
    pub limit_ns: i64,
    /// The MainDevice.
    pub host: Host,
    /// Each SubDevice, by position.
    pub devices: Vec<Device>,
    /// Events since the last status that was taken, oldest first; at most some hundred.
    pub events: Vec<Event>,
}

/// The kind of a segment.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "lowercase")]
#[cfg_attr(feature = "schema", schemars(inline))]
pub enum Kind {
    /// A simulation with its MainDevice: true time is known.
    Simulated,
    /// A real wire: only what is read from it is known.
    Wire,
    /// A virtual segment for an external MainDevice, of which only its frames are known.
    Served,
}

impl Kind {
    /// Source of SYNC errors: `t` or `r`.
    pub const fn source(self) -> char {
        match self {
            Kind::Simulated | Kind::Served => 't',
            Kind::Wire => 'r',
        }
    }

    /// Source of margins: `t`, or `m` on a wire.
    pub const fn margin_source(self) -> char {
        match self {
            Kind::Simulated | Kind::Served => 't',
            Kind::Wire => 'm',
        }
    }

    /// The name of the kind.
    pub const fn name(self) -> &'static str {
        match self {
            Kind::Simulated => "simulated",
            Kind::Wire => "wire",
            Kind::Served => "served",
        }
    }
}

/// The MainDevice's side. Of a served segment only `frames_sent` and `frames_lost` are known.
#[derive(Clone, PartialEq, Debug, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Host {
    /// Lateness of the cycle's frames at the reference clock against their phase, negative if
    /// early: `[t]` of the last frame in a simulation, `[r]` of the latest one in about a hundred
    /// cycles on a wire; null before operation or without clocks.
    pub phase_error_ns: Option<f64>,
    /// Its largest size in operation, `[t]` or `[m]`.
    pub phase_error_worst_ns: Option<f64>,
    /// State of the servo on the reference clock `[m]`: "free", "acquiring", "locked", "holdover";
    /// empty without clocks.
    #[serde(with = "names::servo")]
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub servo: Option<phase::State>,
    /// How much faster the reference clock runs than the host's, ppm `[m]`.
    pub rate_ppm: Option<f64>,
    /// Cycles begun `[m]`.
    pub cycles: u64,
    /// Frames sent `[m]`; for a served segment, frames received.
    pub frames_sent: u64,
    /// Frames that did not come back in time `[m]`.
    pub frames_lost: u64,
    /// Cyclic datagrams with a wrong working counter `[m]`.
    pub working_counter_errors: u64,
    /// Send instants that were skipped `[m]`.
    pub cycles_skipped: u64,
    /// How often the servo lost its lock in operation `[m]`.
    pub locks_lost: u64,
    /// Cycles since all clocks last received the reference's time, if they exceed the limit `[m]`;
    /// 0x092C is meaningless then.
    pub unled_cycles: Option<u64>,
}

/// One SubDevice.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Device {
    /// Place in processing order, from 0.
    pub position: usize,
    /// Its name.
    pub name: String,
    /// Its mode, as segment files name it; empty before it is known.
    pub mode: Words,
    /// Whether it works by SYNC pulses.
    pub has_sync: bool,
    /// Whether it has the reference clock.
    pub is_reference: bool,
    /// Whether it is asked to be in OP: false for one that may be absent and is absent.
    pub asked: bool,
    /// AL state `[r]` (0x0130): INIT, PREOP, BOOT, SAFEOP, OP; "unknown" for any other value.
    #[serde(with = "names::al_state")]
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub al_state: Option<AlState>,
    /// Error flag of the AL status `[r]`.
    pub al_error: bool,
    /// AL status code `[r]` (0x0134).
    pub al_code: u16,
    /// SYNC error: `[t]` SYNC0 edges against the requested grid, or `[r]` 0x092C; null without
    /// SYNC, before the first value, and for the reference clock on a wire.
    pub error: Option<Error>,
    /// Time left before SYNC0 when outputs are ready, `[t]` by the judges, or `[m]` by the times
    /// that the SubDevice states.
    pub margin: Option<Margin>,
    /// How much faster its own oscillator runs than the reference's, ppm `[r]`: the correction of
    /// the drift loop (0x0930, 0x0932) with inverted sign. Null at the reference and before the
    /// first reading.
    pub clock_ppm: Option<f64>,
    /// Entries 0B, 0C, 0D, 20 of 0x1C32 `[r]`.
    pub outputs: [Counter; 4],
    /// The same of 0x1C33.
    pub inputs: [Counter; 4],
    /// Active alarms.
    pub alarms: Vec<Words>,
    /// Planned times of the events in its cycle; empty without a plan.
    pub moments: Vec<Moment>,
}

/// Errors of a SubDevice's SYNC.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Error {
    /// The last one, ns.
    pub now_ns: f64,
    /// The largest size since the last status, ns; null if nothing was measured since.
    pub recent_ns: Option<f64>,
    /// The largest size in operation, ns.
    pub worst_ns: f64,
    /// Number of edges or readings in operation.
    pub count: u64,
}

/// Time left before SYNC0.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Margin {
    /// The least recent value, ns.
    pub now_ns: f64,
    /// The least in operation, ns.
    pub least_ns: f64,
}

/// A counter of 0x1C32 or 0x1C33.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Counter {
    /// Last value; null if it is not read.
    pub value: Option<u32>,
    /// Sum of its increases in operation, as far as they were seen.
    pub risen: u64,
}

/// An event of a SubDevice's cycle, counted from the begin of the bus cycle.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Moment {
    /// The event.
    #[serde(with = "names::moment")]
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub event: isocat_sync::Moment,
    /// Earliest time in the plan, ns.
    pub earliest_ns: i64,
    /// Latest time in the plan, ns.
    pub latest_ns: i64,
    /// Earliest and latest recent time, `[t]`, ns; null if it is not observed.
    pub seen_ns: Option<(f64, f64)>,
}

/// An event of the segment or of a SubDevice.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Event {
    /// Time, like `at_ns`.
    pub at_ns: i64,
    /// The SubDevice; null for the segment.
    pub position: Option<usize>,
    /// Whether it is bad news.
    pub bad: bool,
    /// Whether it is an alarm that was raised or cleared.
    pub alarm: bool,
    /// Description.
    pub what: String,
}

/// The format.
pub const FORMAT: u32 = 1;
/// Sub-indices of the counters.
pub const SUBS: [&str; 4] = ["0B", "0C", "0D", "20"];

impl Status {
    /// A status before anything is known.
    pub fn new(segment: String, kind: Kind, cycle_ns: i64, limit_ns: i64) -> Self {
        Self {
            format: FORMAT,
            version: env!("CARGO_PKG_VERSION").into(),
            segment,
            kind,
            stage: Stage::Begin,
            failure: None,
            at_ns: 0,
            since_ns: 0,
            operation_ns: None,
            cycle_ns,
            limit_ns,
            host: Host::default(),
            devices: Vec::new(),
            events: Vec::new(),
        }
    }

    /// Whether it is in operation.
    pub fn in_operation(&self) -> bool {
        self.stage == Stage::InOperation
    }

    /// Whether it has ended, so that nothing more follows.
    pub fn has_ended(&self) -> bool {
        self.stage == Stage::Ended
    }
}

impl Device {
    /// A device of which only its place is known.
    pub fn new(position: usize, name: String) -> Self {
        Self {
            position,
            name,
            mode: "".into(),
            has_sync: false,
            is_reference: false,
            asked: true,
            al_state: Some(AlState::Init),
            al_error: false,
            al_code: 0,
            error: None,
            margin: None,
            clock_ppm: None,
            outputs: Default::default(),
            inputs: Default::default(),
            alarms: Vec::with_capacity(MOST_ALARMS),
            moments: Vec::new(),
        }
    }

    /// The state as text, such as `OP` or `SAFEOP+ERR`.
    pub fn state(&self) -> String {
        format!("{}{}", self.state_name(), if self.al_error { "+ERR" } else { "" })
    }

    /// The state without its error flag.
    pub fn state_name(&self) -> &'static str {
        self.al_state.map_or(UNKNOWN, AlState::name)
    }

    /// Sum of its counters' increases in operation.
    pub fn risen(&self) -> u64 {
        self.outputs.iter().chain(&self.inputs).map(|counter| counter.risen).sum()
    }
}

/// The schema of a status.
#[cfg(feature = "schema")]
pub fn schema() -> serde_json::Value {
    isocat_descriptions::schema::of::<Status>(&format!("isocat-status/{FORMAT}"))
}

/// The name of an unknown state.
const UNKNOWN: &str = "unknown";
/// Number of the kinds of alarms that a SubDevice can have.
const MOST_ALARMS: usize = 8;
