//! The mailbox: its protocols, and the writes at start.

use std::ops::RangeInclusive;

use isocat_wire::ObjectAddress;
use isocat_wire::soe::Idn;

use super::read::{self, U8, U16};
use super::slots::{self, Follows};
use super::tree::{Element, Problem};
use super::warning::Warnings;

/// `Device/Mailbox`.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct EsiMailbox {
    /// Whether it repeats a lost answer on request (`DataLinkLayer`).
    pub repeats: bool,
    /// Protocols in the bits of SII word 0x1C: 0 AoE, 1 EoE, 2 CoE, 3 FoE, 4 SoE, 5 VoE.
    pub protocols: u16,
    /// CoE, if supported.
    pub coe: Option<EsiCoe>,
    /// SoE, if supported.
    pub soe: Option<EsiSoe>,
    /// `InitCmd`s of the other protocols, in order. Their content is not read.
    pub further: Vec<FurtherCommand>,
}

/// An `InitCmd` of AoE, EoE, FoE or VoE.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct FurtherCommand {
    /// Byte offset in the text.
    pub at: usize,
    /// Name of the protocol, such as `EoE`.
    pub protocol: String,
    /// Transitions such as `PS`, as written.
    pub transitions: Vec<String>,
}

/// `Mailbox/SoE`.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct EsiSoe {
    /// Number of drives (`ChannelCount`); 1 if it is not stated.
    pub drives: u8,
    /// Values of parameters at start, in order.
    pub commands: Vec<IdnCommand>,
}

/// `InitCmd` of SoE: a parameter of a drive that a MainDevice writes at a transition.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct IdnCommand {
    /// Byte offset in the text.
    pub at: usize,
    /// Transitions such as `PS`, as written.
    pub transitions: Vec<String>,
    /// Number of the drive (`Chn`), 0 to 7.
    pub drive: u8,
    /// The parameter.
    pub idn: Idn,
    /// Bytes in wire order; a list begins with its lengths.
    pub data: Vec<u8>,
    /// Description.
    pub comment: String,
}

/// `Mailbox/CoE`.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct EsiCoe {
    /// Whether it describes its objects.
    pub sdo_info: bool,
    /// Whether 0x1C12 and 0x1C13 can be written.
    pub pdo_assign: bool,
    /// Whether mapping objects can be written.
    pub pdo_config: bool,
    /// Whether the mapping must be read from the device.
    pub pdo_upload: bool,
    /// Whether it transfers whole objects.
    pub complete_access: bool,
    /// Whether it transfers in segments.
    pub segmented_sdo: bool,
    /// Downloads at start, in order.
    pub commands: Vec<InitCommand>,
}

/// `InitCmd`: a download that a MainDevice makes at a transition.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct InitCommand {
    /// Byte offset in the text.
    pub at: usize,
    /// Transitions such as `PS`, as written.
    pub transitions: Vec<String>,
    /// The entry.
    pub object: ObjectAddress,
    /// Increments of its index.
    pub follows: Follows,
    /// Bytes in wire order.
    pub data: Vec<u8>,
    /// Whether the whole object is written.
    pub complete_access: bool,
    /// Whether the configuration tool replaces the value.
    pub adapts: bool,
}

/// Reads the mailbox of a device.
pub(super) fn read(
    device: Element<'_>,
    warnings: &mut Warnings,
) -> Result<Option<EsiMailbox>, Problem> {
    let Some(element) = device.child("Mailbox") else { return Ok(None) };
    let mut mailbox =
        EsiMailbox { repeats: read::flag(element, "DataLinkLayer")?, ..EsiMailbox::default() };
    for child in element.elements() {
        let Some(bit) = PROTOCOLS.iter().position(|name| *name == child.name()) else { continue };
        mailbox.protocols |= 1 << bit;
        match child.name() {
            "CoE" => mailbox.coe = Some(coe(child, warnings)?),
            "SoE" => mailbox.soe = Some(soe(child, warnings)?),
            name => {
                mailbox.further.extend(child.children("InitCmd").map(|command| FurtherCommand {
                    at: command.at(),
                    protocol: name.to_owned(),
                    transitions: transitions(command),
                }))
            }
        }
    }
    Ok(Some(mailbox))
}

fn coe(element: Element<'_>, warnings: &mut Warnings) -> Result<EsiCoe, Problem> {
    Ok(EsiCoe {
        sdo_info: read::flag(element, "SdoInfo")?,
        pdo_assign: read::flag(element, "PdoAssign")?,
        pdo_config: read::flag(element, "PdoConfig")?,
        pdo_upload: read::flag(element, "PdoUpload")?,
        complete_access: read::flag(element, "CompleteAccess")?,
        segmented_sdo: read::flag(element, "SegmentedSdo")?,
        commands: commands(element, warnings)?,
    })
}

/// The `InitCmd`s of a CoE element.
pub(super) fn commands(
    coe: Element<'_>,
    warnings: &mut Warnings,
) -> Result<Vec<InitCommand>, Problem> {
    let mut all = Vec::new();
    for element in coe.children("InitCmd") {
        let index = read::required(element, "Index", U16, warnings)? as u16;
        let sub = read::required(element, "SubIndex", U8, warnings)? as u8;
        let data = element.child("Data");
        all.push(InitCommand {
            at: element.at(),
            transitions: transitions(element),
            object: ObjectAddress::new(index, sub),
            follows: slots::follows(element)?,
            data: read::bytes(element, "Data")?.unwrap_or_default(),
            complete_access: read::flag(element, "CompleteAccess")?,
            adapts: data.map_or(Ok(false), |data| read::flag(data, "AdaptAutomatically"))?,
        });
    }
    Ok(all)
}

fn soe(element: Element<'_>, warnings: &mut Warnings) -> Result<EsiSoe, Problem> {
    let drives = read::attribute(element, "ChannelCount", DRIVES, warnings)?.unwrap_or(1);
    let mut commands = Vec::new();
    for element in element.children("InitCmd") {
        let drive = read::attribute(element, "Chn", 0..=DRIVES.end() - 1, warnings)?.unwrap_or(0);
        let idn = read::required(element, "IDN", U16, warnings)?;
        commands.push(IdnCommand {
            at: element.at(),
            transitions: transitions(element),
            drive: drive as u8,
            idn: Idn(idn as u16),
            data: read::bytes(element, "Data")?.unwrap_or_default(),
            comment: element.child_text("Comment").trim().to_owned(),
        });
    }
    Ok(EsiSoe { drives: drives as u8, commands })
}

fn transitions(command: Element<'_>) -> Vec<String> {
    command.children("Transition").map(|transition| transition.text().into_owned()).collect()
}

/// Drives of a SubDevice: SoE has three bits for their number.
const DRIVES: RangeInclusive<i64> = 1..=8;
/// Names of the protocols, by their bit.
pub(super) const PROTOCOLS: [&str; 6] = ["AoE", "EoE", "CoE", "FoE", "SoE", "VoE"];
