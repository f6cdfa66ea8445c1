//! SoE: the servo drive profile in the mailbox. It reads and writes the parameters of drives. A
//! parameter has a number, its IDN, and several elements such as its name and its value.
//!
//! A message is a [`Header`] of four bytes, followed by the elements that it names, in the order of
//! their bits. A value that is longer than the mailbox is sent in fragments, see
//! [`Header::incomplete`]. In an error message an [`ErrorCode`] follows the header.

use core::fmt;

pub mod error;

pub use error::ErrorCode;

/// Bytes of the header.
pub const HEADER_LEN: usize = 4;

/// The kind of a message. The code space is open; 7 is reserved.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Opcode(pub u8);

impl Opcode {
    /// Asks for elements.
    pub const READ_REQUEST: Self = Self(1);
    /// Elements, or the reason why they cannot be read.
    pub const READ_RESPONSE: Self = Self(2);
    /// Writes elements.
    pub const WRITE_REQUEST: Self = Self(3);
    /// The elements were written, or the reason why not.
    pub const WRITE_RESPONSE: Self = Self(4);
    /// A command has ended; unsolicited.
    pub const NOTIFICATION: Self = Self(5);
    /// Emergency, unsolicited.
    pub const EMERGENCY: Self = Self(6);
}

/// The elements of an IDN in a message, one bit each. In the message they are in the order of the
/// bits.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default)]
pub struct Elements(pub u8);

impl Elements {
    /// Data state, 2 bytes.
    pub const DATA_STATE: Self = Self(0x01);
    /// Name: its length and its largest length, 2 bytes each, then the text.
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

/// The number of a parameter. Bit 15 tells whether it belongs to the maker (P) or to the standard
/// (S), bits 14:12 are the parameter set, bits 11:0 the number in it.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct Idn(pub u16);

impl Idn {
    /// S-0-0001: cycle time of the control unit, us.
    pub const CONTROL_CYCLE: Self = Self(1);
    /// S-0-0002: cycle time of the communication, us.
    pub const COMMUNICATION_CYCLE: Self = Self(2);
    /// S-0-0015: telegram type; 7 is the one that is configured by lists.
    pub const TELEGRAM_TYPE: Self = Self(15);
    /// S-0-0016: a list of IDNs, the contents of the inputs behind the drive's status word.
    pub const INPUT_LIST: Self = Self(16);
    /// S-0-0017: a list of all IDNs of a drive.
    pub const ALL_IDNS: Self = Self(17);
    /// S-0-0024: a list of IDNs, the contents of the outputs behind the drive's control word.
    pub const OUTPUT_LIST: Self = Self(24);
    /// S-0-0134: control word of the drive, in front of its outputs.
    pub const CONTROL_WORD: Self = Self(134);
    /// S-0-0135: status word of the drive, in front of its inputs.
    pub const STATUS_WORD: Self = Self(135);
}

/// Prints `S-0-0032`.
impl fmt::Display for Idn {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kind = if self.0 & 0x8000 == 0 { 'S' } else { 'P' };
        write!(f, "{kind}-{}-{:04}", self.0 >> 12 & 7, self.0 & 0x0FFF)
    }
}

/// The format of an IDN's value, and the states in which it can be written. Bits without a name
/// here are kept.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Attribute(pub u32);

impl Attribute {
    /// Length on the wire in bytes.
    pub const LEN: usize = 4;
    /// The value is a list: its length and its largest length in bytes, 2 bytes each, then the
    /// items.
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
    /// The value cannot be written in PREOP.
    pub const PROTECTED_PREOP: Self = Self(1 << 28);
    /// The value cannot be written in SAFEOP.
    pub const PROTECTED_SAFEOP: Self = Self(1 << 29);
    /// The value cannot be written in OP.
    pub const PROTECTED_OP: Self = Self(1 << 30);
    /// The value cannot be written in any state.
    pub const READ_ONLY: Self = Self(7 << 28);

    /// The attribute of a value of 1, 2, 4 or 8 bytes, or of a list of such items; the factor is 1.
    /// `None` for any other length.
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

    /// Number of bytes of the value, or of an item of a list: 1, 2, 4 or 8.
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
    /// Bit 3: fragments follow. [`idn`](Self::idn) is then their number; the last message names the
    /// IDN.
    pub incomplete: bool,
    /// Bit 4: the message is an error, and its code follows the header.
    pub error: bool,
    /// Bits 7:5: the drive of the SubDevice, 0 to 7.
    pub drive: u8,
    /// The elements that are read or written.
    pub elements: Elements,
    /// The parameter, or the number of fragments that follow.
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
    /// Writes the four bytes.
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
