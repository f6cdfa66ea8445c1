//! Tests that invalid states are refused in words: the key, what was found, and what is expected.

use std::collections::BTreeMap;

use isocat::document::section::Kind as Declared;
use isocat_playground::answer::of;
use isocat_playground::keys::{KEYS, Kind, LONGEST_CYCLE, in_file};
use isocat_playground::state::State;

fn problems(key: &str, text: &str) -> Vec<(String, String)> {
    let texts = BTreeMap::from([(key.to_owned(), text.to_owned())]);
    of(&texts).problems.into_iter().map(|problem| (problem.key, problem.message)).collect()
}

#[test]
fn what_is_wrong_with_a_key_is_said_with_its_name() {
    for (key, text, words) in [
        ("mode", "dc-sync9", "expected one of free-run, sm, dc-sync0"),
        ("cycle", "1", "has no unit"),
        ("cycle", "1lightyear", "expected a number with one of the units ns"),
        ("cycle", "own", "is no duration"),
        ("cycle", "10us", "expected 100 us to 20 ms"),
        ("cable", "-1m", "expected 0.01 m to 1000 m"),
        ("clocks", "2000ppm", "expected -1000 ppm to +1000 ppm"),
        ("devices", "0", "expected 1 to 8"),
        ("devices", "many", "expected a whole number from 1 to 8"),
        ("device", "toaster", "expected one of model_every_mode"),
        ("cicle", "1ms", "cycle"),
        ("at", "soon", "expected a whole number"),
        ("pulse", "1s", "expected 0 ns to 655.35 us"),
    ] {
        let found = problems(key, text);
        assert_eq!(found.len(), 1, "{key} = {text}: {found:?}");
        assert_eq!(found[0].0, key);
        assert!(found[0].1.contains(words), "{key} = {text}: {}", found[0].1);
        assert!(found[0].1.contains(key), "{}", found[0].1);
    }
}

/// The parser of segment files refuses lines of faults, in its words.
#[test]
fn a_fault_that_can_t_be_is_told_with_what_is_expected() {
    for (line, words) in [
        ("pull 1", "has no colon; expected when and what"),
        ("soon: pull 1", "soon"),
        ("in-operation + 5ms: pul 1", "did you mean"),
        ("in-operation + 5ms: pull 3", "0 to 2"),
        ("in-operation + 5ms: pull 1 for 5", "has no unit"),
        ("0.1s: heal\n\n  in-operation: power-on 1 for 5ms", "power-on"),
        ("1s: misbehave 1 \"\u{7f}", "misbehave"),
    ] {
        let found = problems("faults", line);
        assert_eq!(found.len(), 1, "{line}: {found:?}");
        assert_eq!(found[0].0, "faults", "{line}: {}", found[0].1);
        assert!(found[0].1.contains(words), "{line}: {}", found[0].1);
    }
}

/// An error of the segment file is reported at the key of the page.
#[test]
fn what_the_devices_can_t_do_is_told_by_key_too() {
    let refused = |state: &[(&str, &str)]| {
        let pairs = state.iter().map(|(key, text)| ((*key).to_owned(), (*text).to_owned()));
        of(&pairs.collect()).problems
    };
    for (state, key) in [
        (&[("phase", "5ms")][..], "phase"),
        (&[("shift", "1ms")], "shift"),
        (&[("sync1", "200us")], "sync1"),
        (&[("mode", "dc-subordinated"), ("sync0-cycle", "300us")], "sync0-cycle"),
        (&[("device", "beckhoff_el2502-0010"), ("mode", "dc-subordinated")], "mode"),
        (&[("cycle", "100us"), ("host-jitter", "90us")], "host-jitter"),
    ] {
        let found = refused(state);
        assert_eq!(found.len(), 1, "{state:?}: {found:?}");
        assert_eq!(found[0].key, key, "{}", found[0].message);
        assert!(
            found[0].message.contains("expected") || found[0].message.contains("announces"),
            "{}",
            found[0].message
        );
    }
}

#[test]
fn defaults_are_values() {
    assert!(State::read(&BTreeMap::new()).is_ok());
    for key in KEYS.iter() {
        assert!(!key.label.is_empty() && !key.help.is_empty() && !key.views.is_empty());
        // A key for which `own` is no value must have a default value.
        if let Kind::Duration { own: None, .. } = key.kind {
            assert_ne!(key.default, "own", "{}", key.name);
        }
    }
}

#[test]
fn no_text_panics() {
    for text in ["{", "[]", "{\"cycle\":1}", "null", "{\"\":\"\"}", "{\"cycle\":\"\\u0000\"}"] {
        let answer = isocat_playground::answer(text);
        assert!(answer.contains("\"problems\":[{"), "{text}: {answer}");
    }
    let description = isocat_playground::answer("");
    assert!(description.contains("\"presets\"") && description.contains("\"keys\""));
}

/// The file that the page shows is the segment that it ran.
#[test]
fn the_file_on_the_page_is_one_for_the_command() {
    let state =
        [("mode", "dc-shift-sync1"), ("sync1", "250us"), ("copy-time", "30us"), ("cable", "2.5m")];
    let answer = of(&state.iter().map(|(k, v)| ((*k).to_owned(), (*v).to_owned())).collect());
    let file = isocat::SegmentFile::parse("page.toml", &answer.file).expect("it is right");
    assert_eq!(file.subdevices.len(), 3);
    let report = isocat::run(&isocat::Scenario::from(file));
    assert_eq!(report.verdict, answer.verdict);
}

/// A key that stands for a key of a segment file has no value that the file would refuse.
#[test]
fn keys_keep_within_those_of_the_file() {
    let mut keys = 0;
    for key in KEYS.iter() {
        let Some(path) = key.of else { continue };
        keys += 1;
        match (&key.kind, in_file(path).key.kind) {
            // In the other part of the page, these keys only stand for registers.
            (Kind::Duration { .. }, _) if key.views.len() > 1 && key.name != "cycle" => {}
            (Kind::Duration { least, most, .. }, Declared::Duration { least: l, most: m, .. }) => {
                assert!(*least >= l.at(LONGEST_CYCLE) && *most <= m.at(LONGEST_CYCLE), "{path}");
            }
            (Kind::Length { least, most }, Declared::Length { least: l, most: m })
            | (Kind::Count { least, most }, Declared::Integer { least: l, most: m }) => {
                assert!(*least >= l && *most <= m, "{path}");
            }
            (Kind::Rate { most }, Declared::Rate { least, most: m }) => {
                assert!(*most <= m && -most >= least, "{path}");
            }
            (Kind::Choice { choices }, Declared::Choice(words)) => {
                let words = words.0.words();
                let known = |word: &str| words.iter().any(|(known, _)| *known == word);
                assert!(choices.iter().all(|(word, _)| known(word)), "{path}");
                assert_eq!(choices.len(), words.len(), "{path}: the page has them all");
            }
            (Kind::Choice { .. }, Declared::Boolean | Declared::Either(_)) => {}
            (kind, declared) => panic!("{path}: {kind:?} for {declared:?}"),
        }
    }
    assert_eq!(keys, 19);
}
