//! PDOs and their entries, as the file has them.

use std::collections::HashMap;

use isocat_wire::ObjectAddress;

use super::read::{self, U8, U16};
use super::slots::{self, Follows};
use super::tree::{Element, Problem};
use super::warning::{WarningKind, Warnings};

/// Which way process data go.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum Direction {
    /// RxPDO: MainDevice to SubDevice.
    Outputs,
    /// TxPDO: SubDevice to MainDevice.
    Inputs,
}

/// `RxPdo` or `TxPdo`.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct EsiPdo {
    /// Byte of the text at which it stands.
    pub at: usize,
    /// Which way.
    pub direction: Direction,
    /// Index of its mapping object.
    pub index: u16,
    /// By what its index grows.
    pub follows: Follows,
    /// Name.
    pub name: String,
    /// SyncManager that it is assigned to by default.
    pub sync_manager: Option<u8>,
    /// Entries can't be changed.
    pub fixed: bool,
    /// Must stay assigned.
    pub mandatory: bool,
    /// PDOs that may not be assigned beside it.
    pub exclude: Vec<u16>,
    /// How often its entries repeat by default; 0 if it does not oversample.
    pub oversampling: u16,
    /// From the index of an entry to that of its next repetition.
    pub oversampling_step: u16,
    /// Entries in order.
    pub entries: Vec<EsiPdoEntry>,
}

/// `Entry` of a PDO.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct EsiPdoEntry {
    /// Byte of the text at which it stands.
    pub at: usize,
    /// What it maps; `None` for padding.
    pub object: Option<ObjectAddress>,
    /// By what the index of that grows.
    pub follows: Follows,
    /// Bits in the process data: they count, whatever the type is called.
    pub bits: u16,
    /// Name.
    pub name: String,
    /// Name of its type, as written.
    pub data_type: String,
}

impl EsiPdo {
    /// Bits of all entries.
    pub fn bits(&self) -> u32 {
        self.entries.iter().map(|entry| u32::from(entry.bits)).sum()
    }
}

/// `Pdos/Pdo`: what old files define once and refer to.
#[derive(Default)]
pub(super) struct Definitions<'a>(HashMap<&'a str, Element<'a>>);

impl<'a> Definitions<'a> {
    /// Those of a file.
    pub fn of(descriptions: Element<'a>) -> Self {
        let list = descriptions.child("Pdos");
        let pdos = list.iter().flat_map(|list| list.children("Pdo"));
        Self(pdos.filter_map(|pdo| Some((pdo.attribute("RefName")?, pdo))).collect())
    }

    /// The element that has index and entries of a PDO; `None` if it is not in the file.
    fn body(&self, pdo: Element<'a>) -> Option<Element<'a>> {
        let body = match pdo.attribute("Ref") {
            Some(name) => *self.0.get(name)?,
            None => pdo,
        };
        (!body.child_text("Index").is_empty()).then_some(body)
    }
}

/// Reads the PDOs of a device or module.
pub(super) fn read<'a>(
    owner: Element<'a>,
    definitions: &Definitions<'a>,
    warnings: &mut Warnings,
) -> Result<Vec<EsiPdo>, Problem> {
    let mut all = Vec::new();
    for element in owner.elements() {
        let direction = match element.name() {
            "RxPdo" => Direction::Outputs,
            "TxPdo" => Direction::Inputs,
            _ => continue,
        };
        let Some(body) = definitions.body(element) else {
            let name = element.attribute("Ref").unwrap_or_default();
            warnings.add(WarningKind::PdoLeftOut, element.at(), || {
                format!(
                    "a PDO \"{}\" without Index: its definition is not in the file",
                    read::cut(name)
                )
            });
            continue;
        };
        all.push(pdo(element, body, direction, warnings)?);
    }
    Ok(all)
}

/// `element` says how a device has it, `body` what it is.
fn pdo(
    element: Element<'_>,
    body: Element<'_>,
    direction: Direction,
    warnings: &mut Warnings,
) -> Result<EsiPdo, Problem> {
    let (mut exclude, mut entries) = (Vec::new(), Vec::new());
    for child in body.elements() {
        match child.name() {
            "Exclude" => {
                let text = child.text();
                exclude.push(read::integer(&text, child.at(), "Exclude", U16, warnings)? as u16);
            }
            "Entry" => entries.push(entry(child, warnings)?),
            _ => {}
        }
    }
    // Channels that share a definition follow each other.
    let channel = match element.attribute("Ref") {
        Some(_) => read::attribute(element, "Chn", U8, warnings)?.unwrap_or(0) as u16,
        None => 0,
    };
    Ok(EsiPdo {
        at: element.at(),
        direction,
        index: (read::required(body, "Index", U16, warnings)? as u16).wrapping_add(channel),
        follows: slots::follows(body)?,
        name: read::name(body),
        sync_manager: read::attribute(element, "Sm", U8, warnings)?.map(|sm| sm as u8),
        fixed: read::flag(element, "Fixed")?,
        mandatory: read::flag(element, "Mandatory")?,
        exclude,
        oversampling: read::attribute(element, "OSFac", U16, warnings)?.unwrap_or(0) as u16,
        oversampling_step: read::attribute(element, "OSIndexInc", U16, warnings)?.unwrap_or(0)
            as u16,
        entries,
    })
}

fn entry(element: Element<'_>, warnings: &mut Warnings) -> Result<EsiPdoEntry, Problem> {
    let index = read::required(element, "Index", U16, warnings)? as u16;
    let sub = read::child(element, "SubIndex", U8, warnings)?.unwrap_or(0) as u8;
    Ok(EsiPdoEntry {
        at: element.at(),
        object: (index != 0).then_some(ObjectAddress::new(index, sub)),
        follows: slots::follows(element)?,
        bits: read::required(element, "BitLen", U16, warnings)? as u16,
        name: read::name(element),
        data_type: element.child_text("DataType").into_owned(),
    })
}
