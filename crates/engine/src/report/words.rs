//! Sentences of findings: the only place where a kind and its figures become words.
//!
//! These sentences are for people only. Programs, diagnoses and pages use the kind.

use isocat_maindevice::SegmentChange;
use isocat_sim::{Judged, Kind};
use isocat_wire::time::{Nanos, Picos};

use super::Finding;
use crate::verdict::Gap;

/// The document that contains a sentence: the wording of a kind depends on who measured it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Family {
    /// A run in virtual time.
    Virtual,
    /// A run on a real interface.
    Wire,
    /// A served segment with an external MainDevice.
    Served,
}

/// The sentence of a finding, with its figures and its time.
pub fn sentence(kind: &Kind, since: Option<Nanos>, family: Family) -> String {
    let what = what(kind, family);
    match (since, family) {
        (None, _) => what,
        (Some(since), Family::Virtual | Family::Wire) => {
            format!("{what}, since {} into the run", seconds(since))
        }
        (Some(since), Family::Served) => {
            format!("{what}, {} after all were in OP", time(since.into()))
        }
    }
}

/// What was found, with its figures.
pub fn what(kind: &Kind, family: Family) -> String {
    match kind {
        Kind::Judged(kind) => judged(kind, family),
        Kind::Change(change) => change.to_string(),
        Kind::Breach(breach) => breach.to_string(),
    }
}

fn judged(kind: &Judged, family: Family) -> String {
    match kind {
        Judged::Failed { cause, .. } => cause.to_string(),
        Judged::TooLong => "the segment did not reach OP in the time allowed".into(),
        Judged::EndedEarly => "ended by a signal before all SubDevices were in OP".into(),
        Judged::NothingAnswers { interface, carrier, unprocessed } => {
            let reason = match (carrier, unprocessed) {
                (_, 1..) => {
                    "own frames come back that no SubDevice has processed: is it a loop or a switch?"
                }
                (Some(false), _) => {
                    "it has no carrier: no cable, or what is at its other end is off"
                }
                _ => "what is at its other end does not answer EtherCAT frames, or is off",
            };
            format!("no SubDevice answers on {interface}; {reason}")
        }
        Judged::Silence { interface, carrier } => {
            let cable = match carrier {
                Some(false) => "it has no carrier: the cable was pulled, or its other end is off",
                _ => "it has a carrier: a cable further on was pulled, or the segment is off",
            };
            format!("nothing comes back on {interface} any more; {cable}")
        }
        Judged::CommandFailed { what } => what.clone(),
        Judged::InterfaceFailed { error } => error.clone(),
        Judged::CountChanged { expected, found } => {
            format!("{found} SubDevices answer, {expected} at the scan")
        }
        Judged::LeftOp { state, code } => format!("left OP for {state}, AL status code {code}"),
        Judged::NotInOp { state, code } => {
            format!("is in {state} at the end, AL status code {code}")
        }
        Judged::NoAnswer => "does not answer at the end".into(),
        Judged::MissedEvents { count, outputs } => {
            let what = match outputs {
                true => "SYNC0 came before the outputs were copied and calculated",
                false => "SYNC0 came before the inputs were read again",
            };
            format!("{what}, {count} times")
        }
        Judged::Sync0OffGrid { error, limit, worst } => {
            let what = format!("SYNC0 {} off the grid, limit {}", us(*error), us(*limit));
            match family {
                Family::Served => what,
                Family::Virtual | Family::Wire => format!("{what}, later up to {}", us(*worst)),
            }
        }
        Judged::SyncStillActive { sync0, sync1, acknowledged } => {
            let lost = match (sync0, sync1) {
                (count, 0) => format!("{count} pulses of SYNC0"),
                (0, count) => format!("{count} pulses of SYNC1"),
                (sync0, sync1) => format!("{sync0} pulses of SYNC0 and {sync1} of SYNC1"),
            };
            let why = match acknowledged {
                true => "the one before was not acknowledged yet (0x098E, 0x098F)",
                false => "the one before was still active: it is longer than the cycle (0x0982)",
            };
            format!("{lost} made no edge: {why}")
        }
        Judged::NoSync0 => "no SYNC0 pulse at all".into(),
        Judged::ModeNotAsked { object } => format!(
            "its mailbox does not answer ({object}), so that it could not be asked for its mode; \
             it is in Free Run, which nobody chose"
        ),
        Judged::Sync0WithoutSpread => "SYNC0 without any spread: too good to be measured".into(),
        Judged::OutputsUneven { spread, limit } => {
            let (spread, limit) = (us(*spread), us(*limit));
            format!("outputs follow SYNC0 with a spread of {spread}, limit {limit}")
        }
        Judged::OutputsLate { cycles, count, age } => format!(
            "outputs act {} late, {count} times: up to {} after their frame left the MainDevice",
            whole_cycles(*cycles),
            time(*age)
        ),
        Judged::InputsLate { cycles, count, age } => format!(
            "inputs arrive {} late, {count} times: up to {} after Input Latch",
            whole_cycles(*cycles),
            time(*age)
        ),
        Judged::SamplesIncomplete { outputs, expected, found, count } => {
            let direction = if *outputs { "output" } else { "input" };
            let sets = if *count == 1 { "1 set".into() } else { format!("{count} sets") };
            format!(
                "{sets} of {direction} samples not whole: the first has {found}, expected {expected}"
            )
        }
        Judged::SmEventMissed { object, grew, value } => {
            format!("SM event missed: {object} grew by {grew} to {value}")
        }
        Judged::CycleTimeTooSmall { object, grew, value } => {
            format!("cycle time too small: {object} {}", grown(*grew, *value))
        }
        Judged::ShiftTimeTooShort { object, grew, value } => {
            format!("shift time too short: {object} {}", grown(*grew, *value))
        }
        Judged::SyncError { object, grew: None, .. } => format!("sync error: {object} is set"),
        Judged::SyncError { object, grew, value } => {
            format!("sync error: {object} {}", grown(*grew, *value))
        }
        Judged::ClockOff { difference, limit } => {
            format!("its clock is {difference} from the reference (0x092C), limit {limit}")
        }
        Judged::FramesTooLate { cycles, by } => {
            let cycles = in_cycles(*cycles);
            format!(
                "outputs came up to {by} too late for SYNC0 {cycles}, by the times that it states"
            )
        }
        Judged::FramesTooEarly { cycles, by } => {
            let cycles = in_cycles(*cycles);
            format!("frames came up to {by} too early for its inputs or outputs {cycles}")
        }
        Judged::DelayChanged { written, found } => {
            let found = us(*found);
            format!(
                "its delay is {found} and no longer the {written} that were written: a cable was changed"
            )
        }
        Judged::DriveNotEnabled => "drive never reached operation enabled".into(),
        Judged::WorkingCounter { datagrams } => {
            format!("working counter of process data wrong in {datagrams} datagrams")
        }
        Judged::CyclesSkipped { cycles } => match (family, cycles) {
            (Family::Virtual | Family::Served, _) => format!("the host skipped {cycles} cycles"),
            (Family::Wire, cycles) => {
                let cycles = match cycles {
                    1 => "1 cycle was".into(),
                    cycles => format!("{cycles} cycles were"),
                };
                format!("{cycles} skipped: the machine woke too late, no frame left in them")
            }
        },
        Judged::NothingCameBack { lasted, frames } => {
            format!("no frame came back for {lasted}: {frames} were sent")
        }
        Judged::FramesLost { frames: 1 } => "1 frame did not come back in time".into(),
        Judged::FramesLost { frames } => format!("{frames} frames did not come back in time"),
        Judged::AnswersLate { frames: 1 } => "1 answer came a cycle late or later".into(),
        Judged::AnswersLate { frames } => {
            format!("{frames} answers came a cycle late or later")
        }
        Judged::HostNotLocked { holdover } => {
            let state = if *holdover { "hears nothing from" } else { "is not locked onto" };
            format!("the host {state} the reference clock")
        }
        Judged::Found { cycle } => format!("found in cycle {cycle}"),
        Judged::AlwaysAbsent => "optional, absent all the time".into(),
    }
}

/// What is not known, and why.
pub fn gap(gap: &Gap) -> String {
    match gap {
        Gap::FrameTimes { cycles } => format!(
            "when frames came is not known {}: no time of the reference clock came back",
            in_cycles(*cycles)
        ),
        Gap::OutputsMaybeLate { cycles, by } => format!(
            "outputs may have been late {}: up to {by} with the worst clocks",
            in_cycles(*cycles)
        ),
        Gap::FramesMaybeEarly { cycles, by } => format!(
            "frames may have been too early {}: up to {by} with the worst clocks",
            in_cycles(*cycles)
        ),
        Gap::ReturnedLate { frames } => {
            let frames = if *frames == 1 { "1 frame".into() } else { format!("{frames} frames") };
            format!("{frames} came back when the next cycle had begun: outputs or inputs may be a cycle late")
        }
        Gap::NothingTells => {
            "it has no counter of missed events, and no plan says how late its frames may be".into()
        }
        Gap::CountersNotRead => "its counters (0x1C32, 0x1C33) could not be read".into(),
        Gap::ClockNotRead => "its clock (0x092C) was not read while the segment ran".into(),
        Gap::ClocksNotLed { cycles } => {
            format!("drift frames did not reach all clocks for {cycles} cycles: 0x092C told nothing then")
        }
        Gap::ClockNearLimit { bound, limit } => {
            format!("its clock may have been up to {bound} off between readings, limit {limit}")
        }
        Gap::BackgroundOff => {
            "nothing is read in the background: what happened between beginning and end is not known".into()
        }
        Gap::EventsDropped { count } => format!("{count} events were dropped"),
        Gap::OwnMisses { longest } => format!(
            "misses that it causes itself and pays off within {longest}, the longest time between two \
             readings of its counter"
        ),
        Gap::NoCounter => "misses that it causes itself: it counts none".into(),
        Gap::DelaysNotWatched => "cables that are exchanged: delays are not measured while it runs".into(),
        Gap::Pins => "how evenly outputs follow SYNC0 at the pins".into(),
    }
}

fn in_cycles(cycles: u64) -> String {
    match cycles {
        1 => "in 1 cycle".into(),
        more => format!("in {more} cycles"),
    }
}

fn whole_cycles(cycles: u64) -> String {
    match cycles {
        1 => "1 cycle".into(),
        more => format!("{more} cycles"),
    }
}

fn grown(grew: Option<u32>, value: u32) -> String {
    match grew {
        Some(grew) => format!("grew by {grew} to {value}"),
        None => format!("= {value}"),
    }
}

/// The verdict of a run that is not in sync: its first finding, and the number of the others.
pub(super) fn verdict(findings: &[Finding]) -> Option<String> {
    let (first, others) = findings.split_first()?;
    let others = match others.len() {
        0 => String::new(),
        more => format!("; {more} more below"),
    };
    let left_out =
        |finding: &Finding| matches!(finding.kind, Kind::Change(SegmentChange::LeftOut { .. }));
    // What was asked for with the wish to go on without those that fail.
    let head = if findings.iter().all(left_out) { "In sync except" } else { "Not in sync" };
    Some(format!("{head}: {}{others}.", first.sentence()))
}

impl Finding {
    /// The finding with the device it concerns.
    pub fn sentence(&self) -> String {
        match (&self.stage, &self.device, self.position) {
            // What the MainDevice says of a stage names the SubDevice itself.
            (Some(stage), _, _) => format!("{stage}: {}", self.what),
            (None, Some(name), Some(position)) => {
                format!("SubDevice {position} ({name}): {}", self.what)
            }
            _ => self.what.clone(),
        }
    }
}

/// A time such as `12.345 s`.
pub fn seconds(span: Nanos) -> String {
    let ms = span.0 / 1_000_000;
    format!("{}.{:03} s", ms / 1000, ms % 1000)
}

/// A time in the unit that reads best.
pub fn time(span: Picos) -> String {
    match span.0.abs() {
        0..=999_999_999 => us(span),
        ps if ps < 1_000_000_000_000 => format!("{:.3} ms", span.0 as f64 / 1e9),
        _ => format!("{:.3} s", span.0 as f64 / 1e12),
    }
}

/// A time such as `412.345 us`.
pub fn us(span: Picos) -> String {
    format!("{:.3} us", span.0 as f64 / 1e6)
}
