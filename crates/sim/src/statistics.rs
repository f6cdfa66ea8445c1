//! Running figures of a series: count, least, largest, mean, standard deviation.

/// Figures of a series of values in picoseconds.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Statistics {
    count: u64,
    /// Without values, the largest number, so that the first one is less.
    least: i64,
    /// The largest value less the least.
    span: u64,
    /// Sums of the values less the least one, and of the squares of that: in a series most numbers
    /// are small then, and none is negative.
    sum: Sum,
    sum_of_squares: Sum,
}

/// A sum of 128 bits, its low half first: as a number it would begin at a multiple of 16 bytes, and
/// a judge's figures would lie in more cache lines.
#[derive(Clone, Copy, PartialEq, Debug)]
struct Sum {
    low: u64,
    high: u64,
}

impl Sum {
    const ZERO: Self = Self { low: 0, high: 0 };

    #[inline]
    fn add(&mut self, value: u128) {
        let (low, carries) = self.low.overflowing_add(value as u64);
        self.low = low;
        self.high = self.high.wrapping_add((value >> 64) as u64).wrapping_add(carries.into());
    }

    fn get(self) -> i128 {
        (u128::from(self.high) << 64 | u128::from(self.low)) as i128
    }
}

impl Default for Statistics {
    fn default() -> Self {
        Self { count: 0, least: i64::MAX, span: 0, sum: Sum::ZERO, sum_of_squares: Sum::ZERO }
    }
}

impl Statistics {
    /// Takes one value, ps.
    #[inline]
    pub fn push(&mut self, value_ps: i64) {
        self.widens(value_ps);
    }

    /// Takes one value, ps; returns whether it is further out than all before.
    #[inline]
    pub(crate) fn widens(&mut self, value_ps: i64) -> bool {
        // One that is less than the least wraps.
        let above = value_ps.wrapping_sub(self.least) as u64;
        let widens = above > self.span;
        let above = if widens { self.widen(value_ps) } else { above };
        self.count += 1;
        self.sum.add(above.into());
        self.sum_of_squares.add(u128::from(above) * u128::from(above));
        widens
    }

    /// Makes room for a value that is further out than all before; returns how far it is above the
    /// least one.
    #[cold]
    #[inline(never)]
    fn widen(&mut self, value_ps: i64) -> u64 {
        let is_first = self.count == 0;
        let (least, largest) = match is_first {
            true => (value_ps, value_ps),
            false => (self.least, self.largest()),
        };
        self.least = least.min(value_ps);
        self.span = largest.max(value_ps).abs_diff(self.least);
        // The sums count from the new least value.
        let lower = u128::from(least.abs_diff(self.least));
        let (count, sum) = (u128::from(self.count), self.sum.get() as u128);
        self.sum_of_squares.add(lower.wrapping_mul(2 * sum + count * lower));
        self.sum.add(count * lower);
        value_ps.abs_diff(self.least)
    }
    /// Number of values.
    pub fn count(&self) -> u64 {
        self.count
    }
    /// The least value, ps; 0 without values.
    pub fn least(&self) -> i64 {
        if self.count == 0 { 0 } else { self.least }
    }
    /// The largest value, ps; 0 without values.
    pub fn largest(&self) -> i64 {
        self.least().wrapping_add_unsigned(self.span)
    }
    /// The largest absolute value, ps.
    pub fn worst(&self) -> u64 {
        self.least().unsigned_abs().max(self.largest().unsigned_abs())
    }
    /// Mean, ps; 0 without values.
    pub fn mean(&self) -> f64 {
        if self.count == 0 {
            return 0.0;
        }
        let sum = self.sum.get() + i128::from(self.count) * i128::from(self.least);
        sum as f64 / self.count as f64
    }
    /// Standard deviation, ps; 0 without values.
    pub fn standard_deviation(&self) -> f64 {
        if self.count == 0 {
            return 0.0;
        }
        // The sums are exact integers, so only the last step rounds. It does not matter what they
        // count from.
        let n = i128::from(self.count);
        let spread = n * self.sum_of_squares.get() - self.sum.get() * self.sum.get();
        (spread.max(0) as f64).sqrt() / n as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_of_a_known_series() {
        let mut statistics = Statistics::default();
        for value in [-4, 0, 4, 8] {
            statistics.push(value);
        }
        assert_eq!((statistics.least(), statistics.largest(), statistics.worst()), (-4, 8, 8));
        assert_eq!(statistics.mean(), 2.0);
        assert_eq!(statistics.standard_deviation(), 20f64.sqrt());
        assert_eq!(statistics.count(), 4);
    }

    /// Against sums of the values themselves, with values that grow in both directions.
    #[test]
    fn the_order_of_values_does_not_matter() {
        let values = [5, 3, 3, -9_000_000_000, 40, 7, -9_000_000_001, 1 << 50, 0, -(1 << 50), 12];
        for start in 0..values.len() {
            let mut statistics = Statistics::default();
            let (mut sum, mut squares) = (0i128, 0i128);
            for (count, value) in (1..).zip(values[start..].iter().chain(&values[..start])) {
                let before = (statistics.least(), statistics.largest());
                let is_out = count == 1 || *value < before.0 || *value > before.1;
                assert_eq!(statistics.widens(*value), is_out);
                sum += i128::from(*value);
                squares += i128::from(*value) * i128::from(*value);
                let spread = count * squares - sum * sum;
                assert_eq!(statistics.mean(), sum as f64 / count as f64);
                assert_eq!(statistics.standard_deviation(), (spread as f64).sqrt() / count as f64);
            }
            assert_eq!((statistics.least(), statistics.largest()), (-(1 << 50), 1 << 50));
        }
    }

    #[test]
    fn without_values_all_figures_are_zero() {
        let none = Statistics::default();
        assert_eq!((none.count(), none.least(), none.largest(), none.worst()), (0, 0, 0, 0));
        assert_eq!((none.mean(), none.standard_deviation()), (0.0, 0.0));
    }

    #[test]
    fn a_large_common_part_does_not_swallow_the_spread() {
        let mut statistics = Statistics::default();
        for i in 0..1000 {
            statistics.push(1_000_000_000_000_000 + i % 2);
        }
        assert_eq!(statistics.standard_deviation(), 0.5);
    }
}
