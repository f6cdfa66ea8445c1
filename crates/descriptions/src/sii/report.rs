//! The content of an SII file, as one JSON document.

use isocat_wire::sii::{Header, MailboxArea, SmRecord};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Serialize;

use super::{Doubt, SiiFile, SiiOpMode, SiiPdo};

/// Version of the document; it changes whenever a reader could be misled by an older schema.
pub const FORMAT: u32 = 1;

/// JSON schema of the document, draft 2020-12.
#[cfg(feature = "schema")]
pub fn schema() -> serde_json::Value {
    crate::schema::of::<Report>(&format!("isocat-sii/{FORMAT}"))
}

/// The content of an SII, with the doubts about it.
#[derive(Clone, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Report {
    /// Version of this document: 1.
    pub format: u32,
    /// The file, as the caller named it.
    pub file: String,
    /// Bytes of the image.
    pub bytes: usize,
    /// Bytes up to and including the end mark of the categories.
    pub bytes_used: usize,
    /// Vendor id.
    pub vendor_id: u32,
    /// Product code.
    pub product_code: u32,
    /// Revision.
    pub revision: u32,
    /// Serial number.
    pub serial: u32,
    /// Order number: the device type. Empty without the category General.
    pub order: String,
    /// Name.
    pub name: String,
    /// Type of the group.
    pub group: String,
    /// Words 0 to 6 as hex digits, which the ESC loads.
    pub configuration: String,
    /// Station alias; 0 for none.
    pub alias: u16,
    /// Whether the ESC's SYNC unit is switched on.
    pub sync_unit: bool,
    /// Whether the ESC answers state requests by itself, without a CPU.
    pub device_emulation: bool,
    /// Length of SYNC pulses in ns; 0 if the device's program ends them.
    pub pulse_ns: u32,
    /// The standard mailbox; null for none.
    pub mailbox: Option<Mailbox>,
    /// The mailbox in BOOT; null for none.
    pub boot_mailbox: Option<Mailbox>,
    /// Protocols of the mailbox.
    pub protocols: Vec<String>,
    /// CoE services.
    pub coe: Vec<String>,
    /// Ports from port 0 by letter: Y MII, K EBUS, H fast hot connect, blank unused. Null without
    /// the category General.
    pub ports: Option<String>,
    /// Current on the EBUS in mA; negative for devices that feed it. Null without the category
    /// General.
    pub ebus_ma: Option<i16>,
    /// Use of each FMMU: outputs, inputs, mailbox-state, unused, or the number.
    pub fmmus: Vec<String>,
    /// SyncManagers by number.
    pub sync_managers: Vec<SyncManager>,
    /// PDOs to the MainDevice.
    pub tx_pdos: Vec<Pdo>,
    /// PDOs from the MainDevice.
    pub rx_pdos: Vec<Pdo>,
    /// OpModes; the first is the default.
    pub op_modes: Vec<OpMode>,
    /// Categories that are kept unchanged.
    pub other_categories: Vec<Category>,
    /// Contradictions to the standard or within the image, and what it lacks.
    pub doubts: Vec<DoubtReport>,
}

/// A mailbox.
#[derive(Clone, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Mailbox {
    /// First byte of the mailbox from the MainDevice.
    pub receive_start: u16,
    /// Its bytes.
    pub receive_length: u16,
    /// First byte of the mailbox to the MainDevice.
    pub send_start: u16,
    /// Its bytes.
    pub send_length: u16,
}

/// A SyncManager.
#[derive(Clone, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct SyncManager {
    /// Its purpose: mailbox-out, mailbox-in, outputs, inputs, unused, or the number.
    pub purpose: String,
    /// First byte.
    pub start: u16,
    /// Bytes by default.
    pub length: u16,
    /// Control byte.
    pub control: u8,
    /// Whether it is enabled.
    pub enabled: bool,
    /// Whether it represents no SyncManager of the ESC.
    pub is_virtual: bool,
    /// Whether it is enabled only in OP.
    pub op_only: bool,
}

/// A PDO.
#[derive(Clone, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Pdo {
    /// Index of its mapping object.
    pub index: u16,
    /// Name.
    pub name: String,
    /// SyncManager to which it is assigned; null for none.
    pub sync_manager: Option<u8>,
    /// Whether it must stay assigned.
    pub mandatory: bool,
    /// Whether its entries cannot be changed.
    pub fixed: bool,
    /// Mapped entries.
    pub entries: Vec<Entry>,
}

/// An entry of a PDO.
#[derive(Clone, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Entry {
    /// Index, 0 for padding.
    pub index: u16,
    /// Sub-index.
    pub sub: u8,
    /// Bits.
    pub bits: u8,
    /// Code of its type.
    pub data_type: u8,
    /// Name.
    pub name: String,
}

/// An OpMode.
#[derive(Clone, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct OpMode {
    /// Name.
    pub name: String,
    /// Description.
    pub description: String,
    /// Low byte for register 0x0980, high byte for 0x0981.
    pub assign_activate: u16,
    /// Cycle of SYNC0 in ns; 0 if the factor is used.
    pub cycle_time_0_ns: u32,
    /// Ratio of SYNC0's cycle to the bus cycle.
    pub sync0_factor: i16,
    /// Phase of SYNC0 in ns.
    pub shift_time_0_ns: i32,
    /// Ratio of SYNC1's cycle to that of SYNC0.
    pub sync1_factor: i16,
    /// Phase of SYNC1 in ns.
    pub shift_time_1_ns: i32,
}

/// A category that is kept unchanged.
#[derive(Clone, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Category {
    /// Its type.
    pub kind: u16,
    /// Its bytes as hex digits.
    pub data: String,
}

/// A doubt about the image.
#[derive(Clone, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct DoubtReport {
    /// Its fixed name.
    pub kind: &'static str,
    /// Its word in the image.
    pub word: usize,
    /// The expected value.
    pub expected: String,
    /// The found value.
    pub found: String,
    /// Whether it keeps a device with this EEPROM from OP.
    pub keeps_from_op: bool,
    /// What to do about it, the most certain first.
    pub remedies: &'static [&'static str],
}

impl SiiFile {
    /// The content of the file, for programs.
    pub fn report(&self) -> Report {
        let header = &self.sii.header;
        let general = self.sii.general.clone();
        let words = &header.configuration;
        let text = |text: fn(&super::General) -> &String| {
            general.as_ref().map(text).cloned().unwrap_or_default()
        };
        Report {
            format: FORMAT,
            file: self.path.clone(),
            bytes: self.image.len(),
            bytes_used: self.used,
            vendor_id: header.vendor_id,
            product_code: header.product_code,
            revision: header.revision,
            serial: header.serial,
            order: text(|general| &general.order),
            name: text(|general| &general.name),
            group: text(|general| &general.group),
            configuration: hex(words),
            alias: u16::from_le_bytes([words[8], words[9]]),
            sync_unit: words[1] & SYNC_UNIT != 0,
            device_emulation: header.emulates(),
            pulse_ns: u32::from(u16::from_le_bytes([words[4], words[5]])) * TICK_NS,
            mailbox: mailbox(header.receive, header.send),
            boot_mailbox: mailbox(header.boot_receive, header.boot_send),
            protocols: names(header.protocols.into(), &PROTOCOLS),
            coe: general.as_ref().map_or(Vec::new(), |g| match header.protocols & Header::COE {
                0 => Vec::new(),
                _ => names(g.coe_details.into(), &COE_DETAILS),
            }),
            ports: general.as_ref().map(super::General::physics),
            ebus_ma: general.as_ref().map(|general| general.ebus_ma),
            fmmus: self.sii.fmmus.iter().map(|found| fmmu(*found)).collect(),
            sync_managers: self.sii.sync_managers.iter().map(sync_manager).collect(),
            tx_pdos: self.sii.inputs.iter().map(pdo).collect(),
            rx_pdos: self.sii.outputs.iter().map(pdo).collect(),
            op_modes: self.sii.op_modes.iter().map(op_mode).collect(),
            other_categories: self
                .sii
                .others
                .iter()
                .map(|other| Category { kind: other.kind, data: hex(&other.data) })
                .collect(),
            doubts: self.doubts.iter().map(doubt).collect(),
        }
    }
}

fn mailbox(receive: MailboxArea, send: MailboxArea) -> Option<Mailbox> {
    (receive.length > 0 || send.length > 0).then_some(Mailbox {
        receive_start: receive.start,
        receive_length: receive.length,
        send_start: send.start,
        send_length: send.length,
    })
}

fn fmmu(found: u8) -> String {
    match found {
        0 | 0xFF => "unused".to_owned(),
        1 => "outputs".to_owned(),
        2 => "inputs".to_owned(),
        3 => "mailbox-state".to_owned(),
        other => other.to_string(),
    }
}

fn sync_manager(record: &SmRecord) -> SyncManager {
    let names = ["unused", "mailbox-out", "mailbox-in", "outputs", "inputs"];
    let purpose = names.get(usize::from(record.kind));
    SyncManager {
        purpose: purpose.map_or_else(|| record.kind.to_string(), |name| (*name).to_owned()),
        start: record.start,
        length: record.length,
        control: record.control,
        enabled: record.enable & SmRecord::ENABLED != 0,
        is_virtual: record.enable & SmRecord::VIRTUAL != 0,
        op_only: record.enable & SmRecord::OP_ONLY != 0,
    }
}

fn pdo(pdo: &SiiPdo) -> Pdo {
    let entry = |entry: &super::SiiEntry| Entry {
        index: entry.index,
        sub: entry.sub,
        bits: entry.bits,
        data_type: entry.data_type,
        name: entry.name.clone(),
    };
    Pdo {
        index: pdo.index,
        name: pdo.name.clone(),
        sync_manager: pdo.sync_manager,
        mandatory: pdo.flags & SiiPdo::MANDATORY != 0,
        fixed: pdo.flags & SiiPdo::FIXED != 0,
        entries: pdo.entries.iter().map(entry).collect(),
    }
}

fn op_mode(mode: &SiiOpMode) -> OpMode {
    OpMode {
        name: mode.name.clone(),
        description: mode.description.clone(),
        assign_activate: mode.assign_activate,
        cycle_time_0_ns: mode.cycle_time_0,
        sync0_factor: mode.sync0_factor,
        shift_time_0_ns: mode.shift_time_0,
        sync1_factor: mode.sync1_factor,
        shift_time_1_ns: mode.shift_time_1,
    }
}

fn doubt(doubt: &Doubt) -> DoubtReport {
    let Doubt { kind, word, expected, found, keeps_from_op } = doubt.clone();
    let remedies = kind.remedies();
    DoubtReport { kind: kind.name(), word, expected, found, keeps_from_op, remedies }
}

/// The names of the bits that are set.
fn names(bits: u32, names: &[&str]) -> Vec<String> {
    let all = names.iter().enumerate();
    all.filter(|(bit, _)| bits & 1 << bit != 0).map(|(_, name)| (*name).to_owned()).collect()
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Bits of word 0x1C.
const PROTOCOLS: [&str; 6] = ["AoE", "EoE", "CoE", "FoE", "SoE", "VoE"];
/// Bits of byte 5 of the category General.
const COE_DETAILS: [&str; 6] = [
    "sdo",
    "sdo-information",
    "pdo-assignment",
    "pdo-configuration",
    "upload-at-start",
    "complete-access",
];
/// A bit of register 0x0141, the high byte of word 0.
const SYNC_UNIT: u8 = 0x04;
/// A unit of word 2.
const TICK_NS: u32 = 10;
