//! Explanations for people and for programs.

use isocat_descriptions::columns::wrap;
use serde::Serialize;

use super::{FORMAT, Found, Meaning};

/// The meanings as text of a hundred columns.
pub fn text(meanings: &[Meaning]) -> String {
    let mut text = String::new();
    match meanings.first().map(|meaning| meaning.found) {
        Some(Found::Number) => text += "Nothing is known of this line as such; of its numbers:\n\n",
        Some(Found::Word) => text += "Nothing is known of this line as such; of its words:\n\n",
        Some(Found::Line | Found::Asked) | None => {}
    }
    if meanings.len() > 1 {
        text += &format!("{} things, the likeliest first:\n\n", meanings.len());
    }
    let all: Vec<String> = meanings.iter().map(one).collect();
    text + &all.join("\n")
}

/// The same as JSON.
pub fn json(what: &str, meanings: &[Meaning]) -> String {
    let json = serde_json::to_string_pretty(&Document { format: FORMAT, what, meanings });
    json.expect("texts can be written as JSON") + "\n"
}

#[derive(Serialize)]
struct Document<'a> {
    format: &'static str,
    what: &'a str,
    meanings: &'a [Meaning],
}

fn one(meaning: &Meaning) -> String {
    let Meaning { kind, what, name, means, .. } = meaning;
    let mut text = String::new();
    for (i, line) in wrap(&format!("{what}, {kind}: {name}"), WIDTH).into_iter().enumerate() {
        text += &format!("{}{line}\n", if i == 0 { "" } else { "  " });
    }
    paragraph(&mut text, "", "", means);
    for (i, line) in meaning.value.iter().enumerate() {
        paragraph(&mut text, if i == 0 { "Value" } else { "" }, "- ", line);
    }
    for (i, cause) in meaning.causes.iter().enumerate() {
        paragraph(&mut text, if i == 0 { "Causes" } else { "" }, &format!("{}. ", i + 1), cause);
    }
    for (title, lines) in [("Read", meaning.read), ("Change", meaning.change)] {
        for (i, line) in lines.iter().enumerate() {
            paragraph(&mut text, if i == 0 { title } else { "" }, "- ", line);
        }
    }
    text
}

/// A title in its column, a mark, and the words after both.
fn paragraph(text: &mut String, title: &str, mark: &str, words: &str) {
    let indent = if title.is_empty() && mark.is_empty() { 2 } else { TITLE };
    let lines = wrap(words, WIDTH - indent - mark.len());
    for (i, line) in lines.into_iter().enumerate() {
        let title = if i == 0 { title } else { "" };
        let mark = if i == 0 { mark.to_owned() } else { " ".repeat(mark.len()) };
        let column = format!("  {title:<width$}", width = indent - 2);
        *text += format!("{column}{mark}{line}").trim_end();
        *text += "\n";
    }
}

/// Width of the text in columns, as in a report.
const WIDTH: usize = 100;
/// Column where the words begin after a title.
const TITLE: usize = 10;
