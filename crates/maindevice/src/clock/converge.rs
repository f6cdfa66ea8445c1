//! Drives the drift loops until clocks have converged: all of them on the way up, or one that joins.

use alloc::vec::Vec;

use isocat_sync::drift::{Convergence, Verdict};
use isocat_wire::StationAddress;
use isocat_wire::register::{self};
use isocat_wire::time::Nanos;

use super::drift_frames::{
    Burst, followers, hasten, limits, noise, read_differences, reading_interval,
};
use super::settings::set_filter;
use crate::config::Config;
use crate::error::Cause;
use crate::link::Link;
use crate::segment::{Segment, SubDevice};

/// Drives the drift loop until every clock has converged: a stream of FRMW, several in flight, with
/// a look at 0x092C of all clocks now and then.
pub(super) async fn converge(
    link: &Link,
    config: &Config,
    segment: &mut Segment,
    reference: usize,
) -> Result<(), Cause> {
    let begin = link.now();
    let end = begin + config.timeouts.drift;
    let noise = noise(segment, config);
    let clocks = followers(segment, reference);
    let mut judged: Vec<_> =
        clocks.iter().map(|(at, _)| Convergence::new(limits(config, noise[*at]))).collect();
    let count = clocks.len() as u16 + 1;
    let station = segment.devices[reference].station;
    let mut burst = Burst::new(link, station, count);
    let noise = clocks.iter().map(|(at, _)| noise[*at]).max().unwrap_or_default();
    let interval = reading_interval(noise);
    let mut next_reading = begin + interval;
    loop {
        burst.until(next_reading).await?;
        let slow = link.now() - begin > HURRY;
        burst.slow(slow);
        next_reading = link.now() + if slow { Nanos(SLOWER * interval.0) } else { interval };
        let readings = read_differences(link, &clocks).await?;
        for (((device, _), judge), (at, difference)) in clocks.iter().zip(&mut judged).zip(readings)
        {
            let device = &mut segment.devices[*device];
            let difference = difference.nanos(device.difference_polarity);
            device.difference = Some(difference);
            judge.sample(at, difference);
        }
        let converged = judged.iter().all(|one| matches!(one.verdict(), Verdict::Converged { .. }));
        if converged {
            burst.finish().await?;
            let (difference, _) = config.drift_filters.depths(config.cycle);
            let address = register::TIME_FILTER_DEPTH.address;
            link.bwr(address, &[difference]).expect(count).await?;
            link.board(|board| board.statistics.drift_burst = board.statistics.drift_frames);
            return Ok(());
        }
        if link.now() >= end {
            let (device, slope_ppb) = worst(&clocks, &judged, segment);
            let device = &segment.devices[device];
            return Err(Cause::Drift {
                place: device.place(),
                difference: device.difference.unwrap_or(Nanos::ZERO),
                slope_ppb,
                after: link.now() - begin,
            });
        }
    }
}

/// Clocks lock in half a second as a rule. One that has not by then has time: a clock that never comes into step, whatever it is
/// led by, must not take the wire for as long as it is waited for.
const HURRY: Nanos = Nanos(5_000_000_000);

/// How much slower drift frames and readings are then.
const SLOWER: i64 = 10;

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

/// Waits until a clock has converged, led by the drift datagram of the cycle and, as a loop pulls by so much for
/// each, by more of them. `noise` is what 0x092C shows of the way to it (1 sigma).
pub(crate) async fn follow(
    link: &Link,
    config: &Config,
    reference: StationAddress,
    noise: Nanos,
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
                let (difference, _) = config.drift_filters.depths(config.cycle);
                set_filter(link, core::iter::once(device.station), difference).await;
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
