//! SoE: the servo drive profile in the mailbox. It reads and writes the parameters of drives, each of which has a
//! number, its IDN, and several elements such as its name and its value.
//!
//! A message is a [`Header`] of four bytes, and behind it the elements that it names, in the order of their bits. A
//! value that is longer than the mailbox goes in fragments, see [`Header::incomplete`]. An [`ErrorCode`] stands
//! behind the header of a message that is an error.

use core::fmt;

pub mod error;

pub use error::ErrorCode;

/// Bytes of the header.
pub const HEADER_LEN: usize = 4;

/// What a message is. The code space is open; 7 is reserved.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Opcode(pub u8);

impl Opcode {
    /// Elements are asked for.
    pub const READ_REQUEST: Self = Self(1);
    /// Elements, or why they can't be read.
    pub const READ_RESPONSE: Self = Self(2);
    /// Elements are written.
    pub const WRITE_REQUEST: Self = Self(3);
    /// Elements were written, or why not.
    pub const WRITE_RESPONSE: Self = Self(4);
    /// A command has ended; unsolicited.
    pub const NOTIFICATION: Self = Self(5);
    /// Emergency, unsolicited.
    pub const EMERGENCY: Self = Self(6);
}

/// Which elements of an IDN a message has, one bit each. In a message they stand in the order of the bits.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default)]
pub struct Elements(pub u8);

impl Elements {
    /// Data state, 2 bytes.
    pub const DATA_STATE: Self = Self(0x01);
    /// Name: its length and the most that it can have, 2 bytes each, then the text.
    pub const NAME: Self = Self(0x02);
    /// [`Attribute`], 4 bytes.
    pub const ATTRIBUTE: Self = Self(0x04);
    /// Unit, in the form of the name.
    pub const UNIT: Self = Self(0x08);
    /// Least value.
    pub const MINIMUM: Self = Self(0x10);
    /// Greatest value.
    pub const MAXIMUM: Self = Self(0x20);
    /// The value itself (operation data).
    pub const VALUE: Self = Self(0x40);
    /// Value after power-on.
    pub const DEFAULT: Self = Self(0x80);

    /// Each element alone, in the order in which a message has them.
    pub fn each(self) -> impl Iterator<Item = Self> {
        (0..u8::BITS).map(|bit| Self(1 << bit)).filter(move |one| self.0 & one.0 != 0)
    }
}

/// The number of a parameter: bit 15 tells those of the maker (P) from those of the standard (S), bits 14:12 are the
/// parameter set, bits 11:0 the number in it.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct Idn(pub u16);

impl Idn {
    /// S-0-0001: cycle time of the control unit, us.
    pub const CONTROL_CYCLE: Self = Self(1);
    /// S-0-0002: cycle time of the communication, us.
    pub const COMMUNICATION_CYCLE: Self = Self(2);
    /// S-0-0015: telegram type; 7 is the one that lists configure.
    pub const TELEGRAM_TYPE: Self = Self(15);
    /// S-0-0016: what the inputs have behind the drive's status word, a list of IDNs.
    pub const INPUT_LIST: Self = Self(16);
    /// S-0-0017: all IDNs of a drive, a list of them.
    pub const ALL_IDNS: Self = Self(17);
    /// S-0-0024: what the outputs have behind the drive's control word, a list of IDNs.
    pub const OUTPUT_LIST: Self = Self(24);
    /// S-0-0134: control word of the drive, in front of its outputs.
    pub const CONTROL_WORD: Self = Self(134);
    /// S-0-0135: status word of the drive, in front of its inputs.
    pub const STATUS_WORD: Self = Self(135);
}

/// `S-0-0032`
impl fmt::Display for Idn {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kind = if self.0 & 0x8000 == 0 { 'S' } else { 'P' };
        write!(f, "{kind}-{}-{:04}", self.0 >> 12 & 7, self.0 & 0x0FFF)
    }
}

/// How the value of an IDN is to be understood, and when it can be written. Bits that have no name here are kept.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Attribute(pub u32);

impl Attribute {
    /// Bytes on the wire.
    pub const LEN: usize = 4;
    /// The value is a list: its length and the most that it can have, 2 bytes each, in bytes; then the items.
    pub const LIST: Self = Self(1 << 18);
    /// The value is the state of a command.
    pub const COMMAND: Self = Self(1 << 19);
    /// Items are shown as bits.
    pub const BINARY: Self = Self(0);
    /// Items are shown as numbers without sign.
    pub const UNSIGNED: Self = Self(1 << 20);
    /// Items are shown as numbers with sign.
    pub const SIGNED: Self = Self(2 << 20);
    /// Items are IDNs.
    pub const IDN: Self = Self(5 << 20);
    /// It can't be written in PREOP.
    pub const PROTECTED_PREOP: Self = Self(1 << 28);
    /// It can't be written in SAFEOP.
    pub const PROTECTED_SAFEOP: Self = Self(1 << 29);
    /// It can't be written in OP.
    pub const PROTECTED_OP: Self = Self(1 << 30);
    /// It can't be written in any state.
    pub const READ_ONLY: Self = Self(7 << 28);

    /// The attribute of a value of 1, 2, 4 or 8 bytes, or of a list of such items; the factor is 1. `None` for any
    /// other length.
    pub const fn of_length(bytes: usize) -> Option<Self> {
        let code = match bytes {
            1 => 0,
            2 => 1,
            4 => 2,
            8 => 3,
            _ => return None,
        };
        Some(Self(1 | code << 16))
    }

    /// Both sets of bits.
    pub const fn with(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// Whether all bits of `other` are among these.
    pub const fn has(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// Bytes of the value, or of an item of a list: 1, 2, 4 or 8.
    pub const fn length(self) -> usize {
        1 << (self.0 >> 16 & 3)
    }

    /// Whether the value is a list.
    pub const fn is_list(self) -> bool {
        self.has(Self::LIST)
    }
}

/// The four bytes before the elements.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Header {
    /// Bits 2:0 of the first byte.
    pub opcode: Opcode,
    /// Bit 3: fragments follow. Then [`idn`](Self::idn) is the number of those that follow; the last message names the IDN.
    pub incomplete: bool,
    /// Bit 4: an error, of which the code stands behind the header.
    pub error: bool,
    /// Bits 7:5: which drive of the SubDevice, 0 to 7.
    pub drive: u8,
    /// What is read or written.
    pub elements: Elements,
    /// The parameter; the number of fragments that follow if there are some.
    pub idn: Idn,
}

impl Header {
    /// A request for elements of an IDN, or the last fragment of one.
    pub const fn new(opcode: Opcode, drive: u8, elements: Elements, idn: Idn) -> Self {
        Self { opcode, incomplete: false, error: false, drive, elements, idn }
    }
    /// Reads the four bytes.
    pub const fn parse(b: &[u8; HEADER_LEN]) -> Self {
        Self {
            opcode: Opcode(b[0] & 0x07),
            incomplete: b[0] & 0x08 != 0,
            error: b[0] & 0x10 != 0,
            drive: b[0] >> 5,
            elements: Elements(b[1]),
            idn: Idn(u16::from_le_bytes([b[2], b[3]])),
        }
    }
    /// The four bytes.
    pub const fn emit(self) -> [u8; HEADER_LEN] {
        let first = self.opcode.0 & 0x07
            | (self.incomplete as u8) << 3
            | (self.error as u8) << 4
            | self.drive << 5;
        let idn = self.idn.0.to_le_bytes();
        [first, self.elements.0, idn[0], idn[1]]
    }
}

#[cfg(test)]
mod tests {
    use std::string::ToString;
    use std::vec::Vec;

    use super::*;

    #[test]
    fn header_both_ways() {
        let bytes = [0x5A, 0x42, 0x0A, 0x80];
        let header = Header::parse(&bytes);
        assert_eq!(header.opcode, Opcode::READ_RESPONSE);
        assert_eq!((header.incomplete, header.error, header.drive), (true, true, 2));
        assert_eq!(header.elements.each().collect::<Vec<_>>(), [Elements::NAME, Elements::VALUE]);
        assert_eq!(header.emit(), bytes);
    }

    #[test]
    fn names_of_numbers() {
        let name = |number| Idn(number).to_string();
        assert_eq!([32, 0x7FFF, 0x800A].map(name), ["S-0-0032", "S-7-4095", "P-0-0010"]);
    }

    #[test]
    fn lengths_are_powers_of_two() {
        let both = |bytes| Attribute::of_length(bytes).map(Attribute::length);
        assert_eq!([1, 2, 4, 8].map(both), [Some(1), Some(2), Some(4), Some(8)]);
        assert_eq!([0, 3, 5, 9].map(both), [None; 4]);
    }
}
