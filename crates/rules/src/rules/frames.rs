//! The cyclic frames: their cycle, their phase, their senders, and the time that they distribute.

use isocat_wire::time::Nanos;

use crate::book::Findings;
use crate::breach::Breach;
use crate::claims::Claims;
use crate::evidence::{Evidence, Slide};

pub(crate) fn cycle(claims: &Claims, evidence: &Evidence, findings: &mut Findings<'_>) {
    let Some(wanted) = claims.cycle else { return };
    let Some(found) = evidence.cycle else { return findings.unknown(None) };
    if is_other_cycle(claims, evidence) {
        findings.broken(None, Breach::OtherCycle { wanted, found });
    } else {
        findings.kept();
    }
}

/// Whether frames are known to follow each other at another cycle, so that what lies between them
/// and SYNC0 follows from that.
pub(crate) fn is_other_cycle(claims: &Claims, evidence: &Evidence) -> bool {
    let both = claims.cycle.zip(evidence.cycle);
    both.is_some_and(|(wanted, found)| (found - wanted).0.abs() > wanted.0 / CYCLE_PART)
}

pub(crate) fn steady(claims: &Claims, evidence: &Evidence, findings: &mut Findings<'_>) {
    // Only SYNC0 makes the phase of frames matter.
    let timed = evidence.devices.iter().any(|device| device.sync0_cycle.is_some());
    let Some(cycle) = claims.cycle.or(evidence.cycle).filter(|_| timed) else { return };
    let Some(slide) = evidence.slide else { return findings.unknown(None) };
    if !slides(evidence) {
        return findings.kept();
    }
    let speed = slide.per_second.0.abs();
    let half_cycle_after = Nanos((i128::from(cycle.0) * 500_000_000 / i128::from(speed)) as i64);
    let per_second = slide.per_second;
    findings.broken(None, Breach::FramesSlide { per_second, half_cycle_after });
}

/// Whether frames are known to slide, so that they have no place in the cycle.
pub(crate) fn slides(evidence: &Evidence) -> bool {
    let sure = |slide: Slide| slide.per_second.0.abs() > STEADY.0.max(SURE * slide.uncertainty.0);
    evidence.slide.is_some_and(sure)
}

pub(crate) fn one_talker(_: &Claims, evidence: &Evidence, findings: &mut Findings<'_>) {
    let Some(talkers) = &evidence.talkers else { return findings.unknown(None) };
    let mut frames: alloc::vec::Vec<_> = talkers.clone();
    frames.sort_unstable_by(|one, other| other.cmp(one));
    match frames.get(1).filter(|frames| **frames >= TALKS) {
        Some(frames) => findings.broken(None, Breach::SeveralTalkers { frames: *frames }),
        None => findings.kept(),
    }
}

pub(crate) fn taken(_: &Claims, evidence: &Evidence, findings: &mut Findings<'_>) {
    // Only where a program runs in virtual time its sockets can be seen; elsewhere it is no claim.
    let Some([frames, of]) = evidence.untaken else { return };
    // A program that always sends first works with inputs that are a cycle old, as it means to.
    let counts = |frames: u64| frames >= UNTAKEN.max(of / UNTAKEN_PART);
    if counts(frames) && counts(of.saturating_sub(frames)) {
        findings.broken(None, Breach::AnswersUntaken { frames, of });
    } else {
        findings.kept();
    }
}

pub(crate) fn time(claims: &Claims, evidence: &Evidence, findings: &mut Findings<'_>) {
    let timed = evidence.devices.iter().filter(|device| device.sync0_cycle.is_some()).count();
    if timed < 2 {
        return;
    }
    let Some(gap) = evidence.longest_drift_gap else { return findings.unknown(None) };
    let limit = longest_gap(claims, evidence);
    if gap <= limit {
        findings.kept();
    } else {
        findings.broken(None, Breach::TimeNotDistributed { gap, limit });
    }
}

/// The longest time without a drift datagram: clocks that the loop has set to one rate keep it to
/// some parts per million, and temperature changes no quartz faster.
fn longest_gap(claims: &Claims, evidence: &Evidence) -> Nanos {
    let limit = claims.sync0_limit.0.max(1);
    // A slow bus can't send more often.
    let cycles = evidence.cycle.map_or(0, |cycle| 10 * cycle.0);
    Nanos((limit * 1_000_000 / KEPT_PPM).max(cycles))
}

/// Frames of another sender that are no MainDevice yet: a look at a register by hand.
const TALKS: u64 = 8;
/// Answers that a program leaves behind after stalls of its machine are fewer: in number, and a
/// hundredth of all.
const UNTAKEN: u64 = 8;
const UNTAKEN_PART: u64 = 100;
/// The part of the cycle by which the mean time between frames may differ: a fiftieth.
const CYCLE_PART: i64 = 50;
/// Slower than this frames do not slide but follow their servo: a part per million.
const STEADY: Nanos = Nanos(1_000);
/// A slide is sure if it is that many times its uncertainty.
const SURE: i64 = 4;
/// How well a clock keeps the rate to which its loop has set it, parts per million.
const KEPT_PPM: i64 = 5;
