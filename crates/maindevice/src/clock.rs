//! Distributed clocks: delays, offsets, drift.
//!
//! 1. The port receive times are latched several times and turned into delays (`delay`).
//! 2. All clocks get one time: that of the reference clock as it runs. The host sets no date, so
//!    the segment's time counts from the power-on of the reference clock, not from the year 2000.
//!    Offsets are computed from local times of one frame, so they include the delay and no time
//!    jumps.
//! 3. The polarity of each clock's 0x092C is measured, since register documentations contradict
//!    each other.
//! 4. The filters are reset, and FRMW frames drive the drift loop until every clock has converged.

use core::sync::atomic::AtomicBool;

use isocat_wire::register::{self, Value};
use isocat_wire::time::Nanos;

use crate::config::Config;
use crate::delay::{self, Latch};
use crate::error::{AccessError, Cause};
use crate::link::Link;
use crate::segment::{DcCapability, Segment, Speed, SubDevice};

mod converge;
mod drift_frames;
mod join;
mod latches;
mod lines;
mod pace;
mod polarity;
mod settings;
mod shift;

use converge::converge;
pub(crate) use converge::follow;
pub(crate) use drift_frames::{limits, noise};
pub(crate) use join::{Joining, join};
use latches::{Latches, measure};
pub(crate) use settings::depths;
use settings::{SPEED_COUNTER_START, locking_depth, write};
pub(crate) use shift::shift;

/// Measures and sets delays and offsets, then drives the drift loop. Does nothing without a clock.
///
/// Other procedures may run beside it: its datagrams go ahead of theirs, so that its frames come in
/// time. While they do (`beside`), the clocks are driven on, so that none runs away.
pub(crate) async fn synchronize(
    link: &Link,
    config: &Config,
    segment: &mut Segment,
    beside: &AtomicBool,
) -> Result<(), Cause> {
    let Some(reference) = segment.reference else { return Ok(()) };
    let link = &link.ahead();
    let Latches { lines, last: (sent, latched) } =
        measure(link, config, segment, reference).await?;
    // How long writing takes: the clocks run apart meanwhile.
    let mut writing = Nanos::ZERO;
    if config.drift_compensation {
        set_offsets(segment, reference, &lines.at(latched));
        writing = polarity::learn(link, config, segment, reference).await?;
    }
    let by_then = link.now() + writing - sent;
    set_offsets(segment, reference, &lines.at(latched + by_then.0));
    write(link, config, segment, Nanos::ZERO, locking_depth(segment, config)).await?;
    if config.drift_compensation {
        converge(link, config, segment, reference, beside).await?;
    }
    Ok(())
}

/// Measures the speed of each free-running clock against the reference clock. Corrections that an
/// earlier run left in the clocks are reset first.
pub(crate) async fn measure_speeds(
    link: &Link,
    config: &Config,
    segment: &mut Segment,
) -> Result<(), AccessError> {
    let Some(reference) = segment.reference else { return Ok(()) };
    let start = SPEED_COUNTER_START.to_bytes();
    link.bwr(register::SPEED_COUNTER_START.address, &start).reply().await?;
    let stations = delay::stations(segment);
    let mut tries = 0;
    let (first, last) = loop {
        let first = delay::latch(link, &stations).await;
        link.sleep(SPEED_WINDOW).await;
        match (first, delay::latch(link, &stations).await) {
            (Ok(first), Ok(last)) => break (first, last),
            (Err(error), _) | (_, Err(error)) if tries == MOST_TRIES => return Err(error),
            _ => tries += 1,
        }
    };
    // Half of what a clock of 32 bits holds; a host that slept longer has measured nothing.
    let counted = |at: usize, device: &SubDevice| {
        let time = |latch: &Latch| match device.dc.has_clock() {
            true => Some(latch.entry as u32),
            false => latch.ports.map(|ports| ports[device.entry.index()]),
        };
        let span = time(last.get(at)?)?.wrapping_sub(time(first.get(at)?)?);
        i32::try_from(span).ok().map(i64::from).filter(|span| *span > 0)
    };
    let Some(window) = counted(reference, &segment.devices[reference]) else { return Ok(()) };
    let noise = noise(segment, config);
    for (at, device) in segment.devices.iter_mut().enumerate() {
        device.observed.speed = counted(at, device).map(|span| Speed {
            ppb: (span - window) * 1_000_000_000 / window,
            // The first tick may be missing at one clock and the last at the other, and each of
            // both frames may have been late or early.
            error_ppb: match at == reference {
                true => 0,
                false => (2 * TICK_E9 + SIGMAS * noise[at].0 * 1_000_000_000) / window,
            },
            window: Nanos(window),
        });
    }
    Ok(())
}

/// Offsets that give every clock the reference's own time. A frame that entered the reference at
/// its local time `r` enters a SubDevice `delay` later, at the local time `l` there: its system
/// time is then `r + delay`, so its offset is `r + delay - l`. All wraps as the registers do.
///
/// `entries` are the local times of one frame: that of the first drift frame, so that each loop
/// begins without a difference. A loop takes for drift what the filter of 0x0934 passes of it.
fn set_offsets(segment: &mut Segment, reference: usize, entries: &[u64]) {
    let time = entries[reference];
    for (device, entry) in segment.devices.iter_mut().zip(entries) {
        let delay = device.delay.unwrap_or(Nanos::ZERO).0;
        device.offset = time.wrapping_add_signed(delay).wrapping_sub(*entry);
        if device.dc == DcCapability::Clock32 {
            device.offset &= u64::from(u32::MAX);
        }
    }
    segment.devices[reference].offset = 0;
}

/// Time from one latch to the other. At this length the two ticks of 10 ns make 0.1 ppm.
const SPEED_WINDOW: Nanos = Nanos(200_000_000);

/// A tick of 10 ns, in ns times 10^9.
const TICK_E9: i64 = 10_000_000_000;

/// Standard deviations of the jitter of hops in the difference of two frames: three, times the root
/// of two.
const SIGMAS: i64 = 4;

/// Number of pairs of latches that may be lost.
const MOST_TRIES: usize = 3;
