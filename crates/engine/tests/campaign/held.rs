//! What the wire's verdict says, held against what happened.

use isocat_engine::verdict::{Answer, Gap, Verdict};
use isocat_maindevice::SegmentChange;
use isocat_sim::course::{Sign, Stretch};
use isocat_sim::{Fault, Finding, Judged, Kind};
use isocat_wire::time::{Nanos, Picos};

use crate::truth::{Truth, half};

/// How a verdict can be wrong.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum Mistake {
    /// Something was lost and the answer is "in sync".
    UndetectedLoss,
    /// The same, and nothing on any wire could have shown it.
    OutOfSight,
    /// A finding of something that did not happen.
    FalseAlarm,
    /// A finding about a SubDevice that nothing happened to, where others lost something.
    WrongName,
    /// In sync again, but not within the time planned for it.
    LateRecovery,
    /// Not in sync again, however long it was waited for.
    NoRecovery,
}

/// What is wrong with a verdict, and the finding or SubDevice that shows it.
pub fn hold(verdict: &Verdict, truth: &Truth, limit: Nanos) -> Vec<(Mistake, String)> {
    let mut wrong = Vec::new();
    if verdict.answer() == Answer::InSync && !truth.losses.is_empty() {
        let kind =
            if truth.is_out_of_sight() { Mistake::OutOfSight } else { Mistake::UndetectedLoss };
        wrong.push((kind, format!("{:?}", truth.losses)));
    }
    for finding in verdict.findings.iter().filter(|found| !is_true(found, truth, limit)) {
        let named = finding.place.device.is_some() && !truth.losses.is_empty();
        let kind = if named { Mistake::WrongName } else { Mistake::FalseAlarm };
        wrong.push((kind, format!("{:?} {:?}", finding.place.device, finding.kind)));
    }
    wrong
}

/// Whether what a finding says did happen.
fn is_true(finding: &Finding, truth: &Truth, limit: Nanos) -> bool {
    let of_device = finding.place.device.is_some_and(|device| truth.lost(device));
    match &finding.kind {
        Kind::Judged(kind) => of_device || is_true_judgement(kind, finding, truth, limit),
        // Those that are told of the segment say how it is now: it did change if anything was lost.
        Kind::Change(SegmentChange::ReferenceElected { .. } | SegmentChange::Unplanned { .. }) => {
            !truth.losses.is_empty()
        }
        Kind::Change(SegmentChange::Lost { .. }) => of_device || truth.wires_were_touched(),
        Kind::Change(_) => of_device,
    }
}

fn is_true_judgement(kind: &Judged, finding: &Finding, truth: &Truth, limit: Nanos) -> bool {
    let frames_were_touched =
        truth.any(|fault| matches!(fault, Fault::Frames(_))) || truth.time_was_touched();
    let by_itself = finding.place.device.is_some_and(|device| truth.misbehaves(device));
    let error = finding.place.device.and_then(|device| truth.worst_sync0.get(device));
    match kind {
        Judged::FramesLost { .. } => truth.witness.lost > 0 || frames_were_touched,
        // Those without outputs lose nothing by it.
        Judged::NoAnswer => truth.wires_were_touched(),
        // Two frames that came one behind the other.
        Judged::CycleTimeTooSmall { .. } => frames_were_touched,
        // It says so itself, and it is what it was made to do.
        Judged::ShiftTimeTooShort { .. } | Judged::SmEventMissed { .. } => by_itself,
        Judged::WorkingCounter { .. } => {
            truth.witness.lost > 0 || truth.wires_were_touched() || !truth.losses.is_empty()
        }
        Judged::CountChanged { .. } => truth.wires_were_touched(),
        Judged::CyclesSkipped { .. } | Judged::HostNotLocked { .. } => {
            truth.time_was_touched() || !truth.losses.is_empty()
        }
        // By the times that the SubDevice states: it may be faster than that.
        Judged::FramesTooLate { .. } | Judged::FramesTooEarly { .. } => frames_were_touched,
        // What 0x092C shows spreads around what is so.
        Judged::ClockOff { .. } => error.is_some_and(|error| *error > half(limit)),
        Judged::DelayChanged { .. } => {
            truth.any(|fault| matches!(fault, Fault::Recable { .. } | Fault::Replace { .. }))
        }
        _ => false,
    }
}

/// Whether the segment did not come back in time, where it can.
pub fn no_recovery(truth: &Truth, bound: Nanos) -> Option<(Mistake, String)> {
    let until = truth.last_fault()? + Picos::from(bound);
    let is_late = |stretch: &&Stretch| stretch.open || stretch.to > until;
    let late = truth.stretches.iter().filter(is_late).find(|stretch| !takes_longer(stretch, truth));
    late.filter(|_| until <= truth.ended).map(|stretch| {
        let took = (stretch.to - until).0 / 1_000_000_000;
        let kind = if stretch.open { Mistake::NoRecovery } else { Mistake::LateRecovery };
        (kind, format!("{took} ms beyond it: {stretch:?}"))
    })
}

/// What no MainDevice shortens: the loop of an ESC follows its crystal at a pace of its own, and a delay that is no longer
/// right stays until somebody has it written anew.
fn takes_longer(stretch: &Stretch, truth: &Truth) -> bool {
    let moves = |fault: &Fault| match fault {
        Fault::Clock { .. } => true,
        Fault::Recable { takes, .. } => *takes < UNSEEN,
        _ => false,
    };
    stretch.sign == Sign::Sync0Off && truth.any(moves)
}

/// A cable that is away for less loses no link.
const UNSEEN: Nanos = Nanos::micros(15);

/// Whether clocks near their limit, on this side of it or just beyond, are all that speaks against a segment.
pub fn near_limit(verdict: &Verdict) -> bool {
    let near = |finding: &Finding| match finding.kind {
        Kind::Judged(Judged::ClockOff { difference, limit }) => difference.abs().0 < 2 * limit.0,
        _ => false,
    };
    let mut open = verdict.unknown.iter().filter(|open| open.kind.decides());
    verdict.findings.iter().all(near)
        && open.all(|open| matches!(open.kind, Gap::ClockNearLimit { .. }))
}
