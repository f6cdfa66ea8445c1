//! Devices from descriptions of makers: the keys `esi`, `type`, `revision` and `opmode`.

use std::collections::HashMap;
use std::path::Path;

use isocat_wire::time::Nanos;

use crate::document::{FileError, Source, Table, Value, name_hint};
use crate::esi::{EsiDevice, EsiFile};
use crate::profile::{Profile, RunAs};

/// Descriptions that were read for this segment, by path.
#[derive(Default)]
pub(super) struct Files(HashMap<String, EsiFile>);

/// A device of a description.
pub(super) struct Imported {
    pub profile: &'static Profile,
    pub run_as: RunAs,
}

/// The device that a table names; what it says of the OpMode is in [`RunAs::notes`].
pub(super) fn device(
    source: Source<'_>,
    table: Table<'_>,
    esi: &Value<'_>,
    cycle: Nanos,
    files: &mut Files,
) -> Result<Imported, FileError> {
    let name = esi.name("the path of a device description, such as esi = \"vendor.xml\"")?;
    let folder = Path::new(source.path).parent().unwrap_or(Path::new(""));
    let path = folder.join(name).display().to_string();
    let file = match files.0.entry(path) {
        std::collections::hash_map::Entry::Occupied(known) => known.into_mut(),
        std::collections::hash_map::Entry::Vacant(free) => {
            let file = EsiFile::read(free.key()).map_err(|error| match error.line {
                // It could not be read at all: the segment file is to blame.
                0 => esi.error(error.to_string()),
                _ => error,
            })?;
            free.insert(file)
        }
    };
    let kind = table.required("type", "the type of the device, such as type = \"EL2502-0010\"")?;
    let revision = table.value("revision");
    let wanted = revision.map(|value| value.u32()).transpose()?;
    let choice = file.device(kind.name("a type of the description")?, wanted).map_err(|words| {
        let place = revision.filter(|_| words.starts_with("no revision")).unwrap_or(kind);
        place.error(words)
    })?;
    let (op_mode, mut notes) = op_mode(choice.device, table.value("opmode"))?;
    notes.extend(choice.note.map(|note| format!("revision: {note}")));
    let device = choice.device;
    let told = |error: crate::profile::NotSimulated| error.error;
    let profile = Profile::from_esi(file, device, op_mode).map_err(told)?;
    let mut run_as = RunAs::new(file, device, op_mode, profile, cycle).map_err(told)?;
    notes.append(&mut run_as.notes);
    for warning in &device.warnings {
        notes.push(format!("{}: {}", warning.kind, warning.message));
    }
    run_as.notes = notes;
    Ok(Imported { profile, run_as })
}

/// The OpMode that the key names or numbers; without it the first, but for a drive the first with SYNC0.
fn op_mode(
    device: &EsiDevice,
    value: Option<Value<'_>>,
) -> Result<(Option<usize>, Vec<String>), FileError> {
    let modes = device.op_modes();
    let names = || modes.iter().map(|mode| mode.name.as_str());
    let Some(value) = value else {
        let first_with_sync = modes.iter().position(|mode| mode.sync0());
        let drive = device.profile.number == Some(DRIVE);
        let number = first_with_sync.filter(|_| drive).or((!modes.is_empty()).then_some(0));
        let note = match number {
            Some(number) if modes.len() > 1 => {
                let why = if drive { "the first with SYNC0, as for drives" } else { "the first" };
                vec![format!("opmode: \"{}\" is taken, {why}", modes[number].name)]
            }
            _ => Vec::new(),
        };
        return Ok((number, note));
    };
    if modes.is_empty() {
        let message = format!("opmode is given, but {} has none", device.type_name);
        return Err(value.error(message));
    }
    if value.as_integer().is_some() {
        return Ok((Some(value.integer(0..=modes.len() as i64 - 1)? as usize), Vec::new()));
    }
    let name = value.name("the name of an OpMode, or its number in the file from 0")?;
    let Some(number) = names().position(|known| known == name) else {
        let message = format!("no OpMode \"{name}\" in {}", device.type_name);
        return Err(value.error(message).with_hint(name_hint(name, names())));
    };
    let same = names().filter(|known| *known == name).count();
    let note = (same > 1)
        .then(|| format!("opmode: {same} are called \"{name}\"; number {number} is taken"));
    Ok((Some(number), note.into_iter().collect()))
}

/// Device profile of drives.
const DRIVE: u16 = 402;
