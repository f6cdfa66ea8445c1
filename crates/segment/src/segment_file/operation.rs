//! What the MainDevice does beside the exchange while the segment runs: the tables `[quality]` and `[delay_watch]`, the
//! keys `recovery` and `direction`.
//!
//! ```toml
//! recovery = { first = "1s", longest = "30s" }
//! direction = "drive-reference"
//!
//! [quality]
//! share_permille = 5
//! margin_limit = "20us"
//! ```

use isocat_descriptions::document::{FileError, Table, Value, name_hint};
use isocat_maindevice::{DelayWatch, QualityWatch, Recovery};
use isocat_sync::phase::{Direction, drive};
use isocat_wire::time::Nanos;

use super::{LONGEST_CYCLE, LONGEST_RUN};

/// What is asked for; by default nothing.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Operation {
    /// What is read in the background. Table `[quality]`, empty for the defaults: `share_permille` (1 to 200),
    /// `history` (16 to 100000), `unled_cycles`, `difference_limit`, `margin_limit` (a duration or "off"), `objects` (true
    /// or false).
    pub quality: Option<QualityWatch>,
    /// Delays measured on in operation. Table `[delay_watch]`, empty for the defaults: `every`, `latches`, `rewrite`.
    pub delay_watch: Option<DelayWatch>,
    /// What becomes of SubDevices that leave OP. Key `recovery`: "never" (default), "once", or pauses that grow,
    /// `{ first = "1s", longest = "30s" }`.
    pub recovery: Recovery,
    /// Which clock leads. Key `direction`: "follow-reference" (default) or "drive-reference".
    pub direction: Direction,
}

/// Keys of the root that are read here.
pub(super) const KEYS: [&str; 4] = ["quality", "delay_watch", "recovery", "direction"];

pub(super) fn operation(root: &Table<'_>, cycle: Nanos) -> Result<Operation, FileError> {
    let mut operation = Operation::default();
    if let Some(table) = root.table("quality")? {
        operation.quality = Some(quality(&table)?);
    }
    if let Some(table) = root.table("delay_watch")? {
        operation.delay_watch = Some(delay_watch(&table, cycle)?);
    }
    if let Some(value) = root.value("recovery") {
        operation.recovery = recovery(&value)?;
    }
    if let Some(value) = root.value("direction") {
        let limits = drive::Limits::default();
        let directions = [
            ("follow-reference", Direction::FollowReference),
            ("drive-reference", Direction::DriveReference { limits }),
        ];
        operation.direction = value.one_of(&directions)?;
    }
    Ok(operation)
}

fn quality(table: &Table<'_>) -> Result<QualityWatch, FileError> {
    let keys = [
        "share_permille",
        "history",
        "unled_cycles",
        "difference_limit",
        "margin_limit",
        "objects",
    ];
    table.allow(&keys)?;
    let mut watch = QualityWatch::default();
    if let Some(value) = table.value("share_permille") {
        watch.share_permille = value.integer(1..=200)? as u16;
    }
    if let Some(value) = table.value("history") {
        watch.history = value.integer(16..=MOST_HISTORY)? as usize;
    }
    if let Some(value) = table.value("unled_cycles") {
        watch.unled_cycles = value.integer(1..=i64::from(u32::MAX))? as u64;
    }
    if let Some(value) = table.value("difference_limit") {
        watch.difference_limit = value.duration(Nanos(1)..=Nanos::millis(1))?;
    }
    if let Some(value) = table.value("margin_limit") {
        watch.margin_limit = match value.as_string() {
            Some("off") => None,
            _ => Some(value.duration(-LONGEST_CYCLE..=LONGEST_CYCLE)?),
        };
    }
    if let Some(value) = table.value("objects") {
        watch.objects = value.boolean()?;
    }
    Ok(watch)
}

fn delay_watch(table: &Table<'_>, cycle: Nanos) -> Result<DelayWatch, FileError> {
    table.allow(&["every", "latches", "rewrite"])?;
    let mut watch = DelayWatch::default();
    watch.every = match table.value("every") {
        Some(value) => value.duration(cycle..=LONGEST_RUN)?,
        None => watch.every.max(cycle),
    };
    if let Some(value) = table.value("latches") {
        watch.latches = value.integer(2..=MOST_LATCHES)? as usize;
    }
    if let Some(value) = table.value("rewrite") {
        watch.rewrite = value.boolean()?;
    }
    Ok(watch)
}

fn recovery(value: &Value<'_>) -> Result<Recovery, FileError> {
    if value.is_table() {
        let table = value.table()?;
        table.allow(&["first", "longest"])?;
        let pause = |key, least| {
            let expected = "a pause, such as \"1s\"";
            table.required(key, expected)?.duration(least..=LONGEST_RUN)
        };
        let first = pause("first", Nanos::millis(1))?;
        return Ok(Recovery::BackOff { first, longest: pause("longest", first)? });
    }
    let expected = "\"never\", \"once\", or { first = \"1s\", longest = \"30s\" }";
    match value.string(expected)? {
        "never" => Ok(Recovery::Never),
        "once" => Ok(Recovery::Once),
        other => Err(value
            .error(format!("recovery = \"{other}\"; expected {expected}"))
            .with_hint(name_hint(other, ["never", "once"]))),
    }
}

const MOST_HISTORY: i64 = 100_000;
const MOST_LATCHES: i64 = 10_000;
