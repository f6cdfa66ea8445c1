//! LinuxCNC and its driver lcec (linuxcnc-ethercat).

use super::causes::{self, entry};
use super::{Entry, Line, Program, introduction, line};

pub(super) static PROGRAM: Program = Program { name: "LinuxCNC and lcec", lines: LINES };

static LINES: &[Line] = &[
    line(
        &[
            "Unexpected realtime delay on task # with period #",
            "Unexpected realtime delay on task",
            "Unexpected realtime delay",
            "realtime delay",
        ],
        &causes::HOST_LATE,
    ),
    line(
        &["unable to sync master # cycle to reference clock", "RTAPI_TASK_PLL_SUPPORT not present"],
        &NO_TASK_PLL,
    ),
    line(
        &["Phase calibration complete: jitter=# target=#", "phase-jitter", "Phase calibration"],
        &PHASE_CALIBRATION,
    ),
    line(
        &[
            "Invalid appTimePeriod of",
            "is not a positive multiple of appTimePeriod",
            "syncUnit # cycle mismatch",
            "cycle mismatch",
        ],
        &causes::PHASE,
    ),
    line(&["pll-err", "pll-out", "pll-reset-cnt"], &PLL_PINS),
    line(
        &["failed to activate master", "requesting master # failed", "failure activating master"],
        &causes::BUSY_MASTER,
    ),
    introduction(
        &[
            "failed to configure slave # sdo #",
            "failed to configure slave # # sdo",
            "sdo write of # rejected by slave",
            "fail to configure slave",
        ],
        &causes::SDO_FAILED,
    ),
    line(
        &[
            "fail to read slave # configuration",
            "fail to read configuration",
            "PDO entry registration failed",
            "failure to append PDO entries",
            "domain creation failed",
            "PDO entries, vs a configured limit",
        ],
        &causes::CONFIGURATION,
    ),
    line(&["slave-online", "slave * online state", "slave online FALSE"], &ONLINE),
    line(&["slave-oper", "slave-state-op", "all-op", "slave operational FALSE"], &ONLINE),
    line(&["slaves-responding", "link-up FALSE"], &causes::SCAN_AGAIN),
    line(&["joint # following error", "following error"], &FOLLOWING),
    line(
        &["Activating master", "Master # activated successfully", "Initial app_time set"],
        &causes::NOTICE,
    ),
    line(&["Double dc config for slave"], &causes::CONFIGURATION),
];

static NO_TASK_PLL: Entry = entry(
    "This build of LinuxCNC cannot shift its realtime task, so the host cannot follow the \
         reference clock: frames slide through the cycle of SYNC0.",
    &["a LinuxCNC without the task PLL", "refClockSyncCycles below 0 asks for it"],
    &["`pll-err` of lcec over time", "0x1C32:0B: whether it grows steadily"],
    &[
        "a LinuxCNC with the task PLL",
        "or let the host lead: refClockSyncCycles of 1 or more, with the host's jitter",
    ],
);

static PHASE_CALIBRATION: Entry = entry(
    "lcec measured how the phase of the task lies against the reference clock, and its jitter; it \
         steers to this target.",
    &[
        "a large jitter: the machine is late at times",
        "nothing is wrong with a small one: it is a notice",
    ],
    &["the latency of the machine", "0x1C32:0B of the drives"],
    &["less latency; sync0Shift so that frame and SYNC0 stay apart by more than the jitter"],
);

static PLL_PINS: Entry = entry(
    "How far the realtime task of the host is from the reference clock (ns), and by how much it is \
         corrected. Near 0 and steady: the host follows. Growing or jumping: it does not.",
    &[
        "no task PLL, or sync to reference clock not configured",
        "latency of the machine",
        "the reference clock is lost: its device is not in OP",
    ],
    &["pll-err over some seconds", "0x092C of each device"],
    &["refClockSyncCycles and sync0Shift of the master; less latency"],
);

static ONLINE: Entry = entry(
    "Pins that tell of each device whether it answers (online), and whether it reached OP with its \
         configuration (oper, state-op).",
    &[
        "not online: no power, no link, or frames are lost",
        "online and not in OP: it refused a state, or left OP; its AL status code says why",
    ],
    &["`ethercat slaves -v` and the kernel log: AL status message", "0x0130 and 0x0134"],
    &["power and cable, or the cause that the code names"],
);

static FOLLOWING: Entry = entry(
    "A joint is not where it was told to be: set points act late or unevenly, or the drive cannot \
         follow.",
    &[
        "set points do not come evenly with SYNC0: the host is not locked onto the reference clock",
        "outputs act a cycle late, or cycles are lost",
        "the interpolation time (0x60C2) is not the cycle",
        "the drive's own limits and tuning, or a wrong scale",
    ],
    &["0x60C2:01 and :02", "0x1C32:0B, 0x092C", "`isocat diagnose` of a capture"],
    &[
        "let the host follow the reference clock; 0x60C2 = cycle; SYNC0 behind the frame",
        "then tuning, and the limit of the error",
    ],
);
