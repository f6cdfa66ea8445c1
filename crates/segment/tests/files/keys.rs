//! Every declared key is read as declared, and the documents made from the declarations are
//! committed.
//!
//! If `ISOCAT_KEYS` is set to a folder, the test writes its files there, for another reader of the
//! schemas: accepted ones to `good`, those that a schema can refuse to `bad`.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

use isocat_descriptions::document::FileError;
use isocat_descriptions::document::section::{Kind, Limit, Need, Rule};
use isocat_segment::keys::{self, File, Place};
use isocat_segment::profile::Profile;
use isocat_segment::segment_file::SegmentFile;

mod bases;
mod pages;

use self::bases::file;

/// The content of a file, in a form that distinguishes any two contents.
fn read(of: &File, text: &str) -> Result<String, FileError> {
    let path = folder().join("file.toml").display().to_string();
    match of.name {
        "segment-file" => SegmentFile::parse(&path, text).map(|segment| format!("{segment:?}")),
        _ => Profile::from_toml(&path, text).map(|profile| format!("{profile:?}")),
    }
}

/// Folder with the ESI file of the examples.
fn folder() -> PathBuf {
    static MADE: std::sync::OnceLock<PathBuf> = std::sync::OnceLock::new();
    let make = || {
        let folder = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("keys");
        std::fs::create_dir_all(&folder).unwrap();
        let shipped = concat!(env!("CARGO_MANIFEST_DIR"), "/../isocat/tests/esi/box.xml");
        let text = std::fs::read_to_string(shipped).unwrap();
        let drive = "RevisionNo=\"#x00010000\">Drive</Type>";
        assert!(text.contains(drive));
        let renamed = text.replacen(drive, "RevisionNo=\"#x00110000\">EL2502-0010</Type>", 1);
        std::fs::write(folder.join("vendor.xml"), renamed).unwrap();
        let rack = concat!(env!("CARGO_MANIFEST_DIR"), "/../isocat/tests/esi/rack.xml");
        std::fs::copy(rack, folder.join("rack.xml")).unwrap();
        let simple = isocat_segment::profile::built_in("simple_io4").unwrap();
        std::fs::write(folder.join("eeprom.bin"), &simple.sii).unwrap();
        folder
    };
    MADE.get_or_init(make).clone()
}

/// Writes a file for another reader.
fn leave(of: &File, good: bool, text: &str) {
    static COUNT: AtomicUsize = AtomicUsize::new(0);
    let Some(folder) = std::env::var_os("ISOCAT_KEYS") else { return };
    let folder = Path::new(&folder).join(of.name).join(if good { "good" } else { "bad" });
    std::fs::create_dir_all(&folder).unwrap();
    let number = COUNT.fetch_add(1, Ordering::Relaxed);
    std::fs::write(folder.join(format!("{number:04}.toml")), text).unwrap();
}

fn accepted(place: &Place, value: &str) -> String {
    let text = file(place, Some(&format!("{} = {value}", place.key.name)));
    let read = read(place.file, &text)
        .unwrap_or_else(|error| panic!("{} = {value}: {error}\n{text}", place.path()));
    leave(place.file, true, &text);
    read
}

fn refused(place: &Place, value: &str) -> String {
    let line = format!("{} = {value}", place.key.name);
    let text = file(place, Some(&line));
    match read(place.file, &text) {
        Ok(_) => panic!("{} = {value} was accepted\n{text}", place.path()),
        Err(error) => {
            // The mistake is reported at the key.
            let told = text.lines().nth(error.line.saturating_sub(1)).unwrap_or_default();
            assert!(told.contains(place.key.name), "{error}\n{text}");
            error.to_string()
        }
    }
}

#[test]
fn every_example_is_accepted() {
    for place in keys::all() {
        accepted(&place, place.key.example);
    }
}

/// A date is a value of no key, so a key that is declared and not read would accept it.
#[test]
fn every_key_is_read() {
    for place in keys::all() {
        let words = refused(&place, "1979-05-27");
        assert!(words.contains("expected"), "{}: {words}", place.path());
        leave(place.file, false, &file(&place, Some(&format!("{} = 1979-05-27", place.key.name))));
    }
}

#[test]
fn no_other_key_is_accepted() {
    for place in keys::all() {
        let text = file(&place, Some("no_such_key = 1"));
        let error = read(place.file, &text).unwrap_err().to_string();
        assert!(error.contains("unknown key \"no_such_key\""), "{error}\n{text}");
        leave(place.file, false, &text);
    }
}

/// Tests both sides of every end of every range, by the smallest step.
#[test]
fn ranges_end_where_they_are_declared() {
    let mut ranges = 0;
    for place in keys::all() {
        let base = match place.key.name {
            "cable_asymmetry" => 100,
            "longest" => 1_000_000_000,
            _ => 1_000_000,
        };
        let (least, most, whole, unit) = match place.key.kind {
            Kind::Duration { least, most, whole } => (least.at(base), most.at(base), whole, "ns"),
            Kind::Length { least, most } => (least, most, 1, "mm"),
            Kind::DelayPerMetre { least, most } => (least, most, 1, "ps/m"),
            Kind::Rate { least, most } => (least, most, 1, "ppb"),
            Kind::Integer { least, most } | Kind::Hex { least, most } => (least, most, 1, ""),
            _ => continue,
        };
        ranges += 1;
        let value = |number: i64| match unit {
            "" => number.to_string(),
            unit => format!("\"{number}{unit}\""),
        };
        // Other errors of a value at the end of its range do not matter here.
        let out = |number: i64| {
            let text = file(&place, Some(&format!("{} = {}", place.key.name, value(number))));
            let read = read(place.file, &text);
            let start = format!("{} = ", place.key.name);
            let out = read.as_ref().is_err_and(|error| {
                error.message.starts_with(&start) && error.message.contains("is out of range")
            });
            match read {
                Ok(_) => leave(place.file, true, &text),
                Err(_) if out && unit.is_empty() => leave(place.file, false, &text),
                Err(_) => {}
            }
            out
        };
        for (inside, outside) in [(least, least.checked_sub(1)), (most, most.checked_add(1))] {
            assert!(!out(inside), "{} = {}", place.path(), value(inside));
            if let Some(outside) = outside {
                assert!(out(outside), "{} = {}", place.path(), value(outside));
            }
        }
        if whole > 1 {
            let words = refused(&place, &value(least + whole + 1));
            assert!(words.contains("expected whole"), "{words}");
        }
    }
    assert!(ranges > 60, "{ranges}");
}

/// The same for decimal numbers, which have no smallest step.
#[test]
fn decimals_end_where_they_are_declared() {
    let mut ranges = 0;
    for place in keys::all() {
        let Kind::Decimal { least, most, unit } = place.key.kind else { continue };
        ranges += 1;
        let out = |number: String| {
            let text = file(&place, Some(&format!("{} = \"{number}{unit}\"", place.key.name)));
            let start = format!("{} = ", place.key.name);
            read(place.file, &text).is_err_and(|error| {
                error.message.starts_with(&start) && error.message.contains("is out of range")
            })
        };
        assert!(!out(format!("{least}")) && !out(format!("{most}")), "{}", place.path());
        assert!(out(format!("{}", least - 1e-9)), "{}", place.path());
        assert!(out(format!("{most}1")), "{}", place.path());
    }
    assert!(ranges > 8, "{ranges}");
}

#[test]
fn defaults_are_what_holds_without_the_key() {
    let mut defaults = 0;
    for place in keys::all() {
        let Need::Default(default) = place.key.need else { continue };
        // An inline table has no empty lines.
        let without = read(place.file, &file(&place, None)).unwrap();
        assert_eq!(accepted(&place, default), without, "{}", place.path());
        defaults += 1;
    }
    assert!(defaults > 30, "{defaults}");
}

/// The default gives the same result as no key, and the example another one.
#[test]
fn examples_are_heard() {
    for place in keys::all() {
        let Need::Default(default) = place.key.need else { continue };
        if default != place.key.example {
            let without = read(place.file, &file(&place, None)).unwrap();
            assert_ne!(accepted(&place, place.key.example), without, "{}", place.path());
        }
    }
}

#[test]
fn what_is_needed_is_asked_for() {
    for place in keys::all() {
        let Need::Required(_) = place.key.need else { continue };
        let text = file(&place, None);
        let error = read(place.file, &text).unwrap_err().to_string();
        let lacks = format!("lacks the key \"{}\"; expected", place.key.name);
        let none = format!("has no [[{}]]; expected", place.key.name);
        assert!(error.contains(&lacks) || error.contains(&none), "{error}\n{text}");
        leave(place.file, false, &text);
    }
}

#[test]
fn words_are_those_declared() {
    for place in keys::all() {
        let (words, list) = match place.key.kind {
            Kind::Choice(choice) => (choice.0.words(), false),
            Kind::List(Kind::Choice(choice)) => (choice.0.words(), true),
            _ => continue,
        };
        let value = |word: &str| if list { format!("[\"{word}\"]") } else { format!("\"{word}\"") };
        for (word, _) in words {
            let text = file(&place, Some(&format!("{} = {}", place.key.name, value(word))));
            // It may need another device, but it is known.
            match read(place.file, &text) {
                Ok(_) => leave(place.file, true, &text),
                Err(error) => assert!(!error.message.contains("unknown"), "{error}\n{text}"),
            }
        }
        let words = refused(&place, &value("no-such-word"));
        assert!(words.contains("unknown") && words.contains("expected one of"), "{words}");
        let line = format!("{} = {}", place.key.name, value("no-such-word"));
        leave(place.file, false, &file(&place, Some(&line)));
    }
}

/// The parser enforces the declared rules for pairs of keys.
#[test]
fn keys_that_go_together() {
    let mut rules = 0;
    for file in &keys::FILES {
        for section in file.section.all() {
            for rule in section.rules {
                rules += 1;
                let place = |name| Place { file, section, key: section.key(name).unwrap() };
                let line = |name| format!("{name} = {}", place(name).key.example);
                let wrong = match *rule {
                    Rule::Either(one, other) => {
                        let both = format!("{}\n{}", line(one), line(other));
                        vec![bases::file(&place(one), Some(&both)), bases::file(&place(one), None)]
                    }
                    // Its base has only the first of both.
                    Rule::Any(one, _) => vec![bases::file(&place(one), None)],
                    Rule::AnyOf(keys) => {
                        keys.iter().map(|key| bases::file(&place(key), None)).collect()
                    }
                    Rule::NotBoth(one, other) => {
                        vec![bases::file(
                            &place(one),
                            Some(&format!("{}\n{}", line(one), line(other))),
                        )]
                    }
                    Rule::Needs(one, other) => vec![alone(&place(one), &[other])],
                    Rule::NeedsAny(one, others) => vec![alone(&place(one), others)],
                };
                for text in wrong {
                    assert!(read(file, &text).is_err(), "{rule:?}\n{text}");
                    leave(file, false, &text);
                }
            }
        }
    }
    assert!(rules > 8, "{rules}");
}

/// A file that has this key and none of the others.
fn alone(place: &Place, others: &[&str]) -> String {
    let line = format!("{} = {}", place.key.name, place.key.example);
    let beside = bases::file(place, Some(&line));
    let without = |line: &&str| !others.iter().any(|other| line.starts_with(&format!("{other} =")));
    beside.lines().filter(without).map(|line| format!("{line}\n")).collect()
}

#[test]
fn a_key_is_found_by_its_name() {
    let paths = |name: &str| keys::find(name).iter().map(Place::path).collect::<Vec<_>>();
    assert_eq!(paths("input_shift"), ["subdevice.input_shift"]);
    assert_eq!(paths("cycle"), ["cycle", "subdevice.cycle"]);
    assert_eq!(paths("subdevice.cycle"), ["subdevice.cycle"]);
    assert_eq!(paths("times.jitter"), ["times.jitter"]);
    assert!(paths("no_such_key").is_empty());
}

/// Texts for people have the form of sentences and phrases.
#[test]
fn words_of_the_declarations() {
    for place in keys::all() {
        let key = place.key;
        let (path, means, goes) = (place.path(), key.means, key.goes);
        assert!(means.ends_with('.') && means.starts_with(char::is_uppercase), "{path}: {means}");
        assert!(!goes.is_empty() && !goes.ends_with('.'), "{path}: {goes}");
        assert!(!means.contains("  ") && !goes.contains("  "), "{path}");
        if let Need::Default(default) = key.need {
            assert_ne!(default, "", "{path}");
        }
        if let Kind::Duration { least: Limit::At(least), most: Limit::At(most), .. } = key.kind {
            assert!(least < most, "{path}");
        }
    }
}
