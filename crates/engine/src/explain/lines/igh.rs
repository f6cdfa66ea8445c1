//! The IgH EtherCAT Master: its kernel log, and the tool `ethercat`.

use super::causes::{self, entry};
use super::{Entry, Line, Program, introduction, line};

pub(super) static PROGRAM: Program =
    Program { name: "IgH EtherCAT Master (kernel log)", lines: LINES };

static LINES: &[Line] = &[
    line(&["# datagrams TIMED OUT", "datagrams TIMED OUT"], &causes::NO_ANSWER),
    line(&["# datagrams UNMATCHED", "datagrams UNMATCHED"], &causes::LATE_ANSWER),
    line(
        &["Datagram * was SKIPPED # times", "was SKIPPED # times", "was SKIPPED"],
        &causes::SKIPPED,
    ),
    line(&["# frames CORRUPTED", "frames CORRUPTED"], &causes::CORRUPTED),
    line(
        &[
            "Domain #: Working counter changed to #",
            "Working counter changed to #",
            "Domain #: # working counter changes - now #",
            "working counter changes now #",
        ],
        &causes::COUNTER_CHANGES,
    ),
    line(&["Domain # WC # state", "Domain State #", "Domain: WC #"], &causes::COUNTER_CHANGES),
    line(
        &[
            "Slave did not sync after # ms",
            "did not sync after #",
            "slave could not be synchronized",
            "could not be synchronized",
            "slave did not sync",
        ],
        &causes::CLOCK_NOT_SETTLED,
    ),
    line(&["Failed to check DC synchrony", "DC sync check datagram"], &causes::CLOCK_NOT_SETTLED),
    line(
        &[
            "No app_time received up to now",
            "No application time supplied",
            "application time not supplied",
            "abort DC time offset calculation",
            "Cyclic start time will not be in phase",
        ],
        &causes::NO_APPLICATION_TIME,
    ),
    line(
        &[
            "Slave Config DC results in a negative sync1 cycle",
            "Resetting to zero cycle and shift time",
        ],
        &causes::PHASE,
    ),
    introduction(&["AL status message #", "Unknown AL status code #"], &causes::STATE_REFUSED),
    line(
        &[
            "Failed to set # state, slave refused state change",
            "Failed to set * state * slave refused state",
            "slave refused state change",
            "Failed to set state #",
            "Failed to set # state",
        ],
        &causes::STATE_REFUSED,
    ),
    line(
        &["Timeout while setting state #", "Timeout while acknowledging state #"],
        &causes::STATE_LATE,
    ),
    line(&["Slave has state error bit set"], &causes::ERROR_BIT),
    line(
        &[
            "Failed to acknowledge state change",
            "Acknowledged state #",
            "Changed to # in the meantime",
        ],
        &causes::ERROR_BIT,
    ),
    line(&["Slave states on # device", "Slave states on"], &SLAVE_STATES),
    line(
        &[
            "# slaves responding on # device",
            "# slaves responding",
            "Bus scanning completed in",
            "Scanning bus",
        ],
        &causes::SCAN_AGAIN,
    ),
    line(
        &["0 slaves responding on # device", "0 slaves responding", "No slaves responding"],
        &causes::NO_DEVICES,
    ),
    line(
        &[
            "Link state of # changed to UP",
            "Link state of # changed to",
            "carrier off",
            "Link is down",
        ],
        &causes::LINK,
    ),
    line(
        &[
            "Failed to calculate bus topology",
            "Retrying slave scan",
            "Finishing slave configuration",
        ],
        &causes::TOPOLOGY,
    ),
    line(
        &[
            "No DC reference clock found",
            "can not act as a DC reference clock",
            "DC reference clock not found",
        ],
        &causes::NO_REFERENCE,
    ),
    line(
        &[
            "Using slave # as DC reference clock",
            "as application selected DC reference clock",
            "as DC reference clock",
        ],
        &causes::REFERENCE_CHOSEN,
    ),
    line(&["Domain #: Redundant link in use", "Redundant link in use"], &causes::REDUNDANCY_USED),
    line(&["Redundant link unused again"], &RING_CLOSED),
    introduction(
        &[
            "SDO abort message #",
            "SDO download # aborted",
            "SDO download # # bytes aborted",
            "SDO upload # aborted",
            "SDO download * aborted",
            "SDO upload * aborted",
            "SDO configuration failed",
            "Unknown SDO abort code #",
            "Failed to process SDO request",
            "Incomplete abort command",
        ],
        &causes::SDO_FAILED,
    ),
    line(
        &[
            "SDO # upload response failed with timeout after # ms",
            "SDO # failed with timeout after # ms",
            "Timeout while waiting for SDO upload",
            "Timeout while waiting for SDO download",
            "Timeout after # ms while waiting",
            "failed with timeout after # ms",
            "response failed with timeout",
            "Reception of CoE upload response failed",
            "Reception of CoE download response failed",
            "Reception of CoE mailbox check datagram failed",
            "Reception of CoE download request failed",
            "Reception of CoE upload request failed",
            "Failed to receive CoE download response datagram",
            "Failed to receive CoE mailbox check datagram",
            "SDO request * timed out",
            "Aborting SDO request, slave is in INIT",
            "Aborting SDO request",
            "No mailbox response data received",
            "Slave cannot verify if mailbox communication",
        ],
        &causes::MAILBOX_SILENT,
    ),
    line(
        &[
            "Mailbox error response received",
            "Received mailbox protocol # as response",
            "Received mailbox protocol",
            "Corrupt mailbox response received",
            "Received corrupted SDO",
            "Received upload response for wrong SDO",
            "Received unknown response while",
            "Invalid mailbox response for",
            "Cleared old data from the mailbox",
            "Data size does not fit in mailbox",
            "Mailbox too small",
        ],
        &causes::MAILBOX_BROKEN,
    ),
    line(&["CoE Emergency Request received", "Error code # Error register #"], &causes::EMERGENCY),
    line(
        &[
            "PDO configuration failed",
            "Slave does not support assigning PDOs",
            "Slave does not support changing the PDO mapping",
            "Failed to configure mapping of PDO #",
            "Failed to configure mapping of PDO",
            "Failed to set number of assigned PDOs",
            "Failed to set number of entries",
            "Failed to assign PDO # at position # of SM#",
            "Failed to assign PDO",
            "Failed to map PDO entry",
            "Failed to clear PDO mapping",
            "Failed to clear PDO assignment",
            "PDO entry # is not mapped",
            "PDO entry # does not exist",
            "PDO # is not assigned",
            "Currently mapped PDO entries",
            "Currently assigned PDOs",
            "Slave has no SyncManager",
            "Slave seems not to support PDO",
            "Failed to read PDO entries for PDO",
            "Failed to read number of assigned PDOs",
            "does not contain an entry with",
            "FMMU limit reached",
            "Slave has less FMMUs",
            "Slave provides more sync managers",
            "Failed to set sync managers",
            "Failed to set process data sync managers",
            "Failed to set FMMUs",
            "SM# has an invalid direction field",
        ],
        &causes::CONFIGURATION,
    ),
    line(
        &[
            "Slave does not support distributed clocks",
            "Attached slave does not support CoE",
            "Slave does not support CoE",
            "Slave does not support SoE",
            "slave does not support SDO Info",
            "Slave does not support mailbox communication",
            "Slave cannot process CoE download request",
            "Slave cannot process CoE upload request",
            "Slave has no mailbox",
        ],
        &causes::NOT_SUPPORTED,
    ),
    line(
        &[
            "SII: Read timeout",
            "SII: Error on last SII command",
            "SII: Write timeout",
            "SII: Write operation failed",
            "Timeout waiting for EEPROM to load",
            "EEPROM not loaded",
            "Failed to fetch SII contents",
            "Failed to determine SII content size",
            "Failed to analyze category data",
            "Unexpected end of SII data",
            "Failed to assign SII to EtherCAT",
            "Failed to assign SII to PDI",
            "Reception of SII read datagram failed",
            "Reading word offset # failed",
        ],
        &causes::EEPROM,
    ),
    line(
        &["Slave type mismatch. Slave was", "Slave type mismatch", "is of wrong type"],
        &causes::WRONG_DEVICE,
    ),
    line(&["config # has no slave attached", "has no slave attached"], &NOT_ATTACHED),
    line(
        &["No response from slave", "Slave did not respond", "No response on", "no response"],
        &causes::DEVICE_LOST,
    ),
    line(
        &[
            "Failed to receive AL state datagram",
            "Failed to receive DL status datagram",
            "Failed to receive system time datagram",
            "Failed to receive state checking datagram",
            "Failed to receive DC receive times datagram",
            "Failed to receive DC system time offset datagram",
            "Failed to receive DC start time datagram",
            "Failed to receive DC cycle times datagram",
            "Failed to receive state datagram",
            "Failed to receive station address datagram",
            "Failed to receive delay measuring datagram",
            "Failed to receive loop control",
            "Failed to receive base data datagram",
            "Failed to receive * datagram",
            "Failed to * Datagram timed out",
            "Datagram timed out",
            "Reception of * datagram failed",
            "Reception of * failed",
        ],
        &causes::NO_ANSWER,
    ),
    line(
        &[
            "Failed to read AL state",
            "Failed to read DL status",
            "Failed to read base data",
            "Failed to check state #",
            "Failed to get DC times",
            "Failed to get DC receive times",
            "Failed to set DC system time offset",
            "Failed to set DC cycle times",
            "Failed to set DC start time",
            "Failed to activate DC",
            "Failed to write station address",
            "Failed to reset DC filter",
            "Failed to clear station addresses",
            "Failed to set watchdog divider",
        ],
        &NOT_COUNTED,
    ),
    line(
        &[
            "Failed to activate master",
            "Master already in use",
            "Master still waiting for devices",
            "Master not active",
            "Failed to request master",
            "Failed to open /dev/EtherCAT",
            "Failed to reserve master",
            "Failed to enter OPERATION phase",
            "Failed to enter IDLE phase",
            "masters waiting for devices",
            "Unable to find master",
        ],
        &causes::BUSY_MASTER,
    ),
    line(&["No free datagram during", "datagram queue full", "max_queue_size"], &causes::CAPACITY),
    line(
        &[
            "Master # not yet synchronized",
            "Master not yet synchronized",
            "not yet synchronized",
            "not yet synced",
        ],
        &causes::OUT_OF_STEP,
    ),
    line(
        &[
            "Checking for synchrony",
            "Releasing master",
            "Requesting master",
            "Accepting # as # device for master",
        ],
        &causes::NOTICE,
    ),
];

static SLAVE_STATES: Entry = entry(
    "The states of all devices, or-ed together (a broadcast of AL status): OP alone means that all \
         are in OP, SAFEOP, OP that at least one is only in SAFEOP.",
    &[
        "at start: devices come up one after the other; nothing is wrong",
        "in operation a lower state in the list: a device left OP by itself",
        "with + ERROR: its AL status code says why",
    ],
    &["0x0130 and 0x0134 of each device: `isocat explain 0x001A` explains a code"],
    &["remove the cause that the code names, acknowledge, ask for OP again"],
);

static RING_CLOSED: Entry = entry(
    "The ring is closed again: frames go all the way round, and redundancy is back.",
    &["the cable is plugged again, or the device has power"],
    &["0x0310 to 0x0313: which link was lost", "0x092C: whether clocks agree"],
    &["find out why the ring was open: `ring = true` in a segment file shows what a break costs"],
);

static NOT_ATTACHED: Entry = entry(
    "The configuration has a device at an alias and position where none answers.",
    &[
        "the device is missing: no power or link",
        "alias or position is wrong: position counts from the device with the alias",
        "the search of devices has not ended yet",
    ],
    &[
        "`ethercat slaves`, `isocat scan --interface IF`: what is there",
        "SII word 4, register 0x0012: the alias",
    ],
    &["correct alias and position, or bring the device up; wait for the search before activating"],
);

static NOT_COUNTED: Entry = entry(
    "The program read or wrote a register of a device, the frame came back, and the device did not \
         count.",
    &[
        "the device is gone: power or link was lost while it was set up",
        "it has no such register: DC registers of a device without DC",
        "its station address was lost with power",
    ],
    &["0x0110 of the device before it: links", "0x0008 bit 2: whether it has DC"],
    &["power and cable of the device; no DC for a device that has none"],
);
