//! The key `modules`: the modules in the slots of a modular device.

use isocat_descriptions::document::section::{Key, Kind, Need, Section};

pub(super) const MODULES_KEY: Key = Key {
    name: "modules",
    kind: Kind::List(&Kind::Either(&ITEMS)),
    need: Need::Without("the modules that the description presets"),
    means: "The modules in the slots of a modular device, place by place from the first, as `isocat \
            devices vendor.xml --modules` lists them: a type, an ident, or a table with `module`, \
            `slot` and `count`. `\"\"` leaves a place empty, and so do places behind the last one. \
            Only beside `esi`.",
    goes: "process data, objects and downloads at start of the device; objects 0xF030 and 0xF050",
    example: r#"["DI16", "DI16", 0x0000_2040]"#,
};

/// A row of `modules`.
pub(in super::super) static MODULE: Section = Section {
    head: "a table of modules",
    means: "A module, or several of one kind, and where the first of them stands.",
    keys: &[
        Key {
            name: "module",
            kind: Kind::Either(&[NAMED, IDENT]),
            need: Need::Required("a type of module, such as module = \"DI16\""),
            means: "The module: its type or its ident. `\"\"` leaves the places empty.",
            goes: "the choice of the module in the ESI file",
            example: r#""DI16""#,
        },
        Key {
            name: "slot",
            kind: Kind::Either(&[
                Kind::Name(SLOT_EXPECTED),
                Kind::Integer { least: 0, most: MOST_PLACES - 1 },
            ]),
            need: Need::Without("the place behind the row before"),
            means: "Where the first of them stands: the number of a place, or the name of a slot, \
                    which is its first place that no row before has given.",
            goes: "the indices of PDOs and objects; the sub-index of 0xF030",
            example: "3",
        },
        Key {
            name: "count",
            kind: Kind::Integer { least: 1, most: MOST_PLACES },
            need: Need::Default("1"),
            means: "Number of such modules, one behind the other.",
            goes: "the modules of the device",
            example: "4",
        },
    ],
    rules: &[],
};

const ITEMS: [Kind; 3] = [NAMED, IDENT, Kind::Table(&MODULE)];
const NAMED: Kind = Kind::Text(MODULE_EXPECTED);
const IDENT: Kind = Kind::Hex { least: 0, most: u32::MAX as i64 };

pub(in super::super) const MODULE_EXPECTED: &str =
    "a type of module such as \"DI16\", its ident, or \"\" for an empty place";
pub(in super::super) const SLOT_EXPECTED: &str =
    "the name of a slot, or the number of a place from 0";
/// Largest number of entries of the objects 0xF030 and 0xF050.
pub(in super::super) const MOST_PLACES: i64 = 255;
