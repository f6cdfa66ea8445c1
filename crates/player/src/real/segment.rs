//! What is known of the SubDevices on the wire, for the judges: the list, readings, and the times
//! of the plan.

use isocat_descriptions::start_up::{CyclicFrame, DeviceStartUp, StartUp};
use isocat_engine::plan::Plan;
use isocat_maindevice::SdoError;
use isocat_maindevice::segment::{
    DcCapability, ProcessData, Segment, SubDevice, SyncEntry, SyncObject, Timing,
};
use isocat_sync::object::{INPUT_PARAMETER, OUTPUT_PARAMETER, sub};
use isocat_sync::{SyncMode, budget};
use isocat_wire::al::{AlStatus, AlStatusCode};
use isocat_wire::datagram::{HEADER_LEN, WKC_LEN};
use isocat_wire::frame;
use isocat_wire::register::{self, Value, features};
use isocat_wire::time::Nanos;
use isocat_wire::{ObjectAddress, StationAddress};

use crate::clock;
use crate::failure::Kind;
use crate::mailbox;
use crate::play::Player;
use crate::virtual_segment::{SYNC0, SYNC1, assign_activate};

/// The segment by the list. `assumed`: whether the plan's times of a device are only assumed, by
/// position. `jitter`: lateness of frames that the plan allows for.
pub(super) fn of_list(
    list: &StartUp,
    plan: Option<&Plan>,
    assumed: &[bool],
    jitter: Nanos,
) -> Segment {
    let device = |(position, listed): (usize, &DeviceStartUp)| {
        let mut device = SubDevice::new(position, StationAddress(listed.station));
        device.name.clone_from(&listed.name);
        device.mode = mode(listed, plan.map(|plan| plan.segment.devices[position].mode));
        let data = |bits: Option<isocat_descriptions::start_up::ImageBits>| ProcessData {
            length: bits.map_or(0, |bits| bits.length.div_ceil(8) as u16),
            ..ProcessData::default()
        };
        (device.outputs, device.inputs) = (data(listed.outputs), data(listed.inputs));
        device
    };
    let devices: Vec<SubDevice> = list.devices.iter().enumerate().map(device).collect();
    let reference = clock::reference(list);
    let timing = plan.map(|plan| timing(list, plan, &devices, assumed, jitter));
    Segment { devices, reference, timing, ..Segment::default() }
}

/// The mode of a device by the list. If several modes without SYNC, or several with SYNC, are
/// possible, it is the plan's.
fn mode(device: &DeviceStartUp, planned: Option<SyncMode>) -> SyncMode {
    let bits = assign_activate(device).to_bytes()[1];
    let starts = bits & SYNC0 != 0;
    match planned {
        Some(mode) if mode.uses_dc() == starts => mode,
        _ if starts && bits & SYNC1 != 0 => SyncMode::DcShiftSync1,
        _ if starts => SyncMode::DcSync0,
        _ => SyncMode::FreeRun,
    }
}

/// The plan's budget with frames at phase 0, where the player sends them, and with the list's
/// phases of SYNC0. If the list's frames take longer than the plan's, all times are later by the
/// difference.
fn timing(
    list: &StartUp,
    plan: &Plan,
    devices: &[SubDevice],
    assumed: &[bool],
    jitter: Nanos,
) -> Timing {
    let planned = plan.timing();
    let later = (on_wire(&list.frames) - planned.frames_on_wire()).max(Nanos::ZERO);
    let cycle = budget::Cycle { send: Nanos::ZERO, jitter, ..planned.cycle };
    let acts = |position: usize| {
        let shift = list.devices[position].dc.filter(|dc| dc.sync0_ns > 0)?.shift_ns;
        Some(Nanos(shift.into()) + planned.devices[position].0.pulses.lead)
    };
    let uses = |position: &usize| devices[*position].mode.uses_dc();
    let common = (0..devices.len()).filter(uses).find_map(acts);
    let of_device = |position: usize| {
        let mut device = planned.devices[position].0;
        for at in [&mut device.outputs_arrival, &mut device.inputs_read].into_iter().flatten() {
            *at += later;
        }
        let is_known = !assumed.get(position).copied().unwrap_or(true)
            && device.mode == devices[position].mode;
        let acting = acts(position).or(common).unwrap_or(Nanos::ZERO);
        let budget = match is_known {
            true => budget::budget(&cycle, acting, &device),
            false => budget::Budget::default(),
        };
        // Arrival times are judged by the common phase, which does not apply to a device with
        // another phase.
        if !is_known || Some(acting) != common {
            device.outputs_arrival = None;
        }
        (device, budget)
    };
    Timing {
        cycle,
        sync0: common,
        frames: planned.frames.clone(),
        devices: (0..devices.len()).map(of_device).collect(),
    }
}

/// The time on the wire of all frames of the fullest cycle, with the gap after each.
fn on_wire(frames: &[CyclicFrame]) -> Nanos {
    let length = |frame: &CyclicFrame| {
        let datagrams =
            frame.datagrams.iter().map(|one| HEADER_LEN + usize::from(one.length) + WKC_LEN);
        let bytes =
            frame::ETHERNET_HEADER_LEN + frame::ETHERCAT_HEADER_LEN + datagrams.sum::<usize>();
        bytes.max(frame::MIN_LEN) + frame::WIRE_OVERHEAD
    };
    let bytes: usize = frames.iter().map(length).sum();
    Nanos((bytes as u64 * frame::BYTE_TIME_NS) as i64)
}

/// Adds what can only be read in OP: features, delays, and the devices' synchronization objects.
pub(super) fn complete(player: &mut Player<'_>, segment: &mut Segment) -> Result<(), Kind> {
    let units = player.clocks.as_ref().map(|clocks| clocks.units.clone()).unwrap_or_default();
    for position in 0..segment.devices.len() {
        let station = player.list.devices[position].station;
        let device = &mut segment.devices[position];
        if let Some(head) = player.line.read(station, register::TYPE.address, 10)? {
            device.esc.kind = head[0];
            device.esc.features = register::FEATURES.load(&head);
        }
        if let Some(Some(unit)) = units.get(position) {
            let has_width = device.esc.has(features::DC_64_BIT);
            device.dc = if has_width { DcCapability::Clock64 } else { DcCapability::Clock32 };
            device.delay = Some(unit.delay);
            device.measured_delay = Some(unit.measured);
            device.offset = unit.offset;
        }
        let Some(mailbox) = player.list.devices[position].mailbox.filter(|mailbox| mailbox.coe)
        else {
            continue;
        };
        let counter = &mut player.mailbox_counters[position];
        for index in [OUTPUT_PARAMETER, INPUT_PARAMETER] {
            let mut object = SyncObject::default();
            for sub in SUBS {
                let address = ObjectAddress::new(index, sub);
                let read = mailbox::upload(&mut player.line, station, mailbox, counter, address)?;
                match read {
                    Ok(value) => {
                        let entry = SyncEntry { sub, description: None, value: Ok(value) };
                        if let Some(number) = entry.number() {
                            object.values.set(sub, number);
                        }
                        object.entries.push(entry);
                    }
                    Err(SdoError::Abort(_)) if sub != sub::SYNC_TYPE => {}
                    // The SubDevice does not have the object, or does not answer.
                    Err(_) => break,
                }
            }
            let found = (!object.entries.is_empty()).then_some(object);
            match index {
                OUTPUT_PARAMETER => segment.devices[position].output_sync = found,
                _ => segment.devices[position].input_sync = found,
            }
        }
    }
    Ok(())
}

/// Reads AL status and its code of each SubDevice after a way up that failed.
pub(super) fn read_states(player: &mut Player<'_>, segment: &mut Segment) -> Result<(), Kind> {
    for device in &mut segment.devices {
        let bytes = player.line.read(device.station.0, register::AL_STATUS.address, 6)?;
        let Some(bytes) = bytes else { continue };
        device.al_status = AlStatus(u16::from_le_bytes([bytes[0], bytes[1]]));
        device.al_code = AlStatusCode(u16::from_le_bytes([bytes[4], bytes[5]]));
    }
    Ok(())
}

/// The synchronization type and the counters.
const SUBS: [u8; 5] = [
    sub::SYNC_TYPE,
    sub::SM_EVENT_MISSED,
    sub::CYCLE_TIME_TOO_SMALL,
    sub::SHIFT_TIME_TOO_SHORT,
    sub::SYNC_ERROR,
];
