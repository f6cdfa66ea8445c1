//! Doubts of an import, each with a name of its own.

use std::fmt;

/// Something in a description that could be read in more than one way, contradicts another part, or is
/// left out. One per device and kind: the first place, and how many there are.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Warning {
    /// Which.
    pub kind: WarningKind,
    /// Byte of the text at which it was met first; [`super::EsiFile::place`] gives line and column.
    pub at: usize,
    /// What was found and how it is taken, about the first.
    pub message: String,
    /// How many places have it.
    pub count: usize,
}

/// Warnings as they are collected.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub(super) struct Warnings(pub Vec<Warning>);

impl Warnings {
    /// Notes a doubt; the message is made for the first of a kind only.
    pub fn add(&mut self, kind: WarningKind, at: usize, message: impl FnOnce() -> String) {
        match self.0.iter_mut().find(|warning| warning.kind == kind) {
            Some(warning) => warning.count += 1,
            None => self.0.push(Warning { kind, at, message: message(), count: 1 }),
        }
    }
}

macro_rules! kinds {
    ($($(#[doc = $doc:literal])* $kind:ident = $name:literal;)*) => {
        /// The kinds of [`Warning`]; their names are stable.
        #[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
        pub enum WarningKind { $($(#[doc = $doc])* $kind,)* }

        impl WarningKind {
            /// All of them.
            pub const ALL: &[WarningKind] = &[$(Self::$kind,)*];

            /// The name, in words joined by dashes.
            pub const fn name(self) -> &'static str {
                match self { $(Self::$kind => $name,)* }
            }
        }
    };
}

kinds! {
    /// The declared encoding has a name that is not registered.
    EncodingName = "encoding-name";
    /// Declared encoding and bytes disagree; the bytes count.
    EncodingMismatch = "encoding-mismatch";
    /// A number with two prefixes (`#x0x6041`), read as if it had one.
    NumberDoubledPrefix = "number-doubled-prefix";
    /// The maker has no name.
    VendorNameMissing = "vendor-name-missing";
    /// `InfoReference` names another file, which is not read.
    ReferencedFileNotRead = "referenced-file-not-read";
    /// No product code: a placeholder, listed but never chosen.
    ProductCodeMissing = "product-code-missing";
    /// No revision, taken as 0.
    RevisionMissing = "revision-missing";
    /// Another device of the file has the same product code and revision.
    IdentityRepeated = "identity-repeated";
    /// `GroupType` is missing or names no group of the file.
    GroupUnknown = "group-unknown";
    /// `Physics` is missing: two MII ports are assumed.
    PhysicsMissing = "physics-missing";
    /// `Physics` has a letter that no port has, no port at all, or more than four.
    PhysicsUnknown = "physics-unknown";
    /// The box has further ESCs (`SubDevice`), which are devices of their own.
    SeveralControllers = "several-controllers";
    /// A SyncManager's text is missing or of no meaning; its control byte tells.
    SyncManagerName = "sync-manager-name";
    /// A SyncManager's text contradicts its control byte, which counts.
    SyncManagerNameContradicts = "sync-manager-name-contradicts";
    /// A SyncManager without control byte; its text tells.
    SyncManagerWithoutControl = "sync-manager-without-control";
    /// `Enable` is neither 0 nor 1.
    SyncManagerEnable = "sync-manager-enable";
    /// `DefaultSize` is not the sum of the default PDOs, which counts.
    SyncManagerSize = "sync-manager-size";
    /// A window without a SyncManager that is none of inputs; it is not mapped.
    SyncManagerVirtual = "sync-manager-virtual";
    /// A process data SyncManager with one buffer, as a mailbox has it.
    SyncManagerOneBuffer = "sync-manager-one-buffer";
    /// A PDO names a SyncManager that does not exist or has the other direction.
    PdoSyncManager = "pdo-sync-manager";
    /// A PDO without index, or one that refers to a definition elsewhere; it is left out.
    PdoLeftOut = "pdo-left-out";
    /// Two PDOs have one index; the first counts.
    PdoRepeated = "pdo-repeated";
    /// Two PDOs of the default assignment exclude each other.
    PdoExcluded = "pdo-excluded";
    /// An entry of more than 255 bits, or without object, is taken as padding.
    PdoEntryPadded = "pdo-entry-padded";
    /// The device has no process data at all by default.
    ProcessDataMissing = "process-data-missing";
    /// A `Mailbox` without two mailbox SyncManagers.
    MailboxWithoutSyncManagers = "mailbox-without-sync-managers";
    /// A mailbox protocol other than CoE and SoE: virtual SubDevices answer it with an error.
    MailboxProtocol = "mailbox-protocol";
    /// CoE without a dictionary in the file: a small one is generated.
    DictionaryMissing = "dictionary-missing";
    /// The dictionary is in another file, which is not read.
    DictionaryFile = "dictionary-file";
    /// An object that can't be read; it is left out.
    ObjectLeftOut = "object-left-out";
    /// Defaults were matched to sub-indices by order, since names differ.
    ObjectItemsByOrder = "object-items-by-order";
    /// A data type that nobody defines; its bits count.
    DataTypeUnknown = "data-type-unknown";
    /// A default value that can't be read; its entry has none.
    DefaultLeftOut = "default-left-out";
    /// A default value whose length is not that of its type.
    DefaultLength = "default-length";
    /// The first OpMode, the default, makes no pulse though another one does.
    FirstOpModeWithoutDc = "first-opmode-without-dc";
    /// Two OpModes have one name: they are told apart by position.
    OpModeNameRepeated = "opmode-name-repeated";
    /// AssignActivate is missing, taken as 0.
    AssignActivateMissing = "assign-activate-missing";
    /// AssignActivate switches SYNC on in a way that is not in use elsewhere.
    AssignActivateUnusual = "assign-activate-unusual";
    /// AssignActivate switches SYNC1 on without SYNC0.
    Sync1Alone = "sync1-alone";
    /// SYNC is on without a cycle (absent, or 0 with factor 0): the bus cycle is taken.
    Sync0CycleMissing = "sync0-cycle-missing";
    /// SYNC0's cycle has a fixed time: only bus cycles that are a multiple of it are possible.
    Sync0CycleFixed = "sync0-cycle-fixed";
    /// SYNC0's cycle has a time and a factor; the time counts.
    Sync0CycleTwice = "sync0-cycle-twice";
    /// SYNC0's cycle is below 10 us.
    Sync0CycleShort = "sync0-cycle-short";
    /// SYNC1 has a cycle, but AssignActivate does not switch it on.
    Sync1Unused = "sync1-unused";
    /// A shift of a second or more; its place within the cycle counts.
    ShiftTimeHuge = "shift-time-huge";
    /// An OpMode in the style of old files (SyncType, CycleTime, ShiftTime); not used.
    OpModeObsolete = "opmode-obsolete";
    /// The dictionary presets 0x1C32:04 without DC, but an OpMode has it.
    DictionaryWithoutDc = "dictionary-without-dc";
    /// Which of several modules is in a slot is not said; the first is taken.
    SlotModuleAssumed = "slot-module-assumed";
    /// A slot must have a module, but the file has none that fits.
    SlotModuleMissing = "slot-module-missing";
    /// A PDO or an object of a module has the index of another one; the first counts.
    ModuleIndexRepeated = "module-index-repeated";
    /// A group of PDOs does not begin where it should, since no free PDO is named that fills the room before it.
    PdoGroupUnaligned = "pdo-group-unaligned";
    /// The modules of a device have more objects and downloads than are taken; the rest is left out.
    ModulesTooLarge = "modules-too-large";
    /// No `Eeprom`: usual contents are assumed.
    EepromMissing = "eeprom-missing";
    /// `ConfigData` ends before the pulse length, within a word or after word 6: zeros are added, or what is
    /// too much is dropped.
    ConfigDataLength = "config-data-length";
    /// Elements that this import does not know; they are skipped.
    ElementUnknown = "element-unknown";
}

impl WarningKind {
    /// Whether it is about process data or modules, so that other modules may not have it.
    pub(super) const fn is_of_process_data(self) -> bool {
        matches!(
            self,
            Self::SlotModuleAssumed
                | Self::SlotModuleMissing
                | Self::ModuleIndexRepeated
                | Self::PdoGroupUnaligned
                | Self::ModulesTooLarge
                | Self::PdoSyncManager
                | Self::SyncManagerSize
                | Self::PdoExcluded
                | Self::PdoEntryPadded
                | Self::ProcessDataMissing
        )
    }
}

impl fmt::Display for WarningKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}
