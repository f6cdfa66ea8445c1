//! `isocat calibrate` on the virtual segment tells the drift law that was set, and `plan` and `run`
//! take what it writes.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;

fn isocat(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_isocat")).args(arguments).output().expect("it starts")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// A segment of two drives whose drift loops keep this law.
fn segment(name: &str, law: &str, phase: u8) -> PathBuf {
    let folder = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("calibrate-cli");
    std::fs::create_dir_all(&folder).expect("a folder");
    let drive = |name: &str, clock: &str| {
        format!(
            "[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\nname = \"{name}\"\nclock = \"{clock}\"\n\
             cable = \"3m\"\n"
        )
    };
    let text = format!(
        "cycle = \"1ms\"\ndrift_law = \"{law}\"\ndrift_phase = {phase}\n\n{}\n{}",
        drive("first", "5ppm"),
        drive("second", "-12ppm")
    );
    let path = folder.join(format!("{name}.toml"));
    std::fs::write(&path, text).expect("a segment file");
    path
}

#[test]
fn the_virtual_segment_shows_what_was_set() {
    let path = segment("virtual", "hold", 11);
    let fragment = path.with_file_name("chip.toml");
    let chips = path.with_file_name("chips.toml").display().to_string();
    let (path, to) = (path.display().to_string(), fragment.display().to_string());
    let output = isocat(&["calibrate", &path, "--json", "--profile", &to, "--chips", &chips]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let value: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(value["format"], "isocat-calibration/2");
    assert_eq!(value["devices"][1]["law"]["name"], "hold");
    assert_eq!(value["devices"][1]["law"]["phase"], 11);
    let fragment = std::fs::read_to_string(&fragment).expect("a fragment");
    let keys =
        "[esc]\ndrift_law = \"hold\"\ndrift_phase = 11\ndifference_polarity = \"positive-ahead\"\n";
    assert!(fragment.ends_with(keys), "{fragment}");
    let people = isocat(&["calibrate", &path]);
    assert!(text(&people.stdout).contains("drift law        hold 11"), "{}", text(&people.stdout));
    taken_by_all(&path, &chips, "hold 11");
}

/// What was written is taken by `plan` and `run` of the same devices: without the segment file's
/// own law they behave as with it.
fn taken_by_all(path: &str, chips: &str, law: &str) {
    let written = std::fs::read_to_string(chips).expect("a file of chips");
    let (name, phase) = law.split_once(' ').expect("name and phase");
    let keys = format!("position = 1\ndrift_law = \"{name}\"\ndrift_phase = {phase}\n");
    assert!(written.contains(&keys), "{written}");
    let own = std::fs::read_to_string(path).expect("the segment file");
    let lines = own.lines().filter(|line| !line.starts_with("drift_"));
    let bare = chips.replace("chips.toml", "bare.toml");
    std::fs::write(&bare, lines.collect::<Vec<_>>().join("\n")).expect("a segment file");
    let json = |arguments: &[&str]| {
        let output = isocat(arguments);
        assert_eq!(output.status.code(), Some(0), "{arguments:?}: {}", text(&output.stderr));
        serde_json::from_slice::<Value>(&output.stdout).expect("JSON")
    };
    assert_eq!(
        json(&["plan", &bare, "--chips", chips, "--prove", "--for", "1s", "--json"])["fits"],
        true
    );
    // Each device's course in true time tells its law: the same with the file as with the law set
    // for all, and another one without.
    let run = |path: &str, more: &[&str]| {
        let mut arguments = vec!["run", path, "--for", "1s", "--json"];
        arguments.extend(more);
        let mut report = json(&arguments);
        // The lines of the two files differ.
        for device in report["devices"].as_array_mut().expect("devices") {
            device["line"].take();
        }
        report["devices"].to_string()
    };
    let only = chips.replace("chips.toml", "only.toml");
    let keys = format!("[[chip]]\ndrift_law = \"{name}\"\ndrift_phase = {phase}\n");
    std::fs::write(&only, keys).expect("a file of chips");
    assert_eq!(run(&bare, &["--chips", &only]), run(path, &[]), "of all devices");
    assert_ne!(run(&bare, &["--chips", chips]), run(&bare, &[]), "of those measured");
}

#[test]
fn chips_that_do_not_fit_are_refused() {
    let path = segment("chips", "hold", 10);
    let chips = path.with_file_name("other.toml");
    std::fs::write(&chips, "[[chip]]\nposition = 2\ndrift_law = \"block\"\n").expect("a file");
    let (path, chips) = (path.display().to_string(), chips.display().to_string());
    for verb in ["plan", "run"] {
        let output = isocat(&[verb, &path, "--chips", &chips]);
        assert_eq!(output.status.code(), Some(2));
        let error = text(&output.stderr).split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(error.contains("other.toml:2:") && error.contains("expected 0 to 1"), "{error}");
    }
}

#[test]
fn what_can_not_be_calibrated_is_told() {
    let path = segment("refused", "proportional", 9).display().to_string();
    let proportional = isocat(&["calibrate", &path]);
    assert_eq!(proportional.status.code(), Some(2));
    let error = text(&proportional.stderr);
    assert!(
        error.contains("drift_phase") && error.contains("expected the law hold or block"),
        "{error}"
    );
    let path = segment("device", "hold", 10).display().to_string();
    let nobody = isocat(&["calibrate", &path, "--profile", "/nonexistent/x.toml", "--device", "0"]);
    assert_eq!(nobody.status.code(), Some(2));
    let error = text(&nobody.stderr).split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(error.contains("position 0: no clock whose law and sign"), "{error}");
}

#[test]
fn the_schema_of_the_calibration_is_committed() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/calibration.schema.json");
    let now = isocat::report::calibrate::schema();
    let now = serde_json::to_string_pretty(&now).expect("JSON") + "\n";
    if std::env::var_os("UPDATE_SCHEMA").is_some() {
        std::fs::write(&path, &now).expect("docs/ is writable");
    }
    let committed = std::fs::read_to_string(&path).expect("the schema is committed");
    assert_eq!(now, committed, "the report changed: run with UPDATE_SCHEMA=1 and raise FORMAT");
}
