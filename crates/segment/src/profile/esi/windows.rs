//! Windows: registers that an FMMU alone maps into the process image, without a SyncManager.

use std::ops::Range;

use isocat_descriptions::esi::{Direction, EsiPdo, Purpose};
use isocat_subdevice::MAX_PROCESS_DATA;

use super::super::draft::{Area, Window};
use super::{Doubt, DoubtKind, Import, NotSimulated, Obstacle, bytes_of};

/// PDOs of one SyncManager by its number.
pub(super) type Assigned = (u8, Vec<EsiPdo>);

impl Import<'_> {
    /// Parts what is assigned to inputs: what SyncManagers guard, and what lies in windows.
    pub(super) fn part(&self, inputs: Vec<Assigned>) -> (Vec<Assigned>, Vec<Assigned>) {
        let purpose = |number: u8| self.device.sync_managers[usize::from(number)].purpose;
        inputs.into_iter().partition(|(number, _)| !matches!(purpose(*number), Purpose::Window(_)))
    }

    /// The windows of inputs that are mapped. Each other window that has PDOs stays out of the
    /// process image, and becomes a doubt.
    pub(super) fn windows(
        &mut self,
        assigned: &[Assigned],
        inputs: Option<&Area>,
        has_mailbox: bool,
    ) -> Result<Vec<Window>, NotSimulated> {
        for number in self.device.output_windows(self.mode) {
            let why =
                "the plan writes the SYNC unit, and process data would write the same registers";
            self.left_out(number, Direction::Outputs, why);
        }
        let guarded = inputs.map_or(0, |area| {
            let further = area.further.iter().map(|share| usize::from(share.length));
            area.bits(&area.default).div_ceil(8) as usize + further.sum::<usize>()
        });
        let mut total = guarded;
        let mut windows = Vec::new();
        for (number, pdos) in assigned.iter().filter(|(_, pdos)| bytes_of(pdos) > 0) {
            let sm = &self.device.sync_managers[usize::from(*number)];
            let (start, bytes) = (usize::from(sm.start), bytes_of(pdos));
            let is_within =
                |times: &Range<usize>| times.start <= start && start + bytes <= times.end;
            if has_mailbox {
                let why =
                    "beside a mailbox objects tell the PDOs of windows, and they are not read";
                self.left_out(*number, Direction::Inputs, why);
                continue;
            }
            if self.device.dc.is_none() || !DC_TIMES.iter().any(is_within) {
                let why = "a virtual device has no values there; expected system time, SYNC and latch times of a \
                           device with Dc, 0x0910 to 0x092F or 0x0990 to 0x09CF";
                self.left_out(*number, Direction::Inputs, why);
                continue;
            }
            total += bytes;
            if total > MAX_PROCESS_DATA {
                let message =
                    format!("{total} bytes of inputs; expected at most {MAX_PROCESS_DATA}");
                return Err(self.stopped(Obstacle::ProcessDataTooLong, sm.at, message));
            }
            let pdos = pdos.iter().map(|pdo| self.pdo(pdo)).collect::<Result<_, _>>()?;
            windows.push(Window { sync_manager: *number, length: bytes as u16, pdos });
        }
        Ok(windows)
    }

    fn left_out(&mut self, number: u8, direction: Direction, why: &str) {
        let sm = &self.device.sync_managers[usize::from(number)];
        let words = format!(
            "SyncManager {number}, a window of {} on 0x{:04X}, is not mapped into the process image: {why}",
            super::word(direction),
            sm.start
        );
        self.doubts.push(Doubt::new(DoubtKind::WindowNotMapped, words));
    }
}

/// Registers of times that an ESC with distributed clocks has and that reading does not disturb:
/// system time and receive time, start and next pulses, latches. Between them SYNC status is
/// acknowledged by reading.
const DC_TIMES: [Range<usize>; 2] = [0x0910..0x0930, 0x0990..0x09D0];
