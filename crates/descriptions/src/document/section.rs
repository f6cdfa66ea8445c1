//! Keys of a file, declared once: a table of a file is a [`Section`] of [`Key`]s.
//!
//! What a key is called, what values it has, what holds without it, what it does and where its
//! value goes stands in its [`Key`] and nowhere else. The parser reads by it ([`Keys`]), and
//! explanations, the schemas for editors, the tables of the documentation and the playground's
//! controls are made of it.

mod read;
mod words;

pub use read::{Keys, Scalar};

use std::fmt;

use isocat_wire::time::Nanos;

/// A table of a file and its keys.
#[derive(Debug)]
pub struct Section {
    /// How the file opens it: `[host]`, `[[subdevice]]`; empty for the top level.
    pub head: &'static str,
    /// What it describes, as a sentence.
    pub means: &'static str,
    /// Its keys, in the order in which people should read of them.
    pub keys: &'static [Key],
    /// What holds between them.
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

/// A key: all that is known about it.
#[derive(Debug)]
pub struct Key {
    /// As the file writes it.
    pub name: &'static str,
    /// What values it has.
    pub kind: Kind,
    /// Whether it must be there.
    pub need: Need,
    /// What it does, in a sentence or two.
    pub means: &'static str,
    /// Where its value goes: an object, a register, a field.
    pub goes: &'static str,
    /// A value, as TOML.
    pub example: &'static str,
}

/// What holds between two keys of a section.
#[derive(Clone, Copy, Debug)]
pub enum Rule {
    /// One of both stands there, not both.
    Either(&'static str, &'static str),
    /// At least one of both stands there.
    Any(&'static str, &'static str),
    /// At least one of them stands there.
    AnyOf(&'static [&'static str]),
    /// Not both stand there.
    NotBoth(&'static str, &'static str),
    /// The first stands only beside the second.
    Needs(&'static str, &'static str),
    /// The first stands only beside one of the others.
    NeedsAny(&'static str, &'static [&'static str]),
}

/// Whether a key must be there.
#[derive(Clone, Copy, Debug)]
pub enum Need {
    /// It must. An error says what was expected, in these words.
    Required(&'static str),
    /// It must in some cases: which, in words, and what an error says was expected.
    Sometimes(&'static str, &'static str),
    /// Without it this value holds, as TOML.
    Default(&'static str),
    /// Without it this holds, in words.
    Without(&'static str),
}

/// What values a key has. Ends of ranges belong to them.
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
    /// How much faster a clock runs, with its unit.
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
        /// As it stands behind the number.
        unit: &'static str,
    },
    /// An integer that people write in hexadecimal: an index, an address, a code.
    Hex {
        /// Least.
        least: i64,
        /// Most.
        most: i64,
    },
    /// `true` or `false`.
    Boolean,
    /// A text of 1 to 255 bytes: what it should be, in words.
    Name(&'static str),
    /// Any text, even an empty one: what it should be, in words.
    Text(&'static str),
    /// A text with a form of its own.
    Pattern {
        /// What it should be, in words.
        expected: &'static str,
        /// The form as a regular expression of ECMA 262. It may be wider than what the parser
        /// takes.
        pattern: &'static str,
    },
    /// One of some words.
    Choice(Choice),
    /// A text that begins with one of some words; what stands behind it depends on the word.
    Command {
        /// What it should be, in words.
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
        /// What the keys should be, in words.
        expected: &'static str,
        /// Their form as a regular expression.
        pattern: &'static str,
        /// What values they have.
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
    /// It depends on another quantity: in words, and how it follows from that.
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

/// A list of cells that each have a meaning by their place.
#[derive(Debug)]
pub struct Row {
    /// What it is, for errors: `a row [PDO, bits]`.
    pub expected: &'static str,
    /// The cells.
    pub cells: &'static [Cell],
    /// A table that may follow the last cell.
    pub more: Option<&'static Section>,
}

/// A cell of a row.
#[derive(Debug)]
pub struct Cell {
    /// What it is called.
    pub name: &'static str,
    /// What values it has.
    pub kind: Kind,
}

/// The words of a key that has words. The list itself also has what each word stands for, see
/// [`Keys::choice`].
#[derive(Clone, Copy)]
pub struct Choice(pub &'static (dyn Words + Sync));

impl fmt::Debug for Choice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.0.words()).finish()
    }
}

/// A list of words.
pub trait Words {
    /// Each word and what it means; an empty meaning where the word says it all.
    fn words(&self) -> Vec<(&'static str, &'static str)>;
}

/// A word, what it means, and what it stands for.
pub type Word<T> = (&'static str, &'static str, T);

impl<T, const N: usize> Words for [Word<T>; N] {
    fn words(&self) -> Vec<(&'static str, &'static str)> {
        self.iter().map(|(word, means, _)| (*word, *means)).collect()
    }
}
