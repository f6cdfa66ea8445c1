//! The OpMode of its description in which a SubDevice runs.

use std::fmt::{self, Write};

use isocat_descriptions::columns::{WIDTH, wrap};
use isocat_segment::segment_file::SubDevice;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Serialize;

use crate::fold::positions;

/// An OpMode (ESI, `Dc/OpMode`).
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct OpMode {
    /// Its name in the description.
    pub name: String,
    /// Its number in the description, from 0.
    pub number: usize,
}

impl OpMode {
    /// That of a device of the segment file; `None` for one without.
    pub(crate) fn of(device: &SubDevice) -> Option<Self> {
        let taken = device.op_mode.as_ref()?;
        Some(Self { name: taken.name.clone(), number: taken.number })
    }
}

impl fmt::Display for OpMode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.name.as_str() {
            "" => write!(f, "OpMode {}", self.number),
            name => write!(f, "OpMode \"{name}\""),
        }
    }
}

/// The OpModes below a table of SubDevices, each once with their positions; nothing without.
pub(crate) fn write<'a>(
    out: &mut String,
    devices: impl Iterator<Item = (usize, &'a OpMode)>,
) -> fmt::Result {
    let mut all: Vec<(String, Vec<usize>)> = Vec::new();
    for (position, op_mode) in devices {
        let name = op_mode.to_string();
        match all.iter_mut().find(|(known, _)| *known == name) {
            Some((_, positions)) => positions.push(position),
            None => all.push((name, vec![position])),
        }
    }
    let words = |(name, at): &(String, Vec<usize>)| format!("{name}: {}", positions(at));
    let mut parts: Vec<String> = all.iter().take(MOST).map(words).collect();
    if all.len() > MOST {
        parts.push(format!("{} more OpModes, which --json lists", all.len() - MOST));
    }
    if !parts.is_empty() {
        for line in wrap(&parts.join("; "), WIDTH - 2) {
            writeln!(out, "  {line}")?;
        }
    }
    Ok(())
}

/// Largest number of OpModes that are named.
const MOST: usize = 12;
