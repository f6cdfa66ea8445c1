//! What became of each SubDevice in each case, as a document. What is measured is so in true time, unless it is said otherwise.

use isocat_wire::AlState;
use schemars::JsonSchema;
use serde::Serialize;

use crate::report::typed;

/// What becomes of a segment when one cable or the power of one SubDevice goes for a time.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct WhatIf {
    /// Seed of all randomness.
    pub seed: u64,
    /// How long the cable or the power is gone.
    pub gone_ns: i64,
    /// How long all have been in OP before.
    pub before_ns: i64,
    /// Position of the SubDevice whose clock leads; null without clocks.
    pub reference: Option<usize>,
    /// Whether SubDevices that leave OP are brought back: the key `recovery`.
    pub recovers: bool,
    /// Names of all SubDevices in the segment file, by position.
    pub names: Vec<String>,
    /// Why there are no cases: the way up failed, without anything that went. Null if it did not.
    pub failure: Option<String>,
    /// The cases: one run of the segment each.
    pub cases: Vec<Case>,
}

/// What goes.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
#[schemars(inline)]
pub enum Gone {
    /// The cable that leads to a SubDevice is pulled.
    Cable,
    /// A SubDevice loses its power.
    Power,
}

/// One thing that goes, and comes back.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Case {
    /// What goes.
    pub what: Gone,
    /// Position of the SubDevice to which the cable leads, or that loses its power.
    pub device: usize,
    /// What becomes of the clock that leads, as the MainDevice has it.
    pub clocks: Clocks,
    /// Position of the SubDevice whose clock leads in place of the reference clock; null if none does.
    pub leads: Option<usize>,
    /// From when it is back until all SubDevices are in OP and in sync, 0 if they never were not; null: they are not by
    /// themselves.
    pub in_sync_ns: Option<i64>,
    /// What becomes of each SubDevice, by position.
    pub devices: Vec<Fate>,
}

/// The clock that leads.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
#[schemars(inline)]
pub enum Clocks {
    /// There are none.
    None,
    /// The reference clock goes on to lead.
    Lead,
    /// Another one leads in its place until it is back; the time goes on.
    TakenOver,
    /// The reference clock goes, and the MainDevice reaches none that could lead in its place.
    Lost,
}

/// What becomes of one SubDevice.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Fate {
    /// Place in processing order, from 0.
    pub position: usize,
    /// Whether it has outputs.
    pub outputs: bool,
    /// What becomes of it.
    pub outcome: Outcome,
    /// From when something was gone until it left OP by itself, or until the first sign that it was not in sync; null where
    /// there is none.
    pub after_ns: Option<i64>,
    /// The state that it went to by itself; null if it did not.
    #[serde(serialize_with = "typed::some_text")]
    #[schemars(with = "Option<String>")]
    pub state: Option<AlState>,
    /// Why: register 0x0134; null if it did not.
    pub code: Option<u16>,
    /// How long it was in OP with the process data of the last frame: its outputs stayed as they were. Null where it
    /// exchanged process data all the time or lost its power.
    pub held_ns: Option<i64>,
    /// Largest SYNC0 error against the clock that leads, from when something was gone to the end of the run; null without
    /// SYNC0, and while no clock leads.
    pub sync0_worst_ns: Option<f64>,
    /// From when what was gone is back until it is in OP and in sync, 0 if it was by then; null: it is not by itself.
    pub in_sync_ns: Option<i64>,
    /// Why it is not in sync again; null if it is.
    pub not_back: Option<NotBack>,
    /// What went wrong last when the MainDevice tried to get it back; null where it did not or where that went well.
    pub why: Option<String>,
}

/// What becomes of a SubDevice.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
#[schemars(inline)]
pub enum Outcome {
    /// It stays in OP and in sync, and exchanges process data.
    InSync,
    /// It stays in OP and has no process data that could be late.
    Idle,
    /// It stays in OP and exchanges process data, and there is a sign that it is not in sync.
    OutOfSync,
    /// It stays in OP without process data: neither its watchdog nor a check of its own takes it out. To take it up again, the
    /// MainDevice may.
    CutOff,
    /// It leaves OP by itself; its outputs go safe, if it has any.
    LeftOp,
    /// It is the one without power.
    WithoutPower,
    /// It was not in sync before: nothing is known of the case.
    NotBefore,
    /// It may be absent, and was not there.
    Absent,
}

impl Outcome {
    /// Whether nothing becomes of it.
    pub fn is_calm(&self) -> bool {
        matches!(self, Self::InSync | Self::Idle | Self::Absent)
    }

    /// Whether it was in OP without process data before, or as long as, something was gone.
    pub(super) fn has_held(&self) -> bool {
        matches!(self, Self::CutOff | Self::LeftOp)
    }
}

/// Why a SubDevice is not in sync again by itself.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
#[schemars(inline)]
pub enum NotBack {
    /// It answers, and is not brought back to OP: the key `recovery` is "never".
    RecoveryOff,
    /// The MainDevice tried, and could not.
    Refused,
    /// The MainDevice does not count on it again.
    NotFound,
    /// There were signs that it is not in sync up to the end.
    StillOut,
}
