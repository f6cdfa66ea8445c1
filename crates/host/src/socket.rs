//! A raw Ethernet socket for EtherCAT frames.

use std::os::fd::{AsFd, BorrowedFd, OwnedFd};

use isocat_wire::time::{Host, Nanos, Time};
use rustix::event::{PollFd, PollFlags, poll};
use rustix::io::Errno;
use rustix::net::SendFlags;

use super::clock::{self, Stamps};
use super::packet::{self, Hears};
use super::{LinkError, sys};

/// An open network interface that sends and receives only EtherCAT frames (EtherType 0x88A4), as
/// whole Ethernet frames without their FCS. Own frames are not received.
#[derive(Debug)]
pub struct RawSocket {
    socket: OwnedFd,
    interface: String,
    /// The kernel's number of the interface.
    index: u32,
    stamps: Stamps,
}

/// A received frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Received {
    /// Its length, bytes. A frame longer than the buffer was cut.
    pub len: usize,
    /// The instant at which the kernel took it from the driver.
    pub at: Time<Host>,
    /// The instant at which it was taken from the kernel.
    pub taken: Time<Host>,
}

impl RawSocket {
    /// Opens an interface of the present network namespace, or of the named one (as `ip netns`
    /// names them). Needs `CAP_NET_RAW`; another namespace needs `CAP_SYS_ADMIN` too.
    pub fn open(interface: &str, namespace: Option<&str>) -> Result<Self, LinkError> {
        // Options for speed, and a buffer for more frames than are ever under way.
        let options = [
            (libc::SOL_SOCKET, libc::SO_RCVBUFFORCE, BUFFER),
            (libc::SOL_SOCKET, libc::SO_SNDBUFFORCE, BUFFER),
            (libc::SOL_PACKET, libc::PACKET_QDISC_BYPASS, 1),
        ];
        let (socket, index) = packet::open(interface, namespace, &options, Hears::Arrivals)?;
        Ok(Self { socket, interface: interface.to_owned(), index, stamps: Stamps::new() })
    }

    /// The interface.
    pub fn interface(&self) -> &str {
        &self.interface
    }

    /// Whether the interface is up and its cable has a signal; `None` if the system does not tell.
    pub fn has_carrier(&self) -> Option<bool> {
        sys::has_carrier(self.socket.as_fd(), &self.interface).ok()
    }

    /// Whether the interface still exists, up or down. An interface that was deleted and made again
    /// counts as another one, from which nothing is received.
    pub fn is_there(&self) -> bool {
        let index = rustix::net::netdevice::name_to_index(&self.socket, &self.interface);
        index.is_ok_and(|index| index == self.index)
    }

    /// How the interface collects arrivals; `None` if its driver does not tell.
    pub(super) fn coalescing(&self) -> Option<sys::Coalescing> {
        sys::coalescing(self.socket.as_fd(), &self.interface).ok()
    }

    /// Sends a frame. One system call.
    #[inline]
    pub fn send(&self, frame: &[u8]) -> Result<(), LinkError> {
        loop {
            let error = match rustix::net::send(&self.socket, frame, SendFlags::DONTWAIT) {
                Ok(_) => return Ok(()),
                Err(Errno::INTR) => continue,
                Err(error) => error,
            };
            return self.not_sent(error);
        }
    }

    #[cold]
    fn not_sent(&self, error: Errno) -> Result<(), LinkError> {
        match error {
            // The port's queue is full, or its other end is down: the frame is lost, as on a wire.
            Errno::AGAIN | Errno::NOBUFS => Ok(()),
            Errno::NETDOWN | Errno::NODEV | Errno::NXIO => {
                Err(LinkError::Down(self.interface.clone()))
            }
            error => Err(LinkError::os("sending on", &self.interface, error.into())),
        }
    }

    /// Takes the next frame, if one has arrived. One system call.
    #[inline]
    pub fn receive(&mut self, buffer: &mut [u8]) -> Result<Option<Received>, LinkError> {
        match sys::receive(self.socket.as_fd(), buffer, false) {
            Ok(sys::Taken { len, stamp, .. }) => {
                let (at, taken) = self.stamps.instant(stamp);
                Ok(Some(Received { len, at, taken }))
            }
            Err(Errno::AGAIN | Errno::INTR) => Ok(None),
            Err(error) => Err(self.not_received(error)),
        }
    }

    #[cold]
    fn not_received(&self, error: Errno) -> LinkError {
        match error {
            Errno::NETDOWN | Errno::NODEV => LinkError::Down(self.interface.clone()),
            error => LinkError::os("receiving on", &self.interface, error.into()),
        }
    }

    /// Sleeps until a frame arrives, `until` is reached or a signal comes. Returns whether a frame
    /// may have arrived. One system call.
    pub fn wait(&self, until: Option<Time<Host>>) -> Result<bool, LinkError> {
        self.wait_for(until.map(|until| until - clock::now()))
    }

    /// The same for this time.
    #[inline]
    pub(super) fn wait_for(&self, span: Option<Nanos>) -> Result<bool, LinkError> {
        let timeout = span.map(clock::timespec);
        let mut fds = [PollFd::new(&self.socket, PollFlags::IN)];
        match poll(&mut fds, timeout.as_ref()) {
            Ok(ready) => Ok(ready > 0),
            Err(Errno::INTR) => Ok(false),
            Err(error) => Err(LinkError::os("waiting on", &self.interface, error.into())),
        }
    }
}

impl AsFd for RawSocket {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }
}

/// Bytes of frames that may wait in the kernel: a burst of a thousand full ones.
const BUFFER: i32 = 4 << 20;
