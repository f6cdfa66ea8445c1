//! SYNC0: mode, cycle, phase.

use isocat_sync::SyncMode;
use isocat_wire::time::{Nanos, Picos};

use super::frames::{self, slides};
use super::operating;
use crate::book::Findings;
use crate::breach::Breach;
use crate::claims::Claims;
use crate::evidence::Evidence;

pub(crate) fn mode(claims: &Claims, evidence: &Evidence, findings: &mut Findings<'_>) {
    for (at, claim, seen) in operating(claims, evidence) {
        let Some(wanted) = claim.mode else { continue };
        match seen.mode {
            None => findings.unknown(Some(at)),
            Some(found) if found == wanted => findings.kept(),
            Some(found) => {
                let activation = seen.activation;
                findings.broken(Some(at), Breach::OtherMode { wanted, found, activation });
            }
        }
    }
}

/// Whether the mode explains what SYNC0 does: it is known to be another one than was asked for, or
/// none was asked for and it is known to be one without SYNC0.
fn is_explained_by_mode(wanted: Option<SyncMode>, found: Option<SyncMode>) -> bool {
    match (wanted, found) {
        (_, None) => false,
        (Some(wanted), Some(found)) => wanted != found,
        // SYNC0 is another one where outputs act on SYNC1.
        (None, Some(found)) => !matches!(found, SyncMode::DcSync0 | SyncMode::DcShiftSync1),
    }
}

pub(crate) fn starts(claims: &Claims, evidence: &Evidence, findings: &mut Findings<'_>) {
    for (at, _, seen) in
        operating(claims, evidence).filter(|(_, _, seen)| seen.sync0_cycle.is_some())
    {
        match seen.sync0_overdue {
            None => findings.unknown(Some(at)),
            Some(Nanos::ZERO) => findings.kept(),
            Some(ago) => findings.broken(Some(at), Breach::StartPassed { ago }),
        }
    }
}

pub(crate) fn clock_kept(claims: &Claims, evidence: &Evidence, findings: &mut Findings<'_>) {
    // What the clocks of others say matters to SYNC0 alone.
    let timed = evidence.devices.iter().any(|device| device.sync0_cycle.is_some());
    for (at, _, seen) in operating(claims, evidence).filter(|_| timed) {
        match seen.clock_set {
            None => findings.unknown(Some(at)),
            Some(by) if by <= claims.sync0_limit.max(LEAST_JUMP) => findings.kept(),
            Some(by) => findings.broken(Some(at), Breach::ClockSet { by }),
        }
    }
}

/// A change of a clock that no MainDevice makes to keep it.
const LEAST_JUMP: Nanos = Nanos::micros(1);

pub(crate) fn sync0_cycle(claims: &Claims, evidence: &Evidence, findings: &mut Findings<'_>) {
    let pairs = claims.devices.iter().zip(&evidence.devices).enumerate();
    for (at, (claim, seen)) in pairs.filter(|(_, (claim, seen))| seen.operated || claim.operates) {
        let Some(wanted) = claim.sync0_cycle else { continue };
        match seen.sync0_cycle {
            _ if is_explained_by_mode(claim.mode, seen.mode) => {}
            Some(found) if found != wanted => {
                findings.broken(Some(at), Breach::OtherSync0Cycle { wanted, found });
            }
            // A wrong cycle may be why it did not come to OP; a right one is not yet kept there.
            _ if !seen.operated => {}
            None => findings.unknown(Some(at)),
            Some(_) => findings.kept(),
        }
    }
}

pub(crate) fn shift(claims: &Claims, evidence: &Evidence, findings: &mut Findings<'_>) {
    for (at, claim, seen) in operating(claims, evidence) {
        let (Some(wanted), Some(cycle)) = (claim.shift, claim.sync0_cycle.or(claims.cycle)) else {
            continue;
        };
        if is_explained_by_mode(claim.mode, seen.mode) || frames::is_other_cycle(claims, evidence) {
            continue;
        }
        // Of frames that slide there is no distance.
        let distance = seen.frame_to_sync0.filter(|_| !slides(evidence));
        let Some(found) = distance else {
            findings.unknown(Some(at));
            continue;
        };
        let cycle = Picos::from(cycle).0;
        let off = (found.0 - Picos::from(wanted).0).rem_euclid(cycle);
        // The frame takes some time to the SubDevice, and a host may send off the beginning of its
        // cycle. What is further off is no shift that was asked for.
        if off.min(cycle - off) <= cycle / 4 {
            findings.kept();
        } else {
            findings.broken(Some(at), Breach::OtherShift { wanted, found });
        }
    }
}

pub(crate) fn in_phase(claims: &Claims, evidence: &Evidence, findings: &mut Findings<'_>) {
    let devices = || operating(claims, evidence).filter(|(_, claim, _)| claim.in_phase);
    let mut first: Option<(usize, Nanos, Nanos)> = None;
    for (at, claim, seen) in devices() {
        if is_explained_by_mode(claim.mode, seen.mode) {
            continue;
        }
        let (Some(phase), Some(cycle)) = (seen.sync0_phase, seen.sync0_cycle) else {
            findings.unknown(Some(at));
            continue;
        };
        // Pulses of different cycles meet where the shorter cycle has one.
        let Some((from, of_first, cycle_of_first)) = first else {
            first = Some((at, phase, cycle));
            continue;
        };
        let shorter = cycle.min(cycle_of_first).0.max(1);
        let off = (phase.0 - of_first.0).rem_euclid(shorter);
        let by = Nanos(if off > shorter / 2 { off - shorter } else { off });
        if by.abs() <= claims.sync0_limit {
            findings.kept();
        } else {
            let limit = claims.sync0_limit;
            findings.broken(Some(at), Breach::Sync0Apart { from, by, limit });
        }
    }
}
