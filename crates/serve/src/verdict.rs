//! The judges' results for an exchange in operation, in the segment's own time.

use isocat_rules::{Breach, Claims, Evidence, Ruling};
use isocat_sim::bench::DeviceBench;
use isocat_sim::finding::{self, Finding, Place};
use isocat_sim::{Served, Statistics};
use isocat_sync::SyncMode;
use isocat_sync::object::{OUTPUT_PARAMETER, sub};
use isocat_wire::time::{Nanos, Picos, Time, True};
use isocat_wire::{AlState, AlStatus, AlStatusCode, ObjectAddress};

use crate::conduct::Conduct;
use crate::evidence;

/// What a stretch of operation is judged by.
#[derive(Clone, Copy)]
pub(crate) struct Case<'a> {
    /// The segment and its judges.
    pub served: &'a Served,
    /// What the MainDevice did.
    pub conduct: &'a Conduct,
    /// What it was meant to do.
    pub claims: &'a Claims,
}

/// A judged stretch of operation.
#[derive(Clone, Debug)]
pub struct Judged {
    /// The instant at which all SubDevices that were asked for were in OP.
    pub began: Time<True>,
    /// The instant at which it ended, or was evaluated.
    pub ended: Time<True>,
    /// Number of SubDevices in OP at the start.
    pub devices_in_op: usize,
    /// Every SubDevice, by position.
    pub devices: Vec<JudgedDevice>,
    /// Findings about the segment.
    pub findings: Vec<Finding>,
    /// The judgement by the rules, whose breaches are among the findings.
    pub ruling: Ruling,
    /// What the rules were judged by.
    pub evidence: Evidence,
}

/// The results of one SubDevice.
#[derive(Clone, Debug)]
pub struct JudgedDevice {
    /// Its state at the end.
    pub state: AlState,
    /// Its AL status code.
    pub code: AlStatusCode,
    /// Its synchronization mode.
    pub mode: SyncMode,
    /// Whether it was in OP when the judging began.
    pub took_part: bool,
    /// Distance of SYNC0 edges from the grid in its SYNC unit, ps; `None` without SYNC0.
    pub sync0_error: Option<Statistics>,
    /// Time from the end of copying and calculating to SYNC0, ps.
    pub margin: Statistics,
    /// Time from the SM2 event to SYNC0, ps.
    pub distance: Statistics,
    /// Age of outputs when they act, and of inputs when they are back at the MainDevice's port, ps.
    pub ages: [Statistics; 2],
    /// Number of SYNC0 edges while process data passed it.
    pub sync0_in_frame: u64,
    /// Counters of 0x1C32 in the stack: 0B, 0C, 0D, 20.
    pub counters: [u32; 4],
    /// The same counters when the judging began.
    pub counters_before: [u32; 4],
    /// Offset (0x0920) and delay (0x0928) of its clock when the judging began, ns.
    pub clock_before: [i64; 2],
    /// Whether it has process data of its own.
    pub has_process_data: bool,
    /// Whether it has outputs.
    pub has_outputs: bool,
    /// Its findings, each with the time from the start if it has one.
    pub findings: Vec<Finding>,
}

impl Judged {
    /// An empty judgement that begins at `at`.
    pub(crate) fn begin(served: &Served, at: Time<True>) -> Self {
        Self::new(served, (at, at), |position| {
            (counters(served, position), evidence::clock(&served.segment().devices()[position]))
        })
    }

    /// The same judgement as of `ended`.
    pub(crate) fn until(&self, case: Case<'_>, ended: Time<True>) -> Self {
        let before = |position: usize| {
            let JudgedDevice { counters_before, clock_before, .. } = &self.devices[position];
            (*counters_before, *clock_before)
        };
        let mut judged = Self::new(case.served, (self.began, ended), before);
        judged.hold_against(case);
        judged
    }

    /// Holds the stretch against what was meant.
    fn hold_against(&mut self, Case { served, conduct, claims }: Case<'_>) {
        let evidence = evidence::of(served, conduct, &self.devices, (self.began, self.ended));
        self.ruling = isocat_rules::judge(claims, &evidence);
        self.evidence = evidence;
        // A SubDevice that has left OP has a finding of its own, with its time.
        let left = |device: &JudgedDevice| {
            let left = |one: &Finding| {
                matches!(&one.kind, finding::Kind::Judged(finding::Judged::LeftOp { .. }))
            };
            device.findings.iter().any(left)
        };
        let has_left: Vec<bool> = self.devices.iter().map(left).collect();
        self.ruling.breached.retain(|breached| {
            let is_state = matches!(breached.breach, Breach::NotOperated { .. });
            !(is_state && breached.device.is_some_and(|device| has_left[device]))
        });
        for breached in self.ruling.breached.iter().rev() {
            let place = Place { device: breached.device, stage: None };
            let finding = Finding { place, since: None, kind: breached.breach.clone().into() };
            match breached.device {
                // What is otherwise than it was meant explains what came of it.
                Some(device) => self.devices[device].findings.insert(0, finding),
                None => self.findings.insert(0, finding),
            }
        }
    }

    fn new(
        served: &Served,
        (began, ended): (Time<True>, Time<True>),
        before: impl Fn(usize) -> ([u32; 4], [i64; 2]),
    ) -> Self {
        let devices: Vec<_> = (0..served.segment().devices().len())
            .map(|at| device(served, at, before(at), (began, ended)))
            .collect();
        let devices_in_op = devices.iter().filter(|device| device.took_part).count();
        let (findings, ruling) = (Vec::new(), Ruling::default());
        let evidence = Evidence::default();
        Self { began, ended, devices_in_op, devices, findings, ruling, evidence }
    }

    /// All findings: those about the segment, then those of the SubDevices by position.
    pub fn all_findings(&self) -> impl Iterator<Item = &Finding> {
        self.findings.iter().chain(self.devices.iter().flat_map(|device| &device.findings))
    }

    /// Whether there is no finding.
    pub fn in_sync(&self) -> bool {
        self.devices_in_op > 0 && self.all_findings().next().is_none()
    }
}

/// The present values of 0x1C32:0B, 0C, 0D and 20 in the stack.
fn counters(served: &Served, position: usize) -> [u32; 4] {
    let sync = served.segment().devices()[position].stack.sync();
    [
        sync.sm_event_missed().into(),
        sync.cycle_time_too_small().into(),
        sync.shift_time_too_short().into(),
        sync.sync_error().into(),
    ]
}

fn device(
    served: &Served,
    at: usize,
    (counters_before, clock_before): ([u32; 4], [i64; 2]),
    (began, ended): (Time<True>, Time<True>),
) -> JudgedDevice {
    let (device, bench) = (&served.segment().devices()[at], &served.bench().devices()[at]);
    let before = bench.states.iter().rfind(|change| change.at <= began);
    let took_part = before.is_some_and(|change| change.state == AlState::Op);
    let last = bench.states.iter().rfind(|change| change.at <= ended);
    let sync = device.stack.sync();
    let mut judged = JudgedDevice {
        state: last.map_or(AlState::Init, |change| change.state),
        code: last.map_or(AlStatusCode::NO_ERROR, |change| change.code),
        mode: sync.mode(),
        took_part,
        sync0_error: bench.sync0.as_ref().map(|judge| *judge.statistics()),
        margin: *bench.margin.margin(),
        distance: *bench.margin.distance(),
        ages: [*bench.outputs_cycle.age(), *bench.inputs_cycle.age()],
        sync0_in_frame: served.sync0_in_frame()[at],
        counters: counters(served, at),
        counters_before,
        clock_before,
        has_outputs: sync.has_outputs(),
        has_process_data: sync.has_outputs() || sync.has_inputs(),
        findings: Vec::new(),
    };
    if took_part {
        let lost = finding::Judged::sync_still_active(&bench.lost_pulses, &device.esc);
        let samples = device.sampling().map_or(0, |sampling| sampling.samples);
        judged.findings = findings(at, &judged, bench, (lost, samples), (began, ended));
    }
    judged
}

fn findings(
    position: usize,
    judged: &JudgedDevice,
    bench: &DeviceBench,
    (lost, samples): (Option<(Time<True>, finding::Judged)>, u16),
    (began, ended): (Time<True>, Time<True>),
) -> Vec<Finding> {
    let mut findings = Vec::new();
    let mut find = |at: Option<Time<True>>, kind: finding::Judged| {
        let since = at.map(|at| Nanos((at - began).0 / 1000));
        findings.push(Finding { place: Place::device(position), since, kind: kind.into() });
    };
    let within = |at: Time<True>| (began..=ended).contains(&at);
    if let Some(change) = bench.states.iter().find(|change| change.at > began && within(change.at))
    {
        let (state, code) = (AlStatus::new(change.state), change.code);
        find(Some(change.at), finding::Judged::LeftOp { state, code });
    }
    // A SubDevice that does not use SYNC0 may work at any time.
    let works_by_sync0 = judged.mode.uses_dc();
    if let Some(first) = bench.missed.first().filter(|at| within(*at)) {
        let (count, outputs) = (bench.missed.count(), judged.has_outputs);
        find(Some(first), finding::Judged::MissedEvents { count, outputs });
    }
    if let Some((at, kind)) = lost.filter(|(at, _)| within(*at)) {
        find(Some(at), kind);
    }
    if let Some(judge) = &bench.sync0 {
        if let Some((at, error)) = judge.first_beyond().filter(|(at, _)| within(*at)) {
            let (limit, worst) = (judge.limit(), Picos(judge.statistics().worst() as i64));
            find(Some(at), finding::Judged::Sync0OffGrid { error, limit, worst });
        } else if judge.statistics().count() == 0 && ended - began > FIRST_EDGES {
            find(None, finding::Judged::NoSync0);
        }
    }
    let uneven = bench.outputs_delay.first_beyond().filter(|at| works_by_sync0 && within(*at));
    if let Some(at) = uneven {
        let (spread, limit) = (bench.outputs_delay.spread(), bench.outputs_delay.limit());
        find(Some(at), finding::Judged::OutputsUneven { spread, limit });
    }
    let late = [
        finding::Judged::outputs_late(bench.outputs_cycle.late()),
        finding::Judged::inputs_late(bench.inputs_cycle.late()),
        finding::Judged::samples_incomplete(&bench.output_samples, true, samples),
        finding::Judged::samples_incomplete(&bench.input_samples, false, samples),
    ];
    for (at, kind) in late.into_iter().flatten().filter(|(at, _)| within(*at)) {
        find(Some(at), kind);
    }
    let object = |sub| ObjectAddress::new(OUTPUT_PARAMETER, sub);
    // Counts from before the judging belong to start-up. A counter that is smaller now was reset
    // meanwhile.
    let grown = |at: usize| {
        let (before, value) = (judged.counters_before[at], judged.counters[at]);
        let grew = value.checked_sub(before).unwrap_or(value);
        (grew > 0).then_some((Some(grew), value))
    };
    if let Some((grew, value)) = grown(1) {
        let object = object(sub::CYCLE_TIME_TOO_SMALL);
        find(None, finding::Judged::CycleTimeTooSmall { object, grew, value });
    }
    if let Some((grew, value)) = grown(2) {
        let object = object(sub::SHIFT_TIME_TOO_SHORT);
        find(None, finding::Judged::ShiftTimeTooShort { object, grew, value });
    }
    if let Some((grew, value)) = grown(3) {
        find(None, finding::Judged::SyncError { object: object(sub::SYNC_ERROR), grew, value });
    }
    findings
}

/// Time within which the first edges must come.
const FIRST_EDGES: Picos = Picos(2_000_000_000_000);
