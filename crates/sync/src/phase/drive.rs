//! The other direction: the reference clock is led after the host's clock, or after an external time.
//!
//! A system time written to register 0x0910 of the reference clock goes into its drift loop, as the
//! reference's own time goes into those of all other clocks. What is written here is never a raw time
//! stamp: a trajectory begins where the servo's line finds the reference clock, at the rate it has, and
//! changes its rate by a bounded acceleration towards that of the leading clock, then its phase by a
//! bounded slew. What is written for a frame is the trajectory at that frame's time stamp, at most
//! [`Limits::most`] from where the line expects the clock to be.
//!
//! System time never steps, so the difference between both clocks when the rates have met stays
//! as it was ([`Drive::offset`]); who needs the leading time itself adds it.
//!
//! What no law can take out is what holds a frame up between its stamp and the wire: the clock is
//! compared when the frame arrives, the value was chosen when it was stamped. [`Drive::injected`] has the figures.

use isocat_wire::time::{Dc, Host, Nanos, Time};

use super::external::{Filter, Source, Stamps};
use super::line::{Line, root};
use super::servo::{Servo, State};

/// How fast the reference clock may be led.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Limits {
    /// Largest rate beside that of the leading clock while a phase is caught up, ppb, above zero.
    pub slew_ppb: i64,
    /// Largest change of the rate, ppb a second, above zero.
    pub acceleration_ppb: i64,
    /// Farthest that a value written is from the time which the clock is expected to show, above zero.
    pub most: Nanos,
}

impl Default for Limits {
    /// A phase is caught up at 10 ppm, so 1 ms in 100 s. The rate changes by 1 ppm a second: two quartzes that
    /// differ by 50 ppm meet in 50 s, and drift loops that learn a rate in some four seconds, as those of
    /// the simulated chips do at 1 ms, are off by less than 100 ns meanwhile. 1000 ns are above what frames are held up as a rule, and not more than the drift loop of a chip is
    /// known to take for a steady difference.
    fn default() -> Self {
        Self { slew_ppb: 10_000, acceleration_ppb: 1_000, most: Nanos(1_000) }
    }
}

/// What was written, less what the reference clock showed when it came: what the host puts into the
/// segment's clocks.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct Injected {
    /// Values written since the rates met.
    pub count: u64,
    /// Mean, ns.
    pub mean_ns: f64,
    /// Standard deviation, ns.
    pub deviation_ns: f64,
    /// The farthest from zero, ns, without its sign.
    pub peak_ns: u64,
}

/// Leads the reference clock.
///
/// For each frame that can take a value: [`value`](Self::value) as it is stamped, and
/// [`came_back`](Self::came_back) with what it found. Pairs of an external time come by
/// [`stamps`](Self::stamps).
#[derive(Clone, Debug)]
pub struct Drive {
    limits: Limits,
    /// External time as a line over host time; `None`: the host's clock itself leads.
    external: Option<Filter>,
    trajectory: Option<Line>,
    /// Leading time less system time, ns.
    offset: i64,
    /// The rates have met once.
    led: bool,
    count: u64,
    mean: f64,
    squares: f64,
    peak: u64,
}

impl Drive {
    /// Leads after the host's clock.
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

    /// Leads after an external time.
    pub fn after_external(limits: Limits, source: Source) -> Self {
        Self { external: Some(Filter::new(source)), ..Self::after_host(limits) }
    }

    /// Takes stamps of the external time; `servo` is the host's. Nothing to do where the host's clock leads.
    pub fn stamps(&mut self, stamps: Stamps, servo: &Servo) {
        if let Some(external) = &mut self.external {
            external.sample(stamps, servo);
        }
    }

    /// The value for register 0x0910 of the reference in a frame that is stamped `host`. `None`: nothing is to be
    /// written, because the host or the external time is not locked.
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
        // In ns and ppb, which is ns a second. Slow enough to stop in time: v² = 2 a s, with half of that to spare.
        let braking = root(self.limits.acceleration_ppb as f64 * behind.abs());
        let slew = braking.min(behind.abs()).min(self.limits.slew_ppb as f64);
        let wanted = rates + if behind < 0.0 { -slew } else { slew };
        let most = self.limits.acceleration_ppb as f64 * passed as f64 / 1e9;
        line.rate += wanted.clamp(-most, most) / 1e9;
        // A clock that can't follow is waited for.
        let ahead = (line.dc - found.dc).0 as f64 + line.fraction - found.fraction;
        let most = self.limits.most.0 as f64;
        let line = line.moved(host, ahead.clamp(-most, most) - ahead);
        self.trajectory = Some(line);
        // A lower half of zero is what a drift loop may take for "no time".
        let zero = line.dc.count() as u32 == 0;
        Some(line.dc + Nanos(i64::from(zero)))
    }

    /// A frame came back in which `written` was written to the reference clock when that showed `found`.
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

    /// Another reference clock: everything but the pairs of external time begins anew.
    pub fn reset(&mut self) {
        *self = Self { external: self.external.take(), ..Self::after_host(self.limits) };
    }

    /// What was put into the segment's clocks since the rates met.
    pub fn injected(&self) -> Injected {
        let variance = self.squares / self.count.max(1) as f64;
        Injected {
            count: self.count,
            mean_ns: self.mean,
            deviation_ns: root(variance),
            peak_ns: self.peak,
        }
    }

    /// Leading time less system time, which is kept; `None` before the rates met.
    pub fn offset(&self) -> Option<Nanos> {
        self.led.then_some(Nanos(self.offset))
    }

    /// How far the reference clock is behind where it is led to (negative: ahead), by the lines; `None`
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
