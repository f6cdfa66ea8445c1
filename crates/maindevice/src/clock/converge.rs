//! Drives the drift loops until clocks have converged: all clocks during bring-up, or one that
//! joins.

use alloc::vec::Vec;

use isocat_sync::drift::{Convergence, Limits, Verdict};
use isocat_wire::StationAddress;
use isocat_wire::register;
use isocat_wire::time::{Host, Nanos, Time};

use super::drift_frames::{
    Burst, followers, hasten, limits, noise_behind, read_differences, reading_interval,
};
use super::pace::Pace;
use super::settings::{depths, locking_depth, set_filter};
use crate::config::Config;
use crate::error::Cause;
use crate::link::Link;
use crate::segment::{Segment, SubDevice};

/// Drives the drift loop until every clock has converged: it sends a stream of FRMW frames, several
/// in flight, and reads 0x092C of all clocks at intervals.
///
/// A burst locks the clocks. Slower frames follow in two cases. If the drift datagrams of the cycle
/// come much more seldom, slower frames teach the speed well enough for them. If hops jitter, a
/// burst does not suffice: the jitter recurs within a few milliseconds, and a loop driven faster
/// than that takes it for drift.
pub(super) async fn converge(
    link: &Link,
    config: &Config,
    segment: &mut Segment,
    reference: usize,
) -> Result<(), Cause> {
    let begin = link.now();
    let end = begin + config.timeouts.drift;
    let noise = noise_behind(segment, config, locking_depth(config));
    let (difference, speed) = depths(segment, config);
    let most = followers(segment, reference).iter().map(|(at, _)| noise[*at]).max();
    let pace = Pace::new(config.cycle, speed, most.unwrap_or_default());
    let hurry = end.min(begin + HURRY);
    let mut led = Led::Far;
    while matches!(led, Led::Far) && link.now() < hurry {
        // What a disturbance has left of a phase goes with the number of frames: once more by many of them.
        led = lead(link, config, segment, reference, (pace, true), &noise, hurry).await?;
    }
    if !matches!(led, Led::Converged) {
        let settled = (pace.settled(), false);
        led = lead(link, config, segment, reference, settled, &noise, end).await?;
    }
    if let Led::Not { device, slope_ppb } = led {
        let device = &segment.devices[device];
        return Err(Cause::Drift {
            place: device.place(),
            difference: device.difference.unwrap_or(Nanos::ZERO),
            slope_ppb,
            after: link.now() - begin,
        });
    }
    let address = register::TIME_FILTER_DEPTH.address;
    let count = followers(segment, reference).len() as u16 + 1;
    link.bwr(address, &[difference]).expect(count).await?;
    link.board(|board| board.statistics.drift_burst = board.statistics.drift_frames);
    Ok(())
}

/// The result of driving the clocks.
enum Led {
    Converged,
    /// Not yet, and one is so far off that it takes more than patience.
    Far,
    /// The worst clock, and its slope.
    Not {
        device: usize,
        slope_ppb: i64,
    },
}

/// Sends one drift frame each `pace` until every clock has converged and at least `least` frames
/// are sent, but no longer than until `end`. `noise` is the share of 0x092C that jitter causes, by
/// position (1 sigma).
async fn lead(
    link: &Link,
    config: &Config,
    segment: &mut Segment,
    reference: usize,
    (pace, tried): (Pace, bool),
    noise: &[Nanos],
    end: Time<Host>,
) -> Result<Led, Cause> {
    let begin = link.now();
    let clocks = followers(segment, reference);
    let limits: Vec<_> = clocks.iter().map(|(at, _)| limits(config, noise[*at])).collect();
    let mut judged: Vec<_> = limits.iter().map(|limits| Convergence::new(*limits)).collect();
    let count = clocks.len() as u16 + 1;
    let station = segment.devices[reference].station;
    let mut burst = Burst::new(link, station, count, pace);
    let noise = clocks.iter().map(|(at, _)| noise[*at]).max().unwrap_or_default();
    let interval = reading_interval(noise);
    let learned = if tried { begin + pace.lasts() } else { begin };
    let window = Nanos(interval.0 * READINGS);
    // Before that it is known that they move.
    let mut next_reading = (begin + interval).max(learned + Nanos(-window.0));
    loop {
        burst.until(next_reading).await?;
        let asked = link.now();
        let readings = read_differences(link, &clocks).await?;
        // Reading a thousand clocks takes longer than the interval, and no drift frame is sent meanwhile: most of the
        // time is left to what leads them.
        let took = link.now() - asked;
        next_reading = (asked + interval).max(link.now() + Nanos(PULLING_PER_READING * took.0));
        for (((device, _), judge), (at, difference)) in clocks.iter().zip(&mut judged).zip(readings)
        {
            let device = &mut segment.devices[*device];
            let difference = difference.nanos(device.difference_polarity);
            device.difference = Some(difference);
            judge.sample(at, difference);
        }
        let converged = judged.iter().all(|one| matches!(one.verdict(), Verdict::Converged { .. }));
        if converged && link.now() >= learned {
            burst.finish().await?;
            return Ok(Led::Converged);
        }
        let is_far = |((device, _), limits): (&(usize, StationAddress), &Limits)| {
            let shown = segment.devices[*device].difference.unwrap_or_default();
            shown.abs().0 > FAR * (limits.mean + limits.noise).0
        };
        if tried && link.now() >= learned && clocks.iter().zip(&limits).any(is_far) {
            burst.finish().await?;
            return Ok(Led::Far);
        }
        if link.now() >= end {
            burst.finish().await?;
            let (device, slope_ppb) = worst(&clocks, &judged, segment);
            return Ok(Led::Not { device, slope_ppb });
        }
    }
}

/// Readings that a verdict needs.
const READINGS: i64 = 16;
/// So many times beyond the limit of the mean, a clock needs more than patience.
const FAR: i64 = 5;
/// Time of a burst after which the pace is slower. Clocks usually lock within half a second of a
/// burst. A clock that never locks must not load the wire for the whole time allowed.
const HURRY: Nanos = Nanos(2_000_000_000);

/// The clock that is furthest off, and its slope.
fn worst(
    clocks: &[(usize, StationAddress)],
    judged: &[Convergence],
    segment: &Segment,
) -> (usize, i64) {
    clocks
        .iter()
        .zip(judged)
        .filter_map(|((device, _), one)| match one.verdict() {
            Verdict::Converging { slope_ppb, .. } => Some((*device, slope_ppb)),
            _ => None,
        })
        .max_by_key(|(device, _)| segment.devices[*device].difference.map(Nanos::abs))
        .unwrap_or((0, 0))
}

/// Waits until a clock has converged. The drift datagrams of the cycle drive it, and additional
/// drift frames, since a loop corrects a fixed amount for each frame. `noise` is the share of
/// 0x092C that jitter on its way causes (1 sigma); `filter` becomes its 0x0934.
pub(crate) async fn follow(
    link: &Link,
    config: &Config,
    reference: StationAddress,
    noise: Nanos,
    filter: u8,
    device: &mut SubDevice,
) -> Result<(), Cause> {
    let begin = link.now();
    let end = begin + config.timeouts.drift;
    let mut judge = Convergence::new(limits(config, noise));
    loop {
        let next_reading = link.now() + reading_interval(noise);
        while link.now() < next_reading {
            hasten(link, config, reference).await;
        }
        let clocks = [(device.position, device.station)];
        for (at, difference) in read_differences(link, &clocks).await? {
            let difference = difference.nanos(device.difference_polarity);
            device.difference = Some(difference);
            judge.sample(at, difference);
        }
        match judge.verdict() {
            Verdict::Converged { .. } => {
                set_filter(link, core::iter::once(device.station), filter).await;
                return Ok(());
            }
            Verdict::Converging { slope_ppb, .. } if link.now() >= end => {
                return Err(Cause::Drift {
                    place: device.place(),
                    difference: device.difference.unwrap_or(Nanos::ZERO),
                    slope_ppb,
                    after: link.now() - begin,
                });
            }
            _ => {}
        }
    }
}

/// Drift frames go out for at least so many times as long as a reading of all clocks takes.
const PULLING_PER_READING: i64 = 3;
