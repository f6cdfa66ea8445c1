//! Why a SubDevice is not in sync and what to do about it: from the results of a run, compared with
//! the plan.
//!
//! Each cause is stated with the figures that show it. A cause that no figure shows is not stated:
//! then only the meaning of the AL status code is given. A remedy that is a line of the segment
//! file says where the line goes.

mod clock;
pub(crate) mod eeprom;
mod mode;
mod place;
mod segment;
mod text;

use isocat_descriptions::quantity::time;
use isocat_maindevice::segment::Timing;
use isocat_maindevice::{Cause, Segment, SegmentChange};
use isocat_segment::Scenario;
use isocat_sim::{Judged, Kind};
use isocat_sync::budget::{Check, Device, Sign, window};
use isocat_sync::explain::al_codes;
use isocat_sync::{Moment, SyncSignal};
use isocat_wire::AlStatusCode;
use isocat_wire::time::{Nanos, Picos};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Serialize;

use crate::recording::cycle::{CycleSeen, acting};
use crate::recording::{Recorded, RecordedDevice, Recording};
use crate::report::Finding;
use crate::{Report, watched};

/// A fault of one SubDevice or of the segment.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Diagnosis {
    /// The SubDevice; `None` for the segment.
    pub position: Option<usize>,
    /// Its name, or `the segment`.
    pub who: String,
    /// What is wrong, in one sentence with its figures.
    pub what: String,
    /// Why, as far as figures show it.
    pub causes: Vec<String>,
    /// What to do, the most certain first.
    pub remedies: Vec<String>,
}

impl Report {
    /// Looks for causes and remedies in what was recorded of this run ([`diagnose`]).
    pub fn explain(&mut self, recorded: &Recorded, segment: &Segment, limit: Nanos) {
        self.diagnoses = diagnose(self, recorded, segment, limit);
    }
}

/// Runs a scenario again with a recorder, for a run without a recording: the same seed gives the
/// same run. `progress` hears of it as in [`isocat_sim::Run::execute`].
pub fn record(
    scenario: &Scenario,
    progress: &mut dyn FnMut(isocat_sim::run::Progress),
) -> (Recorded, Segment) {
    let mut recording = Recording::of(scenario);
    let outcome = watched(scenario.run(), &mut recording, progress);
    let segment = outcome.world.main().segment().clone();
    drop(outcome);
    (recording.finish(), segment)
}

/// All faults; empty for a segment in sync. `limit` is the largest SYNC0 error that the judges
/// allowed.
pub fn diagnose(
    report: &Report,
    recorded: &Recorded,
    segment: &Segment,
    limit: Nanos,
) -> Vec<Diagnosis> {
    if report.in_sync {
        return Vec::new();
    }
    let mut all: Vec<Diagnosis> = Vec::new();
    for device in &report.devices {
        let position = device.position;
        let found = report.findings.iter().find(|finding| finding.position == Some(position));
        let none = RecordedDevice::default();
        let seen = recorded.devices.get(position).unwrap_or(&none);
        if found.is_none() && seen.missed_count == 0 {
            continue;
        }
        let mut case = Case {
            report,
            timing: segment.timing.as_ref(),
            device: segment.timing.as_ref().and_then(|t| t.devices.get(position)).map(|(d, _)| d),
            position,
            seen,
            leads: segment.reference == Some(position),
            host_leads: clock::host_leads(segment),
            limit: limit.into(),
            causes: Vec::new(),
            remedies: Vec::new(),
        };
        case.eeprom(segment);
        // What is seen of a SubDevice while no frame reaches it follows from that.
        if !case.lost() {
            case.silent_mailbox();
            case.ignored_type();
            case.lost_pulses();
            case.outputs();
            case.late();
            case.consequence();
            case.frames();
            case.clock();
        }
        case.code(device.registers.al_status_code);
        all.push(Diagnosis {
            position: Some(position),
            who: format!("SubDevice {position} ({})", device.name),
            what: found.map_or_else(
                || format!("{} SM events missed", seen.missed_count),
                |finding| finding.what.clone(),
            ),
            causes: case.causes,
            remedies: case.remedies,
        });
    }
    let of_segment = |finding| self::segment::of(finding, report, segment);
    all.extend(report.findings.iter().filter(|f| f.position.is_none()).map(of_segment));
    // Those with a cause first: the others may follow from them, and all from a silence.
    let silence = report
        .findings
        .first()
        .filter(|first| matches!(first.kind, Kind::Judged(Judged::NothingCameBack { .. })));
    let is_silence = |diagnosis: &Diagnosis| {
        diagnosis.position.is_none() && silence.is_some_and(|first| first.what == diagnosis.what)
    };
    all.sort_by_key(|diagnosis| (!is_silence(diagnosis), diagnosis.causes.is_empty()));
    all
}

/// One SubDevice under diagnosis.
struct Case<'a> {
    report: &'a Report,
    timing: Option<&'a Timing>,
    device: Option<&'a Device>,
    position: usize,
    seen: &'a RecordedDevice,
    leads: bool,
    /// Whether the host leads the reference clock (drive-reference).
    host_leads: bool,
    /// The largest SYNC0 error allowed.
    limit: Picos,
    causes: Vec<String>,
    remedies: Vec<String>,
}

impl Case<'_> {
    /// Whether frames no longer reached it; states that, and since when.
    fn lost(&mut self) -> bool {
        let lost = self.report.findings.iter().find(|finding| {
            let is_lost = matches!(finding.kind, Kind::Change(SegmentChange::Lost { .. }));
            is_lost && finding.position == Some(self.position)
        });
        let Some(lost) = lost else { return false };
        let since = lost.since_ns.map_or(String::new(), |ns| {
            let ms = ns / 1_000_000;
            format!(" from {}.{:03} s of the run on", ms / 1_000, ms % 1_000)
        });
        self.causes.push(format!(
            "No frame reached it{since}: a cable on the way to it was pulled or is broken, or it, or a SubDevice before it, had no power."
        ));
        self.remedies.push(
            "Check cable, connectors and power at the first SubDevice that was lost; recovery and optional in a segment file say whether \
             lost ones are taken up again (docs/changes.md)."
                .into(),
        );
        true
    }

    /// Looks for what its EEPROM lacks, where its way up failed.
    fn eeprom(&mut self, segment: &Segment) {
        let mut own = self.report.findings.iter().filter(|f| f.position == Some(self.position));
        let Some(cause) = own.find_map(|finding| eeprom::failure(&finding.kind)) else { return };
        if let Cause::Sii { problem, .. } = cause
            && let Some((why, remedies)) = eeprom::unread(*problem)
        {
            self.causes.push(why.to_owned());
            self.remedies.extend(remedies.iter().map(|remedy| (*remedy).to_owned()));
            return;
        }
        let Some(device) = segment.devices.get(self.position) else { return };
        if !eeprom::can_come_of_it(cause) {
            return;
        }
        for lack in eeprom::of(&device.sii) {
            self.causes.push(format!("Its EEPROM can't bring a device to OP: {lack}."));
            for remedy in lack.kind.remedies() {
                let remedy = format!("The EEPROM: {remedy}.");
                if !self.remedies.contains(&remedy) {
                    self.remedies.push(remedy);
                }
            }
        }
    }

    /// A line in its table of the segment file.
    fn in_device(&self, line: &str) -> String {
        place::device(self.report, &self.report.devices[self.position], line)
    }

    /// Looks for a mailbox that was silent when the device's mode was asked for.
    fn silent_mailbox(&mut self) {
        let mut own = self.report.findings.iter().filter(|f| f.position == Some(self.position));
        let silent =
            |finding: &Finding| matches!(finding.kind, Kind::Judged(Judged::ModeNotAsked { .. }));
        if !own.any(silent) {
            return;
        }
        self.causes.push(
            "Its program does not look into the mailbox any more (SM0 stays full) or gives no answer (SM1 stays empty), while it \
             goes on with process data."
                .into(),
        );
        self.remedies.extend([
            "Switch its power off and on: a mailbox that stalled in the device's program seldom comes back by itself.".to_owned(),
            "Ask its maker for a firmware that serves the mailbox, if it stalls again.".to_owned(),
            format!(
                "To go on without it, give it the mode that it has: {}; its objects are not read then either.",
                self.in_device("mode = \"free-run\"")
            ),
        ]);
    }

    /// Looks for SYNC pulses that made no edge.
    fn lost_pulses(&mut self) {
        let mut own = self.report.findings.iter().filter(|f| f.position == Some(self.position));
        let Some(acknowledged) = own.find_map(|finding| match finding.kind {
            Kind::Judged(Judged::SyncStillActive { acknowledged, .. }) => Some(acknowledged),
            _ => None,
        }) else {
            return;
        };
        let check = Check::Sync0FallsInCycle;
        let planned = self.timing.and_then(|timing| timing.demand(self.position, check));
        let is_short = planned.is_some_and(|planned| planned.slack() < Nanos::ZERO);
        let signal = self.device.map(|device| (device.sync_signal, device.pulses.sync0_cycle));
        match signal {
            Some((SyncSignal::Acknowledged(_), _)) if !is_short => self.causes.push(
                "A pulse was not acknowledged, though its program has the time for it: it did not notice the pulse. The signal stays \
                 active since, and no edge comes any more."
                    .into(),
            ),
            Some((SyncSignal::Acknowledged(after), cycle)) => self.causes.push(format!(
                "Its program acknowledges SYNC {after} behind the pulse, and later by its jitter: SYNC0 comes every {cycle}, and makes no \
                 edge while it is still active."
            )),
            Some((SyncSignal::Pulse(length), cycle)) => self.causes.push(format!(
                "Its pulses are {length} long, and SYNC0 comes every {cycle}: the signal does not fall between them."
            )),
            _ => {}
        }
        let shorter = self.in_device("pulse = \"10us\"");
        self.remedies.push(match (acknowledged, is_short) {
            (true, true) => format!(
                "Have its program read 0x098E (SYNC1: 0x098F) as soon as the interrupt comes, and not behind its work; or let \
                 pulses end by themselves (word 2 of its EEPROM, in 10 ns): {shorter}."
            ),
            (true, false) => "Switch its SYNC unit off and program it again (0x0981), or switch the device off and on; pulses that end by \
                              themselves (word 2 of its EEPROM) can't get stuck."
                .into(),
            (false, _) => {
                format!("Make the pulse shorter (word 2 of its EEPROM, in 10 ns): {shorter}.")
            }
        });
        self.causes.extend(self.short_line());
    }

    /// Looks for outputs that are not ready when their pulse comes.
    fn outputs(&mut self) {
        let (Some(timing), Some(device), Some(cycle)) =
            (self.timing, self.device, self.seen.cycle.as_ref())
        else {
            return;
        };
        let left = cycle.outputs_left;
        if left.count() == 0 || left.least() >= 0 {
            return;
        }
        let pulse = if acting(device) == Some(Moment::Sync1) { "SYNC1" } else { "SYNC0" };
        let late = -left.least() as f64 / 1e3;
        let how_often = match left.largest() < 0 {
            true => "in every cycle that was seen".to_owned(),
            false => "in some cycles".to_owned(),
        };
        self.causes.push(format!(
            "Outputs were ready up to {} after the {pulse} that wants them, {how_often}.",
            time(late)
        ));
        let stated = device.output_calc_and_copy;
        let took = cycle.outputs_took;
        let copied = took.largest() as f64 / 1e3;
        // A tick of its clock and what clocks may differ is no fault of its own.
        let beyond = |span: f64| Some(span).filter(|span| span - stated.0 as f64 > 100.0);
        let from_copy = beyond(copied).filter(|_| took.count() > 0);
        let since_event = || beyond(self.since_event(cycle, device, timing)?);
        if let Some(spent) = from_copy.or_else(since_event) {
            let over = spent - stated.0 as f64;
            self.causes.push(match from_copy {
                Some(_) => format!(
                    "Copying and calculating took up to {}, but 0x1C32:06 states {stated}: {} more than planned with.",
                    time(spent),
                    time(over)
                ),
                None => format!(
                    "Its frames were as punctual as planned. From its SM2 event until outputs were ready its program took {} on average, \
                     longer than 0x1C32:06 states ({stated}): {} more than planned with.",
                    time(spent),
                    time(over)
                ),
            });
            let true_time = Nanos(spent.ceil() as i64);
            // With the time that it really needs the plan asks for a later pulse.
            let line = timing.demand(self.position, Check::OutputsBeforeSync0).map(|d| d.line());
            let short = line.map_or(Nanos::ZERO, |line| Nanos(over.ceil() as i64) - line.slack());
            let also = match timing.sync0.filter(|_| short > Nanos::ZERO) {
                Some(shift) => {
                    let later = (shift + short).0.div_euclid(1_000) + 1;
                    let line = place::head(self.report, &format!("shift = \"{later}us\""));
                    format!(
                        "; and with it let the pulse come later, {line} (now {shift}), or no shift there, then the plan chooses one"
                    )
                }
                None => String::new(),
            };
            let states = self.in_device(&format!("calc_copy = \"{} ns\"", true_time.0));
            self.remedies.push(format!(
                "State the time that it really needs (0x1C32:06 = {} ns; its maker does): {states}{also}.",
                true_time.0
            ));
            self.remedies.push(format!(
                "Or make its program faster from the SM2 event until outputs are copied, by {} at least.",
                time(late)
            ));
        }
        self.later(cycle, device, timing, late);
        if let Some(short) = self.short_line().filter(|short| !self.causes.contains(short)) {
            self.causes.push(short);
            self.remedies.push(format!(
                "isocat plan{} --suggest tells the phase and the smallest cycle that fit.",
                place::argument(self.report)
            ));
        }
    }

    /// Time from the SM2 event until outputs are ready, on average and in ns, where frames were as
    /// punctual as the plan has them: then the program alone is what takes longer.
    fn since_event(&self, cycle: &CycleSeen, device: &Device, timing: &Timing) -> Option<f64> {
        let (stored, ready) = (cycle.of(Moment::Sm2)?, cycle.of(Moment::OutputsReady)?);
        let planned = timing.moments(self.position)?.of(Moment::Sm2)?;
        if stored.largest() as f64 / 1e3 > planned.latest.0 as f64 {
            return None;
        }
        // Phases lie around those of the plan, so that a late one may count as early.
        let whole = device.exchange(&timing.cycle).0.max(1) as f64;
        Some(((ready.mean() - stored.mean()) / 1e3).rem_euclid(whole))
    }

    /// Looks for outputs or inputs that miss their cycle though they come regularly.
    fn late(&mut self) {
        let device = &self.report.devices[self.position];
        let cycle = device.cycle_ns.unwrap_or(self.report.cycle_ns).max(self.report.cycle_ns);
        let of_device = |finding: &&crate::report::Finding| finding.position == Some(self.position);
        let kinds: Vec<_> =
            self.report.findings.iter().filter(of_device).map(|finding| &finding.kind).collect();
        let mut causes = Vec::new();
        for kind in kinds {
            match (kind, device.true_time.outputs_age, device.true_time.inputs_age) {
                (Kind::Judged(Judged::OutputsLate { .. }), Some(age), _) => causes.push(format!(
                    "Its outputs are {} old on average when they act, in a cycle of {}: their frame comes when the event that \
                     fetches them has passed, or when they can't be ready any more, and they wait for the next.",
                    time(age.mean_ns),
                    Nanos(cycle)
                )),
                (Kind::Judged(Judged::InputsLate { .. }), _, Some(age)) => causes.push(format!(
                    "Its inputs are {} old on average when they arrive, in a cycle of {}: they stand in the buffer when the frame \
                     that was to bring them has passed.",
                    time(age.mean_ns),
                    Nanos(cycle)
                )),
                _ => {}
            }
        }
        if causes.is_empty() {
            return;
        }
        self.causes.extend(causes);
        if let Some(short) = self.short_line().filter(|short| !self.causes.contains(short)) {
            self.causes.push(short);
            let file = place::argument(self.report);
            self.remedies.push(format!(
                "isocat plan{file} shows by how much: another phase (shift in the head), a shorter input_shift, another sync1 or a \
                 longer cycle makes room; isocat plan{file} --suggest tells the phase and the smallest cycle that fit."
            ));
        }
    }

    /// States the consequence.
    fn consequence(&mut self) {
        let device = &self.report.devices[self.position];
        let (missed, highest) =
            (device.true_time.missed_events, device.true_time.highest_missed_counter);
        if missed > 0 && device.registers.al_status.is_op() {
            self.causes.push(format!(
                "It stayed in OP all the same: its counter 0x1C32:0B, which goes down again between two misses, reached {highest}. At \
                 each of these {missed} pulses it acted on the outputs of the cycle before.",
            ));
        }
    }

    /// Suggests a later pulse: by how much, and whether the plan has the slack.
    fn later(&mut self, cycle: &CycleSeen, device: &Device, timing: &Timing, late: f64) {
        let Some(shift) = timing.sync0 else { return };
        // What the plan keeps free beside what was seen.
        let needed =
            Nanos(late.ceil() as i64) + timing.cycle.clock_error + timing.cycle.clock_error;
        let later = Nanos((shift + needed).0.div_euclid(1_000) * 1_000 + 1_000);
        let latest = window(&timing.cycle, device).latest;
        match latest {
            Some(latest) if later > latest => self.remedies.push(format!(
                "A later pulse alone does not help: the latest that its inputs allow is {latest}, needed are {later}. A longer cycle \
                 does."
            )),
            _ => {
                let line = format!("shift = \"{}us\"", later.0 / 1_000);
                let (line, or) =
                    (place::head(self.report, &line), if self.remedies.is_empty() { "P" } else { "Or p" });
                self.remedies.push(format!(
                    "{or}lace the pulse later: {line} (now {shift}). That covers what was seen here, and no more."
                ));
            }
        }
        let stored = timing.moments(self.position).and_then(|moments| moments.of(Moment::Sm2));
        if let (Some(stored), Some(seen)) = (stored, cycle.of(Moment::Sm2)) {
            let beyond = seen.largest() as f64 / 1e3 - stored.latest.0 as f64;
            if beyond > 0.0 {
                self.causes.push(format!(
                    "Frames came up to {} later than was planned with ([host] jitter {}).",
                    time(beyond),
                    timing.cycle.jitter
                ));
                let jitter = timing.cycle.jitter.0 + beyond.ceil() as i64;
                let line = format!("jitter = \"{}us\"", jitter.div_euclid(1_000) + 1);
                self.remedies.push(format!(
                    "Plan with what the host really does: {}, or more; isocat run --preflight tells what makes a real one late.",
                    place::host(self.report, &line)
                ));
            }
        }
    }

    /// A line of the plan that does not fit, if the plan was run nevertheless.
    fn short_line(&self) -> Option<String> {
        let lines = &self.report.devices[self.position].plan;
        let line =
            lines.iter().filter(|line| line.slack_ns < 0).min_by_key(|line| line.slack_ns)?;
        let slack = Nanos(line.slack_ns);
        Some(format!("The plan had said so: {}: {}: slack {slack}.", line.object, line.demand))
    }

    /// Looks for outputs that did not come at all.
    fn frames(&mut self) {
        if self.seen.missed_count == 0 || !self.causes.is_empty() {
            return;
        }
        let frames = |kind: &Kind| {
            matches!(
                kind,
                Kind::Judged(
                    Judged::NothingCameBack { .. }
                        | Judged::FramesLost { .. }
                        | Judged::AnswersLate { .. }
                        | Judged::CyclesSkipped { .. }
                )
            )
        };
        let mut of_segment =
            self.report.findings.iter().filter(|finding| finding.position.is_none());
        let lost = of_segment.find(|finding| frames(&finding.kind));
        match lost {
            Some(finding) => self.causes.push(format!(
                "It had no outputs to act on since frames did not come: {}.",
                finding.what
            )),
            None => self.causes.push(format!(
                "{} pulses found no outputs, though its program was not late: no frame with them came in time.",
                self.seen.missed_count
            )),
        }
        // The frames that a host did not send can't be looked at.
        if lost
            .is_some_and(|found| matches!(found.kind, Kind::Judged(Judged::CyclesSkipped { .. })))
        {
            self.remedies.extend(HOST_STOOD_STILL.map(str::to_owned));
            return;
        }
        self.remedies.push(format!(
            "See what became of the frames: isocat run{} --capture run.pcapng has a comment at each such instant.",
            place::argument(self.report)
        ));
    }

    /// States what its AL status code means.
    fn code(&mut self, code: u16) {
        if code == 0 {
            return;
        }
        let Some(entry) = al_codes::explain(AlStatusCode(code)) else { return };
        self.causes.push(format!("AL status code 0x{code:04X}: {}", entry.means));
        self.refusal_by_plan(AlStatusCode(code));
        if self.remedies.is_empty() {
            self.remedies.extend(entry.change.iter().map(|change| (*change).to_owned()));
        } else {
            self.remedies.push(format!("isocat explain 0x{code:04X} tells more of this code."));
        }
    }

    /// Looks for the line of the plan that predicts this refusal, and was run all the same.
    fn refusal_by_plan(&mut self, code: AlStatusCode) {
        let (Some(timing), Some(device)) = (self.timing, self.device) else { return };
        let demands = Check::OF_DEVICE.into_iter().filter_map(|c| timing.demand(self.position, c));
        let refused = Sign::Refusal(code);
        let mut short = demands.filter(|demand| !demand.line().fits());
        let Some(demand) = short.find(|demand| demand.sign(device.mode) == refused) else { return };
        let line = demand.line();
        let step = demand.step().map_or(String::new(), |step| format!("; its step is {step}"));
        self.causes.push(format!("The plan had said so: {line}{step}."));
        self.remedies.push(line.check.remedy().to_owned());
    }
}

/// What helps where the host came later than a whole cycle.
const HOST_STOOD_STILL: [&str; 2] = [
    "Make the host punctual, since no SubDevice is at fault: isocat run --preflight tells what on it harms punctuality, and a real-time \
     kernel with a core for the cyclic task alone keeps other work from holding it.",
    "Where the host can't be better: a longer cycle, and a watchdog that is longer than its pauses, if the machine allows it.",
];
