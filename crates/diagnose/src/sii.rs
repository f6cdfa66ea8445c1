//! What a MainDevice read of a device's EEPROM (SII), word by word.

use std::collections::BTreeMap;

use isocat_wire::eeprom::EepromStatus;
use isocat_wire::register;
use isocat_wire::sii::{category, word};

use crate::access::{Access, part};
use crate::known::Known;

/// The words that were read.
#[derive(Clone, Debug, Default)]
pub(crate) struct Sii {
    words: BTreeMap<u16, Known<u16>>,
    /// The last word address that was requested.
    asked: Option<u16>,
    /// Number of bytes that a read returns, by the EEPROM status.
    read_len: usize,
    /// Whether a read was commanded whose end was not seen yet.
    reading: bool,
    /// Number of reads in a row, up to now, that the EEPROM did not acknowledge.
    unacknowledged: u64,
    /// Frame of the first one.
    silent_since: usize,
    /// Number of write commands.
    pub writes: u64,
    /// Frame of the first write command.
    pub first_write: Option<usize>,
}

impl Sii {
    /// Takes a datagram to this device.
    pub fn access(&mut self, access: &Access<'_>) {
        let first = access.ado();
        if let Some(data) = access.written().filter(|_| access.taken() != Some(false)) {
            self.command(first, data, access.frame);
        }
        if let Some(data) = access.read() {
            self.answer(first, data, access.frame);
        }
    }

    fn command(&mut self, first: u16, data: &[u8], frame: usize) {
        if let Some([low, high, ..]) = part::<4>(first, data, register::EEPROM_ADDRESS.address) {
            self.asked = Some(u16::from_le_bytes([low, high]));
        }
        let Some(command) = part::<2>(first, data, register::EEPROM_STATUS.address) else { return };
        self.reading = u16::from_le_bytes(command) & EepromStatus::COMMAND == EepromStatus::READ;
        if u16::from_le_bytes(command) & EepromStatus::COMMAND == EepromStatus::WRITE {
            self.writes += 1;
            self.first_write.get_or_insert(frame);
            self.asked = None;
        }
    }

    fn answer(&mut self, first: u16, data: &[u8], frame: usize) {
        if let Some(status) = part::<2>(first, data, register::EEPROM_STATUS.address) {
            let status = EepromStatus(u16::from_le_bytes(status));
            self.read_len = status.read_len();
            if self.reading && !status.busy() {
                self.end_of_read(status, frame);
            }
            if status.busy() || status.failed() {
                return;
            }
        }
        let Some(asked) = self.asked else { return };
        let at = register::EEPROM_DATA.address;
        let Some(first_word) = part::<4>(first, data, at) else { return };
        let mut bytes = first_word.to_vec();
        if self.read_len == 8 {
            bytes.extend(part::<4>(first, data, at + 4).into_iter().flatten());
        }
        for (pair, address) in bytes.chunks_exact(2).zip(asked..MOST_WORDS) {
            let value = u16::from_le_bytes([pair[0], pair[1]]);
            self.words.insert(address, Known { value, frame });
        }
    }

    fn end_of_read(&mut self, status: EepromStatus, frame: usize) {
        self.reading = false;
        if !status.no_acknowledge() {
            self.unacknowledged = 0;
            return;
        }
        if self.unacknowledged == 0 {
            self.silent_since = frame;
        }
        self.unacknowledged += 1;
    }

    /// Reads up to the end that no EEPROM acknowledged: their number, and the frame of the first. A
    /// memory that burns what was written to it acknowledges nothing for some milliseconds either.
    pub fn silent(&self) -> Option<(u64, usize)> {
        let least = if self.writes == 0 { 2 } else { MOST_WHILE_BURNING + 1 };
        (self.unacknowledged >= least).then_some((self.unacknowledged, self.silent_since))
    }

    /// How many words are known.
    pub fn len(&self) -> usize {
        self.words.len()
    }

    fn long(&self, at: u16) -> Option<Known<u32>> {
        let (low, high) = (self.words.get(&at)?, self.words.get(&(at + 1))?);
        let value = u32::from(low.value) | u32::from(high.value) << 16;
        Some(Known { value, frame: low.frame.max(high.frame) })
    }

    /// Vendor id.
    pub fn vendor(&self) -> Option<Known<u32>> {
        self.long(word::VENDOR_ID)
    }

    /// Product code.
    pub fn product(&self) -> Option<Known<u32>> {
        self.long(word::PRODUCT_CODE)
    }

    /// Revision.
    pub fn revision(&self) -> Option<Known<u32>> {
        self.long(word::REVISION)
    }

    /// Serial number.
    pub fn serial(&self) -> Option<Known<u32>> {
        self.long(word::SERIAL)
    }

    /// The device's name, if the capture shows the parts of the categories that hold it.
    pub fn name(&self) -> Option<String> {
        let general = self.category(category::GENERAL)?;
        let strings = self.category(category::STRINGS)?;
        // Byte 3 of the general category: number of the string with the device's name.
        let wanted = self.byte(general, 3).filter(|number| *number > 0)?;
        let mut at = 1;
        for _ in 1..wanted {
            at += 1 + usize::from(self.byte(strings, at)?);
        }
        let len = usize::from(self.byte(strings, at)?);
        let name: Option<Vec<u8>> = (at + 1..=at + len).map(|at| self.byte(strings, at)).collect();
        let name: String = String::from_utf8_lossy(&name?).chars().take(64).collect();
        let name = name.trim_matches(|c: char| c == '\0' || c.is_whitespace()).to_owned();
        (!name.is_empty() && !name.chars().any(char::is_control)).then_some(name)
    }

    /// The word at which the data of a category begin, if all category headers before it were read.
    fn category(&self, wanted: u16) -> Option<u16> {
        let mut at = word::CATEGORIES;
        loop {
            let (kind, len) = (self.words.get(&at)?.value, self.words.get(&(at + 1))?.value);
            match kind {
                category::END => return None,
                kind if kind == wanted => return Some(at + 2),
                _ => at = at.checked_add(len)?.checked_add(2)?,
            }
        }
    }

    /// Byte `at` of the data that begin at word `first`.
    fn byte(&self, first: u16, at: usize) -> Option<u8> {
        let word = self.words.get(&first.checked_add(u16::try_from(at / 2).ok()?)?)?.value;
        Some(word.to_le_bytes()[at % 2])
    }
}

/// Reads in a row that may come while the memory burns a word: for 10 ms, each millisecond.
const MOST_WHILE_BURNING: u64 = 10;
/// Words that are kept of one EEPROM: 8 KiB.
const MOST_WORDS: u16 = 4096;
