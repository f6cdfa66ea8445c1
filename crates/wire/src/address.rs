//! The ways to name a place: position, station, port, object.

use core::fmt;

/// A SubDevice by its position in the segment, as the frame carries it.
///
/// The first SubDevice is addressed with 0, the second with 0xFFFF: every ESC adds one in passing,
/// and the ESC that receives 0 is addressed.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct AutoIncrementAddress(pub u16);

impl AutoIncrementAddress {
    /// The address of the SubDevice at `position`, counted from 0 in processing order.
    pub const fn of_position(position: u16) -> Self {
        Self(0u16.wrapping_sub(position))
    }
}

/// A SubDevice by its configured station address (register 0x0010) or, if enabled, its alias.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct StationAddress(pub u16);

impl fmt::Display for StationAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:#06x}", self.0)
    }
}

/// One of the four ports of an ESC. Frames pass 0 → EPU → 3 → 1 → 2 → 0.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub enum PortNumber {
    /// Port 0, the upstream port.
    P0,
    /// Port 1.
    P1,
    /// Port 2.
    P2,
    /// Port 3.
    P3,
}

impl PortNumber {
    /// Ports by number.
    pub const ALL: [PortNumber; 4] = [Self::P0, Self::P1, Self::P2, Self::P3];
    /// Ports in the order in which a frame that entered at port 0 visits them.
    pub const PROCESSING_ORDER: [PortNumber; 4] = [Self::P0, Self::P3, Self::P1, Self::P2];

    /// 0 to 3.
    pub const fn index(self) -> usize {
        self as usize
    }

    /// The port with this number; `None` above 3.
    pub const fn new(number: usize) -> Option<Self> {
        match number {
            0 => Some(Self::P0),
            1 => Some(Self::P1),
            2 => Some(Self::P2),
            3 => Some(Self::P3),
            _ => None,
        }
    }
}

impl fmt::Display for PortNumber {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.index())
    }
}

/// An entry of a SubDevice's object dictionary; printed `0x1C32:0B`.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct ObjectAddress {
    /// Object index.
    pub index: u16,
    /// Sub-index; printed with two hex digits, since the field mixes decimal and hex.
    pub sub: u8,
}

impl ObjectAddress {
    /// Entry `sub` of object `index`.
    pub const fn new(index: u16, sub: u8) -> Self {
        Self { index, sub }
    }
}

impl fmt::Display for ObjectAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "0x{:04X}:{:02X}", self.index, self.sub)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    #[test]
    fn positions_count_down_from_zero() {
        let on_wire = |position| AutoIncrementAddress::of_position(position).0;
        assert_eq!([on_wire(0), on_wire(1), on_wire(2)], [0x0000, 0xFFFF, 0xFFFE]);
    }

    #[test]
    fn objects_print_with_two_hex_digits() {
        assert_eq!(ObjectAddress::new(0x1C32, 11).to_string(), "0x1C32:0B");
    }
}
