//! EoE: Ethernet frames in the mailbox, and the settings of the port behind it. A message is a
//! [`Header`] of four bytes, followed by a fragment of a frame or by a setting.

/// Bytes of the header.
pub const HEADER_LEN: usize = 4;

/// The kind of a message, 4 bits. The code space is open.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Kind(pub u8);

impl Kind {
    /// A fragment of an Ethernet frame.
    pub const FRAGMENT: Self = Self(0);
    /// Sets the address of the port (IP, MAC).
    pub const SET_ADDRESS: Self = Self(2);
    /// The outcome of setting the address.
    pub const ADDRESS_SET: Self = Self(3);
    /// Sets the filters of the port.
    pub const SET_FILTER: Self = Self(4);
    /// The outcome of setting the filters.
    pub const FILTER_SET: Self = Self(5);
    /// Asks for the address of the port.
    pub const READ_ADDRESS: Self = Self(6);
    /// The address, or an outcome that there is none.
    pub const ADDRESS: Self = Self(7);
    /// Asks for the filters of the port.
    pub const READ_FILTER: Self = Self(8);
    /// The filters, or an outcome that there are none.
    pub const FILTER: Self = Self(9);
}

/// The outcome of a setting. The code space is open.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Outcome(pub u16);

impl Outcome {
    /// Done.
    pub const SUCCESS: Self = Self(0);
    /// The port has no IP address.
    pub const NO_IP: Self = Self(0x0201);
    /// The port has no filters.
    pub const NO_FILTER: Self = Self(0x0401);
}

/// The four bytes before the rest of a message.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Header {
    /// Bits 3:0.
    pub kind: Kind,
    /// Bits 7:4: the port; 0 for any.
    pub port: u8,
    /// Bits 15:8: last fragment (bit 8), time appended (9) and asked for (10); the others are
    /// reserved.
    pub flags: u8,
    /// Bits 31:16: the position of a fragment, or an [`Outcome`].
    pub word: u16,
}

impl Header {
    /// Reads the four bytes.
    pub const fn parse(b: &[u8; HEADER_LEN]) -> Self {
        Self {
            kind: Kind(b[0] & 0x0F),
            port: b[0] >> 4,
            flags: b[1],
            word: u16::from_le_bytes([b[2], b[3]]),
        }
    }
    /// Writes the four bytes.
    pub const fn emit(self) -> [u8; HEADER_LEN] {
        let w = self.word.to_le_bytes();
        [self.kind.0 & 0x0F | self.port << 4, self.flags, w[0], w[1]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn header_both_ways() {
        let bytes = [0x13, 0x01, 0x01, 0x02];
        let header = Header::parse(&bytes);
        assert_eq!((header.kind, header.port), (Kind::ADDRESS_SET, 1));
        assert_eq!(header.word, Outcome::NO_IP.0);
        assert_eq!(header.emit(), bytes);
    }
}
