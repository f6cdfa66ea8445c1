//! Doubts of an import, each with a name of its own.

use std::fmt;

use serde::{Serialize, Serializer};

/// Something in an ENI that could be read in more than one way, contradicts another part, or is left out.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
pub struct Warning {
    /// Which.
    pub kind: WarningKind,
    /// Line, from 1.
    pub line: usize,
    /// Column in characters, from 1.
    pub column: usize,
    /// What was found and how it is taken.
    pub message: String,
}

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}: {} ({})", self.line, self.column, self.message, self.kind.name())
    }
}

macro_rules! kinds {
    ($($(#[doc = $doc:literal])* $kind:ident = $name:literal;)*) => {
        /// The kinds of [`Warning`]; their names are stable.
        #[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
        pub enum WarningKind { $($(#[doc = $doc])* $kind,)* }

        impl WarningKind {
            /// The name, in words joined by dashes.
            pub const fn name(self) -> &'static str {
                match self { $(Self::$kind => $name,)* }
            }
        }
    };
}

kinds! {
    /// Text stands before the XML declaration; it is skipped.
    TextBeforeDeclaration = "text-before-declaration";
    /// A hexadecimal number where ENI has decimal ones.
    HexNumber = "hex-number";
    /// The mailbox's `Recv` is called `Receive`.
    MailboxReceive = "mailbox-receive";
    /// `Ccs` is 2 in a command that has data: taken as a download.
    CcsOfDownload = "ccs-of-download";
    /// An SDO upload at start; it is left out.
    UploadLeftOut = "upload-left-out";
    /// A command that is disabled, or has no transition; it is left out.
    CommandLeftOut = "command-left-out";
    /// A start-up command of AoE, EoE or FoE, or one of SoE that does not write a value; it is left out.
    ProtocolLeftOut = "protocol-left-out";
    /// `AutoIncAddr` does not agree with the place in the file, which counts.
    AutoIncrement = "auto-increment";
    /// No `Cyclic/CycleTime`: the longest `DC/CycleTime0` is taken for the bus cycle.
    CycleTimeMissing = "cycle-time-missing";
    /// A SYNC0 cycle and the bus cycle are no multiple of each other.
    CycleTimeDiffers = "cycle-time-differs";
    /// Several SubDevices are said to be the reference clock.
    ReferenceClocks = "reference-clocks";
    /// DC is in use and no SubDevice is said to be the reference clock.
    ReferenceClockMissing = "reference-clock-missing";
    /// What is written to 0x09A0 and 0x09A4 is not what `DC` says.
    CyclesDiffer = "cycles-differ";
    /// What is written to 0x0010 is not `PhysAddr`.
    StationDiffers = "station-differs";
    /// A start time other than 0 is written to 0x0990: it has passed, whoever plays it.
    StartTime = "start-time";
    /// A check compares another number of bytes than it reads.
    CheckLength = "check-length";
    /// Neither data nor a length; nothing is transferred.
    NoData = "no-data";
    /// Elements that this import does not know; they are skipped.
    ElementUnknown = "element-unknown";
}

impl Serialize for WarningKind {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}
