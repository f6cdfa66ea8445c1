//! What is left of the clocks' phase when operation is reached, and how it goes. Clocks count as
//! converged while the drift loops still take off a rest.

use isocat_maindevice::{Segment, SubDevice};
use isocat_sync::settling::{self, FIRST, Mean};
use isocat_wire::time::Nanos;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Serialize;

/// The distances of clocks from the reference clock in operation, as means over several readings or
/// SYNC0 edges. Those of a clock count from its first one on, until it pauses or is not led.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Settling {
    /// Number of clocks that are followed, without the reference clock.
    pub clocks: usize,
    /// Of these, clocks with fewer than four readings or edges, or the first of them later than two
    /// seconds after operation; they are in no other figure.
    pub too_few: usize,
    /// The clock that was farthest from the reference at first: the mean of its first four readings
    /// or edges; null without any.
    pub first: Option<Distance>,
    /// The clock that was farthest at last: the mean of the last span of its readings or edges.
    /// Spans are about a third of the time before them, and there are at most 49152 readings or
    /// edges in all of them.
    pub last: Option<Distance>,
    /// Time from operation until the distance of the clock that was farthest at first had halved
    /// and stayed so, at most; null if it had not, or was 10 ns or less at first: a tick of a
    /// clock.
    pub halved_within_ns: Option<i64>,
}

/// The distance of a clock from the reference clock.
#[derive(Clone, Copy, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Distance {
    /// Position of the SubDevice.
    pub position: usize,
    /// Mean: positive if SYNC0 is late, or if 0x092C shows the clock ahead.
    pub mean_ns: f64,
    /// Time from operation to the last of its readings or edges.
    pub until_ns: i64,
}

/// A clock whose 0x092C was the largest.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Difference {
    /// Position of the SubDevice.
    pub position: usize,
    /// 0x092C: positive if its clock is ahead of the reference.
    pub difference_ns: i64,
}

impl Settling {
    /// Sums up the clocks, each with its position; `since` counts from operation. `None` without
    /// clocks.
    pub(crate) fn new<'a, T: Copy + 'a>(
        clocks: impl Iterator<Item = (usize, &'a settling::Settling<T>)>,
        since: impl Fn(T) -> Nanos,
    ) -> Option<Self> {
        let mut all =
            Self { clocks: 0, too_few: 0, first: None, last: None, halved_within_ns: None };
        let distance = |position, mean: Mean<T>| Distance {
            position,
            mean_ns: mean.difference.0 as f64 / 1e3,
            until_ns: since(mean.until).0,
        };
        for (position, clock) in clocks {
            all.clocks += 1;
            let is_early = clock.begin().is_some_and(|begin| since(begin) <= LATEST);
            let (Some(first), Some(last), true) = (clock.first(), clock.last(), is_early) else {
                all.too_few += 1;
                continue;
            };
            let (first, last) = (distance(position, first), distance(position, last));
            if first.is_worse_than(all.first) {
                all.first = Some(first);
                all.halved_within_ns = clock.halved().map(|at| since(at).0);
            }
            if last.is_worse_than(all.last) {
                all.last = Some(last);
            }
        }
        (all.clocks > 0).then_some(all)
    }

    /// The figures in words, each with a short name. `what` the means are of: edges, or readings.
    pub fn lines(&self, what: &str) -> Vec<(&'static str, String)> {
        let told = |Distance { position, mean_ns, until_ns }: Distance| {
            format!("{:.0} ns after {}, SubDevice {position}", mean_ns.abs(), span(until_ns))
        };
        let mut lines = Vec::new();
        if let Some(first) = self.first {
            let halved = match self.halved_within_ns {
                _ if first.mean_ns.abs() <= TICK_NS => "a clock's tick is 10 ns".to_owned(),
                Some(at) => format!("halved within {}", span(at)),
                None => "not halved".to_owned(),
            };
            lines.push(("clocks at OP, worst distance", format!("{}; {halved}", told(first))));
        }
        if let Some(last) = self.last.filter(|_| self.last != self.first) {
            lines.push(("clocks at last, worst distance", told(last)));
        }
        if self.too_few > 0 {
            let (few, all) = (self.too_few, self.clocks);
            let words = format!("{few} of {all}: fewer than {FIRST} {what} of each");
            lines.push(("clocks whose distance is not known", words));
        }
        lines
    }
}

impl Distance {
    fn is_worse_than(&self, other: Option<Self>) -> bool {
        other.is_none_or(|other| self.mean_ns.abs() > other.mean_ns.abs())
    }
}

impl Difference {
    /// The largest 0x092C of the last readings on the way up, or of those when a clock joined.
    pub(super) fn at_lock(segment: &Segment) -> Option<Self> {
        let is_led = |device: &&SubDevice| Some(device.position) != segment.reference;
        let followers = segment.devices.iter().filter(is_led);
        let shown = followers.filter_map(|device| {
            let difference_ns = device.difference?.0;
            Some(Self { position: device.position, difference_ns })
        });
        // Of equal ones the first.
        shown.reduce(|a, b| if b.difference_ns.abs() > a.difference_ns.abs() { b } else { a })
    }

    /// The figure in words.
    pub fn words(self) -> String {
        format!("worst {} ns (SubDevice {})", self.difference_ns.abs(), self.position)
    }
}

/// A time in ms, or in s from one second on.
fn span(ns: i64) -> String {
    match ns {
        1_000_000_000.. => format!("{:.1} s", ns as f64 / 1e9),
        100_000_000.. => format!("{:.0} ms", ns as f64 / 1e6),
        _ => format!("{:.1} ms", ns as f64 / 1e6),
    }
}

/// Latest first reading or edge of a clock that was there from operation on.
const LATEST: Nanos = Nanos(2_000_000_000);
/// A tick of a clock.
const TICK_NS: f64 = 10.0;

#[cfg(test)]
mod tests {
    use isocat_wire::time::{Host, Picos, Time};

    use super::*;

    /// Differences in ns, one a ms from `begin` ms after operation on.
    fn clock(begin: u64, differences: &[i64]) -> settling::Settling<Time<Host>> {
        let mut clock = settling::Settling::default();
        for (ms, ns) in (begin..).zip(differences) {
            clock.sample(Time::new(OPERATION + 1_000_000 * ms), Picos(1_000 * ns));
        }
        clock
    }

    fn sum_up(clocks: &[settling::Settling<Time<Host>>]) -> Settling {
        let clocks = clocks.iter().enumerate().map(|(at, clock)| (at + 1, clock));
        Settling::new(clocks, |at| at - Time::new(OPERATION)).expect("there are clocks")
    }

    const OPERATION: u64 = 5_000_000_000;

    #[test]
    fn the_worst_of_first_and_last_may_be_two_clocks() {
        let slow = clock(1, &[30, 30, 30, 30, 25, 25]);
        let fast = clock(1, &[-43, -43, -43, -43, -10, -10]);
        let all = sum_up(&[slow, fast]);
        assert_eq!((all.clocks, all.too_few), (2, 0));
        let distance = |position, mean_ns, until_ns| Some(Distance { position, mean_ns, until_ns });
        assert_eq!(all.first, distance(2, -43.0, 4_000_000));
        assert_eq!(all.last, distance(1, 25.0, 6_000_000));
        assert_eq!(all.halved_within_ns, Some(6_000_000));
        let lines = [
            (
                "clocks at OP, worst distance",
                "43 ns after 4.0 ms, SubDevice 2; halved within 6.0 ms",
            ),
            ("clocks at last, worst distance", "25 ns after 6.0 ms, SubDevice 1"),
        ];
        assert_eq!(all.lines("readings"), lines.map(|(what, figure)| (what, figure.to_owned())));
    }

    #[test]
    fn what_is_not_known_is_said() {
        let none = sum_up(&[clock(1, &[43; 3])]);
        assert_eq!((none.clocks, none.too_few, none.first), (1, 1, None));
        let words = |all: &Settling| -> Vec<String> {
            all.lines("readings").into_iter().map(|(_, words)| words).collect()
        };
        assert_eq!(words(&none), ["1 of 1: fewer than 4 readings of each"]);
        let some = sum_up(&[clock(1, &[43; 3]), clock(1, &[40; 4])]);
        let expected = [
            "40 ns after 4.0 ms, SubDevice 2; not halved",
            "1 of 2: fewer than 4 readings of each",
        ];
        assert_eq!(words(&some), expected);
        for (ns, end) in [(10, "; a clock's tick is 10 ns"), (-11, "; not halved")] {
            let words = words(&sum_up(&[clock(1, &[ns; 4])]));
            assert!(words.len() == 1 && words[0].ends_with(end), "{words:?}");
        }
        assert_eq!(Settling::new([].into_iter(), |at: Time<Host>| at - Time::ZERO), None);
    }

    #[test]
    fn a_clock_that_comes_later_is_left_out() {
        assert_eq!(sum_up(&[clock(2_000, &[43; 4])]).too_few, 0);
        assert_eq!(sum_up(&[clock(2_001, &[43; 4])]).too_few, 1);
    }

    #[test]
    fn times_in_ms_and_s() {
        let spans = [99_900_000, 100_000_000, 999_000_000, 1_000_000_000].map(span);
        assert_eq!(spans, ["99.9 ms", "100 ms", "999 ms", "1.0 s"]);
    }
}
