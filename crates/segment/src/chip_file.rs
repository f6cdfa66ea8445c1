//! The measured properties of the chips of a segment, device by device: `isocat calibrate --chips`
//! writes such a file, and `plan`, `run` and `serve` read it in addition to the segment file.
//!
//! ```toml
//! [[chip]]
//! position = 1                  # in the order of frames; without it: all devices without a table
//! drift_law = "hold"
//! drift_phase = 10
//! difference_polarity = "positive-ahead"
//! eeprom_read = "1ms"
//! port_jitter = "40ns"
//! ```
//!
//! Each key is one of `[esc]` of a profile, and takes precedence over it.

use std::collections::HashMap;

use isocat_descriptions::document::section::{Key, Keys, Kind, Need, Section};
use isocat_descriptions::document::{FileError, Source, Table};

use crate::chips;
use crate::scenario::Scenario;

/// A file of measured properties, read and checked as far as possible without a segment.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct ChipFile {
    path: String,
    text: String,
}

impl ChipFile {
    /// Reads such a file; `path` names it in errors.
    pub fn parse(path: &str, text: &str) -> Result<Self, FileError> {
        let source = Source { path, text };
        let document = source.parse()?;
        let root = Keys::open(Table::root(source, &document), &FILE)?;
        let tables = root.tables("chip")?;
        if tables.is_empty() {
            return Err(root.error("no chip in the file; expected one or more tables [[chip]]"));
        }
        let mut lines: HashMap<Option<usize>, usize> = HashMap::new();
        for (number, table) in tables.iter().enumerate() {
            let position = table.find::<usize>("position")?;
            if lines.insert(position, number).is_some() {
                return Err(table.error(match position {
                    Some(at) => format!("position {at} has a table already; expected one for each"),
                    None => "a second table without a position; expected one".to_owned(),
                }));
            }
            // Values and their ranges do not depend on the chip.
            chips::measured(&isocat_esc::ET1100, table)?;
        }
        Ok(Self { path: path.to_owned(), text: text.to_owned() })
    }

    /// Reads such a file from disk.
    pub fn read(path: &str) -> Result<Self, FileError> {
        let text =
            std::fs::read_to_string(path).map_err(|reason| FileError::unreadable(path, &reason))?;
        Self::parse(path, &text)
    }

    /// Gives the devices of a scenario the measured chips. The other devices keep the drift law
    /// that the segment file sets for all. An error names a device that does not exist.
    pub fn apply(&self, scenario: &mut Scenario) -> Result<(), FileError> {
        let source = Source { path: &self.path, text: &self.text };
        let document = source.parse()?;
        let tables = Keys::open(Table::root(source, &document), &FILE)?.tables("chip")?;
        let law = scenario.drift_law.take();
        for device in &mut scenario.devices {
            let chip = chips::with_law(device.profile.esc(), law);
            device.profile = device.profile.with_chip(chip);
        }
        let count = scenario.devices.len();
        let mut own = vec![false; count];
        let mut all = None;
        for table in &tables {
            let Some(position) = table.find::<usize>("position")? else {
                all = Some(table);
                continue;
            };
            let Some(device) = scenario.devices.get_mut(position) else {
                let message = format!(
                    "position {position} is not in the segment; expected 0 to {}",
                    count.saturating_sub(1)
                );
                return Err(table.error_at("position", message));
            };
            device.profile =
                device.profile.with_chip(chips::measured(device.profile.esc(), table)?);
            own[position] = true;
        }
        let Some(table) = all else { return Ok(()) };
        for (device, own) in scenario.devices.iter_mut().zip(own) {
            if !own {
                device.profile =
                    device.profile.with_chip(chips::measured(device.profile.esc(), table)?);
            }
        }
        Ok(())
    }
}

static FILE: Section = Section {
    head: "",
    means: "What was measured of the chips of a segment.",
    keys: &[Key {
        name: "chip",
        kind: Kind::Tables(&CHIP),
        need: Need::Without("nothing"),
        means: "A chip.",
        goes: "the simulated ESCs",
        example: "",
    }],
    rules: &[],
};

static CHIP: Section = Section {
    head: "[[chip]]",
    means: "What was measured of one chip.",
    keys: &[
        Key {
            name: "position",
            kind: Kind::Integer { least: 0, most: 65_535 },
            need: Need::Without("all devices that have no table of their own"),
            means: "Which device it is, in the order in which frames meet them, from 0.",
            goes: "the device whose chip it is",
            example: "1",
        },
        chips::DRIFT_LAW,
        chips::DRIFT_PHASE,
        chips::DRIFT_GAIN,
        chips::DIFFERENCE_POLARITY,
        chips::EEPROM_READ,
        chips::PORT_JITTER,
    ],
    rules: &[],
};

#[cfg(test)]
mod tests {
    use isocat_esc::DriftLaw;
    use isocat_wire::Nanos;
    use isocat_wire::dc::DifferencePolarity;
    use isocat_wire::time::Picos;

    use super::*;
    use crate::SegmentFile;

    fn scenario(head: &str) -> Scenario {
        let text = format!(
            "cycle = \"1ms\"\n{head}\n[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\ncount = 3\n"
        );
        Scenario::from(SegmentFile::parse("three.toml", &text).expect("a segment file"))
    }

    #[test]
    fn each_device_gets_its_own() {
        let file = ChipFile::parse(
            "chips.toml",
            "[[chip]]\nposition = 1\ndrift_law = \"hold\"\ndrift_phase = 11\nport_jitter = \"8ns\"\n\
             [[chip]]\neeprom_read = \"1.2ms\"\ndifference_polarity = \"negative-ahead\"\n",
        )
        .expect("a file");
        let mut scenario = scenario("drift_law = \"block\"");
        file.apply(&mut scenario).expect("it fits");
        let chips: Vec<_> = scenario.devices.iter().map(|device| device.profile.esc()).collect();
        let laws: Vec<_> = chips.iter().map(|chip| chip.drift_law).collect();
        // The devices without measurements keep the setting for all of the segment file.
        assert_eq!(laws, [DriftLaw::BLOCK, DriftLaw::Hold { phase: 11 }, DriftLaw::BLOCK]);
        assert_eq!(scenario.drift_law, None);
        let periods: Vec<_> = chips.iter().map(|chip| chip.rx_fifo.mii_period).collect();
        assert_eq!(periods, [40_000, 8_000, 40_000].map(Picos));
        let reads: Vec<_> = chips.iter().map(|chip| chip.eeprom_read_time).collect();
        assert_eq!(reads, [1_200, 20, 1_200].map(Nanos::micros));
        let polarities: Vec<_> = chips.iter().map(|chip| chip.difference_polarity).collect();
        let (new, old) = (DifferencePolarity::NegativeAhead, DifferencePolarity::PositiveAhead);
        assert_eq!(polarities, [new, old, new]);
    }

    #[test]
    fn mistakes_are_told_with_their_place() {
        for (text, expected) in [
            ("", "no chip in the file"),
            ("[[chip]]\nlaw = \"hold\"\n", "2:1: unknown key \"law\""),
            ("[[chip]]\nposition = 1\n[[chip]]\nposition = 1\n", "position 1 has a table already"),
            ("[[chip]]\n[[chip]]\n", "a second table without a position"),
            ("[[chip]]\ndrift_law = \"hold\"\ndrift_gain = 4\n", "expected the law proportional"),
            ("[[chip]]\nport_jitter = \"1.001us\"\n", "port_jitter"),
            ("[[chip]]\neeprom_read = \"50.001ms\"\n", "eeprom_read"),
            ("[[chip]]\ndrift_gain = 0\n", "drift_gain"),
        ] {
            let error = ChipFile::parse("chips.toml", text).expect_err(text).to_string();
            assert!(error.contains(expected), "{text}: {error}");
        }
        let third = |position: usize| {
            let text = format!("[[chip]]\nposition = {position}\ndrift_gain = 8\n");
            let file = ChipFile::parse("chips.toml", &text).expect("a file");
            file.apply(&mut scenario("")).map_err(|error| error.to_string())
        };
        assert_eq!(third(2), Ok(()));
        assert!(third(3).is_err_and(|error| error.contains("expected 0 to 2")));
    }
}
