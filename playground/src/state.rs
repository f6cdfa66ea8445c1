//! The state of the page: keys with texts, as in its address line.
//!
//! Every key is described once, in [`KEYS`]; errors of values use its words.

use std::collections::BTreeMap;
use std::fmt::Write;

use isocat::document::name_hint;
use isocat::quantity::{Length, Ppb, parse_duration};
use isocat_wire::Nanos;
use serde::Serialize;

use crate::keys::{KEYS, Key, Kind, OWN};

/// An error in the page's state.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
pub struct Problem {
    /// The key; empty: the whole state.
    pub key: String,
    /// What is wrong, and what is expected.
    pub message: String,
}

/// A valid state: each key has a value of its kind.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct State(BTreeMap<&'static str, Value>);

#[derive(Clone, PartialEq, Eq, Debug)]
enum Value {
    Word(&'static str),
    Number(i64),
    Lines(String),
    Own,
}

impl State {
    /// Reads texts by key; missing keys have their defaults. Reports every error.
    pub fn read(texts: &BTreeMap<String, String>) -> Result<Self, Vec<Problem>> {
        let mut problems = Vec::new();
        for key in texts.keys() {
            // The shown cycle and device are not part of the run.
            if !KEYS.iter().any(|known| known.name == key) && !LOOKS.contains(&key.as_str()) {
                let mut message =
                    format!("unknown key \"{key}\"; expected one of the page's controls");
                let hint = name_hint(key, KEYS.iter().map(|key| key.name));
                if !hint.is_empty() {
                    let _ = write!(message, " ({hint})");
                }
                problems.push(Problem { key: key.clone(), message });
            }
        }
        let mut values = BTreeMap::new();
        for key in KEYS.iter() {
            let text = texts.get(key.name).unwrap_or(&key.default).trim();
            match key.read(text) {
                Ok(value) => {
                    values.insert(key.name, value);
                }
                Err(message) => problems.push(Problem { key: key.name.to_owned(), message }),
            }
        }
        if problems.is_empty() { Ok(Self(values)) } else { Err(problems) }
    }

    /// The word of a key with words.
    pub fn word(&self, key: &str) -> &'static str {
        match self.0.get(key) {
            Some(Value::Word(word)) => word,
            other => unreachable!("{key} is a choice, found {other:?}"),
        }
    }

    /// The lines of a key with lines, without empty ones.
    pub fn lines(&self, key: &str) -> impl Iterator<Item = &str> {
        let text = match self.0.get(key) {
            Some(Value::Lines(text)) => text.as_str(),
            _ => "",
        };
        text.lines().map(str::trim).filter(|line| !line.is_empty())
    }

    /// The number of a key in the smallest unit of its kind; `None`: no value is requested.
    pub fn number(&self, key: &str) -> Option<i64> {
        match self.0.get(key) {
            Some(Value::Number(number)) => Some(*number),
            _ => None,
        }
    }

    /// A span of time; `None`: no value is requested.
    pub fn time(&self, key: &str) -> Option<Nanos> {
        self.number(key).map(Nanos)
    }
}

/// Keys that choose what is shown, not what is run: the cycle and the device; `only=play` requests
/// only the pictures of one cycle.
pub const LOOKS: [&str; 3] = ["at", "show", "only"];

impl Key {
    fn read(&self, text: &str) -> Result<Value, String> {
        let name = self.name;
        let number = |number: i64, least: i64, most: i64, show: fn(i64) -> String| {
            if (least..=most).contains(&number) {
                Ok(Value::Number(number))
            } else {
                let (least, most, found) = (show(least), show(most), show(number));
                Err(format!("{name} = {found}; expected {least} to {most}"))
            }
        };
        match &self.kind {
            Kind::Choice { choices } => {
                let found = choices.iter().find(|(word, _)| *word == text);
                found.map(|(word, _)| Value::Word(word)).ok_or_else(|| {
                    let words: Vec<_> = choices.iter().map(|(word, _)| *word).collect();
                    format!("{name} = \"{text}\"; expected one of {}", words.join(", "))
                })
            }
            Kind::Lines { .. } => Ok(Value::Lines(text.to_owned())),
            Kind::Duration { own: Some(_), .. } if text == OWN => Ok(Value::Own),
            Kind::Duration { least, most, .. } => {
                let time = parse_duration(text).map_err(|error| format!("{name}: {error}"))?;
                number(time.0, *least, *most, |ns| Nanos(ns).to_string())
            }
            Kind::Length { least, most } => {
                let length: Length = text.parse().map_err(|error| format!("{name}: {error}"))?;
                number(length.0, *least, *most, |mm| Length(mm).to_string())
            }
            Kind::Rate { most } => {
                let rate: Ppb = text.parse().map_err(|error| format!("{name}: {error}"))?;
                number(rate.0, -most, *most, |ppb| Ppb(ppb).to_string())
            }
            Kind::Count { least, most } => {
                let count = text.parse().map_err(|_| {
                    format!("{name} = \"{text}\"; expected a whole number from {least} to {most}")
                })?;
                number(count, *least, *most, |count| count.to_string())
            }
        }
    }
}
