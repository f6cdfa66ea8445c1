//! `[[plant]]`: the machine behind a drive.

use isocat_descriptions::document::section::{Choice, Key, Kind, Need, Section, Word};

use super::output::{PLACE, TYPES};

pub(super) const PLANTS_KEY: Key = Key {
    name: "plant",
    kind: Kind::Tables(&PLANT),
    need: Need::Without("nothing is moved"),
    means: "Machines that outputs move: the report tells what late outputs did to them.",
    goes: "the simulation of `isocat run`, and its judges",
    example: r#"[{ device = "0", motor_inertia = "3kgcm2", load_inertia = "7kgcm2" }]"#,
};

static PLANT: Section = Section {
    head: "[[plant]]",
    means: "A machine of two masses behind a device. Its command must be written by an `[[output]]`. docs/plant.md says what it is, \
            and what it is not.",
    keys: &[
        Key {
            name: "device",
            kind: Kind::Name("the name of a device, or its position"),
            need: Need::Required(
                "the name of a device, or its position, such as device = \"axis 1\"",
            ),
            means: "The device that moves it. Each moves one at most.",
            goes: "the simulated device",
            example: r#""x""#,
        },
        Key {
            name: "command",
            kind: PLACE,
            need: Need::Without("the target position, 0x607A:00"),
            means: "Where in its outputs the command is.",
            goes: "the simulated device",
            example: r#""byte 2""#,
        },
        Key {
            name: "command_type",
            kind: Kind::Choice(Choice(&TYPES)),
            need: Need::Without("as wide as the object is mapped, with a sign; of a byte: \"i32\""),
            means: "What stands there.",
            goes: "the simulated device",
            example: r#""i32""#,
        },
        Key {
            name: "commands",
            kind: Kind::Choice(Choice(&COMMANDS)),
            need: Need::Default(r#""position""#),
            means: "What the command is.",
            goes: "the simulated device",
            example: r#""torque""#,
        },
        Key {
            name: "torque",
            kind: Kind::Decimal { least: 0.000_001, most: 1_000_000.0, unit: "Nm" },
            need: Need::Default(r#""0.001Nm""#),
            means: "With `commands = \"torque\"`: the torque of one increment of the command.",
            goes: "the simulated device",
            example: r#""0.01Nm""#,
        },
        Key {
            name: "position_gain",
            kind: Kind::Decimal { least: 0.01, most: 100_000.0, unit: "/s" },
            need: Need::Default(r#""50/s""#),
            means: "With `commands = \"position\"`: speed that the position loop asks for, to the distance from the target.",
            goes: "the simulated device",
            example: r#""80/s""#,
        },
        Key {
            name: "speed_gain",
            kind: Kind::Decimal { least: 0.01, most: 1_000_000.0, unit: "/s" },
            need: Need::Default(r#""300/s""#),
            means: "With `commands = \"position\"`: acceleration that the speed loop asks for, to the difference of speed. Its \
                    torque is that of both inertias together. At most one to a cycle of the device.",
            goes: "the simulated device",
            example: r#""400/s""#,
        },
        Key {
            name: "actual",
            kind: PLACE,
            need: Need::Without("0x6064:00 if it is mapped, else nothing shows it"),
            means: "Where in its inputs the position of the motor is shown, in increments, as the encoder had it at Input Latch.",
            goes: "the simulated device",
            example: r#""byte 2""#,
        },
        Key {
            name: "motor_inertia",
            kind: INERTIA,
            need: Need::Required("the inertia of the motor, such as motor_inertia = \"3kgcm2\""),
            means: "Inertia of the motor.",
            goes: "the simulated machine",
            example: r#""3kgcm2""#,
        },
        Key {
            name: "load_inertia",
            kind: INERTIA,
            need: Need::Required("the inertia of the load, such as load_inertia = \"7kgcm2\""),
            means: "Inertia of the load, as the motor's shaft feels it.",
            goes: "the simulated machine",
            example: r#""7kgcm2""#,
        },
        Key {
            name: "stiffness",
            kind: Kind::Decimal { least: 0.01, most: 10_000_000.0, unit: "Nm/rad" },
            need: Need::Default(r#""400Nm/rad""#),
            means: "Stiffness of what joins them. The resonance of both must lie below 10 kHz.",
            goes: "the simulated machine",
            example: r#""1000Nm/rad""#,
        },
        Key {
            name: "damping",
            kind: Kind::Decimal { least: 0.0, most: 1_000.0, unit: "Nms/rad" },
            need: Need::Default(r#""0.01Nms/rad""#),
            means: "Damping of what joins them, at most critical.",
            goes: "the simulated machine",
            example: r#""0.02Nms/rad""#,
        },
        Key {
            name: "friction",
            kind: Kind::Decimal { least: 0.0, most: 1_000.0, unit: "Nms/rad" },
            need: Need::Default(r#""0Nms/rad""#),
            means: "Viscous friction of the load: torque to its speed.",
            goes: "the simulated machine",
            example: r#""0.001Nms/rad""#,
        },
        Key {
            name: "increments",
            kind: Kind::Integer { least: 1, most: u32::MAX as i64 },
            need: Need::Default("1048576"),
            means: "Increments of the encoder, and of a commanded position, to a turn of the motor.",
            goes: "the simulated machine",
            example: "4096",
        },
        Key {
            name: "travel",
            kind: Kind::Decimal { least: 0.000_1, most: 1_000_000.0, unit: "mm" },
            need: Need::Default(r#""10mm""#),
            means: "How far the load travels with a turn of the motor: figures of the report are of that way. The default is an \
                    ordinary ball screw.",
            goes: "the figures of the report",
            example: r#""5mm""#,
        },
    ],
    rules: &[],
};

const INERTIA: Kind = Kind::Decimal { least: 0.000_1, most: 10_000_000.0, unit: "kgcm2" };

/// The kinds of commands; `true` for a torque.
pub(in crate::segment_file) static COMMANDS: [Word<bool>; 2] = [
    ("position", "target position in increments, as in cyclic synchronous position", false),
    ("torque", "torque, as in cyclic synchronous torque", true),
];
