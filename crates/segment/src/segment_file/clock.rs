//! How a clock deviates: the keys `clock`, `clock_ramp`, `clock_step`, `clock_walk`.

use isocat_descriptions::document::{FileError, Table};
use isocat_descriptions::quantity::Ppb;
use isocat_sim::oscillator::{ClockModel, Ramp, Step, Walk};
use isocat_wire::time::Nanos;

use super::{LONGEST_RUN, MOST_DRIFT};

/// Reads the shape of a device's clock beside its constant deviation. Points of time count from
/// power-on, in true time.
///
/// - `clock_ramp = { by = "+5ppm", from = "2s", over = "60s" }`: a deviation that grows evenly, as of
///   temperature; `from` may be left out: at once.
/// - `clock_step = { by = "+1ppm", at = "5s" }`: one that changes suddenly.
/// - `clock_walk = { step = "0.05ppm", every = "100ms", within = "2ppm" }`: one that wanders.
pub(super) fn shape(table: Table<'_>) -> Result<ClockModel, FileError> {
    let mut model = ClockModel::constant(0);
    if let Some(ramp) = table.table("clock_ramp")? {
        ramp.allow(&["by", "from", "over"])?;
        model.ramp = Some(Ramp {
            by_ppb: deviation(&ramp, "by", -MOST_DRIFT)?,
            from: match ramp.value("from") {
                Some(value) => value.duration(Nanos::ZERO..=LONGEST_RUN)?,
                None => Nanos::ZERO,
            },
            over: span(&ramp, "over", SHORTEST)?,
        });
    }
    if let Some(step) = table.table("clock_step")? {
        step.allow(&["by", "at"])?;
        let by_ppb = deviation(&step, "by", -MOST_DRIFT)?;
        model.step = Some(Step { by_ppb, at: span(&step, "at", Nanos::ZERO)? });
    }
    if let Some(walk) = table.table("clock_walk")? {
        walk.allow(&["step", "every", "within"])?;
        model.walk = Some(Walk {
            step_ppb: deviation(&walk, "step", Ppb(0))?,
            every: span(&walk, "every", SHORTEST)?,
            bound_ppb: deviation(&walk, "within", Ppb(0))?,
        });
    }
    Ok(model)
}

fn deviation<'a>(table: &Table<'a>, key: &'a str, least: Ppb) -> Result<i64, FileError> {
    let value = table.required(key, "a deviation, such as \"1ppm\"")?;
    Ok(value.rate(least..=MOST_DRIFT)?.0)
}

fn span<'a>(table: &Table<'a>, key: &'a str, least: Nanos) -> Result<Nanos, FileError> {
    table.required(key, "a duration, such as \"10s\"")?.duration(least..=LONGEST_RUN)
}

/// A clock that changes faster is not what these shapes are about.
const SHORTEST: Nanos = Nanos::micros(1);
