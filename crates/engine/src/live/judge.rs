//! The reason for the end of a run on an interface, in addition to the results of the
//! [`verdict`](crate::verdict) engine for the time in operation; and further notes for the reader.

use isocat_host::Traffic;
use isocat_maindevice::Cause;
use isocat_maindevice::statistics::Statistics;
use isocat_sim::{Finding, Judged, Place};
use isocat_wire::time::Nanos;

use super::job::{End, Outcome, SILENCE};
use crate::report::words::seconds;

/// Adds the reason for the end of the run to the findings of the time in operation, and sorts all
/// by time.
pub(super) fn judge(outcome: &mut Outcome, interface: &str, carrier: Option<bool>) {
    let segment = |since, kind: Judged| Finding { place: Place::SEGMENT, since, kind: kind.into() };
    let nothing_came = outcome.statistics.1.frames_received == 0;
    let interface = interface.to_owned();
    let ended = match &outcome.end {
        End::Failed(error) if nothing_came && is_lost(&error.cause) => {
            let place = Place { device: None, stage: Some(error.stage) };
            let unprocessed = outcome.figures.unprocessed;
            let kind = Judged::NothingAnswers { interface, carrier, unprocessed }.into();
            Some(Finding { place, since: None, kind })
        }
        End::Failed(error) => {
            let device = error.cause.place().map(|place| place.position);
            let place = Place { device, stage: Some(error.stage) };
            let kind = Judged::failed(error.cause.clone()).into();
            Some(Finding { place, since: None, kind })
        }
        End::List { .. } if nothing_came => {
            let unprocessed = outcome.figures.unprocessed;
            Some(segment(None, Judged::NothingAnswers { interface, carrier, unprocessed }))
        }
        End::List { what, position, .. } => {
            let place = Place { device: *position, stage: None };
            let kind = Judged::CommandFailed { what: what.clone() }.into();
            Some(Finding { place, since: None, kind })
        }
        End::TooLong => Some(segment(None, Judged::TooLong)),
        End::Asked if outcome.judged.is_none() => Some(segment(None, Judged::EndedEarly)),
        End::Link(error) => {
            let error = error.to_string().replace('\n', "; ");
            Some(segment(outcome.judged, Judged::InterfaceFailed { error }))
        }
        End::Silence => {
            let since = outcome.judged.map(|judged| judged - SILENCE);
            Some(segment(since, Judged::Silence { interface, carrier }))
        }
        End::Time | End::Asked => None,
    };
    // The reason for the end comes before the other findings without a time.
    outcome.findings.splice(0..0, ended);
    outcome.findings.sort_by_key(|finding| finding.since.unwrap_or(Nanos(i64::MAX)));
}

fn is_lost(cause: &Cause) -> bool {
    match cause {
        Cause::Access(error) => error.is_lost(),
        Cause::Silent { .. } => true,
        _ => false,
    }
}

/// Notes what is no reason for a verdict but may explain what happened.
pub(super) fn note(
    outcome: &mut Outcome,
    interface: &str,
    jitter: Nanos,
    total: Statistics,
    traffic: Option<(Traffic, Traffic)>,
) {
    let mut notes = Vec::new();
    let figures = &outcome.figures;
    let end = &outcome.statistics.1;
    if outcome.machine.wake_ups.largest() > jitter {
        notes.push(format!(
            "wake-ups were up to {} late before the run; the plan keeps {jitter} ([host] jitter)",
            outcome.machine.wake_ups.largest()
        ));
    }
    if figures.beyond_jitter > 0 {
        let (late, all) = (figures.beyond_jitter, figures.lateness.count());
        notes.push(format!(
            "{late} of {all} cycles left later than the {jitter} that the plan keeps for it, at worst {}",
            figures.lateness.largest()
        ));
    }
    if outcome.judged.is_some() && outcome.locks_lost > 0 {
        let times = outcome.locks_lost;
        notes.push(format!("the host lost its lock on the reference clock {times} times"));
    }
    if let Some((late, since)) = outcome.stall {
        notes.push(format!(
            "the machine's longest stall: {late} too late for a cycle, {} into the run",
            seconds(since)
        ));
    }
    if let Some(address) = figures.other_talker {
        let address = address.map(|byte| format!("{byte:02x}")).join(":");
        notes.push(format!(
            "{} EtherCAT frames of another sender ({address}) came in: there is a second MainDevice on this \
             wire, which disturbs the segment",
            figures.other_talkers
        ));
    }
    if figures.unprocessed > 0 && end.frames_received > 0 {
        notes.push(format!(
            "{} frames of ours came back that no SubDevice had processed",
            figures.unprocessed
        ));
    }
    if let Some((before, after)) = traffic {
        let late =
            total.frames_late + total.frames_unexpected + total.frames_echoed + figures.too_late;
        let ours = total.frames_received + total.frames_foreign + late;
        let came = (after.received - before.received).saturating_sub(ours);
        // Frames of another program on the same interface may be EtherCAT too.
        let sent = total.frames_sent + figures.other_talkers;
        let left = (after.sent - before.sent).saturating_sub(sent);
        if came + left > 0 {
            notes.push(format!(
                "other protocols use {interface}: {came} frames came in and {left} left that are no EtherCAT \
                 frames; IPv6, DHCP and LLDP should be off there"
            ));
        }
    }
    if let (End::Asked, Some(judged)) = (&outcome.end, outcome.judged) {
        notes.push(format!("ended by a signal after {}", seconds(judged)));
    }
    outcome.notes.splice(0..0, notes);
}
