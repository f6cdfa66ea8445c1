//! SOEM: what its samples and its error list print.

use super::causes::{self, entry};
use super::{Entry, Line, Program, introduction, line};

pub(super) static PROGRAM: Program = Program { name: "SOEM and programs with it", lines: LINES };

static LINES: &[Line] = &[
    line(
        &[
            "No slaves found",
            "0 slaves found",
            "0 slaves found and configured",
            "slaves found and configured 0",
            "no slave found",
            "found 0 slaves",
        ],
        &causes::NO_DEVICES,
    ),
    line(
        &[
            "ERROR : slave # lost",
            "slave # lost",
            "slave # is lost",
            "slave lost",
            "slave # not responding",
        ],
        &causes::DEVICE_LOST,
    ),
    line(
        &["MESSAGE : slave # found", "slave # found", "slave # recovered", "slave # reconfigured"],
        &causes::DEVICE_BACK,
    ),
    line(
        &[
            "slave # is in SAFE_OP + ERROR, attempting ack",
            "SAFE_OP + ERROR attempting ack",
            "is in SAFE_OP+ERROR",
        ],
        &causes::ERROR_BIT,
    ),
    line(
        &[
            "WARNING : slave # is in SAFE_OP, change to OPERATIONAL",
            "is in SAFE_OP change to OPERATIONAL",
        ],
        &IN_SAFEOP,
    ),
    line(
        &[
            "OK : all slaves resumed OPERATIONAL",
            "Operational state reached for all slaves",
            "all slaves are now operational",
            "OP state reached",
            "all slaves reached operational state",
            "all slaves reached OP",
            "all slaves in OP",
        ],
        &causes::IN_OPERATION,
    ),
    line(
        &[
            "Not all slaves reached operational state",
            "Not all slaves reached safe operational state",
            "not all slaves reached OP state",
            "not all slaves reached SAFEOP state",
            "not all slaves reached",
            "not all slaves are in",
            "not all slaves",
        ],
        &causes::NOT_ALL_IN_STATE,
    ),
    line(
        &[
            "Slave # Could not set to #",
            "Slave # could not set to",
            "could not set slave # to",
            "could not reach OP",
            "failed to reach OP",
        ],
        &causes::STATE_REFUSED,
    ),
    introduction(
        &["Slave # State=# StatusCode=#", "State=# StatusCode=#", "slave # is # AL-status=#"],
        &causes::STATE_REFUSED,
    ),
    introduction(&["SDO slave:# index:# error:#", "SDO slave # index"], &causes::SDO_FAILED),
    line(&["MBX slave:# error:#", "MBX slave # error"], &causes::MAILBOX_BROKEN),
    line(&["PACKET slave:# index:# error:#", "PACKET slave # index"], &causes::MAILBOX_BROKEN),
    line(&["EMERGENCY slave:# error:#", "EMERGENCY slave #"], &causes::EMERGENCY),
    line(&["SoE slave:# IDN:# error:#"], &causes::SDO_FAILED),
    line(
        &[
            "WKC -1",
            "working counter = -1",
            "working counter: -1",
            "working counter is -1",
            "wkc returned -1",
        ],
        &NO_FRAME,
    ),
    line(&["EC_NOFRAME"], &NO_FRAME),
    line(&["EC_OTHERFRAME", "working counter -2"], &causes::CORRUPTED),
    line(&["EC_TIMEOUT", "working counter -5"], &causes::NO_ANSWER),
    line(&["EC_ERROR", "working counter -3"], &causes::NO_ANSWER),
    line(
        &["EC_SLAVECOUNTEXCEEDED", "working counter -4", "too many slaves on network"],
        &causes::CAPACITY,
    ),
    line(
        &[
            "Processdata cycle # WKC #",
            "Calculated workcounter #",
            "wrong working counter",
            "incorrect working counter",
            "Workcounter error",
            "working counter too low",
            "wkc # wrong expected #",
            "expected working counter #",
            "got working counter #",
            "working counter # expected #",
            "wkc * expectedWKC",
            "working counter mismatch got # expected #",
        ],
        &causes::LOW_WORKING_COUNTER,
    ),
    line(
        &[
            "No socket connection on #",
            "No socket connection",
            "Excecute as root",
            "Execute as root",
            "could not open interface",
            "ec_init failed",
            "Unable to open adapter",
        ],
        &causes::NO_SOCKET,
    ),
    line(&["# slaves found and configured", "slaves found and configured"], &causes::NOTICE),
    line(
        &["Request operational state for all slaves", "Slaves mapped, state to SAFE_OP"],
        &causes::NOTICE,
    ),
    line(
        &[
            "Slave # has no proper mailbox in configuration",
            "has no proper mailbox out configuration",
        ],
        &MAILBOX_OF_SII,
    ),
    line(
        &["SM type workaround possible incorrect mapping", "Activated SM type workaround"],
        &causes::CONFIGURATION,
    ),
    line(
        &[
            "HW_RX: received idx # but we did not send one",
            "received idx # but we did not send one",
            "we did not send one",
        ],
        &causes::LATE_ANSWER,
    ),
    line(
        &[
            "not all previously sent frames are received",
            "wrong index received",
            "unexpected index",
        ],
        &causes::LATE_ANSWER,
    ),
    line(&["Wrong configuration", "IOmap too small"], &causes::CONFIGURATION),
];

static NO_FRAME: Entry = entry(
    "The call gave back -1 (EC_NOFRAME) instead of a working counter: no frame came back within \
         its time-out. It is no count of devices: the frame was lost, or its answer was late.",
    &[
        "the answer came late: the time-out (EC_TIMEOUTRET, 2 ms) passed; card, driver, interrupt \
             coalescing or the machine",
        "the frame was lost: a cable, a device without power, the link",
        "receive was called without a send before it, or twice",
        "another thread took the answer, or another program uses the interface",
    ],
    &[
        "a capture at the host: whether the frame came back, and when; `isocat diagnose FILE`",
        "0x0300 to 0x0313 of each device",
    ],
    &[
        "late: coalescing off (`ethtool -C IF rx-usecs 0`), real-time priority, a longer time-out",
        "lost: cable and power before the first device that is missing",
    ],
);

static IN_SAFEOP: Entry = entry(
    "A device that had been in OP is in SAFEOP without an error, and the program asks for OP \
         again. Its outputs are safe meanwhile.",
    &[
        "process data paused, and the device stepped down without an error",
        "it was lost and set up again, and OP is the last step",
    ],
    &["0x0130 and 0x0134", "the working counter of cycles before it: frames that were lost"],
    &["send process data in each cycle; then what made the cycles fail"],
);

static MAILBOX_OF_SII: Entry = entry(
    "The EEPROM states no mailbox, or not both halves of it, so that the program takes sizes of \
         its own.",
    &[
        "a blank or wrong EEPROM (SII words 0x18 to 0x1B)",
        "the program asks a device that has no mailbox",
    ],
    &["`isocat sii` of the EEPROM", "0x0800 and 0x0808: SM0 and SM1"],
    &["write the EEPROM of this device; no objects for a device without mailbox"],
);
