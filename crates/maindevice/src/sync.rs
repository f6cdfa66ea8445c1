//! Synchronization at the devices: writes and verifies sync types, programs and verifies SYNC0.

use alloc::vec::Vec;

use isocat_sync::SyncMode;
use isocat_sync::object::{INPUT_PARAMETER, OUTPUT_PARAMETER, ShiftBy, sub};
use isocat_sync::start::Grid;
use isocat_wire::coe::info::Access;
use isocat_wire::dc::{ActivationStatus, AssignActivate, SyncActivation};
use isocat_wire::register::{self, Value, features};
use isocat_wire::time::{Dc, Nanos, Time};
use isocat_wire::{ObjectAddress, StationAddress};

use crate::coe;
use crate::config::{Config, DeviceConfig};
use crate::error::{AccessError, Cause, SdoError};
use crate::link::Link;
use crate::mailbox::Mailbox;
use crate::objects::{number, sdo};
use crate::segment::{DcCapability, Segment, SubDevice, SyncObject, SyncSetting};
use crate::service::Service;

/// Writes the type of synchronization (01), the cycle time (02) and the shift time (03) of both
/// sync objects, in PREOP, if the device allows it. A refused type is no error yet: many stacks
/// take it from the SYNC unit on the way to SAFEOP, where [`verify_types`] checks it.
pub(crate) async fn write_types(
    mailbox: &mut Mailbox,
    device: &mut SubDevice,
    config: &Config,
    wish: Option<&DeviceConfig>,
) -> Result<(), Cause> {
    for TypeWrite { object, data, checked } in type_writes(device, config, wish) {
        if !checked {
            refusable(mailbox, device, object, &data).await?;
            continue;
        }
        let written = coe::download(mailbox, object, &data, false).await;
        written.map_err(|error| sdo(device, object, error))?;
        let value = data.iter().rev().fold(0, |value, byte| value << 8 | u32::from(*byte));
        expect_value(mailbox, device, object, value).await?;
    }
    Ok(())
}

/// One write to a sync object.
pub(crate) struct TypeWrite {
    /// The entry.
    pub object: ObjectAddress,
    /// Its value, little-endian.
    pub data: Vec<u8>,
    /// Whether the value must be accepted unchanged and is read back; otherwise it may be refused.
    pub checked: bool,
}

/// The writes to the sync objects, in order.
pub(crate) fn type_writes(
    device: &SubDevice,
    config: &Config,
    wish: Option<&DeviceConfig>,
) -> Vec<TypeWrite> {
    let mut writes = Vec::new();
    for direction in directions(device, wish) {
        let Some(object) = direction.object else { continue };
        let at = |sub| ObjectAddress::new(direction.index, sub);
        let mut write = |sub, data: &[u8], checked| {
            writes.push(TypeWrite { object: at(sub), data: data.to_vec(), checked });
        };
        // It is written even if the device already shows this value: a stack may show the type of
        // its last operation but choose another one if it gets no write.
        if writable(object, sub::SYNC_TYPE) {
            write(sub::SYNC_TYPE, &direction.kind.to_le_bytes(), false);
        }
        let own = match device.mode.uses_dc() {
            true => device.pulses.sync0_cycle,
            false => Nanos(config.cycle.0 * i64::from(device.every)),
        };
        let cycle = own.to_u32().unwrap_or(u32::MAX);
        if device.mode != SyncMode::FreeRun && writable(object, sub::CYCLE_TIME) {
            write(sub::CYCLE_TIME, &cycle.to_le_bytes(), false);
        }
        let local = object.values.supported.is_some_and(|t| t.shift() == ShiftBy::LocalTimer);
        if let Some(shift) = direction.shift.filter(|_| local) {
            write(sub::SHIFT_TIME, &shift.to_u32().unwrap_or(u32::MAX).to_le_bytes(), true);
        }
    }
    writes
}

/// Reads the type of synchronization back in SAFEOP, where it must be that of the mode, and takes
/// over the other values that the device now shows.
pub(crate) async fn verify_types(
    mailbox: &mut Mailbox,
    device: &mut SubDevice,
    wish: Option<&DeviceConfig>,
) -> Result<(), Cause> {
    let expected: Vec<(u16, u16)> = directions(device, wish)
        .iter()
        .filter(|direction| direction.object.is_some_and(|o| o.entry(sub::SYNC_TYPE).is_some()))
        .map(|direction| (direction.index, direction.kind))
        .collect();
    for (index, kind) in expected {
        for sub in [sub::SYNC_TYPE, sub::CYCLE_TIME, sub::SHIFT_TIME, sub::SYNC0_CYCLE_TIME] {
            let found = match number(mailbox, device, index, sub).await {
                Ok(found) => found,
                Err(cause) => {
                    device.do_without(Service::TypeReadBack, cause)?;
                    break;
                }
            };
            if let Some(found) = found {
                let object = if index == OUTPUT_PARAMETER {
                    &mut device.output_sync
                } else {
                    &mut device.input_sync
                };
                if let Some(object) = object {
                    object.values.set(sub, found);
                }
            }
            // A device in Free Run may show any type: it is not synchronized.
            let wrong = found.filter(|found| *found != u32::from(kind));
            if let (sub::SYNC_TYPE, Some(found), true) =
                (sub, wrong, device.mode != SyncMode::FreeRun)
            {
                let object = ObjectAddress::new(index, sub);
                let written = kind.into();
                return Err(Cause::ReadBack { place: device.place(), object, written, found });
            }
        }
    }
    Ok(())
}

/// One direction's sync object and the configured values.
struct Direction<'a> {
    index: u16,
    object: Option<&'a SyncObject>,
    kind: u16,
    shift: Option<Nanos>,
}

/// The directions with process data.
fn directions<'a>(device: &'a SubDevice, wish: Option<&DeviceConfig>) -> Vec<Direction<'a>> {
    let has_outputs = device.outputs.length > 0;
    let outputs = Direction {
        index: OUTPUT_PARAMETER,
        object: device.output_sync.as_ref(),
        kind: device.mode.output_type().0,
        shift: wish.and_then(|wish| wish.shift_outputs),
    };
    let inputs = Direction {
        index: INPUT_PARAMETER,
        object: device.input_sync.as_ref(),
        kind: device.mode.input_type(has_outputs).0,
        shift: wish.and_then(|wish| wish.shift_inputs),
    };
    let mut all = Vec::new();
    if has_outputs {
        all.push(outputs);
    }
    if device.inputs.length > 0 {
        all.push(inputs);
    }
    all
}

/// Whether an entry may be written in PREOP, by its description; without a description it is tried.
pub(crate) fn writable(object: &SyncObject, sub: u8) -> bool {
    object.entry(sub).is_some_and(|entry| {
        entry
            .description
            .as_ref()
            .is_none_or(|(description, _)| description.access.has(Access::WRITE_PREOP))
    })
}

/// Writes a value that the device may refuse.
async fn refusable(
    mailbox: &mut Mailbox,
    device: &mut SubDevice,
    object: ObjectAddress,
    value: &[u8],
) -> Result<(), Cause> {
    match coe::download(mailbox, object, value, false).await {
        Ok(()) | Err(SdoError::Abort(_)) => Ok(()),
        Err(error) => device.do_without(Service::TypeWrite, sdo(device, object, error)),
    }
}

async fn expect_value(
    mailbox: &mut Mailbox,
    device: &SubDevice,
    object: ObjectAddress,
    written: u32,
) -> Result<(), Cause> {
    match number(mailbox, device, object.index, object.sub).await? {
        Some(found) if found != written => {
            Err(Cause::ReadBack { place: device.place(), object, written, found })
        }
        _ => Ok(()),
    }
}

/// The common grid of all SYNC units. Its period holds whole cycles of the bus and of each
/// SubDevice's pulses, so that pulses of equal cycle coincide even if they do not coincide with
/// each bus cycle. `None` if the cycles do not meet within the range of a 32-bit clock.
pub(crate) fn grid(segment: &Segment, cycle: Nanos) -> Option<Grid> {
    let synced = segment.devices.iter().filter(|device| device.mode.uses_dc());
    let periods = synced.map(|device| device.pulses.sync1_cycle());
    Grid::of(periods.chain([cycle])).ok()
}

/// The grid of one SubDevice. Its points are those of all SubDevices of the same cycle, and its
/// pulses come in the bus cycles with its process data.
pub(crate) fn own_grid(device: &SubDevice, cycle: Nanos) -> Grid {
    let bus = || Grid::of([cycle]).expect("the cycle was checked: above 0, below 2^31 ns");
    Grid::of([device.pulses.sync1_cycle(), cycle]).unwrap_or_else(|_| bus())
}

/// Reads the system time of the reference clock, in 64 bits; the upper half of a 32-bit clock is 0
/// here.
pub(crate) async fn system_time(
    link: &Link,
    station: StationAddress,
) -> Result<Time<Dc>, AccessError> {
    Ok(Time::new(link.read(station, register::SYSTEM_TIME).await?))
}

/// Reads the system time of a reference clock that the cycle also reads, in 64 bits. The time of a
/// 32-bit clock is extended as in the cycle.
pub(crate) async fn reference_now(
    link: &Link,
    reference: &SubDevice,
) -> Result<Time<Dc>, AccessError> {
    let now = system_time(link, reference.station).await?;
    let (_, near) = link.board(|board| board.reference_time);
    Ok(match reference.dc {
        DcCapability::Clock64 => now,
        _ => near.nearest(now.count() as u32),
    })
}

/// A lead of the start time that suffices for programming all SYNC units, unless the host stalls.
pub(crate) fn short_lead(segment: &Segment) -> Nanos {
    let synced = segment.devices.iter().filter(|device| device.mode.uses_dc()).count();
    SHORT_LEAD + Nanos(LEAD_PER_DEVICE.0.saturating_mul(synced as i64))
}

/// Programs the SYNC unit: off, owner, cycles, start time, on. The cycles are one write of eight
/// bytes, and each step takes effect before the next. `acting`: a point of the acting pulses' grid.
pub(crate) async fn program(
    link: &Link,
    device: &mut SubDevice,
    acting: Time<Dc>,
) -> Result<(), Cause> {
    let pulses = device.pulses;
    // SYNC0 comes first, but never earlier than the common lead time of all devices.
    let ahead = (pulses.lead.0 + pulses.sync1_cycle().0 - 1) / pulses.sync1_cycle().0.max(1);
    let start = acting + Nanos(ahead * pulses.sync1_cycle().0 - pulses.lead.0);
    let station = device.station;
    link.write(station, register::SYNC_ACTIVATION, SyncActivation(0)).await?;
    // It is only written if it must change: some devices react badly to the mere write.
    let owner = link.read(station, register::CYCLIC_UNIT_CONTROL).await?;
    if owner & SYNC_OWNED_BY_PDI != 0 {
        let control = owner & !SYNC_OWNED_BY_PDI;
        link.write(station, register::CYCLIC_UNIT_CONTROL, control).await?;
    }
    link.fpwr(station, register::SYNC0_CYCLE.address, &cycles(device)).expect(1).await?;
    link.write(station, register::SYNC_START_TIME, start.count()).await?;
    let (register, data) = activation(device);
    link.fpwr(station, register, &data).expect(1).await?;
    device.sync = Some(SyncSetting {
        start,
        sync0_cycle: pulses.sync0_cycle,
        sync1_cycle: pulses.sync1,
        activation: data.last().copied().unwrap_or_default(),
        next: start,
        next_sync1: None,
    });
    Ok(())
}

/// Writes owners and SYNC unit of a SubDevice whose mode needs no pulses, if it is configured: an
/// active unit without pulses lets the latch units stamp edges.
pub(crate) async fn program_unit(link: &Link, device: &SubDevice) -> Result<(), Cause> {
    if let Some((register, data)) = unit_without_pulses(device) {
        link.fpwr(device.station, register, &data).expect(1).await?;
    }
    Ok(())
}

/// The write of [`program_unit`]: the register's address and the bytes.
pub(crate) fn unit_without_pulses(device: &SubDevice) -> Option<(u16, Vec<u8>)> {
    let word = device.unit.filter(|word| *word != AssignActivate::OFF && !device.mode.uses_dc())?;
    device.dc.has_clock().then(|| (register::CYCLIC_UNIT_CONTROL.address, word.to_bytes().to_vec()))
}

/// The content of registers 0x09A0 and 0x09A4.
pub(crate) fn cycles(device: &SubDevice) -> [u8; 8] {
    let pulses = &device.pulses;
    let mut cycles = [0; 8];
    cycles[..4].copy_from_slice(&pulses.sync0_cycle.to_u32().unwrap_or(0).to_le_bytes());
    cycles[4..].copy_from_slice(&pulses.sync1.to_u32().unwrap_or(0).to_le_bytes());
    cycles
}

/// The write that activates the pulses: the register's address and the bytes. It includes the
/// owners in 0x0980 if they are configured.
pub(crate) fn activation(device: &SubDevice) -> (u16, Vec<u8>) {
    match device.unit {
        Some(word) => (register::CYCLIC_UNIT_CONTROL.address, word.to_bytes().to_vec()),
        None => (register::SYNC_ACTIVATION.address, alloc::vec![pulses(device.mode)]),
    }
}

/// The configured word, adapted to a mode as [`DeviceConfig::unit`] describes.
pub(crate) fn unit(mode: SyncMode, word: AssignActivate) -> AssignActivate {
    let [mut control, mut activation] = word.0.to_le_bytes();
    if mode.uses_dc() {
        control &= !SYNC_OWNED_BY_PDI;
        activation |= pulses(mode);
    } else {
        activation &= !(SyncActivation::SYNC0 | SyncActivation::SYNC1);
    }
    AssignActivate(u16::from_le_bytes([control, activation]))
}

/// Register 0x0981 for a mode with DC.
fn pulses(mode: SyncMode) -> u8 {
    let sync1 = if mode.uses_sync1() { SyncActivation::SYNC1 } else { 0 };
    SyncActivation::ACTIVE | SyncActivation::SYNC0 | sync1
}

/// Verifies that SYNC0 runs, and SYNC1 if it is used: no first pulse is pending (0x0984, if it
/// exists), and the next pulse (0x0990, 0x0998) is within one cycle from now (0x0910) and on the
/// grid.
pub(crate) async fn verify(link: &Link, device: &mut SubDevice) -> Result<(), Cause> {
    let Some(mut setting) = device.sync else { return Ok(()) };
    let station = device.station;
    let cycle = setting.sync0_cycle;
    let mut tries = VERIFY_TRIES;
    loop {
        tries -= 1;
        // They are queued together, so they usually share a frame. If a pulse falls in between,
        // another attempt is made.
        let now = link.fprd(station, register::SYSTEM_TIME.address, 8);
        let next = link.fprd(station, register::SYNC_START_TIME.address, 16);
        let activation = link.fprd(station, register::SYNC_ACTIVATION.address, 1);
        let now = time(&now.expect(1).await?.data);
        let pulses = next.expect(1).await?.data;
        let next = time(&pulses);
        let next_sync1 = time(pulses.get(8..).unwrap_or_default());
        let activation = activation.expect(1).await?.data[0];
        let status = if device.esc.has(features::ENHANCED_SYNC_ACTIVATION) {
            link.try_read(station, register::ACTIVATION_STATUS).await?
        } else {
            None
        };
        let wide = |time: Time<Dc>| match device.dc {
            DcCapability::Clock64 => time,
            _ => setting.start.nearest(time.count() as u32),
        };
        let (now, next, next_sync1) = (wide(now), wide(next), wide(next_sync1));
        // ECAT reads the time less the delay (0x0928), but pulses are made by the time without it.
        let now = now + device.delay.unwrap_or(Nanos::ZERO);
        setting.next = next;
        setting.next_sync1 = device.mode.uses_sync1().then_some(next_sync1);
        let sync1_cycle = device.pulses.sync1_cycle();
        if runs(&setting, activation, status, now, next)
            && sync1_runs(&setting, sync1_cycle, activation, status, now)
        {
            device.sync = Some(setting);
            return Ok(());
        }
        if tries == 0 {
            return Err(Cause::SyncNotStarted {
                place: device.place(),
                activation,
                status,
                next,
                now,
                cycle,
            });
        }
        link.sleep(Nanos(VERIFY_PAUSE.0 * i64::from(tries))).await;
    }
}

/// Whether these registers are those of a running SYNC0.
fn runs(
    setting: &SyncSetting,
    activation: u8,
    status: Option<ActivationStatus>,
    now: Time<Dc>,
    next: Time<Dc>,
) -> bool {
    let cycle = setting.sync0_cycle;
    let ahead = next - now;
    let on_grid = (next - setting.start).0.rem_euclid(cycle.0) == 0;
    let pending = status.is_some_and(|status| status.sync0_pending());
    let on = SyncActivation::ACTIVE | SyncActivation::SYNC0;
    activation & on == on && !pending && on_grid && ahead.0 > 0 && ahead <= cycle
}

/// The same for SYNC1, if it is used.
fn sync1_runs(
    setting: &SyncSetting,
    cycle: Nanos,
    activation: u8,
    status: Option<ActivationStatus>,
    now: Time<Dc>,
) -> bool {
    let Some(next) = setting.next_sync1 else { return true };
    let ahead = next - now;
    let on_grid = (next - (setting.start + setting.sync1_cycle)).0.rem_euclid(cycle.0) == 0;
    let pending = status.is_some_and(|status| status.sync1_pending());
    activation & SyncActivation::SYNC1 != 0 && !pending && on_grid && ahead.0 > 0 && ahead <= cycle
}

fn time(bytes: &[u8]) -> Time<Dc> {
    Time::new(bytes.first_chunk().map_or(0, |bytes| u64::from_bytes(*bytes)))
}

/// The part of a short lead that does not depend on the number of SubDevices: six ways there and
/// back, each in a cycle of 1 ms if the host is slow.
const SHORT_LEAD: Nanos = Nanos::millis(10);
/// The part for each SubDevice: five accesses of some 2 us on the wire, all SubDevices beside each
/// other, with a reserve for a small part of the cycle.
const LEAD_PER_DEVICE: Nanos = Nanos::micros(50);

/// Register 0x0980 bit 0.
const SYNC_OWNED_BY_PDI: u8 = 1;
/// Number of attempts: a pulse may fall between the two readings once, not three times.
const VERIFY_TRIES: u8 = 3;
/// Pause, multiplied by the attempts left, so that it does not beat with the cycle.
const VERIFY_PAUSE: Nanos = Nanos(130_000);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_grid_holds_the_cycles_of_all_devices() {
        let bus = Nanos(1_000_000);
        let device = |position, mode, sync0, sync1| {
            let mut device = SubDevice::new(position, StationAddress(0x1001));
            device.mode = mode;
            device.pulses = isocat_sync::Pulses {
                sync0_cycle: Nanos(sync0),
                sync1: Nanos(sync1),
                lead: Nanos::ZERO,
            };
            device
        };
        let mut segment = Segment::default();
        assert_eq!(grid(&segment, bus).unwrap().period(), bus);
        segment.devices.push(device(0, SyncMode::DcSubordinated, 250_000, 750_000));
        assert_eq!(grid(&segment, bus).unwrap().period(), bus);
        // SYNC1 has periods of 2 ms and 3 ms.
        segment.devices.push(device(1, SyncMode::DcSync1, 1_000_000, 1_500_000));
        assert_eq!(grid(&segment, bus).unwrap().period(), Nanos(2_000_000));
        segment.devices.push(device(2, SyncMode::DcSync1, 1_000_000, 2_500_000));
        assert_eq!(grid(&segment, bus).unwrap().period(), Nanos(6_000_000));
        segment.devices.push(device(3, SyncMode::FreeRun, 7_000_000, 0));
        assert_eq!(grid(&segment, bus).unwrap().period(), Nanos(6_000_000));
        segment.devices.push(device(4, SyncMode::DcSync0, 999_999_937, 0));
        assert_eq!(grid(&segment, bus), None);
        let own = |at: usize| own_grid(&segment.devices[at], bus).period();
        assert_eq!([0, 1, 4].map(own), [bus, Nanos(2_000_000), bus]);
    }

    #[test]
    fn pulses_that_run_and_pulses_that_do_not() {
        let setting = SyncSetting {
            start: Time::new(5_000_000),
            sync0_cycle: Nanos(1_000_000),
            sync1_cycle: Nanos::ZERO,
            activation: 3,
            next: Time::ZERO,
            next_sync1: None,
        };
        let check = |activation, status, now, next| {
            runs(&setting, activation, status, Time::new(now), Time::new(next))
        };
        assert!(check(3, None, 6_000_000, 7_000_000));
        assert!(check(3, Some(ActivationStatus(0)), 6_999_999, 7_000_000));
        assert!(!check(3, None, 7_000_000, 7_000_000), "the pulse is over");
        assert!(!check(3, None, 5_999_999, 7_000_000), "more than a cycle ahead");
        assert!(!check(3, None, 6_000_000, 6_999_999), "off the grid");
        assert!(!check(2, None, 6_000_000, 7_000_000), "unit off");
        assert!(!check(3, Some(ActivationStatus(1)), 6_000_000, 7_000_000), "pending");
        // The start was in the past: the next pulse comes when the counter wraps.
        assert!(!check(3, None, 6_000_000, 5_000_000));
    }
}
