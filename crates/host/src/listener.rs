//! A listener on a network interface: it receives what others send and receive there, and sends
//! nothing.

use std::os::fd::{AsFd, OwnedFd};

use isocat_wire::frame::{FrameError, payload};
use isocat_wire::time::{Host, Time};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;

use super::clock::Stamps;
use super::packet::{self, Hears};
use super::{LinkError, sys};

/// An interface in listening mode. It receives EtherCAT frames (EtherType 0x88A4, also with a VLAN
/// tag, and UDP) of every program on this machine and of the wire, in both directions.
///
/// It does not receive frames that a program sends past the kernel's taps (`PACKET_QDISC_BYPASS`,
/// XDP, its own driver), nor those that come back past the kernel. A MainDevice of this project
/// sends with that bypass, so on the same machine only its answers are received.
#[derive(Debug)]
pub struct Listener {
    socket: OwnedFd,
    interface: String,
    /// The kernel's number of the interface.
    index: u32,
    stamps: Stamps,
    /// Frames that the kernel dropped because its queue was full.
    dropped: u64,
}

/// A received frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Heard {
    /// Its length, bytes. A frame longer than the buffer was cut.
    pub len: usize,
    /// When the kernel stamped it.
    pub at: Time<Host>,
    /// Whether this machine sent it; otherwise it came in.
    pub sent: bool,
}

impl Listener {
    /// Opens an interface of the present network namespace, or of the named one. Needs
    /// `CAP_NET_RAW`; another namespace needs `CAP_SYS_ADMIN` too.
    pub fn open(interface: &str, namespace: Option<&str>) -> Result<Self, LinkError> {
        // A short queue would drop frames of a burst; dropped frames are counted.
        let options = [(libc::SOL_SOCKET, libc::SO_RCVBUFFORCE, BUFFER)];
        let (socket, index) = packet::open(interface, namespace, &options, Hears::BothWays)?;
        // At a mirror port frames have any address. If promiscuous mode is refused, broadcasts are
        // still received.
        let _ = sys::hear_all(socket.as_fd(), index);
        let interface = interface.to_owned();
        Ok(Self { socket, interface, index, stamps: Stamps::new(), dropped: 0 })
    }

    /// The interface.
    pub fn interface(&self) -> &str {
        &self.interface
    }

    /// Whether the interface still exists, up or down.
    pub fn is_there(&self) -> bool {
        let index = rustix::net::netdevice::name_to_index(&self.socket, &self.interface);
        index.is_ok_and(|index| index == self.index)
    }

    /// Sleeps until a frame arrives or `milliseconds` are over. Returns whether a frame may have
    /// arrived. A signal ends the sleep early.
    pub fn wait(&self, milliseconds: u32) -> Result<bool, LinkError> {
        let timeout = Timespec {
            tv_sec: i64::from(milliseconds / 1000),
            tv_nsec: i64::from(milliseconds % 1000) * 1_000_000,
        };
        let mut fds = [PollFd::new(&self.socket, PollFlags::IN)];
        match poll(&mut fds, Some(&timeout)) {
            Ok(ready) => Ok(ready > 0),
            Err(Errno::INTR) => Ok(false),
            Err(error) => Err(LinkError::os("waiting on", &self.interface, error.into())),
        }
    }

    /// Takes the next EtherCAT frame, if one has arrived. Frames of other protocols are skipped.
    /// `Err(Down)`: the interface went down; frames arrive again once it is up.
    pub fn receive(&mut self, buffer: &mut [u8]) -> Result<Option<Heard>, LinkError> {
        for _ in 0..MOST_PASSED_OVER {
            let taken = match sys::receive(self.socket.as_fd(), buffer, true) {
                Ok(taken) => taken,
                Err(error) => {
                    return match error {
                        Errno::AGAIN | Errno::INTR => Ok(None),
                        Errno::NETDOWN | Errno::NODEV => {
                            Err(LinkError::Down(self.interface.clone()))
                        }
                        error => Err(LinkError::os("receiving on", &self.interface, error.into())),
                    };
                }
            };
            let heard = taken.len.min(buffer.len());
            if is_ethercat(&buffer[..heard]) {
                let (at, _) = self.stamps.instant(taken.stamp);
                return Ok(Some(Heard { len: taken.len, at, sent: taken.outgoing }));
            }
        }
        Ok(None)
    }

    /// Number of frames of any protocol that were lost because the kernel's queue was full.
    pub fn dropped(&mut self) -> u64 {
        self.dropped += u64::from(sys::dropped(self.socket.as_fd()).unwrap_or(0));
        self.dropped
    }
}

/// Whether a frame is an EtherCAT frame, perhaps a damaged one.
fn is_ethercat(bytes: &[u8]) -> bool {
    match payload(bytes) {
        Ok(_) => true,
        Err(error) => matches!(error, FrameError::Length { .. }),
    }
}

/// Largest number of frames of other protocols that are skipped in one call, so that a flood blocks
/// nothing else.
const MOST_PASSED_OVER: usize = 1024;
/// Bytes of frames that may wait in the kernel: 8 MB, some seconds at a cycle of 1 ms.
const BUFFER: i32 = 8 << 20;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_of_ethercat_are_told_from_others() {
        let mut frame = vec![0xFF; 12];
        frame.extend([0x88, 0xA4, 0x02, 0x10, 1, 2]);
        frame.resize(60, 0);
        assert!(is_ethercat(&frame));
        // A length beyond the frame is a damaged frame.
        (frame[14], frame[15]) = (0xFF, 0x17);
        assert!(is_ethercat(&frame));
        frame[13] = 0xA5;
        assert!(!is_ethercat(&frame));
        assert!(!is_ethercat(&[]));
    }

    #[test]
    fn an_interface_that_is_not_there() {
        match Listener::open("isct-not-there", None) {
            Err(LinkError::Unknown { name, .. }) => assert_eq!(name, "isct-not-there"),
            // The process may not open raw sockets.
            Err(LinkError::Permission { .. }) => {}
            other => panic!("{other:?}"),
        }
    }
}
