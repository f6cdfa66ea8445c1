//! The local clock: a counter of 10 ns ticks whose speed two dividers trim.
//!
//! One divider adds a nanosecond every `start - difference + 2` ticks; the other removes one every
//! `start + difference + 2` ticks, so single ticks are 9, 10 or 11 ns long. In whole nanoseconds
//! this is the published relation between the speed counter and the speed: difference / (5 (start +
//! difference + 2) (start - difference + 2)). Between two changes of speed both the clock and its
//! inverse are closed forms.

use core::num::NonZeroU32;

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
    /// The speed counter start and difference that the periods of the dividers follow from.
    speed: (u16, i16),
    /// Ticks in a nanosecond of local time, 2^-[`PACE`].
    pace: u64,
}

impl Clock {
    /// A clock that shows `local` at `now` and runs at its nominal speed.
    pub fn new(local: u64, now: Time<Device>) -> Self {
        let speed = (super::drift_loop::START, 0);
        let divider = Divider::new(speed.0, speed.1);
        let mut clock =
            Self { base: tick(now), local, gain: divider, loss: divider, speed, pace: 0 };
        clock.set_pace();
        clock
    }

    /// Local time in ns, 64 bits. Before the last change of speed the nominal speed is assumed.
    #[inline(never)]
    pub fn local(&self, at: Time<Device>) -> u64 {
        self.local_now(at)
    }

    /// The same for the place at which it is asked for in every cycle.
    #[inline(always)]
    pub fn local_now(&self, at: Time<Device>) -> u64 {
        let tick = tick(at);
        let ticks = tick.wrapping_sub(self.base);
        if ticks < SHORT {
            return self.local.wrapping_add(self.short_advance(ticks as u32));
        }
        self.local_far(tick)
    }

    #[cold]
    #[inline(never)]
    fn local_far(&self, tick: u64) -> u64 {
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
        let mut clock = *self;
        clock.rebase(from_tick);
        if clock.base == from_tick
            && let Some((at, passed)) = clock.soon(span)
        {
            return (at, Some(passed));
        }
        let target = span as u64;
        // Estimate with the mean speed, then correct: the phases of the dividers shift it by a few
        // ticks.
        let (plus, minus) = (self.gain.period(), self.loss.period());
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

    /// [`Self::passed`] from the last change of speed on, in numbers of 32 bits; `None` if the span
    /// is not above zero, not below [`SOON`], or not found at once.
    #[inline(always)]
    pub fn soon(&self, span: i64) -> Option<(Time<Device>, u64)> {
        if !(1..SOON).contains(&(span as u64)) {
            return None;
        }
        let target = span as u64;
        // Estimated with the mean speed, and a tick more, so that it seldom has to be corrected.
        let mut ticks = ((target * self.pace) >> PACE) as u32 + 1;
        let ((gained, mut gain), (lost, mut loss)) =
            (self.gain.phase(ticks)?, self.loss.phase(ticks)?);
        let mut advance = u64::from(ticks) * TICK + u64::from(gained) - u64::from(lost);
        // A tick is 9 to 11 ns. What the last one added is seen by the phases of the dividers.
        while advance < target {
            (ticks, gain, loss) = (ticks + 1, gain + 1, loss + 1);
            advance += TICK;
            if gain == self.gain.period.get() {
                (gain, advance) = (0, advance + 1);
            }
            if loss == self.loss.period.get() {
                (loss, advance) = (0, advance - 1);
            }
        }
        while advance - target >= TICK - 1 {
            let last = TICK + u64::from(gain == 0) - u64::from(loss == 0);
            if advance - target < last {
                break;
            }
            (ticks, advance) = (ticks - 1, advance - last);
            gain = gain.checked_sub(1).unwrap_or(self.gain.period.get() - 1);
            loss = loss.checked_sub(1).unwrap_or(self.loss.period.get() - 1);
        }
        Some((Time::new((self.base + u64::from(ticks)) * TICK), advance))
    }

    /// Sets another speed from `now` on, and moves the local time by `step` ns. The dividers keep
    /// their phase: a new period counts from their next pulse on.
    #[inline(always)]
    pub fn adjust(&mut self, now: Time<Device>, start: u16, difference: i16, step: i64) {
        self.rebase(tick(now));
        self.local = self.local.wrapping_add_signed(step);
        if self.speed != (start, difference) {
            self.set_speed(start, difference);
        }
    }

    #[cold]
    #[inline(never)]
    fn set_speed(&mut self, start: u16, difference: i16) {
        self.speed = (start, difference);
        self.gain.period = Divider::new(start, -difference).period;
        self.loss.period = Divider::new(start, difference).period;
        self.set_pace();
    }

    fn set_pace(&mut self) {
        // A period has 15 bits.
        let (plus, minus) = (self.gain.period(), self.loss.period());
        let area = plus * minus;
        self.pace = (area << PACE) / (TICK * area + minus - plus);
    }

    /// The local time at `now`, if the clock counts from there.
    #[inline(always)]
    pub fn counted(&self, now: Time<Device>) -> Option<u64> {
        (self.base == tick(now)).then_some(self.local)
    }

    /// Counts from `tick` on, but not from before the last change of speed.
    #[inline(always)]
    fn rebase(&mut self, tick: u64) {
        let ticks = tick.saturating_sub(self.base);
        if ticks >= SHORT {
            return self.rebase_far(ticks);
        }
        self.base += ticks;
        let ticks = ticks as u32;
        let (gained, lost) = (self.gain.pass(ticks), self.loss.pass(ticks));
        let advance = u64::from(ticks) * TICK + u64::from(gained);
        self.local = self.local.wrapping_add(advance).wrapping_sub(lost.into());
    }

    /// The same for a number of ticks that may exceed 32 bits.
    #[cold]
    #[inline(never)]
    fn rebase_far(&mut self, ticks: u64) {
        let advance = self.advance(ticks);
        (self.base, self.local) = (self.base + ticks, self.local.wrapping_add(advance));
        for divider in [&mut self.gain, &mut self.loss] {
            // All ticks but the last ones are whole periods.
            let whole = ticks.saturating_sub(divider.left.into()) / divider.period();
            divider.pass((ticks - whole * divider.period()) as u32);
        }
    }

    /// Nanoseconds that the local time gains in the first `ticks` since the base.
    fn advance(&self, ticks: u64) -> u64 {
        (ticks.wrapping_mul(TICK))
            .wrapping_add(self.gain.pulses(ticks))
            .wrapping_sub(self.loss.pulses(ticks))
    }

    /// The same for a number of ticks below [`SHORT`].
    #[inline(always)]
    fn short_advance(&self, ticks: u32) -> u64 {
        let (gained, lost) = (self.gain.short_pulses(ticks), self.loss.short_pulses(ticks));
        u64::from(ticks) * TICK + u64::from(gained) - u64::from(lost)
    }
}

/// A counter that gives a pulse once a period.
#[derive(Clone, Copy, Debug)]
struct Divider {
    /// Ticks between two pulses.
    period: NonZeroU32,
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
        Self { period: NonZeroU32::new(period).unwrap_or(NonZeroU32::MIN), left: period }
    }

    fn period(&self) -> u64 {
        self.period.get().into()
    }

    /// Pulses in the first `ticks` since the base.
    fn pulses(&self, ticks: u64) -> u64 {
        ticks.checked_sub(u64::from(self.left)).map_or(0, |rest| 1 + rest / self.period())
    }

    /// The same for a number of ticks below [`SHORT`].
    #[inline(always)]
    fn short_pulses(&self, ticks: u32) -> u32 {
        (ticks + self.period.get()).checked_sub(self.left).map_or(0, |since| since / self.period)
    }

    /// Counts this number of ticks, which is below [`SHORT`], and returns the pulses in them.
    #[inline(always)]
    fn pass(&mut self, ticks: u32) -> u32 {
        // Ticks since the last pulse, had it come a period before the next one.
        match (ticks + self.period.get()).checked_sub(self.left) {
            Some(since) => {
                self.left = self.period.get() - since % self.period;
                since / self.period
            }
            None => {
                self.left -= ticks;
                0
            }
        }
    }

    /// Pulses in the first `ticks`, which are fewer than [`SHORT`], and the ticks since the last
    /// of them; `None` if the first pulse comes later than a period from now, as after a change of
    /// speed.
    #[inline(always)]
    fn phase(&self, ticks: u32) -> Option<(u32, u32)> {
        let since = ticks + self.period.get().checked_sub(self.left)?;
        Some((since / self.period, since % self.period))
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
/// A number of ticks, 10 s, to which a period can be added in 32 bits.
const SHORT: u64 = 1 << 30;
/// Fraction bits of the ticks in a nanosecond. With a span below [`SOON`] the product has 62 bits.
const PACE: u32 = 35;
/// More ticks than any run has (2900 years).
const FAR: u64 = u64::MAX / TICK / 20;
