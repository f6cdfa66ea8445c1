//! What a capture shows of a segment in operation, for the rulebook: as registers were written and
//! read, and as frames came.

use std::ops::Range;
use std::time::Duration;

use isocat_rules::{Claims, DeviceClaims, DeviceEvidence, Evidence};
use isocat_sync::SyncMode;
use isocat_sync::object::SyncType;
use isocat_wire::fmmu::Fmmu;
use isocat_wire::sync_manager::SyncManager;
use isocat_wire::time::{Nanos, Picos};
use isocat_wire::{AlState, AlStatusCode, Command, PortNumber, register};

use crate::device::Device;
use crate::judge::sync::{self, LEAST_CYCLES};
use crate::judge::{self, PATIENCE, turns};
use crate::mailbox::Way;
use crate::observer::Observer;
use crate::sync_unit::Switched;

/// The evidence about the SubDevices that the claims are about, by position.
pub(crate) fn of(observer: &Observer, claims: &Claims) -> Evidence {
    let cycles = [&observer.cycle.by_clock, &observer.cycle.rhythm];
    let rhythm = cycles.into_iter().find(|rhythm| rhythm.count >= LEAST_CYCLES);
    let is_operated = observer.operation.is_some() && rhythm.is_some();
    let of_device = |(at, claims): (usize, &DeviceClaims)| {
        let place = u16::try_from(at).ok().and_then(|at| observer.devices.at(at));
        Some(device(observer, place?, claims, is_operated))
    };
    let devices = claims.devices.iter().enumerate();
    Evidence {
        cycle: rhythm.and_then(|rhythm| rhythm.median()).map(nanos),
        // A pause between two stretches is none in operation.
        longest_drift_gap: sync::drift_gap(observer)
            .filter(|_| observer.held.is_empty())
            .map(|gap| nanos(gap.ns)),
        slide: rhythm.and_then(|rhythm| observer.phases.slide(rhythm.median()?)),
        talkers: Some(turns(observer).map(|talker| talker.frames).collect()),
        devices: devices.map(|one| of_device(one).unwrap_or_default()).collect(),
    }
}

fn device(
    observer: &Observer,
    place: usize,
    claims: &DeviceClaims,
    is_operated: bool,
) -> DeviceEvidence {
    let device = &observer.devices.list[place];
    // Without any state in the capture, the exchange itself is operation.
    let operated = is_operated && (was_in_op(observer, device) || device.states.now().is_none());
    let last = device.sync.last.filter(Switched::makes_sync0);
    let set_up = is_set_up(device);
    let lengths = lengths(device).or_else(|| set_up.then_some([0, 0]));
    DeviceEvidence {
        state: state(observer, device, is_operated),
        operated,
        mode: mode(device, claims.mode),
        activation: match device.sync.last {
            Some(last) => Some(last.word.0.to_le_bytes()[1]),
            None => set_up.then_some(0),
        },
        sync0_cycle: last
            .and_then(|last| last.sync0_cycle)
            .map(|cycle| Nanos::from_u32(cycle.value)),
        sync0_phase: sync0_phase(observer, place),
        sync0_overdue: last.and_then(overdue),
        frame_to_sync0: frame_to_sync0(observer, device),
        lengths,
        exchanged: [Fmmu::WRITE, Fmmu::READ].map(|kind| exchanged(observer, device, kind)),
        logical: set_up
            .then(|| [Fmmu::WRITE, Fmmu::READ].map(|kind| mapped(device, kind).collect())),
        guarded: guarded(device, set_up),
        watchdog: watchdog(device, set_up),
        clock_set: set_up.then(|| clock_set(device)),
    }
}

fn nanos(ns: u64) -> Nanos {
    Nanos(i64::try_from(ns).unwrap_or(i64::MAX))
}

/// Whether the capture has the way up of the device, so that what was not written was left out.
fn is_set_up(device: &Device) -> bool {
    device.image.written(register::STATION_ADDRESS).is_some() && device.states.op.is_some()
}

/// Whether it was read in OP in the present stretch of operation.
fn was_in_op(observer: &Observer, device: &Device) -> bool {
    let since = observer.stretch.map_or(0, |stretch| stretch.frame);
    device.states.op.is_some() && device.states.last_op >= since
}

/// The state of a device in operation: OP if it was read there. What it does after that is no claim
/// but an event. Another state is known when there was enough time for OP since others came there.
fn state(
    observer: &Observer,
    device: &Device,
    is_operated: bool,
) -> Option<(AlState, AlStatusCode)> {
    if was_in_op(observer, device) {
        return Some((AlState::Op, AlStatusCode(0)));
    }
    let began = observer.stretch.or(observer.operation).filter(|_| is_operated)?;
    let end = observer.left.filter(|left| left.frame > began.frame);
    let end = end.map_or(observer.last, |left| left.value);
    let (status, seen) = device.states.last_seen()?;
    let long = end.saturating_sub(began.value) >= PATIENCE;
    let code = device.states.changes.kept.last().and_then(|last| last.code);
    let state = status.state().ok().filter(|_| long && seen > began.frame)?;
    Some((state, code.unwrap_or_default()))
}

/// The frame in which a device was asked for SAFEOP on its last way up, or was first seen there if
/// the capture does not show who asked.
fn way_up(device: &Device) -> Option<usize> {
    let is_up = |state| matches!(state, Ok(AlState::SafeOp | AlState::Op));
    let (mut up, mut was_down) = (None, true);
    for asked in &device.states.requests.kept {
        let is_up = is_up(asked.control.state());
        if is_up && was_down {
            up = Some(asked.frame);
        }
        was_down = !is_up;
    }
    let mut seen = device.states.changes.kept.iter();
    let seen = || seen.find(|seen| is_up(seen.status.state())).map(|seen| seen.frame);
    up.or_else(seen)
}

/// The mode that a device took on its way to SAFEOP, by its SYNC unit and its synchronization type
/// as they were then. Where both fit several modes, the one that was asked for is taken.
fn mode(device: &Device, wanted: Option<SyncMode>) -> Option<SyncMode> {
    let up = way_up(device);
    let switched = &device.sync.switched;
    let before = |one: &&Switched| up.is_none_or(|up| one.frame < up);
    let then = match switched.left_off() {
        0 => switched.kept.iter().rev().find(before),
        _ => None,
    };
    let on = then.is_some_and(Switched::makes_sync0);
    // Some take SYNC0 that is switched on later, and others don't.
    if !on && (device.sync.is_on() || !is_set_up(device)) {
        return None;
    }
    let sync1 = then.is_some_and(|then| on && then.word.makes_sync1());
    // A type that was read before SAFEOP may be another one since.
    let of_type = judge::mode(device).filter(|(object, known)| {
        let way = device.mailbox.values.get(object).map(|known| known.value.way);
        way == Some(Way::Written) || up.is_some_and(|up| up < known.frame)
    });
    let of_type = of_type.map(|(_, known)| known.value);
    let fits = |mode: &SyncMode| match of_type {
        _ if mode.uses_dc() && !on || mode.uses_sync1() && !sync1 => false,
        Some(SyncType::FREE_RUN) => *mode == SyncMode::FreeRun,
        Some(SyncType::SM | SyncType::INPUTS_ON_SM2) => *mode == SyncMode::SmSynchronous,
        Some(own) if on => mode.output_type() == own,
        None if on => mode.uses_dc(),
        // A type that needs SYNC0 has none.
        Some(_) => *mode == SyncMode::SmSynchronous,
        None => !mode.uses_dc(),
    };
    if of_type.is_none() && !on && wanted.is_none_or(|wanted| !wanted.uses_dc()) {
        return None;
    }
    let order = [SyncMode::SmSynchronous, SyncMode::FreeRun].into_iter().chain(SyncMode::ALL);
    wanted.into_iter().chain(order).find(fits)
}

/// The phase of SYNC0 by the clock of the segment. `None`: also where nothing shows that the clock
/// of the device followed it when operation began.
fn sync0_phase(observer: &Observer, place: usize) -> Option<Nanos> {
    let device = &observer.devices.list[place];
    let grid = device.sync.grid()?;
    let leads = judge::reference(observer) == Some(place);
    let differences = &device.differences;
    let read = [differences.before_sync, differences.worst].into_iter().flatten();
    let mut read = read.map(|known| known.value.magnitude() <= sync::APART_NS).peekable();
    let follows = match read.peek() {
        Some(_) => read.all(|near| near),
        None => observer.drift.count - observer.drift.recent >= SETTLED,
    };
    if !leads && !follows {
        return None;
    }
    // A clock that is ahead by a wrong delay lets its pulses come too early.
    let ahead = delay_error(observer, device).unwrap_or(0);
    let cycle = i64::try_from(grid.cycle).ok()?;
    Some(Nanos((grid.phase as i64 - ahead).rem_euclid(cycle)))
}

/// By how much the delay that was written to a device is longer than what the receive times say,
/// ns, both against the reference.
fn delay_error(observer: &Observer, device: &Device) -> Option<i64> {
    let reference = &observer.devices.list[judge::reference(observer)?];
    let ways = ways(observer);
    let way = |device: &Device| ways.get(usize::from(device.position?)).copied().flatten();
    let measured = way(device)? - way(reference)?;
    Some(judge::delay(observer, device)? - measured)
}

/// How long frames take from the first device to each other one, ns, by position, by the times at
/// which their first bit came in at each port (0x0900).
///
/// A frame goes through the ports in the order 0, 3, 1, 2, and comes back at each before it leaves
/// by the next. What passes between two of them is the way to the device behind the second one and
/// back, and what that device and all behind it take.
fn ways(observer: &Observer) -> Vec<Option<i64>> {
    let count = u16::try_from(observer.devices.list.len()).unwrap_or(u16::MAX);
    let mut ways: Vec<Option<i64>> = Vec::new();
    // Devices on the path to the present one, with the ports behind which devices are to come.
    let mut path: Vec<Ports<'_>> = Vec::new();
    for position in 0..count {
        let Some(device) = observer.devices.at(position).map(|at| &observer.devices.list[at])
        else {
            break;
        };
        let Some(ports) = Ports::of(device, usize::from(position)) else { break };
        while path.pop_if(|last| last.open.len() == 1).is_some() {}
        let way = match path.last_mut() {
            None if position == 0 => Some(0),
            None => break,
            Some(parent) => {
                let behind = parent.next();
                let before = ways[parent.position];
                before
                    .zip(behind)
                    .zip(ports.takes())
                    .map(|((before, (to, spent)), own)| before + spent + (to - own) / 2)
            }
        };
        ways.push(way);
        path.push(ports);
    }
    ways
}

/// The open ports of a device, in the order in which frames pass them.
struct Ports<'a> {
    device: &'a Device,
    position: usize,
    /// The port at which the frame came back last, and those that follow.
    open: Vec<PortNumber>,
}

impl<'a> Ports<'a> {
    fn of(device: &'a Device, position: usize) -> Option<Self> {
        let status = device.image.read(register::DL_STATUS)?.value;
        let order = PortNumber::PROCESSING_ORDER.into_iter();
        let open = order.filter(|port| *port == PortNumber::P0 || status.communication(*port));
        Some(Self { device, position, open: open.collect() })
    }

    fn time(&self, port: PortNumber) -> Option<u32> {
        let of_port = [
            register::RECEIVE_TIME_0,
            register::RECEIVE_TIME_1,
            register::RECEIVE_TIME_2,
            register::RECEIVE_TIME_3,
        ];
        self.device.image.read(of_port[port as usize]).map(|known| known.value)
    }

    /// From the first port to a later one, ns.
    fn until(&self, port: PortNumber) -> Option<i64> {
        Some(self.time(port)?.wrapping_sub(self.time(PortNumber::P0)?).into())
    }

    /// What the device and all behind it take.
    fn takes(&self) -> Option<i64> {
        match self.open[..] {
            [] | [_] => Some(0),
            [.., last] => self.until(last),
        }
    }

    /// The time that passes behind the next port, and what passed before it.
    fn next(&mut self) -> Option<(i64, i64)> {
        let before = self.open.remove(0);
        let spent = if before == PortNumber::P0 { Some(0) } else { self.until(before) };
        let spent = spent?;
        Some((self.until(*self.open.first()?)? - spent, spent))
    }
}

/// By how much the start time had passed when SYNC0 was switched on last.
fn overdue(last: Switched) -> Option<Nanos> {
    let (now, start) = last.now.zip(last.full_start())?;
    let late = now.value.wrapping_sub(start).cast_signed();
    Some(Nanos(late.max(0)))
}

/// The time from the instant at which punctual frames reach the reference clock to SYNC0.
fn frame_to_sync0(observer: &Observer, device: &Device) -> Option<Picos> {
    let distance = sync::measured(observer, device)?;
    if distance.slides() || distance.count < LEAST_CYCLES {
        return None;
    }
    let cycle = i64::try_from(distance.grid.cycle).ok()?;
    let after = (distance.punctual() + observer.phases.frame_ns()).rem_euclid(cycle);
    Some(Picos::from(Nanos(if after > cycle / 4 * 3 { after - cycle } else { after })))
}

/// Bytes of outputs and inputs by the SyncManagers; `None` if the capture shows none.
fn lengths(device: &Device) -> Option<[u32; 2]> {
    let mut known = false;
    let mut lengths = [0; 2];
    for manager in managers(device) {
        known = true;
        if let Some(direction) = direction(manager) {
            lengths[direction] += u32::from(manager.length);
        }
    }
    known.then_some(lengths)
}

/// The SyncManagers that the capture shows.
fn managers(device: &Device) -> impl Iterator<Item = SyncManager> {
    let known = (0..8).filter_map(|number| device.image.latest(register::sync_manager(number)));
    known.map(|known| known.value)
}

/// Whether a SyncManager of process data has a byte at this address.
pub(crate) fn is_process_data(device: &Device, address: u16) -> bool {
    let mut of_process_data = managers(device).filter(|manager| direction(*manager).is_some());
    of_process_data
        .any(|manager| (u32::from(manager.start)..manager.end()).contains(&address.into()))
}

/// 0: the SyncManager takes outputs; 1: it gives inputs; `None`: it has no process data.
fn direction(manager: SyncManager) -> Option<usize> {
    let of_process_data = manager.is_enabled() && manager.length > 0 && !manager.is_mailbox();
    of_process_data.then_some(usize::from(!manager.is_ecat_write()))
}

/// The logical bits that FMMUs of this kind map to or from SyncManagers of process data.
fn mapped(device: &Device, kind: u8) -> impl Iterator<Item = Range<u64>> {
    let fmmus = (0..16).filter_map(|number| device.image.latest(register::fmmu(number)));
    let fmmus = fmmus.map(|known| known.value);
    let of_process_data = fmmus.filter(move |fmmu: &Fmmu| {
        let start = u32::from(fmmu.physical_start);
        let end = start + u32::from(fmmu.length);
        let meets = |sm: SyncManager| {
            direction(sm).is_some() && start < sm.end() && u32::from(sm.start) < end
        };
        fmmu.is_active() && fmmu.kind & kind != 0 && managers(device).any(meets)
    });
    of_process_data.map(|fmmu| {
        let first = u64::from(fmmu.logical_start) * 8 + u64::from(fmmu.logical_start_bit);
        first..first + u64::from(fmmu.bits())
    })
}

/// Whether frames in operation carry what the FMMUs of this kind map; `None`: the capture does not
/// show the way up, or the device's memory is addressed without FMMUs.
fn exchanged(observer: &Observer, device: &Device, kind: u8) -> Option<bool> {
    if !is_set_up(device) || device.by_address {
        return None;
    }
    let commands = match kind {
        Fmmu::WRITE => [Command::Lrw, Command::Lwr],
        _ => [Command::Lrw, Command::Lrd],
    };
    let carried = |bits: Range<u64>| {
        observer.cycle.logical.iter().any(|logical| {
            let first = u64::from(logical.address) * 8;
            let end = first + u64::from(logical.len) * 8;
            let came_back = logical.counts.iter().any(|(count, _)| *count > 0);
            came_back
                && commands.contains(&logical.command)
                && first <= bits.start
                && bits.end <= end
        })
    };
    Some(mapped(device, kind).any(carried))
}

/// Whether the process data watchdog guards the outputs; it does so after power-on.
fn guarded(device: &Device, set_up: bool) -> Option<bool> {
    let outputs = managers(device).filter(|manager| direction(*manager) == Some(0));
    let control = SyncManager::CONTROL_WATCHDOG;
    let watched =
        outputs.map(|manager| manager.control & control != 0).reduce(|all, one| all && one)?;
    let time = device.image.latest(register::WATCHDOG_TIME_PROCESS_DATA).map(|known| known.value);
    match time {
        Some(time) => Some(watched && time > 0),
        None => (set_up || !watched).then_some(watched),
    }
}

/// The time of the process data watchdog; registers that were not written are as after power-on.
fn watchdog(device: &Device, set_up: bool) -> Option<Nanos> {
    let or = |known: Option<u16>, power_on| known.or(set_up.then_some(power_on));
    let image = &device.image;
    let divider = image.latest(register::WATCHDOG_DIVIDER).map(|known| known.value);
    let time = image.latest(register::WATCHDOG_TIME_PROCESS_DATA).map(|known| known.value);
    let step = (i64::from(or(divider, DIVIDER)?) + 2) * 40;
    Some(Nanos(step * i64::from(or(time, STEPS)?)))
}

/// The largest change of the device's clock in operation.
fn clock_set(device: &Device) -> Nanos {
    let by = device.clock_set.kept.iter().map(|set| set.by_ns.unwrap_or(i64::MAX));
    Nanos(by.map(i64::saturating_abs).max().unwrap_or(0))
}

/// 0x0400 and 0x0420 after power-on: 1 000 steps of 100 us.
const DIVIDER: u16 = 2498;
const STEPS: u16 = 1_000;

/// Drift frames before operation after which clocks count as together. MainDevices usually send ten
/// to fifteen thousand, quick ones some thousand.
const SETTLED: u64 = 1_000;

/// The first frame that shows what is otherwise than meant, and when it was.
pub(crate) fn shown(
    observer: &Observer,
    device: Option<usize>,
    breach: &isocat_rules::Breach,
) -> (usize, Option<Duration>) {
    use isocat_rules::Breach;
    let operation = observer.operation.map_or((1, None), |began| (began.frame, Some(began.value)));
    let device = device.map(|place| &observer.devices.list[place]);
    let last = device.and_then(|device| device.sync.last);
    let known = |frame: Option<usize>| frame.map(|frame| (frame, None));
    let place = match breach {
        Breach::OtherSync0Cycle { .. } => {
            known(last.and_then(|last| last.sync0_cycle).map(|cycle| cycle.frame))
        }
        Breach::Sync0Apart { .. } | Breach::StartPassed { .. } => {
            last.map(|last| (last.start.map_or(last.frame, |start| start.frame), None))
        }
        Breach::OtherShift { .. } => last.map(|last| (last.frame, Some(last.at))),
        Breach::OtherMode { .. } => match last {
            Some(last) => Some((last.frame, Some(last.at))),
            None => device.and_then(|d| d.states.op).map(|op| (op.frame, Some(op.value))),
        },
        Breach::NotOperated { .. } => {
            known(device.and_then(|device| device.states.last_seen()).map(|(_, frame)| frame))
        }
        Breach::SeveralTalkers { .. } => known(turns(observer).nth(1).map(|other| other.first)),
        _ => None,
    };
    place.unwrap_or(operation)
}
