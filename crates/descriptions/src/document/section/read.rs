//! Reads a table by the declarations of its keys.

use isocat_wire::time::Nanos;

use super::{Key, Kind, Need, Row, Section, Word};
use crate::document::{FileError, Source, Table, Value};
use crate::quantity::{DelayPerMetre, Length, Ppb};

/// A table of a file with the [`Section`] that declares its keys.
///
/// A request for a key that the section does not declare, or for a value that its kind does not
/// have, is a mistake of the program. It panics whatever the file contains, so the first file that
/// is read shows it.
#[derive(Clone, Copy, Debug)]
pub struct Keys<'a> {
    table: Table<'a>,
    section: &'static Section,
    base: i64,
}

impl<'a> Keys<'a> {
    /// Refuses keys that the section does not declare.
    pub fn open(table: Table<'a>, section: &'static Section) -> Result<Self, FileError> {
        let names: Vec<_> = section.keys.iter().map(|key| key.name).collect();
        table.allow(&names)?;
        Ok(Self { table, section, base: 0 })
    }

    /// Sets the quantity on which limits of its ranges depend.
    pub fn by(self, base: Nanos) -> Self {
        Self { base: base.0, ..self }
    }

    /// The value of a key that is required or has a default.
    pub fn get<T: Scalar>(&self, name: &'static str) -> Result<T, FileError> {
        let key = self.key(name);
        match (self.table.value(name), key.need) {
            (Some(value), _) => T::read(&value, &key.kind, self.base),
            (None, Need::Default(text)) => Ok(default(key, text, self.base)),
            (None, Need::Required(expected) | Need::Sometimes(_, expected)) => {
                Err(self.lacks(name, expected))
            }
            (None, Need::Without(_)) => panic!("the key \"{name}\" is declared without a default"),
        }
    }

    /// The value of a key, if present.
    pub fn find<T: Scalar>(&self, name: &'static str) -> Result<Option<T>, FileError> {
        let key = self.key(name);
        let value = self.table.value(name);
        value.map(|value| T::read(&value, &key.kind, self.base)).transpose()
    }

    /// The value for the word of a key; `words` is the list in its [`Kind::Choice`]. For a key that
    /// is required or has a default.
    pub fn choice<T: Copy>(&self, name: &'static str, words: &[Word<T>]) -> Result<T, FileError> {
        let key = self.key(name);
        match (self.find_choice(name, words)?, key.need) {
            (Some(value), _) => Ok(value),
            (None, Need::Default(text)) => {
                let word = words.iter().find(|(word, ..)| text.trim_matches('"') == *word);
                Ok(word.expect("a default is one of the words").2)
            }
            (None, Need::Required(expected) | Need::Sometimes(_, expected)) => {
                Err(self.lacks(name, expected))
            }
            (None, Need::Without(_)) => panic!("the key \"{name}\" is declared without a default"),
        }
    }

    /// The same for an optional key, if present.
    pub fn find_choice<T: Copy>(
        &self,
        name: &'static str,
        words: &[Word<T>],
    ) -> Result<Option<T>, FileError> {
        let kind = &self.key(name).kind;
        self.table.value(name).map(|value| kind.word(&value, words)).transpose()
    }

    /// The value of a key as in the file, for kinds that the reader parses itself.
    pub fn value(&self, name: &'static str) -> Option<Value<'a>> {
        self.key(name);
        self.table.value(name)
    }

    /// The same for a required key.
    pub fn required(&self, name: &'static str) -> Result<Value<'a>, FileError> {
        match (self.value(name), self.key(name).need) {
            (Some(value), _) => Ok(value),
            (None, Need::Required(expected) | Need::Sometimes(_, expected)) => {
                Err(self.lacks(name, expected))
            }
            (None, _) => panic!("the key \"{name}\" is not declared as required"),
        }
    }

    /// The values of a list; empty if the key is missing and not required. `things` names its
    /// elements in errors.
    pub fn list(&self, name: &'static str, things: &str) -> Result<Vec<Value<'a>>, FileError> {
        match (self.value(name), self.key(name).need) {
            (Some(value), _) => value.array(things),
            (None, Need::Required(expected) | Need::Sometimes(_, expected)) => {
                Err(self.lacks(name, expected))
            }
            (None, _) => Ok(Vec::new()),
        }
    }

    /// The scalar values of a list, each with its place; empty if the key is missing.
    pub fn items<T: Scalar>(
        &self,
        name: &'static str,
        things: &str,
    ) -> Result<Vec<(Value<'a>, T)>, FileError> {
        let Kind::List(kind) = self.key(name).kind else { panic!("{name} is no list") };
        let values = self.list(name, things)?.into_iter();
        values.map(|value| Ok((value, T::read(&value, kind, self.base)?))).collect()
    }

    /// The table of a key, if present.
    pub fn table(&self, name: &'static str) -> Result<Option<Keys<'a>>, FileError> {
        let Kind::Table(section) = self.key(name).kind else { panic!("{name} is no table") };
        let Some(value) = self.table.value(name) else { return Ok(None) };
        Ok(Some(Keys::open(value.table()?, section)?.with(self.base)))
    }

    /// The table of a key; if missing, an empty one, whose keys have their defaults.
    pub fn table_or_empty(&self, name: &'static str) -> Result<Keys<'a>, FileError> {
        let Kind::Table(section) = self.key(name).kind else { panic!("{name} is no table") };
        match self.table(name)? {
            Some(keys) => Ok(keys),
            None => Ok(Keys { table: self.table.empty(name), section, base: self.base }),
        }
    }

    /// The table of a required key.
    pub fn required_table(&self, name: &'static str) -> Result<Keys<'a>, FileError> {
        match (self.table(name)?, self.key(name).need) {
            (Some(keys), _) => Ok(keys),
            (None, Need::Required(expected) | Need::Sometimes(_, expected)) => {
                Err(self.lacks(name, expected))
            }
            (None, _) => panic!("the table \"{name}\" is not declared as required"),
        }
    }

    /// The tables `[[name]]`; empty if there are none.
    pub fn tables(&self, name: &'static str) -> Result<Vec<Keys<'a>>, FileError> {
        let Kind::Tables(section) = self.key(name).kind else { panic!("{name} is no tables") };
        let tables = self.table.tables(name)?;
        tables.into_iter().map(|table| Ok(Keys::open(table, section)?.with(self.base))).collect()
    }

    /// An error about the table as a whole.
    pub fn error(&self, message: impl Into<String>) -> FileError {
        self.table.error(message)
    }

    /// An error about the value of a key, or about the table if the key is missing.
    pub fn error_at(&self, name: &'static str, message: impl Into<String>) -> FileError {
        match self.value(name) {
            Some(value) => value.error(message),
            None => self.error(message),
        }
    }

    /// Byte offset of the table's begin.
    pub fn at(&self) -> usize {
        self.table.at
    }

    fn with(self, base: i64) -> Self {
        Self { base, ..self }
    }

    fn key(&self, name: &'static str) -> &'static Key {
        let head = self.section.head;
        self.section.key(name).unwrap_or_else(|| panic!("{head} does not declare \"{name}\""))
    }

    fn lacks(&self, name: &str, expected: &str) -> FileError {
        self.table.lacks(name, expected)
    }
}

impl Kind {
    /// The value that belongs to the word.
    pub fn word<T: Copy>(&self, value: &Value<'_>, words: &[Word<T>]) -> Result<T, FileError> {
        let Kind::Choice(choice) = self else { panic!("{self:?} has no words") };
        debug_assert!(
            choice.0.words().into_iter().eq(words.iter().map(|(word, means, _)| (*word, *means))),
            "read by other words than declared"
        );
        value.one_of(words)
    }
}

impl Row {
    /// The cells of a row in the file.
    pub fn open<'a>(&'static self, value: &Value<'a>) -> Result<Cells<'a>, FileError> {
        let values = value.array("cells")?;
        let most = self.cells.len() + usize::from(self.more.is_some());
        if !(self.cells.len()..=most).contains(&values.len()) {
            return Err(value.unexpected(self.expected));
        }
        Ok(Cells { row: self, values })
    }
}

/// A row of the file.
pub struct Cells<'a> {
    row: &'static Row,
    values: Vec<Value<'a>>,
}

impl<'a> Cells<'a> {
    /// The value of a cell.
    pub fn get<T: Scalar>(&self, name: &'static str) -> Result<T, FileError> {
        let (at, kind) = self.cell(name);
        T::read(&self.values[at], kind, 0)
    }

    /// A cell as in the file.
    pub fn value(&self, name: &'static str) -> Value<'a> {
        self.values[self.cell(name).0]
    }

    /// The table after the last cell.
    pub fn more(&self) -> Result<Option<Keys<'a>>, FileError> {
        let Some(section) = self.row.more else { return Ok(None) };
        let Some(value) = self.values.get(self.row.cells.len()) else { return Ok(None) };
        Keys::open(value.table()?, section).map(Some)
    }

    fn cell(&self, name: &str) -> (usize, &'static Kind) {
        let mut cells = self.row.cells.iter().enumerate();
        let (at, cell) = cells.find(|(_, cell)| cell.name == name).expect("a cell of the row");
        (at, &cell.kind)
    }
}

/// A scalar value of a key.
pub trait Scalar: Sized {
    /// Reads it and checks the range of its kind; `base` is the quantity on which limits depend.
    fn read(value: &Value<'_>, kind: &Kind, base: i64) -> Result<Self, FileError>;
}

impl Scalar for Nanos {
    fn read(value: &Value<'_>, kind: &Kind, base: i64) -> Result<Self, FileError> {
        let Kind::Duration { least, most, whole } = *kind else { mistaken(kind) };
        let time = value.duration(Nanos(least.at(base))..=Nanos(most.at(base)))?;
        if time.0 % whole != 0 {
            let (name, whole) = (value.name, Nanos(whole));
            return Err(value.error(format!("{name} = {time}; expected whole {whole}")));
        }
        Ok(time)
    }
}

impl Scalar for Length {
    fn read(value: &Value<'_>, kind: &Kind, _: i64) -> Result<Self, FileError> {
        let Kind::Length { least, most } = *kind else { mistaken(kind) };
        value.length(Length(least)..=Length(most))
    }
}

impl Scalar for DelayPerMetre {
    fn read(value: &Value<'_>, kind: &Kind, _: i64) -> Result<Self, FileError> {
        let Kind::DelayPerMetre { least, most } = *kind else { mistaken(kind) };
        value.delay_per_metre(DelayPerMetre(least)..=DelayPerMetre(most))
    }
}

impl Scalar for Ppb {
    fn read(value: &Value<'_>, kind: &Kind, _: i64) -> Result<Self, FileError> {
        let Kind::Rate { least, most } = *kind else { mistaken(kind) };
        value.rate(Ppb(least)..=Ppb(most))
    }
}

impl Scalar for f64 {
    fn read(value: &Value<'_>, kind: &Kind, _: i64) -> Result<Self, FileError> {
        let Kind::Decimal { least, most, unit } = *kind else { mistaken(kind) };
        value.decimal(least..=most, unit)
    }
}

impl Scalar for bool {
    fn read(value: &Value<'_>, kind: &Kind, _: i64) -> Result<Self, FileError> {
        let Kind::Boolean = kind else { mistaken(kind) };
        value.boolean()
    }
}

impl Scalar for String {
    fn read(value: &Value<'_>, kind: &Kind, _: i64) -> Result<Self, FileError> {
        match kind {
            Kind::Name(expected) | Kind::Pattern { expected, .. } => value.name(expected),
            Kind::Text(expected) => value.string(expected),
            _ => mistaken(kind),
        }
        .map(str::to_owned)
    }
}

macro_rules! integers {
    ($($type:ty)*) => {$(
        impl Scalar for $type {
            fn read(value: &Value<'_>, kind: &Kind, _: i64) -> Result<Self, FileError> {
                let (Kind::Integer { least, most } | Kind::Hex { least, most }) = *kind else {
                    mistaken(kind)
                };
                let number = value.integer(least..=most)?;
                Ok(number.try_into().expect("a declared range fits the type that is read"))
            }
        }
    )*};
}

integers!(u8 u16 u32 u64 usize i16 i64);

fn mistaken(kind: &Kind) -> ! {
    panic!("{kind:?} is declared, and read as something else")
}

/// The default value of a key.
fn default<T: Scalar>(key: &'static Key, text: &str, base: i64) -> T {
    let mut default = None;
    with_default(key, text, &mut |value| {
        default = Some(T::read(value, &key.kind, base)?);
        Ok(())
    })
    .unwrap_or_else(|error| panic!("a default is a value of its key: {error}"));
    default.expect("it was read")
}

/// Calls `read` with the default value of a key. One function for values of all types.
fn with_default(
    key: &Key,
    text: &str,
    read: &mut dyn FnMut(&Value<'_>) -> Result<(), FileError>,
) -> Result<(), FileError> {
    let text = format!("{} = {text}", key.name);
    let source = Source { path: "the default", text: &text };
    let document = source.parse()?;
    read(&Table::root(source, &document).required(key.name, "")?)
}
