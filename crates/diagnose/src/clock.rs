//! The reference clock and the drift frames that distribute its time.

use std::time::Duration;

use isocat_wire::Command;
use isocat_wire::register;

use crate::access::{Access, part};
use crate::known::Known;

/// Which device's clock a drift frame reads.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Reference {
    /// By station address (FRMW).
    Station(u16),
    /// By position (ARMW).
    Position(u16),
}

/// The drift frames of a capture.
#[derive(Clone, Debug, Default)]
pub(crate) struct Drift {
    /// FRMW and ARMW of 0x0910.
    pub count: u64,
    pub first: Option<Known<Duration>>,
    pub last: Option<Known<Duration>>,
    /// The device whose clock they read last, and the frame from which on it was this device.
    pub reference: Option<Known<Reference>>,
    /// How often the reference changed.
    pub changes: u64,
    /// Command of the last one.
    pub command: Option<Command>,
    /// Bytes of the time: 4 or 8.
    pub bytes: u16,
    /// The reference's system time as the last one brought it, and when.
    pub time: Option<(Known<u64>, Duration)>,
    /// The reference's system time as the last drift frame brought it, ns.
    led: Option<u64>,
    /// Working counter of the last drift frame whose time was not the one that was sent.
    answered: Option<u16>,
    /// The longest time without a drift frame since [`restart`](Self::restart), and the frame at
    /// its end. Where the reference's clock is known, the shorter of stamps and clock counts, as
    /// stamps may jump.
    pub gap: Option<Known<Duration>>,
    /// Drift frames since [`restart`](Self::restart).
    pub recent: u64,
    /// By how much the stamps' time from one drift frame to the next differed most from the
    /// reference's, ns; `None`: that was not seen. The many of the way up show coarse stamps best.
    stamps_off: Option<u64>,
    /// A clock was set since the last time.
    was_set: bool,
    /// Some time had bits beyond the lower 32. A clock of 32 bits has none there, also where eight
    /// bytes are read.
    is_wide: bool,
    /// Working counters of drift frames (clocks that took the time), each with the first frame that
    /// had it.
    clocks: Vec<Known<u16>>,
}

impl Drift {
    /// Notes an access if it distributes the reference time. Returns the reference's system time,
    /// 64 bits, if it was read.
    pub fn access(&mut self, access: &Access<'_>, at: Duration) -> Option<u64> {
        let reference = match access.command {
            Command::Frmw => Reference::Station(access.header.adp()),
            Command::Armw => Reference::Position(access.position?),
            _ => return self.reading(access, at),
        };
        let address = register::SYSTEM_TIME.address;
        if access.ado() != address || access.header.len < 4 {
            return None;
        }
        let frame = access.frame;
        // A reference before the tap has already answered, even if the frame does not come back.
        let before = access.sent.filter(|_| access.answered_before);
        let read = before.or_else(|| access.read().filter(|read| self.is_answered(access, read)));
        let time = read.and_then(|data| self.extended(access.ado(), data));
        let time = time.filter(|time| Some(*time) != self.led);
        if let Some(last) = self.last {
            let by_stamps = at.saturating_sub(last.value);
            let by_clock = self.led.zip(time).map(|(led, time)| time.saturating_sub(led));
            let gap = by_clock.map_or(by_stamps, |ns| by_stamps.min(Duration::from_nanos(ns)));
            if self.recent > 0 && self.gap.is_none_or(|longest| gap > longest.value) {
                self.gap = Some(Known { value: gap, frame });
            }
        }
        if let Some(wkc) = access.wkc()
            && self.clocks.last().is_none_or(|last| last.value != wkc)
            && self.clocks.len() < MOST_CHANGES
        {
            self.clocks.push(Known { value: wkc, frame });
        }
        self.count += 1;
        self.recent += 1;
        self.command = Some(access.command);
        self.bytes = if access.header.len >= 8 { 8 } else { 4 };
        self.first.get_or_insert(Known { value: at, frame });
        self.last = Some(Known { value: at, frame });
        match self.reference {
            Some(known) if known.value == reference => {}
            before => {
                self.changes += u64::from(before.is_some());
                self.reference = Some(Known { value: reference, frame });
            }
        }
        if let Some((time, (known, then))) = time.zip(self.time) {
            self.compare(at, then, time.checked_sub(known.value));
        }
        self.led = time.or(self.led);
        self.time = time.map(|value| (Known { value, frame }, at)).or(self.time);
        time
    }

    /// Holds what passed by the stamps from `then` to `at` against what passed by the clock, ns,
    /// unless that was set back meanwhile.
    fn compare(&mut self, at: Duration, then: Duration, by_clock: Option<u64>) {
        let was_set = std::mem::take(&mut self.was_set);
        let short = by_clock.filter(|ns| !was_set && u128::from(*ns) <= ESTIMATED.as_nanos());
        let Some(by_clock) = short else { return };
        let ns = |at: Duration| i128::try_from(at.as_nanos()).unwrap_or(i128::MAX);
        let off = (ns(at) - ns(then)).abs_diff(by_clock.into());
        let off = u64::try_from(off).unwrap_or(u64::MAX);
        self.stamps_off = self.stamps_off.max(Some(off));
    }

    /// Whether the reference put its time into a drift frame that came back with `read`.
    ///
    /// A reference that is gone leaves the field as it was sent, which is no new time. But a
    /// MainDevice that sends its estimate of the time hits it to the nanosecond in some percent of
    /// the frames: as many clocks as before then have answered.
    fn is_answered(&mut self, access: &Access<'_>, read: &[u8]) -> bool {
        if access.sent != Some(read) {
            self.answered = access.wkc();
            return true;
        }
        self.answered.is_some() && self.answered == access.wkc()
    }

    /// Notes a plain reading of the reference's system time.
    fn reading(&mut self, access: &Access<'_>, at: Duration) -> Option<u64> {
        let is_reference = match self.reference?.value {
            Reference::Station(station) => {
                access.command == Command::Fprd && access.header.adp() == station
            }
            Reference::Position(position) => {
                access.command == Command::Aprd && access.position == Some(position)
            }
        };
        if is_reference && access.covers(register::SYSTEM_TIME.address, 4) {
            let time = self.extended(access.ado(), access.read()?)?;
            // This is no frame of the drift loop; it only tells the present time.
            self.time = Some((Known { value: time, frame: access.frame }, at));
        }
        None
    }

    /// How inaccurate stamps are within some milliseconds, ns. `None`: too inaccurate to tell the
    /// reference's time by them, or not known.
    pub fn stamps_within(&self) -> Option<u64> {
        self.stamps_off.filter(|off| *off <= MOST_OFF_NS)
    }

    /// The reference's system time at an instant of the stamps, by the last reading and what passed
    /// since; `None`: that is too long ago, or stamps jumped or are too inaccurate.
    pub fn estimate(&self, at: Duration) -> Option<u64> {
        self.stamps_within()?;
        let (known, then) = self.time?;
        let since = at.checked_sub(then).filter(|since| *since <= ESTIMATED)?;
        Some(known.value.wrapping_add(since.as_nanos() as u64))
    }

    /// The time with all its bits. A time of 32 bits takes the upper half that brings it nearest
    /// to the time read before.
    fn extended(&mut self, first: u16, data: &[u8]) -> Option<u64> {
        let address = register::SYSTEM_TIME.address;
        if let Some(bytes) = part::<8>(first, data, address) {
            let time = u64::from_le_bytes(bytes);
            self.is_wide |= time > u32::MAX.into();
            if self.is_wide {
                return Some(time);
            }
        }
        let low = u32::from_le_bytes(part::<4>(first, data, address)?);
        let before = self.time.map_or(u64::from(low), |(known, _)| known.value);
        Some(nearest(low, before))
    }

    /// Whether drift frames near this frame counted fewer clocks than earlier ones; `None`: there
    /// are no drift frames, or more changes than are kept.
    pub fn fewer(&self, frame: usize) -> Option<bool> {
        if self.clocks.len() >= MOST_CHANGES {
            return None;
        }
        let until = |limit: usize| self.clocks.iter().take_while(move |known| known.frame < limit);
        let most = until(frame).map(|known| known.value).max()?;
        let holds = until(frame + NEAR).last()?.value;
        Some(holds < most)
    }

    /// Forgets how inaccurate stamps were.
    pub fn forget(&mut self) {
        self.restart();
        self.stamps_off = None;
    }

    /// Forgets the gaps so far, and counts again from here.
    pub fn restart(&mut self) {
        self.gap = None;
        self.recent = 0;
    }

    /// Notes that a clock was set: the next time does not follow the last one.
    pub fn set(&mut self) {
        self.was_set = true;
    }
}

/// Changes of the number of clocks that are kept.
const MOST_CHANGES: usize = 512;
/// Drift frames lie within this many frames of the process data of their cycle.
const NEAR: usize = 8;

/// Error of stamps up to which they tell the reference's time, ns.
const MOST_OFF_NS: u64 = 50_000;
/// Time after a reading for which stamps continue it: clocks of 50 ppm differ by 1 us then.
const ESTIMATED: Duration = Duration::from_millis(20);

/// The 64-bit time with these lower 32 bits that is nearest to `near`.
pub(crate) fn nearest(low: u32, near: u64) -> u64 {
    let behind = low.wrapping_sub(near as u32) as i32;
    near.wrapping_add_signed(behind.into())
}

#[cfg(test)]
mod tests {
    use isocat_wire::StationAddress;
    use isocat_wire::datagram::{Address, Header};

    use super::*;

    fn frame(drift: &mut Drift, frame: usize, sent: u64, back: (u64, u16)) -> Option<u64> {
        let (sent, data) = (sent.to_le_bytes(), back.0.to_le_bytes());
        let reference = Address::Station(StationAddress(0x1001), register::SYSTEM_TIME.address);
        let header = Header::new(Command::Frmw, 0, reference, 8);
        let access = Access {
            command: Command::Frmw,
            header,
            sent: Some(&sent),
            answered_before: false,
            back: Some((&data, back.1)),
            passed: None,
            position: None,
            frame,
        };
        drift.access(&access, Duration::from_millis(frame as u64))
    }

    /// A MainDevice sends its estimate. The answer that equals it is a time if as many clocks
    /// answered as before, and none if the reference did not.
    #[test]
    fn an_estimate_that_is_exact_is_a_time() {
        let mut drift = Drift::default();
        assert_eq!(frame(&mut drift, 0, 0, (0, 2)), None, "nothing is known yet");
        assert_eq!(frame(&mut drift, 1, 1_000, (1_010, 3)), Some(1_010));
        assert_eq!(frame(&mut drift, 2, 2_010, (2_010, 3)), Some(2_010));
        assert_eq!(frame(&mut drift, 3, 3_010, (3_010, 2)), None, "the reference is gone");
        assert_eq!(frame(&mut drift, 4, 4_010, (4_010, 3)), Some(4_010));
    }

    /// What stamps are worth is told by the times that came, also where one between them did not.
    #[test]
    fn stamps_are_as_good_as_the_clock_says() {
        let mut drift = Drift::default();
        for (number, time) in [(1, 1_000_000), (2, 2_000_400), (4, 4_000_100), (90, 95_000_000)] {
            if number == 4 {
                frame(&mut drift, 3, 7, (7, 0));
            }
            frame(&mut drift, number, 0, (time, 3));
        }
        assert_eq!(drift.stamps_within(), Some(400));
        let at = |us| Duration::from_micros(us);
        assert_eq!(drift.estimate(at(90_000)), Some(95_000_000));
        assert_eq!(drift.estimate(at(110_000)), Some(115_000_000));
        assert_eq!(drift.estimate(at(110_001)), None, "too long ago");
        assert_eq!(drift.estimate(at(89_999)), None, "the stamps jumped back");
        frame(&mut drift, 91, 0, (96_050_000, 3));
        assert_eq!(drift.stamps_within(), Some(50_000));
        frame(&mut drift, 92, 0, (97_100_001, 3));
        assert_eq!((drift.stamps_within(), drift.estimate(at(92_000))), (None, None));
        // Nothing was compared: readings are too far apart, or the clock was set back.
        drift.forget();
        frame(&mut drift, 120, 0, (125_000_000, 3));
        frame(&mut drift, 121, 0, (124_000_000, 3));
        assert_eq!(drift.stamps_within(), None);
        drift.set();
        frame(&mut drift, 122, 0, (125_500_000, 3));
        assert_eq!(drift.stamps_within(), None);
        frame(&mut drift, 123, 0, (126_500_000, 3));
        assert_eq!(drift.stamps_within(), Some(0));
    }

    /// Eight bytes of a clock of 32 bits have nothing in the upper half, and go on past its end.
    #[test]
    fn a_clock_of_32_bits_goes_on() {
        let mut drift = Drift::default();
        let end = 1_u64 << 32;
        assert_eq!(frame(&mut drift, 1, 0, (end - 400_000, 3)), Some(end - 400_000));
        assert_eq!(frame(&mut drift, 2, 0, (600_000, 3)), Some(end + 600_000));
        assert_eq!(frame(&mut drift, 3, 0, (1_600_000, 3)), Some(end + 1_600_000));
        assert_eq!(drift.stamps_within(), Some(0));
        // One of 64 bits that was set back stays where it says.
        let mut drift = Drift::default();
        assert_eq!(frame(&mut drift, 1, 0, (5 * end, 3)), Some(5 * end));
        assert_eq!(frame(&mut drift, 2, 0, (600_000, 3)), Some(600_000));
    }

    #[test]
    fn half_a_time_is_completed_by_the_nearest() {
        let near = 0x5_FFFF_FFF0;
        assert_eq!(nearest(0xFFFF_FFFF, near), 0x5_FFFF_FFFF);
        assert_eq!(nearest(0x0000_0010, near), 0x6_0000_0010);
        assert_eq!(nearest(0xFFFF_FF00, 0x6_0000_0010), 0x5_FFFF_FF00);
    }
}
