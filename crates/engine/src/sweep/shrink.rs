//! Reduces a run that fails to as few faults, devices and keys, and to as little time and as small
//! numbers as still fail the same way.

use std::ops::Range;

use isocat_descriptions::quantity::parse_duration;
use isocat_wire::time::Nanos;
use toml::{Table, Value};

/// Largest number of tries.
const MOST_TRIES: usize = 400;

/// The ways to reduce, in this order: those with the largest effect first. Each gives files that
/// are a little smaller, the most promising ones first.
const WAYS: [fn(&Table) -> Vec<Table>; 5] =
    [fewer_faults, fewer_devices, less_time, fewer_keys, smaller_numbers];

/// The smallest file found for which `fails_alike` holds, as it does for `text`.
pub fn shrink(text: &str, mut fails_alike: impl FnMut(&str) -> bool) -> String {
    let Ok(mut best) = text.parse::<Table>() else { return text.to_owned() };
    let mut tries = 0;
    loop {
        let mut is_smaller = false;
        for way in WAYS {
            while let Some(smaller) = way(&best).into_iter().find(|candidate| {
                tries += 1;
                tries <= MOST_TRIES && fails_alike(&candidate.to_string())
            }) {
                (best, is_smaller) = (smaller, true);
            }
        }
        // One way may open another: a device can be removed once no fault names it.
        if !is_smaller || tries > MOST_TRIES {
            return best.to_string();
        }
    }
}

/// Files with half of the faults, then files without one.
fn fewer_faults(table: &Table) -> Vec<Table> {
    let count = count(table, "fault");
    let mut all = Vec::new();
    if count >= 4 {
        all.push(without(table, "fault", 0..count / 2));
        all.push(without(table, "fault", count / 2..count));
    }
    all.extend((0..count).rev().map(|one| without(table, "fault", one..one + 1)));
    all
}

/// Files with half of the devices, then files without one; at least one stays. Faults still name
/// the same device.
fn fewer_devices(table: &Table) -> Vec<Table> {
    let count = count(table, "subdevice");
    let mut all = Vec::new();
    if count >= 4 {
        all.push(without_devices(table, count / 2..count));
        all.push(without_devices(table, 0..count / 2));
    }
    if count > 1 {
        all.extend((0..count).rev().map(|one| without_devices(table, one..one + 1)));
    }
    all
}

/// Files with a shorter run of whole cycles.
fn less_time(table: &Table) -> Vec<Table> {
    let time =
        |key: &str| table.get(key).and_then(Value::as_str).and_then(|t| parse_duration(t).ok());
    let (Some(duration), Some(cycle)) = (time("for"), time("cycle")) else { return Vec::new() };
    let (duration, cycle) = (duration.0, cycle.0.max(1));
    let shorter = [round(duration / 2), duration / 4 * 3, duration / 8 * 7, round(duration)];
    let shorter = shorter.map(|time| time / cycle * cycle);
    let fits = |time: &i64| *time >= 10 * cycle && *time < duration;
    shorter
        .into_iter()
        .filter(fits)
        .map(|time| {
            let mut table = table.clone();
            table.insert("for".into(), Value::String(duration_text(time)));
            table
        })
        .collect()
}

/// Files without one key of the root, of the host, of a device or of a fault, and without one of
/// several expectations. If the file needs the key, its reader refuses it, and a refused file fails
/// differently.
fn fewer_keys(table: &Table) -> Vec<Table> {
    const KEPT: [&str; 5] = ["cycle", "for", "seed", "device", "esi"];
    let mut all = Vec::new();
    let expectations = count(table, "expect");
    if expectations > 1 {
        all.extend((0..expectations).rev().map(|one| without(table, "expect", one..one + 1)));
    }
    for (key, value) in table {
        match value {
            _ if KEPT.contains(&key.as_str()) || key == "expect" => {}
            Value::Table(inner) => {
                all.push(with(table, |table| {
                    table.remove(key);
                }));
                all.extend(inner.keys().map(|own| {
                    with(table, |table| {
                        let inner = table.get_mut(key).and_then(Value::as_table_mut);
                        inner.and_then(|inner| inner.remove(own));
                    })
                }));
            }
            Value::Array(items) if items.iter().all(Value::is_table) => {
                for (place, item) in items.iter().enumerate() {
                    let keys = item.as_table().into_iter().flat_map(Table::keys);
                    let keys = keys.filter(|own| !KEPT.contains(&own.as_str()));
                    all.extend(keys.map(|own| {
                        with(table, |table| {
                            if let Some(item) = item_mut(table, key, place) {
                                item.remove(own);
                            }
                        })
                    }));
                }
            }
            _ => all.push(with(table, |table| {
                table.remove(key);
            })),
        }
    }
    all
}

/// Files with faults that come earlier, last shorter, are fewer or weaker: each number of a fault
/// is halved, then rounded.
fn smaller_numbers(table: &Table) -> Vec<Table> {
    let mut all = Vec::new();
    for fault in 0..count(table, "fault") {
        for key in ["at", "what", "within", "every"] {
            let Some(text) = text_of(table, "fault", fault, key) else { continue };
            let words: Vec<&str> = text.split(' ').collect();
            let device = if key == "what" { device_word(&words) } else { None };
            // Without "+ 50ms", at once.
            if let ("at", [base, "+", _]) = (key, &words[..]) {
                all.push(with(table, |table| {
                    if let Some(item) = item_mut(table, "fault", fault) {
                        item.insert(key.to_owned(), Value::String((*base).to_owned()));
                    }
                }));
            }
            for place in (0..words.len()).filter(|place| Some(*place) != device) {
                for smaller in smaller(words[place]) {
                    let mut words = words.clone();
                    words[place] = &smaller;
                    all.push(with(table, |table| {
                        if let Some(item) = item_mut(table, "fault", fault) {
                            item.insert(key.to_owned(), Value::String(words.join(" ")));
                        }
                    }));
                }
            }
        }
    }
    all
}

/// Smaller numbers of the same unit: half of it, then itself, each rounded down to 1, 2 or 5 and
/// zeros.
fn smaller(word: &str) -> Vec<String> {
    let (sign, rest) = match word.strip_prefix(['+', '-']) {
        Some(rest) if !rest.is_empty() => word.split_at(word.len() - rest.len()),
        _ => ("", word),
    };
    if !rest.starts_with(|c: char| c.is_ascii_digit()) {
        return Vec::new();
    }
    let unit = rest.trim_start_matches(|c: char| c.is_ascii_digit());
    let number: Option<i64> = rest[..rest.len() - unit.len()].parse().ok();
    let rounded = |number: i64| {
        let all = [round(number / 2), round(number)];
        all.into_iter().filter(move |smaller| *smaller > 0 && *smaller < number)
    };
    match (unit, number) {
        ("" | "ppm" | "%", Some(number)) => {
            rounded(number).map(|smaller| format!("{sign}{smaller}{unit}")).collect()
        }
        _ => match parse_duration(rest) {
            Ok(Nanos(time)) => {
                rounded(time).map(|time| format!("{sign}{}", duration_text(time))).collect()
            }
            Err(_) => Vec::new(),
        },
    }
}

/// The largest number of the form 1, 2 or 5 and zeros that is not larger.
fn round(number: i64) -> i64 {
    let mut power = 1;
    while power <= number / 10 {
        power *= 10;
    }
    [5, 2, 1].into_iter().map(|first| first * power).find(|round| *round <= number).unwrap_or(0)
}

fn duration_text(ns: i64) -> String {
    let units = [(1_000_000_000, "s"), (1_000_000, "ms"), (1_000, "us")];
    let unit = units.into_iter().find(|(unit, _)| ns % unit == 0);
    unit.map_or(format!("{ns}ns"), |(unit, name)| format!("{}{name}", ns / unit))
}

/// First words of faults that are followed by their SubDevice.
const ABOUT_A_DEVICE: [&str; 14] = [
    "pull",
    "plug",
    "break",
    "flap",
    "power-off",
    "power-on",
    "power-cycle",
    "replace",
    "dead-eeprom",
    "clock",
    "clock-walk",
    "misbehave",
    "stuck-mailbox",
    "sync-off",
];

/// The index of the word that names a SubDevice by its position.
fn device_word(words: &[&str]) -> Option<usize> {
    let place = match words.first()? {
        first if ABOUT_A_DEVICE.contains(first) || *first == "al-error" => 1,
        _ => words.iter().position(|word| *word == "at")? + 1,
    };
    words.get(place).filter(|word| word.parse::<usize>().is_ok()).map(|_| place)
}

/// Removes devices, and reduces the positions of those behind them.
fn without_devices(table: &Table, places: Range<usize>) -> Table {
    let mut smaller = without(table, "subdevice", places.clone());
    for fault in 0..count(table, "fault") {
        let Some(text) = text_of(table, "fault", fault, "what") else { continue };
        let mut words: Vec<String> = text.split(' ').map(str::to_owned).collect();
        let plain: Vec<&str> = words.iter().map(String::as_str).collect();
        let Some(place) = device_word(&plain) else { continue };
        let Ok(position) = words[place].parse::<usize>() else { continue };
        if position >= places.end {
            words[place] = (position - places.len()).to_string();
            if let Some(item) = item_mut(&mut smaller, "fault", fault) {
                item.insert("what".into(), Value::String(words.join(" ")));
            }
        }
    }
    smaller
}

fn count(table: &Table, key: &str) -> usize {
    table.get(key).and_then(Value::as_array).map_or(0, Vec::len)
}

fn text_of<'t>(table: &'t Table, array: &str, place: usize, key: &str) -> Option<&'t str> {
    table.get(array)?.as_array()?.get(place)?.get(key)?.as_str()
}

fn item_mut<'t>(table: &'t mut Table, array: &str, place: usize) -> Option<&'t mut Table> {
    table.get_mut(array)?.as_array_mut()?.get_mut(place)?.as_table_mut()
}

fn with(table: &Table, change: impl FnOnce(&mut Table)) -> Table {
    let mut table = table.clone();
    change(&mut table);
    table
}

fn without(table: &Table, key: &str, places: Range<usize>) -> Table {
    with(table, |table| {
        if let Some(array) = table.get_mut(key).and_then(Value::as_array_mut) {
            array.drain(places);
            if array.is_empty() {
                table.remove(key);
            }
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_become_smaller_and_round() {
        assert_eq!([0, 1, 3, 9, 10, 49, 50, 217].map(round), [0, 1, 2, 5, 10, 20, 50, 200]);
        assert_eq!(smaller("217500000ns"), ["100ms", "200ms"]);
        assert_eq!(smaller("+7ppm"), ["+2ppm", "+5ppm"]);
        assert_eq!(smaller("1"), [""; 0]);
        assert_eq!(smaller("0x8123"), [""; 0]);
        assert_eq!(smaller("in-operation"), [""; 0]);
        assert_eq!(smaller("+"), [""; 0]);
    }

    #[test]
    fn faults_go_on_meaning_their_device() {
        let text = "[[subdevice]]\ndevice = \"a\"\n[[subdevice]]\ndevice = \"b\"\n[[subdevice]]\ndevice = \"c\"\n\
                    [[fault]]\nwhat = \"pull 2 for 1ms\"\n[[fault]]\nwhat = \"drop 2 at 2\"\n\
                    [[fault]]\nwhat = \"pull 0 for 1ms\"\n[[fault]]\nwhat = \"clock host +2ppm\"";
        let smaller = without_devices(&text.parse().unwrap(), 1..2);
        let what = |place| text_of(&smaller, "fault", place, "what").unwrap();
        assert_eq!(
            [what(0), what(1), what(2), what(3)],
            ["pull 1 for 1ms", "drop 2 at 1", "pull 0 for 1ms", "clock host +2ppm"]
        );
    }
}
