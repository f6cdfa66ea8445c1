//! The wire time that acyclic frames may take in a cycle.

use isocat_wire::frame::{self, duration_ns};
use isocat_wire::time::{Host, Nanos, Time};

use crate::config::Config;
use crate::cycle::CyclicExchange;
use crate::segment::GAP;

/// The share of acyclic frames in the present cycle.
#[derive(Default)]
pub(super) struct Share {
    cycle: u64,
    left: i64,
    /// When the port will have sent the last acyclic frame and the gap after it.
    free: Time<Host>,
}

/// The share before operation, percent: the most that the configuration may ask for.
const BEFORE_OPERATION: u8 = 90;

/// Most bytes of an acyclic frame that finds room in each cycle, within the share.
pub(super) fn most_octets(cycle: &CyclicExchange, config: &Config) -> usize {
    let share = config.cycle.0 * i64::from(config.acyclic_share) / 100;
    octets(share.min((cycle.spare() - GAP).0))
}

/// The bytes of a frame that takes this long, ns, less preamble and FCS.
fn octets(time: i64) -> usize {
    (time.max(0) as u64 / frame::BYTE_TIME_NS).saturating_sub(12) as usize
}

impl Share {
    /// Takes the time of a frame that leaves as soon as the port is free, from `now` on.
    pub(super) fn take(&mut self, now: Time<Host>, len: usize) {
        let duration = duration_ns(len) as i64;
        self.left -= duration;
        self.free = now.max(self.free) + Nanos(duration) + GAP;
    }

    /// Most bytes that an acyclic frame may have now; `first` is the length of the first waiting
    /// datagram. `None` if it must wait.
    ///
    /// Acyclic frames follow those of the cycle, take at most their share of it, and end before the
    /// next cycle. The first of a cycle may exceed the share, so that long mailboxes fit into short
    /// cycles. A frame that is too long for any cycle is sent nevertheless, since all others would
    /// wait for it; the next cycle is then late.
    ///
    /// Before operation, no application waits for the rest of the cycle, so they may have nearly
    /// all of it.
    pub(super) fn room(
        &mut self,
        cycle: &CyclicExchange,
        config: &Config,
        operates: bool,
        now: Time<Host>,
        first: usize,
    ) -> Option<usize> {
        if !cycle.is_sent() {
            return None;
        }
        let percent = if operates { config.acyclic_share } else { BEFORE_OPERATION };
        let share = config.cycle.0 * i64::from(percent) / 100;
        let fresh = self.cycle != cycle.number();
        if fresh {
            *self = Share { cycle: cycle.number(), left: share, free: self.free };
        }
        // Acyclic frames leave one after the other, and the last one must also end in time.
        let free = now.max(self.free).max(cycle.through());
        let until_next = (cycle.due() - free).0 - GAP.0;
        let needed = duration_ns(first) as i64;
        let hopeless = fresh && needed + GAP.0 > cycle.spare().0;
        if needed > until_next && !hopeless || needed > self.left && self.left < share {
            return None;
        }
        let time = self.left.min(until_next).max(needed);
        Some(octets(time).max(first))
    }
}
