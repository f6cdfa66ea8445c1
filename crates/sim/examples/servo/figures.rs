//! The figures of races.

use isocat_wire::time::{Picos, Time};

use super::hosts::Course;
use super::laws::Entry;
use super::race::{self, LENGTH, LOCK, SETTLED, Track};

/// Figures of one race, ps.
#[derive(Clone, Copy)]
pub struct Figures {
    /// Time from the first deadline to the one after which none is off the target by [`LOCK`] or
    /// more, until the disturbance.
    pub lock: Option<i64>,
    /// The same for the law's own mean phase instead of the target.
    pub own_lock: Option<i64>,
    /// Mean phase error of the deadlines once settled.
    pub mean: f64,
    /// Largest distance of a deadline from that mean, once settled.
    pub worst: i64,
    /// Arrival of the earliest frame once settled, less the target.
    pub earliest: i64,
    /// Arrival of the latest.
    pub latest: i64,
    /// Time from the disturbance until no deadline is off the law's own mean by [`LOCK`] or more.
    /// `None`: there is no disturbance, or it was not within that before.
    pub recovery: Option<i64>,
}

impl Figures {
    /// Computes the figures of a race.
    pub fn of(track: &Track, course: &Course, own_phase: bool) -> Self {
        let end = Picos::from(LENGTH).0;
        let happens = course.disturbance.map(|at| (Time::ZERO + Picos::from(at) - track.begin).0);
        let quiet_end = happens.unwrap_or(end);
        let quiet = || track.points.iter().filter(|point| point.at.0 < quiet_end);
        // Phases are folded around the first of them, so that the phases of a law near half a cycle
        // from the target are not split by the fold.
        let first = quiet().find(|point| point.at >= SETTLED).map_or(0, |point| point.deadline);
        let around = |deadline: i64| first + fold(deadline - first);
        let settled: Vec<i64> = quiet()
            .filter(|point| point.at >= SETTLED)
            .map(|point| around(point.deadline))
            .collect();
        let mean = settled.iter().sum::<i64>() as f64 / settled.len().max(1) as f64;
        let own_error = |deadline: i64| fold(deadline - mean as i64);
        let worst = settled.iter().map(|error| (error - mean as i64).abs()).max().unwrap_or(0);
        let in_lock_since = |points: &mut dyn Iterator<Item = (i64, i64)>| {
            points
                .fold(0, |since, (at, error)| if error.abs() >= LOCK { at + CYCLE } else { since })
        };
        let target = |point: &race::Point| (point.at.0, point.deadline);
        let own = |point: &race::Point| (point.at.0, own_error(point.deadline));
        let stays = |since: i64, end: i64| (since + STAYS < end).then_some(since);
        let own_lock = stays(in_lock_since(&mut quiet().map(own)), quiet_end);
        let recovery = happens.filter(|_| own_lock.is_some()).and_then(|happens| {
            let after = track.points.iter().filter(|point| point.at.0 >= happens);
            stays(in_lock_since(&mut after.map(own)), end).map(|since| (since - happens).max(0))
        });
        let arrivals = track.points.iter().filter(|point| point.at >= SETTLED).map(|point| {
            let deadline = if own_phase { own_error(point.deadline) } else { point.deadline };
            deadline + point.late
        });
        let (earliest, latest) =
            arrivals.fold((i64::MAX, i64::MIN), |(least, most), at| (least.min(at), most.max(at)));
        Self {
            lock: stays(in_lock_since(&mut quiet().map(target)), quiet_end),
            own_lock,
            mean,
            worst,
            earliest,
            latest,
            recovery,
        }
    }
}

/// Times of all races, and the number of races that have one.
#[derive(Clone, Copy)]
pub struct Times {
    /// Median of the races that have one, ps.
    pub median: i64,
    /// The slowest, ps.
    pub worst: i64,
    /// Number of races that have one.
    pub reached: usize,
}

impl Times {
    fn of(times: impl Iterator<Item = Option<i64>>) -> Self {
        let mut reached: Vec<i64> = times.flatten().collect();
        reached.sort_unstable();
        let median = reached.get(reached.len() / 2).copied().unwrap_or(0);
        Self { median, worst: reached.last().copied().unwrap_or(0), reached: reached.len() }
    }
}

/// Figures of a law on a course, over all starts.
#[derive(Clone, Copy)]
pub struct Summary {
    /// [`Figures::lock`].
    pub lock: Times,
    /// [`Figures::own_lock`].
    pub own_lock: Times,
    /// Mean phase of all starts, ps.
    pub mean: f64,
    /// Difference of the largest and the least mean phase, ps.
    pub repeat: f64,
    /// [`Figures::worst`] of all, ps.
    pub worst: i64,
    /// The earliest frame of all, ps.
    pub earliest: i64,
    /// The latest frame of all, ps.
    pub latest: i64,
    /// [`Figures::recovery`].
    pub recovery: Times,
}

impl Summary {
    /// Races a law on a course from this number of starts.
    pub fn of(law: &Entry, course: &Course, starts: u64) -> Self {
        let race = |seed| Figures::of(&race::run(law, course, seed), course, law.own_phase);
        let all: Vec<Figures> = (0..starts).map(race).collect();
        let means = || all.iter().map(|figures| figures.mean);
        let (least, most) = means()
            .fold((f64::MAX, f64::MIN), |(least, most), mean| (least.min(mean), most.max(mean)));
        Self {
            lock: Times::of(all.iter().map(|figures| figures.lock)),
            own_lock: Times::of(all.iter().map(|figures| figures.own_lock)),
            mean: means().sum::<f64>() / starts.max(1) as f64,
            repeat: most - least,
            worst: all.iter().map(|figures| figures.worst).max().unwrap_or(0),
            earliest: all.iter().map(|figures| figures.earliest).min().unwrap_or(0),
            latest: all.iter().map(|figures| figures.latest).max().unwrap_or(0),
            recovery: Times::of(all.iter().map(|figures| figures.recovery)),
        }
    }
}

/// Folds an error into half a cycle.
fn fold(error: i64) -> i64 {
    (error + CYCLE / 2).rem_euclid(CYCLE) - CYCLE / 2
}

/// A lock that lasts less than this before the end does not count.
const STAYS: i64 = 200_000_000_000;
const CYCLE: i64 = race::GRID.cycle * 1_000;
