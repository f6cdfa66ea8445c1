//! The ESC's interface to the SII EEPROM, registers 0x0502-0x050F.

use crate::register::newtype_value;

/// EEPROM control and status, register 0x0502.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct EepromStatus(pub u16);
newtype_value!(EepromStatus u16 2);

impl EepromStatus {
    /// Bit 0: ECAT write enable, set together with the write command.
    pub const WRITE_ENABLE: u16 = 1 << 0;
    /// Bit 5: the PDI emulates the EEPROM.
    pub const EMULATED: u16 = 1 << 5;
    /// Bit 6: a read gives 8 bytes; otherwise 4.
    pub const READS_8_BYTES: u16 = 1 << 6;
    /// Bit 7: two address bytes.
    pub const TWO_ADDRESS_BYTES: u16 = 1 << 7;
    /// Command 001 in bits 10:8.
    pub const READ: u16 = 1 << 8;
    /// Command 010 in bits 10:8.
    pub const WRITE: u16 = 1 << 9;
    /// Command 100 in bits 10:8.
    pub const RELOAD: u16 = 1 << 10;
    /// Bits 10:8.
    pub const COMMAND: u16 = 7 << 8;
    /// Bit 11: checksum error in the configuration area.
    pub const CHECKSUM_ERROR: u16 = 1 << 11;
    /// Bit 12: EEPROM not loaded.
    pub const NOT_LOADED: u16 = 1 << 12;
    /// Bit 13: missing acknowledge or invalid command.
    pub const COMMAND_ERROR: u16 = 1 << 13;
    /// Bit 14: write without write enable.
    pub const WRITE_ENABLE_ERROR: u16 = 1 << 14;
    /// Bit 15: busy.
    pub const BUSY: u16 = 1 << 15;

    /// A command is under way.
    pub const fn busy(self) -> bool {
        self.0 & Self::BUSY != 0
    }
    /// Number of bytes that a read gives.
    pub const fn read_len(self) -> usize {
        if self.0 & Self::READS_8_BYTES != 0 { 8 } else { 4 }
    }
    /// The EEPROM did not acknowledge the last command (or the command was invalid). Where the PDI
    /// emulates it, its program reports an error of its own by that bit.
    pub const fn no_acknowledge(self) -> bool {
        self.0 & (Self::COMMAND_ERROR | Self::EMULATED) == Self::COMMAND_ERROR
    }
    /// The last command failed.
    pub const fn failed(self) -> bool {
        self.0 & (Self::COMMAND_ERROR | Self::WRITE_ENABLE_ERROR) != 0
    }
}

/// The six bytes that start a read of `word`: control and address.
pub fn read_command(word: u32) -> [u8; 6] {
    let (c, a) = (EepromStatus::READ.to_le_bytes(), word.to_le_bytes());
    [c[0], c[1], a[0], a[1], a[2], a[3]]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Facts vectors 12 and 13.
    #[test]
    fn captured_values() {
        assert_eq!(read_command(8), [0x00, 0x01, 0x08, 0x00, 0x00, 0x00]);
        assert!(EepromStatus(0x8140).busy() && EepromStatus(0x8140).read_len() == 8);
        assert!(!EepromStatus(0x0040).busy());
        assert!(EepromStatus(0x2040).failed() && EepromStatus(0x2040).no_acknowledge());
        assert!(EepromStatus(0x2020).failed() && !EepromStatus(0x2020).no_acknowledge());
        assert!(EepromStatus(0x4040).failed() && !EepromStatus(0x4040).no_acknowledge());
    }
}
