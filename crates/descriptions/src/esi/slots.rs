//! Slots of a modular device, and their places for modules.

use super::modules::{EsiModule, ModuleAt};
use super::read::{self, U8, U16, U32};
use super::tree::{Element, Problem};
use super::warning::{WarningKind, Warnings};

/// `Device/Slots`.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct EsiSlots {
    /// Byte offset in the text.
    pub at: usize,
    /// Whether the list of modules is written to 0xF030 (`DownloadModuleIdentList`).
    pub download_idents: bool,
    /// Transition of that write: `IP`, `PS` or `SO` (`DownloadModuleListTransition`).
    pub download_at: String,
    /// Largest number of modules in all slots together (`MaxSlotCount`); `None` if not stated.
    pub most: Option<u16>,
    /// `ModulePdoGroup`s, numbered from 0.
    pub pdo_groups: Vec<EsiPdoGroup>,
    /// The slots.
    pub slots: Vec<EsiSlot>,
}

/// `Slot`: one place, or `most` places of a kind.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct EsiSlot {
    /// Byte offset in the text.
    pub at: usize,
    /// Name.
    pub name: String,
    /// Number of its group (`SlotGroup`).
    pub group: u16,
    /// Smallest number of modules.
    pub least: u16,
    /// Largest number of modules.
    pub most: u16,
    /// Increments of indices: those of the slot, or else those of all slots.
    pub increments: Increments,
    /// Modules that fit, and whether each is the preset.
    pub idents: Vec<(u32, bool)>,
    /// Classes of modules that fit.
    pub classes: Vec<ModuleClass>,
}

/// `ModuleClass` of a slot.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct ModuleClass {
    /// Name of the class.
    pub class: String,
    /// Vendor id of the modules; `None` for any.
    pub vendor_id: Option<u32>,
}

/// Increments of an index from one place, and from one group of slots, to the next.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Increments {
    /// For PDOs, by place (`SlotPdoIncrement`).
    pub pdo: u16,
    /// For objects, by place (`SlotIndexIncrement`).
    pub index: u16,
    /// For PDOs, by group (`SlotGroupPdoIncrement`).
    pub group_pdo: u16,
    /// For objects, by group (`SlotGroupIndexIncrement`).
    pub group_index: u16,
}

/// The increments that apply to an index: `DependOnSlot` and `DependOnSlotGroup` of `Index`.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default)]
pub struct Follows {
    /// Increment by place.
    pub slot: bool,
    /// Increment by group of the slot.
    pub group: bool,
}

/// `ModulePdoGroup`: modules of one group are adjacent in the process data.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct EsiPdoGroup {
    /// Alignment of its begin in bytes; 0 and 1 for none.
    pub alignment: u8,
    /// The PDO of outputs for the padding before it.
    pub rx_pdo: Option<u16>,
    /// The PDO of inputs for the padding before it.
    pub tx_pdo: Option<u16>,
}

/// A place for one module.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct EsiPlace<'d> {
    /// Its number from 0, counted through all slots.
    pub number: u16,
    /// Index of its slot in [`EsiSlots::slots`].
    pub slot_number: usize,
    /// The slot.
    pub slot: &'d EsiSlot,
}

impl EsiSlots {
    /// The places for modules, in order. The number of a slot's places is its largest number of
    /// modules.
    pub fn places(&self) -> impl Iterator<Item = EsiPlace<'_>> {
        let most = self.most.map_or(MOST_PLACES, |most| most.min(MOST_PLACES));
        let slots = self.slots.iter().enumerate();
        let all = slots.flat_map(|(slot_number, slot)| {
            (0..slot.most).map(move |_| EsiPlace { number: 0, slot_number, slot })
        });
        (0..most).zip(all).map(|(number, place)| EsiPlace { number, ..place })
    }

    /// The default modules: presets, and the first module that fits if one is required.
    pub(super) fn default_modules<'m>(
        &self,
        modules: &'m [EsiModule],
        warnings: &mut Warnings,
    ) -> Vec<ModuleAt<'m>> {
        let mut all = Vec::new();
        let mut places = self.places().peekable();
        for (slot_number, slot) in self.slots.iter().enumerate() {
            let preset = slot.idents.iter().find(|(_, preset)| *preset).map(|(ident, _)| *ident);
            let count = match preset {
                Some(_) => slot.least.max(1),
                None => slot.least,
            };
            let find = |ident| modules.iter().find(|module| module.ident == ident);
            let found = match preset {
                Some(ident) => find(ident),
                None if count == 0 => None,
                // The order of the slot's list is used first, then that of the file.
                None => slot
                    .idents
                    .iter()
                    .find_map(|(ident, _)| find(*ident))
                    .or_else(|| modules.iter().find(|module| slot.takes(module))),
            };
            let mut left = count;
            while let Some(place) = places.next_if(|place| place.slot_number == slot_number) {
                if left == 0 {
                    continue;
                }
                left -= 1;
                let name = || read::cut(&slot.name);
                match found {
                    Some(module) if preset.is_none() => {
                        warnings.add(WarningKind::SlotModuleAssumed, slot.at, || {
                            let ident = module.ident;
                            format!("slot \"{}\" has {ident:#x}, the first that fits", name())
                        });
                    }
                    None => warnings.add(WarningKind::SlotModuleMissing, slot.at, || {
                        format!("no module of the file fits into slot \"{}\"", name())
                    }),
                    _ => {}
                }
                all.extend(found.map(|module| ModuleAt { place: place.number, module }));
            }
        }
        all
    }
}

impl EsiSlot {
    /// Whether a module fits, by its ident or by its class.
    pub fn takes(&self, module: &EsiModule) -> bool {
        if self.idents.is_empty() && self.classes.is_empty() {
            return true;
        }
        let by_class = |class: &ModuleClass| {
            class.class == module.class && class.vendor_id.is_none_or(|id| id == module.vendor_id)
        };
        self.idents.iter().any(|(ident, _)| *ident == module.ident)
            || self.classes.iter().any(by_class)
    }
}

impl EsiPlace<'_> {
    /// The index of a module's object at this place.
    pub fn object(self, index: u16, follows: Follows) -> u16 {
        let Increments { index: by_place, group_index: by_group, .. } = self.slot.increments;
        self.moved(index, follows, by_place, by_group)
    }

    /// The index of a module's PDO at this place.
    pub fn pdo(self, index: u16, follows: Follows) -> u16 {
        let Increments { pdo: by_place, group_pdo: by_group, .. } = self.slot.increments;
        self.moved(index, follows, by_place, by_group)
    }

    fn moved(self, index: u16, follows: Follows, by_place: u16, by_group: u16) -> u16 {
        let steps = |follows: bool, number: u16, step: u16| match follows {
            true => number.wrapping_mul(step),
            false => 0,
        };
        index.wrapping_add(steps(follows.slot, self.number, by_place)).wrapping_add(steps(
            follows.group,
            self.slot.group,
            by_group,
        ))
    }
}

/// Reads the slots of a device.
pub(super) fn read(
    device: Element<'_>,
    warnings: &mut Warnings,
) -> Result<Option<EsiSlots>, Problem> {
    let Some(element) = device.child("Slots") else { return Ok(None) };
    let common = increments(element, Increments::default(), warnings)?;
    let mut slots = EsiSlots {
        at: element.at(),
        download_idents: read::flag(element, "DownloadModuleIdentList")?,
        // The schema has the letters of the reverse transition, by mistake.
        download_at: match element.attribute("DownloadModuleListTransition").map(str::trim) {
            None | Some("" | "SP") => "PS".to_owned(),
            Some(other) => other.to_owned(),
        },
        // Some files have 0 although there are slots.
        most: read::attribute(element, "MaxSlotCount", U16, warnings)?
            .map(|most| most as u16)
            .filter(|most| *most > 0),
        pdo_groups: Vec::new(),
        slots: Vec::new(),
    };
    for child in element.children("Slot") {
        slots.slots.push(slot(child, common, warnings)?);
    }
    for child in element.children("ModulePdoGroup") {
        let mut index = |name| read::attribute(child, name, U16, warnings);
        let (rx_pdo, tx_pdo) = (index("RxPdo")?, index("TxPdo")?);
        slots.pdo_groups.push(EsiPdoGroup {
            alignment: read::attribute(child, "Alignment", U8, warnings)?.unwrap_or(0) as u8,
            rx_pdo: rx_pdo.map(|index| index as u16),
            tx_pdo: tx_pdo.map(|index| index as u16),
        });
    }
    Ok(Some(slots))
}

fn slot(
    element: Element<'_>,
    common: Increments,
    warnings: &mut Warnings,
) -> Result<EsiSlot, Problem> {
    let mut idents = Vec::new();
    for ident in element.children("ModuleIdent") {
        let number = read::integer(&ident.text(), ident.at(), "ModuleIdent", U32, warnings)?;
        idents.push((number as u32, read::flag(ident, "Default")?));
    }
    let mut classes = Vec::new();
    for class in element.children("ModuleClass") {
        let vendor_id = read::child(class, "VendorId", U32, warnings)?;
        classes.push(ModuleClass {
            class: class.child("Class").unwrap_or(class).text().into_owned(),
            vendor_id: vendor_id.map(|id| id as u32),
        });
    }
    let least = read::attribute(element, "MinInstances", U16, warnings)?.unwrap_or(0);
    let most = read::attribute(element, "MaxInstances", U16, warnings)?.unwrap_or(least.max(1));
    if least > most {
        let message =
            format!("MinInstances = {least}, but MaxInstances = {most}; expected no more");
        return Err(Problem::new(element.at(), message));
    }
    Ok(EsiSlot {
        at: element.at(),
        name: match element.attribute("SlotName") {
            Some(name) => name.to_owned(),
            None => read::name(element),
        },
        group: read::attribute(element, "SlotGroup", U16, warnings)?.unwrap_or(0) as u16,
        least: least as u16,
        most: most as u16,
        increments: increments(element, common, warnings)?,
        idents,
        classes,
    })
}

/// The increments of an element; missing ones are those of `common`.
fn increments(
    element: Element<'_>,
    common: Increments,
    warnings: &mut Warnings,
) -> Result<Increments, Problem> {
    let mut number = |name, common| {
        let own = read::attribute(element, name, U16, warnings)?;
        Ok(own.map_or(common, |own| own as u16))
    };
    Ok(Increments {
        pdo: number("SlotPdoIncrement", common.pdo)?,
        index: number("SlotIndexIncrement", common.index)?,
        group_pdo: number("SlotGroupPdoIncrement", common.group_pdo)?,
        group_index: number("SlotGroupIndexIncrement", common.group_index)?,
    })
}

/// `Index/@DependOnSlot` and `@DependOnSlotGroup`.
pub(super) fn follows(element: Element<'_>) -> Result<Follows, Problem> {
    let Some(index) = element.child("Index") else { return Ok(Follows::default()) };
    Ok(Follows {
        slot: read::flag(index, "DependOnSlot")?,
        group: read::flag(index, "DependOnSlotGroup")?,
    })
}

/// Largest number of entries of the objects 0xF030 and 0xF050.
const MOST_PLACES: u16 = 255;
