//! Descriptions and SII: the image that a vendor's tool writes for a device, and a device that is
//! known only by its SII.

use std::fmt;
use std::sync::OnceLock;

use isocat_wire::ObjectAddress;
use isocat_wire::coe::DataType;
use isocat_wire::sii::{Header, MailboxArea, SmRecord, sm_type};
use isocat_wire::sync_manager::SyncManager;
use isocat_wire::time::Nanos;

use super::registers::EsiRegisters;
use super::{
    CycleTime, Direction, Encoding, EsiCoe, EsiDc, EsiDevice, EsiEeprom, EsiFile, EsiGroup,
    EsiMailbox, EsiOpMode, EsiPdo, EsiPdoEntry, EsiProfile, EsiSoe, EsiSyncManager, EsiTimeouts,
    Follows, Purpose, ShiftTime, data_type, sync_manager,
};
use crate::sii::{
    General, Names, OtherCategory, Sii, SiiEntry, SiiFile, SiiOpMode, SiiPdo, Unwritable,
};

/// An image of a description.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct EsiImage {
    /// The bytes, as long as the EEPROM.
    pub bytes: Vec<u8>,
    /// Parts that the description does not state, and the replacements.
    pub notes: Vec<ImageNote>,
}

/// A note on a difference between an image and its description.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ImageNote {
    /// The description has the whole image; all other elements are ignored.
    WholeImage,
    /// There is no ConfigData: words 0 to 6 are 0, and the ESC has no PDI.
    NoConfiguration,
    /// PDOs of modules are not written.
    Modules,
}

impl fmt::Display for ImageNote {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::WholeImage => {
                "the description has the whole image (Eeprom/Data); it is taken as it is"
            }
            Self::NoConfiguration => {
                "the description has no ConfigData: words 0 to 6 are 0, and the ESC has no PDI"
            }
            Self::Modules => "the device has slots: PDOs of modules are not written",
        })
    }
}

impl EsiFile {
    /// The image that the vendor's tool would write for a device. Fails if it does not fit into an
    /// EEPROM.
    pub fn image_of_sii(&self, device: &EsiDevice) -> Result<EsiImage, Unwritable> {
        let eeprom = device.eeprom.clone().unwrap_or_default();
        if let Some(bytes) = eeprom.image {
            return Ok(EsiImage { bytes, notes: vec![ImageNote::WholeImage] });
        }
        let bytes = self.sii(device).image(eeprom.byte_size, Names::Fitting)?;
        let mut notes = Vec::new();
        if eeprom.configuration.is_none() {
            notes.push(ImageNote::NoConfiguration);
        }
        if device.slots.is_some() {
            notes.push(ImageNote::Modules);
        }
        Ok(EsiImage { bytes, notes })
    }

    /// The SII of a device according to its description alone.
    pub fn sii(&self, device: &EsiDevice) -> Sii {
        let eeprom = device.eeprom.clone().unwrap_or_default();
        let area = |purpose| {
            let sm = device.sync_managers.iter().find(|sm| sm.purpose == purpose);
            sm.map_or(MailboxArea::default(), |sm| MailboxArea {
                start: sm.start,
                length: sm.default_size,
            })
        };
        let mailbox = device.mailbox.as_ref();
        let (receive, send) = match mailbox {
            Some(_) => (area(Purpose::MailboxOut), area(Purpose::MailboxIn)),
            None => (MailboxArea::default(), MailboxArea::default()),
        };
        let (boot_receive, boot_send) = eeprom.boot.unwrap_or_default();
        let pdos = |direction| {
            let of = device.pdos.iter().filter(move |pdo| pdo.direction == direction);
            of.map(pdo).collect()
        };
        Sii {
            header: Header {
                configuration: eeprom.configuration.unwrap_or_default(),
                vendor_id: self.vendor_id,
                product_code: device.product_code.unwrap_or(0),
                revision: device.revision.unwrap_or(0),
                serial: device.serial,
                boot_receive,
                boot_send,
                receive,
                send,
                protocols: mailbox.map_or(0, |mailbox| mailbox.protocols),
                size: 0,
            },
            general: Some(general(device)),
            fmmus: device.fmmus.clone(),
            sync_managers: device.sync_managers.iter().map(record).collect(),
            inputs: pdos(Direction::Inputs),
            outputs: pdos(Direction::Outputs),
            op_modes: device.op_modes().iter().map(op_mode).collect(),
            others: eeprom
                .categories
                .into_iter()
                .map(|(kind, data)| OtherCategory { kind, data })
                .collect(),
        }
    }

    /// A description with one device, made from its SII. Other properties are missing, as in an
    /// incomplete description.
    pub fn of_sii(file: &SiiFile) -> Self {
        let digits = file.image.iter().map(|byte| format!("{byte:02x}"));
        Self {
            path: file.path.clone(),
            encoding: Encoding::Utf8,
            vendor_id: file.sii.header.vendor_id,
            vendor: String::new(),
            devices: vec![device_of(&file.sii, file.image.len())],
            modules: Vec::new(),
            refused: Vec::new(),
            file_warnings: Vec::new(),
            // There is no text; this one distinguishes images of the same path.
            text: digits.collect(),
            lines: OnceLock::new(),
            references: Vec::new(),
            other_texts: Vec::new(),
        }
    }
}

fn general(device: &EsiDevice) -> General {
    let mailbox = device.mailbox.as_ref();
    let protocols = mailbox.map_or(0, |mailbox| mailbox.protocols);
    let coe = mailbox.and_then(|mailbox| mailbox.coe.as_ref());
    let details = |coe: &EsiCoe| {
        let bits = [
            true,
            coe.sdo_info,
            coe.pdo_assign,
            coe.pdo_config,
            coe.pdo_upload,
            coe.complete_access,
        ];
        bits.iter().enumerate().fold(0, |sum, (bit, is)| sum | u8::from(*is) << bit)
    };
    General {
        group: device.group.kind.clone(),
        order: device.type_name.clone(),
        name: device.name.clone(),
        coe_details: coe.map_or(0, details),
        foe: u8::from(protocols & FOE != 0),
        eoe: u8::from(protocols & EOE != 0),
        flags: if mailbox.is_some_and(|mailbox| mailbox.repeats) { DATA_LINK_LAYER } else { 0 },
        ebus_ma: device.ebus_ma.unwrap_or(0),
        group_name: device.group.name.clone(),
        ports: ports(device.physics.as_deref().unwrap_or("YY")),
        ..General::default()
    }
}

/// Kind of each port, four bits from port 0.
fn ports(physics: &str) -> u16 {
    let kinds = physics.chars().take(4).map(|letter| match letter {
        ' ' => 0,
        'K' | 'B' => 3,
        'H' => 4,
        _ => 1_u16,
    });
    kinds.enumerate().fold(0, |sum, (port, kind)| sum | kind << (4 * port))
}

fn record(sm: &EsiSyncManager) -> SmRecord {
    let (kind, usual) = match sm.purpose {
        Purpose::MailboxOut => (sm_type::MAILBOX_OUT, SyncManager::MAILBOX_OUT),
        Purpose::MailboxIn => (sm_type::MAILBOX_IN, SyncManager::MAILBOX_IN),
        Purpose::Outputs => (sm_type::OUTPUTS, SyncManager::OUTPUTS),
        Purpose::Inputs => (sm_type::INPUTS, SyncManager::INPUTS),
        Purpose::Window(Some(Direction::Outputs)) => (sm_type::OUTPUTS, 0),
        Purpose::Window(Some(Direction::Inputs)) => (sm_type::INPUTS, 0),
        Purpose::Window(None) => (sm_type::UNUSED, 0),
    };
    let window = matches!(sm.purpose, Purpose::Window(_));
    let flags = [(window, SmRecord::VIRTUAL), (sm.op_only, SmRecord::OP_ONLY)];
    let flags = flags.into_iter().filter(|(is, _)| *is).fold(0, |sum, (_, bit)| sum | bit);
    SmRecord {
        start: sm.start,
        length: sm.default_size,
        control: sm.control.unwrap_or(usual),
        status: 0,
        enable: sm.enable.unwrap_or(0) & SmRecord::ENABLED | flags,
        kind,
    }
}

fn pdo(pdo: &EsiPdo) -> SiiPdo {
    let flags = [(pdo.mandatory, SiiPdo::MANDATORY), (pdo.fixed, SiiPdo::FIXED)];
    let mut entries = Vec::new();
    for entry in &pdo.entries {
        let mut left = entry.bits;
        // A record has 8 bits for the length; a longer one only reserves its bits.
        let object = entry.object.filter(|_| left <= 255);
        while left > 0 {
            let bits = left.min(255) as u8;
            left -= u16::from(bits);
            entries.push(SiiEntry {
                index: object.map_or(0, |object| object.index),
                sub: object.map_or(0, |object| object.sub),
                name: entry.name.clone(),
                data_type: object.map_or(0, |_| data_type(&entry.data_type, bits.into()).0 as u8),
                bits,
                flags: 0,
            });
        }
    }
    entries.truncate(255);
    SiiPdo {
        index: pdo.index,
        sync_manager: pdo.sync_manager,
        sync_unit: 0,
        name: pdo.name.clone(),
        flags: flags.into_iter().filter(|(is, _)| *is).fold(0, |sum, (_, bit)| sum | bit),
        entries,
    }
}

/// An OpMode in category 60.
fn op_mode(mode: &EsiOpMode) -> SiiOpMode {
    let ns = |time: Option<Nanos>| {
        time.map_or(0, |time| time.0.clamp(i32::MIN.into(), i32::MAX.into()) as i32)
    };
    let factor = |cycle: Option<CycleTime>| {
        let factor = cycle.and_then(|cycle| cycle.factor).unwrap_or(0);
        factor.clamp(i16::MIN.into(), i16::MAX.into()) as i16
    };
    SiiOpMode {
        name: mode.name.clone(),
        description: mode.description.clone(),
        assign_activate: mode.assign_activate,
        cycle_time_0: ns(mode.cycle_time_sync0.map(|cycle| cycle.value)).max(0) as u32,
        shift_time_0: ns(mode.shift_time_sync0.map(|shift| shift.value)),
        shift_time_1: ns(mode.shift_time_sync1.map(|shift| shift.value)),
        sync0_factor: factor(mode.cycle_time_sync0),
        sync1_factor: factor(mode.cycle_time_sync1),
    }
}

fn device_of(sii: &Sii, bytes: usize) -> EsiDevice {
    let header = &sii.header;
    let general = sii.general.clone().unwrap_or_default();
    let is_told = header.receive.length > 0 && header.send.length > 0;
    // A program with protocols has a mailbox, whether or not its EEPROM says where.
    let is_forgotten = !is_told && header.protocols != 0 && !header.emulates();
    let has_mailbox = is_told || is_forgotten;
    let order = if general.order.is_empty() { "device" } else { &general.order };
    let name = if general.name.is_empty() { order } else { &general.name };
    let physics = general.physics();
    let has_dc = header.configuration[1] & SYNC_AND_LATCH != 0 || !sii.op_modes.is_empty();
    let pdos = |direction, pdos: &[SiiPdo]| -> Vec<EsiPdo> {
        pdos.iter().map(|pdo| esi_pdo(direction, pdo, sii.sync_managers.len())).collect()
    };
    EsiDevice {
        at: 0,
        type_name: order.to_owned(),
        name: name.to_owned(),
        group: EsiGroup { kind: general.group.clone(), name: general.group_name.clone() },
        ebus_ma: sii.general.as_ref().map(|general| general.ebus_ma),
        product_code: Some(header.product_code),
        revision: Some(header.revision),
        serial: header.serial,
        hidden: false,
        physics: (!physics.trim().is_empty()).then_some(physics),
        timeouts: EsiTimeouts::default(),
        fmmus: sii.fmmus.iter().take(16).map(|found| found % 0xFF).collect(),
        sync_managers: sii
            .sync_managers
            .iter()
            .take(sync_manager::MOST)
            .enumerate()
            .map(|(number, record)| match record.enable & SmRecord::VIRTUAL != 0 {
                true => esi_sync_manager(record, Purpose::Window(window(sii, number, record))),
                false => match purpose(record, has_mailbox) {
                    mailbox @ (Purpose::MailboxOut | Purpose::MailboxIn)
                        if is_forgotten && record.length == 0 =>
                    {
                        let record = SmRecord { length: USUAL_MAILBOX, ..*record };
                        esi_sync_manager(&record, mailbox)
                    }
                    purpose => esi_sync_manager(record, purpose),
                },
            })
            .collect(),
        pdos: [pdos(Direction::Outputs, &sii.outputs), pdos(Direction::Inputs, &sii.inputs)]
            .concat(),
        mailbox: has_mailbox.then(|| esi_mailbox(header.protocols, &general)),
        dc: has_dc.then(|| EsiDc {
            op_modes: sii.op_modes.iter().map(esi_op_mode).collect(),
            ..EsiDc::default()
        }),
        profile: EsiProfile::default(),
        pdo_group: 0,
        slots: None,
        modules: Vec::new(),
        registers: EsiRegisters::default(),
        eeprom: Some(EsiEeprom {
            byte_size: bytes,
            configuration: Some(header.configuration),
            boot: Some((header.boot_receive, header.boot_send)),
            ..EsiEeprom::default()
        }),
        warnings: Vec::new(),
    }
}

fn esi_mailbox(protocols: u16, general: &General) -> EsiMailbox {
    let has = |bit: u8| general.coe_details & 1 << bit != 0;
    EsiMailbox {
        repeats: general.flags & DATA_LINK_LAYER != 0,
        protocols,
        coe: (protocols & Header::COE != 0).then(|| EsiCoe {
            sdo_info: has(1),
            pdo_assign: has(2),
            pdo_config: has(3),
            pdo_upload: has(4),
            complete_access: has(5),
            ..EsiCoe::default()
        }),
        soe: (protocols & Header::SOE != 0)
            .then(|| EsiSoe { drives: general.soe_channels.clamp(1, 8), commands: Vec::new() }),
        further: Vec::new(),
    }
}

fn purpose(record: &SmRecord, has_mailbox: bool) -> Purpose {
    match record.kind {
        sm_type::MAILBOX_OUT => Purpose::MailboxOut,
        sm_type::MAILBOX_IN => Purpose::MailboxIn,
        // The program and its ESC work by the control byte, whatever the type says.
        sm_type::OUTPUTS | sm_type::INPUTS if record.control != 0 && record.length > 0 => {
            match record.control & SyncManager::CONTROL_ECAT_WRITES != 0 {
                true => Purpose::Outputs,
                false => Purpose::Inputs,
            }
        }
        sm_type::OUTPUTS => Purpose::Outputs,
        sm_type::INPUTS => Purpose::Inputs,
        // Older images leave the type out.
        _ => sync_manager::by_control(record.control, None, has_mailbox),
    }
}

/// The direction of a window; where its type says nothing, that of the PDOs in it.
fn window(sii: &Sii, number: usize, record: &SmRecord) -> Option<Direction> {
    let has = |pdos: &[SiiPdo]| pdos.iter().any(|pdo| pdo.sync_manager == Some(number as u8));
    match record.kind {
        sm_type::OUTPUTS => Some(Direction::Outputs),
        sm_type::INPUTS => Some(Direction::Inputs),
        sm_type::UNUSED if has(&sii.inputs) => Some(Direction::Inputs),
        sm_type::UNUSED if has(&sii.outputs) => Some(Direction::Outputs),
        _ => None,
    }
}

fn esi_sync_manager(record: &SmRecord, purpose: Purpose) -> EsiSyncManager {
    EsiSyncManager {
        at: 0,
        purpose,
        start: record.start,
        default_size: record.length,
        max_size: None,
        control: Some(record.control),
        enable: Some(record.enable & SmRecord::ENABLED),
        op_only: record.enable & SmRecord::OP_ONLY != 0,
    }
}

fn esi_pdo(direction: Direction, pdo: &SiiPdo, sync_managers: usize) -> EsiPdo {
    let entry = |entry: &SiiEntry| EsiPdoEntry {
        at: 0,
        object: (entry.index != 0).then(|| ObjectAddress::new(entry.index, entry.sub)),
        follows: Follows::default(),
        bits: entry.bits.into(),
        name: entry.name.clone(),
        data_type: type_name(DataType(entry.data_type.into())),
    };
    EsiPdo {
        at: 0,
        direction,
        index: pdo.index,
        follows: Follows::default(),
        name: pdo.name.clone(),
        sync_manager: pdo.sync_manager.filter(|number| usize::from(*number) < sync_managers),
        fixed: pdo.flags & SiiPdo::FIXED != 0,
        mandatory: pdo.flags & SiiPdo::MANDATORY != 0,
        exclude: Vec::new(),
        oversampling: 0,
        oversampling_step: 0,
        entries: pdo.entries.iter().map(entry).collect(),
    }
}

/// The name of a type in descriptions.
fn type_name(kind: DataType) -> String {
    let name = match kind {
        DataType::BOOLEAN => "BOOL",
        DataType::INTEGER8 => "SINT",
        DataType::INTEGER16 => "INT",
        DataType::INTEGER24 => "INT24",
        DataType::UNSIGNED24 => "UINT24",
        DataType::INTEGER32 => "DINT",
        DataType::INTEGER64 => "LINT",
        DataType::UNSIGNED8 => "USINT",
        DataType::UNSIGNED16 => "UINT",
        DataType::UNSIGNED32 => "UDINT",
        DataType::UNSIGNED64 => "ULINT",
        DataType::REAL32 => "REAL",
        DataType::REAL64 => "LREAL",
        other => other.name().unwrap_or_default(),
    };
    name.to_owned()
}

fn esi_op_mode(mode: &SiiOpMode) -> EsiOpMode {
    let cycle = |value: u32, factor: i16| {
        let is = value != 0 || factor != 0;
        is.then(|| CycleTime {
            value: Nanos(value.into()),
            factor: (factor != 0).then_some(factor.into()),
        })
    };
    let shift = |value: i32| {
        (value != 0).then(|| ShiftTime { value: Nanos(value.into()), factor: None, input: false })
    };
    EsiOpMode {
        at: 0,
        name: mode.name.clone(),
        description: mode.description.clone(),
        assign_activate: mode.assign_activate,
        cycle_time_sync0: cycle(mode.cycle_time_0, mode.sync0_factor),
        shift_time_sync0: shift(mode.shift_time_0),
        cycle_time_sync1: cycle(0, mode.sync1_factor),
        shift_time_sync1: shift(mode.shift_time_1),
        assignments: Vec::new(),
    }
}

/// Bits of the mailbox protocols.
const EOE: u16 = 1 << 1;
const FOE: u16 = 1 << 3;
/// Flag of the category General: the mailbox repeats a lost answer.
const DATA_LINK_LAYER: u8 = 0x04;
/// Bits of register 0x0141, the high byte of word 0.
const SYNC_AND_LATCH: u8 = 0x0C;
/// Length of a mailbox that an EEPROM left out.
const USUAL_MAILBOX: u16 = 128;
