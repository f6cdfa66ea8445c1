//! Reads frames from capture files: pcapng and pcap, as any tool writes them.
//!
//! A file may end in the middle of a packet, or hold links other than Ethernet, or packets that
//! were cut. What can be read is read, and [`Tally`] says what was left out.
//!
//! [`Reader`] returns one frame after the other and holds at most eight megabytes of the file,
//! whatever its length; [`Reading`] holds all frames of a file in memory.

use std::fmt;
use std::io::{self, Chain, Cursor, ErrorKind, Read};
use std::time::Duration;

use isocat_wire::frame::{FrameError, payload};
use pcap_file::pcap::PcapReader;
use pcap_file::pcapng::blocks::enhanced_packet::{EnhancedPacketBlock, EnhancedPacketOption};
use pcap_file::pcapng::blocks::interface_description::{
    InterfaceDescriptionBlock, InterfaceDescriptionOption,
};
use pcap_file::pcapng::{Block, PcapNgReader};
use pcap_file::{DataLink, PcapError, TsResolution};

use crate::link;
use crate::probe::{Clock, Probe};

#[cfg(test)]
mod tests;

/// One frame, without its check sequence.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Frame {
    /// Number of the packet in its file, from 1, as Wireshark shows it.
    pub number: usize,
    /// When it was captured, since the epoch of the file's clock.
    pub at: Duration,
    /// Number of the interface in its section, from 0.
    pub interface: u32,
    /// Whether the file says that it was sent (`true`) or received (`false`); `None`: the file does
    /// not say.
    pub sent: Option<bool>,
    /// The frame from the destination address on.
    pub bytes: Vec<u8>,
}

/// What a file contains besides the frames.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Tally {
    /// Packets in the file, including those without Ethernet frames.
    pub packets: usize,
    /// Packets of links without Ethernet frames, which are left out.
    pub other_links: usize,
    /// The link type of the first of them, by the registry of LINKTYPE_ values.
    pub other_link: Option<u32>,
    /// Packets that the file cuts off within their EtherCAT part, which are left out.
    pub cut: usize,
    /// Why reading ended before the end of the file; `None`: it did not.
    pub ended: Option<String>,
}

/// Why the bytes are not a capture file.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum NoCapture {
    /// The file can't be read.
    Unreadable(String),
    /// The file begins like neither of the formats.
    Unknown {
        /// The first bytes that were found, at most four.
        found: Vec<u8>,
    },
}

impl fmt::Display for NoCapture {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let found = match self {
            Self::Unreadable(why) => return write!(f, "can't be read: {why}"),
            Self::Unknown { found } => &found[..],
        };
        match found {
            [] => write!(f, "the file is empty; expected a capture (pcapng or pcap)"),
            [0x1F, 0x8B, ..] => f.write_str("a file packed by gzip; expected it unpacked"),
            [b'P', b'K', ..] => f.write_str("a zip archive; expected the capture that is in it"),
            [0x28, 0xB5, 0x2F, 0xFD] => f.write_str("a file packed by zstd; expected it unpacked"),
            [0xFD, b'7', b'z', b'X'] => f.write_str("a file packed by xz; expected it unpacked"),
            [b'B', b'Z', b'h', _] => f.write_str("a file packed by bzip2; expected it unpacked"),
            [b'7', b'z', 0xBC, 0xAF] => f.write_str("a 7z archive; expected the capture in it"),
            [0x04, 0x22, 0x4D, 0x18] => f.write_str("a file packed by lz4; expected it unpacked"),
            MAGIC_NG => f.write_str("the first block of the pcapng file is damaged or cut off"),
            [0xD4, 0xC3, 0xB2, 0xA1]
            | [0xA1, 0xB2, 0xC3, 0xD4]
            | [0x4D, 0x3C, 0xB2, 0xA1]
            | [0xA1, 0xB2, 0x3C, 0x4D] => {
                f.write_str("the header of the pcap file is damaged or cut off")
            }
            b"snoo" | b"GMBU" | b"RTSS" | b"XCP\0" | b"TRSN" | [0x34, 0xCD, 0xB2, 0xA1] => f
                .write_str(
                    "a capture of another format; editcap -F pcapng IN OUT makes pcapng of it",
                ),
            found if found.iter().all(|byte| matches!(byte, b'\t'..=b'\r' | b' '..=b'~')) => {
                let text = String::from_utf8_lossy(found);
                write!(f, "a text that begins with {text:?}; expected a capture (pcapng or pcap)")
            }
            found => write!(f, "no capture begins with {found:02x?}; expected pcapng or pcap"),
        }
    }
}

impl std::error::Error for NoCapture {}

/// A capture file, read from its beginning to its end.
#[derive(Debug)]
pub struct Reader<R: Read> {
    source: Source<R>,
    /// The interfaces of the section.
    links: Vec<Link>,
    /// Stamp of the last packet, which packets without a stamp get.
    last: Duration,
    tally: Tally,
    probe: Option<(Probe, Clock)>,
}

enum Source<R: Read> {
    Ng(PcapNgReader<Chain<Cursor<Vec<u8>>, R>>),
    Classic(PcapReader<Chain<Cursor<Vec<u8>>, R>>),
    Ended,
}

impl<R: Read> fmt::Debug for Source<R> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Ng(_) => "pcapng",
            Self::Classic(_) => "pcap",
            Self::Ended => "ended",
        })
    }
}

impl<R: Read> Reader<R> {
    /// Begins to read. `Err`: the file is neither pcapng nor pcap.
    pub fn new(mut source: R) -> Result<Self, NoCapture> {
        let unreadable = |error: io::Error| NoCapture::Unreadable(error.to_string());
        let mut first = Vec::new();
        source.by_ref().take(4).read_to_end(&mut first).map_err(unreadable)?;
        let unknown = |_| NoCapture::Unknown { found: first.clone() };
        let source = Cursor::new(first.clone()).chain(source);
        let source = match &first[..] {
            MAGIC_NG => Source::Ng(PcapNgReader::new(source).map_err(unknown)?),
            _ => Source::Classic(PcapReader::new(source).map_err(unknown)?),
        };
        let (links, last) = (Vec::new(), Duration::ZERO);
        Ok(Self { source, links, last, tally: Tally::default(), probe: None })
    }

    /// Expects the header of a probe in the packets: frames are read without it, and its instants
    /// replace the stamps. Packets without the header stay unchanged.
    pub fn with_probe(self, probe: Option<Probe>) -> Self {
        Self { probe: probe.map(|probe| (probe, Clock::default())), ..self }
    }

    /// What was found so far.
    pub fn tally(&self) -> &Tally {
        &self.tally
    }

    /// The next Ethernet frame; `None`: the file ended, or can't be read further.
    pub fn frame(&mut self) -> Option<Frame> {
        loop {
            let step = match &mut self.source {
                Source::Ended => return None,
                Source::Ng(reader) => reader.next_block().map(|block| match block {
                    Ok(block) => Ok(packet_of(block, &mut self.links, self.last)),
                    Err(error) => Err(error),
                }),
                Source::Classic(reader) => {
                    let header = reader.header();
                    reader.next_raw_packet().map(|packet| {
                        let packet = packet?;
                        let fraction = match header.ts_resolution {
                            TsResolution::MicroSecond => u64::from(packet.ts_frac) * 1000,
                            TsResolution::NanoSecond => u64::from(packet.ts_frac),
                        };
                        let second = Duration::from_secs(packet.ts_sec.into());
                        Ok(Some(Packet {
                            link: header.datalink,
                            at: second + Duration::from_nanos(fraction),
                            interface: 0,
                            sent: None,
                            whole: packet.data.len() >= packet.orig_len as usize,
                            bytes: packet.data.into_owned(),
                        }))
                    })
                }
            };
            match step {
                None => self.source = Source::Ended,
                Some(Err(error)) => self.end(words(&error)),
                Some(Ok(None)) if self.links.len() > MOST_INTERFACES => {
                    self.end(format!("a section has more than {MOST_INTERFACES} interfaces"));
                }
                Some(Ok(None)) => {}
                Some(Ok(Some(packet))) => {
                    if let Some(frame) = self.take(packet) {
                        return Some(frame);
                    }
                }
            }
        }
    }

    fn end(&mut self, why: String) {
        self.source = Source::Ended;
        self.tally.ended = Some(why);
    }

    fn take(&mut self, packet: Packet) -> Option<Frame> {
        self.tally.packets += 1;
        let Packet { link, mut at, interface, sent, whole, mut bytes } = packet;
        self.last = at;
        if let Some((probe, clock)) = &mut self.probe {
            at = clock.take(*probe, at, &mut bytes).unwrap_or(at);
        }
        let Some(taken) = link::take(link, &bytes) else {
            self.tally.other_links += 1;
            self.tally.other_link.get_or_insert(link.into());
            return None;
        };
        // A frame that only lacks its padding is complete.
        let is_ours = |error: FrameError| {
            matches!(error, FrameError::Short { .. } | FrameError::Length { .. })
        };
        if !whole && payload(&taken.bytes).is_err_and(is_ours) {
            self.tally.cut += 1;
            return None;
        }
        let (sent, number) = (sent.or(taken.sent), self.tally.packets);
        Some(Frame { number, at, interface, sent, bytes: taken.bytes })
    }
}

/// A packet of the file.
struct Packet {
    link: DataLink,
    at: Duration,
    interface: u32,
    sent: Option<bool>,
    /// Whether the file has all its bytes.
    whole: bool,
    bytes: Vec<u8>,
}

/// The packet of a block; `None`: the block has none. `last`: the stamp of the previous packet.
fn packet_of(block: Block<'_>, links: &mut Vec<Link>, last: Duration) -> Option<Packet> {
    let link_of = |interface: u32, links: &[Link]| {
        links.get(interface as usize).copied().unwrap_or(Link::ETHERNET)
    };
    match block {
        // Each section has its own interfaces.
        Block::SectionHeader(_) => links.clear(),
        Block::InterfaceDescription(interface) => links.push(Link::of(&interface)),
        Block::EnhancedPacket(packet) => {
            let link = link_of(packet.interface_id, links);
            return Some(Packet {
                link: link.link,
                at: link.time(packet.timestamp.as_nanos()),
                interface: packet.interface_id,
                sent: direction(&packet),
                whole: packet.data.len() >= packet.original_len as usize,
                bytes: packet.data.into_owned(),
            });
        }
        Block::Packet(packet) => {
            let interface = u32::from(packet.interface_id);
            let link = link_of(interface, links);
            return Some(Packet {
                link: link.link,
                at: link.time(u128::from(packet.timestamp)),
                interface,
                sent: None,
                whole: packet.data.len() >= packet.original_len as usize,
                bytes: packet.data.into_owned(),
            });
        }
        Block::SimplePacket(packet) => {
            return Some(Packet {
                link: link_of(0, links).link,
                at: last,
                interface: 0,
                sent: None,
                whole: packet.data.len() >= packet.original_len as usize,
                bytes: packet.data.into_owned(),
            });
        }
        _ => {}
    }
    None
}

/// All frames of a capture file.
#[derive(Clone, Debug, Default)]
pub struct Reading {
    /// The Ethernet frames, in the order of the file.
    pub frames: Vec<Frame>,
    /// What else the file contains.
    pub tally: Tally,
}

impl Reading {
    /// Reads a whole file. `Err`: it is neither pcapng nor pcap.
    pub fn of(bytes: &[u8]) -> Result<Self, NoCapture> {
        let mut reader = Reader::new(bytes)?;
        let mut frames = Vec::new();
        while let Some(frame) = reader.frame() {
            frames.push(frame);
        }
        Ok(Self { frames, tally: reader.tally })
    }
}

/// An interface of a section.
#[derive(Clone, Copy, Debug)]
struct Link {
    link: DataLink,
    /// Value of if_tsresol: units of 10^-n s if bit 7 is clear, of 2^-n s if it is set.
    resolution: u8,
    /// Offset to add to all its stamps, s.
    offset: i64,
}

impl Link {
    /// The interface of packets in a file that describes no interface.
    const ETHERNET: Self = Self { link: DataLink::ETHERNET, resolution: MICROSECONDS, offset: 0 };

    fn of(interface: &InterfaceDescriptionBlock<'_>) -> Self {
        let mut link = Self { link: interface.linktype, ..Self::ETHERNET };
        for option in &interface.options {
            match option {
                InterfaceDescriptionOption::IfTsResol(resolution) => link.resolution = *resolution,
                InterfaceDescriptionOption::IfTsOffset(offset) => link.offset = *offset as i64,
                _ => {}
            }
        }
        link
    }

    /// A time stamp in units of the interface, as a duration.
    fn time(self, units: u128) -> Duration {
        let power = u32::from(self.resolution & 0x7F);
        let nanos = match self.resolution & 0x80 {
            0 => match 10_u128.checked_pow(power) {
                Some(per_second) => units.saturating_mul(1_000_000_000) / per_second,
                None => 0,
            },
            _ => units.saturating_mul(1_000_000_000).checked_shr(power).unwrap_or(0),
        };
        let nanos = Duration::from_nanos(u64::try_from(nanos).unwrap_or(u64::MAX));
        let offset = Duration::from_secs(self.offset.unsigned_abs());
        match self.offset {
            0.. => nanos.saturating_add(offset),
            _ => nanos.saturating_sub(offset),
        }
    }
}

/// The direction by bits 1:0 of the flags of a packet.
fn direction(packet: &EnhancedPacketBlock<'_>) -> Option<bool> {
    packet.options.iter().find_map(|option| match option {
        EnhancedPacketOption::Flags(flags) => match flags & 0b11 {
            1 => Some(false),
            2 => Some(true),
            _ => None,
        },
        _ => None,
    })
}

pub(crate) fn words(error: &PcapError) -> String {
    match error {
        PcapError::IncompleteBuffer => CUT_OFF.to_owned(),
        PcapError::IoError(error) if error.kind() == ErrorKind::UnexpectedEof => CUT_OFF.to_owned(),
        PcapError::IoError(error) => format!("can't be read on: {error}"),
        PcapError::InvalidField(what) => format!("a block is not as it should be ({what})"),
        other => format!("a block is not as it should be ({other})"),
    }
}

/// Resolution of a pcapng interface that does not state one: 10^-6 s.
const MICROSECONDS: u8 = 6;
/// First bytes of pcapng, in either byte order.
pub(crate) const MAGIC_NG: &[u8] = &[0x0A, 0x0D, 0x0D, 0x0A];
/// Largest number of interfaces of a section, which bounds the memory of the reader.
const MOST_INTERFACES: usize = 65_536;
pub(crate) const CUT_OFF: &str = "the file ends in the middle of a block";
