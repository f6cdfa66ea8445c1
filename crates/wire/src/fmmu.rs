//! The registers of an FMMU: one mapping from logical bits to ESC memory.

use crate::register::Value;

/// The sixteen bytes of FMMU y at 0x0600 + 16 y.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Fmmu {
    /// First logical byte.
    pub logical_start: u32,
    /// Number of logical bytes, including partial first and last ones.
    pub length: u16,
    /// First mapped bit of the first byte, 0..=7.
    pub logical_start_bit: u8,
    /// Last mapped bit of the last byte, 0..=7. May be below the start bit if the length is over 1.
    pub logical_stop_bit: u8,
    /// First physical byte: RAM or a register.
    pub physical_start: u16,
    /// First physical bit, 0..=7.
    pub physical_start_bit: u8,
    /// Bit 0: reads (inputs); bit 1: writes (outputs).
    pub kind: u8,
    /// Bit 0: active.
    pub activate: u8,
    /// Reserved bytes, kept as received.
    pub reserved: [u8; 3],
}

impl Fmmu {
    /// Kind of an FMMU through which the MainDevice reads.
    pub const READ: u8 = 1;
    /// Kind of an FMMU through which the MainDevice writes.
    pub const WRITE: u8 = 2;

    /// An active byte-wise mapping.
    pub const fn bytes(logical_start: u32, length: u16, physical_start: u16, kind: u8) -> Self {
        Self {
            logical_start,
            length,
            logical_start_bit: 0,
            logical_stop_bit: 7,
            physical_start,
            physical_start_bit: 0,
            kind,
            activate: 1,
            reserved: [0; 3],
        }
    }

    /// Whether it is active and maps at least one byte.
    pub const fn is_active(&self) -> bool {
        self.activate & 1 != 0 && self.length > 0
    }

    /// Number of mapped bits; 0 for a length of 0 or a stop bit before the start bit in one byte.
    pub const fn bits(&self) -> u32 {
        if self.length == 0 {
            return 0;
        }
        let bits = (self.length as i64 - 1) * 8 + (self.logical_stop_bit & 7) as i64
            - (self.logical_start_bit & 7) as i64
            + 1;
        if bits < 0 { 0 } else { bits as u32 }
    }

    /// Whether whole bytes map to whole bytes.
    pub const fn is_bytewise(&self) -> bool {
        self.logical_start_bit & 7 == 0
            && self.logical_stop_bit & 7 == 7
            && self.physical_start_bit & 7 == 0
    }
}

impl Value for Fmmu {
    type Bytes = [u8; 16];
    const LEN: usize = 16;
    fn from_bytes(b: [u8; 16]) -> Self {
        Self {
            logical_start: u32::from_le_bytes([b[0], b[1], b[2], b[3]]),
            length: u16::from_le_bytes([b[4], b[5]]),
            logical_start_bit: b[6],
            logical_stop_bit: b[7],
            physical_start: u16::from_le_bytes([b[8], b[9]]),
            physical_start_bit: b[10],
            kind: b[11],
            activate: b[12],
            reserved: [b[13], b[14], b[15]],
        }
    }
    fn to_bytes(self) -> [u8; 16] {
        let mut b = [0; 16];
        b[0..4].copy_from_slice(&self.logical_start.to_le_bytes());
        b[4..6].copy_from_slice(&self.length.to_le_bytes());
        b[6] = self.logical_start_bit;
        b[7] = self.logical_stop_bit;
        b[8..10].copy_from_slice(&self.physical_start.to_le_bytes());
        b[10] = self.physical_start_bit;
        b[11] = self.kind;
        b[12] = self.activate;
        b[13..].copy_from_slice(&self.reserved);
        b
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stop_below_start_is_legal_over_several_bytes() {
        // The data sheet's example: start 3, stop 0, length 3.
        let fmmu = Fmmu { length: 3, logical_start_bit: 3, ..Default::default() };
        assert_eq!(fmmu.bits(), 14);
        let one = Fmmu { length: 1, logical_start_bit: 3, ..Default::default() };
        assert_eq!(one.bits(), 0);
    }

    #[test]
    fn both_ways() {
        // As captured: logical 0x09000000, length 1, bit 0, physical 0x080D bit 3, read, active.
        let bytes = [0, 0, 0, 9, 1, 0, 0, 0, 0x0D, 0x08, 3, 1, 1, 0, 0, 0];
        let fmmu = Fmmu::from_bytes(bytes);
        assert_eq!(
            (fmmu.logical_start, fmmu.physical_start, fmmu.bits()),
            (0x0900_0000, 0x080D, 1)
        );
        assert_eq!(fmmu.to_bytes(), bytes);
    }
}
