//! SII: the content of a SubDevice's EEPROM, read from a file and written from a description.
//!
//! Bytes of a file (`hex` for Intel HEX) become a [`SiiFile`] (`read`): its [`Sii`], which has
//! every category of the standard as typed values and keeps all others unchanged, and every
//! [`Doubt`] with its word, the expected and the found value. Only a file without a complete header
//! is refused. `write` makes an image of a [`Sii`]: from a file, from an ESI file
//! ([`EsiFile::sii`]) or from a profile. `report` gives the content of a file, for programs and
//! people. `complete` judges whether a content has what the way up to OP needs, of a file as of
//! what a MainDevice read.
//!
//! [`EsiFile::sii`]: crate::esi::EsiFile::sii

use std::fmt;

use isocat_wire::sii::{Header, SmRecord};

mod complete;
mod hex;
mod read;
pub mod report;
#[cfg(test)]
mod tests;
mod text;
mod write;

pub use complete::{Assigned, Content, lacks};
pub use write::{Names, Unwritable};

/// An SII with its file.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct SiiFile {
    /// The name of the file in errors.
    pub path: String,
    /// The image: all bytes of the file, Intel HEX decoded.
    pub image: Vec<u8>,
    /// Its content.
    pub sii: Sii,
    /// Bytes up to and including the end mark; without one, as far as could be read.
    pub used: usize,
    /// Doubts, in the order of the words.
    pub doubts: Vec<Doubt>,
}

/// The content of an SII.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Sii {
    /// The first 64 words.
    pub header: Header,
    /// Category 30; `None` if it is missing.
    pub general: Option<General>,
    /// Category 40: 1 outputs, 2 inputs, 3 mailbox state, 0 and 0xFF unused.
    pub fmmus: Vec<u8>,
    /// Category 41.
    pub sync_managers: Vec<SmRecord>,
    /// Category 50, TxPDOs.
    pub inputs: Vec<SiiPdo>,
    /// Category 51, RxPDOs.
    pub outputs: Vec<SiiPdo>,
    /// Category 60.
    pub op_modes: Vec<SiiOpMode>,
    /// All other categories, in their order.
    pub others: Vec<OtherCategory>,
}

/// Category 30. Texts replace their numbers in the category of strings; an empty one has the number
/// 0.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct General {
    /// Type of the group.
    pub group: String,
    /// Name of the picture.
    pub image: String,
    /// Order number: the device type.
    pub order: String,
    /// Name.
    pub name: String,
    /// Byte 4, which older files use for the physical layer.
    pub physical_layer: u8,
    /// Bit 0 SDO, 1 SDO information, 2 PDO assignment, 3 PDO configuration, 4 upload at start, 5
    /// complete access.
    pub coe_details: u8,
    /// FoE, as in the file.
    pub foe: u8,
    /// EoE, as in the file.
    pub eoe: u8,
    /// Channels of SoE.
    pub soe_channels: u8,
    /// Channels of DS402.
    pub ds402_channels: u8,
    /// SysMan class.
    pub sysman_class: u8,
    /// Bit 0 SAFEOP, 1 no LRW, 2 mailbox data link layer, 3 and 4 identification.
    pub flags: u8,
    /// Current on the EBUS in mA; negative for devices that feed it.
    pub ebus_ma: i16,
    /// Byte 14: a repetition of the group, or the name of the group.
    pub group_name: String,
    /// Kind of each port, four bits from port 0: 0 unused, 1 MII, 3 EBUS, 4 fast hot connect.
    pub ports: u16,
    /// Place of the identification.
    pub identification: u16,
}

impl General {
    /// Bytes of the category.
    pub const LEN: usize = 32;

    /// The ports by letter, as in an ESI file: Y MII, K EBUS, H fast hot connect, blank unused.
    pub fn physics(&self) -> String {
        let letter = |port: u32| match self.ports >> (4 * port) & 0xF {
            0 => ' ',
            3 => 'K',
            4 => 'H',
            _ => 'Y',
        };
        (0..4).map(letter).collect::<String>().trim_end().to_owned()
    }
}

/// A PDO of categories 50 and 51.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct SiiPdo {
    /// Index of its mapping object.
    pub index: u16,
    /// SyncManager to which it is assigned; `None` for none (0xFF).
    pub sync_manager: Option<u8>,
    /// Sync unit.
    pub sync_unit: u8,
    /// Name.
    pub name: String,
    /// Bit 0 mandatory, 1 default, 4 fixed.
    pub flags: u16,
    /// Mapped entries, at most 255.
    pub entries: Vec<SiiEntry>,
}

impl SiiPdo {
    /// Flag: it must stay assigned.
    pub const MANDATORY: u16 = 0x0001;
    /// Flag: its entries cannot be changed.
    pub const FIXED: u16 = 0x0010;

    /// Bits of all entries.
    pub fn bits(&self) -> u32 {
        self.entries.iter().map(|entry| u32::from(entry.bits)).sum()
    }
}

/// An entry of a PDO.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct SiiEntry {
    /// Index, 0 for padding.
    pub index: u16,
    /// Sub-index.
    pub sub: u8,
    /// Name.
    pub name: String,
    /// Low byte of the type's code.
    pub data_type: u8,
    /// Bits.
    pub bits: u8,
    /// Flags.
    pub flags: u16,
}

/// An OpMode of category 60.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct SiiOpMode {
    /// Name.
    pub name: String,
    /// Description.
    pub description: String,
    /// Low byte for register 0x0980, high byte for 0x0981.
    pub assign_activate: u16,
    /// Cycle of SYNC0, ns; 0 if the factor is used.
    pub cycle_time_0: u32,
    /// Phase of SYNC0, ns.
    pub shift_time_0: i32,
    /// Phase of SYNC1, ns.
    pub shift_time_1: i32,
    /// Ratio of SYNC0's cycle to the bus cycle.
    pub sync0_factor: i16,
    /// Ratio of SYNC1's cycle to that of SYNC0.
    pub sync1_factor: i16,
}

impl SiiOpMode {
    /// Bytes of an OpMode.
    pub const LEN: usize = 24;

    /// The record without its texts: their numbers are 0.
    pub fn record(&self) -> [u8; Self::LEN] {
        let mut record = [0; Self::LEN];
        record[0x00..0x04].copy_from_slice(&self.cycle_time_0.to_le_bytes());
        record[0x04..0x08].copy_from_slice(&self.shift_time_0.to_le_bytes());
        record[0x08..0x0C].copy_from_slice(&self.shift_time_1.to_le_bytes());
        record[0x0C..0x0E].copy_from_slice(&self.sync1_factor.to_le_bytes());
        record[0x0E..0x10].copy_from_slice(&self.assign_activate.to_le_bytes());
        record[0x10..0x12].copy_from_slice(&self.sync0_factor.to_le_bytes());
        record
    }

    /// The OpMode of a record with these texts.
    pub fn of_record(r: &[u8; Self::LEN], name: String, description: String) -> Self {
        Self {
            name,
            description,
            cycle_time_0: u32::from_le_bytes([r[0], r[1], r[2], r[3]]),
            shift_time_0: i32::from_le_bytes([r[4], r[5], r[6], r[7]]),
            shift_time_1: i32::from_le_bytes([r[8], r[9], r[10], r[11]]),
            sync1_factor: i16::from_le_bytes([r[12], r[13]]),
            assign_activate: u16::from_le_bytes([r[14], r[15]]),
            sync0_factor: i16::from_le_bytes([r[16], r[17]]),
        }
    }
}

/// A category that is kept unchanged.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct OtherCategory {
    /// Its type.
    pub kind: u16,
    /// Its bytes; their number is even.
    pub data: Vec<u8>,
}

/// A contradiction of an image to the standard or to itself, or something that it lacks.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Doubt {
    /// The kind.
    pub kind: DoubtKind,
    /// Its word.
    pub word: usize,
    /// The expected value.
    pub expected: String,
    /// The found value.
    pub found: String,
    /// Whether it keeps a device with this EEPROM from OP.
    pub keeps_from_op: bool,
}

impl fmt::Display for Doubt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { kind, word, expected, found, .. } = self;
        write!(f, "word {word:#06x}: {}: expected {expected}, found {found}", kind.name())
    }
}

/// The kind of a doubt about an image.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub enum DoubtKind {
    /// The configuration area has a wrong checksum, so the ESC does not load it.
    Checksum,
    /// The version is not 1.
    Version,
    /// The size in the header differs from that of the file.
    Size,
    /// Vendor or product code is missing.
    Identity,
    /// The file ends with half a word.
    HalfWord,
    /// A category ends after the end of the file.
    CategoryCut,
    /// There is no end mark.
    EndMark,
    /// There are more categories than the limit.
    ManyCategories,
    /// A category occurs twice.
    CategoryRepeated,
    /// The length of a category is no whole number of records.
    CategoryLength,
    /// The strings continue after the end of their category.
    StringsCut,
    /// A string has characters that cannot be printed.
    StringUnprintable,
    /// A text has the number of a missing string.
    StringMissing,
    /// The entries of a PDO continue after the end of their category.
    PdoCut,
    /// A PDO is assigned to a SyncManager that is not listed, or not for process data.
    PdoSyncManager,
    /// The use of an FMMU is unknown.
    FmmuUse,
    /// The type of a SyncManager is unknown.
    SyncManagerType,
    /// The mailbox areas of the SyncManagers differ from the header.
    MailboxArea,
    /// There are protocols without a mailbox, or a mailbox without protocols.
    MailboxProtocols,
    /// Nothing was ever written to the EEPROM.
    Blank,
    /// There are no SyncManagers for the mailbox or the PDOs.
    SyncManagersMissing,
    /// The protocols of a mailbox are stated, and no place or no size of it.
    MailboxMissing,
    /// A SyncManager with PDOs and a length is not enabled.
    SyncManagerOff,
    /// A SyncManager is enabled and its type says unused.
    SyncManagerUntyped,
    /// Type and control byte of a SyncManager name opposite directions.
    SyncManagerDirection,
    /// There is no category General: the device has no name.
    GeneralMissing,
}

impl DoubtKind {
    /// All kinds.
    pub const ALL: [Self; 26] = [
        Self::Checksum,
        Self::Version,
        Self::Size,
        Self::Identity,
        Self::HalfWord,
        Self::CategoryCut,
        Self::EndMark,
        Self::ManyCategories,
        Self::CategoryRepeated,
        Self::CategoryLength,
        Self::StringsCut,
        Self::StringUnprintable,
        Self::StringMissing,
        Self::PdoCut,
        Self::PdoSyncManager,
        Self::FmmuUse,
        Self::SyncManagerType,
        Self::MailboxArea,
        Self::MailboxProtocols,
        Self::Blank,
        Self::SyncManagersMissing,
        Self::MailboxMissing,
        Self::SyncManagerOff,
        Self::SyncManagerUntyped,
        Self::SyncManagerDirection,
        Self::GeneralMissing,
    ];

    /// The name, in words joined by dashes.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Checksum => "checksum",
            Self::Version => "version",
            Self::Size => "size",
            Self::Identity => "identity",
            Self::HalfWord => "half-word",
            Self::CategoryCut => "category-cut",
            Self::EndMark => "end-mark",
            Self::ManyCategories => "many-categories",
            Self::CategoryRepeated => "category-repeated",
            Self::CategoryLength => "category-length",
            Self::StringsCut => "strings-cut",
            Self::StringUnprintable => "string-unprintable",
            Self::StringMissing => "string-missing",
            Self::PdoCut => "pdo-cut",
            Self::PdoSyncManager => "pdo-sync-manager",
            Self::FmmuUse => "fmmu-use",
            Self::SyncManagerType => "sync-manager-type",
            Self::MailboxArea => "mailbox-area",
            Self::MailboxProtocols => "mailbox-protocols",
            Self::Blank => "blank",
            Self::SyncManagersMissing => "sync-managers-missing",
            Self::MailboxMissing => "mailbox-missing",
            Self::SyncManagerOff => "sync-manager-off",
            Self::SyncManagerUntyped => "sync-manager-untyped",
            Self::SyncManagerDirection => "sync-manager-direction",
            Self::GeneralMissing => "general-missing",
        }
    }

    /// What it means, in a sentence.
    pub const fn means(self) -> &'static str {
        match self {
            Self::Checksum => {
                "The configuration area has a wrong checksum, so the ESC does not load it."
            }
            Self::Version => "The version is not 1.",
            Self::Size => "The size in the header differs from that of the file.",
            Self::Identity => "Vendor or product code is missing.",
            Self::HalfWord => "The file ends with half a word.",
            Self::CategoryCut => "A category ends after the end of the file.",
            Self::EndMark => "There is no end mark.",
            Self::ManyCategories => "There are more categories than the limit.",
            Self::CategoryRepeated => "A category occurs twice.",
            Self::CategoryLength => "The length of a category is no whole number of records.",
            Self::StringsCut => "The strings continue after the end of their category.",
            Self::StringUnprintable => "A string has characters that cannot be printed.",
            Self::StringMissing => "A text has the number of a missing string.",
            Self::PdoCut => "The entries of a PDO continue after the end of their category.",
            Self::PdoSyncManager => {
                "A PDO is assigned to a SyncManager that is not listed, or not for process data."
            }
            Self::FmmuUse => "The use of an FMMU is unknown.",
            Self::SyncManagerType => "The type of a SyncManager is unknown.",
            Self::MailboxArea => "The mailbox areas of the SyncManagers differ from the header.",
            Self::MailboxProtocols => {
                "There are protocols without a mailbox, or a mailbox without protocols."
            }
            Self::Blank => {
                "All bytes of the header are 0xFF or 0x00: nothing was ever written to the EEPROM."
            }
            Self::SyncManagersMissing => {
                "There are no SyncManagers for the mailbox or the PDOs: no MainDevice can set up process data."
            }
            Self::MailboxMissing => {
                "The protocols of a mailbox are stated, and no place or no size of it: a device with \
                 a CPU refuses PREOP (AL status code 0x0016)."
            }
            Self::SyncManagerOff => {
                "A SyncManager with PDOs and a length is not enabled: a MainDevice that takes the \
                 flag as it stands leaves it off, and the device refuses SAFEOP."
            }
            Self::SyncManagerUntyped => {
                "A SyncManager is enabled and has a length, and its type says unused: MainDevices \
                 leave it off, or enable it for nothing."
            }
            Self::SyncManagerDirection => {
                "The type of a SyncManager says outputs and its control byte inputs, or the other \
                 way round: a MainDevice that goes by the type sets its FMMUs the wrong way, and no \
                 process data go (AL status code 0x001B, 0x001D or 0x001E)."
            }
            Self::GeneralMissing => {
                "There is no category General: the device has no name, and nothing tells its CoE services."
            }
        }
    }

    /// What to do about it, the most certain first.
    pub const fn remedies(self) -> &'static [&'static str] {
        match self {
            Self::Blank | Self::SyncManagersMissing | Self::MailboxMissing => {
                &["write the whole image: the maker's description (ESI) has what is missing, and \
                 `isocat sii --from FILE --type TYPE --out OUT` makes the image of it"]
            }
            Self::PdoSyncManager
            | Self::SyncManagerOff
            | Self::SyncManagerUntyped
            | Self::SyncManagerDirection => {
                &["compare with the SyncManagers of the maker's description (ESI), as \
                 `isocat sii --from FILE --type TYPE` shows them; `--out OUT` writes that image"]
            }
            Self::Checksum => &[
                "correct the checksum, by writing words 0 to 7 anew: `isocat sii --from FILE --out OUT` \
                 computes it; then switch the device off and on",
            ],
            _ => &[
                "the EEPROM's content, if it is yours: `isocat sii --from FILE --out OUT` writes one; \
                 a device that runs as it is needs nothing",
            ],
        }
    }
}
