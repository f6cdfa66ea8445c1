//! Clocks, SYNC units, and the distance from frames to SYNC0.

use std::time::Duration;

use isocat_sync::object::{INPUT_PARAMETER, OUTPUT_PARAMETER, SyncType, sub};
use isocat_wire::al::AlState;
use isocat_wire::{ObjectAddress, register};

use super::{MOST_FRAMES, delay, mode, reference};
use crate::device::Device;
use crate::evidence;
use crate::finding::{Finding, Kind};
use crate::observer::Observer;
use crate::phase::{Distance, Measured};
use crate::sync_unit::Switched;

pub(super) fn judge(observer: &Observer, all: &mut Vec<Finding>) {
    drift_frames(observer, all);
    for (place, device) in observer.devices.list.iter().enumerate() {
        started(place, device, observer, all);
        other_delay(place, device, observer, all);
        modes(place, device, all);
        sync0_left_out(place, device, observer, all);
        sync0_switched_off(place, device, observer, all);
        differences(place, device, all);
        clock_set(place, device, observer, all);
        clock_set_early(place, device, observer, all);
        minimum(place, device, all);
        mismatch(place, device, observer, all);
        forgotten(place, device, observer, all);
        watchdog(place, device, observer, all);
        distances(place, device, observer, all);
    }
    slides(observer, all);
}

/// Whether any device makes SYNC0, as far as the capture shows.
fn any_sync(observer: &Observer) -> bool {
    observer.devices.list.iter().any(|device| device.sync.is_on())
}

/// The longest time without a drift frame in operation.
#[derive(Clone, Copy)]
pub(crate) struct DriftGap {
    pub ns: u64,
    /// The frame that shows it, and when that was.
    frame: usize,
    at: Option<Duration>,
    /// No drift frame came at all.
    never: bool,
}

/// The longest time without a drift frame in operation; `None`: no clock is to be kept, or it is
/// not known.
pub(crate) fn drift_gap(observer: &Observer) -> Option<DriftGap> {
    let operation = observer.operation.filter(|_| any_sync(observer))?;
    let end = observer.left.map_or(observer.now, |left| left.value);
    let span = end.saturating_sub(operation.value);
    let whole = |of: Duration| u64::try_from(of.as_nanos()).unwrap_or(u64::MAX);
    let Some(last) = observer.drift.last else {
        let (frame, at) = (operation.frame, Some(operation.value));
        return Some(DriftGap { ns: whole(span), frame, at, never: true });
    };
    if observer.drift.recent == 0 && whole(span) <= DRIFT_PAUSE_NS {
        return None;
    }
    let rest = end.saturating_sub(last.value.max(operation.value));
    match observer.drift.gap.filter(|gap| gap.value >= rest) {
        Some(gap) => {
            Some(DriftGap { ns: whole(gap.value), frame: gap.frame, at: None, never: false })
        }
        None => {
            let (frame, at) = (last.frame, Some(last.value));
            Some(DriftGap { ns: whole(rest), frame, at, never: false })
        }
    }
}

fn drift_frames(observer: &Observer, all: &mut Vec<Finding>) {
    let gap = drift_gap(observer).filter(|gap| gap.ns > DRIFT_PAUSE_NS);
    let Some(DriftGap { ns: gap_ns, frame, at, never }) = gap else { return };
    let kind = if never { Kind::NoDriftFrames {} } else { Kind::DriftFramesStopped { gap_ns } };
    all.push(Finding { at, ..Finding::new(kind, None, frame) });
}

/// Judges the moment at which SYNC was switched on.
fn started(place: usize, device: &Device, observer: &Observer, all: &mut Vec<Finding>) {
    for switched in device.sync.switched.kept.iter().filter(|one| one.makes_sync0()) {
        if let Some((now, start)) = switched.now.zip(switched.full_start()) {
            let late = now.value.wrapping_sub(start).cast_signed();
            // The reference's time was read in an earlier frame, so the real time is later, never
            // earlier.
            if late > 0 {
                // By its own clock it may be to come: then that clock is at fault.
                let ahead = ahead(device, observer, switched, now.value);
                let kind = match ahead.filter(|ahead| late.saturating_add(*ahead) < 0) {
                    Some(ahead_ns) => Kind::ClockFar { ahead_ns },
                    None => Kind::StartInPast { late_ns: late as u64 },
                };
                let frames = switched.start.map(|start| start.frame).into_iter().chain([now.frame]);
                let finding = Finding::new(kind, Some(place), switched.frame);
                all.push(finding.at(switched.at).with(frames));
            }
        }
    }
    let Some(last) = device.sync.last.filter(|last| last.makes_sync0()) else { return };
    if device.sync.looked.is_none() {
        all.push(Finding::new(Kind::SyncNotLookedAt {}, Some(place), last.frame).at(last.at));
    }
    if let Some(before) = device.differences.before_sync
        && before.value.magnitude() > APART_NS
    {
        let kind = Kind::ClocksNotConverged { ns: before.value.magnitude() };
        all.push(Finding::new(kind, Some(place), before.frame).with([last.frame]));
    }
}

/// By how much the clock of a device was ahead of the reference's `now` when SYNC0 was switched on,
/// ns: as its own time was read shortly before, or as its offset set it.
fn ahead(device: &Device, observer: &Observer, switched: &Switched, now: u64) -> Option<i64> {
    // A clock of 32 bits has nothing in the upper half.
    match switched.own.filter(|own| *own > u32::MAX.into() || evidence::is_wide(device)) {
        Some(own) => {
            let now = now.wrapping_add(switched.since.as_nanos() as u64);
            Some(own.wrapping_sub(now).cast_signed())
        }
        None => evidence::ahead_when_set(observer, device),
    }
}

/// Finds a propagation delay that is not what the receive times of the same capture say.
fn other_delay(place: usize, device: &Device, observer: &Observer, all: &mut Vec<Finding>) {
    let Some(last) = device.sync.last.filter(|last| last.makes_sync0()) else { return };
    let Some(over) = evidence::delay_error(observer, device) else { return };
    let written = device.image.written(register::SYSTEM_TIME_DELAY);
    let limit = u64::from(APART_NS) + DIFFER_NS * u64::from(device.position.unwrap_or_default());
    if let Some(written) = written.filter(|_| over.unsigned_abs() > limit) {
        let measured_ns = i64::from(written.value) - over;
        let kind = Kind::OtherDelay { written_ns: written.value, measured_ns };
        all.push(Finding::new(kind, Some(place), written.frame).with([last.frame]));
    }
}

fn modes(place: usize, device: &Device, all: &mut Vec<Finding>) {
    let Some((object, known)) = mode(device) else { return };
    let (mode, frame) = (known.value, known.frame);
    let last = device.sync.last;
    let sync0 = last.is_some_and(|last| last.makes_sync0());
    let sync1 = last.is_some_and(|last| last.word.activates() && last.word.makes_sync1());
    // What was set up before the capture began is not known.
    let up = device.states.op.filter(|op| frame < op.frame);
    // What was switched off later is another matter.
    let entries = || device.sync.switched.kept.iter().filter(|one| one.word.activates());
    let had_sync0 = entries().any(|one| one.word.makes_sync0());
    let had_sync1 = entries().any(|one| one.word.makes_sync1());
    let lacks_sync0 = mode == SyncType::DC_SYNC0 && !sync0 && !had_sync0;
    let lacks = lacks_sync0 || mode == SyncType::DC_SYNC1 && !sync1 && !had_sync1;
    let written = device.mailbox.values.get(&object);
    let written = written.is_some_and(|known| known.value.way == crate::mailbox::Way::Written);
    if let Some(op) = up.filter(|_| lacks && written) {
        let kind = Kind::ModeWithoutSync { object, mode };
        all.push(Finding::new(kind, Some(place), frame).with([op.frame]));
    }
    let unused = matches!(mode, SyncType::FREE_RUN | SyncType::SM | SyncType::INPUTS_ON_SM2);
    if let Some(last) = last.filter(|_| sync0 && unused && written) {
        let kind = Kind::SyncWithoutMode { object, mode };
        all.push(Finding::new(kind, Some(place), frame).with([last.frame]));
    }
}

/// SYNC0 that was switched off while the device was to stay in OP.
fn sync0_switched_off(place: usize, device: &Device, observer: &Observer, all: &mut Vec<Finding>) {
    let (requests, changes) = (&device.states.requests, &device.states.changes);
    let Some(op) = device.states.op.filter(|_| requests.left_off() + changes.left_off() == 0)
    else {
        return;
    };
    let entries = &device.sync.switched.kept;
    let in_op = |off: &Switched| {
        let asked = requests.kept.iter().rfind(|asked| asked.frame < off.frame);
        let seen = changes.kept.iter().rfind(|seen| seen.frame < off.frame);
        let was_op = seen.is_some_and(|seen| seen.status.state() == Ok(AlState::Op));
        let stays = asked.is_some_and(|asked| asked.control.state() == Ok(AlState::Op));
        off.frame > op.frame && stays && was_op
    };
    let off = entries.windows(2).find_map(|two| {
        let [before, now] = two else { return None };
        (before.makes_sync0() && !now.makes_sync0() && in_op(now)).then_some(*now)
    });
    let Some(off) = off else { return };
    // Shortly before the way down it harms nothing.
    let asked = requests.kept.iter().find(|asked| asked.frame > off.frame).map(|asked| asked.at);
    let again = entries.iter().find(|one| one.frame > off.frame && one.makes_sync0());
    let data = observer.cycle.logical.iter().map(|logical| logical.last_at).max();
    let ends = asked.into_iter().chain(again.map(|again| again.at)).chain(data);
    let end = ends.min().unwrap_or(off.at);
    if end.saturating_sub(off.at) >= super::PATIENCE {
        all.push(Finding::new(Kind::Sync0SwitchedOff {}, Some(place), off.frame).at(off.at));
    }
}

/// A device without SYNC0 beside one of its kind that has it. Whether that is meant, no frame says.
fn sync0_left_out(place: usize, device: &Device, observer: &Observer, all: &mut Vec<Finding>) {
    let had = |device: &Device| device.sync.switched.kept.iter().any(Switched::makes_sync0);
    if had(device) || !evidence::operated_as_set_up(observer, device) {
        return;
    }
    let identity = |device: &Device| {
        let sii = &device.sii;
        Some((sii.vendor()?.value, sii.product()?.value))
    };
    let Some(own) = identity(device) else { return };
    let runs = |other: &Device| {
        let on = other.sync.last.is_some_and(|last| last.makes_sync0());
        on && evidence::operated_as_set_up(observer, other) && identity(other) == Some(own)
    };
    let like = observer.devices.list.iter().position(runs);
    if let Some((like, op)) = like.zip(device.states.op) {
        let finding = Finding::new(Kind::Sync0LeftOut { like }, Some(place), op.frame);
        all.push(finding.at(op.value));
    }
}

fn differences(place: usize, device: &Device, all: &mut Vec<Finding>) {
    let Some(worst) = device.differences.worst.filter(|_| device.sync.is_on()) else { return };
    if worst.value.magnitude() > APART_NS {
        let kind = Kind::ClocksApart { ns: worst.value.magnitude() };
        all.push(Finding::new(kind, Some(place), worst.frame));
    }
}

/// A clock that is set anew jumps, and SYNC0 with it.
fn clock_set(place: usize, device: &Device, observer: &Observer, all: &mut Vec<Finding>) {
    let jumps = |by: Option<i64>| by.is_none_or(|by| by.unsigned_abs() > APART_NS.into());
    let mut set = device.clock_set.kept.iter().filter(|set| jumps(set.by_ns));
    let Some(first) = set.next().filter(|_| any_sync(observer)) else { return };
    let kind = Kind::ClockSet { address: first.address, by_ns: first.by_ns };
    let finding = Finding::new(kind, Some(place), first.frame).at(first.at);
    all.push(finding.with(set.map(|more| more.frame).take(MOST_FRAMES)));
}

/// Finds a clock that was set on a second way up while drift frames led it and SYNC0 still ran from
/// the first one: SYNC0 moved with the clock. A change that the reference has too moves all devices
/// alike, and is no finding.
fn clock_set_early(place: usize, device: &Device, observer: &Observer, all: &mut Vec<Finding>) {
    let Some(last) = device.sync.last.filter(|last| last.makes_sync0()) else { return };
    let changes = |of: usize| {
        let kept = &observer.devices.list[of].clock_set_early.kept;
        kept.iter().filter(|set| set.frame > last.frame)
    };
    let Some(first) = changes(place).next() else { return };
    // After a pause clocks are apart, and setting them puts them right; a device that was away has
    // its SYNC unit as it is after power-on.
    let is_led = changes(place).all(|set| set.led.is_some_and(|led| led <= TOGETHER));
    let was_there = device.silences.kept.iter().all(|silence| silence.frame < last.frame);
    let operated = device.states.op.is_some() && device.states.last_op > first.frame;
    if !is_led || !was_there || !operated {
        return;
    }
    let Some(leads) = reference(observer).filter(|leads| *leads != place) else { return };
    let pair = [place, leads];
    if pair.into_iter().flat_map(changes).any(|set| set.by_ns.is_none()) {
        return;
    }
    let [own, of_reference] =
        pair.map(|of| changes(of).filter_map(|set| set.by_ns).fold(0_i64, i64::wrapping_add));
    let by_ns = own.wrapping_sub(of_reference);
    // A clock of 32 bits has the lower half alone.
    let is_wide = pair.into_iter().all(|of| evidence::is_wide(&observer.devices.list[of]));
    let by_ns = if is_wide { by_ns } else { i64::from(by_ns as i32) };
    if by_ns.unsigned_abs() > APART_NS.into() {
        let kind = Kind::ClockSetEarly { address: first.address, by_ns };
        all.push(Finding::new(kind, Some(place), first.frame).at(first.at).with([last.frame]));
    }
}

/// The local cycle that the SYNC unit gives the device, ns: that of SYNC1 if SYNC1 is on.
pub(crate) fn local_cycle(device: &Device) -> Option<u64> {
    let last = device.sync.last.filter(|last| last.makes_sync0())?;
    let sync0 = u64::from(last.sync0_cycle?.value);
    let sync1 = last.sync1_cycle.filter(|_| last.word.makes_sync1()).map_or(0, |k| k.value.into());
    // SYNC1 follows a SYNC0 by its cycle time, and then the first SYNC0 after that.
    let pulses = sync1_pulses(sync1, sync0)?;
    Some(pulses * sync0)
}

fn sync1_pulses(sync1: u64, sync0: u64) -> Option<u64> {
    Some(sync1.checked_div(sync0)? + 1)
}

fn minimum(place: usize, device: &Device, all: &mut Vec<Finding>) {
    let Some(cycle_ns) = local_cycle(device) else { return };
    for index in [OUTPUT_PARAMETER, INPUT_PARAMETER] {
        let object = ObjectAddress::new(index, sub::MINIMUM_CYCLE_TIME);
        let Some(minimum) = device.mailbox.number(object) else { continue };
        if minimum.value > cycle_ns {
            let minimum_ns = minimum.value;
            let kind = Kind::CycleBelowMinimum { object, minimum_ns, cycle_ns };
            let set = device.sync.last.and_then(|last| last.sync0_cycle).map(|known| known.frame);
            all.push(Finding::new(kind, Some(place), minimum.frame).with(set));
            return;
        }
    }
}

/// Checks the ratio of both cycles: three frames a SYNC cycle or a frame at each third SYNC0 are in
/// order; a ratio of 1.3 is not.
fn mismatch(place: usize, device: &Device, observer: &Observer, all: &mut Vec<Finding>) {
    let by_clock = &observer.cycle.by_clock;
    // Not the mean: what is lost makes no other cycle.
    let Some((cycle_ns, frames_ns)) = local_cycle(device).zip(by_clock.median()) else { return };
    if by_clock.count < LEAST_CYCLES {
        return;
    }
    let (longer, shorter) = (cycle_ns.max(frames_ns), cycle_ns.min(frames_ns).max(1));
    let times = (longer + shorter / 2) / shorter;
    if longer.abs_diff(times * shorter) > longer / MISMATCH {
        let frame = by_clock.longest.first().map_or(0, |gap| gap.frame);
        let set = device.sync.last.and_then(|last| last.sync0_cycle).map(|known| known.frame);
        let kind = Kind::CycleMismatch { frames_ns, cycle_ns };
        all.push(Finding::new(kind, Some(place), frame).with(set));
    }
}

/// Finds what the way up did not do before SYNC0 was switched on. This is only known for devices
/// whose station address was written in the capture.
fn forgotten(place: usize, device: &Device, observer: &Observer, all: &mut Vec<Finding>) {
    let Some(last) = device.sync.last.filter(|last| last.makes_sync0()) else { return };
    let changes = &device.states.changes.kept;
    let before = changes.iter().rev().find(|seen| seen.frame < last.frame);
    let state = before.and_then(|seen| seen.status.state().ok());
    if let Some(state) = state.filter(|state| matches!(state, AlState::SafeOp | AlState::Op)) {
        let kind = Kind::SyncAfterSafeOp { state };
        all.push(Finding::new(kind, Some(place), last.frame).at(last.at));
    }
    if device.image.written(register::STATION_ADDRESS).is_none() {
        return;
    }
    let written = |address| device.image.written_bytes::<4>(address).is_some();
    let mut forgot = |kind| all.push(Finding::new(kind, Some(place), last.frame).at(last.at));
    if !written(register::SYSTEM_TIME_OFFSET.address) {
        forgot(Kind::OffsetNotWritten {});
    }
    // The reference has no delay to itself, so none needs to be written.
    let leads = reference(observer) == Some(place);
    if !leads && !written(register::SYSTEM_TIME_DELAY.address) {
        forgot(Kind::DelayNotWritten {});
    }
}

/// The time of the process data watchdog, ns, and a frame that shows it, if both of its registers
/// are known and it is not off.
pub(crate) fn watchdog_ns(device: &Device) -> Option<(u64, usize)> {
    let divider = device.image.latest(register::WATCHDOG_DIVIDER)?;
    let time = device.image.latest(register::WATCHDOG_TIME_PROCESS_DATA)?;
    let ns = (u64::from(divider.value) + 2) * 40 * u64::from(time.value);
    (ns > 0).then_some((ns, divider.frame.max(time.frame)))
}

fn watchdog(place: usize, device: &Device, observer: &Observer, all: &mut Vec<Finding>) {
    let rhythm = match observer.cycle.by_clock.count {
        0 => &observer.cycle.rhythm,
        _ => &observer.cycle.by_clock,
    };
    let Some((watchdog_ns, frame)) = watchdog_ns(device) else { return };
    let Some(cycle_ns) = rhythm.median().filter(|_| rhythm.count >= LEAST_CYCLES) else { return };
    let outputs = device.image.latest(register::sync_manager(2));
    let watched = outputs.is_some_and(|sm| {
        let control = isocat_wire::sync_manager::SyncManager::CONTROL_WATCHDOG;
        sm.value.is_enabled() && sm.value.control & control != 0
    });
    if watched && watchdog_ns <= cycle_ns {
        let kind = Kind::WatchdogBelowCycle { watchdog_ns, cycle_ns };
        all.push(Finding::new(kind, Some(place), frame));
    }
}

/// The distances of a device, from the last bit of its frames there to its SYNC0; `None`: they are
/// not known.
pub(crate) struct OfDevice<'a> {
    /// From the last bit at the reference.
    pub distance: &'a Distance,
    /// By how much it is shorter at the device, ns.
    pub delay: i64,
    /// How inaccurate it is, as stamps of the capture have a share in it, ns; else 0.
    pub within: i64,
    /// Other frames went on when its own had ended.
    pub ended: bool,
}

pub(crate) fn distance(observer: &Observer, place: usize) -> Option<OfDevice<'_>> {
    let (Measured { distance, ended, .. }, within) = observer.distance(place)?;
    let within = within as i64;
    let delay = delay(observer, &observer.devices.list[place])?;
    // Whether the nearest frame came before or behind SYNC0 must be told.
    let cycle = distance.grid.cycle as i64;
    let [shortest, longest] =
        [distance.shortest, distance.longest].map(|known| known.value - delay);
    let told = |ns: i64| (ns - within).div_euclid(cycle) == (ns + within).div_euclid(cycle);
    (told(shortest) && told(longest)).then_some(OfDevice { distance, delay, within, ended })
}

fn distances(place: usize, device: &Device, observer: &Observer, all: &mut Vec<Finding>) {
    let Some(OfDevice { distance, delay, within, .. }) = distance(observer, place) else { return };
    let sure = |finding: Finding| if within > 0 { finding.likely() } else { finding };
    if distance.slides() {
        return;
    }
    let least = distance.shortest.value - delay;
    let most = distance.longest.value - delay;
    let cycle = distance.grid.cycle as i64;
    let usual = (distance.mean() - delay).div_euclid(cycle);
    let early = most.div_euclid(cycle) > usual;
    if least.div_euclid(cycle) < usual || early {
        let worst = if early { distance.longest } else { distance.shortest };
        let first = distance.first_outside.unwrap_or(worst);
        let kind = Kind::SyncPassed {
            // Where most lie beyond the pulse, those before are the unusual ones.
            frames: distance.outside.min(distance.count - distance.outside).max(1),
            of: distance.count,
            worst_ns: worst.value - delay,
        };
        all.push(sure(Finding::new(kind, Some(place), first.frame).with([worst.frame])));
        return;
    }
    let object = ObjectAddress::new(OUTPUT_PARAMETER, sub::CALC_AND_COPY_TIME);
    let Some(needed) = device.mailbox.number(object) else { return };
    let by_sync0 = mode(device).is_some_and(|(_, mode)| mode.value == SyncType::DC_SYNC0);
    if by_sync0 && least + within < needed.value as i64 {
        let kind = Kind::CopyTimeNotKept { least_ns: least, needed_ns: needed.value };
        let finding = Finding::new(kind, Some(place), distance.shortest.frame);
        all.push(sure(finding.with([needed.frame])));
    }
}

fn slides(observer: &Observer, all: &mut Vec<Finding>) {
    let Some(distance) = observer.phases.all().find(|distance| distance.slides()) else { return };
    let cycle = distance.grid.cycle as i64;
    let way = distance.last.value - distance.first.value;
    let span = cycle as f64 * distance.count as f64;
    let kind = Kind::HostSlides { turns: way / cycle, ppm: -(way as f64) / span * 1e6 };
    let frames = distance.first_outside.map(|known| known.frame);
    let finding = Finding::new(kind, None, distance.first.frame);
    all.push(finding.with(frames.into_iter().chain([distance.last.frame])));
}

/// Cycles from which on their length is judged.
pub(crate) const LEAST_CYCLES: u64 = 20;
/// Fraction of the longer cycle by which it may miss a multiple of the shorter one: 5 %.
const MISMATCH: u64 = 20;
/// Difference from the reference clock above which it is reported, ns.
pub(crate) const APART_NS: u32 = 1_000;
/// Time since the last drift frame up to which clocks are still together.
const TOGETHER: Duration = Duration::from_millis(100);
/// How many ns MainDevices differ by in the delay of each further device: what a chip takes more on
/// the way out than on the way back is left out by some.
const DIFFER_NS: u64 = 40;
/// Pause of drift frames above which it is reported, ns: clocks of 50 ppm drift apart by 5 us in
/// it.
const DRIFT_PAUSE_NS: u64 = 100_000_000;
