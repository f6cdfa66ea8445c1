//! Kinds of breaches: what is otherwise than it was intended.

use alloc::string::String;

use isocat_sync::SyncMode;
use isocat_wire::time::{Nanos, Picos};
use isocat_wire::{AlState, AlStatusCode};

use crate::kind::{Figure, Figured};
use crate::kinds;

kinds! {
    /// A breach of a claim.
    #[derive(Clone, PartialEq, Eq, Debug)]
    pub enum Breach {
        /// The SubDevice was not in OP while the segment was operated, and is not optional.
        NotOperated = "not-operated" {
            /// Its state.
            state: AlState,
            /// Register 0x0134.
            code: AlStatusCode,
        },
        /// The SubDevice runs in another mode than was asked for.
        OtherMode = "other-mode" {
            /// The mode that was asked for.
            wanted: SyncMode,
            /// The mode in which it runs.
            found: SyncMode,
            /// Register 0x0981; null: unknown.
            activation: Option<u8>,
        },
        /// SYNC0 is switched on and never comes: its start time had passed.
        StartPassed = "start-passed" {
            /// How long ago the pulse was due (0x0990) by the clock of the SubDevice.
            ago: Nanos,
        },
        /// SYNC0 of the SubDevice has another cycle than was asked for.
        OtherSync0Cycle = "other-sync0-cycle" {
            /// The cycle that was asked for.
            wanted: Nanos,
            /// Register 0x09A0.
            found: Nanos,
        },
        /// SYNC0 comes at another time after its frame than was asked for, by more than a quarter
        /// of the cycle.
        OtherShift = "other-shift" {
            /// The time from the beginning of a cycle to SYNC0 that was asked for.
            wanted: Nanos,
            /// The mean time from the beginning of the frame to SYNC0.
            found: Picos,
        },
        /// SYNC0 of two SubDevices does not come at one instant.
        Sync0Apart = "sync0-apart" {
            /// Position of the other one.
            from: usize,
            /// By how much it comes later than there.
            by: Nanos,
            /// Largest distance allowed.
            limit: Nanos,
        },
        /// Frames follow each other at another cycle than was asked for.
        OtherCycle = "other-cycle" {
            /// The cycle that was asked for.
            wanted: Nanos,
            /// The mean time from one frame to the next.
            found: Nanos,
        },
        /// The SubDevice was described with process data and runs without any.
        NoProcessData = "no-process-data",
        /// The SubDevice has process data in a direction, and no frame carries them.
        NotCarried = "not-carried" {
            /// Whether they are outputs; else inputs.
            outputs: bool,
        },
        /// Frames carry the process data of the SubDevice in a direction more seldom than they are
        /// to be exchanged: in cycles between it acts on old outputs, or its inputs are old.
        CarriedSeldom = "carried-seldom" {
            /// Whether they are outputs; else inputs.
            outputs: bool,
            /// The time from one exchange to the next that was asked for.
            wanted: Nanos,
            /// The mean time from one to the next.
            found: Nanos,
        },
        /// The interpolation time of the drive is not the time from one set point to the next: it
        /// steps or waits at each.
        OtherInterpolation = "other-interpolation" {
            /// The time from one set point to the next.
            wanted: Nanos,
            /// Object 0x60C2.
            found: Nanos,
        },
        /// Two SubDevices take the same logical bits: the outputs of one are those of the other, or
        /// one overwrites the inputs of the other.
        SharedAddress = "shared-address" {
            /// Position of the other one.
            with: usize,
            /// Whether they are outputs; else inputs.
            outputs: bool,
            /// The first logical byte that both take.
            logical: u32,
        },
        /// The outputs of the SubDevice are not guarded by its process data watchdog.
        WatchdogOff = "watchdog-off",
        /// The process data watchdog has another time than was asked for.
        OtherWatchdog = "other-watchdog" {
            /// The time that was asked for.
            wanted: Nanos,
            /// The time by its registers.
            found: Nanos,
        },
        /// The clock of the SubDevice was set anew while it operated, and its SYNC0 jumped.
        ClockSet = "clock-set" {
            /// The largest change of its offset (0x0920) or its delay (0x0928).
            by: Nanos,
        },
        /// The reference time did not reach the clocks for so long that they may have run apart
        /// further than SYNC0 may.
        TimeNotDistributed = "time-not-distributed" {
            /// The longest time without a drift datagram.
            gap: Nanos,
            /// The longest one that two quartz clocks bear.
            limit: Nanos,
        },
        /// Frames slide through the cycle: the MainDevice does not follow the reference clock.
        FramesSlide = "frames-slide" {
            /// Movement in a second; positive: frames come later and later.
            per_second: Nanos,
            /// Time after which they have moved by half of a cycle.
            half_cycle_after: Nanos,
        },
        /// The program sent some frames though it had not taken the answers to those before: it
        /// works with the inputs of this cycle at times, and at times with those of the last one.
        AnswersUntaken = "answers-untaken" {
            /// Frames that left so.
            frames: u64,
            /// All frames of these kinds.
            of: u64,
        },
        /// More than one MainDevice sent frames at the same time.
        SeveralTalkers = "several-talkers" {
            /// Frames of the second one.
            frames: u64,
        },
    }
}

impl Figured for SyncMode {
    fn figure(&self) -> Figure {
        Figure::Text(String::from(self.name()))
    }
}
