//! A small world, tried out whole: one to three SubDevices, and each thing that can happen to a
//! frame.

use std::fmt::Write;

use crate::draw::Drawn;

/// What happens to the frame of a cycle.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Fate {
    OnTime,
    /// It leaves late, by this number of eighths of the cycle.
    Late(u64),
    /// It is lost on its way out, or back.
    LostOut,
    LostBack,
    /// Devices see it twice, or the MainDevice does.
    DoubledOut,
    DoubledBack,
    /// The next frame overtakes it on its way out, or back.
    OvertakenOut,
    OvertakenBack,
}

impl Fate {
    /// All that can happen to one frame: late by up to three cycles.
    pub fn all() -> impl Iterator<Item = Self> {
        use Fate::*;
        let others =
            [LostOut, LostBack, DoubledOut, DoubledBack, OvertakenOut, OvertakenBack, OnTime];
        (1..=24).map(Late).chain(others)
    }

    /// As a fault of a segment file with this cycle, ns.
    fn what(self, cycle: u64) -> Option<String> {
        Some(match self {
            Self::OnTime => return None,
            Self::Late(eighths) => {
                format!("slow-send {}ns for {cycle}ns", cycle * eighths / 8)
            }
            Self::LostOut => "drop 1 out".to_owned(),
            Self::LostBack => "drop 1 back".to_owned(),
            Self::DoubledOut => "double 1 out".to_owned(),
            Self::DoubledBack => "double 1 back".to_owned(),
            Self::OvertakenOut => format!("delay {}ns 1 out", cycle * 5 / 4),
            Self::OvertakenBack => format!("delay {}ns 1 back", cycle * 5 / 4),
        })
    }
}

/// A segment with this number of SubDevices. `fates` happen to the frames of successive cycles.
/// `reads`: the counters of SubDevices are read before that and behind it.
pub fn segment(devices: usize, reads: bool, fates: &[Fate]) -> Drawn {
    let mut text = format!("cycle = \"{CYCLE}ns\"\nfor = \"{}ns\"\n", CYCLE * LENGTH);
    for mode in &MODES[..devices] {
        let _ = writeln!(text, "[[subdevice]]\ndevice = \"model_every_mode\"\nmode = \"{mode}\"");
    }
    for (number, fate) in (0..).zip(fates) {
        let Some(what) = fate.what(CYCLE) else { continue };
        // From the middle of a cycle on, so that one frame alone meets it.
        let at = CYCLE * (BEFORE + number) + CYCLE / 2;
        let _ = writeln!(text, "[[fault]]\nat = \"in-operation + {at}ns\"\nwhat = \"{what}\"");
    }
    Drawn { text, recovers: false, reads }
}

/// All sequences of `length` fates of an alphabet; `number` counts them.
pub fn sequence(alphabet: &[Fate], length: u32, number: usize) -> Vec<Fate> {
    let digit = |place| number / alphabet.len().pow(place) % alphabet.len();
    (0..length).map(|place| alphabet[digit(place)]).collect()
}

const CYCLE: u64 = 1_000_000;
/// Cycles of a run, and those before the first fate.
const LENGTH: u64 = 60;
const BEFORE: u64 = 20;
const MODES: [&str; 3] = ["dc-sync0", "sm", "dc-sync1"];
