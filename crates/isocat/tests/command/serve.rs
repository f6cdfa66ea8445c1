//! `isocat serve`, `run` and `watch` refuse what they can not be used on with exit code 2 and the
//! reason.
#![cfg(target_os = "linux")]

use std::path::Path;
use std::process::{Command, Output};

/// A ring of three.
const RING: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/faults/ring.toml");

fn isocat(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_isocat")).args(arguments).output().expect("it starts")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

#[test]
fn what_can_not_be_served_on_is_told() {
    for (arguments, expected) in [
        (&["serve"][..], "--interface"),
        (&["serve", "nowhere.toml", "--interface", "lo"], "nowhere.toml"),
        (&["serve", "--setup-veth", "a name that is far too long"], "expected 1 to 11"),
        (&["serve", "--interface", "lo", "--netns", "no-such-namespace"], "no-such-namespace"),
        (&["serve", "--interface", "lo", "--secondary", "eth7"], "expected ring = true in it"),
        (&["serve", RING, "--interface", "lo"], "expected --secondary IF beside --interface lo"),
        (&["serve", RING, "--interface", "lo", "--secondary", "lo"], "expected another interface"),
        (&["run", RING, "--interface", "lo"], "is a ring, which has two ports"),
        (&["watch", RING, "--interface", "lo"], "is a ring, which has two ports"),
        (&["control", "no-such-if", "status"], "no isocat serves on no-such-if"),
    ] {
        let output = isocat(arguments);
        // Lines are broken where they are full, and paths are of any length.
        let message = text(&output.stderr).split_whitespace().collect::<Vec<_>>().join(" ");
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {message}");
        assert!(message.contains(expected), "{arguments:?}: {message}");
        assert!(!message.contains("panicked"), "{message}");
    }
}

#[test]
fn the_schema_of_the_summary_is_committed() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/serve-summary.schema.json");
    let now = serde_json::to_string_pretty(&isocat::serve::summary::schema()).expect("JSON") + "\n";
    if std::env::var_os("UPDATE_SCHEMA").is_some() {
        std::fs::write(&path, &now).expect("docs/ is writable");
    }
    let committed = std::fs::read_to_string(&path).expect("the schema is committed");
    assert_eq!(now, committed, "the summary changed: run with UPDATE_SCHEMA=1 and raise FORMAT");
}
