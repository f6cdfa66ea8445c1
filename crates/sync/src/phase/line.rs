//! A line that maps host time to system time.

use isocat_wire::time::{Dc, Host, Nanos, Time};

/// A point and a rate.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Line {
    /// A point of the line: the system time at `host`, with its fraction of a nanosecond.
    pub host: Time<Host>,
    pub dc: Time<Dc>,
    pub fraction: f64,
    /// Relative rate: how much faster system time runs than host time.
    pub rate: f64,
}

impl Line {
    /// The system time at `host`, and its fraction of a nanosecond.
    pub fn at(&self, host: Time<Host>) -> (Time<Dc>, f64) {
        let elapsed = host - self.host;
        let correction = self.fraction + elapsed.0 as f64 * self.rate;
        let whole = round(correction);
        (self.dc + elapsed + Nanos(whole), correction - whole as f64)
    }

    /// The distance of `dc` from the line at `host`, positive if `dc` is later, ns.
    pub fn error(&self, host: Time<Host>, dc: Time<Dc>) -> f64 {
        let (expected, fraction) = self.at(host);
        (dc - expected).0 as f64 - fraction
    }

    /// The same, to the bit, where the system time is not needed beside it: the difference is a
    /// whole number that a float holds, so that this is rounded once only.
    pub fn height(&self, host: Time<Host>, dc: Time<Dc>) -> f64 {
        let elapsed = (host - self.host).0;
        let ahead = (dc - self.dc).0.wrapping_sub(elapsed);
        ahead as f64 - (self.fraction + elapsed as f64 * self.rate)
    }

    /// The host time at which the line reaches `dc`.
    pub fn when(&self, dc: Time<Dc>) -> Time<Host> {
        let ahead = (dc - self.dc).0 as f64 - self.fraction;
        self.host + Nanos(round(ahead / (1.0 + self.rate)))
    }

    /// The same line with its point at `host`, moved by `correction` ns.
    pub fn moved(&self, host: Time<Host>, correction: f64) -> Self {
        let (dc, fraction) = self.at(host);
        let correction = fraction + correction;
        let whole = round(correction);
        Self { host, dc: dc + Nanos(whole), fraction: correction - whole as f64, ..*self }
    }
}

/// Rounds to the nearest whole number; `f64::round` needs std.
#[inline]
pub(super) fn round(value: f64) -> i64 {
    (value + 0.5_f64.copysign(value)) as i64
}

/// Square root to a thousandth, up to four million; `f64::sqrt` needs std.
pub(super) fn root(square: f64) -> f64 {
    ((square.max(0.0) * 1e6) as u64).isqrt() as f64 / 1e3
}

/// No two quartz clocks differ by more than 0.1 %, so a steeper line comes from a wrong reading.
pub(super) const RATE_LIMIT: f64 = 1e-3;
