//! What the EEPROM of a SubDevice lacks for OP, where the way up failed: judged as `isocat sii`
//! judges a file.

use isocat_descriptions::sii::{Assigned, Content, Doubt, lacks};
use isocat_maindevice::error::SiiProblem;
use isocat_maindevice::segment::{Sii, SiiPdo};
use isocat_maindevice::{Cause, SegmentChange};
use isocat_sim::{Judged, Kind};

/// What keeps a device with this SII from OP; nothing of a SII that was not read.
pub(crate) fn of(sii: &Sii) -> Vec<Doubt> {
    if sii.end == 0 {
        return Vec::new();
    }
    let assigned = |inputs| {
        move |pdo: &SiiPdo| Assigned {
            index: pdo.record.index,
            inputs,
            sync_manager: pdo.record.sm,
            word: pdo.word + 1,
        }
    };
    let outputs = sii.rx_pdos.iter().map(assigned(false));
    let all = sii.tx_pdos.iter().map(assigned(true)).chain(outputs);
    let mut doubts = lacks(&Content {
        header: &sii.header,
        has_general: sii.has_general,
        sync_managers: &sii.sync_managers,
        sync_managers_at: sii.sync_managers_at,
        pdos: sii.rx_pdos.len() + sii.tx_pdos.len(),
        assigned: &all.filter(|pdo| pdo.sync_manager != NO_SYNC_MANAGER).collect::<Vec<_>>(),
        end: sii.end,
    });
    doubts.retain(|doubt| doubt.keeps_from_op);
    doubts
}

/// Why the EEPROM did not give its content, in a sentence, with the remedies.
pub(super) fn unread(problem: SiiProblem) -> Option<(&'static str, &'static [&'static str])> {
    match problem {
        SiiProblem::NoAcknowledge(_) => Some((
            "The ESC asks its EEPROM, and nothing acknowledges (register 0x0502 bit 13): there is no EEPROM, it is dead, \
             or its bus is held low. Frames and ports are not the cause: its ESC answers.",
            &[
                "Look at the EEPROM on the board: its supply, its address pins, SCL and SDA with their pull-ups, and the pin \
                 that tells the ESC its size.",
                "Replace the device, or its EEPROM with the image of its maker: isocat sii --from FILE --type TYPE --out OUT \
                 makes one of the description.",
            ],
        )),
        SiiProblem::NotLoaded(_) => Some((
            "The ESC has no configuration, and so no door to a CPU (0x0110 bit 0): its EEPROM was never written, or words 0 to 6 \
             and the checksum in word 7 disagree, or it does not answer.",
            &[
                "Write the image of its maker, then switch the device off and on: isocat sii --from FILE --type TYPE --out OUT \
                 makes it of the description; isocat sii FILE tells what is wrong with one that was read out.",
            ],
        )),
        SiiProblem::Blank(_) => Some((
            "The EEPROM answers and was never written: the ESC has no configuration, and nobody knows which device it is.",
            &[
                "Write the image of its maker: isocat sii --from FILE --type TYPE --out OUT makes one of the description; then \
                 switch the device off and on.",
            ],
        )),
        _ => None,
    }
}

/// What made the way up of a SubDevice fail, by its finding.
pub(super) fn failure(kind: &Kind) -> Option<&Cause> {
    match kind {
        Kind::Judged(Judged::Failed { cause, .. })
        | Kind::Change(
            SegmentChange::LeftOut { cause }
            | SegmentChange::NotAdmitted { cause }
            | SegmentChange::NotRecovered { cause },
        ) => Some(cause),
        _ => None,
    }
}

/// Whether a lack of the EEPROM can be behind it: not behind clocks, cables or another device.
pub(super) fn can_come_of_it(cause: &Cause) -> bool {
    matches!(
        cause,
        Cause::Sii { .. }
            | Cause::Refused { .. }
            | Cause::StateTimeout { .. }
            | Cause::Mailbox { .. }
            | Cause::Sdo { .. }
            | Cause::Soe { .. }
            | Cause::Mapping { .. }
            | Cause::ProcessData { .. }
    )
}

/// A PDO that is assigned to no SyncManager.
const NO_SYNC_MANAGER: u8 = 0xFF;
