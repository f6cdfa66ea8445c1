//! Distributed clocks: delays, offsets, drift.
//!
//! 1. The port receive times are latched several times and turned into delays (`delay`).
//! 2. All clocks get one time: that of the reference clock as it runs. The host sets no date, so
//!    the segment's time counts from the power-on of the reference clock, not from the year 2000.
//!    Offsets are computed from local times of one frame, so they include the delay and no time
//!    jumps.
//! 3. The polarity of each clock's 0x092C is measured, since register documentations contradict
//!    each other.
//! 4. The filters are reset, and the first drift frame leaves in each the phase that its clock will
//!    gain. FRMW frames then drive the drift loop until every clock has converged.

use alloc::vec::Vec;
use core::sync::atomic::AtomicBool;

use isocat_wire::register::{self, Value};
use isocat_wire::time::{Host, Nanos, Time};

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

pub(crate) use converge::follow;
use converge::{converge, first_pace};
use drift_frames::drift_frame_that_returns;
pub(crate) use drift_frames::{limits, noise};
pub(crate) use join::{Joining, join};
use latches::{Latches, measure};
pub(crate) use settings::depths;
use settings::{SPEED_COUNTER_START, locking_depth, write, write_offsets};
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
    let entries = |at: Time<Host>| lines.at(latched + (at - sent).0);
    let depth = locking_depth(segment, config);
    if !config.drift_compensation {
        set_offsets(segment, reference, &entries(link.now()), &[]);
        return Ok(write(link, config, segment, Nanos::ZERO, depth).await?);
    }
    set_offsets(segment, reference, &entries(sent), &[]);
    // How long writing takes: the clocks run apart meanwhile.
    let writing = polarity::learn(link, config, segment, reference).await?;
    // While a loop learns its speed, its clock gains this. So it begins as far behind, and the
    // filter of its loop with it: the first drift frame leaves 1 / 2^depth of a difference there.
    // The loop would take for drift what the filter passes later.
    let gained = lines.gained_in(first_pace(segment, config, reference).mean());
    let behind: Vec<Nanos> = gained.into_iter().map(|gained| -gained).collect();
    let far: Vec<Nanos> = behind.iter().map(|phase| Nanos(phase.0 << depth)).collect();
    set_offsets(segment, reference, &entries(link.now() + writing), &far);
    write(link, config, segment, Nanos::ZERO, depth).await?;
    drift_frame_that_returns(link, segment.devices[reference].station).await?;
    // Offsets alone are half of it.
    set_offsets(segment, reference, &entries(link.now() + Nanos(writing.0 / 2)), &behind);
    write_offsets(link, segment).await?;
    converge(link, config, segment, reference, beside).await
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
/// `entries` are the local times of one frame: that of the next drift frame. It then finds each
/// clock by its phase in `phases` ahead of the reference; missing phases are zero.
fn set_offsets(segment: &mut Segment, reference: usize, entries: &[u64], phases: &[Nanos]) {
    let time = entries[reference];
    for (at, (device, entry)) in segment.devices.iter_mut().zip(entries).enumerate() {
        let delay = device.delay.unwrap_or(Nanos::ZERO);
        let ahead = delay + phases.get(at).copied().unwrap_or_default();
        device.offset = time.wrapping_add_signed(ahead.0).wrapping_sub(*entry);
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
