//! Every key of segment files and profiles: where it may occur, and the documents made from its
//! declaration.
//!
//! The declarations are next to their parsers: [`segment_file::FILE`] and [`profile::FILE`].
//! [`find`] looks a key up by its name, [`schema()`] makes a JSON schema for editors, [`page()`]
//! the tables of the documentation.

mod page;
mod schema;

pub use page::page;
pub use schema::schema;

use isocat_descriptions::document::section::{Key, Section};

use crate::{profile, segment_file};

/// A kind of file that has keys.
#[derive(Debug)]
pub struct File {
    /// Its name in commands: `segment-file`, `profile`.
    pub name: &'static str,
    /// Its name in sentences.
    pub title: &'static str,
    /// Its top level.
    pub section: &'static Section,
}

/// Segment files and profiles.
pub static FILES: [File; 2] = [
    File { name: "segment-file", title: "segment file", section: &segment_file::FILE },
    File { name: "profile", title: "profile", section: &profile::FILE },
];

/// A place where a key may occur.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    /// The kind of file.
    pub file: &'static File,
    /// The table in the file.
    pub section: &'static Section,
    /// The key.
    pub key: &'static Key,
}

impl Place {
    /// The place as a path: `subdevice.input_shift`; only the name at the top level and in tables
    /// without a name.
    pub fn path(&self) -> String {
        match bare(self.section) {
            section if section.is_empty() || section.contains(' ') => self.key.name.to_owned(),
            section => format!("{section}.{}", self.key.name),
        }
    }
}

/// Every key in every place, segment files first.
pub fn all() -> impl Iterator<Item = Place> {
    let sections =
        |file: &'static File| file.section.all().into_iter().map(move |section| (file, section));
    FILES.iter().flat_map(sections).flat_map(|(file, section)| {
        section.keys.iter().map(move |key| Place { file, section, key })
    })
}

/// The places of a key: by its name (`input_shift`), or by its table and its name
/// (`subdevice.input_shift`).
pub fn find(name: &str) -> Vec<Place> {
    all().filter(|place| place.key.name == name || place.path() == name).collect()
}

/// The name of a table without its brackets.
fn bare(section: &Section) -> &'static str {
    section.head.trim_matches(['[', ']'])
}
