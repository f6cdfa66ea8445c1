//! What is otherwise than it was meant, by the rulebook, beside what the frames alone show. Of two
//! findings about the same thing the one that explains more stays.

use isocat_rules::{Breach, Breached, Claims, Ruling};

use crate::evidence;
use crate::finding::{Finding, Kind};
use crate::observer::Observer;

/// The ruling about a capture; without claims there is nothing to check.
pub(crate) fn rule(observer: &Observer, claims: Option<&Claims>) -> Ruling {
    let judge = |claims| isocat_rules::judge(claims, &evidence::of(observer, claims));
    claims.map(judge).unwrap_or_default()
}

pub(super) fn judge(observer: &Observer, ruling: &Ruling, all: &mut Vec<Finding>) {
    for Breached { device, breach } in &ruling.breached {
        let place = device.and_then(|at| observer.devices.at(u16::try_from(at).ok()?));
        if all.iter().any(|own| says_more(own, breach, place)) {
            continue;
        }
        all.retain(|own| !says_less(own, breach, place));
        let (frame, at) = evidence::shown(observer, place, breach);
        let finding = Finding::new(Kind::Breached(breach.clone()), place, frame);
        all.push(Finding { at, ..finding });
    }
}

/// Whether a finding of the frames tells the breach with its cause, or to the frame.
fn says_more(own: &Finding, breach: &Breach, place: Option<usize>) -> bool {
    let of_device = own.device == place;
    match breach {
        Breach::NotOperated { .. } => {
            let down = matches!(
                own.kind,
                Kind::StayedBelow { .. }
                    | Kind::AlError { came_up: false, .. }
                    | Kind::LeftOp { .. }
                    | Kind::DeviceSilent {}
            );
            of_device && down
        }
        Breach::StartPassed { .. } => of_device && matches!(own.kind, Kind::StartInPast { .. }),
        Breach::TimeNotDistributed { .. } => {
            matches!(own.kind, Kind::NoDriftFrames {} | Kind::DriftFramesStopped { .. })
        }
        Breach::FramesSlide { .. } => matches!(own.kind, Kind::HostSlides { .. }),
        Breach::SeveralTalkers { .. } => matches!(own.kind, Kind::AnotherTalker { .. }),
        _ => false,
    }
}

/// Whether a finding of the frames is the effect of the breach alone.
fn says_less(own: &Finding, breach: &Breach, place: Option<usize>) -> bool {
    let of_device = own.device == place;
    match breach {
        Breach::OtherMode { .. } => {
            let of_mode =
                matches!(own.kind, Kind::ModeWithoutSync { .. } | Kind::SyncWithoutMode { .. });
            of_device && of_mode
        }
        // Frames at the right cycle wander through another one.
        Breach::OtherSync0Cycle { .. } => match own.kind {
            Kind::HostSlides { .. } => true,
            Kind::CycleMismatch { .. } | Kind::SyncPassed { .. } => of_device,
            _ => false,
        },
        Breach::OtherCycle { .. } => {
            matches!(own.kind, Kind::CycleMismatch { .. } | Kind::HostSlides { .. })
        }
        _ => false,
    }
}
