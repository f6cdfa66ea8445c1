//! FoE: file access in the mailbox. A message is a [`Header`] of six bytes, followed by a name
//! (requests), by data, or by a text (errors, busy).

use core::fmt;

/// Bytes of the header.
pub const HEADER_LEN: usize = 6;

/// The kind of a message. The code space is open.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Opcode(pub u8);

impl Opcode {
    /// Asks for a file.
    pub const READ: Self = Self(1);
    /// Announces a file.
    pub const WRITE: Self = Self(2);
    /// A packet of the file.
    pub const DATA: Self = Self(3);
    /// The packet was accepted.
    pub const ACK: Self = Self(4);
    /// The transfer has failed.
    pub const ERROR: Self = Self(5);
    /// The packet must be sent again later.
    pub const BUSY: Self = Self(6);
}

/// The six bytes before the rest of a message.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Header {
    /// The kind of the message.
    pub opcode: Opcode,
    /// Password of a request, number of a packet, or an [`ErrorCode`].
    pub number: u32,
}

impl Header {
    /// Reads the six bytes; the second one is reserved and dropped.
    pub const fn parse(b: &[u8; HEADER_LEN]) -> Self {
        Self { opcode: Opcode(b[0]), number: u32::from_le_bytes([b[2], b[3], b[4], b[5]]) }
    }
    /// Writes the six bytes.
    pub const fn emit(self) -> [u8; HEADER_LEN] {
        let n = self.number.to_le_bytes();
        [self.opcode.0, 0, n[0], n[1], n[2], n[3]]
    }
}

/// The reason why a transfer failed. The code space is open, so unknown codes are kept.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct ErrorCode(pub u32);

impl ErrorCode {
    /// Not defined.
    pub const NOT_DEFINED: Self = Self(0x8000);
    /// The file does not exist.
    pub const NOT_FOUND: Self = Self(0x8001);
    /// The file cannot be read or written.
    pub const ACCESS_DENIED: Self = Self(0x8002);
    /// The message does not belong to a transfer.
    pub const ILLEGAL: Self = Self(0x8004);
}

/// Prints `FoE error 0x8001 (not found)`.
impl fmt::Display for ErrorCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let meaning = match self.0 {
            0x8000 => "not defined",
            0x8001 => "not found",
            0x8002 => "access denied",
            0x8003 => "disk full",
            0x8004 => "illegal",
            0x8005 => "packet number wrong",
            0x8006 => "file exists",
            0x8007 => "no user",
            0x8008 => "in BOOT only",
            0x8009 => "not in BOOT",
            0x800A => "no rights",
            0x800B => "program error",
            _ => "a code of the vendor",
        };
        write!(f, "FoE error 0x{:04X} ({meaning})", self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn header_both_ways() {
        let bytes = [5, 0, 0x01, 0x80, 0, 0];
        let header = Header::parse(&bytes);
        assert_eq!(header, Header { opcode: Opcode::ERROR, number: ErrorCode::NOT_FOUND.0 });
        assert_eq!(header.emit(), bytes);
    }
}
