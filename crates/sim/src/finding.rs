//! What judges find: where, since when, and which kind with its figures. Sentences are made of it at the end, for people.
//!
//! Runs in virtual time, runs on a real interface and served segments are judged in the same kinds. Each judge finds those
//! that it can see: nothing on a real wire is measured in true time, and a simulated host has no interface.

use isocat_esc::Esc;
use isocat_maindevice::kind::{Description, Figures};
use isocat_maindevice::{Cause, SegmentChange, Stage, kinds};
use isocat_wire::time::{Nanos, Picos, Time, True};
use isocat_wire::{AlStatus, AlStatusCode, ObjectAddress, register};

use crate::judge::{Late, LostPulses, Samples};

/// Something that keeps the segment from being in sync.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Finding {
    /// Where.
    pub place: Place,
    /// Since when, counted from the beginning of the judged time; `None`: from its beginning, or that is not known.
    pub since: Option<Nanos>,
    /// What, with its figures.
    pub kind: Kind,
}

/// Where something was found.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Place {
    /// Position of the SubDevice; `None` concerns the segment.
    pub device: Option<usize>,
    /// Stage of the way up; `None` in operation.
    pub stage: Option<Stage>,
}

impl Place {
    /// The segment, in operation.
    pub const SEGMENT: Self = Self { device: None, stage: None };

    /// A SubDevice in operation.
    pub const fn device(position: usize) -> Self {
        Self { device: Some(position), stage: None }
    }
}

kinds! {
    /// What judges find; changes of the segment are kinds of their own, [`Kind::Change`].
    #[derive(Clone, PartialEq, Eq, Debug)]
    pub enum Judged {
        /// The way up failed.
        Failed = "failed" {
            /// Which kind of failure; the sentence names place, expected and found.
            cause: Cause,
            /// Register 0x0134, if a state was refused or not reached; else null.
            code: Option<AlStatusCode>,
        },
        /// Not all SubDevices were in OP within the time allowed.
        TooLong = "bring-up-too-long",
        /// The run was ended by a signal before all SubDevices were in OP.
        EndedEarly = "ended-early",
        /// Not one SubDevice answers on a real interface.
        NothingAnswers = "nothing-answers" {
            /// The interface.
            interface: String,
            /// Whether it has a carrier; null: not known.
            carrier: Option<bool>,
            /// Own frames that came back and no SubDevice had processed.
            unprocessed: u64,
        },
        /// Frames stopped coming back on a real interface.
        Silence = "silence" {
            /// The interface.
            interface: String,
            /// Whether it has a carrier; null: not known.
            carrier: Option<bool>,
        },
        /// A command of a start-up list that another tool wrote (ENI) failed on the way up.
        CommandFailed = "command-failed" {
            /// The command, and what happened.
            what: String,
        },
        /// A real interface failed.
        InterfaceFailed = "interface-failed" {
            /// What the operating system says.
            error: String,
        },
        /// Another number of SubDevices answers than at the scan.
        CountChanged = "count-changed" {
            /// At the scan.
            expected: u16,
            /// Now.
            found: u16,
        },
        /// The SubDevice left OP though it was not asked to.
        LeftOp = "left-op" {
            /// Register 0x0130.
            state: AlStatus,
            /// Register 0x0134.
            code: AlStatusCode,
        },
        /// The SubDevice is in another state than OP at the end.
        NotInOp = "not-in-op" {
            /// Register 0x0130.
            state: AlStatus,
            /// Register 0x0134.
            code: AlStatusCode,
        },
        /// The SubDevice does not answer at the end.
        NoAnswer = "no-answer",
        /// The pulse came before outputs were ready; without outputs, before inputs were read again.
        MissedEvents = "missed-events" {
            /// How often.
            count: u64,
            /// Whether the SubDevice has outputs.
            outputs: bool,
        },
        /// A SYNC0 pulse lay further off the grid of the reference clock than allowed.
        Sync0OffGrid = "sync0-off-grid" {
            /// The first that was; positive: late.
            error: Picos,
            /// Largest error allowed.
            limit: Picos,
            /// The largest of all errors, without its sign.
            worst: Picos,
        },
        /// Pulses of SYNC0 or SYNC1 were due while the signal was still active from the one before, and made no edge.
        SyncStillActive = "sync-still-active" {
            /// Pulses of SYNC0 without an edge.
            sync0: u64,
            /// Pulses of SYNC1 without an edge.
            sync1: u64,
            /// Whether the signal stays active until the SubDevice acknowledges it (0x0982 is 0); else the pulse is longer than
            /// its cycle.
            acknowledged: bool,
        },
        /// SYNC0 was asked for and did not come once.
        NoSync0 = "no-sync0",
        /// SYNC0 lies on the grid without any spread, which no clock that is steered can do: the measurement is wrong.
        Sync0WithoutSpread = "sync0-without-spread",
        /// Outputs become valid at a distance from SYNC0 that varies too much.
        OutputsUneven = "outputs-uneven" {
            /// From the least to the largest distance.
            spread: Picos,
            /// Largest spread allowed.
            limit: Picos,
        },
        /// Outputs acted a whole cycle or more behind the first pulse (or SM event) that they were
        /// for.
        OutputsLate = "outputs-late" {
            /// The most cycles.
            cycles: u64,
            /// Frames whose outputs acted late.
            count: u64,
            /// The largest age of outputs that acted late: from the first bit of their frame at the
            /// MainDevice.
            age: Picos,
        },
        /// Inputs came a whole cycle or more behind the first frame that could bring them.
        InputsLate = "inputs-late" {
            /// The most cycles.
            cycles: u64,
            /// Inputs that came late.
            count: u64,
            /// The largest age of inputs that came late: from Input Latch to the frame's last bit
            /// at the MainDevice.
            age: Picos,
        },
        /// A device that oversamples handed over a set of samples that was not whole: pulses of SYNC0 were missing, or there
        /// were too many.
        SamplesIncomplete = "samples-incomplete" {
            /// Whether they are samples of outputs; else of inputs.
            outputs: bool,
            /// Samples of a whole set.
            expected: u64,
            /// Samples of the first set that was not whole.
            found: u64,
            /// Sets that were not whole.
            count: u64,
        },
        /// 0x1C32:0B or 0x1C33:0B rose.
        SmEventMissed = "sm-event-missed" {
            /// The counter.
            object: ObjectAddress,
            /// By how much it rose in the judged time.
            grew: u32,
            /// As it is now.
            value: u32,
        },
        /// 0x1C32:0C or 0x1C33:0C rose.
        CycleTimeTooSmall = "cycle-time-too-small" {
            /// The counter.
            object: ObjectAddress,
            /// By how much it rose in the judged time; null: it was read at the end only.
            grew: Option<u32>,
            /// As it is now.
            value: u32,
        },
        /// 0x1C32:0D or 0x1C33:0D rose.
        ShiftTimeTooShort = "shift-time-too-short" {
            /// The counter.
            object: ObjectAddress,
            /// By how much it rose in the judged time; null: it was read at the end only.
            grew: Option<u32>,
            /// As it is now.
            value: u32,
        },
        /// 0x1C32:20 or 0x1C33:20 is set.
        SyncError = "sync-error" {
            /// The flag.
            object: ObjectAddress,
            /// By how much it rose in the judged time; null: it was read at the end only.
            grew: Option<u32>,
            /// As it is now.
            value: u32,
        },
        /// The clock of the SubDevice is further from the reference clock than allowed.
        ClockOff = "clock-off" {
            /// Register 0x092C.
            difference: Nanos,
            /// Largest difference allowed.
            limit: Nanos,
        },
        /// Frames found the reference clock so late that outputs came too late for their pulse, by the times that the
        /// SubDevice states.
        FramesTooLate = "frames-too-late" {
            /// Cycles.
            cycles: u64,
            /// By how much at most, with the worst clocks that the plan assumes.
            by: Nanos,
        },
        /// Frames found the reference clock so early that inputs were not ready, that outputs came before the pulse of the
        /// cycle before, or that they count as those of that cycle.
        FramesTooEarly = "frames-too-early" {
            /// Cycles.
            cycles: u64,
            /// By how much at most, with the worst clocks that the plan assumes.
            by: Nanos,
        },
        /// The delay to the SubDevice is no longer the one that was written, by more than a clock may be off.
        DelayChanged = "delay-changed" {
            /// Register 0x0928.
            written: Nanos,
            /// Measured now.
            found: Picos,
        },
        /// The drive had time to switch on and did not.
        DriveNotEnabled = "drive-not-enabled",
        /// Process data came back with a wrong working counter.
        WorkingCounter = "working-counter" {
            /// Datagrams.
            datagrams: u64,
        },
        /// The host came later than a whole cycle: no frame of these cycles was sent.
        CyclesSkipped = "cycles-skipped" {
            /// Cycles.
            cycles: u64,
        },
        /// Frames did not come back in time.
        FramesLost = "frames-lost" {
            /// Frames.
            frames: u64,
        },
        /// The host's clock is not locked onto the reference clock at the end.
        HostNotLocked = "host-not-locked" {
            /// Whether it was, and then heard nothing more from the reference clock.
            holdover: bool,
        },
        /// A SubDevice that may be absent came.
        Found = "found" {
            /// Cycle.
            cycle: u64,
        },
        /// A SubDevice that may be absent was absent all the time.
        AlwaysAbsent = "always-absent",
    }
}

impl Judged {
    /// Outputs acted late, and since when; `None` if they never did.
    pub fn outputs_late(late: &Late) -> Option<(Time<True>, Self)> {
        let (cycles, count, age) = (late.cycles(), late.count(), late.age());
        Some((late.first()?, Self::OutputsLate { cycles, count, age }))
    }

    /// Inputs came late, and since when; `None` if they never did.
    pub fn inputs_late(late: &Late) -> Option<(Time<True>, Self)> {
        let (cycles, count, age) = (late.cycles(), late.count(), late.age());
        Some((late.first()?, Self::InputsLate { cycles, count, age }))
    }

    /// Sets of samples were not whole, and since when; `None` if all were. `expected` is how many samples a set has.
    pub fn samples_incomplete(
        samples: &Samples,
        outputs: bool,
        expected: u16,
    ) -> Option<(Time<True>, Self)> {
        let ((at, found), expected) = (samples.first_incomplete()?, expected.into());
        let count = samples.incomplete();
        Some((at, Self::SamplesIncomplete { outputs, expected, found, count }))
    }

    /// SYNC pulses of an ESC made no edge, and since when; `None` if each did.
    pub fn sync_still_active<M: AsRef<[u8]> + AsMut<[u8]>>(
        lost: &LostPulses,
        esc: &Esc<M>,
    ) -> Option<(Time<True>, Self)> {
        let (sync0, sync1) = (lost.sync0(), lost.sync1());
        let acknowledged = esc.register(register::SYNC_PULSE_LENGTH) == 0;
        Some((lost.first()?, Self::SyncStillActive { sync0, sync1, acknowledged }))
    }

    /// The way up failed.
    pub fn failed(cause: Cause) -> Self {
        Self::Failed { code: cause.al_status_code(), cause }
    }
}

/// What was found, with its figures.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Kind {
    /// By a judge.
    Judged(Judged),
    /// By the MainDevice: the segment changed.
    Change(SegmentChange),
}

impl Kind {
    /// The name of the kind; it stays the same whatever the sentence becomes.
    pub const fn name(&self) -> &'static str {
        match self {
            Kind::Judged(kind) => kind.name(),
            Kind::Change(kind) => kind.name(),
        }
    }

    /// The figures by their names, the unit included.
    pub fn figures(&self) -> Figures {
        match self {
            Kind::Judged(kind) => kind.figures(),
            Kind::Change(kind) => kind.figures(),
        }
    }

    /// All kinds with their figures.
    pub fn descriptions() -> impl Iterator<Item = &'static Description> {
        Judged::DESCRIPTIONS.iter().chain(SegmentChange::DESCRIPTIONS)
    }

    /// The AL status code that is part of it.
    pub fn al_status_code(&self) -> Option<AlStatusCode> {
        match self {
            Kind::Judged(Judged::LeftOp { code, .. } | Judged::NotInOp { code, .. }) => Some(*code),
            Kind::Judged(Judged::Failed { code, .. }) => *code,
            Kind::Change(
                SegmentChange::LeftOut { cause }
                | SegmentChange::NotAdmitted { cause }
                | SegmentChange::NotRecovered { cause },
            ) => cause.al_status_code(),
            _ => None,
        }
    }
}

impl From<Judged> for Kind {
    fn from(kind: Judged) -> Self {
        Kind::Judged(kind)
    }
}

impl From<SegmentChange> for Kind {
    fn from(kind: SegmentChange) -> Self {
        Kind::Change(kind)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_two_kinds_have_one_name() {
        let mut names: Vec<_> = Kind::descriptions().map(|kind| kind.name).collect();
        let all = names.len();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), all);
        let kebab = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
        assert!(names.iter().all(|name| name.chars().all(kebab)), "{names:?}");
    }
}
