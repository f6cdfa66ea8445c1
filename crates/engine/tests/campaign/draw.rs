//! Segments at random, with and without faults.

use std::fmt::Write;

use isocat_engine::sweep::Sweep;
use isocat_segment::profile::{built_in, built_in_ids};
use isocat_sim::random::Stream;
use isocat_sync::SyncMode;

/// A segment file; `recovers` says whether SubDevices that leave OP are to be brought back, and
/// whether there is time for it.
pub struct Drawn {
    pub text: String,
    pub recovers: bool,
    /// Whether the counters of SubDevices are read before the run and behind it.
    pub reads: bool,
}

/// The segment of a seed. In four out of five there are faults.
pub fn draw(seed: u64) -> Drawn {
    let mut chance = Chance(Stream::new(seed, "campaign", 0));
    let (_, recovers, text) = segment(seed, &mut chance);
    let is_harmed = !chance.one_in(5);
    let sweep = Sweep::new("random.toml", &text).map(|mut sweep| {
        sweep.seeds(seed, 1);
        if is_harmed {
            sweep.swarm();
        }
        sweep
    });
    // What a file cannot express is refused when it is run.
    let case = sweep.ok().and_then(|sweep| sweep.case(0).ok());
    Drawn { text: case.map_or(text, |case| case.text), recovers, reads: true }
}

/// The segment of a seed in which nothing happens but that the frames of one cycle leave late, by
/// this share of the cycle in percent.
pub fn held_up(seed: u64, percent: u64) -> Drawn {
    let mut chance = Chance(Stream::new(seed, "held up", percent));
    let (cycle, recovers, mut text) = segment(seed, &mut chance);
    let at = cycle * chance.between(20, 120) + chance.between(0, cycle);
    let late = cycle * percent / 100;
    let _ = writeln!(
        text,
        "[[fault]]\nat = \"in-operation + {at}ns\"\nwhat = \"slow-send {late}ns for {cycle}ns\""
    );
    Drawn { text, recovers, reads: true }
}

/// A segment without faults: its cycle in ns, whether SubDevices that leave OP are to be brought
/// back, and its file.
fn segment(seed: u64, chance: &mut Chance) -> (u64, bool, String) {
    let cycle = *chance.of(&[500_000, 1_000_000, 1_000_000, 2_000_000, 4_000_000, 10_000_000]);
    let recovers = chance.one_in(4);
    let mut text = format!("cycle = \"{cycle}ns\"\nseed = {seed}\n");
    let length = cycle * chance.between(150, 400);
    let _ = writeln!(text, "for = \"{length}ns\"");
    if recovers {
        text.push_str("recovery = { first = \"20ms\", longest = \"200ms\" }\n");
    }
    if chance.one_in(4) {
        let _ = writeln!(text, "outputs_spread = \"{}ns\"", chance.between(5_000, 20_000));
    }
    let _ = writeln!(text, "[host]\njitter = \"{}ns\"", chance.between(0, 50_000.min(cycle / 8)));
    let mut forks = Vec::new();
    for place in 0..chance.between(1, 5) {
        device(chance, &mut text, place, &mut forks);
    }
    (cycle, recovers, text)
}

/// Writes a device; `forks` are the devices before it with a free port for a branch.
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

/// This device has a third port.
const FORK: &str = "model_every_mode";
const EBUS: [&str; 3] = ["beckhoff_ek", "beckhoff_ej", "beckhoff_el"];

struct Chance(Stream);

impl Chance {
    /// A random number between both ends, inclusive.
    fn between(&mut self, least: u64, most: u64) -> u64 {
        least + self.0.up_to(most.max(least) - least)
    }

    fn one_in(&mut self, count: u64) -> bool {
        self.0.up_to(count - 1) == 0
    }

    fn of<'a, T>(&mut self, choices: &'a [T]) -> &'a T {
        &choices[self.between(0, choices.len() as u64 - 1) as usize]
    }
}
