//! Delay and jitter of each hop, from many round trips and latches.

use isocat_wire::Command;
use isocat_wire::PortNumber;
use isocat_wire::datagram::Address;
use isocat_wire::register;
use isocat_wire::time::Nanos;

use super::bus::{Bus, Trouble, number};
use super::found::Found;

/// The hop to a device, and the round trip behind it.
#[derive(Clone, PartialEq, Debug)]
pub struct Hop {
    /// The device above and its port; `None` for the first device, or if the open ports do not form
    /// a tree.
    pub above: Option<(usize, PortNumber)>,
    /// Time from a frame's arrival at this device until its last return, ns: 0 at the end of a
    /// line.
    pub round_trip: Spread,
    /// Half of the difference between the frame's time away from the port above and its round trip
    /// behind this device, ns. It is the delay of the hop if both directions are equal and the two
    /// ESCs keep frames equally long.
    pub one_way: Option<Spread>,
    /// Number of latches.
    pub latches: usize,
    /// tDiff of this device, ns, and the standard error: the time that a frame stays on its way
    /// through the processing unit, less that on its way back. `None` at the end of a line.
    pub t_diff: Option<(f64, f64)>,
}

/// Statistics of repeated readings of one quantity.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct Spread {
    /// Mean.
    pub mean: f64,
    /// Standard deviation of one reading.
    pub deviation: f64,
    /// Smallest reading.
    pub least: f64,
    /// Largest reading.
    pub most: f64,
}

impl Spread {
    /// The statistics of these readings; all 0 without any.
    pub(super) fn of(readings: &[f64]) -> Self {
        if readings.is_empty() {
            return Self::default();
        }
        let count = readings.len() as f64;
        let mean = readings.iter().sum::<f64>() / count;
        let square: f64 = readings.iter().map(|reading| (reading - mean) * (reading - mean)).sum();
        Self {
            mean,
            deviation: (square / (count - 1.0).max(1.0)).sqrt(),
            least: readings.iter().copied().fold(f64::INFINITY, f64::min),
            most: readings.iter().copied().fold(f64::NEG_INFINITY, f64::max),
        }
    }
}

/// Measures all hops; by position, `None` for a device without receive times.
pub(super) fn measure(bus: &mut Bus<'_>, found: &[Found]) -> Result<Vec<Option<Hop>>, Trouble> {
    let timed: Vec<usize> =
        found.iter().filter(|device| device.has_times).map(|device| device.position).collect();
    let mut latches: Vec<Vec<Option<[u32; 4]>>> = Vec::with_capacity(LATCHES);
    let mut lost = 0;
    while latches.len() < LATCHES && lost <= LATCHES {
        match latch(bus, found.len(), &timed)? {
            Some(latch) => latches.push(latch),
            None => lost += 1,
        }
        bus.wait(Nanos(200_000 + 10_007 * (latches.len() % 7) as i64))?;
    }
    let parents = parents(found);
    let hop = |device: &Found| {
        let at = device.position;
        let trips: Vec<f64> =
            latches.iter().filter_map(|latch| round_trip(device, &latch[at]?)).collect();
        let above = parents.get(at).copied().flatten();
        let one_way = above.and_then(|(above, port)| {
            let each: Vec<f64> = latches
                .iter()
                .filter_map(|latch| {
                    let away = branch(&found[above], port, &latch[above]?)?;
                    Some((away - round_trip(device, &latch[at]?)?) / 2.0)
                })
                .collect();
            (!each.is_empty()).then(|| Spread::of(&each))
        });
        Hop { above, round_trip: Spread::of(&trips), one_way, latches: trips.len(), t_diff: None }
    };
    Ok(found.iter().map(|device| device.has_times.then(|| hop(device))).collect())
}

/// One latch of the ports' receive times, by position; `None` if it was lost.
fn latch(
    bus: &mut Bus<'_>,
    count: usize,
    timed: &[usize],
) -> Result<Option<Vec<Option<[u32; 4]>>>, Trouble> {
    let address = register::RECEIVE_TIME_0.address;
    let asks = [(Command::Bwr, Address::Broadcast(address), vec![0; 4])];
    if bus.once(&asks)?.is_none() {
        return Ok(None);
    }
    let mut all = vec![None; count];
    for (at, bytes) in timed.iter().zip(bus.read_each(timed, address, 16)?) {
        all[*at] = Some(std::array::from_fn(|port| number(&bytes[4 * port..][..4]) as u32));
    }
    Ok(Some(all))
}

/// Open ports in the order in which a frame visits them, the entry first.
fn visited(device: &Found) -> impl Iterator<Item = PortNumber> + '_ {
    PortNumber::PROCESSING_ORDER.into_iter().filter(|port| device.open[port.index()])
}

/// Time from the first port to the last; `None` if the times run backwards.
pub(super) fn round_trip(device: &Found, times: &[u32; 4]) -> Option<f64> {
    let last = visited(device).last()?;
    span(times[PortNumber::P0.index()], times[last.index()])
}

/// Time that a frame was away through a port.
pub(super) fn branch(device: &Found, port: PortNumber, times: &[u32; 4]) -> Option<f64> {
    let before = visited(device).take_while(|visited| *visited != port).last()?;
    span(times[before.index()], times[port.index()])
}

fn span(from: u32, to: u32) -> Option<f64> {
    let span = to.wrapping_sub(from) as i32;
    (span >= 0).then(|| f64::from(span))
}

/// The device and port above each device, by open ports; all `None` if these do not form a tree.
/// Frames are assumed to come in at port 0.
pub(super) fn parents(found: &[Found]) -> Vec<Option<(usize, PortNumber)>> {
    let mut free: Vec<(usize, PortNumber)> = Vec::new();
    let mut parents = Vec::with_capacity(found.len());
    for device in found {
        let parent = free.pop();
        let makes_tree = device.open[0] && (parent.is_some() == (device.position > 0));
        if !makes_tree {
            return Vec::new();
        }
        parents.push(parent);
        let mut below: Vec<_> =
            visited(device).skip(1).map(|port| (device.position, port)).collect();
        below.reverse();
        free.append(&mut below);
    }
    if free.is_empty() { parents } else { Vec::new() }
}

/// Number of latches of the receive times.
const LATCHES: usize = 128;
