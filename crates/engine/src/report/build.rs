//! Builds the report from the outcome of a run.

use isocat_maindevice::SubDevice;
use isocat_maindevice::motion::{Axis, Drive};
use isocat_maindevice::statistics::Summary;
use isocat_segment::Scenario;
use isocat_segment::segment_file::Clock;
use isocat_sim::bench::DeviceBench;
use isocat_sim::sampling::{Channel, Sampling};
use isocat_sim::{Judged, Outcome, Place, Statistics, Tap, run};
use isocat_sync::SyncMode;
use isocat_sync::delay::Delay;
use isocat_wire::time::{Nanos, Picos};

use super::expected;
use super::samples::Samples;
use super::times::MeasuredTimes;
use super::words::Family;
use super::*;

impl Report {
    /// Reports on a run of `scenario`.
    pub fn new<T: Tap>(scenario: &Scenario, outcome: &Outcome<T>) -> Self {
        let devices: Vec<Device> = (0..scenario.devices.len())
            .map(|position| device(scenario, outcome, position))
            .collect();
        let findings = findings(scenario, outcome);
        Self {
            format: FORMAT,
            version: env!("CARGO_PKG_VERSION"),
            segment_file: scenario.source.clone(),
            seed: scenario.seed,
            in_sync: outcome.in_sync(),
            verdict: verdict(scenario, outcome, &devices, &findings),
            expected: expected::expected(scenario, outcome),
            faults: expected::faults(outcome),
            findings,
            diagnoses: Vec::new(),
            visits: told(scenario, &outcome.visits),
            services: services::notes(&outcome.world.main().segment().devices),
            cycle_ns: scenario.cycle.0,
            judged_ns: if outcome.began.is_some() { scenario.duration.0 } else { 0 },
            segment: segment(scenario, outcome),
            quality: quality::Quality::new(outcome.world.main(), scenario.operation.quality)
                .map(|quality| quality.with_alarms(&outcome.alarms)),
            plants: plant::Plants::new(scenario, outcome),
            devices,
        }
    }
}

fn verdict<T: Tap>(
    scenario: &Scenario,
    outcome: &Outcome<T>,
    devices: &[Device],
    findings: &[Finding],
) -> String {
    if !outcome.in_sync() {
        return words::verdict(findings).unwrap_or_else(|| {
            format!("Not in sync: the way up did not end ({}).", scenario.source)
        });
    }
    let status = |device: &&Device| device.registers.al_status;
    let there =
        |device: &&Device| !matches!(status(device), StateRead::Absent | StateRead::Joining);
    let modes: Vec<SyncMode> = devices.iter().filter(there).map(|device| device.mode).collect();
    let mut text = verdict_of_modes(&modes);
    for (state, words) in [(StateRead::Absent, "absent"), (StateRead::Joining, "being taken up")] {
        match devices.iter().filter(|device| status(device) == state).count() {
            0 => {}
            1 => text += &format!(" 1 optional one is {words}."),
            many => text += &format!(" {many} optional ones are {words}."),
        }
    }
    text
}

/// The verdict of a run without findings, by the modes of its SubDevices.
pub(super) fn verdict_of_modes(modes: &[SyncMode]) -> String {
    let free = modes.iter().filter(|mode| **mode == SyncMode::FreeRun).count();
    let synchronized = modes.len() - free;
    if synchronized == 0 {
        return format!("In operation: all {free} SubDevices in Free Run, nothing to synchronize.");
    }
    let mut text = format!("In sync: {synchronized} of {} SubDevices", modes.len());
    if free > 0 {
        text += &format!(", {free} in Free Run as announced or asked for");
    }
    text + "."
}

impl Finding {
    /// A finding in a document of this family; `name` gives names of SubDevices by position.
    pub(super) fn new(
        found: &isocat_sim::Finding,
        name: impl Fn(usize) -> Option<String>,
        family: Family,
    ) -> Self {
        let isocat_sim::Finding { place, since, kind } = found;
        Self {
            position: place.device,
            device: place.device.and_then(name),
            stage: place.stage,
            since_ns: since.map(|since| since.0),
            what: words::sentence(kind, *since, family),
            kind: kind.clone(),
        }
    }
}

fn findings<T: Tap>(scenario: &Scenario, outcome: &Outcome<T>) -> Vec<Finding> {
    let of_way_up = match &outcome.failure {
        Some(error) => Some((
            error.cause.place().map(|place| place.position),
            error.stage,
            Judged::failed(error.cause.clone()),
        )),
        None if outcome.began.is_none() => {
            Some((None, outcome.world.main().stage(), Judged::TooLong))
        }
        None => None,
    };
    let of_way_up = of_way_up.map(|(device, stage, kind)| isocat_sim::Finding {
        place: Place { device, stage: Some(stage) },
        since: None,
        kind: kind.into(),
    });
    let mut all = told(scenario, of_way_up.as_slice());
    all.extend(told(scenario, &outcome.findings));
    all
}

fn told(scenario: &Scenario, all: &[isocat_sim::Finding]) -> Vec<Finding> {
    let name = |position: usize| scenario.devices.get(position).map(|d| d.name.clone());
    all.iter().map(|finding| Finding::new(finding, name, Family::Virtual)).collect()
}

fn segment<T: Tap>(scenario: &Scenario, outcome: &Outcome<T>) -> Segment {
    let main = outcome.world.main();
    let counts = main.statistics();
    let uncertainty = main.phase_uncertainty();
    let timing = main.segment().timing.as_ref();
    let bench = &outcome.bench;
    Segment {
        ring: Ring::of(scenario),
        copies_lost: counts.copies_lost,
        true_time: SegmentTrueTime {
            time_to_synchronization_ns: time_to_synchronization(outcome),
            settling: settling_of(outcome),
            host_phase_error: bench.host_phase().and_then(|judge| spread(judge.statistics())),
            outputs_valid_spread: span(bench.outputs_valid().spread())
                .filter(|_| bench.devices().iter().filter(|d| d.sync0.is_some()).count() > 1),
        },
        main_device: SegmentMainDevice {
            reference: main.segment().reference,
            // A way up that failed has no other frames.
            bring_up_frames: match counts.bring_up_frames {
                0 => counts.frames_sent,
                frames => frames,
            },
            drift_frames: counts.drift_burst,
            difference_at_lock: settling::Difference::at_lock(main.segment()),
            frames_sent: counts.frames_sent,
            frames_lost: counts.frames_lost,
            cycles: counts.cycles,
            working_counter_errors: counts.working_counter_errors,
            host_phase_error: summary(&counts.phase_error),
            reference_rate_ppb: main.rate_ppb(),
            reference_rate_error_ppb: uncertainty.map(|told| told.rate_ppb.ceil() as i64),
            reference_phase_error_ns: uncertainty.map(|told| told.phase_ns.ceil() as i64),
        },
        plan: timing.map(SegmentPlan::from),
    }
}

/// How the clocks of all SubDevices with SYNC0 went, except the reference clock.
fn settling_of<T: Tap>(outcome: &Outcome<T>) -> Option<settling::Settling> {
    let began = outcome.began?;
    let reference = outcome.world.main().segment().reference?;
    let followers = outcome.bench.devices().iter().enumerate();
    let followers = followers.filter(|(position, _)| *position != reference);
    let clocks = followers
        .filter_map(|(position, device)| Some((position, device.sync0.as_ref()?.settling())));
    settling::Settling::new(clocks, |at| Nanos((at - began).0 / 1_000))
}

impl From<&isocat_maindevice::segment::Timing> for SegmentPlan {
    fn from(timing: &isocat_maindevice::segment::Timing) -> Self {
        Self {
            send_phase_ns: timing.cycle.send.0,
            sync0_phase_ns: timing.sync0.map(|phase| phase.0),
            jitter_ns: timing.cycle.jitter.0,
        }
    }
}

fn device<T: Tap>(scenario: &Scenario, outcome: &Outcome<T>, position: usize) -> Device {
    let wanted = &scenario.devices[position];
    let main = outcome.world.main().segment();
    let found = main.devices.get(position);
    let budget = main.timing.as_ref().and_then(|timing| timing.devices.get(position));
    let mode = found.map_or(SyncMode::FreeRun, |device| device.mode);
    Device {
        position,
        name: wanted.name.clone(),
        profile: wanted.profile.id.clone(),
        line: wanted.line,
        mode,
        op_mode: OpMode::of(wanted),
        mode_reason: found.map_or(String::new(), |device| device.mode_reason.clone()),
        cycle_ns: outcome
            .world
            .segment()
            .devices()
            .get(position)
            .map(|device| device.stack.sync().cycle().0)
            .map(|cycle| match found {
                Some(found) if mode == SyncMode::SmSynchronous => {
                    scenario.cycle.0 * i64::from(found.every)
                }
                _ => cycle,
            })
            .filter(|cycle| *cycle > 0),
        true_time: true_time(
            &outcome.bench.devices()[position],
            mode,
            oscillator(scenario, position),
            wanted.profile.sampling.as_ref(),
        ),
        registers: registers(outcome, position),
        plan: budget.map_or(Vec::new(), |(_, budget)| {
            // Limits of the judges stand with what they judge, unless they alone tell that a plan
            // does not fit.
            let counts =
                |line: &isocat_sync::budget::Line| line.check.is_of_cycle() || !line.fits();
            budget.lines().filter(counts).map(plan_line).collect()
        }),
        // A coupler has no process data.
        application: found
            .filter(|found| found.outputs.length + found.inputs.length > 0)
            .map(|_| application(outcome.world.application().axes().get(position)))
            .map(|text| {
                let device = &outcome.world.segment().devices()[position];
                text + &unchanged(device.stack.sync().toggle_failed())
            })
            .unwrap_or_default(),
        assumptions: wanted
            .profile
            .assumptions
            .iter()
            .map(|a| Assumption {
                item: a.item.clone(),
                value: a.value.clone(),
                why: a.why.clone(),
                doubt: None,
            })
            .chain(wanted.notes.iter().map(Assumption::from))
            .collect(),
    }
}

/// The constant deviation of a device's clock, and its origin.
fn oscillator(scenario: &Scenario, position: usize) -> Oscillator {
    let clock = scenario.devices[position].clock;
    Oscillator {
        deviation_ppb: clock.deviation(scenario.seed, position).0,
        drawn_within_ppb: match clock {
            Clock::Given(_) => None,
            Clock::DrawnWithin(limit) => Some(limit.0),
        },
    }
}

fn true_time(
    bench: &DeviceBench,
    mode: SyncMode,
    clock: Oscillator,
    sampling: Option<&Sampling>,
) -> DeviceTrueTime {
    let with_sync0 = |statistics: &Statistics| {
        if mode.uses_dc() { span(statistics) } else { None }
    };
    let samples = |channels: fn(&Sampling) -> &[Channel], judge| {
        let sampling = sampling.filter(|sampling| !channels(sampling).is_empty())?;
        Some(Samples::new(judge, sampling.samples))
    };
    DeviceTrueTime {
        clock,
        sync0_error: bench.sync0.as_ref().and_then(|judge| spread(judge.statistics())),
        sm2_to_sync0: with_sync0(bench.margin.distance()),
        sync0_margin: with_sync0(bench.margin.margin()),
        outputs_delay: with_sync0(bench.outputs_delay.delay()),
        outputs_age: span(bench.outputs_cycle.age()),
        outputs_late: bench.outputs_cycle.late().count(),
        inputs_age: span(bench.inputs_cycle.age()),
        inputs_late: bench.inputs_cycle.late().count(),
        input_samples: samples(|sampling| &sampling.inputs, &bench.input_samples),
        output_samples: samples(|sampling| &sampling.outputs, &bench.output_samples),
        missed_events: bench.missed.count(),
        highest_missed_counter: bench.missed.highest(),
        state: bench.states.last().map_or(AlState::Init, |change| change.state),
    }
}

fn registers<T: Tap>(outcome: &Outcome<T>, position: usize) -> DeviceRegisters {
    let found = outcome.world.main().segment().devices.get(position);
    let ns = |time: Option<Nanos>| time.map(|time| time.0);
    DeviceRegisters {
        al_status: found.map_or(StateRead::NotScanned, |device| match device.admitted {
            true => StateRead::Status(device.al_status),
            false if device.left_out.is_some() => StateRead::Status(device.al_status),
            false if outcome.joining[position] => StateRead::Joining,
            false => StateRead::Absent,
        }),
        al_status_code: found.map_or(0, |device| device.al_code.0),
        delay_ns: ns(found.and_then(|device| device.delay)),
        delay_error_ns: found.and_then(delay_error),
        delay_unknown: found.and_then(delay_unknown),
        measured_times: found.and_then(|device| device.own_times).map(MeasuredTimes::from),
        system_time_difference_ns: ns(found.and_then(|device| device.difference)),
        output_sync_type: found
            .and_then(|device| device.output_sync.as_ref()?.sync_type())
            .map(|kind| kind.0),
        input_sync_type: found
            .and_then(|device| device.input_sync.as_ref()?.sync_type())
            .map(|kind| kind.0),
        output_counters: counters(outcome.output_counters[position]),
        input_counters: counters(outcome.input_counters[position]),
    }
}

/// The error bar of the measured delay, ns, rounded up.
pub(super) fn delay_error(device: &SubDevice) -> Option<i64> {
    let bar = device.measured_delay?.bar()?;
    Some((bar.0 + 999).div_euclid(1_000))
}

/// Why the delay of a clock was not measured.
pub(super) fn delay_unknown(device: &SubDevice) -> Option<String> {
    match device.measured_delay? {
        Delay::Indeterminate { why, between } if device.dc.has_clock() => {
            Some(match between.map(|(least, most)| (least.0 / 1_000, most.0 / 1_000)) {
                Some((least, most)) => format!("{why}; {least} to {most} ns are possible"),
                None => why.to_string(),
            })
        }
        _ => None,
    }
}

/// What a device says that wants its outputs to change each time, if they did not.
fn unchanged(count: u16) -> String {
    match count {
        0 => String::new(),
        count => format!(
            "; it counted {count} outputs as old, since their toggle bit did not change (0x1C32:0E): the application must change \
             that bit, or count it up, with each frame"
        ),
    }
}

pub(super) fn application(axis: Option<&Axis>) -> String {
    match axis {
        Some(Axis::Drive(Drive { enabled_cycles: 0, .. })) => "drive, not enabled".into(),
        Some(Axis::Drive(drive)) => format!(
            "drive, operation enabled for {} cycles, moved {} increments, lag at most {}",
            drive.enabled_cycles, drive.travelled, drive.worst_lag
        ),
        Some(Axis::Outputs) => "outputs written each cycle".into(),
        Some(Axis::Nothing) => "inputs read each cycle".into(),
        None => String::new(),
    }
}

pub(super) fn counters(counters: run::Counters) -> Counters {
    Counters {
        sm_event_missed: counters.sm_event_missed,
        cycle_time_too_small: counters.cycle_time_too_small,
        shift_time_too_short: counters.shift_time_too_short,
        sync_error: counters.sync_error,
    }
}

pub(super) fn plan_line(line: isocat_sync::budget::Line) -> PlanLine {
    PlanLine {
        object: line.check.source().map_or(String::new(), |source| source.to_string()),
        demand: line.check.words().to_owned(),
        needed_ns: line.needed.0,
        available_ns: line.available.0,
        slack_ns: line.slack().0,
    }
}

/// Time from power-on until all SubDevices were in OP and on the grid; `None` if one was off the
/// grid at the beginning.
fn time_to_synchronization<T>(outcome: &Outcome<T>) -> Option<i64> {
    let began = outcome.began?;
    let off_from_the_start = |device: &DeviceBench| {
        let edge = device.sync0.as_ref().and_then(|judge| judge.first_beyond());
        edge.is_some_and(|(at, _)| at - began < FIRST_EDGES)
    };
    let off = outcome.bench.devices().iter().any(off_from_the_start);
    (!off).then(|| began.as_nanos() as i64)
}

/// Time in which the first SYNC0 edges come after OP: two of the longest cycles.
const FIRST_EDGES: Picos = Picos(2_000_000_000_000);

/// A series of ps as ns; `None` if it is empty.
pub fn span(statistics: &Statistics) -> Option<Span> {
    let ns = |ps: f64| ps.round() / 1000.0;
    (statistics.count() > 0).then(|| Span {
        count: statistics.count(),
        mean_ns: ns(statistics.mean()),
        standard_deviation_ns: ns(statistics.standard_deviation()),
        min_ns: ns(statistics.least() as f64),
        max_ns: ns(statistics.largest() as f64),
    })
}

/// A series of errors in ps as ns; `None` if it is empty.
pub fn spread(statistics: &Statistics) -> Option<Spread> {
    let ns = |ps: f64| ps.round() / 1000.0;
    (statistics.count() > 0).then(|| Spread {
        count: statistics.count(),
        mean_ns: ns(statistics.mean()),
        standard_deviation_ns: ns(statistics.standard_deviation()),
        min_ns: ns(statistics.least() as f64),
        max_ns: ns(statistics.largest() as f64),
        worst_ns: ns(statistics.worst() as f64),
    })
}

pub(super) fn summary(summary: &Summary) -> Option<Spread> {
    let ns = |time: Nanos| time.0 as f64;
    Some(Spread {
        count: summary.count,
        mean_ns: ns(summary.mean()?),
        standard_deviation_ns: ns(summary.deviation()?),
        min_ns: ns(summary.min),
        max_ns: ns(summary.max),
        worst_ns: ns(summary.min.abs().max(summary.max.abs())),
    })
}
