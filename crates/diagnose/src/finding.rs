//! What was found in a capture: kinds with their figures. [`words`](crate::words) makes sentences
//! of them.

use std::time::Duration;

use isocat_rules::Breach;
use isocat_sync::object::SyncType;
use isocat_wire::al::{AlState, AlStatus, AlStatusCode};
use isocat_wire::mailbox::ErrorDetail;
use isocat_wire::{AbortCode, ObjectAddress};

/// How much a finding weighs.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(crate) enum Weight {
    /// Something went wrong.
    Fault,
    /// Something was forgotten or done wrong, but did no harm yet.
    Warning,
    /// Worth knowing; it is not wrong.
    Note,
}

/// How sure a finding is.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Sure {
    /// The frames that are named show it.
    Shown,
    /// The frames agree with it, but another cause would show the same frames.
    Likely,
}

/// One finding.
#[derive(Clone, PartialEq, Debug)]
pub(crate) struct Finding {
    pub kind: Kind,
    /// Place of the device in the list; `None`: the finding is about the segment.
    pub device: Option<usize>,
    /// The first frame that shows it, and when that was.
    pub frame: usize,
    pub at: Option<Duration>,
    /// Further frames that belong to it.
    pub frames: Vec<usize>,
    pub sure: Sure,
    /// The frame by which the finding is sorted, if it began before `frame` showed it.
    pub order: Option<usize>,
}

/// Which transmission a working counter belongs to.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Which {
    pub command: isocat_wire::Command,
    pub address: u32,
}

macro_rules! kinds {
    ($($(#[doc = $doc:literal])+ $variant:ident { $($field:ident: $type:ty),* $(,)? } $name:literal $weight:ident;)*) => {
        /// A kind of finding, with its figures.
        #[derive(Clone, PartialEq, Debug)]
        pub(crate) enum Kind {
            $($(#[doc = $doc])+ $variant { $($field: $type),* },)*
            /// Something is otherwise than it was meant.
            Breached(Breach),
        }

        impl Kind {
            /// Its name in documents.
            pub fn name(&self) -> &'static str {
                match self { $(Self::$variant { .. } => $name,)* Self::Breached(breach) => breach.name() }
            }

            /// Its place in the list. Of two kinds shown by the same frame, the earlier one is the
            /// cause of the later one.
            pub fn rank(&self) -> usize {
                KINDS.iter().position(|name| *name == self.name()).unwrap_or(KINDS.len())
            }

            /// How much it weighs.
            pub fn weight(&self) -> Weight {
                match self { $(Self::$variant { .. } => Weight::$weight,)* Self::Breached(_) => Weight::Fault }
            }
        }

        /// The names of all kinds, without the breaches of the rulebook.
        pub const KINDS: &[&str] = &[$($name),*];

        /// The name of each kind, and what it means.
        pub const MEANINGS: &[(&str, &str)] =
            &[$(($name, concat!($($doc),+).trim_ascii_start())),*];
    };
}

kinds! {
    /// Frames of more than one MainDevice.
    AnotherTalker { first: [u8; 6], other: [u8; 6], frames: u64 } "another-talker" Fault;
    /// Frames passed fewer devices than before.
    DevicesVanished { from: u16, to: u16, silent: Vec<usize> } "devices-vanished" Fault;
    /// Cyclic frames did not come back any more, to the end of the capture.
    SilentToTheEnd { frames: u64, for_ns: u64 } "silent-to-the-end" Fault;
    /// For a time no cyclic frame came back; before and behind they did.
    NothingCameBack { times: u64, frames: u64, for_ns: u64 } "nothing-came-back" Fault;
    /// A device that was in OP no longer answers.
    DeviceSilent {} "device-silent" Fault;
    /// SYNC0 runs, and no drift frames distribute the reference time.
    NoDriftFrames {} "no-drift-frames" Fault;
    /// The drift frames paused, or stopped for good.
    DriftFramesStopped { gap_ns: u64 } "drift-frames-stopped" Fault;
    /// The SYNC cycle is below what the device says it can do.
    CycleBelowMinimum { object: ObjectAddress, minimum_ns: u64, cycle_ns: u64 } "cycle-below-minimum" Fault;
    /// The start time was in the past when SYNC was switched on.
    StartInPast { late_ns: u64 } "start-in-past" Fault;
    /// The clock is so far from the reference that SYNC0 starts at another instant, or never.
    ClockFar { ahead_ns: i64 } "clock-far" Fault;
    /// The propagation delay that was written is not what the receive times say.
    OtherDelay { written_ns: u32, measured_ns: i64 } "other-delay" Fault;
    /// The offset or the delay of a clock was changed while SYNC0 ran and was not set up again.
    ClockSetEarly { address: u16, by_ns: i64 } "clock-set-early" Fault;
    /// The device was asked for OP and refused it, and no process data came meanwhile.
    OpWithoutData { status: AlStatus, code: Option<AlStatusCode>, for_ns: u64 } "op-without-data" Fault;
    /// The mailbox does not answer any more, though the MainDevice looks for the answer.
    MailboxStalled { object: ObjectAddress, for_ns: u64 } "mailbox-stalled" Fault;
    /// The synchronization type needs a SYNC signal that is not switched on.
    ModeWithoutSync { object: ObjectAddress, mode: SyncType } "mode-without-sync" Fault;
    /// SYNC0 was switched off while the device was to stay in OP.
    Sync0SwitchedOff {} "sync0-switched-off" Fault;
    /// The process data watchdog is not longer than the cycle.
    WatchdogBelowCycle { watchdog_ns: u64, cycle_ns: u64 } "watchdog-below-cycle" Fault;
    /// Cycles without a frame, in the time of the reference clock.
    CyclesSkipped { count: u64, longest_ns: u64, cycle_ns: u64 } "cycles-skipped" Fault;
    /// Cyclic frames did not come back.
    FramesLost { count: u64 } "frames-lost" Fault;
    /// Answers of cyclic frames came when the next cycle had begun.
    AnswersLate { count: u64, longest_ns: u64, cycle_ns: u64 } "answers-late" Fault;
    /// The cycle of the frames is neither a multiple nor a fraction of that of the SYNC unit.
    CycleMismatch { frames_ns: u64, cycle_ns: u64 } "cycle-mismatch" Fault;
    /// Frames slide through the cycle: the MainDevice does not follow the reference clock.
    HostSlides { turns: i64, ppm: f64 } "host-slides" Fault;
    /// Frames reached a device on the other side of SYNC0 than usual.
    SyncPassed { frames: u64, of: u64, worst_ns: i64 } "sync0-passed" Fault;
    /// Cycles without an answer, in a capture that does not show requests.
    CyclesMissing { count: u64, longest_ns: u64, cycle_ns: u64 } "cycles-missing" Fault;
    /// Answers of cyclic frames came without a request: devices took a frame twice.
    FramesDoubled { count: u64 } "frames-doubled" Fault;
    /// A device counted events that it missed, or that came too early.
    SyncCounted { object: ObjectAddress, count: u64 } "sync-counted" Fault;
    /// From the frame to SYNC0 there is less time than the device needs to copy its outputs.
    CopyTimeNotKept { least_ns: i64, needed_ns: u64 } "copy-time-not-kept" Fault;
    /// A clock was read far from the reference in operation.
    ClocksApart { ns: u32 } "clocks-apart" Fault;
    /// The offset (0x0920) or the delay (0x0928) of a clock was changed in operation.
    ClockSet { address: u16, by_ns: Option<i64> } "clock-set" Fault;
    /// Error counters grew between two readings.
    ErrorsCounted { address: u16, by: u64, operating: bool } "errors-counted" Fault;
    /// A device left OP without a request in the capture.
    LeftOp { to: AlStatus, code: Option<AlStatusCode> } "left-op" Fault;
    /// A device was asked for OP and stayed below it.
    StayedBelow { status: AlStatus } "stayed-below-op" Fault;
    /// All devices were asked to leave OP, and process data went on without them.
    AskedDown { state: AlState, for_ns: u64 } "asked-down" Fault;
    /// A device refused a state, or went to an error state.
    AlError { asked: Option<AlState>, status: AlStatus, code: Option<AlStatusCode>, came_up: bool } "al-error" Fault;
    /// The EEPROM of a device acknowledged no read any more, to the end of the capture.
    EepromSilent { count: u64 } "eeprom-silent" Fault;
    /// A working counter was lower than usual.
    WorkingCounter { which: Which, usual: u16, lowest: u16, frames: u64, missing: Vec<usize> } "working-counter" Fault;
    /// Cycles without a frame, by the stamps of the capture alone.
    GapSeen { count: u64, longest_ns: u64, cycle_ns: u64 } "gap-seen" Warning;
    /// SYNC was switched on while the clock was far from the reference.
    ClocksNotConverged { ns: u32 } "clocks-not-converged" Warning;
    /// SYNC0 is switched on, but the synchronization type does not use it.
    SyncWithoutMode { object: ObjectAddress, mode: SyncType } "sync-without-mode" Warning;
    /// SYNC0 is off at the device, and runs at another one of its kind.
    Sync0LeftOut { like: usize } "sync0-left-out" Warning;
    /// SYNC0 was switched on after the device had left PREOP.
    SyncAfterSafeOp { state: AlState } "sync-after-safeop" Warning;
    /// SYNC0 was switched on, but the way up did not write the device's system time offset.
    OffsetNotWritten {} "offset-not-written" Warning;
    /// SYNC0 was switched on, but the way up did not write the device's propagation delay.
    DelayNotWritten {} "delay-not-written" Warning;
    /// Frames enter the device at a port other than 0.
    PortsSwapped {} "ports-swapped" Warning;
    /// The MainDevice did not read whether SYNC runs.
    SyncNotLookedAt {} "sync-not-looked-at" Warning;
    /// The device aborted an SDO transfer.
    SdoAborted { object: ObjectAddress, code: AbortCode, written: bool, count: u64 } "sdo-aborted" Warning;
    /// No answer to a mailbox request was seen.
    MailboxSilent { object: ObjectAddress, count: u64 } "mailbox-silent" Warning;
    /// A mailbox request was sent after INIT had been read, and had no answer in time.
    MailboxEarly { object: ObjectAddress, count: u64 } "mailbox-early" Warning;
    /// The device refused a mailbox message.
    MailboxError { detail: ErrorDetail, count: u64 } "mailbox-error" Warning;
    /// A device sent an emergency message.
    Emergency { code: u16, count: u64 } "emergency" Warning;
    /// A device was in an error state when it was first seen.
    ErrorFromBefore { status: AlStatus, code: Option<AlStatusCode> } "error-from-before" Note;
    /// Error counters were not zero when they were first read.
    CountersFromBefore { count: u64 } "counters-from-before" Note;
    /// The EEPROM of a device was written.
    EepromWritten { count: u64 } "eeprom-written" Note;
}

impl Finding {
    /// A finding that `frame` shows.
    pub fn new(kind: Kind, device: Option<usize>, frame: usize) -> Self {
        Self { kind, device, frame, at: None, frames: Vec::new(), sure: Sure::Shown, order: None }
    }

    pub fn at(self, at: Duration) -> Self {
        Self { at: Some(at), ..self }
    }

    pub fn with(mut self, frames: impl IntoIterator<Item = usize>) -> Self {
        let own = self.frame;
        self.frames.extend(frames.into_iter().filter(|frame| *frame != own));
        self
    }

    pub fn likely(self) -> Self {
        Self { sure: Sure::Likely, ..self }
    }
}
