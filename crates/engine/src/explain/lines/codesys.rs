//! CODESYS: log and status page of its EtherCAT stack.

use super::causes;
use super::{Line, Program, line};

pub(super) static PROGRAM: Program = Program { name: "CODESYS", lines: LINES };

static LINES: &[Line] = &[
    line(
        &[
            "Distributed clock not synchronized",
            "Distributed clocks not synchronized",
            "DC not synchronized",
            "Sync window exceeded",
            "Sync window monitoring",
            "DC sync window",
            "xDistributedClockInSync = FALSE",
            "xDistributedClockInSync",
            "DistributedClockInSync",
            "xSyncInWindow",
            "clock is not in sync window",
            "outside the sync window",
        ],
        &causes::OUT_OF_STEP,
    ),
    line(
        &["Distributed clocks synchronized", "Distributed clock synchronized"],
        &causes::IN_OPERATION,
    ),
    line(
        &[
            "Working counter error",
            "Workingcounter wrong",
            "WrongWorkingCounter",
            "Working counter invalid",
            "Invalid workingcounter",
        ],
        &causes::LOW_WORKING_COUNTER,
    ),
    line(
        &[
            "Could not open network adapter",
            "Network adapter not found",
            "no network adapter",
            "adapter with MAC address not found",
            "Ethernet adapter not found",
        ],
        &causes::NO_SOCKET,
    ),
    line(
        &[
            "slaves at bus does not match configuration",
            "Wrong number of slaves",
            "Number of slaves does not match",
            "different slave count",
        ],
        &causes::TOPOLOGY,
    ),
    line(
        &[
            "VendorID wrong",
            "ProductID wrong",
            "Vendor ID mismatch",
            "Product ID mismatch",
            "Wrong vendor",
            "Check VendorID",
            "Revision mismatch",
        ],
        &causes::WRONG_DEVICE,
    ),
    line(&["No slave found", "no slaves on the bus"], &causes::NO_DEVICES),
    line(
        &[
            "Slave * not responding",
            "lost connection to slave",
            "Connection to slave lost",
            "No communication to slave",
            "slave does not respond",
        ],
        &causes::DEVICE_LOST,
    ),
    line(
        &[
            "SDO write error",
            "SDO read error",
            "SDO error",
            "SDO write * failed",
            "SDO read * failed",
            "Abort SDO",
        ],
        &causes::SDO_FAILED,
    ),
    line(&["Mailbox timeout", "SDO timeout", "No mailbox response"], &causes::MAILBOX_SILENT),
    line(
        &["Not all slaves operational", "Slave * not in operational", "not operational"],
        &causes::NOT_ALL_IN_STATE,
    ),
    line(&["Cable error", "Kabelfehler", "link error"], &causes::CRC),
    line(
        &[
            "bus cycle task exceeded",
            "task watchdog",
            "cycle time exceeded",
            "Bus task jitter",
            "cycle overrun",
        ],
        &causes::HOST_LATE,
    ),
    line(&["Frame loss", "lost frames", "frame lost", "packet lost"], &causes::NO_ANSWER),
    line(&["Redundancy is active", "ring broken", "Line break"], &causes::REDUNDANCY_USED),
];
