//! Propagation delays: latching the receive times, and what many latches make of them.
//!
//! [`latch`] is the procedure, [`Estimator`] takes its [`Times`] and gives the delays of all SubDevices. A latch
//! whose frame was lost, or that not every SubDevice took, is none, which
//! [`Statistics`](crate::Statistics) counts. One in which a single SubDevice contradicts itself is left out
//! there, and below it where the branch can't be told.

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
    /// One of them stamps the next frame instead of the one that latches: no other may be under way
    /// then.
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

/// Whether a write to 0x0900 enables ports 1 to 3 to stamp the next frame that arrives there,
/// whatever is in it: so an ESC20 and an ET1200, by their type (register 0x0000). Others stamp the
/// frame that writes.
fn stamps_next_frame(kind: u8) -> bool {
    matches!(kind, 0x02 | 0x12)
}

/// One write to 0x0900 and all times that it latched. It disturbs nothing: SYNC and the drift loop do not use
/// them.
pub(crate) async fn latch(link: &Link, stations: &Stations) -> Result<Times, AccessError> {
    latch_among(link, stations, 0).await
}

/// The same, while up to so many others take the write too.
pub(crate) async fn latch_among(
    link: &Link,
    Stations { list: stations, quiet }: &Stations,
    strangers: u16,
) -> Result<Times, AccessError> {
    let timed = stations.iter().filter(|(_, dc)| dc.has_receive_times()).count();
    // A repetition after a loss might leave times of two frames: rather another latch.
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
            let bytes = ports.expect(1).await?.data;
            let time = |port: PortNumber| {
                let bytes = bytes.get(4 * port.index()..).unwrap_or_default();
                bytes.first_chunk().map_or(0, |bytes| u32::from_le_bytes(*bytes))
            };
            latch.ports = Some(PortNumber::ALL.map(time));
            if let Some(entry) = entry {
                let bytes = entry.expect(1).await?.data;
                latch.entry = bytes.first_chunk().map_or(0, |b| u64::from_le_bytes(*b));
            }
        }
        all.push(latch);
    }
    Ok(all)
}

/// With receive times it shows where frames really come in; parents follow from that. Ports whose time did
/// not change from one latch to the next were not reached.
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

/// Makes delays of many latches. No input or output of its own: [`Estimator::sample`] takes what was read.
pub(crate) struct Estimator {
    /// The receive times in it are those of the last latch.
    nodes: Vec<Node>,
    reference: usize,
    rate_ppb: u32,
    found: Vec<Found>,
    means: Vec<Mean>,
    previous: Vec<Option<[u32; 4]>>,
    latches: usize,
    /// A round trip that changes by more from latch to latch is none, ns.
    most_change: u32,
}

impl Estimator {
    /// For a segment whose parents are known. `rate_ppb`: how much the speeds of two clocks may
    /// differ; `jitters`: [`Config::hop_jitter`](crate::Config::hop_jitter).
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

    /// Latches taken.
    pub fn latches(&self) -> usize {
        self.latches
    }

    /// The largest standard error of those that are known.
    pub fn worst_error(&self) -> Picos {
        let error = |delay: Delay| match delay {
            Delay::Known { standard_error, .. } => standard_error,
            Delay::Indeterminate { .. } => Picos::ZERO,
        };
        self.delays().into_iter().map(error).max().unwrap_or_default()
    }

    /// The delays by position.
    pub fn delays(&self) -> Vec<Delay> {
        let averaging = Averaging::of(&self.means);
        self.means.iter().map(|mean| mean.delay(averaging)).collect()
    }

    /// What the mean of one SubDevice is made of.
    pub fn mean(&self, position: usize) -> Mean {
        self.means.get(position).copied().unwrap_or_default()
    }

    /// Forgets all latches but the last, whose times tell which of the next are stale.
    pub fn restart(&mut self) {
        self.means.iter_mut().for_each(|mean| *mean = mean.restarted());
        self.latches = 0;
    }
}

/// The times, or such as say that they contradict each other, if a port holds the time of an earlier frame: the
/// round trip to it then changed by the time between two latches.
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
        // Before the frame came in.
        times[port.index()] = times[entry].wrapping_sub(1);
    }
    times
}

fn node(device: &SubDevice) -> Node {
    let mut stay = Stay::of_esc(device.esc.kind);
    if !device.dc.has_receive_times() {
        // Its entry is not known either, so what it adds may be the other way round.
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

/// How much frames jitter on their way from the reference clock, by position; nothing if hops do
/// not.
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

/// Standard deviation of 0x092C by position (1 sigma), as frames arrive: in whole ns, rounded up.
pub(crate) fn noise(segment: &Segment, jitters: bool) -> Vec<Nanos> {
    let all = jitter(segment, segment.reference.unwrap_or(0), jitters);
    all.iter().map(|one| Nanos((one.arrival_deviation().0 + 999) / 1_000)).collect()
}

/// Period of the clock that takes frames from a port into the ESC's own, by the kind of port
/// (register 0x0007): the nibble clock of MII, a tick for EBUS. A bound; how often it is reached,
/// nobody publishes.
fn receive_period(ports: u8, port: PortNumber) -> Picos {
    const EBUS: u8 = 0b10;
    match ports >> (2 * port.index()) & 0b11 {
        EBUS => Picos(10_000),
        _ => Picos(40_000),
    }
}

/// How far the speeds of two free-running clocks may lie apart: 50 ppm each.
pub(crate) const FREE_RUNNING_PPB: u32 = 100_000;
/// The same for clocks that the drift loop keeps: within 1 ppm, or they would not stay together.
pub(crate) const STEERED_PPB: u32 = 1_000;
/// A round trip changes by ticks and jitter from latch to latch; a stale time by the time in between, which is
/// longer than a frame.
const MOST_CHANGE_NS: u32 = 2_000;
/// What a hop there and back may make of that.
const HOP_CHANGE_NS: u32 = 80;
/// The pause between two latches is twice as long at least.
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

    /// A port at which no frame comes back any more keeps its time.
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
        // Then it was cable for those behind it.
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
