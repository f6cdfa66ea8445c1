//! Whether a content has what the way up to OP needs.
//!
//! A lack is stated where no MainDevice can do without it, and a lesser doubt where MainDevices
//! differ. What makers leave out with reason is neither: couplers have no process data; the length
//! of a SyncManager is 0 where the MainDevice is to write the sum of the PDOs, or object 0x1C12 of
//! a device with CoE assigns them; a SyncManager that is off with length 0 is enabled with its
//! PDOs; an ESC without a CPU checks nothing; PDOs may stand in objects or in a MainDevice's
//! configuration alone.

use isocat_wire::sii::{Header, MailboxArea, SmRecord, sm_type, word};
use isocat_wire::sync_manager::SyncManager;

use super::{Doubt, DoubtKind};

/// What decides about the way up.
#[derive(Clone, Debug)]
pub struct Content<'a> {
    /// The first 64 words.
    pub header: &'a Header,
    /// Whether there is a category General.
    pub has_general: bool,
    /// The SyncManagers.
    pub sync_managers: &'a [SmRecord],
    /// The word of the first one; `None` without their category.
    pub sync_managers_at: Option<usize>,
    /// How many PDOs there are, assigned or not.
    pub pdos: usize,
    /// Those that are assigned to a SyncManager.
    pub assigned: &'a [Assigned],
    /// The word at which the categories end.
    pub end: usize,
}

/// A PDO that is assigned to a SyncManager.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Assigned {
    /// Index of the PDO's mapping object.
    pub index: u16,
    /// Whether it is a TxPDO.
    pub inputs: bool,
    /// The number of the SyncManager.
    pub sync_manager: u8,
    /// The word with that number.
    pub word: usize,
}

/// What a content lacks for OP, and what MainDevices may stumble over, in the order of the way up.
pub fn lacks(content: &Content<'_>) -> Vec<Doubt> {
    let mut judge = Judge { content, doubts: Vec::new() };
    judge.mailbox();
    if content.sync_managers.is_empty() {
        judge.no_sync_managers();
    } else {
        judge.assignments();
        judge.sync_managers();
        judge.directions();
    }
    if !content.has_general {
        let expected = "the category General (30), with the device's name and its CoE services";
        judge.may_matter(DoubtKind::GeneralMissing, content.end, expected.to_owned(), "none");
    }
    judge.doubts
}

struct Judge<'a> {
    content: &'a Content<'a>,
    doubts: Vec<Doubt>,
}

impl Judge<'_> {
    fn keeps(&mut self, kind: DoubtKind, word: usize, expected: String, found: impl Into<String>) {
        self.doubts.push(Doubt { kind, word, expected, found: found.into(), keeps_from_op: true });
    }

    fn may_matter(
        &mut self,
        kind: DoubtKind,
        word: usize,
        expected: String,
        found: impl Into<String>,
    ) {
        self.doubts.push(Doubt { kind, word, expected, found: found.into(), keeps_from_op: false });
    }

    /// The areas of the standard mailbox, alone and beside those of the SyncManagers.
    fn mailbox(&mut self) {
        let header = self.content.header;
        let is_empty = |area: MailboxArea| area.length == 0 || area.start == 0;
        let areas = [
            (header.receive, word::RECEIVE_MAILBOX, "to the device"),
            (header.send, word::SEND_MAILBOX, "from the device"),
        ];
        // Without a CPU behind the ESC nothing reads a mailbox, even if the word has protocols.
        let has_protocols = header.protocols != 0 && !header.emulates();
        let empty = areas.iter().find(|(area, ..)| is_empty(*area));
        if let Some((area, at, way)) = empty.filter(|_| has_protocols) {
            let expected = format!(
                "offset and size of the mailbox {way}, since word 0x001C has its protocols ({:#06x})",
                header.protocols
            );
            self.keeps(DoubtKind::MailboxMissing, (*at).into(), expected, words(*area));
        }
        for (number, record) in self.content.sync_managers.iter().enumerate() {
            let area = match record.kind {
                sm_type::MAILBOX_OUT => header.receive,
                sm_type::MAILBOX_IN => header.send,
                _ => continue,
            };
            let found = MailboxArea { start: record.start, length: record.length };
            if found == area {
                continue;
            }
            let at = self.record(number);
            let doubt = (DoubtKind::MailboxArea, at, words(area), words(found));
            // Some MainDevices take the header's, some those of the SyncManager.
            self.may_matter(doubt.0, doubt.1, doubt.2, doubt.3);
        }
        let has_mailbox = header.receive.length > 0 || header.send.length > 0;
        let (at, found) = (word::MAILBOX_PROTOCOLS.into(), format!("{:#06x}", header.protocols));
        let expected = match (has_mailbox, header.protocols != 0) {
            (true, false) => "protocols of the mailbox",
            (false, true) if header.emulates() => "0, since there is no mailbox",
            _ => return,
        };
        self.may_matter(DoubtKind::MailboxProtocols, at, expected.to_owned(), found);
    }

    fn no_sync_managers(&mut self) {
        let (header, pdos) = (self.content.header, self.content.pdos);
        let has_mailbox = header.receive.length > 0 && header.send.length > 0;
        let of = match (has_mailbox, pdos) {
            (false, 0) => return,
            (true, 0) => "the mailbox and process data".to_owned(),
            (false, n) => format!("{n} PDOs"),
            (true, n) => format!("the mailbox and {n} PDOs"),
        };
        let (at, found) = match self.content.sync_managers_at {
            Some(at) => (at, "an empty category".to_owned()),
            None => {
                (self.content.end, format!("no such category up to word {:#06x}", self.content.end))
            }
        };
        let expected = format!("SyncManagers (category 41) for {of}");
        self.keeps(DoubtKind::SyncManagersMissing, at, expected, found);
    }

    /// PDOs whose SyncManager is not for process data. Devices with CoE or SoE tell their
    /// assignment otherwise, too.
    fn assignments(&mut self) {
        let (all, can_tell) = (self.content.sync_managers, self.has_objects());
        for pdo in self.content.assigned {
            let number = usize::from(pdo.sync_manager);
            let wanted = if pdo.inputs { "4, inputs" } else { "3, outputs" };
            let (expected, found) = match all.get(number) {
                None => (
                    format!("one of {} SyncManagers, or 255", all.len()),
                    format!("{number} for PDO 0x{:04X}", pdo.index),
                ),
                Some(record) if record.kind > sm_type::MAILBOX_IN || record.is_window() => continue,
                Some(record) => (
                    format!("a SyncManager for PDO 0x{:04X} (type {wanted})", pdo.index),
                    format!("SyncManager {number}, of type {}", record.kind),
                ),
            };
            // An unused or unknown type may go by the direction of its PDOs.
            let is_mailbox = all.get(number).is_none_or(|record| record.kind != sm_type::UNUSED);
            match can_tell || !is_mailbox {
                true => self.may_matter(DoubtKind::PdoSyncManager, pdo.word, expected, found),
                false => self.keeps(DoubtKind::PdoSyncManager, pdo.word, expected, found),
            }
        }
    }

    fn sync_managers(&mut self) {
        for (number, record) in self.content.sync_managers.iter().enumerate() {
            let at = self.record(number) + 3;
            let is_assigned = |pdo: &Assigned| usize::from(pdo.sync_manager) == number;
            let assigned = self.content.assigned.iter().find(|pdo| is_assigned(pdo));
            let is_on = record.enable & SmRecord::ENABLED != 0;
            match (record.kind, assigned) {
                _ if record.length == 0 || record.is_window() => {}
                (sm_type::OUTPUTS | sm_type::INPUTS, Some(pdo))
                    if record.enable & (SmRecord::ENABLED | SmRecord::OP_ONLY) == 0
                        && !self.content.header.emulates() =>
                {
                    let expected = format!(
                        "SyncManager {number} enabled (bit 0), since PDO 0x{:04X} is assigned to it",
                        pdo.index
                    );
                    let found = format!("{:#04x}, off", record.enable);
                    self.may_matter(DoubtKind::SyncManagerOff, at, expected, found);
                }
                (sm_type::UNUSED, None) if is_on => {
                    let expected =
                        format!("a type of 1 to 4 for SyncManager {number}, or not enabled");
                    let found = format!("type 0, enabled with {} bytes", record.length);
                    self.may_matter(DoubtKind::SyncManagerUntyped, at, expected, found);
                }
                _ => {}
            }
        }
    }

    /// SyncManagers whose type and control byte name opposite directions. Where objects tell what
    /// a SyncManager is for (0x1C00), only MainDevices that go by the EEPROM stumble.
    fn directions(&mut self) {
        for (number, record) in self.content.sync_managers.iter().enumerate() {
            let is_written = match record.kind {
                sm_type::MAILBOX_OUT | sm_type::OUTPUTS => true,
                sm_type::MAILBOX_IN | sm_type::INPUTS => false,
                _ => continue,
            };
            // A SyncManager without bytes guards nothing, and a control byte of 0 may be left out.
            let is_used = record.length > 0 && record.control != 0 && !record.is_window();
            let is_used = is_used && record.enable & SmRecord::ENABLED != 0;
            let direction = match record.control & DIRECTION {
                0 => false,
                SyncManager::CONTROL_ECAT_WRITES => true,
                _ => continue,
            };
            if !is_used || direction == is_written {
                continue;
            }
            let wanted = match record.kind {
                sm_type::MAILBOX_OUT => "2, mailbox from the device",
                sm_type::MAILBOX_IN => "1, mailbox to the device",
                sm_type::OUTPUTS => "4, inputs",
                _ => "3, outputs",
            };
            let by = if is_written { "the device" } else { "the MainDevice" };
            let expected = format!(
                "type {wanted}, for SyncManager {number}, since {by} writes it by its control byte \
                 {:#04x}",
                record.control
            );
            let (at, found) = (self.record(number) + 3, format!("type {}", record.kind));
            match self.has_objects() {
                true => self.may_matter(DoubtKind::SyncManagerDirection, at, expected, found),
                false => self.keeps(DoubtKind::SyncManagerDirection, at, expected, found),
            }
        }
    }

    /// Whether a protocol of the mailbox can tell what SyncManagers and PDOs are for.
    fn has_objects(&self) -> bool {
        self.content.header.protocols & (Header::COE | Header::SOE) != 0
    }

    /// The word of a record.
    fn record(&self, number: usize) -> usize {
        let first = self.content.sync_managers_at.unwrap_or(self.content.end);
        first + number * SmRecord::LEN / 2
    }
}

fn words(area: MailboxArea) -> String {
    format!("{} bytes at 0x{:04X}", area.length, area.start)
}

/// Bits 3:2 of a SyncManager's control byte.
const DIRECTION: u8 = 0x0C;
