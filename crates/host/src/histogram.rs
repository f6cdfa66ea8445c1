//! A series of time spans, kept as counts: any number of values in fixed memory, without
//! allocation.

use isocat_maindevice::statistics::Summary;
use isocat_wire::time::Nanos;

/// Counts of time spans by size. Each size is known to one part in eight; least, largest and mean
/// are exact.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Histogram {
    summary: Summary,
    counts: [u64; SLOTS],
}

impl Default for Histogram {
    fn default() -> Self {
        Self { summary: Summary::default(), counts: [0; SLOTS] }
    }
}

impl std::fmt::Debug for Histogram {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("Histogram").field(&self.summary).finish()
    }
}

impl Histogram {
    /// Adds a value; a negative one is counted as zero.
    pub fn add(&mut self, span: Nanos) {
        self.summary.add(span);
        self.counts[slot(span.0.max(0) as u64)] += 1;
    }

    /// Number of values.
    pub fn count(&self) -> u64 {
        self.summary.count
    }

    /// Count, least, largest, mean and deviation.
    pub fn summary(&self) -> &Summary {
        &self.summary
    }

    /// The least value; 0 without values.
    pub fn least(&self) -> Nanos {
        self.summary.min
    }

    /// The largest value; 0 without values.
    pub fn largest(&self) -> Nanos {
        self.summary.max
    }

    /// The size that `percent` of the values do not exceed, rounded up to the end of its slot; 0
    /// without values.
    pub fn percentile(&self, percent: u8) -> Nanos {
        let wanted = (self.summary.count * u64::from(percent)).div_ceil(100);
        let mut seen = 0;
        for (slot, count) in self.counts.iter().enumerate() {
            seen += count;
            if seen >= wanted.max(1) {
                return Nanos(end(slot) as i64).min(self.largest());
            }
        }
        self.largest()
    }

    /// The number of values up to each limit and above the one before; limits must rise. The last
    /// count is of the values beyond all limits. A value is counted by the end of its slot.
    pub fn buckets<const N: usize>(&self, limits: [Nanos; N]) -> ([u64; N], u64) {
        let (mut within, mut beyond) = ([0; N], 0);
        for (slot, count) in self.counts.iter().enumerate() {
            match limits.iter().position(|limit| end(slot) <= limit.0.max(0) as u64) {
                Some(at) => within[at] += count,
                None => beyond += count,
            }
        }
        (within, beyond)
    }
}

/// Number of slots in each doubling.
const PARTS: u64 = 8;
/// Slots up to 2^40 ns, 18 minutes; longer spans count in the last one.
const SLOTS: usize = 39 * PARTS as usize;

/// The slot of a value: values below 16 have one each, larger ones eight to a doubling.
fn slot(value: u64) -> usize {
    let doubling = u64::from(value.max(PARTS).ilog2()) - PARTS.ilog2() as u64;
    let slot = doubling * PARTS + (value >> doubling);
    (slot as usize).min(SLOTS - 1)
}

/// The largest value of a slot.
fn end(slot: usize) -> u64 {
    let slot = slot as u64;
    let doubling = (slot / PARTS).saturating_sub(1);
    ((slot - doubling * PARTS + 1) << doubling) - 1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_lies_in_its_slot() {
        for value in (0..4_096).chain([999_999, 1 << 30, (1 << 41) - 1]) {
            let at = slot(value);
            if at < SLOTS - 1 {
                assert!(value <= end(at), "{value}");
                assert!(at == 0 || value > end(at - 1), "{value}");
                assert!(end(at) <= value + value / PARTS, "{value}");
            }
        }
    }

    #[test]
    fn percentiles_and_buckets_of_a_known_series() {
        let mut series = Histogram::default();
        assert_eq!(series.percentile(99), Nanos::ZERO);
        for us in 1..=100 {
            series.add(Nanos::micros(us));
        }
        assert_eq!(series.least(), Nanos::micros(1));
        assert_eq!(series.percentile(100), Nanos::micros(100));
        let median = series.percentile(50).0;
        assert!((50_000..=56_250).contains(&median), "{median}");
        let (within, beyond) = series.buckets([Nanos::micros(20), Nanos::micros(500)]);
        assert_eq!(within.iter().sum::<u64>() + beyond, 100);
        assert!((17..=20).contains(&within[0]), "{within:?}");
        assert_eq!(beyond, 0);
    }
}
