//! The SII: the image in a SubDevice's EEPROM.
//!
//! A header of 64 words is followed by categories, each with a word for its type, a word for its
//! length, and data; type 0xFFFF ends them. [`Header`] and [`categories`] read an image, [`Writer`]
//! makes one.

use core::fmt;

use crate::register::Value;
use crate::sync_manager::SyncManager;

/// Word addresses in the header.
pub mod word {
    /// First word of the ESC configuration area.
    pub const CONFIGURATION: u16 = 0x00;
    /// Checksum of the configuration area.
    pub const CHECKSUM: u16 = 0x07;
    /// Vendor id.
    pub const VENDOR_ID: u16 = 0x08;
    /// Product code.
    pub const PRODUCT_CODE: u16 = 0x0A;
    /// Revision.
    pub const REVISION: u16 = 0x0C;
    /// Serial number.
    pub const SERIAL: u16 = 0x0E;
    /// Standard receive mailbox: offset, then size.
    pub const RECEIVE_MAILBOX: u16 = 0x18;
    /// Standard send mailbox: offset, then size.
    pub const SEND_MAILBOX: u16 = 0x1A;
    /// Mailbox protocols.
    pub const MAILBOX_PROTOCOLS: u16 = 0x1C;
    /// First category.
    pub const CATEGORIES: u16 = 0x40;
}

/// Bytes of the header.
pub const HEADER_LEN: usize = 0x80;

/// Category types.
pub mod category {
    /// Strings.
    pub const STRINGS: u16 = 10;
    /// General.
    pub const GENERAL: u16 = 30;
    /// Use of each FMMU.
    pub const FMMU: u16 = 40;
    /// SyncManagers.
    pub const SYNC_MANAGER: u16 = 41;
    /// TxPDOs (inputs).
    pub const TX_PDO: u16 = 50;
    /// RxPDOs (outputs).
    pub const RX_PDO: u16 = 51;
    /// DC operation modes.
    pub const DC: u16 = 60;
    /// The end mark: no category follows.
    pub const END: u16 = 0xFFFF;
}

/// CRC-8 over the 14 bytes of words 0 to 6: polynomial 0x07, initial value 0xFF.
pub const fn checksum(configuration: &[u8; 14]) -> u8 {
    let mut crc = 0xFFu8;
    let mut i = 0;
    while i < configuration.len() {
        crc ^= configuration[i];
        let mut bit = 0;
        while bit < 8 {
            crc = if crc & 0x80 != 0 { crc << 1 ^ 0x07 } else { crc << 1 };
            bit += 1;
        }
        i += 1;
    }
    crc
}

/// The one value of all bytes, if nothing was ever written: 0xFF as in an erased chip, or 0x00.
/// `None` for an image with content, and for no bytes.
pub fn blank(bytes: &[u8]) -> Option<u8> {
    let first = *bytes.first()?;
    (matches!(first, 0x00 | 0xFF) && bytes.iter().all(|byte| *byte == first)).then_some(first)
}

/// A mailbox area.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct MailboxArea {
    /// First byte.
    pub start: u16,
    /// Bytes.
    pub length: u16,
}

/// The fields of the first 64 words.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Header {
    /// Words 0 to 6: PDI and ESC configuration, pulse length (word 2), alias (word 4).
    pub configuration: [u8; 14],
    /// Vendor id.
    pub vendor_id: u32,
    /// Product code.
    pub product_code: u32,
    /// Revision.
    pub revision: u32,
    /// Serial number.
    pub serial: u32,
    /// MainDevice to SubDevice in BOOT.
    pub boot_receive: MailboxArea,
    /// SubDevice to MainDevice in BOOT.
    pub boot_send: MailboxArea,
    /// MainDevice to SubDevice.
    pub receive: MailboxArea,
    /// SubDevice to MainDevice.
    pub send: MailboxArea,
    /// Bit 0 AoE, 1 EoE, 2 CoE, 3 FoE, 4 SoE, 5 VoE.
    pub protocols: u16,
    /// Size of the EEPROM in kbit, less one.
    pub size: u16,
}

impl Header {
    /// Protocol bit of CoE.
    pub const COE: u16 = 1 << 2;
    /// Protocol bit of SoE.
    pub const SOE: u16 = 1 << 4;
    /// Bit of register 0x0141, the high byte of word 0: the ESC answers state requests by itself,
    /// without a CPU.
    pub const DEVICE_EMULATION: u8 = 0x01;

    /// Whether the ESC answers state requests by itself, without a CPU that checks anything.
    pub const fn emulates(&self) -> bool {
        self.configuration[1] & Self::DEVICE_EMULATION != 0
    }

    /// Reads the header; `None` if the image is shorter. The checksum is not checked here, since
    /// the ESC does so.
    pub fn parse(image: &[u8]) -> Option<Self> {
        let b: &[u8; HEADER_LEN] = image.first_chunk()?;
        let half = |word: usize| u16::from_le_bytes([b[2 * word], b[2 * word + 1]]);
        let full = |word: usize| u32::from(half(word)) | u32::from(half(word + 1)) << 16;
        let area = |word: usize| MailboxArea { start: half(word), length: half(word + 1) };
        Some(Self {
            configuration: *b.first_chunk()?,
            vendor_id: full(0x08),
            product_code: full(0x0A),
            revision: full(0x0C),
            serial: full(0x0E),
            boot_receive: area(0x14),
            boot_send: area(0x16),
            receive: area(0x18),
            send: area(0x1A),
            protocols: half(0x1C),
            size: half(0x3E),
        })
    }
}

/// One category: its type and its data.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Category<'a> {
    /// Type, see [`category`].
    pub kind: u16,
    /// Data; their length is even.
    pub data: &'a [u8],
}

/// The image ends without an end mark of its categories.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Truncated {
    /// Word address at which the image ends too early.
    pub word: usize,
}

impl fmt::Display for Truncated {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "SII ends at word {:#06x} within a category, expected the end mark 0xFFFF",
            self.word
        )
    }
}

/// All categories of an image, up to its end mark.
pub fn categories(image: &[u8]) -> impl Iterator<Item = Result<Category<'_>, Truncated>> {
    let mut at = Some(HEADER_LEN);
    core::iter::from_fn(move || {
        let start = at.take()?;
        let truncated = Some(Err(Truncated { word: start / 2 }));
        let Some(&[k0, k1]) = image.get(start..).and_then(|rest| rest.first_chunk()) else {
            return truncated;
        };
        let kind = u16::from_le_bytes([k0, k1]);
        if kind == category::END {
            return None;
        }
        let Some(&[l0, l1]) = image.get(start + 2..).and_then(|rest| rest.first_chunk()) else {
            return truncated;
        };
        let end = start + 4 + 2 * usize::from(u16::from_le_bytes([l0, l1]));
        let Some(data) = image.get(start + 4..end) else { return truncated };
        at = Some(end);
        Some(Ok(Category { kind, data }))
    })
}

/// String `number` (from 1) of a strings category; `None` if there is no such string.
pub fn string(data: &[u8], number: u8) -> Option<&[u8]> {
    let mut rest = data.get(1..)?;
    let count = *data.first()?;
    if number == 0 || number > count {
        return None;
    }
    for _ in 1..number {
        let len = usize::from(*rest.first()?);
        rest = rest.get(1 + len..)?;
    }
    let len = usize::from(*rest.first()?);
    rest.get(1..1 + len)
}

/// The use of a SyncManager, the last byte of its record.
pub mod sm_type {
    /// Not used.
    pub const UNUSED: u8 = 0;
    /// Mailbox, MainDevice to SubDevice.
    pub const MAILBOX_OUT: u8 = 1;
    /// Mailbox, SubDevice to MainDevice.
    pub const MAILBOX_IN: u8 = 2;
    /// Outputs.
    pub const OUTPUTS: u8 = 3;
    /// Inputs.
    pub const INPUTS: u8 = 4;
}

/// A SyncManager record: eight bytes.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct SmRecord {
    /// Start address of the area.
    pub start: u16,
    /// Default length.
    pub length: u16,
    /// Control byte, see [`SyncManager`].
    pub control: u8,
    /// Status byte, 0.
    pub status: u8,
    /// Bit 0 enable, 1 fixed content, 2 virtual, 3 OP only.
    pub enable: u8,
    /// See [`sm_type`].
    pub kind: u8,
}

impl SmRecord {
    /// Bytes of a record.
    pub const LEN: usize = 8;
    /// Bit of [`enable`](Self::enable): switched on.
    pub const ENABLED: u8 = 0x01;
    /// Bit of [`enable`](Self::enable): no SyncManager is activated, an FMMU alone maps the bytes.
    pub const VIRTUAL: u8 = 0x04;
    /// Bit of [`enable`](Self::enable): switched on in OP only.
    pub const OP_ONLY: u8 = 0x08;

    /// Whether it is a window: PDOs that are assigned to it are mapped by an FMMU alone, as a rule
    /// to registers. A mailbox always needs its SyncManager, whatever its record says.
    pub const fn is_window(&self) -> bool {
        let mailbox = matches!(self.kind, sm_type::MAILBOX_OUT | sm_type::MAILBOX_IN);
        self.enable & Self::VIRTUAL != 0 && !mailbox
    }

    /// Reads the eight bytes.
    pub fn parse(b: &[u8; 8]) -> Self {
        let sm = SyncManager::from_bytes(*b);
        Self {
            start: sm.start,
            length: sm.length,
            control: b[4],
            status: b[5],
            enable: b[6],
            kind: b[7],
        }
    }
    /// Writes the eight bytes.
    pub const fn emit(&self) -> [u8; 8] {
        let (s, l) = (self.start.to_le_bytes(), self.length.to_le_bytes());
        [s[0], s[1], l[0], l[1], self.control, self.status, self.enable, self.kind]
    }
}

/// The head of a PDO in the categories 50 and 51: eight bytes, followed by eight for each entry.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct PdoRecord {
    /// PDO index.
    pub index: u16,
    /// Number of entries that follow.
    pub entries: u8,
    /// SyncManager it is assigned to by default, 0xFF for none.
    pub sm: u8,
    /// Sync unit.
    pub sync_unit: u8,
    /// String number of its name.
    pub name: u8,
    /// Flags: bit 0 mandatory, 1 default, 4 fixed.
    pub flags: u16,
}

impl PdoRecord {
    /// Length of the head, and of each entry, in bytes.
    pub const LEN: usize = 8;
    /// Reads the eight bytes.
    pub const fn parse(b: &[u8; 8]) -> Self {
        Self {
            index: u16::from_le_bytes([b[0], b[1]]),
            entries: b[2],
            sm: b[3],
            sync_unit: b[4],
            name: b[5],
            flags: u16::from_le_bytes([b[6], b[7]]),
        }
    }
    /// Writes the eight bytes.
    pub const fn emit(&self) -> [u8; 8] {
        let (i, f) = (self.index.to_le_bytes(), self.flags.to_le_bytes());
        [i[0], i[1], self.entries, self.sm, self.sync_unit, self.name, f[0], f[1]]
    }
}

/// An entry of a PDO in the categories 50 and 51.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct PdoEntryRecord {
    /// Object index, 0 for padding.
    pub index: u16,
    /// Sub-index.
    pub sub: u8,
    /// String number of its name.
    pub name: u8,
    /// Low byte of the type code.
    pub data_type: u8,
    /// Length in bits.
    pub bits: u8,
    /// Flags.
    pub flags: u16,
}

impl PdoEntryRecord {
    /// Reads the eight bytes.
    pub const fn parse(b: &[u8; 8]) -> Self {
        Self {
            index: u16::from_le_bytes([b[0], b[1]]),
            sub: b[2],
            name: b[3],
            data_type: b[4],
            bits: b[5],
            flags: u16::from_le_bytes([b[6], b[7]]),
        }
    }
    /// Writes the eight bytes.
    pub const fn emit(&self) -> [u8; 8] {
        let (i, f) = (self.index.to_le_bytes(), self.flags.to_le_bytes());
        [i[0], i[1], self.sub, self.name, self.data_type, self.bits, f[0], f[1]]
    }
}

/// Makes an image in the caller's buffer: first the header, then the categories, then
/// [`Writer::finish`].
#[derive(Debug)]
pub struct Writer<'a> {
    image: &'a mut [u8],
    at: usize,
}

/// The image does not fit into its buffer.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct ImageFull;

impl<'a> Writer<'a> {
    /// Writes the header with its checksum. The rest of the buffer becomes 0xFF, as in an erased
    /// chip.
    pub fn new(image: &'a mut [u8], header: &Header) -> Result<Self, ImageFull> {
        if image.len() < HEADER_LEN {
            return Err(ImageFull);
        }
        image.fill(0xFF);
        image[..HEADER_LEN].fill(0);
        let mut half = |word: usize, value: u16| {
            image[2 * word..2 * word + 2].copy_from_slice(&value.to_le_bytes());
        };
        let mut put = |words: usize, value: u32| {
            half(words, value as u16);
            half(words + 1, (value >> 16) as u16);
        };
        put(0x08, header.vendor_id);
        put(0x0A, header.product_code);
        put(0x0C, header.revision);
        put(0x0E, header.serial);
        for (word, area) in [
            (0x14, header.boot_receive),
            (0x16, header.boot_send),
            (0x18, header.receive),
            (0x1A, header.send),
        ] {
            put(word, u32::from(area.start) | u32::from(area.length) << 16);
        }
        half(0x1C, header.protocols);
        half(0x3E, header.size);
        half(0x3F, 1);
        half(0x07, u16::from(checksum(&header.configuration)));
        image[..14].copy_from_slice(&header.configuration);
        Ok(Self { image, at: HEADER_LEN })
    }

    /// Adds a category; data of odd length are padded with 0.
    pub fn category(&mut self, kind: u16, data: &[u8]) -> Result<(), ImageFull> {
        let words = data.len().div_ceil(2);
        let end = self.at + 4 + 2 * words;
        if end + 2 > self.image.len() || words > usize::from(u16::MAX) {
            return Err(ImageFull);
        }
        let area = &mut self.image[self.at..end];
        area.fill(0);
        area[..2].copy_from_slice(&kind.to_le_bytes());
        area[2..4].copy_from_slice(&(words as u16).to_le_bytes());
        area[4..4 + data.len()].copy_from_slice(data);
        self.at = end;
        Ok(())
    }

    /// Writes the end mark. Returns the number of bytes used.
    pub fn finish(self) -> Result<usize, ImageFull> {
        let end = self.at + 2;
        self.image.get_mut(self.at..end).ok_or(ImageFull)?.fill(0xFF);
        Ok(end)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn checksums_of_real_images() {
        let bytes = |start: &[u8]| {
            let mut all = [0; 14];
            all[..start.len()].copy_from_slice(start);
            all
        };
        assert_eq!(checksum(&bytes(&[0x80, 0x06, 0x00, 0x44, 0x64])), 0xF3);
        assert_eq!(checksum(&bytes(&[0x05, 0x0E, 0x03, 0x06, 0x10, 0x27])), 0xD7);
    }

    #[test]
    fn a_blank_image_has_one_value() {
        assert_eq!([blank(&[0xFF; 4]), blank(&[0; 4])], [Some(0xFF), Some(0)]);
        for content in [&[0xFF, 0xFF, 0xFF, 0x00][..], &[0, 0, 0, 1], &[0x5A; 4], &[]] {
            assert_eq!(blank(content), None, "{content:?}");
        }
    }

    #[test]
    fn a_mailbox_is_no_window() {
        let is_window =
            |enable, kind| SmRecord::parse(&[0, 0, 0, 0, 0, 0, enable, kind]).is_window();
        let (on, window) = (SmRecord::ENABLED, SmRecord::VIRTUAL);
        for kind in [sm_type::UNUSED, sm_type::OUTPUTS, sm_type::INPUTS] {
            assert!(is_window(window, kind) && is_window(on | window, kind));
            assert!(!is_window(on, kind) && !is_window(SmRecord::OP_ONLY, kind));
        }
        for kind in [sm_type::MAILBOX_OUT, sm_type::MAILBOX_IN] {
            assert!(!is_window(window, kind));
        }
    }

    #[test]
    fn an_image_reads_back() {
        let mut image = [0; 256];
        let header = Header {
            configuration: [0x05, 0x0E, 0x03, 0x06, 0x10, 0x27, 0, 0, 0, 0, 0, 0, 0, 0],
            vendor_id: 2,
            product_code: 0x09C6_3052,
            send: MailboxArea { start: 0x1080, length: 128 },
            protocols: Header::COE,
            ..Default::default()
        };
        let mut writer = Writer::new(&mut image, &header).unwrap();
        writer.category(category::STRINGS, b"\x02\x03one\x05three").unwrap();
        writer.category(category::FMMU, &[1, 2, 3]).unwrap();
        let len = writer.finish().unwrap();
        assert_eq!(image[14], 0xD7);
        assert_eq!(Header::parse(&image), Some(header));
        let found: std::vec::Vec<_> = categories(&image[..len]).map(|c| c.unwrap()).collect();
        assert_eq!(string(found[0].data, 2), Some(&b"three"[..]));
        assert_eq!(string(found[0].data, 3), None);
        assert_eq!(found[1].data, [1, 2, 3, 0]);
        assert_eq!(
            categories(&image[..len - 2]).last(),
            Some(Err(Truncated { word: len / 2 - 1 }))
        );
    }

    #[test]
    fn a_full_buffer_is_an_error() {
        let mut image = [0; HEADER_LEN + 6];
        let mut writer = Writer::new(&mut image, &Header::default()).unwrap();
        assert_eq!(writer.category(category::FMMU, &[1, 2]), Err(ImageFull));
        assert!(writer.finish().is_ok());
    }
}
