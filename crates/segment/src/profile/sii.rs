//! The EEPROM image of a profile.

use std::ops::Range;

use isocat_descriptions::document::FileError;
use isocat_descriptions::sii::{General, Names, Sii, SiiEntry, SiiOpMode, SiiPdo};
use isocat_wire::sii::{Header, MailboxArea, SmRecord, checksum, sm_type};
use isocat_wire::sync_manager::SyncManager;
use isocat_wire::time::Nanos;

use super::draft::{Area, Draft, Pdo, PdoEntry, Window};
use super::ports;

/// The image, in the smallest usual EEPROM size.
pub(super) fn image(draft: &Draft<'_>) -> Result<Vec<u8>, FileError> {
    let sii = Sii {
        header: header(draft),
        general: Some(general(draft)),
        fmmus: fmmus(draft),
        sync_managers: sync_managers(draft),
        inputs: [pdos(draft.inputs.as_ref()), windows(draft)].concat(),
        outputs: pdos(draft.outputs.as_ref()),
        op_modes: op_modes(draft),
        others: Vec::new(),
    };
    let least = draft.eeprom.as_ref().map_or(0, |eeprom| eeprom.size);
    // For an imported device the SII is not the only source of its names.
    let names = if draft.eeprom.is_some() { Names::Fitting } else { Names::All };
    sii.image(least, names).map_err(|problem| draft.source.error(0, problem.to_string()))
}

/// Length of SYNC pulses, word 2 of an image; zero is acknowledge mode.
pub(super) fn pulse(image: &[u8]) -> Nanos {
    let ticks = image.get(PULSE).map_or([0; 2], |word| [word[0], word[1]]);
    Nanos(i64::from(u16::from_le_bytes(ticks)) * TICK)
}

/// Whether an image switches the SYNC unit on: the high byte of word 0, which is loaded to register
/// 0x0141.
pub(super) fn has_sync_unit(image: &[u8]) -> bool {
    image.get(1).is_some_and(|byte| byte & SYNC_UNIT != 0)
}

/// The image with another length of SYNC pulses, in whole ticks, and with the new checksum.
pub(super) fn with_pulse(image: &[u8], pulse: Nanos) -> Vec<u8> {
    let mut image = image.to_vec();
    image[PULSE].copy_from_slice(&((pulse.0 / TICK) as u16).to_le_bytes());
    let mut configuration = [0; 14];
    configuration.copy_from_slice(&image[..14]);
    image[14] = checksum(&configuration);
    image
}

fn header(draft: &Draft<'_>) -> Header {
    let mut configuration = [0; 14];
    configuration[0] = PDI_SPI;
    configuration[1] = if draft.esc.sync_unit { ESC_SYNC_AND_LATCH } else { 0 };
    configuration[3] = SYNC_OUTPUTS_MAPPED;
    if draft.behaviour.value.device_emulation {
        configuration[0] = PDI_DIGITAL_IO;
        configuration[1] |= DEVICE_EMULATION;
    }
    configuration[PULSE].copy_from_slice(&((draft.esc.pulse.0 / TICK) as u16).to_le_bytes());
    configuration[8..10].copy_from_slice(&draft.esc.alias.to_le_bytes());
    let mailbox = draft.mailbox.map(|mailbox| mailbox.value);
    let nowhere = MailboxArea::default();
    let eeprom = draft.eeprom.as_ref();
    let (boot_receive, boot_send) = eeprom.map_or((nowhere, nowhere), |eeprom| eeprom.boot);
    Header {
        configuration: eeprom.map_or(configuration, |eeprom| eeprom.configuration),
        boot_receive,
        boot_send,
        vendor_id: draft.identity.vendor_id,
        product_code: draft.identity.product_code,
        revision: draft.identity.revision,
        serial: draft.identity.serial,
        receive: mailbox.map_or(nowhere, |mailbox| mailbox.receive),
        send: mailbox.map_or(nowhere, |mailbox| mailbox.send),
        protocols: if mailbox.is_some() { draft.protocols } else { 0 },
        size: 0,
    }
}

fn general(draft: &Draft<'_>) -> General {
    let writable = [&draft.outputs, &draft.inputs]
        .into_iter()
        .flatten()
        .any(|area| area.access.has_any(isocat_wire::coe::info::Access::WRITE));
    let mut coe_details = 0;
    if draft.speaks_coe() {
        coe_details = COE_SDO | COE_INFORMATION | COE_COMPLETE_ACCESS;
    }
    if writable && draft.speaks_coe() {
        coe_details |= COE_ASSIGNMENT;
    }
    let general = General {
        group: draft.vendor.clone(),
        order: draft.name.clone(),
        name: draft.name.clone(),
        coe_details,
        foe: u8::from(draft.protocols & FOE != 0),
        eoe: u8::from(draft.protocols & EOE != 0),
        ports: ports::in_sii(&draft.esc.chip.1),
        ..General::default()
    };
    match &draft.eeprom {
        None => general,
        Some(eeprom) => General {
            order: eeprom.order.clone(),
            coe_details: eeprom.coe_details,
            soe_channels: draft.mailbox.map_or(0, |mailbox| mailbox.value.speaks.drives),
            ports: eeprom.ports,
            ..general
        },
    }
}

/// Uses of the FMMUs; the third maps the state of the send mailbox.
fn fmmus(draft: &Draft<'_>) -> Vec<u8> {
    if let Some(eeprom) = &draft.eeprom {
        return eeprom.fmmus.clone();
    }
    let mut uses = vec![FMMU_OUTPUTS, FMMU_INPUTS];
    uses.extend(draft.mailbox.map(|_| FMMU_MAILBOX_STATUS));
    uses
}

/// SM0 and SM1 are the mailbox, SM2 the outputs, SM3 the inputs, unless the profile numbers them
/// otherwise. Without a mailbox SM0 and SM1 are unused, but keep the control byte of a mailbox:
/// some MainDevices (ethercrab) guess the use of an unused one from it, and would read control 0 as
/// inputs.
fn sync_managers(draft: &Draft<'_>) -> Vec<SmRecord> {
    if let Some(eeprom) = &draft.eeprom {
        return eeprom.sync_managers.clone();
    }
    let mailbox = |area: Option<MailboxArea>, control, kind| {
        let MailboxArea { start, length } = area.unwrap_or_default();
        SmRecord {
            start,
            length,
            control,
            status: 0,
            enable: u8::from(area.is_some()),
            kind: if area.is_some() { kind } else { sm_type::UNUSED },
        }
    };
    let process_data = |area: Option<&Area>, control, kind| {
        let length = area.map_or(0, default_length);
        SmRecord {
            start: area.map_or(0, |area| area.start),
            length,
            control,
            status: 0,
            enable: u8::from(length > 0),
            kind: if area.is_some() { kind } else { sm_type::UNUSED },
        }
    };
    let (receive, send) = (
        draft.mailbox.map(|mailbox| mailbox.value.receive),
        draft.mailbox.map(|mailbox| mailbox.value.send),
    );
    let mut all = vec![
        mailbox(receive, SyncManager::MAILBOX_OUT, sm_type::MAILBOX_OUT),
        mailbox(send, SyncManager::MAILBOX_IN, sm_type::MAILBOX_IN),
        process_data(None, SyncManager::OUTPUTS, sm_type::OUTPUTS),
        process_data(None, SyncManager::INPUTS, sm_type::INPUTS),
    ];
    for (area, control, kind) in [
        (&draft.outputs, SyncManager::OUTPUTS, sm_type::OUTPUTS),
        (&draft.inputs, SyncManager::INPUTS, sm_type::INPUTS),
    ] {
        let Some(area) = area else { continue };
        let number = usize::from(area.sync_manager);
        // A device without a program handles no events.
        let silent = draft.behaviour.value.device_emulation;
        let control = if silent { control & !SyncManager::CONTROL_AL_EVENT } else { control };
        while all.len() <= number {
            all.push(process_data(None, SyncManager::INPUTS, sm_type::INPUTS));
        }
        all[number] = process_data(Some(area), control, kind);
    }
    all
}

/// Bytes of the PDOs assigned by default.
fn default_length(area: &Area) -> u16 {
    area.bits(&area.default).div_ceil(8) as u16
}

fn pdos(area: Option<&Area>) -> Vec<SiiPdo> {
    let Some(area) = area else { return Vec::new() };
    area.pdos.iter().map(|one| pdo(one, area.sync_manager_of(one.index))).collect()
}

/// The PDOs in windows of inputs.
fn windows(draft: &Draft<'_>) -> Vec<SiiPdo> {
    let windows = draft.eeprom.iter().flat_map(|eeprom| &eeprom.windows);
    let of = |window: &Window| {
        let number = Some(window.sync_manager);
        window.pdos.iter().map(|one| pdo(one, number)).collect::<Vec<_>>()
    };
    windows.flat_map(of).collect()
}

fn pdo(pdo: &Pdo, sync_manager: Option<u8>) -> SiiPdo {
    SiiPdo {
        index: pdo.index,
        sync_manager,
        sync_unit: 0,
        name: pdo.name.clone(),
        flags: SiiPdo::FIXED,
        entries: pdo.entries.iter().map(entry).collect(),
    }
}

fn entry(entry: &PdoEntry) -> SiiEntry {
    SiiEntry {
        index: entry.object.map_or(0, |object| object.index),
        sub: entry.object.map_or(0, |object| object.sub),
        name: entry.name.clone(),
        data_type: entry.data_type.0 as u8,
        bits: entry.bits,
        flags: 0,
    }
}

fn op_modes(draft: &Draft<'_>) -> Vec<SiiOpMode> {
    if let Some(eeprom) = &draft.eeprom {
        let modes = eeprom.op_modes.iter();
        return modes
            .map(|(name, text, record)| SiiOpMode::of_record(record, name.clone(), text.clone()))
            .collect();
    }
    let modes = draft.op_modes.iter();
    modes
        .map(|mode| SiiOpMode {
            name: mode.name.clone(),
            description: mode.description.clone(),
            assign_activate: mode.assign_activate,
            sync0_factor: mode.sync0_factor,
            sync1_factor: mode.sync1_factor,
            // The ranges of the keys guarantee the conversion.
            cycle_time_0: mode.sync0_cycle.to_u32().unwrap_or(u32::MAX),
            shift_time_0: mode.sync0_shift.0 as i32,
            shift_time_1: mode.sync1_shift.0 as i32,
        })
        .collect()
}

/// A text cut to at most 255 bytes, in whole characters.
pub(super) fn cut(text: &str) -> &str {
    let end = (0..=text.len().min(255)).rev().find(|end| text.is_char_boundary(*end));
    &text[..end.unwrap_or(0)]
}

/// Bytes of word 2: length of SYNC pulses, in ticks of the ESC.
const PULSE: Range<usize> = 4..6;
/// A tick of the ESC, ns.
const TICK: i64 = 10;

/// Register 0x0140: the local CPU is connected by SPI.
pub(super) const PDI_SPI: u8 = 0x05;
/// Register 0x0140: digital I/O.
pub(super) const PDI_DIGITAL_IO: u8 = 0x04;
/// Bit 0 of register 0x0141.
pub(super) const DEVICE_EMULATION: u8 = 0x01;
/// Register 0x0141: SYNC-out unit and latch-in unit on.
pub(super) const ESC_SYNC_AND_LATCH: u8 = 0x0C;
/// Register 0x0141: SYNC-out unit on.
pub(super) const SYNC_UNIT: u8 = 0x04;
/// Register 0x0151: both pins are SYNC outputs, active low, and both are mapped to the AL event
/// request.
pub(super) const SYNC_OUTPUTS_MAPPED: u8 = 0xCC;
const FMMU_OUTPUTS: u8 = 1;
const FMMU_INPUTS: u8 = 2;
const FMMU_MAILBOX_STATUS: u8 = 3;
pub(super) const COE_SDO: u8 = 0x01;
pub(super) const COE_INFORMATION: u8 = 0x02;
pub(super) const COE_ASSIGNMENT: u8 = 0x04;
pub(super) const COE_CONFIGURATION: u8 = 0x08;
pub(super) const COE_UPLOAD: u8 = 0x10;
pub(super) const COE_COMPLETE_ACCESS: u8 = 0x20;
/// Protocol bits of word 0x1C.
const EOE: u16 = 1 << 1;
const FOE: u16 = 1 << 3;
