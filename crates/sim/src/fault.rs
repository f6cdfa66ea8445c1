//! Faults as data: the common language of faults for simulations, served segments, and the code
//! that drives them.
//!
//! A [`Fault`] is what happens; a [`Planned`] fault also has its time, number, probability and
//! duration. A [`Timeline`] keeps the planned faults in the order of time. All random decisions
//! come from the seed of the run.
//!
//! `frames` decides about frames; `happen` applies the other faults to a segment and its host.

use isocat_subdevice::Misbehaviour;
use isocat_wire::datagram::Address;
use isocat_wire::frame::FrameWriter;
use isocat_wire::time::Nanos;
use isocat_wire::{AlStatusCode, Command, register};

use crate::cable::Direction;

pub(crate) mod frames;
pub(crate) mod happen;
pub mod timeline;
mod words;

pub use timeline::{Happened, Timeline};

/// A fault, or its repair.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Fault {
    /// Frames are harmed.
    Frames(FrameFault),
    /// A cable is pulled. The number of a SubDevice names the cable that leads to it,
    /// [`RING_CABLE`] the one that closes a ring.
    Pull {
        /// The cable.
        cable: usize,
    },
    /// A cable is plugged in, and all its broken lines are repaired.
    Plug {
        /// The cable.
        cable: usize,
    },
    /// One direction of a cable is broken: the ESC at the receiving end loses its link, the other
    /// one keeps it and sends without effect.
    BreakWay {
        /// The cable.
        cable: usize,
        /// The direction.
        way: Direction,
    },
    /// A cable is pulled and plugged in repeatedly.
    Flap {
        /// The cable.
        cable: usize,
        /// How long it is pulled.
        off: Nanos,
        /// How long it is plugged in.
        on: Nanos,
    },
    /// A cable is replaced by one of another length.
    Recable {
        /// The cable.
        cable: usize,
        /// Length of the new cable, mm.
        millimetres: u64,
        /// Time without a cable. If it is shorter than the ends need to notice, no link is lost.
        takes: Nanos,
    },
    /// A SubDevice loses its power.
    PowerOff {
        /// Position.
        device: usize,
    },
    /// A SubDevice gets its power again.
    PowerOn {
        /// Position.
        device: usize,
    },
    /// A SubDevice is replaced by another one.
    Replace {
        /// Position.
        device: usize,
        /// Index of the spare SubDevice ([`Timeline::with_spares`]).
        spare: usize,
        /// Time without any SubDevice in its place.
        takes: Nanos,
    },
    /// The EEPROM of a SubDevice does not answer its ESC.
    DeadEeprom {
        /// Position.
        device: usize,
    },
    /// A clock changes its speed.
    Clock {
        /// The clock.
        whose: Whose,
        /// The change.
        change: ClockChange,
    },
    /// The host's clock jumps ahead.
    ClockJump {
        /// The jump.
        by: Nanos,
    },
    /// No program runs on the host: timers and frames are not handled.
    Stall,
    /// Programs on the host wake up late.
    LateWakeUps(LateHost),
    /// Frames leave the host later than the program's time stamp.
    SlowSends(LateHost),
    /// A SubDevice misbehaves.
    Misbehave {
        /// Position.
        device: usize,
        /// The misbehaviour.
        how: Misbehaviour,
    },
    /// The SYNC unit of a SubDevice is switched off: register 0x0981 is set to 0.
    SyncOff {
        /// Position.
        device: usize,
    },
    /// The application of a SubDevice fails: it goes to SAFEOP, or stays in a lower state, with
    /// this code.
    AlError {
        /// Position.
        device: usize,
        /// The code in register 0x0134.
        code: AlStatusCode,
    },
    /// Another MainDevice sends to the same segment.
    SecondMaster {
        /// The frames that it sends.
        sends: Foreign,
        /// Time from one frame to the next.
        every: Nanos,
    },
    /// Ends all faults in force.
    Heal,
}

/// The number of the cable that closes a ring, in faults that name a cable. Faults are configured
/// before the number of SubDevices, and so of cables, is known.
pub const RING_CABLE: usize = usize::MAX;

/// A fault of frames.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct FrameFault {
    /// What happens to them.
    pub harm: Harm,
    /// Which frames.
    pub which: Which,
    /// Direction; `None`: either, at random.
    pub way: Option<Direction>,
    /// Number of the cable; `None`: between the MainDevice and its port.
    pub cable: Option<usize>,
}

/// What happens to a frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Harm {
    /// It is lost.
    Lost,
    /// One of its bits is flipped: ESCs count it, and the program does not receive it.
    Damaged,
    /// It is delayed.
    Late {
        /// Least delay.
        least: Nanos,
        /// Largest delay.
        most: Nanos,
    },
    /// It arrives twice.
    Doubled,
}

/// Which frames are hit.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Which {
    /// This number of frames that come next.
    Next(u64),
    /// Random frames.
    Chance {
        /// Probability, parts per million. 0 ends all random faults of the same kind, direction and
        /// place.
        ppm: u32,
        /// Number of successive frames that a hit affects, from 1.
        burst: u32,
    },
}

/// The clock that changes.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Whose {
    /// The host's clock.
    Host,
    /// The clock of the SubDevice at this position.
    Device(usize),
}

/// How the speed of a clock changes. The sum of all changes stays within 1 % of true time.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ClockChange {
    /// At once.
    Step {
        /// Change of the speed, ppb.
        by_ppb: i64,
    },
    /// Evenly, in [`RAMP_PIECES`](crate::oscillator::RAMP_PIECES) steps.
    Ramp {
        /// Change of the speed in all, ppb.
        by_ppb: i64,
        /// Duration.
        over: Nanos,
    },
    /// It wanders, for [`WALK_PIECES`](crate::oscillator::WALK_PIECES) intervals.
    Walk {
        /// Largest change from one interval to the next, ppb.
        step_ppb: i64,
        /// Length of an interval.
        every: Nanos,
        /// Largest distance from the initial speed, ppb.
        bound_ppb: i64,
    },
}

/// Random delays on the host.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct LateHost {
    /// Least delay.
    pub least: Nanos,
    /// Largest delay.
    pub most: Nanos,
    /// Probability, parts per million.
    pub ppm: u32,
}

/// Frames that another MainDevice sends.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Foreign {
    /// A broadcast read of AL status, which counts the SubDevices.
    Count,
    /// A broadcast write to AL control, which requests INIT of all SubDevices.
    Init,
}

impl Foreign {
    /// Writes the frame; returns its length.
    pub(crate) fn write(self, buffer: &mut [u8]) -> usize {
        let mut frame = FrameWriter::new(buffer, FOREIGN_SOURCE);
        let (control, status) = (register::AL_CONTROL.address, register::AL_STATUS.address);
        let pushed = match self {
            Self::Count => {
                frame.push(Command::Brd, FOREIGN_INDEX, Address::Broadcast(status), &[0; 2])
            }
            Self::Init => {
                frame.push(Command::Bwr, FOREIGN_INDEX, Address::Broadcast(control), &[1, 0])
            }
        };
        debug_assert!(pushed.is_ok(), "the shortest frame holds a datagram");
        frame.finish()
    }
}

/// Source address of the other MainDevice: a globally administered address that no device has.
const FOREIGN_SOURCE: [u8; 6] = [0x00, 0x00, 0x5E, 0x00, 0x53, 0x01];
const FOREIGN_INDEX: u8 = 0x5A;

/// The time of a fault.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum When {
    /// This time after the segment was switched on.
    At(Nanos),
    /// This time after the MainDevice reached a moment.
    After(Moment, Nanos),
}

/// A moment of the MainDevice's work. Each is reached once.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum Moment {
    /// All SubDevices that take part are in OP.
    InOperation,
    /// This number of cycles is complete.
    Cycle(u64),
}

/// A fault, and its times.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Planned {
    /// When it happens first.
    pub when: When,
    /// Largest additional delay, drawn each time.
    pub within: Nanos,
    /// Probability that it happens, parts per million, drawn each time.
    pub ppm: u32,
    /// Number of times, from 1.
    pub times: u32,
    /// Time from one occurrence to the next.
    pub every: Nanos,
    /// Duration each time; `None`: until the end of the run, or until another fault ends it.
    pub lasts: Option<Nanos>,
    /// The fault.
    pub fault: Fault,
}

impl Planned {
    /// A fault that happens once, without an end.
    pub const fn once(when: When, fault: Fault) -> Self {
        let (within, every) = (Nanos::ZERO, Nanos::ZERO);
        Self { when, within, ppm: MILLION, times: 1, every, lasts: None, fault }
    }
}

/// Certainty, in parts per million.
pub const MILLION: u32 = 1_000_000;

/// Whether it concerns cables or the power of SubDevices. The segment must know such faults before
/// their time, since a frame in flight meets them at its place.
fn is_of_the_wire(fault: &Fault) -> bool {
    use Fault::*;
    matches!(
        fault,
        Pull { .. }
            | Plug { .. }
            | BreakWay { .. }
            | Flap { .. }
            | Recable { .. }
            | PowerOff { .. }
            | PowerOn { .. }
    )
}

impl Fault {
    /// Whether it happens to the MainDevice's host, so that it needs a simulated host.
    pub fn is_of_the_host(&self) -> bool {
        use Fault::*;
        let own = matches!(
            self,
            ClockJump { .. } | Stall | LateWakeUps(_) | SlowSends(_) | SecondMaster { .. }
        );
        own || matches!(self, Clock { whose: Whose::Host, .. })
    }

    /// The cable that it concerns, if any.
    pub fn cable(&self) -> Option<usize> {
        use Fault::*;
        match self {
            Pull { cable }
            | Plug { cable }
            | BreakWay { cable, .. }
            | Flap { cable, .. }
            | Recable { cable, .. } => Some(*cable),
            Frames(frames) => frames.cable,
            _ => None,
        }
    }

    /// Whether it can have a duration.
    pub fn can_end(&self) -> bool {
        use Fault::*;
        !matches!(
            self,
            Plug { .. }
                | PowerOn { .. }
                | Replace { .. }
                | Recable { .. }
                | ClockJump { .. }
                | AlError { .. }
                | Heal
                | Frames(FrameFault { which: Which::Next(_), .. })
        )
    }
}
