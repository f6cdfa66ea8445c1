//! Doubts of an import, each with a stable name.

use std::fmt;

use serde::{Serialize, Serializer};

/// A part of an ENI that could be read in more than one way, contradicts another part, or is left
/// out.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
pub struct Warning {
    /// The kind.
    pub kind: WarningKind,
    /// Line, from 1.
    pub line: usize,
    /// Column in characters, from 1.
    pub column: usize,
    /// What was found, and how it is read.
    pub message: String,
}

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}: {} ({})", self.line, self.column, self.message, self.kind.name())
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
    /// Text stands before the XML declaration; it is skipped.
    TextBeforeDeclaration = "text-before-declaration";
    /// A number is hexadecimal, but ENI has decimal ones.
    HexNumber = "hex-number";
    /// The mailbox's `Recv` is called `Receive`.
    MailboxReceive = "mailbox-receive";
    /// `Ccs` is 2 in a command with data: read as a download.
    CcsOfDownload = "ccs-of-download";
    /// An SDO upload at start; it is left out.
    UploadLeftOut = "upload-left-out";
    /// A command that is disabled, or has no transition; it is left out.
    CommandLeftOut = "command-left-out";
    /// A start-up command of AoE, EoE or FoE, or one of SoE that does not write a value; it is left
    /// out.
    ProtocolLeftOut = "protocol-left-out";
    /// `AutoIncAddr` differs from the position in the file, which is used.
    AutoIncrement = "auto-increment";
    /// `Cyclic/CycleTime` is missing: the longest `DC/CycleTime0` is used as bus cycle.
    CycleTimeMissing = "cycle-time-missing";
    /// A SYNC0 cycle and the bus cycle are no multiple of each other.
    CycleTimeDiffers = "cycle-time-differs";
    /// Several SubDevices are declared as reference clock.
    ReferenceClocks = "reference-clocks";
    /// DC is in use, but no SubDevice is declared as reference clock.
    ReferenceClockMissing = "reference-clock-missing";
    /// The values for 0x09A0 and 0x09A4 differ from `DC`.
    CyclesDiffer = "cycles-differ";
    /// The value for 0x0010 differs from `PhysAddr`.
    StationDiffers = "station-differs";
    /// A start time other than 0 is written to 0x0990: it is in the past at every start.
    StartTime = "start-time";
    /// A check compares another number of bytes than it reads.
    CheckLength = "check-length";
    /// There are neither data nor a length; nothing is transferred.
    NoData = "no-data";
    /// Elements that this import does not know; they are skipped.
    ElementUnknown = "element-unknown";
}

impl Serialize for WarningKind {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}
