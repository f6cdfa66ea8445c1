//! Drivers for ROS 2, and libraries of robots: ethercat_driver_ros2, jsd, ethercat_sdk.

use super::causes;
use super::{Line, Program, line};

pub(super) static PROGRAM: Program =
    Program { name: "ROS 2 drivers and robot libraries", lines: LINES };

static LINES: &[Line] = &[
    line(
        &["Activate EcMaster failed", "EcMaster failed", "Failed to activate EcMaster"],
        &causes::BUSY_MASTER,
    ),
    line(
        &["Master AL states: #", "Slave: State #", "Slave: not operational"],
        &causes::NOT_ALL_IN_STATE,
    ),
    line(&["Slave: offline", "Slave: not online"], &causes::DEVICE_LOST),
    line(&["Domain: WC #", "Domain: State #"], &causes::COUNTER_CHANGES),
    line(&["Link is down"], &causes::LINK),
    line(
        &["Failed to download config SDO for module", "Failed to download config SDO"],
        &causes::SDO_FAILED,
    ),
    line(
        &[
            "WARNING. Master. slave config",
            "failed to get slave configuration",
            "Failed to get slave config",
        ],
        &causes::CONFIGURATION,
    ),
    line(
        &[
            "Failed to register PDO entry",
            "PDO entry registration failed",
            "WARNING. Failed to register",
        ],
        &causes::CONFIGURATION,
    ),
    line(
        &["Overrun detected", "control loop missed", "update rate not met", "Overrun might occur"],
        &causes::HOST_LATE,
    ),
    line(
        &[
            "working counter mismatch got # expected #",
            "MASTER_RECV_PD_GROUP * working counter mismatch",
            "working counter mismatch",
        ],
        &causes::LOW_WORKING_COUNTER,
    ),
    line(
        &[
            "Bad working counter",
            "Working counter is too low",
            "bus is not ok",
            "Working counter lower than expected",
        ],
        &causes::LOW_WORKING_COUNTER,
    ),
    line(
        &["has not reached OP", "did not reach OP", "did not reach operational"],
        &causes::NOT_ALL_IN_STATE,
    ),
];
