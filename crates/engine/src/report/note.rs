//! Kinds of notes in plans and scans.

use std::collections::HashMap;
use std::fmt;

use isocat_maindevice::kinds;

use super::Note;
use crate::fold;

kinds! {
    /// The kind of a note in a plan or a scan.
    #[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
    pub enum NoteKind {
        /// A part of the SubDevice could not be read.
        NotRead = "not-read",
        /// The scan could not continue.
        GivenUp = "given-up",
        /// SubDevices may not be back in INIT after the scan.
        WayDown = "way-down",
        /// Frames leave through a port that the ESC does not have.
        PortNotThere = "port-not-there",
        /// Frames come in through another port than port 0.
        PortsSwapped = "ports-swapped",
        /// The ESC promises distributed clocks, and its receive times do not answer.
        NoReceiveTimes = "no-receive-times",
        /// 0x1C32:04 or 0x1C33:04 announces no mode.
        NoTypes = "no-types",
        /// Sub-index 01 of 0x1C32 or 0x1C33 shows Free Run, and sub-index 04 does not announce it.
        FreeRunNotAnnounced = "free-run-not-announced",
        /// Register 0x0012 and the SII state different alias addresses.
        Alias = "alias",
        /// The SII has more SyncManagers than the ESC.
        TooFewSyncManagers = "too-few-sync-managers",
        /// The process data need more FMMUs than the ESC has.
        TooFewFmmus = "too-few-fmmus",
        /// The SII and object 0x1C00 state different uses of a SyncManager.
        SyncManagerUse = "sync-manager-use",
        /// An area lies outside the process RAM.
        BeyondTheMemory = "beyond-the-memory",
        /// Two areas share bytes of the process RAM.
        Overlap = "overlap",
        /// The SII states two areas for one mailbox.
        MailboxArea = "mailbox-area",
        /// The SII lacks something that the way up to OP needs.
        EepromIncomplete = "eeprom-incomplete",
        /// An OpMode of the SII switches SYNC on, and the SubDevice has no system time.
        OpModeWithoutClock = "op-mode-without-clock",
        /// 0x1C32:04 and 0x1C33:04 announce no common mode.
        TypesExcludeEachOther = "types-exclude-each-other",
        /// An entry is described but cannot be read.
        NotReadable = "not-readable",
        /// The length of an entry differs from its description.
        Length = "length",
        /// 0x1C32:04 or 0x1C33:04 announces a DC mode, and the SubDevice has no system time.
        DcWithoutClock = "dc-without-clock",
        /// 0x1C32:04 or 0x1C33:04 has a reserved value in bits 6:5.
        ShiftReserved = "shift-reserved",
        /// A shift by local timer is announced, and the entry for it is missing.
        NoShift = "no-shift",
        /// A shift by local timer is announced, and the entry for it cannot be written.
        ShiftReadOnly = "shift-read-only",
        /// Calc and copy time is longer than the minimum cycle.
        CopyLongerThanCycle = "copy-longer-than-cycle",
        /// Sub-index 01 of 0x1C32 or 0x1C33 shows a type that sub-index 04 does not announce.
        TypeNotAnnounced = "type-not-announced",
        /// The SubDevice had an AL status error before the scan.
        ErrorBefore = "error-before",
        /// The SubDevice was in another state than INIT before the scan.
        InUse = "in-use",
        /// A port has a link, but the device behind it does not answer.
        LinkWithoutSignal = "link-without-signal",
        /// The SubDevice has receive times and no system time.
        ReceiveTimesOnly = "receive-times-only",
        /// The receive times do not determine the propagation delay.
        DelayUnknown = "delay-unknown",
        /// The SII names no vendor or no product.
        NoIdentity = "no-identity",
        /// Object 0x1C32 or 0x1C33 is missing.
        NoSyncObject = "no-sync-object",
        /// The SII assigns outputs to a window on registers, which is not mapped.
        WindowNotMapped = "window-not-mapped",
        /// Nothing is assigned in 0x1C12 and 0x1C13.
        NothingAssigned = "nothing-assigned",
        /// 0x1C32:04 and 0x1C33:04 announce different modes.
        TypesDisagree = "types-disagree",
        /// 0x1C32:05 and 0x1C33:05 state different minimum cycles.
        MinimumCyclesDiffer = "minimum-cycles-differ",
        /// Counters of 0x1C32 or 0x1C33 were not 0 before the scan.
        Counted = "counted",
        /// A time that an announced mode asks for is not stated.
        NotStated = "not-stated",
        /// 0x1C32:04 or 0x1C33:04 announces both fixed delays and delays to be measured.
        DelayBoth = "delay-both",
        /// Delays are announced as fixed, and minimum and maximum differ.
        DelayNotFixed = "delay-not-fixed",
        /// Subordinated cycles are announced, and 0x1C32:0A does not state their SYNC0 cycle.
        NoSync0Cycle = "no-sync0-cycle",
        /// Sub-indices that an announced mode asks for are missing.
        Missing = "missing",
        /// SYNC0 comes while the frame passes: SubDevices behind it use old outputs, those before
        /// it new ones.
        Sync0InFrame = "sync0-in-frame",
        /// Free Run is requested, but the SubDevice will work by the SM event.
        FreeRunBySm = "free-run-by-sm",
        /// A shift by local timer is asked for, and the mode does not use it.
        ShiftUnused = "shift-unused",
        /// A mailbox frame takes longer than the free time of a cycle.
        MailboxNoRoom = "mailbox-no-room",
        /// The base cycle may begin at any of several SYNC0 pulses.
        TwoPhases = "two-phases",
        /// Types cannot be written, and are not those of the mode.
        TypeReadOnly = "type-read-only",
        /// The mode needs SYNC, and each OpMode of the SubDevice leaves it off.
        OpmodeSyncOff = "opmode-sync-off",
        /// The first OpMode of the SubDevice switches DC off.
        FirstOpmodeDcOff = "first-opmode-dc-off",
    }
}

impl Note {
    /// All of them as sentences; what is the same of several SubDevices is one, at the place of the
    /// first.
    pub(crate) fn sentences<'a>(notes: impl Iterator<Item = &'a Note>) -> Vec<String> {
        let mut said: Vec<Vec<&Note>> = Vec::new();
        let mut known: HashMap<(NoteKind, &str), usize> = HashMap::new();
        for note in notes {
            let of_device = note.position.is_some() && !note.kind.names_its_device();
            match known.get(&(note.kind, note.what.as_str())).filter(|_| of_device) {
                Some(at) => said[*at].push(note),
                None => {
                    if of_device {
                        known.insert((note.kind, &note.what), said.len());
                    }
                    said.push(vec![note]);
                }
            }
        }
        let sentence = |same: &Vec<&Note>| match same[..] {
            [one] => one.sentence(),
            _ => {
                let places: Vec<usize> = same.iter().filter_map(|note| note.position).collect();
                let names = same.iter().map(|note| note.device.as_deref().unwrap_or_default());
                let names = match fold::name(&names.collect::<Vec<_>>()) {
                    name if name.is_empty() => name,
                    name => format!(" ({name})"),
                };
                format!("SubDevices {}{names}: {}", fold::positions(&places), same[0].what)
            }
        };
        said.iter().map(sentence).collect()
    }
}

impl NoteKind {
    /// All kinds, in the order of [`NoteKind::DESCRIPTIONS`].
    pub const ALL: [Self; Self::DESCRIPTIONS.len()] = [
        Self::NotRead,
        Self::GivenUp,
        Self::WayDown,
        Self::PortNotThere,
        Self::PortsSwapped,
        Self::NoReceiveTimes,
        Self::NoTypes,
        Self::FreeRunNotAnnounced,
        Self::Alias,
        Self::TooFewSyncManagers,
        Self::TooFewFmmus,
        Self::SyncManagerUse,
        Self::BeyondTheMemory,
        Self::Overlap,
        Self::MailboxArea,
        Self::EepromIncomplete,
        Self::OpModeWithoutClock,
        Self::TypesExcludeEachOther,
        Self::NotReadable,
        Self::Length,
        Self::DcWithoutClock,
        Self::ShiftReserved,
        Self::NoShift,
        Self::ShiftReadOnly,
        Self::CopyLongerThanCycle,
        Self::TypeNotAnnounced,
        Self::ErrorBefore,
        Self::InUse,
        Self::LinkWithoutSignal,
        Self::ReceiveTimesOnly,
        Self::DelayUnknown,
        Self::NoIdentity,
        Self::NoSyncObject,
        Self::WindowNotMapped,
        Self::NothingAssigned,
        Self::TypesDisagree,
        Self::MinimumCyclesDiffer,
        Self::Counted,
        Self::NotStated,
        Self::DelayBoth,
        Self::DelayNotFixed,
        Self::NoSync0Cycle,
        Self::Missing,
        Self::Sync0InFrame,
        Self::FreeRunBySm,
        Self::ShiftUnused,
        Self::MailboxNoRoom,
        Self::TwoPhases,
        Self::TypeReadOnly,
        Self::OpmodeSyncOff,
        Self::FirstOpmodeDcOff,
    ];

    /// Whether the sentence comes from the MainDevice, which names the SubDevice itself.
    pub(crate) const fn names_its_device(self) -> bool {
        matches!(self, Self::NotRead | Self::GivenUp)
    }
}

/// Its name.
impl fmt::Display for NoteKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}
