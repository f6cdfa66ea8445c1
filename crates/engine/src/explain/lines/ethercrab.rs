//! ethercrab: its errors, as `Debug` and as `Display` print them, and its log.

use super::causes::{self, entry};
use super::{Entry, Line, Program, introduction, line};

pub(super) static PROGRAM: Program = Program { name: "ethercrab", lines: LINES };

static LINES: &[Line] = &[
    line(
        &[
            "WorkingCounter { expected: #, received: # }",
            "working counter expected # got #",
            "working counter expected # received #",
        ],
        &causes::LOW_WORKING_COUNTER,
    ),
    line(
        &["Timeout(Pdu)", "timeout: PDU", "Timeout Pdu", "PDU timeout", "Error: Timeout"],
        &causes::NO_ANSWER,
    ),
    line(&["Timeout(StateTransition)", "timeout: state transition"], &causes::STATE_LATE),
    line(
        &[
            "Timeout(MailboxResponse)",
            "timeout: mailbox response",
            "Timeout(MailboxEcho)",
            "timeout: mailbox echo",
            "Mailbox IN ready error for",
            "Response mailbox IN error for",
        ],
        &causes::MAILBOX_SILENT,
    ),
    line(
        &[
            "Timeout(Eeprom)",
            "timeout: EEPROM",
            "Could not find EEPROM category",
            "EEPROM could be empty or corrupt",
        ],
        &causes::EEPROM,
    ),
    line(
        &["Eeprom(Decode)", "Eeprom(NoCategory)", "Eeprom(SectionOverrun)", "Eeprom(ClearErrors)"],
        &causes::EEPROM,
    ),
    introduction(
        &[
            "Mailbox(Aborted { code: #",
            "Mailbox Aborted",
            "CoeAbortCode",
            "Mailbox error for SubDevice #",
        ],
        &causes::SDO_FAILED,
    ),
    line(
        &[
            "Mailbox(NoReadMailbox)",
            "Mailbox(NoWriteMailbox)",
            "device has no read mailbox",
            "device has no write",
        ],
        &causes::NOT_SUPPORTED,
    ),
    line(
        &[
            "Mailbox(SdoResponseInvalid",
            "Mailbox(InvalidCount)",
            "incorrect mailbox count value",
            "Mailbox(TooLong",
            "Invalid SDO response",
            "invalid response from device",
        ],
        &causes::MAILBOX_BROKEN,
    ),
    line(
        &["Mailbox(Emergency", "Mailbox emergency code #", "emergency: code #"],
        &causes::EMERGENCY,
    ),
    line(
        &[
            "a SubDevice failed to transition to a new state",
            "Error: StateTransition",
            "Err(StateTransition",
            "Err value: StateTransition",
            "Error occurred transitioning",
        ],
        &causes::STATE_REFUSED,
    ),
    introduction(&["SubDevice # status code #", "subdevice error: #"], &causes::STATE_REFUSED),
    line(
        &[
            "InvalidState { expected",
            "is in invalid state * Expected",
            "state is invalid * expected",
        ],
        &OTHER_STATE,
    ),
    line(
        &[
            "NotFound { item: SubDevice",
            "SubDevice not found",
            "item kind SubDevice not found",
            "UnknownSubDevice",
            "unknown SubDevice",
        ],
        &causes::TOPOLOGY,
    ),
    line(
        &[
            "NotFound { item: Pdo",
            "NotFound { item: Fmmu",
            "NotFound { item: SyncManager",
            "item kind Pdo not found",
        ],
        &causes::CONFIGURATION,
    ),
    line(&["No SubDevices were discovered"], &causes::NO_DEVICES),
    line(
        &[
            "DistributedClock(NoReference)",
            "No DC reference SubDevice found",
            "No DC reference clock SubDevice present",
        ],
        &causes::NO_REFERENCE,
    ),
    line(
        &[
            "PdiTooLong",
            "Process Data Image is too long",
            "Error: Capacity",
            "Err(Capacity",
            "Err value: Capacity",
            "not enough capacity for",
            "No available frames in",
            "Not enough send slots available",
        ],
        &causes::CAPACITY,
    ),
    line(
        &[
            "Error: Topology",
            "Err(Topology",
            "Err value: Topology",
            "Did not find parent for SubDevice",
            "Did not find fork parent",
        ],
        &causes::TOPOLOGY,
    ),
    line(
        &[
            "Error: SendFrame",
            "Err(SendFrame",
            "Err value: SendFrame",
            "failed to send EtherCAT frame",
            "PartialSend",
            "Error: ReceiveFrame",
            "Err(ReceiveFrame",
            "Err value: ReceiveFrame",
            "failed to receive an EtherCAT frame",
            "Packet receive failed",
            "Could not find interface",
        ],
        &causes::NO_SOCKET,
    ),
    line(
        &[
            "Pdu(Validation",
            "received PDU validation failed",
            "Pdu(InvalidFrameState)",
            "Pdu(InvalidIndex",
            "invalid PDU index",
            "Failed to claim receiving frame",
        ],
        &causes::LATE_ANSWER,
    ),
    line(
        &[
            "Pdu(Decode)",
            "Failed to parse frame header",
            "Received frame is too short",
            "Pdu(Ethernet)",
        ],
        &causes::CORRUPTED,
    ),
    line(&["Pdu(SwapState)", "Pdu(CreateFrame)", "failed to swap frame state"], &causes::CAPACITY),
    line(&["Pdu(TooLong)", "data is too long to fit in given buffer"], &causes::CAPACITY),
    line(
        &["Error: Wire", "Err(Wire", "Err value: Wire", "wire encode/decode error"],
        &causes::MAILBOX_BROKEN,
    ),
];

static OTHER_STATE: Entry = entry(
    "A device is in another state than the program expects: it left the state by itself, or never \
         reached it.",
    &[
        "it left OP: lost synchronization, expired watchdog, lost power",
        "it refused the step before it",
        "another program asked for a state",
    ],
    &["0x0130 and 0x0134 of the device: state and AL status code"],
    &["remove the cause that the code names, acknowledge, then ask for the state again"],
);
