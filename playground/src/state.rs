//! What the page says: keys with texts, as they stand in its address line.
//!
//! Every key is described once, in [`KEYS`]: the page makes its controls of that, the address line is read by it, and a value
//! that is refused is refused in its words.

use std::collections::BTreeMap;
use std::fmt::Write;

use isocat::document::name_hint;
use isocat::quantity::{Length, Ppb, parse_duration};
use isocat_wire::Nanos;
use serde::Serialize;

/// A key of the state.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Key {
    /// As it stands in the address line.
    pub name: &'static str,
    /// What the page calls it.
    pub label: &'static str,
    /// One sentence more.
    pub help: &'static str,
    /// What values it has.
    pub kind: Kind,
    /// The value that needs not be said.
    pub default: &'static str,
    /// The part of the page that has it: `run`, `pulses`, or both.
    pub views: &'static [&'static str],
    /// Which heading it stands under.
    pub group: &'static str,
}

/// What values a key has.
#[derive(Clone, Copy, Debug, Serialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
pub enum Kind {
    /// One of some words: word, and what it means.
    Choice {
        /// The words.
        choices: &'static [(&'static str, &'static str)],
    },
    /// A span of time, ns; `own` means that nothing is asked for.
    Duration {
        /// Least.
        least: i64,
        /// Most.
        most: i64,
        /// What an arrow key adds, ns.
        step: i64,
        /// What stands in the place of a value if there is none: `None`, there must be one.
        own: Option<&'static str>,
    },
    /// A length, mm.
    Length {
        /// Least.
        least: i64,
        /// Most.
        most: i64,
    },
    /// A deviation of clocks, ppb.
    Rate {
        /// Largest, either way.
        most: i64,
    },
    /// A whole number.
    Count {
        /// Least.
        least: i64,
        /// Most.
        most: i64,
    },
}

/// The word for a value that nobody asks for.
pub const OWN: &str = "own";

const RUN: &[&str] = &["run"];
const PULSES: &[&str] = &["pulses"];
const BOTH: &[&str] = &["run", "pulses"];
const SWITCH: Kind = Kind::Choice { choices: &[("on", "on"), ("off", "off")] };

const fn duration(least: i64, most: i64, step: i64, own: Option<&'static str>) -> Kind {
    Kind::Duration { least, most, step, own }
}

/// All keys.
pub const KEYS: [Key; 24] = [
    Key {
        name: "view",
        label: "Look at",
        help: "A whole segment, or the SYNC unit of one ESC alone.",
        kind: Kind::Choice {
            choices: &[("run", "a segment that runs"), ("pulses", "SYNC signal generation")],
        },
        default: "run",
        views: BOTH,
        group: "",
    },
    Key {
        name: "mode",
        label: "Synchronization mode",
        help: "0x1C32:01 and 0x1C33:01 together.",
        kind: Kind::Choice {
            choices: &[
                ("free-run", "Free Run"),
                ("sm", "SM-synchronous"),
                ("dc-sync0", "DC SYNC0 (SM/SYNC0)"),
                ("dc-shift-sync1", "DC, inputs at SYNC1 (SM/SYNC0/SYNC1)"),
                ("dc-sync1", "DC SYNC1"),
                ("dc-subordinated", "DC, subordinated cycles"),
            ],
        },
        default: "dc-sync0",
        views: RUN,
        group: "Synchronization",
    },
    Key {
        name: "cycle",
        label: "Bus cycle",
        help: "Distance of the frames with process data; in DC modes 0x09A0 and 0x1C32:02.",
        kind: duration(100_000, 20_000_000, 1_000, None),
        default: "1ms",
        views: BOTH,
        group: "Synchronization",
    },
    Key {
        name: "phase",
        label: "SYNC0 in the cycle",
        help: "From the begin of the cycle to SYNC0.",
        kind: duration(0, 19_999_999, 1_000, Some("the plan chooses")),
        default: OWN,
        views: RUN,
        group: "Synchronization",
    },
    Key {
        name: "sync1",
        label: "SYNC1 behind SYNC0",
        help: "Register 0x09A4. In the SYNC unit any distance; in a segment below one cycle.",
        kind: duration(0, 60_000_000, 1_000, Some("as the mode has it")),
        default: OWN,
        views: BOTH,
        group: "Synchronization",
    },
    Key {
        name: "sync0-cycle",
        label: "SYNC0 cycle",
        help: "Register 0x09A0; in a segment for subordinated cycles. 0 ns is single shot.",
        kind: duration(0, 20_000_000, 1_000, Some("the bus cycle")),
        default: OWN,
        views: BOTH,
        group: "Synchronization",
    },
    Key {
        name: "shift",
        label: "Shift of Outputs Valid",
        help: "0x1C32:03, from the pulse to valid outputs.",
        kind: duration(0, 19_999_999, 1_000, Some("none")),
        default: OWN,
        views: RUN,
        group: "Synchronization",
    },
    Key {
        name: "input-shift",
        label: "Shift of Input Latch",
        help: "0x1C33:03, from the pulse or the SM event to the latch.",
        kind: duration(0, 19_999_999, 1_000, Some("none")),
        default: OWN,
        views: RUN,
        group: "Synchronization",
    },
    Key {
        name: "device",
        label: "Device",
        help: "A built-in profile; all SubDevices are of it.",
        kind: Kind::Choice {
            choices: &[
                ("model_every_mode", "model with every mode"),
                ("kollmorgen_akd2g", "drive: Kollmorgen AKD2G"),
                ("hpmicro_ecat_cia402_ssc", "drive: SSC sample (HPMicro)"),
                ("beckhoff_el2502-0010", "PWM terminal: Beckhoff EL2502-0010"),
            ],
        },
        default: "model_every_mode",
        views: RUN,
        group: "Devices",
    },
    Key {
        name: "devices",
        label: "Number of devices",
        help: "One behind the other.",
        kind: Kind::Count { least: 1, most: 8 },
        default: "3",
        views: RUN,
        group: "Devices",
    },
    Key {
        name: "calc-copy",
        label: "Calc and copy time, stated",
        help: "0x1C32:06: what the device says and the plan believes.",
        kind: duration(1, 10_000_000, 1_000, Some("the device's own")),
        default: OWN,
        views: RUN,
        group: "Devices",
    },
    Key {
        name: "copy-time",
        label: "… and really needed",
        help: "How long its CPU takes from SM2 to outputs ready. Above the stated time it eats the slack.",
        kind: duration(1, 10_000_000, 1, Some("as stated")),
        default: OWN,
        views: RUN,
        group: "Devices",
    },
    Key {
        name: "delay",
        label: "Delay time",
        help: "0x1C32:09, from the pulse to valid outputs: the hardware's.",
        kind: duration(0, 10_000_000, 1_000, Some("the device's own")),
        default: OWN,
        views: RUN,
        group: "Devices",
    },
    Key {
        name: "device-jitter",
        label: "Jitter of the device",
        help: "How late its steps begin behind a pulse, peak to peak.",
        kind: duration(0, 1_000_000, 100, Some("the device's own")),
        default: OWN,
        views: RUN,
        group: "Devices",
    },
    Key {
        name: "cable",
        label: "Cable between devices",
        help: "5 ns a metre.",
        kind: Kind::Length { least: 10, most: 1_000_000 },
        default: "10m",
        views: RUN,
        group: "Devices",
    },
    Key {
        name: "clocks",
        label: "Clocks are off by up to",
        help: "Each device its own share of it, some fast, some slow.",
        kind: Kind::Rate { most: 1_000_000 },
        default: "50ppm",
        views: RUN,
        group: "Clocks and host",
    },
    Key {
        name: "host-clock",
        label: "Clock of the host",
        help: "Of the machine that the MainDevice runs on.",
        kind: Kind::Rate { most: 1_000_000 },
        default: "12ppm",
        views: RUN,
        group: "Clocks and host",
    },
    Key {
        name: "host-jitter",
        label: "Jitter of the host",
        help: "How late its frames leave, peak to peak.",
        kind: duration(0, 5_000_000, 1_000, None),
        default: "20us",
        views: RUN,
        group: "Clocks and host",
    },
    Key {
        name: "drift-compensation",
        label: "Drift compensation",
        help: "Whether the system time is distributed, so that clocks stay together.",
        kind: SWITCH,
        default: "on",
        views: RUN,
        group: "Clocks and host",
    },
    Key {
        name: "force",
        label: "Run although the plan does not fit",
        help: "Without it the MainDevice refuses, and says by which line.",
        kind: SWITCH,
        default: "off",
        views: RUN,
        group: "Clocks and host",
    },
    Key {
        name: "cycles",
        label: "Cycles",
        help: "How many are judged once all devices are in OP.",
        kind: Kind::Count { least: 50, most: 2_000 },
        default: "300",
        views: RUN,
        group: "Clocks and host",
    },
    Key {
        name: "seed",
        label: "Seed",
        help: "Of everything random; the same seed gives the same run.",
        kind: Kind::Count { least: 0, most: 1_000_000 },
        default: "1",
        views: RUN,
        group: "Clocks and host",
    },
    Key {
        name: "pulse",
        label: "Pulse length",
        help: "Register 0x0982, from the EEPROM, in steps of 10 ns; 0 ns is acknowledge mode.",
        kind: duration(0, 655_350, 10, None),
        default: "100us",
        views: PULSES,
        group: "Synchronization",
    },
    Key {
        name: "acknowledge",
        label: "Acknowledge behind the edge",
        help: "When the local CPU reads 0x098E or 0x098F.",
        kind: duration(0, 60_000_000, 1_000, Some("never")),
        default: OWN,
        views: PULSES,
        group: "Synchronization",
    },
];

/// Something that can't be as the page says it.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
pub struct Problem {
    /// The key; empty concerns the whole.
    pub key: String,
    /// What is wrong and what is expected.
    pub message: String,
}

/// A state that was read: each key has a value of its kind.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct State(BTreeMap<&'static str, Value>);

#[derive(Clone, PartialEq, Eq, Debug)]
enum Value {
    Word(&'static str),
    Number(i64),
    Own,
}

impl State {
    /// Reads texts by key; keys that are not there have their default. Every mistake is told.
    pub fn read(texts: &BTreeMap<String, String>) -> Result<Self, Vec<Problem>> {
        let mut problems = Vec::new();
        for key in texts.keys() {
            // Which cycle and which device are looked at is no part of the run.
            if !KEYS.iter().any(|known| known.name == key) && !LOOKS.contains(&key.as_str()) {
                let mut message =
                    format!("unknown key \"{key}\"; expected one of the page's controls");
                let hint = name_hint(key, KEYS.iter().map(|key| key.name));
                if !hint.is_empty() {
                    let _ = write!(message, " ({hint})");
                }
                problems.push(Problem { key: key.clone(), message });
            }
        }
        let mut values = BTreeMap::new();
        for key in &KEYS {
            let text = texts.get(key.name).map_or(key.default, String::as_str).trim();
            match key.read(text) {
                Ok(value) => {
                    values.insert(key.name, value);
                }
                Err(message) => problems.push(Problem { key: key.name.to_owned(), message }),
            }
        }
        if problems.is_empty() { Ok(Self(values)) } else { Err(problems) }
    }

    /// The word of a key that has words.
    pub fn word(&self, key: &str) -> &'static str {
        match self.0.get(key) {
            Some(Value::Word(word)) => word,
            other => unreachable!("{key} is a choice, found {other:?}"),
        }
    }

    /// The number of a key in the smallest unit of its kind; `None` if nothing is asked for.
    pub fn number(&self, key: &str) -> Option<i64> {
        match self.0.get(key) {
            Some(Value::Number(number)) => Some(*number),
            _ => None,
        }
    }

    /// A span of time; `None` if nothing is asked for.
    pub fn time(&self, key: &str) -> Option<Nanos> {
        self.number(key).map(Nanos)
    }
}

/// Keys that say what is looked at, not what is run: the cycle, the device; `only=play` for the pictures of one cycle alone.
pub const LOOKS: [&str; 3] = ["at", "show", "only"];

impl Key {
    fn read(&self, text: &str) -> Result<Value, String> {
        let name = self.name;
        let number = |number: i64, least: i64, most: i64, show: fn(i64) -> String| {
            if (least..=most).contains(&number) {
                Ok(Value::Number(number))
            } else {
                let (least, most, found) = (show(least), show(most), show(number));
                Err(format!("{name} = {found}; expected {least} to {most}"))
            }
        };
        match self.kind {
            Kind::Choice { choices } => {
                let found = choices.iter().find(|(word, _)| *word == text);
                found.map(|(word, _)| Value::Word(word)).ok_or_else(|| {
                    let words: Vec<_> = choices.iter().map(|(word, _)| *word).collect();
                    format!("{name} = \"{text}\"; expected one of {}", words.join(", "))
                })
            }
            Kind::Duration { own: Some(_), .. } if text == OWN => Ok(Value::Own),
            Kind::Duration { least, most, .. } => {
                let time = parse_duration(text).map_err(|error| format!("{name}: {error}"))?;
                number(time.0, least, most, |ns| Nanos(ns).to_string())
            }
            Kind::Length { least, most } => {
                let length: Length = text.parse().map_err(|error| format!("{name}: {error}"))?;
                number(length.0, least, most, |mm| Length(mm).to_string())
            }
            Kind::Rate { most } => {
                let rate: Ppb = text.parse().map_err(|error| format!("{name}: {error}"))?;
                number(rate.0, -most, most, |ppb| Ppb(ppb).to_string())
            }
            Kind::Count { least, most } => {
                let count = text.parse().map_err(|_| {
                    format!("{name} = \"{text}\"; expected a whole number from {least} to {most}")
                })?;
                number(count, least, most, |count| count.to_string())
            }
        }
    }
}
