//! How often something is read, so that its frames take no more of the wire than their share.

use isocat_wire::frame;
use isocat_wire::time::{Host, Nanos, Time};

/// Says when to read next, by what the reads before cost.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pace {
    /// So much wire time in 1000.
    share: i64,
    /// The share is one of so many parts.
    parts: i64,
    next: Time<Host>,
    spent: Nanos,
}

impl Pace {
    /// A share in permille, from `now` on.
    pub fn new(share_permille: u16, now: Time<Host>) -> Self {
        Self { share: i64::from(share_permille.max(1)), parts: 1, next: now, spent: Nanos::ZERO }
    }

    /// From now on one of so many parts.
    pub fn divide(&mut self, parts: i64) {
        self.parts = parts;
    }

    pub fn is_due(&self, now: Time<Host>) -> bool {
        now >= self.next
    }

    /// Counts wire time. What was read late is made up for once, no more.
    pub fn charge(&mut self, now: Time<Host>, cost: Nanos) {
        self.spent += cost;
        self.next = (self.next + Nanos(cost.0 * 1_000 * self.parts / self.share)).max(now);
    }

    /// There is nothing to read now.
    pub fn rest(&mut self, now: Time<Host>, pause: Nanos) {
        self.next = self.next.max(now + pause);
    }

    /// Wire time of all reads so far.
    pub fn spent(&self) -> Nanos {
        self.spent
    }
}

/// The time that datagrams of these lengths take in a frame of their own, preamble and gap included.
pub fn wire_time(lengths: impl Iterator<Item = usize>) -> Nanos {
    let overhead = isocat_wire::datagram::HEADER_LEN + isocat_wire::datagram::WKC_LEN;
    let datagrams: usize = lengths.map(|length| length + overhead).sum();
    let bytes = frame::ETHERNET_HEADER_LEN + frame::ETHERCAT_HEADER_LEN + datagrams;
    let on_wire = bytes.max(frame::MIN_LEN) + frame::WIRE_OVERHEAD;
    Nanos(on_wire as i64 * frame::BYTE_TIME_NS as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 1 us at one of two parts of 10 permille: every 200 us, to the nanosecond.
    #[test]
    fn due_when_the_share_allows_it() {
        let mut pace = Pace::new(10, Time::new(0));
        pace.divide(2);
        assert!(pace.is_due(Time::new(0)));
        pace.charge(Time::new(0), Nanos(1_000));
        assert_eq!([199_999, 200_000].map(|at| pace.is_due(Time::new(at))), [false, true]);
        // Late by 50 us, which the next one makes up for.
        pace.charge(Time::new(250_000), Nanos(1_000));
        assert_eq!([399_999, 400_000].map(|at| pace.is_due(Time::new(at))), [false, true]);
        // Later than the next one: that comes at once, and nothing is saved up.
        pace.charge(Time::new(900_000), Nanos(1_000));
        assert!(pace.is_due(Time::new(900_000)));
        pace.charge(Time::new(900_000), Nanos(1_000));
        assert_eq!([1_099_999, 1_100_000].map(|at| pace.is_due(Time::new(at))), [false, true]);
        assert_eq!(pace.spent(), Nanos(4_000));
    }

    /// A short frame is padded; 64 bytes with check sequence, 8 of preamble, 12 of gap.
    #[test]
    fn frames_of_their_own() {
        assert_eq!(wire_time([1].into_iter()), Nanos(84 * 80));
        let bytes = 14 + 2 + (12 + 100) + (12 + 8) + 24;
        assert_eq!(wire_time([100, 8].into_iter()), Nanos(bytes * 80));
    }
}
