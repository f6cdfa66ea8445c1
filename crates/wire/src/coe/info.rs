//! SDO information: the services that describe the object dictionary.

/// Bytes before the data of an information message.
pub const HEADER_LEN: usize = 4;

/// The kind of an information message. The code space is open.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Opcode(pub u8);

impl Opcode {
    /// Request: list of object indices.
    pub const LIST_REQUEST: Self = Self(1);
    /// Response: list of object indices.
    pub const LIST_RESPONSE: Self = Self(2);
    /// Request: an object's description.
    pub const OBJECT_REQUEST: Self = Self(3);
    /// Response: an object's description.
    pub const OBJECT_RESPONSE: Self = Self(4);
    /// Request: an entry's description.
    pub const ENTRY_REQUEST: Self = Self(5);
    /// Response: an entry's description.
    pub const ENTRY_RESPONSE: Self = Self(6);
    /// Response: an abort code.
    pub const ERROR: Self = Self(7);
}

/// The four bytes before the data of an information message.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Header {
    /// Bits 6:0.
    pub opcode: Opcode,
    /// Bit 7: fragments follow.
    pub incomplete: bool,
    /// Number of fragments that follow.
    pub fragments_left: u16,
}

impl Header {
    /// Reads the four bytes.
    pub const fn parse(b: &[u8; HEADER_LEN]) -> Self {
        Self {
            opcode: Opcode(b[0] & 0x7F),
            incomplete: b[0] & 0x80 != 0,
            fragments_left: u16::from_le_bytes([b[2], b[3]]),
        }
    }
    /// Writes the four bytes.
    pub const fn emit(self) -> [u8; HEADER_LEN] {
        let f = self.fragments_left.to_le_bytes();
        [self.opcode.0 & 0x7F | (self.incomplete as u8) << 7, 0, f[0], f[1]]
    }
}

/// The kinds of object lists.
pub mod list_type {
    /// The lengths of the five lists.
    pub const LENGTHS: u16 = 0;
    /// All objects.
    pub const ALL: u16 = 1;
    /// Objects that can be mapped into an RxPDO.
    pub const RX_MAPPABLE: u16 = 2;
    /// Objects that can be mapped into a TxPDO.
    pub const TX_MAPPABLE: u16 = 3;
    /// Objects for backup.
    pub const BACKUP: u16 = 4;
    /// Objects for settings.
    pub const SETTINGS: u16 = 5;
}

/// Kind of an object.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct ObjectCode(pub u8);

impl ObjectCode {
    /// A single value.
    pub const VAR: Self = Self(7);
    /// Entries of one type.
    pub const ARRAY: Self = Self(8);
    /// Entries of several types.
    pub const RECORD: Self = Self(9);
}

/// The access rights of an entry in each state; the access word of an entry description.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default)]
pub struct Access(pub u16);

impl Access {
    /// Read in PREOP, SAFEOP and OP.
    pub const READ: Self = Self(0x0007);
    /// Write in PREOP.
    pub const WRITE_PREOP: Self = Self(0x0008);
    /// Write in SAFEOP.
    pub const WRITE_SAFEOP: Self = Self(0x0010);
    /// Write in OP.
    pub const WRITE_OP: Self = Self(0x0020);
    /// Write in all three states.
    pub const WRITE: Self = Self(0x0038);
    /// Mappable into an RxPDO.
    pub const RX_MAPPABLE: Self = Self(0x0040);
    /// Mappable into a TxPDO.
    pub const TX_MAPPABLE: Self = Self(0x0080);
    /// Part of a backup.
    pub const BACKUP: Self = Self(0x0100);
    /// Part of the settings.
    pub const SETTINGS: Self = Self(0x0200);

    /// Both sets of rights.
    pub const fn with(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
    /// Whether all rights of `other` are among these.
    pub const fn has(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }
    /// Whether some right of `other` is among these.
    pub const fn has_any(self, other: Self) -> bool {
        self.0 & other.0 != 0
    }
}

/// Head of an object description response, before the name.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct ObjectDescription {
    /// Index.
    pub index: u16,
    /// Type code of the object.
    pub data_type: u16,
    /// Highest sub-index.
    pub max_sub: u8,
    /// Kind.
    pub code: ObjectCode,
}

impl ObjectDescription {
    /// Bytes before the name.
    pub const LEN: usize = 6;
    /// Reads the bytes before the name.
    pub const fn parse(b: &[u8; Self::LEN]) -> Self {
        Self {
            index: u16::from_le_bytes([b[0], b[1]]),
            data_type: u16::from_le_bytes([b[2], b[3]]),
            max_sub: b[4],
            code: ObjectCode(b[5]),
        }
    }
    /// Writes the bytes before the name.
    pub const fn emit(&self) -> [u8; Self::LEN] {
        let (i, t) = (self.index.to_le_bytes(), self.data_type.to_le_bytes());
        [i[0], i[1], t[0], t[1], self.max_sub, self.code.0]
    }
}

/// Head of an entry description response, before unit, default, minimum, maximum and name.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct EntryDescription {
    /// Index.
    pub index: u16,
    /// Sub-index.
    pub sub: u8,
    /// Optional parts that follow: bit 3 unit, 4 default, 5 minimum, 6 maximum.
    pub value_info: u8,
    /// Type code; 0 for a gap.
    pub data_type: u16,
    /// Length of the value in bits.
    pub bits: u16,
    /// Access word.
    pub access: Access,
}

impl EntryDescription {
    /// Bytes before the optional parts.
    pub const LEN: usize = 10;
    /// Reads the bytes before the optional parts.
    pub const fn parse(b: &[u8; Self::LEN]) -> Self {
        Self {
            index: u16::from_le_bytes([b[0], b[1]]),
            sub: b[2],
            value_info: b[3],
            data_type: u16::from_le_bytes([b[4], b[5]]),
            bits: u16::from_le_bytes([b[6], b[7]]),
            access: Access(u16::from_le_bytes([b[8], b[9]])),
        }
    }
    /// Writes the bytes before the optional parts.
    pub const fn emit(&self) -> [u8; Self::LEN] {
        let i = self.index.to_le_bytes();
        let t = self.data_type.to_le_bytes();
        let l = self.bits.to_le_bytes();
        let a = self.access.0.to_le_bytes();
        [i[0], i[1], self.sub, self.value_info, t[0], t[1], l[0], l[1], a[0], a[1]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn descriptions_both_ways() {
        let entry = [0x32, 0x1C, 0x02, 0, 0x07, 0, 32, 0, 0x07, 0];
        let parsed = EntryDescription::parse(&entry);
        assert_eq!((parsed.index, parsed.sub, parsed.bits), (0x1C32, 2, 32));
        assert!(parsed.access.has(Access::READ) && !parsed.access.has_any(Access::WRITE));
        assert_eq!(parsed.emit(), entry);
        let object = [0x32, 0x1C, 0x29, 0, 32, 9];
        assert_eq!(ObjectDescription::parse(&object).emit(), object);
        let header = Header { opcode: Opcode::LIST_RESPONSE, incomplete: true, fragments_left: 3 };
        assert_eq!(header.emit(), [0x82, 0, 3, 0]);
        assert_eq!(Header::parse(&header.emit()), header);
    }
}
