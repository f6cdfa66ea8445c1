//! Judges whether a clock has converged to the reference, by measured differences and their slope.
//!
//! A fixed number of drift frames proves nothing: a clock may still drift after the last one. Here
//! a clock counts as converged when neither the difference nor its slope exceeds the limits over a
//! window of readings of register 0x092C.

use isocat_wire::time::{Host, Nanos, Time};

/// Number of readings that the judgement uses.
const WINDOW: usize = 16;

/// The limits for a converged clock.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Limits {
    /// Largest difference from the reference in the window, ns.
    pub difference: Nanos,
    /// Largest mean of the differences in the window, ns: the rest that the loop still has to
    /// correct. Single differences also contain the grain of both clocks and the jitter of the way.
    pub mean: Nanos,
    /// Largest slope of the differences, ns per second (ppb).
    pub slope_ppb: i64,
    /// Standard deviation of one reading (1 sigma), ns, from the jitter of frames on their way.
    /// Four of it are allowed beyond either limit.
    pub noise: Nanos,
}

/// The slope of a clock that has converged, ns per second: see [`Limits`].
pub const SETTLED_PPB: u32 = 1_000;

impl Limits {
    /// The default limits, with another limit of the difference and a fifth of it for the mean.
    pub fn of_difference(difference: Nanos) -> Self {
        Self { difference, mean: Nanos((difference.0 / 5).max(1)), ..Self::default() }
    }
}

impl Default for Limits {
    /// 40 ns: twice the tick of both clocks, also for the mean. 1000 ppb: a clock that drifts
    /// faster would leave those 40 ns within 40 cycles of 1 ms if the drift frames stopped.
    fn default() -> Self {
        let slope_ppb = i64::from(SETTLED_PPB);
        Self { difference: Nanos(40), mean: Nanos(40), slope_ppb, noise: Nanos::ZERO }
    }
}

/// The judgement on the readings of one clock.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Verdict {
    /// Too few readings for a judgement.
    TooEarly,
    /// At least one limit is exceeded.
    Converging {
        /// Largest difference in the window.
        worst: Nanos,
        /// Slope over the window, ns per second.
        slope_ppb: i64,
    },
    /// Both limits hold over the whole window.
    Converged {
        /// Largest difference in the window.
        worst: Nanos,
        /// Slope over the window, ns per second.
        slope_ppb: i64,
    },
}

/// The last readings of one clock.
#[derive(Clone, Copy, Debug)]
pub struct Convergence {
    limits: Limits,
    readings: [(Time<Host>, Nanos); WINDOW],
    count: usize,
    sums: Sums,
    /// All bits that a size of a difference had so far.
    sizes: i64,
}

/// Sums over the readings in the window, for the numerator of the line through them: each new
/// reading comes in as the oldest one leaves. They wrap around, so the numerator is exact as long
/// as it fits, and the same from any origin of time on: see [`Convergence::short_numerator`].
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    x: i64,
    y: i64,
    xy: i64,
}

impl Sums {
    /// Replaces a reading by another one. One at zero is none.
    #[inline(always)]
    fn replace(&mut self, (old, Nanos(gone)): (Time<Host>, Nanos), (x, Nanos(y)): (i64, Nanos)) {
        let old = old.count() as i64;
        self.x = self.x.wrapping_add(x.wrapping_sub(old));
        self.y = self.y.wrapping_add(y.wrapping_sub(gone));
        let product = x.wrapping_mul(y).wrapping_sub(old.wrapping_mul(gone));
        self.xy = self.xy.wrapping_add(product);
    }
}

impl Convergence {
    /// No readings yet.
    pub fn new(limits: Limits) -> Self {
        let readings = [(Time::ZERO, Nanos::ZERO); WINDOW];
        Self { limits, readings, count: 0, sums: Sums::default(), sizes: 0 }
    }

    /// Adds one reading of the system time difference. No reading is earlier than the one before.
    #[inline]
    pub fn sample(&mut self, at: Time<Host>, difference: Nanos) {
        let place = &mut self.readings[self.count % WINDOW];
        self.sums.replace(*place, (at.count() as i64, difference));
        *place = (at, difference);
        self.sizes |= difference.0 ^ (difference.0 >> 63);
        self.count += 1;
    }

    /// Slope over the window, ns per second, as in the verdict; `None` while there are too few
    /// readings.
    pub fn slope_ppb(&self) -> Option<i64> {
        (self.count >= WINDOW).then(|| slope_ppb(self.line()))
    }

    /// Whether the slope is at most `most_ppb` ns per second, up or down; true while there are too
    /// few readings. No difference in the window is farther from zero than `worst`. It needs no
    /// division.
    #[inline]
    pub fn is_flat(&self, most_ppb: u32, worst: Nanos) -> bool {
        if self.count < WINDOW {
            return true;
        }
        // With d the distances of the times from their mean, the slope is at most worst · Σ|d| /
        // Σd², by Cauchy and Schwarz at most worst · sqrt(n / Σd²), and Σd² is at least half of the
        // square of the span: together worst / span · sqrt(32), less than six times.
        let most = u128::from(worst.0.unsigned_abs()) * (6 * NANOS_PER_SECOND as u128);
        most < u128::from(self.span()) * u128::from(most_ppb) || self.is_flat_by_line(most_ppb)
    }

    /// Whether the slope is at most [`SETTLED_PPB`], as [`Self::is_flat`] says it: the question
    /// that each reading asks.
    #[inline]
    pub fn is_settled(&self, worst: Nanos) -> bool {
        // See `is_flat`; both sides are divided by the slope.
        let most = worst.0.unsigned_abs().saturating_mul(6 * NANOS_PER_SECOND as u64 / SETTLED);
        self.count < WINDOW || most < self.span() || self.is_settled_by_line()
    }

    /// Whether the clock certainly drifts by at most `room` in each of `parts` equal parts of
    /// `time`. No difference in the window is farther from zero than `worst`.
    pub fn stays_within(&self, room: Nanos, time: Nanos, parts: u64, worst: Nanos) -> bool {
        // See `is_flat` for the slope.
        let size = |span: Nanos| u128::from(span.0.unsigned_abs());
        let most = size(worst) * 6 * size(time);
        self.count < WINDOW || most <= u128::from(self.span()) * size(room) * u128::from(parts)
    }

    fn is_settled_by_line(&self) -> bool {
        let span = self.span();
        // The numerator is below the least denominator (see below) times the slope: 8008 / 10^9
        // times the square of the span, of which this is less.
        self.short_numerator()
            .is_some_and(|numerator| numerator.unsigned_abs() < (span * span) >> 17)
            || self.is_flat_by_line(SETTLED_PPB)
    }

    fn is_flat_by_line(&self, most_ppb: u32) -> bool {
        // The slope is rounded towards zero.
        let most = u128::from(most_ppb) + 1;
        if let Some(numerator) = self.short_numerator() {
            let scaled = u128::from(numerator.unsigned_abs()) * NANOS_PER_SECOND as u128;
            // The denominator is n · Σd², and Σd² at least half of the sum of the squares of the
            // times from each of some readings to one of the later ones: from the oldest one to the
            // newest one, and three times from a reading of the next three to one before the last
            // three. These are at least `gap`. It is two thirds of the denominator with readings at
            // equal distances, so that the denominator itself is seldom needed.
            let [span, gap] = [self.span(), self.gap()].map(u128::from);
            let least = (span * span + 3 * gap * gap) * u128::from(LEAST);
            if scaled < least * most {
                return true;
            }
            let denominator = self.denominator();
            return denominator == 0 || scaled < denominator * most;
        }
        let (denominator, numerator) = self.line_of_window();
        let scaled = (numerator * NANOS_PER_SECOND).unsigned_abs();
        denominator == 0 || scaled < denominator.unsigned_abs().saturating_mul(most)
    }

    /// Time from the oldest reading of a full window to the newest one, ns.
    #[inline]
    fn span(&self) -> u64 {
        let (first, last) = (self.count % WINDOW, (self.count + WINDOW - 1) % WINDOW);
        (self.readings[last].0 - self.readings[first].0).0.unsigned_abs()
    }

    /// Time from the fourth reading of a full window to the fourth last one, ns.
    #[inline]
    fn gap(&self) -> u64 {
        let (first, last) = ((self.count + 3) % WINDOW, (self.count + WINDOW - 4) % WINDOW);
        (self.readings[last].0 - self.readings[first].0).0.max(0) as u64
    }

    /// Judges the window.
    pub fn verdict(&self) -> Verdict {
        if self.count < WINDOW {
            return Verdict::TooEarly;
        }
        let worst = self.readings.iter().map(|(_, d)| d.abs()).max().unwrap_or_default();
        let line = self.line();
        let slope_ppb = slope_ppb(line);
        let Limits { difference, mean, slope_ppb: slope, noise } = self.limits;
        let difference = difference + self.limits.noise_allowed();
        let is_flat = || {
            let size = slope_ppb.abs();
            size <= slope || size <= slope + self.noise_of(line.0)
        };
        // Four times the error of a mean of sixteen readings.
        let off = self.mean().abs() <= mean + noise;
        if worst <= difference && off && is_flat() {
            Verdict::Converged { worst, slope_ppb }
        } else {
            Verdict::Converging { worst, slope_ppb }
        }
    }

    /// Mean of the differences in the window, rounded away from zero.
    fn mean(&self) -> Nanos {
        let sum: i64 = self.readings.iter().map(|(_, difference)| difference.0).sum();
        let count = WINDOW as i64;
        Nanos((sum.abs() + count - 1) / count)
    }

    /// The slope that noise of the readings may cause, ns per second; 0 while there are too few
    /// readings.
    pub fn slope_noise_ppb(&self) -> i64 {
        if self.count < WINDOW || self.limits.noise_allowed() == Nanos::ZERO {
            return 0;
        }
        self.noise_of(self.line().0)
    }

    /// The same with the denominator of the line.
    fn noise_of(&self, denominator: i128) -> i64 {
        let noise = i128::from(self.limits.noise_allowed().0);
        if denominator == 0 || noise == 0 {
            return 0;
        }
        // The error of a slope is sigma x sqrt(n / denominator), here in units of 10^-12 per ns.
        let scaled = WINDOW as i128 * 1_000_000_000_000_000_000_000_000 / denominator;
        (noise * scaled.unsigned_abs().isqrt() as i128 / 1_000) as i64
    }

    /// Denominator and numerator of the slope of the least-squares line through a full window.
    fn line(&self) -> (i128, i128) {
        match self.short_numerator() {
            Some(numerator) => (self.denominator() as i128, numerator.into()),
            None => self.line_of_window(),
        }
    }

    /// The numerator by the running sums, if it fits: it is at most n² / 4 times the span and the
    /// range of the differences.
    #[inline]
    fn short_numerator(&self) -> Option<i64> {
        if self.span() >= SHORT_SPAN || self.sizes >= SMALL_SIZE {
            return None;
        }
        let Sums { x, y, xy } = self.sums;
        Some(xy.wrapping_mul(WINDOW as i64).wrapping_sub(x.wrapping_mul(y)))
    }

    /// The denominator of a line with a short span: at most n² / 4 times the square of the span.
    fn denominator(&self) -> u128 {
        let oldest = self.readings[self.count % WINDOW].0;
        let (mut sum, mut squares) = (0_u64, 0_u128);
        for (at, _) in &self.readings {
            let x = (*at - oldest).0 as u64;
            sum = sum.wrapping_add(x);
            squares = squares.wrapping_add(u128::from(x) * u128::from(x));
        }
        let square = u128::from(sum) * u128::from(sum);
        squares.wrapping_mul(WINDOW as u128).wrapping_sub(square)
    }

    /// The same by the readings themselves.
    #[cold]
    fn line_of_window(&self) -> (i128, i128) {
        let oldest = self.readings[self.count % WINDOW].0;
        let (mut sx, mut sy, mut sxx, mut sxy) = (0_i64, 0_i64, 0_i128, 0_i128);
        for (at, Nanos(y)) in &self.readings {
            let x = (*at - oldest).0;
            (sx, sy) = (sx.wrapping_add(x), sy.wrapping_add(*y));
            (sxx, sxy) = (sxx.wrapping_add(product(x, x)), sxy.wrapping_add(product(x, *y)));
        }
        let slope = |products: i128, other| {
            (WINDOW as i128).wrapping_mul(products).wrapping_sub(product(sx, other))
        };
        (slope(sxx, sx), slope(sxy, sy))
    }
}

fn product(a: i64, b: i64) -> i128 {
    i128::from(a) * i128::from(b)
}

/// With a shorter span, 4.3 s, and smaller differences, 16 ms, the numerator of a line fits into 64
/// bits: n² / 4 · 2^32 · 2^25, and a sign. The denominator then has 70 bits.
const SHORT_SPAN: u64 = 1 << 32;
const SMALL_SIZE: i64 = 1 << 24;
const NANOS_PER_SECOND: i128 = 1_000_000_000;
const SETTLED: u64 = SETTLED_PPB as u64;
/// The least denominator of a line in squares of the span.
const LEAST: u64 = WINDOW as u64 / 2;

/// Slope of the least-squares line with this denominator and numerator.
fn slope_ppb((denominator, numerator): (i128, i128)) -> i64 {
    if denominator == 0 {
        return 0;
    }
    let scaled = numerator * NANOS_PER_SECOND;
    // A division of long numbers is dear, and a clock that stands still needs none.
    if scaled.unsigned_abs() < denominator.unsigned_abs() {
        return 0;
    }
    (scaled / denominator) as i64
}

impl Limits {
    /// What the noise of a reading may add to a difference: four standard deviations.
    pub const fn noise_allowed(&self) -> Nanos {
        Nanos(4 * self.noise.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Readings every millisecond that lie on a line.
    fn line(start: i64, per_ms: i64) -> Convergence {
        let mut convergence = Convergence::new(Limits::default());
        for i in 0..WINDOW as i64 {
            let at = Time::new(7_000_000 + 1_000_000 * i as u64);
            convergence.sample(at, Nanos(start + per_ms * i));
        }
        convergence
    }

    #[test]
    fn both_sides_of_the_difference() {
        assert_eq!(line(40, 0).verdict(), Verdict::Converged { worst: Nanos(40), slope_ppb: 0 });
        assert_eq!(line(-41, 0).verdict(), Verdict::Converging { worst: Nanos(41), slope_ppb: 0 });
    }

    /// Each difference is within its limit, but the mean is not.
    #[test]
    fn both_sides_of_the_mean() {
        let limits = Limits::of_difference(Nanos(100));
        let verdict = |last| {
            let mut convergence = Convergence::new(limits);
            for i in 0..WINDOW as u64 {
                let difference = if i == 8 { last } else { 20 };
                convergence.sample(Time::new(1_000_000_000 * i), Nanos(difference));
            }
            convergence.verdict()
        };
        assert!(matches!(verdict(20), Verdict::Converged { .. }));
        assert!(matches!(verdict(21), Verdict::Converging { .. }));
    }

    #[test]
    fn both_sides_of_the_slope() {
        assert_eq!(line(-8, 1).verdict(), Verdict::Converged { worst: Nanos(8), slope_ppb: 1_000 });
        let sliding = Verdict::Converging { worst: Nanos(16), slope_ppb: -2_000 };
        assert_eq!(line(16, -2).verdict(), sliding);
    }

    /// With 25 ns of noise the difference may be 100 ns more. The slope may be off by four errors
    /// of 25 ns x sqrt(12 / 16³) per ms, which is 5400 ns/s.
    #[test]
    fn noise_widens_both_limits() {
        let limits = Limits { noise: Nanos(25), mean: Nanos(200), ..Limits::default() };
        let line = |start: i64, per_ms: i64| {
            let mut convergence = Convergence { limits, ..line(start, per_ms) };
            convergence.limits = limits;
            convergence
        };
        assert!(matches!(line(140, 0).verdict(), Verdict::Converged { .. }));
        assert!(matches!(line(141, 0).verdict(), Verdict::Converging { .. }));
        assert!((5_400..5_430).contains(&line(0, 0).slope_noise_ppb()));
        assert!(matches!(line(0, 6).verdict(), Verdict::Converged { slope_ppb: 6_000, .. }));
        assert!(matches!(line(0, 7).verdict(), Verdict::Converging { slope_ppb: 7_000, .. }));
    }

    /// The running sums are those of the window, counted from its oldest reading, from any origin
    /// of the clock on.
    #[test]
    fn the_line_is_that_of_the_window() {
        let mut random = 0x2545_F491_4F6C_DD1D_u64;
        let mut draw = |below: u64| {
            random ^= random << 13;
            random ^= random >> 7;
            random ^= random << 17;
            random % below
        };
        for origin in [0, 1 << 40, u64::MAX / 2] {
            for (most, sizes) in [(3, 33), (1_000_000, 33), (1 << 34, 33), (1 << 27, 8)] {
                let mut convergence = Convergence::new(Limits::default());
                let mut at = origin;
                for count in 1..100 {
                    at += draw(most);
                    let difference = draw(1 << (sizes - 1)) as i64 - (1 << (sizes - 2));
                    convergence.sample(Time::new(at), Nanos(difference));
                    if count < WINDOW {
                        continue;
                    }
                    let oldest = convergence.readings[count % WINDOW].0;
                    let points = convergence
                        .readings
                        .map(|(at, y)| (i128::from((at - oldest).0), i128::from(y.0)));
                    let sum = |of: fn((i128, i128)) -> i128| points.into_iter().map(of).sum();
                    let (sx, sy): (i128, i128) = (sum(|(x, _)| x), sum(|(_, y)| y));
                    let (sxx, sxy): (i128, i128) = (sum(|(x, _)| x * x), sum(|(x, y)| x * y));
                    let n = WINDOW as i128;
                    assert_eq!(convergence.line(), (n * sxx - sx * sx, n * sxy - sx * sy));
                    let slope = convergence.slope_ppb().expect("the window is full").abs();
                    for most in [0, 1_000, slope - 1, slope, slope + 1] {
                        let Ok(most) = u32::try_from(most) else { continue };
                        let worst = convergence.readings.map(|(_, y)| y.abs()).into_iter().max();
                        let flat = convergence.is_flat(most, worst.expect("there are readings"));
                        assert_eq!(flat, slope <= i64::from(most), "{slope}");
                    }
                    let worst = convergence.readings.map(|(_, y)| y.abs()).into_iter().max();
                    let worst = worst.expect("there are readings");
                    let settled = convergence.is_settled(worst);
                    assert_eq!(settled, slope <= i64::from(SETTLED_PPB), "{slope}");
                    for (time, parts) in [(1_000_000, 1), (1 << 40, 255)] {
                        let moved = i128::from(time / parts) * i128::from(slope) / 1_000_000_000;
                        for room in [moved - 1, moved, 3 * moved, 100 * moved] {
                            let Ok(room @ 0..) = i64::try_from(room) else { continue };
                            let (time, room) = (Nanos(time), Nanos(room));
                            let stays = convergence.stays_within(room, time, parts as u64, worst);
                            assert!(!stays || moved <= i128::from(room.0), "{slope}");
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn one_reading_less_than_the_window_is_too_early() {
        let mut convergence = Convergence::new(Limits::default());
        for i in 0..WINDOW as u64 - 1 {
            convergence.sample(Time::new(i), Nanos::ZERO);
        }
        assert_eq!(convergence.verdict(), Verdict::TooEarly);
        convergence.sample(Time::new(99), Nanos::ZERO);
        assert_ne!(convergence.verdict(), Verdict::TooEarly);
    }

    #[test]
    fn old_readings_are_forgotten() {
        let mut convergence = line(100_000, 0);
        for i in 0..WINDOW as u64 {
            convergence.sample(Time::new(100_000_000 + i * 1_000_000), Nanos(5));
        }
        assert!(matches!(convergence.verdict(), Verdict::Converged { .. }));
    }
}
