//! `[[object]]` and its rows.

use isocat_descriptions::document::section::{
    Cell, Choice, Key, Kind, Need, Row, Rule, Section, Word,
};
use isocat_subdevice::MAX_TRANSFER;
use isocat_wire::coe::DataType;
use isocat_wire::coe::info::ObjectCode;

pub(super) static OBJECT: Section = Section {
    head: "[[object]]",
    means: "An object of the dictionary.",
    keys: &[
        Key {
            name: "index",
            kind: Kind::Hex { least: 0x1000, most: 0xFFFF },
            need: Need::Required("the object's index"),
            means: "Its index.",
            goes: "the object dictionary",
            example: "0x1C32",
        },
        Key {
            name: "name",
            kind: Kind::Name("the object's name"),
            need: Need::Sometimes("unless `like` is given", "the object's name"),
            means: "Its name, as SDO information gives it. With `like` it may be left out.",
            goes: "SDO information",
            example: r#""SM output parameter""#,
        },
        Key {
            name: "code",
            kind: Kind::Choice(Choice(&CODES)),
            need: Need::Without("that of `like`; \"var\" for one entry, else \"record\""),
            means: "Its object code.",
            goes: "SDO information",
            example: r#""record""#,
        },
        Key {
            name: "type",
            kind: TYPE,
            need: Need::Without(
                "that of the standard for 0x1C32 and 0x1C33; else that of its entries",
            ),
            means: "Its data type.",
            goes: "SDO information",
            example: r#""UNSIGNED8""#,
        },
        Key {
            name: "like",
            kind: Kind::Pattern {
                expected: "an object of this file that stands before (\"1C32\") or of a built-in \
                           profile (\"kollmorgen_akd2g:1C32\")",
                pattern: r"^(.+:)?(0x)?[0-9A-Fa-f]{4}$",
            },
            need: Need::Without("like none"),
            means: "An object whose entries it has: one that stands before in the file, or one of \
                    a built-in profile.",
            goes: "the object dictionary",
            example: r#""kollmorgen_akd2g:1C32""#,
        },
        Key {
            name: "without",
            kind: Kind::List(&Kind::Hex { least: 0, most: 255 }),
            need: Need::Without("all of them"),
            means: "Sub-indices of the object named by `like` that it does not have.",
            goes: "the object dictionary",
            example: "[]",
        },
        Key {
            name: "entries",
            kind: Kind::List(&Kind::Either(&[Kind::Row(&ROW), Kind::Table(&GAPS)])),
            need: Need::Sometimes(
                "unless `like` is given",
                "rows [sub-index, type, access, value, name]",
            ),
            means: "Its entries, ascending. With `like` they replace or add entries and may be \
                    left out.",
            goes: "the object dictionary",
            example: r#"[[0, "UNSIGNED8", "ro", 1, "Own"]]"#,
        },
        Key {
            name: "values",
            kind: Kind::Map {
                expected: "sub-indices in two hex digits",
                pattern: r"^(0x)?[0-9A-Fa-f]{2}$",
                values: &VALUE,
            },
            need: Need::Without("as the entries have them"),
            means: "Values of entries, by sub-index in two hex digits: { 01 = 0x22, 05 = \"1ms\" \
                    }.",
            goes: "the object dictionary",
            example: r#"{ 00 = 1 }"#,
        },
        Key {
            name: "contradiction",
            kind: Kind::Name("what the maker's table contradicts"),
            need: Need::Without("none"),
            means: "Where 0x1C32:01 or 0x1C33:01 presets a type that sub-index 04 does not \
                    announce: what the maker's table contradicts, so that it is no slip.",
            goes: "the check of the profile",
            example: r#""the table presets 1 and announces Free Run alone""#,
        },
    ],
    rules: &[Rule::Any("name", "like"), Rule::Any("entries", "like")],
};

/// An entry of an object.
pub(in super::super) static ROW: Row = Row {
    expected: "a row [sub-index, type, access, value, name]",
    cells: &[
        Cell { name: "sub-index", kind: Kind::Hex { least: 0, most: 255 } },
        Cell { name: "type", kind: TYPE },
        Cell { name: "access", kind: ACCESS },
        Cell { name: "value", kind: VALUE },
        Cell { name: "name", kind: Kind::Text("the entry's name") },
    ],
    more: Some(&MORE),
};

static MORE: Section = Section {
    head: "behind a row of an object",
    means: "Where complete access has the entry, and how long it is.",
    keys: &[
        Key {
            name: "offset",
            kind: Kind::Integer { least: 0, most: u16::MAX as i64 },
            need: Need::Without(
                "where ETG.1020 has it in 0x1C32 and 0x1C33, elsewhere behind the entry before",
            ),
            means: "Bit at which complete access has the entry.",
            goes: "complete access",
            example: "480",
        },
        Key {
            name: "bits",
            kind: Kind::Integer { least: 1, most: 8 * MAX_TRANSFER as i64 },
            need: Need::Without("those of the type; of a text or of bytes those of the value"),
            means: "Length of the entry, where it has room for more than its value. At least those \
                    of the value.",
            goes: "SDO information; the mailbox",
            example: "64",
        },
    ],
    rules: &[],
};

/// Sub-indices that only reserve bits.
pub(in super::super) static GAPS: Section = Section {
    head: "gaps of an object",
    means: "Sub-indices that keep bits free in complete access.",
    keys: &[
        Key {
            name: "gaps",
            kind: Kind::Row(&FIRST_AND_LAST),
            need: Need::Required("the first and the last sub-index, [14, 31]"),
            means: "The first and the last sub-index.",
            goes: "complete access",
            example: "[14, 31]",
        },
        Key {
            name: "bits",
            kind: Kind::Integer { least: 1, most: 64 },
            need: Need::Required("bits of one gap"),
            means: "Number of bits of each.",
            goes: "complete access",
            example: "8",
        },
        Key {
            name: "name",
            kind: Kind::Name("the gaps' name"),
            need: Need::Default(r#""Gap""#),
            means: "Their name; the sub-index stands behind it.",
            goes: "SDO information",
            example: r#""Reserved""#,
        },
    ],
    rules: &[],
};

/// The range of sub-indices that are gaps.
pub(in super::super) static FIRST_AND_LAST: Row = Row {
    expected: "the first and the last sub-index, [14, 31]",
    cells: &[
        Cell { name: "first", kind: Kind::Integer { least: 1, most: 255 } },
        Cell { name: "last", kind: Kind::Integer { least: 1, most: 255 } },
    ],
    more: None,
};

/// The notation of access.
pub(in super::super) const ACCESS_WORDS: &str = "\"ro\", \"rw\" or \"wo\", then for writing only in some states \
    \"preop\", \"safeop\", \"op\", then \"rx\", \"tx\", \"backup\", \"settings\"";

/// Access rights.
pub(super) const ACCESS: Kind = Kind::Pattern {
    expected: ACCESS_WORDS,
    pattern: r"^\s*(ro|rw|wo)(\s+(preop|safeop|op|rx|tx|backup|settings))*\s*$",
};

/// A data type.
pub(super) const TYPE: Kind = Kind::Choice(Choice(&TYPES));

/// A value of an entry.
const VALUE: Kind =
    Kind::Either(&[Kind::Integer { least: i64::MIN, most: i64::MAX }, Kind::Text(VALUE_WORDS)]);

const VALUE_WORDS: &str = "a text; for UNSIGNED32 a time with its unit; bytes of the wire such as \"hex:0A FF\"; \
    or \"unknown\" for a number that is not published";

/// The object codes.
pub(in super::super) static CODES: [Word<ObjectCode>; 3] = [
    ("var", "a single value", ObjectCode::VAR),
    ("array", "entries of one type", ObjectCode::ARRAY),
    ("record", "entries of any types", ObjectCode::RECORD),
];

/// The data types, the usual ones first.
pub(in super::super) static TYPES: [Word<DataType>; 27] = [
    ("BOOLEAN", "", DataType::BOOLEAN),
    ("INTEGER8", "", DataType::INTEGER8),
    ("INTEGER16", "", DataType::INTEGER16),
    ("INTEGER32", "", DataType::INTEGER32),
    ("INTEGER64", "", DataType::INTEGER64),
    ("UNSIGNED8", "", DataType::UNSIGNED8),
    ("UNSIGNED16", "", DataType::UNSIGNED16),
    ("UNSIGNED24", "", DataType::UNSIGNED24),
    ("UNSIGNED32", "", DataType::UNSIGNED32),
    ("UNSIGNED64", "", DataType::UNSIGNED64),
    ("VISIBLE_STRING", "", DataType::VISIBLE_STRING),
    ("INTEGER24", "", DataType::INTEGER24),
    ("BIT2", "", DataType::BIT2),
    ("BIT1", "", DataType::BIT1),
    ("BIT3", "", DataType::BIT3),
    ("BIT4", "", DataType::BIT4),
    ("BIT5", "", DataType::BIT5),
    ("BIT6", "", DataType::BIT6),
    ("BIT7", "", DataType::BIT7),
    ("BIT8", "", DataType::BIT8),
    ("REAL32", "", DataType::REAL32),
    ("REAL64", "", DataType::REAL64),
    ("OCTET_STRING", "", DataType::OCTET_STRING),
    ("UNICODE_STRING", "", DataType::UNICODE_STRING),
    ("PDO_MAPPING", "", DataType::PDO_MAPPING),
    ("IDENTITY", "", DataType::IDENTITY),
    ("SYNC_PAR", "", DataType::SYNC_PAR),
];
