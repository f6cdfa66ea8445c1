//! `[[output]]`: process data that the MainDevice's application writes at given times.

use isocat_descriptions::document::section::{Choice, Key, Kind, Need, Rule, Section, Word};
use isocat_wire::time::Nanos;

use super::LONGEST_RUN;
use super::fault::INSTANT;

pub(super) const OUTPUTS_KEY: Key = Key {
    name: "output",
    kind: Kind::Tables(&OUTPUT),
    need: Need::Without("drives follow a slow triangle, and other outputs count"),
    means: "What the MainDevice's application writes into outputs, and when.",
    goes: "the application of a simulated MainDevice",
    example: r#"[{ at = "in-operation", device = "0", place = "byte 0", type = "u8", value = 5 }]"#,
};

static OUTPUT: Section = Section {
    head: "[[output]]",
    means: "A value, a ramp or a sine in some bits of a device's outputs, until another one of the same bits begins.",
    keys: &[
        Key {
            name: "at",
            kind: INSTANT,
            need: Need::Required("when it begins, such as at = \"in-operation + 100ms\""),
            means: "When it begins, as with faults: the first cycle that is due then or later has it.",
            goes: "the application of a simulated MainDevice",
            example: r#""in-operation + 100ms""#,
        },
        Key {
            name: "device",
            kind: Kind::Name("the name of a device, or its position"),
            need: Need::Required(
                "the name of a device, or its position, such as device = \"axis 1\"",
            ),
            means: "Whose outputs.",
            goes: "the process image",
            example: r#""x""#,
        },
        Key {
            name: "place",
            kind: PLACE,
            need: Need::Required("an object or a byte, such as place = \"0x607A:00\""),
            means: "Where in them: an object as it is mapped in the PDOs that are assigned, or a byte, from 0.",
            goes: "the process image",
            example: r#""byte 0""#,
        },
        Key {
            name: "type",
            kind: Kind::Choice(Choice(&TYPES)),
            need: Need::Without("as wide as the object is mapped, with a sign; of a byte: \"i32\""),
            means: "What stands there.",
            goes: "the process image",
            example: r#""u8""#,
        },
        Key {
            name: "value",
            kind: Kind::Integer { least: i32::MIN as i64, most: u32::MAX as i64 },
            need: Need::Sometimes("unless `amplitude` is given", "a number, such as value = 1000"),
            means: "The value that is written.",
            goes: "the process image",
            example: "1",
        },
        Key {
            name: "over",
            kind: Kind::duration(Nanos::ZERO, LONGEST_RUN),
            need: Need::Default(r#""0s""#),
            means: "It is reached evenly within this time, from what stood there before.",
            goes: "the process image",
            example: r#""200ms""#,
        },
        Key {
            name: "amplitude",
            kind: Kind::Integer { least: 1, most: i32::MAX as i64 },
            need: Need::Without("no sine"),
            means: "A sine is written, around what stood there before, and this is the farthest from it.",
            goes: "the process image",
            example: "100",
        },
        Key {
            name: "period",
            kind: Kind::duration(Nanos::micros(10), LONGEST_RUN),
            need: Need::Sometimes(
                "beside `amplitude`",
                "the time of one swing, such as period = \"100ms\"",
            ),
            means: "Time of one swing of the sine.",
            goes: "the process image",
            example: r#""100ms""#,
        },
        Key {
            name: "lasts",
            kind: Kind::duration(Nanos::ZERO, LONGEST_RUN),
            need: Need::Without("the sine goes on"),
            means: "The sine stops after this time, where it is then.",
            goes: "the process image",
            example: r#""1s""#,
        },
    ],
    rules: &[
        Rule::Either("value", "amplitude"),
        Rule::Needs("over", "value"),
        Rule::Needs("amplitude", "period"),
        Rule::Needs("period", "amplitude"),
        Rule::Needs("lasts", "amplitude"),
    ],
};

/// An object or a byte of process data.
pub(in crate::segment_file) const PLACE: Kind = Kind::Pattern {
    expected: "an object such as \"0x607A:00\", or a byte such as \"byte 2\"",
    pattern: r"^\s*(0x[0-9A-Fa-f]{1,4}(\s*:\s*[0-9A-Fa-f]{1,2})?|byte\s+[0-9]+)\s*$",
};

/// Number of bits, and whether there is a sign.
pub(in crate::segment_file) static TYPES: [Word<(u8, bool)>; 6] = [
    ("i8", "8 bits with a sign", (8, true)),
    ("u8", "8 bits without a sign", (8, false)),
    ("i16", "16 bits with a sign", (16, true)),
    ("u16", "16 bits without a sign", (16, false)),
    ("i32", "32 bits with a sign", (32, true)),
    ("u32", "32 bits without a sign", (32, false)),
];
