//! docs/examples/machine-in-ci, as somebody uses it: the folder is copied and its one command is
//! run, once as it is and once with a machine that can't hold what is expected of it.
#![cfg(unix)]

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn example() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/examples/machine-in-ci")
}

/// A copy of the folder whose machine is changed so.
fn copy(name: &str, change: impl FnOnce(String) -> String) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    // What an earlier run left.
    let _ = std::fs::remove_dir_all(&folder);
    // By a program of its own: a script that this one has open for writing, in any thread, can't be
    // run.
    let copied = Command::new("cp").arg("-r").arg(example()).arg(&folder).status();
    assert!(copied.expect("cp starts").success());
    // Results of a user who tried the example in place.
    let _ = std::fs::remove_dir_all(folder.join("results"));
    let path = folder.join("machine.toml");
    let machine = std::fs::read_to_string(&path).expect("it is there");
    std::fs::write(&path, change(machine)).expect("written");
    folder
}

/// The job as a CI runs it, with a sweep of few seeds.
fn job(folder: &Path) -> Output {
    Command::new(folder.join("ci.sh"))
        .env("ISOCAT", env!("CARGO_BIN_EXE_isocat"))
        .env("SEEDS", "2")
        .output()
        .expect("it starts")
}

/// What a test came to, by its name, as a reader of XML sees it; and the counts of the suite:
/// tests, failures, errors.
fn junit(folder: &Path) -> (Vec<(String, Option<String>)>, [String; 3]) {
    let path = folder.join("results/junit.xml");
    let text = std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{path:?}: {error}"));
    let document = roxmltree::Document::parse(&text).expect("XML");
    let suite = document.descendants().find(|node| node.has_tag_name("testsuite"));
    let suite = suite.expect("a suite");
    let tests = suite.children().filter(|node| node.has_tag_name("testcase")).map(|test| {
        let failure = test.children().find(|node| node.has_tag_name("failure"));
        let why = failure.and_then(|failure| failure.attribute("message")).map(str::to_owned);
        (test.attribute("name").expect("a name").to_owned(), why)
    });
    let count = |what: &str| suite.attribute(what).expect(what).to_owned();
    (tests.collect(), ["tests", "failures", "errors"].map(count))
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr)
}

#[test]
fn the_machine_holds_what_is_expected_of_it() {
    let folder = copy("machine-in-ci", |machine| machine);
    let output = job(&folder);
    assert_eq!(output.status.code(), Some(0), "{}", said(&output));
    let (tests, counts) = junit(&folder);
    assert_eq!(counts, ["5", "0", "0"]);
    assert!(tests.iter().all(|(_, failure)| failure.is_none()), "{tests:?}");
    let results = folder.join("results");
    let rows = std::fs::read_to_string(results.join("sweep.csv")).expect("rows");
    assert_eq!(rows.lines().count(), 1 + 2 * 2, "two seeds at each of two points");
    for page in ["run.html", "sweep.html"] {
        let text = std::fs::read_to_string(results.join(page)).expect(page);
        assert!(text.starts_with("<!DOCTYPE html>"), "{page}");
    }
    let kept = std::fs::read_dir(results.join("failed")).expect("a folder").count();
    assert_eq!(kept, 0, "no run failed");
}

/// With a cycle of 4 ms the reference time comes too seldom for the infeed's clock: the job fails,
/// says so in its JUnit, and the runs that failed are there to be repeated.
#[test]
fn a_machine_that_does_not_hold_it_fails_the_job() {
    let folder = copy("machine-in-ci-fails", |machine| {
        let changed = machine.replace("cycle = \"1ms\"", "cycle = \"4ms\"");
        assert_ne!(changed, machine);
        changed
    });
    let output = job(&folder);
    assert_eq!(output.status.code(), Some(1), "{}", said(&output));
    let (tests, counts) = junit(&folder);
    assert_eq!(counts, ["5", "1", "0"]);
    let failed: Vec<_> = tests.iter().filter(|(_, failure)| failure.is_some()).collect();
    let [(name, Some(why))] = &failed[..] else { panic!("{tests:?}") };
    assert!(name.starts_with("SYNC0 of SubDevice 2 (infeed) never more than"), "{name}");
    assert!(why.contains("off at SubDevice 2 (infeed)"), "{why}");
    let mut kept: Vec<_> = std::fs::read_dir(folder.join("results/failed"))
        .expect("runs that failed")
        .map(|entry| entry.expect("an entry").path())
        .collect();
    kept.sort();
    let again =
        Command::new(env!("CARGO_BIN_EXE_isocat")).arg("run").arg(&kept[0]).output().expect("runs");
    assert_eq!(again.status.code(), Some(1), "{}", said(&again));
}
