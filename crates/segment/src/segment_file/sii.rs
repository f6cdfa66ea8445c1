//! Devices whose EEPROM is a file: the key `sii`, alone or in addition to `device` or `esi`.

use std::path::Path;
use std::sync::Arc;

use isocat_descriptions::document::section::Keys;
use isocat_descriptions::document::{FileError, Source, Value};
use isocat_descriptions::esi::EsiFile;
use isocat_descriptions::sii::SiiFile;
use isocat_wire::time::Nanos;

use super::esi::{self, Imported};
use crate::profile::{Doubt, DoubtKind, Profile};

/// The file that the key names, with the key's value for errors about it.
pub(super) fn file<'k>(
    source: Source<'_>,
    keys: &Keys<'k>,
) -> Result<Option<(Value<'k>, SiiFile)>, FileError> {
    let Some(value) = keys.value("sii") else { return Ok(None) };
    let name = value.name("the path of an EEPROM's content, such as sii = \"eeprom.bin\"")?;
    let folder = Path::new(source.path).parent().unwrap_or(Path::new(""));
    let path = folder.join(name).display().to_string();
    // A binary file has no lines, so the error is at the key of the segment file.
    let file = SiiFile::read(&path).map_err(|error| match error.line {
        0 => value.error(error.to_string()),
        _ => error,
    })?;
    Ok(Some((value, file)))
}

/// The device described by the SII alone.
pub(super) fn device(
    keys: &Keys<'_>,
    value: &Value<'_>,
    sii: &SiiFile,
    cycle: Nanos,
) -> Result<Imported, FileError> {
    let file = EsiFile::of_sii(sii);
    let Some(device) = file.devices.first() else {
        unreachable!("a description of an SII has its device");
    };
    let mut imported = esi::in_op_mode(&file, device, None, keys, cycle).map_err(|error| {
        // The place of an obstacle is in the SII, which has no lines.
        if error.path == file.path { value.error(&*error.message) } else { error }
    })?;
    imported.profile = imported.profile.with_sii(&sii.image);
    imported.run_as.notes.extend(notes(sii));
    Ok(imported)
}

/// A device that is described elsewhere, with the bytes of this file in its EEPROM. Another vendor
/// or product is an error; another revision is noted, since EEPROM and firmware of a device may
/// differ in age.
pub(super) fn served(
    value: &Value<'_>,
    profile: &Arc<Profile>,
    sii: &SiiFile,
) -> Result<(Arc<Profile>, Vec<Doubt>), FileError> {
    let (header, identity) = (&sii.sii.header, &profile.identity);
    for (what, expected, found) in [
        ("vendor", identity.vendor_id, header.vendor_id),
        ("product code", identity.product_code, header.product_code),
    ] {
        if expected != found {
            return Err(value.error(format!(
                "{} is of another device: expected {what} 0x{expected:08X} of {}, found 0x{found:08X}",
                sii.path, profile.name
            )));
        }
    }
    let mut notes = notes(sii);
    if identity.revision != header.revision {
        let words = format!(
            "the EEPROM has revision 0x{:08X}, the device's objects 0x{:08X}",
            header.revision, identity.revision
        );
        notes.insert(0, Doubt::new(DoubtKind::SiiRevision, words));
    }
    Ok((profile.with_sii(&sii.image), notes))
}

fn notes(sii: &SiiFile) -> Vec<Doubt> {
    sii.doubts.iter().map(|doubt| Doubt::new(DoubtKind::Sii, doubt.to_string())).collect()
}
