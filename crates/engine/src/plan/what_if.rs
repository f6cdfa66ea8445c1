//! Effects on a segment when one cable or the power of one SubDevice fails for a time.
//!
//! Nothing is computed: each case is a run of the segment in virtual time, like the proof's
//! ([`proof`](mod@super::proof)), with one fault. The cable that leads to a SubDevice is pulled, or
//! the SubDevice loses its power. After a time the fault ends, and the run goes on until all are in
//! sync again, or until nothing more changes. An observer and the course of the run
//! ([`isocat_sim::course`]) record the effects on each SubDevice, in true time.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::channel;

use isocat_maindevice::{Event, Motion, Recovery};
use isocat_segment::Scenario;
use isocat_segment::segment_file::Faults;
use isocat_sim::fault::{Fault, Moment, Planned, When};
use isocat_sim::run::intent;
use isocat_sim::{Course, World};
use isocat_wire::time::{Nanos, Picos, Time, True};

use super::{Plan, proof};

mod onlooker;
mod report;
mod text;

use onlooker::{Onlooker, Seen, Shared};
pub use report::{Case, Clocks, Fate, Gone, NotBack, Outcome, WhatIf};
pub use text::Row;

/// Settings of the trials.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Settings {
    /// Duration of the fault, up to [`LONGEST`].
    pub gone: Nanos,
    /// Positions of the SubDevices whose cable and power are tried, in this order.
    pub devices: Vec<usize>,
    /// Number of threads.
    pub threads: usize,
}

/// Default duration of the fault. It is longer than a usual watchdog of chips (100 ms) and than the
/// time until a link is up (300 ms).
pub const GONE: Nanos = Nanos::millis(500);
/// Longest duration of the fault: all of it, and of the time after it, is simulated.
pub const LONGEST: Nanos = Nanos::millis(60_000);
/// Time in operation before the fault: the drift loops settle.
const BEFORE: Nanos = Nanos::millis(100);
/// The case ends once all SubDevices have been in sync for this time. It is longer than a usual
/// watchdog of chips and than the time until a link is up.
const QUIET: Nanos = Nanos::millis(500);
/// The case ends if no SubDevice has changed its state for this time, not counting pauses of the
/// recovery.
const PATIENCE: Nanos = Nanos::millis(3_000);
/// Longest time that a case is followed.
const LIMIT: Nanos = Nanos::millis(60_000);
/// Least number of cycles in each of these spans.
const CYCLES: i64 = 20;
/// Interval of the check for the end.
const LOOK: Nanos = Nanos::millis(10);
/// Virtual time limit of the way up; each of its steps has a much shorter deadline.
const WAY_UP: Nanos = Nanos::millis(300_000);

/// Runs all cases: for each SubDevice its cable, then its power. `progress` gets the number of
/// finished cases. If the way up fails, it fails in all cases alike, and there are none.
pub fn what_if(
    plan: &Plan,
    scenario: &Scenario,
    settings: &Settings,
    progress: &mut dyn FnMut(usize),
) -> WhatIf {
    let scenario = quiet(proof::as_planned(plan, scenario));
    let cases: Vec<(Gone, usize)> =
        settings.devices.iter().flat_map(|at| [(Gone::Cable, *at), (Gone::Power, *at)]).collect();
    let next = AtomicUsize::new(0);
    let (sender, receiver) = channel();
    let mut done = BTreeMap::new();
    std::thread::scope(|scope| {
        for _ in 0..settings.threads.clamp(1, cases.len().max(1)) {
            let (sender, next, cases, scenario) = (sender.clone(), &next, &cases, &scenario);
            scope.spawn(move || {
                while let Some((what, device)) = cases.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let case = Trial::new(scenario, *what, *device, settings.gone).run();
                    if sender.send(((*device, *what), case)).is_err() {
                        break;
                    }
                }
            });
        }
        drop(sender);
        for (number, case) in &receiver {
            done.insert(number, case);
            progress(done.len());
        }
    });
    let in_order = cases.iter().filter_map(|(what, device)| done.remove(&(*device, *what)));
    let (cases, failure) = match in_order.collect::<Result<Vec<_>, _>>() {
        Ok(cases) => (cases, None),
        Err(failure) => (Vec::new(), Some(failure)),
    };
    WhatIf {
        seed: scenario.seed,
        gone_ns: settings.gone.0,
        before_ns: spans(&scenario, BEFORE).0,
        reference: plan.segment.reference,
        recovers: scenario.operation.recovery != Recovery::Never,
        names: scenario.devices.iter().map(|device| device.name.clone()).collect(),
        failure,
        cases,
    }
}

/// The scenario without faults and expectations.
fn quiet(scenario: Scenario) -> Scenario {
    Scenario { faults: Faults::default(), expectations: Vec::new(), ..scenario }
}

fn spans(scenario: &Scenario, time: Nanos) -> Nanos {
    time.max(Nanos(scenario.cycle.0.saturating_mul(CYCLES)))
}

/// One case in progress.
struct Trial<'a> {
    scenario: &'a Scenario,
    what: Gone,
    device: usize,
    gone: Nanos,
    world: World<Motion, Shared>,
    onlooker: Shared,
}

/// Instants of the begin and the end of the fault.
#[derive(Clone, Copy, Debug)]
struct Instants {
    gone: Time<True>,
    back: Time<True>,
}

impl<'a> Trial<'a> {
    fn new(scenario: &'a Scenario, what: Gone, device: usize, gone: Nanos) -> Self {
        let fault = match what {
            Gone::Cable => Fault::Pull { cable: device },
            Gone::Power => Fault::PowerOff { device },
        };
        let when = When::After(Moment::InOperation, spans(scenario, BEFORE));
        let planned = Planned { lasts: Some(gone), ..Planned::once(when, fault) };
        let mut setup = scenario.run().setup;
        setup.faults = vec![planned];
        let onlooker = Shared::new(Onlooker::new(scenario.devices.len()));
        let mut world = World::new(setup, Motion::default(), Some(onlooker.clone()));
        world.follow_course();
        Self { scenario, what, device, gone, world, onlooker }
    }

    fn run(mut self) -> Result<Case, String> {
        self.bring_up()?;
        self.world.catch_up();
        let intent = intent(self.world.main(), self.scenario.sync0_limit);
        self.world.begin_judging(intent);
        let gone = self.world.now() + Picos::from(spans(self.scenario, BEFORE));
        let instants = Instants { gone, back: gone + Picos::from(self.gone) };
        self.onlooker.watch_from(gone);
        self.follow(instants.back);
        self.world.end_judging();
        Ok(self.case(instants))
    }

    fn bring_up(&mut self) -> Result<(), String> {
        let limit = Time::ZERO + Picos::from(WAY_UP);
        loop {
            let more = self.world.step(limit);
            while let Some(event) = self.world.poll_event() {
                match event {
                    Event::InOperation { .. } => return Ok(()),
                    Event::Failed(error) => return Err(format!("the way up failed: {error}")),
                    _ => {}
                }
            }
            if !more {
                return Err(format!("the way up has not ended after {WAY_UP}"));
            }
        }
    }

    /// Runs until all have been in sync for long enough, or until nothing more changes.
    fn follow(&mut self, back: Time<True>) {
        let quiet = Picos::from(spans(self.scenario, QUIET));
        let patience = Picos::from(spans(self.scenario, PATIENCE) + self.longest_pause());
        let mut in_sync_since = None;
        let mut look = back;
        while look < back + Picos::from(LIMIT) {
            while self.world.step(look) {
                self.take_events();
            }
            self.take_events();
            let is_out = |course: &Course| course.out_of_sync_at(look).next().is_some();
            if self.world.course().is_some_and(is_out) || self.onlooker.is_one_given_up() {
                in_sync_since = None;
            } else if look - *in_sync_since.get_or_insert(look) >= quiet {
                break;
            }
            if look - self.onlooker.last_change().max(back) >= patience {
                break;
            }
            look += Picos::from(spans(self.scenario, LOOK));
        }
    }

    fn longest_pause(&self) -> Nanos {
        match self.scenario.operation.recovery {
            Recovery::BackOff { longest, .. } => longest,
            Recovery::Never | Recovery::Once => Nanos::ZERO,
        }
    }

    /// Drops events; the observer gets them when they are polled.
    fn take_events(&mut self) {
        while self.world.poll_event().is_some() {}
    }

    fn case(&self, instants: Instants) -> Case {
        let seen = self.onlooker.seen();
        let fates: Vec<Fate> = seen
            .devices
            .iter()
            .enumerate()
            .map(|(at, seen)| self.fate(at, seen, instants))
            .collect();
        let back = fates.iter().map(|fate| fate.in_sync_ns);
        let in_sync_ns =
            back.collect::<Option<Vec<i64>>>().map(|all| all.into_iter().max().unwrap_or(0));
        let (clocks, leads) = clocks(&seen, &fates);
        Case { what: self.what, device: self.device, clocks, leads, in_sync_ns, devices: fates }
    }

    fn fate(&self, position: usize, seen: &onlooker::Device, instants: Instants) -> Fate {
        let stretches = self.world.course().map_or(&[][..], Course::stretches);
        let of_device = || stretches.iter().filter(|stretch| stretch.device == position);
        let first = of_device().next();
        // A device's own clock counts whole ticks, so an event may seem to be slightly earlier.
        let tick = Picos::from(Nanos::micros(1));
        let is_cut_off = seen.lost.is_some() || seen.pause > self.missing(position);
        let outcome = match first {
            _ if !seen.takes_part => Outcome::Absent,
            Some(first) if first.from + tick < instants.gone => Outcome::NotBefore,
            _ if self.what == Gone::Power && position == self.device => Outcome::WithoutPower,
            _ if seen.left.is_some() => Outcome::LeftOp,
            _ if is_cut_off => Outcome::CutOff,
            Some(_) => Outcome::OutOfSync,
            None if !seen.exchanges => Outcome::Idle,
            None => Outcome::InSync,
        };
        let left = seen.left.filter(|_| outcome == Outcome::LeftOp);
        let sign = first.filter(|_| outcome == Outcome::OutOfSync).map(|sign| sign.from);
        let in_sync_ns = self.in_sync_again(position, seen, instants.back);
        let not_back = in_sync_ns.is_none().then(|| self.why_not_back(position, seen));
        Fate {
            position,
            outputs: seen.has_outputs,
            outcome,
            after_ns: left.map(|left| left.at).or(sign).map(|at| nanos(at - instants.gone)),
            state: left.map(|left| left.state),
            code: left.map(|left| left.code.0),
            held_ns: outcome.has_held().then(|| nanos(seen.held.unwrap_or(seen.pause))),
            made_safe: seen.held.is_some() && outcome == Outcome::CutOff,
            sync0_worst_ns: seen.sync0_worst.map(|error| error.0 as f64 / 1e3),
            in_sync_ns,
            not_back,
            why: seen.refused.clone().filter(|_| not_back.is_some()),
        }
    }

    /// Time from the end of the fault to the last sign that a SubDevice is not in sync; `None` if
    /// there are signs up to the end.
    fn in_sync_again(
        &self,
        position: usize,
        seen: &onlooker::Device,
        back: Time<True>,
    ) -> Option<i64> {
        let stretches = self.world.course().map_or(&[][..], Course::stretches);
        let of_device = || stretches.iter().filter(|stretch| stretch.device == position);
        let is_given_up = seen.lost.is_some_and(|(_, again)| again.is_none());
        if is_given_up || of_device().any(|stretch| stretch.open) {
            return None;
        }
        // A SubDevice that stays in OP shows no sign: it is back when frames are.
        let admitted = seen.lost.and_then(|(_, again)| again);
        let exchanged = seen.exchanged_again.filter(|_| seen.pause > self.missing(position));
        let signs = of_device().map(|stretch| stretch.to).max();
        let last = signs.or_else(|| admitted.into_iter().chain(exchanged).max());
        Some(last.map_or(0, |last| nanos(last - back).max(0)))
    }

    /// Shortest pause of the exchange that means missing frames, not late ones.
    fn missing(&self, position: usize) -> Picos {
        let every = self.world.bench.intent().and_then(|intent| *intent.exchange.get(position)?);
        let cycle = every.map_or(self.scenario.cycle, |grid| grid.cycle);
        Picos::from(Nanos(3 * cycle.0))
    }

    fn why_not_back(&self, position: usize, seen: &onlooker::Device) -> NotBack {
        let device = self.world.main().segment().devices.get(position);
        match seen.refused {
            Some(_) => NotBack::Refused,
            None if device.is_some_and(|device| !device.admitted) => NotBack::NotFound,
            None if self.scenario.operation.recovery == Recovery::Never => NotBack::RecoveryOff,
            None => NotBack::StillOut,
        }
    }
}

/// The effect on the clock that leads, and the position of the clock that leads in its place.
fn clocks(seen: &Seen, fates: &[Fate]) -> (Clocks, Option<usize>) {
    let Some(reference) = seen.reference else { return (Clocks::None, None) };
    let leads = seen.elected.filter(|elected| *elected != reference);
    let goes = fates.get(reference).is_some_and(|fate| !fate.outcome.is_calm());
    match leads {
        Some(_) => (Clocks::TakenOver, leads),
        None if goes => (Clocks::Lost, None),
        None => (Clocks::Lead, None),
    }
}

fn nanos(time: Picos) -> i64 {
    time.0 / 1_000
}
