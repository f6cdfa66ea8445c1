//! Drives behind SoE: the parameters that a description mentions, and those that are written at
//! start.
//!
//! A description has no list of parameters as it has of objects. The drive has those that are
//! mentioned: in InitCmds and in the mapping of PDOs. The lists of mapped parameters (S-0-0016,
//! S-0-0024), of all parameters (S-0-0017) and the telegram type (S-0-0015) follow from that. The
//! drive has no others.

use std::collections::BTreeMap;

use isocat_descriptions::esi::{Direction, EsiPdo, IdnCommand, data_type};
use isocat_descriptions::start_up::Transition;
use isocat_subdevice::{MAX_TRANSFER, Parameter, Speaks};
use isocat_wire::mailbox::Protocol;
use isocat_wire::soe::{Attribute, Idn};

use super::super::StartupParameter;
use super::super::dictionary::{leak, leak_text};
use super::startup::early;
use super::{Doubt, DoubtKind, Import};

/// A parameter under construction.
struct Found {
    name: String,
    attribute: Attribute,
    fixed: bool,
    value: Vec<u8>,
}

type All = BTreeMap<(u8, Idn), Found>;

/// The PDOs of each SyncManager, for both directions.
type Assigned<'a> = [(Direction, &'a [(u8, Vec<EsiPdo>)]); 2];

impl Import<'_> {
    /// The protocols that the mailbox answers.
    pub(super) fn speaks(&mut self, image: Assigned<'_>) -> Speaks {
        let protocols = self.device.mailbox.as_ref().map_or(0, |mailbox| mailbox.protocols);
        if protocols & Protocol::SOE.announcement() == 0 {
            return Speaks { protocols, drives: 0, parameters: &[] };
        }
        let mut all = All::new();
        for (direction, managers) in image {
            for pdo in managers.iter().flat_map(|(_, pdos)| pdos) {
                mapped(&mut all, direction, pdo);
            }
        }
        let mut unfit = Vec::new();
        for command in self.idn_commands() {
            match of_command(&command) {
                Some(found) => {
                    all.entry((command.drive, command.idn)).or_insert(found);
                }
                None => unfit.push(named(command.drive, command.idn)),
            }
        }
        if !unfit.is_empty() {
            let words = format!(
                "SoE InitCmd {} is left out: its data are neither 1, 2, 4 or 8 bytes nor a list with its lengths in \
                 front",
                unfit.join(", ")
            );
            self.doubts.push(Doubt::new(DoubtKind::InitCommandLeftOut, words));
        }
        let said = self.device.mailbox.as_ref().and_then(|mailbox| mailbox.soe.as_ref());
        let named = all.keys().map(|(drive, _)| drive + 1).max().unwrap_or(1);
        let drives = said.map_or(1, |soe| soe.drives).max(named);
        for drive in 0..drives {
            self.add_lists(&mut all, drive);
        }
        let why = "no description has it; it follows from the PDOs and InitCmds";
        self.assume("SoE lists", "S-0-0015, S-0-0016, S-0-0017, S-0-0024", why);
        Speaks { protocols, drives, parameters: placed(all) }
    }

    /// The parameters that are written at start, those on the way to PREOP first. Omitted ones are
    /// reported.
    pub(super) fn parameters_at_start(&mut self, speaks: &Speaks) -> Vec<StartupParameter> {
        let mut all = Vec::new();
        let mut late = Vec::new();
        let mut cycles = Vec::new();
        for command in self.idn_commands() {
            let IdnCommand { drive, idn, ref data, ref comment, .. } = command;
            let has = |one: &Parameter| (one.drive, one.idn) == (drive, idn);
            if !speaks.parameters.iter().any(has) || of_command(&command).is_none() {
                continue;
            }
            if command.transitions.is_empty() {
                late.push(format!("{} (no transition)", named(drive, idn)));
            }
            for name in &command.transitions {
                let Some(transition) = early(name) else {
                    late.push(format!("{} ({name})", named(drive, idn)));
                    continue;
                };
                let parameter = StartupParameter {
                    transition,
                    drive,
                    idn,
                    data: data.clone(),
                    comment: comment.clone(),
                };
                if parameter.is_cycle() {
                    cycles.push(named(drive, idn));
                }
                all.push(parameter);
            }
        }
        if !late.is_empty() {
            let words = format!(
                "SoE InitCmd {} is left out: parameters are written on the way to SAFEOP only",
                late.join(", ")
            );
            self.doubts.push(Doubt::new(DoubtKind::InitCommandLeftOut, words));
        }
        if !cycles.is_empty() {
            let words = format!(
                "{} get the bus cycle in us, as far as it is a whole number of them, and not what the InitCmd has: \
                 the drive watches the cycle by it",
                cycles.join(", ")
            );
            self.doubts.push(Doubt::new(DoubtKind::CycleParameter, words));
        }
        all.sort_by_cached_key(|parameter| u64::from(parameter.transition != Transition::IP));
        all
    }

    /// Reports the parameters of a device without a usable mailbox, which are not written.
    pub(super) fn parameters_without_mailbox(&mut self) {
        let left_out: Vec<String> = self
            .idn_commands()
            .iter()
            .map(|command| {
                let at = command.transitions.join(", ");
                format!("{} ({at})", named(command.drive, command.idn))
            })
            .collect();
        if !left_out.is_empty() {
            let words = format!(
                "SoE InitCmd {} is left out: the description has no two SyncManagers for its mailbox",
                left_out.join(", ")
            );
            self.doubts.push(Doubt::new(DoubtKind::InitCommandLeftOut, words));
        }
    }

    fn idn_commands(&self) -> Vec<IdnCommand> {
        let soe = self.device.mailbox.as_ref().and_then(|mailbox| mailbox.soe.as_ref());
        soe.map_or(Vec::new(), |soe| soe.commands.clone())
    }

    /// Adds the parameters of every drive: its telegram type, and the lists of its parameters.
    fn add_lists(&self, all: &mut All, drive: u8) {
        let number = Attribute::of_length(2).expect("two bytes are a length of SoE");
        let known = |idn| Found {
            name: name_of(idn).to_owned(),
            attribute: number.with(Attribute::UNSIGNED),
            fixed: true,
            value: CONFIGURED.to_le_bytes().to_vec(),
        };
        for idn in [Idn::TELEGRAM_TYPE, Idn::INPUT_LIST, Idn::OUTPUT_LIST] {
            let list = idn != Idn::TELEGRAM_TYPE;
            let empty = || Found {
                attribute: number.with(Attribute::LIST).with(Attribute::IDN),
                value: list_of(&[]),
                ..known(idn)
            };
            all.entry((drive, idn)).or_insert_with(|| if list { empty() } else { known(idn) });
        }
        let own = all.keys().filter(|(of, _)| *of == drive).map(|(_, idn)| *idn);
        let mut idns: Vec<Idn> = own.chain([Idn::ALL_IDNS]).collect();
        idns.sort_by_cached_key(|idn| u64::from(idn.0));
        idns.dedup();
        // A list that is longer than a transfer would be none that can be read.
        idns.truncate((MAX_TRANSFER - 4) / 2);
        let attribute =
            number.with(Attribute::LIST).with(Attribute::IDN).with(Attribute::READ_ONLY);
        let list = Found { attribute, value: list_of(&idns), ..known(Idn::ALL_IDNS) };
        all.insert((drive, Idn::ALL_IDNS), list);
    }
}

/// Adds the mapping of a PDO: its entries, and the list of them. PDO 0x0018 is that of drive 0,
/// 0x1018 that of drive 1.
fn mapped(all: &mut All, direction: Direction, pdo: &EsiPdo) {
    let drive = (pdo.index >> 12 & 7) as u8;
    let (list, word) = match direction {
        Direction::Outputs => (Idn::OUTPUT_LIST, Idn::CONTROL_WORD),
        Direction::Inputs => (Idn::INPUT_LIST, Idn::STATUS_WORD),
    };
    let mut idns = Vec::new();
    for entry in &pdo.entries {
        let Some(object) = entry.object else { continue };
        let bytes = usize::from(entry.bits) / 8;
        let attribute = Attribute::of_length(bytes).filter(|_| entry.bits.is_multiple_of(8));
        let Some(attribute) = attribute else { continue };
        let shown = match data_type(&entry.data_type, entry.bits.into()).name() {
            Some(name) if name.starts_with("INTEGER") => Attribute::SIGNED,
            Some(name) if name.starts_with("UNSIGNED") => Attribute::UNSIGNED,
            _ => Attribute::BINARY,
        };
        let idn = Idn(object.index);
        if idn != word {
            idns.push(idn);
        }
        let found = Found {
            name: entry.name.clone(),
            attribute: attribute.with(shown).with(Attribute::READ_ONLY),
            fixed: false,
            value: vec![0; bytes],
        };
        all.entry((drive, idn)).or_insert(found);
    }
    let item = Attribute::of_length(2).expect("two bytes are a length of SoE");
    let found = Found {
        name: name_of(list).to_owned(),
        attribute: item.with(Attribute::LIST).with(Attribute::IDN),
        fixed: true,
        value: list_of(&idns),
    };
    all.insert((drive, list), found);
}

/// The parameter that an InitCmd writes; `None` if its data are not a valid SoE value.
fn of_command(command: &IdnCommand) -> Option<Found> {
    let data = &command.data;
    let late = Attribute::PROTECTED_SAFEOP.with(Attribute::PROTECTED_OP);
    let (attribute, value) = match Attribute::of_length(data.len()) {
        Some(attribute) => (attribute, vec![0; data.len()]),
        None => {
            let (&[l0, l1, m0, m1], items) = data.split_first_chunk()?;
            let most = usize::from(u16::from_le_bytes([m0, m1]).max(items.len() as u16));
            let fits = usize::from(u16::from_le_bytes([l0, l1])) == items.len();
            let usable = fits && most + 4 <= MAX_TRANSFER;
            let mut value = vec![0, 0, m0, m1];
            value[2..].copy_from_slice(&(most as u16).to_le_bytes());
            value.resize(usable.then_some(most + 4)?, 0);
            (Attribute::of_length(1)?.with(Attribute::LIST), value)
        }
    };
    let name = command.comment.clone();
    Some(Found { name, attribute: attribute.with(late), fixed: false, value })
}

/// A list of IDNs in SoE format, with its present length as maximum.
fn list_of(idns: &[Idn]) -> Vec<u8> {
    let length = (2 * idns.len() as u16).to_le_bytes();
    let items = idns.iter().flat_map(|idn| idn.0.to_le_bytes());
    length.into_iter().chain(length).chain(items).collect()
}

/// The static form of all parameters, with an offset in the value store for each.
fn placed(all: All) -> &'static [Parameter] {
    let mut store = 0;
    let place = |((drive, idn), found): ((u8, Idn), Found)| {
        let len = found.value.len() as u16;
        let at = store;
        store += len;
        Parameter {
            drive,
            idn,
            name: leak_text(super::super::sii::cut(&found.name)),
            attribute: found.attribute,
            fixed: found.fixed,
            store: at,
            len,
            default: leak(found.value),
        }
    };
    leak(all.into_iter().map(place).collect())
}

/// The name of a parameter that has none in a description.
const fn name_of(idn: Idn) -> &'static str {
    match idn {
        Idn::TELEGRAM_TYPE => "Telegram type",
        Idn::INPUT_LIST => "Configuration list of AT",
        Idn::ALL_IDNS => "IDN list of all operation data",
        _ => "Configuration list of MDT",
    }
}

fn named(drive: u8, idn: Idn) -> String {
    format!("{idn} of drive {drive}")
}

/// Telegram type with the configuration of S-0-0016 and S-0-0024.
const CONFIGURED: u16 = 7;
