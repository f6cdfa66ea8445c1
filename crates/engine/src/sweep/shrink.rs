//! A run that fails, made small: as few faults, devices and as little time as still fail the same way.

use isocat_descriptions::quantity::parse_duration;
use toml::{Table, Value};

/// Tries of one shrinking.
const MOST_TRIES: usize = 300;

/// The smallest file that was found for which `fails_alike` holds, as it does for `text`.
pub fn shrink(text: &str, mut fails_alike: impl FnMut(&str) -> bool) -> String {
    let Ok(mut best) = text.parse::<Table>() else { return text.to_owned() };
    let mut tries = 0;
    loop {
        let smaller = candidates(&best).into_iter().find(|candidate| {
            tries += 1;
            tries <= MOST_TRIES && fails_alike(&candidate.to_string())
        });
        match smaller {
            Some(smaller) => best = smaller,
            None => return best.to_string(),
        }
    }
}

/// Files that are a little smaller, the most promising ones first.
fn candidates(table: &Table) -> Vec<Table> {
    let mut all = Vec::new();
    // Half of the faults, each half; then each alone; devices from the end of the line.
    for key in ["fault", "subdevice"] {
        let count = table.get(key).and_then(Value::as_array).map_or(0, Vec::len);
        if count >= 4 {
            all.push(without(table, key, 0..count / 2));
            all.push(without(table, key, count / 2..count));
        }
        let least = usize::from(key == "subdevice");
        if count > least {
            all.extend((0..count).rev().map(|one| without(table, key, one..one + 1)));
        }
    }
    let duration =
        table.get("for").and_then(Value::as_str).and_then(|text| parse_duration(text).ok());
    let cycle =
        table.get("cycle").and_then(Value::as_str).and_then(|text| parse_duration(text).ok());
    if let (Some(duration), Some(cycle)) = (duration, cycle) {
        for shorter in [duration.0 / 2, duration.0 / 4 * 3] {
            // Whole cycles are read more easily.
            let shorter = shorter / cycle.0.max(1) * cycle.0.max(1);
            if shorter >= 10 * cycle.0 && shorter < duration.0 {
                let mut table = table.clone();
                table.insert("for".into(), Value::String(format!("{shorter}ns")));
                all.push(table);
            }
        }
    }
    all
}

fn without(table: &Table, key: &str, places: std::ops::Range<usize>) -> Table {
    let mut table = table.clone();
    if let Some(array) = table.get_mut(key).and_then(Value::as_array_mut) {
        array.drain(places);
        if array.is_empty() {
            table.remove(key);
        }
    }
    table
}
