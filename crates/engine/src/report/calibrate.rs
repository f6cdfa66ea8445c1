//! What a calibration measured, for people and for machines, and as keys of a device profile.
//!
//! Each figure stands with its error and with what it was measured from. Nothing is taken from a
//! profile or a data sheet.

mod build;
mod profile;
mod text;

pub use profile::NoFragment;
use schemars::JsonSchema;
use serde::Serialize;

/// Version of the document; changes whenever a reader could be misled by an older schema.
pub const FORMAT: &str = "isocat-calibration/2";

/// JSON schema of the document, draft 2020-12.
pub fn schema() -> serde_json::Value {
    super::schema_of::<CalibrationReport>()
}

/// The whole document. All times are nanoseconds unless their name says otherwise.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct CalibrationReport {
    /// [`FORMAT`].
    pub format: &'static str,
    /// Version of the program.
    pub version: &'static str,
    /// Segment file or network interface.
    pub place: String,
    /// Whether each clock's law and sign were told.
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
    /// Shortest and longest interval of the drift frames that were to come each millisecond, by the
    /// reference clock.
    pub paced: [i64; 2],
    /// Frames sent.
    pub frames_sent: u64,
    /// Of these, frames that did not come back.
    pub frames_lost: u64,
    /// What is not as it was found; empty if everything was put back.
    pub left_changed: Vec<String>,
    /// The devices, by position.
    pub devices: Vec<Device>,
}

/// A figure, its error, and what it comes from.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Figure {
    /// The figure.
    pub value: f64,
    /// Its standard error.
    pub error: f64,
    /// What was measured, and with which registers.
    pub from: &'static str,
}

/// One device.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
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
    /// What bit 31 of register 0x092C means, as the profile key `difference_polarity` has it; null:
    /// not told.
    pub difference_polarity: Option<&'static str>,
    /// The drift loop's law; null for others than followers.
    pub law: Option<Law>,
    /// Latches of this clock against the reference: standard deviation, ticks of both included (4.1
    /// ns alone).
    pub latch_deviation: Option<f64>,
    /// How far frames jitter on the way from the clock above; null for others than followers.
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

/// What a device has of distributed clocks.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ClockKind {
    /// It leads.
    Reference,
    /// It was measured.
    Follower,
    /// It has receive times alone.
    ReceiveTimes,
    /// It has nothing of it.
    None,
}

/// What is known of a drift loop's law.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Law {
    /// `told`, `not-told-apart` or `none-fits`.
    pub verdict: LawVerdict,
    /// Name of the law, as the profile key `drift_law` has it; null unless told.
    pub name: Option<&'static str>,
    /// Phase parameter, as the profile key `drift_phase` has it; null unless told.
    pub phase: Option<u8>,
    /// Gain, as the profile key `drift_gain` has it; null unless `proportional` was told.
    pub gain: Option<u16>,
    /// The best of each family, best first.
    pub fits: Vec<Fit>,
    /// Numbers that were compared.
    pub numbers: usize,
}

/// What is known.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum LawVerdict {
    /// One law fits, the others do not.
    Told,
    /// Several fit.
    NotToldApart,
    /// None fits.
    NoneFits,
}

/// How well a law fits.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Fit {
    /// Its name.
    pub name: &'static str,
    /// Its parameter that fits best: the phase, or the gain of `proportional`.
    pub parameter: u16,
    /// Whether it fits and can't be told from the best.
    pub admissible: bool,
    /// Root mean square of measured less predicted, in standard deviations.
    pub misfit: f64,
    /// The parameter as a real number; null for a law that is far from fitting.
    pub measured: Option<Figure>,
}

/// Many readings.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Spread {
    /// Mean.
    pub mean: f64,
    /// Standard error of the mean.
    pub error: f64,
    /// Standard deviation of one reading.
    pub deviation: f64,
    /// Least.
    pub least: f64,
    /// Largest.
    pub most: f64,
    /// Readings.
    pub count: usize,
    /// What was read.
    pub from: &'static str,
}

/// The jitter of frames between two clocks.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Jitter {
    /// Position of the clock above.
    pub above: usize,
    /// The port at which frames come in: `mii`, `ebus` or `other`, register 0x0007.
    pub port: &'static str,
    /// Standard deviation of a frame's time on the way, ticks not included; null if both crystals are
    /// too much alike to show it.
    pub deviation: Option<Figure>,
    /// Latches.
    pub latches: usize,
}

/// The hop to a device.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Hop {
    /// Position of the device above; null for the first, or if open ports make no tree.
    pub above: Option<usize>,
    /// Port of it.
    pub port: Option<usize>,
    /// From a frame's arrival until it is back for the last time.
    pub round_trip: Spread,
    /// Half of what the frame is away from above and not here; null for the first. It is the delay
    /// of the hop less half of tDiff.
    pub one_way: Option<Spread>,
    /// tDiff of this device: how much longer a frame stays on its way through the processing unit
    /// than on its way back; null at the end of a line.
    pub t_diff: Option<Figure>,
}

/// A change of state.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct StateChange {
    /// How long it took; null if it did not come.
    pub took: Option<Spread>,
    /// Code of register 0x0134 if it was refused.
    pub refused: Option<u16>,
}
