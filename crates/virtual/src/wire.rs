//! The segment behind the packet sockets.

use isocat_wire::time::{Host, Time};

use crate::kernel::MachineFault;

/// A frame that comes back.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct WireAnswer {
    /// The instant at which its last bit has arrived.
    pub at: Time<Host>,
    /// The index of the interface at which it arrives, among those that were named.
    pub interface: usize,
    /// Its bytes, from the destination address on.
    pub bytes: Vec<u8>,
}

/// Takes frames and returns answers in virtual time. Instants never go back.
pub trait Wire {
    /// Sends a frame whose first bit leaves an interface at `at`. The frames that come back are
    /// added to `answers`, in any order.
    fn send(
        &mut self,
        interface: usize,
        at: Time<Host>,
        frame: &[u8],
        answers: &mut Vec<WireAnswer>,
    );

    /// Notes that the program is about to send a frame with process data or the reference's time by
    /// a socket from which it takes frames, and whether the answer to the last one of its kind lies
    /// there and was not taken.
    fn about_to_send(&mut self, has_untaken: bool) {
        let _ = has_untaken;
    }

    /// Advances time to `now` without a frame.
    fn advance(&mut self, now: Time<Host>);

    /// The next instant at which [`advance`](Self::advance) is needed if no frame is sent.
    fn next_timeout(&self, now: Time<Host>) -> Option<Time<Host>>;

    /// Takes the faults of the program's machine that have begun since the last call.
    fn take_machine_faults(&mut self) -> Vec<MachineFault>;
}
