//! One command in a frame: header, data, working counter.

use core::fmt;

use crate::address::{AutoIncrementAddress, StationAddress};
use crate::command::{Command, UnknownCommand};

/// Bytes of a datagram header.
pub const HEADER_LEN: usize = 10;
/// Bytes of the working counter behind the data.
pub const WKC_LEN: usize = 2;
/// Largest number of data bytes in one datagram of an Ethernet frame without VLAN tag.
pub const MAX_DATA_LEN: usize = 1486;

/// The ten bytes before a datagram's data.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Header {
    /// The command, kept raw so that unknown commands pass unchanged; see [`Header::command`].
    pub command: u8,
    /// The MainDevice's own tag; no ESC changes it.
    pub index: u8,
    /// ADP in the low half and ADO in the high half, or a 32-bit logical address.
    pub address: u32,
    /// Data bytes, 0..=2047.
    pub len: u16,
    /// Reserved bits 13:11 of the length word, kept as received.
    pub reserved: u8,
    /// The frame has passed an automatically closed port 0 once.
    pub circulating: bool,
    /// Another datagram follows.
    pub more: bool,
    /// The ECAT events of all ESCs passed, OR-ed (register 0x0210 masked by 0x0200).
    pub irq: u16,
}

impl Header {
    /// A header as a MainDevice sends it.
    pub fn new(command: Command, index: u8, address: Address, len: u16) -> Self {
        Self {
            command: command as u8,
            index,
            address: address.raw(),
            len,
            reserved: 0,
            circulating: false,
            more: false,
            irq: 0,
        }
    }

    /// The command, or the unknown code.
    pub fn command(&self) -> Result<Command, UnknownCommand> {
        Command::try_from(self.command)
    }

    /// Address position: auto-increment position or station address.
    pub const fn adp(&self) -> u16 {
        self.address as u16
    }

    /// Address offset: register or memory address.
    pub const fn ado(&self) -> u16 {
        (self.address >> 16) as u16
    }

    /// Reads the ten bytes.
    pub fn parse(bytes: &[u8; HEADER_LEN]) -> Self {
        let length = u16::from_le_bytes([bytes[6], bytes[7]]);
        Self {
            command: bytes[0],
            index: bytes[1],
            address: u32::from_le_bytes([bytes[2], bytes[3], bytes[4], bytes[5]]),
            len: length & 0x07FF,
            reserved: (length >> 11 & 0x7) as u8,
            circulating: length & 0x4000 != 0,
            more: length & 0x8000 != 0,
            irq: u16::from_le_bytes([bytes[8], bytes[9]]),
        }
    }

    /// Writes the ten bytes.
    pub fn emit(&self) -> [u8; HEADER_LEN] {
        let length = self.len & 0x07FF
            | u16::from(self.reserved & 0x7) << 11
            | u16::from(self.circulating) << 14
            | u16::from(self.more) << 15;
        let (a, l, i) = (self.address.to_le_bytes(), length.to_le_bytes(), self.irq.to_le_bytes());
        [self.command, self.index, a[0], a[1], a[2], a[3], l[0], l[1], i[0], i[1]]
    }
}

/// The SubDevices or the memory that a datagram addresses.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum Address {
    /// By position, then register or memory address (APxx, ARMW).
    Position(AutoIncrementAddress, u16),
    /// By station address, then register or memory address (FPxx, FRMW).
    Station(StationAddress, u16),
    /// All SubDevices, register or memory address (BRD, BWR, BRW).
    Broadcast(u16),
    /// An address of the logical process image (LRD, LWR, LRW).
    Logical(u32),
}

impl Address {
    /// The four bytes of the header, as a little-endian number.
    pub const fn raw(self) -> u32 {
        match self {
            Address::Position(adp, ado) => adp.0 as u32 | (ado as u32) << 16,
            Address::Station(adp, ado) => adp.0 as u32 | (ado as u32) << 16,
            Address::Broadcast(ado) => (ado as u32) << 16,
            Address::Logical(address) => address,
        }
    }
}

/// Where one datagram lies in a byte string; see [`Layouts`].
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Layout {
    /// The parsed header.
    pub header: Header,
    /// Offset of the header.
    pub start: usize,
}

impl Layout {
    /// Offset of the first data byte.
    pub const fn data(&self) -> usize {
        self.start + HEADER_LEN
    }
    /// Offset of the working counter, which is also the end of the data.
    pub const fn wkc(&self) -> usize {
        self.data() + self.header.len as usize
    }
    /// Offset behind the working counter: the next datagram, if [`Header::more`].
    pub const fn end(&self) -> usize {
        self.wkc() + WKC_LEN
    }
    /// Reads the datagram at `start` of `bytes`.
    pub fn at(bytes: &[u8], start: usize) -> Result<Self, DatagramError> {
        let cut = DatagramError { at: start, len: bytes.len() };
        let header = bytes.get(start..).and_then(|rest| rest.first_chunk()).ok_or(cut)?;
        let layout = Self { header: Header::parse(header), start };
        if layout.end() > bytes.len() { Err(cut) } else { Ok(layout) }
    }
}

/// A datagram that extends beyond the end of its bytes.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct DatagramError {
    /// Offset of the datagram that is cut off.
    pub at: usize,
    /// Number of bytes that exist.
    pub len: usize,
}

impl fmt::Display for DatagramError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "datagram at byte {} reaches beyond the {} bytes of the frame", self.at, self.len)
    }
}

/// Walks a chain of datagrams by offset, so that the bytes may be changed between steps.
///
/// ```
/// # use isocat_wire::datagram::{Layouts, Layout};
/// # let mut payload = [7u8, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0];
/// let mut layouts = Layouts::new();
/// while let Some(Ok(datagram)) = layouts.next(&payload) {
///     payload[datagram.data()] |= 0x11;
/// }
/// assert_eq!(payload[10], 0x11);
/// ```
#[derive(Clone, Copy, Debug, Default)]
pub struct Layouts {
    next: Option<usize>,
    started: bool,
}

impl Layouts {
    /// Starts at offset 0, the first byte behind the EtherCAT header.
    pub const fn new() -> Self {
        Self { next: Some(0), started: false }
    }

    /// The next datagram; an error ends the walk.
    pub fn next(&mut self, bytes: &[u8]) -> Option<Result<Layout, DatagramError>> {
        let start = self.next.take()?;
        self.started = true;
        let layout = Layout::at(bytes, start);
        if let Ok(layout) = &layout {
            self.next = layout.header.more.then_some(layout.end());
        }
        Some(layout)
    }
}

/// One datagram of a received frame, for reading.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Datagram<'a> {
    /// Its header.
    pub header: Header,
    /// Its data.
    pub data: &'a [u8],
    /// Its working counter: the sum of accesses that succeeded.
    pub wkc: u16,
}

/// All datagrams of the bytes behind an EtherCAT header.
pub fn datagrams(bytes: &[u8]) -> impl Iterator<Item = Result<Datagram<'_>, DatagramError>> {
    let mut layouts = Layouts::new();
    core::iter::from_fn(move || {
        let layout = match layouts.next(bytes)? {
            Ok(layout) => layout,
            Err(error) => return Some(Err(error)),
        };
        let wkc = u16::from_le_bytes([bytes[layout.wkc()], bytes[layout.wkc() + 1]]);
        let data = &bytes[layout.data()..layout.wkc()];
        Some(Ok(Datagram { header: layout.header, data, wkc }))
    })
}

/// Prints `FPRD 0x1001:0x0130 len 6 wkc 1`.
impl fmt::Display for Datagram<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.header.command() {
            Ok(command) if command.is_logical() => {
                write!(f, "{command} {:#010x}", self.header.address)?;
            }
            Ok(command) => {
                write!(f, "{command} {:#06x}:{:#06x}", self.header.adp(), self.header.ado())?;
            }
            Err(UnknownCommand(code)) => {
                write!(f, "command {code:#04x} {:#010x}", self.header.address)?
            }
        }
        write!(f, " len {} wkc {}", self.data.len(), self.wkc)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The EEPROM read of facts vector 12 in a datagram: FPWR 0x1001:0x0502, six bytes.
    const FPWR: [u8; 18] =
        [5, 0x2A, 0x01, 0x10, 0x02, 0x05, 6, 0, 0, 0, 0x00, 0x01, 0x08, 0, 0, 0, 1, 0];

    #[test]
    fn header_both_ways() {
        let header = Header::parse(FPWR.first_chunk().unwrap());
        assert_eq!(header.command(), Ok(Command::Fpwr));
        assert_eq!((header.adp(), header.ado(), header.len), (0x1001, 0x0502, 6));
        assert_eq!(header.emit(), FPWR[..HEADER_LEN]);
        let address = Address::Station(StationAddress(0x1001), 0x0502);
        assert_eq!(Header::new(Command::Fpwr, 0x2A, address, 6), header);
    }

    #[test]
    fn all_header_bits_survive() {
        for byte in 0..=255u8 {
            let bytes = [byte; HEADER_LEN];
            assert_eq!(Header::parse(&bytes).emit(), bytes);
        }
    }

    #[test]
    fn a_cut_datagram_is_an_error_with_its_place() {
        assert_eq!(datagrams(&FPWR).count(), 1);
        for len in 0..FPWR.len() {
            let error = datagrams(&FPWR[..len]).next().unwrap().unwrap_err();
            assert_eq!(error, DatagramError { at: 0, len });
        }
    }

    #[test]
    fn the_more_bit_chains() {
        let mut two = [0; 36];
        two[..18].copy_from_slice(&FPWR);
        two[7] |= 0x80;
        two[18..].copy_from_slice(&FPWR);
        assert_eq!(datagrams(&two).filter(|d| d.is_ok()).count(), 2);
        let last = datagrams(&two[..20]).last().unwrap();
        assert_eq!(last, Err(DatagramError { at: 18, len: 20 }));
    }
}
