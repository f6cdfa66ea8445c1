//! The Ethernet and EtherCAT headers around the datagrams.

use core::fmt;

use crate::command::Command;
use crate::datagram::{self, Address, Header};

/// EtherType of EtherCAT, big-endian on the wire.
pub const ETHERTYPE: u16 = 0x88A4;
/// EtherType of IPv4, in which the UDP variant travels.
pub const ETHERTYPE_IPV4: u16 = 0x0800;
/// UDP port of EtherCAT, in the destination of the UDP variant.
pub const UDP_PORT: u16 = 0x88A4;
/// EtherType of a VLAN tag.
pub const ETHERTYPE_VLAN: u16 = 0x8100;
/// Bytes of the Ethernet header without VLAN tag.
pub const ETHERNET_HEADER_LEN: usize = 14;
/// Bytes of the EtherCAT header.
pub const ETHERCAT_HEADER_LEN: usize = 2;
/// Bytes before the datagrams of a frame without VLAN tag and UDP.
const HEADERS_LEN: usize = ETHERNET_HEADER_LEN + ETHERCAT_HEADER_LEN;
/// Shortest Ethernet frame without FCS; shorter ones are padded.
pub const MIN_LEN: usize = 60;
/// Longest Ethernet frame without FCS and VLAN tag.
pub const MAX_LEN: usize = 1514;
/// Bytes that every frame takes on the wire in addition to its own: preamble and start delimiter
/// (8), FCS (4) and the gap to the next frame (12).
pub const WIRE_OVERHEAD: usize = 24;
/// Time of one byte on the wire at 100 Mbit/s, ns.
pub const BYTE_TIME_NS: u64 = 80;
/// The bit that the first ESC sets in the first octet of the source address.
pub const LOCALLY_ADMINISTERED: u8 = 0x02;

/// The two bytes behind the EtherType.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct EthercatHeader {
    /// Number of bytes of all datagrams, without this header, padding and FCS; 0..=2047.
    pub len: u16,
    /// Reserved bit 11, kept as received.
    pub reserved: bool,
    /// 1: datagrams (the only type an ESC processes), 4: network variables, 5: mailbox gateway.
    pub kind: u8,
}

impl EthercatHeader {
    /// Type of a frame with datagrams.
    pub const DATAGRAMS: u8 = 1;

    /// Reads the two bytes.
    pub fn parse(bytes: [u8; 2]) -> Self {
        let word = u16::from_le_bytes(bytes);
        Self { len: word & 0x07FF, reserved: word & 0x0800 != 0, kind: (word >> 12) as u8 }
    }

    /// Writes the two bytes.
    pub fn emit(self) -> [u8; 2] {
        (self.len & 0x07FF | u16::from(self.reserved) << 11 | u16::from(self.kind) << 12)
            .to_le_bytes()
    }
}

/// Why bytes are not a frame of datagrams.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum FrameError {
    /// The bytes are too short for the headers.
    Short {
        /// Number of bytes that exist.
        len: usize,
    },
    /// The frame has another protocol.
    EtherType(u16),
    /// An IPv4 packet, but not UDP to the port of EtherCAT.
    NotOurPort {
        /// Protocol in the IPv4 header, 17 for UDP.
        protocol: u8,
        /// The value at the place of the UDP destination port.
        port: u16,
    },
    /// An EtherCAT frame without datagrams.
    Kind(u8),
    /// The EtherCAT header announces more bytes than exist.
    Length {
        /// Number of datagram bytes announced.
        promised: usize,
        /// Number of bytes behind the EtherCAT header.
        found: usize,
    },
}

impl fmt::Display for FrameError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            FrameError::Short { len } => write!(f, "{len} bytes are too short for a frame"),
            FrameError::EtherType(found) => {
                write!(f, "EtherType {found:#06x}, expected {ETHERTYPE:#06x}")
            }
            FrameError::NotOurPort { protocol, port } => write!(
                f,
                "IPv4 protocol {protocol} to port {port:#06x}, expected {PROTOCOL_UDP} (UDP) to \
                 {UDP_PORT:#06x}"
            ),
            FrameError::Kind(found) => write!(f, "EtherCAT type {found}, expected 1 (datagrams)"),
            FrameError::Length { promised, found } => {
                write!(f, "EtherCAT header promises {promised} bytes, the frame has {found}")
            }
        }
    }
}

/// The offsets of the parts of a frame that an ESC changes.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Envelope {
    /// Offset of the first datagram.
    pub datagrams: usize,
    /// Offset of the UDP checksum, in the UDP variant. An ESC changes the contents on the fly and
    /// therefore clears the checksum: zero means "not computed".
    pub udp_checksum: Option<usize>,
}

/// Offset of the first datagram: behind the Ethernet header, the VLAN tag if there is one, the IPv4
/// and UDP headers of the UDP variant, and the EtherCAT header.
#[inline]
pub fn payload_offset(frame: &[u8]) -> Result<usize, FrameError> {
    // Nearly every frame is plain.
    if let Some([.., high, low, _, kind]) = frame.first_chunk::<HEADERS_LEN>()
        && [*high, *low] == ETHERTYPE.to_be_bytes()
        && kind >> 4 == EthercatHeader::DATAGRAMS
    {
        return Ok(HEADERS_LEN);
    }
    envelope(frame).map(|envelope| envelope.datagrams)
}

/// Looks for datagrams in a frame as an ESC does. For the UDP variant it checks only the protocol
/// and the destination port, at their offsets behind an IPv4 header without options.
pub fn envelope(frame: &[u8]) -> Result<Envelope, FrameError> {
    let short = FrameError::Short { len: frame.len() };
    let word =
        |at: usize| frame.get(at..).and_then(|rest| rest.first_chunk::<2>()).copied().ok_or(short);
    let mut at = ETHERNET_HEADER_LEN - 2;
    let mut ethertype = u16::from_be_bytes(word(at)?);
    if ethertype == ETHERTYPE_VLAN {
        at += 4;
        ethertype = u16::from_be_bytes(word(at)?);
    }
    let mut udp_checksum = None;
    at += 2;
    if ethertype == ETHERTYPE_IPV4 {
        let udp = at + IPV4_HEADER_LEN;
        let [_, protocol] = word(at + IPV4_PROTOCOL - 1)?;
        let port = u16::from_be_bytes(word(udp + 2)?);
        if protocol != PROTOCOL_UDP || port != UDP_PORT {
            return Err(FrameError::NotOurPort { protocol, port });
        }
        udp_checksum = Some(udp + 6);
        at = udp + UDP_HEADER_LEN;
    } else if ethertype != ETHERTYPE {
        return Err(FrameError::EtherType(ethertype));
    }
    let header = EthercatHeader::parse(word(at)?);
    if header.kind != EthercatHeader::DATAGRAMS {
        return Err(FrameError::Kind(header.kind));
    }
    Ok(Envelope { datagrams: at + ETHERCAT_HEADER_LEN, udp_checksum })
}

const IPV4_HEADER_LEN: usize = 20;
/// Offset of the protocol in an IPv4 header.
const IPV4_PROTOCOL: usize = 9;
const PROTOCOL_UDP: u8 = 17;
const UDP_HEADER_LEN: usize = 8;

/// The bytes of all datagrams of a frame, by the length in its EtherCAT header.
#[inline]
pub fn payload(frame: &[u8]) -> Result<&[u8], FrameError> {
    let start = payload_offset(frame)?;
    let header = EthercatHeader::parse([frame[start - 2], frame[start - 1]]);
    let promised = usize::from(header.len);
    let found = frame.len() - start;
    frame.get(start..start + promised).ok_or(FrameError::Length { promised, found })
}

/// Time on the wire of a frame of `len` bytes (without FCS), from its first preamble bit to its
/// last FCS bit, ns.
pub const fn duration_ns(len: usize) -> u64 {
    let len = if len < MIN_LEN { MIN_LEN } else { len };
    (len as u64 + 8 + 4) * BYTE_TIME_NS
}

/// Builds a frame of datagrams in the caller's buffer.
///
/// ```
/// use isocat_wire::{Command, datagram::Address, frame::FrameWriter};
/// let mut buffer = [0; 1514];
/// let mut frame = FrameWriter::new(&mut buffer, [2, 0, 0, 0, 0, 1]);
/// frame.push(Command::Brd, 0, Address::Broadcast(0x0000), &[0]).unwrap();
/// assert_eq!(frame.finish(), 60);
/// ```
#[derive(Debug)]
pub struct FrameWriter<'a> {
    buffer: &'a mut [u8],
    end: usize,
    last: Option<usize>,
}

/// The datagram does not fit into the rest of the frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct FrameFull;

impl<'a> FrameWriter<'a> {
    /// An empty broadcast frame from `source`. `buffer` must hold at least [`MIN_LEN`] bytes; bytes
    /// beyond [`MAX_LEN`] are not used. Panics on a shorter buffer.
    pub fn new(buffer: &'a mut [u8], source: [u8; 6]) -> Self {
        let len = buffer.len().min(MAX_LEN);
        let buffer = &mut buffer[..len];
        assert!(len >= MIN_LEN, "a frame buffer holds the shortest frame at least");
        buffer[..6].fill(0xFF);
        buffer[6..12].copy_from_slice(&source);
        buffer[12..14].copy_from_slice(&ETHERTYPE.to_be_bytes());
        Self { buffer, end: ETHERNET_HEADER_LEN + ETHERCAT_HEADER_LEN, last: None }
    }

    /// Whether a datagram of `len` data bytes still fits.
    pub fn fits(&self, len: usize) -> bool {
        self.end + datagram::HEADER_LEN + len + datagram::WKC_LEN <= self.buffer.len()
    }

    /// Adds a datagram and returns the offset of its data in the frame.
    pub fn push(
        &mut self,
        command: Command,
        index: u8,
        address: Address,
        data: &[u8],
    ) -> Result<usize, FrameFull> {
        if !self.fits(data.len()) {
            return Err(FrameFull);
        }
        if let Some(last) = self.last {
            self.buffer[last + 7] |= 0x80;
        }
        let start = self.end;
        let header = Header::new(command, index, address, data.len() as u16);
        let data_at = start + datagram::HEADER_LEN;
        let wkc_at = data_at + data.len();
        self.buffer[start..data_at].copy_from_slice(&header.emit());
        self.buffer[data_at..wkc_at].copy_from_slice(data);
        self.buffer[wkc_at..wkc_at + datagram::WKC_LEN].fill(0);
        self.last = Some(start);
        self.end = wkc_at + datagram::WKC_LEN;
        Ok(data_at)
    }

    /// Adds datagrams that are whole already: headers, data and working counters, one behind the
    /// other. All but the last have the flag that another one follows. All of them take this index.
    pub fn push_whole(&mut self, index: u8, datagrams: &[u8]) -> Result<(), FrameFull> {
        let (start, end) = (self.end, self.end + datagrams.len());
        if end > self.buffer.len() {
            return Err(FrameFull);
        }
        if let Some(last) = self.last.filter(|_| !datagrams.is_empty()) {
            self.buffer[last + 7] |= 0x80;
        }
        let whole = &mut self.buffer[start..end];
        whole.copy_from_slice(datagrams);
        let mut at = 0;
        while let Some(header) =
            whole.get_mut(at..).and_then(|rest| rest.first_chunk_mut::<{ datagram::HEADER_LEN }>())
        {
            header[1] = index;
            let len = usize::from(u16::from_le_bytes([header[6], header[7]]) & 0x07FF);
            self.last = Some(start + at);
            at += datagram::HEADER_LEN + len + datagram::WKC_LEN;
        }
        if let Some(last) = self.last {
            self.buffer[last + 7] &= !0x80;
        }
        self.end = end;
        Ok(())
    }

    /// Whether no datagram was pushed.
    pub fn is_empty(&self) -> bool {
        self.last.is_none()
    }

    /// Writes the EtherCAT header and the padding. Returns the length of the frame without FCS.
    pub fn finish(self) -> usize {
        let start = ETHERNET_HEADER_LEN + ETHERCAT_HEADER_LEN;
        let header = EthercatHeader {
            len: (self.end - start) as u16,
            reserved: false,
            kind: EthercatHeader::DATAGRAMS,
        };
        self.buffer[start - 2..start].copy_from_slice(&header.emit());
        let len = self.end.max(MIN_LEN);
        self.buffer[self.end..len].fill(0);
        len
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::datagram::datagrams;

    #[test]
    fn a_short_frame_is_padded_and_parses_back() {
        let mut buffer = [0xAA; MAX_LEN];
        let mut writer = FrameWriter::new(&mut buffer, [2, 0, 0, 0, 0, 1]);
        writer.push(Command::Brd, 7, Address::Broadcast(0x0130), &[0, 0]).unwrap();
        writer.push(Command::Lrw, 8, Address::Logical(0x0100_0000), &[1, 2, 3]).unwrap();
        let len = writer.finish();
        assert_eq!(len, MIN_LEN);
        let frame = &buffer[..len];
        // EtherCAT header: 29 bytes of datagrams, type 1.
        assert_eq!(frame[12..16], [0x88, 0xA4, 0x1D, 0x10]);
        let found: std::vec::Vec<_> =
            datagrams(payload(frame).unwrap()).map(|d| d.unwrap()).collect();
        assert_eq!(found.len(), 2);
        assert_eq!((found[0].header.index, found[0].header.more), (7, true));
        assert_eq!((found[1].header.address, found[1].data), (0x0100_0000, &[1, 2, 3][..]));
        assert!(frame[45..].iter().all(|byte| *byte == 0), "padding is zero");
    }

    /// Whole datagrams are the same bytes in the frame as those that are made one by one.
    #[test]
    fn whole_datagrams() {
        let push = |writer: &mut FrameWriter<'_>, index, len| {
            writer.push(Command::Fprd, index, Address::Broadcast(0x0130), &[0; 50][..len]).unwrap();
        };
        let mut built = [0; MAX_LEN];
        let mut writer = FrameWriter::new(&mut built, [2, 0, 0, 0, 0, 1]);
        for len in [8, 1, 40] {
            push(&mut writer, 0, len);
        }
        assert_eq!(writer.finish(), 16 + 3 * 12 + 49);
        let mut expected = [0; MAX_LEN];
        let mut writer = FrameWriter::new(&mut expected, [2, 0, 0, 0, 0, 1]);
        for len in [3, 8, 1, 40, 6] {
            push(&mut writer, 9, len);
        }
        let expected_len = writer.finish();
        let mut frame = [0; MAX_LEN];
        let mut writer = FrameWriter::new(&mut frame, [2, 0, 0, 0, 0, 1]);
        push(&mut writer, 9, 3);
        writer.push_whole(9, &built[16..16 + 3 * 12 + 49]).unwrap();
        writer.push_whole(9, &[]).unwrap();
        push(&mut writer, 9, 6);
        let len = writer.finish();
        assert_eq!(frame[..len], expected[..expected_len]);
        let mut writer = FrameWriter::new(&mut frame, [2, 0, 0, 0, 0, 1]);
        writer.push_whole(9, &built[16..16 + 3 * 12 + 49]).unwrap();
        let len = writer.finish();
        let indices: std::vec::Vec<u8> = datagrams(payload(&frame[..len]).unwrap())
            .map(|datagram| datagram.unwrap().header.index)
            .collect();
        assert_eq!(indices, [9, 9, 9], "the last one ends the frame");
        let mut writer = FrameWriter::new(&mut frame[..MIN_LEN], [2, 0, 0, 0, 0, 1]);
        assert_eq!(writer.push_whole(9, &built[16..61]), Err(FrameFull));
    }

    #[test]
    fn the_largest_datagram_fits_and_one_byte_more_does_not() {
        let mut buffer = [0; 2000];
        let data = [0; datagram::MAX_DATA_LEN + 1];
        let mut writer = FrameWriter::new(&mut buffer, [0; 6]);
        let pushed = writer.push(Command::Lrw, 0, Address::Logical(0), &data);
        assert_eq!(pushed, Err(FrameFull));
        writer.push(Command::Lrw, 0, Address::Logical(0), &data[1..]).unwrap();
        assert_eq!(writer.finish(), MAX_LEN);
    }

    #[test]
    fn foreign_frames_are_named() {
        let mut frame = [0; 60];
        assert_eq!(payload(&frame), Err(FrameError::EtherType(0)));
        frame[12..14].copy_from_slice(&[0x88, 0xA4]);
        assert_eq!(payload(&frame), Err(FrameError::Kind(0)));
        frame[14..16].copy_from_slice(&[0xFF, 0x17]);
        assert_eq!(payload(&frame), Err(FrameError::Length { promised: 2047, found: 44 }));
        frame[14..16].copy_from_slice(&[0x0D, 0x10]);
        assert_eq!(payload(&frame).map(<[u8]>::len), Ok(13));
        assert_eq!(payload(&frame[..15]), Err(FrameError::Short { len: 15 }));
    }

    /// IPv4 and UDP headers as a MainDevice on a routed network sends them.
    #[test]
    fn the_udp_variant() {
        let mut frame = [0; 74];
        frame[12..14].copy_from_slice(&[0x08, 0x00]);
        frame[14] = 0x45;
        frame[23] = 17;
        frame[36..38].copy_from_slice(&[0x88, 0xA4]);
        frame[42..44].copy_from_slice(&[0x0D, 0x10]);
        let found = Envelope { datagrams: 44, udp_checksum: Some(40) };
        assert_eq!(envelope(&frame), Ok(found));
        for (at, value, error) in [
            (23, 6, FrameError::NotOurPort { protocol: 6, port: 0x88A4 }),
            (37, 0xA5, FrameError::NotOurPort { protocol: 17, port: 0x88A5 }),
            (43, 0x40, FrameError::Kind(4)),
        ] {
            let mut other = frame;
            other[at] = value;
            assert_eq!(envelope(&other), Err(error));
        }
        assert_eq!(envelope(&frame[..43]), Err(FrameError::Short { len: 43 }));
        // Behind a VLAN tag everything moves by four bytes.
        let mut tagged = [0; 78];
        tagged[12..14].copy_from_slice(&[0x81, 0x00]);
        tagged[16..].copy_from_slice(&frame[12..]);
        assert_eq!(envelope(&tagged), Ok(Envelope { datagrams: 48, udp_checksum: Some(44) }));
    }

    #[test]
    fn a_vlan_tag_is_skipped() {
        let mut frame = [0; 64];
        frame[12..14].copy_from_slice(&[0x81, 0x00]);
        frame[16..20].copy_from_slice(&[0x88, 0xA4, 0x0D, 0x10]);
        assert_eq!(payload_offset(&frame), Ok(20));
    }
}
