//! A varied parameter: a key of the segment file, and its values.

use isocat_descriptions::quantity::parse_duration;
use isocat_sim::random::Stream;
use toml::{Table, Value};

/// A key and its values.
#[derive(Clone, Debug)]
pub struct Axis {
    /// The key, as the caller wrote it.
    pub key: String,
    path: Vec<Step>,
    values: Values,
}

#[derive(Clone, Debug)]
enum Step {
    /// A key of a table.
    Key(String),
    /// One of several tables.
    At(usize),
    /// Each of several tables.
    All,
}

#[derive(Clone, Debug)]
enum Values {
    /// Each value makes a point of the grid.
    List(Vec<String>),
    /// Drawn evenly in each run and for each place: the ends in thousandths of the unit, and the
    /// unit.
    Drawn { least: i64, most: i64, unit: String },
}

impl Axis {
    pub(super) fn parse(text: &str) -> Result<Self, String> {
        let expected = "expected KEY=VALUE,VALUE or KEY=LEAST..MOST, such as host.jitter=5us,50us";
        let (key, values) =
            text.split_once('=').ok_or_else(|| format!("\"{text}\": {expected}"))?;
        let key = key.trim().to_owned();
        let path = path(&key)?;
        let values = match values.split_once("..") {
            Some((least, most)) => drawn(least.trim(), most.trim())?,
            None => Values::List(values.split(',').map(|value| value.trim().to_owned()).collect()),
        };
        match &values {
            Values::List(list) if list.iter().any(String::is_empty) => {
                Err(format!("\"{text}\" has an empty value; {expected}"))
            }
            _ => Ok(Self { key, path, values }),
        }
    }

    /// A key and a list of values.
    pub(super) fn over(key: &str, values: Vec<String>) -> Result<Self, String> {
        if values.is_empty() || values.iter().any(String::is_empty) {
            return Err(format!(
                "{key} has {}; expected one or more values",
                match values.len() {
                    0 => "no values",
                    _ => "an empty value",
                }
            ));
        }
        let key = key.trim().to_owned();
        let path = path(&key)?;
        Ok(Self { key, path, values: Values::List(values) })
    }

    /// Number of points that it adds to the grid.
    pub fn values(&self) -> u64 {
        match &self.values {
            Values::List(list) => list.len() as u64,
            Values::Drawn { .. } => 1,
        }
    }

    /// The values that make points of the grid; `None` if they are drawn.
    pub fn list(&self) -> Option<&[String]> {
        match &self.values {
            Values::List(list) => Some(list),
            Values::Drawn { .. } => None,
        }
    }

    /// Sizes of the values of a list, to sort them: durations, or numbers of one unit. `None` if
    /// they are neither.
    pub fn sizes(&self) -> Option<Vec<f64>> {
        let list = self.list()?;
        let duration = |text: &String| parse_duration(text).ok().map(|time| time.0 as f64);
        let durations: Option<Vec<f64>> = list.iter().map(duration).collect();
        durations.or_else(|| {
            let numbers: Vec<(i64, String)> =
                list.iter().map(|text| quantity(text).ok()).collect::<Option<_>>()?;
            let unit = &numbers.first()?.1;
            let same = numbers.iter().all(|(_, other)| other == unit);
            same.then(|| numbers.iter().map(|(number, _)| *number as f64).collect())
        })
    }

    /// Whether all values are whole numbers without a unit.
    pub fn is_whole(&self) -> bool {
        self.list().is_some_and(|list| list.iter().all(|text| text.parse::<i64>().is_ok()))
    }

    /// The ends of a range, in thousandths of its unit; `None` for a list.
    pub(super) fn ends(&self) -> Option<(i64, i64)> {
        match &self.values {
            Values::List(_) => None,
            Values::Drawn { least, most, .. } => Some((*least, *most)),
        }
    }

    /// The smallest step of a key within a range, in thousandths of its unit. The smallest units
    /// have whole numbers only, and so do numbers without a unit between whole ends.
    pub(super) fn step(&self) -> i64 {
        match &self.values {
            Values::Drawn { least, most, unit } => {
                let smallest = ["ns", "mm", "ppb"].contains(&unit.as_str());
                let are_whole = unit.is_empty() && least % 1_000 == 0 && most % 1_000 == 0;
                if smallest || are_whole { 1_000 } else { 1 }
            }
            Values::List(_) => 1,
        }
    }

    /// The same key with one value from its range, in thousandths of its unit.
    pub(super) fn at(&self, size: i64) -> Self {
        let unit = match &self.values {
            Values::Drawn { unit, .. } => unit.as_str(),
            Values::List(_) => "",
        };
        let values = Values::List(vec![format!("{}{unit}", thousandths(size))]);
        Self { key: self.key.clone(), path: self.path.clone(), values }
    }

    /// Writes the value into a file; returns it as rows show it.
    pub(super) fn apply(
        &self,
        table: &mut Table,
        choice: u64,
        seed: u64,
    ) -> Result<String, String> {
        let mut chance = Stream::new(seed, "sweep", fnv(&self.key));
        let mut told = String::new();
        let mut value = || {
            let text = match &self.values {
                Values::List(list) => list[choice as usize].clone(),
                Values::Drawn { least, most, unit } => {
                    let steps = (most - least).unsigned_abs() / self.step() as u64;
                    let drawn = least + chance.up_to(steps) as i64 * self.step();
                    format!("{}{unit}", thousandths(drawn))
                }
            };
            if told.is_empty() {
                told.clone_from(&text);
            }
            scalar(&text)
        };
        let (first, rest) = self.path.split_first().ok_or("no key")?;
        let Step::Key(first) = first else { return Err("no key".into()) };
        if let Some(position) = device(table, first).filter(|_| !rest.is_empty()) {
            let key = &self.key[first.len() + 1..];
            return Err(format!("{first} is a device; expected subdevice[{position}].{key}"));
        }
        set(table, first, rest, &mut value).map_err(|why| format!("{}: {why}", self.key))?;
        Ok(told)
    }
}

/// Parses a key such as `subdevice[*].cable`, `host.jitter` or `fault[0].what`.
fn path(key: &str) -> Result<Vec<Step>, String> {
    let mut path = Vec::new();
    for part in key.split('.') {
        let (name, place) = match part.split_once('[') {
            Some((name, place)) => (name, Some(place.strip_suffix(']').ok_or("a ] is missing")?)),
            None => (part, None),
        };
        if name.is_empty() {
            return Err(format!("\"{key}\" is no key such as host.jitter or subdevice[*].cable"));
        }
        path.push(Step::Key(name.to_owned()));
        match place {
            None => {}
            Some("*") => path.push(Step::All),
            Some(number) => {
                let number = number.parse().map_err(|_| {
                    format!("\"{number}\" is no place; expected a position from 0 on, or *")
                })?;
                path.push(Step::At(number));
            }
        }
    }
    Ok(path)
}

/// The position of the table `[[subdevice]]` with this name.
fn device(table: &Table, name: &str) -> Option<usize> {
    let devices = table.get("subdevice")?.as_array()?;
    devices.iter().position(|device| device.get("name").and_then(Value::as_str) == Some(name))
}

fn set(
    table: &mut Table,
    key: &str,
    rest: &[Step],
    value: &mut impl FnMut() -> Value,
) -> Result<(), String> {
    match rest {
        [] => {
            table.insert(key.to_owned(), value());
            Ok(())
        }
        [Step::Key(next), rest @ ..] => {
            let inner = table.entry(key).or_insert_with(|| Value::Table(Table::new()));
            let inner = inner.as_table_mut().ok_or_else(|| format!("{key} is no table"))?;
            set(inner, next, rest, value)
        }
        [place, rest @ ..] => {
            let array = table.get_mut(key).and_then(Value::as_array_mut);
            let array = array.ok_or_else(|| format!("there is no [[{key}]]"))?;
            let [Step::Key(next), rest @ ..] = rest else {
                return Err(format!("which key of {key} is varied?"));
            };
            let count = array.len();
            let chosen: Vec<&mut Value> = match place {
                Step::At(number) => {
                    let one = array.get_mut(*number);
                    vec![one.ok_or_else(|| format!("there are {count} of {key}, from 0"))?]
                }
                _ => array.iter_mut().collect(),
            };
            for one in chosen {
                let one = one.as_table_mut().ok_or_else(|| format!("{key} is no table"))?;
                set(one, next, rest, value)?;
            }
            Ok(())
        }
    }
}

/// A value as TOML; if it is not TOML, a string.
fn scalar(text: &str) -> Value {
    let line = format!("value = {text}");
    let parsed = line.parse::<Table>().ok().and_then(|mut table| table.remove("value"));
    parsed.unwrap_or_else(|| Value::String(text.to_owned()))
}

fn drawn(least: &str, most: &str) -> Result<Values, String> {
    let ((mut low, mut unit), (mut high, mut other)) = (quantity(least)?, quantity(most)?);
    // If the durations have two units, both are converted to the smallest one.
    if let (true, Ok(from), Ok(to)) = (unit != other, parse_duration(least), parse_duration(most)) {
        (low, high) = (from.0.saturating_mul(1_000), to.0.saturating_mul(1_000));
        (unit, other) = ("ns".to_owned(), "ns".to_owned());
    }
    if unit != other || low > high {
        return Err(format!(
            "{least}..{most} is no range; expected the smaller end first and one unit, such as 1m..100m"
        ));
    }
    Ok(Values::Drawn { least: low, most: high, unit })
}

/// A number in thousandths, and its unit.
fn quantity(text: &str) -> Result<(i64, String), String> {
    let end = text.find(|c: char| !matches!(c, '0'..='9' | '.' | '-' | '+')).unwrap_or(text.len());
    let (number, unit) = text.split_at(end);
    let number: f64 = number.parse().map_err(|_| format!("\"{text}\" is no number with a unit"))?;
    let thousandths = (number * 1_000.0).round();
    if !(-1e15..=1e15).contains(&thousandths) {
        return Err(format!("\"{text}\" is too large"));
    }
    Ok((thousandths as i64, unit.trim().to_owned()))
}

fn thousandths(number: i64) -> String {
    let text = format!("{:.3}", number as f64 / 1_000.0);
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// A hash of a name that never changes between versions.
fn fnv(text: &str) -> u64 {
    text.bytes().fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    })
}
