//! The tables of the documentation: one for each table of a file.

use std::fmt::Write;

use isocat_descriptions::document::section::{Key, Kind, Section};

use super::File;

/// All tables of a kind of file, as Markdown.
pub fn page(file: &File) -> String {
    file.section.all().into_iter().map(table).collect::<Vec<_>>().join("\n")
}

fn table(section: &Section) -> String {
    let mut text = match section.head {
        "" => "### Top level\n\n".to_owned(),
        head if head.starts_with('[') => format!("### `{head}`\n\n"),
        head if head.contains(' ') => format!("### {}\n\n", capital(head)),
        head => format!("### `{head}`\n\n"),
    };
    let _ = write!(
        text,
        "{}\n\n| key | values | without it | what it does | where it goes |\n|---|---|---|---|---|\n",
        section.means
    );
    for key in section.keys {
        let need = key.need.words();
        let need =
            need.strip_prefix("default: ").or(need.strip_prefix("default ")).unwrap_or(&need);
        let values = values(key);
        let cells = [&format!("`{}`", key.name), &values, need, key.means, key.goes];
        let cells: Vec<_> = cells.iter().map(|cell| cell.replace('|', "\\|")).collect();
        let _ = writeln!(text, "| {} |", cells.join(" | "));
    }
    for key in section.keys {
        for (word, means) in words(&key.kind).into_iter().filter(|(_, means)| !means.is_empty()) {
            let _ = write!(text, "\n- `{} = \"{word}\"`: {means}", key.name);
        }
    }
    if text.ends_with('\n') { text } else { text + "\n" }
}

/// The values of a key; for a table, the link to it on the page.
fn values(key: &Key) -> String {
    match key.kind {
        Kind::Table(section) | Kind::Tables(section) if section.head.starts_with('[') => {
            format!("see `{}`", section.head)
        }
        Kind::Table(section) => format!("see `{}`", section.head),
        kind => kind.words(),
    }
}

/// The words that are values of a key.
fn words(kind: &Kind) -> Vec<(&'static str, &'static str)> {
    match kind {
        Kind::Choice(choice) => choice.0.words(),
        Kind::Either(kinds) => kinds.iter().flat_map(words).collect(),
        Kind::List(Kind::Choice(choice)) => choice.0.words(),
        _ => Vec::new(),
    }
}

fn capital(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| {
        first.to_uppercase().collect::<String>() + letters.as_str()
    })
}
