//! Doubts of an import, each with a stable name.

use std::fmt;

/// A part of a description that could be read in more than one way, contradicts another part, or is
/// left out. There is one per device and kind, with the first place and their number.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Warning {
    /// The kind.
    pub kind: WarningKind,
    /// Byte offset of the first place in the text; [`super::EsiFile::place`] gives line and column.
    pub at: usize,
    /// What was found at the first place, and how it is read.
    pub message: String,
    /// Number of places.
    pub count: usize,
}

/// Warnings under collection.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub(super) struct Warnings(pub Vec<Warning>);

impl Warnings {
    /// Notes a doubt; the message is made only for the first of a kind.
    pub fn add(&mut self, kind: WarningKind, at: usize, message: impl FnOnce() -> String) {
        if !self.again(kind) {
            self.0.push(Warning { kind, at, message: message(), count: 1 });
        }
    }

    /// Counts another place of a kind; false if there is none yet.
    fn again(&mut self, kind: WarningKind) -> bool {
        let known = self.0.iter_mut().find(|warning| warning.kind == kind);
        known.map(|warning| warning.count += 1).is_some()
    }
}

macro_rules! kinds {
    ($($(#[doc = $doc:literal])+ $kind:ident = $name:literal;)*) => {
        /// The kinds of [`Warning`]; their names are stable.
        #[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
        pub enum WarningKind { $($(#[doc = $doc])+ $kind,)* }

        impl WarningKind {
            /// All kinds.
            pub const ALL: &[WarningKind] = &[$(Self::$kind,)*];

            /// The name, in words joined by dashes.
            pub const fn name(self) -> &'static str {
                match self { $(Self::$kind => $name,)* }
            }

            /// What it means, in a sentence or two.
            pub const fn means(self) -> &'static str {
                match self { $(Self::$kind => concat!($($doc),+).trim_ascii_start(),)* }
            }
        }
    };
}

kinds! {
    /// The declared encoding has a name that is not registered.
    EncodingName = "encoding-name";
    /// Declared encoding and bytes disagree; the bytes are used.
    EncodingMismatch = "encoding-mismatch";
    /// A number with two prefixes (`#x0x6041`), read as if it had one.
    NumberDoubledPrefix = "number-doubled-prefix";
    /// The vendor has no name.
    VendorNameMissing = "vendor-name-missing";
    /// `InfoReference` names another file, which is not read.
    ReferencedFileNotRead = "referenced-file-not-read";
    /// The product code is missing: a placeholder, listed but never chosen.
    ProductCodeMissing = "product-code-missing";
    /// The revision is missing and read as 0.
    RevisionMissing = "revision-missing";
    /// Another device of the file has the same product code and revision.
    IdentityRepeated = "identity-repeated";
    /// `GroupType` is missing or names no group of the file.
    GroupUnknown = "group-unknown";
    /// `Physics` is missing: two MII ports are assumed.
    PhysicsMissing = "physics-missing";
    /// `Physics` has a letter that no port has, no port at all, or more than four ports.
    PhysicsUnknown = "physics-unknown";
    /// The box has further ESCs (`SubDevice`), which are separate devices.
    SeveralControllers = "several-controllers";
    /// A SyncManager's text is missing or meaningless; its control byte is used.
    SyncManagerName = "sync-manager-name";
    /// A SyncManager's text contradicts its control byte, which is used.
    SyncManagerNameContradicts = "sync-manager-name-contradicts";
    /// A SyncManager has no control byte; its text is used.
    SyncManagerWithoutControl = "sync-manager-without-control";
    /// `Enable` is neither 0 nor 1.
    SyncManagerEnable = "sync-manager-enable";
    /// `DefaultSize` differs from the sum of the default PDOs, which is used.
    SyncManagerSize = "sync-manager-size";
    /// A window without a SyncManager that is none of inputs; it is not mapped.
    SyncManagerVirtual = "sync-manager-virtual";
    /// A process data SyncManager has one buffer, like a mailbox.
    SyncManagerOneBuffer = "sync-manager-one-buffer";
    /// A PDO names a SyncManager that does not exist or has the other direction.
    PdoSyncManager = "pdo-sync-manager";
    /// A PDO has no index, or refers to a missing definition; it is left out.
    PdoLeftOut = "pdo-left-out";
    /// Two PDOs have one index; the first is used.
    PdoRepeated = "pdo-repeated";
    /// Two PDOs of the default assignment exclude each other.
    PdoExcluded = "pdo-excluded";
    /// An entry of more than 255 bits, or without object, is read as padding.
    PdoEntryPadded = "pdo-entry-padded";
    /// The device has no process data at all by default.
    ProcessDataMissing = "process-data-missing";
    /// There is a `Mailbox` but no two mailbox SyncManagers.
    MailboxWithoutSyncManagers = "mailbox-without-sync-managers";
    /// A mailbox protocol other than CoE and SoE: virtual SubDevices answer it with an error.
    MailboxProtocol = "mailbox-protocol";
    /// There is CoE but no dictionary in the file: a small one is generated.
    DictionaryMissing = "dictionary-missing";
    /// The dictionary is in another file, which is not read.
    DictionaryFile = "dictionary-file";
    /// A register that is to be written and is not.
    RegisterUnused = "register-unused";
    /// An object cannot be read; it is left out.
    ObjectLeftOut = "object-left-out";
    /// Defaults were matched to sub-indices by order, since names differ.
    ObjectItemsByOrder = "object-items-by-order";
    /// A data type is not defined; its bits are used.
    DataTypeUnknown = "data-type-unknown";
    /// A default value cannot be read; its entry has none.
    DefaultLeftOut = "default-left-out";
    /// The length of a default value is not that of its type.
    DefaultLength = "default-length";
    /// The first OpMode, the default, makes no pulse though another one does.
    FirstOpModeWithoutDc = "first-opmode-without-dc";
    /// Two OpModes have one name: they are distinguished by position.
    OpModeNameRepeated = "opmode-name-repeated";
    /// AssignActivate is missing and read as 0.
    AssignActivateMissing = "assign-activate-missing";
    /// AssignActivate switches SYNC on in a way that no known device uses.
    AssignActivateUnusual = "assign-activate-unusual";
    /// AssignActivate switches SYNC1 on without SYNC0.
    Sync1Alone = "sync1-alone";
    /// SYNC is on without a cycle (absent, or 0 with factor 0): the bus cycle is used.
    Sync0CycleMissing = "sync0-cycle-missing";
    /// SYNC0's cycle has a fixed time: only bus cycles that are a multiple of it are possible.
    Sync0CycleFixed = "sync0-cycle-fixed";
    /// SYNC0's cycle has a time and a factor; the time is used.
    Sync0CycleTwice = "sync0-cycle-twice";
    /// SYNC0's cycle is below 10 us.
    Sync0CycleShort = "sync0-cycle-short";
    /// SYNC1 has a cycle, but AssignActivate does not switch it on.
    Sync1Unused = "sync1-unused";
    /// A shift is a second or more; its remainder within the cycle is used.
    ShiftTimeHuge = "shift-time-huge";
    /// An OpMode has the style of old files (SyncType, CycleTime, ShiftTime); it is not used.
    OpModeObsolete = "opmode-obsolete";
    /// The dictionary presets 0x1C32:04 without DC, but an OpMode has it.
    DictionaryWithoutDc = "dictionary-without-dc";
    /// The file does not state which of several modules is in a slot; the first is used.
    SlotModuleAssumed = "slot-module-assumed";
    /// A slot must have a module, but the file has none that fits.
    SlotModuleMissing = "slot-module-missing";
    /// A PDO or an object of a module has the index of another one; the first is used.
    ModuleIndexRepeated = "module-index-repeated";
    /// A group of PDOs does not begin at its alignment, since no free PDO is named for the padding
    /// before it.
    PdoGroupUnaligned = "pdo-group-unaligned";
    /// The modules of a device have more objects and downloads than the limit; the rest is left
    /// out.
    ModulesTooLarge = "modules-too-large";
    /// `Eeprom` is missing: usual contents are assumed.
    EepromMissing = "eeprom-missing";
    /// `ConfigData` ends before the pulse length, within a word or after word 6: zeros are added,
    /// or the excess is dropped.
    ConfigDataLength = "config-data-length";
    /// Elements that this import does not know; they are skipped.
    ElementUnknown = "element-unknown";
}

impl WarningKind {
    /// Whether it is about process data or modules, so that it may not apply with other modules.
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
