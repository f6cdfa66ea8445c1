//! docs/faults.md: its table is made of the vocabulary, and each of its segment files runs and ends
//! as it says.

use std::fmt::Write;
use std::path::Path;

use isocat::fault::WORDS;
use isocat::{Report, Scenario, SegmentFile};

fn docs() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs"))
}

#[test]
fn each_word_has_a_segment_file_that_holds() {
    for word in &WORDS {
        let path = docs().join("faults").join(format!("{}.toml", word.name));
        let file = SegmentFile::read(&path.display().to_string()).unwrap_or_else(|e| panic!("{e}"));
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.contains(&format!("what = \"{}", word.name)), "{}", path.display());
        ends_as_it_says(file);
    }
}

/// The others in the folder: what happens to several things together.
#[test]
fn every_other_segment_file_holds() {
    let mut others = 0;
    for entry in std::fs::read_dir(docs().join("faults")).unwrap() {
        let path = entry.unwrap().path();
        let stem = path.file_stem().unwrap().to_string_lossy().into_owned();
        if WORDS.iter().any(|word| word.name == stem) {
            continue;
        }
        let file = SegmentFile::read(&path.display().to_string()).unwrap_or_else(|e| panic!("{e}"));
        ends_as_it_says(file);
        others += 1;
    }
    assert!(others >= 1, "there is one of a ring");
}

fn ends_as_it_says(file: SegmentFile) {
    assert!(!file.expectations.is_empty(), "{}", file.path);
    let scenario = Scenario::from(file);
    let outcome = scenario.run().execute(None::<isocat::NoTap>, &mut |_| {});
    let report = Report::new(&scenario, &outcome);
    assert!(report.as_expected(), "{}", report.text());
    let began = report.faults.iter().filter(|fault| fault.begins).count();
    assert!(began >= scenario.faults.planned.len(), "{}", report.text());
}

#[test]
fn the_table_is_that_of_the_words() {
    let path = docs().join("faults.md");
    let text = std::fs::read_to_string(&path).unwrap();
    let (begin, end) = ("by a test -->\n", "<!-- end of words -->");
    let at = text.find(begin).unwrap() + begin.len();
    let until = text.find(end).unwrap();
    let mut table = String::from("| line | what happens | file |\n|---|---|---|\n");
    for word in &WORDS {
        let line = format!("{} {}", word.name, word.form);
        let line = line.trim_end().replace('|', "\\|");
        let means = word.means.replace('|', "\\|");
        writeln!(table, "| `{line}` | {means} | [{0}](faults/{0}.toml) |", word.name).unwrap();
    }
    let fresh = format!("{}{table}{}", &text[..at], &text[until..]);
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        std::fs::write(&path, &fresh).unwrap();
    }
    assert!(text == fresh, "{}: UPDATE_GOLDEN=1 rewrites it", path.display());
}
