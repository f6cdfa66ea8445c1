//! The time from one drift frame to the next while clocks lock.

use isocat_wire::time::Nanos;

/// Intervals that begin short and grow with the time that has passed.
///
/// An interval is as short as at the start until a loop that averages speeds over 2^(0x0935) frames
/// has seen four times as many, and until the phase is gone that the clock has gained meanwhile:
/// what is left of it goes with the number of frames, so short intervals are the fastest. From then
/// on it is always the same part of the time passed: a loop with such frames forgets nothing too
/// early and keeps nothing too long.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Pace {
    /// The part of the time passed that an interval takes.
    part: i64,
    /// The interval that it begins with.
    shortest: Nanos,
    /// The longest interval.
    longest: Nanos,
    /// Time that had passed at another pace before.
    before: Nanos,
}

impl Pace {
    /// Intervals for loops that average speeds over 2^`depth` frames, and for clocks whose
    /// difference has this `noise` behind its filter (1 sigma). When the cycle's own frames follow,
    /// a clock moves by its noise times the ratio of both intervals. So the longest interval is the
    /// part of the `cycle` with which that is 20 ns.
    pub fn new(cycle: Nanos, depth: u8, noise: Nanos) -> Self {
        let noise = noise.max(LEAST_NOISE).min(MOVED);
        let longest = Nanos(cycle.0 / MOVED.0 * noise.0).max(SHORTEST);
        Self { part: MEANS << depth, shortest: SHORTEST, longest, before: Nanos::ZERO }
    }

    /// The longest interval from the beginning, and no less than 1 ms.
    pub fn settled(self) -> Self {
        let longest = self.longest.max(SLOW);
        Self { part: 1, shortest: longest, longest, before: Nanos::ZERO }
    }

    /// The pace that goes on where `other` ended.
    pub fn behind(self, other: Self) -> Self {
        Self { before: other.lasts(), ..self }
    }

    /// The shortest interval, with which it begins.
    pub const fn shortest(&self) -> Nanos {
        self.shortest
    }

    /// Whether clocks may be far from the reference at the beginning.
    pub fn begins_far(&self) -> bool {
        self.shortest < self.longest && self.before == Nanos::ZERO
    }

    /// The time until a loop knows its speed from the shortest intervals, and they may grow.
    pub fn learns(&self) -> Nanos {
        Nanos(self.part.saturating_mul(self.shortest.0))
    }

    /// The time until what is left to learn is little, and until a loop that sees a mean of
    /// differences has stopped to swing.
    pub fn settles(&self) -> Nanos {
        Nanos(self.learns().0 * 3 / 2)
    }

    /// The time in which a loop learns its speed but for a part of 1 / e. Its clock gains what it
    /// drifts in it.
    pub fn mean(&self) -> Nanos {
        Nanos(self.learns().0 / MEANS)
    }

    /// The interval when so much time has passed.
    pub fn at(&self, passed: Nanos) -> Nanos {
        Nanos((passed + self.before).0 / self.part).max(self.shortest).min(self.longest)
    }

    /// The pace that goes on growing as far as that of the `cycle`, when so much time has passed.
    pub fn stretched(self, passed: Nanos, cycle: Nanos) -> Self {
        let reached = Nanos((passed + self.before).0 / self.part).min(cycle);
        Self { longest: self.longest.max(reached), ..self }
    }

    /// The time until intervals grow no more, 0.5 s at most. With long cycles and deep filters it
    /// would be longer, and the intervals then stay shorter.
    pub fn lasts(&self) -> Nanos {
        let all = Nanos(self.part.saturating_mul(self.longest.0)).min(LONGEST);
        (all + -self.before).max(Nanos::ZERO)
    }
}

/// Number of means of a speed for which an interval stays the same. With two, clocks would move
/// twice as far before their loops know the speed.
const MEANS: i64 = 4;

/// The first interval. A clock 50 ppm off moves by 160 ns in the 64 intervals that its loop needs
/// to learn the speed. In shorter intervals the jitter of the host would be most of the time
/// between two frames, and a loop that divides by it would take each jump of the hops' jitter for a
/// speed.
const SHORTEST: Nanos = Nanos(50_000);

/// The shortest interval for clocks that do not come into step, so that they load the wire little.
const SLOW: Nanos = Nanos(1_000_000);

/// How far a clock may move when the cycle's own frames take over.
pub(super) const MOVED: Nanos = Nanos(20);

/// Noise of the ticks of two clocks behind the filter, with a reserve.
pub(super) const LEAST_NOISE: Nanos = Nanos(3);

/// Longest time in which intervals grow.
const LONGEST: Nanos = Nanos(512_000_000);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_grow_from_the_shortest_to_that_of_the_cycle() {
        let pace = Pace::new(Nanos::millis(1), 6, Nanos(20));
        let at = |us| pace.at(Nanos::micros(us));
        assert_eq!([at(0), at(12_800), at(25_600)], [50_000, 50_000, 100_000].map(Nanos));
        assert_eq!([at(255_999), at(256_000)], [999_996, 1_000_000].map(Nanos));
        assert_eq!(at(500_000), Nanos::millis(1));
        assert_eq!(pace.lasts(), Nanos::millis(256));
    }

    #[test]
    fn the_longest_interval_goes_by_noise() {
        let longest = |cycle: i64, noise| {
            Pace::new(Nanos::micros(cycle), 6, Nanos(noise)).at(Nanos::millis(60_000))
        };
        assert_eq!([longest(1_000, 0), longest(1_000, 3)], [Nanos::micros(150); 2]);
        assert_eq!(longest(1_000, 4), Nanos::micros(200));
        assert_eq!([longest(4_000, 20), longest(4_000, 21)], [Nanos::micros(4_000); 2]);
        assert_eq!(longest(10, 20), SHORTEST);
    }

    #[test]
    fn a_pace_can_be_stretched_as_far_as_the_time_passed() {
        let pace = Pace::new(Nanos::millis(1), 6, Nanos(3));
        let longest = |ms, cycle| {
            let stretched = pace.stretched(Nanos::millis(ms), Nanos::micros(cycle));
            stretched.at(Nanos::millis(60_000))
        };
        assert_eq!(longest(30, 1_000), Nanos::micros(150), "it is no shorter than it was");
        assert_eq!(longest(64, 1_000), Nanos::micros(250));
        assert_eq!([longest(256, 1_000), longest(999, 1_000)], [Nanos::micros(1_000); 2]);
        assert_eq!(longest(999, 100), Nanos::micros(150));
    }

    #[test]
    fn clocks_come_near_before_intervals_grow() {
        let pace = Pace::new(Nanos::millis(1), 6, Nanos(3));
        assert_eq!((pace.shortest(), pace.learns()), (SHORTEST, Nanos::micros(12_800)));
        assert_eq!(pace.at(pace.learns()), SHORTEST);
        assert_eq!((pace.mean(), pace.settles()), (Nanos::micros(3_200), Nanos::micros(19_200)));
        assert!(pace.begins_far());
        // Where intervals can't grow, or have grown, nothing is gained by it.
        assert!(!pace.settled().begins_far());
        assert!(!Pace::new(Nanos::millis(4), 6, Nanos(3)).behind(pace).begins_far());
        assert!(!Pace::new(Nanos::micros(10), 6, Nanos(3)).begins_far());
    }

    #[test]
    fn a_settled_pace_is_no_faster_than_1_ms() {
        let at = |cycle| Pace::new(Nanos::millis(cycle), 6, Nanos(20)).settled().at(Nanos::ZERO);
        assert_eq!([at(0), at(1), at(2)], [1, 1, 2].map(Nanos::millis));
    }

    #[test]
    fn deep_filters_end_it_early() {
        assert_eq!(Pace::new(Nanos::millis(1), 12, Nanos(20)).lasts(), LONGEST);
    }
}
