//! Process data: present, carried, with an address of their own, guarded.

use core::ops::Range;

use isocat_sync::interpolation;
use isocat_wire::time::Nanos;

use super::operating;
use crate::book::Findings;
use crate::breach::Breach;
use crate::claims::Claims;
use crate::evidence::Evidence;

pub(crate) fn present(claims: &Claims, evidence: &Evidence, findings: &mut Findings<'_>) {
    for (at, _, seen) in operating(claims, evidence).filter(|(_, claim, _)| claim.has_data) {
        match seen.lengths {
            None => findings.unknown(Some(at)),
            Some([0, 0]) => findings.broken(Some(at), Breach::NoProcessData),
            Some(_) => findings.kept(),
        }
    }
}

pub(crate) fn carried(claims: &Claims, evidence: &Evidence, findings: &mut Findings<'_>) {
    for (at, _, seen) in operating(claims, evidence) {
        let Some(lengths) = seen.lengths else {
            findings.unknown(Some(at));
            continue;
        };
        for (direction, carried) in seen.exchanged.into_iter().enumerate() {
            match carried {
                _ if lengths[direction] == 0 => {}
                None => findings.unknown(Some(at)),
                Some(true) => findings.kept(),
                Some(false) => {
                    let outputs = direction == 0;
                    findings.broken(Some(at), Breach::NotCarried { outputs });
                }
            }
        }
    }
}

pub(crate) fn each_cycle(claims: &Claims, evidence: &Evidence, findings: &mut Findings<'_>) {
    // Where all frames come more seldom, that is said already.
    let slower = match (claims.cycle, evidence.cycle) {
        (Some(wanted), Some(found)) if found > wanted => (found.0, wanted.0),
        _ => (1, 1),
    };
    for (at, claim, seen) in operating(claims, evidence) {
        let Some(wanted) = claim.cycle else { continue };
        let Some(lengths) = seen.lengths else {
            findings.unknown(Some(at));
            continue;
        };
        let most = i128::from(wanted.0) * i128::from(slower.0) * 5 / 4;
        for (direction, carried_each) in seen.carried_each.into_iter().enumerate() {
            match carried_each {
                // Where nothing is carried, that is said already.
                _ if lengths[direction] == 0 || seen.exchanged[direction] != Some(true) => {}
                None => findings.unknown(Some(at)),
                Some(found) if i128::from(found.0) * i128::from(slower.1) <= most => {
                    findings.kept();
                }
                Some(found) => {
                    let outputs = direction == 0;
                    findings.broken(Some(at), Breach::CarriedSeldom { outputs, wanted, found });
                }
            }
        }
    }
}

pub(crate) fn interpolation(claims: &Claims, evidence: &Evidence, findings: &mut Findings<'_>) {
    for (at, claim, seen) in operating(claims, evidence) {
        let Some(wanted) = claim.interpolation else { continue };
        match seen.interpolation {
            // Nobody wrote it, and a drive that moves by itself needs none.
            None => {}
            Some(found) if interpolation::agrees(found, wanted) => findings.kept(),
            Some(found) => findings.broken(Some(at), Breach::OtherInterpolation { wanted, found }),
        }
    }
}

pub(crate) fn own_address(claims: &Claims, evidence: &Evidence, findings: &mut Findings<'_>) {
    for direction in 0..2 {
        let mut taken: alloc::vec::Vec<(Range<u64>, usize)> = alloc::vec::Vec::new();
        for (at, _, seen) in operating(claims, evidence) {
            let Some(logical) = &seen.logical else {
                // It is said once.
                if direction == 0 {
                    findings.unknown(Some(at));
                }
                continue;
            };
            let ranges = logical[direction].iter().cloned();
            taken.extend(ranges.map(|range| (range, at)));
        }
        taken.sort_by_key(|(range, at)| (range.start, *at));
        let mut furthest: Option<(u64, usize)> = None;
        for (range, at) in taken {
            match furthest {
                Some((end, with)) if range.start < end && with != at => {
                    let logical = (range.start / 8) as u32;
                    let outputs = direction == 0;
                    let (at, with) = (at.max(with), at.min(with));
                    findings.broken(Some(at), Breach::SharedAddress { with, outputs, logical });
                }
                _ => findings.kept(),
            }
            if furthest.is_none_or(|(end, _)| range.end > end) {
                furthest = Some((range.end, at));
            }
        }
    }
}

pub(crate) fn watchdog(claims: &Claims, evidence: &Evidence, findings: &mut Findings<'_>) {
    for (at, claim, seen) in operating(claims, evidence) {
        let Some(wanted) = claim.watchdog else { continue };
        match seen.watchdog {
            // Where nothing is guarded that is said already.
            _ if seen.guarded == Some(false) => {}
            _ if seen.lengths.is_some_and(|lengths| lengths[0] == 0) => {}
            None => findings.unknown(Some(at)),
            Some(found) if (found - wanted).abs() <= Nanos(wanted.0 / 10).max(STEP) => {
                findings.kept();
            }
            Some(found) => findings.broken(Some(at), Breach::OtherWatchdog { wanted, found }),
        }
    }
}

pub(crate) fn guarded(claims: &Claims, evidence: &Evidence, findings: &mut Findings<'_>) {
    for (at, _, seen) in operating(claims, evidence).filter(|(_, claim, _)| claim.guarded) {
        match seen.guarded {
            _ if seen.lengths.is_some_and(|lengths| lengths[0] == 0) => {}
            None => findings.unknown(Some(at)),
            Some(true) => findings.kept(),
            Some(false) => findings.broken(Some(at), Breach::WatchdogOff),
        }
    }
}

/// The step of a watchdog's time after power-on.
const STEP: Nanos = Nanos::micros(100);
