//! Drives the drift loops until clocks have converged: all clocks during bring-up, or one that
//! joins.

use alloc::vec::Vec;
use core::sync::atomic::{AtomicBool, Ordering};

use isocat_sync::drift::{Convergence, Limits, Verdict};
use isocat_wire::StationAddress;
use isocat_wire::register;
use isocat_wire::time::{Host, Nanos, Time};

use super::drift_frames::{
    Burst, followers, hasten, limits, noise_behind, read_differences, reading_interval,
};
use super::pace::{LEAST_NOISE, MOVED, Pace};
use super::settings::{depths, locking_depth, set_filter};
use crate::config::Config;
use crate::error::Cause;
use crate::link::Link;
use crate::segment::{Segment, SubDevice};

/// Drives the drift loop until every clock has converged: it sends a stream of FRMW frames, several
/// in flight, and reads 0x092C of all clocks at intervals.
///
/// A loop computes a speed from the growth of the difference over 2^(0x0935) drift frames. While it
/// learns the speed, the clock moves by its drift over that many intervals, so short intervals keep
/// it near. But the noise of the difference becomes an error of the speed, which is larger for
/// shorter intervals, and which moves the clock when intervals become longer. So the interval grows
/// with the time that the loops have had ([`Pace`]). Each loop then knows its speed as well as all
/// readings so far allow, and reaches the interval of the cycle without having moved by much.
pub(super) async fn converge(
    link: &Link,
    config: &Config,
    segment: &mut Segment,
    reference: usize,
    beside: &AtomicBool,
) -> Result<(), Cause> {
    let begin = link.now();
    let end = begin + config.timeouts.drift;
    let noise = noise_behind(segment, config, locking_depth(segment, config));
    let (difference, speed) = depths(segment, config);
    let most = most_noise(segment, config, reference);
    let is_short = config.cycle <= SHORT_CYCLE || most >= NOISY;
    let pace = first_pace(segment, config, reference);
    let hurry = end.min(begin + HURRY);
    let mut led = Led::Far;
    while matches!(led, Led::Far) && link.now() < hurry {
        // A disturbance left a phase, which decreases with each frame: many frames once more.
        let way = Way { pace, tried: true, end: hurry, beside };
        led = lead(link, config, segment, reference, way, &noise).await?;
    }
    if matches!(led, Led::Converged) && !is_short {
        let longer = Pace::new(config.cycle, speed, most).behind(pace);
        let way = Way { pace: longer, tried: false, end, beside };
        led = lead(link, config, segment, reference, way, &noise).await?;
    }
    if !matches!(led, Led::Converged) {
        let way = Way { pace: pace.settled(), tried: false, end, beside };
        led = lead(link, config, segment, reference, way, &noise).await?;
    }
    link.board(|board| board.statistics.drift_burst = board.statistics.drift_frames);
    if let Led::Not { device, slope_ppb } = led {
        let device = &segment.devices[device];
        return Err(Cause::Drift {
            place: device.place(),
            difference: device.difference.unwrap_or(Nanos::ZERO),
            slope_ppb,
            after: link.now() - begin,
        });
    }
    if difference != locking_depth(segment, config) {
        let address = register::TIME_FILTER_DEPTH.address;
        let count = followers(segment, reference).len() as u16 + 1;
        link.bwr(address, &[difference]).expect(count).await?;
        // Newer chips forget the difference with it, and a loop may take the next one for drift
        // since then: over a whole cycle that is little, as it is with all others.
        link.sleep(config.cycle).await;
    }
    Ok(())
}

/// The pace with which clocks begin to lock.
///
/// What is left of a phase goes with the number of frames, so it goes before intervals become those
/// of a long cycle. Where hops jitter much, short intervals would teach wrong speeds.
pub(super) fn first_pace(segment: &Segment, config: &Config, reference: usize) -> Pace {
    let most = most_noise(segment, config, reference);
    let is_short = config.cycle <= SHORT_CYCLE || most >= NOISY;
    let cycle = if is_short { config.cycle } else { SHORT_CYCLE };
    Pace::new(cycle, depths(segment, config).1, most)
}

/// The largest noise of 0x092C while clocks lock (1 sigma).
fn most_noise(segment: &Segment, config: &Config, reference: usize) -> Nanos {
    let noise = noise_behind(segment, config, locking_depth(segment, config));
    let most = followers(segment, reference).iter().map(|(at, _)| noise[*at]).max();
    most.unwrap_or_default()
}

/// The result of driving the clocks.
enum Led {
    Converged,
    /// A clock is so far off that waiting does not suffice.
    Far,
    /// The worst clock, and its slope.
    Not {
        device: usize,
        slope_ppb: i64,
    },
}

/// How clocks are driven.
#[derive(Clone, Copy)]
struct Way<'a> {
    pace: Pace,
    /// Whether it also ends when a clock is seen to be far off at the end of the pace.
    tried: bool,
    /// When it ends at the latest. The last try ends only when nothing runs beside it any more: a
    /// mailbox may take longer than clocks may.
    end: Time<Host>,
    /// Whether other procedures run beside it. Until they end, clocks are driven even if all have
    /// converged.
    beside: &'a AtomicBool,
}

/// Sends drift frames until the intervals of their pace grow no more and every clock has converged.
/// `noise` is the share of 0x092C that jitter causes, by position (1 sigma).
async fn lead(
    link: &Link,
    config: &Config,
    segment: &mut Segment,
    reference: usize,
    way: Way<'_>,
    noise: &[Nanos],
) -> Result<Led, Cause> {
    let Way { pace, tried, end, beside } = way;
    let clocks = followers(segment, reference);
    let steady = steady(config, depths(segment, config).1);
    let limit = |noise| {
        let limits = limits(config, noise);
        Limits { slope_ppb: limits.slope_ppb.min(steady), ..limits }
    };
    let limits: Vec<_> = clocks.iter().map(|(at, _)| limit(noise[*at])).collect();
    let mut judged: Vec<_> = limits.iter().map(|limits| Convergence::new(*limits)).collect();
    let count = clocks.len() as u16 + 1;
    let station = segment.devices[reference].station;
    let mut burst = Burst::new(link, station, count, pace);
    let noise = clocks.iter().map(|(at, _)| noise[*at]).max().unwrap_or_default();
    let interval = reading_interval(noise);
    let mut begin = link.now();
    if pace.begins_far() {
        let hurry = end.min(begin + APPROACH);
        let from = begin + pace.settles();
        approach(link, segment, &clocks, &limits, &mut burst, (from, hurry)).await?;
        begin = link.now() + -pace.learns();
    }
    burst.begin(begin);
    let learned = begin + pace.lasts();
    let window = Nanos(interval.0 * READINGS);
    // Earlier readings would only show that the clocks still move.
    let (mut converged, mut are_near) = (false, false);
    // While others have the wire, clocks get few frames: some time must be left without them.
    let mut alone = None;
    let mut next_reading = (begin + interval).max(learned + Nanos(-window.0));
    loop {
        // While others have the wire, clocks that have converged are read seldom.
        loop {
            let is_late = converged && beside.load(Ordering::Relaxed);
            // There is time to let loops learn their speeds from longer intervals.
            if is_late && are_near {
                burst.stretch(config.cycle.min(SHORT_CYCLE));
            }
            let due = if is_late { next_reading + RARELY } else { next_reading };
            if link.now() >= due {
                break;
            }
            burst.until(due.min(link.now() + SLICE)).await?;
        }
        let asked = link.now();
        let readings = read_differences(link, &clocks).await?;
        // Reading a thousand clocks takes longer than the interval, and no drift frame is sent
        // meanwhile: most of the time is left to what leads them.
        let took = link.now() - asked;
        next_reading = (asked + interval).max(link.now() + Nanos(PULLING_PER_READING * took.0));
        // Longer intervals showed a wrong speed, which took a clock away: it comes back first.
        if converged && !are_near {
            burst.pause(next_reading - asked);
        }
        are_near = true;
        for ((((device, _), judge), limits), (at, difference)) in
            clocks.iter().zip(&mut judged).zip(&limits).zip(readings)
        {
            let device = &mut segment.devices[*device];
            let difference = difference.nanos(device.difference_polarity);
            device.difference = Some(difference);
            judge.sample(at, difference);
            are_near &= is_near(difference, limits);
        }
        converged = judged.iter().all(|one| matches!(one.verdict(), Verdict::Converged { .. }));
        if converged && link.now() >= learned && !beside.load(Ordering::Relaxed) {
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
        let last = match tried || !beside.load(Ordering::Relaxed) {
            true => end.max(*alone.get_or_insert(end)),
            false => {
                alone = Some(link.now() + HURRY);
                continue;
            }
        };
        if link.now() >= last {
            burst.finish().await?;
            let (device, slope_ppb) = worst(&clocks, &judged, segment);
            return Ok(Led::Not { device, slope_ppb });
        }
    }
}

/// Sends drift frames at the shortest interval until every clock is near the reference: their loops
/// learn their speeds, and then lose the phase that the clocks have gained meanwhile. `from`: when
/// loops may know their speeds; `end`: when it ends at the latest.
async fn approach(
    link: &Link,
    segment: &mut Segment,
    clocks: &[(usize, StationAddress)],
    limits: &[Limits],
    burst: &mut Burst<'_>,
    (from, end): (Time<Host>, Time<Host>),
) -> Result<(), Cause> {
    let mut next_reading = from;
    loop {
        burst.until(next_reading).await?;
        let asked = link.now();
        let readings = read_differences(link, clocks).await?;
        let took = link.now() - asked;
        next_reading =
            (asked + APPROACH_READING).max(link.now() + Nanos(PULLING_PER_READING * took.0));
        let mut are_near = true;
        for (((device, _), limits), (_, difference)) in clocks.iter().zip(limits).zip(readings) {
            let device = &mut segment.devices[*device];
            let difference = difference.nanos(device.difference_polarity);
            device.difference = Some(difference);
            are_near &= is_near(difference, limits);
        }
        if are_near || next_reading >= end {
            return Ok(());
        }
    }
}

/// Whether a reading shows a clock near the reference: half of the mean that is allowed, and what
/// noise makes of it.
fn is_near(difference: Nanos, limits: &Limits) -> bool {
    let noise = limits.noise.max(LEAST_NOISE);
    let near = (limits.mean.0 / 2 + 3 * noise.0).min(limits.mean.0 + 2 * limits.noise.0);
    difference.abs().0 <= near
}

/// The slope, ns per second, with which a clock moves by [`MOVED`] until its loop has corrected it
/// with the frames of the cycle: speeds are averaged over 2^`depth` of them. With long cycles it is
/// the smallest slope that readings can tell.
fn steady(config: &Config, depth: u8) -> i64 {
    (MOVED.0 * 1_000_000_000 / (config.cycle.0 << depth.min(15)).max(1)).max(LEAST_SLOPE)
}

/// Three errors of the slope of sixteen readings with 3 ns of noise in 30 ms, 3 x 3 ns x sqrt(12 /
/// 16) / 30 ms, ns per second.
const LEAST_SLOPE: i64 = 260;
/// Noise of 0x092C (1 sigma) from which on clocks do not lock at short intervals.
const NOISY: Nanos = Nanos(20);
/// Clocks of longer cycles first lock as those of this one do.
const SHORT_CYCLE: Nanos = Nanos::millis(1);
/// Longest time in which all clocks come near at the shortest interval. A loop whose phase takes
/// 2048 frames by a factor of e comes from 160 ns to 14 in it.
const APPROACH: Nanos = Nanos(250_000_000);
/// Time from one reading to the next meanwhile.
const APPROACH_READING: Nanos = Nanos(4_000_000);
/// Readings that a verdict needs.
const READINGS: i64 = 16;
/// A clock beyond this multiple of the limit of the mean does not come into step by waiting.
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
        .unwrap_or((clocks.first().map_or(0, |(device, _)| *device), 0))
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

/// Additional time between two readings of clocks that have converged, while others have the wire.
const RARELY: Nanos = Nanos(20_000_000);
/// How often it is looked whether others still have the wire.
const SLICE: Nanos = Nanos(1_000_000);
/// The time for drift frames is at least this multiple of the time that reading all clocks takes.
const PULLING_PER_READING: i64 = 3;
