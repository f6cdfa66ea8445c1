//! Frames out of capture files: pcapng and pcap, as any tool writes them.
//!
//! A file may end in the middle of a packet, hold other links than Ethernet, or packets that were
//! cut: what can be read is read, and [`Reading`] says what was left out.

use std::fmt;
use std::time::Duration;

use pcap_file::pcap::PcapReader;
use pcap_file::pcapng::blocks::enhanced_packet::{EnhancedPacketBlock, EnhancedPacketOption};
use pcap_file::pcapng::blocks::interface_description::InterfaceDescriptionOption;
use pcap_file::pcapng::{Block, PcapNgReader};
use pcap_file::{DataLink, PcapError};

/// What a capture file holds.
#[derive(Clone, Debug, Default)]
pub struct Reading {
    /// The Ethernet frames, in the order of the file.
    pub frames: Vec<Frame>,
    /// Packets in the file, with those that are none of Ethernet.
    pub packets: usize,
    /// Packets of other links than Ethernet, which are left out.
    pub other_links: usize,
    /// Packets of which the file does not hold all bytes, which are left out.
    pub cut: usize,
    /// Why reading ended before the end of the file; `None` if it did not.
    pub ended: Option<String>,
}

/// One frame, without its check sequence.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Frame {
    /// Number of the packet in its file, from 1, as Wireshark shows it.
    pub number: usize,
    /// When it was seen, from the epoch of the file's clock.
    pub at: Duration,
    /// Number of the interface, from 0.
    pub interface: u32,
    /// The file says that it was sent (`true`) or received (`false`); `None`: it does not say.
    pub sent: Option<bool>,
    /// From the destination address on.
    pub bytes: Vec<u8>,
}

/// The bytes are no capture file.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct NoCapture {
    /// The first bytes that were found, four at most.
    pub found: Vec<u8>,
}

impl fmt::Display for NoCapture {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.found[..] {
            [] => write!(f, "the file is empty; expected a capture (pcapng or pcap)"),
            _ => write!(f, "no capture begins with {:02x?}; expected pcapng or pcap", self.found),
        }
    }
}

impl Reading {
    /// Reads a whole file. `Err`: it is neither pcapng nor pcap.
    pub fn of(bytes: &[u8]) -> Result<Self, NoCapture> {
        let mut reading = Self::default();
        let known = if let Ok(reader) = PcapNgReader::new(bytes) {
            reading.pcapng(reader);
            true
        } else if let Ok(reader) = PcapReader::new(bytes) {
            reading.pcap(reader);
            true
        } else {
            false
        };
        match known {
            true => Ok(reading),
            false => Err(NoCapture { found: bytes.iter().copied().take(4).collect() }),
        }
    }

    fn pcapng(&mut self, mut reader: PcapNgReader<&[u8]>) {
        let mut links: Vec<Link> = Vec::new();
        let mut last = Duration::ZERO;
        loop {
            let block = match reader.next_block() {
                None => return,
                Some(Ok(block)) => block.into_owned(),
                Some(Err(error)) => return self.ended = Some(words(&error)),
            };
            match block {
                // A section has interfaces of its own.
                Block::SectionHeader(_) => links.clear(),
                Block::InterfaceDescription(interface) => {
                    let resolution = interface.options.iter().find_map(|option| match option {
                        InterfaceDescriptionOption::IfTsResol(resolution) => Some(*resolution),
                        _ => None,
                    });
                    let link = interface.linktype;
                    links.push(Link { link, resolution: resolution.unwrap_or(MICROSECONDS) });
                }
                Block::EnhancedPacket(packet) => {
                    let link = links.get(packet.interface_id as usize).copied();
                    let link = link.unwrap_or(Link::ETHERNET);
                    last = link.time(packet.timestamp.as_nanos());
                    let whole = packet.data.len() >= packet.original_len as usize;
                    let (interface, sent) = (packet.interface_id, direction(&packet));
                    self.packet(link.link, whole, last, interface, sent, &packet.data);
                }
                Block::Packet(packet) => {
                    let link = links.get(usize::from(packet.interface_id)).copied();
                    let link = link.unwrap_or(Link::ETHERNET);
                    last = link.time(u128::from(packet.timestamp));
                    let whole = packet.data.len() >= packet.original_len as usize;
                    let interface = u32::from(packet.interface_id);
                    self.packet(link.link, whole, last, interface, None, &packet.data);
                }
                Block::SimplePacket(packet) => {
                    let link = links.first().copied().unwrap_or(Link::ETHERNET);
                    let whole = packet.data.len() >= packet.original_len as usize;
                    self.packet(link.link, whole, last, 0, None, &packet.data);
                }
                _ => {}
            }
        }
    }

    fn pcap(&mut self, mut reader: PcapReader<&[u8]>) {
        let link = reader.header().datalink;
        while let Some(packet) = reader.next_packet() {
            match packet {
                Ok(packet) => {
                    let whole = packet.data.len() >= packet.orig_len as usize;
                    self.packet(link, whole, packet.timestamp, 0, None, &packet.data);
                }
                Err(error) => return self.ended = Some(words(&error)),
            }
        }
    }

    fn packet(
        &mut self,
        link: DataLink,
        whole: bool,
        at: Duration,
        interface: u32,
        sent: Option<bool>,
        bytes: &[u8],
    ) {
        self.packets += 1;
        if link != DataLink::ETHERNET {
            self.other_links += 1;
        } else if !whole {
            self.cut += 1;
        } else {
            let bytes = bytes.to_vec();
            self.frames.push(Frame { number: self.packets, at, interface, sent, bytes });
        }
    }
}

/// An interface of a section.
#[derive(Clone, Copy)]
struct Link {
    link: DataLink,
    /// The option of its name: bit 7 clear, 10^-n s; set, 2^-n s.
    resolution: u8,
}

impl Link {
    /// What a file that names no interface may be.
    const ETHERNET: Self = Self { link: DataLink::ETHERNET, resolution: MICROSECONDS };

    /// A time stamp in the interface's units.
    fn time(self, units: u128) -> Duration {
        let power = u32::from(self.resolution & 0x7F);
        let nanos = match self.resolution & 0x80 {
            0 => match 10_u128.checked_pow(power) {
                Some(per_second) => units.saturating_mul(1_000_000_000) / per_second,
                None => 0,
            },
            _ => units.saturating_mul(1_000_000_000).checked_shr(power).unwrap_or(0),
        };
        Duration::from_nanos(u64::try_from(nanos).unwrap_or(u64::MAX))
    }
}

/// Bits 1:0 of the flags of a packet.
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

fn words(error: &PcapError) -> String {
    match error {
        PcapError::IoError(_) | PcapError::IncompleteBuffer => {
            "the file ends in the middle of a block".to_owned()
        }
        PcapError::InvalidField(what) => format!("a block is not as it should be ({what})"),
        other => format!("a block is not as it should be ({other})"),
    }
}

/// Units of a pcapng interface that does not say which.
const MICROSECONDS: u8 = 6;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_stamps_in_their_units() {
        let time = |resolution, units| Link { resolution, ..Link::ETHERNET }.time(units);
        assert_eq!(time(6, 1_500_000), Duration::from_millis(1500));
        assert_eq!(time(9, 1_500_000_000), Duration::from_millis(1500));
        assert_eq!(time(0x80 | 10, 1536), Duration::from_millis(1500));
        assert_eq!(time(0, 3), Duration::from_secs(3));
        assert_eq!(time(127, u128::from(u64::MAX)), Duration::ZERO);
    }

    /// A capture cut off at any byte gives the frames before it, and says that it is not whole.
    #[test]
    fn a_file_that_ends_anywhere() {
        let mut capture = crate::capture::Capture::new(Vec::new()).expect("in memory");
        for at in 0..3 {
            capture.write(Duration::from_micros(at), at % 2 == 0, &[at as u8; 60]);
        }
        let file = capture.finish().expect("in memory");
        let whole = Reading::of(&file).expect("a capture");
        assert_eq!((whole.frames.len(), whole.packets, &whole.ended), (3, 3, &None));
        assert_eq!(whole.frames[2].at, Duration::from_micros(2));
        assert_eq!((whole.frames[0].sent, whole.frames[1].sent), (Some(true), Some(false)));
        let mut ended = 0;
        for len in 0..file.len() {
            match Reading::of(&file[..len]) {
                Ok(reading) => {
                    assert!(reading.frames.len() < 3);
                    assert_eq!(reading.frames, whole.frames[..reading.frames.len()]);
                    ended += usize::from(reading.ended.is_some());
                }
                Err(none) => assert_eq!(none.found.len(), len.min(4)),
            }
        }
        assert!(ended > 60, "most ends are in the middle of a block");
        // Any byte that is wrong is an error value or another frame.
        for at in 0..file.len() {
            for value in [0, 1, 0x7F, 0xFF] {
                let mut file = file.clone();
                file[at] = value;
                let _ = Reading::of(&file);
            }
        }
    }
}
