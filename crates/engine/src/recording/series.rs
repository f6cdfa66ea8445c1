//! Long series in little memory: spans of time with least, mean and largest value, and counts by
//! size.

use isocat_wire::time::Picos;

/// A series of values in ps over time. Spans of time grow with the series: their number stays below
/// a bound, and no peak is lost.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Series {
    spans: Vec<SpanOfTime>,
    most: usize,
    /// Values in a full span.
    width: u64,
    count: u64,
    sum: i128,
}

/// Consecutive values.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct SpanOfTime {
    /// Time of the first value.
    pub begin: Picos,
    /// Time of the last value.
    pub end: Picos,
    /// Least.
    pub least: i64,
    /// Largest.
    pub largest: i64,
    /// Sum.
    pub sum: i128,
    /// Number of values.
    pub count: u64,
}

impl SpanOfTime {
    /// Mean, ps.
    pub fn mean(&self) -> f64 {
        self.sum as f64 / self.count.max(1) as f64
    }

    fn join(&mut self, next: &Self) {
        self.end = next.end;
        self.least = self.least.min(next.least);
        self.largest = self.largest.max(next.largest);
        self.sum += next.sum;
        self.count += next.count;
    }
}

impl Series {
    /// A series of up to `most` spans, at least two.
    pub fn new(most: usize) -> Self {
        Self { most: most.max(2), width: 1, ..Self::default() }
    }

    /// Adds a value, not earlier than the last one.
    pub fn push(&mut self, at: Picos, value: i64) {
        self.count += 1;
        self.sum += i128::from(value);
        let new = SpanOfTime {
            begin: at,
            end: at,
            least: value,
            largest: value,
            sum: value.into(),
            count: 1,
        };
        match self.spans.last_mut() {
            Some(last) if last.count < self.width => last.join(&new),
            _ => self.spans.push(new),
        }
        if self.spans.len() > self.most.max(2) {
            self.halve();
        }
    }

    fn halve(&mut self) {
        let pairs = self.spans.chunks(2).map(|pair| {
            let mut both = pair[0];
            if let Some(second) = pair.get(1) {
                both.join(second);
            }
            both
        });
        self.spans = pairs.collect();
        self.width = self.width.max(1) * 2;
    }

    /// The same series with `by` ps added to all values.
    pub fn shifted(&self, by: i64) -> Self {
        let mut shifted = self.clone();
        for span in &mut shifted.spans {
            span.least = span.least.saturating_add(by);
            span.largest = span.largest.saturating_add(by);
            span.sum += i128::from(by) * i128::from(span.count);
        }
        shifted.sum += i128::from(by) * i128::from(self.count);
        shifted
    }

    /// The spans, in the order of time.
    pub fn spans(&self) -> &[SpanOfTime] {
        &self.spans
    }

    /// Number of values.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Least and largest value, ps; `None` without values.
    pub fn range(&self) -> Option<(i64, i64)> {
        let least = self.spans.iter().map(|span| span.least).min()?;
        Some((least, self.spans.iter().map(|span| span.largest).max()?))
    }

    /// Mean, ps; `None` without values.
    pub fn mean(&self) -> Option<f64> {
        (self.count > 0).then(|| self.sum as f64 / self.count as f64)
    }
}

/// Counts by size. Bins grow with the range of values.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Histogram {
    /// Width of a bin, ps.
    width: i64,
    /// Bins around 0: the middle one holds values from 0 to its width.
    bins: Vec<u64>,
}

/// Bins on each side of zero.
const HALF: i64 = 64;

impl Default for Histogram {
    fn default() -> Self {
        Self { width: 1_000, bins: vec![0; 2 * HALF as usize] }
    }
}

impl Histogram {
    /// Adds a value, ps.
    pub fn push(&mut self, value: i64) {
        while !(-HALF..HALF).contains(&value.div_euclid(self.width)) {
            self.widen();
        }
        self.bins[(value.div_euclid(self.width) + HALF) as usize] += 1;
    }

    fn widen(&mut self) {
        let mut wider = vec![0; self.bins.len()];
        for (at, count) in self.bins.iter().enumerate() {
            wider[((at as i64 - HALF).div_euclid(2) + HALF) as usize] += count;
        }
        self.bins = wider;
        self.width = self.width.saturating_mul(2);
    }

    /// Width of a bin, ps.
    pub fn width(&self) -> i64 {
        self.width
    }

    /// Bins that are not empty: begin in ps, and number of values.
    pub fn bins(&self) -> impl Iterator<Item = (i64, u64)> + '_ {
        let begin = |at: usize| (at as i64 - HALF) * self.width;
        let all = self.bins.iter().enumerate();
        all.filter(|(_, count)| **count > 0).map(move |(at, count)| (begin(at), *count))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_peak_is_lost_however_long() {
        let mut series = Series::new(8);
        for at in 0..1_000 {
            series.push(Picos(at), if at == 777 { 50 } else { at % 3 });
        }
        assert!(series.spans().len() <= 8, "{}", series.spans().len());
        assert_eq!(series.range(), Some((0, 50)));
        assert_eq!(series.count(), 1_000);
        let of_spans: u64 = series.spans().iter().map(|span| span.count).sum();
        assert_eq!(of_spans, 1_000);
        let peak = series.spans().iter().find(|span| span.largest == 50).expect("the peak");
        assert!((peak.begin..=peak.end).contains(&Picos(777)));
        let ends = series.spans().windows(2).all(|pair| pair[0].end < pair[1].begin);
        assert!(ends, "spans do not overlap");
    }

    #[test]
    fn the_mean_is_that_of_all_values() {
        let mut series = Series::new(4);
        (0..101).for_each(|value| series.push(Picos(value), value));
        assert_eq!(series.mean(), Some(50.0));
        assert_eq!(Series::new(4).mean(), None);
    }

    #[test]
    fn a_shifted_series_is_that_of_shifted_values() {
        let (mut series, mut other) = (Series::new(4), Series::new(4));
        for value in 0..9 {
            series.push(Picos(value), value);
            other.push(Picos(value), value - 7);
        }
        assert_eq!(series.shifted(-7), other);
    }

    #[test]
    fn bins_widen_and_keep_their_counts() {
        let mut histogram = Histogram::default();
        for value in [-1, 0, 999, 1_000, 63_999, -64_000] {
            histogram.push(value);
        }
        assert_eq!(histogram.width(), 1_000);
        let bins: Vec<_> = histogram.bins().collect();
        assert_eq!(bins, [(-64_000, 1), (-1_000, 1), (0, 2), (1_000, 1), (63_000, 1)]);
        histogram.push(64_000);
        assert_eq!(histogram.width(), 2_000);
        let bins: Vec<_> = histogram.bins().collect();
        assert_eq!(bins, [(-64_000, 1), (-2_000, 1), (0, 3), (62_000, 1), (64_000, 1)]);
        histogram.push(i64::MIN / 2);
        assert_eq!(histogram.bins().map(|(_, count)| count).sum::<u64>(), 8);
    }
}
