//! The jitter of hops, as latches show it, and its effect on the instants of frames.
//!
//! A port takes a frame over at an edge of its own clock (40 ns for copper, 10 ns for EBUS), so the
//! time of a hop is a saw tooth that repeats as two crystals slip past each other. It is not
//! independent noise of each frame: between crystals 1 ppm apart a tooth lasts 40 ms, and frames
//! within it are late by the same time. Its height is measured here, and its pace is that of the
//! crystals. Its phase cannot be measured and is drawn at random.

use isocat_sim::random::Stream;
use isocat_wire::PortNumber;

use super::clocks::Fix;
use super::found::{Found, PortKind};
use super::hops::parents;

/// The jitter of the path from one clock to the next clock behind it.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Jitter {
    /// Position of the clock above.
    pub above: usize,
    /// Kind of the port at which frames come in, register 0x0007.
    pub port: PortKind,
    /// Standard deviation of a frame's time on the path, ns, and the standard error. `None`: the
    /// two crystals are so much alike that no tooth passed.
    pub deviation: Option<(f64, f64)>,
    /// Number of latches.
    pub latches: usize,
}

/// The jitter of the path to one clock: a saw tooth.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Saw {
    /// Height and period, ns, and the standard error.
    pub period: (f64, f64),
    /// Slip of the tooth, ns per ns, and the standard error.
    pub slip: (f64, f64),
}

/// A saw tooth with a phase.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Drawn {
    period: f64,
    slip: f64,
    phase: f64,
}

impl Saw {
    /// Draws a possible saw tooth.
    pub fn draw(&self, chance: &mut Stream) -> Drawn {
        Drawn {
            period: (self.period.0 + self.period.1 * normal(chance)).max(0.0),
            slip: self.slip.0 + self.slip.1 * normal(chance),
            phase: chance.up_to(PHASES) as f64 / PHASES as f64,
        }
    }

    /// Standard error of the mean over these instants, with an unknown phase.
    pub fn error_of_mean(&self, instants: &[i64]) -> f64 {
        let square: f64 = phases(*self)
            .map(|drawn| {
                let mean = drawn.mean(instants);
                mean * mean
            })
            .sum();
        (square / TRIED as f64).sqrt()
    }
}

impl Drawn {
    /// Lateness of a frame against the average, ns, at this time since any fixed instant.
    pub fn late(&self, since: f64) -> f64 {
        if self.period <= 0.0 {
            return 0.0;
        }
        let behind = (self.phase + self.slip * since / self.period).rem_euclid(1.0);
        self.period * (0.5 - behind)
    }

    /// The mean over these instants.
    pub fn mean(&self, instants: &[i64]) -> f64 {
        let sum: f64 = instants.iter().map(|at| self.late(*at as f64)).sum();
        sum / instants.len().max(1) as f64
    }
}

/// For each clock other than the reference, the clock above it: the next one on the way to the
/// first device, or the reference if that is in another branch. The clock is an index of followers;
/// `None` is the reference.
pub(super) fn above(found: &[Found], reference: usize, followers: &[usize]) -> Vec<Option<usize>> {
    let parents = parents(found);
    let up = |position: usize| parents.get(position).copied().flatten().map(|(above, _)| above);
    let next = |position: usize| {
        let mut at = up(position)?;
        while at != reference {
            if let Some(follower) = followers.iter().position(|follower| *follower == at) {
                return Some(follower);
            }
            at = up(at)?;
        }
        None
    };
    followers.iter().map(|position| next(*position)).collect()
}

/// The jitter of the hop to one follower, from latches. `slip` is how much faster its crystal runs
/// than that of the clock above.
pub(super) fn measure(
    fixes: &[&Fix],
    (follower, above): (usize, Option<usize>),
    slip: (f64, f64),
) -> (Option<(f64, f64)>, usize) {
    let latches: usize = fixes.iter().map(|fix| fix.latches.len()).sum();
    let slipped = slip.0.abs() - 2.0 * slip.1;
    let shortest = fixes.iter().map(|fix| fix.span()).fold(f64::INFINITY, f64::min);
    if slipped * shortest < LEAST_SLIP || latches == 0 {
        return (None, latches);
    }
    let variance = pooled(fixes.iter().map(|fix| {
        let rest = |number: usize| fix.apart(number, Some(follower)) - fix.apart(number, above);
        (0..fix.latches.len())
            .map(|number| (fix.latches[number].0 as f64, rest(number)))
            .collect::<Vec<_>>()
    }));
    // Receive times have ticks of 10 ns. If a port has edges of its own, they are at the same place
    // in each tick; if it has none, the figure contains the ticks of both clocks.
    let ticks: f64 = [Some(follower), above]
        .iter()
        .map(|clock| if on_edges(fixes, *clock) { 0.0 } else { TICK * TICK / 12.0 })
        .sum();
    let (least, most) = ((variance - ticks).max(0.0).sqrt(), variance.sqrt());
    let middle = f64::midpoint(least, most);
    let saw = Saw { period: (middle * SQRT_12, 0.0), slip };
    let (mean, spread) = shown(fixes, saw);
    let one = if mean > 0.0 { mean } else { 1.0 };
    // Within the limits that ticks leave the value may be anywhere.
    let error = (middle / one * spread).hypot((most - least) / 2.0).hypot(LEAST_ERROR);
    (Some((middle / one, error)), latches)
}

/// The apparent deviation of a saw tooth at these latches, as a share of the true one: mean and
/// standard deviation over its phases. If there are few teeth, they are not seen whole.
fn shown(fixes: &[&Fix], saw: Saw) -> (f64, f64) {
    if saw.period.0 <= 0.0 {
        return (1.0, 0.0);
    }
    let deviation = saw.period.0 / SQRT_12;
    let each: Vec<f64> = phases(saw)
        .map(|drawn| {
            let variance = pooled(fixes.iter().enumerate().map(|(number, fix)| {
                // The phases in several fixes are independent.
                let phase = (drawn.phase + number as f64 * GOLDEN).fract();
                let drawn = Drawn { phase, ..drawn };
                fix.latches
                    .iter()
                    .map(|(at, _)| (*at as f64, drawn.late((*at - fix.latches[0].0) as f64)))
                    .collect::<Vec<_>>()
            }));
            variance.sqrt() / deviation
        })
        .collect();
    let mean = each.iter().sum::<f64>() / TRIED as f64;
    let square: f64 = each.iter().map(|one| (one - mean) * (one - mean)).sum();
    (mean, (square / (TRIED - 1) as f64).sqrt())
}

/// The same tooth at evenly spread phases.
fn phases(saw: Saw) -> impl Iterator<Item = Drawn> {
    (0..TRIED).map(move |number| Drawn {
        period: saw.period.0,
        slip: saw.slip.0,
        phase: (number as f64 + 0.5) / TRIED as f64,
    })
}

/// Variance about a straight line through each of these series.
fn pooled(series: impl Iterator<Item = Vec<(f64, f64)>>) -> f64 {
    let (mut square, mut free) = (0.0, 0.0);
    for points in series {
        let line = super::clocks::Line::through(&points);
        square += points.iter().map(|(x, y)| (y - line.at(*x)).powi(2)).sum::<f64>();
        free += points.len() as f64 - 2.0;
    }
    if free > 0.0 { square / free } else { 0.0 }
}

/// Whether a clock's receive times are at one place of 40 ns, as those of a copper port with edges
/// of its own are. `None`: the reference.
fn on_edges(fixes: &[&Fix], clock: Option<usize>) -> bool {
    fixes.iter().all(|fix| {
        let turn = |number: usize| {
            let time = fix.latches[number].0 as f64 + fix.apart(number, clock);
            std::f64::consts::TAU * (time.rem_euclid(COPPER) / COPPER)
        };
        let count = fix.latches.len();
        let (cos, sin) = (0..count).map(turn).fold((0.0, 0.0), |(cos, sin), turn| {
            let (s, c) = turn.sin_cos();
            (cos + c, sin + s)
        });
        cos.hypot(sin) > 0.9 * count as f64
    })
}

/// Height and period of the saw tooth on a path, ns, and the standard error.
pub(super) fn period(jitter: &Jitter) -> (f64, f64) {
    match (jitter.port, jitter.deviation) {
        // The edges of such a port are as far apart as the ticks that hide them, so the measurement
        // would give less than the real value.
        (PortKind::Ebus, _) => (TICK, TICK / 4.0),
        (_, Some((value, error))) => (value * SQRT_12, error * SQRT_12),
        // No edge passed: the value may be anything up to that of copper.
        (_, None) => (COPPER / 2.0, COPPER / 4.0),
    }
}

/// The port at which frames come in.
pub(super) fn entry(found: &Found) -> PortKind {
    found.ports[PortNumber::P0.index()]
}

/// Close to a normal deviate: the sum of twelve uniform numbers.
pub(super) fn normal(chance: &mut Stream) -> f64 {
    let sum: u64 = (0..12).map(|_| chance.up_to(PHASES)).sum();
    sum as f64 / PHASES as f64 - 6.0
}

/// Height of a uniform saw tooth, in its standard deviations.
const SQRT_12: f64 = 3.464_101_615_137_754_6;
/// Steps of what is drawn.
const PHASES: u64 = 1 << 24;
/// Number of phases that are tried.
const TRIED: usize = 64;
/// Its multiples are spread evenly over a turn.
const GOLDEN: f64 = 0.618_033_988_749_895;
/// Fewer than one and a half teeth of copper within a fix show no height, ns.
const LEAST_SLIP: f64 = 60.0;
/// Tick of receive times, ns.
const TICK: f64 = 10.0;
/// The nibble clock of copper, ns.
const COPPER: f64 = 40.0;
/// The dividers of both clocks add or skip 1 ns now and then, and ticks are as coarse as the teeth
/// are.
const LEAST_ERROR: f64 = 0.2;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tooth_goes_round_and_has_no_mean() {
        let saw = Saw { period: (40.0, 0.0), slip: (10e-6, 0.0) };
        let drawn = Drawn { period: 40.0, slip: 10e-6, phase: 0.0 };
        for (since, late) in [(0.0, 20.0), (1e6, 10.0), (3.9e6, -19.0), (4e6, 20.0)] {
            assert!((drawn.late(since) - late).abs() < 1e-6, "{since}: {}", drawn.late(since));
        }
        // One instant has the whole deviation. A whole tooth has none.
        assert!((saw.error_of_mean(&[5]) - 40.0 / SQRT_12).abs() < 0.01);
        let whole: Vec<i64> = (0..400).map(|number| number * 10_000).collect();
        assert!(saw.error_of_mean(&whole) < 0.1);
        // Half a tooth has a quarter of the height either way.
        assert!((saw.error_of_mean(&whole[..200]) - 20.0 / SQRT_12).abs() < 1.0);
    }

    /// A staircase that is all jitter, measured at both sides of the least slip.
    #[test]
    fn a_staircase_has_the_deviation_of_its_tooth() {
        for (slip, told) in [(5e-6, true), (0.55e-6, true), (0.45e-6, false), (-3e-6, true)] {
            let saw = Drawn { period: 40.0, slip, phase: 0.3 };
            let latches: Vec<(i64, Vec<i32>)> = (0..128i64)
                .map(|number| {
                    let at = number * 960_000 + (number * 617 % 997) * 40;
                    let apart = slip * at as f64 + saw.late(at as f64);
                    (at, vec![(apart / 40.0).round() as i32 * 40])
                })
                .collect();
            let fix = Fix { at: 0.0, spots: Vec::new(), latches };
            let (deviation, count) = measure(&[&fix], (0, None), (slip, 0.0));
            assert_eq!(count, 128);
            assert_eq!(deviation.is_some(), told, "{slip}");
            if let Some((value, error)) = deviation {
                assert!((value - 40.0 / SQRT_12).abs() < 3.0 * error, "{slip}: {value} {error}");
                assert!((0.1..2.5).contains(&error), "{slip}: {error}");
            }
        }
    }
}
