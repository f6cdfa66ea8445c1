//! Downloads at start: the InitCmds of a description.

use isocat_descriptions::esi::{EsiCoe, InitCommand};
use isocat_descriptions::start_up::Transition;
use isocat_subdevice::MAX_TRANSFER;
use isocat_sync::object;
use isocat_wire::coe::DataType;
use isocat_wire::coe::info::{Access, ObjectCode};

use super::super::Startup;
use super::super::draft::{Draft, Entry, Object, Placed};
use super::objects::written;
use super::{Doubt, DoubtKind, Import};

impl Import<'_> {
    /// Makes entries of InitCmds writable in PREOP. Some files have commands for objects that their
    /// own dictionary lacks or calls read only. Firmware has them, since every configuration tool
    /// writes them.
    pub(super) fn open_for_commands(&mut self, objects: &mut Vec<Object>) {
        let mut opened = Vec::new();
        for command in self.commands() {
            let early = command.transitions.iter().any(|name| early(name).is_some());
            if !early || command.complete_access || is_assignment(&command) {
                continue;
            }
            if open(objects, &command, self.device.at) {
                opened.push(command.object.to_string());
            }
        }
        if !opened.is_empty() {
            let why = "the dictionary of the description has no such entry to write, and an InitCmd writes it";
            let opened = opened.join(" ");
            self.doubts.push(Doubt::new(
                DoubtKind::InitCommandObject,
                format!("{opened}: {why}; it is added"),
            ));
            self.assume("InitCmd objects", opened, why);
        }
    }

    /// The possible downloads, those on the way to PREOP first. Omitted ones are reported.
    pub(super) fn startup(&mut self, draft: &Draft<'_>) -> Vec<Placed<Startup>> {
        let mut all = Vec::new();
        let (mut late, mut assigning, mut unfit) = (Vec::new(), Vec::new(), Vec::new());
        for command in self.commands() {
            let InitCommand { object, ref data, complete_access, .. } = command;
            if command.transitions.is_empty() {
                late.push(format!("{object} (no transition)"));
            }
            for name in &command.transitions {
                let Some(transition) = early(name) else {
                    late.push(format!("{object} ({name})"));
                    continue;
                };
                let takes = takes(draft, &command);
                match (is_assignment(&command), takes) {
                    (true, _) => assigning.push(object.to_string()),
                    (false, false) => unfit.push(object.to_string()),
                    (false, true) => {
                        let value =
                            Startup { transition, object, data: data.clone(), complete_access };
                        all.push(Placed { at: self.device.at, value });
                    }
                }
            }
        }
        for (left_out, why) in [
            (late, "downloads are made on the way to SAFEOP only"),
            (assigning, "assignments and mappings of PDOs are the plan's"),
            (unfit, "the dictionary has no entry of this length to write"),
        ] {
            if !left_out.is_empty() {
                let left_out = left_out.join(" ");
                let words = format!("InitCmd {left_out} is left out: {why}");
                self.doubts.push(Doubt::new(DoubtKind::InitCommandLeftOut, words));
                self.assume("InitCmd left out", left_out, why);
            }
        }
        let written = all.iter().map(|one| &one.value);
        if Startup::interpolate(written) {
            let words = "0x60C2 gets the device's cycle as far as it can hold it, and not what the InitCmd has: the drive \
                         interpolates its set points over this time";
            self.doubts.push(Doubt::new(DoubtKind::CycleParameter, words.to_owned()));
        }
        self.tell_further();
        all.sort_by_cached_key(|download: &Placed<Startup>| {
            u64::from(download.value.transition != Transition::IP)
        });
        all
    }

    /// Reports InitCmds of AoE, EoE, FoE and VoE, which are not sent: a virtual SubDevice answers
    /// these protocols with an error.
    fn tell_further(&mut self) {
        let Some(mailbox) = &self.device.mailbox else { return };
        let told = mailbox.further.iter().map(|command| {
            let at = command.transitions.join(", ");
            let words = format!(
                "{} InitCmd ({at}) is left out: only those of CoE and SoE are sent",
                command.protocol
            );
            Doubt::new(DoubtKind::InitCommandLeftOut, words)
        });
        self.doubts.extend(told);
    }

    fn commands(&self) -> Vec<InitCommand> {
        self.coe().map_or(Vec::new(), |coe| coe.commands.clone())
    }

    fn coe(&self) -> Option<&EsiCoe> {
        self.device.mailbox.as_ref()?.coe.as_ref()
    }
}

/// The transition of this name, if downloads are made at it.
pub(super) fn early(name: &str) -> Option<Transition> {
    [Transition::IP, Transition::PS].into_iter().find(|at| at.to_string() == name)
}

fn is_assignment(command: &InitCommand) -> bool {
    let index = command.object.index;
    matches!(index, FIRST_ASSIGNMENT..=LAST_ASSIGNMENT)
        || matches!(index, 0x1600..=0x17FF | 0x1A00..=0x1BFF)
}

fn takes(draft: &Draft<'_>, command: &InitCommand) -> bool {
    let found = draft.objects.iter().find(|object| object.index == command.object.index);
    let entry = found.and_then(|o| o.entries.iter().find(|e| e.sub == command.object.sub));
    entry.is_some_and(|entry| {
        entry.access.has(Access::WRITE_PREOP) && (command.complete_access || fits(entry, command))
    })
}

fn fits(entry: &Entry, command: &InitCommand) -> bool {
    usize::from(entry.bits.div_ceil(8)) == command.data.len()
}

/// Opens the entry of a command if possible. Returns whether something had to be added.
fn open(objects: &mut Vec<Object>, command: &InitCommand, at: usize) -> bool {
    let sub = command.object.sub;
    let usable = (1..=MAX_TRANSFER).contains(&command.data.len());
    let Some(object) = objects.iter_mut().find(|object| object.index == command.object.index)
    else {
        // The communication area follows from the rest of the description, but for the diagnosis
        // history.
        let own = command.object.index >= 0x2000 || command.object.index == DIAGNOSIS_HISTORY;
        if own && usable {
            objects.push(new_object(command, at));
        }
        return own && usable;
    };
    if let Some(entry) = object.entries.iter_mut().find(|entry| entry.sub == sub) {
        let shut = fits(entry, command) && !entry.access.has(Access::WRITE_PREOP);
        if shut {
            entry.access = entry.access.with(Access::WRITE_PREOP);
        }
        return shut;
    }
    let Some(count) = object.entries.first_mut().filter(|first| first.sub == 0 && first.bits == 8)
    else {
        return false;
    };
    if !usable || object.code == ObjectCode::VAR {
        return false;
    }
    let most = count.default.first().copied().unwrap_or(0).max(sub);
    (count.default, count.written) = (vec![most], written(&[most]));
    let place = object.entries.partition_point(|entry| entry.sub < sub);
    object.entries.insert(place, new_entry(command, at));
    lay_out(&mut object.entries);
    true
}

fn new_object(command: &InitCommand, at: usize) -> Object {
    let mut entries = vec![new_entry(command, at)];
    let single = command.object.sub == 0;
    if !single {
        let count = vec![command.object.sub];
        entries.insert(
            0,
            Entry {
                sub: 0,
                name: "Number of entries".to_owned(),
                data_type: DataType::UNSIGNED8,
                bits: 8,
                access: Access::READ,
                written: written(&count),
                default: count,
                ..new_entry(command, at)
            },
        );
        lay_out(&mut entries);
    }
    Object {
        at,
        index: command.object.index,
        name: NAME.to_owned(),
        code: if single { ObjectCode::VAR } else { ObjectCode::RECORD },
        data_type: if single { entries[0].data_type } else { DataType::UNSIGNED8 },
        entries,
        contradiction: None,
    }
}

fn new_entry(command: &InitCommand, at: usize) -> Entry {
    let bytes = command.data.len();
    let default = vec![0; bytes];
    Entry {
        at,
        sub: command.object.sub,
        name: NAME.to_owned(),
        data_type: match bytes {
            1 => DataType::UNSIGNED8,
            2 => DataType::UNSIGNED16,
            4 => DataType::UNSIGNED32,
            8 => DataType::UNSIGNED64,
            _ => DataType::OCTET_STRING,
        },
        bits: 8 * bytes as u16,
        offset: 0,
        access: Access::READ.with(Access::WRITE_PREOP),
        written: written(&default),
        default,
    }
}

/// Places entries one behind the other, unless they are already farther apart; sub-index 0 takes 16
/// bits.
fn lay_out(entries: &mut [Entry]) {
    let mut free = 0;
    for entry in entries {
        entry.offset = entry.offset.max(free);
        let bits = if entry.sub == 0 { entry.bits.max(16) } else { entry.bits };
        free = (entry.offset + u32::from(bits)).next_multiple_of(8);
    }
}

/// The object for which files most often have a command but no entry.
const DIAGNOSIS_HISTORY: u16 = 0x10F3;
/// Name of an entry without one.
const NAME: &str = "Written at start";

/// Assignment object of SM2, the first that can have process data beside a mailbox.
const FIRST_ASSIGNMENT: u16 = object::OUTPUT_ASSIGNMENT;
/// Assignment object of SM31.
const LAST_ASSIGNMENT: u16 = 0x1C2F;
