//! `[[expect]]`: the expectations of the run.

use isocat_descriptions::document::section::{Key, Kind, Need, Section};
use isocat_wire::time::Nanos;

use super::{LIMIT, LONGEST_RUN};

pub(super) const EXPECT_KEY: Key = Key {
    name: "expect",
    kind: Kind::Tables(&EXPECT),
    need: Need::Without("that the run is in sync"),
    means: "What is expected of a simulated run, or of a segment that is served. With it `isocat run` and `isocat serve` end by \
            this: exit code 0 if all of it came so.",
    goes: "the judges of the run, in true time",
    example: r#"[{ in_sync_at = "5s" }, { recovers_within = "1s" }]"#,
};

static EXPECT: Section = Section {
    head: "[[expect]]",
    means: "Something that is expected of the run; of several keys in one table each.",
    keys: &[
        Key {
            name: "in_sync",
            kind: Kind::Boolean,
            need: Need::Without("it does not matter"),
            means: "Whether nothing at all speaks against the run: no finding from the beginning of operation to its end.",
            goes: "the findings of the report",
            example: "true",
        },
        Key {
            name: "in_sync_at",
            kind: Kind::Pattern {
                expected: "an instant, such as \"5s\" or \"in-operation + 2s\"",
                pattern: r"^\s*(when\s+)?(in-operation|[0-9.]+\s*[a-zµ]+)(\s*\+\s*[0-9.]+\s*[a-zµ]+)?\s*$",
            },
            need: Need::Without("it does not matter"),
            means: "All devices are in sync at this instant: in OP, SYNC0 on its grid, outputs in time. Times count from the \
                    power-on of the segment, which is the beginning of `serve`.",
            goes: "the course of the run",
            example: r#""5s""#,
        },
        Key {
            name: "worst_sync0",
            kind: LIMIT,
            need: Need::Without("it does not matter"),
            means: "No SYNC0 edge is ever farther off its grid, whatever goes wrong.",
            goes: "the course of the run",
            example: r#""500ns""#,
        },
        Key {
            name: "device",
            kind: Kind::Name("the name of a device, or its position"),
            need: Need::Without("all devices"),
            means: "Whose edges `worst_sync0` is about, and whose plant `plant_deviation`.",
            goes: "the judges of the run, in true time",
            example: r#""x""#,
        },
        Key {
            name: "plant_deviation",
            kind: Kind::Decimal { least: 0.0, most: 1_000_000_000.0, unit: "um" },
            need: Need::Without("it does not matter"),
            means: "No load of a `[[plant]]` is ever farther from where it would be with punctual outputs.",
            goes: "the judges of the plants, in true time",
            example: r#""20um""#,
        },
        Key {
            name: "recovers_within",
            kind: Kind::duration(Nanos::ZERO, LONGEST_RUN),
            need: Need::Without("it does not matter"),
            means: "All devices are in sync again this long after the last fault ended (or began, if it has no end), and stay so.",
            goes: "the course of the run",
            example: r#""1s""#,
        },
        Key {
            name: "safe_within",
            kind: Kind::duration(Nanos(1), LONGEST_RUN),
            need: Need::Without("it does not matter"),
            means: "No device stays in OP for longer with outputs that no frame renews: it leaves OP before, or its \
                    watchdog makes them safe.",
            goes: "the course of the run",
            example: r#""120ms""#,
        },
        Key {
            name: "blames",
            kind: Kind::Name("the name of a device, or its position"),
            need: Need::Without("it does not matter"),
            means: "The first finding that is about a device is about this one.",
            goes: "the findings of the report",
            example: r#""x""#,
        },
    ],
    rules: &[],
};
