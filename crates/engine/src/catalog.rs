//! The content of an ESI file as one JSON document: devices, their OpModes and slots, and modules.

use isocat_descriptions::esi::{Direction, EsiDevice, EsiFile, EsiModule, EsiSlots, Warning};
use isocat_segment::profile::Profile;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Serialize;

/// Version of the document; it changes whenever a reader could be misled by an older schema.
pub const FORMAT: u32 = 1;

/// JSON schema of the document, draft 2020-12.
#[cfg(feature = "schema")]
pub fn schema() -> serde_json::Value {
    isocat_descriptions::schema::of::<Catalog>(&format!("isocat-devices/{FORMAT}"))
}

/// The content of an ESI file.
#[derive(Clone, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Catalog {
    /// Version of this document: 1.
    pub format: u32,
    /// The file, as the caller named it.
    pub file: String,
    /// Vendor id.
    pub vendor_id: u32,
    /// Vendor name; empty if the file has none.
    pub vendor: String,
    /// Devices in the order of the file.
    pub devices: Vec<Device>,
    /// Modules in the order of the file, then those of the other files.
    pub modules: Vec<Module>,
    /// Devices and modules that cannot be read, each with its place.
    pub refused: Vec<String>,
    /// Warnings about the file as a whole.
    pub warnings: Vec<Doubt>,
}

/// A device.
#[derive(Clone, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Device {
    /// Type: key `type` of a segment file.
    #[serde(rename = "type")]
    pub type_name: String,
    /// Name.
    pub name: String,
    /// Product code; null for a placeholder.
    pub product_code: Option<u32>,
    /// Revision; null if the file has none.
    pub revision: Option<u32>,
    /// Whether a newer device hides it.
    pub hidden: bool,
    /// OpModes in the order of their numbers.
    pub op_modes: Vec<OpMode>,
    /// Why it cannot be simulated, as a keyword; null if it can, or for a device with OpModes, each
    /// of which has its own reason.
    pub not_simulated: Option<String>,
    /// Slots of a modular device; empty for any other.
    pub slots: Vec<Slot>,
    /// Warnings about the device.
    pub warnings: Vec<Doubt>,
}

/// An OpMode.
#[derive(Clone, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct OpMode {
    /// Name.
    pub name: String,
    /// What it is for.
    pub description: String,
    /// AssignActivate: registers 0x0980 (low byte) and 0x0981.
    pub assign_activate: u16,
    /// Why it cannot be simulated, as a keyword; null if it can.
    pub not_simulated: Option<String>,
}

/// A slot: one place for a module, or several.
#[derive(Clone, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Slot {
    /// Name.
    pub name: String,
    /// Number of its first place, counted from 0 through all slots.
    pub first_place: u16,
    /// Number of its places: the largest number of modules.
    pub places: u16,
    /// Smallest number of modules.
    pub least: u16,
    /// Number of its group.
    pub group: u16,
    /// Idents of the modules that fit, as far as the files contain them.
    pub takes: Vec<u32>,
    /// Ident of the module that is preset; null if none is.
    pub preset: Option<u32>,
}

/// A module.
#[derive(Clone, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Module {
    /// Ident.
    pub ident: u32,
    /// Type: the name that key `modules` of a segment file uses.
    #[serde(rename = "type")]
    pub type_name: String,
    /// Name.
    pub name: String,
    /// Class; empty if it has none.
    pub class: String,
    /// The file that contains it, if that is another one.
    pub file: Option<String>,
    /// Bits of its outputs that are in the process data by default.
    pub output_bits: u32,
    /// Bits of its inputs that are in the process data by default.
    pub input_bits: u32,
    /// OpModes of the device to which it belongs; empty for all of them.
    pub op_modes: Vec<String>,
}

/// A warning: something doubtful in the file.
#[derive(Clone, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Doubt {
    /// Its fixed name.
    pub kind: String,
    /// Line of its first place, from 1.
    pub line: usize,
    /// Number of its places.
    pub count: usize,
    /// What was found at the first place, and how it is read.
    pub message: String,
}

impl Catalog {
    /// The catalog of a description, with the modules that it includes.
    pub fn of(file: &EsiFile) -> Self {
        Self {
            format: FORMAT,
            file: file.path.clone(),
            vendor_id: file.vendor_id,
            vendor: one_line(&file.vendor),
            devices: file.devices.iter().map(|found| device(file, found)).collect(),
            modules: file.modules.iter().map(module).collect(),
            refused: file.refused.iter().map(|error| error.to_string()).collect(),
            warnings: doubts(file, &file.file_warnings),
        }
    }
}

fn device(file: &EsiFile, device: &EsiDevice) -> Device {
    let obstacle = |mode| {
        let refused = Profile::from_esi(file, device, mode).err()?;
        Some(refused.obstacle.name().to_owned())
    };
    let modes = device.op_modes();
    let op_mode = |(number, mode): (usize, &isocat_descriptions::esi::EsiOpMode)| OpMode {
        name: one_line(&mode.name),
        description: one_line(&mode.description),
        assign_activate: mode.assign_activate,
        not_simulated: obstacle(Some(number)),
    };
    Device {
        type_name: one_line(&device.type_name),
        name: one_line(&device.name),
        product_code: device.product_code,
        revision: device.revision,
        hidden: device.hidden,
        op_modes: modes.iter().enumerate().map(op_mode).collect(),
        not_simulated: if modes.is_empty() { obstacle(None) } else { None },
        slots: device.slots.as_ref().map_or(Vec::new(), |all| slots(all, &file.modules)),
        warnings: doubts(file, &device.warnings),
    }
}

/// The slots of a device, with the modules among these that fit.
pub fn slots(all: &EsiSlots, modules: &[EsiModule]) -> Vec<Slot> {
    let slot = |(number, slot): (usize, &isocat_descriptions::esi::EsiSlot)| {
        let mut places = all.places().filter(|place| place.slot_number == number);
        let takes = modules.iter().filter(|module| slot.takes(module));
        Slot {
            name: one_line(&slot.name),
            first_place: places.next().map_or(0, |place| place.number),
            places: all.places().filter(|place| place.slot_number == number).count() as u16,
            least: slot.least,
            group: slot.group,
            takes: takes.map(|module| module.ident).collect(),
            preset: slot.idents.iter().find(|(_, preset)| *preset).map(|(ident, _)| *ident),
        }
    };
    all.slots.iter().enumerate().map(slot).collect()
}

/// A module of a file.
pub fn module(module: &EsiModule) -> Module {
    let bits = |direction| {
        let assigned = module
            .pdos
            .iter()
            .filter(|pdo| pdo.direction == direction && pdo.sync_manager.is_some());
        assigned.map(|pdo| pdo.bits()).fold(0, u32::saturating_add)
    };
    Module {
        ident: module.ident,
        type_name: one_line(&module.type_name),
        name: one_line(&module.name),
        class: module.class.clone(),
        file: module.file.clone(),
        output_bits: bits(Direction::Outputs),
        input_bits: bits(Direction::Inputs),
        op_modes: module.op_modes.clone(),
    }
}

fn doubts(file: &EsiFile, warnings: &[Warning]) -> Vec<Doubt> {
    let doubt = |warning: &Warning| Doubt {
        kind: warning.kind.to_string(),
        line: file.place(warning.at).line,
        count: warning.count,
        message: one_line(&warning.message),
    };
    warnings.iter().map(doubt).collect()
}

/// A text of a file in one line, without control characters.
pub fn one_line(text: &str) -> String {
    let words: Vec<_> = text.split_whitespace().collect();
    words.join(" ").chars().filter(|character| !character.is_control()).collect()
}
