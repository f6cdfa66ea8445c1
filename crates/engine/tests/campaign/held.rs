//! Compares the wire's verdict with what happened.

use isocat_engine::verdict::{Answer, Gap, Verdict};
use isocat_maindevice::SegmentChange;
use isocat_sim::course::{Sign, Stretch};
use isocat_sim::{Fault, Finding, Judged, Kind};
use isocat_wire::time::{Nanos, Picos};

use crate::truth::{Truth, half};

/// A kind of wrong verdict.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum Mistake {
    /// There was a loss, and the answer is "in sync".
    UndetectedLoss,
    /// The same, but no wire could have shown it.
    OutOfSight,
    /// A finding of something that did not happen.
    FalseAlarm,
    /// A finding about a SubDevice without a loss, while others had one.
    WrongName,
    /// In sync again, but not within the time planned for it.
    LateRecovery,
    /// Not in sync again until the end.
    NoRecovery,
}

/// The mistakes of a verdict, with the finding or SubDevice that shows each.
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

/// Whether the statement of a finding is true.
fn is_true(finding: &Finding, truth: &Truth, limit: Nanos) -> bool {
    let of_device = finding.place.device.is_some_and(|device| truth.lost(device));
    match &finding.kind {
        Kind::Judged(kind) => of_device || is_true_judgement(kind, finding, truth, limit),
        // These findings are about the segment at present: it did change if anything was lost.
        Kind::Change(SegmentChange::ReferenceElected { .. } | SegmentChange::Unplanned { .. }) => {
            !truth.losses.is_empty()
        }
        Kind::Change(SegmentChange::Lost { .. }) => of_device || truth.wires_were_touched(),
        // The engine holds nothing against claims.
        Kind::Change(_) | Kind::Breach(_) => of_device,
    }
}

fn is_true_judgement(kind: &Judged, finding: &Finding, truth: &Truth, limit: Nanos) -> bool {
    let frames_were_touched =
        truth.any(|fault| matches!(fault, Fault::Frames(_))) || truth.time_was_touched();
    let by_itself = finding.place.device.is_some_and(|device| truth.misbehaves(device));
    let error = finding.place.device.and_then(|device| truth.worst_sync0.get(device));
    match kind {
        Judged::FramesLost { .. } => truth.witness.lost > 0 || frames_were_touched,
        Judged::NothingCameBack { .. } => truth.wires_were_touched() || frames_were_touched,
        Judged::AnswersLate { .. } => frames_were_touched,
        // SubDevices without outputs lose nothing by it.
        Judged::NoAnswer => truth.wires_were_touched(),
        // The cause is two frames in quick succession.
        Judged::CycleTimeTooSmall { .. } => frames_were_touched,
        // The SubDevice reports it, and it was made to misbehave.
        Judged::ShiftTimeTooShort { .. } | Judged::SmEventMissed { .. } => by_itself,
        Judged::WorkingCounter { .. } => {
            truth.witness.lost > 0 || truth.wires_were_touched() || !truth.losses.is_empty()
        }
        Judged::CountChanged { .. } => truth.wires_were_touched(),
        Judged::CyclesSkipped { .. } | Judged::HostNotLocked { .. } => {
            truth.time_was_touched() || !truth.losses.is_empty()
        }
        // The finding uses the times that the SubDevice states: the device may be faster than that.
        Judged::FramesTooLate { .. } | Judged::FramesTooEarly { .. } => frames_were_touched,
        // The values of 0x092C are spread around the true one.
        Judged::ClockOff { .. } => error.is_some_and(|error| *error > half(limit)),
        Judged::DelayChanged { .. } => {
            truth.any(|fault| matches!(fault, Fault::Recable { .. } | Fault::Replace { .. }))
        }
        _ => false,
    }
}

/// Whether a segment that can come back in time did not do so.
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

/// Whether no MainDevice can shorten the time: the loop of an ESC follows its crystal at its own
/// pace, and a wrong delay stays until it is written again.
fn takes_longer(stretch: &Stretch, truth: &Truth) -> bool {
    let moves = |fault: &Fault| match fault {
        Fault::Clock { .. } => true,
        Fault::Recable { takes, .. } => *takes < UNSEEN,
        _ => false,
    };
    stretch.sign == Sign::Sync0Off && truth.any(moves)
}

/// A cable that is unplugged for a shorter time loses no link.
const UNSEEN: Nanos = Nanos::micros(15);

/// Whether the only reason against a segment is clocks near their limit, on either side.
pub fn near_limit(verdict: &Verdict) -> bool {
    let near = |finding: &Finding| match finding.kind {
        Kind::Judged(Judged::ClockOff { difference, limit }) => difference.abs().0 < 2 * limit.0,
        _ => false,
    };
    let mut open = verdict.unknown.iter().filter(|open| open.kind.decides());
    verdict.findings.iter().all(near)
        && open.all(|open| matches!(open.kind, Gap::ClockNearLimit { .. }))
}
