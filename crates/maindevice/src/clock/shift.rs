//! Delays that change because frames take another way.

use alloc::vec::Vec;

use isocat_sync::drift::Limits;
use isocat_wire::StationAddress;
use isocat_wire::dc::SystemTimeDifference;
use isocat_wire::register::{self, Value};
use isocat_wire::time::Nanos;

use super::drift_frames::drift_frame;
use super::settings::set_filter;
use crate::link::Link;
use crate::segment::SubDevice;

/// Corrects delays after frames have changed their way. If a branch is lost or comes back, the way
/// to all SubDevices behind it in the order of frames becomes shorter or longer.
///
/// A drift datagram on the new way measures the difference: 0x092C shows it while the filter of
/// 0x0934 is off. A loop that got a wrong time corrects until it gets the next one, so a second
/// drift datagram follows at once, in addition to those of the cycle. Each clock comes with the
/// limits within which it counts as converged, and with its last 0x092C, if known. Returns the
/// delays that were written.
pub(crate) async fn shift(
    link: Link,
    filter: u8,
    reference: StationAddress,
    clocks: Vec<(SubDevice, Limits, Nanos)>,
) -> Vec<(usize, Nanos)> {
    let stations = || clocks.iter().map(|(device, ..)| device.station);
    // Without the reference nothing can be measured.
    if link.fprd(reference, register::SYSTEM_TIME.address, 8).expect(1).await.is_err() {
        return Vec::new();
    }
    let unfiltered = filter > 0;
    if unfiltered {
        set_filter(&link, stations(), 0).await;
        let _lost = drift_frame(&link, reference).reply().await.is_err();
    }
    let delays = shift_by_difference(&link, reference, &clocks).await;
    if unfiltered {
        set_filter(&link, stations(), filter).await;
    }
    delays
}

async fn shift_by_difference(
    link: &Link,
    reference: StationAddress,
    clocks: &[(SubDevice, Limits, Nanos)],
) -> Vec<(usize, Nanos)> {
    let there = link.fprd(reference, register::SYSTEM_TIME.address, 8);
    let address = register::SYSTEM_TIME_DIFFERENCE.address;
    let read = |device: &SubDevice| link.fprd(device.station, address, 4);
    let reads: Vec<_> = clocks.iter().map(|clock| (clock, read(&clock.0))).collect();
    // Without the reference nothing was measured.
    if there.expect(1).await.is_err() {
        return Vec::new();
    }
    let mut writes = Vec::new();
    for ((device, limits, before), read) in reads {
        let threshold = limits.difference + limits.noise_allowed();
        let Ok(reply) = read.expect(1).await else { continue };
        let bytes = reply.data.first_chunk().copied().unwrap_or_default();
        let shown = SystemTimeDifference::from_bytes(bytes).nanos(device.difference_polarity);
        let apart = shown - *before;
        let Some(written) = device.delay else { continue };
        if apart.abs() <= threshold || apart.abs() > LONGEST_DETOUR {
            continue;
        }
        let mut delay = Nanos((written + apart).0.max(0));
        // The way is again what it was when it was measured with care.
        let measured = device.measured_delay.and_then(|measured| measured.nanos());
        if let Some(measured) = measured.filter(|measured| (delay - *measured).abs() <= threshold) {
            delay = measured;
        }
        let data = (delay.0 as u32).to_bytes();
        let write = link.fpwr(device.station, register::SYSTEM_TIME_DELAY.address, &data);
        writes.push((device.position, delay, write));
    }
    let mut delays = Vec::with_capacity(writes.len());
    if writes.is_empty() {
        return delays;
    }
    let next = drift_frame(link, reference);
    for (position, delay, write) in writes {
        if write.expect(1).await.is_ok() {
            delays.push((position, delay));
        }
    }
    // Should it be lost, that of the next cycle does the same.
    let _lost = next.reply().await.is_err();
    delays
}

/// More than any branch takes. A datagram that has not passed the reference shows larger
/// differences.
const LONGEST_DETOUR: Nanos = Nanos::millis(1);
