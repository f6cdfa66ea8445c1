//! Activities of the MainDevice besides the exchange: `[quality]`, `[delay_watch]`, `recovery`,
//! `direction`, `measure_times`.

use isocat_descriptions::document::section::{Choice, Key, Kind, Limit, Need, Section, Word};
use isocat_wire::time::Nanos;

use super::{CYCLE, LONGEST_CYCLE, LONGEST_RUN};

pub(super) const QUALITY_KEY: Key = Key {
    name: "quality",
    kind: Kind::Table(&QUALITY),
    need: Need::Without("nothing is read in the background"),
    means: "Clocks, error counters and distances are read in the background and reported. An empty \
            table takes the defaults.",
    goes: "Config::quality",
    example: "{ share_permille = 5 }",
};

static QUALITY: Section = Section {
    head: "[quality]",
    means: "What is read in the background while the segment runs.",
    keys: &[
        Key {
            name: "share_permille",
            kind: Kind::Integer { least: 1, most: 200 },
            need: Need::Default("10"),
            means: "Share of the wire's time that the reads may take, in permille.",
            goes: "QualityWatch::share_permille",
            example: "5",
        },
        Key {
            name: "history",
            kind: Kind::Integer { least: 16, most: 100_000 },
            need: Need::Default("256"),
            means: "Number of readings that are kept of each clock.",
            goes: "QualityWatch::history",
            example: "1000",
        },
        Key {
            name: "unled_cycles",
            kind: Kind::Integer { least: 1, most: u32::MAX as i64 },
            need: Need::Default("100"),
            means: "Number of cycles without a drift frame that all clocks took, after which an \
                    alarm is raised.",
            goes: "QualityWatch::unled_cycles",
            example: "50",
        },
        Key {
            name: "difference_limit",
            kind: Kind::duration(Nanos(1), Nanos::millis(1)),
            need: Need::Default(r#""200ns""#),
            means: "A difference of the system time in 0x092C above this raises an alarm; half of \
                    it ends the alarm.",
            goes: "QualityWatch::difference_limit",
            example: r#""150ns""#,
        },
        Key {
            name: "margin_limit",
            kind: Kind::Either(&[MARGIN, Kind::Choice(Choice(&OFF))]),
            need: Need::Default(r#""0ns""#),
            means: "Less time than this left before SYNC0 raises an alarm; \"off\" raises none.",
            goes: "QualityWatch::margin_limit",
            example: r#""20us""#,
        },
        Key {
            name: "objects",
            kind: Kind::Boolean,
            need: Need::Default("true"),
            means: "Whether the error counters and distances of 0x1C32 and 0x1C33 are read as \
                    well.",
            goes: "QualityWatch::objects",
            example: "false",
        },
    ],
    rules: &[],
};

/// A limit of margins, unless it is "off".
pub(in super::super) const MARGIN: Kind = Kind::duration(Nanos(-LONGEST_CYCLE.0), LONGEST_CYCLE);
static OFF: [Word<()>; 1] = [("off", "margins are kept and raise no alarm", ())];

pub(super) const DELAY_WATCH_KEY: Key = Key {
    name: "delay_watch",
    kind: Kind::Table(&DELAY_WATCH),
    need: Need::Without("delays are measured at the start alone"),
    means: "Propagation delays are measured on while the segment runs. An empty table takes the \
            defaults.",
    goes: "Config::delay_watch",
    example: "{ latches = 8 }",
};

static DELAY_WATCH: Section = Section {
    head: "[delay_watch]",
    means: "How propagation delays are measured on while the segment runs.",
    keys: &[
        Key {
            name: "every",
            kind: Kind::Duration { least: CYCLE, most: Limit::At(LONGEST_RUN.0), whole: 1 },
            need: Need::Default(r#""1s""#),
            means: "Time from one latch of the receive times to the next.",
            goes: "DelayWatch::every; writes to register 0x0900",
            example: r#""500ms""#,
        },
        Key {
            name: "latches",
            kind: Kind::Integer { least: 2, most: 10_000 },
            need: Need::Default("16"),
            means: "Number of latches that make one estimate.",
            goes: "DelayWatch::latches",
            example: "8",
        },
        Key {
            name: "rewrite",
            kind: Kind::Boolean,
            need: Need::Default("false"),
            means: "Whether a delay that has changed is written to the device. Its clock and its \
                    pulses then move.",
            goes: "DelayWatch::rewrite; register 0x0928",
            example: "true",
        },
    ],
    rules: &[],
};

const RECOVERY_KINDS: &[Kind] = &[Kind::Choice(Choice(&RECOVERIES)), Kind::Table(&RECOVERY)];

pub(super) const RECOVERY_KEY: Key = Key {
    name: "recovery",
    kind: Kind::Either(RECOVERY_KINDS),
    need: Need::Default(r#""never""#),
    means: "What becomes of devices that leave OP by themselves: nothing, one attempt to bring \
            them back, or attempts after pauses that grow.",
    goes: "Config::recovery",
    example: r#"{ first = "1s", longest = "30s" }"#,
};

static RECOVERIES: [Word<()>; 2] = [
    ("never", "a device that leaves OP stays where it is", ()),
    ("once", "one attempt for each device in the whole run", ()),
];

/// Increasing pauses.
pub(in super::super) static RECOVERY: Section = Section {
    head: "recovery",
    means: "Attempts to bring a device back to OP after pauses that grow.",
    keys: &[
        Key {
            name: "first",
            kind: Kind::duration(Nanos::millis(1), LONGEST_RUN),
            need: Need::Required("a pause, such as \"1s\""),
            means: "From the fall to the first attempt. Each pause after a failure is twice as \
                    long as the one before.",
            goes: "Recovery::BackOff",
            example: r#""1s""#,
        },
        Key {
            name: "longest",
            kind: Kind::Duration {
                least: Limit::From("the first pause", |first| first),
                most: Limit::At(LONGEST_RUN.0),
                whole: 1,
            },
            need: Need::Required("a pause, such as \"1s\""),
            means: "Longest pause.",
            goes: "Recovery::BackOff",
            example: r#""30s""#,
        },
    ],
    rules: &[],
};

pub(super) const MEASURE_TIMES_KEY: Key = Key {
    name: "measure_times",
    kind: Kind::Boolean,
    need: Need::Default("false"),
    means: "Whether devices that announce dynamic times and state 0 measure them on the way up: \
            the segment goes to OP with outputs of 0, back to PREOP, and up again by a plan with \
            the measured times.",
    goes: "Config::measure_times; objects 0x1C32:08 and 0x1C33:08",
    example: "true",
};

pub(super) const MEASURED_TIMES_KEY: Key = Key {
    name: "measured_times",
    kind: Kind::Table(&MEASURED_TIMES),
    need: Need::Without("none are known"),
    means: "Times that the device measured once, as a run with `measure_times` reports them. The \
            plan takes them where the device states 0, and the device does not measure again.",
    goes: "DeviceConfig::measured and the plan",
    example: r#"{ minimum_cycle = "60us", outputs_calc_and_copy = "20us" }"#,
};

static MEASURED_TIMES: Section = Section {
    head: "measured_times",
    means: "Times that a device measured itself.",
    keys: &[
        measured("minimum_cycle", "Minimum cycle time.", "0x1C32:05 and 0x1C33:05, the longer one"),
        measured("outputs_calc_and_copy", "Calc and copy time of the outputs.", "0x1C32:06"),
        measured("outputs_delay", "Delay time of the outputs.", "0x1C32:09"),
        measured("inputs_calc_and_copy", "Calc and copy time of the inputs.", "0x1C33:06"),
        measured("inputs_delay", "Delay time of the inputs.", "0x1C33:09"),
    ],
    rules: &[],
};

const fn measured(name: &'static str, means: &'static str, goes: &'static str) -> Key {
    let kind = Kind::duration(Nanos(1), LONGEST_CYCLE);
    Key { name, kind, need: Need::Without("not measured"), means, goes, example: r#""20us""# }
}

pub(super) const DIRECTION_KEY: Key = Key {
    name: "direction",
    kind: Kind::Choice(Choice(&DIRECTIONS)),
    need: Need::Default(r#""follow-reference""#),
    means: "Which clock leads the segment. \"drive-reference\" needs a bus cycle of at most 2 ms.",
    goes: "Config::direction; writes to register 0x0910",
    example: r#""drive-reference""#,
};

/// The clock that leads; `true` if it is the host's.
pub(in super::super) static DIRECTIONS: [Word<bool>; 2] = [
    ("follow-reference", "the reference clock leads, the host follows", false),
    ("drive-reference", "the host's clock leads, the reference clock follows", true),
];
