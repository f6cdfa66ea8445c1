//! The house rules that a test can keep: who may import what, and what stands nowhere.

use std::fs;
use std::path::{Path, PathBuf};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").canonicalize().expect("the workspace")
}

/// All Rust files below a folder of the workspace, with their text.
fn sources(folder: &str) -> Vec<(PathBuf, String)> {
    let mut files = Vec::new();
    let mut folders = vec![root().join(folder)];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display())) {
            let path = entry.expect("a readable folder").path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let text = fs::read_to_string(&path).expect("a readable file");
                files.push((path, text));
            }
        }
    }
    assert!(!files.is_empty(), "{folder} has sources");
    files
}

/// Fails with every place at which one of the words stands.
fn nowhere(files: &[(PathBuf, String)], words: &[&str], why: &str) {
    let mut found = Vec::new();
    for (path, text) in files {
        for (number, line) in text.lines().enumerate() {
            if words.iter().any(|word| line.contains(word)) {
                found.push(format!("{}:{}: {}", path.display(), number + 1, line.trim()));
            }
        }
    }
    assert!(found.is_empty(), "{why}:\n{}", found.join("\n"));
}

const BELOW: [&str; 7] = ["wire", "sync", "esc", "subdevice", "lan925x", "maindevice", "sim"];
const CORE: [&str; 6] = ["wire", "sync", "esc", "subdevice", "lan925x", "maindevice"];

#[test]
fn no_clock_is_read_below_the_command() {
    let clocks =
        ["Instant::now", "SystemTime::", "time::SystemTime", "time::Instant", "clock_gettime"];
    for package in BELOW {
        nowhere(&sources(&format!("crates/{package}")), &clocks, "`now` is an argument");
    }
}

#[test]
fn core_packages_are_no_std_and_free_of_unsafe() {
    for package in CORE {
        let path = root().join(format!("crates/{package}/src/lib.rs"));
        let text = fs::read_to_string(path).expect("a crate has a lib.rs");
        for attribute in ["#![no_std]", "#![forbid(unsafe_code)]"] {
            assert!(text.contains(attribute), "{package} lacks {attribute}");
        }
    }
    for (package, level) in [("sim", "forbid"), ("isocat", "deny")] {
        let path = root().join(format!("crates/{package}/src/lib.rs"));
        let text = fs::read_to_string(path).expect("a crate has a lib.rs");
        assert!(
            text.contains(&format!("#![{level}(unsafe_code)]")),
            "{package} allows unsafe code"
        );
    }
    let elsewhere: Vec<_> = sources("crates/isocat/src")
        .into_iter()
        .filter(|(path, _)| !path.ends_with("link/sys.rs") && !path.ends_with("isocat/src/lib.rs"))
        .collect();
    nowhere(&elsewhere, &["unsafe_code", "unsafe {"], "what is unsafe stands in link/sys.rs");
}

/// The model of the ESC and the physics of a run must not share formulas with the planner that they
/// judge.
#[test]
fn physics_do_not_know_the_planner() {
    nowhere(&sources("crates/esc"), &["isocat_sync", "isocat-sync"], "esc does not import sync");
    let physics: Vec<_> = sources("crates/sim/src")
        .into_iter()
        .filter(|(path, _)| !path.ends_with("run.rs") && !path.iter().any(|part| part == "judge"))
        .collect();
    nowhere(&physics, &["isocat_sync"], "physics do not import sync");
}

#[test]
fn neither_side_knows_the_other() {
    nowhere(
        &sources("crates/maindevice/src"),
        &["isocat_esc", "isocat_sim"],
        "a MainDevice sees no Esc",
    );
    let stack: Vec<_> = sources("crates/subdevice/src")
        .into_iter()
        .filter(|(path, _)| !path.iter().any(|part| part == "tests"))
        .collect();
    nowhere(
        &stack,
        &["isocat_wire::frame", "isocat_wire::datagram", "isocat_maindevice"],
        "a SubDevice sees no frames",
    );
}

/// The arrows of the house: what each package may depend on, tests aside.
#[test]
fn packages_depend_only_on_those_above() {
    let allowed = [
        ("wire", &[][..]),
        ("sync", &["wire"]),
        ("esc", &["wire"]),
        ("subdevice", &["wire", "sync", "esc"]),
        ("lan925x", &["esc"]),
        ("maindevice", &["wire", "sync"]),
        ("sim", &["wire", "sync", "esc", "subdevice", "maindevice"]),
    ];
    for (package, allowed) in allowed {
        let manifest = fs::read_to_string(root().join(format!("crates/{package}/Cargo.toml")))
            .expect("a package has a manifest");
        let dependencies = manifest.split("[dependencies]").nth(1).unwrap_or_default();
        let dependencies = dependencies.split("\n[").next().unwrap_or_default();
        for line in dependencies.lines() {
            let name = line.split(['.', ' ', '=']).next().unwrap_or_default();
            if let Some(ours) = name.strip_prefix("isocat-") {
                assert!(allowed.contains(&ours), "{package} must not depend on {ours}");
            } else if !name.is_empty() && !name.starts_with('#') {
                let chance = package == "sim" && name.starts_with("rand");
                let bus = package == "lan925x" && name == "embedded-hal";
                assert!(chance || bus, "{package} depends on {name}; core packages stand alone");
            }
        }
    }
}

#[test]
fn nothing_is_left_over() {
    // Spelled so that this file does not find itself.
    let words =
        ["tod\u{6f}!(", "unimplemente\u{64}!(", "db\u{67}!(", "FIXM\u{45}", "#[ignor\u{65}"];
    nowhere(&sources("crates"), &words, "no parked work");
}
