//! Faults that are injected while the segment is served.

use std::fmt;
use std::str::FromStr;

use isocat_descriptions::quantity;
use isocat_sim::Served;
use isocat_sim::random::Stream;
use isocat_wire::time::{Nanos, Picos, Time, True};

/// A fault, or its end.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Fault {
    /// Pulls the cable that leads to a SubDevice.
    Pull(usize),
    /// Plugs it in again.
    Plug(usize),
    /// Switches a SubDevice off and, after a time, on again.
    PowerCycle {
        /// Position.
        device: usize,
        /// How long it is off.
        off: Nanos,
    },
    /// Loses the next frames.
    Drop(u64),
    /// Loses frames by chance, parts per million; 0 ends it.
    Loss(u32),
    /// Answers come later by this; 0 ends it.
    Delay {
        /// At least.
        least: Nanos,
        /// At most.
        most: Nanos,
    },
}

/// The faults that are in force.
#[derive(Debug)]
pub(super) struct Faults {
    drop: u64,
    loss_ppm: u32,
    least: Nanos,
    most: Nanos,
    chance: Stream,
    /// SubDevices that are off, and when each is switched on again.
    off: Vec<(usize, Time<True>)>,
}

impl Faults {
    pub fn new(seed: u64) -> Self {
        Self {
            drop: 0,
            loss_ppm: 0,
            least: Nanos::ZERO,
            most: Nanos::ZERO,
            chance: Stream::new(seed, "served faults", 0),
            off: Vec::new(),
        }
    }

    pub fn inject(&mut self, served: &mut Served, fault: &Fault) -> Result<(), String> {
        let count = served.segment().devices().len();
        let known = |device: usize| match device < count {
            true => Ok(()),
            false => Err(format!("there is no SubDevice {device}; expected 0 to {}", count - 1)),
        };
        match *fault {
            Fault::Pull(device) | Fault::Plug(device) => {
                known(device)?;
                let now = served.now();
                match fault {
                    Fault::Pull(_) => served.segment_mut().unplug(device, now),
                    _ => served.segment_mut().plug(device, now),
                }
            }
            Fault::PowerCycle { device, off } => {
                known(device)?;
                if self.off.iter().any(|(other, _)| *other == device) {
                    return Err(format!("SubDevice {device} is off already"));
                }
                let now = served.now();
                served.segment_mut().power_off(device, now);
                self.off.push((device, now + Picos::from(off)));
            }
            Fault::Drop(frames) => self.drop = frames,
            Fault::Loss(ppm) => self.loss_ppm = ppm,
            Fault::Delay { least, most } => (self.least, self.most) = (least, most),
        }
        Ok(())
    }

    /// Whether a frame is lost now, on its way in or (by chance, as often) on its way back.
    pub fn drops(&mut self, inward: bool) -> bool {
        if inward && self.drop > 0 {
            self.drop -= 1;
            return true;
        }
        // Half of the losses happen before the segment, half behind it.
        self.loss_ppm > 0 && self.chance.up_to(2 * MILLION - 1) < u64::from(self.loss_ppm)
    }

    /// Switches on again what has been off long enough at `to`, each at its own instant.
    pub fn restore(&mut self, served: &mut Served, to: Time<True>) {
        self.off.sort_by_key(|(_, on)| *on);
        while let Some(&(device, on)) = self.off.first().filter(|(_, on)| *on <= to) {
            self.off.remove(0);
            // Frames may have run ahead of the clock meanwhile.
            let on = on.max(served.now());
            served.segment_mut().power_on(device, on);
        }
    }

    /// When a SubDevice is to be switched on next.
    pub fn due(&self) -> Option<Time<True>> {
        self.off.iter().map(|(_, on)| *on).min()
    }

    /// How much later the next answer goes back.
    pub fn delay(&mut self) -> Nanos {
        if self.most <= self.least {
            return self.least;
        }
        self.least + Nanos(self.chance.up_to((self.most.0 - self.least.0) as u64) as i64)
    }
}

const MILLION: u64 = 1_000_000;
const LONGEST: Nanos = Nanos::millis(60_000);
/// How long a power cycle takes if nobody says.
const OFF: Nanos = Nanos::millis(500);

impl Fault {
    /// Reads `pull 2`, `plug 2`, `power-cycle 2 [500ms]`, `drop 3`, `loss 0.5%`, `delay 100us [300us]`; a
    /// SubDevice may be named by one of `names` too.
    pub fn parse(text: &str, names: &[String]) -> Result<Self, String> {
        let text = text.trim();
        let (verb, rest) = text.split_once(' ').unwrap_or((text, ""));
        let rest = rest.trim();
        match verb {
            "pull" => Ok(Self::Pull(device(rest, names)?)),
            "plug" => Ok(Self::Plug(device(rest, names)?)),
            "power-cycle" => {
                let (name, off) = match rest.rsplit_once(' ') {
                    Some((name, off)) if quantity::parse_duration(off).is_ok() => {
                        (name, duration(off)?)
                    }
                    _ => (rest, OFF),
                };
                Ok(Self::PowerCycle { device: device(name, names)?, off })
            }
            "drop" => {
                let frames = u64::from_str(rest);
                frames
                    .map(Self::Drop)
                    .map_err(|_| format!("expected a number of frames, found \"{rest}\""))
            }
            "loss" => percentage(rest).map(Self::Loss),
            "delay" => {
                let (least, most) = match rest.split_once(' ') {
                    Some((least, most)) => (duration(least)?, duration(most)?),
                    None => (duration(rest)?, duration(rest)?),
                };
                match least <= most {
                    true => Ok(Self::Delay { least, most }),
                    false => Err(format!("expected the shorter delay first, found {rest}")),
                }
            }
            _ => Err(format!("unknown command \"{verb}\"; expected {COMMANDS}")),
        }
    }
}

/// The commands, for messages.
pub(crate) const COMMANDS: &str = "pull, plug, power-cycle, drop, loss, delay, status or stop";

fn device(text: &str, names: &[String]) -> Result<usize, String> {
    let text = text.trim();
    if let Some(position) = names.iter().position(|name| name == text) {
        return Ok(position);
    }
    match usize::from_str(text) {
        Ok(position) if position < names.len() => Ok(position),
        _ => {
            let last = names.len().saturating_sub(1);
            Err(format!("expected a SubDevice's name or its place, 0 to {last}, found \"{text}\""))
        }
    }
}

fn duration(text: &str) -> Result<Nanos, String> {
    if text.trim() == "0" {
        return Ok(Nanos::ZERO);
    }
    let span = quantity::parse_duration(text.trim()).map_err(|error| error.to_string())?;
    match (Nanos::ZERO..=LONGEST).contains(&span) {
        true => Ok(span),
        false => Err(format!("expected a time up to 60 s, found {text}")),
    }
}

/// Parts per million of a percentage.
fn percentage(text: &str) -> Result<u32, String> {
    let wrong = || format!("expected a share of all frames from 0% to 100%, found \"{text}\"");
    let number = text.strip_suffix('%').ok_or_else(wrong)?;
    let percent = f64::from_str(number.trim()).map_err(|_| wrong())?;
    let valid = (0.0..=100.0).contains(&percent);
    if valid { Ok((percent * 10_000.0).round() as u32) } else { Err(wrong()) }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Pull(device) => write!(f, "the cable to SubDevice {device} is pulled"),
            Self::Plug(device) => write!(f, "the cable to SubDevice {device} is plugged in"),
            Self::PowerCycle { device, off } => write!(f, "SubDevice {device} is off for {off}"),
            Self::Drop(frames) => write!(f, "the next {frames} frames are lost"),
            Self::Loss(0) => write!(f, "no frames are lost by chance"),
            Self::Loss(ppm) => write!(f, "{} % of all frames are lost", f64::from(*ppm) / 10_000.0),
            Self::Delay { most: Nanos(0), .. } => write!(f, "answers are no longer late"),
            Self::Delay { least, most } if least == most => {
                write!(f, "answers are late by {least}")
            }
            Self::Delay { least, most } => write!(f, "answers are late by {least} to {most}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Fault, String> {
        Fault::parse(text, &["axis 1".to_owned(), "axis 2".to_owned()])
    }

    #[test]
    fn commands_are_read() {
        assert_eq!(parse("pull axis 2"), Ok(Fault::Pull(1)));
        assert_eq!(parse("plug 0"), Ok(Fault::Plug(0)));
        let off = Nanos::millis(20);
        assert_eq!(parse("power-cycle axis 1 20ms"), Ok(Fault::PowerCycle { device: 0, off }));
        assert_eq!(parse("power-cycle axis 1"), Ok(Fault::PowerCycle { device: 0, off: OFF }));
        assert_eq!(parse("drop 3"), Ok(Fault::Drop(3)));
        assert_eq!(parse("loss 0.5%"), Ok(Fault::Loss(5_000)));
        let (least, most) = (Nanos::micros(100), Nanos::micros(300));
        assert_eq!(parse("delay 100us 300us"), Ok(Fault::Delay { least, most }));
        assert_eq!(parse("delay 0"), Ok(Fault::Delay { least: Nanos(0), most: Nanos(0) }));
    }

    #[test]
    fn mistakes_say_what_is_expected() {
        for (text, expected) in [
            ("pull axis 3", "found \"axis 3\""),
            ("pull 2", "0 to 1"),
            ("drop many", "a number of frames"),
            ("loss 101%", "0% to 100%"),
            ("loss 5", "0% to 100%"),
            ("delay 2us 1us", "the shorter delay first"),
            ("delay 2 weeks", "has no unit"),
            ("explode", "expected pull, plug"),
            ("", "expected pull, plug"),
        ] {
            let message = parse(text).expect_err(text);
            assert!(message.contains(expected), "{text}: {message}");
        }
    }

    #[test]
    fn losses_come_as_often_as_asked_for() {
        let mut faults = Faults::new(1);
        faults.loss_ppm = 100_000;
        let lost = (0..20_000).filter(|_| faults.drops(true) || faults.drops(false)).count();
        assert!((1_800..2_200).contains(&lost), "{lost}");
        faults.loss_ppm = 0;
        assert!(!(0..1_000).any(|_| faults.drops(true)));
    }
}
