//! What acyclic frames may take of a cycle's time on the wire.

use isocat_wire::frame::{self, duration_ns};
use isocat_wire::time::{Host, Nanos, Time};

use crate::config::Config;
use crate::cycle::CyclicExchange;
use crate::segment::GAP;

/// Share of acyclic frames in the present cycle.
#[derive(Default)]
pub(super) struct Share {
    cycle: u64,
    left: i64,
    /// When the port has sent the last one and the gap behind it.
    free: Time<Host>,
}

impl Share {
    /// A frame leaves when the port is free from `now` on.
    pub(super) fn take(&mut self, now: Time<Host>, len: usize) {
        let duration = duration_ns(len) as i64;
        self.left -= duration;
        self.free = now.max(self.free) + Nanos(duration) + GAP;
    }

    /// Most bytes that an acyclic frame may have now, the first datagram waiting being `first`
    /// long; `None` if it must wait.
    ///
    /// Acyclic frames follow those of the cycle, take no more than their share of it, and are
    /// through before the next cycle. The first of a cycle may exceed the share, so that long
    /// mailboxes get through short cycles at all. One that no cycle has room for goes out all the same, or
    /// everything would wait for it: the next cycle is late then.
    pub(super) fn room(
        &mut self,
        cycle: &CyclicExchange,
        config: &Config,
        now: Time<Host>,
        first: usize,
    ) -> Option<usize> {
        if !cycle.is_sent() {
            return None;
        }
        let share = config.cycle.0 * i64::from(config.acyclic_share) / 100;
        let fresh = self.cycle != cycle.number();
        if fresh {
            *self = Share { cycle: cycle.number(), left: share, free: self.free };
        }
        // Several in a row leave one behind the other: the last of them must be through as well.
        let free = now.max(self.free).max(cycle.through());
        let until_next = (cycle.due() - free).0 - GAP.0;
        let needed = duration_ns(first) as i64;
        let hopeless = fresh && needed + GAP.0 > cycle.spare().0;
        if needed > until_next && !hopeless || needed > self.left && self.left < share {
            return None;
        }
        let time = self.left.min(until_next).max(needed);
        // The bytes of a frame that takes this long, preamble and FCS taken off.
        let bytes = time as u64 / frame::BYTE_TIME_NS;
        Some((bytes as usize).saturating_sub(12).max(first))
    }
}
