//! Adds true time to a status: SYNC errors as the judges of a simulation define them, recent ones
//! and those of the whole operation.
//!
//! The judges keep figures of the whole time in operation. An [`Onlooker`] gets the same events and
//! has a bench of its own, which it resets at the end of each interval: the figures of that bench
//! are the recent ones. It also takes the times of the events in one SubDevice's cycle, if asked
//! to.

use std::collections::VecDeque;

use isocat_sim::bench::{Bench, DeviceBench, Intent};
use isocat_sim::observation::{Observation, Observed};
use isocat_sim::{Segment, Statistics};
use isocat_wire::time::{Nanos, Time, True};

use super::main_device::larger;
use super::{Error, Margin, Moment, Status};
use crate::moment;

/// Observes the events of SubDevices.
pub struct Onlooker {
    bench: Bench,
    began: Time<True>,
    kept: VecDeque<Interval>,
    most: usize,
    /// The SubDevice whose events are timed, and the period of its process data.
    focus: Option<(usize, Nanos)>,
    seen: [Option<Phases>; EVENTS],
}

/// The results of the judges for a past interval.
struct Interval {
    began: Time<True>,
    /// By position: the largest SYNC error and the least margin, ns.
    devices: Vec<(Option<f64>, Option<f64>)>,
}

const EVENTS: usize = isocat_sync::Moment::ALL.len();

/// Times of an event within the cycle, ps: the first one, and the largest distances from it in both
/// directions.
#[derive(Clone, Copy)]
struct Phases {
    base: i128,
    least: i128,
    most: i128,
}

impl Onlooker {
    /// An observer of `devices` SubDevices; `recent` figures cover `intervals` past intervals and
    /// the present one.
    pub fn new(devices: usize, intervals: usize) -> Self {
        Self {
            bench: Bench::new(devices),
            began: Time::ZERO,
            kept: VecDeque::with_capacity(intervals + 1),
            most: intervals,
            focus: None,
            seen: [None; EVENTS],
        }
    }

    /// Begins the judging.
    pub fn begin(&mut self, at: Time<True>, intent: &Intent) {
        self.bench = Bench::new(self.bench.devices().len());
        self.bench.begin(intent.clone());
        self.kept.clear();
        self.began = at;
    }

    /// Sets the SubDevice whose events are timed, with their period.
    pub fn look_at(&mut self, focus: Option<(usize, Nanos)>) {
        if self.focus != focus {
            (self.focus, self.seen) = (focus, [None; EVENTS]);
        }
    }

    /// Begin of the present interval.
    pub fn began(&self) -> Time<True> {
        self.began
    }

    /// Takes an observation.
    pub fn observe(&mut self, segment: &Segment, observation: &Observation) {
        self.bench.observe(segment, observation);
        let Some((focus, cycle)) = self.focus.filter(|(at, _)| *at == observation.device) else {
            return;
        };
        let (Some(event), Some(intent)) = (compared(observation.event), self.bench.intent()) else {
            return;
        };
        let at = segment.devices()[focus].oscillator().when(observation.device_at);
        let reference = segment.devices()[intent.reference].system_time_ps(at);
        let cycle = i128::from(cycle.0.max(1)) * 1000;
        match &mut self.seen[event as usize] {
            Some(phases) => phases.take(reference, cycle),
            none => {
                let base = reference.rem_euclid(cycle);
                *none = Some(Phases { base, least: 0, most: 0 });
            }
        }
    }

    /// Ends the interval.
    pub fn turn(&mut self, at: Time<True>) {
        let Some(intent) = self.bench.intent().cloned() else { return };
        let devices = self.bench.devices().iter().map(of_late).collect();
        self.kept.push_back(Interval { began: self.began, devices });
        if self.kept.len() > self.most {
            self.kept.pop_front();
        }
        self.bench.begin(intent);
        self.began = at;
    }

    /// Adds true time to a status. `judges` have watched since operation began.
    pub fn over(&self, status: &mut Status, judges: &Bench) {
        if judges.intent().is_none() {
            return;
        }
        let since = self.kept.front().map_or(self.began, |interval| interval.began);
        status.since_ns = since.as_nanos() as i64;
        let host = judges.host_phase();
        status.host.phase_error_ns = host.and_then(|judge| judge.last()).map(|last| ns(last.0));
        let worst = host.map(|judge| judge.statistics()).filter(|all| all.count() > 0);
        status.host.phase_error_worst_ns = worst.map(|all| all.worst() as f64 / 1e3);
        for device in &mut status.devices {
            let position = device.position;
            let (Some(judges), Some(own)) =
                (judges.devices().get(position), self.bench.devices().get(position))
            else {
                continue;
            };
            let kept = self.kept.iter().filter_map(|interval| interval.devices.get(position));
            let (mut error, mut margin) = of_late(own);
            for (of_error, of_margin) in kept {
                error = larger(error, *of_error);
                margin = larger(margin.map(|m| -m), of_margin.map(|m| -m)).map(|m| -m);
            }
            device.error = judges.sync0.as_ref().and_then(|judge| {
                Some(Error {
                    now_ns: ns(judge.last()?.0),
                    recent_ns: error,
                    worst_ns: judge.statistics().worst() as f64 / 1e3,
                    count: judge.statistics().count(),
                })
            });
            let least = least(judges.margin.margin()).filter(|_| device.has_sync);
            device.margin =
                least.map(|least| Margin { now_ns: margin.unwrap_or(least), least_ns: least });
            if self.focus.is_some_and(|(focus, _)| focus == position) {
                self.fill(&mut device.moments);
            }
        }
    }

    fn fill(&self, moments: &mut [Moment]) {
        for moment in moments {
            let phases = self.seen[moment.event as usize];
            moment.seen_ns = phases.zip(self.focus).and_then(|(phases, (_, cycle))| {
                phases.near((moment.earliest_ns, moment.latest_ns), cycle)
            });
        }
    }
}

impl Phases {
    fn take(&mut self, reference: i128, cycle: i128) {
        let off = (reference - self.base + cycle / 2).rem_euclid(cycle) - cycle / 2;
        (self.least, self.most) = (self.least.min(off), self.most.max(off));
    }

    /// Earliest and latest time in ns, in the cycle in which they are nearest to the plan; `None`
    /// for an event that is spread over the whole cycle, as SYNC0 of subordinated cycles is.
    fn near(&self, (earliest, latest): (i64, i64), cycle: Nanos) -> Option<(f64, f64)> {
        let cycle = i128::from(cycle.0.max(1)) * 1000;
        if self.most - self.least > cycle / 4 {
            return None;
        }
        let planned = (i128::from(earliest) + i128::from(latest)) * 500;
        let middle = self.base + (self.least + self.most) / 2;
        let by = (planned - middle + cycle / 2).div_euclid(cycle) * cycle;
        let ns = |ps: i128| (self.base + ps + by) as f64 / 1e3;
        Some((ns(self.least), ns(self.most)))
    }
}

/// The largest SYNC error and the least margin that these judges saw, ns.
fn of_late(bench: &DeviceBench) -> (Option<f64>, Option<f64>) {
    let errors = bench.sync0.as_ref().map(|judge| judge.statistics());
    let error = errors.filter(|all| all.count() > 0).map(|all| all.worst() as f64 / 1e3);
    (error, least(bench.margin.margin()))
}

fn least(all: &Statistics) -> Option<f64> {
    (all.count() > 0).then(|| ns(all.least()))
}

fn ns(ps: i64) -> f64 {
    ps as f64 / 1e3
}

/// The moment of an event that is compared with the plan. A fetch of inputs is observed when its
/// frame has passed, but planned from the begin of the frame, so it is left out.
fn compared(event: Observed) -> Option<isocat_sync::Moment> {
    let moment = moment::of(event).filter(|moment| *moment != isocat_sync::Moment::Sm3)?;
    isocat_sync::Moment::PLANNED.contains(&moment).then_some(moment)
}
