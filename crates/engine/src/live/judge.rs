//! What speaks against the segment being in sync, by what was read from it; and what else a reader ought
//! to know.

use isocat_host::Traffic;
use isocat_maindevice::statistics::Statistics;
use isocat_maindevice::{Cause, Stage};
use isocat_sim::run::Counters;
use isocat_sync::object::{INPUT_PARAMETER, OUTPUT_PARAMETER};
use isocat_sync::phase;
use isocat_wire::time::Nanos;
use isocat_wire::{AlState, AlStatus};

use super::job::{AtEnd, End, Noted, Outcome, SILENCE};
use crate::report::interface::seconds;

/// Something that keeps the segment from being in sync.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Finding {
    /// The SubDevice; `None` concerns the segment.
    pub device: Option<usize>,
    /// Stage of the way up; `None` in operation.
    pub stage: Option<Stage>,
    /// Since when, from the beginning of the time in operation; `None` if from the start.
    pub since: Option<Nanos>,
    /// What, with the figures.
    pub what: String,
}

/// Judges an outcome: fills in its findings, in the order of time.
pub(super) fn judge(
    outcome: &mut Outcome,
    noted: &Noted,
    interface: &str,
    carrier: Option<bool>,
    difference_limit: Nanos,
) {
    let mut findings = Vec::new();
    let segment = |stage, since, what| Finding { device: None, stage, since, what };
    let nothing_came = outcome.statistics.1.frames_received == 0;
    match &outcome.end {
        End::Failed(error) if nothing_came && is_lost(&error.cause) => {
            let what = nothing_comes(interface, carrier, outcome.figures.unprocessed);
            findings.push(segment(Some(error.stage), None, what));
        }
        End::Failed(error) => findings.push(Finding {
            device: error.cause.place().map(|place| place.position),
            stage: Some(error.stage),
            since: None,
            what: error.cause.to_string(),
        }),
        End::TooLong => {
            let what = "the segment did not reach OP in the time allowed".to_owned();
            findings.push(segment(None, None, what));
        }
        End::Asked if outcome.judged.is_none() => {
            let what = "ended by a signal before all SubDevices were in OP".to_owned();
            findings.push(segment(None, None, what));
        }
        End::Link(error) => {
            let what = error.to_string().replace('\n', "; ");
            findings.push(segment(None, outcome.judged, what));
        }
        End::Silence => {
            let cable = match carrier {
                Some(false) => "it has no carrier: the cable was pulled, or its other end is off",
                _ => "it has a carrier: a cable further on was pulled, or the segment is off",
            };
            let what = format!("nothing comes back on {interface} any more; {cable}");
            let since = outcome.judged.map(|judged| judged - SILENCE);
            findings.push(segment(None, since, what));
        }
        End::Time | End::Asked => {}
    }
    for (expected, found, since) in noted.counts.iter().take(1) {
        let what = format!("{found} SubDevices answer, {expected} at the scan");
        findings.push(segment(None, Some(*since), what));
    }
    for (device, what, since) in &noted.changes {
        let (device, since, what) = (*device, Some(*since), what.clone());
        findings.push(Finding { device, stage: None, since, what });
    }
    for position in 0..outcome.devices.len() {
        let found = judge_device(outcome, noted, position, difference_limit);
        findings.extend(found.into_iter().map(|(since, what)| Finding {
            device: Some(position),
            stage: None,
            since,
            what,
        }));
    }
    findings.extend(skipped(outcome).map(|(since, what)| segment(None, since, what)));
    let with_clock = outcome.segment.reference.is_some();
    if outcome.judged.is_some() && with_clock && outcome.phase != Some(phase::State::Locked) {
        let state = match outcome.phase {
            Some(phase::State::Holdover) => "hears nothing from",
            _ => "is not locked onto",
        };
        findings.push(segment(None, None, format!("the host {state} the reference clock")));
    }
    // What came first is nearest to the cause; what has no time of its own comes last.
    findings.sort_by_key(|finding| finding.since.unwrap_or(Nanos(i64::MAX)));
    outcome.findings = findings;
}

/// Cycles in which SYNC0 came and no outputs did. Counters of SubDevices may have gone down again since.
fn skipped(outcome: &Outcome) -> Option<(Option<Nanos>, String)> {
    outcome.judged?;
    let (begin, end) = &outcome.statistics;
    let count = end.cycles_skipped - begin.cycles_skipped;
    let waits = outcome.segment.devices.iter().any(|device| device.mode.uses_dc());
    let cycles = if count == 1 { "1 cycle was" } else { &format!("{count} cycles were") };
    (count > 0 && waits).then(|| {
        let what =
            format!("{cycles} skipped: the machine woke too late, SYNC0 came without new outputs");
        (outcome.stall.map(|(_, since)| since), what)
    })
}

/// What speaks against one SubDevice, and since when.
fn judge_device(
    outcome: &Outcome,
    noted: &Noted,
    position: usize,
    limit: Nanos,
) -> Vec<(Option<Nanos>, String)> {
    let mut findings = Vec::new();
    let at_end = &outcome.devices[position];
    let mut changes = noted.states.iter().filter(|(at, ..)| *at == position);
    if let Some((_, status, code, since)) = changes.next() {
        findings.push((Some(*since), format!("left OP for {status}, AL status code {code}")));
    } else {
        match at_end.status {
            Some((status, _)) if status == AlStatus::new(AlState::Op) => {}
            Some((status, code)) => {
                findings.push((None, format!("is in {status} at the end, AL status code {code}")))
            }
            // Silence and a dead interface are told for the segment.
            None if matches!(outcome.end, End::Silence | End::Link(_)) => {}
            None => findings.push((None, "does not answer at the end".to_owned())),
        }
    }
    findings.extend(counted(at_end).map(|what| (None, what)));
    let device = &outcome.segment.devices[position];
    let steered = device.mode.uses_dc() && outcome.segment.reference != Some(position);
    if let Some(difference) = at_end.difference.filter(|d| steered && d.abs() > limit) {
        let what = format!("its clock is {difference} from the reference (0x092C), limit {limit}");
        findings.push((None, what));
    }
    findings
}

/// What the SubDevice itself counted while in operation.
fn counted(at_end: &AtEnd) -> Option<String> {
    let outputs = complaint(OUTPUT_PARAMETER, &at_end.outputs_before, &at_end.outputs);
    // The inputs' object mirrors the outputs'.
    outputs.or_else(|| complaint(INPUT_PARAMETER, &at_end.inputs_before, &at_end.inputs))
}

fn complaint(index: u16, before: &Counters, after: &Counters) -> Option<String> {
    let rows = [
        ("SM event missed", "0B", before.sm_event_missed, after.sm_event_missed),
        ("cycle time too small", "0C", before.cycle_time_too_small, after.cycle_time_too_small),
        ("shift time too short", "0D", before.shift_time_too_short, after.shift_time_too_short),
    ];
    let grown = rows.into_iter().find_map(|(name, sub, before, after)| {
        let (before, after) = (before.unwrap_or(0), after?);
        // One that is smaller than before was set back, and then counted on.
        let by = after.checked_sub(before).unwrap_or(after);
        (by > 0).then(|| format!("{name}: 0x{index:04X}:{sub} grew by {by} to {after}"))
    });
    let set = after.sync_error.filter(|error| *error > 0);
    grown.or_else(|| set.map(|_| format!("sync error: 0x{index:04X}:20 is set")))
}

fn is_lost(cause: &Cause) -> bool {
    match cause {
        Cause::Access(error) => error.is_lost(),
        Cause::Silent { .. } => true,
        _ => false,
    }
}

/// Why a scan hears nothing, as far as it can be told from here.
fn nothing_comes(interface: &str, carrier: Option<bool>, unprocessed: u64) -> String {
    let reason = match (carrier, unprocessed) {
        (_, 1..) => {
            "own frames come back that no SubDevice has processed: is it a loop or a switch?"
        }
        (Some(false), _) => "it has no carrier: no cable, or what is at its other end is off",
        _ => "what is at its other end does not answer EtherCAT frames, or is off",
    };
    format!("no SubDevice answers on {interface}; {reason}")
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
            ("frames did not come back", end.frames_lost - begin.frames_lost),
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
        let late = total.frames_late + total.frames_echoed + figures.too_late;
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
        assert_eq!(says(7, 7), None);
        assert_eq!(says(7, 8).as_deref(), Some("SM event missed: 0x1C32:0B grew by 1 to 8"));
        assert_eq!(says(7, 2).as_deref(), Some("SM event missed: 0x1C32:0B grew by 2 to 2"));
        assert_eq!(says(7, 0), None);
        assert_eq!(complaint(0x1C32, &Counters::default(), &Counters::default()), None);
    }

    #[test]
    fn a_sync_error_counts_while_it_is_set() {
        let set = Counters { sync_error: Some(1), ..Counters::default() };
        assert!(complaint(0x1C33, &set, &set).is_some_and(|what| what.contains("0x1C33:20")));
        assert_eq!(complaint(0x1C33, &set, &Counters::default()), None);
    }
}
