//! What lies behind the packet sockets.

use isocat_wire::time::{Host, Time};

use crate::kernel::MachineFault;

/// A frame that comes back.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct WireAnswer {
    /// When its last bit is there.
    pub at: Time<Host>,
    /// At which interface: its place among those that were named.
    pub interface: usize,
    /// All of it, from the destination address on.
    pub bytes: Vec<u8>,
}

/// Something that takes frames and gives answers, in virtual time. Instants never go back.
pub trait Wire {
    /// A frame whose first bit is sent at `at` from an interface. What comes back goes to
    /// `answers`, in whatever order.
    fn send(
        &mut self,
        interface: usize,
        at: Time<Host>,
        frame: &[u8],
        answers: &mut Vec<WireAnswer>,
    );

    /// Time has gone on to `now` and no frame was sent.
    fn advance(&mut self, now: Time<Host>);

    /// When [`advance`](Self::advance) is wanted next, if nothing is sent.
    fn next_timeout(&self, now: Time<Host>) -> Option<Time<Host>>;

    /// Takes what has begun to happen to the program's machine since the last call.
    fn take_machine_faults(&mut self) -> Vec<MachineFault>;
}
