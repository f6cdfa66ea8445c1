//! `[[fault]]`: the faults and their times.

use isocat_descriptions::document::section::{Choice, Key, Kind, Need, Rule, Section, Words};
use isocat_wire::time::Nanos;

use super::LONGEST_RUN;
use crate::fault::WORDS;

pub(super) const FAULTS_KEY: Key = Key {
    name: "fault",
    kind: Kind::Tables(&FAULT),
    need: Need::Without("nothing goes wrong"),
    means: "What goes wrong while the simulated segment runs.",
    goes: "the simulation; `isocat serve` lets it happen too, but for what concerns the host",
    example: r#"[{ at = "2s", what = "pull 0 for 500ms" }]"#,
};

static FAULT: Section = Section {
    head: "[[fault]]",
    means: "Something that goes wrong, once or several times.",
    keys: &[
        Key {
            name: "at",
            kind: INSTANT,
            need: Need::Required("when it happens, such as at = \"2s\""),
            means: "When it happens: a time after the power-on of the segment; \"cycle N\", when so many cycles are over; \
                    \"in-operation\", when all devices that take part are in OP. A time may be added to both.",
            goes: "the simulation",
            example: r#""in-operation + 100ms""#,
        },
        Key {
            name: "what",
            kind: Kind::Command {
                expected: "a fault, such as \"pull 1 for 500ms\"",
                words: Choice(&Vocabulary),
            },
            need: Need::Required("a fault, such as what = \"pull 1 for 500ms\""),
            means: "What happens, and with `for` how long. A device is named by its name or its position. docs/faults.md has all \
                    words; `isocat control` takes the same lines.",
            goes: "the simulation",
            example: r#""loss 0.5% burst 3 for 2s""#,
        },
        Key {
            name: "within",
            kind: Kind::duration(Nanos::ZERO, LONGEST_RUN),
            need: Need::Default(r#""0s""#),
            means: "It happens up to so much later, as the seed has it.",
            goes: "the simulation",
            example: r#""1s""#,
        },
        Key {
            name: "chance",
            kind: Kind::Pattern {
                expected: "a share above \"0%\", up to \"100%\"",
                pattern: r"^\s*[0-9.]+\s*%\s*$",
            },
            need: Need::Default(r#""100%""#),
            means: "How probable it is that it happens at all, each time.",
            goes: "the simulation",
            example: r#""30%""#,
        },
        Key {
            name: "times",
            kind: Kind::Integer { least: 1, most: MOST_TIMES },
            need: Need::Default("1"),
            means: "How often it happens.",
            goes: "the simulation",
            example: "5",
        },
        Key {
            name: "every",
            kind: Kind::duration(Nanos::micros(10), LONGEST_RUN),
            need: Need::Sometimes(
                "beside `times`",
                "the time from one to the next, such as every = \"200ms\"",
            ),
            means: "Time from one to the next, where it happens several times.",
            goes: "the simulation",
            example: r#""200ms""#,
        },
    ],
    rules: &[Rule::Needs("times", "every")],
};

/// An instant in the notation of faults.
pub(super) const INSTANT: Kind = Kind::Pattern {
    expected: "an instant, such as \"2s\", \"cycle 500\" or \"in-operation + 100ms\"",
    pattern: r"^\s*(when\s+)?(cycle\s+[0-9]+|in-operation|[0-9.]+\s*[a-zµ]+)(\s*\+\s*[0-9.]+\s*[a-zµ]+)?\s*$",
};

/// The words for faults.
struct Vocabulary;

impl Words for Vocabulary {
    fn words(&self) -> Vec<(&'static str, &'static str)> {
        let means = |means: &'static str| means.strip_suffix('.').unwrap_or(means);
        WORDS.iter().map(|word| (word.name, means(word.means))).collect()
    }
}

/// More repetitions of a fault than a run of an hour at 3 Hz has cycles.
const MOST_TIMES: i64 = 10_000;
