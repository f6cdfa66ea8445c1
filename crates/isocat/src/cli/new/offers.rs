//! What a description offers beside what was taken: other products and revisions of a type, and
//! modules. It stands in comments of the new file.

use std::fmt::Write;

use isocat_descriptions::esi::{EsiDevice, EsiFile, EsiModule};
use isocat_engine::catalog;
use isocat_segment::new_file::quoted;

/// Other devices of one type in one file.
pub(super) struct Others<'f> {
    /// Of other products, whatever their revision.
    products: Vec<&'f EsiDevice>,
    /// Of the same product in other revisions.
    revisions: Vec<&'f EsiDevice>,
}

impl<'f> Others<'f> {
    pub fn of(file: &'f EsiFile, found: &EsiDevice) -> Self {
        let same_type = file.usable().filter(|other| other.type_name == found.type_name);
        let (of_product, products): (Vec<_>, Vec<_>) =
            same_type.partition(|other| other.product_code == found.product_code);
        let other = |other: &&EsiDevice| other.revision != found.revision;
        Self { products, revisions: of_product.into_iter().filter(other).collect() }
    }

    /// Whether the type alone stands for several products.
    pub fn has_products(&self) -> bool {
        !self.products.is_empty()
    }

    /// The other products, for a comment behind the key `product`; empty without.
    pub fn products(&self) -> String {
        let product = |other: &&EsiDevice| {
            let (code, revision) = (other.product_code.unwrap_or(0), other.revision.unwrap_or(0));
            format!("0x{code:08X} ({}, revision 0x{revision:08X})", catalog::one_line(&other.name))
        };
        list(self.products.iter().map(product))
    }

    /// The other revisions, for a comment behind the key `revision`; empty without.
    pub fn revisions(&self) -> String {
        list(self.revisions.iter().map(|other| format!("0x{:08X}", other.revision.unwrap_or(0))))
    }

    /// A message about a product that was taken of several.
    pub fn message(&self, file: &EsiFile, found: &EsiDevice) -> Option<String> {
        let code = found.product_code.filter(|_| self.has_products())?;
        Some(format!(
            "{} has several products called {}: 0x{code:08X} ({}) is taken; write another one behind \
             product in the file: {}",
            file.path,
            found.type_name,
            catalog::one_line(&found.name),
            self.products()
        ))
    }
}

/// Comments about the modules of a modular device: those that are in its slots now, as a key to
/// edit, and what each slot takes. Empty for any other device.
pub(super) fn modules(file: &EsiFile, device: &EsiDevice) -> Vec<String> {
    let Some(slots) = &device.slots else { return Vec::new() };
    let slots = catalog::slots(slots, &file.modules);
    if slots.iter().all(|slot| slot.takes.is_empty()) {
        return vec![format!(
            "modules: no module of {} fits its slots; esi = [{}, \"modules.xml\"] adds those of another file",
            file.path,
            quoted(&file.path)
        )];
    }
    let fitted = file.with_default_modules(device);
    let taken: Vec<_> = fitted.modules.iter().map(|one| (one.place, one.ident)).collect();
    let mut lines = Vec::new();
    match (&taken[..], slots.iter().find(|slot| !slot.takes.is_empty())) {
        ([], Some(slot)) => {
            let row = rows(file, &[(slot.first_place, slot.takes[0])]);
            lines.push(format!("modules = [{row}]    # for example; its slots are empty now"));
        }
        (taken, _) => {
            lines.push(format!("modules = [{}]    # as they are taken now", rows(file, taken)));
        }
    }
    for slot in slots.iter().take(MOST_SLOTS) {
        let places = match slot.places {
            0 | 1 => format!("place {}", slot.first_place),
            count => format!("places {} to {}", slot.first_place, slot.first_place + count - 1),
        };
        let names = list(slot.takes.iter().map(|ident| name(file, *ident)));
        let names = if names.is_empty() { "no module of this file".to_owned() } else { names };
        lines.push(format!("  slot {} ({places}) takes {names}", quoted(&slot.name)));
    }
    lines.push(format!("  all of them: isocat devices {} --modules", file.path));
    lines
}

/// Rows of the key `modules`. A module behind an empty place names its own place.
fn rows(file: &EsiFile, modules: &[(u16, u32)]) -> String {
    let mut text = String::new();
    let mut next = 0;
    for (place, ident) in modules {
        let comma = if text.is_empty() { "" } else { ", " };
        let name = name(file, *ident);
        let _ = match *place == next {
            true => write!(text, "{comma}{name}"),
            false => write!(text, "{comma}{{ slot = {place}, module = {name} }}"),
        };
        next = place + 1;
    }
    text
}

/// A module as the key names it: by its type, or by its ident where its type is empty or several
/// have it.
fn name(file: &EsiFile, ident: u32) -> String {
    let of_ident = |module: &&EsiModule| module.ident == ident;
    let Some(module) = file.modules.iter().find(of_ident) else { return format!("0x{ident:08X}") };
    let type_name = &module.type_name;
    let same = file.modules.iter().filter(|other| other.type_name == *type_name).count();
    match type_name.trim().is_empty() || same > 1 {
        true => format!("0x{ident:08X}"),
        false => quoted(type_name),
    }
}

/// A list that ends with a count where it is long.
fn list(all: impl Iterator<Item = String>) -> String {
    let all: Vec<_> = all.collect();
    let mut text = all[..all.len().min(MOST)].join(", ");
    if all.len() > MOST {
        let _ = write!(text, " and {} more", all.len() - MOST);
    }
    text
}

/// Largest number of products, revisions or modules in a comment.
const MOST: usize = 6;
/// Largest number of slots that are listed.
const MOST_SLOTS: usize = 8;
