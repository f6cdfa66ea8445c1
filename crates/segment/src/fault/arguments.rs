//! The arguments of a word, read from left to right.

use std::str::FromStr;
use std::sync::Arc;

use isocat_descriptions::quantity::{self, Length, Ppb, QuantityError};
use isocat_sim::Direction;
use isocat_sim::fault::{Harm, LateHost, MILLION, RING_CABLE, Which};
use isocat_subdevice::Misbehaviour;
use isocat_wire::AlStatusCode;
use isocat_wire::time::Nanos;

use super::Wrong;
use crate::profile::{self, Profile};
use crate::segment_file::{self, RING_NAME};

/// The words of a line, and the names of the SubDevices.
pub struct Arguments<'a> {
    words: Vec<&'a str>,
    at: usize,
    names: &'a [String],
}

/// The longest time of a fault.
const LONGEST: Nanos = Nanos::millis(3_600_000);

/// Lengths of cables, mm, as for the key `cable`.
const LENGTHS: std::ops::RangeInclusive<i64> = 10..=2_000_000;

impl<'a> Arguments<'a> {
    pub fn of(text: &'a str, names: &'a [String]) -> Self {
        Self { words: text.split_whitespace().collect(), at: 0, names }
    }

    /// The next word.
    pub fn next(&mut self) -> Option<&'a str> {
        let word = self.words.get(self.at).copied();
        self.at += usize::from(word.is_some());
        word
    }

    fn peek(&self) -> Option<&'a str> {
        self.words.get(self.at).copied()
    }

    /// Takes the next word if it is this one.
    pub fn take(&mut self, word: &str) -> bool {
        let is_next = self.peek() == Some(word);
        self.at += usize::from(is_next);
        is_next
    }

    /// A SubDevice by its name, which may contain spaces, or by its position.
    pub fn device(&mut self) -> Result<usize, Wrong> {
        let rest = &self.words[self.at..];
        for count in (1..=rest.len()).rev() {
            let text = rest[..count].join(" ");
            let text = text.trim_matches('"');
            if let Some(position) = self.names.iter().position(|name| name == text) {
                self.at += count;
                return Ok(position);
            }
        }
        let last = self.names.len().saturating_sub(1);
        let position = rest.first().and_then(|word| usize::from_str(word).ok());
        match position.filter(|position| *position < self.names.len()) {
            Some(position) => {
                self.at += 1;
                Ok(position)
            }
            None => {
                let found = rest.join(" ");
                Err(Wrong(format!(
                    "no SubDevice \"{found}\": a name, or a position from 0 to {last}"
                )))
            }
        }
    }

    /// A cable: the one that leads to a SubDevice, or `ring` for the one that closes a ring.
    pub fn cable(&mut self) -> Result<usize, Wrong> {
        match self.device() {
            // Without a ring, a SubDevice may have that name.
            Err(_) if self.take(RING_NAME) => Ok(RING_CABLE),
            cable => cable,
        }
    }

    /// A time of 0 or more.
    pub fn time(&mut self) -> Result<Nanos, Wrong> {
        let word = self.next().ok_or_else(|| Wrong("a time is missing".into()))?;
        if word == "0" {
            return Ok(Nanos::ZERO);
        }
        let time = quantity::parse_duration(word).map_err(|error| Wrong(error.to_string()))?;
        match (Nanos::ZERO..=LONGEST).contains(&time) {
            true => Ok(time),
            false => Err(Wrong(format!("\"{word}\" is not from 0 to 1 h"))),
        }
    }

    /// The length of a cable, mm.
    pub fn length(&mut self) -> Result<u64, Wrong> {
        let word = self.next().ok_or_else(|| Wrong("a length is missing".into()))?;
        let length: Length = word.parse().map_err(|e: QuantityError| Wrong(e.to_string()))?;
        match LENGTHS.contains(&length.0) {
            true => Ok(length.0 as u64),
            false => Err(Wrong(format!("\"{word}\" is not from 10 mm to 2 km"))),
        }
    }

    /// A time above 0, long enough to separate repeated faults.
    pub fn pause(&mut self) -> Result<Nanos, Wrong> {
        let time = self.time()?;
        if time >= SHORTEST_PAUSE {
            return Ok(time);
        }
        Err(Wrong(format!("{time} is too short: 10 us at least")))
    }

    /// A time, if the next word is one.
    pub fn some_time(&mut self) -> Result<Option<Nanos>, Wrong> {
        let is_time = |word: &str| word == "0" || quantity::parse_duration(word).is_ok();
        match self.peek().is_some_and(is_time) {
            true => self.time().map(Some),
            false => Ok(None),
        }
    }

    /// One time, or the least and the largest of two.
    pub fn span(&mut self) -> Result<(Nanos, Nanos), Wrong> {
        let least = self.time()?;
        let most = self.some_time()?.unwrap_or(least);
        match least <= most {
            true => Ok((least, most)),
            false => Err(Wrong(format!("the shorter time stands first, found {least} and {most}"))),
        }
    }

    /// Lateness on the host.
    pub fn late(&mut self) -> Result<LateHost, Wrong> {
        let (least, most) = self.span()?;
        let ppm = match self.peek().is_some_and(|word| word.ends_with('%')) {
            true => self.share()?,
            false => MILLION,
        };
        Ok(LateHost { least, most, ppm })
    }

    /// A number of frames, or a share of all.
    pub fn which(&mut self) -> Result<Which, Wrong> {
        let word = self.peek().ok_or_else(|| Wrong("which frames is missing".into()))?;
        if word.ends_with('%') || word == "0" {
            return self.chance();
        }
        self.at += 1;
        match u64::from_str(word).ok().filter(|count| (1..=MOST_FRAMES).contains(count)) {
            Some(count) => Ok(Which::Next(count)),
            None => Err(Wrong(format!(
                "\"{word}\" is no number of frames from 1 to {MOST_FRAMES}, and no share such as 0.5%"
            ))),
        }
    }

    /// A share of all frames, and the number of consecutive frames.
    pub fn chance(&mut self) -> Result<Which, Wrong> {
        let ppm = self.share()?;
        let burst = match self.take("burst") {
            true => self.number(1, 100_000)? as u32,
            false => 1,
        };
        Ok(Which::Chance { ppm, burst })
    }

    /// A share, in parts per million.
    fn share(&mut self) -> Result<u32, Wrong> {
        let word = self.next().ok_or_else(|| Wrong("a share is missing".into()))?;
        let wrong = || Wrong(format!("\"{word}\" is no share from 0% to 100%"));
        if word == "0" {
            return Ok(0);
        }
        let percent = f64::from_str(word.strip_suffix('%').ok_or_else(wrong)?);
        let percent = percent.ok().filter(|percent| (0.0..=100.0).contains(percent));
        Ok((percent.ok_or_else(wrong)? * f64::from(MILLION / 100)).round() as u32)
    }

    pub fn number(&mut self, least: u64, most: u64) -> Result<u64, Wrong> {
        let word = self.next().unwrap_or_default();
        let number = u64::from_str(word).ok().filter(|number| (least..=most).contains(number));
        number.ok_or_else(|| Wrong(format!("\"{word}\" is no number from {least} to {most}")))
    }

    /// `out` or `back`, if the next word is one of them.
    pub fn some_way(&mut self) -> Option<Direction> {
        if self.take("out") {
            return Some(Direction::Out);
        }
        self.take("back").then_some(Direction::Back)
    }

    pub fn way(&mut self) -> Result<Direction, Wrong> {
        let found = self.peek().unwrap_or("nothing");
        self.some_way().ok_or_else(|| Wrong(format!("\"{found}\" is neither out nor back")))
    }

    /// Direction and place of frames: `[out|back] [at CABLE]`.
    pub fn place(&mut self) -> Result<(Option<Direction>, Option<usize>), Wrong> {
        let way = self.some_way();
        let cable = self.take("at").then(|| self.cable()).transpose()?;
        Ok((way.or_else(|| self.some_way()), cable))
    }

    /// Frequency deviation of a clock, ppb (positive: faster).
    pub fn rate(&mut self) -> Result<i64, Wrong> {
        let word = self.next().ok_or_else(|| Wrong("a rate is missing".into()))?;
        let Ppb(rate) = Ppb::from_str(word).map_err(|error| Wrong(error.to_string()))?;
        match rate.abs() <= MOST_RATE {
            true => Ok(rate),
            false => Err(Wrong(format!("\"{word}\" is beyond 5000 ppm"))),
        }
    }

    /// A 16-bit code, in decimal or with 0x.
    pub fn code(&mut self) -> Result<AlStatusCode, Wrong> {
        let word = self.next().unwrap_or_default();
        let code = match word.strip_prefix("0x") {
            Some(digits) => u16::from_str_radix(digits, 16).ok(),
            None => word.parse().ok(),
        };
        let code = code.filter(|code| *code != 0).map(AlStatusCode);
        code.ok_or_else(|| Wrong(format!("\"{word}\" is no AL status code such as 0x0050")))
    }

    /// A misbehaviour of a SubDevice: the rest of the line, up to `for`.
    pub fn misbehaviour(&mut self) -> Result<Misbehaviour, Wrong> {
        let rest = &self.words[self.at..];
        let end = rest.iter().position(|word| *word == "for").unwrap_or(rest.len());
        self.at += end;
        let misbehaviour = segment_file::misbehaviour(&rest[..end].join(" "));
        misbehaviour.map_err(|message| Wrong(message.replace('\n', "; ")))
    }

    /// A built-in device.
    pub fn profile(&mut self) -> Result<Arc<Profile>, Wrong> {
        let word = self.next().unwrap_or_default();
        profile::built_in(word).ok_or_else(|| Wrong(format!("no built-in device \"{word}\"")))
    }

    /// `for` and a time, if the next word is `for`.
    pub fn lasts(&mut self) -> Result<Option<Nanos>, Wrong> {
        self.take("for").then(|| self.pause()).transpose()
    }

    /// A delay: its size, and the frames.
    pub fn delay(&mut self) -> Result<(Harm, Which), Wrong> {
        let (least, most) = self.span()?;
        let named = |word: &str| word.ends_with('%') || word.parse::<u64>().is_ok();
        let which = match self.peek().is_some_and(named) {
            true => self.which()?,
            // A delay of 0 means that no frame is late any more.
            false if most == Nanos::ZERO => Which::Chance { ppm: 0, burst: 1 },
            false => Which::Chance { ppm: MILLION, burst: 1 },
        };
        Ok((Harm::Late { least, most }, which))
    }
}

const MOST_FRAMES: u64 = 1_000_000_000;
/// Half of the range of the simulation's clocks, ppb.
const MOST_RATE: i64 = 5_000_000;
const SHORTEST_PAUSE: Nanos = Nanos::micros(10);
