//! Keys of a file, declared once: a table of a file is a [`Section`] of [`Key`]s.
//!
//! Name, values, default, effect and destination of a key are declared in its [`Key`] and nowhere
//! else. The parser uses it ([`Keys`]), and explanations, the schemas for editors, the tables of
//! the documentation and the playground's controls are made from it.

mod read;
mod words;

pub use read::{Keys, Scalar};

use std::fmt;

use isocat_wire::time::Nanos;

/// A table of a file and its keys.
#[derive(Debug)]
pub struct Section {
    /// Its head in the file: `[host]`, `[[subdevice]]`; empty for the top level.
    pub head: &'static str,
    /// Its meaning, as a sentence.
    pub means: &'static str,
    /// Its keys, in the order for readers.
    pub keys: &'static [Key],
    /// Rules for the keys.
    pub rules: &'static [Rule],
}

impl Section {
    /// The key with this name.
    pub fn key(&self, name: &str) -> Option<&'static Key> {
        self.keys.iter().find(|key| key.name == name)
    }

    /// This section and all below it, each once, in the order of their keys.
    pub fn all(&'static self) -> Vec<&'static Section> {
        let mut all = vec![self];
        for key in self.keys {
            key.kind.collect(&mut all);
        }
        all
    }
}

/// A key with all its properties.
#[derive(Debug)]
pub struct Key {
    /// Its name in the file.
    pub name: &'static str,
    /// The kind of its values.
    pub kind: Kind,
    /// Whether it is required.
    pub need: Need,
    /// Its effect, in one or two sentences.
    pub means: &'static str,
    /// The destination of its value: an object, a register, a field.
    pub goes: &'static str,
    /// An example value in TOML.
    pub example: &'static str,
}

/// A rule for the keys of a section.
#[derive(Clone, Copy, Debug)]
pub enum Rule {
    /// Exactly one of both is present.
    Either(&'static str, &'static str),
    /// At least one of both is present.
    Any(&'static str, &'static str),
    /// At least one of them is present.
    AnyOf(&'static [&'static str]),
    /// Not both are present.
    NotBoth(&'static str, &'static str),
    /// The first requires the second.
    Needs(&'static str, &'static str),
    /// The first requires one of the others.
    NeedsAny(&'static str, &'static [&'static str]),
}

/// Whether a key is required.
#[derive(Clone, Copy, Debug)]
pub enum Need {
    /// It is required. The text describes the expected value in an error.
    Required(&'static str),
    /// It is required in some cases: the cases in words, and the expected value for errors.
    Sometimes(&'static str, &'static str),
    /// Its default, as TOML.
    Default(&'static str),
    /// Its default, in words.
    Without(&'static str),
}

/// The kind of a key's values, including ranges.
#[derive(Clone, Copy, Debug)]
pub enum Kind {
    /// A span of time with its unit.
    Duration {
        /// Least, ns.
        least: Limit,
        /// Most, ns.
        most: Limit,
        /// It must be a multiple of this, ns.
        whole: i64,
    },
    /// A length with its unit.
    Length {
        /// Least, mm.
        least: i64,
        /// Most, mm.
        most: i64,
    },
    /// A delay per length of cable with its unit.
    DelayPerMetre {
        /// Least, ps/m.
        least: i64,
        /// Most, ps/m.
        most: i64,
    },
    /// Frequency deviation of a clock, with its unit.
    Rate {
        /// Least, ppb.
        least: i64,
        /// Most, ppb.
        most: i64,
    },
    /// An integer.
    Integer {
        /// Least.
        least: i64,
        /// Most.
        most: i64,
    },
    /// A physical quantity as a decimal number with one unit, such as `0.5Nm`.
    Decimal {
        /// Least.
        least: f64,
        /// Most.
        most: f64,
        /// Unit after the number.
        unit: &'static str,
    },
    /// An integer in hexadecimal notation: an index, an address, a code.
    Hex {
        /// Least.
        least: i64,
        /// Most.
        most: i64,
    },
    /// `true` or `false`.
    Boolean,
    /// A text of 1 to 255 bytes; the description is for errors.
    Name(&'static str),
    /// Any text, even an empty one; the description is for errors.
    Text(&'static str),
    /// A text with a special form.
    Pattern {
        /// Description of the expected text.
        expected: &'static str,
        /// The form as a regular expression of ECMA 262. It may be wider than what the parser
        /// accepts.
        pattern: &'static str,
    },
    /// One of some words.
    Choice(Choice),
    /// A text that begins with one of some words; the rest depends on the word.
    Command {
        /// Description of the expected text.
        expected: &'static str,
        /// The words.
        words: Choice,
    },
    /// One of several kinds.
    Either(&'static [Kind]),
    /// A list.
    List(&'static Kind),
    /// A list of fixed length whose cells differ.
    Row(&'static Row),
    /// A table.
    Table(&'static Section),
    /// Any number of tables, `[[…]]`.
    Tables(&'static Section),
    /// A table whose keys are data.
    Map {
        /// Description of the expected keys.
        expected: &'static str,
        /// Their form as a regular expression.
        pattern: &'static str,
        /// The kind of their values.
        values: &'static Kind,
    },
}

impl Kind {
    /// A duration between two fixed ends.
    pub const fn duration(least: Nanos, most: Nanos) -> Self {
        Self::Duration { least: Limit::At(least.0), most: Limit::At(most.0), whole: 1 }
    }

    fn collect(&self, all: &mut Vec<&'static Section>) {
        match self {
            Self::Table(section) | Self::Tables(section)
                if !all.iter().any(|known| std::ptr::eq(*known, *section)) =>
            {
                all.push(section);
                section.keys.iter().for_each(|key| key.kind.collect(all));
            }
            Self::Either(kinds) => kinds.iter().for_each(|kind| kind.collect(all)),
            Self::List(kind) | Self::Map { values: kind, .. } => kind.collect(all),
            Self::Row(row) => {
                row.cells.iter().for_each(|cell| cell.kind.collect(all));
                row.more.iter().for_each(|more| Self::Table(more).collect(all));
            }
            _ => {}
        }
    }
}

/// An end of a range, in the smallest unit.
#[derive(Clone, Copy, Debug)]
pub enum Limit {
    /// A fixed number.
    At(i64),
    /// A number that depends on another quantity: description, and formula.
    From(&'static str, fn(i64) -> i64),
}

impl Limit {
    /// The number; `base` is the quantity that it depends on.
    pub fn at(self, base: i64) -> i64 {
        match self {
            Self::At(number) => number,
            Self::From(_, number) => number(base),
        }
    }
}

/// A list of cells whose meaning depends on their place.
#[derive(Debug)]
pub struct Row {
    /// Its description for errors: `a row [PDO, bits]`.
    pub expected: &'static str,
    /// The cells.
    pub cells: &'static [Cell],
    /// A table that may follow the last cell.
    pub more: Option<&'static Section>,
}

/// A cell of a row.
#[derive(Debug)]
pub struct Cell {
    /// Its name.
    pub name: &'static str,
    /// The kind of its values.
    pub kind: Kind,
}

/// The words of a key. The list itself also has the value for each word, see [`Keys::choice`].
#[derive(Clone, Copy)]
pub struct Choice(pub &'static (dyn Words + Sync));

impl fmt::Debug for Choice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.0.words()).finish()
    }
}

/// A list of words.
pub trait Words {
    /// Each word and its meaning; the meaning is empty if the word suffices.
    fn words(&self) -> Vec<(&'static str, &'static str)>;
}

/// A word, its meaning, and its value.
pub type Word<T> = (&'static str, &'static str, T);

impl<T, const N: usize> Words for [Word<T>; N] {
    fn words(&self) -> Vec<(&'static str, &'static str)> {
        self.iter().map(|(word, means, _)| (*word, *means)).collect()
    }
}
