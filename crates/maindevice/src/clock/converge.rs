//! Drives the drift loops until clocks have converged: all clocks during bring-up, or one that
//! joins.

use alloc::vec::Vec;

use isocat_sync::drift::{Convergence, Verdict};
use isocat_wire::StationAddress;
use isocat_wire::register;
use isocat_wire::time::{Host, Nanos, Time};

use super::drift_frames::{
    Burst, PACE, followers, hasten, limits, noise, pace_for, read_differences, reading_interval,
};
use super::settings::{NOISY, depths, set_filter};
use crate::config::Config;
use crate::delay;
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
    let hurry = end.min(begin + HURRY);
    let way = delay::noise(segment, config.hop_jitter);
    let noisy = way.iter().any(|one| *one > NOISY);
    let fine = noise(segment, config);
    // What a burst leaves of the jitter must not hold it up: it counts as locked with what the
    // filter of a short way leaves, 1 / sqrt(31).
    let shallow = |way: &Nanos| Nanos((way.0 * 18 + 99) / 100);
    let coarse: Vec<_> = fine.iter().zip(&way).map(|(fine, way)| shallow(way).max(*fine)).collect();
    let led = lead(link, config, segment, reference, (PACE, 0), &coarse, hurry).await?;
    let slower = pace_for(config.cycle).max(if noisy { SLOW_PACE } else { PACE });
    let led = match led {
        Led::Converged if slower > PACE => {
            let most = if noisy { MOST_SETTLING } else { MOST_LEARNING };
            let settled = end.min(link.now() + Nanos(slower.0 * most));
            let learn = (slower, LEARNING_FRAMES);
            lead(link, config, segment, reference, learn, &fine, settled).await?;
            Led::Converged
        }
        Led::Converged => Led::Converged,
        Led::Not { .. } => {
            let learn = (slower.max(SLOW_PACE), LEARNING_FRAMES);
            lead(link, config, segment, reference, learn, &fine, end).await?
        }
    };
    if let Led::Not { device, slope_ppb } = led {
        let device = &segment.devices[device];
        return Err(Cause::Drift {
            place: device.place(),
            difference: device.difference.unwrap_or(Nanos::ZERO),
            slope_ppb,
            after: link.now() - begin,
        });
    }
    let (difference, _) = depths(segment, config);
    let address = register::TIME_FILTER_DEPTH.address;
    let count = followers(segment, reference).len() as u16 + 1;
    link.bwr(address, &[difference]).expect(count).await?;
    link.board(|board| board.statistics.drift_burst = board.statistics.drift_frames);
    Ok(())
}

/// The result of driving the clocks.
enum Led {
    Converged,
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
    (pace, least): (Nanos, i64),
    noise: &[Nanos],
    end: Time<Host>,
) -> Result<Led, Cause> {
    let begin = link.now();
    let clocks = followers(segment, reference);
    let mut judged: Vec<_> =
        clocks.iter().map(|(at, _)| Convergence::new(limits(config, noise[*at]))).collect();
    let count = clocks.len() as u16 + 1;
    let station = segment.devices[reference].station;
    let mut burst = Burst::new(link, station, count, pace);
    let noise = clocks.iter().map(|(at, _)| noise[*at]).max().unwrap_or_default();
    let interval = reading_interval(noise).max(Nanos(FRAMES_PER_READING * pace.0));
    let learned = begin + Nanos(pace.0 * least);
    let mut next_reading = begin + interval;
    loop {
        burst.until(next_reading).await?;
        let asked = link.now();
        let readings = read_differences(link, &clocks).await?;
        // Reading a thousand clocks takes longer than the interval, and no drift frame is sent
        // meanwhile: most of the time is left to what leads them.
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
        if link.now() >= end {
            burst.finish().await?;
            let (device, slope_ppb) = worst(&clocks, &judged, segment);
            return Ok(Led::Not { device, slope_ppb });
        }
    }
}

/// Time of a burst after which the pace is slower. Clocks usually lock within half a second of a
/// burst. A clock that never locks must not load the wire for the whole time allowed.
const HURRY: Nanos = Nanos(2_000_000_000);

/// The pace of drift frames after that time, and where hops jitter.
const SLOW_PACE: Nanos = Nanos(1_000_000);

/// Drift frames from one reading to the next.
const FRAMES_PER_READING: i64 = 10;

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

/// Most drift frames at the slower pace, if a burst has already locked the clocks.
const MOST_LEARNING: i64 = 512;

/// The same where hops jitter: each frame removes 1/1024 of the error that the burst left.
const MOST_SETTLING: i64 = 4096;

/// Drift frames at the slower pace: after these a speed filter of the usual depth, a mean over 64,
/// keeps an eighth of its earlier content.
const LEARNING_FRAMES: i64 = 128;
/// The time for drift frames is at least this multiple of the time that reading all clocks takes.
const PULLING_PER_READING: i64 = 3;
