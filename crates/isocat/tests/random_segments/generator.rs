//! Random segments as files: a number gives always the same one.

use std::fmt::Write;

use isocat_sync::SyncMode;

use crate::profile::{built_in, built_in_ids};

/// A segment, and whether its devices do what they state.
pub struct Drawn {
    /// The file.
    pub text: String,
    /// No device needs longer than it states.
    pub honest: bool,
}

/// Draws the segment with this number.
pub fn draw(number: u64) -> Drawn {
    let mut chance = Chance::new(number.wrapping_mul(0x2545_F491_4F6C_DD1D) ^ 0x1571_5CAF);
    let cycle = *chance.of(&CYCLES_NS);
    let mut text = format!("cycle = \"{cycle}ns\"\nseed = {number}\n");
    if chance.one_in(4) {
        let _ = writeln!(text, "outputs_spread = \"{}ns\"", chance.between(1_000, 20_000));
    }
    if chance.one_in(6) {
        let _ = writeln!(text, "shift = \"{}ns\"", chance.between(0, cycle - 1) / 10 * 10);
    }
    let most_jitter = (100_000).min(cycle / 4);
    let _ = writeln!(text, "[host]\njitter = \"{}ns\"", chance.between(0, most_jitter));
    let count = 1 + chance.between(0, 3) * chance.between(0, 2);
    let mut drawn = Drawn { text, honest: true };
    for place in 0..count {
        device(&mut chance, &mut drawn, cycle, place);
    }
    drawn
}

fn device(chance: &mut Chance, drawn: &mut Drawn, bus: u64, place: u64) {
    let ids: Vec<_> = built_in_ids().collect();
    // The one that has every mode in every second place.
    let id = if chance.one_in(2) { "model_every_mode" } else { *chance.of(&ids) };
    let profile = built_in(id).expect("a built-in profile");
    let modes: Vec<_> = profile.modes().collect();
    let text = &mut drawn.text;
    let _ = writeln!(text, "[[subdevice]]\ndevice = \"{id}\"");
    let mode = (!modes.is_empty() && !chance.one_in(8)).then(|| *chance.of(&modes));
    if let Some(mode) = mode {
        let _ = writeln!(text, "mode = \"{mode}\"");
    }
    let mut key = |name: &str, value: u64, unit: &str| {
        let _ = writeln!(text, "{name} = \"{value}{unit}\"");
    };
    key("cable", chance.between(1, 100), "m");
    let mut cycle = bus;
    if mode != Some(SyncMode::DcSubordinated) && chance.one_in(6) {
        cycle = bus * chance.between(2, 5);
        key("cycle", cycle, "ns");
    }
    let shifts = &profile.description.behaviour;
    if shifts.shift_outputs && chance.one_in(3) {
        key("shift", chance.between(1, bus * 7 / 10), "ns");
    }
    if shifts.shift_inputs && chance.one_in(3) {
        key("input_shift", chance.between(1, bus * 7 / 10), "ns");
    }
    let sync1 = [Some(SyncMode::DcShiftSync1), Some(SyncMode::DcSync1)].contains(&mode);
    if sync1 && chance.one_in(2) {
        key("sync1", chance.between(1, cycle.min(bus) / 10 - 1) * 10, "ns");
    }
    if mode == Some(SyncMode::DcSubordinated) {
        key("sync0_cycle", bus / *chance.of(&[2, 4, 5]), "ns");
    }
    if chance.one_in(5) {
        key("jitter", chance.between(0, 3_000), "ns");
    }
    if id == "model_every_mode" && chance.one_in(4) {
        let (stated, needed, honest) = restated(chance);
        key("calc_copy", stated, "ns");
        key("copy_time", needed, "ns");
        drawn.honest &= honest;
    }
    // Few clocks are as bad as 300 ppm.
    let ppm = if chance.one_in(8) { 300 } else { 100 };
    let deviation = chance.between(0, 2 * ppm * 10) as i64 - ppm as i64 * 10;
    let text = &mut drawn.text;
    let _ = writeln!(text, "clock = \"{}.{}ppm\"", deviation / 10, (deviation % 10).abs());
    if place > 1 && chance.one_in(4) {
        let (upstream, port) = (chance.between(0, place - 2), chance.between(1, 3));
        let _ = writeln!(text, "connect = \"{upstream}:{port}\"");
    }
}

/// Another calc and copy time of outputs, stated and needed, and whether the device then does what
/// it states: its minimum cycle of 60 us holds the application's 7 us, 12 us for the inputs and up
/// to 3 us of jitter besides.
fn restated(chance: &mut Chance) -> (u64, u64, bool) {
    let needed = chance.between(1_000, 38_000);
    match chance.between(0, 5) {
        0 => (needed, needed * 2, false),
        1 => (59_000, chance.between(42_000, 59_000), false),
        // Above the minimum cycle, which contradicts it then.
        2 | 3 => {
            let stated = chance.between(60_001, 120_000);
            (stated, chance.between(1_000, stated), true)
        }
        _ => (chance.between(needed, 60_000), needed, true),
    }
}

/// Usual bus cycles.
const CYCLES_NS: [u64; 10] = [
    125_000, 250_000, 500_000, 1_000_000, 1_000_000, 2_000_000, 4_000_000, 5_000_000, 10_000_000,
    20_000_000,
];

/// SplitMix64.
pub struct Chance(u64);

impl Chance {
    /// A number gives always the same one.
    pub fn new(number: u64) -> Self {
        Self(number)
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        mixed ^ (mixed >> 31)
    }

    /// Both ends are possible.
    pub fn between(&mut self, least: u64, most: u64) -> u64 {
        least + self.next() % (most.max(least) - least + 1)
    }

    /// True once in this number of draws, on average.
    pub fn one_in(&mut self, count: u64) -> bool {
        self.next().is_multiple_of(count)
    }

    fn of<'a, T>(&mut self, choices: &'a [T]) -> &'a T {
        &choices[self.between(0, choices.len() as u64 - 1) as usize]
    }
}
