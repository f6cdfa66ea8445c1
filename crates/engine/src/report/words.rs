//! Sentences of findings: the only place where a kind and its figures become words.
//!
//! Nothing reads these sentences but people. Programs, diagnoses and pages go by the kind.

use isocat_maindevice::SegmentChange;
use isocat_sim::{Judged, Kind};
use isocat_wire::time::{Nanos, Picos};

use super::Finding;

/// The document that a sentence is for: what is said of one kind depends on who measured it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Family {
    /// A run in virtual time.
    Virtual,
    /// A run on a real interface.
    Wire,
    /// A served segment with a MainDevice from outside.
    Served,
}

/// The sentence of a finding, with its figures and since when.
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
        Judged::NoSync0 => "no SYNC0 pulse at all".into(),
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
                format!(
                    "{cycles} skipped: the machine woke too late, SYNC0 came without new outputs"
                )
            }
        },
        Judged::FramesLost { frames } => format!("{frames} frames did not come back in time"),
        Judged::HostNotLocked { holdover } => {
            let state = if *holdover { "hears nothing from" } else { "is not locked onto" };
            format!("the host {state} the reference clock")
        }
        Judged::Found { cycle } => format!("found in cycle {cycle}"),
        Judged::AlwaysAbsent => "optional, absent all the time".into(),
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

/// What a run came to that is not in sync: its first finding, and how many there are beside it.
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

/// `12.345 s`
pub fn seconds(span: Nanos) -> String {
    let ms = span.0 / 1_000_000;
    format!("{}.{:03} s", ms / 1000, ms % 1000)
}

/// In the unit that reads best.
pub fn time(span: Picos) -> String {
    match span.0.abs() {
        0..=999_999_999 => us(span),
        ps if ps < 1_000_000_000_000 => format!("{:.3} ms", span.0 as f64 / 1e9),
        _ => format!("{:.3} s", span.0 as f64 / 1e12),
    }
}

/// `412.345 us`
pub fn us(span: Picos) -> String {
    format!("{:.3} us", span.0 as f64 / 1e6)
}
