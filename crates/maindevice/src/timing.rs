//! The plan of one cycle: the phase of SYNC0, and every line of the budget of every SubDevice.

use alloc::vec::Vec;

use isocat_sync::budget::{self, Origin, Tracking, USUAL_DEVIATION_PPB, budget, common_shift};
use isocat_sync::phase::Direction;
use isocat_wire::time::Nanos;

use crate::config::{ClockRange, Config};
use crate::error::Cause;
use crate::segment::{Segment, SubDevice, Timing};
use crate::{cycle, delay, hot_connect, mapping, mode};

/// Plans one cycle: SYNC0's phase, and every line of the budget of every SubDevice. Frames find the
/// reference clock at phase 0 of system time.
pub(crate) fn plan(segment: &Segment, config: &Config) -> Result<Timing, Cause> {
    let cycle = budget::Cycle {
        cycle: config.cycle,
        send: Nanos::ZERO,
        jitter: config.host_jitter + way_jitter(segment, config),
        hop_jitter: way_jitter(segment, config),
        ring_way: ring_detour(segment, config, Nanos::ZERO).0,
        clock_error_origin: match config.clock_error {
            Some(_) => Origin::Intent,
            None => Origin::Computed,
        },
        clock_error: config.clock_error.unwrap_or_else(|| clock_error(segment, config)),
        clock_deviation_ppb: deviation(reference_range(segment, config), ClockRange::default()),
        limits: config.limits,
    };
    let frames = cycle::frames(
        segment,
        config.drift_compensation,
        config.direction != Direction::FollowReference,
    );
    let times = cycle::chunk_times(&frames, segment.image.chunks.len());
    let reference = reference_range(segment, config);
    let mut demands: Vec<budget::Device> =
        segment.devices.iter().map(|device| demands_of(config, device, reference)).collect();
    // Each device would look through all before it, which is not needed if none is absent.
    let some_absent = segment.devices.iter().any(|device| !device.admitted);
    for (chunk, times) in segment.image.chunks.iter().zip(times) {
        let range = chunk.first..chunk.end;
        for (device, demands) in segment.devices[range.clone()].iter().zip(&mut demands[range]) {
            if !chunk.holds(device) {
                continue;
            }
            let delay = segment.delay(device.position);
            let (detour, early) = ring_detour(segment, config, delay);
            let absent = match some_absent {
                true => hot_connect::detour(segment, device.position),
                false => Nanos::ZERO,
            };
            demands.ring_spread = detour + early;
            let detour = detour + absent;
            demands.delay = delay;
            let (outputs, inputs) = (device.outputs.length > 0, device.inputs.length > 0);
            demands.outputs_arrival = outputs.then_some(delay + detour + times.stored);
            // Outputs arrive as late as in the fullest cycle, inputs are fetched as early as in the
            // emptiest.
            demands.inputs_fetched = inputs.then_some(delay - early + times.fetched - times.spread);
            demands.frame_spread = times.spread;
            let watchdog = config.watchdog_of(device.position);
            if config.watchdog.is_some() {
                demands.origins.watchdog = Origin::Intent;
            } else if watchdog.divider.or(watchdog.process_data).is_some() {
                demands.origins.watchdog = Origin::Esi;
            }
            demands.watchdog = mapping::watchdog(device, watchdog);
            demands.inputs_read = inputs.then_some(delay + detour + times.read);
        }
    }
    let common = common_shift(&cycle, &demands);
    let sync0 = common.map(|common| config.shift.unwrap_or(common));
    let shift = sync0.unwrap_or(Nanos::ZERO);
    let devices: Vec<_> =
        demands.iter().map(|device| (*device, budget(&cycle, shift, device))).collect();
    let timing = Timing { cycle, sync0, frames, devices };
    if !config.force {
        let line = timing.frames_in_cycle().line();
        if !line.fits() {
            return Err(Cause::Frames { line });
        }
        for (device, (_, budget)) in segment.devices.iter().zip(&timing.devices) {
            if let Some(line) = budget.failure() {
                return Err(Cause::Plan { place: device.place(), line });
            }
        }
    }
    Ok(timing)
}

/// The clock error of the plan: the threshold on either side of the reference, or what the drift
/// loop leaves at the worst clock if that is more.
fn clock_error(segment: &Segment, config: &Config) -> Nanos {
    let threshold = Nanos(2 * config.drift_threshold.0);
    let (time_filter_depth, speed_filter_depth) = crate::clock::depths(segment, config);
    let reference = reference_range(segment, config);
    let led = |device: &&SubDevice| device.dc.has_clock() && config.drift_compensation;
    let left = segment.devices.iter().filter(led).map(|device| {
        budget::clock_error(&Tracking {
            cycle: config.cycle,
            deviation_ppb: deviation(range(config, device.position), reference),
            time_filter_depth,
            speed_filter_depth,
        })
    });
    // A loop passes on a tenth of the jitter of the way at the usual depths (docs/dc.md), a third
    // at worst; more before it has settled.
    left.max().unwrap_or_default().max(threshold) + hop_jitter(segment, config)
}

/// Range of the arrival times that hops cause: a period of MII at the reference, and four standard
/// deviations of the way behind it.
fn way_jitter(segment: &Segment, config: &Config) -> Nanos {
    match config.hop_jitter {
        true => MII_PERIOD + Nanos(4 * hop_jitter(segment, config).0),
        false => Nanos::ZERO,
    }
}

/// Time of a nibble at 100 Mbit/s.
const MII_PERIOD: Nanos = Nanos(40);

/// Standard deviation of the jitter on the longest way from the reference clock.
fn hop_jitter(segment: &Segment, config: &Config) -> Nanos {
    delay::noise(segment, config.hop_jitter).into_iter().max().unwrap_or_default()
}

/// The speed range of a SubDevice's oscillator, as far as it is known.
fn range(config: &Config, position: usize) -> ClockRange {
    config.devices.get(position).and_then(|wish| wish.clock).unwrap_or_default()
}

fn reference_range(segment: &Segment, config: &Config) -> ClockRange {
    segment.reference.map_or(ClockRange::default(), |reference| range(config, reference))
}

/// Largest difference of the speeds of two oscillators: the usual one, or more if more is known.
fn deviation(one: ClockRange, other: ClockRange) -> i64 {
    one.apart(other).max(USUAL_DEVIATION_PPB)
}

/// The demands by configuration and assumptions, without arrivals.
fn demands_of(config: &Config, device: &SubDevice, reference: ClockRange) -> budget::Device {
    let wish = config.devices.get(device.position);
    let assumed = wish.map(|wish| wish.assumed).unwrap_or_default();
    let demands = mode::demands(device, assumed, wish);
    let clock_deviation_ppb = deviation(range(config, device.position), reference);
    budget::Device { clock_deviation_ppb, ..demands }
}

/// How much later and earlier than by its delay frames may reach a SubDevice in a ring that is cut
/// or whole again. On the longest way they come from the other end to the first SubDevice and back;
/// on the shortest they come from the other end directly.
fn ring_detour(segment: &Segment, config: &Config, delay: Nanos) -> (Nanos, Nanos) {
    let Some(ring) = config.ring else { return (Nanos::ZERO, Nanos::ZERO) };
    let whole = segment.devices.iter().filter_map(|device| device.delay).max();
    let whole = whole.unwrap_or(Nanos::ZERO);
    let early = delay - (whole - delay) - ring.longer;
    // Behind a cut at the first cable frames reach the reference clock later by this, or earlier,
    // and the host follows. Once the ring is whole again they deviate by it in the other direction;
    // while it follows, the host overshoots by less.
    let step = Nanos((whole + ring.longer).0.abs());
    (step, early.max(step))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{AssumedTimes, DeviceConfig};
    use crate::mode::tests::drive;
    use crate::segment::{Chunk, ProcessImage};
    use isocat_sync::budget::Check;
    use isocat_sync::{Pulses, SyncMode};

    /// Three in a ring: behind a cut at the first cable, each is reached past all others and back.
    /// The host has followed, so it is too early by the same time when the ring is whole again.
    #[test]
    fn frames_in_a_ring_may_go_the_long_way() {
        let devices =
            [0, 300, 700].map(|delay| SubDevice { delay: Some(Nanos(delay)), ..drive(0, 0) });
        let segment = Segment { devices: devices.into(), ..Segment::default() };
        let mut config = Config::new(Nanos::millis(1));
        let detours = |config: &Config| {
            [0, 300, 360, 700].map(|delay| ring_detour(&segment, config, Nanos(delay)))
        };
        assert_eq!(detours(&config), [(Nanos::ZERO, Nanos::ZERO); 4]);
        config.ring = Some(crate::Ring::default());
        let expected = [(700, 700); 4];
        assert_eq!(detours(&config), expected.map(|(late, early)| (Nanos(late), Nanos(early))));
        // The cable at the secondary port is longer than the one at the primary port, or shorter.
        let with = |longer| Config {
            ring: Some(crate::Ring { longer: Nanos(longer), ..Default::default() }),
            ..Config::new(Nanos::millis(1))
        };
        let expected = [(790, 790); 4];
        let expected = expected.map(|(late, early)| (Nanos(late), Nanos(early)));
        assert_eq!(detours(&with(90)), expected);
        let expected = [(610, 610), (610, 610), (610, 610), (610, 790)];
        let expected = expected.map(|(late, early)| (Nanos(late), Nanos(early)));
        assert_eq!(detours(&with(-90)), expected);
    }

    fn planned(device: SubDevice, config: &Config) -> Result<Timing, Cause> {
        let chunk =
            Chunk { every: 1, logical: 0, length: 8, first: 0, end: 1, writers: 1, readers: 1 };
        let image = ProcessImage { chunks: alloc::vec![chunk], read_write: true };
        let segment = Segment {
            devices: alloc::vec![device],
            reference: Some(0),
            image,
            ..Segment::default()
        };
        plan(&segment, config)
    }

    #[test]
    fn assumed_times_count_where_the_device_states_none() {
        let mut config = Config::new(Nanos(1_000_000));
        let assumed =
            AssumedTimes { outputs_calc_and_copy: Some(Nanos(60_000)), ..AssumedTimes::default() };
        config.devices = alloc::vec![DeviceConfig { assumed, ..DeviceConfig::default() }];
        let mut device = drive(0x0027, 0x0027);
        device.mode = SyncMode::DcSync0;
        device.pulses = Pulses { sync0_cycle: config.cycle, ..Pulses::default() };
        device.delay = Some(Nanos(300));
        let timing = planned(device.clone(), &config).unwrap();
        // Drift datagram 20, chunk 20, AL status 14, headers 16 bytes; preamble and FCS 12; 80 ns
        // for each byte.
        let arrival = 300 + (20 + 20 + 14 + 16 + 12) * 80;
        assert_eq!(timing.devices[0].0.outputs_arrival, Some(Nanos(arrival)));
        let line = timing.devices[0].1.line(Check::OutputsBeforeSync0).unwrap();
        // The jitter of a hop is included in the host's jitter.
        assert_eq!(line.needed, Nanos(arrival + 20_000 + MII_PERIOD.0 + 200 + 60_000));
        // The configured phase is exactly sufficient, then 1 ns too early.
        config.shift = Some(line.needed);
        assert!(planned(device.clone(), &config).is_ok());
        config.shift = Some(line.needed - Nanos(1));
        assert!(matches!(planned(device.clone(), &config), Err(Cause::Plan { .. })));
        config.force = true;
        assert!(planned(device, &config).is_ok());
    }
}
