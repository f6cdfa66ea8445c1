//! The synchronization modes as data: which bits announce each, how it is set up, and what it reads
//! back.

use isocat_sync::SyncMode;

/// One way to synchronize a SubDevice.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Mode {
    /// The mode.
    pub mode: SyncMode,
    /// The bit of 0x1C32:04 and 0x1C33:04 that belongs to this mode alone.
    pub bit: u8,
    /// All bits of 0x1C32:04 and 0x1C33:04 that it needs.
    pub needs: u16,
    /// Value of 0x1C32:01.
    pub output_type: u16,
    /// Value of 0x1C33:01, if outputs are transmitted.
    pub input_type: u16,
    /// Value of 0x1C33:01, if no outputs are transmitted.
    pub input_only_type: u16,
    /// Value of register 0x0981; 0 for a mode without the SYNC unit.
    pub activation: u8,
    /// Why the suite does not try it; `None`: it does.
    pub untried: Option<&'static str>,
}

impl Mode {
    /// Its name in reports and segment files.
    pub const fn name(&self) -> &'static str {
        self.mode.name()
    }

    /// Whether the mode uses SYNC0.
    pub const fn uses_dc(&self) -> bool {
        self.activation != 0
    }

    /// Whether SM2 starts the work and SYNC0 alone lets outputs act.
    pub const fn is_sync0(&self) -> bool {
        self.activation == 0x03
    }

    /// SYNC0 cycles in one bus cycle.
    pub const fn subordinated_cycles(&self) -> u32 {
        if self.bit == 4 { 2 } else { 1 }
    }

    /// Values of registers 0x09A0 and 0x09A4 for a bus cycle of `cycle` ns. SYNC1 is in the middle,
    /// or at the last SYNC0 of a bus cycle.
    pub const fn pulses(&self, cycle: u32) -> (u32, u32) {
        match (self.activation, self.bit) {
            (0x07, 4) => (cycle / 2, cycle / 2),
            (0x07, _) => (cycle, cycle / 2),
            _ => (cycle, 0),
        }
    }
}

/// All modes, least synchronized first.
pub const MODES: [Mode; 6] = [
    Mode {
        mode: SyncMode::FreeRun,
        bit: 0,
        needs: 0x01,
        output_type: 0,
        input_type: 0,
        input_only_type: 0,
        activation: 0,
        untried: None,
    },
    Mode {
        mode: SyncMode::SmSynchronous,
        bit: 1,
        needs: 0x02,
        output_type: 1,
        input_type: 0x22,
        input_only_type: 1,
        activation: 0,
        untried: None,
    },
    Mode {
        mode: SyncMode::DcSync0,
        bit: 2,
        needs: 0x04,
        output_type: 2,
        input_type: 2,
        input_only_type: 2,
        activation: 0x03,
        untried: None,
    },
    Mode {
        mode: SyncMode::DcShiftSync1,
        bit: 3,
        needs: 0x0C,
        output_type: 2,
        input_type: 3,
        input_only_type: 3,
        activation: 0x07,
        untried: None,
    },
    Mode {
        mode: SyncMode::DcSync1,
        bit: 3,
        needs: 0x08,
        output_type: 3,
        input_type: 3,
        input_only_type: 3,
        activation: 0x07,
        untried: None,
    },
    Mode {
        mode: SyncMode::DcSubordinated,
        bit: 4,
        needs: 0x18,
        output_type: 3,
        input_type: 3,
        input_only_type: 3,
        activation: 0x07,
        untried: None,
    },
];
