//! Selection of modules: the user's wishes, compared with the slots.

use super::modules::{EsiModule, ModuleAt};
use super::slots::{EsiPlace, EsiSlot};
use super::{EsiDevice, EsiFile};
use crate::document::name_hint;

/// A wish for a module, or for several of one kind.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct ModuleWish<'a> {
    /// Place of the first one; `None` for the place after the previous wish.
    pub slot: Option<SlotName<'a>>,
    /// The module; `None` leaves the place empty.
    pub module: Option<ModuleName<'a>>,
    /// Number of consecutive modules; at least 1.
    pub count: usize,
}

/// The name of a place.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum SlotName<'a> {
    /// Its number from 0, through all slots.
    Place(usize),
    /// Name of a slot: its first place without a wish.
    Name(&'a str),
}

/// The name of a module.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ModuleName<'a> {
    /// Type name.
    Type(&'a str),
    /// Ident.
    Ident(u32),
}

/// A part of a [`ModuleWish`].
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum WishPart {
    /// [`ModuleWish::slot`].
    Slot,
    /// [`ModuleWish::module`].
    Module,
    /// [`ModuleWish::count`].
    Count,
}

/// Why the modules cannot be fitted as wished.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct NoModule {
    /// The failing wish, by its number from 0, and its failing part; `None` for all together.
    pub blame: Option<(usize, WishPart)>,
    /// The request, and the possible values.
    pub message: String,
    /// A suggestion.
    pub hint: Option<String>,
}

impl NoModule {
    fn of(wish: usize, part: WishPart, message: String) -> Self {
        Self { blame: Some((wish, part)), message, hint: None }
    }
}

impl EsiFile {
    /// The wished modules of a device, by place. They replace the default: a place without a wish
    /// stays empty.
    pub fn choose_modules(
        &self,
        device: &EsiDevice,
        wishes: &[ModuleWish<'_>],
    ) -> Result<Vec<ModuleAt<'_>>, NoModule> {
        let Some(slots) = &device.slots else {
            let message = format!("{} has no slots for modules", plain(&device.type_name));
            return Err(NoModule { blame: None, message, hint: None });
        };
        let places: Vec<EsiPlace<'_>> = slots.places().collect();
        let mut choice = Choice { file: self, places: &places, filled: vec![None; places.len()] };
        let mut next = 0;
        for (number, wish) in wishes.iter().enumerate() {
            next = choice.put(number, wish, next)?;
        }
        for (slot_number, slot) in slots.slots.iter().enumerate() {
            let filled = choice.filled.iter().zip(&places);
            let count = filled
                .filter(|(filled, place)| {
                    place.slot_number == slot_number && matches!(filled, Some(Some(_)))
                })
                .count();
            if count < usize::from(slot.least) {
                let message = format!(
                    "slot {} must have {}, and {count} {} given",
                    named(slot),
                    modules(slot.least.into()),
                    if count == 1 { "is" } else { "are" }
                );
                let hint = self.fitting(slot).map(|all| format!("it takes {all}"));
                return Err(NoModule { blame: None, message, hint });
            }
        }
        let filled = choice.filled.iter().zip(&places);
        Ok(filled
            .filter_map(|(filled, place)| {
                Some(ModuleAt { place: place.number, module: (*filled).flatten()? })
            })
            .collect())
    }

    /// Some of the modules that fit a slot, in words; `None` if the file has none.
    fn fitting(&self, slot: &EsiSlot) -> Option<String> {
        let all = self.modules.iter().filter(|module| slot.takes(module));
        let all: Vec<_> = all.map(|module| format!("\"{}\"", plain(&module.type_name))).collect();
        match all.len() {
            0 => None,
            count if count > MOST_NAMED => {
                let more = count - MOST_NAMED;
                Some(format!("{} and {more} more", all[..MOST_NAMED].join(", ")))
            }
            _ => Some(all.join(", ")),
        }
    }

    /// The files to which this one refers; they may contain the missing module.
    fn elsewhere(&self) -> Option<String> {
        let reference = self.references.first()?;
        Some(format!(
            "the file refers to {reference:?}, which is read where it is listed: esi = [\"…\", \"…\"]"
        ))
    }
}

/// The selection so far.
struct Choice<'f, 'p> {
    file: &'f EsiFile,
    places: &'p [EsiPlace<'p>],
    /// By place: `None` without a wish, otherwise the module, or that it stays empty.
    filled: Vec<Option<Option<&'f EsiModule>>>,
}

impl<'f> Choice<'f, '_> {
    /// Fulfils a wish; returns the place after it.
    fn put(
        &mut self,
        number: usize,
        wish: &ModuleWish<'_>,
        next: usize,
    ) -> Result<usize, NoModule> {
        let start = self.start(number, wish, next)?;
        let end = start.saturating_add(wish.count);
        for at in start..end {
            let part = if at == start { WishPart::Module } else { WishPart::Count };
            let Some(place) = self.places.get(at) else {
                let message = format!(
                    "there is no place {at} for a module; the device takes {} at most",
                    modules(self.places.len())
                );
                return Err(NoModule::of(number, part, message));
            };
            let of_slot = matches!(wish.slot, Some(SlotName::Name(_)));
            if of_slot && place.slot_number != self.places[start].slot_number {
                let slot = self.places[start].slot;
                let message =
                    format!("slot {} takes {} at most", named(slot), modules(slot.most.into()));
                return Err(NoModule::of(number, WishPart::Count, message));
            }
            if let Some(known) = self.filled[at] {
                let what = match known {
                    Some(module) => format!("\"{}\"", plain(&module.type_name)),
                    None => "to stay empty".to_owned(),
                };
                let part = if wish.slot.is_some() { WishPart::Slot } else { WishPart::Module };
                let message = format!("place {at} is given twice; it was {what} before");
                return Err(NoModule::of(number, part, message));
            }
            let module = match wish.module {
                Some(name) => Some(self.module(number, name, place)?),
                None => None,
            };
            self.filled[at] = Some(module);
        }
        Ok(end)
    }

    /// The first place of a wish.
    fn start(&self, number: usize, wish: &ModuleWish<'_>, next: usize) -> Result<usize, NoModule> {
        let refused = |message| NoModule::of(number, WishPart::Slot, message);
        match wish.slot {
            None => Ok(next),
            Some(SlotName::Place(place)) if place < self.places.len() => Ok(place),
            Some(SlotName::Place(place)) => Err(refused(format!(
                "there is no place {place}; expected 0 to {}",
                self.places.len().saturating_sub(1)
            ))),
            Some(SlotName::Name(name)) => {
                let of_slot = |at: &usize| plain(&self.places[*at].slot.name) == plain(name);
                let mut all = (0..self.places.len()).filter(of_slot).peekable();
                let Some(first) = all.peek().copied() else {
                    let mut names: Vec<_> =
                        self.places.iter().map(|place| plain(&place.slot.name)).collect();
                    names.dedup();
                    let hint = name_hint(name, names.iter().map(String::as_str));
                    let refused = refused(format!("no slot is called \"{name}\""));
                    return Err(NoModule { hint: Some(hint), ..refused });
                };
                all.find(|at| self.filled[*at].is_none()).ok_or_else(|| {
                    let slot = self.places[first].slot;
                    let most = modules(slot.most.into());
                    refused(format!("slot {} is full; it takes {most} at most", named(slot)))
                })
            }
        }
    }

    /// The module with this name that fits a place.
    fn module(
        &self,
        number: usize,
        name: ModuleName<'_>,
        place: &EsiPlace<'_>,
    ) -> Result<&'f EsiModule, NoModule> {
        let refused = |message| NoModule::of(number, WishPart::Module, message);
        let is_meant = |module: &&EsiModule| match name {
            ModuleName::Type(name) => plain(&module.type_name) == plain(name),
            ModuleName::Ident(ident) => module.ident == ident,
        };
        let mut meant: Vec<&EsiModule> = self.file.modules.iter().filter(is_meant).collect();
        // A module in two files counts once; the first is used.
        let mut seen = Vec::new();
        meant.retain(|module| {
            let new = !seen.contains(&module.ident);
            seen.push(module.ident);
            new
        });
        let words = match name {
            ModuleName::Type(name) => format!("\"{}\"", plain(name)),
            ModuleName::Ident(ident) => format!("{ident:#x}"),
        };
        if meant.is_empty() {
            let message = format!("no module {words} in the file");
            let known: Vec<_> =
                self.file.modules.iter().map(|module| plain(&module.type_name)).collect();
            let similar = match name {
                ModuleName::Type(name) if !known.is_empty() => {
                    Some(name_hint(name, known.iter().map(String::as_str)))
                }
                _ => None,
            };
            let hint = match self.file.modules.iter().any(|module| module.file.is_some()) {
                true => similar,
                false => self.file.elsewhere().or(similar),
            };
            return Err(NoModule { hint, ..refused(message) });
        }
        let slot = place.slot;
        let takes: Vec<&EsiModule> =
            meant.iter().copied().filter(|module| slot.takes(module)).collect();
        match takes[..] {
            [one] => Ok(one),
            [] => {
                let message =
                    format!("slot {} (place {}) does not take {words}", named(slot), place.number);
                let hint = match self.places.iter().find(|place| place.slot.takes(meant[0])) {
                    Some(other) => Some(format!(
                        "place {} in slot {} takes it",
                        other.number,
                        named(other.slot)
                    )),
                    None => self.file.fitting(slot).map(|all| format!("the slot takes {all}")),
                };
                Err(NoModule { hint, ..refused(message) })
            }
            [_, _, ..] => {
                let idents: Vec<_> =
                    takes.iter().map(|module| format!("{:#x}", module.ident)).collect();
                let count = takes.len();
                Err(refused(format!(
                    "{count} modules are called {words}; expected the ident of one of them: {}",
                    idents.join(" or ")
                )))
            }
        }
    }
}

/// The name of a slot for people.
fn named(slot: &EsiSlot) -> String {
    format!("\"{}\"", plain(&slot.name))
}

fn modules(count: usize) -> String {
    format!("{count} module{}", if count == 1 { "" } else { "s" })
}

/// A text with single blanks: some files have names with line breaks and repeated blanks.
fn plain(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Largest number of names in a message.
const MOST_NAMED: usize = 8;
