//! Checks before a state is entered: SyncManagers, mapping, DC, watchdog.
//!
//! The order of the checks is that of the Slave Stack Code, so that a configuration with several
//! faults gives the usual status code. Stricter checks follow those that they refine.

use core::ops::Range;

use isocat_esc::{Pdi, PdiExt};
use isocat_sync::object::{
    INPUT_ASSIGNMENT, INPUT_PARAMETER, OUTPUT_ASSIGNMENT, OUTPUT_PARAMETER, sub,
};
use isocat_sync::{Chain, SupportedTypes, SyncMode, SyncType};
use isocat_wire::sii::MailboxArea;
use isocat_wire::sync_manager::SyncManager;
use isocat_wire::{AlStatusCode, Nanos, register};

use crate::assignment;
use crate::description::{Description, Mailbox, ProcessDataArea};
use crate::dictionary::Values;
use crate::misbehaviour::Misbehaviour;
use crate::process_data::{Buffer, Buffers, MAX_AREAS, MAX_PROCESS_DATA};
use crate::sync_engine::{Chosen, Setup};

/// The results of the checks of PREOP to SAFEOP.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) struct SafeOp {
    /// Buffers of the outputs, usually SM2.
    pub outputs: Buffers,
    /// Buffers of the inputs, usually SM3.
    pub inputs: Buffers,
    /// Whether a SyncManager of outputs restarts the process data watchdog.
    pub watchdog: bool,
    /// How the device will be synchronized.
    pub sync: Setup,
}

/// Bytes by area, in the order of the description.
type Lengths = [u32; MAX_AREAS];

/// Checks INIT to PREOP: the mailbox SyncManagers must have the device's settings.
pub(crate) fn mailbox(pdi: &mut impl Pdi, mailbox: Option<&Mailbox>) -> Result<(), AlStatusCode> {
    let Some(mailbox) = mailbox else { return Ok(()) };
    let right = is_mailbox(pdi, 0, mailbox.receive, SyncManager::CONTROL_ECAT_WRITES)
        && is_mailbox(pdi, 1, mailbox.send, 0);
    if right { Ok(()) } else { Err(AlStatusCode::INVALID_MAILBOX) }
}

/// Checks PREOP to SAFEOP.
pub(crate) fn safe_op(
    pdi: &mut impl Pdi,
    dictionary: &Values<'_>,
    chosen: Chosen,
) -> Result<SafeOp, AlStatusCode> {
    let description = dictionary.description();
    let (output_lengths, input_lengths) = mapped_lengths(pdi, dictionary)?;
    let (outputs, inputs) = process_data(pdi, description, &output_lengths, &input_lengths)?;
    let sync = sync(pdi, dictionary, chosen, outputs.is_used(), inputs.is_used())?;
    let areas = || description.output_areas().chain(description.input_areas());
    if sync.chain.mode == SyncMode::FreeRun
        && areas().any(|area| {
            let sm = process_data_manager(pdi, area);
            effective_length(&sm) > 0 && sm.is_mailbox()
        })
    {
        return Err(AlStatusCode::FREE_RUN_NEEDS_3_BUFFERS);
    }
    let watchdog = description.output_areas().any(|area| {
        let sm = process_data_manager(pdi, area);
        effective_length(&sm) > 0 && sm.control & SyncManager::CONTROL_WATCHDOG != 0
    });
    let watchdog_time = pdi.load(register::WATCHDOG_TIME_PROCESS_DATA);
    let must_agree = description.behaviour.watchdog_must_agree && outputs.is_used();
    if must_agree && watchdog != (watchdog_time != 0) {
        return Err(AlStatusCode::INVALID_WATCHDOG_CONFIGURATION);
    }
    Ok(SafeOp { outputs, inputs, watchdog, sync })
}

/// The buffers of the process data, if their SyncManagers have these lengths. Called at PREOP to
/// SAFEOP, and again whenever a SyncManager is switched in SAFEOP or OP.
pub(crate) fn process_data(
    pdi: &mut impl Pdi,
    description: &Description,
    output_lengths: &Lengths,
    input_lengths: &Lengths,
) -> Result<(Buffers, Buffers), AlStatusCode> {
    let ram_end = u32::from(register::PROCESS_RAM) + 1024 * u32::from(pdi.load(register::RAM_SIZE));
    let direction = SyncManager::CONTROL_ECAT_WRITES;
    let areas = description.output_areas();
    let outputs = buffers(pdi, areas, output_lengths, direction, ram_end)
        .ok_or(AlStatusCode::INVALID_OUTPUT_CONFIGURATION)?;
    let inputs = buffers(pdi, description.input_areas(), input_lengths, 0, ram_end)
        .ok_or(AlStatusCode::INVALID_INPUT_CONFIGURATION)?;
    // Without outputs the read of the inputs is the event of the cycle. With several SyncManagers
    // it is that of the first one.
    let silent = |sm: SyncManager| sm.control & SyncManager::CONTROL_AL_EVENT == 0;
    let (first_outputs, first_inputs) = (description.outputs, description.inputs);
    if outputs.is_used() && silent(process_data_manager(pdi, first_outputs)) {
        return Err(AlStatusCode::INVALID_OUTPUT_CONFIGURATION);
    }
    let lives_by_inputs = !outputs.is_used() && inputs.is_used();
    if lives_by_inputs && silent(process_data_manager(pdi, first_inputs)) {
        return Err(AlStatusCode::INVALID_INPUT_CONFIGURATION);
    }
    no_overlap(pdi, description)?;
    Ok((outputs, inputs))
}

/// Checks that the areas of the process data overlap neither a mailbox nor each other.
fn no_overlap(pdi: &mut impl Pdi, description: &Description) -> Result<(), AlStatusCode> {
    let mut taken: [Range<u32>; 2 + 2 * MAX_AREAS] = core::array::from_fn(|_| 0..0);
    let mailboxes = description.mailbox.iter().flat_map(|mailbox| [mailbox.receive, mailbox.send]);
    for (place, mailbox) in taken.iter_mut().zip(mailboxes) {
        let start = u32::from(mailbox.start);
        *place = start..start + u32::from(mailbox.length);
    }
    let (input, output) =
        (AlStatusCode::INVALID_INPUT_CONFIGURATION, AlStatusCode::INVALID_OUTPUT_CONFIGURATION);
    let inputs = description.input_areas().map(|area| (area, input));
    let outputs = description.output_areas().map(|area| (area, output));
    for (number, (area, code)) in inputs.chain(outputs).enumerate() {
        let memory = memory(&process_data_manager(pdi, area));
        if taken.iter().any(|other| overlap(other, &memory)) {
            return Err(code);
        }
        if let Some(place) = taken.get_mut(2 + number) {
            *place = memory;
        }
    }
    Ok(())
}

/// The memory of a SyncManager, with all of its buffers. A single byte has one buffer.
fn memory(sm: &SyncManager) -> Range<u32> {
    let length = effective_length(sm);
    let buffers = if sm.is_mailbox() || length == 1 { 1 } else { 3 };
    let start = u32::from(sm.start);
    start..start + buffers * length
}

/// Bytes of outputs and inputs by the PDO assignment of each SyncManager. A device without
/// assignment objects takes the length of the SyncManager. Without a mailbox no assignment can be
/// written, so it has only one length.
fn mapped_lengths(
    pdi: &mut impl Pdi,
    dictionary: &Values<'_>,
) -> Result<(Lengths, Lengths), AlStatusCode> {
    let fixed = dictionary.description().mailbox.is_none();
    let mut length = |index, area: ProcessDataArea, code| {
        let most = usize::from(area.max_length).min(MAX_PROCESS_DATA) as u32;
        match assignment::length(dictionary, index) {
            Ok(Some(bytes)) if bytes <= most => Ok(bytes),
            Ok(None) if fixed => Ok(most),
            Ok(None) => Ok(effective_length(&process_data_manager(pdi, area))),
            _ => Err(code),
        }
    };
    let description = dictionary.description();
    let (mut outputs, mut inputs) = ([0; MAX_AREAS], [0; MAX_AREAS]);
    let code = AlStatusCode::INVALID_INPUT_MAPPING;
    for (at, area) in description.input_areas().take(MAX_AREAS).enumerate() {
        let index = if at == 0 { INPUT_ASSIGNMENT } else { assignment::of_sync_manager(area) };
        inputs[at] = length(index, area, code)?;
    }
    let code = AlStatusCode::INVALID_OUTPUT_MAPPING;
    for (at, area) in description.output_areas().take(MAX_AREAS).enumerate() {
        let index = if at == 0 { OUTPUT_ASSIGNMENT } else { assignment::of_sync_manager(area) };
        outputs[at] = length(index, area, code)?;
    }
    Ok((outputs, inputs))
}

/// The SyncManager of an area.
fn process_data_manager(pdi: &mut impl Pdi, area: ProcessDataArea) -> SyncManager {
    pdi.load(register::sync_manager(usize::from(area.sync_manager)))
}

/// The buffers of one direction, if all of its SyncManagers have the settings that the device
/// needs.
fn buffers(
    pdi: &mut impl Pdi,
    areas: impl Iterator<Item = ProcessDataArea>,
    lengths: &Lengths,
    direction: u8,
    ram_end: u32,
) -> Option<Buffers> {
    // Each buffer has a separate limit, and the image has one for all.
    if lengths.iter().sum::<u32>() > MAX_PROCESS_DATA as u32 {
        return None;
    }
    let mut found = Buffers::NONE;
    for (number, (area, length)) in areas.zip(lengths).enumerate() {
        let sm = process_data_manager(pdi, area);
        found.set(number, buffer(&sm, area, *length, direction, ram_end)?);
    }
    Some(found)
}

/// The buffer of a process data SyncManager, if it has the settings that the device needs.
fn buffer(
    sm: &SyncManager,
    area: ProcessDataArea,
    length: u32,
    direction: u8,
    ram_end: u32,
) -> Option<Buffer> {
    if effective_length(sm) != length {
        return None;
    }
    if length == 0 {
        return Some(Buffer::default());
    }
    let fits = usize::from(sm.length) <= usize::from(area.max_length).min(MAX_PROCESS_DATA)
        && memory(sm).end <= ram_end;
    let mode = sm.is_mailbox() || sm.control & 0x03 == 0;
    let right = sm.start == area.start && mode && sm.control & 0x0C == direction;
    (fits && right).then_some(Buffer { start: sm.start, length: sm.length })
}

/// Bytes that a SyncManager guards; zero while it is off.
fn effective_length(sm: &SyncManager) -> u32 {
    if sm.is_enabled() { u32::from(sm.length) } else { 0 }
}

fn overlap(a: &Range<u32>, b: &Range<u32>) -> bool {
    a.start < b.end && b.start < a.end && !a.is_empty() && !b.is_empty()
}

fn is_mailbox(pdi: &mut impl Pdi, number: usize, area: MailboxArea, direction: u8) -> bool {
    let sm: SyncManager = pdi.load(register::sync_manager(number));
    sm.is_enabled()
        && sm.is_mailbox()
        && sm.control & 0x0C == direction
        && sm.control & SyncManager::CONTROL_AL_EVENT != 0
        && (sm.start, sm.length) == (area.start, area.length)
}

/// Determines the synchronization from the SYNC unit, the MainDevice's choice, and the device's
/// capabilities.
pub(crate) fn sync(
    pdi: &mut impl Pdi,
    dictionary: &Values<'_>,
    chosen: Chosen,
    has_outputs: bool,
    has_inputs: bool,
) -> Result<Setup, AlStatusCode> {
    let description = dictionary.description();
    let activation = pdi.load(register::SYNC_ACTIVATION);
    let sync0_cycle = Nanos::from_u32(pdi.load(register::SYNC0_CYCLE));
    let sync1_cycle = Nanos::from_u32(pdi.load(register::SYNC1_CYCLE));
    let supported = supported_types(dictionary, has_outputs, has_inputs);
    let minimum = minimum_cycle_time(dictionary);
    let maximum = description.behaviour.maximum_cycle_time;
    let granularity = description.behaviour.cycle_granularity;

    // A device that cannot announce its types is not refused for it: the pulses of a simple device
    // have no effect.
    let listens = description.mailbox.is_some() || supported.dc_sync0();
    let unit_on = listens
        && (activation.active() || activation.0 & isocat_wire::dc::SyncActivation::AUTO != 0);
    let (sync0, sync1) = (unit_on && activation.sync0(), unit_on && activation.sync1());
    let stamps_only = description.behaviour.unit_without_pulses && !sync0 && !sync1;
    let sync1 = sync1 && (supported.dc_sync1() || !description.behaviour.ignores_sync1);
    let subordinated = sync1 && sync1_cycle > Nanos::ZERO && sync1_cycle >= sync0_cycle;
    if unit_on && !stamps_only {
        if !sync0 {
            // No pulse is enabled, or SYNC1 without the SYNC0 that it follows.
            return Err(AlStatusCode::INVALID_DC_SYNC_CONFIGURATION);
        }
        // Announced SYNC1 includes the SYNC0 that it follows: terminals announce only bit 3 and use
        // both.
        let by_sync1 = sync1 && supported.dc_sync1();
        if sync1 != by_sync1 || !supported.dc_sync0() && !by_sync1 {
            return Err(AlStatusCode::INVALID_DC_SYNC_CONFIGURATION);
        }
        let too_long = |cycle: Nanos| maximum > Nanos::ZERO && cycle > maximum;
        if sync0_cycle > Nanos::ZERO && (sync0_cycle < minimum || too_long(sync0_cycle)) {
            return Err(AlStatusCode::DC_SYNC0_CYCLE);
        }
        if granularity > Nanos::ZERO && sync0_cycle.0 % granularity.0 != 0 {
            return Err(AlStatusCode::DC_INVALID_SYNC_CYCLE);
        }
        if sync1 && too_long(sync1_cycle) {
            return Err(AlStatusCode::DC_SYNC1_CYCLE);
        }
        if subordinated && !supported.dc_subordinated() {
            return Err(AlStatusCode::INVALID_DC_SYNC_CONFIGURATION);
        }
    }

    let (output_type, input_type) = if chosen.nothing() {
        let ignores = description.behaviour.faults().contains(&Misbehaviour::IgnoresSyncUnit);
        let mode = match (sync0 && !ignores, sync1, subordinated) {
            (true, true, true) => SyncMode::DcSubordinated,
            (true, true, false) if !supported.dc_sync0() => SyncMode::DcSync1,
            (true, true, false) => SyncMode::DcShiftSync1,
            (true, false, _) => SyncMode::DcSync0,
            _ if supported.sm_synchronous() => SyncMode::SmSynchronous,
            _ => SyncMode::FreeRun,
        };
        (mode.output_type(), mode.input_type(has_outputs))
    } else {
        chosen_types(dictionary, chosen, has_outputs, subordinated)
    };
    let types = [has_outputs.then_some(output_type), has_inputs.then_some(input_type)];
    let any = |wanted: &[SyncType]| types.iter().flatten().any(|t| wanted.contains(t));
    if any(&[SyncType::DC_SYNC0]) && !sync0 || any(&[SyncType::DC_SYNC1]) && !sync1 {
        return Err(AlStatusCode::INVALID_DC_SYNC_CONFIGURATION);
    }
    if any(&[SyncType::FREE_RUN]) && !supported.free_run() {
        return Err(AlStatusCode::FREE_RUN_NOT_SUPPORTED);
    }
    if any(&[SyncType::SM, SyncType::INPUTS_ON_SM2]) && !supported.sm_synchronous() {
        return Err(AlStatusCode::SYNCHRONIZATION_NOT_SUPPORTED);
    }
    let mode = SyncMode::from_types(output_type, input_type, has_outputs, has_inputs, subordinated)
        .ok_or(AlStatusCode::INCONSISTENT_SETTINGS)?;

    let cycle = if mode.uses_dc() {
        if sync0_cycle == Nanos::ZERO {
            // A single pulse starts no cycle.
            return Err(AlStatusCode::DC_SYNC0_CYCLE);
        }
        let fixed = description.behaviour.subordinated_sync0_cycle;
        let needs_it = mode == SyncMode::DcSubordinated && fixed > Nanos::ZERO;
        if needs_it && sync0_cycle != fixed {
            return Err(AlStatusCode::DC_SYNC0_CYCLE);
        }
        sync0_cycle
    } else {
        let stated = |index| dictionary.value(index, sub::CYCLE_TIME).filter(|_| chosen.cycle);
        let cycle = stated(OUTPUT_PARAMETER).max(stated(INPUT_PARAMETER)).unwrap_or(0);
        let cycle = Nanos::from_u32(cycle);
        if cycle > Nanos::ZERO && cycle < minimum {
            return Err(AlStatusCode::CYCLE_TIME_TOO_SMALL);
        }
        cycle
    };
    let acknowledge_sync = mode.uses_dc() && pdi.load(register::SYNC_PULSE_LENGTH) == 0;
    let behaviour = &description.behaviour;
    let chain = Chain {
        mode,
        has_outputs,
        polls_outputs: behaviour.polls_outputs,
        outputs_on_sync1: behaviour.outputs_on_sync1,
        application_on_sync1: behaviour.application_on_sync1,
    };
    let sync1 = if mode.uses_sync1() { sync1_cycle } else { Nanos::ZERO };
    Ok(Setup { chain, cycle, sync1, has_inputs, acknowledge_sync })
}

/// The types of both objects if the MainDevice wrote at least one of them; the other one follows
/// it.
fn chosen_types(
    dictionary: &Values<'_>,
    chosen: Chosen,
    has_outputs: bool,
    subordinated: bool,
) -> (SyncType, SyncType) {
    let stored =
        |index| SyncType(dictionary.value(index, sub::SYNC_TYPE).unwrap_or_default() as u16);
    let (output, input) = (stored(OUTPUT_PARAMETER), stored(INPUT_PARAMETER));
    let mode = |found: SyncType| match found {
        SyncType::FREE_RUN => Some(SyncMode::FreeRun),
        SyncType::SM | SyncType::INPUTS_ON_SM2 => Some(SyncMode::SmSynchronous),
        SyncType::DC_SYNC0 => Some(SyncMode::DcSync0),
        SyncType::DC_SYNC1 if subordinated => Some(SyncMode::DcSubordinated),
        // If only the inputs are set to SYNC1, outputs act at SYNC0.
        SyncType::DC_SYNC1 if chosen.output_type => Some(SyncMode::DcSync1),
        SyncType::DC_SYNC1 => Some(SyncMode::DcShiftSync1),
        _ => None,
    };
    if !chosen.input_type {
        (output, mode(output).map_or(output, |mode| mode.input_type(has_outputs)))
    } else if !chosen.output_type {
        (mode(input).map_or(input, SyncMode::output_type), input)
    } else {
        (output, input)
    }
}

/// The types that both transmitted directions support. For a direction without a statement the
/// description decides, and by default supports all types. A device that announces 0 makes no
/// statement either: taken literally it could never leave PREOP.
pub(crate) fn supported_types(
    dictionary: &Values<'_>,
    has_outputs: bool,
    has_inputs: bool,
) -> SupportedTypes {
    let undeclared = dictionary.description().behaviour.undeclared_types.0;
    let stated = |index, used: bool| match dictionary.value(index, sub::SUPPORTED_TYPES) {
        _ if !used => u16::MAX,
        Some(value) if value != 0 => value as u16,
        _ => undeclared,
    };
    SupportedTypes(stated(OUTPUT_PARAMETER, has_outputs) & stated(INPUT_PARAMETER, has_inputs))
}

/// The shortest cycle that the device states; zero if it states none.
pub(crate) fn minimum_cycle_time(dictionary: &Values<'_>) -> Nanos {
    let stated = |index| dictionary.value(index, sub::MINIMUM_CYCLE_TIME).unwrap_or_default();
    Nanos::from_u32(stated(OUTPUT_PARAMETER).max(stated(INPUT_PARAMETER)))
}
