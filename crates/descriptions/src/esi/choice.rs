//! Selection of a device in a description by type, product code and revision.

use super::{EsiDevice, EsiFile};
use crate::document::name_hint;

/// Selection criteria of a device. `None` matches everything.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Wish<'a> {
    /// Type name, such as "EL2502-0010". It may be omitted if all devices have one type.
    pub type_name: Option<&'a str>,
    /// Product code: some files give one type and revision to several products.
    pub product: Option<u32>,
    /// Revision: this one, or else the newest that is not newer. Without it the newest of all.
    pub revision: Option<u32>,
}

/// A part of a [`Wish`].
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Wanted {
    /// [`Wish::type_name`].
    Type,
    /// [`Wish::product`].
    Product,
    /// [`Wish::revision`].
    Revision,
}

/// Why no device of a file was chosen.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct NoChoice {
    /// The criterion that nothing in the file matches.
    pub blame: Wanted,
    /// The requested and the existing values.
    pub message: String,
}

/// A device of a file, with a note on its selection.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Choice<'f> {
    /// The device.
    pub device: &'f EsiDevice,
    /// Why this device was selected, if there were others.
    pub note: Option<String>,
}

impl EsiFile {
    /// Devices that can be chosen: those with a product code.
    pub fn usable(&self) -> impl Iterator<Item = &EsiDevice> {
        self.devices.iter().filter(|device| device.product_code.is_some())
    }

    /// The device that matches a wish.
    pub fn device(&self, wish: Wish<'_>) -> Result<Choice<'_>, NoChoice> {
        let mut candidates = self.of_product(self.of_type(wish)?, wish)?;
        candidates.sort_by_cached_key(|device| u64::from(number(device)));
        let newest =
            |found: &&&EsiDevice| wish.revision.is_none_or(|wanted| number(found) <= wanted);
        let Some(device) = candidates.iter().rev().find(newest).copied() else {
            let all: Vec<_> =
                candidates.iter().map(|device| format!("{:#010x}", number(device))).collect();
            let (wanted, all) = (wish.revision.unwrap_or(0), all.join(", "));
            let message = format!("no revision {wanted:#010x} or older in the file; it has: {all}");
            return Err(NoChoice { blame: Wanted::Revision, message });
        };
        let mut notes = Vec::new();
        let found = number(device);
        match wish.revision {
            Some(wanted) if wanted != found => notes.push(format!(
                "no revision {wanted:#010x} in the file; {found:#010x}, the newest below, is taken"
            )),
            None if candidates.len() > 1 => {
                let all = candidates.len();
                notes.push(format!("the newest of {all} revisions, {found:#010x}, is taken"));
            }
            _ => {}
        }
        // Types are names for people: some files give one to several products.
        let same: Vec<_> = candidates.iter().filter(|other| number(other) == found).collect();
        if same.len() > 1 {
            let count = same.len();
            let products = products(same.into_iter().copied());
            notes.push(format!(
                "{count} devices have this type and revision, of product {products}; the last is taken"
            ));
        }
        Ok(Choice { device, note: (!notes.is_empty()).then(|| notes.join("; ")) })
    }

    /// Usable devices of the wished type; all if they have one type or a product is wished.
    fn of_type(&self, wish: Wish<'_>) -> Result<Vec<&EsiDevice>, NoChoice> {
        let mut names: Vec<&str> = self.usable().map(|device| device.type_name.as_str()).collect();
        names.dedup();
        let no = |message| Err(NoChoice { blame: Wanted::Type, message });
        let Some(type_name) = wish.type_name.map(str::trim) else {
            return match names[..] {
                [] => no(self.none_usable()),
                [_] => Ok(self.usable().collect()),
                _ if wish.product.is_some() => Ok(self.usable().collect()),
                [first, ..] => no(format!(
                    "the file has several devices; expected the type of one of them, such as {first:?}"
                )),
            };
        };
        let candidates: Vec<_> =
            self.usable().filter(|device| device.type_name == type_name).collect();
        if !candidates.is_empty() {
            return Ok(candidates);
        }
        let placeholder = self.devices.iter().any(|device| device.type_name == type_name);
        no(match (placeholder, names.is_empty()) {
            (true, _) => format!("\"{type_name}\" has no product code: it is a placeholder"),
            (false, true) => self.none_usable(),
            (false, false) => {
                let hint = name_hint(type_name, names);
                let refused = self.refused.first();
                let refused = refused.map_or(String::new(), |error| format!("; refused: {error}"));
                format!("no type \"{type_name}\" in the file; {hint}{refused}")
            }
        })
    }

    fn of_product<'f>(
        &self,
        candidates: Vec<&'f EsiDevice>,
        wish: Wish<'_>,
    ) -> Result<Vec<&'f EsiDevice>, NoChoice> {
        let Some(wanted) = wish.product else { return Ok(candidates) };
        let of_product: Vec<_> = candidates
            .iter()
            .copied()
            .filter(|device| device.product_code == Some(wanted))
            .collect();
        if of_product.is_empty() {
            let known = products(candidates.into_iter());
            let message = format!("no product {wanted:#010x} in the file; expected {known}");
            return Err(NoChoice { blame: Wanted::Product, message });
        }
        Ok(of_product)
    }

    /// Why no device can be selected, with the place of the first refused one.
    pub fn none_usable(&self) -> String {
        match self.refused.first() {
            Some(error) => format!("the file has no device that can be chosen; refused: {error}"),
            None => "the file has no device that can be chosen".to_owned(),
        }
    }
}

fn number(device: &EsiDevice) -> u32 {
    device.revision.unwrap_or(0)
}

/// Product codes in a list, each once.
fn products<'f>(devices: impl Iterator<Item = &'f EsiDevice>) -> String {
    let mut codes: Vec<_> = devices.filter_map(|device| device.product_code).collect();
    codes.sort_by_cached_key(|code| u64::from(*code));
    codes.dedup();
    let codes: Vec<_> = codes.into_iter().map(|code| format!("{code:#010x}")).collect();
    codes.join(" or ")
}
