//! A device with modules in its slots, as one device that includes their parts with the indices of
//! their places.

use std::borrow::Cow;
use std::collections::{BTreeMap, HashSet};

use isocat_wire::ObjectAddress;
use isocat_wire::coe::DataType;
use isocat_wire::coe::info::{Access, ObjectCode};

use super::device::{self, EsiDevice};
use super::dictionary::{EsiEntry, EsiObject};
use super::mailbox::InitCommand;
use super::modules::{EsiModule, ModuleAt};
use super::pdo::{Direction, EsiPdo, EsiPdoEntry};
use super::slots::{EsiPlace, EsiSlots, Follows};
use super::warning::{WarningKind, Warnings};
use super::{EsiFile, read};

/// A module in a device.
#[derive(Clone, PartialEq, Eq, Hash, Debug)]
pub struct FittedModule {
    /// Number of its place, from 0.
    pub place: u16,
    /// Its ident.
    pub ident: u32,
    /// Its type.
    pub type_name: String,
    /// Names of the OpModes for which it is made; empty for all of them.
    pub op_modes: Vec<String>,
}

impl EsiFile {
    /// A device with modules in its slots. It includes their PDOs, downloads and objects,
    /// [`EsiDevice::modules`] lists them, and it has no [`EsiDevice::slots`] any more.
    ///
    /// `modules` has each place once, ascending, as [`EsiFile::choose_modules`] returns them.
    pub fn fitted(&self, device: &EsiDevice, modules: &[ModuleAt<'_>]) -> EsiDevice {
        let mut warnings = Warnings::default();
        let fitted = fit(device, modules, &mut warnings);
        self.with_warnings(device, fitted, warnings)
    }

    /// The same with the default modules; a device without slots is unchanged.
    pub fn with_default_modules<'d>(&self, device: &'d EsiDevice) -> Cow<'d, EsiDevice> {
        let Some(slots) = &device.slots else { return Cow::Borrowed(device) };
        let mut warnings = Warnings::default();
        let modules = slots.default_modules(&self.modules, &mut warnings);
        let fitted = fit(device, &modules, &mut warnings);
        Cow::Owned(self.with_warnings(device, fitted, warnings))
    }

    /// Replaces the doubts about the default modules by those about these modules.
    fn with_warnings(
        &self,
        device: &EsiDevice,
        mut fitted: EsiDevice,
        mut found: Warnings,
    ) -> EsiDevice {
        device::check_image(&fitted, &fitted.pdos, &mut found);
        let other = device.warnings.iter().filter(|warning| !warning.kind.is_of_process_data());
        fitted.warnings = other.cloned().chain(found.0).collect();
        fitted
    }
}

fn fit(device: &EsiDevice, modules: &[ModuleAt<'_>], w: &mut Warnings) -> EsiDevice {
    let Some(slots) = &device.slots else { return device.clone() };
    let mut fitted = EsiDevice { pdos: pdos(device, slots, modules, w), ..device.clone() };
    fitted.slots = None;
    fitted.modules = modules
        .iter()
        .map(|ModuleAt { place, module }| FittedModule {
            place: *place,
            ident: module.ident,
            type_name: module.type_name.clone(),
            op_modes: module.op_modes.clone(),
        })
        .collect();
    // Without CoE there is neither a dictionary nor a download.
    let Some(coe) = fitted.mailbox.as_mut().and_then(|mailbox| mailbox.coe.as_mut()) else {
        return fitted;
    };
    let mut room = MOST_BYTES;
    let placed = placed(slots, modules);
    let commands = commands(&placed, &mut room, w);
    coe.commands.extend(commands);
    add_objects(&mut fitted.profile.objects, &placed, &mut room, w);
    let idents = idents(modules);
    if !idents.is_empty() {
        let listed = coe.commands.iter().any(|command| command.object.index == CONFIGURED);
        let object = fitted.profile.objects.iter().find(|object| object.index == CONFIGURED);
        let writes = object.is_some_and(|object| object.entries.iter().any(is_written));
        if !listed && (slots.download_idents || writes) {
            let list = configured(slots, object, &idents);
            // The objects for the modules' own downloads exist after the list is written.
            coe.commands.splice(0..0, list);
        }
        detect(&mut fitted.profile.objects, slots, &idents);
    }
    fitted
}

/// Each module with its place.
fn placed<'p>(slots: &'p EsiSlots, modules: &[ModuleAt<'p>]) -> Vec<(EsiPlace<'p>, &'p EsiModule)> {
    let places: Vec<_> = slots.places().collect();
    let find = |at: &ModuleAt<'p>| Some((*places.get(usize::from(at.place))?, at.module));
    modules.iter().filter_map(find).collect()
}

/// Place of a module's part in the text of the device's file.
fn place_of(module: &EsiModule, place: EsiPlace<'_>, at: usize) -> usize {
    match module.file {
        Some(_) => place.slot.at,
        None => at,
    }
}

/// The PDOs of the device and of its modules, in the order of their groups.
pub(super) fn pdos(
    device: &EsiDevice,
    slots: &EsiSlots,
    modules: &[ModuleAt<'_>],
    w: &mut Warnings,
) -> Vec<EsiPdo> {
    let mut taken: HashSet<u16> = device.pdos.iter().map(|pdo| pdo.index).collect();
    let mut groups = BTreeMap::from([(device.pdo_group, device.pdos.clone())]);
    let mut entries = 0;
    for (place, module) in placed(slots, modules) {
        for pdo in &module.pdos {
            let at = place_of(module, place, pdo.at);
            entries += pdo.entries.len();
            if entries > MOST_ENTRIES {
                w.add(WarningKind::PdoLeftOut, at, || {
                    format!("the modules have more than {MOST_ENTRIES} entries of process data")
                });
                return grouped(groups, slots, &mut taken, w);
            }
            let index = place.pdo(pdo.index, pdo.follows);
            if !taken.insert(index) {
                w.add(WarningKind::ModuleIndexRepeated, at, || {
                    let (name, number) = (read::cut(&module.type_name), place.number);
                    format!("PDO 0x{index:04X} of \"{name}\" at place {number} stands before, too")
                });
                continue;
            }
            let mut pdo = EsiPdo { at, index, ..pdo.clone() };
            for entry in &mut pdo.entries {
                entry.at = place_of(module, place, entry.at);
                if let Some(object) = &mut entry.object {
                    object.index = place.object(object.index, entry.follows);
                }
            }
            groups.entry(module.pdo_group).or_default().push(pdo);
        }
    }
    grouped(groups, slots, &mut taken, w)
}

/// The groups in their order, each with its padding before.
fn grouped(
    groups: BTreeMap<u16, Vec<EsiPdo>>,
    slots: &EsiSlots,
    taken: &mut HashSet<u16>,
    w: &mut Warnings,
) -> Vec<EsiPdo> {
    let mut all: Vec<EsiPdo> = Vec::new();
    for (number, pdos) in groups {
        let group = slots.pdo_groups.get(usize::from(number)).copied().unwrap_or_default();
        let alignment = 8 * u32::from(group.alignment.max(1));
        let mut managers: Vec<_> =
            pdos.iter().filter_map(|pdo| Some((pdo.direction, pdo.sync_manager?))).collect();
        managers.dedup();
        for (at, &(direction, manager)) in managers.iter().enumerate() {
            if managers[..at].contains(&(direction, manager)) {
                continue;
            }
            let before = all
                .iter()
                .filter(|pdo| pdo.direction == direction && pdo.sync_manager == Some(manager));
            let bits: u32 = before.map(EsiPdo::bits).sum();
            let fill = bits.next_multiple_of(alignment) - bits;
            if fill == 0 {
                continue;
            }
            let index = match direction {
                Direction::Outputs => group.rx_pdo,
                Direction::Inputs => group.tx_pdo,
            };
            match index.filter(|index| taken.insert(*index)) {
                Some(index) => all.push(filling(slots.at, direction, manager, index, fill as u16)),
                None => w.add(WarningKind::PdoGroupUnaligned, slots.at, || {
                    format!(
                        "group {number} of PDOs in SyncManager {manager} would begin {fill} bits later, \
                         but no free PDO is named that fills them"
                    )
                }),
            }
        }
        all.extend(pdos);
    }
    all
}

fn filling(at: usize, direction: Direction, manager: u8, index: u16, bits: u16) -> EsiPdo {
    let entry = EsiPdoEntry {
        at,
        object: None,
        follows: Follows::default(),
        bits,
        name: String::new(),
        data_type: String::new(),
    };
    EsiPdo {
        at,
        direction,
        index,
        follows: Follows::default(),
        name: "Alignment".to_owned(),
        sync_manager: Some(manager),
        fixed: true,
        mandatory: true,
        exclude: Vec::new(),
        oversampling: 0,
        oversampling_step: 0,
        entries: vec![entry],
    }
}

/// The downloads of modules.
fn commands(
    placed: &[(EsiPlace<'_>, &EsiModule)],
    room: &mut usize,
    w: &mut Warnings,
) -> Vec<InitCommand> {
    let mut all = Vec::new();
    for (place, module) in placed {
        for command in &module.commands {
            let at = place_of(module, *place, command.at);
            if !take(room, command.data.len(), at, w) {
                return all;
            }
            let object = ObjectAddress {
                index: place.object(command.object.index, command.follows),
                ..command.object
            };
            all.push(InitCommand { at, object, ..command.clone() });
        }
    }
    all
}

/// Merges the objects of modules into those of the device, ascending. The module's definition of an
/// object takes precedence over that of the device, which may be for tools without support of
/// modules. The communication area stays that of the device.
fn add_objects(
    all: &mut Vec<EsiObject>,
    placed: &[(EsiPlace<'_>, &EsiModule)],
    room: &mut usize,
    w: &mut Warnings,
) {
    let mut added: Vec<EsiObject> = Vec::new();
    let mut indices: HashSet<u16> = HashSet::new();
    'modules: for (place, module) in placed {
        for object in &module.objects {
            let at = place_of(module, *place, object.at);
            let bytes = object.entries.iter().map(|entry| entry.default.len() + ENTRY).sum();
            if !take(room, bytes, at, w) {
                break 'modules;
            }
            let index = place.object(object.index, object.follows);
            if !indices.insert(index) {
                w.add(WarningKind::ModuleIndexRepeated, at, || {
                    let (name, number) = (read::cut(&module.type_name), place.number);
                    format!(
                        "object 0x{index:04X} of \"{name}\" at place {number} stands before, too"
                    )
                });
                continue;
            }
            added.push(EsiObject { at, index, ..object.clone() });
        }
    }
    let own: HashSet<u16> = all.iter().map(|object| object.index).collect();
    added.retain(|object| object.index >= MANUFACTURERS || !own.contains(&object.index));
    all.retain(|object| object.index < MANUFACTURERS || !indices.contains(&object.index));
    all.extend(added);
    all.sort_by_cached_key(|object| u64::from(object.index));
}

/// Whether this many further bytes fit; adds a warning if they do not.
fn take(room: &mut usize, bytes: usize, at: usize, w: &mut Warnings) -> bool {
    match room.checked_sub(bytes + ENTRY) {
        Some(left) => *room = left,
        None => {
            w.add(WarningKind::ModulesTooLarge, at, || {
                format!("objects and downloads of all modules take more than {MOST_BYTES} bytes")
            });
            return false;
        }
    }
    true
}

/// The idents by place, up to the last place with a module; 0 for an empty one.
fn idents(modules: &[ModuleAt<'_>]) -> Vec<u32> {
    let length = modules.iter().map(|at| usize::from(at.place) + 1).max().unwrap_or(0);
    let mut idents = vec![0; length];
    for at in modules {
        idents[usize::from(at.place)] = at.module.ident;
    }
    idents
}

fn is_written(entry: &EsiEntry) -> bool {
    entry.sub > 0 && entry.access.has_any(Access::WRITE)
}

/// The downloads of the list of modules: its entries, then their number if it can be written.
fn configured(slots: &EsiSlots, object: Option<&EsiObject>, idents: &[u32]) -> Vec<InitCommand> {
    let command = |sub, data| InitCommand {
        at: slots.at,
        transitions: vec![slots.download_at.clone()],
        object: ObjectAddress::new(CONFIGURED, sub),
        follows: Follows::default(),
        data,
        complete_access: false,
        adapts: false,
    };
    let entries = (1..=u8::MAX).zip(idents);
    let mut all: Vec<_> =
        entries.map(|(sub, ident)| command(sub, ident.to_le_bytes().to_vec())).collect();
    let count = object.and_then(|object| object.entries.first());
    if count.is_none_or(|count| count.sub == 0 && count.access.has_any(Access::WRITE)) {
        all.push(command(0, vec![idents.len() as u8]));
    }
    all
}

/// Sets the modules that the device detects in its slots. A device with a configured list also
/// needs the detected one.
fn detect(objects: &mut Vec<EsiObject>, slots: &EsiSlots, idents: &[u32]) {
    let place = objects.partition_point(|object| object.index < DETECTED);
    let known = objects.get_mut(place).filter(|object| object.index == DETECTED);
    let Some(object) = known else {
        if slots.download_idents {
            objects.insert(place, detected(slots.at, idents));
        }
        return;
    };
    for entry in &mut object.entries {
        let value = match entry.sub {
            0 => idents.len() as u32,
            sub => idents.get(usize::from(sub) - 1).copied().unwrap_or(0),
        };
        let length = usize::from(entry.bits.div_ceil(8)).min(8);
        entry.default = u64::from(value).to_le_bytes()[..length].to_vec();
    }
}

fn detected(at: usize, idents: &[u32]) -> EsiObject {
    let entry = |sub: u8, bits: u16, data_type, offset, default: Vec<u8>| EsiEntry {
        sub,
        name: format!("SubIndex {sub:03}"),
        data_type,
        bits,
        offset,
        access: Access::READ,
        default,
    };
    let count = vec![idents.len() as u8];
    let mut entries = vec![entry(0, 8, DataType::UNSIGNED8, 0, count)];
    entries.extend((1..=u8::MAX).zip(idents).map(|(sub, ident)| {
        let offset = 32 * u32::from(sub) - 16;
        entry(sub, 32, DataType::UNSIGNED32, offset, ident.to_le_bytes().to_vec())
    }));
    EsiObject {
        at,
        index: DETECTED,
        follows: Follows::default(),
        name: "Detected Module Ident List".to_owned(),
        code: ObjectCode::ARRAY,
        data_type: DataType::UNSIGNED32,
        entries,
    }
}

/// End of the communication area of the dictionary.
const MANUFACTURERS: u16 = 0x2000;
/// Configured Module Ident List (ETG.5001).
const CONFIGURED: u16 = 0xF030;
/// Detected Module Ident List.
const DETECTED: u16 = 0xF050;
/// Far above the 254 sub-indices of a mapping.
const MOST_ENTRIES: usize = 4_096;
/// Limit of the objects and downloads of a device's modules; the largest known coupler, full, has
/// less than 1 MB.
const MOST_BYTES: usize = 16 << 20;
/// Size of an entry or a download without its value.
const ENTRY: usize = 128;
