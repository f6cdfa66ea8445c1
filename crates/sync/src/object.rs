//! The sync objects 0x1C32 (outputs) and 0x1C33 (inputs) as typed values.

use core::fmt;

use isocat_wire::time::Nanos;

/// Object 0x1C00: the use of each SyncManager.
pub const SM_COMMUNICATION_TYPE: u16 = 0x1C00;
/// Object 0x1C12: PDOs assigned to SM2.
pub const OUTPUT_ASSIGNMENT: u16 = 0x1C12;
/// Object 0x1C13: PDOs assigned to SM3.
pub const INPUT_ASSIGNMENT: u16 = 0x1C13;
/// Object 0x1C32: SM output parameter.
pub const OUTPUT_PARAMETER: u16 = 0x1C32;
/// Object 0x1C33: SM input parameter.
pub const INPUT_PARAMETER: u16 = 0x1C33;
/// Object 0x10F1: error settings; sub-index 2 is the sync error counter limit.
pub const ERROR_SETTINGS: u16 = 0x10F1;
/// Object 0x60C2: interpolation time period of a drive (CiA 402); see [`crate::interpolation`].
pub const INTERPOLATION_TIME: u16 = 0x60C2;

/// Sub-indices of 0x1C32 and 0x1C33.
pub mod sub {
    /// Synchronization type, u16.
    pub const SYNC_TYPE: u8 = 0x01;
    /// Cycle time, u32 ns.
    pub const CYCLE_TIME: u8 = 0x02;
    /// Shift time, u32 ns.
    pub const SHIFT_TIME: u8 = 0x03;
    /// Synchronization types supported, u16.
    pub const SUPPORTED_TYPES: u8 = 0x04;
    /// Minimum cycle time, u32 ns.
    pub const MINIMUM_CYCLE_TIME: u8 = 0x05;
    /// Calc and copy time, u32 ns.
    pub const CALC_AND_COPY_TIME: u8 = 0x06;
    /// Minimum delay time, u32 ns.
    pub const MINIMUM_DELAY_TIME: u8 = 0x07;
    /// Get cycle time (command), u16.
    pub const GET_CYCLE_TIME: u8 = 0x08;
    /// Delay time, u32 ns.
    pub const DELAY_TIME: u8 = 0x09;
    /// SYNC0 cycle time, u32 ns.
    pub const SYNC0_CYCLE_TIME: u8 = 0x0A;
    /// SM event missed counter, u16.
    pub const SM_EVENT_MISSED: u8 = 0x0B;
    /// Cycle time too small counter, u16.
    pub const CYCLE_TIME_TOO_SMALL: u8 = 0x0C;
    /// Shift time too short counter, u16.
    pub const SHIFT_TIME_TOO_SHORT: u8 = 0x0D;
    /// RxPDO toggle failed counter, u16.
    pub const TOGGLE_FAILED: u8 = 0x0E;
    /// Minimum cycle distance, u32 ns.
    pub const MINIMUM_CYCLE_DISTANCE: u8 = 0x0F;
    /// Maximum cycle distance, u32 ns.
    pub const MAXIMUM_CYCLE_DISTANCE: u8 = 0x10;
    /// Minimum SM-SYNC distance, u32 ns.
    pub const MINIMUM_SM_SYNC_DISTANCE: u8 = 0x11;
    /// Maximum SM-SYNC distance, u32 ns.
    pub const MAXIMUM_SM_SYNC_DISTANCE: u8 = 0x12;
    /// Sync error, 1 bit.
    pub const SYNC_ERROR: u8 = 0x20;
}

/// ETG.1020 name of a sub-index of 0x1C32 or 0x1C33.
pub const fn name(sub: u8) -> Option<&'static str> {
    Some(match sub {
        0x01 => "synchronization type",
        0x02 => "cycle time",
        0x03 => "shift time",
        0x04 => "synchronization types supported",
        0x05 => "minimum cycle time",
        0x06 => "calc and copy time",
        0x07 => "minimum delay time",
        0x08 => "get cycle time",
        0x09 => "delay time",
        0x0A => "SYNC0 cycle time",
        0x0B => "SM event missed",
        0x0C => "cycle time too small",
        0x0D => "shift time too short",
        0x0E => "RxPDO toggle failed",
        0x0F => "minimum cycle distance",
        0x10 => "maximum cycle distance",
        0x11 => "minimum SM-SYNC distance",
        0x12 => "maximum SM-SYNC distance",
        0x20 => "sync error",
        _ => return None,
    })
}

/// Sub-index 01. The code space is open, so unknown types are kept.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default)]
pub struct SyncType(pub u16);

impl SyncType {
    /// Not synchronized.
    pub const FREE_RUN: Self = Self(0x00);
    /// 0x1C32: synchronized with SM2; 0x1C33: with SM3, when no outputs are transmitted.
    pub const SM: Self = Self(0x01);
    /// Synchronized with SYNC0.
    pub const DC_SYNC0: Self = Self(0x02);
    /// Synchronized with SYNC1.
    pub const DC_SYNC1: Self = Self(0x03);
    /// 0x1C33 only: inputs synchronized with SM2, when outputs are transmitted.
    pub const INPUTS_ON_SM2: Self = Self(0x22);
}

impl fmt::Display for SyncType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::FREE_RUN => f.write_str("0 (Free Run)"),
            Self::SM => f.write_str("1 (SM-synchronous)"),
            Self::DC_SYNC0 => f.write_str("2 (DC SYNC0)"),
            Self::DC_SYNC1 => f.write_str("3 (DC SYNC1)"),
            Self::INPUTS_ON_SM2 => f.write_str("0x22 (SM-synchronous with SM2)"),
            Self(other) => write!(f, "{other:#04x} (unknown)"),
        }
    }
}

/// Sub-index 04: the abilities of a SubDevice. Bits 4:2 are independent flags.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default)]
pub struct SupportedTypes(pub u16);

/// How a SubDevice shifts Outputs Valid (0x1C32) or Input Latch (0x1C33): bits 6:5 of sub-index 04.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ShiftBy {
    /// 00: no shift.
    Nothing,
    /// 01: a local timer; sub-index 03 is writable.
    LocalTimer,
    /// 10: SYNC1.
    Sync1,
    /// 11.
    Reserved,
}

impl SupportedTypes {
    /// Bit 14, see [`SupportedTypes::dynamic_times`].
    pub const DYNAMIC_TIMES: u16 = 1 << 14;

    /// Bit 0.
    pub const fn free_run(self) -> bool {
        self.0 & 1 << 0 != 0
    }
    /// Bit 1.
    pub const fn sm_synchronous(self) -> bool {
        self.0 & 1 << 1 != 0
    }
    /// Bit 2.
    pub const fn dc_sync0(self) -> bool {
        self.0 & 1 << 2 != 0
    }
    /// Bit 3.
    pub const fn dc_sync1(self) -> bool {
        self.0 & 1 << 3 != 0
    }
    /// Bit 4: subordinated application cycles with a fixed SYNC0.
    pub const fn dc_subordinated(self) -> bool {
        self.0 & 1 << 4 != 0
    }
    /// Bits 6:5.
    pub const fn shift(self) -> ShiftBy {
        match self.0 >> 5 & 3 {
            0 => ShiftBy::Nothing,
            1 => ShiftBy::LocalTimer,
            2 => ShiftBy::Sync1,
            _ => ShiftBy::Reserved,
        }
    }
    /// Bit 10: delay times depend on the configuration and should be measured.
    pub const fn delay_should_be_measured(self) -> bool {
        self.0 & 1 << 10 != 0
    }
    /// Bit 11: delay times are fixed, because the hardware synchronizes.
    pub const fn delay_fixed(self) -> bool {
        self.0 & 1 << 11 != 0
    }
    /// Bit 14: times may read 0 and are measured in OP.
    pub const fn dynamic_times(self) -> bool {
        self.0 & Self::DYNAMIC_TIMES != 0
    }
}

impl fmt::Display for SupportedTypes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "0x{:04X} (", self.0)?;
        let mut first = true;
        for (set, text) in [
            (self.free_run(), "Free Run"),
            (self.sm_synchronous(), "SM"),
            (self.dc_sync0(), "DC SYNC0"),
            (self.dc_sync1(), "DC SYNC1"),
            (self.dc_subordinated(), "subordinated"),
            (self.shift() == ShiftBy::LocalTimer, "shift by local timer"),
            (self.shift() == ShiftBy::Sync1, "shift by SYNC1"),
            (self.delay_should_be_measured(), "delay to be measured"),
            (self.delay_fixed(), "delay fixed"),
            (self.dynamic_times(), "dynamic times"),
        ] {
            if set {
                write!(f, "{}{text}", if first { "" } else { ", " })?;
                first = false;
            }
        }
        f.write_str(if first { "nothing)" } else { ")" })
    }
}

/// The values of one sync object, 0x1C32 or 0x1C33, as read from a SubDevice. `None` if the
/// sub-index does not exist.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct SyncParameters {
    /// 01.
    pub sync_type: Option<SyncType>,
    /// 02.
    pub cycle_time: Option<Nanos>,
    /// 03: time from the related event to Outputs Valid (0x1C32) or Input Latch (0x1C33).
    pub shift_time: Option<Nanos>,
    /// 04.
    pub supported: Option<SupportedTypes>,
    /// 05: the shortest cycle that the SubDevice supports.
    pub minimum_cycle_time: Option<Nanos>,
    /// 06: least time from the starting to the acting event (0x1C32), or from Input Latch until the
    /// inputs are in the SM3 buffer (0x1C33).
    pub calc_and_copy_time: Option<Nanos>,
    /// 07.
    pub minimum_delay_time: Option<Nanos>,
    /// 09: hardware delay from the trigger to Outputs Valid or Input Latch.
    pub delay_time: Option<Nanos>,
    /// 0A.
    pub sync0_cycle_time: Option<Nanos>,
    /// 0B.
    pub sm_event_missed: Option<u16>,
    /// 0C.
    pub cycle_time_too_small: Option<u16>,
    /// 0D.
    pub shift_time_too_short: Option<u16>,
    /// 0E.
    pub toggle_failed: Option<u16>,
    /// 20.
    pub sync_error: Option<bool>,
}

impl SyncParameters {
    /// Stores the value read from one sub-index. Sub-indices without a field here are ignored.
    pub fn set(&mut self, sub: u8, value: u32) {
        let time = Some(Nanos::from_u32(value));
        let count = Some(value as u16);
        match sub {
            sub::SYNC_TYPE => self.sync_type = Some(SyncType(value as u16)),
            sub::CYCLE_TIME => self.cycle_time = time,
            sub::SHIFT_TIME => self.shift_time = time,
            sub::SUPPORTED_TYPES => self.supported = Some(SupportedTypes(value as u16)),
            sub::MINIMUM_CYCLE_TIME => self.minimum_cycle_time = time,
            sub::CALC_AND_COPY_TIME => self.calc_and_copy_time = time,
            sub::MINIMUM_DELAY_TIME => self.minimum_delay_time = time,
            sub::DELAY_TIME => self.delay_time = time,
            sub::SYNC0_CYCLE_TIME => self.sync0_cycle_time = time,
            sub::SM_EVENT_MISSED => self.sm_event_missed = count,
            sub::CYCLE_TIME_TOO_SMALL => self.cycle_time_too_small = count,
            sub::SHIFT_TIME_TOO_SHORT => self.shift_time_too_short = count,
            sub::TOGGLE_FAILED => self.toggle_failed = count,
            sub::SYNC_ERROR => self.sync_error = Some(value & 1 != 0),
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    #[test]
    fn each_counter_goes_to_its_field() {
        let mut read = SyncParameters::default();
        for (sub, value) in [
            (sub::SM_EVENT_MISSED, 11),
            (sub::CYCLE_TIME_TOO_SMALL, 12),
            (sub::SHIFT_TIME_TOO_SHORT, 13),
            (sub::TOGGLE_FAILED, 14),
        ] {
            read.set(sub, value);
        }
        let expected = SyncParameters {
            sm_event_missed: Some(11),
            cycle_time_too_small: Some(12),
            shift_time_too_short: Some(13),
            toggle_failed: Some(14),
            ..SyncParameters::default()
        };
        assert_eq!(read, expected);
    }

    #[test]
    fn words_of_real_devices() {
        let akd2g = SupportedTypes(0x0427);
        assert!(akd2g.free_run() && akd2g.sm_synchronous() && akd2g.dc_sync0());
        assert!(!akd2g.dc_sync1() && akd2g.delay_should_be_measured());
        assert_eq!(akd2g.shift(), ShiftBy::LocalTimer);
        let el2502 = SupportedTypes(0x4001);
        assert_eq!(el2502.to_string(), "0x4001 (Free Run, dynamic times)");
        assert_eq!(SupportedTypes(0xC007).shift(), ShiftBy::Nothing);
    }

    #[test]
    fn all_sub_indices_with_a_field_are_taken() {
        let mut read = SyncParameters::default();
        for sub in 0..=0x20 {
            read.set(sub, 1);
        }
        assert_eq!(read.delay_time, Some(Nanos(1)));
        assert_eq!(read.sync_error, Some(true));
        assert_eq!(read.minimum_delay_time, Some(Nanos(1)));
    }
}
