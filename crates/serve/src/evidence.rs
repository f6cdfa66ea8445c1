//! What the segment itself shows of a MainDevice's work, for the rules: registers and states of the
//! simulated devices, and what their judges measured.

use std::ops::Range;

use isocat_rules::evidence::{DeviceEvidence, Evidence};
use isocat_sim::Served;
use isocat_sim::device::Device;
use isocat_subdevice::description::ProcessDataArea;
use isocat_wire::fmmu::Fmmu;
use isocat_wire::register;
use isocat_wire::sync_manager::SyncManager;
use isocat_wire::time::{Nanos, Picos, Time, True};
use isocat_wire::{AlState, Command};

use crate::conduct::Conduct;
use crate::verdict::JudgedDevice;

/// The evidence of the stretch that ended at `ended`. Registers are those of now: call this before
/// the MainDevice changes them for its way down.
pub(crate) fn of(
    served: &Served,
    conduct: &Conduct,
    devices: &[JudgedDevice],
    (began, ended): (Time<True>, Time<True>),
) -> Evidence {
    let cycle = &conduct.cycle;
    let whole = |ps: Picos| Nanos(ps.0 / 1_000);
    Evidence {
        cycle: mean_cycle(conduct),
        longest_drift_gap: Some(whole(cycle.longest_drift_gap(began, ended))),
        slide: cycle.slide(),
        talkers: Some(conduct.sources().iter().map(|source| source.frames).collect()),
        untaken: cycle.untaken,
        devices: devices
            .iter()
            .enumerate()
            .map(|(at, judged)| device(served, conduct, at, judged))
            .collect(),
    }
}

/// The evidence where nothing came to operation: what the MainDevice had set up when it gave up.
/// `reference` is the SubDevice whose time it distributed.
pub(crate) fn of_attempt(served: &Served, conduct: &Conduct, reference: usize) -> Evidence {
    let cycle = &conduct.cycle;
    let devices = served.segment().devices();
    let frame = cycle.last().map(|at| served.system_time_ps(reference, at));
    let device = |device: &Device| {
        let esc = &device.esc;
        let sync0_cycle = esc.register(register::SYNC0_CYCLE);
        let runs = esc.sync_active() && sync0_cycle > 0;
        let overdue = overdue(served, device);
        let wide = esc.register(register::FEATURES) & register::features::DC_64_BIT != 0;
        let comes = runs && wide && overdue == Some(Nanos::ZERO);
        let start = i128::from(esc.register(register::SYNC_START_TIME)) * 1_000;
        let phase = Nanos((start / 1_000).rem_euclid(i128::from(sync0_cycle.max(1))) as i64);
        DeviceEvidence {
            operated: true,
            mode: matches!(device.stack.state(), AlState::SafeOp | AlState::Op)
                .then(|| device.stack.sync().mode()),
            activation: Some(esc.register(register::SYNC_ACTIVATION).0),
            sync0_cycle: runs.then(|| Nanos::from_u32(sync0_cycle)),
            sync0_phase: comes.then_some(phase),
            sync0_overdue: overdue,
            frame_to_sync0: frame
                .filter(|_| comes)
                .map(|frame| after(frame, start, Nanos::from_u32(sync0_cycle))),
            ..DeviceEvidence::default()
        }
    };
    Evidence {
        talkers: Some(conduct.sources().iter().map(|source| source.frames).collect()),
        devices: devices.iter().map(device).collect(),
        ..Evidence::default()
    }
}

fn mean_cycle(conduct: &Conduct) -> Option<Nanos> {
    // One pause is no other cycle.
    let intervals = &conduct.cycle.intervals;
    let rest = intervals.count().saturating_sub(1);
    let sum = intervals.mean() * intervals.count() as f64 - intervals.largest() as f64;
    (conduct.cycle.count() >= LEAST_CYCLES && rest > 0)
        .then(|| Nanos((sum / rest as f64 / 1_000.0) as i64))
}

fn device(served: &Served, conduct: &Conduct, at: usize, judged: &JudgedDevice) -> DeviceEvidence {
    let device = &served.segment().devices()[at];
    let esc = &device.esc;
    let cycle = esc.register(register::SYNC0_CYCLE);
    let runs = esc.sync_active() && cycle > 0;
    let intent = served.bench().intent();
    let grid = intent.and_then(|intent| *intent.sync0.get(at)?);
    let description = device.stack.description();
    let outputs: Vec<_> = areas(device, description.output_areas()).collect();
    let inputs: Vec<_> = areas(device, description.input_areas()).collect();
    let [output_bytes, input_bytes] =
        [&outputs, &inputs].map(|areas| areas.iter().map(|sm| u32::from(sm.length)).sum::<u32>());
    let [output_age, input_age] = &judged.ages;
    let logical = [mapped(device, &outputs, Fmmu::WRITE), mapped(device, &inputs, Fmmu::READ)];
    let commands = [[Command::Lrw, Command::Lwr], [Command::Lrw, Command::Lrd]];
    let carried_each =
        [0, 1].map(|towards| carried_each(conduct, &logical[towards], commands[towards]));
    DeviceEvidence {
        state: Some((judged.state, judged.code)),
        operated: judged.took_part,
        mode: Some(judged.mode),
        activation: Some(esc.register(register::SYNC_ACTIVATION).0),
        sync0_cycle: runs.then(|| Nanos::from_u32(cycle)),
        sync0_overdue: overdue(served, device),
        sync0_phase: grid.filter(|_| runs).map(|grid| grid.phase),
        frame_to_sync0: grid.filter(|_| runs && judged.mode.uses_dc()).and_then(|grid| {
            let sync0 = i128::from(grid.phase.0) * 1_000;
            Some(after(conduct.cycle.mean_phase()?, sync0, grid.cycle))
        }),
        lengths: Some([output_bytes, input_bytes]),
        exchanged: [output_age, input_age].map(|age| Some(age.count() > 0)),
        carried_each,
        interpolation: device.stack.interpolation_time(),
        logical: Some(logical),
        guarded: Some(outputs.iter().all(|sm| {
            sm.control & SyncManager::CONTROL_WATCHDOG != 0
                && esc.register(register::WATCHDOG_TIME_PROCESS_DATA) > 0
        })),
        watchdog: Some(watchdog(device)),
        clock_set: Some(clock_set(judged.clock_before, clock(device))),
    }
}

/// Mean time from one datagram with these logical bits to the next, by their number against that of
/// the cycles.
fn carried_each(
    conduct: &Conduct,
    logical: &[Range<u64>],
    commands: [Command; 2],
) -> Option<Nanos> {
    let cycle = mean_cycle(conduct)?;
    let of = |bits: &Range<u64>| conduct.cycle.carried(bits.start, commands);
    let [cycles, least] =
        logical.iter().map(of).min_by_key(|found| found.map(|[_, count]| count))??;
    // The stretch may end just before the next one.
    let each = i128::from(cycle.0) * i128::from(cycles) / (i128::from(least) + 1);
    (least > 0).then(|| Nanos(i64::try_from(each).unwrap_or(i64::MAX)))
}

/// The time of the process data watchdog: steps of some ticks of 40 ns.
fn watchdog(device: &Device) -> Nanos {
    let step = (i64::from(device.esc.register(register::WATCHDOG_DIVIDER)) + 2) * 40;
    Nanos(step * i64::from(device.esc.register(register::WATCHDOG_TIME_PROCESS_DATA)))
}

/// Offset and delay of the clock, ns.
pub(crate) fn clock(device: &Device) -> [i64; 2] {
    let offset = device.esc.register(register::SYSTEM_TIME_OFFSET).cast_signed();
    [offset, device.esc.register(register::SYSTEM_TIME_DELAY).into()]
}

/// The larger one of the changes of offset and delay.
fn clock_set(before: [i64; 2], now: [i64; 2]) -> Nanos {
    let changes = before.into_iter().zip(now).map(|(before, now)| now.wrapping_sub(before));
    Nanos(changes.map(i64::saturating_abs).max().unwrap_or(0))
}

/// The time from a frame to the SYNC0 that belongs to it, by two instants of the reference clock in
/// ps: one that comes up to a quarter of the cycle before the frame is before it.
fn after(frame: i128, sync0: i128, cycle: Nanos) -> Picos {
    let cycle = i128::from(cycle.0) * 1_000;
    let after = (sync0 - frame).rem_euclid(cycle);
    Picos(if after > cycle * 3 / 4 { after - cycle } else { after } as i64)
}

/// By how much the next pulse of SYNC0 is overdue by the clock of the device.
fn overdue(served: &Served, device: &Device) -> Option<Nanos> {
    let esc = &device.esc;
    let now = esc.system_time(device.oscillator().read(served.now()));
    let Some(due) = esc.next_sync0() else {
        // None will ever come: the start time had passed when it was written.
        let ago = now - Time::new(esc.register(register::SYNC_START_TIME));
        return Some(ago.max(Nanos(1)));
    };
    // A pulse of this very instant is not overdue.
    let cycle = Nanos::from_u32(esc.register(register::SYNC0_CYCLE));
    Some(now - due).filter(|ago| *ago > cycle).or(Some(Nanos::ZERO))
}

/// The SyncManagers of process data that are switched on.
fn areas(
    device: &Device,
    areas: impl Iterator<Item = ProcessDataArea>,
) -> impl Iterator<Item = SyncManager> {
    areas
        .map(|area| device.esc.register(register::sync_manager(area.sync_manager.into())))
        .filter(|sm| sm.is_enabled() && sm.length > 0)
}

/// The logical bits that FMMUs of this kind map to or from these SyncManagers.
fn mapped(device: &Device, areas: &[SyncManager], kind: u8) -> Vec<Range<u64>> {
    let count = device.esc.register(register::FMMU_COUNT).min(16);
    let fmmus = (0..count.into()).map(|number| device.esc.register(register::fmmu(number)));
    let of_areas = fmmus.filter(|fmmu: &Fmmu| {
        let start = u32::from(fmmu.physical_start);
        let end = start + u32::from(fmmu.length);
        let meets = |sm: &SyncManager| start < sm.end() && u32::from(sm.start) < end;
        fmmu.is_active() && fmmu.kind & kind != 0 && areas.iter().any(meets)
    });
    let bits = |fmmu: Fmmu| {
        let first = u64::from(fmmu.logical_start) * 8 + u64::from(fmmu.logical_start_bit & 7);
        first..first + u64::from(fmmu.bits())
    };
    of_areas.map(bits).collect()
}

/// Cycles whose mean length says something.
const LEAST_CYCLES: u64 = 10;
