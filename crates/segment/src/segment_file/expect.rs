//! `[[expect]]`: from its keys to the expectations of the judges.

use isocat_descriptions::document::section::Keys;
use isocat_descriptions::document::{FileError, Value};
use isocat_sim::Expectation;
use isocat_sim::fault::{Moment, When};
use isocat_sim::plant::PlantSetup;
use isocat_wire::time::Nanos;

use super::{SubDevice, fault};

pub(super) fn expectations(
    root: &Keys<'_>,
    devices: &[SubDevice],
    plants: &[PlantSetup],
) -> Result<Vec<Expectation>, FileError> {
    let mut all = Vec::new();
    for keys in &root.tables("expect")? {
        let before = all.len();
        let device = keys.value("device").map(|value| position(&value, devices)).transpose()?;
        all.extend(keys.find("in_sync")?.map(Expectation::InSync));
        if let Some(value) = keys.value("in_sync_at") {
            all.push(Expectation::InSyncAt(instant(&value)?));
        }
        let worst: Option<Nanos> = keys.find("worst_sync0")?;
        let deviation: Option<f64> = keys.find("plant_deviation")?;
        if let (None, None, Some(value)) = (worst, deviation, keys.value("device")) {
            return Err(
                value.error("device is given without worst_sync0 or plant_deviation beside it")
            );
        }
        if let (Some(_), Some(value)) = (deviation, keys.value("plant_deviation")) {
            let of = |plant: &PlantSetup| device.is_none_or(|device| plant.device == device);
            if !plants.iter().any(of) {
                return Err(value.error("there is no such plant; expected a [[plant]]"));
            }
        }
        all.extend(deviation.map(|um| {
            let limit_nm = (um * 1_000.0).round() as u64;
            Expectation::PlantDeviation { device, limit_nm }
        }));
        all.extend(worst.map(|limit| Expectation::WorstSync0 { device, limit }));
        all.extend(keys.find("recovers_within")?.map(Expectation::RecoversWithin));
        all.extend(keys.find("safe_within")?.map(Expectation::SafeWithin));
        if let Some(value) = keys.value("blames") {
            all.push(Expectation::Blames(position(&value, devices)?));
        }
        if all.len() == before {
            return Err(
                keys.error("nothing is expected; expected a key such as in_sync_at = \"5s\"")
            );
        }
    }
    Ok(all)
}

fn instant(value: &Value<'_>) -> Result<When, FileError> {
    match fault::when(value)? {
        When::After(Moment::Cycle(_), _) => Err(value
            .error("expectations do not count cycles; expected \"5s\" or \"in-operation + 2s\"")),
        when => Ok(when),
    }
}

/// A device by its name, or by its position.
pub(super) fn position(value: &Value<'_>, devices: &[SubDevice]) -> Result<usize, FileError> {
    let text = value.name("the name of a device, or its position")?;
    if let Some(position) = devices.iter().position(|device| device.name == text) {
        return Ok(position);
    }
    let position = text.parse().ok().filter(|position| *position < devices.len());
    position.ok_or_else(|| {
        let last = devices.len().saturating_sub(1);
        value
            .error(format!("no device \"{text}\"; expected a name, or a position from 0 to {last}"))
    })
}
