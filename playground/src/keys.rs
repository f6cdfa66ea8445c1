//! The keys of the page: its controls are built from them, and the address line is read by them.
//!
//! A key that stands for a key of a segment file takes its sentence, values, range and default from
//! the declaration of that key ([`isocat::keys`]). The page adds a label of its own, and often a
//! smaller range, which a page can run and show in a short time.

use std::sync::LazyLock;

use isocat::document::section::{Kind as Declared, Need};
use isocat::keys::{Place, find};
use serde::Serialize;

/// A key of the page.
#[derive(Clone, Debug, Serialize)]
pub struct Key {
    /// Its name in the address line.
    pub name: &'static str,
    /// Its label on the page.
    pub label: &'static str,
    /// An explanation of a sentence or two.
    pub help: String,
    /// The kind of its values.
    pub kind: Kind,
    /// The value that the address line may omit.
    pub default: String,
    /// The parts of the page that have it: `run`, `pulses`, or both.
    pub views: &'static [&'static str],
    /// The heading that it is under.
    pub group: &'static str,
    /// The key of a segment file that it stands for, as a path.
    #[serde(skip)]
    pub of: Option<&'static str>,
}

/// The kind of a key's values.
#[derive(Clone, Debug, Serialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
pub enum Kind {
    /// One of some words: each word, and its meaning.
    Choice {
        /// The words.
        choices: Vec<(&'static str, &'static str)>,
    },
    /// A span of time, ns; `own` means that no value is requested.
    Duration {
        /// Smallest value.
        least: i64,
        /// Largest value.
        most: i64,
        /// The step of an arrow key, ns.
        step: i64,
        /// The text that is shown without a value; `None`: a value is required.
        own: Option<&'static str>,
    },
    /// A length, mm.
    Length {
        /// Smallest value.
        least: i64,
        /// Largest value.
        most: i64,
    },
    /// A deviation of clocks, ppb.
    Rate {
        /// Largest deviation in both directions.
        most: i64,
    },
    /// A whole number.
    Count {
        /// Smallest value.
        least: i64,
        /// Largest value.
        most: i64,
    },
    /// Lines in a language of their own; may be empty.
    Lines {
        /// An example of a line.
        example: &'static str,
    },
}

/// The word that requests no value.
pub const OWN: &str = "own";

const RUN: &[&str] = &["run"];
const PULSES: &[&str] = &["pulses"];
const BOTH: &[&str] = &["run", "pulses"];
/// Longest bus cycle that the page shows, ns.
pub const LONGEST_CYCLE: i64 = 20_000_000;
/// Longest time that a device can state, ns; a cycle of the page can't show longer ones.
const LONGEST_TIME: i64 = 10_000_000;

/// All keys.
pub static KEYS: LazyLock<Vec<Key>> = LazyLock::new(|| {
    let mut keys = vec![page(
        "view",
        "Look at",
        "A whole segment, or the SYNC unit of one ESC alone.",
        choice(&[("run", "a segment that runs"), ("pulses", "SYNC signal generation")]),
        "run",
        BOTH,
    )];
    keys.extend(under("Synchronization", synchronization()));
    keys.extend(under("Devices", devices()));
    keys.extend(under("Clocks and host", clocks_and_host()));
    keys.extend(under("What goes wrong", what_goes_wrong()));
    keys.extend(under("Synchronization", pulses()));
    keys
});

fn synchronization() -> Vec<Key> {
    vec![
        of_file("mode", "subdevice.mode", "Synchronization mode")
            .choices(&[
                ("free-run", "Free Run"),
                ("sm", "SM-synchronous"),
                ("dc-sync0", "DC SYNC0 (SM/SYNC0)"),
                ("dc-shift-sync1", "DC, inputs at SYNC1 (SM/SYNC0/SYNC1)"),
                ("dc-sync1", "DC SYNC1"),
                ("dc-subordinated", "DC, subordinated cycles"),
            ])
            .default("dc-sync0"),
        of_file("cycle", "cycle", "Bus cycle")
            .between(100_000, LONGEST_CYCLE)
            .default("1ms")
            .in_both(),
        of_file("phase", "shift", "SYNC0 in the cycle").own("the plan chooses"),
        of_file("sync1", "subdevice.sync1", "SYNC1 behind SYNC0")
            .also("In the SYNC unit any distance.")
            .between(0, 60_000_000)
            .own("as the mode has it")
            .in_both(),
        of_file("sync0-cycle", "subdevice.sync0_cycle", "SYNC0 cycle")
            .also("In the SYNC unit any cycle; 0 ns is single shot.")
            .between(0, LONGEST_CYCLE)
            .own("the bus cycle")
            .in_both(),
        of_file("shift", "subdevice.shift", "Shift of Outputs Valid").own("none"),
        of_file("input-shift", "subdevice.input_shift", "Shift of Input Latch").own("none"),
    ]
}

fn devices() -> Vec<Key> {
    vec![
        of_file("device", "subdevice.device", "Device")
            .also("All SubDevices are of it.")
            .choices(&[
                ("model_every_mode", "model with every mode"),
                ("kollmorgen_akd2g", "drive: Kollmorgen AKD2G"),
                ("hpmicro_ecat_cia402_ssc", "drive: SSC sample (HPMicro)"),
                ("beckhoff_el2502-0010", "PWM terminal: Beckhoff EL2502-0010"),
            ])
            .default("model_every_mode"),
        page("devices", "Number of devices", "One behind the other.", count(1, 8), "3", RUN),
        of_file("calc-copy", "subdevice.calc_copy", "Calc and copy time, stated")
            .between(1, LONGEST_TIME),
        of_file("copy-time", "subdevice.copy_time", "… and really needed")
            .between(1, LONGEST_TIME)
            .step(1)
            .own("as stated"),
        of_file("delay", "subdevice.delay", "Delay time").between(0, LONGEST_TIME),
        of_file("device-jitter", "subdevice.jitter", "Jitter of the device")
            .between(0, 1_000_000)
            .step(100)
            .own("the device's own"),
        of_file("cable", "subdevice.cable", "Cable between devices").between(10, 1_000_000),
        Key {
            help: "Each device its own share of it, some fast, some slow.".into(),
            ..of_file("clocks", "subdevice.clock", "Clocks are off by up to").default("50ppm")
        },
    ]
}

fn clocks_and_host() -> Vec<Key> {
    vec![
        of_file("host-clock", "host.clock", "Clock of the host"),
        of_file("host-jitter", "host.jitter", "Jitter of the host")
            .between(0, 5_000_000)
            .default("20us"),
        of_file("drift-compensation", "host.drift_compensation", "Drift compensation"),
        page(
            "force",
            "Run although the plan does not fit",
            "Without it the MainDevice refuses, and says by which line.",
            choice(&SWITCH),
            "off",
            RUN,
        ),
        page(
            "cycles",
            "Cycles",
            "How many are judged once all devices are in OP.",
            count(50, 2_000),
            "300",
            RUN,
        ),
        of_file("seed", "seed", "Seed").between(0, 1_000_000),
    ]
}

/// The key for the lines of faults in a segment file.
pub const FAULTS: &str = "faults";
/// Pauses between the attempts to re-admit devices: short, because a run of the page is short.
pub const AGAIN: &str = "{ first = \"20ms\", longest = \"100ms\" }";

fn what_goes_wrong() -> Vec<Key> {
    vec![
        page(
            FAULTS,
            "Faults",
            "One a line: when, a colon, what. After the power-on (0.5s), after so many cycles (cycle 500), or once all are in \
             OP (in-operation + 50ms). Words as in segment files: drop 5, delay 200us for 10ms, pull 1 for 20ms, \
             power-cycle 2, clock 1 +50ppm, stall 5ms, sync-off 1, al-error 1 0x8000 …",
            Kind::Lines { example: "in-operation + 50ms: pull 1 for 20ms" },
            "",
            RUN,
        ),
        of_file("recovery", "recovery", "Devices that leave OP").choices(&[
            ("never", "stay out"),
            ("once", "are brought back once"),
            ("again", "are brought back again and again"),
        ]),
    ]
}

fn pulses() -> Vec<Key> {
    let span = |most, step, own| Kind::Duration { least: 0, most, step, own };
    vec![
        page(
            "pulse",
            "Pulse length",
            "Register 0x0982, from the EEPROM, in steps of 10 ns; 0 ns is acknowledge mode.",
            span(655_350, 10, None),
            "100us",
            PULSES,
        ),
        page(
            "acknowledge",
            "Acknowledge behind the edge",
            "When the local CPU reads 0x098E or 0x098F.",
            span(60_000_000, 1_000, Some("never")),
            OWN,
            PULSES,
        ),
    ]
}

/// A key that only the page has.
fn page(
    name: &'static str,
    label: &'static str,
    help: &str,
    kind: Kind,
    default: &str,
    views: &'static [&'static str],
) -> Key {
    let (help, default) = (help.to_owned(), default.to_owned());
    Key { name, label, help, kind, default, views, group: "", of: None }
}

/// A key that stands for the key of a segment file at `path`.
fn of_file(name: &'static str, path: &'static str, label: &'static str) -> Key {
    let place = in_file(path);
    let help = format!("{} Goes to: {}.", place.key.means, place.key.goes);
    let (own, default) = match place.key.need {
        Need::Default("true") => (None, "on".to_owned()),
        Need::Default(text) => (None, text.trim_matches('"').to_owned()),
        Need::Without(words) => (Some(words), OWN.to_owned()),
        Need::Required(_) | Need::Sometimes(..) => (None, String::new()),
    };
    let kind = match place.key.kind {
        Declared::Duration { least, most, .. } => {
            let (least, most) = (least.at(LONGEST_CYCLE), most.at(LONGEST_CYCLE));
            Kind::Duration { least, most, step: 1_000, own }
        }
        Declared::Length { least, most } => Kind::Length { least, most },
        Declared::Rate { most, .. } => Kind::Rate { most },
        Declared::Integer { least, most } => count(least, most),
        Declared::Boolean => choice(&SWITCH),
        // The page chooses the words.
        _ => choice(&[]),
    };
    Key { name, label, help, kind, default, views: RUN, group: "", of: Some(path) }
}

/// The key of a segment file at a path.
pub fn in_file(path: &str) -> Place {
    let mut places = find(path).into_iter().filter(|place| place.path() == path);
    places.next().unwrap_or_else(|| panic!("segment files have no key {path}"))
}

impl Key {
    /// Adds a sentence after that of the file's key.
    fn also(mut self, words: &str) -> Self {
        self.help = format!("{} {words}", self.help);
        self
    }

    /// Sets the page's own range.
    fn between(mut self, from: i64, to: i64) -> Self {
        match &mut self.kind {
            Kind::Duration { least, most, .. }
            | Kind::Length { least, most }
            | Kind::Count { least, most } => (*least, *most) = (from, to),
            other => panic!("{other:?} has no range"),
        }
        self
    }

    fn step(mut self, by: i64) -> Self {
        if let Kind::Duration { step, .. } = &mut self.kind {
            *step = by;
        }
        self
    }

    /// Sets the text that is shown without a value, short enough for a control.
    fn own(mut self, words: &'static str) -> Self {
        if let Kind::Duration { own, .. } = &mut self.kind {
            *own = Some(words);
        }
        self
    }

    /// Sets the words that the page offers, with its labels.
    fn choices(self, choices: &[(&'static str, &'static str)]) -> Self {
        Self { kind: choice(choices), ..self }
    }

    /// Sets a value that may be omitted; a value is then required.
    fn default(mut self, text: &str) -> Self {
        if let Kind::Duration { own, .. } = &mut self.kind {
            *own = None;
        }
        Self { default: text.to_owned(), ..self }
    }

    /// Adds the key to both parts of the page.
    fn in_both(self) -> Self {
        Self { views: BOTH, ..self }
    }
}

fn under(group: &'static str, keys: Vec<Key>) -> impl Iterator<Item = Key> {
    keys.into_iter().map(move |key| Key { group, ..key })
}

fn choice(choices: &[(&'static str, &'static str)]) -> Kind {
    Kind::Choice { choices: choices.to_vec() }
}

const fn count(least: i64, most: i64) -> Kind {
    Kind::Count { least, most }
}

const SWITCH: [(&str, &str); 2] = [("on", "on"), ("off", "off")];
