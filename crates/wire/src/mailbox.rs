//! The mailbox: the acyclic channel through SM0 and SM1.

use core::fmt;

/// Bytes of the mailbox header.
pub const HEADER_LEN: usize = 6;

/// A protocol in the mailbox. The code space is open.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Protocol(pub u8);

impl Protocol {
    /// Mailbox error message.
    pub const ERROR: Self = Self(0);
    /// ADS over EtherCAT.
    pub const AOE: Self = Self(1);
    /// Ethernet over EtherCAT.
    pub const EOE: Self = Self(2);
    /// CANopen over EtherCAT.
    pub const COE: Self = Self(3);
    /// File access over EtherCAT.
    pub const FOE: Self = Self(4);
    /// Servo drive profile over EtherCAT.
    pub const SOE: Self = Self(5);
    /// Vendor specific.
    pub const VOE: Self = Self(15);

    /// The bit by which SII word 0x1C announces the protocol; 0 if no bit does.
    pub const fn announcement(self) -> u16 {
        match self {
            Self::AOE => 1,
            Self::EOE => 1 << 1,
            Self::COE => 1 << 2,
            Self::FOE => 1 << 3,
            Self::SOE => 1 << 4,
            Self::VOE => 1 << 5,
            _ => 0,
        }
    }
}

/// The six bytes before a mailbox service.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Header {
    /// Number of bytes of the service behind this header.
    pub length: u16,
    /// Station address of the source (of the destination, if the MainDevice sends); 0 is the
    /// MainDevice.
    pub address: u16,
    /// Channel (bits 5:0) and priority (bits 7:6).
    pub channel: u8,
    /// The protocol of the service.
    pub protocol: Protocol,
    /// Counts the services of one direction, 1..=7; 0 switches the duplicate check off.
    pub counter: u8,
    /// Reserved bit 7 of the last byte, kept as received.
    pub reserved: bool,
}

impl Header {
    /// A header with default channel and priority.
    pub const fn new(length: u16, address: u16, protocol: Protocol, counter: u8) -> Self {
        Self { length, address, channel: 0, protocol, counter, reserved: false }
    }
    /// Reads the six bytes.
    pub const fn parse(b: &[u8; HEADER_LEN]) -> Self {
        Self {
            length: u16::from_le_bytes([b[0], b[1]]),
            address: u16::from_le_bytes([b[2], b[3]]),
            channel: b[4],
            protocol: Protocol(b[5] & 0x0F),
            counter: b[5] >> 4 & 0x07,
            reserved: b[5] & 0x80 != 0,
        }
    }
    /// Writes the six bytes.
    pub const fn emit(&self) -> [u8; HEADER_LEN] {
        let (l, a) = (self.length.to_le_bytes(), self.address.to_le_bytes());
        let last = self.protocol.0 & 0x0F | (self.counter & 7) << 4 | (self.reserved as u8) << 7;
        [l[0], l[1], a[0], a[1], self.channel, last]
    }
}

/// The counter that follows `counter`: 1 to 7, then 1 again.
pub const fn next_counter(counter: u8) -> u8 {
    if counter >= 7 { 1 } else { counter + 1 }
}

/// Detail of a mailbox error message. The code space is open.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct ErrorDetail(pub u16);

impl ErrorDetail {
    /// The syntax of the six-byte header is wrong.
    pub const SYNTAX: Self = Self(1);
    /// The protocol is not supported.
    pub const UNSUPPORTED_PROTOCOL: Self = Self(2);
    /// The channel field is wrong.
    pub const INVALID_CHANNEL: Self = Self(3);
    /// The service of the protocol is not supported.
    pub const SERVICE_NOT_SUPPORTED: Self = Self(4);
    /// The header of the protocol is wrong.
    pub const INVALID_HEADER: Self = Self(5);
    /// The data are too short.
    pub const SIZE_TOO_SHORT: Self = Self(6);
    /// There is no memory left.
    pub const NO_MEMORY: Self = Self(7);
    /// The length of the data is inconsistent.
    pub const INVALID_SIZE: Self = Self(8);
    /// A service is already being processed.
    pub const SERVICE_IN_WORK: Self = Self(9);

    /// Writes the four data bytes of the message.
    pub const fn emit(self) -> [u8; 4] {
        let d = self.0.to_le_bytes();
        [1, 0, d[0], d[1]]
    }
    /// Reads the four data bytes of the message.
    pub const fn parse(b: &[u8; 4]) -> Self {
        Self(u16::from_le_bytes([b[2], b[3]]))
    }
}

impl fmt::Display for ErrorDetail {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let text = match self.0 {
            1 => "syntax error",
            2 => "protocol not supported",
            3 => "invalid channel",
            4 => "service not supported",
            5 => "invalid header",
            6 => "size too short",
            7 => "no memory",
            8 => "invalid size",
            9 => "service in work",
            _ => "unknown detail",
        };
        write!(f, "mailbox error {} ({text})", self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The header of facts vector 18.
    #[test]
    fn captured_header() {
        let bytes = [0x0A, 0, 0, 0, 0, 0x13];
        let header = Header::parse(&bytes);
        assert_eq!(header, Header::new(10, 0, Protocol::COE, 1));
        assert_eq!(header.emit(), bytes);
    }

    #[test]
    fn counters_skip_zero() {
        assert_eq!([0, 1, 6, 7].map(next_counter), [1, 2, 7, 1]);
    }
}
