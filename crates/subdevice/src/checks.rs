//! What must be right before a state is entered: SyncManagers, mapping, DC, watchdog.
//!
//! The order of the checks is that of the Slave Stack Code, so that a configuration with several
//! faults gives the status code that the field knows; stricter checks stand behind those they refine.

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
use crate::dictionary::Dictionary;
use crate::misbehaviour::Misbehaviour;
use crate::process_data::{Buffer, MAX_PROCESS_DATA};
use crate::sync_engine::{Chosen, Setup};

/// What PREOP to SAFEOP found out.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) struct SafeOp {
    /// Buffer of SM2.
    pub outputs: Buffer,
    /// Buffer of SM3.
    pub inputs: Buffer,
    /// SM2 restarts the process data watchdog.
    pub watchdog: bool,
    /// How the device will be synchronized.
    pub sync: Setup,
}

/// INIT to PREOP: the mailbox SyncManagers must be set as the device has its mailbox.
pub(crate) fn mailbox(pdi: &mut impl Pdi, mailbox: Option<&Mailbox>) -> Result<(), AlStatusCode> {
    let Some(mailbox) = mailbox else { return Ok(()) };
    let right = is_mailbox(pdi, 0, mailbox.receive, SyncManager::CONTROL_ECAT_WRITES)
        && is_mailbox(pdi, 1, mailbox.send, 0);
    if right { Ok(()) } else { Err(AlStatusCode::INVALID_MAILBOX) }
}

/// PREOP to SAFEOP.
pub(crate) fn safe_op<S: AsRef<[u8]> + AsMut<[u8]>>(
    pdi: &mut impl Pdi,
    dictionary: &Dictionary<S>,
    chosen: Chosen,
) -> Result<SafeOp, AlStatusCode> {
    let description = dictionary.description();
    let sm2 = process_data_manager(pdi, description.outputs);
    let sm3 = process_data_manager(pdi, description.inputs);
    let (output_length, input_length) = mapped_lengths(dictionary, &sm2, &sm3)?;
    let (outputs, inputs) = process_data(pdi, description, output_length, input_length)?;
    let sync = sync(pdi, dictionary, chosen, outputs.is_used(), inputs.is_used())?;
    let one_buffer = |sm: &SyncManager, buffer: Buffer| buffer.is_used() && sm.is_mailbox();
    if sync.chain.mode == SyncMode::FreeRun
        && (one_buffer(&sm2, outputs) || one_buffer(&sm3, inputs))
    {
        return Err(AlStatusCode::FREE_RUN_NEEDS_3_BUFFERS);
    }
    let watchdog = outputs.is_used() && sm2.control & SyncManager::CONTROL_WATCHDOG != 0;
    let watchdog_time = pdi.load(register::WATCHDOG_TIME_PROCESS_DATA);
    let must_agree = description.behaviour.watchdog_must_agree && outputs.is_used();
    if must_agree && watchdog != (watchdog_time != 0) {
        return Err(AlStatusCode::INVALID_WATCHDOG_CONFIGURATION);
    }
    Ok(SafeOp { outputs, inputs, watchdog, sync })
}

/// The buffers of SM2 and SM3, if they are set for so many bytes. Asked for at PREOP to SAFEOP, and again
/// whenever a SyncManager is switched in SAFEOP or OP.
pub(crate) fn process_data(
    pdi: &mut impl Pdi,
    description: &Description,
    output_length: u32,
    input_length: u32,
) -> Result<(Buffer, Buffer), AlStatusCode> {
    let sm2 = process_data_manager(pdi, description.outputs);
    let sm3 = process_data_manager(pdi, description.inputs);
    let ram_end = u32::from(register::PROCESS_RAM) + 1024 * u32::from(pdi.load(register::RAM_SIZE));
    let outputs =
        buffer(&sm2, description.outputs, output_length, SyncManager::CONTROL_ECAT_WRITES, ram_end)
            .ok_or(AlStatusCode::INVALID_OUTPUT_CONFIGURATION)?;
    let inputs = buffer(&sm3, description.inputs, input_length, 0, ram_end)
        .ok_or(AlStatusCode::INVALID_INPUT_CONFIGURATION)?;
    // Without outputs the read of the inputs is the event that the device lives by.
    if outputs.is_used() && sm2.control & SyncManager::CONTROL_AL_EVENT == 0 {
        return Err(AlStatusCode::INVALID_OUTPUT_CONFIGURATION);
    }
    if !outputs.is_used() && inputs.is_used() && sm3.control & SyncManager::CONTROL_AL_EVENT == 0 {
        return Err(AlStatusCode::INVALID_INPUT_CONFIGURATION);
    }

    let area = |sm: &SyncManager, used: bool| {
        let buffers = if sm.is_mailbox() { 1 } else { 3 };
        let start = u32::from(sm.start);
        start..start + if used { buffers * u32::from(sm.length) } else { 0 }
    };
    let (output_area, input_area) = (area(&sm2, outputs.is_used()), area(&sm3, inputs.is_used()));
    for mailbox in description.mailbox.iter().flat_map(|m| [m.receive, m.send]) {
        let start = u32::from(mailbox.start);
        let mailbox_area = start..start + u32::from(mailbox.length);
        if overlap(&input_area, &mailbox_area) {
            return Err(AlStatusCode::INVALID_INPUT_CONFIGURATION);
        }
        if overlap(&output_area, &mailbox_area) {
            return Err(AlStatusCode::INVALID_OUTPUT_CONFIGURATION);
        }
    }
    if overlap(&output_area, &input_area) {
        return Err(AlStatusCode::INVALID_OUTPUT_CONFIGURATION);
    }
    Ok((outputs, inputs))
}

/// Bytes of outputs and inputs by the PDO assignment. A device without assignment objects takes what
/// the SyncManager is set to; without a mailbox nobody could have chosen it, and it has one length only.
fn mapped_lengths<S: AsRef<[u8]> + AsMut<[u8]>>(
    dictionary: &Dictionary<S>,
    sm2: &SyncManager,
    sm3: &SyncManager,
) -> Result<(u32, u32), AlStatusCode> {
    let fixed = dictionary.description().mailbox.is_none();
    let length = |index, sm: &SyncManager, area: ProcessDataArea, code| {
        let most = usize::from(area.max_length).min(MAX_PROCESS_DATA) as u32;
        match assignment::length(dictionary, index) {
            Ok(Some(bytes)) if bytes <= most => Ok(bytes),
            Ok(None) if fixed => Ok(most),
            Ok(None) => Ok(effective_length(sm)),
            _ => Err(code),
        }
    };
    let description = dictionary.description();
    let code = AlStatusCode::INVALID_INPUT_MAPPING;
    let inputs = length(INPUT_ASSIGNMENT, sm3, description.inputs, code)?;
    let code = AlStatusCode::INVALID_OUTPUT_MAPPING;
    let outputs = length(OUTPUT_ASSIGNMENT, sm2, description.outputs, code)?;
    Ok((outputs, inputs))
}

/// The SyncManager of a direction.
fn process_data_manager(pdi: &mut impl Pdi, area: ProcessDataArea) -> SyncManager {
    pdi.load(register::sync_manager(usize::from(area.sync_manager)))
}

/// The buffer of a process data SyncManager if it is set as the device needs it.
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
    let buffers = if sm.is_mailbox() { 1 } else { 3 };
    let fits = usize::from(sm.length) <= usize::from(area.max_length).min(MAX_PROCESS_DATA)
        && u32::from(sm.start) + buffers * length <= ram_end;
    let mode = sm.is_mailbox() || sm.control & 0x03 == 0;
    let right = sm.start == area.start && mode && sm.control & 0x0C == direction;
    (fits && right).then_some(Buffer { start: sm.start, length: sm.length })
}

/// Bytes that a SyncManager guards; none while it is off.
fn effective_length(sm: &SyncManager) -> u32 {
    if sm.is_enabled() { u32::from(sm.length) } else { 0 }
}

fn overlap(a: &core::ops::Range<u32>, b: &core::ops::Range<u32>) -> bool {
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

/// The synchronization: what the SYNC unit is set to, what the MainDevice chose, what the device can.
fn sync<S: AsRef<[u8]> + AsMut<[u8]>>(
    pdi: &mut impl Pdi,
    dictionary: &Dictionary<S>,
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

    // Who can't say what it supports is not refused for it: the pulses of a simple device go nowhere.
    let listens = description.mailbox.is_some() || supported.dc_sync0();
    let unit_on = listens
        && (activation.active() || activation.0 & isocat_wire::dc::SyncActivation::AUTO != 0);
    let (sync0, sync1) = (unit_on && activation.sync0(), unit_on && activation.sync1());
    let subordinated = sync1 && sync1_cycle > Nanos::ZERO && sync1_cycle >= sync0_cycle;
    if unit_on {
        if !sync0 {
            // Nothing enabled, or SYNC1 without the SYNC0 that it follows.
            return Err(AlStatusCode::INVALID_DC_SYNC_CONFIGURATION);
        }
        // SYNC1 takes the SYNC0 that it follows with it: terminals announce bit 3 alone and run by both.
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
            // A single shot starts no cycle.
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

/// The types of both objects if the MainDevice wrote at least one; the other follows it.
fn chosen_types<S: AsRef<[u8]> + AsMut<[u8]>>(
    dictionary: &Dictionary<S>,
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
        // Inputs alone at SYNC1 leave the outputs to SYNC0.
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

/// What both directions that are transmitted can do. Of a direction that states nothing the description
/// tells, which by default refuses nothing. A device that announces 0 states nothing either: taken at its
/// word it could never leave PREOP.
pub(crate) fn supported_types<S: AsRef<[u8]> + AsMut<[u8]>>(
    dictionary: &Dictionary<S>,
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
pub(crate) fn minimum_cycle_time<S: AsRef<[u8]> + AsMut<[u8]>>(
    dictionary: &Dictionary<S>,
) -> Nanos {
    let stated = |index| dictionary.value(index, sub::MINIMUM_CYCLE_TIME).unwrap_or_default();
    Nanos::from_u32(stated(OUTPUT_PARAMETER).max(stated(INPUT_PARAMETER)))
}
