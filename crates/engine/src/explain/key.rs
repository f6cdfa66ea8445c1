//! Keys of segment files and profiles.

use isocat_descriptions::document::name_hint;
use isocat_descriptions::document::section::{Key, Kind};
use isocat_segment::keys::{self, Place};

use super::{Found, Meaning};

/// The meanings of a key in every place where it may occur.
pub(super) fn meanings(name: &str) -> Vec<Meaning> {
    keys::find(name).iter().map(meaning).collect()
}

/// Similar keys.
pub(super) fn hint(name: &str) -> String {
    name_hint(name, keys::all().map(|place| place.key.name))
}

fn meaning(place: &Place) -> Meaning {
    let Place { file, section, key } = *place;
    let kind = match file.name {
        "segment-file" => "key of a segment file",
        _ => "key of a profile",
    };
    let mut value = vec![key.kind.words()];
    value.extend(words(key));
    value.push(key.need.words());
    value.push(format!("goes to: {}", key.goes));
    value.push(format!("such as: {}", key.line()));
    Meaning {
        kind,
        what: place.path(),
        name: match section.head {
            "" => "at the top level".into(),
            head => format!("in {head}"),
        },
        means: key.means,
        value,
        causes: &[],
        read: &[],
        change: &[],
        found: Found::Asked,
    }
}

/// The meaning of each word of a key, or the keys of its table.
fn words(key: &Key) -> Vec<String> {
    match key.kind {
        Kind::Choice(choice) => {
            let words = choice.0.words().into_iter();
            let told = words.filter(|(_, means)| !means.is_empty());
            told.map(|(word, means)| format!("\"{word}\": {means}")).collect()
        }
        Kind::Table(section) | Kind::Tables(section) => {
            let names: Vec<_> = section.keys.iter().map(|key| key.name).collect();
            vec![format!("its keys: {}", names.join(", "))]
        }
        _ => Vec::new(),
    }
}
