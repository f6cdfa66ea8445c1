//! One device of a file.

use std::collections::{HashMap, HashSet};

use super::dc::{self, EsiDc};
use super::dictionary::{self, EsiProfile};
use super::eeprom::{self, EsiEeprom, EsiTimeouts};
use super::fitting::{self, FittedModule};
use super::image::{self, Image};
use super::mailbox::{self, EsiMailbox, PROTOCOLS};
use super::modules::EsiModule;
use super::pdo::{self, Direction, EsiPdo};
use super::read::{self, U16, U32, cut};
use super::registers::{self, EsiRegisters};
use super::slots::{self, EsiSlots};
use super::sync_manager::{self, EsiSyncManager, Purpose};
use super::tree::{Element, Problem};
use super::warning::{Warning, WarningKind, Warnings};

/// `Devices/Device`.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct EsiDevice {
    /// Byte offset in the text.
    pub at: usize,
    /// Type name, such as "EL2502-0010".
    pub type_name: String,
    /// Product name.
    pub name: String,
    /// Its group.
    pub group: EsiGroup,
    /// `EBusCurrent` in mA: consumption from the EBUS, negative for supply; `None` if not stated.
    pub ebus_ma: Option<i16>,
    /// Product code; `None` for a placeholder, which is never chosen.
    pub product_code: Option<u32>,
    /// Revision, if the file has one.
    pub revision: Option<u32>,
    /// Serial number, mostly 0.
    pub serial: u32,
    /// Whether a newer device hides it in lists.
    pub hidden: bool,
    /// Ports 0 to 3 by letter: Y MII, K EBUS, H fast hot connect, blank unused; `None` if not
    /// stated.
    pub physics: Option<String>,
    /// Timeouts and behaviour in `Info`.
    pub timeouts: EsiTimeouts,
    /// Use of each FMMU as in SII category 40: 1 outputs, 2 inputs, 3 mailbox state, 0 unused.
    pub fmmus: Vec<u8>,
    /// SyncManagers by number.
    pub sync_managers: Vec<EsiSyncManager>,
    /// PDOs of both directions, in order.
    pub pdos: Vec<EsiPdo>,
    /// Mailbox, if it has one.
    pub mailbox: Option<EsiMailbox>,
    /// Distributed clocks, if the file describes them.
    pub dc: Option<EsiDc>,
    /// Device profile and dictionary.
    pub profile: EsiProfile,
    /// Number of the group with its own process data (`Type@ModulePdoGroup`).
    pub pdo_group: u16,
    /// Slots of a modular device; `None` once the modules are fitted.
    pub slots: Option<EsiSlots>,
    /// The fitted modules, whose PDOs, objects and downloads are included: see
    /// [`super::EsiFile::fitted`].
    pub modules: Vec<FittedModule>,
    /// Registers of its ESC that are to be written.
    pub registers: EsiRegisters,
    /// EEPROM.
    pub eeprom: Option<EsiEeprom>,
    /// Doubts about it.
    pub warnings: Vec<Warning>,
}

/// A group of devices.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct EsiGroup {
    /// `GroupType`.
    pub kind: String,
    /// Name in the list of groups; empty if it is not listed.
    pub name: String,
}

impl EsiDevice {
    /// OpModes; empty for a device without DC.
    pub fn op_modes(&self) -> &[dc::EsiOpMode] {
        self.dc.as_ref().map_or(&[], |dc| &dc.op_modes)
    }

    /// The process data by default or in one of its OpModes; those of modules are included only if
    /// they are [fitted](super::EsiFile::fitted).
    pub fn image(&self, mode: Option<&dc::EsiOpMode>) -> Image {
        // The doubts were noted when the device was read.
        image::default(self, &self.pdos, mode, &mut Warnings::default())
    }

    /// Windows of outputs that have PDOs by default or in one of its OpModes, by SyncManager
    /// number. They are no part of the [`image`](Self::image): as a rule they lie on the registers
    /// of the SYNC unit, which would be written by the plan and by process data both.
    pub fn output_windows(&self, mode: Option<&dc::EsiOpMode>) -> Vec<u8> {
        let by_default = self.pdos.iter().filter_map(|pdo| pdo.sync_manager);
        let by_mode = mode.iter().flat_map(|mode| &mode.assignments);
        let by_mode = by_mode.filter(|assignment| !assignment.pdos.is_empty());
        let named = by_default.chain(by_mode.map(|assignment| assignment.sync_manager));
        let mut windows: Vec<u8> = named.filter(|number| self.is_output_window(*number)).collect();
        windows.sort_by_cached_key(|number| u64::from(*number));
        windows.dedup();
        windows
    }

    /// Whether the SyncManager of this number is a window of outputs.
    pub(super) fn is_output_window(&self, number: u8) -> bool {
        let purpose = self.sync_managers.get(usize::from(number)).map(|sm| sm.purpose);
        purpose == Some(Purpose::Window(Some(Direction::Outputs)))
    }
}

/// Reads a device. `groups` are the names of the file's groups by type; `left` is the number of
/// dictionary entries that the file may still have.
pub(super) fn read<'a>(
    element: Element<'a>,
    groups: &HashMap<String, String>,
    definitions: &pdo::Definitions<'a>,
    modules: &[EsiModule],
    left: &mut usize,
) -> Result<EsiDevice, Problem> {
    let mut warnings = Warnings::default();
    let w = &mut warnings;
    let at = element.at();
    let Some(kind) = element.child("Type") else {
        return Err(Problem::new(at, "Device lacks Type; expected one with ProductCode"));
    };
    let type_name = kind.text().into_owned();
    let product_code = read::attribute(kind, "ProductCode", U32, w)?.map(|code| code as u32);
    if product_code.is_none() {
        w.add(WarningKind::ProductCodeMissing, kind.at(), || {
            format!("\"{}\" is a placeholder", cut(&type_name))
        });
    }
    let revision = read::attribute(kind, "RevisionNo", U32, w)?.map(|revision| revision as u32);
    if revision.is_none() && product_code.is_some() {
        w.add(WarningKind::RevisionMissing, kind.at(), || {
            format!("\"{}\" has no RevisionNo; 0 is taken", cut(&type_name))
        });
    }
    let group = element.child_text("GroupType");
    let group_name = groups.get(&*group);
    if group_name.is_none() {
        w.add(WarningKind::GroupUnknown, at, || format!("group \"{}\"", cut(&group)));
    }
    let physics = element.attribute("Physics").map(str::to_owned);
    match &physics {
        None => w.add(WarningKind::PhysicsMissing, at, || "two MII ports are assumed".to_owned()),
        Some(letters) => {
            if let Some(words) = strange_ports(letters) {
                w.add(WarningKind::PhysicsUnknown, at, || words);
            }
        }
    }
    if let Some(further) = element.child("SubDevice") {
        w.add(WarningKind::SeveralControllers, further.at(), || {
            "the box has further controllers; this is one of them".to_owned()
        });
    }
    for child in element.elements().filter(|child| !KNOWN.contains(&child.name())) {
        w.add(WarningKind::ElementUnknown, child.at(), || format!("<{}>", child.name()));
    }
    let mut device = EsiDevice {
        at,
        name: read::name(element),
        group: EsiGroup { kind: group.into_owned(), name: group_name.cloned().unwrap_or_default() },
        ebus_ma: ebus_current(element, w),
        product_code,
        revision,
        serial: read::attribute(kind, "SerialNo", U32, w)?.unwrap_or(0) as u32,
        hidden: false,
        physics,
        timeouts: eeprom::timeouts(element, w)?,
        fmmus: fmmus(element),
        sync_managers: sync_manager::read(element, w)?,
        pdos: pdo::read(element, definitions, w)?,
        mailbox: mailbox::read(element, w)?,
        dc: dc::read(element, w)?,
        profile: dictionary::read(element, left, w)?,
        pdo_group: read::attribute(kind, "ModulePdoGroup", U16, w)?.unwrap_or(0) as u16,
        slots: slots::read(element, w)?,
        modules: Vec::new(),
        registers: registers::read(element, w),
        eeprom: eeprom::read(element, w)?,
        type_name,
        warnings: Vec::new(),
    };
    check(&mut device, w);
    match &device.slots {
        None => check_image(&device, &device.pdos, w),
        Some(slots) => {
            let modules = slots.default_modules(modules, w);
            let pdos = fitting::pdos(&device, slots, &modules, w);
            check_image(&device, &pdos, w);
        }
    }
    device.warnings = warnings.0;
    Ok(device)
}

/// The current is used only for an SII, so an unreadable one is left out.
fn ebus_current(device: Element<'_>, warnings: &mut Warnings) -> Option<i16> {
    let info = device.child("Info")?.child("Electrical")?;
    let range = i16::MIN.into()..=i16::MAX.into();
    let current = read::child(info, "EBusCurrent", range, warnings).unwrap_or(None);
    current.map(|ma| ma as i16)
}

/// A doubt about the letters of the ports.
fn strange_ports(letters: &str) -> Option<String> {
    if letters.trim().is_empty() {
        return Some("no port at all; two MII ports are assumed".to_owned());
    }
    if letters.chars().count() > 4 {
        let shown = cut(letters);
        return Some(format!("\"{shown}\" has more than 4 ports; the first 4 are taken"));
    }
    let (port, letter) = letters.chars().enumerate().find(|(_, l)| !PHYSICS.contains(l))?;
    let letter = letter.escape_default();
    Some(format!("port {port} is \"{letter}\", none of Y, K, H, B and blank; MII is taken"))
}

fn fmmus(device: Element<'_>) -> Vec<u8> {
    let uses = device.children("Fmmu").map(|fmmu| match &*fmmu.text() {
        "Outputs" => 1,
        "Inputs" => 2,
        "MBoxState" => 3,
        _ => 0,
    });
    uses.take(16).collect()
}

/// Warns of contradictions between parts of a device.
fn check(device: &mut EsiDevice, w: &mut Warnings) {
    let mut seen = HashSet::new();
    let mut twice = None;
    device.pdos.retain(|pdo| {
        let new = seen.insert(pdo.index);
        if !new {
            twice = Some(pdo.at);
            w.add(WarningKind::PdoRepeated, pdo.at, || {
                format!("PDO 0x{:04X} stands twice; the first counts", pdo.index)
            });
        }
        new
    });
    if let Some(mailbox) = &device.mailbox {
        let of = |purpose| device.sync_managers.iter().any(|sm| sm.purpose == purpose);
        if !of(Purpose::MailboxOut) || !of(Purpose::MailboxIn) {
            w.add(WarningKind::MailboxWithoutSyncManagers, device.at, || {
                "a mailbox, but not two SyncManagers for it; it is not used".to_owned()
            });
        }
        for (bit, name) in PROTOCOLS.iter().enumerate() {
            if mailbox.protocols & 1 << bit != 0 && !["CoE", "SoE"].contains(name) {
                w.add(WarningKind::MailboxProtocol, device.at, || {
                    format!("{name} is announced; a virtual SubDevice answers it with an error")
                });
            }
        }
        if mailbox.coe.is_some() && !device.profile.has_dictionary {
            w.add(WarningKind::DictionaryMissing, device.at, || {
                "CoE without a dictionary in this file; objects of identity and PDOs are made"
                    .into()
            });
        }
    }
    let supported = |index| {
        let object = device.profile.objects.iter().find(|object| object.index == index)?;
        let entry = object.entries.iter().find(|entry| entry.sub == 4)?;
        Some((
            object.at,
            entry.default.iter().rev().fold(0u64, |sum, byte| sum << 8 | u64::from(*byte)),
        ))
    };
    let with_sync0 = device.op_modes().iter().find(|mode| mode.sync0());
    if let (Some(mode), Some((at, types))) = (with_sync0, supported(0x1C32).or(supported(0x1C33)))
        && types & DC_BITS == 0
    {
        w.add(WarningKind::DictionaryWithoutDc, at, || {
            format!("0x1C32:04 = {types:#06x} has no DC, OpMode \"{}\" has", cut(&mode.name))
        });
    }
}

/// Warns of doubts about the process data that are assigned by default.
pub(super) fn check_image(device: &EsiDevice, pdos: &[EsiPdo], w: &mut Warnings) {
    let image = image::default(device, pdos, None, w);
    for (direction, size) in
        [(Direction::Outputs, &image.outputs), (Direction::Inputs, &image.inputs)]
    {
        for (number, pdos) in size {
            let bits: u32 = pdos.iter().map(|pdo| pdo.bits()).sum();
            let sm = &device.sync_managers[usize::from(*number)];
            // Windows have no size as a rule: nothing in the ESC needs it.
            let stated = sm.default_size > 0 || !matches!(sm.purpose, Purpose::Window(_));
            if stated && u32::from(sm.default_size) != bits.div_ceil(8) {
                w.add(WarningKind::SyncManagerSize, sm.at, || {
                    format!(
                        "DefaultSize {} of SyncManager {number}, but the default {direction:?} have \
                         {bits} bits",
                        sm.default_size
                    )
                });
            }
            let assigned: HashSet<u16> = pdos.iter().map(|pdo| pdo.index).collect();
            for pdo in pdos {
                if let Some(other) = pdo.exclude.iter().find(|other| assigned.contains(other)) {
                    w.add(WarningKind::PdoExcluded, pdo.at, || {
                        format!(
                            "0x{:04X} and 0x{:04X} are both assigned and exclude each other",
                            pdo.index, other
                        )
                    });
                }
            }
        }
    }
    let process_data =
        |sm: &EsiSyncManager| matches!(sm.purpose, Purpose::Outputs | Purpose::Inputs);
    if image.is_empty() && device.sync_managers.iter().any(process_data) {
        w.add(WarningKind::ProcessDataMissing, device.at, || {
            "no PDO is assigned to any SyncManager by default".to_owned()
        });
    }
    for entry in image.all().flat_map(|pdo| &pdo.entries) {
        if entry.bits > 255 {
            w.add(WarningKind::PdoEntryPadded, entry.at, || {
                format!("an entry of {} bits; a mapping object has room for 255", entry.bits)
            });
        }
    }
}

/// MII, EBUS, MII with fast hot connect, EBUS in old files, no port.
const PHYSICS: [char; 5] = ['Y', 'K', 'H', 'B', ' '];
/// Bits 2 to 4 of 0x1C32:04: SYNC0, SYNC1, subordinated.
const DC_BITS: u64 = 0x1C;
/// Children of a device in the schema.
const KNOWN: [&str; 27] = [
    "Type",
    "HideType",
    "AlternativeType",
    "SubDevice",
    "Name",
    "Comment",
    "URL",
    "Info",
    "GroupType",
    "Profile",
    "Fmmu",
    "Sm",
    "Su",
    "RxPdo",
    "TxPdo",
    "Mailbox",
    "Dc",
    "Slots",
    "ESC",
    "Eeprom",
    "Image16x14",
    "ImageFile16x14",
    "ImageData16x14",
    "VendorSpecific",
    "ImageFile",
    "ModulePdoGroup",
    "ControllerSync",
];
