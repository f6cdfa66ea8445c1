//! Running figures of a series: count, least, largest, mean, standard deviation.

/// Figures of a series of values in picoseconds.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Statistics {
    count: u64,
    /// Without values, beyond all of them; the same for the largest one.
    least: i64,
    largest: i64,
    sum: i128,
    sum_of_squares: i128,
}

impl Default for Statistics {
    fn default() -> Self {
        Self { count: 0, least: i64::MAX, largest: i64::MIN, sum: 0, sum_of_squares: 0 }
    }
}

impl Statistics {
    /// Takes one value, ps.
    #[inline]
    pub fn push(&mut self, value_ps: i64) {
        self.count += 1;
        // Few values are further out than all before.
        if value_ps < self.least || value_ps > self.largest {
            self.widen(value_ps);
        }
        self.sum += i128::from(value_ps);
        self.sum_of_squares += i128::from(value_ps) * i128::from(value_ps);
    }

    #[cold]
    fn widen(&mut self, value_ps: i64) {
        self.least = self.least.min(value_ps);
        self.largest = self.largest.max(value_ps);
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
        if self.count == 0 { 0 } else { self.largest }
    }
    /// The largest absolute value, ps.
    pub fn worst(&self) -> u64 {
        self.least().unsigned_abs().max(self.largest().unsigned_abs())
    }
    /// Mean, ps; 0 without values.
    pub fn mean(&self) -> f64 {
        if self.count == 0 { 0.0 } else { self.sum as f64 / self.count as f64 }
    }
    /// Standard deviation, ps; 0 without values.
    pub fn standard_deviation(&self) -> f64 {
        if self.count == 0 {
            return 0.0;
        }
        // The sums are exact integers, so only the last step rounds.
        let n = i128::from(self.count);
        let spread = n * self.sum_of_squares - self.sum * self.sum;
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
