//! Images of the distributed clocks' registers.

use core::fmt;

use crate::register::newtype_value;
use crate::time::Nanos;

/// System time difference, register 0x092C: sign and magnitude, not two's complement. The meaning
/// of the sign depends on the chip: see [`DifferencePolarity`].
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct SystemTimeDifference(pub u32);
newtype_value!(SystemTimeDifference u32 4);

/// The meaning of bit 31 of register 0x092C. Register texts contradict each other. The only
/// captured chip, an ET1100, follows the older text.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default)]
pub enum DifferencePolarity {
    /// Bit 31 = 0: the local copy is ahead of the received time or equal to it (older texts,
    /// captured).
    #[default]
    PositiveAhead,
    /// Bit 31 = 1: the local copy is ahead of the received time or equal to it (newer texts).
    NegativeAhead,
}

impl SystemTimeDifference {
    /// Converts local minus received time; the magnitude saturates.
    #[inline]
    pub fn from_nanos(difference: Nanos, polarity: DifferencePolarity) -> Self {
        let magnitude = difference.0.unsigned_abs().min(0x7FFF_FFFF) as u32;
        let ahead = difference.0 >= 0;
        let sign = ahead == (polarity == DifferencePolarity::NegativeAhead);
        Self(magnitude | u32::from(sign) << 31)
    }
    /// Local minus received time: positive when the local clock is ahead.
    pub const fn nanos(self, polarity: DifferencePolarity) -> Nanos {
        let behind = match polarity {
            DifferencePolarity::PositiveAhead => self.0,
            DifferencePolarity::NegativeAhead => !self.0,
        };
        // All bits are set if it is behind: the negative of a number is its complement plus one.
        let sign = (behind as i32 >> 31) as i64;
        Nanos((self.magnitude() as i64 ^ sign) - sign)
    }
    /// Size of the difference.
    pub const fn magnitude(self) -> u32 {
        self.0 & 0x7FFF_FFFF
    }
    /// Bit 31.
    pub const fn is_negative(self) -> bool {
        self.0 >> 31 == 1
    }
}

/// SYNC activation, register 0x0981.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct SyncActivation(pub u8);
newtype_value!(SyncActivation u8 1);

impl SyncActivation {
    /// Bit 0: the SYNC unit is active.
    pub const ACTIVE: u8 = 1 << 0;
    /// Bit 1: SYNC0 is generated.
    pub const SYNC0: u8 = 1 << 1;
    /// Bit 2: SYNC1 is generated.
    pub const SYNC1: u8 = 1 << 2;
    /// Bit 3: bit 0 sets itself when the start time is written.
    pub const AUTO: u8 = 1 << 3;
    /// Bit 4: a 32-bit start time is extended to 64 bits.
    pub const EXTEND: u8 = 1 << 4;
    /// Bit 5: start at once if the start time is not in the near future.
    pub const PLAUSIBILITY: u8 = 1 << 5;
    /// Bit 6: the near future is about 2.1 s instead of half the counter.
    pub const NEAR_FUTURE: u8 = 1 << 6;
    /// Bit 7: one pulse on the enabled signals; clears itself.
    pub const DEBUG_PULSE: u8 = 1 << 7;

    /// The SYNC unit is active.
    pub const fn active(self) -> bool {
        self.0 & Self::ACTIVE != 0
    }
    /// SYNC0 is generated.
    pub const fn sync0(self) -> bool {
        self.0 & Self::SYNC0 != 0
    }
    /// SYNC1 is generated.
    pub const fn sync1(self) -> bool {
        self.0 & Self::SYNC1 != 0
    }
}

/// SYNC activation status, register 0x0984.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct ActivationStatus(pub u8);
newtype_value!(ActivationStatus u8 1);

impl ActivationStatus {
    /// Bit 0: the first SYNC0 pulse is still pending.
    pub const fn sync0_pending(self) -> bool {
        self.0 & 1 != 0
    }
    /// Bit 1: the first SYNC1 pulse is still pending.
    pub const fn sync1_pending(self) -> bool {
        self.0 & 2 != 0
    }
    /// Bit 2: the start time was not in the near future at activation.
    pub const fn start_implausible(self) -> bool {
        self.0 & 4 != 0
    }
}

/// The 16-bit word written to 0x0980 (low byte) and 0x0981 (high byte): AssignActivate in ESI files
/// and in the SII.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default)]
pub struct AssignActivate(pub u16);
newtype_value!(AssignActivate u16 2);

impl AssignActivate {
    /// No SYNC unit: Free Run or SM-synchronous.
    pub const OFF: Self = Self(0x0000);
    /// Active with SYNC0.
    pub const SYNC0: Self = Self(0x0300);
    /// Active with SYNC0 and SYNC1.
    pub const SYNC0_AND_SYNC1: Self = Self(0x0700);

    /// Active without a pulse: for time stamps of the latch units.
    pub const UNIT_ONLY: Self = Self(0x0100);
    /// Bit 0: the SYNC unit belongs to the PDI.
    pub const UNIT_AT_PDI: u16 = 1 << 0;
    /// Bit 4: latch unit 0 belongs to the PDI.
    pub const LATCH0_AT_PDI: u16 = 1 << 4;
    /// Bit 5: latch unit 1 belongs to the PDI.
    pub const LATCH1_AT_PDI: u16 = 1 << 5;
    /// Bits of 0x0980 without a meaning.
    pub const RESERVED: u16 = 0x00CE;

    /// The SYNC unit belongs to the PDI: the SubDevice programs it, and writes of the MainDevice to
    /// the unit from 0x0981 on are ignored.
    pub const fn unit_at_pdi(self) -> bool {
        self.0 & Self::UNIT_AT_PDI != 0
    }
    /// Latch unit 0 belongs to the PDI.
    pub const fn latch0_at_pdi(self) -> bool {
        self.0 & Self::LATCH0_AT_PDI != 0
    }
    /// Latch unit 1 belongs to the PDI.
    pub const fn latch1_at_pdi(self) -> bool {
        self.0 & Self::LATCH1_AT_PDI != 0
    }
    /// The unit is switched on, at once or by the write of the start time.
    pub const fn activates(self) -> bool {
        self.activation().0 & (SyncActivation::ACTIVE | SyncActivation::AUTO) != 0
    }
    /// The unit is on and generates SYNC0.
    pub const fn makes_sync0(self) -> bool {
        self.activates() && self.activation().sync0()
    }
    /// The unit is on and generates SYNC1.
    pub const fn makes_sync1(self) -> bool {
        self.activates() && self.activation().sync1()
    }
    /// The byte for 0x0981.
    pub const fn activation(self) -> SyncActivation {
        SyncActivation((self.0 >> 8) as u8)
    }
    /// The byte for 0x0980: owners of the SYNC unit (bit 0) and the latch units (bits 4, 5).
    pub const fn control(self) -> u8 {
        self.0 as u8
    }
}

impl fmt::Display for AssignActivate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "0x{:04X}", self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A captured ET1100 showed 0x000000FD when its clock was ahead; newer texts define the
    /// opposite.
    #[test]
    fn the_sign_means_what_the_chip_says() {
        use DifferencePolarity::{NegativeAhead, PositiveAhead};
        assert_eq!(SystemTimeDifference(0x0000_00FD).nanos(PositiveAhead), Nanos(253));
        assert_eq!(SystemTimeDifference(0x0000_00FD).nanos(NegativeAhead), Nanos(-253));
        for (polarity, behind, equal) in
            [(PositiveAhead, 0x8000_00FD, 0), (NegativeAhead, 0x0000_00FD, 0x8000_0000)]
        {
            let register = |ns| SystemTimeDifference::from_nanos(Nanos(ns), polarity);
            assert_eq!((register(-253).0, register(0).0), (behind, equal));
            assert_eq!(register(-253).nanos(polarity), Nanos(-253));
            assert_eq!(register(i64::MIN).0 & 0x7FFF_FFFF, 0x7FFF_FFFF);
        }
    }

    #[test]
    fn assign_activate_is_not_read_as_the_tutorials_do() {
        let word = AssignActivate(0x0300);
        assert!(word.activation().active() && word.activation().sync0());
        assert!(!AssignActivate(0x0100).activation().sync0());
        assert!(AssignActivate(0x0200).activation().sync0());
    }

    /// AssignActivate words of real devices: unit on, SYNC0, SYNC1, unit, latch 0 and latch 1 at
    /// the PDI.
    #[test]
    fn words_of_the_field() {
        for (word, expected) in [
            (0x0000, [false; 6]),
            (0x0300, [true, true, false, false, false, false]),
            (0x0700, [true, true, true, false, false, false]),
            (0x0730, [true, true, true, false, true, true]),
            (0x0320, [true, true, false, false, false, true]),
            (0x0310, [true, true, false, false, true, false]),
            (0x0301, [true, true, false, true, false, false]),
            (0x0500, [true, false, true, false, false, false]),
            (0x0100, [true, false, false, false, false, false]),
            (0x0130, [true, false, false, false, true, true]),
            (0x0030, [false, false, false, false, true, true]),
            (0x0600, [false; 6]),
        ] {
            let it = AssignActivate(word);
            let found = [
                it.activates(),
                it.makes_sync0(),
                it.makes_sync1(),
                it.unit_at_pdi(),
                it.latch0_at_pdi(),
                it.latch1_at_pdi(),
            ];
            assert_eq!(found, expected, "{it}");
        }
        assert!(AssignActivate(0x0B00).makes_sync0(), "on by the write of the start time");
    }
}
