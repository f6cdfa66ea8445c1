//! The data link layer: the state of the ports.

use crate::address::PortNumber;
use crate::register::newtype_value;

/// DL status, register 0x0110.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct DlStatus(pub u16);
newtype_value!(DlStatus u16 2);

impl DlStatus {
    /// EEPROM loaded, PDI operational.
    pub const PDI_OPERATIONAL: u16 = 1 << 0;
    /// PDI watchdog not expired.
    pub const PDI_WATCHDOG: u16 = 1 << 1;
    /// Enhanced link detection on for a port.
    pub const ENHANCED_LINK: u16 = 1 << 2;

    /// Bits 4..7: a physical link at this port.
    pub const fn link(self, port: PortNumber) -> bool {
        self.0 & 1 << (4 + port.index()) != 0
    }
    /// Bits 8, 10, 12, 14: the loop at this port is closed, so frames turn around here.
    pub const fn loop_closed(self, port: PortNumber) -> bool {
        self.0 & 1 << (8 + 2 * port.index()) != 0
    }
    /// Bits 9, 11, 13, 15: communication established at this port.
    pub const fn communication(self, port: PortNumber) -> bool {
        self.0 & 1 << (9 + 2 * port.index()) != 0
    }
    /// Whether frames leave through this port.
    pub const fn open(self, port: PortNumber) -> bool {
        self.communication(port) && !self.loop_closed(port)
    }
    /// The same status with the bits of one port replaced.
    pub const fn with_port(
        self,
        port: PortNumber,
        link: bool,
        closed: bool,
        communication: bool,
    ) -> Self {
        let p = port.index();
        let mask = 1 << (4 + p) | 0b11 << (8 + 2 * p);
        let bits = (link as u16) << (4 + p)
            | (closed as u16) << (8 + 2 * p)
            | (communication as u16) << (9 + 2 * p);
        Self(self.0 & !mask | bits)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use PortNumber::*;

    /// Facts vector 14: a LAN9252 in the middle of a line and one at its end.
    #[test]
    fn captured_values() {
        let open = |status: DlStatus| PortNumber::ALL.map(|port| status.open(port));
        assert_eq!(open(DlStatus(0x5A37)), [true, true, false, false]);
        assert_eq!(open(DlStatus(0x5617)), [true, false, false, false]);
        let middle = DlStatus(0x0007)
            .with_port(P0, true, false, true)
            .with_port(P1, true, false, true)
            .with_port(P2, false, true, false)
            .with_port(P3, false, true, false);
        assert_eq!(middle, DlStatus(0x5A37));
    }
}
