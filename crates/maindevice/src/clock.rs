//! Distributed clocks: delays, offsets, drift.
//!
//! 1. The port receive times are latched several times and turned into delays (`delay`).
//! 2. All clocks get one time: that of the reference clock as it runs. The host gives no date, so
//!    the segment's time is not the time since 2000 but that since the reference was switched on.
//!    Offsets are made from local times of one and the same frame, so the delay is in them and
//!    nothing jumps.
//! 3. The filters are reset and the drift loop is driven by FRMW until every clock has converged.

use alloc::vec;
use alloc::vec::Vec;

use isocat_sync::delay::Delay;
use isocat_sync::drift::{Convergence, Limits, Verdict};
use isocat_wire::StationAddress;
use isocat_wire::command::Command;
use isocat_wire::datagram::Address;
use isocat_wire::dc::SystemTimeDifference;
use isocat_wire::register::{self, Value};
use isocat_wire::time::{Host, Nanos, Time};

use crate::board::Wish;
use crate::config::Config;
use crate::delay::{self, Estimator, FREE_RUNNING_PPB, Latch, Times};
use crate::error::{AccessError, Cause};
use crate::event::Event;
use crate::hot_connect::Present;
use crate::link::{Exchange, Link, Travel};
use crate::segment::{DcCapability, Segment, Speed, SubDevice};

/// Measures and sets delays and offsets, then drives the drift loop. Nothing to do without a clock.
pub(crate) async fn synchronize(
    link: &Link,
    config: &Config,
    segment: &mut Segment,
) -> Result<(), Cause> {
    let Some(reference) = segment.reference else { return Ok(()) };
    let last = measure_delays(link, config, segment, reference).await?;
    set_offsets(segment, reference, &last);
    write(link, segment).await?;
    if config.drift_compensation {
        converge(link, config, segment, reference).await?;
    }
    Ok(())
}

/// How fast each clock runs when nobody leads it, against the reference clock. Corrections that an earlier run
/// left in the clocks are taken away first.
pub(crate) async fn measure_speeds(link: &Link, segment: &mut Segment) -> Result<(), AccessError> {
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
    for (at, device) in segment.devices.iter_mut().enumerate() {
        device.observed.speed = counted(at, device).map(|span| Speed {
            ppb: (span - window) * 1_000_000_000 / window,
            // The first tick may be missing at one clock and the last at the other.
            error_ppb: if at == reference { 0 } else { 2 * TICK_E9 / window },
            window: Nanos(window),
        });
    }
    Ok(())
}

/// Clocks that come into a running segment.
pub(crate) struct Joining {
    /// Positions of those that come.
    pub joining: Vec<usize>,
    /// Positions of all that are there, those that come included, in processing order.
    pub there: Vec<usize>,
    /// Others that answer.
    pub strangers: u16,
}

/// Gives clocks that come into a running segment their delays and offsets; nobody else's clock is written to.
///
/// The drift datagram reaches what lies behind the reference only. So where one comes that lies before it, or
/// where no reference is left, the first of them leads from now on ([`Wish::Lead`]); it takes over the time as it
/// runs, so that nothing jumps. Until it does, the datagram would write the host's time to it, and the clocks are
/// left to themselves.
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
        reset_filters(link, segment.devices[position].station).await?;
    }
    // The others as they are, without the gaps.
    let place = |position: usize| there.iter().position(|at| *at == position);
    let Some(at) = place(reference) else { return Ok(()) };
    let Present(mut present) = Present::among(segment, |device| there.contains(&device.position));
    present.reference = Some(at);
    let stations = delay::stations(&present);
    let mut estimator = Estimator::new(&present, at, FREE_RUNNING_PPB);
    let mut latches = latch_often(link, config, &stations, strangers).await?;
    for (_, latch) in &latches {
        estimator.sample(latch);
    }
    let Some((sent, latch)) = latches.pop() else { return Ok(()) };
    let delays = estimator.delays();
    let entry = |position: usize| place(position).map_or(0, |at| latch[at].entry);
    // System time and delay of whoever has both: all others follow from them.
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
    let mut writes = Vec::new();
    for &position in &clocks {
        let measured = place(position).and_then(|at| delays.get(at)).filter(|_| !in_ring).copied();
        let apart = from_reference(position) - from_reference(known);
        let device = &mut segment.devices[position];
        if let Some(measured) = measured {
            take(link, device, measured);
        }
        // Delays count from the first reference that there was.
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
        reset_filters(link, segment.devices[position].station).await?;
    }
    if reference != before {
        segment.reference = Some(reference);
        link.board(|board| board.wishes.push_back(Wish::Lead(reference)));
    }
    Ok(())
}

/// Sets delays right after frames have come to take another way: a branch that is gone, or back, makes it shorter
/// or longer to all that lie behind it in the order of frames.
///
/// The first drift datagram on the new way has measured by how much, as the clocks themselves agreed until then:
/// 0x092C shows it. A loop that has taken a wrong time for a right one pulls until it gets the next, so that follows
/// at once, in a drift datagram beside those of the cycle. Gives the delays that were written.
pub(crate) async fn shift(
    link: Link,
    threshold: Nanos,
    reference: StationAddress,
    clocks: Vec<SubDevice>,
) -> Vec<(usize, Nanos)> {
    let there = link.fprd(reference, register::SYSTEM_TIME.address, 8);
    let address = register::SYSTEM_TIME_DIFFERENCE.address;
    let reads: Vec<_> =
        clocks.iter().map(|device| (device, link.fprd(device.station, address, 4))).collect();
    // Without the reference nothing was measured.
    if there.expect(1).await.is_err() {
        return Vec::new();
    }
    let mut writes = Vec::new();
    for (device, read) in reads {
        let Ok(reply) = read.expect(1).await else { continue };
        let bytes = reply.data.first_chunk().copied().unwrap_or_default();
        let apart = SystemTimeDifference::from_bytes(bytes).nanos();
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
    let address = Address::Station(reference, register::SYSTEM_TIME.address);
    let travel = Travel { alone: true, once: true };
    let next = link.exchange(Command::Frmw, address, vec![0; 8], travel);
    link.board(|board| board.statistics.drift_frames += 1);
    for (position, delay, write) in writes {
        if write.expect(1).await.is_ok() {
            delays.push((position, delay));
        }
    }
    // Should it be lost, that of the next cycle does the same.
    let _lost = next.reply().await.is_err();
    delays
}

/// More than any branch takes; a datagram that has not passed the reference makes differences beyond.
const LONGEST_DETOUR: Nanos = Nanos::millis(1);

/// Filter depths and, last, the write to 0x0930 that clears all filters of this clock.
async fn reset_filters(link: &Link, station: StationAddress) -> Result<(), AccessError> {
    let depths = [TIME_FILTER_DEPTH, SPEED_FILTER_DEPTH];
    link.fpwr(station, register::TIME_FILTER_DEPTH.address, &depths).expect(1).await?;
    link.write(station, register::SPEED_COUNTER_START, SPEED_COUNTER_START).await
}

/// Waits until a clock has converged, led by the drift datagram of the cycle and, as a loop pulls by so much for
/// each, by more of them.
pub(crate) async fn follow(
    link: &Link,
    config: &Config,
    reference: StationAddress,
    device: &mut SubDevice,
) -> Result<(), Cause> {
    let begin = link.now();
    let end = begin + config.timeouts.drift;
    let limits = Limits { difference: config.drift_threshold, ..Limits::default() };
    let mut judge = Convergence::new(limits);
    loop {
        let next_reading = link.now() + READING_INTERVAL;
        while link.now() < next_reading {
            hasten(link, reference).await;
        }
        let clocks = [(device.position, device.station)];
        for (at, difference) in read_differences(link, &clocks).await? {
            device.difference = Some(difference);
            judge.sample(at, difference);
        }
        match judge.verdict() {
            Verdict::Converged { .. } => return Ok(()),
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

/// One more drift frame than the cycle's own when its time has come, whoever of several asks first. The others stay where
/// they are: it is the same time, told more often.
///
/// They come evenly. What a loop steers lasts until the next time is received, and it takes the time since the last one for
/// that until the next: after several in a row it would steer for long what is meant for a moment.
///
/// What counts wrongly is seen by the cycle's own datagram.
async fn hasten(link: &Link, reference: StationAddress) {
    let now = link.now();
    let due = link.board(|board| {
        let due = board.hastened + PACE;
        if board.leading && now >= due {
            board.hastened = now;
            board.statistics.drift_frames += 1;
            return None;
        }
        Some(due.max(now + PACE))
    });
    if let Some(due) = due {
        return link.until(due).await;
    }
    let address = Address::Station(reference, register::SYSTEM_TIME.address);
    let travel = Travel { alone: true, once: true };
    // One that is lost matters nothing, the next brings a newer time.
    let frame = link.exchange(Command::Frmw, address, vec![0; 8], travel);
    let _lost = frame.reply().await.is_err();
}

/// As many latches as are wanted, each with the instant before it; some may be lost, not more than come back.
async fn latch_often(
    link: &Link,
    config: &Config,
    stations: &[(StationAddress, DcCapability)],
    strangers: u16,
) -> Result<Vec<(Time<Host>, Times)>, Cause> {
    let wanted = config.delay_latches.max(1);
    let mut latches = Vec::with_capacity(wanted);
    let mut lost = 0;
    while latches.len() < wanted {
        let sent = link.now();
        match delay::latch_among(link, stations, strangers).await {
            Ok(latch) => latches.push((sent, latch)),
            Err(error) => {
                lost += 1;
                if lost > wanted {
                    return Err(error.into());
                }
            }
        }
    }
    link.board(|board| {
        board.statistics.delay_latches += wanted as u64;
        board.statistics.delay_latches_lost += lost as u64;
    });
    Ok(latches)
}

/// Latches several times; delays become the mean. Gives the last latch.
async fn measure_delays(
    link: &Link,
    config: &Config,
    segment: &mut Segment,
    reference: usize,
) -> Result<Times, Cause> {
    let wanted = config.delay_latches.max(1);
    let stations = delay::stations(segment);
    let latches = latch_often(link, config, &stations, 0).await?;
    let mut times: Vec<Times> = latches.into_iter().map(|(_, latch)| latch).collect();
    delay::find_entries(segment, times.get(wanted.wrapping_sub(2)), &times[wanted - 1])?;
    let mut estimator = Estimator::new(segment, reference, FREE_RUNNING_PPB);
    for latch in &times {
        estimator.sample(latch);
    }
    for (position, (device, delay)) in
        segment.devices.iter_mut().zip(estimator.delays()).enumerate()
    {
        take(link, device, delay);
        let mean = estimator.mean(position);
        device.delay_spread = delay.nanos().map(|_| Nanos(mean.spread().0 / 1_000));
        device.delay_latches_left_out = mean.left_out();
    }
    Ok(times.pop().unwrap_or_default())
}

/// Takes over what was measured. A clock whose delay can't be known is led all the same, with the middle of what
/// is possible, and is reported.
fn take(link: &Link, device: &mut SubDevice, delay: Delay) {
    device.measured_delay = Some(delay);
    device.delay = delay.nanos();
    if let Delay::Indeterminate { why, between } = delay
        && device.dc.has_clock()
    {
        let used = delay.or_middle();
        device.delay = Some(used);
        let position = device.position;
        link.report(Event::DelayUnknown { position, why, between, used });
    }
}

/// Offsets that give every clock the reference's own time. A frame that entered the reference at
/// its local time `r` enters a SubDevice `delay` later, at the local time `l` there: its system
/// time is then `r + delay`, so its offset is `r + delay - l`. All wraps as the registers do.
fn set_offsets(segment: &mut Segment, reference: usize, latches: &[Latch]) {
    let time = latches[reference].entry;
    for (device, latch) in segment.devices.iter_mut().zip(latches) {
        let delay = device.delay.unwrap_or(Nanos::ZERO).0;
        device.offset = time.wrapping_add_signed(delay).wrapping_sub(latch.entry);
        if device.dc == DcCapability::Clock32 {
            device.offset &= u64::from(u32::MAX);
        }
    }
    segment.devices[reference].offset = 0;
}

/// Writes delay and offset of every clock and resets its filters. Filter depths first: the write to
/// 0x0930 is the one that clears all of them.
async fn write(link: &Link, segment: &Segment) -> Result<(), Cause> {
    let clocks = || segment.devices.iter().filter(|device| device.dc.has_clock());
    let mut writes = Vec::new();
    for device in clocks() {
        let delay = device.delay.unwrap_or(Nanos::ZERO).0 as u32;
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
    let depths = [TIME_FILTER_DEPTH, SPEED_FILTER_DEPTH];
    link.bwr(register::TIME_FILTER_DEPTH.address, &depths).expect(count).await?;
    let start = SPEED_COUNTER_START.to_bytes();
    link.bwr(register::SPEED_COUNTER_START.address, &start).expect(count).await?;
    Ok(())
}

/// Drives the drift loop until every clock has converged: a stream of FRMW, several in flight, with
/// a look at 0x092C of all clocks now and then.
async fn converge(
    link: &Link,
    config: &Config,
    segment: &mut Segment,
    reference: usize,
) -> Result<(), Cause> {
    let begin = link.now();
    let end = begin + config.timeouts.drift;
    let limits = Limits { difference: config.drift_threshold, ..Limits::default() };
    let clocks: Vec<(usize, StationAddress)> = segment
        .devices
        .iter()
        .enumerate()
        .filter(|(at, device)| device.dc.has_clock() && *at != reference)
        .map(|(at, device)| (at, device.station))
        .collect();
    let mut judged: Vec<_> = clocks.iter().map(|_| Convergence::new(limits)).collect();
    let count = clocks.len() as u16 + 1;
    let station = segment.devices[reference].station;
    let mut burst = Burst { link, station, count, in_flight: Vec::new() };
    let mut next_reading = begin + READING_INTERVAL;
    loop {
        burst.until(next_reading).await?;
        next_reading = link.now() + READING_INTERVAL;
        let readings = read_differences(link, &clocks).await?;
        for (((device, _), judge), (at, difference)) in clocks.iter().zip(&mut judged).zip(readings)
        {
            segment.devices[*device].difference = Some(difference);
            judge.sample(at, difference);
        }
        let converged = judged.iter().all(|one| matches!(one.verdict(), Verdict::Converged { .. }));
        if converged {
            burst.finish().await?;
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

/// Register 0x092C of every clock, with the time stamp of the frame that read it.
async fn read_differences(
    link: &Link,
    clocks: &[(usize, StationAddress)],
) -> Result<Vec<(Time<Host>, Nanos)>, AccessError> {
    let address = register::SYSTEM_TIME_DIFFERENCE.address;
    let reads: Vec<_> = clocks.iter().map(|(_, station)| link.fprd(*station, address, 4)).collect();
    let mut all = Vec::with_capacity(reads.len());
    for read in reads {
        let reply = read.expect(1).await?;
        let bytes = reply.data.first_chunk().copied().unwrap_or_default();
        all.push((reply.sent, SystemTimeDifference::from_bytes(bytes).nanos()));
    }
    Ok(all)
}

/// A stream of drift frames.
struct Burst<'a> {
    link: &'a Link,
    station: StationAddress,
    /// What each must count: the reference read, all other clocks written.
    count: u16,
    in_flight: Vec<Exchange>,
}

impl Burst<'_> {
    /// Keeps several frames in flight until `end`.
    async fn until(&mut self, end: Time<Host>) -> Result<(), AccessError> {
        while self.link.now() < end {
            while self.in_flight.len() < IN_FLIGHT {
                self.send();
            }
            let oldest = self.in_flight.remove(0);
            self.take(oldest).await?;
        }
        Ok(())
    }

    /// Waits for what is in flight.
    async fn finish(mut self) -> Result<(), AccessError> {
        while !self.in_flight.is_empty() {
            let oldest = self.in_flight.remove(0);
            self.take(oldest).await?;
        }
        Ok(())
    }

    /// One drift frame alone: the loop takes one value a frame.
    fn send(&mut self) {
        let address = Address::Station(self.station, register::SYSTEM_TIME.address);
        let travel = Travel { alone: true, once: true };
        let exchange = self.link.exchange(Command::Frmw, address, vec![0; 8], travel);
        self.link.board(|board| board.statistics.drift_frames += 1);
        self.in_flight.push(exchange);
    }

    /// A lost drift frame matters nothing, the next one brings a newer time. One that counts
    /// wrongly does: a clock is not led.
    async fn take(&self, exchange: Exchange) -> Result<(), AccessError> {
        match exchange.expect(self.count).await {
            Err(error) if error.is_lost() => Ok(()),
            other => other.map(|_| ()),
        }
    }
}

/// From one latch to the other: both ticks of 10 ns then make 0.1 ppm.
const SPEED_WINDOW: Nanos = Nanos(200_000_000);
/// A tick of 10 ns, in ns times 10^9.
const TICK_E9: i64 = 10_000_000_000;
/// Pairs of latches that may be lost.
const MOST_TRIES: usize = 3;
/// From one drift frame to the next while a clock joins, beside those of the cycle. They take 7 % of the wire, and a tenth of
/// the time that the cycle's own would at 1 ms.
const PACE: Nanos = Nanos(100_000);
/// Drift frames in flight: enough to fill the time of one round trip through a short line.
const IN_FLIGHT: usize = 8;
/// Between two readings of 0x092C: 16 of them make a window in which a slope of 1 ppm shows.
const READING_INTERVAL: Nanos = Nanos(2_000_000);
/// Register 0x0934: differences unfiltered at start, as TwinCAT and SOEM set it.
const TIME_FILTER_DEPTH: u8 = 0;
/// Register 0x0935: reset value of the chips.
const SPEED_FILTER_DEPTH: u8 = 12;
/// Register 0x0930: reset value of the chips.
const SPEED_COUNTER_START: u16 = 0x1000;
