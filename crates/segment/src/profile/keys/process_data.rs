//! `[outputs]`, `[inputs]` and their PDOs.

use isocat_descriptions::document::section::{Cell, Key, Kind, Need, Row, Section};
use isocat_subdevice::MAX_PROCESS_DATA;

use super::object::{ACCESS, TYPE};

pub(super) static OUTPUTS: Section = Section {
    head: "[outputs]",
    means: "Process data from the MainDevice, SM2.",
    keys: &area(&Kind::Tables(&OUTPUT_PDO), &RX_PDO, &Kind::Row(&RX_PDO_ROW), "SM2", "0x1C12"),
};

pub(super) static INPUTS: Section = Section {
    head: "[inputs]",
    means: "Process data to the MainDevice, SM3. Its keys are those of [outputs].",
    keys: &area(&Kind::Tables(&INPUT_PDO), &TX_PDO, &Kind::Row(&TX_PDO_ROW), "SM3", "0x1C13"),
};

const fn area(
    tables: &'static Kind,
    index: &'static Kind,
    row: &'static Kind,
    sync_manager: &'static str,
    assignment: &'static str,
) -> [Key; 8] {
    [
        Key {
            name: "start",
            kind: Kind::Hex { least: 0x1000, most: 0xFFFF },
            need: Need::Required("an address"),
            means: "First byte of the area. There are three buffers, one behind the other.",
            goes: sync_manager,
            example: "0x1800",
        },
        Key {
            name: "length",
            kind: Kind::Integer { least: 1, most: MAX_PROCESS_DATA as i64 },
            need: Need::Required("the most bytes of one buffer"),
            means: "Most bytes of one buffer. Without mailbox it is exactly what the PDOs of \
                    `default` need.",
            goes: sync_manager,
            example: "16",
        },
        Key {
            name: "access",
            kind: ACCESS,
            need: Need::Required("who may write the PDO assignment, such as \"ro\""),
            means: "Who may write the PDO assignment: \"ro\" is a fixed one. Needed beside \
                    [mailbox], refused without.",
            goes: assignment,
            example: r#""rw preop""#,
        },
        Key {
            name: "slots",
            kind: Kind::Integer { least: 1, most: 254 },
            need: Need::Without("as many as there are PDOs"),
            means: "Most PDOs that can be assigned. Only beside [mailbox].",
            goes: assignment,
            example: "2",
        },
        Key {
            name: "default",
            kind: Kind::List(index),
            need: Need::Without("none"),
            means: "PDOs that are assigned at power-on.",
            goes: assignment,
            example: "[]",
        },
        Key {
            name: "recommended",
            kind: Kind::List(index),
            need: Need::Without("those of `default`"),
            means: "PDOs that should be assigned: written where the assignment is writable. Only \
                    beside [mailbox].",
            goes: assignment,
            example: "[]",
        },
        Key {
            name: "pdo",
            kind: *tables,
            need: Need::Without("no PDOs, or those of `pdos`"),
            means: "PDOs with their entries.",
            goes: "objects of PDO mapping; categories 50 and 51 of the SII",
            example: "[]",
        },
        Key {
            name: "pdos",
            kind: Kind::List(row),
            need: Need::Without("no further PDOs"),
            means: "PDOs of which only the bits matter: rows of index and bits.",
            goes: "objects of PDO mapping; categories 50 and 51 of the SII",
            example: "[]",
        },
    ]
}

static OUTPUT_PDO: Section = Section {
    head: "[[outputs.pdo]]",
    means: "A PDO of the outputs.",
    keys: &pdo(RX_PDO, "0x1600"),
};

static INPUT_PDO: Section =
    Section { head: "[[inputs.pdo]]", means: "A PDO of the inputs.", keys: &pdo(TX_PDO, "0x1A00") };

const fn pdo(index: Kind, example: &'static str) -> [Key; 3] {
    [
        Key {
            name: "index",
            kind: index,
            need: Need::Required("the PDO's index"),
            means: "Its index.",
            goes: "the object of PDO mapping",
            example,
        },
        Key {
            name: "name",
            kind: Kind::Name("the PDO's name"),
            need: Need::Required("the PDO's name"),
            means: "Its name.",
            goes: "the object of PDO mapping; strings of the SII",
            example: r#""Outputs""#,
        },
        Key {
            name: "entries",
            kind: ENTRIES,
            need: Need::Required("rows [object, type, name]"),
            means: "What it maps, in order: rows of object, type and name, and padding such as { \
                    pad = 8 }.",
            goes: "the object of PDO mapping",
            example: r#"[["7000:01", "UNSIGNED16", "Value"], { pad = 8 }]"#,
        },
    ]
}

const ENTRIES: Kind = Kind::List(&Kind::Either(&[Kind::Row(&PDO_ROW), Kind::Table(&PADDING)]));

/// A mapped entry.
pub(in super::super) static PDO_ROW: Row = Row {
    expected: "a row such as [\"6040:00\", \"UNSIGNED16\", \"Controlword\"] or { pad = 8 }",
    cells: &[
        Cell {
            name: "object",
            kind: Kind::Pattern {
                expected: "an object such as \"6040:00\"",
                pattern: r"^(0x)?[0-9A-Fa-f]{4}:(0x)?[0-9A-Fa-f]{2}$",
            },
        },
        Cell { name: "type", kind: TYPE },
        Cell { name: "name", kind: Kind::Name("the entry's name") },
    ],
    more: None,
};

/// Bits that map nothing.
pub(in super::super) static PADDING: Section = Section {
    head: "padding of a PDO",
    means: "Bits that map nothing.",
    keys: &[Key {
        name: "pad",
        kind: Kind::Integer { least: 1, most: 64 },
        need: Need::Required("bits of padding"),
        means: "Number of bits that map nothing.",
        goes: "an entry 0x0000:00 of the object of PDO mapping",
        example: "8",
    }],
};

/// A PDO of the outputs of which only the bits matter.
pub(in super::super) static RX_PDO_ROW: Row = Row {
    expected: "a row [PDO, bits]",
    cells: &[Cell { name: "PDO", kind: RX_PDO }, BITS],
    more: None,
};

/// The same of the inputs.
pub(in super::super) static TX_PDO_ROW: Row = Row {
    expected: "a row [PDO, bits]",
    cells: &[Cell { name: "PDO", kind: TX_PDO }, BITS],
    more: None,
};

const BITS: Cell = Cell { name: "bits", kind: Kind::Integer { least: 0, most: 16_000 } };
const RX_PDO: Kind = Kind::Hex { least: 0x1600, most: 0x17FF };
const TX_PDO: Kind = Kind::Hex { least: 0x1A00, most: 0x1BFF };
