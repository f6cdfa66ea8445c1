//! Writes settings of clocks: offsets, delays and filter depths.

use alloc::vec::Vec;

use isocat_wire::StationAddress;
use isocat_wire::register::{self, Value};
use isocat_wire::time::Nanos;

use crate::config::Config;
use crate::delay::{self};
use crate::error::AccessError;
use crate::link::Link;
use crate::segment::{Segment, SubDevice};

/// Writes delay and offset of every clock and resets its filters; delays are too long by `lag`.
/// Filter depths are written first, since the write to 0x0930 clears all filters.
pub(super) async fn write(
    link: &Link,
    config: &Config,
    segment: &Segment,
    lag: Nanos,
    depth: u8,
) -> Result<(), AccessError> {
    let clocks = || segment.devices.iter().filter(|device| device.dc.has_clock());
    let mut writes = Vec::new();
    for device in clocks() {
        let delay = (device.delay.unwrap_or(Nanos::ZERO) + lag).0 as u32;
        let station = device.station;
        writes.push(link.fpwr(
            station,
            register::SYSTEM_TIME_OFFSET.address,
            &device.offset.to_bytes(),
        ));
        writes.push(link.fpwr(station, register::SYSTEM_TIME_DELAY.address, &delay.to_bytes()));
    }
    for write in writes {
        write.expect(1).await?;
    }
    let count = clocks().count() as u16;
    let depths = [depth, depths(segment, config).1];
    link.bwr(register::TIME_FILTER_DEPTH.address, &depths).expect(count).await?;
    let start = SPEED_COUNTER_START.to_bytes();
    link.bwr(register::SPEED_COUNTER_START.address, &start).expect(count).await?;
    Ok(())
}

/// Writes the offset of every clock.
pub(super) async fn write_offsets(link: &Link, segment: &Segment) -> Result<(), AccessError> {
    let clocks = segment.devices.iter().filter(|device| device.dc.has_clock());
    let address = register::SYSTEM_TIME_OFFSET.address;
    let write = |device: &SubDevice| link.fpwr(device.station, address, &device.offset.to_bytes());
    let writes: Vec<_> = clocks.map(write).collect();
    for write in writes {
        write.expect(1).await?;
    }
    Ok(())
}

/// Writes the filter depths and, last, 0x0930, which clears all filters of this clock.
pub(super) async fn reset_filters(
    link: &Link,
    config: &Config,
    segment: &Segment,
    station: StationAddress,
) -> Result<(), AccessError> {
    let depths = joining_depths(segment, config);
    link.fpwr(station, register::TIME_FILTER_DEPTH.address, &depths).expect(1).await?;
    link.write(station, register::SPEED_COUNTER_START, SPEED_COUNTER_START).await
}

/// Writes register 0x0934 of these clocks. If the write is lost at a clock, its difference is
/// filtered less or more, but the clock is still controlled.
pub(super) async fn set_filter(
    link: &Link,
    clocks: impl Iterator<Item = StationAddress>,
    depth: u8,
) {
    let address = register::TIME_FILTER_DEPTH.address;
    let writes: Vec<_> = clocks.map(|station| link.fpwr(station, address, &[depth])).collect();
    for write in writes {
        let _lost = write.reply().await.is_err();
    }
}

/// Depths of 0x0934 and 0x0935 in operation: the configured ones, or those that suit the cycle. On
/// a long way 0x0934 is deeper, so that the remaining jitter of the hops is not larger than on a
/// short way. A loop takes that remainder for a speed: with a shallow filter a clock behind a
/// thousand hops wanders by some microseconds (docs/dc.md).
pub(crate) fn depths(segment: &Segment, config: &Config) -> (u8, u8) {
    let (difference, speed) = config.drift_filters.depths(config.cycle);
    match config.drift_filters.difference {
        Some(asked) => (asked.min(15), speed),
        None => (difference.max(quiet_depth(segment, config)), speed),
    }
}

/// Depth of 0x0934 that reduces the jitter of the longest way to [`NOISY`]: the mean leaves 1 /
/// sqrt(2^(depth + 1)) of it.
fn quiet_depth(segment: &Segment, config: &Config) -> u8 {
    let noise = delay::noise(segment, config.hop_jitter).into_iter().max().unwrap_or_default();
    let square = (noise.0 * noise.0) as u64 / (2 * NOISY.0 * NOISY.0) as u64;
    square.checked_ilog2().map_or(0, |log| log + 1).min(DEEPEST) as u8
}

/// Depth of 0x0934 while clocks lock, unless another one is configured. The depth of 0x0935 is
/// already that of the cycle, since newer chips forget the speed when it is written.
///
/// Where hops jitter it is so deep that the mean changes by about 1 ns from frame to frame. In 50
/// us a loop can correct 2.4 ns (1 / 20490, the range of 0x0932); it would take larger changes for
/// jumps, and its clock would wander. But the mean is no longer than that of speeds, or the loop
/// swings.
pub(super) fn locking_depth(segment: &Segment, config: &Config) -> u8 {
    if let Some(asked) = config.drift_filters.difference {
        return asked.min(15);
    }
    let noise = delay::noise(segment, config.hop_jitter).into_iter().max().unwrap_or_default();
    let depth = noise.0.checked_ilog2().map_or(0, |log| log + 1) as u8;
    depth.max(LOCKING_DEPTH).min(depths(segment, config).1.max(LOCKING_DEPTH))
}

/// Depths of 0x0934 and 0x0935 while a clock joins. The depth for the speed is already that of the
/// cycle, since newer chips forget the speed when it is written. The depth for the difference suits
/// the pace of a burst, so that the loop does not take the jitter of hops for a speed.
fn joining_depths(segment: &Segment, config: &Config) -> [u8; 2] {
    let filters = config.drift_filters;
    let (operation, speed) = depths(segment, config);
    let noise = delay::noise(segment, config.hop_jitter).into_iter().max().unwrap_or_default();
    let usual = if noise > NOISY { operation.max(NOISY_DEPTH) } else { LOCKING_DEPTH };
    [filters.difference.unwrap_or(usual), speed]
}

/// Depth of 0x0934 while clocks lock, where hops do not jitter: the mean is over a fourth of the
/// frames that speeds are averaged over, or fewer.
const LOCKING_DEPTH: u8 = 4;

/// The same where hops jitter by more than [`NOISY`] (1 sigma).
const NOISY_DEPTH: u8 = 6;

/// Deeper filters make the loop slower than the plan assumes.
const DEEPEST: u32 = 8;

/// Jitter of which the mean of 16 differences leaves a tick of 10 ns from one pace to the next.
const NOISY: Nanos = Nanos(30);

/// Register 0x0930: reset value of the chips.
pub(super) const SPEED_COUNTER_START: u16 = 0x1000;
