//! Deviation of a clock: `clock`, `clock_ramp`, `clock_step`, `clock_walk`.

use isocat_descriptions::document::section::{Key, Kind, Need, Section};
use isocat_wire::time::Nanos;

/// A deviation in either direction.
pub(super) const DEVIATION: Kind = Kind::Rate { least: -MOST_DRIFT, most: MOST_DRIFT };

pub(super) const CLOCKS_KEY: Key = Key {
    name: "clocks",
    kind: Kind::Rate { least: 0, most: MOST_DRIFT },
    need: Need::Without("what the device's profile states, else 25 ppm, usual for SubDevices"),
    means: "How far the oscillators of devices without `clock` may be off, either way. What each \
            really is off is drawn by the seed, evenly within this. `0ppm` gives all devices the \
            same perfect clock, which no real segment has.",
    goes: "the simulated ESCs' oscillators",
    example: r#""50ppm""#,
};

pub(super) const RAMP_KEY: Key = Key {
    name: "clock_ramp",
    kind: Kind::Table(&RAMP),
    need: Need::Without("the deviation does not grow"),
    means: "A deviation that grows evenly, as by temperature.",
    goes: "the simulated ESC's oscillator",
    example: r#"{ by = "+5ppm", from = "2s", over = "60s" }"#,
};

static RAMP: Section = Section {
    head: "clock_ramp",
    means: "A deviation that grows evenly, as by temperature. Instants count from power-on in true \
            time.",
    keys: &[
        by("How much it grows by in all."),
        Key {
            name: "from",
            kind: Kind::duration(Nanos::ZERO, LONGEST_RUN),
            need: Need::Default(r#""0s""#),
            means: "When it begins to grow.",
            goes: "the simulated ESC's oscillator",
            example: r#""2s""#,
        },
        span("over", SHORTEST, "How long it grows."),
    ],
    rules: &[],
};

pub(super) const STEP_KEY: Key = Key {
    name: "clock_step",
    kind: Kind::Table(&STEP),
    need: Need::Without("the deviation does not jump"),
    means: "A deviation that changes suddenly.",
    goes: "the simulated ESC's oscillator",
    example: r#"{ by = "-1ppm", at = "5s" }"#,
};

static STEP: Section = Section {
    head: "clock_step",
    means: "A deviation that changes suddenly.",
    keys: &[
        by("How much it changes by."),
        span("at", Nanos::ZERO, "When it changes, from power-on in true time."),
    ],
    rules: &[],
};

pub(super) const WALK_KEY: Key = Key {
    name: "clock_walk",
    kind: Kind::Table(&WALK),
    need: Need::Without("the deviation does not wander"),
    means: "A deviation that wanders at random, by the seed.",
    goes: "the simulated ESC's oscillator",
    example: r#"{ step = "0.05ppm", every = "100ms", within = "2ppm" }"#,
};

static WALK: Section = Section {
    head: "clock_walk",
    means: "A deviation that wanders at random, by the seed.",
    keys: &[
        size("step", "How far one step goes, up or down."),
        span("every", SHORTEST, "Time from one step to the next."),
        size("within", "How far it goes from zero at most, either way."),
    ],
    rules: &[],
};

const fn by(means: &'static str) -> Key {
    Key { name: "by", kind: DEVIATION, ..size("by", means) }
}

const fn size(name: &'static str, means: &'static str) -> Key {
    Key {
        name,
        kind: Kind::Rate { least: 0, most: MOST_DRIFT },
        need: Need::Required("a deviation, such as \"1ppm\""),
        means,
        goes: "the simulated ESC's oscillator",
        example: r#""1ppm""#,
    }
}

const fn span(name: &'static str, least: Nanos, means: &'static str) -> Key {
    Key {
        name,
        kind: Kind::duration(least, LONGEST_RUN),
        need: Need::Required("a duration, such as \"10s\""),
        means,
        goes: "the simulated ESC's oscillator",
        example: r#""10s""#,
    }
}

/// Ten times the deviation of the worst crystal of a SubDevice, ppb.
const MOST_DRIFT: i64 = 1_000_000;
pub(in crate::segment_file) const LONGEST_RUN: Nanos = Nanos::millis(24 * 3_600 * 1_000);
/// These shapes are not meant for faster changes.
const SHORTEST: Nanos = Nanos::micros(1);
