//! The mean of several latches, and its remaining error.
//!
//! A receive time that lies anywhere within a tick has the variance 10² / 12 ns². One latch
//! therefore gives a delay with the variance V = 10² / 12 ns² times the squares of its
//! coefficients. How much of V a mean of n latches keeps depends on where in the tick they fell. If
//! they always fell at one place, all have the same error and the mean is no better than one latch;
//! if they fell anywhere, the mean keeps V / n. In all cases, by the law of total variance, the
//! mean keeps V less the mean square deviation of the latches from their mean. For one delay that
//! is a poor estimate (an interval of whole ticks never deviates), so it is taken over all
//! SubDevices: [`Averaging`].
//!
//! The jitter of hops ([`HopJitter`]) is treated like quantization. It comes from clocks whose
//! phases are arbitrary and may stay constant, so latches average it out only as far as their
//! spread shows.
//!
//! Other noise shows in the spread of the delay itself; the error is never stated below that.

use isocat_wire::time::Picos;

use super::path::TICK;
use super::{Delay, Found, HopJitter, Why};

/// All latches of one SubDevice.
#[derive(Clone, Copy, Default, Debug)]
pub struct Mean {
    /// Latches that gave the delay.
    known: u32,
    /// Latches that did not give the delay.
    left_out: u32,
    why: Option<Why>,
    /// ps.
    delays: Spread,
    /// ns from the entry to each port.
    rounds: [Spread; 4],
    least: i64,
    most: i64,
    quarters: u64,
    systematic: Picos,
    /// The range of the last latch that did not give the delay.
    between: Option<(Picos, Picos)>,
    /// The jitter that is expected in addition to quantization.
    jitter: HopJitter,
}

/// Numbers that lie close together.
#[derive(Clone, Copy, Default, Debug)]
struct Spread {
    count: u32,
    first: i64,
    /// Sum of the differences from the first number.
    sum: i64,
    squares: u128,
}

/// How far the latches of a whole segment averaged quantization out.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Averaging {
    /// The part of one latch's variance that the mean keeps; 1024 is all of it.
    kept: u32,
}

/// The whole of a variance.
const ALL: u32 = 1024;

impl Mean {
    /// A mean without latches, for a SubDevice whose frames have this jitter. The default expects
    /// none.
    pub fn expecting(jitter: HopJitter) -> Self {
        Self { jitter, ..Self::default() }
    }

    /// The same mean without its latches.
    pub fn restarted(&self) -> Self {
        Self::expecting(self.jitter)
    }

    /// Adds a latch.
    pub fn add(&mut self, found: &Found) {
        if found.why.is_some() {
            self.left_out += 1;
            self.why = found.why;
            let least = |slack: Picos| Picos((found.delay - slack).0.max(0));
            self.between = found.slack.map(|slack| (least(slack), found.delay + slack));
            return;
        }
        let delay = found.delay.0;
        if self.known == 0 {
            (self.least, self.most) = (delay, delay);
        }
        self.known += 1;
        self.delays.add(delay);
        for (spread, round) in self.rounds.iter_mut().zip(found.rounds) {
            if let Some(round) = round {
                spread.add(round);
            }
        }
        (self.least, self.most) = (self.least.min(delay), self.most.max(delay));
        self.quarters = self.quarters.max(found.quarters);
        self.systematic = self.systematic.max(found.systematic);
    }

    /// Number of latches that gave the delay.
    pub fn latches(&self) -> u32 {
        self.known
    }

    /// Number of latches that came back and did not give the delay.
    pub fn left_out(&self) -> u32 {
        self.left_out
    }

    /// The largest delay less the smallest.
    pub fn spread(&self) -> Picos {
        Picos(self.most - self.least)
    }

    /// The result. A delay counts as known if at least half of the latches gave it.
    pub fn delay(&self, averaging: Averaging) -> Delay {
        if self.known == 0 || self.known < self.left_out {
            let why = self.why.unwrap_or(Why::NoLatch);
            return Delay::Indeterminate { why, between: self.between };
        }
        // A frame cannot reach a clock behind the reference earlier than the reference: below zero
        // it is noise.
        let delay = Picos(self.delays.mean().max(0));
        let one = self.quantization() + u128::from(self.jitter.delay);
        let kept = one * u128::from(averaging.kept) / u128::from(ALL);
        let variance = kept.max(one / u128::from(self.known)).max(self.delays.of_the_mean());
        let standard_error = Picos(root(variance) as i64);
        Delay::Known { delay, standard_error, systematic: self.systematic }
    }

    /// Variance of one latch, ps².
    fn quantization(&self) -> u128 {
        u128::from(self.quarters) * (TICK * TICK) as u128 / (4 * 12)
    }
}

impl Spread {
    fn add(&mut self, value: i64) {
        if self.count == 0 {
            self.first = value;
        }
        self.count += 1;
        let difference = value.saturating_sub(self.first);
        self.sum = self.sum.saturating_add(difference);
        self.squares += u128::from(difference.unsigned_abs()).pow(2);
    }

    /// The mean, rounded to the nearest.
    fn mean(&self) -> i64 {
        let count = i64::from(self.count.max(1));
        self.first + (self.sum + count / 2).div_euclid(count)
    }

    /// Sum of the squared deviations from the mean.
    fn deviations(&self) -> u128 {
        let count = u128::from(self.count.max(1));
        self.squares.saturating_sub(u128::from(self.sum.unsigned_abs()).pow(2) / count)
    }

    /// Variance of the mean if only the spread is known.
    fn of_the_mean(&self) -> u128 {
        match u128::from(self.count) {
            0 | 1 => 0,
            count => self.deviations() / (count * (count - 1)),
        }
    }
}

impl Averaging {
    /// Evaluates all SubDevices of a segment.
    pub fn of(means: &[Mean]) -> Self {
        let rounds = || {
            let all = means.iter().flat_map(|mean| mean.rounds.iter().zip(mean.jitter.rounds));
            all.filter(|(round, _)| round.count > 0)
        };
        // Each has two times with a variance of 10² / 12 ns², and the jitter; everything is
        // multiplied by 6. All count the same, whatever jitter is expected.
        let all = 100 * rounds().count() as u128;
        let seen = |(round, jitter): (&Spread, u64)| {
            let expected = 100 + 6 * u128::from(jitter) / 1_000_000;
            600 * round.deviations() / (u128::from(round.count) * expected)
        };
        let seen: u128 = rounds().map(seen).sum();
        let kept = all.saturating_sub(seen) * u128::from(ALL);
        Self { kept: kept.checked_div(all).map_or(ALL, |kept| kept as u32) }
    }
}

/// Integer square root, rounded up: an error is not stated smaller than it is.
pub(super) fn root(square: u128) -> u64 {
    let root = square.isqrt();
    (root + u128::from(root * root < square)).min(u128::from(u64::MAX >> 1)) as u64
}

#[cfg(test)]
mod tests {
    use std::vec::Vec;

    use super::*;

    /// Ten latches of a delay with two coefficients of a half, with these deviations in ps in turn.
    fn mean(deviations: &[i64]) -> Mean {
        let mut mean = Mean::default();
        for deviation in deviations {
            let mut found = Found::default();
            (found.delay, found.why) = (Picos(500_000 + deviation), None);
            // These are the reference's times; the delay is half of its round trip.
            found.rounds[1] = Some(1_000 + deviation / 500);
            found.quarters = 2;
            mean.add(&found);
        }
        mean
    }

    fn error(mean: &Mean, averaging: Averaging) -> i64 {
        match mean.delay(averaging) {
            Delay::Known { standard_error, .. } => standard_error.0,
            other => panic!("{other:?}"),
        }
    }

    /// 10 ns / sqrt(12) times sqrt(1/4 + 1/4): half of 4.08 ns.
    const ONE: i64 = 2_042;

    #[test]
    fn one_latch_has_the_error_of_its_ticks() {
        let one = mean(&[0]);
        assert_eq!(error(&one, Averaging::of(&[one])), ONE);
    }

    #[test]
    fn latches_at_one_place_in_the_tick_are_worth_one() {
        let same = mean(&[0; 16]);
        assert_eq!(error(&same, Averaging::of(&[same])), ONE);
    }

    #[test]
    fn latches_all_over_the_tick_are_worth_their_number() {
        // Half of them are one tick later, which is half a tick of delay: more than V on the
        // average.
        let spread: Vec<i64> = (0..16).map(|i| 5_000 * (i % 2)).collect();
        let spread = mean(&spread);
        // 2.5 ns of deviation, 15 degrees of freedom.
        assert_eq!(error(&spread, Averaging::of(&[spread])), 646);
        // One without deviation learns from the others that the latches fell everywhere.
        let same = mean(&[0; 16]);
        let together = Averaging::of(&[same, spread, spread]);
        assert_eq!(error(&same, together), ONE.div_euclid(4) + 1);
    }

    #[test]
    fn noise_beyond_the_ticks_shows() {
        let noisy: Vec<i64> = (0..16).map(|i| 40_000 * (i % 2)).collect();
        let noisy = mean(&noisy);
        assert_eq!(error(&noisy, Averaging::of(&[noisy])), 5_164);
    }

    #[test]
    fn half_of_the_latches_must_tell() {
        let mut mean = mean(&[0, 0]);
        let mut wrong = Found::default();
        wrong.why = Some(Why::TimesContradict);
        mean.add(&wrong);
        mean.add(&wrong);
        assert!(matches!(mean.delay(Averaging { kept: ALL }), Delay::Known { .. }));
        assert_eq!((mean.latches(), mean.left_out()), (2, 2));
        mean.add(&wrong);
        let why = Why::TimesContradict;
        let expected = Delay::Indeterminate { why, between: None };
        assert_eq!(mean.delay(Averaging { kept: ALL }), expected);
        let nothing = Delay::Indeterminate { why: Why::NoLatch, between: None };
        assert_eq!(Mean::default().delay(Averaging { kept: ALL }), nothing);
    }
}
