//! Oscillators: the count of a free-running clock against true time.
//!
//! An [`Oscillator`] is made from a [`ClockModel`]: a constant deviation, a temperature ramp, a
//! step, a bounded random walk. All of them change the *rate*, at known points of true time;
//! between two of them the count is linear. The sum of the linear pieces is kept in whole units of
//! 2⁻⁶⁴ ns, so it is exact, without drift or jumps. The pieces of ramp and step are a short list;
//! the walk is a table that repeats, forward and back. So reading and its inverse are closed forms:
//! a search in either, then one multiplication or division.

use isocat_wire::time::{Nanos, Scale, Time, True};

use crate::fault::ClockChange;
use crate::random::Stream;

#[cfg(test)]
mod tests;

/// How a clock deviates from true time. Points of true time count from the start of the run.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct ClockModel {
    /// Constant deviation, ppb; positive is fast.
    pub deviation_ppb: i64,
    /// A slow change, for example by temperature.
    pub ramp: Option<Ramp>,
    /// A sudden change, for example by a shock or a switched supply.
    pub step: Option<Step>,
    /// A random walk of the speed.
    pub walk: Option<Walk>,
}

/// A deviation that grows evenly, in [`RAMP_PIECES`] steps.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Ramp {
    /// Growth in all, ppb.
    pub by_ppb: i64,
    /// True time at which it begins, 0 or more.
    pub from: Nanos,
    /// Duration, above zero.
    pub over: Nanos,
}

/// A deviation that changes suddenly.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Step {
    /// Change, ppb.
    pub by_ppb: i64,
    /// True time of the change, 0 or more.
    pub at: Nanos,
}

/// A deviation that wanders: it changes by up to `step_ppb` up or down in each interval, and never
/// exceeds `bound_ppb`. After [`WALK_PIECES`] intervals it goes the same way back, and so on.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Walk {
    /// Largest change from one interval to the next, ppb.
    pub step_ppb: i64,
    /// Length of an interval of true time, above zero.
    pub every: Nanos,
    /// Largest distance from the initial deviation, ppb.
    pub bound_ppb: i64,
}

/// Steps of a ramp. Each is a straight line; 64 of them make the error of the count against an even
/// ramp less than `by` × `over` / 1024: 10 ns for 1 ppm in 10 s.
pub const RAMP_PIECES: i64 = 64;
/// Intervals of a random walk until it turns back: enough that a run of cycles does not meet the
/// turn by accident, few enough for a table (24 KiB for each device with a walk).
pub const WALK_PIECES: usize = 1024;
/// Largest deviation of all parts of a model together, ppb: a clock deviates by at most 1 %.
pub const MOST_DEVIATION_PPB: i64 = 10_000_000;

impl ClockModel {
    /// A clock that runs fast by `deviation_ppb` parts per billion (slow, if negative).
    pub const fn constant(deviation_ppb: i64) -> Self {
        Self { deviation_ppb, ramp: None, step: None, walk: None }
    }

    /// Its largest possible deviation from true time, ppb.
    pub fn most_deviation_ppb(&self) -> i64 {
        let parts = [
            self.ramp.map_or(0, |ramp| ramp.by_ppb),
            self.step.map_or(0, |step| step.by_ppb),
            self.walk.map_or(0, |walk| walk.bound_ppb),
        ];
        parts.iter().fold(self.deviation_ppb.saturating_abs(), |sum, part| {
            sum.saturating_add(part.saturating_abs())
        })
    }
}

/// An oscillator that counts nanoseconds from zero at true time zero.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Oscillator {
    /// The rate of the first piece, 2⁻⁶⁴ ns per ps.
    rate: u64,
    /// The factor from readings to true time, if the rate never changes.
    factor: Factor,
    /// Further pieces and the walk; most clocks have none.
    shape: Option<Box<Shape>>,
}

#[derive(Clone, PartialEq, Eq, Debug)]
struct Shape {
    /// Ascending by `start`; the first starts at zero.
    pieces: Vec<Piece>,
    walk: Option<Wander>,
}

/// A straight piece, without the walk.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct Piece {
    /// ps of true time.
    start: u64,
    /// The count at its start, including the walk's part, 2⁻⁶⁴ ns.
    count: u128,
    /// 2⁻⁶⁴ ns per ps.
    rate: u64,
}

impl Oscillator {
    /// An oscillator that runs fast by `deviation_ppb` parts per billion (slow, if negative).
    /// Panics beyond [`MOST_DEVIATION_PPB`].
    pub fn new(deviation_ppb: i64) -> Self {
        assert!(deviation_ppb.abs() <= MOST_DEVIATION_PPB, "an oscillator deviates by at most 1 %");
        let rate = rate_of(deviation_ppb);
        Self { rate, factor: Factor(reciprocal(rate)), shape: None }
    }

    /// The oscillator of a model; `chance` draws the walk. Panics on a model that deviates by more
    /// than [`MOST_DEVIATION_PPB`], or whose times are negative (for lengths: zero), which are
    /// errors of the caller.
    pub fn of(model: &ClockModel, chance: &mut Stream) -> Self {
        let most = model.most_deviation_ppb();
        assert!(most <= MOST_DEVIATION_PPB, "an oscillator deviates by at most 1 %: {most} ppb");
        if (model.ramp, model.step, model.walk) == (None, None, None) {
            return Self::new(model.deviation_ppb);
        }
        let walk = model.walk.map(|walk| Wander::new(&walk, chance));
        let mut pieces: Vec<Piece> = Vec::new();
        for (start, deviation_ppb) in changes(model) {
            let rate = rate_of(deviation_ppb);
            let count = match pieces.last() {
                None => 0,
                Some(last) => {
                    let wandered = wandered(&walk, start) - wandered(&walk, last.start);
                    let straight = u128::from(start - last.start) * u128::from(last.rate);
                    (last.count + straight).wrapping_add_signed(wandered)
                }
            };
            pieces.push(Piece { start, count, rate });
        }
        let (rate, shape) = (pieces[0].rate, Some(Box::new(Shape { pieces, walk })));
        Self { rate, factor: Factor::NONE, shape }
    }

    /// Its rate, 2⁻⁶⁴ ns per ps, if that never changes.
    pub(crate) fn straight_rate(&self) -> Option<u64> {
        self.shape.is_none().then_some(self.rate)
    }

    /// Its count at a point of true time: whole ns, rounded down.
    pub fn read<S: Scale>(&self, at: Time<True>) -> Time<S> {
        let at = at.count();
        let count = match &self.shape {
            None => u128::from(at) * u128::from(self.rate),
            Some(shape) => shape.count(at),
        };
        Time::new((count >> 64) as u64)
    }

    /// Its count at a point of true time, ps, rounded down; wraps at 64 bits.
    pub(crate) fn count_ps(&self, at: Time<True>) -> u64 {
        let at = at.count();
        let count = match &self.shape {
            None => u128::from(at) * u128::from(self.rate),
            Some(shape) => shape.count(at),
        };
        let part = (u128::from(count as u64) * 1_000) >> 64;
        ((count >> 64) as u64).wrapping_mul(1_000).wrapping_add(part as u64)
    }

    /// The first point of true time at which it counts `reading`; never, if that is beyond the
    /// range of time.
    #[inline]
    pub fn when<S: Scale>(&self, reading: Time<S>) -> Time<True> {
        self.factor.when(reading).unwrap_or_else(|| self.find(reading.count()))
    }

    /// The factor from its readings to true time.
    #[inline]
    pub(crate) fn factor(&self) -> Factor {
        self.factor
    }

    /// The same as [`when`](Self::when), by a division or a search.
    #[cold]
    fn find(&self, reading: u64) -> Time<True> {
        let count = u128::from(reading) << 64;
        let at = match &self.shape {
            None => Some(count.div_ceil(u128::from(self.rate))),
            Some(shape) => shape.when(count),
        };
        at.and_then(|at| u64::try_from(at).ok()).map_or(Time::NEVER, Time::new)
    }
}

/// The [`reciprocal`] of a rate that never changes; zero of one that does.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Factor(u64);

impl Factor {
    /// None.
    pub const NONE: Self = Self(0);

    /// [`Oscillator::when`], if a multiplication decides it.
    #[inline]
    pub fn when<S: Scale>(self, reading: Time<S>) -> Option<Time<True>> {
        // The exact quotient is not below this one, and higher by less than the reading.
        let product = u128::from(reading.count()) * u128::from(self.0);
        let (at, part) = ((product >> RECIPROCAL_SHIFT) as u64, product as u64 & (SHORT - 1));
        let is_exact = part > 0 && reading.count() <= SHORT - part;
        is_exact.then(|| Time::new(at + 1))
    }
}

/// 2¹¹⁷ divided by a rate, rounded down. A reading in ns times this, divided by 2⁵³, is the reading
/// in ps; for readings below [`SHORT`] it is less than 2 ps too small.
fn reciprocal(rate: u64) -> u64 {
    // A rate is within 1 % of 2⁶⁴ / 1000, so this has 64 bits.
    ((1u128 << (64 + RECIPROCAL_SHIFT)) / u128::from(rate)).try_into().unwrap_or(u64::MAX)
}

const RECIPROCAL_SHIFT: u32 = 53;
/// Readings below this, 104 days, are divided by the [`reciprocal`].
const SHORT: u64 = 1 << RECIPROCAL_SHIFT;

/// A change of an oscillator's speed: the point of true time, ps, and the change, ppb.
pub(crate) type Bend = (u64, i64);

impl ClockChange {
    /// The changes of the speed, if it begins at `from`.
    pub(crate) fn bends(&self, from: Time<True>, chance: &mut Stream) -> Vec<Bend> {
        let from = from.count();
        match *self {
            Self::Step { by_ppb } => vec![(from, by_ppb)],
            Self::Ramp { by_ppb, over } => stairs(by_ppb, from, picos(over)),
            Self::Walk { step_ppb, every, bound_ppb } => {
                let mut deviation = 0;
                let bend = |interval: u64| {
                    let before = deviation;
                    deviation = wander(deviation, step_ppb, bound_ppb, chance);
                    (from.saturating_add(interval * picos(every)), deviation - before)
                };
                (0..WALK_PIECES as u64).map(bend).collect()
            }
        }
    }
}

impl Oscillator {
    /// Changes the speed from each of these points on. The count before them stays unchanged. The
    /// deviation never exceeds [`MOST_DEVIATION_PPB`], even if a larger change is requested.
    pub(crate) fn bend(&mut self, bends: &[Bend]) {
        for (at, by_ppb) in bends {
            self.cut_piece(*at);
            let pieces = &mut self.shape_mut().pieces;
            let first = pieces.partition_point(|piece| piece.start < *at);
            for piece in &mut pieces[first..] {
                let rate = piece.rate.wrapping_add_signed(rate_offset(*by_ppb));
                piece.rate = rate.clamp(rate_of(-MOST_DEVIATION_PPB), rate_of(MOST_DEVIATION_PPB));
            }
            self.count_on(first);
        }
    }

    /// Lets the count jump ahead by this time at a point.
    pub(crate) fn jump(&mut self, at: Time<True>, by: Nanos) {
        self.cut_piece(at.count());
        let pieces = &mut self.shape_mut().pieces;
        let first = pieces.partition_point(|piece| piece.start < at.count());
        for piece in &mut pieces[first..] {
            piece.count += (by.0.max(0) as u128) << 64;
        }
        let rate = pieces[0].rate;
        self.rate = rate;
    }

    /// Begins a new piece at `at`, if none begins there.
    fn cut_piece(&mut self, at: u64) {
        let shape = self.shape_mut();
        let next = shape.pieces.partition_point(|piece| piece.start <= at);
        let before = shape.pieces[next - 1];
        if before.start < at {
            let piece = Piece { start: at, count: shape.count(at), rate: before.rate };
            shape.pieces.insert(next, piece);
        }
    }

    /// Computes the counts of the pieces after this one again.
    fn count_on(&mut self, from: usize) {
        let Shape { pieces, walk } = self.shape_mut();
        for number in from + 1..pieces.len() {
            let (last, start) = (pieces[number - 1], pieces[number].start);
            let wandered = wandered(walk, start) - wandered(walk, last.start);
            let straight = u128::from(start - last.start) * u128::from(last.rate);
            pieces[number].count = (last.count + straight).wrapping_add_signed(wandered);
        }
        self.rate = self.shape_mut().pieces[0].rate;
    }

    fn shape_mut(&mut self) -> &mut Shape {
        let piece = Piece { start: 0, count: 0, rate: self.rate };
        self.factor = Factor::NONE;
        self.shape.get_or_insert_with(|| Box::new(Shape { pieces: vec![piece], walk: None }))
    }
}

impl Shape {
    /// The exact count at `at`, 2⁻⁶⁴ ns.
    fn count(&self, at: u64) -> u128 {
        let piece = self.pieces[self.pieces.partition_point(|piece| piece.start <= at) - 1];
        let straight = u128::from(at - piece.start) * u128::from(piece.rate);
        let wandered = wandered(&self.walk, at) - wandered(&self.walk, piece.start);
        (piece.count + straight).wrapping_add_signed(wandered)
    }

    /// The first point at which the exact count is `count` or more.
    fn when(&self, count: u128) -> Option<u128> {
        // The count at the start of the first piece is zero, and nothing comes before it.
        let number = self.pieces.partition_point(|piece| piece.count < count).max(1) - 1;
        let piece = self.pieces[number];
        let left = count.saturating_sub(piece.count);
        let start = u128::from(piece.start);
        let at = match &self.walk {
            None => start + left.div_ceil(u128::from(piece.rate)),
            Some(walk) => walk.when(piece, left)?,
        };
        // Counts that a jump skips are reached at the end of the jump.
        let next = self.pieces.get(number + 1).map(|next| u128::from(next.start));
        Some(next.map_or(at, |next| at.min(next)))
    }
}

/// The table of a random walk.
#[derive(Clone, PartialEq, Eq, Debug)]
struct Wander {
    /// Length of an interval, ps.
    every: u64,
    /// Deviation in each interval of the way there, 2⁻⁶⁴ ns per ps.
    rates: Vec<i64>,
    /// Its sum in the count up to the start of each interval, and to the end of the last.
    sums: Vec<i128>,
}

impl Wander {
    fn new(walk: &Walk, chance: &mut Stream) -> Self {
        assert!(walk.every > Nanos::ZERO, "a walk needs time: every {}", walk.every);
        let every = picos(walk.every);
        let (step, bound) = (walk.step_ppb.abs(), walk.bound_ppb.abs());
        let mut deviation = 0;
        let mut sums = vec![0];
        let rates = (0..WALK_PIECES).map(|_| {
            deviation = wander(deviation, step, bound, chance);
            let rate = rate_offset(deviation);
            let sum = sums[sums.len() - 1] + i128::from(rate) * i128::from(every);
            sums.push(sum);
            rate
        });
        let rates = rates.collect();
        Self { every, rates, sums }
    }

    /// Number of intervals until it is back at its start and repeats.
    const PERIOD: u64 = 2 * WALK_PIECES as u64;

    /// Deviation in the interval with this number, and its sum up to the interval.
    fn interval(&self, number: u64) -> (i64, i128) {
        let (rounds, within) = (number / Self::PERIOD, (number % Self::PERIOD) as usize);
        let there = self.sums[WALK_PIECES];
        let before = i128::from(rounds) * 2 * there;
        if within < WALK_PIECES {
            return (self.rates[within], before + self.sums[within]);
        }
        let back = 2 * WALK_PIECES - within;
        (self.rates[back - 1], before + 2 * there - self.sums[back])
    }

    /// Its sum in the count up to `at`.
    fn sum(&self, at: u64) -> i128 {
        let (rate, sum) = self.interval(at / self.every);
        sum + i128::from(rate) * i128::from(at % self.every)
    }

    /// The first point, in a straight `piece` and after it, at which the count has grown by `left`
    /// since the start of the piece.
    fn when(&self, piece: Piece, left: u128) -> Option<u128> {
        let start_sum = self.sum(piece.start);
        // The count at the beginning of an interval, since the start of the piece.
        let grown = |number: u64| {
            let (_, sum) = self.interval(number);
            let since = i128::from(number) * i128::from(self.every) - i128::from(piece.start);
            since * i128::from(piece.rate) + sum - start_sum
        };
        let left = i128::try_from(left).ok()?;
        // All clocks are within 1 %, so the interval is at most 2 % off a first guess.
        let first = piece.start / self.every;
        let most = left / i128::from(piece.rate / 100 * 97) / i128::from(self.every) + 2;
        let (mut low, mut high) = (first, first + u64::try_from(most).ok()?);
        while high - low > 1 {
            let middle = low + (high - low) / 2;
            if grown(middle) < left { low = middle } else { high = middle }
        }
        let (rate, _) = self.interval(low);
        let (from, before) = match low {
            low if low == first => (u128::from(piece.start), 0),
            low => (u128::from(low) * u128::from(self.every), grown(low)),
        };
        let rate = u128::from(piece.rate.wrapping_add_signed(rate));
        Some(from + ((left - before).max(0) as u128).div_ceil(rate))
    }
}

fn wandered(walk: &Option<Wander>, at: u64) -> i128 {
    walk.as_ref().map_or(0, |walk| walk.sum(at))
}

/// The deviations of ramp and step: points of true time, ascending, and the deviation from there
/// on.
fn changes(model: &ClockModel) -> Vec<(u64, i64)> {
    let mut changes = vec![(0, model.deviation_ppb)];
    if let Some(Ramp { by_ppb, from, over }) = model.ramp {
        assert!(over > Nanos::ZERO, "a ramp needs time: over {over}");
        let (from, over) = (picos(from), picos(over));
        changes.extend(stairs(by_ppb, from, over));
    }
    if let Some(step) = model.step {
        changes.push((picos(step.at), step.by_ppb));
    }
    changes.sort_by_cached_key(|(at, _)| *at);
    let mut deviation = 0;
    for (_, by) in &mut changes {
        deviation += *by;
        *by = deviation;
    }
    // Of several changes at one point the last holds the sum.
    changes.reverse();
    changes.dedup_by_key(|(at, _)| *at);
    changes.reverse();
    changes
}

/// The steps of a ramp that begins at `from` and takes `over`, ps.
fn stairs(by_ppb: i64, from: u64, over: u64) -> Vec<Bend> {
    let stair = |stair: i64| {
        // Each step is half a step early, so that the steps are around the even ramp and not below
        // it.
        let part = i128::from(2 * stair - 1) * i128::from(over) / i128::from(2 * RAMP_PIECES);
        let gained = |stair| (i128::from(by_ppb) * i128::from(stair)) / i128::from(RAMP_PIECES);
        (from.saturating_add(part as u64), (gained(stair) - gained(stair - 1)) as i64)
    };
    (1..=RAMP_PIECES).map(stair).collect()
}

/// The next deviation of a walk.
fn wander(deviation: i64, step: i64, bound: i64, chance: &mut Stream) -> i64 {
    let change = chance.up_to(2 * step.unsigned_abs()) as i64 - step;
    (deviation + change).clamp(-bound, bound)
}

/// The rate of a clock that deviates by `ppb`, 2⁻⁶⁴ ns per ps: exact to 10⁻¹⁶.
fn rate_of(ppb: i64) -> u64 {
    ((u128::from((1_000_000_000 + ppb) as u64) << 64) / PARTS) as u64
}

/// Change of a rate by `ppb`.
fn rate_offset(ppb: i64) -> i64 {
    (i128::from(ppb) << 64).div_euclid(PARTS as i128) as i64
}

fn picos(time: Nanos) -> u64 {
    assert!(time >= Nanos::ZERO, "points of true time count from the beginning: {time}");
    time.0 as u64 * 1000
}

/// ps in a thousandth of a second times ppb.
const PARTS: u128 = 1_000_000_000_000;
