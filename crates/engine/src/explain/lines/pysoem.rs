//! pysoem: its exceptions, as Python prints them.

use super::causes::{self, entry};
use super::{Entry, Line, Program, introduction, line};

pub(super) static PROGRAM: Program = Program { name: "pysoem (exceptions)", lines: LINES };

static LINES: &[Line] = &[
    introduction(&["SdoError", "pysoem.SdoError"], &causes::SDO_FAILED),
    line(
        &["SdoInfoError", "Sdo List Info read failed", "Sdo Object Info read failed"],
        &DICTIONARY,
    ),
    line(&["MailboxError", "pysoem.MailboxError"], &causes::MAILBOX_BROKEN),
    line(&["PacketError", "pysoem.PacketError"], &PACKET),
    introduction(&["ConfigMapError", "pysoem.ConfigMapError"], &MAP),
    line(&["WkcError", "pysoem.WkcError"], &NOT_ANSWERED),
    line(&["pysoem.Emergency", "Emergency(slave"], &causes::EMERGENCY),
    line(
        &[
            "ConnectionError: could not open interface",
            "ConnectionError could not open",
            "NetworkInterfaceNotOpenError",
        ],
        &causes::NO_SOCKET,
    ),
    line(&["EepromError", "EEPROM write error"], &causes::EEPROM),
    line(&["BasicExampleError: no slave found", "no slave found"], &causes::NO_DEVICES),
    line(&["unexpected slave layout"], &causes::WRONG_DEVICE),
    line(&["requested slave device is not available"], &causes::TOPOLOGY),
];

static NOT_ANSWERED: Entry = entry(
    "A register or mailbox access had no working counter: the device did not count, or no frame \
         came back (-1).",
    &[
        "the device does not answer: no power, no link, or its address was lost",
        "an SDO without an answer: no mailbox in this state, or the device is busy",
        "a frame was lost, or its answer was late",
    ],
    &[
        "0x0130 of the device: whether it answers",
        "the number in it: 0 nobody counted, -1 no frame",
    ],
    &["power, cable and state of this device; PREOP before SDO; a longer time-out"],
);

static PACKET: Entry = entry(
    "An SDO was answered by something that does not fit the request; the number in it is that of \
         the library: 1 unexpected frame, 3 container too small for the data.",
    &[
        "3: the object holds more bytes than were asked for; give a larger size",
        "1: an answer to an older request, after a time-out",
        "two threads use the mailbox of one device",
    ],
    &["the type and length of the object in the device's dictionary"],
    &["the size of the object; one SDO at a time to a device"],
);

static DICTIONARY: Entry = entry(
    "The device did not give the list or the description of its objects: SDO information.",
    &["it has no SDO information: it is optional", "its mailbox was slow"],
    &["SII, category general: CoE details, bit of SDO information", "its description (ESI)"],
    &["use the description of the device instead of the dictionary"],
);

static MAP: Entry = entry(
    "While PDOs were read or set up for the process image, SDO of at least one device failed; each \
         error stands in the list.",
    &[
        "an object of mapping is missing (0x06020000): PDOs of this device are those of its SII",
        "a write in the device's configuration function was refused",
        "the mailbox did not answer in time",
    ],
    &[
        "each error in the list: slave, object and abort code",
        "0x1C12, 0x1C13 and the PDOs in them",
    ],
    &["take objects that this device has; call the map once, in PREOP"],
);
