//! Deviation of a clock: the keys `clocks`, `clock`, `clock_ramp`, `clock_step`, `clock_walk`.

use isocat_descriptions::document::FileError;
use isocat_descriptions::document::section::Keys;
use isocat_descriptions::quantity::Ppb;
use isocat_sim::oscillator::{ClockModel, Ramp, Step, Walk};
use isocat_sim::random::Stream;

use crate::profile::{CLOCK_TOLERANCE, Profile};

/// Constant frequency deviation of a device's clock.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Clock {
    /// The value of the key `clock`.
    Given(Ppb),
    /// Drawn by the seed, so that no two devices share a crystal: evenly within this limit in both
    /// directions. The limit is that of the key `clocks`, or else of the profile, or else
    /// [`CLOCK_TOLERANCE`].
    DrawnWithin(Ppb),
}

impl Clock {
    /// Its frequency deviation from true time in the run `seed`, for the device at this position
    /// (positive: faster). It does not depend on devices behind it or on other draws.
    pub fn deviation(self, seed: u64, position: usize) -> Ppb {
        match self {
            Self::Given(deviation) => deviation,
            Self::DrawnWithin(Ppb(most)) => {
                let most = most.unsigned_abs();
                let drawn = Stream::new(seed, "crystal", position as u64).up_to(2 * most);
                Ppb(drawn as i64 - most as i64)
            }
        }
    }
}

/// Reads a device's constant deviation; `tolerance` is the value of `clocks`.
pub(super) fn clock(
    keys: &Keys<'_>,
    profile: &Profile,
    tolerance: Option<Ppb>,
) -> Result<Clock, FileError> {
    let within = tolerance.or(profile.clock_tolerance).unwrap_or(CLOCK_TOLERANCE);
    Ok(keys.find("clock")?.map_or(Clock::DrawnWithin(within), Clock::Given))
}

/// Reads the changes of a device's clock, without its constant deviation.
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
