//! In the place of `esi` where descriptions of makers are not built in: the key is known, and refused.

use isocat_sync::SyncMode;
use isocat_wire::time::Nanos;

use crate::document::section::Keys;
use crate::document::{FileError, Source, Value};
use crate::profile::Profile;

/// No file is ever read.
#[derive(Default)]
pub(super) struct Files;

/// There is none.
pub(super) struct Imported {
    pub profile: &'static Profile,
    pub run_as: RunAs,
}

/// What an OpMode stands for.
pub(super) struct RunAs {
    pub mode: SyncMode,
    pub sync1: Option<Nanos>,
    pub sync0_cycle: Option<Nanos>,
    pub notes: Vec<String>,
}

/// Refuses the key.
pub(super) fn device(
    _: Source<'_>,
    _: &Keys<'_>,
    esi: &Value<'_>,
    _: Nanos,
    _: &mut Files,
) -> Result<Imported, FileError> {
    Err(esi.error(
        "esi is given, but this program is built without descriptions of makers; expected device = with a profile",
    ))
}

/// Nothing contradicts what is not there.
pub(super) fn agree(
    _: &Keys<'_>,
    _: &Value<'_>,
    _: SyncMode,
    _: &mut RunAs,
) -> Result<(), FileError> {
    Ok(())
}
