//! The effects on each SubDevice in each case, as a document. Measurements are in true time unless
//! stated otherwise.

use isocat_wire::AlState;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Serialize;

use crate::report::typed;

/// Effects on a segment when one cable or the power of one SubDevice fails for a time.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct WhatIf {
    /// Seed of all randomness.
    pub seed: u64,
    /// Duration of the fault.
    pub gone_ns: i64,
    /// Time in which all have been in OP before the fault.
    pub before_ns: i64,
    /// Position of the SubDevice whose clock leads; null without clocks.
    pub reference: Option<usize>,
    /// Whether SubDevices that leave OP are brought back: the key `recovery`.
    pub recovers: bool,
    /// Names of all SubDevices in the segment file, by position.
    pub names: Vec<String>,
    /// Why there are no cases: the way up failed without any fault. Null if it did not.
    pub failure: Option<String>,
    /// The cases: one run of the segment each.
    pub cases: Vec<Case>,
}

/// The kind of fault.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[cfg_attr(feature = "schema", schemars(inline))]
pub enum Gone {
    /// The cable that leads to a SubDevice is pulled.
    Cable,
    /// A SubDevice loses its power.
    Power,
}

/// One fault, which ends after a time.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Case {
    /// The kind of fault.
    pub what: Gone,
    /// Position of the SubDevice to which the cable leads, or that loses its power.
    pub device: usize,
    /// The effect on the clock that leads, as seen by the MainDevice.
    pub clocks: Clocks,
    /// Position of the SubDevice whose clock leads in place of the reference clock; null if none
    /// does.
    pub leads: Option<usize>,
    /// Time from the end of the fault until all SubDevices are in OP and in sync, 0 if they always
    /// were; null if they do not return by themselves.
    pub in_sync_ns: Option<i64>,
    /// The effect on each SubDevice, by position.
    pub devices: Vec<Fate>,
}

/// The clock that leads.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[cfg_attr(feature = "schema", schemars(inline))]
pub enum Clocks {
    /// There are no clocks.
    None,
    /// The reference clock continues to lead.
    Lead,
    /// Another clock leads in its place until it is back; the system time continues.
    TakenOver,
    /// The reference clock is lost, and the MainDevice reaches no clock that could lead in its
    /// place.
    Lost,
}

/// The effect on one SubDevice.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Fate {
    /// Place in processing order, from 0.
    pub position: usize,
    /// Whether it has outputs.
    pub outputs: bool,
    /// The outcome.
    pub outcome: Outcome,
    /// Time from the begin of the fault until it left OP by itself, or until the first sign that it
    /// was not in sync; null if there is none.
    pub after_ns: Option<i64>,
    /// The state that it changed to by itself; null if it did not.
    #[serde(serialize_with = "typed::some_text")]
    #[cfg_attr(feature = "schema", schemars(with = "Option<String>"))]
    pub state: Option<AlState>,
    /// The reason, register 0x0134; null if it did not.
    pub code: Option<u16>,
    /// How long it was in OP with the process data of the last frame: its outputs kept their
    /// values. Null if it exchanged process data all the time or lost its power.
    pub held_ns: Option<i64>,
    /// Whether its watchdog then made the outputs safe, though it stays in OP: a device without a
    /// program.
    pub made_safe: bool,
    /// Largest SYNC0 error against the clock that leads, from the begin of the fault to the end of
    /// the run; null without SYNC0, and while no clock leads.
    pub sync0_worst_ns: Option<f64>,
    /// Time from the end of the fault until it is in OP and in sync, 0 if it already was; null if
    /// it does not return by itself.
    pub in_sync_ns: Option<i64>,
    /// Why it is not in sync again; null if it is.
    pub not_back: Option<NotBack>,
    /// The last error when the MainDevice tried to bring it back; null if it did not try or
    /// succeeded.
    pub why: Option<String>,
}

/// The outcome for a SubDevice.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[cfg_attr(feature = "schema", schemars(inline))]
pub enum Outcome {
    /// It stays in OP and in sync, and exchanges process data.
    InSync,
    /// It stays in OP and has no process data that could be late.
    Idle,
    /// It stays in OP and exchanges process data, but a sign shows that it is not in sync.
    OutOfSync,
    /// It stays in OP without process data: neither its watchdog nor another check of its own makes
    /// it leave. The MainDevice may re-admit it.
    CutOff,
    /// It leaves OP by itself; its outputs, if any, become safe.
    LeftOp,
    /// It is the SubDevice without power.
    WithoutPower,
    /// It was not in sync before, so the case has no result.
    NotBefore,
    /// It may be absent, and was absent.
    Absent,
}

impl Outcome {
    /// Whether there is no effect.
    pub fn is_calm(&self) -> bool {
        matches!(self, Self::InSync | Self::Idle | Self::Absent)
    }

    /// Whether it was in OP without process data before or during the fault.
    pub(super) fn has_held(&self) -> bool {
        matches!(self, Self::CutOff | Self::LeftOp)
    }
}

/// Why a SubDevice is not in sync again by itself.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[cfg_attr(feature = "schema", schemars(inline))]
pub enum NotBack {
    /// It answers, but is not brought back to OP: the key `recovery` is "never".
    RecoveryOff,
    /// The MainDevice tried, and failed.
    Refused,
    /// The MainDevice has not re-admitted it.
    NotFound,
    /// There were signs that it is not in sync up to the end.
    StillOut,
}
