//! `[times]` and `[behaviour]`: the times of the device's CPU and the behaviour of its firmware.

use isocat_descriptions::document::section::{Choice, Key, Kind, Need, Section, Word};
use isocat_subdevice::MAX_PROCESS_DATA;
use isocat_subdevice::description::{LossCodes, Measured, MissedEvents};
use isocat_wire::time::Nanos;

use super::LONGEST_STEP;

pub(super) static TIMES: Section = Section {
    head: "[times]",
    means: "What its CPU really needs. What it states stands in 0x1C32 and 0x1C33.",
    keys: &[
        needed(
            "reaction",
            "From a request to the answer of the main loop: state changes and mailbox.",
        ),
        Key {
            need: Need::Without("what 0x1C32:06 states"),
            ..needed("calc_and_copy", "From the SM2 event to mapped outputs, at worst.")
        },
        needed("application", "The application's own work in a cycle."),
        Key {
            need: Need::Without("what 0x1C33:06 states"),
            ..needed(
                "input_copy",
                "From Input Latch until the inputs stand in the SM3 buffer, at worst.",
            )
        },
        spread("jitter", "Peak-to-peak spread of the steps that follow a SYNC0 event."),
        Key {
            name: "acknowledge",
            kind: Kind::duration(Nanos::ZERO, LONGEST_STEP),
            need: Need::Without("at once, with the interrupt"),
            means: "From a SYNC pulse until the program reads register 0x098E (SYNC1: 0x098F), which \
                    ends it where `pulse` is 0 ns. Many programs do it behind all that the pulse \
                    starts. It spreads by `jitter`; pulses that are due before make no edge.",
            goes: "the simulated CPU and the plan",
            example: r#""30us""#,
        },
        spread("latency", "Longest interrupt latency from the SM2 event; a part of calc_and_copy."),
        Key {
            name: "variation",
            kind: Kind::Integer { least: 0, most: 100 },
            need: Need::Default("0"),
            means: "How much faster than at worst copying and the application may be, in percent, \
                    evenly spread.",
            goes: "the simulated CPU",
            example: "20",
        },
        Key {
            name: "overrun",
            kind: Kind::Table(&OVERRUN),
            need: Need::Without("the application never takes longer"),
            means: "Now and then the application takes longer than it ever should.",
            goes: "the simulated CPU",
            example: r#"{ one_in = 1000, by = "200us" }"#,
        },
        spread(
            "timer_jitter",
            "Peak-to-peak spread of the local timer that shifts outputs and inputs.",
        ),
    ],
    rules: &[],
};

const fn needed(name: &'static str, means: &'static str) -> Key {
    Key {
        name,
        kind: Kind::duration(Nanos(1), LONGEST_STEP),
        need: Need::Required("a duration with its unit, such as \"20us\""),
        means,
        goes: "the simulated CPU",
        example: r#""20us""#,
    }
}

const fn spread(name: &'static str, means: &'static str) -> Key {
    Key {
        name,
        kind: Kind::duration(Nanos::ZERO, LONGEST_STEP),
        need: Need::Default(r#""0ns""#),
        means,
        goes: "the simulated CPU",
        example: r#""2us""#,
    }
}

static OVERRUN: Section = Section {
    head: "times.overrun",
    means: "An application that takes too long, at random.",
    keys: &[
        Key {
            name: "one_in",
            kind: Kind::Integer { least: 1, most: u32::MAX as i64 },
            need: Need::Required("in how many cycles it happens once"),
            means: "Number of cycles in which it happens once on average.",
            goes: "the simulated CPU",
            example: "1000",
        },
        Key {
            name: "by",
            kind: Kind::duration(Nanos(1), LONGEST_STEP),
            need: Need::Required("a duration with its unit, such as \"200us\""),
            means: "How much longer the application then takes.",
            goes: "the simulated CPU",
            example: r#""200us""#,
        },
    ],
    rules: &[],
};

pub(super) static BEHAVIOUR: Section = Section {
    head: "[behaviour]",
    means: "Behaviour that devices differ in. Without a key the device does what most do.",
    keys: &[
        Key {
            name: "missed_events",
            kind: Kind::Choice(Choice(&MISSED_EVENTS)),
            need: Need::Default(r#""counted""#),
            means: "How missed SM events are counted.",
            goes: "object 0x1C32:0B",
            example: r#""slave-stack-code""#,
        },
        Key {
            name: "sync_error_limit",
            kind: Kind::Integer { least: 1, most: u16::MAX as i64 },
            need: Need::Default("4"),
            means: "Limit of the counter of missed events where there is no object 0x10F1.",
            goes: "AL status code 0x001A",
            example: "8",
        },
        Key {
            name: "safeop_to_op_timeout",
            kind: Kind::duration(Nanos::millis(10), Nanos::millis(60_000)),
            need: Need::Default(r#""9s""#),
            means: "Time from the request of OP until the device gives it up.",
            goes: "AL status codes 0x001A, 0x001B, 0x002D",
            example: r#""5s""#,
        },
        Key {
            name: "free_run_period",
            kind: Kind::duration(Nanos::micros(10), LONGEST_STEP),
            need: Need::Default(r#""1ms""#),
            means: "Period of the local timer in Free Run while 0x1C32:02 is 0.",
            goes: "the simulated device's timer",
            example: r#""4ms""#,
        },
        time(
            "maximum_cycle_time",
            "Longest SYNC0 cycle that it accepts.",
            "no limit",
            "AL status code 0x0036",
            r#""8ms""#,
        ),
        flag(
            "watchdog_must_agree",
            "true",
            "The watchdog trigger of SM2 and the time in register 0x0420 must both be set or both \
             be zero.",
            "AL status code 0x001F",
        ),
        flag(
            "hide_unused_sync_objects",
            "false",
            "The object 0x1C32 has no sub-indices in SAFEOP and OP while no outputs are \
             transmitted; the same for 0x1C33 and inputs.",
            "objects 0x1C32:00 and 0x1C33:00",
        ),
        Key {
            name: "identification",
            kind: Kind::Integer { least: 0, most: u16::MAX as i64 },
            need: Need::Default("0"),
            means: "Identification value that the device gives on request; 0 for none.",
            goes: "register 0x0134 after bit 5 of register 0x0120",
            example: "7",
        },
        flag(
            "polls_outputs",
            "false",
            "The program takes no interrupt from SM2: at SYNC0 it looks whether outputs have come.",
            "the simulated device's stack",
        ),
        flag(
            "application_on_sync1",
            "false",
            "With subordinated cycles the application runs at SYNC1 and not at each SYNC0.",
            "the simulated device's stack",
        ),
        flag(
            "unit_without_pulses",
            "false",
            "The SYNC unit may be on without a pulse, as for time stamps of the latch units.",
            "AL status code 0x0030",
        ),
        flag(
            "device_emulation",
            "false",
            "There is no program: the ESC answers AL control by itself, and digital I/O hangs on it. Only without \
             [mailbox].",
            "bit 0 of register 0x0141, by word 0 of the SII",
        ),
        flag(
            "ignores_sync1",
            "false",
            "SYNC1 may be made though the device does not announce it: it does not listen to it.",
            "AL status code 0x0030",
        ),
        time(
            "subordinated_sync0_cycle",
            "SYNC0 cycle that subordinated cycles need.",
            "any",
            "AL status code 0x0036",
            r#""250us""#,
        ),
        time(
            "cycle_granularity",
            "The SYNC0 cycle must be a multiple of this.",
            "any cycle",
            "AL status code 0x0035",
            r#""250us""#,
        ),
        Key {
            name: "loss_codes",
            kind: Kind::Choice(Choice(&LOSS_CODES)),
            need: Need::Default(r#""slave-stack-code""#),
            means: "AL status codes with which the device tells that it lost synchronization.",
            goes: "register 0x0134",
            example: r#""drive""#,
        },
        Key {
            name: "measures",
            kind: Kind::List(&Kind::Choice(Choice(&MEASURED))),
            need: Need::Without("\"cycle\", \"minimum-cycle\" and \"calc-and-copy\""),
            means: "Quantities that the device measures in OP on command.",
            goes: "objects 0x1C32:08 and 0x1C33:08",
            example: r#"["calc-and-copy", "delay"]"#,
        },
        flag(
            "dynamic_times",
            "false",
            "The device announces dynamic times (bit 14 of sub-index 04) and states 0 in \
             sub-indices 05, 06 and 09 until it is told to measure them. What the file states in \
             sub-index 06 is then what its CPU needs; outputs act as soon as they are calculated.",
            "objects 0x1C32 and 0x1C33",
        ),
        Key {
            name: "output_toggle",
            kind: Kind::Integer { least: 0, most: 8 * MAX_PROCESS_DATA as i64 - 1 },
            need: Need::Without("no such bit"),
            means: "The bit of the outputs that changes with each of them. Where it did not change \
                    is counted.",
            goes: "object 0x1C32:0E",
            example: "15",
        },
    ],
    rules: &[],
};

const fn time(
    name: &'static str,
    means: &'static str,
    without: &'static str,
    goes: &'static str,
    example: &'static str,
) -> Key {
    let kind = Kind::duration(Nanos(1), Nanos::from_u32(u32::MAX));
    Key { name, kind, need: Need::Without(without), means, goes, example }
}

const fn flag(
    name: &'static str,
    default: &'static str,
    means: &'static str,
    goes: &'static str,
) -> Key {
    Key { name, kind: Kind::Boolean, need: Need::Default(default), means, goes, example: "true" }
}

/// Ways to count missed SM events.
pub(in super::super) static MISSED_EVENTS: [Word<MissedEvents>; 3] = [
    (
        "counted",
        "3 more at each SYNC0 without new outputs, 1 less with them",
        MissedEvents::Counted,
    ),
    (
        "slave-stack-code",
        "the same, but the first is let pass and the error comes at the limit",
        MissedEvents::SlaveStackCode,
    ),
    ("balance", "SM2 events less pulses in OP", MissedEvents::Balance),
];

/// Ways to report a loss of synchronization.
pub(in super::super) static LOSS_CODES: [Word<LossCodes>; 2] = [
    ("slave-stack-code", "0x002D, 0x002C, 0x001A", LossCodes::SLAVE_STACK_CODE),
    ("drive", "0x0032 on the way up, 0x0034 in OP", LossCodes::DRIVE),
];

/// Selects one of the quantities.
type Quantity = fn(&mut Measured) -> &mut bool;

/// Quantities that can be measured.
pub(in super::super) static MEASURED: [Word<Quantity>; 5] = [
    ("cycle", "sub-index 02, the shortest cycle; without DC only", |m| &mut m.cycle),
    ("shift", "sub-index 03, from the event to Outputs Valid or Input Latch", |m| &mut m.shift),
    ("minimum-cycle", "sub-index 05, the longest work of a cycle", |m| &mut m.minimum_cycle),
    ("calc-and-copy", "sub-index 06, the longest mapping", |m| &mut m.calc_and_copy),
    ("delay", "sub-index 09, from the pulse to Outputs Valid or Input Latch", |m| &mut m.delay),
];
