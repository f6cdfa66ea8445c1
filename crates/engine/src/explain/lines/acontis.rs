//! acontis EC-Master: its log and notifications.

use super::causes::{self, entry};
use super::{Entry, Line, Program, introduction, line};

pub(super) static PROGRAM: Program = Program { name: "acontis EC-Master", lines: LINES };

static LINES: &[Line] = &[
    line(
        &[
            "0x981201C2",
            "DCM_E_MAX_CTL_ERROR_EXCEED",
            "controller error synchronization out of limit",
            "DCM out of limit",
            "synchronization out of limit",
            "DcmInSync = 0",
            "DCM not in sync",
            "DCM sync error",
            "EC_NOTIFY_DCM_SYNC",
            "dcmGetStatus",
            "DCM Status: ERROR",
        ],
        &causes::OUT_OF_STEP,
    ),
    line(&["DcmInSync = 1", "DcmInSync true", "DCM in sync", "DcmInSync"], &DCM),
    line(&["0x981201C1", "DCM_E_NOTINITIALIZED", "0x981201C0"], &DCM),
    line(
        &[
            "0x981201C5",
            "0x981201C6",
            "0x981201C7",
            "DCM_E_TIMER_MODIFY_ERROR",
            "DCM_E_INVALID_HWLAYER",
            "0x981201C4",
        ],
        &DCM_TIMER,
    ),
    line(
        &[
            "EC_NOTIFY_DC_SLV_SYNC",
            "DC slave not in sync",
            "slaves not in sync",
            "DC slaves out of sync",
        ],
        &causes::CLOCK_NOT_SETTLED,
    ),
    line(&["EC_E_TIMEOUT", "0x98110010"], &causes::STATE_LATE),
    line(
        &[
            "No response on cyclic Ethernet frame",
            "EC_NOTIFY_FRAME_RESPONSE_ERROR",
            "EC_E_FRAME_LOST",
            "Frame lost, IDX mismatch",
            "0x98110025",
            "frame loss",
            "not all previously sent frames are received/processed",
        ],
        &causes::NO_ANSWER,
    ),
    line(
        &[
            "EC_E_CYCCMD_WKC_ERROR",
            "Cyclic command WKC error",
            "EC_NOTIFY_CYCCMD_WKC_ERROR",
            "0x98110027",
        ],
        &causes::LOW_WORKING_COUNTER,
    ),
    line(
        &[
            "EC_E_BUSCONFIG_MISMATCH",
            "Bus configuration mismatch",
            "EC_NOTIFY_SB_MISMATCH",
            "0x9811001E",
        ],
        &causes::TOPOLOGY,
    ),
    line(
        &[
            "EC_E_LINK_DISCONNECTED",
            "Ethernet link cable disconnected",
            "0x9811002D",
            "EC_NOTIFY_ETH_LINK_NOT_CONNECTED",
        ],
        &causes::LINK,
    ),
    line(
        &[
            "EC_E_SLAVE_NOT_ADDRESSABLE",
            "Station address lost or slave missing",
            "0x9811002B",
            "EC_NOTIFY_SLAVE_PRESENCE",
            "EC_NOTIFY_SLAVE_DISAPPEARS",
            "slave * disappeared",
        ],
        &causes::DEVICE_LOST,
    ),
    line(&["EC_NOTIFY_SLAVE_APPEARS"], &causes::DEVICE_BACK),
    introduction(
        &[
            "EC_NOTIFY_SLAVE_ERROR_STATUS_INFO",
            "EC_NOTIFY_SLAVE_UNEXPECTED_STATE",
            "Slave error status",
        ],
        &causes::ERROR_BIT,
    ),
    line(
        &[
            "EC_NOTIFY_NOT_ALL_DEVICES_OPERATIONAL",
            "Not all devices operational",
            "At least one slave not operational",
        ],
        &causes::NOT_ALL_IN_STATE,
    ),
    line(
        &[
            "EC_NOTIFY_SLAVE_INITCMD_RESPONSE_ERROR",
            "EC_NOTIFY_SLAVE_INITCMD_WKC_ERROR",
            "INITCMD response error",
        ],
        &causes::INIT_COMMAND,
    ),
    line(&["EC_E_CYC_CMDS_OVERFLOW", "0x9811002C"], &causes::CAPACITY),
    line(&["EC_NOTIFY_LINE_CROSSED", "Line crossed"], &causes::TOPOLOGY),
    line(
        &["EC_NOTIFY_JUNCTION_RED_CHANGE", "EC_NOTIFY_RED_LINEBRK", "Redundancy line break"],
        &causes::REDUNDANCY_USED,
    ),
];

static DCM: Entry = entry(
    "DCM steers the host's cycle and the reference clock towards each other. In sync means that \
         the distance between the cycle and SYNC0 has stayed within its limit for the settling \
         time.",
    &[
        "not yet in sync after start: the loop settles, some seconds at most",
        "not initialized: DC or DCM was not configured before the cycle began",
    ],
    &["the distance that DCM reports, over time", "0x092C of each device"],
    &["wait for it before OP is asked for; configure DC and DCM before the first cycle"],
);

static DCM_TIMER: Entry = entry(
    "DCM cannot change the timer of the host, so that the host's cycle cannot follow the reference \
         clock.",
    &[
        "no adjustable timer on this system",
        "the call comes from another processor than the timer's",
    ],
    &["the mode of DCM: bus shift moves the device clocks, master shift the host"],
    &["bus shift, where the host's timer is fixed; one host clock leads then, with its jitter"],
);
