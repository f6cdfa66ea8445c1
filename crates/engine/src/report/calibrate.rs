//! The results of a calibration, for people and for machines, and as keys of a device profile.
//!
//! Each figure has its error and the quantity that was measured. Nothing is taken from a profile or
//! a data sheet.

mod build;
mod profile;
mod text;

pub use profile::NoFragment;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Serialize;

/// Version of the document; it changes whenever a reader could be misled by an older schema.
pub const FORMAT: &str = "isocat-calibration/2";

/// JSON schema of the document, draft 2020-12.
#[cfg(feature = "schema")]
pub fn schema() -> serde_json::Value {
    isocat_descriptions::schema::of::<CalibrationReport>(FORMAT)
}

/// The whole document. All times are nanoseconds unless their name says otherwise.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct CalibrationReport {
    /// [`FORMAT`].
    pub format: &'static str,
    /// Version of the program.
    pub version: &'static str,
    /// Segment file or network interface.
    pub place: String,
    /// Whether each clock's law and sign were determined.
    pub complete: bool,
    /// One sentence for people.
    pub verdict: String,
    /// Position of the reference clock, against which all others were measured.
    pub reference: usize,
    /// Courses of drift frames.
    pub courses: usize,
    /// Drift frames in them.
    pub drift_frames: usize,
    /// Of these, frames that did not come back.
    pub drift_frames_lost: usize,
    /// Shortest and longest interval of the drift frames that were due each millisecond, by the
    /// reference clock.
    pub paced: [i64; 2],
    /// Frames sent.
    pub frames_sent: u64,
    /// Of these, frames that did not come back.
    pub frames_lost: u64,
    /// Settings that could not be restored; empty if all were.
    pub left_changed: Vec<String>,
    /// The devices, by position.
    pub devices: Vec<Device>,
}

/// A figure, its error, and its origin.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Figure {
    /// The figure.
    pub value: f64,
    /// Its standard error.
    pub error: f64,
    /// What was measured, and with which registers.
    pub from: &'static str,
}

/// One device.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Device {
    /// Its position.
    pub position: usize,
    /// Type of its ESC, register 0x0000.
    pub esc_type: u8,
    /// `reference`, `follower`, `receive-times` or `none`.
    pub clock: ClockKind,
    /// How much faster its crystal runs than the reference's, parts per billion; null for others
    /// than followers.
    pub crystal_ppb: Option<Figure>,
    /// How much that changed until the end.
    pub crystal_change_ppb: Option<Figure>,
    /// Meaning of bit 31 of register 0x092C, as in the profile key `difference_polarity`; null if
    /// it was not determined.
    pub difference_polarity: Option<&'static str>,
    /// The law of the drift loop; null for others than followers.
    pub law: Option<Law>,
    /// Standard deviation of latches of this clock against the reference, including the ticks of
    /// both (4.1 ns alone).
    pub latch_deviation: Option<f64>,
    /// Jitter of frames on the path from the clock above; null for others than followers.
    pub jitter: Option<Jitter>,
    /// The hop to it; null without receive times.
    pub hop: Option<Hop>,
    /// One read of its EEPROM; null if it failed.
    pub eeprom_read: Option<Spread>,
    /// INIT to PREOP.
    pub to_preop: Option<StateChange>,
    /// PREOP to INIT.
    pub to_init: Option<StateChange>,
}

/// Distributed clocks of a device.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum ClockKind {
    /// It is the reference clock.
    Reference,
    /// It was measured.
    Follower,
    /// It has only receive times.
    ReceiveTimes,
    /// It has no distributed clocks.
    None,
}

/// The result for a drift loop's law.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Law {
    /// `told`, `not-told-apart` or `none-fits`.
    pub verdict: LawVerdict,
    /// Name of the law, as in the profile key `drift_law`; null unless told.
    pub name: Option<&'static str>,
    /// Phase parameter, as in the profile key `drift_phase`; null unless told.
    pub phase: Option<u8>,
    /// Gain, as in the profile key `drift_gain`; null unless `proportional` was told.
    pub gain: Option<u16>,
    /// The best of each family, best first.
    pub fits: Vec<Fit>,
    /// Number of compared values.
    pub numbers: usize,
}

/// The verdict on a law.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum LawVerdict {
    /// One law fits, the others do not.
    Told,
    /// Several fit.
    NotToldApart,
    /// None fits.
    NoneFits,
}

/// The fit of a law.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Fit {
    /// Its name.
    pub name: &'static str,
    /// Its parameter that fits best: the phase, or the gain of `proportional`.
    pub parameter: u16,
    /// Whether it fits and cannot be distinguished from the best one.
    pub admissible: bool,
    /// Root mean square of measured less predicted, in standard deviations.
    pub misfit: f64,
    /// The parameter as a real number; null for a law that is far from fitting.
    pub measured: Option<Figure>,
}

/// Statistics of repeated readings.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Spread {
    /// Mean.
    pub mean: f64,
    /// Standard error of the mean.
    pub error: f64,
    /// Standard deviation of one reading.
    pub deviation: f64,
    /// Smallest reading.
    pub least: f64,
    /// Largest reading.
    pub most: f64,
    /// Number of readings.
    pub count: usize,
    /// What was read.
    pub from: &'static str,
}

/// The jitter of frames between two clocks.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Jitter {
    /// Position of the clock above.
    pub above: usize,
    /// The port at which frames come in: `mii`, `ebus` or `other`, register 0x0007.
    pub port: &'static str,
    /// Standard deviation of a frame's time on the path, without ticks; null if both crystals are
    /// too similar to show it.
    pub deviation: Option<Figure>,
    /// Number of latches.
    pub latches: usize,
}

/// The hop to a device.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Hop {
    /// Position of the device above; null for the first, or if the open ports do not form a tree.
    pub above: Option<usize>,
    /// Port of that device.
    pub port: Option<usize>,
    /// Time from a frame's arrival until its last return.
    pub round_trip: Spread,
    /// Half of the difference between the frame's time away from the device above and its round
    /// trip behind this one; null for the first. It is the delay of the hop less half of tDiff.
    pub one_way: Option<Spread>,
    /// tDiff of this device: the time that a frame stays on its way through the processing unit,
    /// less that on its way back; null at the end of a line.
    pub t_diff: Option<Figure>,
}

/// A change of state.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct StateChange {
    /// Duration; null if the state was not reached.
    pub took: Option<Spread>,
    /// Code of register 0x0134 if it was refused.
    pub refused: Option<u16>,
}
