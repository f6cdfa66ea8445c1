//! The local clock: a counter of 10 ns ticks whose speed two dividers trim.
//!
//! One divider adds a nanosecond every `start - difference + 2` ticks; the other removes one every
//! `start + difference + 2` ticks, so single ticks are 9, 10 or 11 ns long. In whole nanoseconds
//! this is the published relation between the speed counter and the speed: difference / (5 (start +
//! difference + 2) (start - difference + 2)). Between two changes of speed both the clock and its
//! inverse are closed forms.

use isocat_wire::Time;
use isocat_wire::time::Device;

/// Nanoseconds of the oscillator in one tick.
pub(crate) const TICK: u64 = 10;

/// A local clock since its last change of speed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Clock {
    /// The tick of the last change of speed.
    base: u64,
    /// Local time at that tick.
    local: u64,
    gain: Divider,
    loss: Divider,
}

impl Clock {
    /// A clock that shows `local` at `now` and runs at its nominal speed.
    pub fn new(local: u64, now: Time<Device>) -> Self {
        let divider = Divider::new(super::drift_loop::START, 0);
        Self { base: tick(now), local, gain: divider, loss: divider }
    }

    /// Local time in ns, 64 bits. Before the last change of speed the nominal speed is assumed.
    #[inline]
    pub fn local(&self, at: Time<Device>) -> u64 {
        let tick = tick(at);
        match tick.checked_sub(self.base) {
            Some(ticks) => self.local.wrapping_add(self.advance(ticks)),
            None => self.local.wrapping_sub((self.base - tick).wrapping_mul(TICK)),
        }
    }

    /// The first instant at or after `from` at which `span` ns of local time have passed since
    /// `from`. For a span of zero or less it is the first tick not before `from`; it is never if no
    /// run lasts that long.
    pub fn after(&self, from: Time<Device>, span: i64) -> Time<Device> {
        self.passed(from, span).0
    }

    /// The same, and the local time that has passed then since the tick of `from`, unless that is
    /// not known at once.
    pub fn passed(&self, from: Time<Device>, span: i64) -> (Time<Device>, Option<u64>) {
        if span <= 0 {
            return (ceil(from), None);
        }
        let from_tick = tick(from);
        // Counting from `from` keeps the numbers small.
        let clock = self.rebased(from_tick);
        let target = span as u64;
        if target < SOON && clock.base == from_tick {
            let (ticks, advance) = clock.soon(target as u32);
            return (Time::new((clock.base + u64::from(ticks)) * TICK), Some(advance.into()));
        }
        // Estimate with the mean speed, then correct: the phases of the dividers shift it by a few
        // ticks.
        let (plus, minus) = (u64::from(clock.gain.period), u64::from(clock.loss.period));
        let area = plus * minus;
        let speed = TICK * area + minus - plus;
        let ticks = match target.checked_mul(area) {
            Some(product) => product / speed,
            None => (u128::from(target) * u128::from(area) / u128::from(speed)) as u64,
        };
        if ticks > FAR {
            return (Time::NEVER, None);
        }
        let (ticks, advance) = first(ticks, target, |ticks| clock.advance(ticks));
        // Before the last change of speed, time passed at the nominal speed.
        let passed = (clock.base == from_tick).then_some(advance);
        (Time::new((clock.base + ticks) * TICK), passed)
    }

    /// The first number of ticks since the base in which the local time gains `target`, which is
    /// below [`SOON`], and what it gains in them: [`Self::passed`] in numbers of 32 bits.
    #[inline]
    fn soon(&self, target: u32) -> (u32, u32) {
        let (plus, minus) = (u64::from(self.gain.period), u64::from(self.loss.period));
        let area = plus * minus;
        // A period has 15 bits, so the product has no more than 61.
        let ticks = u64::from(target) * area / (TICK * area + minus - plus);
        let advance = |ticks| u64::from(self.gain_of(ticks as u32));
        let (ticks, advance) = first(ticks, target.into(), advance);
        (ticks as u32, advance as u32)
    }

    /// [`Self::advance`] of a number of ticks that is below [`SOON`] / 5.
    #[inline]
    fn gain_of(&self, ticks: u32) -> u32 {
        let pulses = |divider: &Divider| match ticks.checked_sub(divider.left) {
            Some(rest) => 1 + rest / divider.period,
            None => 0,
        };
        ticks * TICK as u32 + pulses(&self.gain) - pulses(&self.loss)
    }

    /// Counts from `now` on, which is not before the last change of speed; otherwise nothing is
    /// done. Returns the local time at the base.
    #[inline]
    pub fn count_from(&mut self, now: Time<Device>) -> Option<u64> {
        let tick = tick(now);
        if tick < self.base {
            return None;
        }
        *self = self.rebased(tick);
        Some(self.local)
    }

    /// Sets another speed from `now` on, and moves the local time by `step` ns. The dividers keep
    /// their phase: a new period counts from their next pulse on.
    #[inline]
    pub fn adjust(&mut self, now: Time<Device>, start: u16, difference: i16, step: i64) {
        *self = self.rebased(tick(now));
        self.local = self.local.wrapping_add_signed(step);
        self.gain.period = Divider::new(start, -difference).period;
        self.loss.period = Divider::new(start, difference).period;
    }

    /// The same clock counted from `tick` on, but not from before its last change of speed.
    #[inline]
    fn rebased(&self, tick: u64) -> Self {
        let base = tick.max(self.base);
        let ticks = base - self.base;
        if ticks == 0 {
            return *self;
        }
        let ((gained, gain), (lost, loss)) = match u32::try_from(ticks) {
            Ok(ticks) => (self.gain.pass_short(ticks), self.loss.pass_short(ticks)),
            Err(_) => (self.gain.pass(ticks), self.loss.pass(ticks)),
        };
        let advance = ticks.wrapping_mul(TICK).wrapping_add(gained).wrapping_sub(lost);
        Self { base, local: self.local.wrapping_add(advance), gain, loss }
    }

    /// Nanoseconds that the local time gains in the first `ticks` since the base.
    #[inline]
    fn advance(&self, ticks: u64) -> u64 {
        (ticks.wrapping_mul(TICK))
            .wrapping_add(self.gain.pulses(ticks))
            .wrapping_sub(self.loss.pulses(ticks))
    }
}

/// A counter that gives a pulse once a period.
#[derive(Clone, Copy, Debug)]
struct Divider {
    /// Ticks between two pulses.
    period: u32,
    /// Ticks from the base to the first pulse, at least 1.
    left: u32,
}

impl Divider {
    fn new(start: u16, difference: i16) -> Self {
        let start =
            i32::from(start.clamp(super::drift_loop::START_MIN, super::drift_loop::START_MAX));
        // The drift loop keeps the difference below the start; the lower limit 1 guards against
        // other callers.
        let period = (start + i32::from(difference) + 2).max(1) as u32;
        Self { period, left: period }
    }

    /// Pulses in the first `ticks` since the base.
    #[inline]
    fn pulses(&self, ticks: u64) -> u64 {
        match ticks.checked_sub(u64::from(self.left)) {
            Some(rest) => 1 + divide(rest, self.period).0,
            None => 0,
        }
    }

    /// Pulses in the first `ticks`, and the same counter behind them.
    fn pass(&self, ticks: u64) -> (u64, Self) {
        match ticks.checked_sub(u64::from(self.left)) {
            Some(rest) => {
                let (whole, rest) = divide(rest, self.period);
                (1 + whole, Self { left: self.period - rest, ..*self })
            }
            None => (0, Self { left: self.left - ticks as u32, ..*self }),
        }
    }

    /// The same for a number of ticks of 32 bits.
    #[inline]
    fn pass_short(&self, ticks: u32) -> (u64, Self) {
        match ticks.checked_sub(self.left) {
            Some(rest) => {
                let left = self.period - rest % self.period;
                (1 + u64::from(rest / self.period), Self { left, ..*self })
            }
            None => (0, Self { left: self.left - ticks, ..*self }),
        }
    }
}

/// Quotient and remainder. Most spans fit into 32 bits, and these divide several times as fast.
fn divide(number: u64, by: u32) -> (u64, u32) {
    match u32::try_from(number) {
        Ok(number) => (u64::from(number / by), number % by),
        Err(_) => (number / u64::from(by), (number % u64::from(by)) as u32),
    }
}

/// The first number of ticks after which a clock has gained `target` ns or more, and what it has
/// gained then. `ticks` is an estimate; a tick is 9 to 11 ns, so one step is usually enough.
#[inline]
fn first(mut ticks: u64, target: u64, gained: impl Fn(u64) -> u64) -> (u64, u64) {
    let mut advance = gained(ticks);
    while advance >= target && ticks > 0 {
        if advance - target < TICK - 1 {
            break;
        }
        let before = gained(ticks - 1);
        if before < target {
            break;
        }
        (ticks, advance) = (ticks - 1, before);
    }
    while advance < target {
        ticks += 1;
        advance = gained(ticks);
    }
    (ticks, advance)
}

/// The tick that an instant lies in.
pub(crate) fn tick(at: Time<Device>) -> u64 {
    at.count() / TICK
}

/// The first tick at or after an instant.
pub(crate) fn ceil(at: Time<Device>) -> Time<Device> {
    let over = at.count() % TICK;
    let ahead = if over == 0 { 0 } else { TICK - over };
    Time::new(at.count().saturating_add(ahead))
}

/// A span of local time, ns, that fits into 32 bits with all that is counted on the way.
const SOON: u64 = 1 << 30;
/// More ticks than any run has (2900 years).
const FAR: u64 = u64::MAX / TICK / 20;
