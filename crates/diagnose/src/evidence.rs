//! What a capture shows of a segment in operation, for the rulebook: as registers were written and
//! read, and as frames came.

mod data;
mod ways;

use std::time::Duration;

use isocat_rules::{Breach, Claims, DeviceClaims, DeviceEvidence, Evidence};
use isocat_sync::object::{INTERPOLATION_TIME, SyncType};
use isocat_sync::{SyncMode, interpolation as period};
use isocat_wire::register::{self, Register, Value};
use isocat_wire::time::{Nanos, Picos};
use isocat_wire::{AlState, AlStatusCode, ObjectAddress};

use crate::cycle::Rhythm;
use crate::device::Device;
use crate::judge::sync::{self, LEAST_CYCLES};
use crate::judge::{self, PATIENCE, turns};
use crate::known::Known;
use crate::mailbox::Way;
use crate::observer::Observer;
use crate::sync_unit::Switched;

pub(crate) use data::{carriers, goes_both_ways, is_process_data};
use ways::ways;

/// The evidence about the SubDevices that the claims are about, by position.
pub(crate) fn of(observer: &Observer, claims: &Claims) -> Evidence {
    let rhythm = rhythm(observer);
    let is_operated = observer.operation.is_some() && rhythm.is_some();
    let cycle = rhythm.and_then(|rhythm| rhythm.median()).map(nanos);
    let of_device = |(at, claims): (usize, &DeviceClaims)| {
        let place = u16::try_from(at).ok().and_then(|at| observer.devices.at(at));
        Some(device(observer, place?, claims, is_operated, cycle))
    };
    let devices = claims.devices.iter().enumerate();
    Evidence {
        cycle,
        // A pause between two stretches is none in operation.
        longest_drift_gap: sync::drift_gap(observer)
            .filter(|_| observer.held.is_empty())
            .map(|gap| nanos(gap.ns)),
        slide: rhythm.and_then(|_| observer.phases.slide()),
        talkers: Some(turns(observer).map(|talker| talker.frames).collect()),
        untaken: None,
        devices: devices.map(|one| of_device(one).unwrap_or_default()).collect(),
    }
}

/// The rhythm of the cyclic frames, by the clock of the segment if it shows enough of them.
fn rhythm(observer: &Observer) -> Option<&Rhythm> {
    let cycles = [&observer.cycle.by_clock, &observer.cycle.rhythm];
    cycles.into_iter().find(|rhythm| rhythm.count >= LEAST_CYCLES)
}

fn device(
    observer: &Observer,
    place: usize,
    claims: &DeviceClaims,
    is_operated: bool,
    cycle: Option<Nanos>,
) -> DeviceEvidence {
    let device = &observer.devices.list[place];
    // Without any state in the capture, the exchange itself is operation.
    let operated = is_operated && (was_in_op(observer, device) || device.states.now().is_none());
    let last = device.sync.last.filter(Switched::makes_sync0);
    let set_up = is_set_up(device);
    let lengths = data::lengths(device).or_else(|| set_up.then_some([0, 0]));
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
        frame_to_sync0: frame_to_sync0(observer, place),
        lengths,
        exchanged: [0, 1].map(|towards| data::exchanged(observer, device, towards)),
        carried_each: [0, 1].map(|towards| data::carried_each(observer, device, towards, cycle?)),
        interpolation: interpolation(device).map(|known| known.value),
        logical: set_up.then(|| data::mapped(device)),
        guarded: data::guarded(device, set_up),
        watchdog: data::watchdog(device, set_up),
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

/// Whether the capture has the way up of the device, and it was in OP since.
pub(crate) fn operated_as_set_up(observer: &Observer, device: &Device) -> bool {
    is_set_up(device) && was_in_op(observer, device)
}

/// Whether the capture shows the way up of all devices that frames pass, that none of them was
/// given SYNC0, and that all operated.
pub(crate) fn operates_without_sync(observer: &Observer) -> bool {
    let devices = &observer.devices.list;
    let reach = observer.reach.kept.last().filter(|_| observer.reach.left_off() == 0);
    let all = reach.is_some_and(|last| usize::from(last.to) == devices.len());
    let cycles = observer.cycle.rhythm.count >= LEAST_CYCLES;
    let operates = |device: &Device| {
        let switched = &device.sync.switched;
        let never = switched.left_off() == 0 && !switched.kept.iter().any(Switched::makes_sync0);
        let is_up = operated_as_set_up(observer, device);
        is_up && never && !goes_both_ways(device)
    };
    all && cycles && devices.iter().all(operates)
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

/// The interpolation time of a drive: both parts are known, and one at least was written.
pub(crate) fn interpolation(device: &Device) -> Option<Known<Nanos>> {
    let part = |sub| {
        let known = device.mailbox.values.get(&ObjectAddress::new(INTERPOLATION_TIME, sub))?;
        let byte = u8::try_from(known.value.number()?).ok()?;
        Some((byte, known.value.way == Way::Written, known.frame))
    };
    let ((units, first, at), (power, second, then)) = (part(1)?, part(2)?);
    let value = period::time(units, power.cast_signed()).filter(|_| first || second)?;
    Some(Known { value, frame: at.max(then) })
}

/// What holds of any segment, whatever it is meant to do: the start of SYNC0 is to come, frames
/// stay where they are in the cycle, process data are carried and overlap nowhere, and a drive
/// interpolates over the time between its outputs.
pub(crate) fn of_any(observer: &Observer) -> Claims {
    // The rhythm is that of all stretches of operation, so it says nothing of a further one.
    let rhythm = rhythm(observer).filter(|_| observer.held.is_empty());
    let cycle = rhythm.and_then(|rhythm| rhythm.median()).map(nanos);
    let each = |at: usize| {
        let place = observer.devices.at(u16::try_from(at).ok()?)?;
        let cycle = cycle.filter(|cycle| cycle.0 > 0)?;
        let device = &observer.devices.list[place];
        let each = data::carried_each(observer, device, 0, cycle)?;
        // Whole cycles: one more or less is counted at the ends. A drive takes what came last
        // before its own pulse.
        let each = Nanos(cycle.0 * ((each.0 + cycle.0 / 2) / cycle.0).max(1));
        Some(sync::local_cycle(device).map_or(each, |own| each.max(nanos(own))))
    };
    let device = |at| DeviceClaims { interpolation: each(at), ..DeviceClaims::default() };
    let devices = (0..observer.devices.list.len()).map(device).collect();
    Claims { cycle: None, sync0_limit: Nanos(sync::APART_NS.into()), devices }
}

/// The first device with SYNC0 of which nothing shows that its clock had come to the reference
/// before it operated, though the capture has its way up.
pub(crate) fn unled(observer: &Observer) -> Option<usize> {
    let leads = judge::reference(observer);
    let is_unled = |(place, device): (usize, &Device)| {
        let pulses = device.sync.is_on() && operated_as_set_up(observer, device);
        pulses && leads.is_some() && leads != Some(place) && !follows(observer, device)
    };
    observer.devices.list.iter().enumerate().find(|one| is_unled(*one)).map(|(place, _)| place)
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
    if judge::reference(observer) != Some(place) && !follows(observer, device) {
        return None;
    }
    // A clock that is ahead by a wrong delay lets its pulses come too early.
    let ahead = delay_error(observer, device).unwrap_or(0);
    let cycle = i64::try_from(grid.cycle).ok()?;
    Some(Nanos((grid.phase as i64 - ahead).rem_euclid(cycle)))
}

/// Whether the clock of a device followed the reference clock when operation began: its difference
/// was read, or it was set to less than that and had drift frames enough.
fn follows(observer: &Observer, device: &Device) -> bool {
    let differences = &device.differences;
    let read = [differences.before_sync, differences.worst].into_iter().flatten();
    let mut read = read.map(|known| known.value.magnitude() <= sync::APART_NS).peekable();
    if read.peek().is_some() {
        return read.all(|near| near);
    }
    let latch = register::RECEIVE_TIME_0.address;
    if is_set_up(device) && device.image.written_bytes::<1>(latch).is_none() {
        // Times that nothing latched set no clock.
        return false;
    }
    let set = ahead_when_set(observer, device);
    set.is_none_or(|ahead| ahead.unsigned_abs() <= sync::APART_NS.into())
        && observer.drift.count - observer.drift.recent >= SETTLED
}

/// By how much the offset set the clock of a device ahead of the reference, ns, by the time at
/// which both had the frame that latched it (0x0918). Some MainDevices leave the way between them
/// to the drift loop, so the lesser distance counts, with the way or without it.
pub(crate) fn ahead_when_set(observer: &Observer, device: &Device) -> Option<i64> {
    let reference = &observer.devices.list[judge::reference(observer)?];
    let of = |device: &Device| {
        let latched = device.image.read(register::RECEIVE_TIME_EPU)?.value;
        Some(latched.wrapping_add(kept(device, register::SYSTEM_TIME_OFFSET)?))
    };
    let ahead = of(device)?.wrapping_sub(of(reference)?);
    // A clock of 32 bits has the lower half alone.
    let ahead = match is_wide(device) && is_wide(reference) {
        true => ahead.cast_signed(),
        false => i64::from((ahead as u32).cast_signed()),
    };
    let way = way(observer, device)? - way(observer, reference)?;
    [ahead, ahead.saturating_sub(way)].into_iter().min_by_key(|ahead| ahead.unsigned_abs())
}

pub(crate) fn is_wide(device: &Device) -> bool {
    let features = device.image.read(register::FEATURES);
    features.is_some_and(|known| known.value & register::features::DC_64_BIT != 0)
}

/// By how much the delay that was written to a device is longer than what the receive times say,
/// ns, both against the reference.
pub(crate) fn delay_error(observer: &Observer, device: &Device) -> Option<i64> {
    let reference = &observer.devices.list[judge::reference(observer)?];
    let measured = way(observer, device)? - way(observer, reference)?;
    let of = |device: &Device| kept(device, register::SYSTEM_TIME_DELAY).map(i64::from);
    Some(of(device)? - of(reference).unwrap_or(0) - measured)
}

/// What a register that keeps its value has; what the way up did not write is 0 since power-on.
fn kept<T: Value + Default>(device: &Device, register: Register<T>) -> Option<T> {
    let known = device.image.latest_or_zero(register).map(|known| known.value);
    known.or_else(|| is_set_up(device).then(T::default))
}

/// How long frames take to a device.
fn way(observer: &Observer, device: &Device) -> Option<i64> {
    ways(observer).get(usize::from(device.position?)).copied().flatten()
}

/// By how much the start time had passed when SYNC0 was switched on last.
fn overdue(last: Switched) -> Option<Nanos> {
    let (now, start) = last.now.zip(last.full_start())?;
    let late = now.value.wrapping_sub(start).cast_signed();
    Some(Nanos(late.max(0)))
}

/// The time from the instant at which punctual frames reach the reference clock to SYNC0.
fn frame_to_sync0(observer: &Observer, place: usize) -> Option<Picos> {
    let (measured, within) = observer.distance(place)?;
    let distance = measured.distance;
    if measured.ended || distance.slides() || distance.count < LEAST_CYCLES {
        return None;
    }
    let cycle = i64::try_from(distance.grid.cycle).ok()?;
    if within > distance.grid.cycle / 100 {
        return None;
    }
    let after = (distance.punctual() + distance.frame_ns).rem_euclid(cycle);
    Some(Picos::from(Nanos(if after > cycle / 4 * 3 { after - cycle } else { after })))
}

/// The largest change of the device's clock in operation.
fn clock_set(device: &Device) -> Nanos {
    let by = device.clock_set.kept.iter().map(|set| set.by_ns.unwrap_or(i64::MAX));
    Nanos(by.map(i64::saturating_abs).max().unwrap_or(0))
}

/// Drift frames before operation after which clocks count as together. MainDevices usually send ten
/// to fifteen thousand, quick ones some thousand.
const SETTLED: u64 = 1_000;

/// The first frame that shows what is otherwise than meant, and when it was.
pub(crate) fn shown(
    observer: &Observer,
    device: Option<usize>,
    breach: &Breach,
) -> (usize, Option<Duration>) {
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
        Breach::OtherInterpolation { .. } => {
            known(device.and_then(interpolation).map(|known| known.frame))
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

#[cfg(test)]
mod tests {
    use isocat_wire::datagram::{Address, Header};
    use isocat_wire::{AutoIncrementAddress, Command};

    use super::*;
    use crate::access::Access;
    use crate::clock::Reference;
    use crate::known::Known;

    /// Two devices, 1 us apart, whose clocks were latched and set, with drift frames enough.
    fn observer(features: u16, offset: u64, frames: u64) -> Observer {
        let mut observer = Observer::new();
        for (position, latched) in [(0, 5_000_u64), (1, 7_000)] {
            let address = Address::Position(AutoIncrementAddress::of_position(position), 0);
            let access = Access {
                command: Command::Aprd,
                header: Header::new(Command::Aprd, 0, address, 2),
                sent: Some(&[0, 0]),
                answered_before: false,
                back: Some((&[0, 0], 1)),
                passed: None,
                position: Some(position),
                frame: 1,
            };
            observer.devices.whom(&access, true);
            let place = observer.devices.at(position).expect("it has a position");
            observer.devices.name(place, 0x1001 + position, 1);
            let device = &mut observer.devices.list[place];
            let image = &mut device.image;
            let [came, back] = [latched as u32, latched as u32 + 2_000 * u32::from(1 - position)];
            image.write(0x0900, &[0; 4], 2);
            image.note(0x0900, &came.to_le_bytes(), 3);
            image.note(0x0904, &back.to_le_bytes(), 3);
            image.note(0x0918, &latched.to_le_bytes(), 3);
            image.note(0x0008, &features.to_le_bytes(), 3);
            // Port 0, and at the first port 1 as well.
            let status: u16 = if position == 0 { 0x0A30 } else { 0x0210 };
            image.note(0x0110, &status.to_le_bytes(), 3);
            let own = if position == 0 { 0_u64 } else { offset };
            image.write(0x0920, &own.to_le_bytes(), 4);
            image.write(0x0010, &(0x1001 + position).to_le_bytes(), 1);
            device.states.op = Some(Known { value: Duration::ZERO, frame: 9 });
        }
        observer.drift.reference = Some(Known { value: Reference::Station(0x1001), frame: 5 });
        observer.drift.count = frames;
        observer
    }

    #[test]
    fn a_clock_that_was_set_apart_is_not_known_to_follow() {
        let follows = |features, offset: i64, frames| {
            let observer = observer(features, offset.cast_unsigned(), frames);
            let place = observer.devices.at(1).expect("it has a position");
            follows(&observer, &observer.devices.list[place])
        };
        let wide = register::features::DC_64_BIT;
        // Latched 2 us later, of which the way is one, and that may be left out.
        let apart = i64::from(sync::APART_NS);
        for (ahead, near) in [
            (0, true),
            (apart, true),
            (apart + 1, false),
            (-1_000 - apart, true),
            (-1_001 - apart, false),
        ] {
            assert_eq!(follows(wide, ahead - 1_000, SETTLED), near, "{ahead}");
        }
        assert!(!follows(wide, -1_000, SETTLED - 1));
        // The upper half counts where there is one.
        let far = (1 << 40) - 1_000;
        assert_eq!((follows(wide, far, SETTLED), follows(0, far, SETTLED)), (false, true));
    }

    /// Receive times of different frames give no way. Neither do those of a ring, whose last device
    /// has a link to the MainDevice.
    #[test]
    fn only_times_of_one_frame_on_a_line_give_ways() {
        let error = |change: &dyn Fn(&mut Device)| {
            let mut observer = observer(0, 0, SETTLED);
            let place = observer.devices.at(1).expect("it has a position");
            change(&mut observer.devices.list[place]);
            delay_error(&observer, &observer.devices.list[place])
        };
        assert_eq!(error(&|_| {}), Some(-1_000));
        assert_eq!(error(&|last| last.image.note(0x0110, &0x0A30_u16.to_le_bytes(), 9)), None);
        let first_takes = |ns: u32| {
            let mut observer = observer(0, 0, SETTLED);
            let [first, place] = [0, 1].map(|at| observer.devices.at(at).expect("there"));
            let back = 5_000_u32.wrapping_add(ns);
            observer.devices.list[first].image.note(0x0904, &back.to_le_bytes(), 9);
            delay_error(&observer, &observer.devices.list[place])
        };
        assert_eq!(first_takes(1_999_998), Some(-999_999));
        assert_eq!(first_takes(2_000_000), None);
        assert_eq!(first_takes(0_u32.wrapping_sub(2_000)), None);
    }

    #[test]
    fn what_was_not_written_is_zero() {
        let mut observer = observer(0, 0, SETTLED);
        let [first, second] = [0, 1].map(|position| observer.devices.at(position).expect("there"));
        let error = |observer: &Observer| delay_error(observer, &observer.devices.list[second]);
        assert_eq!(error(&observer), Some(-1_000));
        observer.devices.list[first].image.write(0x0928, &1_000_u32.to_le_bytes(), 6);
        assert_eq!(error(&observer), Some(-2_000));
        // One byte of four.
        observer.devices.list[second].image.write(0x0929, &[8], 7);
        assert_eq!(error(&observer), Some(8 * 256 - 2_000));
    }
}
