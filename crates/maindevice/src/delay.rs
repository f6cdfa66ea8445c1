//! Propagation delays: latching the receive times, and the evaluation of many latches.
//!
//! [`latch`] is the procedure; [`Estimator`] takes its [`Times`] and returns the delays of all
//! SubDevices. A latch whose frame was lost, or that not every SubDevice took, is discarded and
//! counted by [`Statistics`](crate::Statistics). If the times of a single SubDevice contradict each
//! other, the latch is left out for it, and for SubDevices below it if their branch cannot be
//! determined.

use alloc::vec;
use alloc::vec::Vec;

use isocat_sync::delay::{
    Averaging, Delay, Found, Hop, HopJitter, Mean, Node, Stay, hop_jitter, propagation_delays,
};
use isocat_wire::command::Command;
use isocat_wire::datagram::Address;
use isocat_wire::register;
use isocat_wire::time::{Nanos, Picos};
use isocat_wire::{PortNumber, StationAddress};

use crate::error::{AccessError, AccessProblem, Cause};
use crate::link::{Exchange, Link, Travel};
use crate::segment::{DcCapability, Segment, SubDevice};
use crate::topology;

/// Times of one latch at one SubDevice.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) struct Latch {
    /// Registers 0x0900 to 0x090F; `None` without receive times.
    pub ports: Option<[u32; 4]>,
    /// Register 0x0918; 0 without a clock.
    pub entry: u64,
}

/// One latch of all SubDevices, by position.
pub(crate) type Times = Vec<Latch>;

/// Which SubDevices latch, by position.
pub(crate) struct Stations {
    /// Station and what its DC unit can do.
    list: Vec<(StationAddress, DcCapability)>,
    /// Whether one of them stamps the next frame instead of the one that latches. No other frame
    /// may then be in flight.
    quiet: bool,
}

impl Stations {
    /// Whether a latch waits until nothing else is under way.
    pub const fn are_quiet(&self) -> bool {
        self.quiet
    }
}

/// All SubDevices of a segment.
pub(crate) fn stations(segment: &Segment) -> Stations {
    let devices = &segment.devices;
    let list = devices.iter().map(|device| (device.station, device.dc)).collect();
    Stations { list, quiet: devices.iter().any(|device| stamps_next_frame(device.esc.kind)) }
}

/// Whether a write to 0x0900 makes ports 1 to 3 stamp the next frame that arrives there, whatever
/// its content. ESC20 and ET1200 do so, by their type (register 0x0000). Others stamp the frame
/// that writes.
fn stamps_next_frame(kind: u8) -> bool {
    matches!(kind, 0x02 | 0x12)
}

/// Writes 0x0900 once and reads all times that it latched. It disturbs neither SYNC nor the drift
/// loop, since they do not use these times.
pub(crate) async fn latch(link: &Link, stations: &Stations) -> Result<Times, AccessError> {
    latch_among(link, stations, 0).await
}

/// The same, but up to `strangers` other SubDevices may take the write too.
pub(crate) async fn latch_among(
    link: &Link,
    Stations { list: stations, quiet }: &Stations,
    strangers: u16,
) -> Result<Times, AccessError> {
    let timed = stations.iter().filter(|(_, dc)| dc.has_receive_times()).count();
    // A repetition after a loss might mix the times of two frames, so a new latch is made instead.
    let travel = Travel { once: true, quiet: *quiet, ..Travel::default() };
    let address = Address::Broadcast(register::RECEIVE_TIME_0.address);
    let write = link.exchange(Command::Bwr, address, vec![0; 4], travel);
    let (expected, found) = (timed as u16, write.reply().await?.wkc);
    if !(expected..=expected + strangers).contains(&found) {
        let problem = AccessProblem::WorkingCounter { expected, found };
        return Err(AccessError { command: Command::Bwr, address, problem });
    }
    let reads: Vec<Option<(Exchange, Option<Exchange>)>> = stations
        .iter()
        .map(|(station, dc)| {
            dc.has_receive_times().then(|| {
                let ports = link.fprd(*station, register::RECEIVE_TIME_0.address, 16);
                let entry = dc
                    .has_clock()
                    .then(|| link.fprd(*station, register::RECEIVE_TIME_EPU.address, 8));
                (ports, entry)
            })
        })
        .collect();
    let mut all = Vec::with_capacity(reads.len());
    for read in reads {
        let mut latch = Latch::default();
        if let Some((ports, entry)) = read {
            let bytes = ports.bytes::<16>(1).await?;
            let time = |port: PortNumber| {
                let bytes = bytes.get(4 * port.index()..).unwrap_or_default();
                bytes.first_chunk().map_or(0, |bytes| u32::from_le_bytes(*bytes))
            };
            latch.ports = Some(PortNumber::ALL.map(time));
            if let Some(entry) = entry {
                latch.entry = u64::from_le_bytes(entry.bytes(1).await?);
            }
        }
        all.push(latch);
    }
    Ok(all)
}

/// Finds the port at which frames enter each SubDevice with receive times, and from that its
/// parent. A port whose time did not change from one latch to the next was not reached.
pub(crate) fn find_entries(
    segment: &mut Segment,
    before: Option<&Times>,
    latches: &Times,
) -> Result<(), Cause> {
    for (position, (device, latch)) in segment.devices.iter_mut().zip(latches).enumerate() {
        if let Some(times) = &latch.ports {
            let before = before.and_then(|before| before.get(position)?.ports);
            device.entry = topology::entry_by_times(device.dl_status, times, before.as_ref());
        }
    }
    let ports: Vec<_> = segment
        .devices
        .iter()
        .zip(latches)
        .map(|(device, latch)| topology::Ports {
            status: device.dl_status,
            entry: device.entry,
            times: latch.ports,
        })
        .collect();
    for (device, parent) in segment.devices.iter_mut().zip(topology::parents(&ports)?) {
        device.parent = parent;
    }
    Ok(())
}

/// Computes delays from many latches. It does no input or output: [`Estimator::sample`] takes the
/// times that were read.
pub(crate) struct Estimator {
    /// Their receive times are those of the last latch.
    nodes: Vec<Node>,
    reference: usize,
    rate_ppb: u32,
    found: Vec<Found>,
    means: Vec<Mean>,
    previous: Vec<Option<[u32; 4]>>,
    latches: usize,
    /// Largest plausible change of a round trip from latch to latch, ns; a larger one shows a stale
    /// time.
    most_change: u32,
}

impl Estimator {
    /// An estimator for a segment whose parents are known. `rate_ppb`: how much the speeds of two
    /// clocks may differ; `jitters`: [`Config::hop_jitter`](crate::Config::hop_jitter).
    pub fn new(segment: &Segment, reference: usize, rate_ppb: u32, jitters: bool) -> Self {
        let count = segment.devices.len();
        let longest_jitter = if jitters { HOP_CHANGE_NS.saturating_mul(count as u32) } else { 0 };
        Self {
            nodes: segment.devices.iter().map(node).collect(),
            reference,
            rate_ppb,
            found: vec![Found::default(); count],
            means: jitter(segment, reference, jitters).into_iter().map(Mean::expecting).collect(),
            previous: vec![None; count],
            latches: 0,
            most_change: MOST_CHANGE_NS + longest_jitter.min(MOST_JITTER_NS),
        }
    }

    /// Takes one latch.
    pub fn sample(&mut self, times: &Times) {
        for ((node, previous), latch) in self.nodes.iter_mut().zip(&mut self.previous).zip(times) {
            node.receive_times = latch.ports;
            if let (Some(times), Some(before)) = (latch.ports, *previous) {
                node.receive_times = Some(without_stale(node, times, before, self.most_change));
            }
            *previous = latch.ports;
        }
        propagation_delays(&self.nodes, self.reference, self.rate_ppb, &mut self.found);
        for (mean, found) in self.means.iter_mut().zip(&self.found) {
            mean.add(found);
        }
        self.latches += 1;
    }

    /// Number of latches taken.
    pub fn latches(&self) -> usize {
        self.latches
    }

    /// The largest standard error of the known delays.
    pub fn worst_error(&self) -> Picos {
        let error = |delay: Delay| match delay {
            Delay::Known { standard_error, .. } => standard_error,
            Delay::Indeterminate { .. } => Picos::ZERO,
        };
        self.delays().into_iter().map(error).max().unwrap_or_default()
    }

    /// The delays, by position.
    pub fn delays(&self) -> Vec<Delay> {
        let averaging = Averaging::of(&self.means);
        self.means.iter().map(|mean| mean.delay(averaging)).collect()
    }

    /// The mean of one SubDevice.
    pub fn mean(&self, position: usize) -> Mean {
        self.means.get(position).copied().unwrap_or_default()
    }

    /// Forgets all latches but the last, whose times show which of the next ones are stale.
    pub fn restart(&mut self) {
        self.means.iter_mut().for_each(|mean| *mean = mean.restarted());
        self.latches = 0;
    }
}

/// The times; if a port holds the time of an earlier frame, times that contradict each other. The
/// round trip to such a port changed by the time between two latches.
fn without_stale(node: &Node, times: [u32; 4], before: [u32; 4], most_change: u32) -> [u32; 4] {
    let entry = node.entry.index();
    let open = |port: &PortNumber| node.open[port.index()] && *port != node.entry;
    let stale = PortNumber::ALL.into_iter().filter(open).find(|port| {
        let round = |times: [u32; 4]| times[port.index()].wrapping_sub(times[entry]);
        let change = round(times).wrapping_sub(round(before)) as i32;
        change.unsigned_abs() > most_change
    });
    let mut times = times;
    if let Some(port) = stale {
        // This is before the frame entered.
        times[port.index()] = times[entry].wrapping_sub(1);
    }
    times
}

fn node(device: &SubDevice) -> Node {
    let mut stay = Stay::of_esc(device.esc.kind);
    if !device.dc.has_receive_times() {
        // Its entry port is not known either, so its two stays may be exchanged.
        let difference = (stay.processing - stay.forwarding).abs();
        stay.difference_bound += difference + difference;
    }
    Node {
        parent: device.parent,
        entry: device.entry,
        open: PortNumber::ALL.map(|port| device.dl_status.open(port)),
        receive_times: None,
        stay,
    }
}

/// The jitter of frames on their way from the reference clock, by position; zero if hops do not
/// jitter.
pub(crate) fn jitter(segment: &Segment, reference: usize, jitters: bool) -> Vec<HopJitter> {
    let mut all = vec![HopJitter::default(); segment.devices.len()];
    if !jitters {
        return all;
    }
    let hop = |device: &SubDevice| {
        let above = device.parent.and_then(|(at, port)| Some((segment.devices.get(at)?, port)));
        Hop {
            parent: device.parent,
            out: receive_period(device.esc.ports, device.entry),
            back: above.map_or(Picos::ZERO, |(above, port)| receive_period(above.esc.ports, port)),
        }
    };
    let hops: Vec<Hop> = segment.devices.iter().map(hop).collect();
    hop_jitter(&hops, &mut all);
    let first = all.get(reference).copied().unwrap_or_default();
    for jitter in &mut all {
        jitter.arrival = jitter.arrival.saturating_sub(first.arrival);
        jitter.delay = jitter.delay.saturating_sub(first.delay);
    }
    all
}

/// Standard deviation of 0x092C by position (1 sigma), before its filter, in whole ns, rounded up.
pub(crate) fn noise(segment: &Segment, jitters: bool) -> Vec<Nanos> {
    let all = jitter(segment, segment.reference.unwrap_or(0), jitters);
    all.iter().map(|one| Nanos((one.arrival_deviation().0 + 999) / 1_000)).collect()
}

/// Period of the clock that takes frames from a port into the ESC's own clock, by the kind of port
/// (register 0x0007): the nibble clock for MII, a tick for EBUS. It is a bound; how often it is
/// reached is not published.
fn receive_period(ports: u8, port: PortNumber) -> Picos {
    const EBUS: u8 = 0b10;
    match ports >> (2 * port.index()) & 0b11 {
        EBUS => Picos(10_000),
        _ => Picos(40_000),
    }
}

/// Largest difference of the speeds of two free-running clocks: 50 ppm each.
pub(crate) const FREE_RUNNING_PPB: u32 = 100_000;
/// The same for clocks in a drift loop: within 1 ppm, or they would not stay together.
pub(crate) const STEERED_PPB: u32 = 1_000;
/// A round trip changes by ticks and jitter from latch to latch. With a stale time it changes by
/// the time in between, which is longer than a frame.
const MOST_CHANGE_NS: u32 = 2_000;
/// How much one hop, there and back, may add to it.
const HOP_CHANGE_NS: u32 = 80;
/// Limit of that addition: half of the shortest pause between two latches.
const MOST_JITTER_NS: u32 = 500_000;

#[cfg(test)]
mod tests {
    use isocat_sync::delay::Why;
    use isocat_wire::dl::DlStatus;

    use super::*;

    fn line(count: usize) -> Segment {
        let device = |position: usize| {
            let mut device = SubDevice::new(position, StationAddress(0x1001 + position as u16));
            let open = |status: DlStatus, port| status.with_port(port, true, false, true);
            device.dl_status = open(DlStatus::default(), PortNumber::P0);
            if position + 1 < count {
                device.dl_status = open(device.dl_status, PortNumber::P1);
            }
            device.parent = position.checked_sub(1).map(|above| (above, PortNumber::P1));
            device.dc = DcCapability::Clock64;
            device.esc.kind = 0x11;
            device
        };
        Segment { devices: (0..count).map(device).collect(), ..Segment::default() }
    }

    fn times(loops: &[u32], at: u32) -> Times {
        let ports =
            |time: &u32| Latch { ports: Some([at, at.wrapping_add(*time), 0, 0]), entry: 0 };
        loops.iter().map(ports).collect()
    }

    fn nanos(estimator: &Estimator) -> Vec<Option<i64>> {
        estimator.delays().iter().map(|delay| delay.nanos().map(|delay| delay.0)).collect()
    }

    #[test]
    fn latches_become_one_delay() {
        let mut estimator = Estimator::new(&line(3), 0, FREE_RUNNING_PPB, false);
        for (number, first) in [600, 610, 620, 610].into_iter().enumerate() {
            estimator.sample(&times(&[first, 310, 0], 1_000_000 * number as u32));
        }
        assert_eq!(nanos(&estimator), [Some(0), Some(160), Some(315)]);
        assert_eq!(estimator.latches(), 4);
        assert_eq!(estimator.mean(1).spread(), Picos(10_000));
        estimator.restart();
        assert_eq!(nanos(&estimator), [None, None, None]);
    }

    /// A port to which no frame comes back any more keeps its time.
    #[test]
    fn a_stale_port_is_left_out_and_counted() {
        let mut estimator = Estimator::new(&line(3), 0, FREE_RUNNING_PPB, false);
        for number in 0..5 {
            let mut times = times(&[600, 310, 0], 50_000 * number);
            if number == 3 {
                times[1].ports = Some([150_000, 100_310, 0, 0]);
            }
            estimator.sample(&times);
        }
        // The next latch differs from the stale one as well.
        assert_eq!((estimator.mean(1).latches(), estimator.mean(1).left_out()), (3, 2));
        // For the SubDevices behind it the port then counts as cable.
        assert_eq!(estimator.mean(2).latches(), 5);
        assert_eq!(nanos(&estimator), [Some(0), Some(155), Some(310)]);
        for number in 5..20 {
            let mut times = times(&[600, 310, 0], 50_000 * number);
            times[1].ports = Some([50_000 * number, 100_310, 0, 0]);
            estimator.sample(&times);
        }
        let why = Why::TimesContradict;
        assert!(matches!(estimator.delays()[1], Delay::Indeterminate { why: w, .. } if w == why));
    }
}
