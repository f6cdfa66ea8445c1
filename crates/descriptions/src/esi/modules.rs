//! Modular devices: modules, slots, and what stands in them by default.

use super::mailbox::{self, InitCommand};
use super::pdo::{self, EsiPdo};
use super::read::{self, U16, U32};
use super::tree::{Element, Problem};
use super::warning::{WarningKind, Warnings};

/// `Modules/Module`.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct EsiModule {
    /// Byte of the text at which it stands.
    pub at: usize,
    /// `Type@ModuleIdent`.
    pub ident: u32,
    /// `Type@ModuleClass`.
    pub class: String,
    /// Type name.
    pub type_name: String,
    /// Its process data.
    pub pdos: Vec<EsiPdo>,
    /// Its downloads at start.
    pub commands: Vec<InitCommand>,
}

/// `Device/Slots`.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct EsiSlots {
    /// Added to PDO indices per slot.
    pub pdo_increment: u16,
    /// Added to the indices of objects per slot.
    pub index_increment: u16,
    /// The list of modules is written to 0xF030.
    pub download_idents: bool,
    /// The slots.
    pub slots: Vec<EsiSlot>,
}

/// `Slot`: one place, or `most` of a kind.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct EsiSlot {
    /// Byte of the text at which it stands.
    pub at: usize,
    /// Name.
    pub name: String,
    /// How many modules there must be.
    pub least: u16,
    /// How many there may be.
    pub most: u16,
    /// Modules that fit, and whether one is the preset.
    pub idents: Vec<(u32, bool)>,
    /// Classes of modules that fit.
    pub classes: Vec<String>,
}

/// Reads the modules below `Modules`; one that can't be read goes to `refused`.
pub(super) fn modules(
    list: Element<'_>,
    warnings: &mut Warnings,
    refused: &mut Vec<Problem>,
) -> Vec<EsiModule> {
    let mut all = Vec::new();
    for element in list.children("Module") {
        if all.len() == MOST_IN_FILE {
            let message = format!("more than {MOST_IN_FILE} modules; the rest is not read");
            refused.push(Problem::new(element.at(), message));
            break;
        }
        match module(element, warnings) {
            Ok(module) => all.push(module),
            Err(problem) => refused.push(problem),
        }
    }
    all
}

fn module(element: Element<'_>, warnings: &mut Warnings) -> Result<EsiModule, Problem> {
    let Some(kind) = element.child("Type") else {
        return Err(Problem::new(element.at(), "Module lacks Type; expected one with ModuleIdent"));
    };
    let ident = read::attribute(kind, "ModuleIdent", U32, warnings)?;
    let coe = element.child("Mailbox").and_then(|mailbox| mailbox.child("CoE"));
    Ok(EsiModule {
        at: element.at(),
        ident: ident.ok_or_else(|| {
            Problem::new(kind.at(), "Type lacks ModuleIdent; expected a number such as #x100")
        })? as u32,
        class: kind.attribute("ModuleClass").unwrap_or_default().trim().to_owned(),
        type_name: kind.text().into_owned(),
        pdos: pdo::read(element, &pdo::Definitions::default(), warnings)?,
        commands: coe.map_or(Ok(Vec::new()), |coe| mailbox::commands(coe, warnings))?,
    })
}

/// Reads the slots of a device.
pub(super) fn slots(
    device: Element<'_>,
    warnings: &mut Warnings,
) -> Result<Option<EsiSlots>, Problem> {
    let Some(element) = device.child("Slots") else { return Ok(None) };
    let mut number = |name| Ok(read::attribute(element, name, U16, warnings)?.unwrap_or(0) as u16);
    let mut slots = EsiSlots {
        pdo_increment: number("SlotPdoIncrement")?,
        index_increment: number("SlotIndexIncrement")?,
        download_idents: match element.attribute("DownloadModuleIdentList") {
            Some(_) => read::flag(element, "DownloadModuleIdentList")?,
            None => false,
        },
        slots: Vec::new(),
    };
    for child in element.children("Slot") {
        let mut idents = Vec::new();
        for ident in child.children("ModuleIdent") {
            let number = read::integer(&ident.text(), ident.at(), "ModuleIdent", U32, warnings)?;
            idents.push((number as u32, read::flag(ident, "Default")?));
        }
        let classes = child.children("ModuleClass").map(|class| match class.child("Class") {
            Some(class) => class.text().into_owned(),
            None => class.text().into_owned(),
        });
        let least = read::attribute(child, "MinInstances", U16, warnings)?.unwrap_or(0);
        let most = read::attribute(child, "MaxInstances", U16, warnings)?.unwrap_or(least.max(1));
        if least > most {
            let message =
                format!("MinInstances = {least}, but MaxInstances = {most}; expected no more");
            return Err(Problem::new(child.at(), message));
        }
        slots.slots.push(EsiSlot {
            at: child.at(),
            name: match child.attribute("SlotName") {
                Some(name) => name.to_owned(),
                None => read::name(child),
            },
            least: least as u16,
            most: most as u16,
            idents,
            classes: classes.collect(),
        });
    }
    Ok(Some(slots))
}

/// The module in each slot by default: the preset, or the first that fits where one must be.
pub(super) fn default_modules<'m>(
    slots: &EsiSlots,
    modules: &'m [EsiModule],
    warnings: &mut Warnings,
) -> Vec<Option<&'m EsiModule>> {
    let mut all = Vec::new();
    for slot in &slots.slots {
        let preset = slot.idents.iter().find(|(_, preset)| *preset).map(|(ident, _)| *ident);
        let count = match preset {
            Some(_) => slot.least.max(1),
            None => slot.least,
        };
        let find = |ident| modules.iter().find(|module| module.ident == ident);
        let by_class = || modules.iter().find(|module| slot.classes.contains(&module.class));
        let found = match preset {
            Some(ident) => find(ident),
            None if count == 0 => None,
            None => slot.idents.iter().find_map(|(ident, _)| find(*ident)).or_else(by_class),
        };
        for _ in 0..count.min(MOST_MODULES) {
            match found {
                Some(module) if preset.is_none() => {
                    warnings.add(WarningKind::SlotModuleAssumed, slot.at, || {
                        format!(
                            "slot \"{}\" has {:#x}, the first that fits",
                            read::cut(&slot.name),
                            module.ident
                        )
                    });
                }
                None => warnings.add(WarningKind::SlotModuleMissing, slot.at, || {
                    format!("no module of the file fits into slot \"{}\"", read::cut(&slot.name))
                }),
                _ => {}
            }
            all.push(found);
        }
        // Places that stay empty count, since indices grow with the place.
        let empty = slot.most.min(MOST_MODULES).saturating_sub(count);
        all.extend((0..empty).map(|_| None));
        if all.len() > usize::from(MOST_MODULES) {
            break;
        }
    }
    all
}

/// Well above the longest known list.
const MOST_IN_FILE: usize = 4_096;
/// Objects 0xF030 and 0xF050 have so many entries.
const MOST_MODULES: u16 = 255;
