//! The other direction: the reference clock follows the host's clock, or an external time.
//!
//! A system time written to register 0x0910 of the reference clock goes into its drift loop, as the
//! reference's own time goes into those of all other clocks. The value is never a raw time stamp
//! but a point of a trajectory. The trajectory begins where the servo's line finds the reference
//! clock, with the clock's rate. It changes its rate by a limited acceleration towards that of the
//! leading clock, and then its phase by a limited slew. The value for a frame is the trajectory at
//! that frame's time stamp, at most [`Limits::most`] from where the line expects the clock.
//!
//! System time never steps, so the difference that both clocks have when their rates have met stays
//! ([`Drive::offset`]). A program that needs the leading time adds this offset.
//!
//! The delay of a frame between its stamp and the wire cannot be corrected: the value is chosen at
//! the stamp, but the clock is compared when the frame arrives. [`Drive::injected`] measures this
//! error.

use isocat_wire::time::{Dc, Host, Nanos, Time};

use super::external::{Filter, Source, Stamps};
use super::line::{Line, root};
use super::servo::{Servo, State};

/// How fast the reference clock may change.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Limits {
    /// Largest rate relative to the leading clock while a phase is corrected, ppb, above zero.
    pub slew_ppb: i64,
    /// Largest change of the rate, ppb per second, above zero.
    pub acceleration_ppb: i64,
    /// Largest distance of a written value from the time that the clock is expected to show, above
    /// zero.
    pub most: Nanos,
}

impl Default for Limits {
    /// A phase is corrected at 10 ppm, so 1 ms in 100 s. The rate changes by 1 ppm per second: two
    /// quartzes that differ by 50 ppm meet in 50 s. Drift loops that learn a rate in some four
    /// seconds, as those of the simulated chips do at 1 ms, are off by less than 100 ns meanwhile.
    /// 1000 ns is more than the usual delay of frames, and not more than the drift loop of a chip
    /// is known to accept as a steady difference.
    /// known to take for a steady difference.
    fn default() -> Self {
        Self { slew_ppb: 10_000, acceleration_ppb: 1_000, most: Nanos(1_000) }
    }
}

/// The error that the host injects into the segment's clocks: the written values, less what the
/// reference clock showed when they arrived.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct Injected {
    /// Number of values written since the rates met.
    pub count: u64,
    /// Mean, ns.
    pub mean_ns: f64,
    /// Standard deviation, ns.
    pub deviation_ns: f64,
    /// Largest absolute value, ns.
    pub peak_ns: u64,
}

/// Makes the reference clock follow a leading clock.
///
/// For each frame that can take a value, call [`value`](Self::value) when it is stamped, and
/// [`came_back`](Self::came_back) with what it found. Pairs of an external time come by
/// [`stamps`](Self::stamps).
#[derive(Clone, Debug)]
pub struct Drive {
    limits: Limits,
    /// External time as a line over host time; `None` if the host's clock leads.
    external: Option<Filter>,
    trajectory: Option<Line>,
    /// Leading time less system time, ns.
    offset: i64,
    /// Whether the rates have met once.
    led: bool,
    count: u64,
    mean: f64,
    squares: f64,
    peak: u64,
}

impl Drive {
    /// Follows the host's clock.
    pub fn after_host(limits: Limits) -> Self {
        Self {
            limits,
            external: None,
            trajectory: None,
            offset: 0,
            led: false,
            count: 0,
            mean: 0.0,
            squares: 0.0,
            peak: 0,
        }
    }

    /// Follows an external time.
    pub fn after_external(limits: Limits, source: Source) -> Self {
        Self { external: Some(Filter::new(source)), ..Self::after_host(limits) }
    }

    /// Adds stamps of the external time; `servo` is the host's. Does nothing if the host's clock
    /// leads.
    pub fn stamps(&mut self, stamps: Stamps, servo: &Servo) {
        if let Some(external) = &mut self.external {
            external.sample(stamps, servo);
        }
    }

    /// The value for register 0x0910 of the reference in a frame that is stamped `host`. `None`:
    /// nothing must be written, because the host or the external time is not locked.
    pub fn value(&mut self, host: Time<Host>, servo: &Servo) -> Option<Time<Dc>> {
        if let Some(external) = &mut self.external {
            external.handle_timeout(host);
        }
        let leading = match &self.external {
            None => Some((host.count(), 0.0, 0.0)),
            Some(external) => external.at(host),
        };
        let locked = servo.state() == State::Locked;
        let Some((time, fraction, leading_rate)) = leading.filter(|_| locked) else {
            self.trajectory = None;
            return None;
        };
        let found = servo.line().moved(host, 0.0);
        let Some(before) = self.trajectory else {
            self.trajectory = Some(found);
            return None;
        };
        let passed = (host - before.host).0;
        if passed <= 0 {
            return None;
        }
        let mut line = before.moved(host, 0.0);
        let rates = 1e9 * (leading_rate - line.rate);
        let difference = time.wrapping_sub(line.dc.count()) as i64;
        if !self.led {
            self.offset = difference;
            self.led = rates.abs() <= self.limits.slew_ppb as f64 / 2.0;
        }
        let behind = difference.wrapping_sub(self.offset) as f64 + fraction - line.fraction;
        // Units are ns and ppb, which is ns per second. The slew is slow enough to brake in time:
        // v² = 2 a s, with half of the acceleration in reserve.
        let braking = root(self.limits.acceleration_ppb as f64 * behind.abs());
        let slew = braking.min(behind.abs()).min(self.limits.slew_ppb as f64);
        let wanted = rates + if behind < 0.0 { -slew } else { slew };
        let most = self.limits.acceleration_ppb as f64 * passed as f64 / 1e9;
        line.rate += wanted.clamp(-most, most) / 1e9;
        // If the clock cannot follow, the trajectory waits for it.
        let ahead = (line.dc - found.dc).0 as f64 + line.fraction - found.fraction;
        let most = self.limits.most.0 as f64;
        let line = line.moved(host, ahead.clamp(-most, most) - ahead);
        self.trajectory = Some(line);
        // A drift loop may take a value whose lower half is zero as "no time".
        let zero = line.dc.count() as u32 == 0;
        Some(line.dc + Nanos(i64::from(zero)))
    }

    /// A frame returned that wrote `written` to the reference clock when the clock showed `found`.
    pub fn came_back(&mut self, written: Time<Dc>, found: Time<Dc>) {
        if !self.led {
            return;
        }
        let difference = (written - found).0;
        self.count += 1;
        let from_mean = difference as f64 - self.mean;
        self.mean += from_mean / self.count as f64;
        self.squares += from_mean * (difference as f64 - self.mean);
        self.peak = self.peak.max(difference.unsigned_abs());
    }

    /// Restarts for another reference clock; only the pairs of external time are kept.
    pub fn reset(&mut self) {
        *self = Self { external: self.external.take(), ..Self::after_host(self.limits) };
    }

    /// The error injected into the segment's clocks since the rates met.
    pub fn injected(&self) -> Injected {
        let variance = self.squares / self.count.max(1) as f64;
        Injected {
            count: self.count,
            mean_ns: self.mean,
            deviation_ns: root(variance),
            peak_ns: self.peak,
        }
    }

    /// The leading time less the system time, which is kept; `None` before the rates met.
    pub fn offset(&self) -> Option<Nanos> {
        self.led.then_some(Nanos(self.offset))
    }

    /// How far the reference clock is behind its target (negative: ahead), by the lines; `None`
    /// before the rates met or while the external time is not locked.
    pub fn behind(&self, host: Time<Host>, servo: &Servo) -> Option<Nanos> {
        let time = match &self.external {
            None => host.count(),
            Some(external) => external.at(host)?.0,
        };
        let difference = time.wrapping_sub(servo.dc_at(host).count()) as i64;
        self.offset().map(|offset| Nanos(difference) - offset)
    }
}

#[cfg(test)]
mod tests;
