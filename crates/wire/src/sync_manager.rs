//! The registers of a SyncManager.

use crate::register::Value;

/// The eight bytes of SyncManager y at 0x0800 + 8 y.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct SyncManager {
    /// First byte of the guarded area.
    pub start: u16,
    /// Bytes of the area.
    pub length: u16,
    /// Mode, direction, events, watchdog trigger; see the constants.
    pub control: u8,
    /// Read-only: see the `STATUS_…` constants.
    pub status: u8,
    /// Bit 0 enable, bit 1 repeat request.
    pub activate: u8,
    /// Bit 0 deactivated by the PDI, bit 1 repeat acknowledge.
    pub pdi_control: u8,
}

impl SyncManager {
    /// Control: mailbox, MainDevice writes, interrupt to the PDI.
    pub const MAILBOX_OUT: u8 = 0x26;
    /// Control: mailbox, MainDevice reads, interrupt to the PDI.
    pub const MAILBOX_IN: u8 = 0x22;
    /// Control: three buffers, MainDevice writes, interrupt to the PDI, watchdog trigger.
    pub const OUTPUTS: u8 = 0x64;
    /// Control: three buffers, MainDevice reads, interrupt to the PDI.
    pub const INPUTS: u8 = 0x20;
    /// Control bits 1:0: one buffer with handshake (mailbox) instead of three.
    pub const CONTROL_MAILBOX: u8 = 0x02;
    /// Control bits 3:2: the MainDevice writes.
    pub const CONTROL_ECAT_WRITES: u8 = 0x04;
    /// Control bit 4: interrupt to the ECAT event request.
    pub const CONTROL_ECAT_EVENT: u8 = 0x10;
    /// Control bit 5: interrupt to the AL event request.
    pub const CONTROL_AL_EVENT: u8 = 0x20;
    /// Control bit 6: a completed write restarts the process data watchdog.
    pub const CONTROL_WATCHDOG: u8 = 0x40;
    /// Status bit 0: completely written.
    pub const STATUS_WRITTEN: u8 = 0x01;
    /// Status bit 1: completely read.
    pub const STATUS_READ: u8 = 0x02;
    /// Status bit 3: mailbox full.
    pub const STATUS_FULL: u8 = 0x08;
    /// Status bits 5:4: buffer last written, 3 for none.
    pub const STATUS_BUFFER: u8 = 0x30;
    /// Status bit 6: the read buffer is in use.
    pub const STATUS_READING: u8 = 0x40;
    /// Status bit 7: the write buffer is in use.
    pub const STATUS_WRITING: u8 = 0x80;
    /// Activate bit 0.
    pub const ENABLE: u8 = 0x01;
    /// Activate bit 1: repeat request, toggled by the MainDevice.
    pub const REPEAT: u8 = 0x02;
    /// Activate bit 6: record the time when ECAT exchanges a buffer (0x09F0).
    pub const LATCH_ECAT: u8 = 0x40;
    /// Activate bit 7: record the time when the PDI opens (0x09F8) or exchanges (0x09FC) a buffer.
    pub const LATCH_PDI: u8 = 0x80;

    /// A configuration as a MainDevice writes it.
    pub const fn new(start: u16, length: u16, control: u8, enable: bool) -> Self {
        Self { start, length, control, status: 0, activate: enable as u8, pdi_control: 0 }
    }
    /// Whether the MainDevice enabled it.
    pub const fn is_enabled(&self) -> bool {
        self.activate & Self::ENABLE != 0
    }
    /// Whether it has one buffer with handshake.
    pub const fn is_mailbox(&self) -> bool {
        self.control & 0x03 == Self::CONTROL_MAILBOX
    }
    /// Whether the MainDevice writes and the PDI reads.
    pub const fn is_ecat_write(&self) -> bool {
        self.control & 0x0C == Self::CONTROL_ECAT_WRITES
    }
    /// The address behind the guarded area.
    pub const fn end(&self) -> u32 {
        self.start as u32 + self.length as u32
    }
}

impl Value for SyncManager {
    type Bytes = [u8; 8];
    const LEN: usize = 8;
    fn from_bytes(b: [u8; 8]) -> Self {
        Self {
            start: u16::from_le_bytes([b[0], b[1]]),
            length: u16::from_le_bytes([b[2], b[3]]),
            control: b[4],
            status: b[5],
            activate: b[6],
            pdi_control: b[7],
        }
    }
    fn to_bytes(self) -> [u8; 8] {
        let (s, l) = (self.start.to_le_bytes(), self.length.to_le_bytes());
        [s[0], s[1], l[0], l[1], self.control, self.status, self.activate, self.pdi_control]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn usual_controls_decode() {
        let sm = |control| SyncManager::new(0x1000, 128, control, true);
        assert!(sm(SyncManager::MAILBOX_OUT).is_mailbox());
        assert!(sm(SyncManager::MAILBOX_OUT).is_ecat_write());
        assert!(!sm(SyncManager::MAILBOX_IN).is_ecat_write());
        assert!(!sm(SyncManager::OUTPUTS).is_mailbox());
        assert!(sm(SyncManager::OUTPUTS).is_ecat_write());
        let bytes = [0x00, 0x10, 0x80, 0x00, 0x26, 0x00, 0x01, 0x00];
        assert_eq!(SyncManager::from_bytes(bytes), sm(0x26));
        assert_eq!(sm(0x26).to_bytes(), bytes);
    }
}
