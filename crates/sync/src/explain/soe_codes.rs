//! SoE error codes: why a parameter of a drive could not be read or written.

use isocat_wire::soe::ErrorCode;

use super::{Entry, entry};

/// The meaning of a code; `None` for a code that no published list contains.
pub fn explain(code: ErrorCode) -> Option<&'static Entry> {
    code.meaning()?;
    let special = SPECIAL.iter().find(|(known, _)| *known == code);
    // Codes x001 to x005 mean the same for each element: name, attribute, unit, minimum, maximum,
    // value, default.
    let of_element = || match code.0 & 0x0FFF {
        1 => Some(&ABSENT),
        2 => Some(&TOO_SHORT),
        3 => Some(&TOO_LONG),
        4 => Some(&READ_ONLY),
        5 => Some(&PROTECTED),
        _ => None,
    };
    special.map(|(_, entry)| entry).or_else(of_element)
}

/// The drive does not have the element.
static ABSENT: Entry = entry(
    "The IDN has no such element: no name, unit, limit or default value.",
    &["the drive does not keep texts or limits", "another element was meant"],
    &["the attribute (element 0x04): what the value is"],
    &["read the value (element 0x40) alone"],
);

/// Fewer bytes arrived than the element has.
static TOO_SHORT: Entry = entry(
    "Fewer bytes came than the element has.",
    &[
        "a value of another length than the attribute says",
        "a list without the four bytes of lengths in front, or with more in them than came",
        "fragments were lost",
    ],
    &["the attribute (element 0x04): length, and whether it is a list"],
    &["send as many bytes as the attribute says"],
);

/// More bytes arrived than the element has.
static TOO_LONG: Entry = entry(
    "More bytes came than the element has room for.",
    &["a value of another length than the attribute says", "a list longer than its maximum"],
    &["the attribute (element 0x04)", "of a list, the second of its lengths: the most that fits"],
    &["send as many bytes as the attribute says"],
);

/// The element can never be written.
static READ_ONLY: Entry = entry(
    "The element can't be written at all.",
    &["a measured value, or one that the drive computes", "an element other than the value"],
    &["bits 28 to 30 of the attribute: in which states the value can't be written"],
    &["leave it out of the start-up list"],
);

/// The element cannot be written at present.
static PROTECTED: Entry = entry(
    "The element can't be written in the present state.",
    &["communication parameters can be written in PREOP alone", "the drive is under power"],
    &["bits 28 to 30 of the attribute: protected in PREOP, SAFEOP, OP", "AL status (0x0130)"],
    &["write it on the way from PREOP to SAFEOP"],
);

static SPECIAL: [(ErrorCode, Entry); 22] = [
    (ErrorCode::INVALID_ACCESS, INVALID_ACCESS),
    (
        ErrorCode::NO_IDN,
        entry(
            "The drive does not have this IDN.",
            &[
                "a start-up list for another firmware or another drive",
                "a P parameter of another maker",
                "the wrong drive number of a SubDevice with several drives",
            ],
            &["S-0-0017, the list of all IDNs of the drive"],
            &["take the maker's description of this revision", "leave the parameter out"],
        ),
    ),
    (ErrorCode::INVALID_ELEMENT, INVALID_ACCESS),
    (
        ErrorCode::VALUE_TOO_LOW,
        entry("The value is below the least one.", LIMITS, READ_LIMITS, &["a greater value"]),
    ),
    (
        ErrorCode::VALUE_TOO_HIGH,
        entry("The value is above the greatest one.", LIMITS, READ_LIMITS, &["a smaller value"]),
    ),
    (
        ErrorCode::VALUE_INVALID,
        entry(
            "The drive can't take this value; in S-0-0016 or S-0-0024, an IDN that can't be in its process data.",
            &[
                "a mode, cycle time or list that the drive does not have",
                "process data of another firmware",
            ],
            &["S-0-0187 and S-0-0188: what can be in the process data"],
            &["take the lists of the maker's description"],
        ),
    ),
    (
        ErrorCode::VALUE_PASSWORD,
        entry(
            "The value is protected by a password.",
            &["the drive was locked after commissioning"],
            &["S-0-0267, the password"],
            &["unlock the drive, or leave the parameter out"],
        ),
    ),
    (
        ErrorCode::VALUE_CYCLIC,
        entry(
            "The value is in the process data: the mailbox can't write it beside.",
            &["a command value of S-0-0024 is in the start-up list, too"],
            &["S-0-0024, what the outputs have"],
            &["write it through the process data"],
        ),
    ),
    (
        ErrorCode::INDIRECT_ADDRESS,
        entry(
            "An address in the value points to nothing.",
            &["a data container or a memory address that the drive does not have"],
            &["the maker's manual of this parameter"],
            &["another address"],
        ),
    ),
    (
        ErrorCode::VALUE_OTHER_SETTINGS,
        entry(
            "Other settings of the drive keep the value from being written.",
            &["an operation mode or a motor that leaves it no choice"],
            &["S-0-0032, the operation mode"],
            &["write the parameters in the order of the description"],
        ),
    ),
    (ErrorCode::COMMAND_ACTIVE, COMMAND),
    (ErrorCode::COMMAND_NOT_INTERRUPTIBLE, COMMAND),
    (ErrorCode::COMMAND_NOT_NOW, COMMAND),
    (
        ErrorCode::COMMAND_PARAMETERS,
        entry(
            "A command can't be carried out with the parameters that the drive has.",
            &["parameters of the command were not written before"],
            &["S-0-0022, the IDNs that are not valid"],
            &["write the parameters first"],
        ),
    ),
    (
        ErrorCode::NO_DATA_STATE,
        entry(
            "The IDN has no data state.",
            &["the drive keeps data states of commands alone"],
            &["the attribute: bit 19 tells commands"],
            &["read the value (element 0x40) alone"],
        ),
    ),
    (
        ErrorCode::DEFAULT_TOO_LONG,
        entry(
            "The default value is longer than can be sent.",
            &["a long list"],
            &["the attribute (element 0x04)"],
            &["read the value (element 0x40) alone"],
        ),
    ),
    (
        ErrorCode::DRIVE_NUMBER,
        entry(
            "The SubDevice has no drive with this number.",
            &[
                "MainDevices that look for drives ask each number from 0 to 7: then it is no fault",
                "a start-up list for a SubDevice with two drives at one with a single drive",
            ],
            &["SII, category General, byte 0x08: number of drives"],
            &["the right device in the configuration"],
        ),
    ),
    (
        ErrorCode::GENERAL,
        entry(
            "The drive gives no reason.",
            &["the value is outside of what the drive can do at present"],
            &["S-0-0095, the diagnostic message"],
            &["the maker's manual of this parameter"],
        ),
    ),
    (
        ErrorCode::NO_ELEMENT,
        entry(
            "The request names no element.",
            &["a wrongly built request: its element flags are 0"],
            &["the second byte of the SoE header"],
            &["0x40 for the value"],
        ),
    ),
    (ErrorCode::NO_NAME, ABSENT_TEXT),
    (ErrorCode::NO_UNIT, ABSENT_TEXT),
    (
        ErrorCode::NO_DEFAULT,
        entry(
            "The IDN has no default value.",
            &["the drive keeps default values of few parameters, or of none"],
            &["the maker's manual"],
            &["read the value (element 0x40) after power-on"],
        ),
    ),
];

const INVALID_ACCESS: Entry = entry(
    "The data state, or the number of the IDN itself, can't be accessed like that.",
    &["a write with element 0x01"],
    &["the second byte of the SoE header"],
    &["write the value (element 0x40)"],
);
const COMMAND: Entry = entry(
    "A command of the drive is under way, or can't be begun or stopped now.",
    &["a command was begun and not cleared", "the drive is not enabled, or is enabled"],
    &["the data state of the command (element 0x01)", "S-0-0135, the drive's status word"],
    &["clear the command with 0, wait, and begin it anew"],
);
const ABSENT_TEXT: Entry = entry(
    "The IDN has no such text.",
    &["the drive keeps no texts; those of the maker's description are the tool's own"],
    &["the attribute (element 0x04), which each IDN has"],
    &["read the value (element 0x40) alone"],
);
const LIMITS: &[&str] = &["a value in another unit or with another scaling than was meant"];
const READ_LIMITS: &[&str] =
    &["minimum and maximum (elements 0x10, 0x20)", "the attribute: decimals and scaling"];
