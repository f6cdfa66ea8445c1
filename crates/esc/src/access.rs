//! Which registers an ESC has, and who may write them.
//!
//! Each table lists runs of registers in the order of their addresses. Every byte of a run can be
//! read; its reserved bytes read 0. A byte outside all runs does not exist: no access to it
//! succeeds. A [`Gate`] names what depends on the state of the chip.

use isocat_wire::register::{CHIP_SPECIFIC, features};

use crate::chip::{Chip, DcUnits, MiiManagement};

/// Which units this ESC has once its EEPROM is loaded.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Units {
    fmmu_end: u16,
    sm_end: u16,
    receive_times: bool,
    /// The system time unit, registers 0x0910-0x0935.
    pub system_time: bool,
    /// The SYNC unit.
    pub sync: bool,
    /// The latch unit.
    pub latch: bool,
    /// The PDI, not ECAT, writes the system time unit.
    time_by_pdi: bool,
    /// Register 0x0936 exists.
    latch_mode: bool,
    enhanced: bool,
    wide: bool,
    /// Register 0x0108 exists.
    pub physical_offset: bool,
    /// Registers 0x0138 and 0x0139 exist.
    pub led_override: bool,
    mii_end: u16,
    specific_end: u16,
}

impl Units {
    /// The units of `chip`, with register 0x0141 as loaded from the EEPROM.
    pub fn new(chip: &Chip, esc_configuration: u8) -> Self {
        let dc = chip.has(features::DC);
        let on = |bit: u8| match chip.dc_units {
            DcUnits::Always => dc,
            DcUnits::ByEeprom => dc && esc_configuration & bit != 0,
        };
        let (sync, latch) = (on(0x04), on(0x08));
        Self {
            fmmu_end: 0x0600 + 16 * u16::from(chip.fmmu_count.min(16)),
            sm_end: 0x0800 + 8 * u16::from(chip.sm_count.min(16)),
            receive_times: dc,
            system_time: sync || latch,
            sync,
            latch,
            time_by_pdi: chip.system_time_by_pdi,
            latch_mode: (sync || latch) && chip.receive_time_latch_mode,
            enhanced: chip.has(features::ENHANCED_SYNC_ACTIVATION),
            wide: chip.counts_64_bit(),
            physical_offset: chip.physical_offset,
            led_override: chip.led_override,
            mii_end: match chip.mii {
                MiiManagement::None => 0x0510,
                MiiManagement::Ecat => 0x0516,
                MiiManagement::Shared => 0x051C,
            },
            specific_end: CHIP_SPECIFIC + chip.chip_specific.len().min(256) as u16,
        }
    }

    /// Whether ECAT writes the lower four bytes of the system time.
    pub const fn takes_time(&self) -> bool {
        self.system_time && !self.time_by_pdi
    }

    /// Whether ECAT writes all eight bytes of the system time.
    pub const fn takes_wide_time(&self) -> bool {
        self.takes_time() && self.wide
    }

    /// Finds the run that holds `address`, or else the next one. Returns the end of that run, and
    /// its gate if `address` is in it.
    pub fn run(&self, table: &'static Table, address: u16) -> (u16, Option<Gate>) {
        let Table { runs: table, pages } = table;
        // A page of 256 registers has few runs, so the search begins at its first one.
        let first = pages[usize::from(address >> 8) & 15];
        let passed = table.get(usize::from(first)..).unwrap_or(&[]);
        let at = usize::from(first) + passed.iter().take_while(|run| run.end <= address).count();
        let Some(run) = table.get(at) else { return (0x1000, None) };
        if address < run.start {
            return (run.start, None);
        }
        let (present, end) = match run.unit {
            Unit::Always => (true, run.end),
            Unit::Fmmu => (address < self.fmmu_end, run.end.min(self.fmmu_end)),
            Unit::Sm => (address < self.sm_end, run.end.min(self.sm_end)),
            Unit::ReceiveTimes => (self.receive_times, run.end),
            Unit::SystemTime => (self.system_time, run.end),
            Unit::EcatTime => (self.system_time && !self.time_by_pdi, run.end),
            Unit::WideEcatTime => (self.system_time && !self.time_by_pdi && self.wide, run.end),
            Unit::PdiTime => (self.system_time && self.time_by_pdi, run.end),
            Unit::WidePdiTime => (self.system_time && self.time_by_pdi && self.wide, run.end),
            Unit::Sync => (self.sync, run.end),
            Unit::WideSync => (self.sync && self.wide, run.end),
            Unit::EnhancedSync => (self.sync && self.enhanced, run.end),
            Unit::Latch => (self.latch, run.end),
            Unit::LatchMode => (self.latch_mode, run.end),
            Unit::PhysicalOffset => (self.physical_offset, run.end),
            Unit::LedOverride => (self.led_override, run.end),
            Unit::Mii => (address < self.mii_end, run.end.min(self.mii_end)),
            Unit::Specific => (address < self.specific_end, run.end.min(self.specific_end)),
        };
        if present { (end, Some(run.gate)) } else { (run.end, None) }
    }
}

/// Runs in the order of their addresses. For each page of 256 registers the table also keeps the
/// first run that ends in the page or behind it.
pub(crate) struct Table {
    runs: &'static [Run],
    pages: [u8; 16],
}

impl Table {
    const fn new(runs: &'static [Run]) -> Self {
        let mut pages = [0; 16];
        let mut page = 0;
        while page < 16 {
            let mut at = 0;
            while at < runs.len() && runs[at].end <= (page as u16) << 8 {
                at += 1;
            }
            pages[page] = at as u8;
            page += 1;
        }
        Self { runs, pages }
    }

    /// The first address and the end of all runs, including those that a chip may lack.
    #[cfg(test)]
    pub fn runs(&self) -> impl Iterator<Item = (u16, u16)> {
        self.runs.iter().map(|run| (run.start, run.end))
    }
}

/// A run of registers.
pub(crate) struct Run {
    start: u16,
    end: u16,
    unit: Unit,
    gate: Gate,
}

/// The unit that must exist for a run to exist.
#[derive(Clone, Copy)]
enum Unit {
    Always,
    Fmmu,
    Sm,
    ReceiveTimes,
    SystemTime,
    EcatTime,
    WideEcatTime,
    PdiTime,
    WidePdiTime,
    Sync,
    WideSync,
    EnhancedSync,
    Latch,
    LatchMode,
    PhysicalOffset,
    LedOverride,
    Mii,
    Specific,
}

/// The condition under which a write is accepted.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Gate {
    /// No condition.
    Open,
    /// AL control: the PDI has read the last request, or the ESC emulates the device.
    AlControl,
    /// AL status: writable unless the ESC emulates the device.
    AlStatus,
    /// The EEPROM interface: writable by its owner while it is not busy.
    Eeprom,
    /// The PDI takes or gives back the EEPROM.
    EepromTake,
    /// A byte of a SyncManager: its configuration while it is disabled, activate, or PDI control.
    SyncManager,
    /// Writable by the owner of the SYNC unit.
    SyncOwner,
    /// Writable by the owner of the SYNC unit while the unit is inactive.
    SyncStart,
    /// Writable by the owner of the latch unit.
    Latch,
    /// MII management: writable by its owner while it is not busy.
    Mii,
    /// ECAT takes MII management, or takes it back from the PDI.
    MiiTake,
}

const fn run(start: u16, end: u16, unit: Unit, gate: Gate) -> Run {
    Run { start, end, unit, gate }
}

/// The registers that both sides can read. A run ends where its registers end in memory, too:
/// FMMUs, SyncManagers and chip-specific registers lie there as chips have them.
pub(crate) static READABLE: Table = Table::new(&[
    run(0x0000, 0x0014, Unit::Always, Gate::Open),
    run(0x0020, 0x0022, Unit::Always, Gate::Open),
    run(0x0030, 0x0032, Unit::Always, Gate::Open),
    run(0x0040, 0x0042, Unit::Always, Gate::Open),
    run(0x0100, 0x0104, Unit::Always, Gate::Open),
    run(0x0108, 0x010A, Unit::PhysicalOffset, Gate::Open),
    run(0x0110, 0x0112, Unit::Always, Gate::Open),
    run(0x0120, 0x0122, Unit::Always, Gate::Open),
    run(0x0130, 0x0136, Unit::Always, Gate::Open),
    run(0x0138, 0x013A, Unit::LedOverride, Gate::Open),
    run(0x0140, 0x0142, Unit::Always, Gate::Open),
    run(0x014E, 0x0154, Unit::Always, Gate::Open),
    run(0x0200, 0x0202, Unit::Always, Gate::Open),
    run(0x0204, 0x0208, Unit::Always, Gate::Open),
    run(0x0210, 0x0212, Unit::Always, Gate::Open),
    run(0x0220, 0x0224, Unit::Always, Gate::Open),
    run(0x0300, 0x0314, Unit::Always, Gate::Open),
    run(0x0400, 0x0402, Unit::Always, Gate::Open),
    run(0x0410, 0x0412, Unit::Always, Gate::Open),
    run(0x0420, 0x0422, Unit::Always, Gate::Open),
    run(0x0440, 0x0444, Unit::Always, Gate::Open),
    run(0x0500, 0x0510, Unit::Always, Gate::Open),
    run(0x0510, 0x051C, Unit::Mii, Gate::Open),
    run(0x0600, 0x0640, Unit::Fmmu, Gate::Open),
    run(0x0640, 0x0680, Unit::Fmmu, Gate::Open),
    run(0x0680, 0x0700, Unit::Fmmu, Gate::Open),
    run(0x0800, 0x0820, Unit::Sm, Gate::Open),
    run(0x0820, 0x0840, Unit::Sm, Gate::Open),
    run(0x0840, 0x0880, Unit::Sm, Gate::Open),
    run(0x0900, 0x0910, Unit::ReceiveTimes, Gate::Open),
    run(0x0910, 0x0936, Unit::SystemTime, Gate::Open),
    run(0x0936, 0x0937, Unit::LatchMode, Gate::Open),
    run(0x0980, 0x0981, Unit::SystemTime, Gate::Open),
    run(0x0981, 0x0984, Unit::Sync, Gate::Open),
    run(0x0984, 0x0985, Unit::EnhancedSync, Gate::Open),
    run(0x098E, 0x09A8, Unit::Sync, Gate::Open),
    run(0x09A8, 0x09AA, Unit::Latch, Gate::Open),
    run(0x09AE, 0x09D0, Unit::Latch, Gate::Open),
    run(0x09F0, 0x09F4, Unit::SystemTime, Gate::Open),
    run(0x09F8, 0x0A00, Unit::SystemTime, Gate::Open),
    run(0x0E00, 0x0E10, Unit::Specific, Gate::Open),
    run(0x0E10, 0x0F00, Unit::Specific, Gate::Open),
    run(0x0F00, 0x0F04, Unit::Always, Gate::Open),
    run(0x0F10, 0x0F20, Unit::Always, Gate::Open),
    run(0x0F80, 0x1000, Unit::Always, Gate::Open),
]);

/// The registers that ECAT can write.
pub(crate) static ECAT_WRITABLE: Table = Table::new(&[
    run(0x0010, 0x0012, Unit::Always, Gate::Open),
    run(0x0020, 0x0022, Unit::Always, Gate::Open),
    run(0x0030, 0x0032, Unit::Always, Gate::Open),
    run(0x0040, 0x0041, Unit::Always, Gate::Open),
    run(0x0100, 0x0104, Unit::Always, Gate::Open),
    run(0x0108, 0x010A, Unit::PhysicalOffset, Gate::Open),
    run(0x0120, 0x0122, Unit::Always, Gate::AlControl),
    run(0x0138, 0x013A, Unit::LedOverride, Gate::Open),
    run(0x0200, 0x0202, Unit::Always, Gate::Open),
    run(0x0300, 0x030E, Unit::Always, Gate::Open),
    run(0x0310, 0x0314, Unit::Always, Gate::Open),
    run(0x0400, 0x0402, Unit::Always, Gate::Open),
    run(0x0410, 0x0412, Unit::Always, Gate::Open),
    run(0x0420, 0x0422, Unit::Always, Gate::Open),
    run(0x0442, 0x0444, Unit::Always, Gate::Open),
    run(0x0500, 0x0501, Unit::Always, Gate::Open),
    run(0x0502, 0x0510, Unit::Always, Gate::Eeprom),
    run(0x0510, 0x0516, Unit::Mii, Gate::Mii),
    run(0x0516, 0x0518, Unit::Mii, Gate::MiiTake),
    run(0x0518, 0x051C, Unit::Mii, Gate::Open),
    run(0x0600, 0x0640, Unit::Fmmu, Gate::Open),
    run(0x0640, 0x0680, Unit::Fmmu, Gate::Open),
    run(0x0680, 0x0700, Unit::Fmmu, Gate::Open),
    run(0x0800, 0x0880, Unit::Sm, Gate::SyncManager),
    run(0x0900, 0x0904, Unit::ReceiveTimes, Gate::Open),
    run(0x0910, 0x0914, Unit::EcatTime, Gate::Open),
    run(0x0914, 0x0918, Unit::WideEcatTime, Gate::Open),
    run(0x0920, 0x0924, Unit::EcatTime, Gate::Open),
    run(0x0924, 0x0928, Unit::WideEcatTime, Gate::Open),
    run(0x0928, 0x092C, Unit::EcatTime, Gate::Open),
    run(0x0930, 0x0932, Unit::EcatTime, Gate::Open),
    run(0x0934, 0x0936, Unit::EcatTime, Gate::Open),
    run(0x0936, 0x0937, Unit::LatchMode, Gate::Open),
    run(0x0980, 0x0981, Unit::SystemTime, Gate::Open),
    run(0x0981, 0x0982, Unit::Sync, Gate::SyncOwner),
    run(0x0990, 0x0994, Unit::Sync, Gate::SyncStart),
    run(0x0994, 0x0998, Unit::WideSync, Gate::SyncStart),
    run(0x09A0, 0x09A8, Unit::Sync, Gate::SyncOwner),
    run(0x09A8, 0x09AA, Unit::Latch, Gate::Latch),
    run(0x0F00, 0x0F04, Unit::Always, Gate::Open),
    run(0x0F10, 0x0F18, Unit::Always, Gate::Open),
    run(0x0F80, 0x1000, Unit::Always, Gate::Open),
]);

/// The registers that the PDI can write.
pub(crate) static PDI_WRITABLE: Table = Table::new(&[
    run(0x0012, 0x0014, Unit::Always, Gate::Open),
    run(0x0041, 0x0042, Unit::Always, Gate::Open),
    run(0x0130, 0x0132, Unit::Always, Gate::AlStatus),
    run(0x0134, 0x0136, Unit::Always, Gate::Open),
    run(0x0138, 0x013A, Unit::LedOverride, Gate::Open),
    run(0x0204, 0x0208, Unit::Always, Gate::Open),
    run(0x0501, 0x0502, Unit::Always, Gate::EepromTake),
    run(0x0502, 0x0510, Unit::Always, Gate::Eeprom),
    run(0x0510, 0x0516, Unit::Mii, Gate::Mii),
    run(0x0517, 0x0518, Unit::Mii, Gate::MiiTake),
    run(0x0800, 0x0880, Unit::Sm, Gate::SyncManager),
    run(0x0910, 0x0914, Unit::PdiTime, Gate::Open),
    run(0x0914, 0x0918, Unit::WidePdiTime, Gate::Open),
    run(0x0920, 0x0924, Unit::PdiTime, Gate::Open),
    run(0x0924, 0x0928, Unit::WidePdiTime, Gate::Open),
    run(0x0928, 0x092C, Unit::PdiTime, Gate::Open),
    run(0x0930, 0x0932, Unit::PdiTime, Gate::Open),
    run(0x0934, 0x0936, Unit::PdiTime, Gate::Open),
    run(0x0981, 0x0982, Unit::Sync, Gate::SyncOwner),
    run(0x0990, 0x0994, Unit::Sync, Gate::SyncStart),
    run(0x0994, 0x0998, Unit::WideSync, Gate::SyncStart),
    run(0x09A0, 0x09A8, Unit::Sync, Gate::SyncOwner),
    run(0x09A8, 0x09AA, Unit::Latch, Gate::Latch),
    run(0x0F80, 0x1000, Unit::Always, Gate::Open),
]);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::{ET1100, ET1200, IP_CORE_32};

    #[test]
    fn runs_are_in_order() {
        for table in [&READABLE, &ECAT_WRITABLE, &PDI_WRITABLE].map(|table| table.runs) {
            for run in table {
                assert!(run.start < run.end);
            }
            for pair in table.windows(2) {
                assert!(pair[0].end <= pair[1].start);
            }
        }
    }

    #[test]
    fn counts_and_units_cut_the_runs() {
        let units = Units::new(&ET1200, 0x00);
        assert_eq!(units.run(&READABLE, 0x062F), (0x0630, Some(Gate::Open)));
        assert_eq!(units.run(&READABLE, 0x0630), (0x0640, None));
        assert_eq!(units.run(&READABLE, 0x0820), (0x0840, None));
        // With the DC units switched off the receive times remain.
        assert_eq!(units.run(&READABLE, 0x0900), (0x0910, Some(Gate::Open)));
        assert_eq!(units.run(&READABLE, 0x0910), (0x0936, None));
        assert!(Units::new(&ET1200, 0x08).run(&READABLE, 0x0910).1.is_some());
        assert!(Units::new(&ET1200, 0x08).run(&READABLE, 0x0981).1.is_none());
        // Only the enhanced SYNC activation has a status.
        assert!(Units::new(&ET1200, 0x04).run(&READABLE, 0x0984).1.is_some());
        assert!(Units::new(&ET1100, 0x04).run(&READABLE, 0x0984).1.is_none());
        // The upper half of a 32-bit counter reads and is not writable.
        let narrow = Units::new(&IP_CORE_32, 0);
        assert!(narrow.run(&READABLE, 0x0914).1.is_some());
        assert!(narrow.run(&ECAT_WRITABLE, 0x0914).1.is_none());
        assert_eq!(narrow.run(&READABLE, 0x0FFF), (0x1000, Some(Gate::Open)));
        // The chip-specific registers reach as far as the chip's own values do.
        assert_eq!(narrow.run(&READABLE, 0x0E00), (0x0E10, Some(Gate::Open)));
        assert_eq!(narrow.run(&READABLE, 0x0E10), (0x0F00, None));
        assert_eq!(units.run(&READABLE, 0x0E01), (0x0E10, None));
        assert_eq!(units.run(&READABLE, 0x0515), (0x0516, Some(Gate::Open)));
        assert_eq!(units.run(&READABLE, 0x0516), (0x051C, None));
    }
}
