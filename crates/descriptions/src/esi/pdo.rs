//! PDOs and their entries, as in the file.

use std::collections::HashMap;

use isocat_wire::ObjectAddress;

use super::read::{self, U8, U16};
use super::slots::{self, Follows};
use super::tree::{Element, Problem};
use super::warning::{WarningKind, Warnings};

/// Direction of process data.
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
    /// Byte offset in the text.
    pub at: usize,
    /// Its direction.
    pub direction: Direction,
    /// Index of its mapping object.
    pub index: u16,
    /// Increments of its index.
    pub follows: Follows,
    /// Name.
    pub name: String,
    /// SyncManager to which it is assigned by default.
    pub sync_manager: Option<u8>,
    /// Whether its entries cannot be changed.
    pub fixed: bool,
    /// Whether it must stay assigned.
    pub mandatory: bool,
    /// PDOs that must not be assigned together with it.
    pub exclude: Vec<u16>,
    /// Default number of repetitions of its entries; 0 without oversampling.
    pub oversampling: u16,
    /// Index distance of an entry and its next repetition.
    pub oversampling_step: u16,
    /// Entries in order.
    pub entries: Vec<EsiPdoEntry>,
}

/// `Entry` of a PDO.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct EsiPdoEntry {
    /// Byte offset in the text.
    pub at: usize,
    /// The mapped object; `None` for padding.
    pub object: Option<ObjectAddress>,
    /// Increments of its index.
    pub follows: Follows,
    /// Bits in the process data; they are used, whatever the type's name is.
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

/// `Pdos/Pdo`: definitions that old files make once and refer to.
#[derive(Default)]
pub(super) struct Definitions<'a>(HashMap<&'a str, Element<'a>>);

impl<'a> Definitions<'a> {
    /// The definitions of a file.
    pub fn of(descriptions: Element<'a>) -> Self {
        let list = descriptions.child("Pdos");
        let pdos = list.iter().flat_map(|list| list.children("Pdo"));
        Self(pdos.filter_map(|pdo| Some((pdo.attribute("RefName")?, pdo))).collect())
    }

    /// The element with index and entries of a PDO; `None` if it is not in the file.
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

/// Reads a PDO: `element` has its assignment, `body` its definition.
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
    // Channels that share a definition have consecutive indices.
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
