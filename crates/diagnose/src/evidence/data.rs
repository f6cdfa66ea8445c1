//! Process data: SyncManagers, FMMUs, the frames that carry them, and the watchdog over them.

use std::ops::Range;

use isocat_wire::fmmu::Fmmu;
use isocat_wire::sync_manager::SyncManager;
use isocat_wire::time::Nanos;
use isocat_wire::{AlState, Command, register};

use super::is_set_up;
use crate::cycle::Logical;
use crate::device::Device;
use crate::observer::Observer;

/// Bytes of outputs and inputs by the SyncManagers; `None` if the capture shows none.
pub(super) fn lengths(device: &Device) -> Option<[u32; 2]> {
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

/// The active FMMUs of this kind, as they were written last.
fn fmmus(device: &Device, kind: u8) -> impl Iterator<Item = Fmmu> {
    let known = (0..16).filter_map(|number| device.image.latest(register::fmmu(number)));
    known.map(|known| known.value).filter(move |fmmu| fmmu.is_active() && fmmu.kind & kind != 0)
}

/// Whether an FMMU both reads and writes: what it reads may overwrite the inputs of the device.
pub(crate) fn goes_both_ways(device: &Device) -> bool {
    fmmus(device, Fmmu::READ).any(|fmmu| fmmu.kind & Fmmu::WRITE != 0)
}

fn logical_bits(fmmu: &Fmmu) -> Range<u64> {
    let first = u64::from(fmmu.logical_start) * 8 + u64::from(fmmu.logical_start_bit & 7);
    first..first + u64::from(fmmu.bits())
}

/// The logical bits that FMMUs map to SyncManagers of outputs, and from those of inputs.
pub(super) fn mapped(device: &Device) -> [Vec<Range<u64>>; 2] {
    let of_process_data = |fmmu: &Fmmu| {
        let start = u32::from(fmmu.physical_start);
        let end = start + u32::from(fmmu.length);
        managers(device)
            .any(|sm| direction(sm).is_some() && start < sm.end() && u32::from(sm.start) < end)
    };
    let of_kind = |kind| fmmus(device, kind).filter(of_process_data);
    KINDS.map(|kind| of_kind(kind).map(|fmmu| logical_bits(&fmmu)).collect())
}

/// Places of the logical datagrams with the last bit of the outputs of a device, with which it has
/// them all, or of its inputs if it has no outputs. `None`: the capture does not show where these
/// are.
pub(crate) fn carriers(logical: &[Logical], device: &Device) -> Option<Vec<usize>> {
    let mapped = mapped(device);
    let (bits, kind) = mapped.iter().zip(KINDS).find(|(bits, _)| !bits.is_empty())?;
    let end = bits.iter().map(|bits| bits.end).max()?;
    let last = end.saturating_sub(1)..end;
    let all = logical.iter().enumerate();
    Some(all.filter(|(_, one)| has(one, &last, kind)).map(|(place, _)| place).collect())
}

/// Whether frames in operation carry the process data of a direction: a SyncManager hands over its
/// buffer with the last byte, and takes one with the first. `None`: the capture does not show the
/// way up, or the device's memory is addressed without FMMUs.
pub(super) fn exchanged(observer: &Observer, device: &Device, towards: usize) -> Option<bool> {
    // FMMUs that were never seen may be those of an earlier program.
    let seen = (0..16).any(|number| device.image.latest(register::fmmu(number)).is_some());
    if !is_set_up(device) || device.by_address || !seen || observer.cycle.left_out > 0 {
        return None;
    }
    let of_direction = managers(device).filter(|sm| direction(*sm) == Some(towards));
    let mut edges = of_direction.map(|sm| [u64::from(sm.start), u64::from(sm.end()) - 1]);
    let is_carried = |byte: u64| {
        fmmus(device, KINDS[towards]).any(|fmmu| {
            let bits = logical_bits_of(&fmmu, byte);
            bits.is_some_and(|bits| are_carried(observer, &bits, KINDS[towards]))
        })
    };
    Some(edges.any(|edges| edges.into_iter().all(is_carried)))
}

/// The logical bits that this FMMU maps to or from a byte of memory.
fn logical_bits_of(fmmu: &Fmmu, byte: u64) -> Option<Range<u64>> {
    let physical = u64::from(fmmu.physical_start) * 8 + u64::from(fmmu.physical_start_bit & 7);
    let from = physical.max(byte * 8);
    let to = (physical + u64::from(fmmu.bits())).min(byte * 8 + 8);
    let logical = logical_bits(fmmu).start;
    (from < to).then(|| logical + from - physical..logical + to - physical)
}

/// Whether a datagram that came back has all these logical bits.
fn are_carried(observer: &Observer, bits: &Range<u64>, kind: u8) -> bool {
    observer.cycle.logical.iter().any(|logical| {
        let came_back = logical.counts.iter().any(|(count, _)| *count > 0);
        came_back && has(logical, bits, kind)
    })
}

/// Whether a datagram has all these logical bits, and works with FMMUs of this kind.
fn has(logical: &Logical, bits: &Range<u64>, kind: u8) -> bool {
    let commands = match kind {
        Fmmu::WRITE => [Command::Lrw, Command::Lwr],
        _ => [Command::Lrw, Command::Lrd],
    };
    let first = u64::from(logical.address) * 8;
    let end = first + u64::from(logical.len) * 8;
    commands.contains(&logical.command) && first <= bits.start && bits.end <= end
}

/// Mean time from one datagram with the process data of a direction to the next, by their number
/// against that of those that begin a `cycle`.
pub(super) fn carried_each(
    observer: &Observer,
    device: &Device,
    towards: usize,
    cycle: Nanos,
) -> Option<Nanos> {
    let all = &observer.cycle;
    // One that was asked to leave OP a while ago needs nothing any more.
    let leaves = device.states.asked.is_some_and(|asked| asked.value.state() != Ok(AlState::Op));
    let asked = device.states.requests.kept.last().map_or(observer.now, |last| last.at);
    let ago = observer.now.saturating_sub(asked).as_nanos();
    if leaves && ago > 10 * u128::from(cycle.0.unsigned_abs()) {
        return None;
    }
    let cycles = all.logical.get(all.marker?)?.recent;
    if !is_set_up(device) || device.by_address || all.left_out > 0 {
        return None;
    }
    let number = |bits: &Range<u64>| {
        let carry = all.logical.iter().filter(|logical| has(logical, bits, KINDS[towards]));
        carry.map(|logical| logical.recent).sum::<u64>()
    };
    let mapped = &mapped(device)[towards];
    let least = mapped.iter().map(|bits| number(&(bits.start..bits.start + 1))).min();
    let least = least.filter(|number| *number > 0)?;
    // The stretch may end just before the next one.
    let each = i128::from(cycle.0) * i128::from(cycles) / (i128::from(least) + 1);
    Some(Nanos(i64::try_from(each).unwrap_or(i64::MAX)))
}

/// Whether the process data watchdog guards the outputs; it does so after power-on.
pub(super) fn guarded(device: &Device, set_up: bool) -> Option<bool> {
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
pub(super) fn watchdog(device: &Device, set_up: bool) -> Option<Nanos> {
    let or = |known: Option<u16>, power_on| known.or(set_up.then_some(power_on));
    let image = &device.image;
    let divider = image.latest(register::WATCHDOG_DIVIDER).map(|known| known.value);
    let time = image.latest(register::WATCHDOG_TIME_PROCESS_DATA).map(|known| known.value);
    let step = (i64::from(or(divider, DIVIDER)?) + 2) * 40;
    Some(Nanos(step * i64::from(or(time, STEPS)?)))
}

/// Kinds of FMMUs of outputs, and of inputs.
const KINDS: [u8; 2] = [Fmmu::WRITE, Fmmu::READ];
/// 0x0400 and 0x0420 after power-on: 1 000 steps of 100 us.
const DIVIDER: u16 = 2498;
const STEPS: u16 = 1_000;
