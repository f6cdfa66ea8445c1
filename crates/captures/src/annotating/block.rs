//! One block of a pcapng file, as bytes.

use std::io::{self, ErrorKind, Read, Write};

use super::CUT_OFF;

/// The byte order of a section.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Order {
    Little,
    Big,
}

impl Order {
    fn u16(self, value: u16) -> [u8; 2] {
        match self {
            Self::Little => value.to_le_bytes(),
            Self::Big => value.to_be_bytes(),
        }
    }

    fn u32(self, value: u32) -> [u8; 4] {
        match self {
            Self::Little => value.to_le_bytes(),
            Self::Big => value.to_be_bytes(),
        }
    }

    fn read(self, bytes: [u8; 4]) -> u32 {
        match self {
            Self::Little => u32::from_le_bytes(bytes),
            Self::Big => u32::from_be_bytes(bytes),
        }
    }
}

/// A block without its two length fields.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) struct Block {
    kind: u32,
    body: Vec<u8>,
}

impl Block {
    /// Reads the next block; `None`: the file ended. A section header sets the byte order of the
    /// following blocks. `Err`: the block is damaged or cut off.
    pub fn read(source: &mut impl Read, order: &mut Order) -> Result<Option<Self>, String> {
        let mut head = [0; 8];
        match source.read(&mut head[..1]) {
            Ok(0) => return Ok(None),
            Ok(_) => fill(source, &mut head[1..])?,
            Err(error) => return Err(error.to_string()),
        }
        let [a, b, c, d, length @ ..] = head;
        let kind = order.read([a, b, c, d]);
        let mut body = Vec::new();
        if kind == SECTION {
            // The type of a section header reads the same in both orders; the magic after its
            // length tells the order.
            body = vec![0; 4];
            fill(source, &mut body)?;
            *order = match body[..] {
                [0x4D, 0x3C, 0x2B, 0x1A] => Order::Little,
                [0x1A, 0x2B, 0x3C, 0x4D] => Order::Big,
                _ => return Err(format!("a section header without its magic: {body:02x?}")),
            };
        }
        let length = order.read(length) as usize;
        let begun = body.len();
        if !(12 + begun..=MOST_BYTES).contains(&length) || !length.is_multiple_of(4) {
            return Err(format!(
                "a block of {length} bytes; expected 12 to {MOST_BYTES}, in fours"
            ));
        }
        body.resize(length - 12, 0);
        fill(source, &mut body[begun..])?;
        let mut again = [0; 4];
        fill(source, &mut again)?;
        if order.read(again) as usize != length {
            return Err(format!("a block of {length} bytes ends with another length"));
        }
        if kind == SECTION
            && let Some(of_section) = body.get_mut(8..16)
        {
            // Comments make the section longer: its length is set to unknown.
            of_section.fill(0xFF);
        }
        Ok(Some(Self { kind, body }))
    }

    /// The header of a section of unknown length.
    pub fn section() -> Self {
        let mut body = Order::Little.u32(0x1A2B_3C4D).to_vec();
        body.extend([1, 0, 0, 0]);
        body.extend([0xFF; 8]);
        Self { kind: SECTION, body }
    }

    /// An interface whose stamps have units of 10^-`digits` s.
    pub fn interface(link: u32, snap_length: u32, digits: u8) -> Self {
        let mut body = Order::Little.u16(link as u16).to_vec();
        body.extend([0, 0]);
        body.extend(Order::Little.u32(snap_length));
        body.extend(option(Order::Little, TS_RESOLUTION, &[digits]));
        body.extend([0; 4]);
        Self { kind: INTERFACE, body }
    }

    /// A packet of the section's first interface. `length`: bytes on the wire.
    pub fn packet(stamp: u64, length: u32, data: &[u8]) -> Self {
        let mut body = vec![0; 4];
        for word in [(stamp >> 32) as u32, stamp as u32, data.len() as u32, length] {
            body.extend(Order::Little.u32(word));
        }
        body.extend(data);
        body.resize(body.len().next_multiple_of(4), 0);
        Self { kind: ENHANCED_PACKET, body }
    }

    /// Whether it is a packet, which Wireshark numbers.
    pub fn is_packet(&self) -> bool {
        matches!(self.kind, ENHANCED_PACKET | PACKET | SIMPLE_PACKET)
    }

    /// Inserts comments before its options. Returns false if it can't hold options, or contradicts
    /// itself.
    pub fn comment(&mut self, order: Order, comments: &[String]) -> bool {
        let Some(options) = self.options(order) else { return false };
        let mut all = Vec::new();
        for comment in comments {
            all.extend(option(order, COMMENT, cut(comment).as_bytes()));
        }
        if options == self.body.len() {
            // End of options.
            all.extend([0; 4]);
        }
        self.body.splice(options..options, all);
        true
    }

    /// Where the options of a packet begin.
    fn options(&self, order: Order) -> Option<usize> {
        let has_options = matches!(self.kind, ENHANCED_PACKET | PACKET);
        let captured = self.body.get(12..16).filter(|_| has_options)?;
        let captured = order.read(captured.try_into().ok()?) as usize;
        let options = 20_usize.checked_add(captured)?.checked_next_multiple_of(4)?;
        (options <= self.body.len()).then_some(options)
    }

    pub fn write(&self, order: Order, out: &mut impl Write) -> io::Result<()> {
        let length = order.u32(self.body.len() as u32 + 12);
        out.write_all(&order.u32(self.kind))?;
        out.write_all(&length)?;
        out.write_all(&self.body)?;
        out.write_all(&length)
    }
}

/// An option with its padding.
fn option(order: Order, code: u16, value: &[u8]) -> Vec<u8> {
    let mut option = [order.u16(code), order.u16(value.len() as u16)].concat();
    option.extend(value);
    option.resize(option.len().next_multiple_of(4), 0);
    option
}

/// A comment, cut to the length that a packet list can show.
fn cut(comment: &str) -> &str {
    let end = (0..=MOST_OF_COMMENT.min(comment.len())).rev();
    end.into_iter().find(|end| comment.is_char_boundary(*end)).map_or("", |end| &comment[..end])
}

fn fill(source: &mut impl Read, bytes: &mut [u8]) -> Result<(), String> {
    source.read_exact(bytes).map_err(|error| match error.kind() {
        ErrorKind::UnexpectedEof => CUT_OFF.to_owned(),
        _ => format!("can't be read on: {error}"),
    })
}

/// Types of blocks.
const SECTION: u32 = 0x0A0D_0D0A;
const INTERFACE: u32 = 1;
const PACKET: u32 = 2;
const SIMPLE_PACKET: u32 = 3;
const ENHANCED_PACKET: u32 = 6;
/// Codes of options.
const COMMENT: u16 = 1;
const TS_RESOLUTION: u16 = 9;
/// A block that claims to be longer is taken as damaged.
const MOST_BYTES: usize = 8 << 20;
/// Longest comment, bytes.
const MOST_OF_COMMENT: usize = 4096;
