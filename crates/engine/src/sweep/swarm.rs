//! Faults that a run draws for itself: which kinds, how many, when, how bad.

use isocat_descriptions::quantity::parse_duration;
use isocat_sim::random::Stream;
use toml::{Table, Value};

/// Adds 1 to 4 faults to a file. Each run has a few kinds of its own: faults that always come together hide what each of
/// them does.
pub(super) fn draw(table: &mut Table, seed: u64) {
    let mut chance = Chance(Stream::new(seed, "swarm", 0));
    let duration =
        table.get("for").and_then(Value::as_str).and_then(|text| parse_duration(text).ok());
    let cycle =
        table.get("cycle").and_then(Value::as_str).and_then(|text| parse_duration(text).ok());
    let duration = duration.map_or(10_000_000_000, |duration| duration.0);
    let cycle = cycle.map_or(1_000_000, |cycle| cycle.0);
    let devices = devices(table);
    let is_ring = table.get("ring").is_some_and(|ring| ring.as_bool() != Some(false));
    let count = 1 + chance.below(4);
    let mut faults = Vec::new();
    for _ in 0..count {
        let at = duration / 1_000 * (50 + chance.below(600)) as i64;
        let mut fault = Table::new();
        fault.insert("at".into(), Value::String(format!("in-operation + {at}ns")));
        fault.insert(
            "what".into(),
            Value::String(what(&mut chance, (devices, is_ring), duration, cycle)),
        );
        faults.push(Value::Table(fault));
    }
    match table.entry("fault").or_insert_with(|| Value::Array(Vec::new())) {
        Value::Array(known) => known.extend(faults),
        other => *other = Value::Array(faults),
    }
}

/// How many devices the file has.
fn devices(table: &Table) -> u64 {
    let tables = table.get("subdevice").and_then(Value::as_array);
    let count = |value: &Value| value.get("count").and_then(Value::as_integer).unwrap_or(1);
    tables.map_or(1, |tables| tables.iter().map(count).sum::<i64>().max(1) as u64)
}

/// A line.
fn what(chance: &mut Chance, (devices, is_ring): (u64, bool), duration: i64, cycle: i64) -> String {
    let device = chance.below(devices);
    let cable = match is_ring && chance.below(devices + 1) == devices {
        true => "ring".to_owned(),
        false => device.to_string(),
    };
    let span = |chance: &mut Chance, from: u64, to: u64| {
        // In thousandths of the run, and not below a millisecond.
        (duration / 1_000 * (from + chance.below(to - from)) as i64).max(1_000_000)
    };
    let cycles = |chance: &mut Chance, from: u64, to: u64| {
        (cycle / 1_000 * (from + chance.below(to - from)) as i64).max(10_000)
    };
    let ppm = |chance: &mut Chance, most: u64| {
        let size = 1 + chance.below(most);
        if chance.below(2) == 0 { format!("+{size}ppm") } else { format!("-{size}ppm") }
    };
    match chance.below(16) {
        0 => format!("drop {}", 1 + chance.below(5)),
        1 => format!("drop {} at {cable}", 1 + chance.below(5)),
        2 => format!(
            "loss {}% burst {} for {}ns",
            1 + chance.below(30),
            1 + chance.below(4),
            span(chance, 5, 200)
        ),
        3 => format!("damage {} at {cable}", 1 + chance.below(5)),
        4 => format!("delay 0 {}ns for {}ns", cycles(chance, 10, 1_500), span(chance, 5, 200)),
        5 => format!("double {}", 1 + chance.below(10)),
        6 => format!("pull {cable} for {}ns", span(chance, 1, 200)),
        7 => {
            let way = if chance.below(2) == 0 { "out" } else { "back" };
            format!("break {cable} {way} for {}ns", span(chance, 1, 200))
        }
        8 => format!("power-cycle {device} {}ns", span(chance, 1, 200)),
        9 => format!("clock {device} {} over {}ns", ppm(chance, 100), span(chance, 5, 200)),
        10 => format!("clock {device} {}", ppm(chance, 200)),
        11 => format!("clock host {}", ppm(chance, 200)),
        12 => format!("stall {}ns", cycles(chance, 500, 40_000)),
        13 => format!(
            "late-wake-ups 0 {}ns 20% for {}ns",
            cycles(chance, 10, 1_500),
            span(chance, 5, 200)
        ),
        14 => format!("sync-off {device} for {}ns", span(chance, 1, 50)),
        _ => format!("al-error {device} 0x8{:03X}", chance.below(0x1000)),
    }
}

struct Chance(Stream);

impl Chance {
    fn below(&mut self, count: u64) -> u64 {
        self.0.up_to(count.max(1) - 1)
    }
}
