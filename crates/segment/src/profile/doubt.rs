//! Doubts about a description, each of a kind with a fixed name.

use std::fmt;

use isocat_descriptions::esi::WarningKind;
use isocat_sync::opmode;

/// A doubt about a description, or a part of it that is not followed.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Doubt {
    /// Its kind; the name of it is for programs.
    pub kind: DoubtKind,
    /// Description in words.
    pub what: String,
}

impl Doubt {
    /// A doubt of this kind, with its description.
    pub fn new(kind: impl Into<DoubtKind>, what: String) -> Self {
        Self { kind: kind.into(), what }
    }
}

macro_rules! kinds {
    ($($(#[doc = $doc:literal])+ $kind:ident = $name:literal,)+) => {
        /// The kind of a [`Doubt`].
        #[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
        pub enum DoubtKind {
            /// About the file, whatever is made of it.
            Description(WarningKind),
            /// About the pulses of an OpMode at the cycle.
            Pulses(opmode::WarningKind),
            $($(#[doc = $doc])+ $kind,)+
        }

        impl DoubtKind {
            /// The kinds of the import itself.
            pub const OWN: &[Self] = &[$(Self::$kind),+];

            /// The name, in words joined by dashes.
            pub const fn name(&self) -> &'static str {
                match self {
                    Self::Description(kind) => kind.name(),
                    Self::Pulses(kind) => kind.name(),
                    $(Self::$kind => $name,)+
                }
            }

            /// What it means, in a sentence or two.
            pub const fn means(&self) -> &'static str {
                match self {
                    Self::Description(kind) => kind.means(),
                    Self::Pulses(kind) => kind.means(),
                    $(Self::$kind => concat!($($doc),+).trim_ascii_start(),)+
                }
            }
        }
    };
}

kinds! {
    /// The file names no revision, or one that the description does not have; which one was taken.
    Revision = "revision",
    /// The file names no OpMode, or several have its name; which one was taken.
    OpMode = "opmode",
    /// The file asks for a mode that the OpMode taken does not stand for: the times of the OpMode
    /// are not used.
    Mode = "mode",
    /// The chosen modules are not those for which the description offers the OpMode.
    ModuleOpMode = "module-opmode",
    /// A drive whose process data lack what following a position needs: it is brought to OP, but it
    /// is not enabled and does not move.
    DriveNotEnabled = "drive-not-enabled",
    /// The EEPROM contradicts the standard or itself.
    Sii = "sii",
    /// The EEPROM has another revision than the description.
    SiiRevision = "sii-revision",
    /// The OpMode leaves SYNC off, and nothing says by what the device works then.
    SyncModeNotStated = "sync-mode-not-stated",
    /// The OpMode has a ShiftTimeSync0, which the phase of the plan replaces.
    ShiftTimeSync0 = "shift-time-sync0",
    /// The OpMode has SYNC1 without SYNC0, which the mode needs: SYNC0 is switched on as well.
    Sync0Added = "sync0-added",
    /// How the samples of a device that oversamples are read, or why they are not.
    Oversampling = "oversampling",
    /// An InitCmd is not sent.
    InitCommandLeftOut = "init-command-left-out",
    /// An InitCmd writes an object that the dictionary does not have, or that can't be written
    /// there: the virtual device gets it.
    InitCommandObject = "init-command-object",
    /// A parameter of a drive that holds the cycle (S-0-0001, S-0-0002, 0x60C2) is written with the
    /// device's own or the bus cycle, and not with the value of the InitCmd.
    CycleParameter = "cycle-parameter",
    /// A SyncManager's control byte gets the AL event: the real device needs none, and the virtual
    /// one has no other way to know that a frame came.
    AlEventAdded = "al-event-added",
    /// A window on registers is not mapped.
    WindowNotMapped = "window-not-mapped",
}

impl From<WarningKind> for DoubtKind {
    fn from(kind: WarningKind) -> Self {
        Self::Description(kind)
    }
}

impl From<opmode::WarningKind> for DoubtKind {
    fn from(kind: opmode::WarningKind) -> Self {
        Self::Pulses(kind)
    }
}

impl fmt::Display for DoubtKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}
