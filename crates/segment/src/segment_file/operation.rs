//! Activities of the MainDevice besides the exchange while the segment runs: the tables `[quality]`
//! and `[delay_watch]`, the keys `recovery`, `direction` and `measure_times`.
//!
//! ```toml
//! recovery = { first = "1s", longest = "30s" }
//! direction = "drive-reference"
//!
//! [quality]
//! share_permille = 5
//! margin_limit = "20us"
//! ```

use isocat_descriptions::document::section::{Keys, Scalar};
use isocat_descriptions::document::{FileError, Value, name_hint};
use isocat_maindevice::{DelayWatch, QualityWatch, Recovery};
use isocat_sync::phase::{Direction, drive};
use isocat_wire::time::Nanos;

use super::keys;

/// The requested activities; none by default.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Operation {
    /// Background reads. Table `[quality]`, empty for the defaults.
    pub quality: Option<QualityWatch>,
    /// Measurement of delays in operation. Table `[delay_watch]`, empty for the defaults.
    pub delay_watch: Option<DelayWatch>,
    /// Recovery of SubDevices that leave OP. Key `recovery`: "never" (default), "once", or
    /// increasing pauses, `{ first = "1s", longest = "30s" }`.
    pub recovery: Recovery,
    /// The clock that leads. Key `direction`: "follow-reference" (default) or "drive-reference".
    pub direction: Direction,
    /// Whether devices measure their times on the way up. Key `measure_times`.
    pub measure_times: bool,
}

pub(super) fn operation(root: &Keys<'_>) -> Result<Operation, FileError> {
    let quality = root.table("quality")?;
    let delay_watch = root.table("delay_watch")?;
    let limits = drive::Limits::default();
    Ok(Operation {
        quality: quality.map(|keys| quality_watch(&keys)).transpose()?,
        delay_watch: delay_watch.map(|keys| self::delay_watch(&keys)).transpose()?,
        recovery: root.value("recovery").map_or(Ok(Recovery::Never), |value| recovery(&value))?,
        direction: match root.choice("direction", &keys::DIRECTIONS)? {
            true => Direction::DriveReference { limits },
            false => Direction::FollowReference,
        },
        measure_times: root.get("measure_times")?,
    })
}

fn quality_watch(keys: &Keys<'_>) -> Result<QualityWatch, FileError> {
    Ok(QualityWatch {
        share_permille: keys.get("share_permille")?,
        history: keys.get("history")?,
        unled_cycles: keys.get("unled_cycles")?,
        difference_limit: keys.get("difference_limit")?,
        margin_limit: match keys.value("margin_limit") {
            Some(value) if value.as_string() == Some("off") => None,
            Some(value) => Some(Nanos::read(&value, &keys::MARGIN, 0)?),
            None => QualityWatch::default().margin_limit,
        },
        objects: keys.get("objects")?,
    })
}

fn delay_watch(keys: &Keys<'_>) -> Result<DelayWatch, FileError> {
    Ok(DelayWatch {
        every: keys.get("every")?,
        latches: keys.get("latches")?,
        rewrite: keys.get("rewrite")?,
    })
}

fn recovery(value: &Value<'_>) -> Result<Recovery, FileError> {
    if value.is_table() {
        let pauses = Keys::open(value.table()?, &keys::RECOVERY)?;
        let first = pauses.get("first")?;
        return Ok(Recovery::BackOff { first, longest: pauses.by(first).get("longest")? });
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
