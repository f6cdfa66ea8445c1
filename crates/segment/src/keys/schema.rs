//! A JSON schema for editors: the keys, their meaning, and their values.
//!
//! Editors of TOML support draft 7 and the extension `x-taplo`, which explains each word of a list.
//! A schema cannot express ranges of quantities with units, only their form.

use isocat_descriptions::document::section::{
    Cell, Choice, Key, Kind, Limit, Need, Row, Rule, Section,
};
use isocat_descriptions::quantity::{DelayPerMetre, Length, Ppb, duration_pattern};
use serde_json::{Map, Value, json};

use super::{File, bare};

/// The schema of a kind of file, as indented JSON.
pub fn schema(file: &File) -> String {
    let mut schema = section(file.section);
    let below = &file.section.all()[1..];
    let definitions: Map<_, _> = below.iter().map(|below| (slug(below), section(below))).collect();
    let title = format!("isocat {}", file.title);
    set(&mut schema, "$schema", json!("http://json-schema.org/draft-07/schema#"));
    set(&mut schema, "title", json!(title));
    set(&mut schema, "definitions", Value::Object(definitions));
    serde_json::to_string_pretty(&schema).expect("a schema can be written as JSON") + "\n"
}

/// A table.
fn section(section: &Section) -> Value {
    let properties: Map<_, _> =
        section.keys.iter().map(|key| (key.name.to_owned(), property(key))).collect();
    let needed = section.keys.iter().filter(|key| matches!(key.need, Need::Required(_)));
    let mut schema = json!({
        "type": "object",
        "description": section.means,
        "properties": properties,
        "required": needed.map(|key| key.name).collect::<Vec<_>>(),
        "additionalProperties": false,
    });
    let rules: Vec<_> = section.rules.iter().map(rule).collect();
    if !rules.is_empty() {
        set(&mut schema, "allOf", Value::Array(rules));
    }
    schema
}

/// A rule between two keys.
fn rule(rule: &Rule) -> Value {
    let has = |key: &str| json!({ "required": [key] });
    match *rule {
        Rule::Either(one, other) => json!({ "oneOf": [has(one), has(other)] }),
        Rule::Any(one, other) => json!({ "anyOf": [has(one), has(other)] }),
        Rule::AnyOf(keys) => {
            json!({ "anyOf": keys.iter().map(|key| has(key)).collect::<Vec<_>>() })
        }
        Rule::NotBoth(one, other) => json!({ "not": { "required": [one, other] } }),
        Rule::NeedsAny(key, others) => {
            let without = json!({ "not": has(key) });
            let any = others.iter().map(|other| has(other));
            json!({ "anyOf": any.chain([without]).collect::<Vec<_>>() })
        }
        Rule::Needs(key, other) => json!({ "dependencies": { key: [other] } }),
    }
}

/// A key with its explanation.
fn property(key: &Key) -> Value {
    let mut schema = kind(&key.kind);
    let (values, need) = (key.kind.words(), key.need.words());
    let words = format!("{}\n\n{values}; {need}\n\nGoes to: {}", key.means, key.goes);
    if let Kind::Table(_) = key.kind {
        // Draft 7 ignores other keywords next to a reference.
        schema = json!({ "allOf": [schema] });
    }
    set(&mut schema, "description", json!(words));
    if let Need::Default(text) = key.need {
        let default = serde_json::from_str(text).expect("a default reads the same as JSON");
        set(&mut schema, "default", default);
    }
    schema
}

fn kind(kind: &Kind) -> Value {
    match kind {
        Kind::Duration { least, .. } => {
            let signed = match least {
                Limit::At(least) => *least < 0,
                // The least value by which the limit is computed.
                Limit::From(_, least) => least(1) < 0,
            };
            text(&duration_pattern(signed))
        }
        Kind::Length { .. } => text(&Length::pattern()),
        Kind::DelayPerMetre { .. } => text(&DelayPerMetre::pattern()),
        Kind::Rate { least, .. } => text(&Ppb::pattern(*least < 0)),
        Kind::Integer { least, most } | Kind::Hex { least, most } => integer(*least, *most),
        Kind::Decimal { least, unit, .. } => {
            let sign = if *least < 0.0 { "[+-]?" } else { "[+]?" };
            let dot = r"([0-9]+(\.[0-9]*)?|\.[0-9]+)";
            text(&format!(r"^\s*{sign}{dot}\s*{unit}\s*$"))
        }
        Kind::Boolean => json!({ "type": "boolean" }),
        Kind::Name(_) => json!({ "type": "string", "minLength": 1, "maxLength": 255 }),
        Kind::Text(_) => json!({ "type": "string" }),
        Kind::Pattern { pattern, .. } => text(pattern),
        Kind::Command { words, .. } => {
            let words: Vec<_> = words.0.words().into_iter().map(|(word, _)| word).collect();
            text(&format!(r"^\s*({})(\s.*)?$", words.join("|")))
        }
        Kind::Choice(choice) => words(choice),
        Kind::Either(kinds) => {
            json!({ "anyOf": kinds.iter().map(self::kind).collect::<Vec<_>>() })
        }
        Kind::List(of) => json!({ "type": "array", "items": self::kind(of) }),
        Kind::Row(of) => row(of),
        Kind::Table(section) => reference(section),
        Kind::Tables(section) => json!({ "type": "array", "items": reference(section) }),
        Kind::Map { pattern, values, .. } => json!({
            "type": "object",
            "patternProperties": { *pattern: self::kind(values) },
            "additionalProperties": false,
        }),
    }
}

fn text(pattern: &str) -> Value {
    json!({ "type": "string", "pattern": pattern })
}

/// The limits of 64 bits are left out: they tell people nothing, and editors compute in floating
/// point.
fn integer(least: i64, most: i64) -> Value {
    let mut schema = json!({ "type": "integer" });
    if least != i64::MIN {
        set(&mut schema, "minimum", json!(least));
    }
    if most != i64::MAX {
        set(&mut schema, "maximum", json!(most));
    }
    schema
}

fn words(choice: &Choice) -> Value {
    let words = choice.0.words();
    let names: Vec<_> = words.iter().map(|(word, _)| *word).collect();
    let mut schema = json!({ "enum": names });
    if words.iter().any(|(_, means)| !means.is_empty()) {
        let means: Vec<_> = words.iter().map(|(_, means)| *means).collect();
        set(&mut schema, "x-taplo", json!({ "docs": { "enumValues": means } }));
    }
    schema
}

fn row(row: &Row) -> Value {
    let cell = |cell: &Cell| {
        let mut schema = kind(&cell.kind);
        set(&mut schema, "title", json!(cell.name));
        schema
    };
    let mut items: Vec<_> = row.cells.iter().map(cell).collect();
    let least = items.len();
    items.extend(row.more.map(reference));
    json!({ "type": "array", "items": items, "additionalItems": false, "minItems": least })
}

fn reference(section: &Section) -> Value {
    json!({ "$ref": format!("#/definitions/{}", slug(section)) })
}

/// A table's name as a word.
fn slug(section: &Section) -> String {
    let letter = |c: char| if c.is_ascii_alphanumeric() { c } else { '-' };
    bare(section).chars().map(letter).collect()
}

fn set(schema: &mut Value, name: &str, value: Value) {
    schema.as_object_mut().expect("a schema is an object").insert(name.to_owned(), value);
}
