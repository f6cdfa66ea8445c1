//! The jitter of a hop: a frame is transferred from the clock of its sender to that of its
//! receiver.
//!
//! A port forwards a received frame at an edge of the SubDevice's own clock
//! ([`isocat_esc::rx_fifo`]), so the time of a hop depends on the phase between the two clocks.
//! Nothing is drawn for a frame: the edges come from the SubDevice's oscillator and a phase from
//! the seed. Between two SubDevices the delay passes through a whole period while their clocks slip
//! by one (40 ns: 4 ms at 10 ppm), and is constant between clocks of equal speed. Its mean is the
//! delay that cable, PHYs and chip have without jitter.

use isocat_wire::time::{Picos, Time, True};

use crate::oscillator::Oscillator;
use crate::random::Stream;

/// The edges of one port's clock.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) struct Edges {
    /// Time from one edge to the next, ps; 0: frames are forwarded without waiting.
    period: u64,
    /// Phase, ps by the SubDevice's oscillator.
    phase: u64,
}

impl Edges {
    /// Edges every `period`, with a phase from [`phase`].
    pub fn new(period: Picos, phase: u64) -> Self {
        Self { period: period.0.unsigned_abs(), phase }
    }

    /// Whether frames wait for edges.
    pub fn are_there(&self) -> bool {
        self.period > 0
    }

    /// How much later than on average a frame is that arrives at `at`: at most half a period,
    /// positive or negative.
    pub fn wait(&self, oscillator: &Oscillator, at: Time<True>) -> Picos {
        if self.period == 0 {
            return Picos::ZERO;
        }
        // The later it arrives after an edge, the shorter it waits for the next one. The period of
        // the oscillator differs from that of true time by less than 1 ps.
        let behind = oscillator.count_ps(at).wrapping_add(self.phase) % self.period;
        let wait = (self.period / 2) as i64 - behind as i64;
        // A frame must not arrive before true time zero, but may leave there.
        Picos(wait.max(-i64::try_from(at.count()).unwrap_or(i64::MAX)))
    }
}

/// The phase of a SubDevice's clock at power-on, ps.
pub(crate) fn phase(seed: u64, position: usize) -> u64 {
    Stream::new(seed, "receive clock", position as u64).up_to(MOST_PHASE)
}

/// A whole number of periods, far longer than any of them.
const MOST_PHASE: u64 = 1_000_000_000 - 1;

#[cfg(test)]
mod tests {
    use super::*;

    /// Over one period every wait occurs once, and a frame that has waited is on the grid of the
    /// receiver.
    #[test]
    fn waits_are_even_and_end_on_edges() {
        for (period, phase) in [(40_000, 0), (40_000, 12_345), (10_000, 987_654_321)] {
            let edges = Edges::new(Picos(period), phase);
            let oscillator = Oscillator::new(0);
            let mut seen: Vec<i64> = Vec::new();
            let begin = Time::<True>::new(7_777_777_777);
            let first = begin + edges.wait(&oscillator, begin);
            for step in 0..period {
                let at = begin + Picos(step);
                let wait = edges.wait(&oscillator, at);
                assert_eq!((at + wait - first).0 % period, 0, "{step}");
                seen.push(wait.0);
            }
            seen.sort_unstable();
            assert!(seen.iter().copied().eq(1 - period / 2..=period / 2));
        }
    }

    /// Frames on the edges of a true clock are received on those of a clock 10 ppm faster: 40 ns in
    /// 4 ms.
    #[test]
    fn the_wait_goes_round_as_clocks_slip() {
        let receiver = Oscillator::new(10_000);
        let edges = Edges::new(Picos(40_000), 5_000);
        let wait = |micros: u64| {
            // A whole number of periods of true time; the count is rounded down.
            edges.wait(&receiver, Time::new(micros * 1_000_000)).0
        };
        for (micros, expected) in [
            (0, 15_000),
            (100, 14_000),
            (400, 11_000),
            (3_499, -19_990),
            (3_501, 19_990),
            (4_000, 15_000),
        ] {
            assert!((wait(micros) - expected).abs() <= 1, "{micros} us: {}", wait(micros));
        }
    }

    /// A frame at true time zero does not arrive before it.
    #[test]
    fn nothing_comes_before_the_beginning() {
        let oscillator = Oscillator::new(0);
        let edges = Edges::new(Picos(10_000), 9_999);
        assert_eq!(edges.wait(&oscillator, Time::new(0)), Picos(0));
        assert_eq!(edges.wait(&oscillator, Time::new(10_000)), Picos(-4_998));
    }

    #[test]
    fn without_a_period_nothing_waits() {
        let none = Edges::default();
        assert!(!none.are_there());
        assert_eq!(none.wait(&Oscillator::new(5), Time::new(1_234_567)), Picos::ZERO);
    }
}
