//! AoE: ADS messages in the mailbox. A message is a [`Header`] of 32 bytes, followed by the data of
//! the command.

/// Bytes of the header.
pub const HEADER_LEN: usize = 32;

/// Target or source of a message: a net id of six bytes and a port of two.
pub type Address = [u8; 8];

/// The header of a message. Fields that are not interpreted here are kept as received.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Header {
    /// The target of the message.
    pub target: Address,
    /// The source of the message.
    pub source: Address,
    /// The command that is requested or answered.
    pub command: u16,
    /// Bit 0: the message is an answer; bit 2: it is an ADS command.
    pub flags: u16,
    /// Number of bytes behind the header.
    pub length: u32,
    /// Error code of the command; 0 without an error.
    pub error: u32,
    /// Number of the request, which its answer repeats.
    pub invoke: u32,
}

impl Header {
    /// Bit of [`flags`](Self::flags): the message is an answer.
    pub const ANSWER: u16 = 1;
    /// [`error`](Self::error): the target has nothing at this port.
    pub const NO_TARGET_PORT: u32 = 6;

    /// Reads the 32 bytes.
    pub fn parse(b: &[u8; HEADER_LEN]) -> Self {
        let eight = |at: usize| core::array::from_fn(|n| b[at + n]);
        let four = |at: usize| u32::from_le_bytes([b[at], b[at + 1], b[at + 2], b[at + 3]]);
        let two = |at: usize| u16::from_le_bytes([b[at], b[at + 1]]);
        Self {
            target: eight(0),
            source: eight(8),
            command: two(16),
            flags: two(18),
            length: four(20),
            error: four(24),
            invoke: four(28),
        }
    }

    /// Writes the 32 bytes.
    pub fn emit(&self) -> [u8; HEADER_LEN] {
        let mut bytes = [0; HEADER_LEN];
        bytes[..8].copy_from_slice(&self.target);
        bytes[8..16].copy_from_slice(&self.source);
        bytes[16..18].copy_from_slice(&self.command.to_le_bytes());
        bytes[18..20].copy_from_slice(&self.flags.to_le_bytes());
        bytes[20..24].copy_from_slice(&self.length.to_le_bytes());
        bytes[24..28].copy_from_slice(&self.error.to_le_bytes());
        bytes[28..].copy_from_slice(&self.invoke.to_le_bytes());
        bytes
    }

    /// The answer that reports failure of this request.
    pub const fn failed(&self, error: u32) -> Self {
        Self {
            target: self.source,
            source: self.target,
            flags: self.flags | Self::ANSWER,
            length: 0,
            error,
            ..*self
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn header_both_ways() {
        let bytes: [u8; HEADER_LEN] = core::array::from_fn(|n| n as u8);
        let header = Header::parse(&bytes);
        assert_eq!((header.command, header.length), (0x1110, 0x1716_1514));
        assert_eq!(header.emit(), bytes);
        let answer = header.failed(Header::NO_TARGET_PORT);
        assert_eq!((answer.target, answer.source), (header.source, header.target));
        assert_eq!((answer.flags, answer.length, answer.invoke), (0x1313, 0, header.invoke));
    }
}
