//! Faults in words, for summaries and logs.

use std::fmt;

use super::{
    ClockChange, Fault, Foreign, FrameFault, Happened, Harm, LateHost, RING_CABLE, Which, Whose,
};
use crate::cable::Direction;

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Frames(frames) => frames.fmt(f),
            Self::Pull { cable } => write!(f, "{} is pulled", CableName(*cable)),
            Self::Plug { cable } => write!(f, "{} is plugged in", CableName(*cable)),
            Self::BreakWay { cable: RING_CABLE, way } => {
                let way = match way {
                    Direction::Out => "to",
                    Direction::Back => "from",
                };
                let cable = CableName(RING_CABLE);
                write!(f, "{cable} is broken on the way {way} the secondary port")
            }
            Self::BreakWay { cable, way } => {
                let way = match way {
                    Direction::Out => "to",
                    Direction::Back => "from",
                };
                write!(f, "the cable at SubDevice {cable} is broken on the way {way} it")
            }
            Self::Flap { cable: RING_CABLE, off, on } => {
                write!(f, "the link that closes the ring flaps: {off} off, {on} on")
            }
            Self::Flap { cable, off, on } => {
                write!(f, "the link to SubDevice {cable} flaps: {off} off, {on} on")
            }
            Self::Recable { cable, millimetres, takes } => {
                let metres = *millimetres as f64 / 1_000.0;
                write!(f, "{} becomes one of {metres} m, in {takes}", CableName(*cable))
            }
            Self::PowerOff { device } => write!(f, "SubDevice {device} is off"),
            Self::PowerOn { device } => write!(f, "SubDevice {device} is on"),
            Self::Replace { device, takes, .. } => {
                write!(f, "SubDevice {device} is replaced by another one, in {takes}")
            }
            Self::DeadEeprom { device } => {
                write!(f, "the EEPROM of SubDevice {device} does not answer")
            }
            Self::Clock { whose, change } => write!(f, "the clock of {whose} {change}"),
            Self::ClockJump { by } => write!(f, "the host's clock jumps ahead by {by}"),
            Self::Stall => write!(f, "the host stands still"),
            Self::LateWakeUps(late) => write!(f, "the host wakes up late {late}"),
            Self::SlowSends(late) => write!(f, "frames leave the host late {late}"),
            Self::Misbehave { device, how } => {
                write!(f, "SubDevice {device} misbehaves: {}", how.word())
            }
            Self::SyncOff { device } => {
                write!(f, "the SYNC unit of SubDevice {device} is switched off")
            }
            Self::AlError { device, code } => {
                write!(f, "the application of SubDevice {device} can't go on: {code}")
            }
            Self::SecondMaster { sends: Foreign::Count, every } => {
                write!(f, "a second MainDevice counts the SubDevices every {every}")
            }
            Self::SecondMaster { sends: Foreign::Init, every } => {
                write!(f, "a second MainDevice asks all for INIT every {every}")
            }
            Self::Heal => f.write_str("all faults end"),
        }
    }
}

/// Displays the name of a cable.
struct CableName(usize);

impl fmt::Display for CableName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            RING_CABLE => f.write_str("the cable that closes the ring"),
            device => write!(f, "the cable to SubDevice {device}"),
        }
    }
}

/// `SubDevice 2 is off`, and at its end `over: SubDevice 2 is off`.
impl fmt::Display for Happened {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let over = if self.begins { "" } else { "over: " };
        write!(f, "{over}{}", self.fault)
    }
}

impl fmt::Display for FrameFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let harm = match self.harm {
            Harm::Lost => "lost".to_owned(),
            Harm::Damaged => "damaged".to_owned(),
            Harm::Late { least, most } if least == most => format!("late by {least}"),
            Harm::Late { least, most } => format!("late by {least} to {most}"),
            Harm::Doubled => "doubled".to_owned(),
        };
        match self.which {
            Which::Next(1) => write!(f, "the next frame is {harm}")?,
            Which::Next(count) => write!(f, "the next {count} frames are {harm}")?,
            Which::Chance { ppm: 0, .. } => write!(f, "no frames are {harm} by chance")?,
            Which::Chance { ppm, burst } => {
                write!(f, "{} % of all frames are {harm}", percent(ppm))?;
                if burst > 1 {
                    write!(f, ", {burst} in a row")?;
                }
            }
        }
        match self.way {
            Some(Direction::Out) => f.write_str(" on the way out")?,
            Some(Direction::Back) => f.write_str(" on the way back")?,
            None => {}
        }
        match self.cable {
            Some(cable) => write!(f, " on {}", CableName(cable)),
            None => Ok(()),
        }
    }
}

impl fmt::Display for Whose {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Host => f.write_str("the host"),
            Self::Device(device) => write!(f, "SubDevice {device}"),
        }
    }
}

impl fmt::Display for ClockChange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ppm = |ppb: i64| ppb as f64 / 1_000.0;
        match *self {
            Self::Step { by_ppb } => write!(f, "runs {:+} ppm faster at once", ppm(by_ppb)),
            Self::Ramp { by_ppb, over } => {
                write!(f, "runs {:+} ppm faster within {over}", ppm(by_ppb))
            }
            Self::Walk { bound_ppb, every, .. } => {
                write!(f, "wanders within {} ppm, a step every {every}", ppm(bound_ppb))
            }
        }
    }
}

impl fmt::Display for LateHost {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { least, most, ppm } = *self;
        match least == most {
            true => write!(f, "by {least}")?,
            false => write!(f, "by {least} to {most}")?,
        }
        match percent(ppm) {
            100.0 => Ok(()),
            percent => write!(f, ", {percent} % of the time"),
        }
    }
}

fn percent(ppm: u32) -> f64 {
    f64::from(ppm) / 10_000.0
}
