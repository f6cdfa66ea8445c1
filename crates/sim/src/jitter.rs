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
    /// If the oscillator is straight: periods in a ps of true time, and the phase in periods, 2⁻⁶⁴.
    turns: u64,
    turned: u64,
    /// Time from one edge to the next, ps; 0: frames are forwarded without waiting.
    period: u32,
    /// Phase, ps by the SubDevice's oscillator, below the period.
    phase: u32,
}

impl Edges {
    /// Edges every `period` (at most 4 ms) of an oscillator, with a phase from [`phase`]. They hold
    /// until the oscillator is bent.
    pub fn new(period: Picos, phase: u64, oscillator: &Oscillator) -> Self {
        let period = u32::try_from(period.0).unwrap_or(u32::MAX);
        let phase = phase.checked_rem(period.into()).unwrap_or(0) as u32;
        let whole = |number: u128| u128::checked_div(number, period.into()).unwrap_or(0) as u64;
        let turns = oscillator.straight_rate().map_or(0, |rate| whole(u128::from(rate) * 1_000));
        Self { turns, turned: whole(u128::from(phase) << 64), period, phase }
    }

    /// Whether frames wait for edges.
    pub fn are_there(&self) -> bool {
        self.period > 0
    }

    /// When a frame that arrives at `at` is forwarded: at most half a period earlier or later than
    /// on average.
    pub fn forward<'a>(
        &self,
        at: Time<True>,
        oscillator: impl FnOnce() -> &'a Oscillator,
    ) -> Time<True> {
        self.after(Picos::ZERO).forward(at, oscillator)
    }

    /// A hop that `takes` this time up to the port, without jitter.
    pub fn after(&self, takes: Picos) -> Hop {
        let turned = self.turned.wrapping_add(self.turns.wrapping_mul(takes.0 as u64));
        let on_average = takes.0.wrapping_add((self.period / 2).into()) as u64;
        Hop { turns: self.turns, turned, on_average, period: self.period, phase: self.phase }
    }
}

/// A frame's transfer from the port before to one with [`Edges`].
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Hop {
    /// As in [`Edges`], the phase that a frame finds which leaves the port before at zero.
    turns: u64,
    turned: u64,
    /// Time until the frame would be forwarded if it had come at an edge, ps.
    on_average: u64,
    /// As in [`Edges`].
    period: u32,
    phase: u32,
}

impl Hop {
    /// When a frame that left the port before at `at` is forwarded.
    #[inline(always)]
    pub fn forward<'a>(
        &self,
        at: Time<True>,
        oscillator: impl FnOnce() -> &'a Oscillator,
    ) -> Time<True> {
        let on_average = at.count().wrapping_add(self.on_average);
        if self.turns == 0 || on_average < NEAR {
            return self.forward_by(on_average, oscillator);
        }
        self.forward_straight(at)
    }

    /// Whether the oscillator is straight.
    #[inline(always)]
    pub const fn is_straight(&self) -> bool {
        self.turns != 0
    }

    /// The same with a [straight](Self::is_straight) oscillator, not [near](NEAR) true time zero.
    #[inline(always)]
    pub fn forward_straight(&self, at: Time<True>) -> Time<True> {
        // The later it arrives after an edge, the shorter it waits for the next one. The period of
        // the oscillator differs from that of true time by less than 1 ps.
        let turn = at.count().wrapping_mul(self.turns).wrapping_add(self.turned);
        let behind = ((u128::from(turn) * u128::from(self.period)) >> 64) as u64;
        Time::new(at.count().wrapping_add(self.on_average).wrapping_sub(behind))
    }

    /// The same by an oscillator that is not straight, without edges, or near true time zero.
    #[cold]
    fn forward_by<'a>(
        &self,
        on_average: u64,
        oscillator: impl FnOnce() -> &'a Oscillator,
    ) -> Time<True> {
        if self.period == 0 {
            return Time::new(on_average);
        }
        let at = on_average.wrapping_sub((self.period / 2).into());
        let behind = if self.turns > 0 {
            let left = on_average.wrapping_sub(self.on_average);
            let turn = left.wrapping_mul(self.turns).wrapping_add(self.turned);
            ((u128::from(turn) * u128::from(self.period)) >> 64) as u64
        } else {
            let count = oscillator().count_ps(Time::new(at)).wrapping_add(self.phase.into());
            count % u64::from(self.period)
        };
        // A frame must not arrive before true time zero, but may leave there.
        Time::new(on_average.saturating_sub(behind))
    }
}

/// Before this point of true time, ps, less than a period may have passed.
pub(crate) const NEAR: u64 = u32::MAX as u64;

/// The phase of a SubDevice's clock at power-on, ps.
pub(crate) fn phase(seed: u64, position: usize) -> u64 {
    Stream::new(seed, "receive clock", position as u64).up_to(MOST_PHASE)
}

/// A whole number of periods, far longer than any of them.
const MOST_PHASE: u64 = 1_000_000_000 - 1;

#[cfg(test)]
mod tests {
    use super::*;

    /// How much later than on average a frame is that arrives at `at`, ps.
    fn wait(edges: &Edges, oscillator: &Oscillator, at: Time<True>) -> i64 {
        (edges.forward(at, || oscillator) - at).0
    }

    /// Over one period every wait occurs once, and a frame that has waited is on the grid of the
    /// receiver.
    #[test]
    fn waits_are_even_and_end_on_edges() {
        for (period, phase) in [(40_000, 0), (40_000, 12_345), (10_000, 987_654_321)] {
            let oscillator = Oscillator::new(0);
            let edges = Edges::new(Picos(period), phase, &oscillator);
            let mut seen: Vec<i64> = Vec::new();
            let begin = Time::<True>::new(7_777_777_777);
            let first = edges.forward(begin, || &oscillator);
            for step in 0..period {
                let at = begin + Picos(step);
                let forwarded = edges.forward(at, || &oscillator);
                assert_eq!((forwarded - first).0 % period, 0, "{step}");
                seen.push((forwarded - at).0);
            }
            seen.sort_unstable();
            assert!(seen.iter().copied().eq(1 - period / 2..=period / 2));
        }
    }

    /// Frames on the edges of a true clock are received on those of a clock 10 ppm faster: 40 ns in
    /// 4 ms. It makes no difference whether the clock may have been another one long before.
    #[test]
    fn the_wait_goes_round_as_clocks_slip() {
        let straight = Oscillator::new(10_000);
        let mut bent = Oscillator::new(10_000);
        bent.bend(&[(0, 5_000), (1, -5_000)]);
        assert_eq!((straight.straight_rate().is_some(), bent.straight_rate()), (true, None));
        for receiver in [straight, bent] {
            let edges = Edges::new(Picos(40_000), 5_000, &receiver);
            for (micros, expected) in [
                (0, 15_000),
                (100, 14_000),
                (400, 11_000),
                (3_499, -19_990),
                (3_501, 19_990),
                (4_000, 15_000),
            ] {
                let wait = wait(&edges, &receiver, Time::new(micros * 1_000_000));
                assert!((wait - expected).abs() <= 1, "{micros} us: {wait}");
            }
        }
    }

    /// A frame at true time zero does not arrive before it.
    #[test]
    fn nothing_comes_before_the_beginning() {
        let oscillator = Oscillator::new(0);
        let edges = Edges::new(Picos(10_000), 9_999, &oscillator);
        assert_eq!(wait(&edges, &oscillator, Time::new(0)), 0);
        let later = wait(&edges, &oscillator, Time::new(10_000));
        assert!((later + 4_998).abs() <= 1, "{later}");
    }

    #[test]
    fn without_a_period_nothing_waits() {
        let none = Edges::default();
        assert!(!none.are_there());
        assert_eq!(wait(&none, &Oscillator::new(5), Time::new(1_234_567)), 0);
    }
}
