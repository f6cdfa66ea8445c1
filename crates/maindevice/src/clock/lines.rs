//! How free-running clocks run apart, by the latches of the delay measurement.

use alloc::vec::Vec;

use isocat_wire::time::Nanos;

use crate::delay::Times;

/// A line for each clock through its time ahead of the reference clock. It contains less of the
/// jitter of the hops than a single latch, and tells where the clock will be some time later.
pub(super) struct Lines {
    reference: usize,
    first: Times,
    /// Latches, and sums of the reference clock's time since the first of them and of its square.
    count: i128,
    x: i128,
    xx: i128,
    /// Sums by position, both since the first latch: of the time by which a clock has run ahead,
    /// and of its product with the reference clock's time.
    all: Vec<(i128, i128)>,
}

impl Lines {
    /// Before the first latch.
    pub fn new(reference: usize) -> Self {
        Self { reference, first: Times::new(), count: 0, x: 0, xx: 0, all: Vec::new() }
    }

    /// Takes a latch.
    pub fn sample(&mut self, times: &Times) {
        if self.first.is_empty() {
            self.first.clone_from(times);
            self.all.resize(times.len(), (0, 0));
        }
        let Some(x) = self.since(times, self.reference) else { return };
        for at in 0..self.all.len() {
            let Some(y) = self.since(times, at).map(|own| own - x) else { continue };
            self.all[at].0 += y;
            self.all[at].1 += y * x;
        }
        self.count += 1;
        self.x += x;
        self.xx += x * x;
    }

    /// Local times (0x0918) of all clocks in a frame that enters the reference clock `since_first`
    /// ns after the first latch; empty before it.
    pub fn at(&self, since_first: i64) -> Vec<u64> {
        let x = i128::from(since_first);
        let denominator = self.count * self.xx - self.x * self.x;
        let entry = |(latch, (y, xy)): (&crate::delay::Latch, &(i128, i128))| {
            let slope = self.count * xy - self.x * y;
            let ahead = match denominator {
                0 => y / self.count.max(1),
                _ => (y * self.xx - self.x * xy + slope * x) / denominator,
            };
            latch.entry.wrapping_add_signed((x + ahead) as i64)
        };
        self.first.iter().zip(&self.all).map(entry).collect()
    }

    /// By how much each clock runs ahead of the reference clock in this `span`, ns.
    pub fn gained_in(&self, span: Nanos) -> Vec<Nanos> {
        let denominator = self.count * self.xx - self.x * self.x;
        let gained = |(y, xy): &(i128, i128)| match denominator {
            0 => Nanos::ZERO,
            _ => Nanos(((self.count * xy - self.x * y) * i128::from(span.0) / denominator) as i64),
        };
        self.all.iter().map(gained).collect()
    }

    /// The reference clock's time from the first latch to this one, ns.
    pub fn reference_since(&self, times: &Times) -> i64 {
        self.since(times, self.reference).unwrap_or_default() as i64
    }

    /// A clock's time from the first latch to this one, below half of the range of a 32-bit clock.
    fn since(&self, times: &Times, at: usize) -> Option<i128> {
        let span = (times.get(at)?.entry as u32).wrapping_sub(self.first.get(at)?.entry as u32);
        Some(i128::from(span as i32))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::delay::Latch;

    fn times(entries: [u64; 2]) -> Times {
        entries.into_iter().map(|entry| Latch { ports: None, entry }).collect()
    }

    /// A clock is 10 ppm fast, began at another time, and passes the wrap of 32 bits. One latch is
    /// 40 ns late.
    #[test]
    fn a_clock_is_where_its_line_says() {
        let mut lines = Lines::new(0);
        assert_eq!(lines.at(5), []);
        for ms in 0..5u64 {
            let late = if ms == 4 { 40 } else { 0 };
            lines.sample(&times([7 + ms * 1_000_000, 0xFFFF_0000 + ms * 1_000_010 + late]));
        }
        assert_eq!(lines.reference_since(&times([7 + 4_000_000, 0])), 4_000_000);
        // The late latch lifts the line by 24 ns there, and by 8 ns more for each ms after it.
        assert_eq!(lines.at(4_000_000), [4_000_007, 0xFFFF_0000 + 4_000_040 + 24]);
        assert_eq!(lines.at(10_000_000), [10_000_007, 0xFFFF_0000 + 10_000_100 + 8 + 64]);
        assert_eq!(lines.gained_in(Nanos::millis(3)), [0, 3 * (10 + 8)].map(Nanos));
    }

    #[test]
    fn one_latch_is_a_point() {
        let mut lines = Lines::new(0);
        lines.sample(&times([100, 5_000]));
        assert_eq!(lines.at(50), [150, 5_050]);
        assert_eq!(lines.gained_in(Nanos::millis(3)), [Nanos::ZERO; 2]);
    }
}
