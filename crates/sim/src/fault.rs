//! What can go wrong, as data: the one language of faults of simulations, served segments, and whatever drives them.
//!
//! A [`Fault`] says what happens, a [`Planned`] also when, how often, with what probability and for how long. A
//! [`Timeline`] keeps what is planned in the order of time, and everything that chance decides comes
//! from the seed of the run.
//!
//! What becomes of frames is decided in `frames`; `happen` does the rest to a segment and the machine that leads it.

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

/// Something that goes wrong, or is put right.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Fault {
    /// Frames are harmed.
    Frames(FrameFault),
    /// A cable is pulled; that of a SubDevice's number is the one that leads to it, [`RING_CABLE`] the one that closes a
    /// ring.
    Pull {
        /// The cable.
        cable: usize,
    },
    /// A cable is plugged in, and whatever of it was broken is mended.
    Plug {
        /// The cable.
        cable: usize,
    },
    /// One way of a cable is broken: the ESC that listens at its end loses its link, the other one keeps it and sends into
    /// nothing.
    BreakWay {
        /// The cable.
        cable: usize,
        /// The way.
        way: Direction,
    },
    /// A cable is pulled and plugged in again and again.
    Flap {
        /// The cable.
        cable: usize,
        /// How long it is pulled.
        off: Nanos,
        /// How long it is plugged in.
        on: Nanos,
    },
    /// A cable is taken out, and one of another length is put in its place.
    Recable {
        /// The cable.
        cable: usize,
        /// Length of the one that comes, mm.
        millimetres: u64,
        /// How long there is none. Shorter than its ends need to notice, no link is lost.
        takes: Nanos,
    },
    /// A SubDevice loses its power.
    PowerOff {
        /// Position.
        device: usize,
    },
    /// It has its power again.
    PowerOn {
        /// Position.
        device: usize,
    },
    /// A SubDevice is taken out, and another one is put in its place.
    Replace {
        /// Position.
        device: usize,
        /// Which of the spare SubDevices ([`Timeline::with_spares`]).
        spare: usize,
        /// How long nothing is there.
        takes: Nanos,
    },
    /// The EEPROM of a SubDevice does not answer its ESC.
    DeadEeprom {
        /// Position.
        device: usize,
    },
    /// A clock runs at another speed.
    Clock {
        /// Whose clock.
        whose: Whose,
        /// How it changes.
        change: ClockChange,
    },
    /// The host's clock jumps ahead.
    ClockJump {
        /// By how much.
        by: Nanos,
    },
    /// No program runs on the host: neither timers nor frames are seen.
    Stall,
    /// Programs on the host are woken late.
    LateWakeUps(LateHost),
    /// Frames leave the host late, after the program's time stamp.
    SlowSends(LateHost),
    /// A SubDevice misbehaves.
    Misbehave {
        /// Position.
        device: usize,
        /// What it does wrong.
        how: Misbehaviour,
    },
    /// The SYNC unit of a SubDevice is switched off: 0 is written to register 0x0981.
    SyncOff {
        /// Position.
        device: usize,
    },
    /// The application of a SubDevice can't go on: SAFEOP, or the state that it is in if that is lower, with this code.
    AlError {
        /// Position.
        device: usize,
        /// The code in register 0x0134.
        code: AlStatusCode,
    },
    /// Another MainDevice sends at the same segment.
    SecondMaster {
        /// What it sends.
        sends: Foreign,
        /// How often.
        every: Nanos,
    },
    /// All that is in force ends.
    Heal,
}

/// Stands for the cable that closes a ring wherever a fault names a cable by its number: faults are told before it is
/// known how many SubDevices, and so how many other cables, there are.
pub const RING_CABLE: usize = usize::MAX;

/// What happens to which frames.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct FrameFault {
    /// What.
    pub harm: Harm,
    /// Which frames.
    pub which: Which,
    /// On which way; `None`: either, by chance.
    pub way: Option<Direction>,
    /// On the cable with this number; `None`: between the MainDevice and its port.
    pub cable: Option<usize>,
}

/// What is done to a frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Harm {
    /// It is lost.
    Lost,
    /// A bit of it tips over: ESCs count it and the program never sees it.
    Damaged,
    /// It comes later.
    Late {
        /// By so much at least.
        least: Nanos,
        /// By so much at most.
        most: Nanos,
    },
    /// It comes twice.
    Doubled,
}

/// Which frames are harmed.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Which {
    /// So many that come next.
    Next(u64),
    /// By chance.
    Chance {
        /// Probability, parts per million. 0 ends all faults of this harm, way and place that go by chance.
        ppm: u32,
        /// One that is hit takes the next ones with it: so many in all, from 1.
        burst: u32,
    },
}

/// Whose clock.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Whose {
    /// That of the host.
    Host,
    /// That of the SubDevice at this position.
    Device(usize),
}

/// How the speed of a clock changes. Clocks stay within 1 % of true time, whatever is added up.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ClockChange {
    /// At once.
    Step {
        /// By how much, ppb.
        by_ppb: i64,
    },
    /// Evenly, in [`RAMP_PIECES`](crate::oscillator::RAMP_PIECES) stairs.
    Ramp {
        /// By how much in all, ppb.
        by_ppb: i64,
        /// In what time.
        over: Nanos,
    },
    /// It wanders, for [`WALK_PIECES`](crate::oscillator::WALK_PIECES) intervals.
    Walk {
        /// By so much at most from one interval to the next, ppb.
        step_ppb: i64,
        /// Length of an interval.
        every: Nanos,
        /// Never farther than this from where it began, ppb.
        bound_ppb: i64,
    },
}

/// How late something on the host is.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct LateHost {
    /// At least.
    pub least: Nanos,
    /// At most.
    pub most: Nanos,
    /// Probability, parts per million.
    pub ppm: u32,
}

/// What another MainDevice sends.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Foreign {
    /// A broadcast read of AL status: it counts the SubDevices.
    Count,
    /// A broadcast write to AL control: everybody to INIT.
    Init,
}

impl Foreign {
    /// Writes the frame; gives its length.
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

/// Source address of the other MainDevice: a globally administered one of nobody.
const FOREIGN_SOURCE: [u8; 6] = [0x00, 0x00, 0x5E, 0x00, 0x53, 0x01];
const FOREIGN_INDEX: u8 = 0x5A;

/// When something happens.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum When {
    /// After the segment was switched on.
    At(Nanos),
    /// Some time after the MainDevice came to a point of its work.
    After(Moment, Nanos),
}

/// A point of the MainDevice's work. Each comes once.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum Moment {
    /// All SubDevices that take part are in OP.
    InOperation,
    /// So many cycles are over.
    Cycle(u64),
}

/// A fault, and when it happens.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Planned {
    /// When, for the first time.
    pub when: When,
    /// Up to so much later, drawn each time.
    pub within: Nanos,
    /// Probability that it happens at all, parts per million, drawn each time.
    pub ppm: u32,
    /// How often, from 1.
    pub times: u32,
    /// From one time to the next.
    pub every: Nanos,
    /// How long it is in force each time; `None`: until the end, or until something else ends it.
    pub lasts: Option<Nanos>,
    /// What happens.
    pub fault: Fault,
}

impl Planned {
    /// It happens once and for good.
    pub const fn once(when: When, fault: Fault) -> Self {
        let (within, every) = (Nanos::ZERO, Nanos::ZERO);
        Self { when, within, ppm: MILLION, times: 1, every, lasts: None, fault }
    }
}

/// Certainty, in parts per million.
pub const MILLION: u32 = 1_000_000;

/// Whether it takes place on cables or at the power of SubDevices. Such things are told to the segment before their
/// time: a frame on its way meets them where it is.
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
    /// Whether it happens to the machine that leads the segment, and so only where that is simulated too.
    pub fn is_of_the_host(&self) -> bool {
        use Fault::*;
        let own = matches!(
            self,
            ClockJump { .. } | Stall | LateWakeUps(_) | SlowSends(_) | SecondMaster { .. }
        );
        own || matches!(self, Clock { whose: Whose::Host, .. })
    }

    /// The cable that it is about, if it is about one.
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

    /// Whether it can be in force for a time and end.
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
