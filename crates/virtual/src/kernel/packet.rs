//! Packet sockets, and the frames that wait in them.

use std::collections::VecDeque;
use std::rc::Rc;

use isocat_wire::time::{Host, Time};

/// Which frames a socket takes.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Protocol {
    /// None, until it is bound to one.
    #[default]
    None,
    /// Those of this EtherType.
    Type(u16),
    /// All.
    All,
}

/// A socket of the family `AF_PACKET`.
#[derive(Debug, Default)]
pub struct PacketSocket {
    /// The interface it is bound to: its place among the virtual ones. `None`: all.
    pub interface: Option<usize>,
    /// The frames it takes.
    pub protocol: Protocol,
    /// A `SOCK_DGRAM` socket: it leaves Ethernet headers to the kernel.
    pub cooked: bool,
    /// Receiving gives stamps of arrival, in this form (the `SO_` option that asked for it).
    pub stamps: Option<i32>,
    /// How long a receive waits (`SO_RCVTIMEO`); `None`: for ever.
    pub patience: Option<isocat_wire::time::Nanos>,
    /// Frames that were left out since the last look, as nobody took the earlier ones.
    pub dropped: u32,
    waiting: VecDeque<Arrived>,
}

/// A frame that arrived.
#[derive(Clone, Debug)]
pub struct Arrived {
    /// When the host had it.
    pub at: Time<Host>,
    /// At which of the virtual interfaces.
    pub interface: usize,
    /// The whole frame, from its destination address on.
    pub bytes: Rc<[u8]>,
}

/// Frames that wait in a socket at most; a kernel's default buffer holds some hundred.
const MOST: usize = 512;

impl PacketSocket {
    /// One that takes these frames from all interfaces.
    pub fn new(protocol: Protocol, cooked: bool) -> Self {
        Self { protocol, cooked, ..Self::default() }
    }

    /// A frame came in at an interface; gives whether this socket takes it.
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
        self.waiting.pop_front()
    }

    /// The oldest frame, which stays.
    pub fn peek(&self) -> Option<&Arrived> {
        self.waiting.front()
    }

    /// A receive would give something.
    pub fn is_readable(&self) -> bool {
        !self.waiting.is_empty()
    }

    /// Forgets frames of before it was bound anew.
    pub fn clear(&mut self) {
        self.waiting.clear();
    }
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
    fn what_nobody_takes_is_bounded_and_counted() {
        let mut socket = PacketSocket { protocol: Protocol::All, ..Default::default() };
        let taken = (0..MOST + 3).filter(|_| socket.offer(&frame(0, 0))).count();
        assert_eq!(taken, MOST);
        assert_eq!(socket.dropped, 3);
        assert_eq!(std::iter::from_fn(|| socket.take()).count(), MOST);
    }
}
