//! Modules of modular devices.

use super::dictionary::{self, EsiObject};
use super::mailbox::{self, InitCommand};
use super::pdo::{self, EsiPdo};
use super::read::{self, U16, U32};
use super::tree::{Element, Problem};
use super::warning::Warnings;

/// `Modules/Module`.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct EsiModule {
    /// Byte offset in the text of the file in [`EsiModule::file`].
    pub at: usize,
    /// Its file, if that is another one than the device's.
    pub file: Option<String>,
    /// Vendor id, as in the file.
    pub vendor_id: u32,
    /// `Type@ModuleIdent`.
    pub ident: u32,
    /// `Type@ModuleClass`.
    pub class: String,
    /// Type name.
    pub type_name: String,
    /// Name.
    pub name: String,
    /// Number of the group with its process data (`Type@ModulePdoGroup`).
    pub pdo_group: u16,
    /// Its process data.
    pub pdos: Vec<EsiPdo>,
    /// Its downloads at start.
    pub commands: Vec<InitCommand>,
    /// Its objects.
    pub objects: Vec<EsiObject>,
    /// Names of the OpModes for which it is made (`DcOpModeName`); empty for all of them.
    pub op_modes: Vec<String>,
}

/// A module at a place of a device.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct ModuleAt<'m> {
    /// Number of the place, from 0.
    pub place: u16,
    /// The module.
    pub module: &'m EsiModule,
}

/// Reads the modules below `Modules`; one that cannot be read goes to `refused`. `left` is the
/// number of dictionary entries that the file may still have.
pub(super) fn modules(
    list: Element<'_>,
    vendor_id: u32,
    left: &mut usize,
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
        match module(element, left, warnings) {
            Ok(module) => all.push(EsiModule { vendor_id, ..module }),
            Err(problem) => refused.push(problem),
        }
    }
    all
}

fn module(
    element: Element<'_>,
    left: &mut usize,
    warnings: &mut Warnings,
) -> Result<EsiModule, Problem> {
    let Some(kind) = element.child("Type") else {
        return Err(Problem::new(element.at(), "Module lacks Type; expected one with ModuleIdent"));
    };
    let ident = read::attribute(kind, "ModuleIdent", U32, warnings)?;
    let coe = element.child("Mailbox").and_then(|mailbox| mailbox.child("CoE"));
    Ok(EsiModule {
        at: element.at(),
        file: None,
        vendor_id: 0,
        ident: ident.ok_or_else(|| {
            Problem::new(kind.at(), "Type lacks ModuleIdent; expected a number such as #x100")
        })? as u32,
        class: kind.attribute("ModuleClass").unwrap_or_default().trim().to_owned(),
        type_name: kind.text().into_owned(),
        name: read::name(element),
        pdo_group: read::attribute(kind, "ModulePdoGroup", U16, warnings)?.unwrap_or(0) as u16,
        pdos: pdo::read(element, &pdo::Definitions::default(), warnings)?,
        commands: coe.map_or(Ok(Vec::new()), |coe| mailbox::commands(coe, warnings))?,
        objects: dictionary::read(element, left, warnings)?.objects,
        op_modes: element.children("DcOpModeName").map(|name| name.text().into_owned()).collect(),
    })
}

/// Well above the longest known list.
const MOST_IN_FILE: usize = 4_096;
