//! What is left in the cycle of a SubDevice before each deadline, at worst: one figure, for
//! drawings and for words.

use isocat_engine::recording::cycle::{CycleSeen, Origin, acting};
use isocat_maindevice::segment::Timing;
use isocat_sync::Moment;
use isocat_wire::time::Nanos;

/// What is left before a deadline.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Margin {
    /// What must be ready: outputs or inputs.
    pub what: &'static str,
    /// What it must be ready for.
    pub until: &'static str,
    /// When it was ready at the latest, ns of the bus cycle.
    pub done: f64,
    /// When it was wanted at the earliest, ns of the bus cycle.
    pub deadline: f64,
    /// What was left at worst, ns: within one cycle where that was seen, else from the latest to
    /// the earliest.
    pub left: f64,
}

impl Margin {
    /// Its colour by what is left against the lateness of the host: too late, less than a late
    /// frame takes, or more.
    pub fn class(&self, jitter: Nanos) -> &'static str {
        match self.left {
            left if left < 0.0 => "bad",
            left if left < jitter.0 as f64 => "tight",
            _ => "good",
        }
    }
}

/// The margins of a SubDevice: as they were seen, else as they are planned. None where its cycle
/// has no place in the bus cycle.
pub fn margins(timing: &Timing, position: usize, seen: Option<&CycleSeen>) -> Vec<Margin> {
    let Some((device, _)) = timing.devices.get(position) else { return Vec::new() };
    if seen.is_some_and(|seen| seen.origin == Origin::OwnCycle) {
        return Vec::new();
    }
    let planned = timing.moments(position).unwrap_or_default();
    let ends = |moment: Moment| {
        let of = seen.and_then(|seen| seen.of(moment));
        let of = of.map(|seen| (seen.least() as f64 / 1e3, seen.largest() as f64 / 1e3));
        of.or_else(|| planned.of(moment).map(|s| (s.earliest.0 as f64, s.latest.0 as f64)))
    };
    let margin = |what, until, done: Option<f64>, deadline: Option<f64>, left: Option<f64>| {
        let (done, deadline) = (done?, deadline?);
        Some(Margin { what, until, done, deadline, left: left.unwrap_or(deadline - done) })
    };
    let in_one_cycle = seen.map(|seen| seen.outputs_left).filter(|left| left.count() > 0);
    let fetched = planned.of(Moment::Sm3).map(|span| span.earliest.0 as f64);
    let all = [
        margin(
            "outputs",
            "the acting pulse",
            ends(Moment::OutputsReady).map(|(_, latest)| latest),
            acting(device).and_then(ends).map(|(earliest, _)| earliest),
            in_one_cycle.map(|left| left.least() as f64 / 1e3),
        ),
        margin(
            "inputs",
            "the next frame",
            ends(Moment::InputsAvailable).map(|(_, latest)| latest),
            fetched,
            None,
        ),
    ];
    all.into_iter().flatten().collect()
}

/// The least of them, ns.
pub fn least(margins: &[Margin]) -> Option<f64> {
    margins.iter().map(|margin| margin.left).reduce(f64::min)
}
