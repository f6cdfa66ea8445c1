//! Gives the system time to clocks that join a running segment.

use alloc::vec::Vec;

use isocat_wire::register::{self, Value};
use isocat_wire::time::Nanos;

use super::latches::{FIRST, latch_often, refine, take};
use super::settings::reset_filters;
use crate::board::Wish;
use crate::config::Config;
use crate::delay::{self, Estimator, FREE_RUNNING_PPB};
use crate::error::Cause;
use crate::hot_connect::Present;
use crate::link::Link;
use crate::segment::{DcCapability, Segment};

/// The clocks that join a running segment.
pub(crate) struct Joining {
    /// Positions of the SubDevices that join.
    pub joining: Vec<usize>,
    /// Positions of all that are present, including those that join, in processing order.
    pub there: Vec<usize>,
    /// Number of other SubDevices that answer.
    pub strangers: u16,
}

/// Gives delays and offsets to clocks that join a running segment. The clocks of other SubDevices
/// are not written.
///
/// The drift datagram reaches only the clocks behind the reference. If a SubDevice joins before the
/// reference, or no reference is left, the first clock becomes the reference ([`Wish::Lead`]). It
/// takes over the running time, so that no time jumps. Until then the datagram would write the
/// host's time to it, so the clocks are not controlled meanwhile.
pub(crate) async fn join(
    link: &Link,
    config: &Config,
    segment: &mut Segment,
    joining: Joining,
) -> Result<(), Cause> {
    let Joining { joining, there, strangers } = joining;
    let clocks = |segment: &Segment| -> Vec<usize> {
        joining.iter().copied().filter(|at| segment.devices[*at].dc.has_clock()).collect()
    };
    let clocks = clocks(segment);
    let (Some(&first), Some(before)) = (clocks.first(), segment.reference) else { return Ok(()) };
    let led = segment.devices[before].admitted;
    let reference = if led { before.min(first) } else { first };
    if reference != before {
        link.board(|board| board.wishes.push_back(Wish::HoldClocks));
        link.sleep(Nanos(2 * config.cycle.0)).await;
    }
    for &position in &clocks {
        reset_filters(link, config, segment, segment.devices[position].station).await?;
    }
    // The others as they are, without the gaps.
    let place = |position: usize| there.iter().position(|at| *at == position);
    let Some(at) = place(reference) else { return Ok(()) };
    let Present(mut present) = Present::among(segment, |device| there.contains(&device.position));
    present.reference = Some(at);
    let stations = delay::stations(&present);
    let mut estimator = Estimator::new(&present, at, FREE_RUNNING_PPB, config.hop_jitter);
    // Clocks that are left to themselves run apart: then what many latches tell is not worth their
    // time.
    let patient = config.hop_jitter && reference == before;
    let mut latches =
        latch_often(link, config, &stations, strangers, patient.then_some(FIRST)).await?;
    for (_, latch) in &latches {
        estimator.sample(latch);
    }
    let Some(last) = latches.pop() else { return Ok(()) };
    let (sent, latch) = match patient {
        true => refine(link, config, &mut estimator, &stations, strangers, last, |_| ()).await?,
        false => last,
    };
    let delays = estimator.delays();
    let entry = |position: usize| place(position).map_or(0, |at| latch[at].entry);
    // System time and delay of a SubDevice that has both: all others follow from them.
    let (known, time, delay) = if led {
        let device = &segment.devices[before];
        let time = entry(before).wrapping_add(device.offset);
        (before, time, device.delay.unwrap_or(Nanos::ZERO))
    } else {
        // Nobody has the time any more but the host.
        let time = link.board(|board| {
            let (host, dc) = board.reference_time;
            dc + (sent - host)
        });
        (first, time.count(), Nanos::ZERO)
    };
    // In a ring frames don't come back the way they went: delays are what they were.
    let in_ring = config.ring.is_some();
    let kept: Vec<Nanos> =
        segment.devices.iter().map(|device| device.delay.unwrap_or(Nanos::ZERO)).collect();
    let from_reference = |position: usize| match in_ring {
        true => kept[position],
        false => {
            let measured = place(position).and_then(|at| delays.get(at));
            measured.map_or(Nanos::ZERO, |delay| delay.or_middle())
        }
    };
    // Delays count from the first reference that there was. A clock that joins before it, and leads
    // from now on, would be behind by less than nothing: so all others are behind by more. No
    // clock moves, and none is controlled meanwhile.
    let apart = |position: usize| from_reference(position) - from_reference(known);
    let least = clocks.iter().map(|at| delay + apart(*at)).min().unwrap_or_default();
    let delay = match led && reference != before && least < Nanos::ZERO {
        true => {
            raise(link, segment, -least).await?;
            delay + -least
        }
        false => delay,
    };
    let mut writes = Vec::new();
    for &position in &clocks {
        let measured = place(position).and_then(|at| delays.get(at)).filter(|_| !in_ring).copied();
        let apart = apart(position);
        let device = &mut segment.devices[position];
        if let Some(measured) = measured {
            take(link, device, measured);
        }
        device.delay = Some(Nanos((delay + apart).0.max(0)));
        device.offset = time.wrapping_add_signed(apart.0).wrapping_sub(entry(position));
        if device.dc == DcCapability::Clock32 {
            device.offset &= u64::from(u32::MAX);
        }
        let delay = device.delay.unwrap_or(Nanos::ZERO).0 as u32;
        let offset = device.offset.to_bytes();
        writes.push(link.fpwr(device.station, register::SYSTEM_TIME_OFFSET.address, &offset));
        let delay = delay.to_bytes();
        writes.push(link.fpwr(device.station, register::SYSTEM_TIME_DELAY.address, &delay));
    }
    for write in writes {
        write.expect(1).await?;
    }
    for &position in &clocks {
        reset_filters(link, config, segment, segment.devices[position].station).await?;
    }
    if reference != before {
        segment.reference = Some(reference);
        link.board(|board| board.wishes.push_back(Wish::Lead(reference)));
    }
    Ok(())
}

/// Raises the delays of all clocks in operation.
async fn raise(link: &Link, segment: &mut Segment, by: Nanos) -> Result<(), Cause> {
    let mut writes = Vec::new();
    for device in segment.devices.iter_mut().filter(|one| one.admitted && one.dc.has_clock()) {
        let delay = device.delay.unwrap_or(Nanos::ZERO) + by;
        device.delay = Some(delay);
        let data = (delay.0 as u32).to_bytes();
        let write = link.fpwr(device.station, register::SYSTEM_TIME_DELAY.address, &data);
        writes.push((device.position, delay, write));
    }
    for (position, delay, write) in writes {
        write.expect(1).await?;
        link.board(|board| board.wishes.push_back(Wish::Delay(position, delay)));
    }
    Ok(())
}
