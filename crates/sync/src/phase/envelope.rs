//! The line under pairs whose stamps are early; it touches those of frames that left at once.
//!
//! Of all lines that have no pair below them it is the one with the least sum of distances to the
//! pairs: the edge of their lower hull above the middle of the time they span. For the noise of
//! delayed frames (most of them short, some of any length) that is the best estimate there is. Its
//! error falls with the number of pairs, not with the root of that number.
//!
//! [`POINTS`] points are kept, each the lowest of several pairs in a row. While the memory grows,
//! neighbours are merged when all points are used. When the memory is as long as the bandwidth asks
//! for, the oldest point is dropped. A lower pair moves the line at once. A line that has become
//! too low shows in pairs that all stay above it for longer than chance allows; then the points
//! before them are dropped.
//!
//! The line is that edge until a pair lies below it, one of its two points is dropped, or the
//! middle leaves it. So most pairs cost one comparison, and the fit is made again for few of them.

use isocat_wire::time::{Dc, Host, Nanos, Time};

use super::line::{Line, RATE_LIMIT};
use super::servo::Uncertainty;

/// The points, and statistics of the pairs behind them.
#[derive(Clone, Debug)]
pub(super) struct Envelope {
    /// The `len` points from `start` on are valid, oldest first. There is twice the room, so that
    /// dropping the oldest moves none of the others.
    points: [Point; 2 * POINTS],
    start: usize,
    len: usize,
    /// The two points that carry the line, by their times; `None` if the last fit found none.
    edge: Option<[Time<Host>; 2]>,
    /// Number of pairs that each point stands for.
    pairs_each: u32,
    /// The lowest of the newest pairs with its height above the line, and the number of these.
    newest: Option<(Point, f64)>,
    newest_pairs: u32,
    /// Number of points behind the newest one that was low, when that was last searched.
    high: usize,
    /// Number of pairs since the start.
    samples: u32,
    /// Mean height of the pairs above the line, ns.
    height: f64,
    /// How much the line rose when the points before were dropped; 0 if they were not, or if that
    /// has proved wrong.
    raised: f64,
    /// How much more surprising pairs must be than with exponential heights.
    caution: f64,
}

#[derive(Clone, Copy, Debug, Default)]
struct Point {
    host: Time<Host>,
    dc: Time<Dc>,
}

impl Envelope {
    /// No pair yet.
    pub const fn new() -> Self {
        Self {
            points: [Point { host: Time::ZERO, dc: Time::ZERO }; 2 * POINTS],
            start: 0,
            len: 0,
            edge: None,
            pairs_each: 1,
            newest: None,
            newest_pairs: 0,
            high: usize::MAX,
            samples: 0,
            height: 0.0,
            raised: 0.0,
            caution: 1.0,
        }
    }

    /// Adds a pair, `error` ns above the line, and returns the new line if it is another one.
    /// `window` is the memory in samples, `noise` the usual height of pairs, ns.
    pub fn sample(
        &mut self,
        line: &Line,
        (host, dc): (Time<Host>, Time<Dc>),
        error: f64,
        window: u32,
        noise: Nanos,
    ) -> Option<Line> {
        self.samples = self.samples.saturating_add(1);
        let weight = (1.0 / f64::from(self.samples)).max(1.0 / f64::from(window.max(1)));
        // A frame with a long delay tells nothing about the others.
        let most = 8.0 * noise.0 as f64;
        self.height += weight * (error.clamp(0.0, most) - self.height);
        if self.raised > 0.0 && error < -self.raised / 2.0 {
            // So the dropped points were still valid: on this host few frames leave at once.
            (self.raised, self.caution) = (0.0, (2.0 * self.caution).min(MOST_CAUTION));
        }
        let point = Point { host, dc };
        if self.newest.is_none_or(|(_, lowest)| error <= lowest) {
            self.newest = Some((point, error));
        }
        self.newest_pairs += 1;
        let full = self.newest_pairs >= self.pairs_each;
        if full {
            self.store(line, window);
            self.forget_what_is_over(line, noise);
        }
        if error >= 0.0 && (!full || self.is_carried(host)) {
            return None;
        }
        let (line, edge) = self.fit(line, point);
        self.edge = edge;
        if let Some((lowest, height)) = &mut self.newest {
            *height = line.height(lowest.host, lowest.dc);
        }
        Some(line)
    }

    /// Whether the points that carry the line are still there, one on each side of the middle, if
    /// the newest pair is of this time.
    fn is_carried(&self, newest: Time<Host>) -> bool {
        let (Some([left, right]), Some(first)) = (self.edge, self.kept().first()) else {
            return false;
        };
        let middle = Nanos((newest - first.host).0 / 2);
        left >= first.host && left - first.host <= middle && right - first.host > middle
    }

    /// The points, oldest first.
    fn kept(&self) -> &[Point] {
        &self.points[self.start..][..self.len]
    }

    /// Number of pairs of the line.
    pub fn samples(&self) -> u32 {
        self.samples
    }

    /// The error of the line; `None` for fewer than [`FEWEST`] pairs.
    ///
    /// The factors hold for this estimator on exponential heights and were found by trial (see the
    /// tests). After n pairs the phase has an error of some four n-ths of the mean height, and the
    /// rate an error of some eight n-ths of it in the time they span.
    pub fn uncertainty(&self) -> Option<Uncertainty> {
        let pairs = self.len as f64 * f64::from(self.pairs_each);
        let points = self.kept();
        let span = points.last()?.host - points.first()?.host;
        if self.samples < FEWEST || self.len < 3 || span.0 <= 0 {
            return None;
        }
        let share = self.height.max(LEAST_HEIGHT) / pairs;
        let phase_ns = PHASE_FACTOR * share;
        Some(Uncertainty { phase_ns, rate_ppb: RATE_FACTOR * share / span.0 as f64 * 1e9 })
    }

    /// Makes the newest pairs a point.
    fn store(&mut self, line: &Line, window: u32) {
        let Some((point, _)) = self.newest.take() else { return };
        self.newest_pairs = 0;
        self.high = self.high.saturating_add(1);
        let kept = POINTS as u32 * self.pairs_each;
        if self.len == POINTS && kept < window {
            for pair in 0..POINTS / 2 {
                let at = self.start + 2 * pair;
                let [first, second] = [self.points[at], self.points[at + 1]];
                let lower = line.height(second.host, second.dc) < line.height(first.host, first.dc);
                self.points[pair] = if lower { second } else { first };
            }
            (self.start, self.len) = (0, POINTS / 2);
            self.pairs_each *= 2;
        }
        let most = (window.div_ceil(self.pairs_each) as usize).clamp(4, POINTS);
        if self.len >= most {
            self.keep(most - 1);
        }
        if self.start + self.len == self.points.len() {
            self.points.copy_within(self.start.., 0);
            self.start = 0;
        }
        self.points[self.start + self.len] = point;
        self.len += 1;
    }

    /// Drops points that are no longer valid. If the newest pairs all stay above the line for
    /// longer than chance allows, the points before them are outdated. If those in the middle do,
    /// the line is a chord of a curve, and the oldest points are outdated.
    fn forget_what_is_over(&mut self, line: &Line, noise: Nanos) {
        if self.len < 8 {
            return;
        }
        // The measured height is used once there are enough pairs; it may exceed the setting.
        let known = self.samples >= HEIGHT_KNOWN;
        let noise = if known { self.height } else { self.height.max(noise.0 as f64) };
        let surprise = self.caution * SURPRISE * noise;
        let pairs = |points: usize| points as f64 * f64::from(self.pairs_each);
        let most = |points: usize| match pairs(points) {
            pairs if pairs >= FEWEST_HIGH => GRAIN + surprise / pairs,
            _ => f64::MAX,
        };
        let height = |point: &Point| line.height(point.host, point.dc);
        let points = self.kept();
        // More points allow less, so that no more of them matter once one is below the least. Such
        // a one is known from the last search, and with it how many matter at most.
        let half = self.len / 2;
        let least = most(half);
        let is_low = |point: &Point| height(point) <= least;
        let known = points.iter().rev().nth(self.high).filter(|point| is_low(point));
        let last = if known.is_some() { self.high.min(half) } else { half };
        let enough = most(last);
        let (mut lowest, mut high) =
            (f64::MAX, if known.is_some() { self.high } else { usize::MAX });
        for (back, point) in points.iter().rev().take(last).enumerate() {
            lowest = lowest.min(height(point));
            if lowest <= enough {
                if lowest <= least {
                    high = back;
                }
                break;
            }
            let back = back + 1;
            if back >= 2 && lowest > most(back) {
                self.raised = lowest;
                return self.keep(back);
            }
        }
        self.high = high;
        let points = self.kept();
        let third = self.len / 3;
        let middle = &points[third..self.len - third];
        // A point that carries the line is on it.
        let is_within = |carrier: Time<Host>| {
            let ends = middle.first().zip(middle.last());
            ends.is_some_and(|(first, last)| (first.host..=last.host).contains(&carrier))
        };
        if self.edge.is_some_and(|edge| edge.into_iter().any(is_within)) {
            return;
        }
        let allowed = most(middle.len());
        if middle.iter().all(|point| height(point) > allowed) {
            self.keep(self.len - third);
        }
    }

    /// Keeps only the newest points.
    fn keep(&mut self, newest: usize) {
        self.start += self.len - newest;
        self.len = newest;
    }

    /// The line under all points and `newest`, and the two of them that carry it.
    fn fit(&self, line: &Line, newest: Point) -> (Line, Option<[Time<Host>; 2]>) {
        let points = self.kept();
        let Some(first) = points.first() else { return (*line, None) };
        let span = newest.host - first.host;
        // Points are in the order of their times, all different.
        let middle = points.partition_point(|point| point.host - first.host <= Nanos(span.0 / 2));
        let (left, right) = points.split_at(middle);
        let below = Below { line, first, span };
        let mut rate = 0.0;
        // The height of the line with this rate, if both halves were searched with it.
        let mut height = None;
        let mut edge = None;
        let turns = if span.0 > 0 { MOST_TURNS } else { 0 };
        for _ in 0..turns {
            let right = below.lowest(right.iter().chain(Some(&newest)), rate);
            let (Some(left), Some(right)) = (below.lowest(left.iter(), rate), right) else { break };
            let better = (right.y - left.y) / (right.x - left.x);
            if (better - rate).abs() < 1e-12 {
                height = Some((rate, left.above(rate).min(right.above(rate))));
                edge = Some([left, right].map(|place| first.host + Nanos(place.x as i64)));
                break;
            }
            rate = better;
        }
        let steep = line.rate + rate;
        let edge = edge.filter(|_| steep.abs() < RATE_LIMIT);
        // Only a rate that is not limited stays the same to the bit, and its height is known.
        let rate =
            if steep.abs() < RATE_LIMIT { rate } else { RATE_LIMIT.copysign(steep) - line.rate };
        let height = match height.filter(|(of, _)| *of == rate) {
            Some((_, height)) => height,
            None => {
                let lowest = below.lowest(points.iter().chain(Some(&newest)), rate);
                lowest.map_or(f64::MAX, |place| place.above(rate))
            }
        };
        let end = height + rate * span.0 as f64;
        let mut fitted = line.moved(newest.host, end);
        fitted.rate += rate;
        (fitted, edge)
    }
}

/// The search for the lowest point, seen along a line.
struct Below<'a> {
    line: &'a Line,
    first: &'a Point,
    /// Time of all points.
    span: Nanos,
}

/// A point relative to the old line, in which numbers are small, so that floats hold them exactly.
#[derive(Clone, Copy)]
struct Place {
    /// Time since the first point, ns.
    x: f64,
    /// Height above the old line, ns.
    y: f64,
}

impl Place {
    /// The height above a line through the origin.
    fn above(&self, rate: f64) -> f64 {
        self.y - rate * self.x
    }
}

impl Below<'_> {
    /// The first of the lowest points above a line of this rate.
    ///
    /// Most points are far above the lowest. Whole numbers show that at a third of the cost: a
    /// point that they find [`DOUBT`] higher than another is higher, and is passed over.
    fn lowest<'p>(&self, points: impl Iterator<Item = &'p Point>, rate: f64) -> Option<Place> {
        let slope = self.line.rate + rate;
        let is_usual = slope.abs() < STEEPEST && (0..LONGEST).contains(&self.span.0);
        let slope = (slope * (1_u64 << SCALE) as f64) as i64;
        let mut lowest: Option<Place> = None;
        let mut least = i64::MAX - DOUBT;
        for point in points {
            let x = (point.host - self.first.host).0;
            let y = (point.dc - self.first.dc).0.wrapping_sub(x);
            if is_usual {
                let above = y.wrapping_sub(x.wrapping_mul(slope) >> SCALE);
                if above > least + DOUBT {
                    continue;
                }
                least = least.min(above);
            }
            let place = Place { x: x as f64, y: self.line.height(point.host, point.dc) };
            if lowest.is_none_or(|lowest| place.above(rate) < lowest.above(rate)) {
                lowest = Some(place);
            }
        }
        lowest
    }
}

/// Number of points kept.
const POINTS: usize = 128;
/// Bits behind the point of a slope as a whole number.
const SCALE: u32 = 36;
/// Slopes and times, ns, for which whole numbers do: their product has 62 bits.
const STEEPEST: f64 = 1.0 / 256.0;
const LONGEST: i64 = 1 << 34;
/// By how much heights in whole numbers may be wrong, ns: 1 for rounding down, 1/4 for the slope,
/// for each of two points.
const DOUBT: i64 = 3;
/// Most iterations to find the two points that carry the line; two or three are usual.
const MOST_TURNS: usize = 8;
/// Pairs from which on the uncertainty has a meaning.
const FEWEST: u32 = 8;
/// How surprising it must be that pairs all stay above the line: the probability is e to the minus
/// this. With one pair per millisecond that happens by chance once in ten minutes; for a while the
/// line then has fewer points.
const SURPRISE: f64 = 16.0;
/// Fewest pairs that must stay above the line, whatever their heights: one frame of a few may have
/// a long delay.
const FEWEST_HIGH: f64 = 8.0;
/// Largest value of [`Envelope::caution`].
const MOST_CAUTION: f64 = 64.0;
/// Pairs from which on their mean height replaces the setting.
const HEIGHT_KNOWN: u32 = 256;
/// The part of the tick of the clock, ns.
const GRAIN: f64 = 20.0;
/// Mean height from the tick alone, ns.
const LEAST_HEIGHT: f64 = 5.0;
const PHASE_FACTOR: f64 = 4.0;
const RATE_FACTOR: f64 = 8.0;

#[cfg(test)]
mod tests {
    use super::*;

    impl Envelope {
        fn take(&mut self, line: &Line, Point { host, dc }: Point, window: u32) -> Option<Line> {
            self.sample(line, (host, dc), line.error(host, dc), window, Nanos(10_000))
        }

        /// The fit as it is defined: each turn looks at all points.
        fn fit_plainly(&self, line: &Line, newest: Point) -> Line {
            let Some(first) = self.kept().first() else { return *line };
            let middle = (newest.host - first.host).0 / 2;
            let points = || self.kept().iter().chain(Some(&newest));
            let x = |point: &Point| (point.host - first.host).0 as f64;
            let y = |point: &Point| line.error(point.host, point.dc);
            let mut rate = 0.0;
            for _ in 0..MOST_TURNS {
                let lowest = |right: bool| {
                    let half = points().filter(|p| ((p.host - first.host).0 > middle) == right);
                    half.map(|point| (x(point), y(point)))
                        .reduce(|a, b| if b.1 - rate * b.0 < a.1 - rate * a.0 { b } else { a })
                };
                let (Some(left), Some(right)) = (lowest(false), lowest(true)) else { break };
                let better = (right.1 - left.1) / (right.0 - left.0);
                if (better - rate).abs() < 1e-12 {
                    break;
                }
                rate = better;
            }
            let steep = line.rate + rate;
            let limited = RATE_LIMIT.copysign(steep) - line.rate;
            let rate = if steep.abs() < RATE_LIMIT { rate } else { limited };
            let height = points().map(|point| y(point) - rate * x(point)).fold(f64::MAX, f64::min);
            let end = height + rate * (newest.host - first.host).0 as f64;
            let mut fitted = line.moved(newest.host, end);
            fitted.rate += rate;
            fitted
        }
    }

    /// Numbers below a limit, the same in each run.
    fn draw() -> impl FnMut(u64) -> u64 {
        let mut random = 0x2545_F491_4F6C_DD1D_u64;
        move |below: u64| {
            random ^= random << 13;
            random ^= random >> 7;
            random ^= random << 17;
            random % below
        }
    }

    /// Passing points over changes no bit of the line, with clocks of any rate, heights of any
    /// size, and cycles from 50 us to longer than whole numbers take.
    #[test]
    fn the_fit_is_the_plain_one() {
        let mut draw = draw();
        for run in 0..60 {
            let cycle = [50_000, 1_000_000, 4_000_000, 10_000_000, 1_000_000_000][run % 5];
            let ppb = draw(2_400_000) as i64 - 1_200_000;
            let most = [1, 30, 10_000, 1_000_000][run % 4];
            let window = [100, 250, 1_000][run % 3];
            let mut envelope = Envelope::new();
            let mut host = 1_000_000 + draw(1 << 40);
            let mut line = Line { host: Time::new(host), dc: Time::new(7), ..Line::default() };
            for _ in 0..600 {
                host += cycle + draw(cycle / 10);
                let drift = i128::from(host) * i128::from(ppb) / 1_000_000_000;
                let most = draw(most);
                let height = draw(1 + most);
                let dc = (i128::from(host) + drift) as u64 + height;
                let point = Point { host: Time::new(host), dc: Time::new(dc / 10 * 10) };
                let next = envelope.take(&line, point, window);
                let (fast, plain) =
                    (envelope.fit(&line, point).0, envelope.fit_plainly(&line, point));
                let bits = |line: &Line| (line.dc, line.fraction.to_bits(), line.rate.to_bits());
                assert_eq!(bits(&fast), bits(&plain), "run {run}");
                line = next.unwrap_or(line);
            }
        }
    }

    /// A line that is kept without a fit is the one that a fit would find, to a thousandth of a
    /// nanosecond over all of its points. It is kept for most pairs.
    #[test]
    fn a_line_that_is_carried_is_the_fitted_one() {
        let mut draw = draw();
        for run in 0..40 {
            let cycle = [250_000, 1_000_000, 4_000_000, 10_000_000][run % 4];
            let window = [100, 250, 1_000][run % 3];
            let ppb = draw(200_000) as i64 - 100_000;
            let mut envelope = Envelope::new();
            let mut host = 1_000_000 + draw(1 << 40);
            let mut line = Line { host: Time::new(host), dc: Time::new(7), ..Line::default() };
            let (mut full, mut fits) = (0, 0);
            for sample in 0..4_000 {
                host += cycle + draw(cycle / 10);
                // The sum of two draws has few low values, as stamps of a busy host.
                let height = draw(10_000) + if run % 2 == 0 { 0 } else { draw(10_000) };
                let drift = i128::from(host) * i128::from(ppb) / 1_000_000_000;
                let dc = (i128::from(host) + drift) as u64 + height;
                let point = Point { host: Time::new(host), dc: Time::new(dc / 10 * 10) };
                let next = envelope.take(&line, point, window);
                let is_full = envelope.newest_pairs == 0;
                if sample >= 1_000 {
                    full += u32::from(is_full);
                    fits += u32::from(next.is_some());
                }
                if is_full && next.is_none() {
                    let (fitted, _) = envelope.fit(&line, point);
                    for point in [*envelope.kept().first().expect("one is stored"), point] {
                        let (at, of) = (fitted.at(point.host), line.at(point.host));
                        let apart = (at.0 - of.0).0 as f64 + at.1 - of.1;
                        assert!(apart.abs() < 1e-3, "run {run}, sample {sample}: {apart} ns");
                    }
                }
                line = next.unwrap_or(line);
            }
            assert!(fits * 4 < full, "run {run}: {fits} fits for {full} points");
        }
    }
}
