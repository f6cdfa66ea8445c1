//! A device that works by another event than it was told to.

use isocat_maindevice::Cause;
use isocat_sync::SyncMode;
use isocat_sync::object::{INPUT_PARAMETER, OUTPUT_PARAMETER, SyncType, sub};

use super::{Case, eeprom, place};

impl Case<'_> {
    /// Looks for a synchronization type that reads back otherwise than it was set.
    pub(super) fn ignored_type(&mut self) {
        let mut own = self.report.findings.iter().filter(|f| f.position == Some(self.position));
        let Some(&Cause::ReadBack { object, written, found, .. }) =
            own.find_map(|finding| eeprom::failure(&finding.kind))
        else {
            return;
        };
        let is_type = [OUTPUT_PARAMETER, INPUT_PARAMETER].contains(&object.index);
        if !is_type || object.sub != sub::SYNC_TYPE {
            return;
        }
        let name = |value: u32| match u16::try_from(value) {
            Ok(value) => SyncType(value).to_string(),
            Err(_) => format!("{value:#x} (unknown)"),
        };
        self.causes.push(format!(
            "It works by {}, as it tells in {object}, although {} was set on the way to SAFEOP: its firmware does not do what it is \
             told, and would work by the frame's arrival or by nothing, while its SYNC0 runs.",
            name(found),
            name(written)
        ));
        let file = place::argument(self.report);
        self.remedies.push(format!(
            "Test its firmware: isocat conform{file} --rule MODE, with --interface IF for the product itself; MODE-04 holds {object} \
             against the mode that was set. If it fails there, ask its maker for another firmware."
        ));
        if let Some(mode) = mode_of(found) {
            self.remedies.push(format!(
                "Or take it as it is, with the mode that it has: {}.",
                self.in_device(&format!("mode = \"{mode}\""))
            ));
        }
    }
}

/// The mode of a type that can be asked for without SYNC.
fn mode_of(found: u32) -> Option<SyncMode> {
    match SyncType(u16::try_from(found).ok()?) {
        SyncType::FREE_RUN => Some(SyncMode::FreeRun),
        SyncType::SM | SyncType::INPUTS_ON_SM2 => Some(SyncMode::SmSynchronous),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_types_without_sync_have_a_mode_to_fall_back_to() {
        let modes = [0x00, 0x01, 0x02, 0x03, 0x22, 0x1_0001].map(mode_of);
        let (free, sm) = (Some(SyncMode::FreeRun), Some(SyncMode::SmSynchronous));
        assert_eq!(modes, [free, sm, None, None, sm, None]);
    }
}
