//! How often to read, so that the frames take at most their share of the wire.

use isocat_wire::frame;
use isocat_wire::time::{Host, Nanos, Time};

/// Tells when to read next, by the cost of the reads before.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pace {
    /// Permille of the wire time.
    share: i64,
    /// Number of parts that divide the share; one part is used here.
    parts: i64,
    next: Time<Host>,
    spent: Nanos,
}

impl Pace {
    /// A share in permille, from `now` on.
    pub fn new(share_permille: u16, now: Time<Host>) -> Self {
        Self { share: i64::from(share_permille.max(1)), parts: 1, next: now, spent: Nanos::ZERO }
    }

    /// Sets the number of parts from now on.
    pub fn divide(&mut self, parts: i64) {
        self.parts = parts;
    }

    pub fn is_due(&self, now: Time<Host>) -> bool {
        now >= self.next
    }

    /// Adds wire time. A late read shortens at most one pause.
    pub fn charge(&mut self, now: Time<Host>, cost: Nanos) {
        self.spent += cost;
        self.next = (self.next + Nanos(cost.0 * 1_000 * self.parts / self.share)).max(now);
    }

    /// Pauses, because there is nothing to read now.
    pub fn rest(&mut self, now: Time<Host>, pause: Nanos) {
        self.next = self.next.max(now + pause);
    }

    /// Wire time of all reads so far.
    pub fn spent(&self) -> Nanos {
        self.spent
    }
}

/// The time that datagrams of these lengths take in one frame, including preamble and gap.
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

    /// 1 us at half of 10 permille is due every 200 us, to the nanosecond.
    #[test]
    fn due_when_the_share_allows_it() {
        let mut pace = Pace::new(10, Time::new(0));
        pace.divide(2);
        assert!(pace.is_due(Time::new(0)));
        pace.charge(Time::new(0), Nanos(1_000));
        assert_eq!([199_999, 200_000].map(|at| pace.is_due(Time::new(at))), [false, true]);
        // It is late by 50 us, which shortens the next pause.
        pace.charge(Time::new(250_000), Nanos(1_000));
        assert_eq!([399_999, 400_000].map(|at| pace.is_due(Time::new(at))), [false, true]);
        // It is later than the next one, which is due at once; no further time is saved up.
        pace.charge(Time::new(900_000), Nanos(1_000));
        assert!(pace.is_due(Time::new(900_000)));
        pace.charge(Time::new(900_000), Nanos(1_000));
        assert_eq!([1_099_999, 1_100_000].map(|at| pace.is_due(Time::new(at))), [false, true]);
        assert_eq!(pace.spent(), Nanos(4_000));
    }

    /// A short frame is padded: 64 bytes with check sequence, 8 of preamble, 12 of gap.
    #[test]
    fn frames_of_their_own() {
        assert_eq!(wire_time([1].into_iter()), Nanos(84 * 80));
        let bytes = 14 + 2 + (12 + 100) + (12 + 8) + 24;
        assert_eq!(wire_time([100, 8].into_iter()), Nanos(bytes * 80));
    }
}
