//! How a clock deviates: the keys `clock`, `clock_ramp`, `clock_step`, `clock_walk`.

use isocat_descriptions::document::FileError;
use isocat_descriptions::document::section::Keys;
use isocat_descriptions::quantity::Ppb;
use isocat_sim::oscillator::{ClockModel, Ramp, Step, Walk};

/// Reads the shape of a device's clock beside its constant deviation.
pub(super) fn shape(keys: &Keys<'_>) -> Result<ClockModel, FileError> {
    let mut model = ClockModel::constant(0);
    if let Some(ramp) = keys.table("clock_ramp")? {
        let (from, over) = (ramp.get("from")?, ramp.get("over")?);
        model.ramp = Some(Ramp { by_ppb: deviation(&ramp, "by")?, from, over });
    }
    if let Some(step) = keys.table("clock_step")? {
        model.step = Some(Step { by_ppb: deviation(&step, "by")?, at: step.get("at")? });
    }
    if let Some(walk) = keys.table("clock_walk")? {
        model.walk = Some(Walk {
            step_ppb: deviation(&walk, "step")?,
            every: walk.get("every")?,
            bound_ppb: deviation(&walk, "within")?,
        });
    }
    Ok(model)
}

fn deviation(keys: &Keys<'_>, name: &'static str) -> Result<i64, FileError> {
    keys.get::<Ppb>(name).map(|deviation| deviation.0)
}
