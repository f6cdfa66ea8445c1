//! Every key of a profile, declared: name, values, default, effect and destination.
//!
//! The parser uses these tables, and `isocat explain`, `docs/profile.md` and
//! `docs/profile.schema.json` are made from them. A new key is added here and read in `parse.rs` or
//! `rows.rs`; a test refuses a key that has only one of both.

mod cpu;
mod object;
mod process_data;

pub(super) use cpu::{LOSS_CODES, MEASURED, MISSED_EVENTS};
pub(super) use object::{ACCESS_WORDS, CODES, FIRST_AND_LAST, GAPS, ROW, TYPES};
pub(super) use process_data::{PADDING, PDO_ROW, RX_PDO_ROW, TX_PDO_ROW};

use isocat_descriptions::document::section::{
    Cell, Choice, Key, Kind, Limit, Need, Row, Rule, Section, Word,
};
use isocat_descriptions::start_up::Transition;
use isocat_esc::chip::{self, Chip};

use crate::chips;
use isocat_subdevice::MAX_MAILBOX;
use isocat_sync::SyncMode;
use isocat_wire::sii::Header;
use isocat_wire::time::Nanos;

use super::ApplicationKind;

/// The whole file.
pub static FILE: Section = Section {
    head: "",
    means: "A profile: everything that a virtual SubDevice is made of.",
    keys: &[
        Key {
            name: "id",
            kind: Kind::Name("the name that segment files use"),
            need: Need::Required("the name that segment files use"),
            means: "What segment files call the device.",
            goes: "Profile::id",
            example: r#""my_drive""#,
        },
        Key {
            name: "name",
            kind: Kind::Name("the product's name"),
            need: Need::Required("the product's name"),
            means: "Name of the product.",
            goes: "object 0x1008; strings of the SII",
            example: r#""My drive""#,
        },
        Key {
            name: "vendor",
            kind: Kind::Name("the maker's name"),
            need: Need::Required("the maker's name"),
            means: "Name of the maker.",
            goes: "Profile::vendor; strings of the SII",
            example: r#""Myself""#,
        },
        Key {
            name: "application",
            kind: Kind::Choice(Choice(&APPLICATIONS)),
            need: Need::Required("\"drive\" or \"io\""),
            means: "What the device does with its process data.",
            goes: "the simulated device's application",
            example: r#""io""#,
        },
        Key {
            name: "identity",
            kind: Kind::Table(&IDENTITY),
            need: Need::Required("a table with vendor_id, product_code and revision"),
            means: "Who made it, what it is, which revision.",
            goes: "object 0x1018, words 0x08 to 0x0F of the SII",
            example: "{ vendor_id = 1, product_code = 2, revision = 3, device_type = 0 }",
        },
        Key {
            name: "esc",
            kind: Kind::Table(&ESC),
            need: Need::Required("a table with the ESC's chip"),
            means: "Its EtherCAT SubDevice Controller.",
            goes: "the simulated ESC; words 0 to 7 of the SII",
            example: r#"{ chip = "ET1100", sync_unit = true }"#,
        },
        Key {
            name: "mailbox",
            kind: Kind::Table(&MAILBOX),
            need: Need::Without("a simple device: no mailbox and no objects"),
            means: "Its mailbox, by which objects are read and written.",
            goes: "SM0 and SM1; words 0x18 to 0x1B of the SII",
            example: "{ receive = { start = 0x1000, length = 128 }, send = { start = 0x1080, \
                      length = 128 } }",
        },
        Key {
            name: "modes",
            kind: Kind::List(&Kind::Choice(Choice(&MODES))),
            need: Need::Sometimes(
                "without [mailbox]",
                "what a device without [mailbox] works by, such as modes = [\"sm\"]",
            ),
            means: "What a device without mailbox can be synchronized by. Needed there, refused \
                    beside [mailbox], where 0x1C32:04 states it.",
            goes: "Behaviour::undeclared_types",
            example: r#"["sm"]"#,
        },
        Key {
            name: "outputs",
            kind: Kind::Table(&process_data::OUTPUTS),
            need: Need::Without("no outputs"),
            means: "Process data from the MainDevice.",
            goes: "SM2, objects 0x1600 to 0x17FF and 0x1C12",
            example: r#"{ start = 0x1100, length = 2, access = "ro", pdos = [[0x1600, 16]] }"#,
        },
        Key {
            name: "inputs",
            kind: Kind::Table(&process_data::INPUTS),
            need: Need::Without("no inputs"),
            means: "Process data to the MainDevice.",
            goes: "SM3, objects 0x1A00 to 0x1BFF and 0x1C13",
            example: r#"{ start = 0x1200, length = 2, access = "ro", pdos = [[0x1A00, 16]] }"#,
        },
        Key {
            name: "object",
            kind: Kind::Tables(&object::OBJECT),
            need: Need::Without("only the objects that follow from the rest"),
            means: "Objects of the dictionary. One that is written out takes the place of the one \
                    that would follow from the rest.",
            goes: "the object dictionary",
            example: r#"[{ index = 0x2000, name = "Own", entries = [[0, "UNSIGNED8", "ro", 1, "Own"]] }]"#,
        },
        Key {
            name: "opmode",
            kind: Kind::Tables(&OP_MODE),
            need: Need::Without("no choices in the SII"),
            means: "Synchronization choices as the ESI lists them. The first is the default.",
            goes: "category 60 (DC) of the SII",
            example: r#"[{ name = "DC", assign_activate = 0x0300, sync0_factor = 1 }]"#,
        },
        Key {
            name: "opmodes",
            kind: Kind::List(&Kind::Row(&OP_MODE_ROW)),
            need: Need::Without("no further choices"),
            means: "The same in short: rows of name, description, AssignActivate and the factors \
                    of SYNC0 and SYNC1. It stands before the tables.",
            goes: "category 60 (DC) of the SII",
            example: r#"[["DC", "DC SYNC0", 0x0300, 1, 0]]"#,
        },
        Key {
            name: "startup",
            kind: Kind::Tables(&STARTUP),
            need: Need::Without("no downloads"),
            means: "Downloads that the device wants at start, in their order. A segment file can't leave them out.",
            goes: "start-up lists; SDO downloads in PREOP",
            example: r#"[{ object = "2000:00", data = "07" }]"#,
        },
        Key {
            name: "times",
            kind: Kind::Table(&cpu::TIMES),
            need: Need::Sometimes(
                "without behaviour.device_emulation",
                "a table with application and others",
            ),
            means: "What its CPU really needs. A device without a program may leave it out.",
            goes: "the simulated CPU",
            example: r#"{ reaction = "50us", application = "20us", calc_and_copy = "10us", input_copy = "10us" }"#,
        },
        Key {
            name: "behaviour",
            kind: Kind::Table(&cpu::BEHAVIOUR),
            need: Need::Without("what most devices do"),
            means: "Behaviour that devices differ in.",
            goes: "the simulated device's stack",
            example: r#"{ missed_events = "slave-stack-code" }"#,
        },
        Key {
            name: "assumed",
            kind: Kind::Tables(&ASSUMED),
            need: Need::Without("every value is published"),
            means: "Objects and keys whose values are not published. Reports list them.",
            goes: "Profile::assumptions",
            example: r#"[{ what = "identity.revision", why = "not published" }]"#,
        },
        Key {
            name: "deviation",
            kind: Kind::Tables(&DEVIATION),
            need: Need::Without("no rule is known to be broken"),
            means: "Rules of `isocat conform` that the device is known to break.",
            goes: "Profile::deviations",
            example: r#"[{ rule = "OBJ-04", places = ["1C32:05"], why = "the manual has no such entry" }]"#,
        },
    ],
    rules: &[Rule::Either("modes", "mailbox")],
};

static STARTUP: Section = Section {
    head: "[[startup]]",
    means: "A download at start, as the InitCmds of an ESI.",
    keys: &[
        Key {
            name: "transition",
            kind: Kind::Choice(Choice(&TRANSITIONS)),
            need: Need::Default(r#""PS""#),
            means: "When it is made.",
            goes: "start-up lists",
            example: r#""IP""#,
        },
        Key {
            name: "object",
            kind: Kind::Pattern {
                expected: "an object such as \"8000:01\"",
                pattern: r"^(0x)?[0-9A-Fa-f]{4}:(0x)?[0-9A-Fa-f]{2}$",
            },
            need: Need::Required("an object such as \"8000:01\""),
            means: "What is written. The device must have it, and let it be written in PREOP.",
            goes: "the SDO download",
            example: r#""2000:00""#,
        },
        Key {
            name: "data",
            kind: Kind::Pattern {
                expected: "bytes such as \"0A FF\"",
                pattern: r"^\s*[0-9A-Fa-f]{2}(\s*[0-9A-Fa-f]{2})*\s*$",
            },
            need: Need::Required("bytes such as \"0A FF\""),
            means: "The bytes, in the order of the wire; as many as the entry has.",
            goes: "the SDO download",
            example: r#""07""#,
        },
        Key {
            name: "complete_access",
            kind: Kind::Boolean,
            need: Need::Default("false"),
            means: "The whole object is written at once.",
            goes: "the SDO download",
            example: "true",
        },
    ],
    rules: &[],
};

/// The transitions at which downloads are made.
pub(super) static TRANSITIONS: [Word<Transition>; 2] = [
    ("IP", "once PREOP is reached", Transition::IP),
    ("PS", "before SAFEOP is asked for", Transition::PS),
];

static IDENTITY: Section = Section {
    head: "[identity]",
    means: "Who made the device, what it is, which revision.",
    keys: &[
        number(
            "vendor_id",
            "the maker's number, object 0x1018:01",
            "Number of the maker.",
            "object 0x1018:01",
        ),
        number(
            "product_code",
            "the product's number, object 0x1018:02",
            "Number of the product.",
            "object 0x1018:02",
        ),
        number(
            "revision",
            "the revision, object 0x1018:03",
            "Number of the revision.",
            "object 0x1018:03",
        ),
        Key {
            need: Need::Default("0"),
            ..number(
                "serial",
                "",
                "Serial number; 0 for a device that has none.",
                "object 0x1018:04",
            )
        },
        Key {
            need: Need::Sometimes("beside [mailbox]", DEVICE_TYPE),
            ..number(
                "device_type",
                DEVICE_TYPE,
                "Number of the device profile and further information. A device without mailbox may \
             leave it out.",
                "object 0x1000",
            )
        },
        version("hardware_version", "Version of the hardware.", "object 0x1009"),
        version("software_version", "Version of the firmware.", "object 0x100A"),
    ],
    rules: &[],
};

const DEVICE_TYPE: &str = "the profile's number, object 0x1000";

const fn number(
    name: &'static str,
    expected: &'static str,
    means: &'static str,
    goes: &'static str,
) -> Key {
    let kind = Kind::Hex { least: 0, most: u32::MAX as i64 };
    Key { name, kind, need: Need::Required(expected), means, goes, example: "0x0000_0002" }
}

const fn version(name: &'static str, means: &'static str, goes: &'static str) -> Key {
    Key {
        name,
        kind: Kind::Name("a version in quotes"),
        need: Need::Default(r#""1.0""#),
        means,
        goes,
        example: r#""1.2""#,
    }
}

static ESC: Section = Section {
    head: "[esc]",
    means: "Its EtherCAT SubDevice Controller.",
    keys: &[
        Key {
            name: "chip",
            kind: Kind::Choice(Choice(&CHIPS)),
            need: Need::Required("the name of an ESC"),
            means: "Which ESC it has.",
            goes: "registers 0x0000 to 0x0009; ports, memory and delays of the simulated ESC",
            example: r#""ET1100""#,
        },
        Key {
            name: "ram_kib",
            kind: Kind::Integer { least: 1, most: 60 },
            need: Need::Without("those of the chip"),
            means: "KiB of its process RAM, where they are not those of the chip: that of an IP core is chosen with it.",
            goes: "register 0x0006; the memory of the simulated ESC",
            example: "60",
        },
        chips::DRIFT_LAW,
        chips::DRIFT_PHASE,
        chips::DRIFT_GAIN,
        chips::DIFFERENCE_POLARITY,
        chips::EEPROM_READ,
        chips::PORT_JITTER,
        Key {
            name: "ports",
            kind: Kind::Pattern { expected: PORTS, pattern: "^[YK][YK ]{0,3}$" },
            need: Need::Without("those of the chip"),
            means: "Its ports, one letter each from port 0, as `Physics` of an ESI has them: Y is \
                    MII (copper with a PHY), K is EBUS, a blank is none. Only ports of one kind \
                    can be joined.",
            goes: "register 0x0007; the PHYs on the way of a frame; the general category of the \
                   SII",
            example: r#""YKY""#,
        },
        Key {
            name: "sync_unit",
            kind: Kind::Boolean,
            need: Need::Required("whether SYNC0 can be generated, true or false"),
            means: "Whether SYNC0 can be generated.",
            goes: "bit 2 of register 0x0141, by word 0 of the SII",
            example: "true",
        },
        Key {
            name: "pulse",
            kind: PULSE,
            need: Need::Default(r#""10us""#),
            means: "Length of SYNC pulses. 0 ns is acknowledge mode: a pulse stays active until the \
                    program has read register 0x098E (SYNC1: 0x098F), `acknowledge` behind it.",
            goes: "register 0x0982, by word 2 of the SII",
            example: r#""100us""#,
        },
        Key {
            name: "alias",
            kind: Kind::Integer { least: 0, most: u16::MAX as i64 },
            need: Need::Default("0"),
            means: "Station alias; 0 for none.",
            goes: "register 0x0012, by word 4 of the SII",
            example: "5",
        },
        Key {
            name: "clock_tolerance",
            kind: Kind::Rate { least: 0, most: 1_000_000 },
            need: Need::Without("25 ppm, usual for SubDevices"),
            means: "How far its oscillator may be off, either way, where the maker states it.",
            goes: "the deviation that is drawn for the simulated ESC's oscillator where a segment \
                   file gives none",
            example: r#""50ppm""#,
        },
        Key {
            name: "watchdog_divider",
            kind: Kind::Integer { least: 0, most: u16::MAX as i64 },
            need: Need::Without("as after power-on, 2498: a unit of 100 us"),
            means: "The unit of both watchdogs, less 2, in 40 ns, if its maker orders one \
                    (`Reg0400` of an ESI).",
            goes: "register 0x0400, unless the segment file has its own `watchdog`",
            example: "2498",
        },
        Key {
            name: "watchdog_pdi",
            kind: Kind::Integer { least: 0, most: u16::MAX as i64 },
            need: Need::Without("as after power-on"),
            means: "The watchdog of the PDI in these units; 0: off (`Reg0410`).",
            goes: "register 0x0410, unless the segment file has its own `watchdog`",
            example: "1000",
        },
        Key {
            name: "watchdog_process_data",
            kind: Kind::Integer { least: 0, most: u16::MAX as i64 },
            need: Need::Without("as after power-on, 1000"),
            means: "The watchdog of the process data in these units; 0: off (`Reg0420`).",
            goes: "register 0x0420, unless the segment file has its own `watchdog`; the plan",
            example: "10000",
        },
    ],
    rules: &[],
};

static MAILBOX: Section = Section {
    head: "[mailbox]",
    means: "Where its mailboxes lie.",
    keys: &[
        Key {
            name: "receive",
            kind: Kind::Table(&MAILBOX_AREA),
            need: Need::Required("{ start = 0x1000, length = 128 }"),
            means: "Mailbox from the MainDevice.",
            goes: "SM0; words 0x18 and 0x19 of the SII",
            example: "{ start = 0x1000, length = 128 }",
        },
        Key {
            name: "send",
            kind: Kind::Table(&MAILBOX_AREA),
            need: Need::Required("{ start = 0x1000, length = 128 }"),
            means: "Mailbox to the MainDevice.",
            goes: "SM1; words 0x1A and 0x1B of the SII",
            example: "{ start = 0x1080, length = 128 }",
        },
        Key {
            name: "protocols",
            kind: Kind::List(&Kind::Choice(Choice(&PROTOCOLS))),
            need: Need::Without("CoE alone"),
            means: "What the mailbox is said to carry. The simulated device carries out CoE and SoE; to the other protocols \
                    that it announces it answers with their errors. Without CoE there are no objects.",
            goes: "word 0x1C of the SII",
            example: r#"["CoE", "FoE"]"#,
        },
    ],
    rules: &[],
};

/// Mailbox protocols, by their bits in word 0x1C of the SII.
pub(super) static PROTOCOLS: [Word<u16>; 6] = [
    ("CoE", "objects", Header::COE),
    ("AoE", "ADS", 1 << 0),
    ("EoE", "Ethernet", 1 << 1),
    ("FoE", "files", 1 << 3),
    ("SoE", "parameters of servo drives", 1 << 4),
    ("VoE", "of the vendor", 1 << 5),
];

static MAILBOX_AREA: Section = Section {
    head: "mailbox.receive",
    means: "Where a mailbox lies in the ESC's memory. `mailbox.send` has the same keys.",
    keys: &[
        Key {
            name: "start",
            kind: Kind::Hex { least: 0x1000, most: 0xFFFF },
            need: Need::Required("an address"),
            means: "Its first byte.",
            goes: "physical start address of the SyncManager",
            example: "0x1000",
        },
        Key {
            name: "length",
            // Two headers, an SDO of 8 bytes and space to segment; the limit is that of the stack.
            kind: Kind::Integer { least: 32, most: MAX_MAILBOX as i64 },
            need: Need::Required("bytes"),
            means: "Its length in bytes.",
            goes: "length of the SyncManager",
            example: "128",
        },
    ],
    rules: &[],
};

static OP_MODE: Section = Section {
    head: "[[opmode]]",
    means: "A synchronization choice, as the ESI lists it.",
    keys: &[
        Key {
            name: "name",
            kind: Kind::Name("the mode's name"),
            need: Need::Required("the mode's name"),
            means: "Short name.",
            goes: "category 60 of the SII",
            example: r#""DC""#,
        },
        Key {
            name: "description",
            kind: Kind::Name("a description"),
            need: Need::Without("none"),
            means: "Description.",
            goes: "category 60 of the SII",
            example: r#""DC with SYNC0""#,
        },
        Key {
            name: "assign_activate",
            kind: WORD,
            need: Need::Required("the word for registers 0x0980 and 0x0981"),
            means: "Word of the SYNC unit.",
            goes: "registers 0x0980 (low byte) and 0x0981 (high byte)",
            example: "0x0300",
        },
        factor(
            "sync0_factor",
            "Cycle of SYNC0 as a multiple of the bus cycle; 0 for none.",
            "register 0x09A0",
        ),
        factor(
            "sync1_factor",
            "Cycle of SYNC1 as a multiple of the SYNC0 cycle; 0 for none.",
            "register 0x09A4",
        ),
        Key {
            name: "sync0_cycle",
            kind: Kind::duration(Nanos::ZERO, Nanos::from_u32(u32::MAX)),
            need: Need::Default(r#""0ns""#),
            means: "Cycle of SYNC0 as a time; 0 ns: the factor counts.",
            goes: "register 0x09A0",
            example: r#""250us""#,
        },
        Key {
            name: "sync0_shift",
            kind: SHIFT,
            need: Need::Default(r#""0ns""#),
            means: "Shift of SYNC0 against the cycle.",
            goes: "register 0x0990",
            example: r#""-20us""#,
        },
        Key {
            name: "sync1_shift",
            kind: SHIFT,
            need: Need::Default(r#""0ns""#),
            means: "Shift of SYNC1 against SYNC0.",
            goes: "register 0x09A4",
            example: r#""20us""#,
        },
    ],
    rules: &[],
};

const fn factor(name: &'static str, means: &'static str, goes: &'static str) -> Key {
    Key { name, kind: FACTOR, need: Need::Default("0"), means, goes, example: "1" }
}

const SHIFT: Kind = Kind::duration(Nanos(i32::MIN as i64), Nanos(i32::MAX as i64));
const WORD: Kind = Kind::Hex { least: 0, most: u16::MAX as i64 };
const FACTOR: Kind = Kind::Integer { least: i16::MIN as i64, most: i16::MAX as i64 };

/// The short form of an OpMode.
pub(super) static OP_MODE_ROW: Row = Row {
    expected: "[name, description, assign_activate, sync0, sync1]",
    cells: &[
        Cell { name: "name", kind: Kind::Name("the mode's name") },
        Cell { name: "description", kind: Kind::Text("a description") },
        Cell { name: "assign_activate", kind: WORD },
        Cell { name: "sync0", kind: FACTOR },
        Cell { name: "sync1", kind: FACTOR },
    ],
    more: None,
};

static ASSUMED: Section = Section {
    head: "[[assumed]]",
    means: "Values that the maker does not publish.",
    keys: &[
        Key {
            name: "what",
            kind: Kind::Either(&[ITEM, Kind::List(&ITEM)]),
            need: Need::Required(ITEM_EXPECTED),
            means: "An object, an entry, a range of entries (each also with \" access\" or \" \
                    offset\" behind it), or a key of the file; one or a list.",
            goes: "Profile::assumptions",
            example: r#""identity.revision""#,
        },
        Key {
            name: "why",
            kind: Kind::Text("the reason for this value"),
            need: Need::Required("the reason for this value"),
            means: "The reason for this value.",
            goes: "Profile::assumptions",
            example: r#""not published; another device of the maker has it""#,
        },
    ],
    rules: &[],
};

const ITEM_EXPECTED: &str = "an object such as \"1C32:06\" or a key such as \"identity.revision\"";
const ITEM: Kind = Kind::Name(ITEM_EXPECTED);

static DEVIATION: Section = Section {
    head: "[[deviation]]",
    means: "A rule of `isocat conform` that the device is known to break.",
    keys: &[
        Key {
            name: "rule",
            kind: Kind::Name("a rule of isocat conform, such as \"OBJ-04\""),
            need: Need::Required("a rule of isocat conform, such as \"OBJ-04\""),
            means: "The rule.",
            goes: "Profile::deviations",
            example: r#""OBJ-04""#,
        },
        Key {
            name: "places",
            kind: Kind::List(&Kind::Pattern {
                expected: "objects or entries, such as [\"1C32:05\", \"1C33\"]",
                pattern: r"^(0x)?[0-9A-Fa-f]{4}(:(0x)?[0-9A-Fa-f]{2})?$",
            }),
            need: Need::Required("objects or entries, such as [\"1C32:05\", \"1C33\"]"),
            means: "Objects and entries where it is broken.",
            goes: "Profile::deviations",
            example: r#"["1C32:05", "1C33"]"#,
        },
        Key {
            name: "why",
            kind: Kind::Name("what the maker publishes instead"),
            need: Need::Required("what the maker publishes instead"),
            means: "What the maker publishes instead.",
            goes: "Profile::deviations",
            example: r#""the manual has no such entry""#,
        },
    ],
    rules: &[],
};

pub(super) const PORTS: &str =
    "one letter a port from port 0, such as \"YKY\": Y for MII, K for EBUS, a blank for none";

/// A device's use of its process data.
pub(super) static APPLICATIONS: [Word<ApplicationKind>; 2] = [
    ("drive", "a CiA 402 drive that follows target positions", ApplicationKind::Drive),
    ("io", "the inputs show the outputs", ApplicationKind::Io),
];

/// The synchronization modes, in the order of their bits in 0x1C32:04.
pub(crate) static MODES: [Word<SyncMode>; 6] = [
    mode(SyncMode::FreeRun, "Free Run: the device runs by its own timer"),
    mode(SyncMode::SmSynchronous, "SM-synchronous: the frame's arrival starts its cycle"),
    mode(
        SyncMode::DcSync0,
        "DC SYNC0: the frame brings outputs, SYNC0 lets them act and takes inputs",
    ),
    mode(SyncMode::DcShiftSync1, "DC SYNC0, and SYNC1 takes the inputs a part of the cycle later"),
    mode(SyncMode::DcSync1, "DC SYNC1: SYNC0 starts the calculation, SYNC1 lets outputs act"),
    mode(SyncMode::DcSubordinated, "DC with a short cycle of SYNC0, several times in a bus cycle"),
];

const fn mode(mode: SyncMode, means: &'static str) -> Word<SyncMode> {
    (mode.name(), means, mode)
}

/// The ESCs that profiles can name.
pub(super) static CHIPS: [Word<(&str, &Chip)>; 6] = [
    chip("ET1100", "Beckhoff ET1100 with MII and EBUS ports, 8 KiB", &chip::ET1100),
    chip("ET1100_MII", "Beckhoff ET1100 with two MII ports, as in a drive", &chip::ET1100_MII),
    chip("ET1200", "Beckhoff ET1200 with two EBUS ports, 1 KiB", &chip::ET1200),
    chip("IP_CORE_32", "IP core as in a drive, DC with 32 bits, 4 KiB", &chip::IP_CORE_32),
    chip("LAN9252", "Microchip LAN9252, 4 KiB", &chip::LAN9252),
    chip("XMC4800", "Infineon XMC4800, 8 KiB", &chip::XMC4800),
];

const fn chip(
    name: &'static str,
    means: &'static str,
    chip: &'static Chip,
) -> Word<(&'static str, &'static Chip)> {
    (name, means, (name, chip))
}

/// Length of SYNC pulses: register 0x0982 holds it in ticks of 10 ns.
pub(crate) const PULSE: Kind =
    Kind::Duration { least: Limit::At(0), most: Limit::At(u16::MAX as i64 * 10), whole: 10 };
const LONGEST_STEP: Nanos = Nanos::millis(1_000);
