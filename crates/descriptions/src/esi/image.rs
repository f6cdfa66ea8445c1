//! The process data of a device by default, or in one of its OpModes.

use super::dc::EsiOpMode;
use super::device::EsiDevice;
use super::pdo::{Direction, EsiPdo};
use super::sync_manager::Purpose;
use super::warning::{WarningKind, Warnings};

/// The process data of a device: PDOs by SyncManager, ascending, each list in the order of the
/// process data. The entries of a PDO that oversamples stand there as often as
/// [`EsiPdo::oversampling`] says.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Image {
    /// Process data from the MainDevice, by SyncManager number.
    pub outputs: Vec<(u8, Vec<EsiPdo>)>,
    /// Process data to the MainDevice, by SyncManager number.
    pub inputs: Vec<(u8, Vec<EsiPdo>)>,
}

impl Image {
    /// Whether there are no process data.
    pub fn is_empty(&self) -> bool {
        self.all().next().is_none()
    }

    /// All PDOs: outputs first, each by SyncManager.
    pub fn all(&self) -> impl Iterator<Item = &EsiPdo> {
        self.outputs.iter().chain(&self.inputs).flat_map(|(_, pdos)| pdos)
    }

    fn of(&mut self, direction: Direction) -> &mut Vec<(u8, Vec<EsiPdo>)> {
        match direction {
            Direction::Outputs => &mut self.outputs,
            Direction::Inputs => &mut self.inputs,
        }
    }

    fn push(&mut self, direction: Direction, number: u8, pdo: EsiPdo) {
        let list = self.of(direction);
        match list.iter_mut().find(|(known, _)| *known == number) {
            Some((_, pdos)) => pdos.push(pdo),
            None => {
                list.push((number, vec![pdo]));
                list.sort_by_cached_key(|(number, _)| u64::from(*number));
            }
        }
    }
}

/// The default image of a device with these PDOs; `mode` replaces the assignment of the
/// SyncManagers that it names.
pub(super) fn default(
    device: &EsiDevice,
    known: &[EsiPdo],
    mode: Option<&EsiOpMode>,
    w: &mut Warnings,
) -> Image {
    let mut image = Image::default();
    for pdo in known {
        let Some(number) = pdo.sync_manager else { continue };
        if device.is_output_window(number) {
            // The warning of the window says that it is not mapped.
            continue;
        }
        match direction(device, number) {
            Some(right) if right == pdo.direction => {
                image.push(right, number, oversampled(pdo, pdo.oversampling));
            }
            found => w.add(WarningKind::PdoSyncManager, pdo.at, || {
                let what = match found {
                    Some(direction) => format!("which has {direction:?}"),
                    None => "which has no process data".to_owned(),
                };
                format!(
                    "PDO 0x{:04X} ({:?}) names SyncManager {number}, {what}; it is not assigned",
                    pdo.index, pdo.direction
                )
            }),
        }
    }
    for assignment in mode.iter().flat_map(|mode| &mode.assignments) {
        let number = assignment.sync_manager;
        let Some(direction) = direction(device, number) else { continue };
        image.of(direction).retain(|(known, _)| *known != number);
        for (index, factor) in &assignment.pdos {
            match known.iter().find(|pdo| pdo.index == *index && pdo.direction == direction) {
                Some(pdo) => {
                    // The OpMode's factor replaces the PDO's own.
                    let factor = factor.unwrap_or(pdo.oversampling);
                    image.push(direction, number, oversampled(pdo, factor));
                }
                None => w.add(WarningKind::PdoSyncManager, mode.map_or(0, |mode| mode.at), || {
                    format!("SyncManager {number} gets PDO 0x{index:04X}, which does not exist")
                }),
            }
        }
    }
    image
}

/// A PDO whose entries repeat `factor` times, each with its own index. Its own factor becomes this
/// one.
fn oversampled(pdo: &EsiPdo, factor: u16) -> EsiPdo {
    let mut pdo = EsiPdo { oversampling: factor, ..pdo.clone() };
    if factor > 1 {
        let one = std::mem::take(&mut pdo.entries);
        for number in 0..factor {
            // A PDO that exceeds every mapping is refused by its count, so counting further is
            // useless.
            if pdo.entries.len() > MOST_ENTRIES {
                break;
            }
            for entry in &one {
                let mut entry = entry.clone();
                if let Some(object) = &mut entry.object {
                    let step = number.wrapping_mul(pdo.oversampling_step);
                    object.index = object.index.wrapping_add(step);
                }
                pdo.entries.push(entry);
            }
        }
    }
    pdo
}

fn direction(device: &EsiDevice, number: u8) -> Option<Direction> {
    match device.sync_managers.get(usize::from(number))?.purpose {
        Purpose::Outputs => Some(Direction::Outputs),
        Purpose::Inputs | Purpose::Window(Some(Direction::Inputs)) => Some(Direction::Inputs),
        _ => None,
    }
}

/// Far above the 254 sub-indices of a mapping.
const MOST_ENTRIES: usize = 4_096;
