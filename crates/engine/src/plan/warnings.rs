//! Warnings: settings that are allowed, and that fail on a real wire.

use isocat_maindevice::segment::{SyncObject, Timing};
use isocat_maindevice::{DeviceConfig, SubDevice};
use isocat_segment::Scenario;
use isocat_sync::object::{INPUT_PARAMETER, OUTPUT_PARAMETER, SupportedTypes, SyncType, sub};
use isocat_sync::{SyncMode, budget};
use isocat_wire::coe::info::Access;
use isocat_wire::dc::AssignActivate;
use isocat_wire::time::Nanos;
use isocat_wire::{ObjectAddress, datagram, frame};

use super::Plan;
use super::report::Note;
use crate::report::NoteKind;

/// All warnings of a plan, by position.
pub(super) fn all(plan: &Plan, scenario: &Scenario) -> Vec<Note> {
    let timing = plan.timing();
    let mut notes = Vec::new();
    for (position, (planned, _)) in timing.devices.iter().enumerate() {
        let found = &plan.segment.devices[position];
        let name = &scenario.devices[position].name;
        let mut note = |kind, what: Option<String>| {
            let device = Some(name.clone());
            notes.extend(what.map(|what| Note { position: Some(position), device, kind, what }));
        };
        note(NoteKind::Sync0InFrame, sync0_in_frame(&timing.cycle, timing.sync0, planned));
        note(NoteKind::FreeRunBySm, free_run_by_sm(found));
        note(NoteKind::CopyLongerThanCycle, copy_longer_than_cycle(found, planned));
        let wished = plan.config.devices.get(position);
        note(NoteKind::ShiftUnused, wished.and_then(|wish| shift_unused(planned, wish)));
        note(NoteKind::MailboxNoRoom, mailbox_no_room(found, timing));
        note(NoteKind::TwoPhases, two_phases(found, planned));
        note(NoteKind::TypeReadOnly, read_only_types(found));
        for (object, _) in types(found) {
            note(NoteKind::TypeNotAnnounced, type_against_announcement(found, object));
        }
        note(NoteKind::TypesDisagree, types_disagree(found));
        note(NoteKind::OpmodeSyncOff, opmode_leaves_sync_off(found));
        note(NoteKind::FirstOpmodeDcOff, first_opmode_is_off(found));
    }
    notes
}

/// Warns if a SYNC0 comes while the frame passes: devices at the end of the line use old outputs,
/// those at the front new ones.
fn sync0_in_frame(
    cycle: &budget::Cycle,
    shift: Option<Nanos>,
    device: &budget::Device,
) -> Option<String> {
    let by_sm2 = [SyncMode::DcSync0, SyncMode::DcShiftSync1, SyncMode::DcSync1];
    let shift = shift.filter(|_| by_sm2.contains(&device.mode))?;
    let begin = device.inputs_fetched.or(Some(device.delay))?;
    let end = device.outputs_arrival.or(device.inputs_read)?;
    let sync0 = device.sync0_phase(shift);
    let (from, to) = (cycle.send + begin, cycle.send + end + cycle.jitter);
    let inside = |phase: Nanos| from <= phase && phase <= to;
    (inside(sync0) || inside(sync0 + device.exchange(cycle))).then(|| {
        format!(
            "SYNC0 at {sync0} of the cycle lies inside the frame, which may pass from {from} to {to}"
        )
    })
}

/// Warns if copying the outputs alone takes longer than the minimum cycle: one of the two figures
/// is wrong.
fn copy_longer_than_cycle(found: &SubDevice, planned: &budget::Device) -> Option<String> {
    let of = |object: &Option<SyncObject>| object.as_ref().map(|object| object.values);
    let copy = of(&found.output_sync)?.calc_and_copy_time?;
    let inputs = of(&found.input_sync).and_then(|values| values.minimum_cycle_time);
    let cycle = of(&found.output_sync)?.minimum_cycle_time.max(inputs)?;
    let used = planned.minimum_cycle;
    let stated = cycle > Nanos::ZERO && planned.mode != SyncMode::FreeRun;
    (stated && copy > cycle).then(|| {
        format!(
            "0x1C32:06 = {copy}, but 0x1C32:05 = {cycle}: outputs take longer than the minimum cycle; the plan takes {used} \
             for the cycle, which the parts of it make"
        )
    })
}

/// Warns of a shift by local timer that the mode does not use: its outputs or inputs are shifted by
/// SYNC1, or not at all.
fn shift_unused(planned: &budget::Device, wish: &DeviceConfig) -> Option<String> {
    let asked = |shift: Option<Nanos>| shift.filter(|shift| *shift > Nanos::ZERO);
    let outputs = asked(wish.shift_outputs)
        .filter(|_| planned.outputs_arrival.is_some() && planned.timed_output_shift().is_none());
    let inputs = asked(wish.shift_inputs)
        .filter(|_| planned.inputs_fetched.is_some() && !planned.shifts_inputs());
    let words = |shift: Nanos, object, what| format!("{object} = {shift} does not shift {what}");
    let outputs = outputs.map(|shift| words(shift, "0x1C32:03", "outputs"));
    let inputs = inputs.map(|shift| words(shift, "0x1C33:03", "inputs"));
    let all: Vec<String> = outputs.into_iter().chain(inputs).collect();
    (!all.is_empty()).then(|| format!("{} in mode {}", all.join(", "), planned.mode))
}

/// Warns of a mailbox whose frame is longer than the free time of a cycle.
fn mailbox_no_room(found: &SubDevice, timing: &Timing) -> Option<String> {
    let needed = mailbox_frame(found)?;
    let spare = timing.cycle.cycle - timing.frames_on_wire() - timing.cycle.jitter;
    (needed > spare).then(|| {
        format!(
            "a frame for its mailbox takes {needed}, and a cycle has {spare} to spare: SDO transfers while the cycle runs \
             make the next cycle late"
        )
    })
}

/// Time on the wire of the frame with the longest mailbox message.
pub(super) fn mailbox_frame(found: &SubDevice) -> Option<Nanos> {
    let header = &found.sii.header;
    let length = usize::from(header.receive.length.max(header.send.length));
    let bytes = frame::ETHERNET_HEADER_LEN + frame::ETHERCAT_HEADER_LEN + DATAGRAM + length;
    let on_wire = bytes.max(frame::MIN_LEN) + frame::WIRE_OVERHEAD;
    found.has_mailbox().then_some(Nanos(on_wire as i64 * frame::BYTE_TIME_NS as i64))
}

/// Bytes of header and working counter.
const DATAGRAM: usize = datagram::HEADER_LEN + datagram::WKC_LEN;

/// Warns if a device cannot be set to Free Run, and would choose SM by itself.
fn free_run_by_sm(found: &SubDevice) -> Option<String> {
    isocat_maindevice::takes_sm_mode(found).then(|| {
        "wanted in Free Run, but 0x1C32:01 can't be written and 0x1C32:04 announces SM: it will work by the SM event,          with its minimum cycle"
            .to_owned()
    })
}

/// Warns if a base cycle of several SYNC0 pulses may begin at any of them.
fn two_phases(found: &SubDevice, planned: &budget::Device) -> Option<String> {
    let stated = found.output_sync.as_ref()?.values.sync0_cycle_time?;
    let sync0 = planned.pulses.sync0_cycle;
    let alone = planned.mode.uses_dc() && !planned.mode.uses_sync1();
    let count = stated.0.checked_div(sync0.0).filter(|_| stated.0 % sync0.0.max(1) == 0)?;
    (alone && count > 1).then(|| {
        format!(
            "its base cycle (0x1C32:0A) is {stated}, SYNC0 comes every {sync0}: it may begin at any of {count} \
             pulses, so {count} phases are possible, and each start may take another"
        )
    })
}

/// The objects of the directions in use, with the type that the mode gives them.
fn types(found: &SubDevice) -> Vec<(u16, SyncType)> {
    let has_outputs = found.outputs.length > 0;
    let outputs = has_outputs.then(|| (OUTPUT_PARAMETER, found.mode.output_type()));
    let inputs =
        (found.inputs.length > 0).then(|| (INPUT_PARAMETER, found.mode.input_type(has_outputs)));
    outputs.into_iter().chain(inputs).collect()
}

fn sync_object(found: &SubDevice, index: u16) -> Option<&isocat_maindevice::segment::SyncObject> {
    match index {
        OUTPUT_PARAMETER => found.output_sync.as_ref(),
        _ => found.input_sync.as_ref(),
    }
}

/// Warns of types that cannot be written: they are fixed from PREOP to SAFEOP, by the state of the
/// SYNC unit at that time.
fn read_only_types(found: &SubDevice) -> Option<String> {
    let fixed = |(index, wanted): (u16, SyncType)| {
        let entry = sync_object(found, index)?.entry(sub::SYNC_TYPE)?;
        let (description, _) = entry.description.as_ref()?;
        let shown = entry.number()?;
        let fixed = !description.access.has(Access::WRITE_PREOP) && shown != u32::from(wanted.0);
        let object = ObjectAddress::new(index, sub::SYNC_TYPE);
        fixed.then(|| format!("{object} ({} instead of {wanted})", SyncType(shown as u16)))
    };
    let all: Vec<_> = types(found).into_iter().filter_map(fixed).collect();
    (!all.is_empty() && found.mode != SyncMode::FreeRun).then(|| {
        format!(
            "read-only in PREOP, and different there: {}. The types follow from the SYNC unit on the way to SAFEOP, \
             so its registers must be final before SAFEOP is asked for",
            all.join(", ")
        )
    })
}

/// Warns if sub-index 01 shows a type that sub-index 04 does not announce.
fn type_against_announcement(found: &SubDevice, index: u16) -> Option<String> {
    let values = &sync_object(found, index)?.values;
    let (shown, announced) = (values.sync_type?, values.supported?);
    let supported = match shown {
        SyncType::FREE_RUN => return None,
        SyncType::SM | SyncType::INPUTS_ON_SM2 => announced.sm_synchronous(),
        SyncType::DC_SYNC0 => announced.dc_sync0(),
        SyncType::DC_SYNC1 => announced.dc_sync1(),
        _ => false,
    };
    let types = ObjectAddress::new(index, sub::SUPPORTED_TYPES);
    let object = ObjectAddress::new(index, sub::SYNC_TYPE);
    (!supported).then(|| {
        format!("{object} shows {shown}, which {types} = {announced} does not announce; {types} is believed")
    })
}

/// Warns if the two objects announce different modes.
fn types_disagree(found: &SubDevice) -> Option<String> {
    let types = |index| sync_object(found, index)?.values.supported;
    let (outputs, inputs) = (types(OUTPUT_PARAMETER)?, types(INPUT_PARAMETER)?);
    // Shift and measurement may differ by direction; the types may not.
    let modes = |types: SupportedTypes| types.0 & 0x001F;
    let both = found.outputs.length > 0 && found.inputs.length > 0;
    (both && modes(outputs) != modes(inputs)).then(|| {
        format!("0x1C32:04 = {outputs}, but 0x1C33:04 = {inputs}; only what both announce is used")
    })
}

/// Warns if all OpModes of the device leave SYNC off, and it is to run by SYNC.
fn opmode_leaves_sync_off(found: &SubDevice) -> Option<String> {
    let modes = &found.sii.operation_modes;
    let dc = found.mode.uses_dc();
    if !dc || modes.is_empty() || modes.iter().any(|mode| makes_pulses(mode.assign_activate)) {
        return None;
    }
    let word = modes[0].assign_activate;
    Some(format!(
        "mode {} needs SYNC, but each OpMode of the device leaves it off (AssignActivate 0x{word:04X}); a \
         MainDevice that follows its ESI never starts SYNC",
        found.mode
    ))
}

/// Warns if the first OpMode, which many MainDevices use, switches DC off.
fn first_opmode_is_off(found: &SubDevice) -> Option<String> {
    let modes = &found.sii.operation_modes;
    let first = modes.first()?.assign_activate;
    let other = modes.iter().position(|mode| makes_pulses(mode.assign_activate))?;
    let pulse =
        if AssignActivate(modes[other].assign_activate).makes_sync0() { "SYNC0" } else { "SYNC1" };
    (found.mode.uses_dc() && !makes_pulses(first)).then(|| {
        format!(
            "its first OpMode switches DC off (AssignActivate 0x{first:04X}); a MainDevice that takes the first \
             one leaves it without SYNC. OpMode {other}, counted from 0, is the one with {pulse}"
        )
    })
}

/// Whether SYNC0 or SYNC1 runs with this AssignActivate.
const fn makes_pulses(word: u16) -> bool {
    let word = AssignActivate(word);
    word.makes_sync0() || word.makes_sync1()
}
