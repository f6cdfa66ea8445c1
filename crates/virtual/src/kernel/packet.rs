//! Packet sockets, and the frames that wait in them.

use std::collections::VecDeque;
use std::rc::Rc;

use isocat_wire::Command;
use isocat_wire::time::{Host, Time};

/// The frames that a socket accepts.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Protocol {
    /// No frames, until the socket is bound to a protocol.
    #[default]
    None,
    /// Frames of this EtherType.
    Type(u16),
    /// All frames.
    All,
}

/// A socket of the family `AF_PACKET`.
#[derive(Debug, Default)]
pub struct PacketSocket {
    /// The interface to which it is bound: its index among the virtual ones. `None`: all.
    pub interface: Option<usize>,
    /// The frames it accepts.
    pub protocol: Protocol,
    /// A `SOCK_DGRAM` socket, for which the kernel handles Ethernet headers.
    pub cooked: bool,
    /// A receive also returns the stamp of arrival, in this form (the `SO_` option that asked for
    /// it).
    pub stamps: Option<i32>,
    /// Timeout of a receive (`SO_RCVTIMEO`); `None`: no timeout.
    pub patience: Option<isocat_wire::time::Nanos>,
    /// Frames that were dropped since the last query, because the queue was full.
    pub dropped: u32,
    waiting: VecDeque<Arrived>,
    /// Frames were taken from it: it is no socket that only sends.
    is_read: bool,
}

/// A frame that arrived.
#[derive(Clone, Debug)]
pub struct Arrived {
    /// The instant at which the host received it.
    pub at: Time<Host>,
    /// The index of the virtual interface at which it arrived.
    pub interface: usize,
    /// The whole frame, from its destination address on.
    pub bytes: Rc<[u8]>,
}

/// Largest number of frames that wait in a socket; a kernel's default buffer holds some hundred.
const MOST: usize = 512;

impl PacketSocket {
    /// A socket that accepts these frames from all interfaces.
    pub fn new(protocol: Protocol, cooked: bool) -> Self {
        Self { protocol, cooked, ..Self::default() }
    }

    /// Offers a frame that came in at an interface. Returns whether this socket accepts it.
    pub fn offer(&mut self, frame: &Arrived) -> bool {
        let of_type = match self.protocol {
            Protocol::None => false,
            Protocol::All => true,
            Protocol::Type(wanted) => frame.bytes.get(12..14) == Some(&wanted.to_be_bytes()),
        };
        let here = self.interface.is_none_or(|interface| interface == frame.interface);
        if !of_type || !here {
            return false;
        }
        if self.waiting.len() == MOST {
            self.dropped += 1;
            return false;
        }
        self.waiting.push_back(frame.clone());
        true
    }

    /// Takes the oldest frame.
    pub fn take(&mut self) -> Option<Arrived> {
        let taken = self.waiting.pop_front();
        self.is_read |= taken.is_some();
        taken
    }

    /// The oldest frame, without taking it.
    pub fn peek(&self) -> Option<&Arrived> {
        self.waiting.front()
    }

    /// Whether an answer to a frame of the same kind as `frame` waits here. `None`: frames are
    /// never taken from this socket, or it is no frame of the cyclic exchange.
    pub fn has_untaken(&self, frame: &[u8]) -> Option<bool> {
        let wanted = kind(frame).filter(|_| self.is_read)?;
        Some(self.waiting.iter().any(|arrived| kind(&arrived.bytes) == Some(wanted)))
    }

    /// Whether a receive would return a frame.
    pub fn is_readable(&self) -> bool {
        !self.waiting.is_empty()
    }

    /// Drops the frames from before the socket was bound again.
    pub fn clear(&mut self) {
        self.waiting.clear();
    }
}

/// What two EtherCAT frames of the cyclic exchange that are of one kind have in common: the first
/// datagram's command, its address within a SubDevice or in logical memory, and its length.
fn kind(frame: &[u8]) -> Option<(u8, [u8; 4], [u8; 2])> {
    let ether_cat = frame.get(12..14)? == isocat_wire::frame::ETHERTYPE.to_be_bytes();
    let [command, _, mut address @ .., low, high] = *frame.get(16..)?.first_chunk::<8>()?;
    match Command::try_from(command).ok()? {
        command if command.is_logical() => {}
        Command::Frmw => {}
        // Devices count in the first half of an address by position.
        Command::Armw => address[..2].fill(0),
        _ => return None,
    }
    // Beside the length there are flags that differ on the way back.
    ether_cat.then_some((command, address, [low, high & 0x07]))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(interface: usize, ether_type: u16) -> Arrived {
        let mut bytes = vec![0; 60];
        bytes[12..14].copy_from_slice(&ether_type.to_be_bytes());
        Arrived { at: Time::ZERO, interface, bytes: bytes.into() }
    }

    #[test]
    fn a_socket_takes_what_it_is_bound_to() {
        let mut socket = PacketSocket::default();
        assert!(!socket.offer(&frame(0, 0x88A4)), "not bound");
        socket.protocol = Protocol::Type(0x88A4);
        assert!(socket.offer(&frame(1, 0x88A4)) && !socket.offer(&frame(1, 0x0800)));
        socket.interface = Some(0);
        assert!(!socket.offer(&frame(1, 0x88A4)) && socket.offer(&frame(0, 0x88A4)));
        socket.protocol = Protocol::All;
        assert!(socket.offer(&frame(0, 0x0800)));
        assert_eq!((socket.take().is_some(), socket.peek().is_some()), (true, true));
    }

    #[test]
    fn an_answer_of_the_same_kind_is_untaken() {
        let of = |command: u8, address: u32, len: u8, index: u8, flags: u8| {
            let mut frame = frame(0, 0x88A4);
            let mut bytes = frame.bytes.to_vec();
            bytes[16..18].copy_from_slice(&[command, index]);
            bytes[18..22].copy_from_slice(&address.to_le_bytes());
            bytes[22..24].copy_from_slice(&[len, flags]);
            frame.bytes = bytes.into();
            frame
        };
        let mut socket = PacketSocket::new(Protocol::All, false);
        let sent = of(12, 0x10_0000, 14, 7, 0);
        let untaken = |socket: &PacketSocket| socket.has_untaken(&sent.bytes);
        assert!(socket.take().is_none());
        socket.offer(&of(12, 0x10_0000, 14, 6, 0x40));
        assert_eq!(untaken(&socket), None, "nothing was ever taken from this socket");
        socket.take();
        assert_eq!(untaken(&socket), Some(false));
        for other in [(11, 0x10_0000, 14), (12, 0x11_0000, 14), (12, 0x10_0000, 15), (7, 0, 2)] {
            socket.offer(&of(other.0, other.1, other.2, 6, 0));
        }
        assert_eq!(untaken(&socket), Some(false));
        socket.offer(&of(12, 0x10_0000, 14, 6, 0x40));
        assert_eq!(untaken(&socket), Some(true));
        // The first device counts in the answer of ARMW. A state that is asked for is no cycle.
        socket.offer(&of(13, 0x0910_0001, 8, 8, 0));
        let of_kind =
            |command, address, len| socket.has_untaken(&of(command, address, len, 9, 0).bytes);
        assert_eq!(of_kind(13, 0x0910_0000, 8), Some(true));
        assert_eq!((of_kind(7, 0, 2), socket.has_untaken(&[0; 20])), (None, None));
    }

    #[test]
    fn what_nobody_takes_is_bounded_and_counted() {
        let mut socket = PacketSocket { protocol: Protocol::All, ..Default::default() };
        let taken = (0..MOST + 3).filter(|_| socket.offer(&frame(0, 0))).count();
        assert_eq!(taken, MOST);
        assert_eq!(socket.dropped, 3);
        assert_eq!(std::iter::from_fn(|| socket.take()).count(), MOST);
    }
}
