//! The dictionary of an imported device: that of the description, adapted to the stack.

use isocat_descriptions::esi::{EsiObject, Purpose};
use isocat_subdevice::MAX_TRANSFER;
use isocat_sync::object;
use isocat_wire::coe::DataType;
use isocat_wire::coe::info::{Access, ObjectCode};
use isocat_wire::sii::sm_type;

use super::super::draft::{self, Area, Draft};
use super::{DC_SUBORDINATED, DC_SYNC0, DC_SYNC1, FREE_RUN_AND_SM, Import, SM_SYNCHRONOUS};

impl Import<'_> {
    /// The objects of the file, except those that follow from its PDOs and SyncManagers: their
    /// defaults in files are mostly those from before the firmware fills them in.
    pub(super) fn objects(&mut self, areas: [&Option<Area>; 2]) -> Vec<draft::Object> {
        let pdos = |index| {
            areas.into_iter().flatten().flat_map(|area| &area.pdos).any(|pdo| pdo.index == index)
        };
        let further = areas.into_iter().flatten().flat_map(|area| &area.further);
        let further: Vec<u16> = further.map(draft::Share::assignment).collect();
        let mut all = Vec::new();
        let mut unfit = Vec::new();
        for object in &self.device.profile.objects {
            let follows = matches!(
                object.index,
                object::SM_COMMUNICATION_TYPE
                    | object::OUTPUT_ASSIGNMENT
                    | object::INPUT_ASSIGNMENT
                    | 0x1018
            ) || further.contains(&object.index);
            let empty = matches!(object.index, 0x1000 | 0x1008..=0x100A)
                && object.entries.iter().all(|entry| entry.default.is_empty());
            if follows || empty || pdos(object.index) {
                continue;
            }
            match fit(object) {
                Some(object) => all.push(object),
                None => unfit.push(format!("0x{:04X}", object.index)),
            }
        }
        if !unfit.is_empty() {
            let why = "longer than an SDO of the stack can carry, or without sub-index 0";
            self.assume("objects left out", unfit.join(" "), why);
        }
        all.push(self.sync_manager_types());
        self.announce(&mut all);
        self.open_for_commands(&mut all);
        all
    }

    /// 0x1C00 from the purpose of each SyncManager.
    fn sync_manager_types(&self) -> draft::Object {
        let at = self.device.at;
        let count = self.device.sync_managers.len();
        let mut entries = vec![entry(at, 0, "Number of SyncManagers", 0, vec![count as u8])];
        for (number, sm) in (1..).zip(&self.device.sync_managers) {
            let kind = match sm.purpose {
                Purpose::MailboxOut => sm_type::MAILBOX_OUT,
                Purpose::MailboxIn => sm_type::MAILBOX_IN,
                Purpose::Outputs => sm_type::OUTPUTS,
                Purpose::Inputs => sm_type::INPUTS,
                Purpose::Window(_) => sm_type::UNUSED,
            };
            let name = format!("SyncManager {}", number - 1);
            entries.push(entry(at, number, &name, 8 + 8 * u32::from(number), vec![kind]));
        }
        draft::Object {
            at,
            index: object::SM_COMMUNICATION_TYPE,
            name: "SyncManager communication type".to_owned(),
            code: ObjectCode::ARRAY,
            data_type: DataType::UNSIGNED8,
            entries,
            contradiction: None,
        }
    }

    /// Adds to 0x1C32:04 and 0x1C33:04 the types that the chosen OpMode needs. If the file's
    /// defaults lack them, the OpMode is trusted: firmware fills such defaults in.
    fn announce(&mut self, objects: &mut [draft::Object]) {
        let Some(mode) = self.mode else { return };
        let needed = match (mode.sync0(), mode.sync1()) {
            (false, false) => return self.announce_without_sync(objects),
            (true, false) => DC_SYNC0,
            (_, true) => DC_SYNC0 | DC_SYNC1 | DC_SUBORDINATED,
        };
        if mode.sync1() {
            self.types_by_sync_unit(objects);
        }
        for index in [object::OUTPUT_PARAMETER, object::INPUT_PARAMETER] {
            let Some(object) = objects.iter_mut().find(|object| object.index == index) else {
                continue;
            };
            let sub = object::sub::SUPPORTED_TYPES;
            let Some(entry) = object.entries.iter_mut().find(|entry| entry.sub == sub) else {
                continue;
            };
            let stated = match entry.default[..] {
                [low, high] => u16::from_le_bytes([low, high]),
                [] => 0,
                _ => continue,
            };
            if stated & needed == needed {
                continue;
            }
            entry.default = (stated | needed).to_le_bytes().to_vec();
            let item = format!("0x{index:04X}:{sub:02X}");
            let value = format!("{:#06x}", stated | needed);
            let why = match stated {
                0 => "the description states none; its OpMode needs it".to_owned(),
                _ => format!("{stated:#06x} in the description lacks what its OpMode needs"),
            };
            self.assume(&item, value, &why);
        }
    }

    /// Adds SM-synchronous to the types of a device that announces neither Free Run nor
    /// SM-synchronous, but has an OpMode without SYNC.
    fn announce_without_sync(&mut self, objects: &mut [draft::Object]) {
        for index in [object::OUTPUT_PARAMETER, object::INPUT_PARAMETER] {
            let sub = object::sub::SUPPORTED_TYPES;
            let Some(entry) = entry_of(objects, index, sub) else { continue };
            let [low, high] = entry.default[..] else { continue };
            let stated = u16::from_le_bytes([low, high]);
            if stated == 0 || stated & FREE_RUN_AND_SM != 0 {
                continue;
            }
            let value = stated | SM_SYNCHRONOUS;
            entry.default = value.to_le_bytes().to_vec();
            let why = format!(
                "{stated:#06x} in the description has no type without SYNC; its OpMode needs one"
            );
            self.assume(&format!("0x{index:04X}:{sub:02X}"), format!("{value:#06x}"), &why);
        }
    }

    /// With SYNC1 the two types differ. If only one of them can be written, writing it alone would
    /// select another mode. Then neither is written, and the device follows its SYNC unit.
    fn types_by_sync_unit(&mut self, objects: &mut [draft::Object]) {
        let sub = object::sub::SYNC_TYPE;
        let both = [object::OUTPUT_PARAMETER, object::INPUT_PARAMETER];
        let writable = both.map(|index| {
            entry_of(objects, index, sub).map(|entry| entry.access.has(Access::WRITE_PREOP))
        });
        let ([Some(true), Some(false)] | [Some(false), Some(true)]) = writable else { return };
        for index in both {
            let Some(entry) = entry_of(objects, index, sub) else { continue };
            if entry.access.has_any(Access::WRITE) {
                entry.access = Access::READ;
                let why = "the other type can't be written; the device goes by its SYNC unit";
                self.assume(&format!("0x{index:04X}:{sub:02X} access"), "read only", why);
            }
        }
    }

    /// Makes mapping entries writable if the file says that mappings can be written.
    pub(super) fn open_mapping(&self, draft: &mut Draft<'_>) {
        let coe = self.device.mailbox.as_ref().and_then(|mailbox| mailbox.coe.as_ref());
        if !coe.is_some_and(|coe| coe.pdo_config) {
            return;
        }
        for pdo in self.device.pdos.iter().filter(|pdo| !pdo.fixed) {
            let found = draft.objects.iter_mut().find(|object| object.index == pdo.index);
            for entry in found.into_iter().flat_map(|object| &mut object.entries) {
                entry.access = entry.access.with(Access::WRITE_PREOP);
            }
        }
    }
}

fn entry_of(objects: &mut [draft::Object], index: u16, sub: u8) -> Option<&mut draft::Entry> {
    let object = objects.iter_mut().find(|object| object.index == index)?;
    object.entries.iter_mut().find(|entry| entry.sub == sub)
}

/// An object as the stack supports it; `None` if it does not.
fn fit(object: &EsiObject) -> Option<draft::Object> {
    let mut entries: Vec<draft::Entry> = Vec::new();
    let single = object.entries.len() == 1;
    let mut free = 0;
    for found in object.entries.iter().filter(|entry| entry.bits > 0) {
        let count = found.sub == 0 && !single;
        // Some files give the count the 16 bits that complete access has for it.
        if count && !matches!(found.bits, 8 | 16) {
            return None;
        }
        let most = if count { 1 } else { usize::MAX };
        let default: Vec<u8> = found.default.iter().copied().take(most).collect();
        // Offsets that overlap are no layout; then one follows the other.
        let offset = found.offset.max(free);
        let bits = if found.sub == 0 { found.bits.max(16) } else { found.bits };
        free = offset + u32::from(bits);
        entries.push(draft::Entry {
            at: object.at,
            sub: found.sub,
            name: super::super::sii::cut(&found.name).to_owned(),
            data_type: if count { DataType::UNSIGNED8 } else { found.data_type },
            bits: if count { 8 } else { found.bits },
            offset,
            access: found.access,
            written: written(&default),
            default,
        });
    }
    let first = entries.first()?;
    let long = entries.iter().any(|entry| usize::from(entry.bits.div_ceil(8)) > MAX_TRANSFER);
    if first.sub != 0 || long || free.div_ceil(8) as usize > MAX_TRANSFER {
        return None;
    }
    Some(draft::Object {
        at: object.at,
        index: object.index,
        name: super::super::sii::cut(&object.name).to_owned(),
        code: object.code,
        data_type: object.data_type,
        entries,
        contradiction: None,
    })
}

pub(super) fn written(bytes: &[u8]) -> String {
    let number = bytes.iter().take(8).rev().fold(0u64, |sum, byte| sum << 8 | u64::from(*byte));
    format!("{number:#x}")
}

fn entry(at: usize, sub: u8, name: &str, offset: u32, default: Vec<u8>) -> draft::Entry {
    draft::Entry {
        at,
        sub,
        name: name.to_owned(),
        data_type: DataType::UNSIGNED8,
        bits: 8,
        offset,
        access: Access::READ,
        written: written(&default),
        default,
    }
}
