//! TOML files with a place for every error: tables and values that know their place.

use std::fmt;
use std::ops::{Deref, RangeInclusive};
use std::sync::LazyLock;

use isocat_wire::time::Nanos;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use crate::limits;
use crate::quantity::{DelayPerMetre, Length, Ppb, QuantityError, parse_duration};

pub mod section;

use section::Word;

/// An error in a file, with its place. It prints in one line, or two with a hint. Its parts are
/// those of [`Wrong`].
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct FileError(Box<Wrong>);

/// The parts of a [`FileError`], which stores them on the heap because each step of a reader passes
/// errors on.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Wrong {
    /// The file, as the user named it.
    pub path: String,
    /// Line, from 1; 0 if the file could not be read at all.
    pub line: usize,
    /// Column in characters, from 1; 0 if the file could not be read at all.
    pub column: usize,
    /// The problem and the expected value.
    pub message: String,
    /// The name that was probably meant, or the existing names.
    pub hint: Option<String>,
}

impl FileError {
    /// The error with these parts.
    pub fn new(wrong: Wrong) -> Self {
        Self(Box::new(wrong))
    }

    /// The error that the file could not be read.
    pub fn unreadable(path: &str, reason: &std::io::Error) -> Self {
        let message = format!("can't be read: {reason}");
        Self::new(Wrong { path: path.to_owned(), line: 0, column: 0, message, hint: None })
    }

    /// Adds a hint.
    pub fn with_hint(mut self, hint: impl Into<String>) -> Self {
        self.0.hint = Some(hint.into());
        self
    }
}

impl Deref for FileError {
    type Target = Wrong;

    fn deref(&self) -> &Wrong {
        &self.0
    }
}

impl fmt::Display for FileError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Wrong { path, line, column, message, hint } = &**self;
        match line {
            0 => write!(f, "{path}: {message}")?,
            _ => write!(f, "{path}:{line}:{column}: {message}")?,
        }
        match hint {
            Some(hint) => write!(f, "\n  {hint}"),
            None => Ok(()),
        }
    }
}

impl std::error::Error for FileError {}

/// A hint for `unknown` among `known`: the nearest name if there is one, then all of them, or some
/// if there are many.
pub fn name_hint<'k>(unknown: &str, known: impl IntoIterator<Item = &'k str>) -> String {
    hint_among(unknown, &known.into_iter().collect::<Vec<_>>())
}

fn hint_among(unknown: &str, known: &[&str]) -> String {
    let all = match known.len() {
        0..=MOST_NAMES => format!("expected one of: {}", known.join(", ")),
        count => {
            format!("expected one of {count}, such as: {}", known[..SOME_NAMES].join(", "))
        }
    };
    match nearest(unknown, known) {
        Some(near) => format!("did you mean \"{near}\"? {all}"),
        None => all,
    }
}

/// Largest number of names that a hint lists completely.
const MOST_NAMES: usize = 32;
/// Number of names that a hint lists otherwise.
const SOME_NAMES: usize = 5;

/// The name that `unknown` was probably meant to be: one that contains it, or one a few typing
/// errors away (a third of its letters).
pub fn nearest<'k>(unknown: &str, known: &[&'k str]) -> Option<&'k str> {
    if unknown.len() > limits::NAME {
        return None;
    }
    let unknown = unknown.to_lowercase();
    let contains = |name: &&&str| unknown.len() >= 3 && name.to_lowercase().contains(&unknown);
    let distance = |name: &str| strsim::damerau_levenshtein(&name.to_lowercase(), &unknown);
    known.iter().find(contains).copied().or_else(|| {
        let near = known.iter().copied().min_by_key(|name| distance(name))?;
        (distance(near) <= unknown.chars().count() / 3 + 1).then_some(near)
    })
}

/// A file's text with its name in errors.
#[derive(Clone, Copy, Debug)]
pub struct Source<'a> {
    /// Name in errors.
    pub path: &'a str,
    /// Content.
    pub text: &'a str,
}

/// A place in a file.
#[derive(Clone, PartialEq, Eq, Hash, Debug)]
pub struct FilePlace {
    /// The file, as the user named it.
    pub path: String,
    /// Line, from 1.
    pub line: usize,
    /// Column in characters, from 1.
    pub column: usize,
}

impl FilePlace {
    /// An error at this place.
    pub fn error(&self, message: impl Into<String>) -> FileError {
        let Self { path, line, column } = self.clone();
        let message = limits::cut(&message.into(), limits::MESSAGE);
        FileError::new(Wrong { path, line, column, message, hint: None })
    }
}

impl<'a> Source<'a> {
    /// The place of the byte `at`.
    pub fn place(&self, at: usize) -> FilePlace {
        let before = self.text.get(..at).unwrap_or(self.text);
        let line_start = before.rfind('\n').map_or(0, |newline| newline + 1);
        FilePlace {
            path: self.path.to_owned(),
            line: before.matches('\n').count() + 1,
            column: before[line_start..].chars().count() + 1,
        }
    }

    /// An error at the byte `at`.
    pub fn error(&self, at: usize, message: impl Into<String>) -> FileError {
        self.place(at).error(message)
    }

    /// A hint if the text is XML.
    fn xml_hint(&self) -> Option<String> {
        let text = self.text.trim_start_matches('\u{feff}').trim_start();
        let path = self.path;
        text.starts_with('<').then(|| match text.contains("<EtherCATConfig") {
            true => format!("for an ENI: isocat eni {path}"),
            false => format!(
                "for a maker's description (ESI): isocat devices {path} lists it, and esi = \"{path}\" with a \
                 type names a device of it in a segment file"
            ),
        })
    }

    /// The document, or the place where it is not TOML.
    pub fn parse(&self) -> Result<Spanned<DeTable<'a>>, FileError> {
        limits::check(self.path, self.text.len(), limits::TOML)?;
        DeTable::parse(self.text).map_err(|error| {
            if let Some(hint) = self.xml_hint() {
                return self.error(0, "this is XML; expected TOML").with_hint(hint);
            }
            let at = error.span().map_or(self.text.len(), |span| span.start);
            self.error(at, format!("not valid TOML: {}", error.message().trim_end()))
        })
    }
}

/// A table and its name in messages.
#[derive(Clone, Copy, Debug)]
pub struct Table<'a> {
    source: Source<'a>,
    entries: &'a DeTable<'a>,
    name: &'a str,
    /// Byte offset of its begin.
    pub at: usize,
}

impl<'a> Table<'a> {
    /// The whole document.
    pub fn root(source: Source<'a>, document: &'a Spanned<DeTable<'a>>) -> Self {
        Self { source, entries: document.get_ref(), name: "the top level", at: 0 }
    }

    /// A table without keys, at the place of this one.
    fn empty(&self, name: &'a str) -> Self {
        static EMPTY: LazyLock<DeTable<'static>> = LazyLock::new(DeTable::new);
        Self { entries: &EMPTY, name, ..*self }
    }

    /// Refuses keys that are not in `known`.
    pub fn allow(&self, known: &[&str]) -> Result<(), FileError> {
        let unknown = self
            .entries
            .keys()
            .filter(|key| !known.contains(&key.get_ref().as_ref()))
            .min_by_key(|key| key.span().start);
        match unknown {
            None => Ok(()),
            Some(key) => Err(self
                .source
                .error(
                    key.span().start,
                    format!("unknown key \"{}\" in {}", key.get_ref(), self.name),
                )
                .with_hint(name_hint(key.get_ref(), known.iter().copied()))),
        }
    }

    /// The value of a key.
    pub fn value(&self, key: &'a str) -> Option<Value<'a>> {
        let value = self.entries.get(key)?;
        Some(Value { source: self.source, name: key, value })
    }

    /// The value of a required key; `expected` describes it in the error.
    pub fn required(&self, key: &'a str, expected: &str) -> Result<Value<'a>, FileError> {
        self.value(key).ok_or_else(|| self.lacks(key, expected))
    }

    /// The error that a key is missing.
    pub fn lacks(&self, key: &str, expected: &str) -> FileError {
        self.error(format!("{} lacks the key \"{key}\"; expected {expected}", self.name))
    }

    /// All keys with their values, in the order of the file.
    pub fn values(&self) -> Vec<(&'a str, Value<'a>)> {
        let mut all: Vec<_> = self
            .entries
            .iter()
            .map(|(key, value)| {
                let name: &'a str = key.get_ref().as_ref();
                (name, Value { source: self.source, name, value })
            })
            .collect();
        all.sort_by_cached_key(|(_, value)| value.at() as u64);
        all
    }

    /// The tables of an array of tables `[[key]]`; none if it is absent.
    pub fn tables(&self, key: &'a str) -> Result<Vec<Table<'a>>, FileError> {
        match self.value(key) {
            None => Ok(Vec::new()),
            Some(value) => value.array("tables")?.iter().map(Value::table).collect(),
        }
    }

    /// The value of a key of this table or of one below it (`esc.chip`) as written in the file; for
    /// a long one, its size.
    pub fn lookup(&self, path: &str) -> Option<String> {
        let mut entries = self.entries;
        let mut keys = path.split('.').peekable();
        loop {
            let value = entries.get(keys.next()?)?;
            match (value.get_ref(), keys.peek()) {
                (DeValue::Table(below), Some(_)) => entries = below,
                (_, Some(_)) => return None,
                (DeValue::String(text), None) => return Some(text.to_string()),
                (DeValue::Table(below), None) => return Some(format!("{} values", below.len())),
                (DeValue::Array(values), None) if value.span().len() > 60 => {
                    return Some(format!("{} entries", values.len()));
                }
                (_, None) => return self.source.text.get(value.span()).map(str::to_owned),
            }
        }
    }

    /// An error about the table as a whole.
    pub fn error(&self, message: impl Into<String>) -> FileError {
        self.source.error(self.at, message)
    }
}

/// A value with its key.
#[derive(Clone, Copy, Debug)]
pub struct Value<'a> {
    source: Source<'a>,
    name: &'a str,
    value: &'a Spanned<DeValue<'a>>,
}

impl<'a> Value<'a> {
    /// Byte offset of its begin.
    pub fn at(&self) -> usize {
        self.value.span().start
    }

    /// Its place.
    pub fn place(&self) -> FilePlace {
        self.source.place(self.at())
    }

    /// An error at the value.
    pub fn error(&self, message: impl Into<String>) -> FileError {
        self.source.error(self.at(), message)
    }

    /// The value as written in the file.
    pub fn written(&self) -> &'a str {
        self.source.text.get(self.value.span()).unwrap_or_default()
    }

    /// A text.
    pub fn string(&self, expected: &str) -> Result<&'a str, FileError> {
        self.as_string().ok_or_else(|| self.unexpected(expected))
    }

    /// A text of 1 to 255 bytes, the limit of the SII and the dictionary.
    pub fn name(&self, expected: &str) -> Result<&'a str, FileError> {
        match self.string(expected)? {
            "" => Err(self.error(format!("{} is empty; expected {expected}", self.name))),
            long if long.len() > 255 => Err(self.error(format!(
                "{} has {} bytes; expected at most 255",
                self.name,
                long.len()
            ))),
            text => Ok(text),
        }
    }

    /// A text, if it is one.
    pub fn as_string(&self) -> Option<&'a str> {
        match self.value.get_ref() {
            DeValue::String(text) => Some(text),
            _ => None,
        }
    }

    /// An integer; `None` if it is none or does not fit into 64 bits.
    pub fn as_integer(&self) -> Option<i64> {
        match self.value.get_ref() {
            DeValue::Integer(integer) => {
                i64::from_str_radix(integer.as_str(), integer.radix()).ok()
            }
            _ => None,
        }
    }

    /// An integer within a range.
    pub fn integer(&self, range: RangeInclusive<i64>) -> Result<i64, FileError> {
        let expected = format!("an integer from {} to {}", range.start(), range.end());
        match (self.as_integer(), self.value.get_ref()) {
            (Some(value), _) if range.contains(&value) => Ok(value),
            (_, DeValue::Integer(_)) => Err(self.error(format!(
                "{} = {} is out of range; expected {expected}",
                self.name,
                self.written()
            ))),
            _ => Err(self.unexpected(&expected)),
        }
    }

    /// A decimal number with its unit, within a range.
    pub fn decimal(&self, range: RangeInclusive<f64>, unit: &str) -> Result<f64, FileError> {
        let (least, most) = (range.start(), range.end());
        let expected = format!("a number with its unit from \"{least}{unit}\" to \"{most}{unit}\"");
        let text = self.string(&expected)?;
        let number = text.trim().strip_suffix(unit).map(str::trim).filter(|number| {
            // Rust also reads "inf" and "1e3", which the schema does not allow.
            !number.is_empty() && number.bytes().all(|b| b.is_ascii_digit() || b"+-.".contains(&b))
        });
        match number.and_then(|number| number.parse().ok()) {
            Some(number) if range.contains(&number) => Ok(number),
            Some(_) => Err(self.error(format!(
                "{} = \"{text}\" is out of range; expected {least}{unit} to {most}{unit}",
                self.name
            ))),
            None => Err(self.error(format!("{} = \"{text}\"; expected {expected}", self.name))),
        }
    }

    /// True or false.
    pub fn boolean(&self) -> Result<bool, FileError> {
        match self.value.get_ref() {
            DeValue::Boolean(value) => Ok(*value),
            _ => Err(self.unexpected("true or false")),
        }
    }

    /// The values of an array of `things`.
    pub fn array(&self, things: &str) -> Result<Vec<Value<'a>>, FileError> {
        match self.value.get_ref() {
            DeValue::Array(values) => Ok(values
                .iter()
                .map(|value| Value { source: self.source, name: self.name, value })
                .collect()),
            _ => Err(self.unexpected(&format!("an array of {things}"))),
        }
    }

    /// Whether it is an array.
    pub fn is_array(&self) -> bool {
        matches!(self.value.get_ref(), DeValue::Array(_))
    }

    /// A table.
    pub fn table(&self) -> Result<Table<'a>, FileError> {
        match self.value.get_ref() {
            DeValue::Table(entries) => {
                Ok(Table { source: self.source, entries, name: self.name, at: self.at() })
            }
            _ => Err(self.unexpected("a table")),
        }
    }

    /// Whether it is a table.
    pub fn is_table(&self) -> bool {
        matches!(self.value.get_ref(), DeValue::Table(_))
    }

    /// A duration within a range.
    pub fn duration(&self, range: RangeInclusive<Nanos>) -> Result<Nanos, FileError> {
        self.quantity(parse_duration, range, "a duration with its unit, such as \"1ms\"")
    }

    /// A length within a range.
    pub fn length(&self, range: RangeInclusive<Length>) -> Result<Length, FileError> {
        self.quantity(str::parse, range, "a length with its unit, such as \"10m\"")
    }

    /// A delay per metre within a range.
    pub(crate) fn delay_per_metre(
        &self,
        range: RangeInclusive<DelayPerMetre>,
    ) -> Result<DelayPerMetre, FileError> {
        self.quantity(str::parse, range, "a cable delay with its unit, such as \"5ns/m\"")
    }

    /// A rate within a range.
    pub fn rate(&self, range: RangeInclusive<Ppb>) -> Result<Ppb, FileError> {
        self.quantity(str::parse, range, "a clock rate with its unit, such as \"-35ppm\"")
    }

    fn quantity<T: Copy + PartialOrd + fmt::Display>(
        &self,
        parse: impl Fn(&str) -> Result<T, QuantityError>,
        range: RangeInclusive<T>,
        expected: &str,
    ) -> Result<T, FileError> {
        let text = self.string(expected)?;
        let value = parse(text).map_err(|error| self.error(format!("{}: {error}", self.name)))?;
        if range.contains(&value) {
            return Ok(value);
        }
        Err(self.out_of_range(text, range.start(), range.end()))
    }

    /// The error of a quantity out of its range. One function for quantities of all types.
    fn out_of_range(
        &self,
        text: &str,
        least: &dyn fmt::Display,
        most: &dyn fmt::Display,
    ) -> FileError {
        self.error(format!(
            "{} = \"{text}\" is out of range; expected {least} to {most}",
            self.name
        ))
    }

    /// The value that belongs to one of a few words.
    pub fn one_of<T: Copy>(&self, words: &[Word<T>]) -> Result<T, FileError> {
        let text = self.string("a name in quotes")?;
        words.iter().find(|(word, ..)| *word == text).map(|(.., value)| *value).ok_or_else(|| {
            self.error(format!("unknown {} \"{text}\"", self.name))
                .with_hint(name_hint(text, words.iter().map(|(word, ..)| *word)))
        })
    }

    /// The error that something else was expected here.
    pub fn unexpected(&self, expected: &str) -> FileError {
        let found = match self.value.get_ref() {
            DeValue::String(text) => format!("the text \"{text}\""),
            DeValue::Integer(_) | DeValue::Float(_) => format!("the number {}", self.written()),
            DeValue::Boolean(value) => format!("{value}"),
            DeValue::Datetime(_) => format!("the date {}", self.written()),
            DeValue::Array(_) => "an array".to_owned(),
            DeValue::Table(_) => "a table".to_owned(),
        };
        self.error(format!("{}: expected {expected}, found {found}", self.name))
    }
}
