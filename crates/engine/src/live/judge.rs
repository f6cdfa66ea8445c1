//! What speaks against the segment being in sync, by what was read from it; and what else a reader ought
//! to know.

use isocat_host::Traffic;
use isocat_maindevice::Cause;
use isocat_maindevice::statistics::Statistics;
use isocat_sim::run::Counters;
use isocat_sim::{Finding, Judged, Place};
use isocat_sync::object::{INPUT_PARAMETER, OUTPUT_PARAMETER, sub};
use isocat_sync::phase;
use isocat_wire::time::Nanos;
use isocat_wire::{AlState, AlStatus, ObjectAddress};

use super::job::{AtEnd, End, Noted, Outcome, SILENCE};
use crate::report::words::seconds;

/// Judges an outcome: fills in its findings, in the order of time.
pub(super) fn judge(
    outcome: &mut Outcome,
    noted: &Noted,
    interface: &str,
    carrier: Option<bool>,
    difference_limit: Nanos,
) {
    let mut findings = Vec::new();
    let segment = |since, kind: Judged| Finding { place: Place::SEGMENT, since, kind: kind.into() };
    let nothing_came = outcome.statistics.1.frames_received == 0;
    let interface = interface.to_owned();
    match &outcome.end {
        End::Failed(error) if nothing_came && is_lost(&error.cause) => {
            let place = Place { device: None, stage: Some(error.stage) };
            let unprocessed = outcome.figures.unprocessed;
            let kind = Judged::NothingAnswers { interface, carrier, unprocessed }.into();
            findings.push(Finding { place, since: None, kind });
        }
        End::Failed(error) => {
            let device = error.cause.place().map(|place| place.position);
            let place = Place { device, stage: Some(error.stage) };
            let kind = Judged::failed(error.cause.clone()).into();
            findings.push(Finding { place, since: None, kind });
        }
        End::TooLong => findings.push(segment(None, Judged::TooLong)),
        End::Asked if outcome.judged.is_none() => {
            findings.push(segment(None, Judged::EndedEarly));
        }
        End::Link(error) => {
            let error = error.to_string().replace('\n', "; ");
            findings.push(segment(outcome.judged, Judged::InterfaceFailed { error }));
        }
        End::Silence => {
            let since = outcome.judged.map(|judged| judged - SILENCE);
            findings.push(segment(since, Judged::Silence { interface, carrier }));
        }
        End::Time | End::Asked => {}
    }
    if let Some((expected, found, since)) = noted.counts.first() {
        let kind = Judged::CountChanged { expected: *expected, found: *found };
        findings.push(segment(Some(*since), kind));
    }
    findings.extend(noted.changes.iter().map(|(device, change, since)| Finding {
        place: Place { device: *device, stage: None },
        since: Some(*since),
        kind: change.clone().into(),
    }));
    for position in 0..outcome.devices.len() {
        let found = judge_device(outcome, noted, position, difference_limit);
        findings.extend(found.into_iter().map(|(since, kind)| Finding {
            place: Place::device(position),
            since,
            kind: kind.into(),
        }));
    }
    findings.extend(skipped(outcome).map(|(since, kind)| segment(since, kind)));
    let with_clock = outcome.segment.reference.is_some();
    if outcome.judged.is_some() && with_clock && outcome.phase != Some(phase::State::Locked) {
        let holdover = outcome.phase == Some(phase::State::Holdover);
        findings.push(segment(None, Judged::HostNotLocked { holdover }));
    }
    // What came first is nearest to the cause; what has no time of its own comes last.
    findings.sort_by_key(|finding| finding.since.unwrap_or(Nanos(i64::MAX)));
    outcome.findings = findings;
}

/// Cycles in which SYNC0 came and no outputs did. Counters of SubDevices may have gone down again since.
fn skipped(outcome: &Outcome) -> Option<(Option<Nanos>, Judged)> {
    outcome.judged?;
    let (begin, end) = &outcome.statistics;
    let cycles = end.cycles_skipped - begin.cycles_skipped;
    let waits = outcome.segment.devices.iter().any(|device| device.mode.uses_dc());
    let since = outcome.stall.map(|(_, since)| since);
    (cycles > 0 && waits).then_some((since, Judged::CyclesSkipped { cycles }))
}

/// What speaks against one SubDevice, and since when.
fn judge_device(
    outcome: &Outcome,
    noted: &Noted,
    position: usize,
    limit: Nanos,
) -> Vec<(Option<Nanos>, Judged)> {
    let mut findings = Vec::new();
    let at_end = &outcome.devices[position];
    let mut changes = noted.states.iter().filter(|(at, ..)| *at == position);
    if let Some((_, state, code, since)) = changes.next() {
        findings.push((Some(*since), Judged::LeftOp { state: *state, code: *code }));
    } else {
        match at_end.status {
            Some((status, _)) if status == AlStatus::new(AlState::Op) => {}
            Some((state, code)) => findings.push((None, Judged::NotInOp { state, code })),
            // Silence and a dead interface are told for the segment.
            None if matches!(outcome.end, End::Silence | End::Link(_)) => {}
            None => findings.push((None, Judged::NoAnswer)),
        }
    }
    findings.extend(counted(at_end).map(|kind| (None, kind)));
    let device = &outcome.segment.devices[position];
    let steered = device.mode.uses_dc() && outcome.segment.reference != Some(position);
    if let Some(difference) = at_end.difference.filter(|d| steered && d.abs() > limit) {
        findings.push((None, Judged::ClockOff { difference, limit }));
    }
    findings
}

/// What the SubDevice itself counted while in operation.
fn counted(at_end: &AtEnd) -> Option<Judged> {
    let outputs = complaint(OUTPUT_PARAMETER, &at_end.outputs_before, &at_end.outputs);
    // The inputs' object mirrors the outputs'.
    outputs.or_else(|| complaint(INPUT_PARAMETER, &at_end.inputs_before, &at_end.inputs))
}

fn complaint(index: u16, before: &Counters, after: &Counters) -> Option<Judged> {
    let object = |sub| ObjectAddress::new(index, sub);
    // By how much a counter grew, and its value. One that is smaller than before was set back, and then counted on.
    let grown = |before: Option<u32>, after: Option<u32>| {
        let (before, after) = (before.unwrap_or(0), after?);
        let by = after.checked_sub(before).unwrap_or(after);
        (by > 0).then_some((by, after))
    };
    if let Some((grew, value)) = grown(before.sm_event_missed, after.sm_event_missed) {
        let object = object(sub::SM_EVENT_MISSED);
        return Some(Judged::SmEventMissed { object, grew, value });
    }
    if let Some((grew, value)) = grown(before.cycle_time_too_small, after.cycle_time_too_small) {
        let object = object(sub::CYCLE_TIME_TOO_SMALL);
        return Some(Judged::CycleTimeTooSmall { object, grew: Some(grew), value });
    }
    if let Some((grew, value)) = grown(before.shift_time_too_short, after.shift_time_too_short) {
        let object = object(sub::SHIFT_TIME_TOO_SHORT);
        return Some(Judged::ShiftTimeTooShort { object, grew: Some(grew), value });
    }
    let value = after.sync_error.filter(|error| *error > 0)?;
    Some(Judged::SyncError { object: object(sub::SYNC_ERROR), grew: None, value })
}

fn is_lost(cause: &Cause) -> bool {
    match cause {
        Cause::Access(error) => error.is_lost(),
        Cause::Silent { .. } => true,
        _ => false,
    }
}

/// Says what is no reason for a verdict but may be one for what happened.
pub(super) fn note(
    outcome: &mut Outcome,
    interface: &str,
    jitter: Nanos,
    total: Statistics,
    traffic: Option<(Traffic, Traffic)>,
) {
    let mut notes = Vec::new();
    let figures = &outcome.figures;
    let (begin, end) = &outcome.statistics;
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
    if outcome.judged.is_some() {
        for (what, count) in [
            ("cycles were skipped: the machine woke more than a cycle late", {
                end.cycles_skipped - begin.cycles_skipped
            }),
            ("frames did not come back in time", end.frames_missed() - begin.frames_missed()),
            ("datagrams had a wrong working counter", {
                end.working_counter_errors - begin.working_counter_errors
            }),
            ("times the host lost its lock on the reference clock", outcome.locks_lost),
        ] {
            if count > 0 {
                notes.push(format!("{count} {what}"));
            }
        }
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
        // What another program sends on the same interface may be EtherCAT too.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_grew_in_operation_counts() {
        let counters = |missed| Counters { sm_event_missed: Some(missed), ..Counters::default() };
        let says = |before, after| complaint(0x1C32, &counters(before), &counters(after));
        let object = ObjectAddress::new(0x1C32, 0x0B);
        let missed = |grew, value| Some(Judged::SmEventMissed { object, grew, value });
        assert_eq!(says(7, 7), None);
        assert_eq!(says(7, 8), missed(1, 8));
        assert_eq!(says(7, 2), missed(2, 2));
        assert_eq!(says(7, 0), None);
        assert_eq!(complaint(0x1C32, &Counters::default(), &Counters::default()), None);
    }

    #[test]
    fn a_sync_error_counts_while_it_is_set() {
        let set = Counters { sync_error: Some(1), ..Counters::default() };
        let object = ObjectAddress::new(0x1C33, 0x20);
        let found = Some(Judged::SyncError { object, grew: None, value: 1 });
        assert_eq!(complaint(0x1C33, &set, &set), found);
        assert_eq!(complaint(0x1C33, &set, &Counters::default()), None);
    }
}
