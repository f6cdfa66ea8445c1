//! The record of a service as one document, for users and for programs.

use isocat_engine::report::typed;
#[cfg(feature = "schema")]
use isocat_engine::report::typed::KindDocument;
use isocat_engine::report::words::{self, time};
use isocat_engine::report::{self, Span, Spread, span, spread};
use isocat_engine::verdict::Answer;
use isocat_rules::Breach;
use isocat_sim::expect::{Expectation, Judgement};
use isocat_sim::{Finding, Kind};

use isocat_sync::object::{OUTPUT_PARAMETER, sub};
use isocat_wire::coe::info::Access;
use isocat_wire::dc::SyncActivation;
use isocat_wire::time::{Nanos, Picos, Time, True};
use isocat_wire::{AlState, AlStatusCode, ObjectAddress};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Serialize;

use super::conduct::Conduct;
use super::deed::Deed;
use super::server::{End, Server, Session};
use super::verdict::{Judged, JudgedDevice};

/// Version of the document. It changes whenever a reader with an older schema could be misled.
pub const FORMAT: &str = "isocat-serve-summary/7";

/// JSON schema of the document, draft 2020-12.
#[cfg(feature = "schema")]
pub fn schema() -> serde_json::Value {
    isocat_descriptions::schema::of::<Summary>(FORMAT)
}

/// The whole document. All times are nanoseconds; points of time count from the start of the
/// service.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Summary {
    /// Version of the format: [`FORMAT`].
    pub format: &'static str,
    /// Version of the program.
    pub version: &'static str,
    /// Path of the segment file.
    pub segment_file: String,
    /// Name of the interface.
    pub interface: String,
    /// Duration of the service.
    pub served_ns: i64,
    /// Frames that came in.
    pub frames: u64,
    /// Frames that were answered.
    pub answered: u64,
    /// Frames lost in the segment, or by an injected fault.
    pub lost: u64,
    /// Answers held back because frames came faster than 100 Mbit/s.
    pub held: u64,
    /// The expectations of the segment file, and whether they were met; empty if it has none.
    pub expected: Vec<Expected>,
    /// Faults that were injected during the service; the newest ones if there were very many.
    pub faults: Vec<Injected>,
    /// Number of faults before these.
    pub faults_left_out: u64,
    /// What each MainDevice did, in order; the newest ones if there were very many.
    pub sessions: Vec<SessionSummary>,
    /// Number of sessions before these. Nothing else is known of them.
    pub sessions_left_out: u64,
    /// Something is otherwise than it was meant, and no expectation covers it.
    #[serde(skip)]
    breach_decides: bool,
}

/// An expectation of the segment file, judged in true time.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Expected {
    /// The key of the segment file.
    pub key: String,
    /// The expectation as a sentence.
    pub what: String,
    /// Whether it was met; null if it could not be judged.
    pub met: Option<bool>,
    /// The finding, or the reason why it was not judged, as a sentence.
    pub found: String,
}

/// The result of a service, by all its expectations.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Outcome {
    /// All expectations were met, or there were none.
    AsExpected,
    /// At least one expectation was not met.
    NotAsExpected,
    /// All judged expectations were met, but at least one could not be judged.
    NotJudged,
}

/// An injected fault.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Injected {
    /// The instant.
    pub at_ns: i64,
    /// The fault in words.
    pub what: String,
}

/// One MainDevice, from its first frame to its last.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct SessionSummary {
    /// Why nothing was judged, the first reason first; empty if something was.
    pub not_judged: Vec<String>,
    /// Instant of the first frame.
    pub began_ns: i64,
    /// Instant of the last frame.
    pub ended_ns: i64,
    /// Whether its frames stopped while SubDevices were still asked to be in SAFEOP or OP.
    pub abrupt: bool,
    /// Number of frames; in a ring those at the primary port.
    pub frames: u64,
    /// In a ring, number of frames at the secondary port: copies of the others, and frames by which
    /// the MainDevice tests the ring.
    pub second_port_frames: u64,
    /// Source addresses of its frames, most frames first. More than one means that there were
    /// several MainDevices.
    pub sources: Vec<String>,
    /// Its steps, in the order in which it first did them.
    pub steps: Vec<Step>,
    /// SubDevices that refused a state or left one by themselves.
    pub refused: Vec<Refusal>,
    /// Its cyclic exchange in operation; null if it never came that far.
    pub cycle: Option<Cycle>,
    /// Its omissions and errors, in words.
    pub remarks: Vec<String>,
    /// The result by true time: `in-sync`; `except`, with the findings in `judged`; `not-known`, if
    /// no SubDevice was in OP.
    pub answer: &'static str,
    /// The judges' results for the exchange in operation; null if no SubDevice was in OP.
    pub judged: Option<JudgedSummary>,
}

/// A step of a MainDevice.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Step {
    /// Time of the first occurrence, from the session's first frame.
    pub after_ns: i64,
    /// The step in words.
    pub what: String,
    /// Number of datagrams, or of SubDevices that reached a state.
    pub count: u64,
}

/// A SubDevice that did not reach a requested state, or left a state by itself.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Refusal {
    /// Time from the session's first frame.
    pub after_ns: i64,
    /// Position of the SubDevice.
    pub position: usize,
    /// Name of the SubDevice.
    pub device: String,
    /// Its present state.
    pub state: String,
    /// AL status code.
    pub code: u16,
    /// Meaning of the code.
    pub meaning: String,
}

/// The rhythm of the cyclic exchange, by the kernel's arrival stamps.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Cycle {
    /// Time from one cycle to the next.
    pub interval: Span,
    /// Phase at which cycles reached the reference clock within SYNC0's cycle, relative to the
    /// first; null without a reference.
    pub phase: Option<Span>,
    /// Number of drift datagrams in operation.
    pub drift_datagrams: u64,
    /// Longest time between two of them.
    pub longest_drift_gap_ns: i64,
}

/// The judges' results.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct JudgedSummary {
    /// Whether there is no finding, in this stretch of operation and in the earlier ones.
    pub in_sync: bool,
    /// Stretches of operation before this one. Each ended when a SubDevice was asked to leave OP,
    /// as one that has fallen is before it is brought back. The figures are those of the last
    /// stretch. If there were very many, only those that were not in sync are listed.
    pub earlier: Vec<Stretch>,
    /// Number of further earlier stretches.
    pub earlier_left_out: u64,
    /// How long SubDevices were judged in operation.
    pub judged_ns: i64,
    /// Number of SubDevices in OP.
    pub in_op: usize,
    /// Findings about the segment.
    pub findings: Vec<String>,
    /// The same for programs, in the same order.
    pub kinds: Vec<FindingKind>,
    /// What was checked of what the segment was meant to do.
    pub claims: ClaimsSummary,
    /// Each SubDevice.
    pub devices: Vec<DeviceSummary>,
}

/// What the rules checked of what the segment was meant to do.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct ClaimsSummary {
    /// Number of claims that were checked; those that do not hold are among the findings.
    pub checked: usize,
    /// Claims that could not be checked.
    pub not_checked: Vec<NotChecked>,
}

/// A claim that could not be checked.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct NotChecked {
    /// Position of the SubDevice; null if the claim is about the segment.
    pub position: Option<usize>,
    /// Name of the rule.
    pub rule: String,
    /// The evidence that is missing.
    pub needs: String,
}

/// A stretch of operation.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Stretch {
    /// How long the stretch was judged.
    pub judged_ns: i64,
    /// The findings, each with its SubDevice; empty if there are none.
    pub findings: Vec<String>,
    /// The findings for programs, in the same order.
    pub kinds: Vec<FindingKind>,
}

/// A finding for programs.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct FindingKind {
    /// Position of the SubDevice; null if it concerns the segment.
    pub position: Option<usize>,
    /// Instant since which it holds, from the start of the judged time; null if it has no time of
    /// its own.
    pub since_ns: Option<i64>,
    /// The kind.
    #[serde(flatten, serialize_with = "typed::kind")]
    #[cfg_attr(feature = "schema", schemars(with = "KindDocument"))]
    pub kind: Kind,
}

/// One SubDevice as the judges saw it, in the segment's own true time.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct DeviceSummary {
    /// Position in processing order, from 0.
    pub position: usize,
    /// Name in the segment file.
    pub name: String,
    /// State at the end of the judged time.
    pub state: String,
    /// Synchronization mode of its stack.
    pub mode: String,
    /// Distance of SYNC0 edges from the grid that the MainDevice wrote; null without SYNC0.
    pub sync0_error: Option<Spread>,
    /// Time from the end of copying and calculating to SYNC0.
    pub sync0_margin: Option<Span>,
    /// Age of outputs when they first act, counted from the first bit of the frame with them at the
    /// port of the MainDevice; null without outputs.
    pub outputs_age: Option<Span>,
    /// Age of inputs when they arrive, counted from Input Latch to the last bit, back at that port,
    /// of the first frame with them; null without inputs.
    pub inputs_age: Option<Span>,
    /// Number of SYNC0 edges while a frame with process data passed it.
    pub sync0_in_frame: u64,
    /// 0x1C32:0B.
    pub sm_event_missed: u32,
    /// 0x1C32:0C.
    pub cycle_time_too_small: u32,
    /// 0x1C32:0D.
    pub shift_time_too_short: u32,
    /// 0x1C32:20.
    pub sync_error: u32,
    /// 0x09A0, if SYNC0 is switched on; null otherwise.
    pub sync0_cycle_ns: Option<i64>,
    /// Whether its outputs, if it has some, are guarded by the process data watchdog; null:
    /// unknown.
    pub guarded: Option<bool>,
    /// The logical bits of its outputs, by its FMMUs: the first one, and the first one behind them.
    pub output_bits: Vec<[u64; 2]>,
    /// Those of its inputs.
    pub input_bits: Vec<[u64; 2]>,
    /// Its findings.
    pub findings: Vec<String>,
    /// Its findings for programs, in the same order.
    pub kinds: Vec<FindingKind>,
}

impl Summary {
    /// The summary of a service that has ended. Call [`Server::finish`] before.
    pub fn new(server: &Server, segment_file: &str, interface: &str, served: Nanos) -> Self {
        let counts = server.counts();
        let sessions = server.sessions().iter().chain(server.session());
        Self {
            format: FORMAT,
            version: env!("CARGO_PKG_VERSION"),
            segment_file: segment_file.to_owned(),
            interface: interface.to_owned(),
            served_ns: served.0,
            frames: counts.frames,
            answered: counts.answered,
            lost: counts.lost,
            held: counts.held,
            expected: expected(server),
            faults: server
                .faults()
                .map(|fault| Injected {
                    at_ns: fault.at.as_nanos() as i64,
                    what: fault.to_string(),
                })
                .collect(),
            faults_left_out: server.left_out().faults,
            sessions: sessions.map(|session| summarize(server, session)).collect(),
            sessions_left_out: server.left_out().sessions,
            breach_decides: breach_decides(server),
        }
    }

    /// The answer for all sessions: a finding in any of them, or else the answer of the last one.
    pub fn answer(&self) -> Answer {
        let answers = || self.sessions.iter().map(|session| answer(session.judged.as_ref()));
        match answers().any(|answer| answer == Answer::Except) {
            true => Answer::Except,
            false => answers().next_back().unwrap_or(Answer::NotKnown),
        }
    }

    /// The outcome by all expectations, and by what is otherwise than it was meant.
    pub fn outcome(&self) -> Outcome {
        let any = |met| self.expected.iter().any(|one| one.met == met);
        match (any(Some(false)) || self.breach_decides, any(None)) {
            (true, _) => Outcome::NotAsExpected,
            (false, true) => Outcome::NotJudged,
            (false, false) => Outcome::AsExpected,
        }
    }
}

/// Whether something is otherwise than it was meant, and no expectation covers it: there are some,
/// but none of a finding, and no fault was asked for.
fn breach_decides(server: &Server) -> bool {
    let covers = |judgement: &Judgement| {
        matches!(judgement.expectation, Expectation::InSync(_) | Expectation::Blames(_))
    };
    let judgements = server.judgements();
    if judgements.is_empty() || judgements.iter().any(covers) || server.faults().len() > 0 {
        return false;
    }
    let sessions = server.sessions().iter().chain(server.session());
    let stretches = sessions.flat_map(|session| session.earlier.iter().chain(&session.judged));
    let mut found = stretches.flat_map(Judged::all_findings);
    found.any(|finding| matches!(finding.kind, Kind::Breach(_)))
}

fn expected(server: &Server) -> Vec<Expected> {
    let zero = server.first_in_operation().unwrap_or(Time::ZERO);
    let name = |position: usize| match server.names().get(position) {
        Some(name) => format!("SubDevice {position} ({name})"),
        None => format!("SubDevice {position}"),
    };
    let expected = |judgement: &Judgement| {
        let report::Expected { key, what, met, found } =
            report::Expected::of(judgement, zero, name);
        Expected { key, what, met: judgement.is_judged().then_some(met), found }
    };
    server.judgements().iter().map(expected).collect()
}

fn summarize(server: &Server, session: &Session) -> SessionSummary {
    let conduct = &session.conduct;
    let after = |at: Time<True>| ns(at - conduct.began);
    let refused = session.refused.iter().map(|refused| Refusal {
        after_ns: after(refused.at),
        position: refused.device,
        device: server.names()[refused.device].clone(),
        state: refused.state.name().to_owned(),
        code: refused.code.0,
        meaning: refused.code.to_string(),
    });
    let judged = session.judged.as_ref().map(|judged| judged_summary(server, judged, session));
    let answer = answer(judged.as_ref());
    SessionSummary {
        not_judged: if judged.is_some() { Vec::new() } else { not_judged(server, session) },
        began_ns: ns(conduct.began - Time::ZERO),
        ended_ns: ns(conduct.last - Time::ZERO),
        abrupt: session.end == End::Abrupt,
        frames: conduct.frames,
        second_port_frames: conduct.second_port_frames,
        sources: conduct.sources().iter().map(|source| mac(source.address)).collect(),
        steps: steps(session),
        refused: refused.collect(),
        cycle: span(&conduct.cycle.intervals).map(|interval| Cycle {
            interval,
            phase: span(&conduct.cycle.phase),
            drift_datagrams: conduct.cycle.drift,
            longest_drift_gap_ns: ns(conduct.cycle.drift_gap),
        }),
        remarks: remarks(server, session),
        answer: answer.name(),
        judged,
    }
}

/// Why nothing was judged, nearest to the cause first.
fn not_judged(server: &Server, session: &Session) -> Vec<String> {
    let Some(attempt) = &session.attempt else {
        return vec![if session.conduct.done(Deed::RequestOp).is_some() {
            "frames stopped before all SubDevices that were asked for OP were there".into()
        } else {
            "no SubDevice was asked for OP".into()
        }];
    };
    let what = |breach: &Breach| words::what(&breach.clone().into(), words::Family::Served);
    let mut reasons = Vec::new();
    for (at, name) in server.names().iter().enumerate() {
        let of_device = attempt.breached.iter().filter(|breached| breached.device == Some(at));
        let breaches: Vec<_> = of_device.map(|breached| what(&breached.breach)).collect();
        // The last refusal is nearest to the end.
        let refused = session.refused.iter().rfind(|refused| refused.device == at);
        if attempt.states[at] == AlState::Op && breaches.is_empty() {
            continue;
        }
        let waits = refused.is_none() && breaches.is_empty();
        let refusal = refused.map_or(String::new(), |one| {
            let signals = match one.code {
                AlStatusCode::INVALID_DC_SYNC_CONFIGURATION => signals(attempt.activations[at]),
                _ => String::new(),
            };
            format!(" (AL status code {}{signals})", one.code)
        });
        let state = format!("was in {}{refusal}", attempt.states[at]);
        let parts: Vec<_> = std::iter::once(state).chain(breaches).collect();
        reasons.push((waits, format!("SubDevice {at} ({name}) {}", parts.join("; "))));
    }
    // What was refused or is wrong tells more than who only waited for it.
    reasons.sort_by_key(|(waits, _)| *waits);
    let mut reasons: Vec<String> = reasons.into_iter().map(|(_, reason)| reason).collect();
    let of_segment = attempt.breached.iter().filter(|breached| breached.device.is_none());
    reasons.extend(of_segment.map(|breached| what(&breached.breach)));
    if session.conduct.done(Deed::RequestOp).is_none() {
        reasons.insert(0, "no SubDevice was asked for OP".into());
    }
    reasons
}

/// Which SYNC signals are on, as the rest of a sentence.
fn signals(activation: SyncActivation) -> String {
    let on = |bit| activation.0 & SyncActivation::ACTIVE != 0 && activation.0 & bit != 0;
    let which = match (on(SyncActivation::SYNC0), on(SyncActivation::SYNC1)) {
        (true, true) => "SYNC0 and SYNC1 are on",
        (true, false) => "SYNC0 is on",
        (false, true) => "SYNC1 is on, SYNC0 is not",
        (false, false) => "no SYNC signal is on",
    };
    format!("; {which}, 0x0981 = {:#04x}", activation.0)
}

fn answer(judged: Option<&JudgedSummary>) -> Answer {
    match judged {
        None => Answer::NotKnown,
        Some(judged) if judged.in_sync => Answer::InSync,
        Some(_) => Answer::Except,
    }
}

fn steps(session: &Session) -> Vec<Step> {
    let began = session.conduct.began;
    let done = session.conduct.order().into_iter().map(|(deed, done)| Step {
        after_ns: ns(done.first - began),
        what: deed.words().to_owned(),
        count: done.count,
    });
    let states = [AlState::PreOp, AlState::SafeOp, AlState::Op];
    let reached = states.into_iter().zip(session.reached).filter_map(|(state, reached)| {
        let reached = reached?;
        let what = format!("the last SubDevice reached {state}");
        Some(Step { after_ns: ns(reached.last - began), what, count: reached.count })
    });
    let mut steps: Vec<_> = done.chain(reached).collect();
    // Counted from the beginning, so none is negative.
    steps.sort_by_cached_key(|step| step.after_ns.cast_unsigned());
    steps
}

/// The omissions and errors of a MainDevice.
fn remarks(server: &Server, session: &Session) -> Vec<String> {
    let conduct = &session.conduct;
    let mut remarks = Vec::new();
    let mut say = |remark: String| remarks.push(remark);
    let did = |deed| conduct.done(deed).is_some();
    if conduct.sync_verified() == Some(false) {
        say("SYNC was activated and never seen to run: neither 0x0984 nor 0x0990 was read afterwards".into());
    }
    let devices = server.served().segment().devices();
    let has_object = |device: &isocat_sim::device::Device| {
        device.stack.description().object(OUTPUT_PARAMETER).is_some()
    };
    let any_objects = devices.iter().any(has_object);
    // Who can't be told its mode is not told it.
    let sync_type = ObjectAddress::new(OUTPUT_PARAMETER, sub::SYNC_TYPE);
    let takes_type = |device: &isocat_sim::device::Device| {
        let entry = device.stack.description().entry(sync_type);
        entry.is_some_and(|entry| entry.access.has_any(Access::WRITE))
    };
    let any_type = devices.iter().any(takes_type);
    if did(Deed::SyncActivate) {
        let of_objects = |deed| matches!(deed, Deed::WriteSyncType | Deed::ReadSyncTimes);
        for (deed, what) in [
            (Deed::LatchTimes, "propagation delays were not measured (0x0900 never written)"),
            (Deed::Delays, "propagation delays were not written (0x0928)"),
            (Deed::Offsets, "system time offsets were not written (0x0920): clocks start apart"),
            (Deed::DistributeTime, "the reference time was never distributed: clocks run apart"),
            (
                Deed::WriteSyncType,
                "0x1C32:01 was not written: each SubDevice chose its mode itself",
            ),
            (
                Deed::ReadSyncTimes,
                "0x1C32:05 and :06 were not read, so the MainDevice cannot know whether the cycle fits",
            ),
            (
                Deed::ReadDifference,
                "0x092C was not read, so the MainDevice cannot know whether the clocks had converged",
            ),
        ] {
            let concerns_one = match deed {
                Deed::WriteSyncType => any_type,
                _ => any_objects || !of_objects(deed),
            };
            if !did(deed) && concerns_one {
                say(what.into());
            }
        }
    }
    if !session.refused.is_empty() && !did(Deed::ReadStatusCode) {
        say("SubDevices refused or fell, and no AL status code (0x0134) was read".into());
    }
    if did(Deed::WriteSii) {
        say("an SII EEPROM was written to".into());
    }
    cycle_remarks(conduct, session, &mut say);
    if let Some(judged) = &session.judged {
        judged_remarks(server, judged, &mut say);
    }
    if session.end == End::Abrupt {
        say("frames stopped while SubDevices were still asked to be in SAFEOP or OP: their watchdogs had to notice".into());
    }
    remarks
}

fn cycle_remarks(conduct: &Conduct, session: &Session, say: &mut impl FnMut(String)) {
    let Some(judged) = &session.judged else { return };
    let cycle = &conduct.cycle;
    let mean = cycle.intervals.mean();
    if cycle.intervals.count() < 10 {
        return;
    }
    let synchronized = judged.devices.iter().any(|device| device.sync0_error.is_some());
    let late = cycle.intervals.largest();
    if late as f64 > 1.5 * mean {
        say(format!(
            "its longest cycle took {}, {:.1} times the mean of {}",
            time(Picos(late)),
            late as f64 / mean,
            time(Picos(mean as i64)),
        ));
    }
    let spread = cycle.phase.largest() - cycle.phase.least();
    let wanders = cycle.phase.count() > 100 && spread as f64 > mean && synchronized;
    if wanders {
        say(format!(
            "its frames wander through the cycle, by {} in all: they do not follow the reference clock",
            time(Picos(spread)),
        ));
    }
}

fn judged_remarks(server: &Server, judged: &Judged, say: &mut impl FnMut(String)) {
    // A SubDevice that has fallen now has another mode, and one without process data has nothing to
    // synchronize.
    let devices = || judged.devices.iter().enumerate();
    let in_op = |device: &JudgedDevice| device.took_part && device.state == AlState::Op;
    let deaf: Vec<_> = devices()
        .filter(|(_, device)| in_op(device) && device.has_process_data)
        .filter(|(_, device)| device.sync0_error.is_some() && !device.mode.uses_dc())
        .collect();
    if let Some((at, first)) = deaf.first() {
        say(format!(
            "SYNC0 runs and means nothing to {}, first SubDevice {at} ({}), whose mode is {}: a SubDevice \
             chooses on the way to SAFEOP, by 0x1C32:01 and the SYNC unit as they are then",
            count(deaf.len()),
            server.names()[*at],
            first.mode.name(),
        ));
    }
    let clashes: Vec<_> =
        judged.devices.iter().enumerate().filter(|(_, d)| d.sync0_in_frame > 0).collect();
    if let Some((at, worst)) = clashes.iter().max_by_key(|(_, device)| device.sync0_in_frame) {
        say(format!(
            "SYNC0 came while a frame with process data passed, at {}; most often at SubDevice {at} ({}), {} of its edges",
            count(clashes.len()),
            server.names()[*at],
            worst.sync0_in_frame,
        ));
    }
}

fn judged_summary(server: &Server, judged: &Judged, session: &Session) -> JudgedSummary {
    let Session { earlier, earlier_left_out, .. } = session;
    let stretch = |judged: &Judged| Stretch {
        judged_ns: ns(judged.ended - judged.began),
        findings: judged
            .all_findings()
            .map(|what| match what.place.device {
                Some(at) => format!("SubDevice {at} ({}): {}", server.names()[at], finding(what)),
                None => finding(what),
            })
            .collect(),
        kinds: judged.all_findings().map(kind).collect(),
    };
    let evidence = |at: usize| judged.evidence.devices.get(at);
    let bits = |at: usize, direction: usize| {
        let logical = evidence(at).and_then(|seen| seen.logical.as_ref());
        let ranges = logical.into_iter().flat_map(|logical| &logical[direction]);
        ranges.map(|range| [range.start, range.end]).collect()
    };
    let device = |(position, device): (usize, &JudgedDevice)| DeviceSummary {
        position,
        name: server.names()[position].clone(),
        state: device.state.name().to_owned(),
        mode: device.mode.name().to_owned(),
        sync0_error: device.sync0_error.as_ref().and_then(spread),
        sync0_margin: span(&device.margin).filter(|_| device.mode.uses_dc()),
        outputs_age: span(&device.ages[0]),
        inputs_age: span(&device.ages[1]),
        sync0_in_frame: device.sync0_in_frame,
        sm_event_missed: device.counters[0],
        cycle_time_too_small: device.counters[1],
        shift_time_too_short: device.counters[2],
        sync_error: device.counters[3],
        sync0_cycle_ns: evidence(position).and_then(|seen| seen.sync0_cycle).map(|cycle| cycle.0),
        guarded: evidence(position).and_then(|seen| seen.guarded),
        output_bits: bits(position, 0),
        input_bits: bits(position, 1),
        findings: device.findings.iter().map(finding).collect(),
        kinds: device.findings.iter().map(kind).collect(),
    };
    let unchecked = judged.ruling.unchecked.iter().map(|one| NotChecked {
        position: one.device,
        rule: one.rule.to_owned(),
        needs: one.needs.to_owned(),
    });
    JudgedSummary {
        findings: judged.findings.iter().map(finding).collect(),
        kinds: judged.findings.iter().map(kind).collect(),
        claims: ClaimsSummary { checked: judged.ruling.checked, not_checked: unchecked.collect() },
        in_sync: judged.in_sync() && earlier.iter().all(Judged::in_sync),
        earlier: earlier.iter().map(stretch).collect(),
        earlier_left_out: *earlier_left_out,
        judged_ns: ns(judged.ended - judged.began),
        in_op: judged.devices_in_op,
        devices: judged.devices.iter().enumerate().map(device).collect(),
    }
}

fn finding(finding: &Finding) -> String {
    words::sentence(&finding.kind, finding.since, words::Family::Served)
}

/// The kind of a finding, with its figures.
fn kind(finding: &Finding) -> FindingKind {
    FindingKind {
        position: finding.place.device,
        since_ns: finding.since.map(|since| since.0),
        kind: finding.kind.clone(),
    }
}

/// The number of SubDevices in words.
fn count(devices: usize) -> String {
    match devices {
        1 => "1 SubDevice".to_owned(),
        more => format!("{more} SubDevices"),
    }
}

pub(super) fn mac(address: [u8; 6]) -> String {
    let [a, b, c, d, e, f] = address;
    format!("{a:02x}:{b:02x}:{c:02x}:{d:02x}:{e:02x}:{f:02x}")
}

fn ns(span: Picos) -> i64 {
    span.0 / 1000
}
