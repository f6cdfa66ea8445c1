//! How the phase that is left of a clock goes, by the differences that are seen in operation.
//!
//! A clock counts as converged while a drift loop still takes off a rest of its phase. Means over
//! spans of more and more differences tell how large that rest is, and when it has halved, in a
//! memory that does not grow.

use isocat_wire::time::Picos;

/// The differences of one clock from the reference, each with its time `T`, in spans. The first
/// span has [`FIRST`] differences, the second and the third have half as many, and two spans at a
/// time have twice as many as the two before. There are no more after the last span: a drift loop
/// takes off a phase by a factor of e in 1024 frames or fewer, so that nothing is left by then.
#[derive(Clone, Debug)]
// In this order: all that a difference touches lies together, and first.
#[repr(C)]
pub struct Settling<T> {
    /// Time of the first difference.
    begin: Option<T>,
    /// Differences so far, their number at which the open span ends, and the sum of that span.
    count: u32,
    end: u32,
    sum: i64,
    complete: usize,
    closed: bool,
    spans: [Mean<T>; SPANS],
}

/// The mean of a span of differences.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Mean<T> {
    /// Mean of the differences.
    pub difference: Picos,
    /// Time of the last of them.
    pub until: T,
}

impl<T: Copy + Default> Default for Settling<T> {
    fn default() -> Self {
        let spans = [Mean { difference: Picos(0), until: T::default() }; SPANS];
        Self { begin: None, count: 0, end: FIRST, sum: 0, spans, complete: 0, closed: false }
    }
}

impl<T: Copy> Settling<T> {
    /// Takes a difference.
    #[inline]
    pub fn sample(&mut self, at: T, difference: Picos) {
        if self.closed || self.complete == SPANS {
            return;
        }
        self.begin.get_or_insert(at);
        self.sum += difference.0;
        self.count += 1;
        if self.count >= self.end {
            self.complete_span(at);
        }
    }

    /// Ends the open span.
    #[cold]
    fn complete_span(&mut self, at: T) {
        let begin = self.complete.checked_sub(1).map_or(0, end_of);
        let mean = self.sum / i64::from(self.count - begin);
        self.spans[self.complete] = Mean { difference: Picos(mean), until: at };
        self.complete += 1;
        (self.end, self.sum) = (end_of(self.complete), 0);
    }

    /// Takes no more differences: what comes is no continuation of what was.
    pub fn close(&mut self) {
        self.closed = true;
    }

    /// Time of the first difference; `None` before it.
    pub fn begin(&self) -> Option<T> {
        self.begin
    }

    /// The first span; `None` while there are too few differences.
    pub fn first(&self) -> Option<Mean<T>> {
        self.complete().first().copied()
    }

    /// The last span that is complete.
    pub fn last(&self) -> Option<Mean<T>> {
        self.complete().last().copied()
    }

    /// The end of the span from which on no mean is above half of the first one: its phase has
    /// halved by then. `None` if it has not, and if the first mean is a tick of a clock or less,
    /// since half of that means nothing.
    pub fn halved(&self) -> Option<T> {
        let half = self.first()?.difference.abs().0 / 2;
        let is_above = |mean: &Mean<T>| mean.difference.abs().0 > half;
        let above = self.complete().iter().rposition(is_above)?;
        let from = self.complete().get(above + 1)?;
        (2 * half > TICK).then_some(from.until)
    }

    fn complete(&self) -> &[Mean<T>] {
        &self.spans[..self.complete]
    }
}

/// The number of differences at the end of a span: 4, 6, 8, 12, 16, 24, and so on.
const fn end_of(span: usize) -> u32 {
    let even = FIRST << (span / 2);
    if span.is_multiple_of(2) { even } else { even + even / 2 }
}

/// Differences in the first span.
pub const FIRST: u32 = 4;
/// Number of spans: 49 152 differences.
const SPANS: usize = 28;
/// A tick of a clock, ps.
const TICK: i64 = 10_000;

#[cfg(test)]
mod tests {
    use super::*;

    /// Differences in ns, one a unit of time from 1 on.
    fn settling(differences: impl IntoIterator<Item = i64>) -> Settling<u64> {
        let mut settling = Settling::default();
        for (at, ns) in differences.into_iter().enumerate() {
            settling.sample(at as u64 + 1, Picos(1_000 * ns));
        }
        settling
    }

    fn mean(ns: i64, until: u64) -> Option<Mean<u64>> {
        Some(Mean { difference: Picos(1_000 * ns), until })
    }

    #[test]
    fn spans_grow() {
        let ends = core::array::from_fn(end_of);
        assert_eq!(ends, [4, 6, 8, 12, 16, 24, 32]);
        assert_eq!(end_of(SPANS - 1), 49_152);
    }

    #[test]
    fn one_difference_less_than_a_span_is_too_few() {
        let few = settling([40; 3]);
        assert_eq!((few.begin(), few.first(), few.halved()), (Some(1), None, None));
        let enough = settling([-30, -40, -50, -60]);
        assert_eq!((enough.first(), enough.last()), (mean(-45, 4), mean(-45, 4)));
        let more = settling([40, 40, 40, 40, 20]);
        assert_eq!(more.last(), mean(40, 4), "the second span is not complete");
        assert_eq!(settling([40, 40, 40, 40, 20, 30]).last(), mean(25, 6));
        assert_eq!(settling([]).begin(), None);
    }

    #[test]
    fn both_sides_of_a_half() {
        let with = |last| settling([-40, -40, -40, -40, 30, 30, 20, last]);
        assert_eq!(with(20).halved(), Some(8));
        assert_eq!(with(21).halved(), None);
        // It is once more above half.
        let again = [40, 40, 40, 40, 10, 10, 30, 30, 20, 20, 20, 20];
        assert_eq!(settling(again).halved(), Some(12));
        assert_eq!(settling(again[..8].iter().copied()).halved(), None);
    }

    #[test]
    fn half_a_tick_means_nothing() {
        let from = |first| settling([first, first, first, first, 0, 0]);
        assert_eq!(from(10).halved(), None);
        assert_eq!(from(11).halved(), Some(6));
        assert_eq!(from(-11).halved(), Some(6));
    }

    #[test]
    fn nothing_comes_after_the_end() {
        let mut long = settling(core::iter::repeat_n(7, 60_000));
        assert_eq!(long.last(), mean(7, 49_152));
        long.close();
        assert_eq!(long.last(), mean(7, 49_152));
    }

    #[test]
    fn a_closed_one_takes_no_more() {
        let mut closed = settling([40; 5]);
        closed.close();
        for at in 6..100 {
            closed.sample(at, Picos(1));
        }
        assert_eq!((closed.first(), closed.last()), (mean(40, 4), mean(40, 4)));
    }
}
