//! Schemas and tables of the documentation are made from the declarations. `UPDATE_GOLDEN=1` writes
//! them.

use std::path::PathBuf;

use isocat_segment::keys::{self, File};
use isocat_segment::profile::Profile;
use isocat_segment::segment_file::SegmentFile;

fn docs(name: &str) -> PathBuf {
    [env!("CARGO_MANIFEST_DIR"), "..", "..", "docs", name].iter().collect()
}

fn compare(name: &str, text: &str) {
    let path = docs(name);
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        std::fs::write(&path, text).unwrap();
    }
    let committed = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(committed == text, "docs/{name} is not what the keys say; UPDATE_GOLDEN=1 writes it");
}

#[test]
fn schemas_are_those_of_the_keys() {
    for file in &keys::FILES {
        compare(&format!("{}.schema.json", file.name), &keys::schema(file));
    }
}

/// The page of a kind of file: its own text, and the tables between two marks.
fn page(file: &File) -> (String, String) {
    let name = format!("{}.md", file.name);
    let text = std::fs::read_to_string(docs(&name)).unwrap();
    (name, text)
}

#[test]
fn tables_are_those_of_the_keys() {
    for file in &keys::FILES {
        let (name, text) = page(file);
        let (before, rest) = text.split_once(BEGIN).expect("a page has a place for its tables");
        let (_, after) = rest.split_once(END).expect("the place has an end");
        compare(&name, &format!("{before}{BEGIN}\n{}\n{END}{after}", keys::page(file)));
    }
}

/// The examples on the pages are valid.
#[test]
fn examples_of_the_pages_are_accepted() {
    for file in &keys::FILES {
        let (name, text) = page(file);
        let mut examples = 0;
        for block in text.split("```toml\n").skip(1) {
            let block = block.split("```").next().unwrap_or_default();
            let read = match file.name {
                "segment-file" => SegmentFile::parse(&name, block).map(drop),
                _ => Profile::from_toml(&name, block).map(drop),
            };
            read.unwrap_or_else(|error| panic!("{error}\n{block}"));
            super::leave(file, true, block);
            examples += 1;
        }
        assert!(examples > 0, "{name}");
    }
}

const BEGIN: &str = "<!-- keys: made of their declarations -->";
const END: &str = "<!-- end of keys -->";
