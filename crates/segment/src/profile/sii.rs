//! The EEPROM image of a profile.

use std::ops::Range;

use isocat_descriptions::document::FileError;
use isocat_wire::sii::{
    HEADER_LEN, Header, ImageFull, MailboxArea, PdoEntryRecord, PdoRecord, SmRecord, Writer,
    category, checksum, sm_type,
};
use isocat_wire::sync_manager::SyncManager;
use isocat_wire::time::Nanos;

use super::draft::{Area, Draft};
use super::ports;

/// The image, in the smallest usual EEPROM that it fits into.
pub(super) fn image(draft: &Draft<'_>) -> Result<Vec<u8>, FileError> {
    let mut strings = Strings { texts: Vec::new(), lenient: draft.eeprom.is_some() };
    let categories = [
        (category::GENERAL, general(draft, &mut strings)),
        (category::FMMU, fmmus(draft)),
        (category::SYNC_MANAGER, sync_managers(draft)),
        (category::TX_PDO, pdos(draft.inputs.as_ref(), &mut strings)),
        (category::RX_PDO, pdos(draft.outputs.as_ref(), &mut strings)),
        (category::DC, op_modes(draft, &mut strings)),
    ];
    let strings = strings.finish().map_err(|problem| draft.source.error(0, problem))?;
    let write = |size: usize| -> Result<Vec<u8>, ImageFull> {
        let mut image = vec![0; size];
        let mut writer = Writer::new(&mut image, &header(draft, size))?;
        // Strings come first: the others point into them.
        writer.category(category::STRINGS, &strings)?;
        for (kind, data) in &categories {
            if !data.is_empty() {
                writer.category(*kind, data)?;
            }
        }
        writer.finish()?;
        Ok(image)
    };
    let most = SIZES[SIZES.len() - 1];
    let least = draft.eeprom.as_ref().map_or(0, |eeprom| eeprom.size.min(most));
    let mut sizes = SIZES.into_iter().filter(|size| *size >= least);
    sizes.find_map(|size| write(size).ok()).ok_or_else(|| {
        draft.source.error(0, format!("the SII image is too long; expected at most {most} bytes"))
    })
}

/// How long SYNC pulses are, word 2 of an image; zero is acknowledge mode.
pub(super) fn pulse(image: &[u8]) -> Nanos {
    let ticks = image.get(PULSE).map_or([0; 2], |word| [word[0], word[1]]);
    Nanos(i64::from(u16::from_le_bytes(ticks)) * TICK)
}

/// Whether an image switches the SYNC unit on: the high byte of word 0, which becomes register 0x0141.
pub(super) fn has_sync_unit(image: &[u8]) -> bool {
    image.get(1).is_some_and(|byte| byte & SYNC_UNIT != 0)
}

/// The image with another length of SYNC pulses, in whole ticks, and the checksum of the words around it.
pub(super) fn with_pulse(image: &[u8], pulse: Nanos) -> Vec<u8> {
    let mut image = image.to_vec();
    image[PULSE].copy_from_slice(&((pulse.0 / TICK) as u16).to_le_bytes());
    let mut configuration = [0; 14];
    configuration.copy_from_slice(&image[..14]);
    image[14] = checksum(&configuration);
    image
}

fn header(draft: &Draft<'_>, size: usize) -> Header {
    let mut configuration = [0; 14];
    configuration[0] = PDI_SPI;
    configuration[1] = if draft.esc.sync_unit { ESC_SYNC_AND_LATCH } else { 0 };
    configuration[3] = SYNC_OUTPUTS_MAPPED;
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
        protocols: match eeprom {
            Some(eeprom) => eeprom.protocols,
            None if mailbox.is_some() => Header::COE,
            None => 0,
        },
        size: (size / 128 - 1) as u16,
    }
}

fn general(draft: &Draft<'_>, strings: &mut Strings) -> Vec<u8> {
    let mut data = vec![0; 32];
    let name = strings.number(&draft.name);
    let writable = [&draft.outputs, &draft.inputs]
        .into_iter()
        .flatten()
        .any(|area| area.access.has_any(isocat_wire::coe::info::Access::WRITE));
    data[0x00] = strings.number(&draft.vendor);
    data[0x02] = name;
    data[0x03] = name;
    if draft.mailbox.is_some() {
        data[0x05] = COE_SDO | COE_INFORMATION | COE_COMPLETE_ACCESS;
    }
    if writable {
        data[0x05] |= COE_ASSIGNMENT;
    }
    data[0x10..0x12].copy_from_slice(&ports::in_sii(&draft.esc.chip.1).to_le_bytes());
    if let Some(eeprom) = &draft.eeprom {
        data[0x02] = strings.number(&eeprom.order);
        data[0x05] = eeprom.coe_details;
        data[0x06] = u8::from(eeprom.protocols & FOE != 0);
        data[0x07] = u8::from(eeprom.protocols & EOE != 0);
        data[0x10..0x12].copy_from_slice(&eeprom.ports.to_le_bytes());
    }
    data
}

/// What the FMMUs are for; the third maps the state of the send mailbox.
fn fmmus(draft: &Draft<'_>) -> Vec<u8> {
    if let Some(eeprom) = &draft.eeprom {
        return eeprom.fmmus.clone();
    }
    let mut uses = vec![FMMU_OUTPUTS, FMMU_INPUTS];
    uses.extend(draft.mailbox.map(|_| FMMU_MAILBOX_STATUS));
    uses
}

/// SM0 and SM1 are the mailbox, SM2 the outputs, SM3 the inputs. Without a mailbox SM0 and SM1 are unused,
/// but keep its control byte: some MainDevices (ethercrab) guess the use of an unused one from there, and
/// would take control 0 for inputs.
fn sync_managers(draft: &Draft<'_>) -> Vec<u8> {
    if let Some(eeprom) = &draft.eeprom {
        return eeprom.sync_managers.iter().flat_map(SmRecord::emit).collect();
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
    [
        mailbox(receive, SyncManager::MAILBOX_OUT, sm_type::MAILBOX_OUT),
        mailbox(send, SyncManager::MAILBOX_IN, sm_type::MAILBOX_IN),
        process_data(draft.outputs.as_ref(), SyncManager::OUTPUTS, sm_type::OUTPUTS),
        process_data(draft.inputs.as_ref(), SyncManager::INPUTS, sm_type::INPUTS),
    ]
    .iter()
    .flat_map(SmRecord::emit)
    .collect()
}

/// Bytes of the PDOs assigned by default.
fn default_length(area: &Area) -> u16 {
    area.bits(&area.default).div_ceil(8) as u16
}

fn pdos(area: Option<&Area>, strings: &mut Strings) -> Vec<u8> {
    let mut data = Vec::new();
    for pdo in area.into_iter().flat_map(|area| &area.pdos) {
        let assigned = area.is_some_and(|area| area.default.iter().any(|d| d.value == pdo.index));
        let record = PdoRecord {
            index: pdo.index,
            entries: pdo.entries.len() as u8,
            sm: if assigned { area.map_or(0xFF, |area| area.sync_manager) } else { 0xFF },
            sync_unit: 0,
            name: strings.number(&pdo.name),
            flags: FIXED_CONTENT,
        };
        data.extend(record.emit());
        for entry in &pdo.entries {
            let record = PdoEntryRecord {
                index: entry.object.map_or(0, |object| object.index),
                sub: entry.object.map_or(0, |object| object.sub),
                name: strings.number(&entry.name),
                data_type: entry.data_type.0 as u8,
                bits: entry.bits,
                flags: 0,
            };
            data.extend(record.emit());
        }
    }
    data
}

fn op_modes(draft: &Draft<'_>, strings: &mut Strings) -> Vec<u8> {
    let mut data = Vec::new();
    if let Some(eeprom) = &draft.eeprom {
        for (name, description, record) in &eeprom.op_modes {
            let mut record = *record;
            record[0x12] = strings.number(name);
            record[0x13] = strings.number(description);
            data.extend(record);
        }
        return data;
    }
    for mode in &draft.op_modes {
        let mut record = [0; 24];
        record[0x0C..0x0E].copy_from_slice(&mode.sync1_factor.to_le_bytes());
        record[0x0E..0x10].copy_from_slice(&mode.assign_activate.to_le_bytes());
        record[0x10..0x12].copy_from_slice(&mode.sync0_factor.to_le_bytes());
        record[0x12] = strings.number(&mode.name);
        record[0x13] = strings.number(&mode.description);
        data.extend(record);
    }
    data
}

/// The strings category: every text once.
struct Strings {
    texts: Vec<String>,
    /// What has no room is left without a name, and too long ones are cut: the SII of an imported device
    /// is not the only place that has its names.
    lenient: bool,
}

impl Strings {
    /// Number of a text, from 1; 0 for none.
    fn number(&mut self, text: &str) -> u8 {
        if text.is_empty() {
            return 0;
        }
        let text = if self.lenient { cut(text) } else { text };
        let known = self.texts.iter().position(|known| known == text);
        if known.is_none() && self.lenient && self.texts.len() == 255 {
            return 0;
        }
        let position = known.unwrap_or_else(|| {
            self.texts.push(text.to_owned());
            self.texts.len() - 1
        });
        // More than 255 are refused by `finish`.
        (position + 1) as u8
    }

    fn finish(self) -> Result<Vec<u8>, String> {
        if self.texts.len() > 255 {
            return Err(format!("{} different names; the SII has room for 255", self.texts.len()));
        }
        let mut data = vec![self.texts.len() as u8];
        for text in &self.texts {
            let Ok(length) = u8::try_from(text.len()) else {
                return Err(format!("the name \"{text}\" is longer than the 255 bytes of the SII"));
            };
            data.push(length);
            data.extend(text.as_bytes());
        }
        Ok(data)
    }
}

/// At most 255 bytes of a text, in whole characters.
pub(super) fn cut(text: &str) -> &str {
    let end = (0..=text.len().min(255)).rev().find(|end| text.is_char_boundary(*end));
    &text[..end.unwrap_or(0)]
}

/// Bytes of word 2: how long SYNC pulses are, in ticks of the ESC.
const PULSE: Range<usize> = 4..6;
/// A tick of the ESC, ns.
const TICK: i64 = 10;
/// EEPROM sizes in bytes, 16 kbit to 512 kbit.
const SIZES: [usize; 6] = [2_048, 4_096, 8_192, 16_384, 32_768, 65_536];
const _: () = assert!(SIZES[0] > HEADER_LEN);

/// Register 0x0140: the local CPU is connected by SPI.
pub(super) const PDI_SPI: u8 = 0x05;
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
/// PDO flag, bit 4: entries can't be changed.
const FIXED_CONTENT: u16 = 0x0010;
