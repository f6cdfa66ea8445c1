//! From an image to an [`Sii`], with every doubt.

use isocat_wire::sii::{
    HEADER_LEN, Header, PdoEntryRecord, PdoRecord, SmRecord, blank, categories, category, checksum,
    sm_type, word,
};

use super::{
    Assigned, Content, Doubt, DoubtKind, General, OtherCategory, Sii, SiiEntry, SiiFile, SiiOpMode,
    SiiPdo, hex, lacks,
};
use crate::document::{FileError, Wrong};
use crate::limits;

impl SiiFile {
    /// Reads a file from disk: an image of at most [`limits::SII`] bytes, or Intel HEX.
    pub fn read(path: &str) -> Result<Self, FileError> {
        // Intel HEX has about three characters for each byte.
        Self::from_bytes(path, &limits::read(path, 3 * limits::SII)?)
    }

    /// Reads the bytes of a file; `path` names it in errors. Fails for broken Intel HEX (with line
    /// and column), and for an image shorter than the header or longer than [`limits::SII`].
    pub fn from_bytes(path: &str, bytes: &[u8]) -> Result<Self, FileError> {
        let image = match std::str::from_utf8(bytes) {
            Ok(text) if hex::is_hex(bytes) => hex::decode(path, text)?,
            _ => bytes.to_vec(),
        };
        limits::check(path, image.len(), limits::SII)?;
        let Some(header) = Header::parse(&image) else {
            let words = HEADER_LEN / 2;
            let message = format!(
                "word {:#06x}: the image ends; expected a header of {words} words, found {} bytes",
                image.len() / 2,
                image.len()
            );
            return Err(FileError::new(Wrong {
                path: path.to_owned(),
                line: 0,
                column: 0,
                message,
                hint: None,
            }));
        };
        let mut reader = Reader { sii: Sii { header, ..Sii::default() }, ..Reader::default() };
        // If the EEPROM was never written, other doubts would only repeat that.
        if let Some(byte) = blank(&image[..HEADER_LEN]) {
            reader.blank(byte);
            let Reader { sii, doubts, .. } = reader;
            return Ok(Self { path: path.to_owned(), image, sii, used: 0, doubts });
        }
        reader.header(&image);
        let used = reader.categories(&image);
        reader.types();
        reader.lacks();
        let Reader { sii, mut doubts, .. } = reader;
        doubts.sort_by_cached_key(|doubt| doubt.word as u64);
        Ok(Self { path: path.to_owned(), image, sii, used, doubts })
    }
}

#[derive(Default)]
struct Reader {
    sii: Sii,
    /// The strings, from number 1.
    strings: Vec<String>,
    doubts: Vec<Doubt>,
    /// Word of the SyncManagers.
    sync_managers_at: Option<usize>,
    /// PDOs that are assigned to a SyncManager.
    assigned: Vec<Assigned>,
    /// Word at which the categories end.
    end: usize,
}

impl Reader {
    fn doubt(
        &mut self,
        kind: DoubtKind,
        word: usize,
        expected: impl Into<String>,
        found: impl Into<String>,
    ) {
        // The number is limited, since an image that is broken everywhere would have a doubt at
        // every few bytes.
        if self.doubts.len() < MOST_DOUBTS {
            let (expected, found) = (expected.into(), found.into());
            // The ESC loads nothing then, and its process RAM stays closed.
            let keeps_from_op = matches!(kind, DoubtKind::Checksum | DoubtKind::Blank);
            self.doubts.push(Doubt { kind, word, expected, found, keeps_from_op });
        }
    }

    fn blank(&mut self, byte: u8) {
        let found = format!("0x{byte:02X} in each byte of the header: never written");
        self.doubt(DoubtKind::Blank, 0, "the content of an EEPROM", found);
    }

    fn header(&mut self, image: &[u8]) {
        let header = self.sii.header;
        let half = |word: usize| u16::from_le_bytes([image[2 * word], image[2 * word + 1]]);
        let (right, found) = (checksum(&header.configuration), half(word::CHECKSUM.into()));
        if found != CHECKSUM_OFF && found.to_le_bytes()[0] != right {
            let found = format!("0x{:02X}", found.to_le_bytes()[0]);
            self.doubt(
                DoubtKind::Checksum,
                word::CHECKSUM.into(),
                format!("0x{right:02X} over words 0 to 6"),
                found,
            );
        }
        for (word, what, number) in [
            (word::VENDOR_ID, "a vendor id", header.vendor_id),
            (word::PRODUCT_CODE, "a product code", header.product_code),
        ] {
            if number == 0 || number == u32::MAX {
                self.doubt(DoubtKind::Identity, word.into(), what, format!("0x{number:08X}"));
            }
        }
        let size = (usize::from(header.size) + 1) * KBIT;
        if size != image.len() {
            let expected = format!("the {} bytes of the file", image.len());
            self.doubt(DoubtKind::Size, SIZE_WORD, expected, format!("{size}"));
        }
        if half(VERSION_WORD) != 1 {
            let found = format!("{}", half(VERSION_WORD));
            self.doubt(DoubtKind::Version, VERSION_WORD, "1", found);
        }
        if !image.len().is_multiple_of(2) {
            let word = image.len() / 2;
            self.doubt(DoubtKind::HalfWord, word, "whole words", format!("{} bytes", image.len()));
        }
    }

    /// Reads all categories; returns the bytes up to the end mark.
    fn categories(&mut self, image: &[u8]) -> usize {
        let mut all: Vec<(usize, u16, &[u8])> = Vec::new();
        let mut at = HEADER_LEN / 2;
        let mut used = None;
        let mut walk = categories(image);
        loop {
            if all.len() == MOST_CATEGORIES {
                let expected = format!("at most {MOST_CATEGORIES} categories");
                self.doubt(DoubtKind::ManyCategories, at, expected, "more; they are not read");
                break;
            }
            match walk.next() {
                None => {
                    used = Some(2 * at + 2);
                    break;
                }
                Some(Ok(found)) => {
                    all.push((at + 2, found.kind, found.data));
                    at += 2 + found.data.len() / 2;
                }
                Some(Err(_)) => {
                    self.no_end(image, at);
                    break;
                }
            }
        }
        self.end = at;
        let strings = all.iter().filter(|(_, kind, _)| *kind == category::STRINGS);
        if let Some((at, _, data)) = strings.clone().next() {
            self.strings(*at, data);
        }
        let mut seen = Vec::new();
        for (at, kind, data) in all {
            // PDOs may be divided; each other category occurs once.
            let once = CATEGORIES_ONCE.contains(&kind);
            if once && seen.contains(&kind) {
                let found = format!("another category {kind}; the first counts");
                self.doubt(DoubtKind::CategoryRepeated, at - 2, "one of each", found);
                continue;
            }
            seen.push(kind);
            self.category(at, kind, data);
        }
        used.unwrap_or(2 * at)
    }

    /// Notes that the categories end without an end mark, at word `at`.
    fn no_end(&mut self, image: &[u8], at: usize) {
        match image.get(2 * at..2 * at + 4) {
            Some(head) => {
                let (kind, words) = (
                    u16::from_le_bytes([head[0], head[1]]),
                    u16::from_le_bytes([head[2], head[3]]),
                );
                let left = image.len() / 2 - at - 2;
                self.doubt(
                    DoubtKind::CategoryCut,
                    at,
                    format!("at most the {left} words that are left"),
                    format!("category {kind} of {words} words; it is not read"),
                );
            }
            None => {
                self.doubt(DoubtKind::EndMark, at, "the end mark 0xFFFF", "the end of the image");
            }
        }
    }

    fn strings(&mut self, at: usize, data: &[u8]) {
        let Some((count, mut rest)) = data.split_first() else { return };
        for number in 1..=*count {
            let here = at + (data.len() - rest.len()) / 2;
            let text = rest.split_first().and_then(|(length, after)| {
                let text = after.get(..usize::from(*length))?;
                rest = &after[text.len()..];
                Some(text)
            });
            let Some(text) = text else {
                let expected = format!("{count} strings in {} bytes", data.len());
                let found = format!("the end of the category within string {number}");
                self.doubt(DoubtKind::StringsCut, here, expected, found);
                return;
            };
            let text = match std::str::from_utf8(text) {
                Ok(text) => text.to_owned(),
                // Older tools write umlauts in Latin-1.
                Err(_) => text.iter().map(|byte| char::from(*byte)).collect(),
            };
            if text.chars().any(char::is_control) {
                let found = format!("string {number}, \"{}\"", text.escape_default());
                self.doubt(
                    DoubtKind::StringUnprintable,
                    here,
                    "letters that can be printed",
                    found,
                );
            }
            self.strings.push(text);
        }
    }

    fn text(&mut self, number: u8, at: usize, what: &str) -> String {
        if number == 0 {
            return String::new();
        }
        match self.strings.get(usize::from(number) - 1) {
            Some(text) => text.clone(),
            None => {
                let expected =
                    format!("0, or one of {} strings for the {what}", self.strings.len());
                self.doubt(DoubtKind::StringMissing, at, expected, format!("string {number}"));
                String::new()
            }
        }
    }

    fn category(&mut self, at: usize, kind: u16, data: &[u8]) {
        match kind {
            category::STRINGS => {}
            category::GENERAL => self.general(at, data),
            category::FMMU => self.fmmus(at, data),
            category::SYNC_MANAGER => {
                self.sync_managers_at = Some(at);
                self.whole_records(at, data, SmRecord::LEN);
                let records = data.chunks_exact(SmRecord::LEN).filter_map(<[u8]>::first_chunk);
                self.sii.sync_managers = records.map(SmRecord::parse).collect();
            }
            category::TX_PDO => {
                let mut pdos = self.pdos(at, data, true);
                self.sii.inputs.append(&mut pdos);
            }
            category::RX_PDO => {
                let mut pdos = self.pdos(at, data, false);
                self.sii.outputs.append(&mut pdos);
            }
            category::DC => self.op_modes(at, data),
            _ => self.sii.others.push(OtherCategory { kind, data: data.to_vec() }),
        }
    }

    fn whole_records(&mut self, at: usize, data: &[u8], length: usize) {
        if !data.len().is_multiple_of(length) {
            let expected = format!("a multiple of {length} bytes");
            self.doubt(DoubtKind::CategoryLength, at - 1, expected, format!("{}", data.len()));
        }
    }

    fn general(&mut self, at: usize, data: &[u8]) {
        if data.len() != General::LEN {
            let expected = format!("{} bytes", General::LEN);
            self.doubt(DoubtKind::CategoryLength, at - 1, expected, format!("{}", data.len()));
        }
        // In a shorter one the rest is 0.
        let byte = |place: usize| data.get(place).copied().unwrap_or(0);
        let half = |place: usize| u16::from_le_bytes([byte(place), byte(place + 1)]);
        self.sii.general = Some(General {
            group: self.text(byte(0x00), at, "group"),
            image: self.text(byte(0x01), at, "picture"),
            order: self.text(byte(0x02), at + 1, "order number"),
            name: self.text(byte(0x03), at + 1, "name"),
            physical_layer: byte(0x04),
            coe_details: byte(0x05),
            foe: byte(0x06),
            eoe: byte(0x07),
            soe_channels: byte(0x08),
            ds402_channels: byte(0x09),
            sysman_class: byte(0x0A),
            flags: byte(0x0B),
            ebus_ma: half(0x0C) as i16,
            group_name: self.text(byte(0x0E), at + 7, "name of the group"),
            ports: half(0x10),
            identification: half(0x12),
        });
    }

    fn fmmus(&mut self, at: usize, data: &[u8]) {
        for (number, found) in data.iter().enumerate() {
            if !matches!(found, 0..=3 | 0xFF) {
                let found = format!("{found} for FMMU {number}");
                self.doubt(DoubtKind::FmmuUse, at + number / 2, "0 to 3, or 255", found);
            }
        }
        self.sii.fmmus = data.to_vec();
    }

    fn pdos(&mut self, at: usize, data: &[u8], inputs: bool) -> Vec<SiiPdo> {
        self.whole_records(at, data, PdoRecord::LEN);
        let mut pdos = Vec::new();
        let words = PdoRecord::LEN / 2;
        let mut records =
            data.chunks_exact(PdoRecord::LEN).filter_map(<[u8]>::first_chunk).enumerate();
        while let Some((number, head)) = records.next() {
            let here = at + number * words;
            let record = PdoRecord::parse(head);
            let mut entries = Vec::new();
            for (number, entry) in records.by_ref().take(record.entries.into()) {
                let entry = PdoEntryRecord::parse(entry);
                entries.push(SiiEntry {
                    index: entry.index,
                    sub: entry.sub,
                    name: self.text(entry.name, at + number * words + 1, "entry"),
                    data_type: entry.data_type,
                    bits: entry.bits,
                    flags: entry.flags,
                });
            }
            if entries.len() < usize::from(record.entries) {
                let expected = format!("{} entries of PDO 0x{:04X}", record.entries, record.index);
                self.doubt(DoubtKind::PdoCut, here, expected, format!("{}", entries.len()));
            }
            let sync_manager = (record.sm != NO_SYNC_MANAGER).then_some(record.sm);
            let (index, word) = (record.index, here + 1);
            self.assigned.extend(sync_manager.map(|sync_manager| Assigned {
                index,
                inputs,
                sync_manager,
                word,
            }));
            pdos.push(SiiPdo {
                index: record.index,
                sync_manager,
                sync_unit: record.sync_unit,
                name: self.text(record.name, here + 2, "PDO"),
                flags: record.flags,
                entries,
            });
        }
        pdos
    }

    fn op_modes(&mut self, at: usize, data: &[u8]) {
        self.whole_records(at, data, SiiOpMode::LEN);
        let records = data.chunks_exact(SiiOpMode::LEN).filter_map(<[u8]>::first_chunk::<24>);
        for (number, record) in records.enumerate() {
            let here = at + number * SiiOpMode::LEN / 2 + 9;
            let name = self.text(record[0x12], here, "OpMode");
            let description = self.text(record[0x13], here, "description of the OpMode");
            self.sii.op_modes.push(SiiOpMode::of_record(record, name, description));
        }
    }

    fn types(&mut self) {
        let first = self.sync_managers_at.unwrap_or(self.end);
        for (number, record) in self.sii.sync_managers.clone().into_iter().enumerate() {
            if record.kind > sm_type::INPUTS {
                let found = format!("{} for SyncManager {number}", record.kind);
                let at = first + number * SmRecord::LEN / 2 + 3;
                self.doubt(DoubtKind::SyncManagerType, at, "0 to 4", found);
            }
        }
    }

    /// Adds what the content lacks as a whole.
    fn lacks(&mut self) {
        let mut found = lacks(&Content {
            header: &self.sii.header,
            has_general: self.sii.general.is_some(),
            sync_managers: &self.sii.sync_managers,
            sync_managers_at: self.sync_managers_at,
            pdos: self.sii.inputs.len() + self.sii.outputs.len(),
            assigned: &self.assigned,
            end: self.end,
        });
        // What keeps from OP is told even if everything else is broken as well.
        found.truncate(MOST_DOUBTS);
        self.doubts.truncate(MOST_DOUBTS - found.len());
        self.doubts.append(&mut found);
    }
}

/// A checksum that switches the check off.
const CHECKSUM_OFF: u16 = 0x88A4;
const SIZE_WORD: usize = 0x3E;
const VERSION_WORD: usize = 0x3F;
/// Bytes per kbit.
const KBIT: usize = 128;
/// A PDO that is not assigned.
const NO_SYNC_MANAGER: u8 = 0xFF;
/// Largest number of categories: the richest known image has a dozen, but a broken file could have
/// thousands of empty ones.
const MOST_CATEGORIES: usize = 256;
const MOST_DOUBTS: usize = 256;
const CATEGORIES_ONCE: [u16; 5] =
    [category::STRINGS, category::GENERAL, category::FMMU, category::SYNC_MANAGER, category::DC];
