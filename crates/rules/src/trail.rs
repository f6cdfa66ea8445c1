//! The phase of frames over a whole session in bounded memory, and how it moves.

use alloc::vec::Vec;

use isocat_wire::time::{Nanos, Picos};

use crate::evidence::Slide;

/// Means of the phase over equal numbers of cycles. When there are too many, two become one.
#[derive(Clone, Debug, Default)]
pub struct Trail {
    /// Mean instant and mean phase of each bin, ps.
    bins: Vec<(f64, f64)>,
    /// Cycles in a bin; 0 before the first.
    each: u32,
    /// The bin that is not full yet: sums, and cycles in it.
    open: (f64, f64, u32),
}

impl Trail {
    /// Takes the phase of a cycle whose frame came at an instant of any clock, ps. Allocates once.
    pub fn take(&mut self, at_ps: u64, phase: Picos) {
        if self.each == 0 {
            self.bins.reserve_exact(BINS);
            self.each = 1;
        }
        let (instants, phases, count) = &mut self.open;
        *instants += at_ps as f64;
        *phases += phase.0 as f64;
        *count += 1;
        if *count < self.each {
            return;
        }
        let n = f64::from(*count);
        self.bins.push((*instants / n, *phases / n));
        self.open = <_>::default();
        if self.bins.len() == BINS {
            for at in 0..BINS / 2 {
                let (one, other) = (self.bins[2 * at], self.bins[2 * at + 1]);
                self.bins[at] = ((one.0 + other.0) / 2.0, (one.1 + other.1) / 2.0);
            }
            self.bins.truncate(BINS / 2);
            self.each *= 2;
        }
    }

    /// How the phase moves in the last half of the time: a loop that still settles moves at first.
    /// `None` where too little was seen.
    pub fn slide(&self) -> Option<Slide> {
        let half = &self.bins[self.bins.len() / 2..];
        let span = half.last()?.0 - half.first()?.0;
        if self.bins.len() < LEAST || span < LEAST_TIME {
            return None;
        }
        let (first, last) = half.split_at(half.len() / 2);
        let (slope, error) = fit(half);
        // What settles or swings has another slope in each half; and a step, as when a delay begins
        // or ends, has none in one of them, or in both.
        let (before, after) = (fit(first).0, fit(last).0);
        let goes_on = |part: f64| part / slope >= 0.5;
        let change = match goes_on(before) && goes_on(after) {
            true => (before - after).abs() / 2.0,
            false => slope.abs(),
        };
        // From ps in a ps to ns in a second.
        let ns = |slope: f64| Nanos((slope * 1e9) as i64);
        Some(Slide { per_second: ns(slope), uncertainty: ns(error.max(change)) })
    }
}

/// The slope of a line through points, and its standard error.
fn fit(points: &[(f64, f64)]) -> (f64, f64) {
    let n = points.len() as f64;
    let mean = |value: fn(&(f64, f64)) -> f64| points.iter().map(value).sum::<f64>() / n;
    let (t, p) = (mean(|point| point.0), mean(|point| point.1));
    let squares: f64 = points.iter().map(|point| square(point.0 - t)).sum();
    let products: f64 = points.iter().map(|point| (point.0 - t) * (point.1 - p)).sum();
    let slope = products / squares;
    let rest = |point: &(f64, f64)| square(point.1 - p - slope * (point.0 - t));
    let scatter = points.iter().map(rest).sum::<f64>() / (n - 2.0).max(1.0);
    (slope, libm::sqrt(scatter / squares))
}

fn square(value: f64) -> f64 {
    value * value
}

const BINS: usize = 64;
/// Bins without which nothing is known.
const LEAST: usize = 16;
/// The least time of which a slope is told, ps.
const LEAST_TIME: f64 = 20e9;

#[cfg(test)]
mod tests {
    use super::*;

    /// The slide of phases (ns) at each of `cycles` cycles of a millisecond.
    fn slide(cycles: u64, phase: impl Fn(u64) -> f64) -> Option<Slide> {
        let mut trail = Trail::default();
        for cycle in 0..cycles {
            trail.take(cycle * 1_000_000_000, Picos((phase(cycle) * 1e3) as i64));
        }
        assert!(trail.bins.len() < BINS && trail.bins.capacity() <= BINS);
        trail.slide()
    }

    #[test]
    fn what_slides_has_a_slope_and_what_swings_or_settles_has_doubt() {
        // 35 us in a second, with a noise of 20 us.
        let noise = |cycle: u64| ((cycle * 7_919) % 41) as f64 * 1_000.0 - 20_000.0;
        let slid = slide(4_000, |cycle| 35.0 * cycle as f64 + noise(cycle)).expect("long enough");
        assert!((33_000..37_000).contains(&slid.per_second.0), "{slid:?}");
        assert!(slid.uncertainty.0 < 2_000, "{slid:?}");
        let still = slide(4_000, noise).expect("long enough");
        assert!(still.per_second.0.abs() < 4 * still.uncertainty.0.max(250), "{still:?}");
        let settles = |cycle: u64| 500_000.0 * (-(cycle as f64) / 800.0).exp();
        let settling = slide(2_000, settles).expect("long enough");
        assert!(settling.per_second.0.abs() < 4 * settling.uncertainty.0, "{settling:?}");
        let swings = |cycle: u64| 200_000.0 * (cycle as f64 / 300.0).sin();
        let swinging = slide(4_000, swings).expect("long enough");
        assert!(swinging.per_second.0.abs() < 4 * swinging.uncertainty.0, "{swinging:?}");
        // A delay of 50 us that ends, wherever that is.
        for end in (0..4_000).step_by(100) {
            let stepped = slide(4_000, |cycle| if cycle < end { 50_000.0 } else { 0.0 });
            let stepped = stepped.expect("long enough");
            assert!(stepped.per_second.0.abs() <= 4 * stepped.uncertainty.0, "{end}: {stepped:?}");
        }
    }

    #[test]
    fn little_time_tells_nothing() {
        assert_eq!(slide(15, |cycle| cycle as f64), None);
        assert_eq!(slide(0, |_| 0.0), None);
        assert!(slide(50, |cycle| cycle as f64).is_some());
    }
}
