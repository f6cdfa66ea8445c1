//! KickCAT: its exceptions and log.

use super::causes;
use super::{Line, Program, introduction, line};

pub(super) static PROGRAM: Program = Program { name: "KickCAT", lines: LINES };

static LINES: &[Line] = &[
    line(
        &[
            "Invalid working counter: expected # got #",
            "Invalid working counter for slave #",
            "Invalid working counter",
            "Process INVALID WKC",
        ],
        &causes::LOW_WORKING_COUNTER,
    ),
    line(
        &["DC slave # NOT synchronized: drift = # ns", "NOT synchronized drift"],
        &causes::CLOCK_NOT_SETTLED,
    ),
    line(
        &["DC slave # synchronized: drift = # ns", "DC reference slave is #"],
        &causes::REFERENCE_CHOSEN,
    ),
    line(&["No dc slave found"], &causes::NO_REFERENCE),
    line(&["No slave detected", "0 slave detected on the network"], &causes::NO_DEVICES),
    line(&["slave detected on the network"], &causes::NOTICE),
    line(
        &["Error while trying to get slave state", "Error while requesting slave state"],
        &causes::DEVICE_LOST,
    ),
    introduction(&["State transition * error", "error::category::AL"], &causes::STATE_REFUSED),
    line(
        &["State transition timeout", "waiting for state * timeout", "waitForState timeout"],
        &causes::STATE_LATE,
    ),
    line(
        &["Error while reading SDO - Timeout", "Error while reading SDO Timeout"],
        &causes::MAILBOX_SILENT,
    ),
    introduction(
        &[
            "Error while reading SDO",
            "Error while writing SDO",
            "Abort requested for # code #",
            "Abort requested for",
        ],
        &causes::SDO_FAILED,
    ),
    line(
        &[
            "Error while fetching eeprom data",
            "Error while fetching eeprom state",
            "Cannot load EEPROM",
            "Checksum Mismatch * eeprom",
        ],
        &causes::EEPROM,
    ),
    line(
        &[
            "Error while fetching slave DC received times",
            "Error while applying slave DC offset",
            "Error while applying slave DC delay",
            "Error while doing static drift compensation",
            "Error while reading DC system time",
        ],
        &causes::NO_ANSWER,
    ),
    line(&["Invalid frame type", "Frame size is too small"], &causes::CORRUPTED),
    line(&["Nominal frame read fail", "Error fetching DL status"], &causes::NO_ANSWER),
    line(
        &[
            "master redundancy interface is not connected",
            "Redundancy frame read fail",
            "Fail to write on redundancy interface",
            "redundancy has been activated",
        ],
        &causes::REDUNDANCY_USED,
    ),
    line(
        &[
            "Invalid SyncManager configuration",
            "Insufficient FMMUs",
            "mapping size exceeds buffer size",
        ],
        &causes::CONFIGURATION,
    ),
    line(&["Invalid watchdog"], &causes::CONFIGURATION),
    line(
        &["Can't write to interface", "Can't read from interface", "Can not write to interface"],
        &causes::NO_SOCKET,
    ),
    line(&["!!! LATE !!!"], &causes::HOST_LATE),
];
