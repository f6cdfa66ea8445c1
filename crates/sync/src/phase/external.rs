//! External time: pairs of stamps, and the line through them.
//!
//! There are two kinds of pairs. A bridge between two segments stamps both system times at once and
//! shows them in object 0x10F4 ([`BridgeStatus`]). A network card with a hardware clock (PTP) is
//! read between two readings of the host's clock. Both become pairs of host time and external time
//! and go through a [`Servo`], the filter that also serves the reference clock.

use isocat_wire::time::{Dc, External, Host, Nanos, Time};

use super::servo::{Servo, State};
use super::settings::Settings;

/// The properties of the pairs of external time.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Source {
    /// Time from one pair to the next, above zero. Bridges: 0x10F5:11.
    pub interval: Nanos,
    /// Standard deviation of a stamp. A bridge has the 10 ns of its clocks, twice; a hardware clock
    /// has the variable part of the reading time.
    pub noise: Nanos,
    /// Readings of a hardware clock that take longer are not used.
    pub longest_read: Nanos,
}

impl Default for Source {
    /// A pair every 10 ms, with a noise of 100 ns, read within 20 us.
    fn default() -> Self {
        Self { interval: Nanos::millis(10), noise: Nanos(100), longest_read: Nanos::micros(20) }
    }
}

/// Stamps of the same instant, or nearly so.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Stamps {
    /// Stamps of a bridge, one for each of its segments: 0x10F4:11 and 0x10F4:12.
    Bridge {
        /// System time of this segment.
        internal: Time<Dc>,
        /// System time of the other segment, in its units.
        external: Time<External>,
    },
    /// A hardware clock of the host, read between two readings of the host's clock.
    Hardware {
        /// Host time before the reading.
        before: Time<Host>,
        /// The hardware clock.
        external: Time<External>,
        /// Host time after the reading.
        after: Time<Host>,
    },
}

/// Object 0x10F4 "External Synchronization Status" as read by complete access: 24 bytes.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct BridgeStatus {
    /// Sub-index 01: 0 none, 1 the other segment follows this one, 2 this segment is to follow.
    pub mode: u8,
    /// Sub-index 0E: changes with each new control value.
    pub control_toggle: bool,
    /// Sub-index 0F: changes with each new pair of stamps.
    pub stamp_toggle: bool,
    /// Sub-index 10: the other side is not connected, or the stamps are not valid.
    pub invalid: bool,
    /// Sub-index 11: system time of this segment.
    pub internal: Time<Dc>,
    /// Sub-index 12: external time in units of system time.
    pub external: Time<External>,
    /// Sub-index 13: how often 0x0910 must be written with a higher (above zero) or lower time than
    /// the clock's.
    pub control: i32,
}

impl BridgeStatus {
    /// Length of the object in bytes.
    pub const LEN: usize = 24;

    /// Reads the object; all byte values are valid.
    pub fn parse(bytes: &[u8; Self::LEN]) -> Self {
        let flags = bytes[3];
        let time = |at: usize| {
            bytes[at..].first_chunk().map_or(0, |eight: &[u8; 8]| u64::from_le_bytes(*eight))
        };
        let [.., a, b, c, d] = *bytes;
        Self {
            mode: bytes[2] & 0x03,
            control_toggle: flags & 0x20 != 0,
            stamp_toggle: flags & 0x40 != 0,
            invalid: flags & 0x80 != 0,
            internal: Time::new(time(4)),
            external: Time::new(time(12)),
            control: i32::from_le_bytes([a, b, c, d]),
        }
    }

    /// The stamps, if they are valid, this segment is to follow, and they are newer than those that
    /// came with `last_toggle` (`None`: there were none).
    pub fn stamps(&self, last_toggle: Option<bool>) -> Option<Stamps> {
        let new = last_toggle != Some(self.stamp_toggle);
        let Self { internal, external, .. } = *self;
        (new && !self.invalid && self.mode == SYNC_SLAVE)
            .then_some(Stamps::Bridge { internal, external })
    }
}

/// [`BridgeStatus::mode`] of the side that follows.
const SYNC_SLAVE: u8 = 2;

/// External time as a line over host time.
#[derive(Clone, Debug)]
pub(super) struct Filter {
    source: Source,
    /// A servo whose system time is the external time.
    line: Servo,
}

impl Filter {
    /// No pair yet.
    pub fn new(source: Source) -> Self {
        let exact = Settings::new(source.interval, Nanos::ZERO);
        let noise = Nanos(source.noise.0.max(0));
        // The lock threshold is four deviations: of normal noise three pairs in a thousand lie
        // beyond three. The loop is slower than the host's own, since a leading clock must be
        // smooth.
        let settings = Settings {
            bandwidth_hz: 0.5,
            lock_threshold: exact.lock_threshold.max(Nanos(noise.0.saturating_mul(4))),
            lock_count: 16,
            outlier: exact.outlier.max(Nanos(noise.0.saturating_mul(20))),
            ..exact
        };
        Self { source, line: Servo::new(settings) }
    }

    /// Adds stamps; `servo` is the host's and converts system time to host time.
    pub fn sample(&mut self, stamps: Stamps, servo: &Servo) {
        let (host, external) = match stamps {
            Stamps::Bridge { internal, external } => {
                if servo.state() != State::Locked {
                    return;
                }
                (servo.host_at(internal), external)
            }
            Stamps::Hardware { before, external, after } => {
                let took = after - before;
                if took.0 < 0 || took > self.source.longest_read {
                    return;
                }
                (before + Nanos(took.0 / 2), external)
            }
        };
        self.line.sample(host, Time::new(external.count()));
    }

    /// Advances the time, so that missing pairs are noticed.
    pub fn handle_timeout(&mut self, now: Time<Host>) {
        self.line.handle_timeout(now);
    }

    /// The external time at `host`, its fraction of a nanosecond, and its rate relative to the
    /// host's clock; `None` unless it is locked.
    pub fn at(&self, host: Time<Host>) -> Option<(u64, f64, f64)> {
        let line = self.line.line();
        let (time, fraction) = line.at(host);
        (self.line.state() == State::Locked).then_some((time.count(), fraction, line.rate))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(flags: u8, mode: u8) -> [u8; 24] {
        let mut bytes = [0; 24];
        bytes[0] = 19;
        bytes[2] = mode;
        bytes[3] = flags;
        bytes[4..12].copy_from_slice(&0x0102_0304_0506_0708_u64.to_le_bytes());
        bytes[12..20].copy_from_slice(&0x1112_1314_1516_1718_u64.to_le_bytes());
        bytes[20..].copy_from_slice(&(-5_i32).to_le_bytes());
        bytes
    }

    #[test]
    fn the_object_in_its_places() {
        let status = BridgeStatus::parse(&image(0x40, 0xFE));
        assert_eq!((status.mode, status.control), (2, -5));
        assert_eq!(
            (status.control_toggle, status.stamp_toggle, status.invalid),
            (false, true, false)
        );
        assert_eq!(status.internal, Time::new(0x0102_0304_0506_0708));
        assert_eq!(status.external, Time::new(0x1112_1314_1516_1718));
        let status = BridgeStatus::parse(&image(0xA0, 1));
        assert_eq!(
            (status.mode, status.control_toggle, status.stamp_toggle, status.invalid),
            (1, true, false, true)
        );
    }

    #[test]
    fn stamps_once_for_each_toggle_and_only_valid_ones() {
        let new = BridgeStatus::parse(&image(0x40, 2));
        let stamps = Stamps::Bridge { internal: new.internal, external: new.external };
        assert_eq!(new.stamps(None), Some(stamps));
        assert_eq!(new.stamps(Some(false)), Some(stamps));
        assert_eq!(new.stamps(Some(true)), None);
        assert_eq!(BridgeStatus::parse(&image(0xC0, 2)).stamps(Some(false)), None);
        assert_eq!(BridgeStatus::parse(&image(0x40, 1)).stamps(Some(false)), None);
    }
}
