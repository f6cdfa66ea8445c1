//! What a seed gives: a small segment, and what goes wrong with it.

use std::fmt::Write;

use isocat_segment::profile::{built_in, built_in_ids};
use isocat_sync::SyncMode;
use isocat_wire::time::Nanos;

/// Nothing goes wrong.
pub const NONE: &str = "none";

/// A segment and its fault.
pub struct Drawn {
    /// The segment file.
    pub text: String,
    pub cycle: Nanos,
    /// How long it operates.
    pub duration: Nanos,
    pub fault: Fault,
}

/// What goes wrong; times count from the beginning of operation.
#[derive(Clone, Debug)]
pub enum Fault {
    None,
    /// Frames damaged on a cable: which, when, how many in a row, on the way back.
    Damaged {
        cable: u64,
        at: Nanos,
        frames: u64,
        back: bool,
    },
    /// A cable cut for a time: too short for a link, or long enough.
    Cut {
        cable: u64,
        at: Nanos,
        length: Nanos,
    },
    /// A SubDevice without power for a time.
    Power {
        device: u64,
        at: Nanos,
        length: Nanos,
    },
    /// The host wakes up late, so many times, once in `every` cycles.
    Late {
        at: Nanos,
        by: Nanos,
        times: u64,
        every: u64,
    },
    /// The host does nothing for a time.
    Stall {
        at: Nanos,
        length: Nanos,
    },
    /// An oscillator changes its speed at once.
    ClockStep {
        device: u64,
        at: Nanos,
        by_ppb: i64,
    },
    /// An oscillator changes its speed slowly.
    ClockRamp {
        device: u64,
        at: Nanos,
        by_ppb: i64,
        over: Nanos,
    },
    /// The host's clock changes its speed at once.
    HostClock {
        at: Nanos,
        by_ppb: i64,
    },
    /// A cable is exchanged for a longer one.
    Exchanged {
        cable: u64,
        at: Nanos,
        metres: u64,
    },
    /// A SubDevice does something wrong from the start.
    Misbehaves(&'static str),
}

impl Fault {
    pub const fn name(&self) -> &'static str {
        match self {
            Self::None => NONE,
            Self::Damaged { .. } => "frames damaged",
            Self::Cut { .. } => "cable cut",
            Self::Power { .. } => "power lost",
            Self::Late { .. } => "frames late",
            Self::Stall { .. } => "host stalls",
            Self::ClockStep { .. } => "clock steps",
            Self::ClockRamp { .. } => "clock ramps",
            Self::HostClock { .. } => "host clock steps",
            Self::Exchanged { .. } => "cable exchanged",
            Self::Misbehaves(_) => "device misbehaves",
        }
    }
}

pub fn draw(seed: u64) -> Drawn {
    let mut chance = Chance(seed.wrapping_mul(0x2545_F491_4F6C_DD1D) ^ 0x5EED_0F15);
    let cycle = *chance.of(&[500_000u64, 1_000_000, 1_000_000, 2_000_000, 4_000_000, 10_000_000]);
    let mut text = format!("cycle = \"{cycle}ns\"\nseed = {seed}\n");
    if chance.one_in(4) {
        let _ = writeln!(text, "outputs_spread = \"{}ns\"", chance.between(5_000, 20_000));
    }
    let _ = writeln!(text, "[host]\njitter = \"{}ns\"", chance.between(0, 50_000.min(cycle / 8)));
    let count = 1 + chance.between(0, 4);
    let duration = Nanos((cycle * chance.between(150, 400)) as i64);
    let fault = fault(&mut chance, cycle, duration, count);
    let mut forks = Vec::new();
    let liar = chance.between(0, count - 1);
    for place in 0..count {
        device(&mut chance, &mut text, place, &mut forks);
        if let (Fault::Misbehaves(words), true) = (&fault, place == liar) {
            let _ = writeln!(text, "misbehave = [\"{words}\"]");
        }
    }
    Drawn { text, cycle: Nanos(cycle as i64), duration, fault }
}

/// Writes a device; `forks` are those before it that have a port free for a branch.
fn device(chance: &mut Chance, text: &mut String, place: u64, forks: &mut Vec<u64>) {
    // Terminals of an EBUS need a coupler before them.
    let copper = |id: &&str| !EBUS.iter().any(|prefix| id.starts_with(prefix));
    let ids: Vec<_> = built_in_ids().filter(copper).collect();
    let id = if chance.one_in(3) { FORK } else { *chance.of(&ids) };
    let modes: Vec<_> = built_in(id).expect("a built-in profile").modes().collect();
    let _ = writeln!(text, "[[subdevice]]\ndevice = \"{id}\"");
    // Subordinated cycles need settings of their own.
    let modes = modes.into_iter().filter(|m| *m != SyncMode::DcSubordinated);
    let (dc, others): (Vec<_>, Vec<_>) = modes.partition(|mode| mode.uses_dc());
    match (dc.is_empty(), others.is_empty()) {
        (false, _) if !chance.one_in(5) => {
            let _ = writeln!(text, "mode = \"{}\"", chance.of(&dc));
        }
        (_, false) => {
            let _ = writeln!(text, "mode = \"{}\"", chance.of(&others));
        }
        _ => {}
    }
    let _ = writeln!(text, "cable = \"{}m\"", chance.between(1, 100));
    let deviation = chance.between(0, 100) as i64 - 50;
    let _ = writeln!(text, "clock = \"{deviation}ppm\"");
    if let Some(fork) = forks.pop_if(|fork| *fork + 1 < place && chance.one_in(2)) {
        let _ = writeln!(text, "connect = \"{fork}:2\"");
    }
    if id == FORK {
        forks.push(place);
    }
}

/// It has a third port.
const FORK: &str = "model_every_mode";
const EBUS: [&str; 3] = ["beckhoff_ek", "beckhoff_ej", "beckhoff_el"];

fn fault(chance: &mut Chance, cycle: u64, duration: Nanos, devices: u64) -> Fault {
    let share =
        |chance: &mut Chance, from, to| Nanos(duration.0 * chance.between(from, to) as i64 / 100);
    let cycles = |chance: &mut Chance, from: u64, to: u64| {
        // In thousandths of a cycle.
        Nanos((cycle * chance.between(from, to) / 1_000) as i64)
    };
    let at = share(chance, 10, 70);
    let any = chance.between(0, devices - 1);
    let ppb = |chance: &mut Chance, most: u64| {
        let size = chance.between(1_000, most) as i64;
        if chance.one_in(2) { size } else { -size }
    };
    match chance.between(0, 13) {
        0..=2 => Fault::None,
        3 => {
            let (frames, back) = (chance.between(1, 5), chance.one_in(2));
            Fault::Damaged { cable: any, at, frames, back }
        }
        4 => {
            let length = match chance.one_in(2) {
                true => Nanos(chance.between(1_000, 14_000) as i64),
                false => cycles(chance, 100, 30_000),
            };
            Fault::Cut { cable: any, at, length }
        }
        5 => Fault::Power { device: any, at, length: cycles(chance, 1_000, 50_000) },
        6 | 7 => {
            let (by, times) = (cycles(chance, 5, 1_500), chance.between(1, 5));
            Fault::Late { at, by, times, every: chance.between(1, 20) }
        }
        8 => Fault::Stall { at, length: cycles(chance, 500, 40_000) },
        9 => Fault::ClockStep { device: any, at, by_ppb: ppb(chance, 2_000_000) },
        10 => {
            let over = share(chance, 5, 30);
            Fault::ClockRamp { device: any, at, by_ppb: ppb(chance, 300_000), over }
        }
        11 => Fault::HostClock { at, by_ppb: ppb(chance, 2_000_000) },
        12 => Fault::Exchanged { cable: any, at, metres: chance.between(1, 500) },
        _ => {
            let words: &[&'static str] = &[
                "missed-copy 50",
                "missed-copy 7",
                "late-copy 100us",
                "late-application 200us",
                "dead-sync0",
                "ignores-shift",
            ];
            Fault::Misbehaves(words[chance.between(0, words.len() as u64 - 1) as usize])
        }
    }
}

/// SplitMix64.
pub struct Chance(u64);

impl Chance {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        mixed ^ (mixed >> 31)
    }

    /// Both ends are possible.
    fn between(&mut self, least: u64, most: u64) -> u64 {
        least + self.next() % (most.max(least) - least + 1)
    }

    fn one_in(&mut self, count: u64) -> bool {
        self.next().is_multiple_of(count)
    }

    fn of<'a, T>(&mut self, choices: &'a [T]) -> &'a T {
        &choices[self.between(0, choices.len() as u64 - 1) as usize]
    }
}
