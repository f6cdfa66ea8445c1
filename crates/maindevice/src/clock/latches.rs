//! Latches of the ports' receive times: as many as the delays need, and their evaluation.

use alloc::vec::Vec;

use isocat_sync::delay::Delay;
use isocat_wire::time::{Host, Nanos, Picos, Time};

use super::lines::Lines;
use crate::config::Config;
use crate::delay::{self, Estimator, FREE_RUNNING_PPB, Times};
use crate::error::Cause;
use crate::event::Event;
use crate::link::Link;
use crate::segment::{Segment, SubDevice};

/// What latches tell of the clocks.
pub(super) struct Latches {
    /// How the clocks run apart.
    pub lines: Lines,
    /// When the last latch was sent, and the reference clock's time from the first one to it, ns.
    pub last: (Time<Host>, i64),
}

/// Latches several times and sets each delay to the mean.
pub(super) async fn measure(
    link: &Link,
    config: &Config,
    segment: &mut Segment,
    reference: usize,
) -> Result<Latches, Cause> {
    let wanted = config.delay_latches.max(1);
    let stations = delay::stations(segment);
    let patient = config.hop_jitter;
    let mut latches = latch_often(link, config, &stations, 0, patient.then_some(FIRST)).await?;
    let before = latches.get(wanted.wrapping_sub(2)).map(|(_, latch)| latch);
    delay::find_entries(segment, before, &latches[wanted - 1].1)?;
    let mut estimator = Estimator::new(segment, reference, FREE_RUNNING_PPB, config.hop_jitter);
    let mut lines = Lines::new(reference);
    for (_, latch) in &latches {
        estimator.sample(latch);
        lines.sample(latch);
    }
    let mut last = latches.pop().unwrap_or_else(|| (link.now(), Times::new()));
    if patient {
        let sample = |latch: &Times| lines.sample(latch);
        last = refine(link, config, &mut estimator, &stations, 0, last, sample).await?;
    }
    for (at, (device, delay)) in segment.devices.iter_mut().zip(estimator.delays()).enumerate() {
        take(link, device, delay);
        let mean = estimator.mean(at);
        device.delay_spread = delay.nanos().map(|_| Nanos(mean.spread().0 / 1_000));
        device.delay_latches_left_out = mean.left_out();
    }
    let last = (last.0, lines.reference_since(&last.1));
    Ok(Latches { lines, last })
}

/// Latches as often as wanted, with `pauses` between them. Each latch comes with the instant before
/// it. Some latches may be lost, but not more than come back.
pub(super) async fn latch_often(
    link: &Link,
    config: &Config,
    stations: &delay::Stations,
    strangers: u16,
    pauses: Option<Pauses>,
) -> Result<Vec<(Time<Host>, Times)>, Cause> {
    let wanted = config.delay_latches.max(1);
    let mut latches = Vec::with_capacity(wanted);
    let mut lost = 0;
    while latches.len() < wanted {
        if let Some(pauses) = pauses {
            link.sleep(pauses.before(latches.len() + lost)).await;
        }
        let sent = link.now();
        match delay::latch_among(link, stations, strangers).await {
            Ok(latch) => latches.push((sent, latch)),
            Err(error) => {
                lost += 1;
                if lost > wanted {
                    return Err(error.into());
                }
            }
        }
    }
    link.board(|board| {
        board.statistics.delay_latches += wanted as u64;
        board.statistics.delay_latches_lost += lost as u64;
    });
    Ok(latches)
}

/// Latches until all delays are known as well as wanted, or the most latches are made. Returns the
/// last latch; `sample` gets each of them.
pub(super) async fn refine(
    link: &Link,
    config: &Config,
    estimator: &mut Estimator,
    stations: &delay::Stations,
    strangers: u16,
    mut last: (Time<Host>, Times),
    mut sample: impl FnMut(&Times) + Send,
) -> Result<(Time<Host>, Times), Cause> {
    let most = MOST_LATCHES.saturating_mul(config.delay_latches.max(1));
    while estimator.latches() < most && estimator.worst_error() > Picos::from(config.delay_error) {
        for latch in latch_often(link, config, stations, strangers, Some(MORE)).await? {
            estimator.sample(&latch.1);
            sample(&latch.1);
            last = latch;
        }
    }
    Ok(last)
}

/// Pauses before latches. They differ: with a constant pause in which two clocks slip by a whole
/// tick, all latches would show the same.
#[derive(Clone, Copy)]
pub(super) struct Pauses {
    shortest: Nanos,
    /// The range by which pauses differ.
    range: Nanos,
}

impl Pauses {
    fn before(self, number: usize) -> Nanos {
        let part = number as i64 * 618 % 1_000;
        self.shortest + Nanos(part * self.range.0 / 1_000)
    }
}

/// Pauses of the least number of latches: at 10 ppm, clocks slip by 10 ns in the shortest.
pub(super) const FIRST: Pauses = Pauses { shortest: Nanos(1_000_000), range: Nanos(4_000_000) };

/// Pauses of further latches. Each tells less that is new, but all of them last long enough: the
/// jitter of a hop goes round as two clocks slip, so the mean of many latches in a round is better
/// than that of as many at random.
const MORE: Pauses = Pauses { shortest: Nanos(125_000), range: Nanos(500_000) };

/// Takes over a measured delay. A clock whose delay cannot be known gets the middle of the possible
/// values and is reported.
pub(super) fn take(link: &Link, device: &mut SubDevice, delay: Delay) {
    device.measured_delay = Some(delay);
    device.delay = delay.nanos();
    if let Delay::Indeterminate { why, between } = delay
        && device.dc.has_clock()
    {
        let used = delay.or_middle();
        device.delay = Some(used);
        let position = device.position;
        link.report(Event::DelayUnknown { position, why, between, used });
    }
}

/// The most latches in all, as a multiple of the least number.
const MOST_LATCHES: usize = 8;
