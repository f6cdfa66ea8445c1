//! What is otherwise than it was meant, by the rulebook, beside what the frames alone show. Of two
//! findings about the same thing the one that explains more stays.

use std::time::Duration;

use isocat_rules::{Breach, Breached, Ruling};

use crate::evidence;
use crate::finding::{Finding, Kind};
use crate::observer::Observer;

/// A stretch of operation, held against what was meant.
#[derive(Clone, Debug)]
pub(crate) struct Held {
    pub ruling: Ruling,
    /// For each breach the place of its device, the first frame that shows it, and when that was.
    shown: Vec<(Option<usize>, usize, Option<Duration>)>,
}

/// Holds the present stretch of operation against the claims. Without a file these are what holds
/// of any segment.
pub(crate) fn hold(observer: &Observer) -> Held {
    let of_any;
    let claims = match &observer.claims {
        Some(claims) => claims,
        None => {
            of_any = evidence::of_any(observer);
            &of_any
        }
    };
    let ruling = isocat_rules::judge(claims, &evidence::of(observer, claims));
    let shown = ruling.breached.iter().map(|Breached { device, breach }| {
        let place = device.and_then(|at| observer.devices.at(u16::try_from(at).ok()?));
        let (frame, at) = evidence::shown(observer, place, breach);
        (place, frame, at)
    });
    Held { shown: shown.collect(), ruling }
}

/// All stretches of operation so far, held against the claims.
pub(crate) fn rulings(observer: &Observer) -> Vec<Held> {
    let ended = observer.held.iter().cloned();
    // After the last stretch only the way down is left.
    let goes_on = observer.is_operating() || observer.held.is_empty();
    ended.chain(goes_on.then(|| hold(observer))).collect()
}

pub(super) fn judge(observer: &Observer, rulings: &[Held], all: &mut Vec<Finding>) {
    let breaches = rulings.iter().flat_map(|held| held.ruling.breached.iter().zip(&held.shown));
    let mut told: Vec<(Option<usize>, &'static str)> = Vec::new();
    for (Breached { breach, .. }, (place, frame, at)) in breaches {
        let key = (*place, breach.name());
        let again = told.contains(&key);
        let more = |own: &Finding| says_more(own, breach, *place, observer);
        if again || all.iter().any(more) {
            continue;
        }
        told.push(key);
        all.retain(|own| !says_less(own, breach, *place));
        let finding = Finding::new(Kind::Breached(breach.clone()), *place, *frame);
        all.push(Finding { at: *at, ..finding });
    }
}

/// Whether a finding of the frames tells the breach with its cause, or to the frame.
fn says_more(own: &Finding, breach: &Breach, place: Option<usize>, observer: &Observer) -> bool {
    let of_device = own.device == place;
    match breach {
        Breach::NotOperated { .. } => {
            let down = matches!(
                own.kind,
                Kind::StayedBelow { .. }
                    | Kind::OpWithoutData { .. }
                    | Kind::AlError { came_up: false, .. }
                    | Kind::LeftOp { .. }
                    | Kind::DeviceSilent {}
            );
            of_device && down
        }
        Breach::StartPassed { .. } => {
            of_device && matches!(own.kind, Kind::StartInPast { .. } | Kind::ClockFar { .. })
        }
        Breach::Sync0Apart { from, .. } => {
            let first = u16::try_from(*from).ok().and_then(|from| observer.devices.at(from));
            let either = of_device || own.device.is_some() && own.device == first;
            either && matches!(own.kind, Kind::OtherDelay { .. } | Kind::ClockFar { .. })
        }
        Breach::TimeNotDistributed { .. } => {
            matches!(own.kind, Kind::NoDriftFrames {} | Kind::DriftFramesStopped { .. })
        }
        Breach::FramesSlide { .. } => matches!(own.kind, Kind::HostSlides { .. }),
        Breach::SeveralTalkers { .. } => matches!(own.kind, Kind::AnotherTalker { .. }),
        Breach::ClockSet { .. } => of_device && matches!(own.kind, Kind::ClockSet { .. }),
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
