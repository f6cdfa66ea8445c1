//! Modules in the slots of a device: the key `modules`.

use std::borrow::Cow;

use isocat_descriptions::document::section::Keys;
use isocat_descriptions::document::{FileError, Value};
use isocat_descriptions::esi::{
    EsiDevice, EsiFile, ModuleName, ModuleWish, NoModule, SlotName, WishPart,
};

use super::keys;
use crate::profile::{Doubt, DoubtKind};

/// The device with the modules that the table names; without the key with the default ones.
pub(super) fn fitted<'d>(
    file: &EsiFile,
    device: &'d EsiDevice,
    keys: &Keys<'_>,
) -> Result<Cow<'d, EsiDevice>, FileError> {
    let Some(list) = keys.value("modules") else { return Ok(file.with_default_modules(device)) };
    let rows = list.array("modules")?;
    let rows: Vec<_> = rows.iter().map(Row::read).collect::<Result<_, FileError>>()?;
    let wishes: Vec<_> = rows.iter().map(|row| row.wish).collect();
    let modules = file.choose_modules(device, &wishes).map_err(|refused| {
        let NoModule { blame, message, hint } = refused;
        let value = blame.map_or(list, |(number, part)| rows[number].part(part));
        let error = value.error(message);
        match hint {
            Some(hint) => error.with_hint(hint),
            None => error,
        }
    })?;
    Ok(Cow::Owned(file.fitted(device, &modules)))
}

/// A row of the list.
struct Row<'a> {
    wish: ModuleWish<'a>,
    /// The whole value in the file.
    whole: Value<'a>,
    slot: Option<Value<'a>>,
    module: Option<Value<'a>>,
    count: Option<Value<'a>>,
}

impl<'a> Row<'a> {
    fn read(value: &Value<'a>) -> Result<Self, FileError> {
        if !value.is_table() {
            let wish = ModuleWish { slot: None, module: module(value)?, count: 1 };
            return Ok(Self { wish, whole: *value, slot: None, module: None, count: None });
        }
        let keys = Keys::open(value.table()?, &keys::MODULE)?;
        let named = keys.required("module")?;
        let slot = keys.value("slot");
        let wish = ModuleWish {
            slot: slot.as_ref().map(self::slot).transpose()?,
            module: module(&named)?,
            count: keys.get("count")?,
        };
        let count = keys.value("count");
        Ok(Self { wish, whole: *value, slot, module: Some(named), count })
    }

    /// The part of it that is wrong.
    fn part(&self, part: WishPart) -> Value<'a> {
        let value = match part {
            WishPart::Slot => self.slot,
            WishPart::Module => self.module,
            WishPart::Count => self.count,
        };
        value.unwrap_or(self.whole)
    }
}

/// A module; `None` for an empty text, which leaves the slot empty.
fn module<'a>(value: &Value<'a>) -> Result<Option<ModuleName<'a>>, FileError> {
    if value.as_integer().is_some() {
        return Ok(Some(ModuleName::Ident(value.integer(0..=u32::MAX.into())? as u32)));
    }
    match value.as_string() {
        Some(text) if text.trim().is_empty() => Ok(None),
        Some(_) => Ok(Some(ModuleName::Type(value.name(keys::MODULE_EXPECTED)?))),
        None => Err(value.unexpected(keys::MODULE_EXPECTED)),
    }
}

fn slot<'a>(value: &Value<'a>) -> Result<SlotName<'a>, FileError> {
    if value.as_integer().is_some() {
        return Ok(SlotName::Place(value.integer(0..=keys::MOST_PLACES - 1)? as usize));
    }
    Ok(SlotName::Name(value.name(keys::SLOT_EXPECTED)?))
}

/// The doubt about modules that are not made for the OpMode of the device (`DcOpModeName`).
pub(super) fn unfit(device: &EsiDevice, op_mode: Option<usize>) -> Option<Doubt> {
    let mode = &device.op_modes().get(op_mode?)?.name;
    let other = |names: &[String]| !names.is_empty() && !names.contains(mode);
    let module = device.modules.iter().find(|module| other(&module.op_modes))?;
    let names = module.op_modes.join("\" or \"");
    let words = format!(
        "module \"{}\" at place {} is for OpMode \"{names}\"; the device runs in \"{mode}\"",
        module.type_name, module.place
    );
    Some(Doubt::new(DoubtKind::ModuleOpMode, words))
}
