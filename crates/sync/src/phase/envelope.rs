//! The line under pairs whose stamps are early: it touches those of frames that left at once.
//!
//! Of all lines that have no pair below them it is the one to which the pairs are nearest in sum: the edge
//! of their lower hull above the middle of the time they span. For noise as of frames that are held up
//! (most of them shortly, any of them long) that is the best estimate there is, and its error falls with
//! the number of pairs, not with its root.
//!
//! [`POINTS`] points are kept, each the lowest of a number of pairs in a row. While the memory grows,
//! neighbours are merged when there is no room; when it is as long as the bandwidth asks for, the oldest
//! point goes. A lower pair moves the line at once. A line that has become too low shows in pairs that all stay
//! above it by more than their number allows: then the points before them are forgotten.

use isocat_wire::time::{Dc, Host, Nanos, Time};

use super::line::{Line, RATE_LIMIT};
use super::servo::Uncertainty;

/// The points and what is known of the pairs behind them.
#[derive(Clone, Debug)]
pub(super) struct Envelope {
    /// Oldest first; `len` of them count.
    points: [Point; POINTS],
    len: usize,
    /// Pairs that each point stands for.
    pairs_each: u32,
    /// The lowest of the newest pairs, and their number.
    newest: Option<Point>,
    newest_pairs: u32,
    /// All pairs since it began.
    samples: u32,
    /// Mean height of the pairs above the line, ns.
    height: f64,
    /// How much lower the line was when the points before were forgotten; 0: they were not, or that is settled.
    raised: f64,
    /// How much more surprising it must be than with exponential heights.
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
            points: [Point { host: Time::ZERO, dc: Time::ZERO }; POINTS],
            len: 0,
            pairs_each: 1,
            newest: None,
            newest_pairs: 0,
            samples: 0,
            height: 0.0,
            raised: 0.0,
            caution: 1.0,
        }
    }

    /// Takes a pair; the line through it and those before. `window` is the memory in samples, `noise` what the
    /// height of pairs is as a rule, ns.
    pub fn sample(
        &mut self,
        line: &Line,
        (host, dc): (Time<Host>, Time<Dc>),
        window: u32,
        noise: Nanos,
    ) -> Line {
        self.samples = self.samples.saturating_add(1);
        let error = line.error(host, dc);
        let weight = (1.0 / f64::from(self.samples)).max(1.0 / f64::from(window.max(1)));
        // One that was held up for long says nothing about the others.
        let most = 8.0 * noise.0 as f64;
        self.height += weight * (error.clamp(0.0, most) - self.height);
        if self.raised > 0.0 && error < -self.raised / 2.0 {
            // So what was forgotten was not over: on this host few frames leave at once.
            (self.raised, self.caution) = (0.0, (2.0 * self.caution).min(MOST_CAUTION));
        }
        let point = Point { host, dc };
        if self.newest.is_none_or(|lowest| error <= line.error(lowest.host, lowest.dc)) {
            self.newest = Some(point);
        }
        self.newest_pairs += 1;
        let full = self.newest_pairs >= self.pairs_each;
        if full {
            self.store(line, window);
            self.forget_what_is_over(line, noise);
        }
        if !full && error >= 0.0 {
            return *line;
        }
        self.fit(line, point)
    }

    /// Pairs that the line has.
    pub fn samples(&self) -> u32 {
        self.samples
    }

    /// How well the line is known; `None` for fewer than [`FEWEST`] pairs.
    ///
    /// The factors are of this estimator on exponential heights, found by trial (see the tests): a phase at the
    /// end of n pairs is off by some four n-ths of the mean height, a rate by some eight of them in the
    /// time they span.
    pub fn uncertainty(&self) -> Option<Uncertainty> {
        let pairs = self.len as f64 * f64::from(self.pairs_each);
        let points = &self.points[..self.len];
        let span = points.last()?.host - points.first()?.host;
        if self.samples < FEWEST || self.len < 3 || span.0 <= 0 {
            return None;
        }
        let share = self.height.max(LEAST_HEIGHT) / pairs;
        let phase_ns = PHASE_FACTOR * share;
        Some(Uncertainty { phase_ns, rate_ppb: RATE_FACTOR * share / span.0 as f64 * 1e9 })
    }

    /// The newest pairs become a point.
    fn store(&mut self, line: &Line, window: u32) {
        let Some(point) = self.newest.take() else { return };
        self.newest_pairs = 0;
        let kept = POINTS as u32 * self.pairs_each;
        if self.len == POINTS && kept < window {
            for pair in 0..POINTS / 2 {
                let [first, second] = [self.points[2 * pair], self.points[2 * pair + 1]];
                let lower = line.error(second.host, second.dc) < line.error(first.host, first.dc);
                self.points[pair] = if lower { second } else { first };
            }
            self.len = POINTS / 2;
            self.pairs_each *= 2;
        }
        let most = (window.div_ceil(self.pairs_each) as usize).clamp(4, POINTS);
        if self.len >= most {
            self.keep(most - 1);
        }
        self.points[self.len] = point;
        self.len += 1;
    }

    /// If the newest pairs all stay above the line by more than chance allows, those before them tell of a
    /// time that is over. If those in the middle do, the line is a chord of a curve, and the oldest are too old.
    fn forget_what_is_over(&mut self, line: &Line, noise: Nanos) {
        if self.len < 8 {
            return;
        }
        // What is measured counts once there is enough of it; it may be more than was set.
        let known = self.samples >= HEIGHT_KNOWN;
        let noise = if known { self.height } else { self.height.max(noise.0 as f64) };
        let most = |points: usize| {
            let pairs = points as f64 * f64::from(self.pairs_each);
            let chance = GRAIN + self.caution * SURPRISE * noise / pairs;
            if pairs >= FEWEST_HIGH { chance } else { f64::MAX }
        };
        let height = |point: &Point| line.error(point.host, point.dc);
        let points = &self.points[..self.len];
        let mut lowest = height(&points[self.len - 1]);
        for back in 2..=self.len / 2 {
            lowest = lowest.min(height(&points[self.len - back]));
            if lowest > most(back) {
                self.raised = lowest;
                return self.keep(back);
            }
        }
        let third = self.len / 3;
        let middle = &points[third..self.len - third];
        if middle.iter().map(height).fold(f64::MAX, f64::min) > most(middle.len()) {
            self.keep(self.len - third);
        }
    }

    /// Keeps the newest points.
    fn keep(&mut self, newest: usize) {
        self.points.copy_within(self.len - newest..self.len, 0);
        self.len = newest;
    }

    /// The line under all points and `newest`.
    fn fit(&self, line: &Line, newest: Point) -> Line {
        let Some(first) = self.points[..self.len].first() else { return *line };
        let middle = (newest.host - first.host).0 / 2;
        let points = || self.points[..self.len].iter().chain(Some(&newest));
        // Against the line as it was: small numbers, which floats hold exactly.
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
        let rate = (line.rate + rate).clamp(-RATE_LIMIT, RATE_LIMIT) - line.rate;
        let height = points().map(|point| y(point) - rate * x(point)).fold(f64::MAX, f64::min);
        let end = height + rate * (newest.host - first.host).0 as f64;
        let mut fitted = line.moved(newest.host, end);
        fitted.rate += rate;
        fitted
    }
}

/// Points kept.
const POINTS: usize = 128;
/// Most rounds of looking for the two points that carry the line: two or three do as a rule.
const MOST_TURNS: usize = 8;
/// Pairs from which on the uncertainty means something.
const FEWEST: u32 = 8;
/// How surprising it must be that pairs all stay above the line: the probability is e to the minus this. At
/// once a millisecond that happens once in ten minutes, and costs a line of fewer points for a while.
const SURPRISE: f64 = 16.0;
/// So many pairs must stay above the line, whatever their heights: one frame of a few may be held up for long.
const FEWEST_HIGH: f64 = 8.0;
/// Most that [`Envelope::caution`] may become.
const MOST_CAUTION: f64 = 64.0;
/// Pairs from which on their mean height counts more than what was set.
const HEIGHT_KNOWN: u32 = 256;
/// What the tick of the clock adds, ns.
const GRAIN: f64 = 20.0;
/// Mean height from the tick alone, ns.
const LEAST_HEIGHT: f64 = 5.0;
const PHASE_FACTOR: f64 = 4.0;
const RATE_FACTOR: f64 = 8.0;
