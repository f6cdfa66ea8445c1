//! The house rules that a test can keep: allowed imports, and words that must not appear.

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

/// Packages that do what no library wraps safely: system calls, and what C hands over.
const WITH_UNSAFE: [&str; 3] = ["host", "isocat-c", "virtual"];
const BELOW: [&str; 7] = ["wire", "sync", "esc", "subdevice", "lan925x", "maindevice", "sim"];
const CORE: [&str; 6] = ["wire", "sync", "esc", "subdevice", "lan925x", "maindevice"];

#[test]
fn no_clock_is_read_below_the_host() {
    let clocks =
        ["Instant::now", "SystemTime::", "time::SystemTime", "time::Instant", "clock_gettime"];
    let more = ["captures", "descriptions", "diagnose", "segment", "recorders"];
    for package in BELOW.into_iter().chain(more) {
        nowhere(&sources(&format!("crates/{package}")), &clocks, "`now` is an argument");
    }
}

/// Tests of `cargo test` that know the machine's clock, and why none of them is decided by it.
const WITH_A_CLOCK: [(&str, &str); 8] = [
    ("crates/host/src/clock.rs", "sleeping must not end early; how late it ends is not judged"),
    ("crates/host/src/preflight.rs", "counts wake-ups: one at least, none early"),
    ("crates/recorders/src/flight/tests.rs", "polls until a thread is done"),
    ("crates/serve/src/control/tests.rs", "limits of an hour, or of a moment that passes anyway"),
    ("crates/virtual/examples/subject.rs", "runs under supervision, where its clock is virtual"),
    ("crates/isocat/tests/command/invariants.rs", "names the words"),
    ("crates/isocat/tests/command/supervised.rs", "asks under supervision, where time is virtual"),
    ("crates/isocat/tests/running/watch.rs", "polls until a thread has told its status"),
];

/// A test that measures a duration, or waits for one, has another result on a slow, a fast or a
/// stalled machine. Such tests are run by `tests/wire.sh`.
#[test]
fn no_test_asks_the_machine_how_late_it_is() {
    let clocks = ["Instant::now", "SystemTime::now", ".elapsed()", "thread::sleep", "clock::now"];
    let known = |path: &Path| WITH_A_CLOCK.iter().any(|(known, _)| path.ends_with(known));
    let is_wire = |path: &Path| path.starts_with(root().join("crates/isocat/tests/wire"));
    let tests = sources("crates").into_iter().filter_map(|(path, text)| {
        let own = path.iter().any(|part| part == "tests" || part == "tests.rs");
        // In a file with code, what stands behind the head of its tests.
        let text = if own {
            Some(text)
        } else {
            text.split_once("#[cfg(test)]\nmod tests {").map(|(_, t)| t.into())
        };
        text.map(|text| (path, text))
    });
    let tests: Vec<_> = tests.filter(|(path, _)| !known(path) && !is_wire(path)).collect();
    nowhere(&tests, &clocks, "a test is decided by counts, or belongs to crates/isocat/tests/wire");
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
    for (package, _) in ARROWS.iter().filter(|(package, _)| !CORE.contains(package)) {
        let level = if WITH_UNSAFE.contains(package) { "deny" } else { "forbid" };
        let path = root().join(format!("crates/{package}/src/lib.rs"));
        let text = fs::read_to_string(path).expect("a crate has a lib.rs");
        assert!(
            text.contains(&format!("#![{level}(unsafe_code)]")),
            "{package} allows unsafe code"
        );
    }
    for package in WITH_UNSAFE {
        // Tests of a library for C call what C calls.
        let is_test = |path: &Path| path.iter().any(|part| part == "tests" || part == "tests.rs");
        let elsewhere: Vec<_> = sources(&format!("crates/{package}/src"))
            .into_iter()
            .filter(|(path, _)| !path.ends_with("src/sys.rs") && !path.ends_with("src/lib.rs"))
            .filter(|(path, _)| !is_test(path))
            .collect();
        nowhere(&elsewhere, &["unsafe_code", "unsafe {"], "what is unsafe stands in sys.rs");
    }
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

/// The arrows of the house, all of them, tests aside: what each package may depend on. A package
/// that is not named here may not be.
const ARROWS: [(&str, &[&str]); 23] = [
    ("wire", &[]),
    ("captures", &["wire"]),
    ("sync", &["wire"]),
    ("rules", &["wire", "sync"]),
    ("esc", &["wire"]),
    ("subdevice", &["wire", "sync", "esc"]),
    ("lan925x", &["esc"]),
    ("maindevice", &["wire", "sync", "rules"]),
    ("host", &["wire", "maindevice"]),
    ("sim", &["wire", "sync", "rules", "esc", "subdevice", "maindevice"]),
    ("virtual", &["wire", "sim"]),
    ("descriptions", &["wire"]),
    (
        "segment",
        &["wire", "sync", "rules", "esc", "subdevice", "maindevice", "sim", "descriptions"],
    ),
    ("recorders", &["wire", "sync", "subdevice", "maindevice", "sim"]),
    ("diagnose", &["wire", "sync", "rules", "captures", "descriptions"]),
    ("conform", &["wire", "sync", "subdevice", "host", "sim", "descriptions", "segment"]),
    (
        "engine",
        &[
            "wire",
            "sync",
            "rules",
            "esc",
            "subdevice",
            "maindevice",
            "host",
            "sim",
            "descriptions",
            "segment",
            "recorders",
            "captures",
            "diagnose",
            "conform",
        ],
    ),
    (
        "serve",
        &["wire", "sync", "rules", "subdevice", "host", "sim", "descriptions", "segment", "engine"],
    ),
    (
        "player",
        &[
            "wire",
            "sync",
            "maindevice",
            "host",
            "sim",
            "descriptions",
            "segment",
            "engine",
            "serve",
        ],
    ),
    ("isocat-c", &["wire", "sim", "subdevice", "descriptions", "segment", "engine", "serve"]),
    ("testing", &["wire", "subdevice", "sim", "descriptions", "segment", "serve"]),
    (
        "isocat",
        &[
            "wire",
            "sync",
            "esc",
            "maindevice",
            "host",
            "sim",
            "descriptions",
            "segment",
            "recorders",
            "captures",
            "diagnose",
            "engine",
            "conform",
            "serve",
            "player",
            "virtual",
        ],
    ),
    // A workspace of its own, and the whole for programs in Python.
    ("isocat-py", &["wire", "subdevice", "sim", "descriptions", "segment", "recorders", "engine"]),
];

#[test]
fn packages_depend_only_on_those_above() {
    let mut packages: Vec<String> = fs::read_dir(root().join("crates"))
        .expect("the packages")
        .map(|entry| entry.expect("a readable folder").file_name().to_string_lossy().into_owned())
        .collect();
    packages.sort();
    let mut named: Vec<&str> = ARROWS.iter().map(|(package, _)| *package).collect();
    named.sort_unstable();
    assert_eq!(packages, named, "every package has its arrows");
    for (package, allowed) in ARROWS {
        let place = ARROWS.iter().position(|(name, _)| *name == package);
        for above in allowed {
            let above = ARROWS.iter().position(|(name, _)| name == above);
            assert!(above < place, "{package} stands above {allowed:?}");
        }
        for name in dependencies(package) {
            if let Some(ours) = name.strip_prefix("isocat-") {
                assert!(allowed.contains(&ours), "{package} must not depend on {ours}");
            } else if BELOW.contains(&package) {
                let chance = package == "sim" && name.starts_with("rand");
                let bus = package == "lan925x" && name == "embedded-hal";
                // The lock that lets a MainDevice move to another thread, without std and without
                // unsafe code of ours.
                let lock = package == "maindevice" && name == "spin";
                // The sine of a motion, without std, and with the same bits on every platform.
                let sine = package == "maindevice" && name == "libm";
                // Behind a feature: a program's own log gets the events.
                let log = package == "maindevice" && name == "tracing";
                assert!(
                    chance || bus || lock || sine || log,
                    "{package} depends on {name}; core packages stand alone"
                );
            }
        }
        for above in allowed {
            let used =
                dependencies(package).any(|name| name.strip_prefix("isocat-") == Some(above));
            assert!(used, "{package} may depend on {above} and does not: the arrow is not needed");
        }
    }
}

/// What a package depends on, on whatever target; tests aside.
fn dependencies(package: &str) -> impl Iterator<Item = String> {
    let manifest = fs::read_to_string(root().join(format!("crates/{package}/Cargo.toml")))
        .expect("a package has a manifest");
    let manifest: toml::Table = manifest.parse().expect("a manifest is TOML");
    let mut tables = vec![manifest.clone()];
    if let Some(targets) = manifest.get("target").and_then(toml::Value::as_table) {
        tables.extend(targets.values().filter_map(toml::Value::as_table).cloned());
    }
    let names = tables.into_iter().filter_map(|table| {
        let dependencies = table.get("dependencies")?.as_table()?.keys().cloned();
        Some(dependencies.collect::<Vec<String>>())
    });
    names.flatten().collect::<Vec<_>>().into_iter()
}

#[test]
fn nothing_is_left_over() {
    // Spelled so that this file does not find itself.
    let words =
        ["tod\u{6f}!(", "unimplemente\u{64}!(", "db\u{67}!(", "FIXM\u{45}", "#[ignor\u{65}]"];
    let all = sources("crates");
    nowhere(&all, &words, "no parked work");
    // A test that `cargo test` leaves out is run by another step, and says by which.
    let left_out = all
        .iter()
        .flat_map(|(_, text)| text.lines())
        .filter(|line| line.contains("#[ignor\u{65} "));
    let unknown: Vec<_> = left_out.filter(|line| !line.contains("tests/wire.sh runs it")).collect();
    assert_eq!(unknown, [""; 0], "no parked tests");
}

/// Packages that look at findings, states and plans: judges' documents, diagnoses and views.
const READERS: [&str; 8] = [
    "crates/diagnose/src",
    "crates/engine/src",
    "crates/serve/src",
    "crates/recorders/src",
    "crates/conform/src",
    "crates/host/src",
    "crates/isocat/src",
    "playground/src",
];

/// Where sentences are made that other code could search.
const SENTENCES: [&str; 9] = [
    "crates/diagnose/src/words.rs",
    "crates/engine/src/report/words.rs",
    "crates/rules/src/words.rs",
    "crates/engine/src/live/judge.rs",
    "crates/engine/src/status/verdict.rs",
    "crates/engine/src/diagnosis.rs",
    "crates/maindevice/src/change.rs",
    "crates/maindevice/src/error.rs",
    "crates/maindevice/src/alarm.rs",
];

/// The text literals of some Rust code that stand behind one of these words.
fn literals_behind<'a>(code: &'a str, words: &[&str]) -> Vec<&'a str> {
    let mut begins = Vec::new();
    for word in words {
        begins.extend(code.match_indices(word).map(|(at, _)| at + word.len()));
    }
    begins.into_iter().filter_map(|begin| code[begin..].split('"').next()).collect()
}

/// Nothing reads what we ourselves have put into words: what decides goes by types.
#[test]
fn nothing_searches_our_own_words() {
    let program = |text: &str| text.split("#[cfg(test)]").next().unwrap_or_default().to_owned();
    let sentences: Vec<String> = SENTENCES
        .iter()
        .map(|path| program(&fs::read_to_string(root().join(path)).expect("a readable file")))
        .collect();
    // Every second part between quotation marks is a literal.
    let sentences: Vec<&str> =
        sentences.iter().flat_map(|text| text.split('"').skip(1).step_by(2)).collect();
    assert!(sentences.iter().any(|what| what.contains("off the grid")), "{sentences:?}");
    let states = (0..=15).filter_map(|code| isocat_wire::AlState::try_from(code).ok());
    let names: Vec<&str> = (isocat_sync::SyncMode::ALL.iter().map(|mode| mode.name()))
        .chain(states.map(|state| state.name()))
        .chain(isocat_sync::Moment::ALL.iter().map(|moment| moment.name()))
        .chain(isocat_sync::budget::Check::OF_DEVICE.iter().map(|check| check.name()))
        .chain(isocat_maindevice::Stage::ALL.iter().map(|stage| stage.name()))
        .chain(isocat_sim::Kind::descriptions().map(|kind| kind.name))
        .chain(isocat::report::NoteKind::DESCRIPTIONS.iter().map(|kind| kind.name))
        .chain(["absent", "joining", "locked", "holdover", "in operation", "ended"])
        .collect();
    assert!(["OP", "free-run", "SYNC0", "cycles-skipped"].iter().all(|name| names.contains(name)));
    let mut found = Vec::new();
    for (path, text) in READERS.iter().flat_map(|folder| sources(folder)) {
        // Lines of logs are words of other programs.
        let of_logs = path.components().any(|part| part.as_os_str() == "lines");
        if of_logs || path.file_name().is_some_and(|name| name == "tests.rs") {
            continue;
        }
        let code = program(&text);
        let searched = literals_behind(
            &code,
            &[
                ".contains(\"",
                ".starts_with(\"",
                ".ends_with(\"",
                ".find(\"",
                ".split_once(\"",
                ".rsplit_once(\"",
                ".strip_prefix(\"",
                ".strip_suffix(\"",
            ],
        );
        // What is shorter than a word is punctuation.
        let ours = |what: &&str| what.len() > 3 && sentences.iter().any(|s| s.contains(*what));
        let compared = literals_behind(&code, &["== \"", "!= \""]);
        let named = |what: &&str| names.contains(what);
        let all = searched.into_iter().filter(ours).chain(compared.into_iter().filter(named));
        found.extend(all.map(|what| format!("{}: \"{what}\"", path.display())));
    }
    assert!(found.is_empty(), "go by the type, not by its words:\n{}", found.join("\n"));
}

/// Comments are as wide as the code, which rustfmt does not see to. Rows of tables, addresses and
/// blocks of code can't be broken.
#[test]
fn comments_keep_to_a_hundred_columns() {
    let mut too_wide = Vec::new();
    for folder in ["crates", "firmware", "fuzz", "playground", "tests", "docs/examples"] {
        for (path, text) in sources(folder) {
            if path.components().any(|part| part.as_os_str() == "target") {
                continue;
            }
            let mut in_code = false;
            for (number, line) in text.lines().enumerate() {
                let line = line.trim_end();
                let Some(comment) = line.trim_start().strip_prefix("//") else {
                    in_code = false;
                    continue;
                };
                let words = comment.trim_start_matches(['/', '!']).trim_start();
                in_code ^= words.starts_with("```");
                let whole = in_code || words.starts_with('|') || words.contains("://");
                let columns = line.chars().count();
                if columns > 100 && !whole {
                    too_wide.push(format!("{}:{}: {columns}", path.display(), number + 1));
                }
            }
        }
    }
    assert!(too_wide.is_empty(), "comments beyond 100 columns:\n{}", too_wide.join("\n"));
}
