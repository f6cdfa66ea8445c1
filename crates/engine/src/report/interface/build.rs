//! Builds the report from the outcome of a run on an interface.

use isocat_host::Histogram;
use isocat_maindevice::segment::SubDevice;
use isocat_sync::SyncMode;
use isocat_sync::phase;
use isocat_wire::time::Nanos;

use super::*;
use crate::live::Outcome;
use crate::live::job::{self, End};
use crate::report::build::{
    application, counters, delay_error, delay_unknown, plan_line, summary, verdict_of_modes,
};
use crate::report::services;
use crate::report::settling::Difference;
use crate::report::times::MeasuredTimes;
use crate::report::typed::{KindDocument, StateRead};
use crate::report::words::{self, Family};
use crate::verdict::{self, Answer, Readings};

/// The settings of the run, for its report.
#[derive(Clone, Copy, Debug)]
pub struct Asked<'a> {
    /// Network interface.
    pub interface: &'a str,
    /// Its network namespace.
    pub namespace: Option<&'a str>,
    /// File with the description of the expected segment; `None` if any segment is accepted.
    pub segment_file: Option<&'a str>,
    /// Bus cycle.
    pub cycle: Nanos,
    /// Time in operation.
    pub duration: Nanos,
    /// Lateness that the plan allows.
    pub jitter: Nanos,
}

impl InterfaceReport {
    /// Reports on a run.
    pub fn new(asked: Asked<'_>, outcome: &Outcome) -> Self {
        let devices: Vec<InterfaceDevice> =
            (0..outcome.segment.devices.len()).map(|at| device(outcome, at)).collect();
        let name = |at: usize| devices.get(at).map(|device| device.name.clone());
        let told = |finding: &isocat_sim::Finding| Finding::new(finding, name, Family::Wire);
        let findings: Vec<Finding> = outcome.findings.iter().map(told).collect();
        let unknown: Vec<Unknown> =
            outcome.unknown.iter().map(|unknown| Unknown::new(unknown, name)).collect();
        let answer = outcome.answer();
        let timing = outcome.segment.timing.as_ref();
        Self {
            format: FORMAT,
            version: env!("CARGO_PKG_VERSION"),
            interface: asked.interface.to_owned(),
            namespace: asked.namespace.map(str::to_owned),
            segment_file: asked.segment_file.map(str::to_owned),
            in_sync: answer == Answer::InSync,
            answer,
            verdict: verdict(&devices, &findings, &unknown),
            findings,
            unknown,
            visits: outcome.visits.iter().map(told).collect(),
            notes: outcome.notes.clone(),
            services: services::notes(&outcome.segment.devices),
            ended_by: match outcome.end {
                End::Time => EndedBy::Time,
                End::Asked => EndedBy::Signal,
                End::Failed(_) | End::List { .. } | End::TooLong => EndedBy::BringUp,
                End::Silence => EndedBy::Silence,
                End::Link(_) => EndedBy::Interface,
            },
            cycle_ns: asked.cycle.0,
            asked_ns: asked.duration.0,
            judged_ns: outcome.judged.map_or(0, |judged| judged.0),
            machine: Machine::from(&outcome.machine),
            punctuality: punctuality(asked, outcome),
            main_device: main_device(outcome),
            plan: timing.map(SegmentPlan::from),
            quality: outcome.quality.clone(),
            devices,
        }
    }
}

impl From<&job::Machine> for Machine {
    fn from(machine: &job::Machine) -> Self {
        Self {
            granted: machine.granted.clone(),
            refused: machine.refused.clone(),
            harms: machine.findings.iter().map(harm).collect(),
            wake_up_lateness: series(&machine.wake_ups),
        }
    }
}

impl Machine {
    /// Whether a setting makes this machine less punctual than possible.
    pub fn harms_punctuality(&self) -> bool {
        !self.harms.is_empty() || !self.refused.is_empty()
    }
}

impl Unknown {
    fn new(unknown: &verdict::Unknown, name: impl Fn(usize) -> Option<String>) -> Self {
        let position = unknown.place.device;
        let document = KindDocument::new(unknown.kind.name(), &unknown.kind.figures());
        Self {
            position,
            device: position.and_then(name),
            decides: unknown.kind.decides(),
            what: words::gap(&unknown.kind),
            kind: document.kind,
            figures: document.figures,
        }
    }
}

impl Unknown {
    /// What is not known, as a sentence with the device it concerns.
    pub fn sentence(&self) -> String {
        match (&self.device, self.position) {
            (Some(name), Some(position)) => format!("SubDevice {position} ({name}): {}", self.what),
            _ => self.what.clone(),
        }
    }
}

fn verdict(devices: &[InterfaceDevice], findings: &[Finding], unknown: &[Unknown]) -> String {
    if let Some(words) = words::verdict(findings) {
        return words;
    }
    let mut open = unknown.iter().filter(|unknown| unknown.decides);
    if let Some(first) = open.next() {
        let others = match open.count() {
            0 => String::new(),
            more => format!("; {more} more below"),
        };
        return format!("Not known: {}{others}.", first.sentence());
    }
    let modes: Vec<SyncMode> = devices.iter().map(|device| device.mode).collect();
    verdict_of_modes(&modes)
}

fn punctuality(asked: Asked<'_>, outcome: &Outcome) -> Punctuality {
    let (begin, end) = &outcome.statistics;
    let figures = &outcome.figures;
    let in_operation = |before: u64, after: u64| match outcome.judged {
        Some(_) => after - before,
        None => 0,
    };
    Punctuality {
        send_lateness: series(&figures.lateness),
        jitter_ns: asked.jitter.0,
        beyond_jitter: figures.beyond_jitter,
        round_trip: series(&figures.round_trip),
        cycles_skipped: in_operation(begin.cycles_skipped, end.cycles_skipped),
        frames_lost: in_operation(begin.frames_missed(), end.frames_missed()),
        working_counter_errors: in_operation(
            begin.working_counter_errors,
            end.working_counter_errors,
        ),
        frames_foreign: end.frames_foreign
            + end.frames_late
            + end.frames_unexpected
            + end.frames_echoed
            + figures.too_late,
        frames_of_others: figures.other_talkers,
        locks_lost: outcome.locks_lost,
        locked: outcome.segment.reference.and(outcome.phase).map(|s| s == phase::State::Locked),
    }
}

fn main_device(outcome: &Outcome) -> SegmentMainDevice {
    let counts = &outcome.statistics.1;
    let uncertainty = outcome.segment.reference.and(outcome.uncertainty);
    SegmentMainDevice {
        reference: outcome.segment.reference,
        // A way up that failed has no other frames.
        bring_up_frames: match counts.bring_up_frames {
            0 => counts.frames_sent,
            frames => frames,
        },
        drift_frames: counts.drift_burst,
        difference_at_lock: Difference::at_lock(&outcome.segment),
        frames_sent: counts.frames_sent,
        frames_lost: counts.frames_lost,
        cycles: counts.cycles,
        working_counter_errors: counts.working_counter_errors,
        host_phase_error: summary(&counts.phase_error),
        reference_rate_ppb: outcome.segment.reference.and(outcome.rate_ppb),
        reference_rate_error_ppb: uncertainty.map(|told| told.rate_ppb.ceil() as i64),
        reference_phase_error_ns: uncertainty.map(|told| told.phase_ns.ceil() as i64),
    }
}

fn device(outcome: &Outcome, position: usize) -> InterfaceDevice {
    let found = &outcome.segment.devices[position];
    let at_end = outcome.devices.get(position).copied().unwrap_or_default();
    let timing = outcome.segment.timing.as_ref();
    let budget = timing.and_then(|timing| timing.devices.get(position));
    let name = match found.name.as_str() {
        "" => format!("{:08x}:{:08x}", found.identity.vendor, found.identity.product),
        name => name.to_owned(),
    };
    InterfaceDevice {
        position,
        name,
        vendor_id: found.identity.vendor,
        product_code: found.identity.product,
        revision: found.identity.revision,
        serial: found.identity.serial,
        mode: found.mode,
        mode_reason: found.mode_reason.clone(),
        registers: registers(found, &at_end, outcome.judged.is_some()),
        output_counters_before: counters(at_end.outputs_before),
        input_counters_before: counters(at_end.inputs_before),
        plan: budget.map_or(Vec::new(), |(_, budget)| budget.lines().map(plan_line).collect()),
        application: application(outcome.axes.get(position)),
    }
}

/// The registers read at the end; if the way up failed, those that were read last. In operation the
/// latter would be too old.
fn registers(found: &SubDevice, at_end: &Readings, operated: bool) -> DeviceRegisters {
    let last = (found.al_status, found.al_code);
    let status = at_end.status.or((!operated).then_some(last));
    let difference = at_end.difference.or(found.difference.filter(|_| !operated));
    let ns = |time: Option<Nanos>| time.map(|time| time.0);
    DeviceRegisters {
        al_status: status.map_or(StateRead::Unknown, |(status, _)| StateRead::Status(status)),
        al_status_code: status.map_or(0, |(_, code)| code.0),
        delay_ns: ns(found.delay),
        delay_error_ns: delay_error(found),
        delay_unknown: delay_unknown(found),
        measured_times: found.own_times.map(MeasuredTimes::from),
        system_time_difference_ns: ns(difference),
        output_sync_type: found.output_sync.as_ref().and_then(|o| o.sync_type()).map(|t| t.0),
        input_sync_type: found.input_sync.as_ref().and_then(|o| o.sync_type()).map(|t| t.0),
        output_counters: counters(at_end.outputs),
        input_counters: counters(at_end.inputs),
    }
}

fn harm(finding: &isocat_host::preflight::Finding) -> Harm {
    let isocat_host::preflight::Finding { what, source, advice } = finding.clone();
    Harm { what, source, advice }
}

/// A series with its distribution; `None` if it is empty.
fn series(histogram: &Histogram) -> Option<Series> {
    let span = summary(histogram.summary())?.span();
    let (within, beyond) = histogram.buckets(LIMITS);
    let within = within.into_iter().zip(LIMITS).map(|(count, limit)| (Some(limit.0), count));
    let buckets = within.chain([(None, beyond)]).filter(|(_, count)| *count > 0);
    Some(Series {
        span,
        p50_ns: histogram.percentile(50).0,
        p99_ns: histogram.percentile(99).0,
        buckets: buckets.map(|(up_to_ns, count)| Bucket { up_to_ns, count }).collect(),
    })
}

const LIMITS: [Nanos; 15] = [
    Nanos::micros(1),
    Nanos::micros(2),
    Nanos::micros(5),
    Nanos::micros(10),
    Nanos::micros(20),
    Nanos::micros(50),
    Nanos::micros(100),
    Nanos::micros(200),
    Nanos::micros(500),
    Nanos::millis(1),
    Nanos::millis(2),
    Nanos::millis(5),
    Nanos::millis(10),
    Nanos::millis(20),
    Nanos::millis(50),
];
