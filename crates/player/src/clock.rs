//! Measures and sets what no list can know: the tree of devices, delays (0x0928) and offsets
//! (0x0920). Then drift frames lead all clocks until they have converged.
//!
//! The procedure is that of isocat's own MainDevice: many latches of the receive times, offsets
//! from times of the same frame, and a burst of drift frames, judged by 0x092C.

use isocat_descriptions::start_up::{Address, StartUp};
use isocat_maindevice::DriftFilters;
use isocat_sync::delay::{Averaging, Delay, Found, Mean, Node, Stay, propagation_delays};
use isocat_sync::drift::{Convergence, Limits, Verdict};
use isocat_wire::dc::{DifferencePolarity, SystemTimeDifference};
use isocat_wire::dl::DlStatus;
use isocat_wire::register::{self, Value, features};
use isocat_wire::time::{Dc, Host, Nanos, Time};
use isocat_wire::{Command, PortNumber};

use crate::cyclic::is_drift;
use crate::failure::Kind;
use crate::line::Line;

/// The clocks of the segment, measured.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct Clocks {
    /// Position of the reference clock.
    pub reference: usize,
    /// The clocks by position; `None`: the device has no clock.
    pub units: Vec<Option<Unit>>,
}

/// The clock of one device.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Unit {
    /// Station address.
    pub station: u16,
    /// Whether its system time has 64 bits; else 32.
    pub is_wide: bool,
    /// Offset (0x0920).
    pub offset: u64,
    /// Propagation delay (0x0928).
    pub delay: Nanos,
    /// The delay by the receive times.
    pub measured: Delay,
    /// Whether the receive times gave a delay; else the delay is 0.
    pub is_delay_known: bool,
    /// Magnitude of the last 0x092C while the clocks were led.
    pub difference: Nanos,
    /// Whether 0x092C stayed within the limit of convergence.
    pub has_converged: bool,
}

/// A device, as input of the delay measurement.
struct Port {
    station: u16,
    kind: u8,
    status: DlStatus,
    has_clock: bool,
    is_wide: bool,
}

/// Times of one latch: of the ports and of the processing unit.
#[derive(Clone, Copy, Default)]
struct Latch {
    ports: Option<[u32; 4]>,
    entry: u64,
}

/// Measures and sets all clocks. `None`: no cyclic datagram of the list distributes a time.
pub(crate) fn set(line: &mut Line, list: &StartUp) -> Result<Option<Clocks>, Kind> {
    let Some(reference) = reference(list) else { return Ok(None) };
    let ports = list.devices.iter().map(|device| port(line, device.station));
    let ports: Vec<Port> = ports.collect::<Result<_, _>>()?;
    let mut nodes = tree(&ports)?;
    let mut means = vec![Mean::default(); nodes.len()];
    let mut found = vec![Found::default(); nodes.len()];
    let mut last = vec![Latch::default(); nodes.len()];
    for _ in 0..LATCHES {
        last = latch(line, &ports)?;
        for (node, latch) in nodes.iter_mut().zip(&last) {
            node.receive_times = latch.ports;
        }
        propagation_delays(&nodes, reference, FREE_RUNNING_PPB, &mut found);
        means.iter_mut().zip(&found).for_each(|(mean, found)| mean.add(found));
        line.sleep(BETWEEN_LATCHES)?;
    }
    let averaging = Averaging::of(&means);
    let units =
        ports.iter().zip(&means).zip(&last).enumerate().map(|(position, ((port, mean), latch))| {
            port.has_clock.then(|| {
                let measured = mean.delay(averaging);
                let delay = measured.nanos();
                let unit = Unit {
                    station: port.station,
                    is_wide: port.is_wide,
                    offset: 0,
                    delay: delay.unwrap_or(Nanos::ZERO),
                    measured,
                    is_delay_known: delay.is_some(),
                    difference: Nanos::ZERO,
                    has_converged: position == reference,
                };
                let offset = offset(&unit, last[reference].entry, latch.entry);
                Unit { offset: if position == reference { 0 } else { offset }, ..unit }
            })
        });
    let mut clocks = Clocks { reference, units: units.collect() };
    write(line, list, &clocks)?;
    converge(line, list, &mut clocks)?;
    Ok(Some(clocks))
}

/// The position of the clock that the list's drift datagrams read.
pub(crate) fn reference(list: &StartUp) -> Option<usize> {
    let datagram =
        list.frames.iter().flat_map(|frame| &frame.datagrams).find(|one| is_drift(one))?;
    let Address::Physical { device, .. } = datagram.address else { return None };
    let position = match datagram.command {
        Command::Frmw => list.devices.iter().position(|one| one.station == device)?,
        _ => usize::from(device.wrapping_neg()),
    };
    (position < list.devices.len()).then_some(position)
}

/// The present time of the reference clock.
pub(crate) fn system_time(line: &mut Line, clocks: &Clocks) -> Result<Time<Dc>, Kind> {
    let unit = clocks.units[clocks.reference].ok_or(Kind::NoAnswer)?;
    let register = register::SYSTEM_TIME.address;
    let bytes = line.read(unit.station, register, 8)?.ok_or(Kind::NoAnswer)?;
    let time = bytes.first_chunk().map_or(0, |bytes| u64::from_le_bytes(*bytes));
    Ok(Time::new(if unit.is_wide { time } else { time & u64::from(u32::MAX) }))
}

/// The offset of a device, by a frame that entered the reference at its local time `there`, and the
/// device `delay` later at its local time `here`.
fn offset(unit: &Unit, there: u64, here: u64) -> u64 {
    let offset = there.wrapping_add_signed(unit.delay.0).wrapping_sub(here);
    if unit.is_wide { offset } else { offset & u64::from(u32::MAX) }
}

fn port(line: &mut Line, station: u16) -> Result<Port, Kind> {
    let head = line.read(station, register::TYPE.address, 10)?.ok_or(Kind::NoAnswer)?;
    let status = line.read(station, register::DL_STATUS.address, 2)?.ok_or(Kind::NoAnswer)?;
    let bits = register::FEATURES.load(&head);
    let has_dc = bits & features::DC != 0;
    // An ESC may have receive times but no clock: then it does not answer at 0x0910.
    let has_clock = has_dc && line.read(station, register::SYSTEM_TIME.address, 4)?.is_some();
    Ok(Port {
        station,
        kind: head[0],
        status: DlStatus(u16::from_le_bytes([status[0], status[1]])),
        has_clock,
        is_wide: bits & features::DC_64_BIT != 0,
    })
}

/// The tree of open ports, if frames enter every device at port 0. A frame visits the other ports
/// in the order 3, 1, 2, and follows each branch at once, so positions follow from the open ports.
fn tree(ports: &[Port]) -> Result<Vec<Node>, Kind> {
    let mut nodes: Vec<Node> = Vec::with_capacity(ports.len());
    let mut free: Vec<(usize, PortNumber)> = Vec::new();
    let offered = || {
        let downstream = |port: &Port| {
            PortNumber::PROCESSING_ORDER[1..].iter().filter(|p| port.status.open(**p)).count()
        };
        ports.iter().map(downstream).sum()
    };
    for (position, port) in ports.iter().enumerate() {
        if !port.status.open(PortNumber::P0) {
            return Err(Kind::SwappedCable { position });
        }
        let parent = match position {
            0 => None,
            _ => Some(
                free.pop()
                    .ok_or_else(|| Kind::Topology { devices: ports.len(), ports: offered() })?,
            ),
        };
        let downstream = PortNumber::PROCESSING_ORDER[1..].iter().rev();
        free.extend(downstream.filter(|p| port.status.open(**p)).map(|p| (position, *p)));
        nodes.push(Node {
            parent,
            entry: PortNumber::P0,
            open: PortNumber::ALL.map(|p| port.status.open(p)),
            receive_times: None,
            stay: Stay::of_esc(port.kind),
        });
    }
    match free.is_empty() {
        true => Ok(nodes),
        false => Err(Kind::Topology { devices: ports.len(), ports: offered() }),
    }
}

/// Writes 0x0900 once, and reads the times that it latched.
fn latch(line: &mut Line, ports: &[Port]) -> Result<Vec<Latch>, Kind> {
    let address = Address::Physical { device: 0, register: register::RECEIVE_TIME_0.address };
    line.datagram(Command::Bwr, address, &[0; 4])?.ok_or(Kind::NoAnswer)?;
    let read = |port: &Port, line: &mut Line| -> Result<Latch, Kind> {
        let times = line.read(port.station, register::RECEIVE_TIME_0.address, 16)?;
        let ports = times.map(|bytes| PortNumber::ALL.map(|port| word(&bytes, 4 * port.index())));
        let entry = match port.has_clock {
            true => line.read(port.station, register::RECEIVE_TIME_EPU.address, 8)?,
            false => None,
        };
        let entry =
            entry.and_then(|bytes| bytes.first_chunk().copied()).map_or(0, u64::from_le_bytes);
        Ok(Latch { ports, entry })
    };
    ports.iter().map(|port| read(port, line)).collect()
}

fn word(bytes: &[u8], at: usize) -> u32 {
    bytes
        .get(at..)
        .and_then(|rest| rest.first_chunk())
        .map_or(0, |bytes| u32::from_le_bytes(*bytes))
}

/// Writes delays and offsets, and then 0x0930, which clears the filters. Filter depths are only
/// written if the list does not write them.
fn write(line: &mut Line, list: &StartUp, clocks: &Clocks) -> Result<(), Kind> {
    for unit in clocks.units.iter().flatten() {
        let delay = (unit.delay.0 as u32).to_bytes();
        let offset = unit.offset.to_bytes();
        let taken = line.write(unit.station, register::SYSTEM_TIME_OFFSET.address, &offset)?
            && line.write(unit.station, register::SYSTEM_TIME_DELAY.address, &delay)?;
        if !taken {
            return Err(Kind::NoAnswer);
        }
        if !writes_filters(list) {
            let (difference, speed) = DriftFilters::default().depths(Nanos(list.cycle_ns));
            line.write(unit.station, register::TIME_FILTER_DEPTH.address, &[difference, speed])?;
        }
        let start = SPEED_COUNTER_START.to_bytes();
        line.write(unit.station, register::SPEED_COUNTER_START.address, &start)?;
    }
    Ok(())
}

/// Whether the list writes 0x0934.
fn writes_filters(list: &StartUp) -> bool {
    let of_devices = list.devices.iter().flat_map(|device| &device.registers);
    let all = list.before.iter().chain(&list.after).chain(of_devices);
    let depth = usize::from(register::TIME_FILTER_DEPTH.address);
    all.filter(|step| matches!(step.command, Command::Bwr | Command::Fpwr | Command::Apwr)).any(
        |step| {
            let Address::Physical { register, .. } = step.address else { return false };
            (usize::from(register)..usize::from(register) + step.data.len()).contains(&depth)
        },
    )
}

/// Leads the clocks by a burst of drift frames until all have converged, or until `PATIENCE` has
/// passed: then the judges see the effect of clocks that have not converged. If the cycle's own
/// drift datagrams are much less frequent, slower frames follow, so that the drift loops learn the
/// speeds well enough.
fn converge(line: &mut Line, list: &StartUp, clocks: &mut Clocks) -> Result<(), Kind> {
    let end = line.now() + PATIENCE;
    let converged = lead(line, clocks, (PACE, 0), end)?;
    for (unit, converged) in clocks.units.iter_mut().zip(converged) {
        if let Some(unit) = unit {
            unit.has_converged |= converged;
        }
    }
    let slower = PACE.max(Nanos(list.cycle_ns / 10));
    if slower > PACE {
        let settled = end.min(line.now() + Nanos(slower.0 * MOST_LEARNING));
        lead(line, clocks, (slower, LEARNING_FRAMES), settled)?;
    }
    Ok(())
}

/// Leads the clocks by one drift frame each `pace`, with at least `least` frames, until all have
/// converged or `end` has passed. Returns by position which ones have converged.
fn lead(
    line: &mut Line,
    clocks: &mut Clocks,
    (pace, least): (Nanos, i64),
    end: Time<Host>,
) -> Result<Vec<bool>, Kind> {
    let mut converged = vec![false; clocks.units.len()];
    let Some(station) = clocks.units[clocks.reference].map(|unit| unit.station) else {
        return Ok(converged);
    };
    let address = Address::Physical { device: station, register: register::SYSTEM_TIME.address };
    let reference = clocks.reference;
    let limits = Limits { noise: NOISE, ..Limits::of_difference(THRESHOLD) };
    let mut judges = vec![Convergence::new(limits); clocks.units.len()];
    let learned = line.now() + Nanos(pace.0 * least);
    while line.now() < end {
        for _ in 0..FRAMES_PER_READING {
            let next = line.now() + pace;
            let now = line.now().count().to_le_bytes();
            let _lost = line.datagram(Command::Frmw, address, &now)?;
            let left = next - line.now();
            line.sleep(left.max(Nanos::ZERO))?;
        }
        let mut all = true;
        for (position, unit) in clocks.units.iter_mut().enumerate() {
            let Some(unit) = unit.as_mut().filter(|_| position != reference) else { continue };
            let register = register::SYSTEM_TIME_DIFFERENCE.address;
            let Some(bytes) = line.read(unit.station, register, 4)? else {
                all = false;
                continue;
            };
            let difference = SystemTimeDifference(word(&bytes, 0));
            let judge = &mut judges[position];
            judge.sample(line.now(), difference.nanos(DifferencePolarity::PositiveAhead));
            unit.difference = Nanos(i64::from(difference.magnitude()));
            converged[position] = matches!(judge.verdict(), Verdict::Converged { .. });
            all &= converged[position];
        }
        if all && line.now() >= learned {
            break;
        }
    }
    Ok(converged)
}

/// Number of latches of the receive times.
const LATCHES: usize = 16;
/// Time between two latches, chosen so that clocks shift within a tick.
const BETWEEN_LATCHES: Nanos = Nanos(1_037_000);
/// Largest difference between the speeds of two free-running clocks: 50 ppm each.
const FREE_RUNNING_PPB: u32 = 100_000;
/// Value for register 0x0930: the reset value of the ESCs.
const SPEED_COUNTER_START: u16 = 0x1000;
/// Time between two drift frames of the burst.
const PACE: Nanos = Nanos(100_000);
/// Drift frames between two readings of 0x092C.
const FRAMES_PER_READING: usize = 20;
/// Smallest and largest number of the slower drift frames, if the cycle is slow.
const LEARNING_FRAMES: i64 = 128;
const MOST_LEARNING: i64 = 512;
/// Limit of 0x092C for converged clocks.
const THRESHOLD: Nanos = Nanos(100);
/// Noise of 0x092C after its filter by the jitter of hops, 1 sigma.
const NOISE: Nanos = Nanos(15);
/// How long clocks are led at most.
const PATIENCE: Nanos = Nanos::millis(10_000);
