//! Devices from ESI files: the keys `esi`, `type`, `product`, `revision`, `modules` and `opmode`.

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use isocat_descriptions::document::section::Keys;
use isocat_descriptions::document::{FileError, Source, Value, name_hint};
use isocat_descriptions::esi::{EsiDevice, EsiFile, Wanted, Wish};
use isocat_sync::SyncMode;
use isocat_wire::time::Nanos;

use super::modules;
use crate::profile::{ApplicationKind, Doubt, DoubtKind, Profile, RunAs};

/// Descriptions that were read for this segment, by their paths; and profiles that the caller gave.
pub(super) struct Files<'a> {
    read: HashMap<Vec<String>, EsiFile>,
    pub(super) profiles: &'a [Arc<Profile>],
}

impl<'a> Files<'a> {
    /// No descriptions yet, and these profiles.
    pub(super) fn with(profiles: &'a [Arc<Profile>]) -> Self {
        Self { read: HashMap::new(), profiles }
    }
}

/// A device of a description.
pub(super) struct Imported {
    pub profile: Arc<Profile>,
    pub run_as: RunAs,
}

/// The device that a table names; notes on its OpMode are in [`RunAs::notes`].
pub(super) fn device(
    source: Source<'_>,
    keys: &Keys<'_>,
    esi: &Value<'_>,
    cycle: Nanos,
    files: &mut Files<'_>,
) -> Result<Imported, FileError> {
    let file = file(source, esi, files)?;
    let kind = keys.value("type");
    let type_name = kind.as_ref().map(|kind| kind.name("a type of the description")).transpose()?;
    let wish = Wish { type_name, product: keys.find("product")?, revision: keys.find("revision")? };
    let choice = file.device(wish).map_err(|refused| {
        let blamed = match refused.blame {
            Wanted::Type => kind,
            Wanted::Product => keys.value("product"),
            Wanted::Revision => keys.value("revision"),
        };
        blamed.as_ref().unwrap_or(esi).error(refused.message)
    })?;
    let device = modules::fitted(file, choice.device, keys)?;
    in_op_mode(file, &device, choice.note, keys, cycle)
}

/// The description that the key names; for a list the first one, which includes the modules of the
/// others.
fn file<'f>(
    source: Source<'_>,
    esi: &Value<'_>,
    files: &'f mut Files<'_>,
) -> Result<&'f EsiFile, FileError> {
    const EXPECTED: &str = "the path of a device description, such as esi = \"vendor.xml\"";
    let named = match esi.is_array() {
        false => vec![(*esi, esi.name(EXPECTED)?)],
        true => {
            let all = esi.array("paths")?.into_iter();
            all.map(|path| Ok((path, path.name(EXPECTED)?))).collect::<Result<_, FileError>>()?
        }
    };
    if named.is_empty() {
        return Err(esi.error(format!("an empty list; expected {EXPECTED}")));
    }
    let folder = Path::new(source.path).parent().unwrap_or(Path::new(""));
    let paths = named.iter().map(|(_, name)| folder.join(name).display().to_string()).collect();
    match files.read.entry(paths) {
        std::collections::hash_map::Entry::Occupied(known) => Ok(known.into_mut()),
        std::collections::hash_map::Entry::Vacant(free) => {
            let mut all = free.key().iter().zip(&named).map(|(path, (value, _))| {
                EsiFile::read(path).map_err(|error| match error.line {
                    // The file could not be read at all, so the error is at the key of the segment
                    // file.
                    0 => value.error(error.to_string()),
                    _ => error,
                })
            });
            let mut file = all.next().expect("the list is not empty")?;
            for ((value, name), other) in named[1..].iter().zip(all) {
                let other = other?;
                if other.modules.is_empty() {
                    let message = format!(
                        "{name} has no modules; expected a file with modules \
                                           behind that with the device"
                    );
                    return Err(value.error(message));
                }
                file.add_modules(other);
            }
            Ok(free.insert(file))
        }
    }
}

/// A device of a description, in the OpMode that the table names. `choice` are the notes on its
/// choice.
pub(super) fn in_op_mode(
    file: &EsiFile,
    device: &EsiDevice,
    choice: Option<String>,
    keys: &Keys<'_>,
    cycle: Nanos,
) -> Result<Imported, FileError> {
    let (op_mode, mut notes) = op_mode(device, keys)?;
    notes.extend(modules::unfit(device, op_mode));
    notes.extend(choice.map(|note| Doubt::new(DoubtKind::Revision, note)));
    let told = |error: crate::profile::NotSimulated| error.error;
    let profile = Profile::from_esi(file, device, op_mode).map_err(told)?;
    let mut run_as = RunAs::new(file, device, op_mode, &profile, cycle).map_err(told)?;
    notes.append(&mut run_as.notes);
    notes.extend(profile.doubts.iter().cloned());
    for warning in &device.warnings {
        // A note on this OpMode at this cycle contains more than a warning about the file alone.
        let kind = warning.kind;
        if !notes.iter().any(|note| note.kind.name() == kind.name()) {
            notes.push(Doubt::new(kind, warning.message.clone()));
        }
    }
    if device.profile.is_drive() && profile.application == ApplicationKind::Io {
        notes.push(not_enabled(device, op_mode));
    }
    run_as.notes = notes;
    Ok(Imported { profile, run_as })
}

/// Whether the OpMode can mean `mode`. If the file has both keys, another mode is a mistake; if the
/// OpMode is only the default, `mode` is used, with a note.
pub(super) fn agree(
    keys: &Keys<'_>,
    value: &Value<'_>,
    mode: SyncMode,
    run_as: &mut RunAs,
) -> Result<(), FileError> {
    if run_as.modes.contains(&mode) {
        return Ok(());
    }
    let names: Vec<_> = run_as.modes.iter().map(|mode| format!("\"{mode}\"")).collect();
    let names = names.join(" or ");
    match keys.value("opmode") {
        Some(op_mode) => {
            let message = format!(
                "mode = \"{mode}\" contradicts opmode = {}, which stands for {names}; expected one of \
                 these modes, or only one of both keys",
                op_mode.written()
            );
            Err(value.error(message))
        }
        None => {
            let words = format!(
                "\"{mode}\" as asked for; the OpMode that is taken stands for {names}, its times are not used"
            );
            run_as.notes.insert(0, Doubt::new(DoubtKind::Mode, words));
            Ok(())
        }
    }
}

/// The OpMode that the key names or numbers; without it the first, but for a drive the first with
/// SYNC0. Modules of the table limit the choice to the OpModes for which they are made.
fn op_mode(device: &EsiDevice, keys: &Keys<'_>) -> Result<(Option<usize>, Vec<Doubt>), FileError> {
    let modes = device.op_modes();
    let names = || modes.iter().map(|mode| mode.name.as_str());
    let Some(value) = keys.value("opmode") else {
        let chosen = keys.value("modules").is_some();
        let fits = |number: &usize| !chosen || modules::unfit(device, Some(*number)).is_none();
        let with_sync = |number: &usize| modes[*number].sync0();
        let drive = device.profile.is_drive();
        let mut all: Vec<usize> = (0..modes.len()).filter(fits).collect();
        if all.is_empty() {
            // No OpMode fits all of the modules; a note says so.
            all = (0..modes.len()).collect();
        }
        let first_with_sync = all.iter().copied().find(with_sync);
        let number = first_with_sync.filter(|_| drive).or(all.first().copied());
        let note = match number {
            Some(number) if modes.len() > 1 => {
                let why = if drive { "the first with SYNC0, as for drives" } else { "the first" };
                let words = format!("\"{}\" is taken, {why}", modes[number].name);
                vec![Doubt::new(DoubtKind::OpMode, words)]
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
    let note =
        (same > 1).then(|| format!("{same} are called \"{name}\"; number {number} is taken"));
    let notes = note.map(|note| Doubt::new(DoubtKind::OpMode, note)).into_iter().collect();
    Ok((Some(number), notes))
}

/// Why a drive is treated as inputs and outputs.
fn not_enabled(device: &EsiDevice, op_mode: Option<usize>) -> Doubt {
    let image = device.image(op_mode.and_then(|number| device.op_modes().get(number)));
    let has = |index: u16, bits: u16| {
        let mut entries = image.all().flat_map(|pdo| &pdo.entries);
        entries.any(|entry| entry.object.is_some_and(|o| o.index == index) && entry.bits == bits)
    };
    let lacking: Vec<_> = DRIVE_OBJECTS
        .iter()
        .filter(|(index, bits)| !has(*index, *bits))
        .map(|(index, bits)| format!("0x{index:04X} of {bits} bits"))
        .collect();
    let why = match lacking.is_empty() {
        true => "its process data do not begin at whole bytes".to_owned(),
        false => format!("its process data lack {}", lacking.join(", ")),
    };
    let words = format!("a drive (CiA 402), but {why}: it is not enabled and does not move");
    Doubt::new(DoubtKind::DriveNotEnabled, words)
}

/// Objects in the process data of a drive that follows positions, with their bits.
const DRIVE_OBJECTS: [(u16, u16); 4] = [(0x6040, 16), (0x607A, 32), (0x6041, 16), (0x6064, 32)];
