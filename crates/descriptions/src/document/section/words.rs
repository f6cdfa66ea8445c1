//! Descriptions of a key's values.

use isocat_wire::time::Nanos;

use super::{Key, Kind, Limit, Need, Section};
use crate::quantity::{DelayPerMetre, Length, Ppb};

impl Kind {
    /// Its values as a phrase: `duration, 10 us to 1 s`.
    pub fn words(&self) -> String {
        match self {
            Self::Duration { least, most, whole } => {
                let (least, most) = (least.words(), most.words());
                match whole {
                    1 => format!("duration, {least} to {most}"),
                    _ => format!("duration, {least} to {most}, whole {}", Nanos(*whole)),
                }
            }
            Self::Length { least, most } => {
                format!("length, {} to {}", Length(*least), Length(*most))
            }
            Self::DelayPerMetre { least, most } => {
                format!("delay, {} to {}", DelayPerMetre(*least), DelayPerMetre(*most))
            }
            Self::Rate { least, most } => format!("rate, {} to {}", Ppb(*least), Ppb(*most)),
            Self::Integer { least, most: i64::MAX } => format!("integer, {least} or more"),
            Self::Integer { least, most } => format!("integer, {least} to {most}"),
            Self::Decimal { least, most, unit } => {
                format!("number with its unit, {least} {unit} to {most} {unit}")
            }
            Self::Hex { least, most } => format!("integer, 0x{least:X} to 0x{most:X}"),
            Self::Boolean => "true or false".into(),
            Self::Name(expected) | Self::Text(expected) => format!("text: {expected}"),
            Self::Pattern { expected, .. } | Self::Command { expected, .. } => (*expected).into(),
            Self::Choice(choice) => {
                let words = choice.0.words();
                let some = words.iter().take(MOST_WORDS).map(|(word, _)| format!("\"{word}\""));
                let some = some.collect::<Vec<_>>().join(", ");
                match words.len() {
                    0..=MOST_WORDS => some,
                    many => format!("one of {many} names, such as {some}"),
                }
            }
            Self::Either(kinds) => kinds.iter().map(Self::words).collect::<Vec<_>>().join("; or "),
            Self::List(kind) => format!("list of: {}", kind.words()),
            Self::Row(row) => row.expected.into(),
            Self::Table(section) if section.head.is_empty() => "table".into(),
            Self::Table(section) => format!("table {}", section.head),
            Self::Tables(section) => format!("tables {}, any number of them", section.head),
            Self::Map { expected, values, .. } => {
                format!("table of {expected}: {}", values.words())
            }
        }
    }
}

/// Largest number of words in a phrase.
const MOST_WORDS: usize = 8;

impl Limit {
    fn words(self) -> String {
        match self {
            Self::At(number) => Nanos(number).to_string(),
            Self::From(words, _) => words.into(),
        }
    }
}

impl Need {
    /// The default of the key, as a phrase.
    pub fn words(self) -> String {
        match self {
            Self::Required(_) => "needed".into(),
            Self::Sometimes(when, _) => format!("needed {when}"),
            Self::Default(value) => format!("default {value}"),
            Self::Without(words) => format!("default: {words}"),
        }
    }
}

impl Key {
    /// A line of the file: `input_shift = "20us"`.
    pub fn line(&self) -> String {
        format!("{} = {}", self.name, self.example)
    }
}

impl Section {
    /// Its name in explanations: `[host]`, `the top level`.
    pub fn title(&self) -> &'static str {
        if self.head.is_empty() { "the top level" } else { self.head }
    }
}
