//! `[outputs]`, `[inputs]` and their PDOs.

use isocat_descriptions::document::section::{Cell, Key, Kind, Need, Row, Section};
use isocat_subdevice::MAX_PROCESS_DATA;

use super::object::{ACCESS, TYPE};

pub(super) static OUTPUTS: Section = Section {
    head: "[outputs]",
    means: "Process data from the MainDevice.",
    keys: &area(&Direction {
        sync_manager: "SM2",
        number: "2",
        assignment: "object 0x1C12",
        list: Kind::List(&RX_PDO),
        pdo: Kind::Tables(&OUTPUT_PDO),
        pdos: Kind::List(&Kind::Row(&RX_PDO_ROW)),
        list_example: "[0x1600]",
        pdo_example: r#"[{ index = 0x1600, name = "Outputs", entries = [{ pad = 8 }] }]"#,
        pdos_example: "[[0x1600, 16]]",
    }),
    rules: &[],
};

pub(super) static INPUTS: Section = Section {
    head: "[inputs]",
    means: "Process data to the MainDevice. Its keys are those of [outputs].",
    keys: &area(&Direction {
        sync_manager: "SM3",
        number: "3",
        assignment: "object 0x1C13",
        list: Kind::List(&TX_PDO),
        pdo: Kind::Tables(&INPUT_PDO),
        pdos: Kind::List(&Kind::Row(&TX_PDO_ROW)),
        list_example: "[0x1A00]",
        pdo_example: r#"[{ index = 0x1A00, name = "Inputs", entries = [{ pad = 8 }] }]"#,
        pdos_example: "[[0x1A00, 16]]",
    }),
    rules: &[],
};

/// The differences of outputs and inputs.
struct Direction {
    sync_manager: &'static str,
    number: &'static str,
    assignment: &'static str,
    list: Kind,
    pdo: Kind,
    pdos: Kind,
    list_example: &'static str,
    pdo_example: &'static str,
    pdos_example: &'static str,
}

const fn area(of: &Direction) -> [Key; 9] {
    let Direction { sync_manager, number, assignment, list, pdo, pdos, .. } = *of;
    let Direction { list_example, pdo_example, pdos_example, .. } = *of;
    [
        Key {
            name: "start",
            kind: Kind::Hex { least: 0x0F00, most: 0xFFFF },
            need: Need::Required("an address"),
            means: "First byte of the area. There are three buffers, one behind the other, in the process RAM (from \
                    0x1000). Outputs of a device without a program may be the registers of digital outputs, 0x0F00 to \
                    0x0F03.",
            goes: sync_manager,
            example: "0x1800",
        },
        Key {
            name: "length",
            kind: Kind::Integer { least: 0, most: MAX_PROCESS_DATA as i64 },
            need: Need::Required("the most bytes of one buffer"),
            means: "Most bytes of one buffer. Without mailbox it is exactly what the PDOs of \
                    `default` need.",
            goes: sync_manager,
            example: "16",
        },
        Key {
            name: "sync_manager",
            kind: Kind::Integer { least: 0, most: 15 },
            need: Need::Default(number),
            means: "Number of the SyncManager. 0 and 1 are the mailbox, where there is one.",
            goes: "SyncManagers, object 0x1C00, the SII",
            example: "5",
        },
        Key {
            name: "access",
            kind: ACCESS,
            need: Need::Sometimes(
                "beside [mailbox]",
                "the states in which the PDO assignment can be written, such as \"ro\"",
            ),
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
            kind: list,
            need: Need::Without("none"),
            means: "PDOs that are assigned at power-on.",
            goes: assignment,
            example: list_example,
        },
        Key {
            name: "recommended",
            kind: list,
            need: Need::Without("those of `default`"),
            means: "PDOs that should be assigned: written where the assignment is writable. Only \
                    beside [mailbox].",
            goes: assignment,
            example: list_example,
        },
        Key {
            name: "pdo",
            kind: pdo,
            need: Need::Without("no PDOs, or those of `pdos`"),
            means: "PDOs with their entries.",
            goes: "objects of PDO mapping; categories 50 and 51 of the SII",
            example: pdo_example,
        },
        Key {
            name: "pdos",
            kind: pdos,
            need: Need::Without("no further PDOs"),
            means: "PDOs of which only the bits matter: rows of index and bits.",
            goes: "objects of PDO mapping; categories 50 and 51 of the SII",
            example: pdos_example,
        },
    ]
}

static OUTPUT_PDO: Section = Section {
    head: "[[outputs.pdo]]",
    means: "A PDO of the outputs.",
    keys: &pdo(RX_PDO, "0x1600"),
    rules: &[],
};

static INPUT_PDO: Section = Section {
    head: "[[inputs.pdo]]",
    means: "A PDO of the inputs.",
    keys: &pdo(TX_PDO, "0x1A00"),
    rules: &[],
};

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

const ENTRY_KINDS: &[Kind] = &[Kind::Row(&PDO_ROW), Kind::Table(&PADDING)];
const ENTRY: Kind = Kind::Either(ENTRY_KINDS);
const ENTRIES: Kind = Kind::List(&ENTRY);

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
        Cell { name: "name", kind: Kind::Text("the entry's name") },
    ],
    more: Some(&MORE),
};

static MORE: Section = Section {
    head: "behind a row of a PDO",
    means: "How long a mapped entry is.",
    keys: &[Key {
        name: "bits",
        kind: Kind::Integer { least: 1, most: 255 },
        need: Need::Required("the bits that are mapped"),
        means: "Bits that are mapped, of a type that does not fix them. Without it those of the type.",
        goes: "the object of PDO mapping",
        example: "128",
    }],
    rules: &[],
};

/// Bits without a mapped entry.
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
    rules: &[],
};

/// A PDO of the outputs, defined by its number of bits only.
pub(in super::super) static RX_PDO_ROW: Row = Row {
    expected: "a row [PDO, bits]",
    cells: &[Cell { name: "PDO", kind: RX_PDO }, BITS],
    more: None,
};

/// A PDO of the inputs, defined by its number of bits only.
pub(in super::super) static TX_PDO_ROW: Row = Row {
    expected: "a row [PDO, bits]",
    cells: &[Cell { name: "PDO", kind: TX_PDO }, BITS],
    more: None,
};

const BITS: Cell = Cell { name: "bits", kind: Kind::Integer { least: 0, most: 16_000 } };
/// Without CoE a PDO is no object: makers number them freely, and for SoE by the number of a
/// parameter.
const RX_PDO: Kind = Kind::Hex { least: 0x0001, most: 0x1BFF };
const TX_PDO: Kind = RX_PDO;
