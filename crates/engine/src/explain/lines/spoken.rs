//! What many programs and people write in nearly the same words.

use super::causes;
use super::{Line, Program, introduction, line};

pub(super) static PROGRAM: Program = Program { name: "several programs", lines: LINES };

static LINES: &[Line] = &[
    line(
        &[
            "working counter error",
            "working counter * expected",
            "unexpected working counter",
            "invalid working counter",
            "working counter is 0",
            "working counter dropped",
            "wrong working counter",
        ],
        &causes::LOW_WORKING_COUNTER,
    ),
    line(
        &[
            "lost synchronization",
            "loss of synchronization",
            "synchronization lost",
            "lost sync",
            "sync error",
            "clock out of sync",
            "not in sync",
            "clocks not synchronized",
            "synchronization loss",
        ],
        &causes::OUT_OF_STEP,
    ),
    line(
        &["SYNC0 sync frame is lost", "sync frame is lost", "sync frame lost"],
        &causes::OUT_OF_STEP,
    ),
    line(
        &[
            "frame lost",
            "lost frame",
            "packet loss",
            "frame loss",
            "lost packet",
            "dropped frame",
            "no frame received",
        ],
        &causes::NO_ANSWER,
    ),
    line(
        &[
            "receive timeout",
            "frame timeout",
            "response timeout",
            "datagram timeout",
            "timed out waiting for frame",
        ],
        &causes::NO_ANSWER,
    ),
    line(
        &[
            "slave disconnected",
            "slave # disconnected",
            "device disconnected",
            "slave # offline",
            "slave missing",
            "lost slave",
            "slave * not found",
            "slave * offline",
        ],
        &causes::DEVICE_LOST,
    ),
    line(
        &[
            "no slaves detected",
            "no slave detected",
            "no EtherCAT slaves",
            "found no slaves",
            "no slaves on bus",
            "no devices found",
            "no slaves connected",
        ],
        &causes::NO_DEVICES,
    ),
    introduction(
        &[
            "state transition failed",
            "failed to transition to",
            "failed to go to OP",
            "transition to # failed",
            "failed to set OP",
            "could not change state",
            "state change failed",
        ],
        &causes::STATE_REFUSED,
    ),
    line(
        &[
            "timeout waiting for state",
            "timeout waiting for OP",
            "timeout reaching OP",
            "state change timed out",
        ],
        &causes::STATE_LATE,
    ),
    line(
        &["link down", "link is down", "link lost", "carrier lost", "NIC Link is Down"],
        &causes::LINK,
    ),
    line(
        &[
            "deadline missed",
            "missed deadline",
            "cycle overrun",
            "loop overrun",
            "cycle time overrun",
            "overrun in cyclic task",
            "task overrun",
            "cycle late",
        ],
        &causes::HOST_LATE,
    ),
    line(
        &[
            "mailbox timeout",
            "SDO timeout",
            "SDO * timed out",
            "SDO request timeout",
            "mailbox timed out",
            "CoE timeout",
        ],
        &causes::MAILBOX_SILENT,
    ),
    introduction(
        &[
            "SDO abort",
            "abort code",
            "SDO error",
            "SDO write failed",
            "SDO read failed",
            "SDO transfer failed",
            "CoE abort",
        ],
        &causes::SDO_FAILED,
    ),
    line(&["ring is broken", "cable redundancy lost", "redundancy lost"], &causes::REDUNDANCY_USED),
    line(
        &[
            "operation not permitted * socket",
            "raw socket * permitted",
            "permission denied * interface",
        ],
        &causes::NO_SOCKET,
    ),
    line(
        &["EEPROM checksum", "EEPROM read failed", "SII checksum", "EEPROM checksum error"],
        &causes::EEPROM,
    ),
    line(&["emergency message", "emergency received", "EMCY"], &causes::EMERGENCY),
];
