//! The stages of bring-up and shutdown.

use core::fmt;

/// The stages of bring-up and shutdown, in their order.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum Stage {
    /// Reset, count, addresses, topology.
    Scan,
    /// SII of all SubDevices.
    Sii,
    /// Mailboxes, PREOP.
    PreOp,
    /// Object dictionary: assignment, mapping, 0x1C32 and 0x1C33.
    Objects,
    /// Mode of each SubDevice.
    Mode,
    /// SyncManagers, FMMUs, process image.
    Mapping,
    /// Delays, offsets, drift.
    Clock,
    /// Budget of one cycle.
    Plan,
    /// Locking the host's clock onto the reference clock.
    Phase,
    /// SYNC units programmed, 0x1C32:01 and 0x1C33:01 written.
    Sync,
    /// SAFEOP.
    SafeOp,
    /// Process data complete, SYNC running, OP.
    Op,
    /// Back to INIT.
    Stop,
}

impl Stage {
    /// All stages, in their order.
    pub const ALL: [Self; 13] = [
        Self::Scan,
        Self::Sii,
        Self::PreOp,
        Self::Objects,
        Self::Mode,
        Self::Mapping,
        Self::Clock,
        Self::Plan,
        Self::Phase,
        Self::Sync,
        Self::SafeOp,
        Self::Op,
        Self::Stop,
    ];

    /// Name in messages.
    pub const fn name(self) -> &'static str {
        match self {
            Stage::Scan => "scan",
            Stage::Sii => "SII",
            Stage::PreOp => "PREOP",
            Stage::Objects => "objects",
            Stage::Mode => "mode",
            Stage::Mapping => "mapping",
            Stage::Clock => "clock",
            Stage::Plan => "plan",
            Stage::Phase => "phase",
            Stage::Sync => "SYNC",
            Stage::SafeOp => "SAFEOP",
            Stage::Op => "OP",
            Stage::Stop => "stop",
        }
    }
}

impl fmt::Display for Stage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}
