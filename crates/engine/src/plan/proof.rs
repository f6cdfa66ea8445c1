//! The proof: what happens in true time, compared with the plan.
//!
//! The segment runs with the phase of the plan and a host that is either in time or as late as the
//! plan allows. An observer takes the true time of each event, and of each distance that a line
//! concerns. It compares instants and uses no formula of the plan.

use std::cell::RefCell;
use std::rc::Rc;

use isocat_maindevice::segment::FramePlan;
use isocat_segment::Scenario;
use isocat_sim::observation::{Observation, Observed};
use isocat_sim::{HostModel, Segment, Tap};
use isocat_sync::budget::{Check, Moments, Span};
use isocat_sync::{Event, Moment, Step, SyncMode};
use isocat_wire::AlState;
use isocat_wire::time::{Nanos, Picos, Time, True};

use super::Plan;
use super::report::{Measured, PlanReport, ProofSummary, Seen};
use crate::{Report, moment, watched};

/// A bound is tight if the largest time that was needed, plus twice the clock error, is at least
/// the bound divided by this.
pub const FACTOR: f64 = 1.25;

/// The observations, and the report of the run.
#[derive(Clone, Debug)]
pub struct Proof {
    /// Worst cases by SubDevice; the last element holds those of the frames.
    watches: Vec<Watch>,
    /// The report of the run.
    pub run: Report,
}

/// Runs the segment for the scenario's duration with the phase of the plan.
pub fn prove(plan: &Plan, scenario: &Scenario) -> Proof {
    let scenario = as_planned(plan, scenario);
    let onlooker = Rc::new(RefCell::new(Onlooker::new(plan, scenario.duration)));
    let mut tap = Shared(onlooker.clone());
    let outcome = watched(scenario.run(), &mut tap, &mut |_| {});
    let run = Report::new(&scenario, &outcome);
    let watches = onlooker.borrow_mut().finish();
    Proof { watches, run }
}

/// The scenario with the phase of the plan, and with the worst host of the plan.
pub(super) fn as_planned(plan: &Plan, scenario: &Scenario) -> Scenario {
    let mut scenario = scenario.clone();
    scenario.host = HostModel { extremes: true, ..scenario.host };
    scenario.shift = plan.timing().sync0;
    scenario.force = true;
    scenario
}

impl Proof {
    /// The worst case of a line: least slack in ns, and the number of observations. Position `None`
    /// means the frames.
    pub fn slack(&self, position: Option<usize>, check: Check) -> Option<(f64, u64)> {
        let at = position.unwrap_or(self.watches.len() - 1);
        let worst = self.watches.get(at)?.slack[check as usize];
        (worst.count > 0).then(|| (worst.least as f64 / 1e3, worst.count))
    }

    /// Puts the observed values next to the planned ones.
    pub fn fill(&self, report: &mut PlanReport) {
        let clock = report.segment.clock_error_ns as f64;
        let (mut findings, mut loose) = (Vec::new(), 0);
        let mut compare = |place: String, at: Option<usize>, line: &mut super::report::Line| {
            let Some((slack, count)) = self.slack(at, line.check) else { return };
            if is_excess(-slack) {
                findings.push(format!("{place}: {}: too late by {:.3} ns", line.demand, -slack));
            }
            let needed = line.available_ns as f64 - slack;
            let of_bound = needed / (line.needed_ns as f64).max(1.0);
            line.measured =
                Some(Measured { count, needed_ns: round(needed), slack_ns: slack, of_bound });
            if is_excess(line.slack_ns as f64 - slack) {
                let planned = Nanos(line.slack_ns);
                findings.push(format!(
                    "{place}: {}: slack {slack:.3} ns in true time, planned {planned}",
                    line.demand
                ));
            }
            let tight = (needed + 2.0 * clock) * FACTOR >= line.needed_ns as f64;
            loose += usize::from(!tight);
        };
        compare("frames".into(), None, &mut report.frames_line);
        for device in &mut report.devices {
            let place = format!("SubDevice {} ({})", device.position, device.name);
            for line in &mut device.lines {
                compare(place.clone(), Some(device.position), line);
            }
        }
        for device in &mut report.devices {
            let place = format!("SubDevice {} ({})", device.position, device.name);
            for moment in &mut device.moments {
                let watch = &self.watches[device.position];
                let Some(seen) = watch.seen(moment.event) else { continue };
                moment.measured = Some(seen);
                let (earliest, latest) = (moment.earliest_ns, moment.latest_ns);
                let early = earliest as f64 - seen.earliest_ns;
                let late = seen.latest_ns - latest as f64;
                if is_excess(early) || is_excess(late) {
                    let Seen { earliest_ns, latest_ns, .. } = seen;
                    findings.push(format!(
                        "{place}: {} from {earliest_ns:.3} to {latest_ns:.3} ns in true time, planned {earliest} \
                         to {latest} ns",
                        moment.event
                    ));
                }
            }
        }
        findings.extend(self.run.findings.iter().map(|finding| finding.sentence()));
        report.proof = Some(ProofSummary {
            seed: self.run.seed,
            judged_ns: self.run.judged_ns,
            holds: report.fits && findings.is_empty() && self.run.in_sync,
            factor: FACTOR,
            loose,
            settling: self.run.segment.true_time.settling.clone(),
            findings,
        });
    }
}

/// The plan counts whole nanoseconds, and true time picoseconds: a value less than a nanosecond
/// beyond a bound is within it.
fn is_excess(beyond_ns: f64) -> bool {
    beyond_ns >= 1.0
}

fn round(ns: f64) -> f64 {
    (ns * 1e3).round() / 1e3
}

#[derive(Clone)]
struct Shared(Rc<RefCell<Onlooker>>);

impl Tap for Shared {
    fn frame(&mut self, at: Time<True>, sent: bool, bytes: &[u8]) {
        if sent {
            self.0.borrow_mut().frame(at, bytes);
        }
    }
    fn observed(&mut self, segment: &Segment, at: Time<True>, observation: &Observation) {
        self.0.borrow_mut().observed(segment, at, observation);
    }
}

/// Observes all events, and keeps the worst cases.
struct Onlooker {
    reference: Option<usize>,
    cycle: Picos,
    frames: Frames,
    watches: Vec<Watch>,
    waiting: usize,
    from: Option<Time<True>>,
    duration: Picos,
}

impl Onlooker {
    fn new(plan: &Plan, duration: Nanos) -> Self {
        let timing = plan.timing();
        let chunks = &plan.segment.image.chunks;
        let watches: Vec<Watch> = (0..timing.devices.len())
            .map(|position| {
                let device = &timing.devices[position].0;
                let moments = timing.moments(position).unwrap_or_default();
                let own = chunks.iter().position(|c| c.holds(&plan.segment.devices[position]));
                let sync0 = device.pulses.sync0_cycle;
                Watch {
                    mode: device.mode,
                    on_sync1: device.pulses.lead > Nanos::ZERO,
                    watchdog: device
                        .watchdog
                        .filter(|_| device.mode != SyncMode::FreeRun)
                        .map(Picos::from),
                    inputs_only: device.inputs_read.is_some() && device.outputs_arrival.is_none(),
                    by_timer: device.input_shift > Nanos::ZERO,
                    chunk: own.map(|chunk| chunks[chunk].logical),
                    expected: Moment::ALL.map(|moment| expected(&moments, moment)),
                    cycle: device.exchange(&timing.cycle).into(),
                    limits: [timing.cycle.limits.sync0_error, timing.cycle.limits.outputs_spread]
                        .map(Picos::from),
                    pulse_cycle: if device.mode.uses_dc() { sync0.into() } else { Picos::ZERO },
                    ..Watch::default()
                }
            })
            .collect();
        Self {
            reference: plan.segment.reference,
            cycle: timing.cycle.cycle.into(),
            frames: Frames {
                first: timing.frames.first().map(parts_planned).unwrap_or_default(),
                cycle: timing.cycle.cycle.into(),
                tolerance: timing.cycle.clock_error.into(),
                ..Frames::default()
            },
            waiting: watches.len(),
            watches,
            from: None,
            duration: duration.into(),
        }
    }

    /// The watches, and a last one with the worst cases of the frames.
    fn finish(&mut self) -> Vec<Watch> {
        let mut watches = std::mem::take(&mut self.watches);
        let mut frames = Watch::default();
        frames.slack[Check::FramesInCycle as usize] = self.frames.slack;
        watches.push(frames);
        watches
    }

    /// Whether an event belongs to the judged time. Later events are excluded, since counters are
    /// read then.
    fn is_on(&self, at: Time<True>) -> bool {
        let settled = Picos(SETTLING * self.cycle.0);
        let within = |from| at >= from && at < from + self.duration + -settled;
        self.from.is_some_and(within)
    }

    fn frame(&mut self, at: Time<True>, bytes: &[u8]) {
        let Ok(payload) = isocat_wire::frame::payload(bytes) else { return };
        let on_wire =
            bytes.len().max(isocat_wire::frame::MIN_LEN) + isocat_wire::frame::WIRE_OVERHEAD;
        let gap = 12;
        let byte = Picos(isocat_wire::frame::BYTE_TIME_NS as i64 * 1_000);
        let (until, whole) =
            (Picos(on_wire as i64 * byte.0), Picos((on_wire - gap) as i64 * byte.0));
        let mut parts = Vec::new();
        let mut cyclic = false;
        for datagram in isocat_wire::datagram::datagrams(payload).flatten() {
            parts.push((datagram.header.address, datagram.data.len()));
            let reads = match datagram.header.command() {
                Ok(command) if command.is_logical() => command != isocat_wire::Command::Lwr,
                _ => continue,
            };
            cyclic = true;
            let logical = datagram.header.address;
            for watch in self.watches.iter_mut().filter(|_| reads) {
                if watch.chunk == Some(logical) {
                    watch.frame = whole;
                }
            }
        }
        let on = self.is_on(at);
        let first = parts == self.frames.first;
        // Before process data run, cycles are shorter than planned.
        if cyclic || first {
            self.frames.passes(at, until, first, on);
        } else {
            self.frames.acyclic(at, until);
        }
    }

    fn observed(&mut self, segment: &Segment, at: Time<True>, observation: &Observation) {
        let Observation { device, event, .. } = *observation;
        if let Observed::State(AlState::Op, _) = event {
            self.waiting = self.waiting.saturating_sub(1);
            if self.waiting == 0 && self.from.is_none() {
                // A few cycles later every device has started all its activities.
                self.from = Some(at + Picos(SETTLING * self.cycle.0));
            }
        }
        let on = self.is_on(at);
        let watch = &mut self.watches[device];
        let reference = self.reference.map(|position| &segment.devices()[position]);
        // The plan's cycle is one of the reference clock, so spans are measured in that clock's
        // time, to the picosecond.
        let system = |clock: &isocat_sim::device::Device| clock.system_time_ps(at).max(0) as u64;
        watch.happens(reference.map_or(at, |clock| Time::new(system(clock))), event, on);
        let Some(reference) = reference.filter(|_| on) else { return };
        let Some(moment) = moment::of(event) else { return };
        // The begin of a frame is its end less its length.
        let length = if moment == Moment::Sm3 { watch.frame.0 as u64 } else { 0 };
        watch.note(moment, reference.system_time_ps(Time::new(at.count() - length)));
    }
}

/// Address and bytes of each datagram of a frame.
fn parts_planned(frame: &FramePlan) -> Vec<(u32, usize)> {
    frame.datagrams.iter().map(|part| (part.address.raw(), part.length)).collect()
}

fn expected(moments: &Moments, moment: Moment) -> Option<Picos> {
    let Span { earliest, latest } = moments.of(moment)?;
    Some(Picos((earliest.0 + latest.0) * 500))
}

/// The process data frames of the cycles.
#[derive(Default)]
struct Frames {
    /// Address and bytes of each datagram of the first frame of a cycle.
    first: Vec<(u32, usize)>,
    cycle: Picos,
    /// Cycles may differ by this much because clocks differ.
    tolerance: Picos,
    /// Departure of the first frame of the last cycle.
    began: Option<Time<True>>,
    /// Time when the port had sent the last frame of a cycle, and its gap.
    free: Option<Time<True>>,
    /// The same for all frames since that one.
    busy: Option<Time<True>>,
    slack: Least,
}

impl Frames {
    fn passes(&mut self, at: Time<True>, on_wire: Picos, first: bool, on: bool) {
        if first {
            if let Some(free) = self.free.filter(|_| on) {
                self.slack.take(at - free);
            }
            // Acyclic frames are sent whenever they fit, but not into the next cycle; that also
            // holds for the way up.
            let due = self.began.map(|began| began + self.cycle);
            if let (Some(due), Some(busy)) = (due, self.busy)
                && busy == at
                && at - due > self.tolerance
            {
                self.slack.take(due - busy);
            }
            self.began = Some(at);
        }
        self.busy = None;
        self.free = Some(at + on_wire);
    }

    fn acyclic(&mut self, at: Time<True>, on_wire: Picos) {
        self.busy = Some(at + on_wire);
    }
}

/// The least of a series, ps.
#[derive(Clone, Copy, Debug)]
struct Least {
    least: i64,
    count: u64,
}

impl Default for Least {
    fn default() -> Self {
        Self { least: i64::MAX, count: 0 }
    }
}

impl Least {
    fn take(&mut self, span: Picos) {
        self.least = self.least.min(span.0);
        self.count += 1;
    }
}

/// The observations of one SubDevice.
#[derive(Clone, Debug, Default)]
struct Watch {
    mode: SyncMode,
    /// Outputs act at SYNC1 although SYNC0 starts only the calculation.
    on_sync1: bool,
    /// How long its outputs stay valid without new ones.
    watchdog: Option<Picos>,
    /// It counts reads of its inputs, since it has no outputs.
    inputs_only: bool,
    /// A timer latches the inputs.
    by_timer: bool,
    /// Logical address of the datagram with its inputs.
    chunk: Option<u32>,
    /// Duration of the frame that fetches them.
    frame: Picos,
    /// Time from one exchange of its process data to the next.
    cycle: Picos,
    /// Time from SYNC0 to SYNC0.
    pulse_cycle: Picos,
    /// Limits of the SYNC0 error, and of the spread of outputs after their pulse.
    limits: [Picos; 2],
    /// Shortest and longest time from the pulse to Outputs Valid.
    acted_after: Option<(i64, i64)>,
    /// Expected middle of each event.
    expected: [Option<Picos>; Moment::ALL.len()],
    slack: [Least; CHECKS],
    phases: [Option<(i64, i64, u64)>; Moment::ALL.len()],

    sm2: Option<Time<True>>,
    /// The last SM2.
    stored: Option<Time<True>>,
    ready: Option<Time<True>>,
    /// A pulse that came while outputs were in work.
    overtaken: Option<Time<True>>,
    /// Time when its inputs were read, if no pulse has counted that yet.
    read: Option<Time<True>>,
    /// A pulse without a read to count.
    unread: Option<Time<True>>,
    sync0: Option<Time<True>>,
    sync1: Option<Time<True>>,
    /// Time when the last SYNC0 was acknowledged.
    acknowledged: Option<Time<True>>,
    /// A SYNC0 that was due before that.
    lost: Option<Time<True>>,
    began: [Option<Time<True>>; 5],
    mapped: Option<Time<True>>,
    /// Inputs were latched, or are due, and are not in the buffer yet.
    wanted: Option<Time<True>>,
    /// A frame that began before its inputs were in the buffer.
    unfed: Option<Time<True>>,
    last_end: Option<Time<True>>,
    /// Time in work since the last pulse; with several mappings of outputs, that of the last one.
    busy: Picos,
    mapping: Picos,
}

impl Watch {
    fn happens(&mut self, at: Time<True>, event: Observed, on: bool) {
        let dc = self.mode.uses_dc();
        match event {
            Observed::Sm2 => {
                if let (SyncMode::SmSynchronous, Some(end)) = (self.mode, self.last_end.take()) {
                    self.take(Check::MinimumCycle, at - end, on);
                }
                self.sm2 = Some(at);
                if let (Some(watchdog), Some(before)) = (self.watchdog, self.stored.replace(at)) {
                    self.take(Check::OutputsBeforeWatchdog, watchdog - (at - before), on);
                }
            }
            Observed::Began(step) => {
                self.began[step as usize] = Some(at);
                if step == Step::LatchInputs && dc {
                    self.wanted.get_or_insert(at);
                }
                if step == Step::OutputsValid && dc {
                    let pulse = if self.acts_on_sync1() { self.sync1 } else { self.sync0 };
                    if let Some(pulse) = pulse {
                        let left = self.pulse_cycle - (at - pulse);
                        self.take(Check::OutputsValidInCycle, left, on);
                        self.acts_after((at - pulse).0, on);
                    }
                }
            }
            Observed::Finished(step) => self.finished(at, step, on),
            Observed::Sync0 => {
                if let (Some(sync1), true) = (self.sync1, self.is_sync1_a_part()) {
                    self.take(Check::Sync1BeforeNextSync0, at - sync1 - NANOSECOND, on);
                }
                self.sync0 = Some(at);
                if let Some(acknowledged) = self.acknowledged.take() {
                    self.take(Check::Sync0FallsInCycle, at - acknowledged, on);
                }
                match self.mode {
                    SyncMode::DcSync1 => {
                        if let Some(sm2) = self.sm2.take() {
                            let left = self.as_planned(at - sm2);
                            self.take(Check::OutputsStoredBeforeSync0, left, on);
                        }
                    }
                    SyncMode::DcSync0 | SyncMode::DcShiftSync1 => {
                        self.outputs_wanted(at, Check::OutputsBeforeSync0, on);
                    }
                    _ => {}
                }
                if self.mode != SyncMode::DcSubordinated {
                    self.counts_read(at, Moment::Sync0, on);
                }
                if self.mode == SyncMode::DcSync0 {
                    self.wanted.get_or_insert(at);
                }
                if dc {
                    let busy = std::mem::take(&mut self.busy) + std::mem::take(&mut self.mapping);
                    self.take(Check::MinimumCycle, self.pulse_cycle - busy, on);
                }
            }
            Observed::StillActive(Event::Sync0) => self.lost = self.lost.or(Some(at)),
            Observed::Acknowledged(Event::Sync0) => match self.lost.take() {
                Some(pulse) => self.take(Check::Sync0FallsInCycle, pulse - at, on),
                None => self.acknowledged = Some(at),
            },
            Observed::Sync1 => {
                self.sync1 = Some(at);
                match self.mode {
                    SyncMode::DcSync1 => self.outputs_wanted(at, Check::Sync1CoversCopy, on),
                    SyncMode::DcSubordinated => {
                        self.outputs_wanted(at, Check::OutputsBeforeSync0, on);
                        self.counts_read(at, Moment::Sync1, on);
                    }
                    _ => {}
                }
            }
            Observed::Sm3 if dc || self.by_timer => {
                if self.inputs_only && dc {
                    match self.unread.take() {
                        // Later than half a cycle after a pulse, it is early for the next one.
                        Some(pulse) if (at - pulse).0 < self.cycle.0 / 2 => {
                            self.take(Check::InputsReadBeforeSync0, pulse - at, on);
                        }
                        _ => self.read = Some(at),
                    }
                }
                let begin = Time::new(at.count() - self.frame.0 as u64);
                match self.mapped {
                    // Inputs that are due only since the frame began are for the next one.
                    _ if self.wanted.is_some_and(|since| since <= begin) => {
                        self.unfed = Some(begin);
                        self.wanted = None;
                    }
                    Some(mapped) => self.take(Check::InputsBeforeFrame, begin - mapped, on),
                    None => {}
                }
                // The frame itself started the timer, whose inputs are for the next one.
                if !dc {
                    self.wanted = Some(at);
                }
            }
            _ => {}
        }
    }

    fn finished(&mut self, at: Time<True>, step: Step, on: bool) {
        match self.began[step as usize].take() {
            Some(began) if step == Step::MapOutputs => self.mapping = at - began,
            Some(began) => self.busy += at - began,
            None => {}
        }
        let of_inputs = matches!(step, Step::LatchInputs | Step::MapInputs);
        if !(of_inputs && self.by_timer) {
            self.last_end = Some(at);
        }
        match step {
            Step::MapOutputs => match self.overtaken.take() {
                Some(pulse) => {
                    let check = match self.mode {
                        SyncMode::DcSync1 => Check::Sync1CoversCopy,
                        _ => Check::OutputsBeforeSync0,
                    };
                    self.take(check, pulse - at, on);
                }
                None => self.ready = Some(at),
            },
            Step::MapInputs => {
                if let Some(begin) = self.unfed.take() {
                    self.take(Check::InputsBeforeFrame, begin - at, on);
                }
                self.mapped = Some(at);
                self.wanted = None;
            }
            _ => {}
        }
    }

    /// Outputs act this long after their pulse, ps.
    fn acts_after(&mut self, after: i64, on: bool) {
        if !on {
            return;
        }
        let (least, most) = self.acted_after.unwrap_or((after, after));
        let (least, most) = (least.min(after), most.max(after));
        self.acted_after = Some((least, most));
        let [_, limit] = self.limits;
        self.take(Check::OutputsSpreadWithinLimit, Picos(limit.0 - (most - least)), on);
    }

    /// A pulse that requires outputs to be ready.
    fn outputs_wanted(&mut self, at: Time<True>, check: Check, on: bool) {
        // In "DC SYNC1" the outputs wait for the SYNC0 that fetches them.
        let stored = if self.mode == SyncMode::DcSync1 { None } else { self.sm2.take() };
        match self.ready.take() {
            Some(ready) => self.take(check, at - ready, on),
            // A device that fetches its outputs at the pulse had them stored.
            None => match (stored, self.began[Step::MapOutputs as usize]) {
                (Some(sm2), None) => self.take(check, at - sm2, on),
                (_, Some(_)) => self.overtaken = Some(at),
                (None, None) => {}
            },
        }
    }

    /// A pulse that counts whether the inputs were read since the last one.
    fn counts_read(&mut self, at: Time<True>, pulse: Moment, on: bool) {
        if !self.inputs_only {
            return;
        }
        let Some(read) = self.read.take() else {
            self.unread = Some(at);
            return;
        };
        // The plan names the begin of the next cycle's frame; the end of this cycle's frame counts.
        let fetched =
            self.expected[Moment::Sm3 as usize].map(|begin| begin + self.frame - self.cycle);
        let left = self.of_its_cycle(at - read, fetched, self.expected[pulse as usize]);
        self.take(Check::InputsReadBeforeSync0, left, on);
    }

    /// A span from SM2 to the SYNC0 of the same cycle, which is the one nearest to its planned
    /// phase. If the frame is late, the next SYNC0 comes first.
    fn as_planned(&self, span: Picos) -> Picos {
        let expected = |moment: Moment| self.expected[moment as usize];
        self.of_its_cycle(span, expected(Moment::Sm2), expected(Moment::Sync0))
    }

    /// A span from an event of the frame to a pulse, less the whole cycles between this pulse and
    /// the one of the plan.
    fn of_its_cycle(&self, span: Picos, from: Option<Picos>, to: Option<Picos>) -> Picos {
        let (Some(from), Some(to)) = (from, to) else { return span };
        let (planned, cycle) = ((to - from).0, self.cycle.0.max(1));
        let cycles = (span.0 - planned + cycle / 2).div_euclid(cycle);
        Picos(span.0 - cycles * cycle)
    }

    fn acts_on_sync1(&self) -> bool {
        self.mode == SyncMode::DcSync1 || (self.mode == SyncMode::DcShiftSync1 && self.on_sync1)
    }

    fn is_sync1_a_part(&self) -> bool {
        matches!(self.mode, SyncMode::DcSync1 | SyncMode::DcShiftSync1)
    }

    fn take(&mut self, check: Check, slack: Picos, on: bool) {
        if on {
            self.slack[check as usize].take(slack);
        }
    }

    /// Notes an event at the reference clock's time `system_ps`.
    fn note(&mut self, moment: Moment, system_ps: i128) {
        let number = moment as usize;
        let Some(expected) = self.expected[number] else { return };
        // With subordinated cycles there are several SYNC0 in a cycle, and outputs act at each.
        let often = self.mode == SyncMode::DcSubordinated && moment.is_of_each_pulse();
        let cycle = i128::from(if often { self.pulse_cycle.0 } else { self.cycle.0 });
        let into = (system_ps - i128::from(expected.0)).rem_euclid(cycle);
        let error = if into > cycle / 2 { into - cycle } else { into } as i64;
        let phase = expected.0 + error;
        if moment == Moment::Sync0 {
            let [limit, _] = self.limits;
            self.take(Check::Sync0WithinLimit, Picos(limit.0 - error.abs()), true);
        }
        let (least, most, count) = self.phases[number].unwrap_or((phase, phase, 0));
        self.phases[number] = Some((least.min(phase), most.max(phase), count + 1));
    }

    fn seen(&self, moment: Moment) -> Option<Seen> {
        let (least, most, count) = self.phases[moment as usize]?;
        let ns = |ps: i64| ps as f64 / 1e3;
        Some(Seen { count, earliest_ns: ns(least), latest_ns: ns(most) })
    }
}

const CHECKS: usize = Check::OF_DEVICE.len() + 1;
const NANOSECOND: Picos = Picos(1_000);
/// Cycles from the last SubDevice's OP until the observer starts.
const SETTLING: i64 = 8;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_whole_nanosecond_is_an_excess_and_a_part_of_one_is_none() {
        assert!(!is_excess(-5.0) && !is_excess(0.0) && !is_excess(0.999));
        assert!(is_excess(1.0) && is_excess(1.001));
    }
}
