//! TwinCAT: event log and state column, in English and in German.

use super::causes::{self, entry};
use super::{Entry, Line, Program, introduction, line};

pub(super) static PROGRAM: Program =
    Program { name: "TwinCAT (event log, Online tab)", lines: LINES };

/// The same texts where Windows or TwinCAT speaks German.
pub(super) static GERMAN: Program =
    Program { name: "TwinCAT and others in German", lines: IN_GERMAN };

static LINES: &[Line] = &[
    line(
        &[
            "DC out of sync",
            "DC not in sync",
            "Sync lost",
            "SyncUnit not synchronized",
            "DCs out of sync",
            "DC sync lost",
            "out of sync",
            "DevState 0x1000",
            "DevState = 0x1000",
        ],
        &causes::OUT_OF_STEP,
    ),
    line(&["INIT NO_COMM", "INIT NO COMM", "NO_COMM"], &causes::DEVICE_LOST),
    line(
        &[
            "SAFEOP ERR",
            "PREOP ERR",
            "INIT ERR",
            "OP ERR",
            "ERR SAFEOP",
            "ERR PREOP",
            "ERR INIT",
            "ERR OP",
        ],
        &causes::ERROR_BIT,
    ),
    line(
        &[
            "Frame missed",
            "Frames missed",
            "missed frame",
            "missing one frame",
            "Frame missed # times",
            "lost frames",
            "frames lost",
            "Tx/Rx errors",
            "frame returned too late",
            "frames not returned",
        ],
        &causes::NO_ANSWER,
    ),
    line(
        &[
            "CRC error counter",
            "CRC errors",
            "CRC error",
            "invalid frame counter",
            "rx error counter",
        ],
        &causes::CRC,
    ),
    line(
        &[
            "WcState = 1",
            "WcState 1",
            "WcState",
            "working counter error",
            "invalid working counter",
            "wrong working counter",
        ],
        &causes::LOW_WORKING_COUNTER,
    ),
    introduction(
        &[
            "state change aborted",
            "state change aborted requested * back to",
            "failed to switch to",
            "unexpected state",
            "abnormal state change from",
            "PREOP to SAFEOP failed",
            "SAFEOP to OP failed",
            "INIT to PREOP failed",
            "check device state for",
            "set device state to",
            "abnormal state change",
        ],
        &causes::STATE_REFUSED,
    ),
    line(
        &["state change timeout", "timeout * state", "INIT to PREOP failed timeout"],
        &causes::STATE_LATE,
    ),
    introduction(
        &[
            "Init Cmd failed: set DC cycle time",
            "InitCmd failed",
            "Init command failed",
            "init cmd * failed",
            "CoE InitDown",
            "initcmd",
        ],
        &causes::INIT_COMMAND,
    ),
    introduction(&["CoE ( SDO abort", "SDO Abort", "SDO transfer aborted"], &causes::SDO_FAILED),
    line(
        &["VPRS", "invalid VendorId", "invalid ProductCode", "wrong device", "invalid vendor"],
        &causes::WRONG_DEVICE,
    ),
    line(&["LNK_MIS", "LNK MIS", "link missing"], &LINK_AT_PORT),
    line(&["LNK_ADD", "LNK ADD", "additional link"], &LINK_AT_PORT),
    line(
        &[
            "communication interrupted",
            "communication lost",
            "communication re-established",
            "communication reestablished",
            "port A no communication",
            "no communication",
        ],
        &causes::DEVICE_LOST,
    ),
    line(&["link error", "Link broken", "link lost", "no link"], &LINK_AT_PORT),
    line(&["watchdog triggered", "Watchdog expired", "SM watchdog triggered"], &WATCHDOG),
    line(
        &[
            "Exceed counter",
            "Cycle ticks exceeded",
            "real-time violation",
            "cycle time exceeded",
            "task exceeded",
        ],
        &causes::HOST_LATE,
    ),
    line(&["Out of send resources"], &SEND_RESOURCES),
    line(
        &[
            "At least one device in SAFE-OP state",
            "At least one slave in SAFEOP",
            "At least one device indicates an error",
        ],
        &causes::NOT_ALL_IN_STATE,
    ),
    line(
        &["topology mismatch", "Wrong topology", "topology changed", "topology error"],
        &causes::TOPOLOGY,
    ),
    line(&["I/O reset required", "locked after link error"], &causes::LINK),
    line(&["Emergency Hex", "CoE emergency", "emergency request"], &causes::EMERGENCY),
    line(
        &["redundancy * line broken", "Link error redundancy adapter", "redundancy mode"],
        &causes::REDUNDANCY_USED,
    ),
];

static IN_GERMAN: &[Line] = &[
    line(
        &[
            "DC nicht synchron",
            "nicht synchron",
            "nicht synchronisiert",
            "Synchronisation verloren",
            "Synchronisierung verloren",
            "Synchronisationsverlust",
            "Synchronisation * verloren",
            "Synchronisierung * verloren",
            "Sync-Fehler",
            "Synchronfehler",
            "Sync verloren",
            "Synchronität verloren",
            "Synchronisationsfehler",
            "nicht mehr synchron",
            "außerhalb des Synchronisationsfensters",
            "Verteilte Uhren nicht synchronisiert",
        ],
        &causes::OUT_OF_STEP,
    ),
    line(
        &[
            "Kein Kontakt",
            "keine Kommunikation",
            "Kommunikation unterbrochen",
            "Kommunikation verloren",
            "Kommunikation abgebrochen",
            "Teilnehmer antwortet nicht",
            "Verbindung zum Slave",
            "Verbindung zum Teilnehmer",
            "Verbindung zu * verloren",
            "Verbindung zu * unterbrochen",
            "antwortet nicht",
            "nicht erreichbar",
            "Slave verloren",
            "Gerät verloren",
            "Teilnehmer fehlt",
            "Kommunikationsausfall",
        ],
        &causes::DEVICE_LOST,
    ),
    line(
        &[
            "Verbindung verloren",
            "Verbindung unterbrochen",
            "Verbindungsverlust",
            "keine Verbindung",
            "Linkfehler",
            "Link verloren",
            "Verbindung getrennt",
        ],
        &LINK_AT_PORT,
    ),
    line(
        &[
            "Frame verloren",
            "Frame * verloren",
            "Frames verloren",
            "Frameverlust",
            "Frame fehlt",
            "Telegramm verloren",
            "Telegrammverlust",
            "Telegramm fehlt",
            "verlorene Frames",
            "fehlende Frames",
            "Paketverlust",
        ],
        &causes::NO_ANSWER,
    ),
    line(
        &[
            "Working Counter falsch",
            "falscher Working Counter",
            "Working Counter Fehler",
            "Working Counter ungültig",
            "ungültiger Working Counter",
            "Arbeitszähler falsch",
            "falscher Arbeitszähler",
            "Arbeitszähler * falsch",
            "Working Counter * falsch",
            "Working Counter nicht gültig",
            "Arbeitszähler Fehler",
        ],
        &causes::LOW_WORKING_COUNTER,
    ),
    line(&["CRC Fehlerzähler", "CRC Fehler", "CRC-Fehlerzähler", "Prüfsummenfehler"], &causes::CRC),
    introduction(
        &[
            "Zustandswechsel fehlgeschlagen",
            "Zustandswechsel abgebrochen",
            "Zustandswechsel abgelehnt",
            "Statuswechsel fehlgeschlagen",
            "Statuswechsel abgebrochen",
            "Zustandsübergang fehlgeschlagen",
            "Zustandswechsel * fehlgeschlagen",
            "Zustandswechsel * abgebrochen",
            "Statuswechsel * fehlgeschlagen",
            "unerwarteter Zustand",
            "ungültiger Zustand",
        ],
        &causes::STATE_REFUSED,
    ),
    line(
        &[
            "Zeitüberschreitung * Zustand",
            "Timeout beim Zustandswechsel",
            "Zustandswechsel Timeout",
            "Zeitüberschreitung beim Zustandswechsel",
        ],
        &causes::STATE_LATE,
    ),
    introduction(
        &[
            "Initialisierungskommando fehlgeschlagen",
            "InitCmd fehlgeschlagen",
            "Init-Kommando fehlgeschlagen",
            "Init Kommando * fehlgeschlagen",
        ],
        &causes::INIT_COMMAND,
    ),
    introduction(
        &[
            "wechselt * in SAFEOP",
            "fällt * in SAFEOP",
            "SAFEOP Fehler",
            "SAFEOP mit Fehler",
            "in SAFEOP gewechselt",
        ],
        &causes::ERROR_BIT,
    ),
    line(&["Zeitüberschreitung", "Zeitlimit überschritten"], &causes::NO_ANSWER),
    introduction(
        &["SDO Abbruch", "SDO-Zugriff fehlgeschlagen", "SDO abgebrochen"],
        &causes::SDO_FAILED,
    ),
    line(
        &["Mailbox Zeitüberschreitung", "Mailbox Timeout", "keine Mailbox-Antwort"],
        &causes::MAILBOX_SILENT,
    ),
    line(
        &[
            "falsches Gerät",
            "falsche Klemme",
            "falscher Teilnehmer",
            "Gerät stimmt nicht",
            "falsche Revision",
        ],
        &causes::WRONG_DEVICE,
    ),
    line(
        &[
            "falsche Topologie",
            "Topologiefehler",
            "Topologie stimmt nicht",
            "Anzahl der Slaves stimmt nicht",
            "Anzahl der Teilnehmer",
        ],
        &causes::TOPOLOGY,
    ),
    line(&["Watchdog abgelaufen", "Watchdog ausgelöst", "Watchdog hat ausgelöst"], &WATCHDOG),
    line(
        &[
            "Zykluszeit überschritten",
            "Zykluszeitüberschreitung",
            "Echtzeitverletzung",
            "Task überschreitet",
        ],
        &causes::HOST_LATE,
    ),
    line(
        &["keine Slaves gefunden", "keine Teilnehmer gefunden", "kein Slave gefunden"],
        &causes::NO_DEVICES,
    ),
    line(
        &["Ring offen", "Ring unterbrochen", "Redundanz verloren", "Leitungsbruch", "Kabelbruch"],
        &causes::REDUNDANCY_USED,
    ),
    line(
        &[
            "nicht alle Slaves",
            "nicht alle Teilnehmer",
            "nicht im Zustand OP",
            "nicht im Zustand",
            "nicht in OP",
        ],
        &causes::NOT_ALL_IN_STATE,
    ),
];

static LINK_AT_PORT: Entry = entry(
    "A port of a device has no link where one is configured, or a link where none is. LNK_MIS: a \
         cable is missing; LNK_ADD: something is plugged in that is not configured.",
    &[
        "a cable is not plugged, broken, or in another port",
        "the next device has no power",
        "a device more than in the configuration",
    ],
    &["0x0110: links and loops of each port", "0x0310 to 0x0313: lost links"],
    &["cables and power behind this port, or the configuration of the topology"],
);

static WATCHDOG: Entry = entry(
    "The watchdog of process data expired: no outputs arrived within its time, so the device made \
         its outputs safe. AL status code 0x001B goes with it.",
    &[
        "the cyclic task stood still: a breakpoint, a stopped program, an overload",
        "frames were lost in a row",
        "the watchdog time is shorter than what the cycle allows",
    ],
    &[
        "0x0400 and 0x0420: the watchdog time",
        "0x0134",
        "lost frames and exceeded cycles of the host",
    ],
    &["send outputs in each cycle; a watchdog of several cycles"],
);

static SEND_RESOURCES: Entry = entry(
    "The host's network driver had no room for a further frame: frames of earlier cycles were not \
         sent or did not come back yet.",
    &[
        "no link: frames wait in the card",
        "more frames in a cycle than fit into it",
        "the card's driver is not one for real time",
    ],
    &[
        "link and speed of the card: 100 Mbit/s full duplex",
        "`isocat plan`: how long the frames of a cycle are",
    ],
    &["the link, the driver for real time, fewer frames or a longer cycle"],
);
