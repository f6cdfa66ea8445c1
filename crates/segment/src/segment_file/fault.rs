//! `[[fault]]`: from its keys to the faults of a simulation.

use std::str::FromStr;
use std::sync::Arc;

use isocat_descriptions::document::section::Keys;
use isocat_descriptions::document::{FileError, Value};
use isocat_descriptions::quantity::parse_duration;
use isocat_sim::Fault;
use isocat_sim::fault::{MILLION, Moment, Planned, RING_CABLE, When};
use isocat_wire::time::Nanos;

use super::{Ring, SubDevice};
use crate::fault::Order;
use crate::profile::Profile;

/// Planned faults.
#[derive(Clone, Debug, Default)]
pub struct Faults {
    /// The faults and their times. SubDevices are named by their position.
    pub planned: Vec<Planned>,
    /// Replacement devices, by the number in [`Fault::Replace`].
    pub spares: Vec<Arc<Profile>>,
}

pub(super) fn faults(
    root: &Keys<'_>,
    devices: &[SubDevice],
    ring: Option<Ring>,
) -> Result<Faults, FileError> {
    let tables = root.tables("fault")?;
    let mut faults = Faults::default();
    if tables.is_empty() {
        return Ok(faults);
    }
    let names: Vec<String> = devices.iter().map(|device| device.name.clone()).collect();
    for keys in &tables {
        let what = keys.required("what")?;
        let mut order =
            Order::parse(what.name("a fault")?, &names).map_err(|message| what.error(message))?;
        if ring.is_none() && order.fault.cable() == Some(RING_CABLE) {
            return Err(what
                .error("ring is the cable that closes a ring; expected ring = true in this file"));
        }
        if let (Fault::Replace { device, spare, .. }, Some(profile)) =
            (&mut order.fault, order.spare.clone())
        {
            fits(&profile, devices, *device, ring).map_err(|message| what.error(message))?;
            *spare = faults.spares.len();
            faults.spares.push(profile);
        }
        let times: u32 = keys.get("times")?;
        if times > 1 && order.spare.is_some() {
            return Err(what.error("a device is replaced once; expected no times"));
        }
        if keys.value("times").is_some() && keys.value("every").is_none() {
            return Err(keys.error_at("times", "times is given without every beside it".to_owned()));
        }
        let every = keys.find("every")?.unwrap_or(Nanos::ZERO);
        faults.planned.push(Planned {
            when: when(&keys.required("at")?)?,
            within: keys.get("within")?,
            ppm: keys.value("chance").map_or(Ok(MILLION), |value| share(&value))?,
            times,
            every,
            lasts: order.lasts,
            fault: order.fault,
        });
    }
    Ok(faults)
}

/// Checks that a replacement device has the ports at which there are cables.
fn fits(
    profile: &Profile,
    devices: &[SubDevice],
    position: usize,
    ring: Option<Ring>,
) -> Result<(), String> {
    let place = devices[position].place;
    let behind = devices.iter().filter_map(|device| device.place.upstream);
    let ports = behind.filter(|(above, _)| *above == position).map(|(_, port)| port);
    let old = devices[position].profile.esc();
    let closing = ring.filter(|ring| ring.device == position).map(|ring| ring.port);
    for port in ports.chain([place.port]).chain(closing) {
        let (has, had) = (profile.esc().port(port), old.port(port));
        if has != had {
            return Err(format!(
                "{} can't take the place of \"{}\": its port {port} is {has:?}, expected {had:?}",
                profile.id, devices[position].name
            ));
        }
    }
    Ok(())
}

/// `2s`, `cycle 500`, `in-operation + 100ms`; a `when` before it is redundant.
pub(super) fn when(value: &Value<'_>) -> Result<When, FileError> {
    let expected = "\"2s\", \"cycle 500\" or \"in-operation + 100ms\"";
    let text = value.name(expected)?;
    let trimmed = text.trim();
    let trimmed = trimmed.strip_prefix("when ").unwrap_or(trimmed).trim();
    let wrong = || value.error(format!("\"{text}\" is no instant; expected {expected}"));
    let duration = |text: &str| {
        let time = parse_duration(text).map_err(|error| value.error(error.to_string()))?;
        let valid = (Nanos::ZERO..=super::keys::LONGEST_RUN).contains(&time);
        valid.then_some(time).ok_or_else(|| value.error(format!("{text} is not from 0 to 24 h")))
    };
    let (point, later) = match trimmed.split_once('+') {
        Some((point, later)) => (point.trim(), duration(later.trim())?),
        None => (trimmed, Nanos::ZERO),
    };
    if point == "in-operation" {
        return Ok(When::After(Moment::InOperation, later));
    }
    if let Some(number) = point.strip_prefix("cycle ") {
        let number = u64::from_str(number.trim()).map_err(|_| wrong())?;
        return Ok(When::After(Moment::Cycle(number), later));
    }
    match trimmed.contains('+') {
        true => Err(wrong()),
        false => duration(point).map(When::At),
    }
}

/// A percentage in parts per million.
fn share(value: &Value<'_>) -> Result<u32, FileError> {
    let expected = "a share above \"0%\", up to \"100%\"";
    let text = value.name(expected)?;
    let percent = text.trim().strip_suffix('%').and_then(|text| f64::from_str(text.trim()).ok());
    let within = percent.filter(|percent| (0.0..=100.0).contains(percent));
    // What can't happen tests nothing.
    match within.map(|percent| (percent * f64::from(MILLION / 100)).round() as u32) {
        Some(ppm @ 1..) => Ok(ppm),
        _ => Err(value.error(format!("\"{text}\"; expected {expected}"))),
    }
}
