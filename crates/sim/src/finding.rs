//! Findings of judges: place, time, and a kind with its figures. The sentences for people are made
//! from them at the end.
//!
//! Runs in virtual time, runs on a real interface and served segments are judged in the same kinds.
//! Each judge reports the kinds that it can measure: on a real wire nothing is measured in true
//! time, and a simulated host has no interface.

use isocat_esc::Esc;
use isocat_maindevice::kind::{Description, Figures};
use isocat_maindevice::{Cause, SegmentChange, Stage, kinds};
use isocat_rules::Breach;
use isocat_wire::time::{Nanos, Picos, Time, True};
use isocat_wire::{AlStatus, AlStatusCode, ObjectAddress, register};

use crate::judge::{Late, LostPulses, Samples};

/// A condition that keeps the segment from being in sync.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Finding {
    /// The place.
    pub place: Place,
    /// Since when, counted from the start of the judged time; `None`: from its start, or unknown.
    pub since: Option<Nanos>,
    /// The kind with its figures.
    pub kind: Kind,
}

/// The place of a finding.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Place {
    /// Position of the SubDevice; `None`: the finding concerns the segment.
    pub device: Option<usize>,
    /// Stage of the bring-up; `None` in operation.
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
    /// Findings of judges. Changes of the segment have separate kinds, [`Kind::Change`].
    #[derive(Clone, PartialEq, Eq, Debug)]
    pub enum Judged {
        /// The bring-up failed.
        Failed = "failed" {
            /// Kind of the failure; the sentence names place, expected and found.
            cause: Cause,
            /// Register 0x0134, if a state was refused or not reached; otherwise null.
            code: Option<AlStatusCode>,
        },
        /// Not all SubDevices were in OP within the time allowed.
        TooLong = "bring-up-too-long",
        /// The run was ended by a signal before all SubDevices were in OP.
        EndedEarly = "ended-early",
        /// No SubDevice answers on a real interface.
        NothingAnswers = "nothing-answers" {
            /// The interface.
            interface: String,
            /// Whether it has a carrier; null: unknown.
            carrier: Option<bool>,
            /// Own frames that came back without processing by a SubDevice.
            unprocessed: u64,
        },
        /// Frames no longer come back on a real interface.
        Silence = "silence" {
            /// The interface.
            interface: String,
            /// Whether it has a carrier; null: unknown.
            carrier: Option<bool>,
        },
        /// A command of a start-up list from another tool (ENI) failed during bring-up.
        CommandFailed = "command-failed" {
            /// The command, and the failure.
            what: String,
        },
        /// A real interface failed.
        InterfaceFailed = "interface-failed" {
            /// The error of the operating system.
            error: String,
        },
        /// The number of SubDevices that answer is not that of the scan.
        CountChanged = "count-changed" {
            /// Number at the scan.
            expected: u16,
            /// Number now.
            found: u16,
        },
        /// The SubDevice left OP without a request.
        LeftOp = "left-op" {
            /// Register 0x0130.
            state: AlStatus,
            /// Register 0x0134.
            code: AlStatusCode,
        },
        /// The SubDevice is not in OP at the end.
        NotInOp = "not-in-op" {
            /// Register 0x0130.
            state: AlStatus,
            /// Register 0x0134.
            code: AlStatusCode,
        },
        /// The SubDevice does not answer at the end.
        NoAnswer = "no-answer",
        /// The pulse came before outputs were ready; without outputs, before inputs were read
        /// again.
        MissedEvents = "missed-events" {
            /// Number of events.
            count: u64,
            /// Whether the SubDevice has outputs.
            outputs: bool,
        },
        /// A SYNC0 pulse was further off the grid of the reference clock than allowed.
        Sync0OffGrid = "sync0-off-grid" {
            /// Error of the first such pulse; positive: late.
            error: Picos,
            /// Largest error allowed.
            limit: Picos,
            /// The largest absolute error.
            worst: Picos,
        },
        /// Pulses of SYNC0 or SYNC1 were due while the signal was still active from the previous
        /// pulse, and made no edge.
        SyncStillActive = "sync-still-active" {
            /// Pulses of SYNC0 without an edge.
            sync0: u64,
            /// Pulses of SYNC1 without an edge.
            sync1: u64,
            /// Whether the signal stays active until the SubDevice acknowledges it (0x0982 is 0);
            /// otherwise the pulse is longer than its cycle.
            acknowledged: bool,
        },
        /// SYNC0 is configured but never came.
        NoSync0 = "no-sync0",
        /// The SubDevice's mailbox was silent on the way up, so that it could not be asked for its
        /// mode; it runs in Free Run, which nobody chose.
        ModeNotAsked = "mode-not-asked" {
            /// The object that was asked for.
            object: ObjectAddress,
        },
        /// SYNC0 is on the grid without any spread, which is impossible for a controlled clock: the
        /// measurement is wrong.
        Sync0WithoutSpread = "sync0-without-spread",
        /// The time from SYNC0 to valid outputs varies too much.
        OutputsUneven = "outputs-uneven" {
            /// Largest less shortest time.
            spread: Picos,
            /// Largest spread allowed.
            limit: Picos,
        },
        /// Outputs acted a whole cycle or more after their first pulse (or SM event).
        OutputsLate = "outputs-late" {
            /// Largest number of cycles.
            cycles: u64,
            /// Number of frames whose outputs acted late.
            count: u64,
            /// The largest age of outputs that acted late, from the first bit of their frame at the
            /// MainDevice.
            age: Picos,
        },
        /// Inputs came a whole cycle or more after the first frame that could bring them.
        InputsLate = "inputs-late" {
            /// Largest number of cycles.
            cycles: u64,
            /// Number of inputs that came late.
            count: u64,
            /// The largest age of inputs that came late, from Input Latch to the frame's last bit
            /// at the MainDevice.
            age: Picos,
        },
        /// A device that oversamples handed over a set of samples that was not whole: pulses of
        /// SYNC0 were missing, or there were too many.
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
        /// 0x1C32:0B or 0x1C33:0B increased.
        SmEventMissed = "sm-event-missed" {
            /// The counter.
            object: ObjectAddress,
            /// Increase in the judged time.
            grew: u32,
            /// Its present value.
            value: u32,
        },
        /// 0x1C32:0C or 0x1C33:0C increased.
        CycleTimeTooSmall = "cycle-time-too-small" {
            /// The counter.
            object: ObjectAddress,
            /// Increase in the judged time; null: it was only read at the end.
            grew: Option<u32>,
            /// Its present value.
            value: u32,
        },
        /// 0x1C32:0D or 0x1C33:0D increased.
        ShiftTimeTooShort = "shift-time-too-short" {
            /// The counter.
            object: ObjectAddress,
            /// Increase in the judged time; null: it was only read at the end.
            grew: Option<u32>,
            /// Its present value.
            value: u32,
        },
        /// 0x1C32:20 or 0x1C33:20 is set.
        SyncError = "sync-error" {
            /// The flag.
            object: ObjectAddress,
            /// Increase in the judged time; null: it was only read at the end.
            grew: Option<u32>,
            /// Its present value.
            value: u32,
        },
        /// The clock of the SubDevice is further from the reference clock than allowed.
        ClockOff = "clock-off" {
            /// Register 0x092C.
            difference: Nanos,
            /// Largest difference allowed.
            limit: Nanos,
        },
        /// Frames found the reference clock so late that outputs came too late for their pulse, by
        /// the times that the SubDevice states.
        FramesTooLate = "frames-too-late" {
            /// Number of cycles.
            cycles: u64,
            /// Largest lateness, with the worst clocks that the plan assumes.
            by: Nanos,
        },
        /// Frames found the reference clock so early that inputs were not ready, that outputs came
        /// before the pulse of the previous cycle, or that they count as those of that cycle.
        FramesTooEarly = "frames-too-early" {
            /// Number of cycles.
            cycles: u64,
            /// Largest earliness, with the worst clocks that the plan assumes.
            by: Nanos,
        },
        /// The delay to the SubDevice differs from the one that was written by more than a clock
        /// may deviate.
        DelayChanged = "delay-changed" {
            /// Register 0x0928.
            written: Nanos,
            /// The delay measured now.
            found: Picos,
        },
        /// The drive had time to switch on but did not.
        DriveNotEnabled = "drive-not-enabled",
        /// Process data came back with a wrong working counter.
        WorkingCounter = "working-counter" {
            /// Number of datagrams.
            datagrams: u64,
        },
        /// The host was late by more than a whole cycle: no frame of these cycles was sent.
        CyclesSkipped = "cycles-skipped" {
            /// Number of cycles.
            cycles: u64,
        },
        /// Frames left, and none came back for a while.
        NothingCameBack = "nothing-came-back" {
            /// How long, the longest time.
            lasted: Nanos,
            /// Frames that left meanwhile.
            frames: u64,
        },
        /// Frames did not come back in time.
        FramesLost = "frames-lost" {
            /// Number of frames.
            frames: u64,
        },
        /// Answers came, but a cycle or more after they were to come: each of these cycles has the
        /// inputs of one before. The segment is not what is slow.
        AnswersLate = "answers-late" {
            /// Number of frames.
            frames: u64,
        },
        /// The host's clock is not locked onto the reference clock at the end.
        HostNotLocked = "host-not-locked" {
            /// Whether it was locked and then received no more reference times.
            holdover: bool,
        },
        /// A SubDevice that may be absent has come.
        Found = "found" {
            /// Cycle.
            cycle: u64,
        },
        /// A SubDevice that may be absent was absent all the time.
        AlwaysAbsent = "always-absent",
    }
}

impl Judged {
    /// Outputs that acted late, and since when; `None` if they never did.
    pub fn outputs_late(late: &Late) -> Option<(Time<True>, Self)> {
        let (cycles, count, age) = (late.cycles(), late.count(), late.age());
        Some((late.first()?, Self::OutputsLate { cycles, count, age }))
    }

    /// Inputs that came late, and since when; `None` if they never did.
    pub fn inputs_late(late: &Late) -> Option<(Time<True>, Self)> {
        let (cycles, count, age) = (late.cycles(), late.count(), late.age());
        Some((late.first()?, Self::InputsLate { cycles, count, age }))
    }

    /// Sets of samples were not whole, and since when; `None` if all were. `expected` is how many
    /// samples a set has.
    pub fn samples_incomplete(
        samples: &Samples,
        outputs: bool,
        expected: u16,
    ) -> Option<(Time<True>, Self)> {
        let ((at, found), expected) = (samples.first_incomplete()?, expected.into());
        let count = samples.incomplete();
        Some((at, Self::SamplesIncomplete { outputs, expected, found, count }))
    }

    /// SYNC pulses of an ESC that made no edge, and since when; `None` if each pulse made one.
    pub fn sync_still_active<M: AsRef<[u8]> + AsMut<[u8]>>(
        lost: &LostPulses,
        esc: &Esc<M>,
    ) -> Option<(Time<True>, Self)> {
        let (sync0, sync1) = (lost.sync0(), lost.sync1());
        let acknowledged = esc.register(register::SYNC_PULSE_LENGTH) == 0;
        Some((lost.first()?, Self::SyncStillActive { sync0, sync1, acknowledged }))
    }

    /// The finding of a failed bring-up.
    pub fn failed(cause: Cause) -> Self {
        Self::Failed { code: cause.al_status_code(), cause }
    }
}

/// The kind of a finding, with its figures.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Kind {
    /// Found by a judge.
    Judged(Judged),
    /// Reported by the MainDevice: the segment changed.
    Change(SegmentChange),
    /// Found by a rule: something is otherwise than it was meant.
    Breach(Breach),
}

impl Kind {
    /// The name of the kind. It stays the same even if the sentence changes.
    pub const fn name(&self) -> &'static str {
        match self {
            Kind::Judged(kind) => kind.name(),
            Kind::Change(kind) => kind.name(),
            Kind::Breach(kind) => kind.name(),
        }
    }

    /// The figures by name, including the unit.
    pub fn figures(&self) -> Figures {
        match self {
            Kind::Judged(kind) => kind.figures(),
            Kind::Change(kind) => kind.figures(),
            Kind::Breach(kind) => kind.figures(),
        }
    }

    /// All kinds with their figures.
    pub fn descriptions() -> impl Iterator<Item = &'static Description> {
        let kinds = [Judged::DESCRIPTIONS, SegmentChange::DESCRIPTIONS, Breach::DESCRIPTIONS];
        kinds.into_iter().flatten()
    }

    /// The AL status code in its figures, if there is one.
    pub fn al_status_code(&self) -> Option<AlStatusCode> {
        match self {
            Kind::Judged(Judged::LeftOp { code, .. } | Judged::NotInOp { code, .. }) => Some(*code),
            Kind::Judged(Judged::Failed { code, .. }) => *code,
            Kind::Breach(Breach::NotOperated { code, .. }) => Some(*code),
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

impl From<Breach> for Kind {
    fn from(kind: Breach) -> Self {
        Kind::Breach(kind)
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
