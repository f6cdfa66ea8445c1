//! From an [`Sii`] to an image.

use std::fmt;

use isocat_wire::sii::{
    HEADER_LEN, Header, ImageFull, PdoEntryRecord, PdoRecord, SmRecord, Writer, category,
};

use super::{General, Sii, SiiOpMode, SiiPdo};

/// Handling of names that exceed the category of strings: it holds 255 strings of 255 bytes each.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Names {
    /// They are an error.
    All,
    /// A name that is too long is cut, and surplus names are left out.
    Fitting,
}

/// Why there is no image.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Unwritable {
    /// Number of different names, which exceeds the limit.
    Names(usize),
    /// A name that is too long.
    Name(String),
    /// Number of bytes, which exceeds the largest EEPROM.
    TooLong(usize),
}

impl fmt::Display for Unwritable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Names(count) => {
                write!(f, "{count} different names; the SII has room for {MOST_STRINGS}")
            }
            Self::Name(text) => {
                write!(f, "the name \"{text}\" is longer than the 255 bytes of the SII")
            }
            Self::TooLong(most) => {
                write!(f, "the SII image is too long; expected at most {most} bytes")
            }
        }
    }
}

impl std::error::Error for Unwritable {}

impl Sii {
    /// The image in the smallest usual EEPROM that holds it and has `least` bytes, or the largest
    /// one. Its header has that size; the checksum is right.
    ///
    /// Strings come first, since the others refer to them; then General, FMMU, SyncM, TxPDO, RxPDO,
    /// DC, and all others.
    pub fn image(&self, least: usize, names: Names) -> Result<Vec<u8>, Unwritable> {
        let mut strings = Strings { texts: Vec::new(), names };
        // Vendors' tools number the texts in this order.
        let general = self.general.as_ref().map(|general| general_data(general, &mut strings));
        let op_modes = op_modes(&self.op_modes, &mut strings);
        let inputs = pdos(&self.inputs, &mut strings);
        let outputs = pdos(&self.outputs, &mut strings);
        let sync_managers = self.sync_managers.iter().flat_map(SmRecord::emit).collect();
        let strings = padded(strings.finish()?);
        let fmmus = padded(self.fmmus.clone());
        let mut categories = vec![
            (category::FMMU, &fmmus),
            (category::SYNC_MANAGER, &sync_managers),
            (category::TX_PDO, &inputs),
            (category::RX_PDO, &outputs),
            (category::DC, &op_modes),
        ];
        categories.retain(|(_, data)| !data.is_empty());
        let general = general.as_ref().map(|general| (category::GENERAL, general));
        let first = [(category::STRINGS, &strings)].into_iter().chain(general);
        categories.splice(..0, first);
        // A category that is kept unchanged may be empty.
        categories.extend(self.others.iter().map(|other| (other.kind, &other.data)));
        let write = |size: usize| -> Result<Vec<u8>, ImageFull> {
            let mut image = vec![0; size];
            let header = Header { size: (size / KBIT - 1) as u16, ..self.header };
            let mut writer = Writer::new(&mut image, &header)?;
            for (kind, data) in &categories {
                writer.category(*kind, data)?;
            }
            writer.finish()?;
            Ok(image)
        };
        let most = SIZES[SIZES.len() - 1];
        let mut sizes = SIZES.into_iter().filter(|size| *size >= least.min(most));
        sizes.find_map(|size| write(size).ok()).ok_or(Unwritable::TooLong(most))
    }
}

/// Vendors pad odd bytes with 0xFF; as the use of an FMMU it means none.
fn padded(mut data: Vec<u8>) -> Vec<u8> {
    data.resize(data.len().next_multiple_of(2), 0xFF);
    data
}

fn general_data(general: &General, strings: &mut Strings) -> Vec<u8> {
    let mut data = vec![0; General::LEN];
    data[0x02] = strings.number(&general.order);
    data[0x00] = strings.number(&general.group);
    data[0x0E] = strings.number(&general.group_name);
    data[0x03] = strings.number(&general.name);
    data[0x01] = strings.number(&general.image);
    data[0x04] = general.physical_layer;
    data[0x05] = general.coe_details;
    data[0x06] = general.foe;
    data[0x07] = general.eoe;
    data[0x08] = general.soe_channels;
    data[0x09] = general.ds402_channels;
    data[0x0A] = general.sysman_class;
    data[0x0B] = general.flags;
    data[0x0C..0x0E].copy_from_slice(&general.ebus_ma.to_le_bytes());
    data[0x10..0x12].copy_from_slice(&general.ports.to_le_bytes());
    data[0x12..0x14].copy_from_slice(&general.identification.to_le_bytes());
    data
}

fn op_modes(modes: &[SiiOpMode], strings: &mut Strings) -> Vec<u8> {
    let mut data = Vec::new();
    for mode in modes {
        let mut record = mode.record();
        record[0x12] = strings.number(&mode.name);
        record[0x13] = strings.number(&mode.description);
        data.extend(record);
    }
    data
}

fn pdos(pdos: &[SiiPdo], strings: &mut Strings) -> Vec<u8> {
    let mut data = Vec::new();
    for pdo in pdos {
        let record = PdoRecord {
            index: pdo.index,
            entries: pdo.entries.len().min(255) as u8,
            sm: pdo.sync_manager.unwrap_or(0xFF),
            sync_unit: pdo.sync_unit,
            name: strings.number(&pdo.name),
            flags: pdo.flags,
        };
        data.extend(record.emit());
        for entry in pdo.entries.iter().take(255) {
            let record = PdoEntryRecord {
                index: entry.index,
                sub: entry.sub,
                name: strings.number(&entry.name),
                data_type: entry.data_type,
                bits: entry.bits,
                flags: entry.flags,
            };
            data.extend(record.emit());
        }
    }
    data
}

/// The strings category: every text once.
struct Strings {
    texts: Vec<String>,
    names: Names,
}

impl Strings {
    /// Number of a text, from 1; 0 for none.
    fn number(&mut self, text: &str) -> u8 {
        if text.is_empty() {
            return 0;
        }
        let fitting = self.names == Names::Fitting;
        let text = if fitting { cut(text) } else { text };
        let known = self.texts.iter().position(|known| known == text);
        if known.is_none() && fitting && self.texts.len() == MOST_STRINGS {
            return 0;
        }
        let position = known.unwrap_or_else(|| {
            self.texts.push(text.to_owned());
            self.texts.len() - 1
        });
        // More than 255 are refused by `finish`.
        (position + 1) as u8
    }

    fn finish(self) -> Result<Vec<u8>, Unwritable> {
        if self.texts.len() > MOST_STRINGS {
            return Err(Unwritable::Names(self.texts.len()));
        }
        let mut data = vec![self.texts.len() as u8];
        for text in &self.texts {
            let Ok(length) = u8::try_from(text.len()) else {
                return Err(Unwritable::Name(text.clone()));
            };
            data.push(length);
            data.extend(text.as_bytes());
        }
        Ok(data)
    }
}

/// A text cut to at most 255 bytes, in whole characters.
fn cut(text: &str) -> &str {
    let end = (0..=text.len().min(255)).rev().find(|end| text.is_char_boundary(*end));
    &text[..end.unwrap_or(0)]
}

const MOST_STRINGS: usize = 255;
/// Bytes per kbit.
const KBIT: usize = 128;
/// EEPROM sizes in bytes, 16 kbit to 512 kbit.
const SIZES: [usize; 6] = [2_048, 4_096, 8_192, 16_384, 32_768, 65_536];
const _: () = assert!(SIZES[0] > HEADER_LEN);
