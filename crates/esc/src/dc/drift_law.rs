//! The unpublished part of the drift loop: how a time difference acts on the clock.
//!
//! No data sheet describes it. The public record (register texts, captures of real chips, figures
//! of users) admits two laws, [`DriftLaw::Hold`] and [`DriftLaw::Block`]. Neither is known to be
//! the law of a real chip, so a claim about synchronization should hold with both.
//! [`DriftLaw::Proportional`] contradicts the record and is kept for comparison.
//!
//! Both admissible laws have two parts. The *speed* is corrected by the growth of the difference
//! from one received time to the next, averaged over about 2^(register 0x0935) received times. The
//! corrected speed stays in force while no time is received. The *phase* is corrected by small
//! steps of the local time: at each received time a share of the filtered difference. The speed is
//! measured without these steps, so the two parts do not disturb each other, and no filter depth
//! makes them unstable.

use core::fmt;
use core::str::FromStr;

use super::drift_loop::{START as RESET_START, START_MAX, START_MIN};

#[cfg(test)]
mod tests;

/// Fraction bits of a time difference, ns.
pub(super) const FRACTION: u32 = 20;

/// How a received system time acts on a clock.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum DriftLaw {
    /// The change of the difference since the last received time corrects the mean speed by 1 /
    /// 2^(0x0935) of it. This law agrees with the whole public record.
    Hold {
        /// A step of phase is the filtered difference divided by 2^`phase`, at a speed counter
        /// start of 0x1000. The record admits 10 and 11.
        phase: u8,
    },
    /// As `Hold`, but the speed changes once in 2^(0x0935) received times, by all of the growth
    /// measured since the last change. This law agrees with the public record except for one
    /// detail: a single huge difference leaves no trace.
    Block {
        /// As for `Hold`. The record admits 9 and 10.
        phase: u8,
    },
    /// A proportional and integral controller in which the mean of the applied difference is the
    /// integral part:
    ///
    /// ```text
    /// applied = clamp(mean - gain * clamp(filtered difference))
    /// mean   += (applied - mean) / 2^(speed counter filter depth)        (the filter of register 0x0935)
    /// ```
    ///
    /// It locks far faster than the captured pair of ET1100 does. It is unstable at small values of
    /// 0x0935, where the data sheet recommends 0.
    Proportional {
        /// Speed counter difference for each ns of time difference, at a speed counter start of
        /// 0x1000 or more. Below that a unit is worth more, so the gain shrinks in proportion to
        /// the start.
        gain: u16,
        /// Largest time difference that is used for steering, ns.
        limit: u16,
    },
}

impl DriftLaw {
    /// The law that is used by default.
    pub const HOLD: Self = Self::Hold { phase: 10 };
    /// The other law that the record admits.
    pub const BLOCK: Self = Self::Block { phase: 9 };
    /// A gain of 4 corrects a difference with a time constant of about 20 ms at the reset value of
    /// 0x0930. At 1000 ns it asks for the whole range of 0x0932 there.
    pub const PROPORTIONAL: Self = Self::Proportional { gain: 4, limit: 1_000 };
    /// The laws by their names.
    pub const NAMED: [(&'static str, Self); 3] =
        [("hold", Self::HOLD), ("block", Self::BLOCK), ("proportional", Self::PROPORTIONAL)];
}

/// Prints `hold`, or `hold 11` if the parameter of the law is not the usual one.
impl fmt::Display for DriftLaw {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some((name, _)) = Self::NAMED.iter().find(|(_, law)| law == self) {
            return f.pad(name);
        }
        match self {
            Self::Hold { phase } => write!(f, "hold {phase}"),
            Self::Block { phase } => write!(f, "block {phase}"),
            Self::Proportional { gain, limit } => write!(f, "proportional {gain} {limit}"),
        }
    }
}

/// The error for a string that is not the name of a law.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct UnknownDriftLaw;

impl fmt::Display for UnknownDriftLaw {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("expected \"hold\", \"block\" or \"proportional\"")
    }
}

impl core::error::Error for UnknownDriftLaw {}

impl FromStr for DriftLaw {
    type Err = UnknownDriftLaw;

    fn from_str(text: &str) -> Result<Self, UnknownDriftLaw> {
        let named = Self::NAMED.iter().find(|(name, _)| *name == text);
        named.map(|(_, law)| *law).ok_or(UnknownDriftLaw)
    }
}

/// What is known when a system time is received.
#[derive(Clone, Copy, Debug)]
pub(super) struct Received {
    /// Local copy less received time, ns: positive when the local copy is ahead.
    pub difference: i32,
    /// The difference after the filter of register 0x0934, with [`FRACTION`] fraction bits.
    pub filtered: i64,
    /// Time since the last received time, or since register 0x0930 was written, in ns of the
    /// device's oscillator.
    pub interval: i64,
    /// This is the first time received since the loop was reset.
    pub first: bool,
    /// Register 0x0930.
    pub start: u16,
    /// Register 0x0934, 0..=15.
    pub time_depth: u8,
    /// Register 0x0935, 0..=15.
    pub speed_depth: u8,
}

/// The state of a law.
#[derive(Clone, Copy, Default, Debug)]
pub(super) struct Steering {
    /// Speed counter difference in force, with [`FRACTION`] fraction bits.
    applied: i64,
    /// Mean of the speed counter difference, as register 0x0932 shows it, with [`FRACTION`]
    /// fraction bits.
    mean: i64,
    /// Both as whole numbers.
    rounded: (i16, i16),
    /// Mean deviation of the clock's period that the law corrects, 2^-60.
    speed: i64,
    /// Sum of the phase steps so far, ns.
    stepped: i64,
    /// Remainder of the last step, with [`FRACTION`] fraction bits.
    rest: i64,
    /// Filtered difference without the steps, with [`FRACTION`] fraction bits.
    drifted: i64,
    /// The part of `drifted` that has already been counted as drift or was a jump.
    counted: i64,
    /// Number of received times in this block, and the length of the block in ns.
    block: (u32, i64),
    scale: Scale,
}

/// Numbers that follow from register 0x0930, kept since it hardly ever changes.
#[derive(Clone, Copy, Default, Debug)]
struct Scale {
    /// The register; `None` before the first time is received.
    register: Option<u16>,
    /// The register, within its useful values.
    start: u16,
    /// The change of the period by the largest speed counter difference, by [`speed_at`].
    largest: i64,
    /// The same by [`fastest`].
    fastest: i64,
    near: Near,
}

/// [`counter_difference`] near a speed for which it was computed: a parabola in the speed. The
/// default is near no speed.
#[derive(Clone, Copy, Default, Debug)]
struct Near {
    /// The speed, 2^-40.
    speed: i64,
    /// The difference there and a half, 2^-40.
    difference: i64,
    /// Its growth in 2^-40 of speed, 2^-40.
    slope: i64,
    /// The part of it that grows with the square of a change, 2^-30.
    bend: i64,
    /// The largest change of the difference, 2^-40.
    reach: i64,
}

impl Scale {
    #[cold]
    fn of(register: u16) -> Self {
        let start = register.clamp(START_MIN, START_MAX);
        let largest = speed_at(range(start), start);
        let (register, fastest) = (Some(register), fastest(start));
        Self { register, start, largest, fastest, near: Near::default() }
    }
}

impl Steering {
    /// Handles a received system time. Returns the step of the local time, ns.
    #[inline(always)]
    pub fn follow(&mut self, law: &DriftLaw, received: &Received) -> i64 {
        if self.scale.register != Some(received.start) {
            self.scale = Scale::of(received.start);
        }
        let phase = match *law {
            DriftLaw::Hold { phase } => {
                self.drift(received);
                self.hold(received);
                phase
            }
            DriftLaw::Block { phase } => {
                self.drift(received);
                self.block(received.interval, received.first, received.speed_depth);
                phase
            }
            DriftLaw::Proportional { gain, limit } => {
                self.proportional(&received.clone(), i64::from(gain), i64::from(limit));
                return 0;
            }
        };
        match self.scale.near.difference(self.speed) {
            Some(whole) if whole == self.rounded.0.into() => {}
            Some(whole) => self.set(whole << FRACTION, whole << FRACTION),
            None => self.apply_speed(),
        }
        self.step(received, phase)
    }

    /// The speed counter difference in force.
    #[inline(always)]
    pub const fn applied(&self) -> i16 {
        self.rounded.0
    }

    /// The speed counter difference as register 0x0932 shows it.
    #[inline(always)]
    pub const fn shown(&self) -> i16 {
        self.rounded.1
    }

    /// Restarts the measurement of the difference; the speed stays.
    pub fn forget_difference(&mut self) {
        (self.stepped, self.rest, self.drifted, self.counted) = (0, 0, 0, 0);
    }

    /// Restarts the speed.
    pub fn forget_speed(&mut self) {
        (self.speed, self.block) = (0, (0, 0));
        self.set(0, 0);
    }

    /// Sets the speed counter difference in force, and its mean.
    fn set(&mut self, applied: i64, mean: i64) {
        (self.applied, self.mean) = (applied, mean);
        self.rounded = (round(applied) as i16, round(mean) as i16);
    }

    /// Updates the filtered difference as it would be without steps of phase.
    #[inline(always)]
    fn drift(&mut self, received: &Received) {
        let sample = (i64::from(received.difference) - self.stepped) << FRACTION;
        self.drifted += (sample - self.drifted) >> received.time_depth;
    }

    /// Law `Hold`: the growth of the difference since the last received time corrects the speed.
    #[inline(always)]
    fn hold(&mut self, received: &Received) {
        let interval = received.interval.clamp(1, LONGEST);
        let most = (interval * self.scale.largest) >> 20;
        let mut grown = self.drifted - self.counted;
        if exceeds(grown, most) {
            grown = self.grow_suddenly((grown, most), received.first, received.speed_depth);
        } else {
            self.counted = self.drifted;
        }
        let deviation = ((grown << 20) / interval) << 20;
        self.speed = within(self.speed - (deviation >> received.speed_depth), self.scale.fastest);
    }

    /// The difference has grown by more than any drift, which is `most`. Returns what counts as
    /// drift.
    #[cold]
    fn grow_suddenly(&mut self, (grown, most): (i64, i64), is_first: bool, depth: u8) -> i64 {
        let drift = grown.clamp(-most, most);
        let rest = grown - drift;
        // A remainder of the size of ticks and nibbles may be left for the next time. A jump is not
        // drift, and neither is the first difference. Without a filter the remainder acts at once,
        // and a nibble would make the loop overshoot: there everything beyond ticks counts as a
        // jump.
        let (grain, jump) = if depth == 0 { (TICKS, TICKS) } else { (NIBBLE, JUMP) };
        let drifts = !is_first && rest.abs() <= jump;
        self.counted = self.drifted - if drifts { rest.clamp(-grain, grain) } else { 0 };
        drift
    }

    /// Law `Block`: when the block is full, the growth of the difference since its start corrects
    /// the speed.
    #[inline(never)]
    fn block(&mut self, interval: i64, is_first: bool, depth: u8) {
        if is_first {
            self.counted = self.drifted;
            self.block = (0, 0);
            return;
        }
        let (count, span) = self.block;
        self.block = (count + 1, span.saturating_add(interval.max(1)));
        if self.block.0 < 1 << depth {
            return;
        }
        let limit = self.scale.fastest;
        let grown = i128::from(self.drifted - self.counted) << 40;
        let deviation = grown / i128::from(self.block.1);
        let deviation = deviation.clamp(i128::from(-2 * limit), i128::from(2 * limit)) as i64;
        self.speed = (self.speed - deviation).clamp(-limit, limit);
        self.counted = self.drifted;
        self.block = (0, 0);
    }

    /// Applies the whole speed counter difference that compensates the mean deviation.
    #[cold]
    fn apply_speed(&mut self) {
        let start = self.scale.start;
        let (fixed, limit) = (counter_difference(self.speed, start), i64::from(range(start)));
        let applied = whole(fixed).clamp(-limit, limit) << FRACTION;
        self.set(applied, applied);
        self.scale.near = Near::of(self.speed, fixed, start);
    }

    /// Takes off a share of the filtered difference at once, in whole ns.
    #[inline(always)]
    fn step(&mut self, received: &Received, phase: u8) -> i64 {
        // More than 8 ms asks for the largest step anyway.
        let mut share = within(received.filtered, 1 << 43);
        if self.scale.start != RESET_START {
            share = share * i64::from(RESET_START) / i64::from(self.scale.start);
        }
        let wanted = self.rest - within(share >> phase.min(20), LARGEST_STEP);
        let whole = wanted >> FRACTION;
        self.rest = wanted - (whole << FRACTION);
        self.stepped += whole;
        whole
    }

    /// Law `Proportional`.
    #[inline(never)]
    fn proportional(&mut self, received: &Received, gain: i64, limit: i64) {
        let steering = received.filtered.clamp(-(limit << FRACTION), limit << FRACTION);
        let share = i64::from(self.scale.start.min(RESET_START));
        let wanted = gain * (steering * share / i64::from(RESET_START));
        let wanted = self.mean - self.patient(wanted, steering, gain, received);
        let range = i64::from(range(self.scale.start)) << FRACTION;
        let applied = wanted.clamp(-range, range);
        self.set(applied, self.mean + ((applied - self.mean) >> received.speed_depth));
    }

    /// Limits the steering so that the loop does not overshoot. A correction lasts until the next
    /// time is received. If received times are so far apart that it would correct more than the
    /// whole difference by then, it is limited to the difference. A filter delays the answer by
    /// several received times, which counts as a longer interval.
    ///
    /// A unit of difference D at a start of A - 2 changes the speed by (A² + D²) / (5 (A² - D²)²).
    fn patient(&self, wanted: i64, steering: i64, gain: i64, received: &Received) -> i64 {
        let (a, d) = (i64::from(self.scale.start) + 2, self.applied >> FRACTION);
        let (sum, product) = (a * a + d * d, a * a - d * d);
        let filter = 1i64 << received.time_depth.saturating_sub(2).min(13);
        let whole = 5 * product * product;
        let interval = if received.first { 0 } else { received.interval.max(0) };
        let turns = sum.saturating_mul(interval).saturating_mul(filter);
        if turns.saturating_mul(gain) <= whole {
            return wanted;
        }
        let most = i128::from(steering.abs()) * i128::from(whole) / i128::from(turns);
        let most = i64::try_from(most).unwrap_or(i64::MAX);
        wanted.clamp(-most, most)
    }
}

/// The largest value of register 0x0932, in both directions.
const fn range(start: u16) -> u16 {
    start - 0x7F
}

/// The change of the period, 2^-40, by a small speed counter difference at this start: difference /
/// (5 (start + 2)²).
fn speed_at(difference: u16, start: u16) -> i64 {
    let a = i64::from(start) + 2;
    (i64::from(difference) << 40) / (5 * a * a)
}

/// The change of the period, 2^-60, by the largest speed counter difference: R / (5 (A + R) (A -
/// R)), where R is the range and A is the start + 2.
fn fastest(start: u16) -> i64 {
    let (a, r) = (i64::from(start) + 2, i64::from(range(start)));
    ((r << 48) / (5 * (a + r) * (a - r))) << 12
}

/// The speed counter difference, 2^-16, that changes the period by `speed`, 2^-60: the published
/// speed = D / (5 (A + D) (A - D)) solved for D.
///
/// D = 10 y A² / (1 + sqrt(1 + (10 y A)²)).
fn counter_difference(speed: i64, start: u16) -> i64 {
    let a = i64::from(start) + 2;
    let speed = speed >> 20;
    let tenfold = (10 * speed * a) >> 16;
    let root = ((1u64 << 48) + tenfold.unsigned_abs().pow(2)).isqrt();
    10 * speed * a * a / ((1 << 24) + root as i64)
}

/// The nearest whole speed counter difference.
const fn whole(fixed: i64) -> i64 {
    (fixed + (1 << 15)) >> 16
}

impl Near {
    /// Near a speed whose [`counter_difference`] is `fixed`.
    ///
    /// With y = D / (5 (A² - D²)) a change u of D, as the slope 5 (A² - D²)² / (A² + D²) alone
    /// would give it, is u - D (3 A² + D²) u² / ((A² - D²) (A² + D²)), and for D up to A / 2 at
    /// most 10 u³ / A² more or less. Up to A / 256 that is below 1 / 100.
    fn of(speed: i64, fixed: i64, start: u16) -> Self {
        // A and D, 2^-8.
        let (a, d) = ((i64::from(start) + 2) << 8, fixed >> 8);
        let reach = a >> 16;
        let most = (a / 2).min((i64::from(range(start)) - reach - 2) << 8);
        if d.abs() > most {
            return Self::default();
        }
        let (less, more) = (a * a - d * d, a * a + d * d);
        let slope = (5 * (less >> 16) * ((less << 18) / more)) >> 18;
        let bend = -(((d * (((3 * a * a + d * d) << 16) / more)) << 22) / less);
        let difference = (fixed << 24) + (1 << 39);
        Self { speed: speed >> 20, difference, slope, bend, reach: reach << 40 }
    }

    /// The whole speed counter difference for a speed, 2^-60; `None` if it must be computed: the
    /// speed is not near, or 1/64 decides.
    #[inline(always)]
    fn difference(&self, speed: i64) -> Option<i64> {
        let change = ((speed >> 20) - self.speed).wrapping_mul(self.slope);
        let coarse = change >> 28;
        let bent = (coarse.wrapping_mul(coarse).wrapping_mul(self.bend)) >> 14;
        let difference = self.difference + change + bent;
        let part = (difference << 24) as u64;
        let is_clear = part.wrapping_sub(1 << 58) < (62 << 58);
        (!exceeds(change, self.reach) && is_clear).then_some(difference >> 40)
    }
}

/// Whether a number lies beyond ±`limit`.
#[inline(always)]
fn exceeds(number: i64, limit: i64) -> bool {
    number.wrapping_add(limit) as u64 > 2 * limit as u64
}

/// The nearest number within ±`limit`. As a rule that is the number itself.
#[inline(always)]
fn within(number: i64, limit: i64) -> i64 {
    if exceeds(number, limit) { number.clamp(-limit, limit) } else { number }
}

/// Rounds to the nearest whole number.
pub(super) const fn round(fixed: i64) -> i64 {
    (fixed + (1 << (FRACTION - 1))) >> FRACTION
}

/// A longer time without a received time counts as this, ns (17 s).
const LONGEST: i64 = 1 << 34;
/// Differences are multiples of the ticks of two clocks; this much may be left over for the next
/// received time, ns.
const TICKS: i64 = 32 << FRACTION;
/// MII transmits nibbles of 40 ns; this much may be left over where speeds are filtered, ns.
const NIBBLE: i64 = 40 << FRACTION;
/// A larger change at once is not drift, ns. The limit is beyond two ticks of 10 ns and a nibble of
/// 40 ns, the grain of frames on MII. Frames that follow each other closely drift by nibbles: a law
/// that took a nibble for a jump would learn no speed from them.
const JUMP: i64 = 128 << FRACTION;
/// The largest step of phase, ns. The record only shows that the limit is 8 ns or more, or that
/// there is none.
const LARGEST_STEP: i64 = 100 << FRACTION;
