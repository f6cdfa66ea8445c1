//! The settings of a SYNC unit in each mode: cycles, and the positions of the pulses about the
//! acting one.

use isocat_wire::time::Nanos;

use crate::mode::SyncMode;

/// The pulses of one SubDevice in one bus cycle. The "acting pulse" is the one at which its outputs
/// take effect; it has the same phase in all SubDevices of a segment.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Pulses {
    /// Register 0x09A0: from SYNC0 to SYNC0.
    pub sync0_cycle: Nanos,
    /// Register 0x09A4: from a SYNC0 to SYNC1. Zero if SYNC1 is not used.
    pub sync1: Nanos,
    /// From the first SYNC0 to the acting pulse.
    pub lead: Nanos,
}

/// How the SYNC signals of a SubDevice end: register 0x0982, which its EEPROM sets, decides.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum SyncSignal {
    /// Not known.
    #[default]
    Unknown,
    /// They end by themselves, this long after the pulse.
    Pulse(Nanos),
    /// They end when the device's program reads 0x098E or 0x098F, this long after the pulse. The
    /// register is 0 (acknowledge mode).
    Acknowledged(Nanos),
}

impl Pulses {
    /// The pulses of a mode. `bus` is the bus cycle. `distance` is the time from SYNC0 to SYNC1 if
    /// SYNC1 is a part of the cycle behind SYNC0; with subordinated cycles it counts from the SYNC0
    /// that SYNC1 belongs to. `sync0` is the SYNC0 cycle with subordinated cycles. With
    /// `outputs_on_sync1` outputs act at SYNC1 even if SYNC0 only starts the calculation.
    pub fn new(
        mode: SyncMode,
        bus: Nanos,
        distance: Nanos,
        sync0: Nanos,
        outputs_on_sync1: bool,
    ) -> Self {
        match mode {
            SyncMode::FreeRun | SyncMode::SmSynchronous => Self::default(),
            SyncMode::DcSync0 => Self { sync0_cycle: bus, sync1: Nanos::ZERO, lead: Nanos::ZERO },
            SyncMode::DcShiftSync1 => {
                let lead = if outputs_on_sync1 { distance } else { Nanos::ZERO };
                Self { sync0_cycle: bus, sync1: distance, lead }
            }
            SyncMode::DcSync1 => Self { sync0_cycle: bus, sync1: distance, lead: distance },
            SyncMode::DcSubordinated => {
                // SYNC1 comes this long after the first SYNC0 behind the last SYNC1, so once a bus
                // cycle.
                let sync1 = bus - sync0 + distance;
                Self { sync0_cycle: sync0, sync1, lead: sync1 }
            }
        }
    }

    /// Time from one acting pulse to the next if SYNC1 acts; otherwise the SYNC0 cycle. SYNC1
    /// counts from the first SYNC0 after the SYNC1 before.
    pub fn sync1_cycle(&self) -> Nanos {
        let count = self.sync1.0.checked_div(self.sync0_cycle.0).unwrap_or(0) + 1;
        Nanos(self.sync0_cycle.0 * count)
    }

    /// Time from the last SYNC0 at or before SYNC1 to SYNC1.
    pub fn behind_sync0(&self) -> Nanos {
        Nanos(self.sync1.0.checked_rem(self.sync0_cycle.0).unwrap_or(0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Register values of devices in the field: bus cycle, SYNC0 cycle, distance; 0x09A4, cycle of
    /// SYNC1.
    #[test]
    fn registers_of_known_devices() {
        let analog = Pulses::new(
            SyncMode::DcShiftSync1,
            Nanos(1_000_000),
            Nanos(100_000),
            Nanos::ZERO,
            false,
        );
        assert_eq!((analog.sync0_cycle, analog.sync1), (Nanos(1_000_000), Nanos(100_000)));
        assert_eq!((analog.sync1_cycle(), analog.lead), (Nanos(1_000_000), Nanos::ZERO));
        for (bus, sync0, sync1) in [
            (1_000_000, 250_000, 750_000),
            (500_000, 62_500, 437_500),
            (1_000_000, 500_000, 500_000),
        ] {
            let pulses =
                Pulses::new(SyncMode::DcSubordinated, Nanos(bus), Nanos::ZERO, Nanos(sync0), false);
            assert_eq!((pulses.sync1, pulses.sync1_cycle()), (Nanos(sync1), Nanos(bus)));
            assert_eq!(pulses.behind_sync0(), Nanos::ZERO);
        }
        // SYNC1 comes behind the SYNC0 that it belongs to, as some drives want it.
        let (bus, sync0, behind) = (Nanos(1_000_000), Nanos(15_625), Nanos(580));
        let shifted = Pulses::new(SyncMode::DcSubordinated, bus, behind, sync0, false);
        assert_eq!((shifted.sync1, shifted.lead), (Nanos(984_955), Nanos(984_955)));
        assert_eq!((shifted.sync1_cycle(), shifted.behind_sync0()), (bus, behind));
        let odd = Pulses { sync0_cycle: Nanos(500_000), sync1: Nanos(750_000), lead: Nanos::ZERO };
        assert_eq!((odd.sync1_cycle(), odd.behind_sync0()), (Nanos(1_000_000), Nanos(250_000)));
    }
}
