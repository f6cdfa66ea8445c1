//! `[[output]]`: from its keys to the values that the MainDevice's application writes.

use std::str::FromStr;

use isocat_descriptions::document::section::Keys;
use isocat_descriptions::document::{FileError, Value};
use isocat_maindevice::segment::Pdo;
use isocat_maindevice::written::{Bits, Output, Shape, Start};
use isocat_sim::fault::{Moment, When};
use isocat_wire::ObjectAddress;

use super::{SubDevice, expect, fault, keys};
use crate::offline;

pub(super) fn outputs(root: &Keys<'_>, devices: &[SubDevice]) -> Result<Vec<Output>, FileError> {
    let mut all: Vec<Output> = Vec::new();
    for keys in &root.tables("output")? {
        let start = match fault::when(&keys.required("at")?)? {
            When::At(time) => Start::At(time),
            When::After(Moment::InOperation, later) => Start::InOperation(later),
            When::After(Moment::Cycle(count), later) => Start::Cycle(count, later),
        };
        let device = expect::position(&keys.required("device")?, devices)?;
        let pdos = &offline::process_data(&devices[device])[0];
        let value = keys.required("place")?;
        let place = place(&value, keys.find_choice("type", &keys::TYPES)?, pdos, "outputs")?;
        let output = Output { device, place, start, shape: shape(keys, place)? };
        if let Some(message) = all.iter().find_map(|other| contradiction(&output, other)) {
            return Err(value.error(message));
        }
        all.push(output);
    }
    Ok(all)
}

fn shape(keys: &Keys<'_>, place: Bits) -> Result<Shape, FileError> {
    let sine: Option<i64> = keys.find("amplitude")?;
    let refuse = |key: &'static str, beside: &str| match keys.value(key) {
        Some(value) => Err(value.error(format!("{key} is given without {beside} beside it"))),
        None => Ok(()),
    };
    let Some(amplitude) = sine else {
        refuse("period", "amplitude")?;
        refuse("lasts", "amplitude")?;
        let value: i64 = match keys.find("value")? {
            Some(value) => value,
            None => {
                return Err(keys.error(
                    "nothing is written; expected a number, such as value = 1000, or a sine by amplitude and period",
                ));
            }
        };
        let (least, most) = place.range();
        if !(least..=most).contains(&value) {
            let message = format!("{value} does not fit there; expected {least} to {most}");
            return Err(keys.error_at("value", message));
        }
        return Ok(Shape::Value { value, over: keys.get("over")? });
    };
    if let Some(value) = keys.value("value") {
        return Err(value.error("value is given beside amplitude; expected one of both"));
    }
    refuse("over", "value")?;
    Ok(Shape::Sine { amplitude, period: keys.get("period")?, lasts: keys.find("lasts")? })
}

/// Why two outputs contradict each other: their bits overlap partly, or they set two values from
/// one instant on.
fn contradiction(one: &Output, other: &Output) -> Option<String> {
    let (a, b) = (one.place, other.place);
    if one.device != other.device || a.end() <= b.at || b.end() <= a.at {
        return None;
    }
    if a != b {
        return Some(format!(
            "bits {} to {} are written here, and bits {} to {} by another output; expected the same bits, or none in common",
            a.at,
            a.end() - 1,
            b.at,
            b.end() - 1
        ));
    }
    let at_once = one.start == other.start;
    at_once.then(|| {
        "another output begins at the same instant in the same place; expected another instant"
            .to_owned()
    })
}

/// The bits of a place in process data with these PDOs, with a type if one is given; `what` names
/// the direction.
pub(super) fn place(
    value: &Value<'_>,
    of_type: Option<(u8, bool)>,
    pdos: &[Pdo],
    what: &str,
) -> Result<Bits, FileError> {
    let expected = "an object such as \"0x607A:00\", or a byte such as \"byte 2\"";
    let text = value.name(expected)?.trim();
    let bits: u32 = pdos.iter().map(Pdo::bits).sum();
    if let Some(byte) = text.strip_prefix("byte ") {
        let (len, signed) = of_type.unwrap_or((32, true));
        let byte = u32::from_str(byte.trim())
            .map_err(|_| value.error(format!("\"{text}\" is no place; expected {expected}")))?;
        let place = byte.checked_mul(8).map(|at| Bits { at, len, signed });
        return place.filter(|place| place.at <= bits && place.end() <= bits).ok_or_else(|| {
            value.error(format!(
                "{len} bits from byte {byte} on end behind the {what}; expected a place in {} bytes",
                bits / 8
            ))
        });
    }
    let object = object(text)
        .ok_or_else(|| value.error(format!("\"{text}\" is no place; expected {expected}")))?;
    if let Some(bits) = offline::bits_of(pdos, object.index, object.sub) {
        return of_entry(value, bits, of_type);
    }
    let mapped = pdos.iter().flat_map(|pdo| &pdo.entries).filter(|entry| entry.index != 0);
    let names: Vec<_> =
        mapped.map(|entry| ObjectAddress::new(entry.index, entry.sub).to_string()).collect();
    Err(value.error(match &names[..] {
        [] => format!(
            "{object} is not mapped, as the device has no {what}; expected a device that has"
        ),
        _ => format!("{object} is not mapped in the {what}; expected one of {}", names.join(", ")),
    }))
}

/// A mapped entry, with a type if one is given.
fn of_entry(
    value: &Value<'_>,
    place: Bits,
    of_type: Option<(u8, bool)>,
) -> Result<Bits, FileError> {
    if !(1..=32).contains(&place.len) {
        let message = format!("it has {} bits; expected an object of 1 to 32 bits", place.len);
        return Err(value.error(message));
    }
    match of_type {
        Some((len, _)) if len != place.len => Err(value.error(format!(
            "it is mapped with {} bits, and the type has {len}; expected a type of as many, or none",
            place.len
        ))),
        Some((_, signed)) => Ok(Bits { signed, ..place }),
        None => Ok(place),
    }
}

/// An object such as `0x607A:00`; without a sub-index it is 0.
fn object(text: &str) -> Option<ObjectAddress> {
    let (index, sub) = text.strip_prefix("0x")?.split_once(':').unwrap_or((&text[2..], "0"));
    let is_hex = |text: &str| text.bytes().all(|byte| byte.is_ascii_hexdigit());
    let (index, sub) = (index.trim(), sub.trim());
    if !is_hex(index) || !is_hex(sub) {
        return None;
    }
    let index = u16::from_str_radix(index, 16).ok()?;
    Some(ObjectAddress::new(index, u8::from_str_radix(sub, 16).ok()?))
}
