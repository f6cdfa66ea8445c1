//! Typed values in documents: views use the type, readers of the JSON get names.

use std::collections::BTreeMap;
use std::fmt;

use isocat_maindevice::kind::{Figure, Figures};
use isocat_sim::Kind;
use isocat_sync::budget::Check;
use isocat_wire::{AlState, AlStatus};
#[cfg(feature = "schema")]
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Serialize, Serializer};

/// A value by its `Display`.
pub fn text<T: fmt::Display, S: Serializer>(value: &T, out: S) -> Result<S::Ok, S::Error> {
    out.collect_str(value)
}

/// A value by its `Display`, or null.
pub(crate) fn some_text<T, S>(value: &Option<T>, out: S) -> Result<S::Ok, S::Error>
where
    T: fmt::Display,
    S: Serializer,
{
    match value {
        Some(value) => out.collect_str(value),
        None => out.serialize_none(),
    }
}

/// A line of the budget by its name.
pub fn check<S: Serializer>(check: &Check, out: S) -> Result<S::Ok, S::Error> {
    out.serialize_str(check.name())
}

/// AL status of a SubDevice, or why there is none.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum StateRead {
    /// Register 0x0130.
    Status(AlStatus),
    /// The SubDevice may be absent, and is absent.
    Absent,
    /// The SubDevice was absent, has returned and is not admitted yet.
    Joining,
    /// The state could not be read at the end.
    Unknown,
    /// The scan ended before it was read.
    NotScanned,
}

impl StateRead {
    /// Whether the SubDevice is in OP, without an error.
    pub fn is_op(self) -> bool {
        self == Self::Status(AlStatus::new(AlState::Op))
    }

    /// Whether the SubDevice shows an error.
    pub fn is_error(self) -> bool {
        matches!(self, Self::Status(status) if status.error())
    }
}

impl fmt::Display for StateRead {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Status(status) => f.pad(&status.to_string()),
            Self::Absent => f.pad("absent"),
            Self::Joining => f.pad("joining"),
            Self::Unknown => f.pad("unknown"),
            Self::NotScanned => f.pad(""),
        }
    }
}

/// A kind with its figures, in a document.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct KindDocument {
    /// Short name of the kind, for programs: it stays the same when the sentence changes.
    /// docs/findings.md describes each.
    #[cfg_attr(feature = "schema", schemars(schema_with = "names"))]
    pub kind: &'static str,
    /// The figures of the kind by name; times are nanoseconds.
    #[cfg_attr(feature = "schema", schemars(schema_with = "figures"))]
    pub figures: BTreeMap<String, FigureDocument>,
}

/// The names of all kinds.
#[cfg(feature = "schema")]
fn names(_: &mut SchemaGenerator) -> Schema {
    let names: Vec<_> = Kind::descriptions().map(|kind| kind.name).collect();
    json_schema!({ "type": "string", "enum": names })
}

#[cfg(feature = "schema")]
pub(super) fn figures(_: &mut SchemaGenerator) -> Schema {
    json_schema!({
        "type": "object",
        "additionalProperties": { "type": ["integer", "number", "boolean", "string", "null"] },
    })
}

/// A figure in a document.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[serde(untagged)]
pub enum FigureDocument {
    /// A count, a code or a time in whole ns.
    Integer(i64),
    /// A time in ns.
    Real(f64),
    /// Yes or no.
    Flag(bool),
    /// A name.
    Text(String),
    /// Not known.
    Absent,
}

impl KindDocument {
    /// The document of a kind's name and figures.
    pub fn new(kind: &'static str, figures: &Figures) -> Self {
        let document = |figure: &Figure| match figure {
            Figure::Integer(number) => FigureDocument::Integer(*number),
            Figure::Real(number) => FigureDocument::Real(*number),
            Figure::Flag(flag) => FigureDocument::Flag(*flag),
            Figure::Text(text) => FigureDocument::Text(text.clone()),
            Figure::Absent => FigureDocument::Absent,
        };
        let mut documents = BTreeMap::new();
        for (name, figure) in figures.iter() {
            documents.insert(name.to_owned(), document(figure));
        }
        Self { kind, figures: documents }
    }
}

impl From<&Kind> for KindDocument {
    fn from(kind: &Kind) -> Self {
        Self::new(kind.name(), &kind.figures())
    }
}

/// A kind as its name and its figures.
pub fn kind<S: Serializer>(kind: &Kind, out: S) -> Result<S::Ok, S::Error> {
    KindDocument::from(kind).serialize(out)
}
