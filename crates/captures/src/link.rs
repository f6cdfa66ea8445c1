//! Turns a captured packet into an Ethernet frame, by the link that it was captured on.

use isocat_wire::frame::{ETHERNET_HEADER_LEN, ETHERTYPE_VLAN};
use pcap_file::DataLink;

/// A packet as an Ethernet frame.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct Taken {
    /// The frame from the destination address on.
    pub bytes: Vec<u8>,
    /// Whether the packet was sent (`true`) or received (`false`); `None`: the link does not say.
    pub sent: Option<bool>,
}

/// Makes a frame of a packet; `None`: the link carries no Ethernet frames.
pub(crate) fn take(link: DataLink, packet: &[u8]) -> Option<Taken> {
    match link {
        DataLink::ETHERNET => Some(Taken { bytes: without_outer_tag(packet), sent: None }),
        DataLink::LINUX_SLL => cooked(packet, &COOKED_1),
        DataLink::LINUX_SLL2 => cooked(packet, &COOKED_2),
        _ => None,
    }
}

/// Offsets in a header of Linux' cooked captures of what an Ethernet header needs.
struct Cooked {
    /// Bytes of the header.
    len: usize,
    /// Offset of the EtherType.
    protocol: usize,
    /// Offset of the last byte of the packet type.
    kind: usize,
    /// Offset of the sender's address.
    address: usize,
}

/// LINKTYPE_LINUX_SLL.
const COOKED_1: Cooked = Cooked { len: 16, protocol: 14, kind: 1, address: 6 };
/// LINKTYPE_LINUX_SLL2.
const COOKED_2: Cooked = Cooked { len: 20, protocol: 0, kind: 10, address: 12 };
/// Packet type of packets that the capturing machine sent.
const OUTGOING: u8 = 4;

/// Makes a frame of a cooked packet. It has no destination address, so the frame gets the broadcast
/// address.
fn cooked(packet: &[u8], header: &Cooked) -> Option<Taken> {
    let data = packet.get(header.len..)?;
    let mut bytes = Vec::with_capacity(ETHERNET_HEADER_LEN + data.len());
    bytes.extend([0xFF; 6]);
    bytes.extend(&packet[header.address..header.address + 6]);
    bytes.extend(&packet[header.protocol..header.protocol + 2]);
    bytes.extend(data);
    let sent = Some(packet[header.kind] == OUTGOING);
    Some(Taken { bytes: without_outer_tag(&bytes), sent })
}

/// Removes the outer one of two VLAN tags: switches add it, and no ESC reads a frame behind it.
fn without_outer_tag(frame: &[u8]) -> Vec<u8> {
    let type_at = |at: usize| match frame.get(at..at + 2) {
        Some(&[high, low]) => u16::from_be_bytes([high, low]),
        _ => 0,
    };
    let first = ETHERNET_HEADER_LEN - 2;
    let is_tag = |ethertype: u16| matches!(ethertype, ETHERTYPE_VLAN | ETHERTYPE_PROVIDER);
    let outer = type_at(first) == ETHERTYPE_PROVIDER || is_tag(type_at(first + 4));
    if is_tag(type_at(first)) && outer {
        let mut bytes = frame[..first].to_vec();
        bytes.extend(&frame[first + 4..]);
        return bytes;
    }
    frame.to_vec()
}

/// EtherType of a provider's VLAN tag (IEEE 802.1ad).
const ETHERTYPE_PROVIDER: u16 = 0x88A8;

#[cfg(test)]
mod tests {
    use super::*;
    use isocat_wire::frame::{FrameError, payload};

    /// These bytes, followed by an empty EtherCAT frame of type 1.
    fn behind(header: &[u8]) -> Vec<u8> {
        let mut bytes = header.to_vec();
        bytes.extend([0, 0x10]);
        bytes.resize(60, 0);
        bytes
    }

    #[test]
    fn cooked_packets_become_frames() {
        let address = [2, 0, 0, 0, 0, 9];
        let mut one = vec![0, 4, 0, 1, 0, 6];
        one.extend(address);
        one.extend([0, 0, 0x88, 0xA4]);
        let mut two = vec![0x88, 0xA4, 0, 0, 0, 0, 0, 2, 0, 1, 0, 6];
        two.extend(address);
        two.extend([0, 0]);
        for (link, header, sent) in
            [(DataLink::LINUX_SLL, one, true), (DataLink::LINUX_SLL2, two, false)]
        {
            let taken = take(link, &behind(&header)).expect("a frame");
            assert_eq!(taken.sent, Some(sent));
            assert_eq!(taken.bytes[6..12], address);
            assert_eq!(payload(&taken.bytes), Ok(&[][..]));
            assert_eq!(take(link, &header[..header.len() - 1]), None, "shorter than its header");
        }
        assert_eq!(take(DataLink::PPP, &[0; 60]), None);
    }

    #[test]
    fn the_outer_of_two_tags_goes() {
        let tagged = |tags: &[u8]| {
            let mut header = vec![0; 12];
            header.extend(tags);
            header.extend([0x88, 0xA4]);
            take(DataLink::ETHERNET, &behind(&header)).expect("a frame").bytes
        };
        assert_eq!(tagged(&[]).len(), 60);
        assert_eq!(tagged(&[0x81, 0, 0, 1])[12..14], [0x81, 0]);
        assert_eq!(tagged(&[0x88, 0xA8, 0, 1]), tagged(&[])[..56]);
        let both = tagged(&[0x88, 0xA8, 0, 1, 0x81, 0, 0, 2]);
        assert_eq!((&both[12..16], payload(&both)), (&[0x81, 0, 0, 2][..], Ok(&[][..])));
        assert_eq!(tagged(&[0x81, 0, 0, 1, 0x81, 0, 0, 2])[12..16], [0x81, 0, 0, 2]);
        // A frame with three tags is not read.
        let three = tagged(&[0x88, 0xA8, 0, 1, 0x88, 0xA8, 0, 1, 0x81, 0, 0, 2]);
        assert_eq!(payload(&three), Err(FrameError::EtherType(0x88A8)));
    }
}
