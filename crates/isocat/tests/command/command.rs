//! The command as a user meets it: exit codes, words, files.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// Runs in the folder of [`scratch`], so that no message depends on where this checkout lies.
fn isocat(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_isocat"));
    command.current_dir(env!("CARGO_TARGET_TMPDIR")).args(arguments);
    command.output().expect("isocat starts")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).expect("isocat prints UTF-8")
}

/// A file of this test's own in the target directory; its name there.
fn scratch(name: &str, content: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    std::fs::write(&path, content).expect("the target directory is writable");
    PathBuf::from(name)
}

#[test]
fn without_arguments_the_built_in_segment_runs_in_sync() {
    let output = isocat(&[]);
    let report = text(&output.stdout);
    assert_eq!(output.status.code(), Some(0), "{report}{}", text(&output.stderr));
    assert!(report.starts_with("In sync: 3 of 5 SubDevices"), "{report}");
    let free_run = report.lines().find(|line| line.contains("EL2502-0010")).expect("its line");
    assert!(free_run.contains("free-run") && free_run.contains("OP"), "{free_run}");
    let widest = report.lines().map(|line| line.chars().count()).max();
    assert!(widest <= Some(100), "{widest:?} columns:\n{report}");
    assert!(!report.contains('\u{1b}'), "no escape codes into a pipe");
    assert_eq!(text(&output.stderr), "");
}

#[test]
fn one_seed_gives_one_report_and_another_seed_another() {
    let run = |seed| {
        let output = isocat(&["run", "--for", "300ms", "--json", "--seed", seed]);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        text(&output.stdout)
    };
    let (first, again, other) = (run("7"), run("7"), run("8"));
    assert_eq!(first, again);
    let json = |text: &str| serde_json::from_str::<serde_json::Value>(text).expect("JSON");
    let (first, other) = (json(&first), json(&other));
    assert_eq!(first["in_sync"], other["in_sync"]);
    let phase =
        |report: &serde_json::Value| report["segment"]["true_time"]["host_phase_error"].clone();
    assert_ne!(phase(&first), phase(&other));
}

#[test]
fn the_schema_of_the_report_is_committed() {
    is_committed("run-report.schema.json", &isocat::report::schema());
}

#[test]
fn the_schema_of_the_conformance_report_is_committed() {
    is_committed("conformance-report.schema.json", &isocat::conform::report::schema());
}

/// What a segment file expects decides: exit code, report and JUnit say the same, on both sides of
/// the edge.
#[test]
fn a_run_ends_by_what_is_expected_of_it() {
    let segment = |within: &str| {
        format!(
            "cycle = \"1ms\"\nfor = \"1s\"\n[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\nname = \"axis\"\n\
             [[fault]]\nat = \"in-operation + 100ms\"\nwhat = \"drop 1 out\"\n\
             [[expect]]\nblames = \"axis\"\nrecovers_within = \"{within}\"\n"
        )
    };
    // The pulse that finds nothing comes behind the frame, half a cycle later.
    for (within, code, failures) in [("500us", 1, "1"), ("2ms", 0, "0")] {
        let path = scratch("expect.toml", &segment(within));
        let path = path.to_str().expect("a name in UTF-8");
        let junit = Path::new(env!("CARGO_TARGET_TMPDIR")).join("expect.xml");
        let file = junit.to_str().expect("a path in UTF-8");
        let output = isocat(&["run", path, "--json", "--junit", file]);
        assert_eq!(output.status.code(), Some(code), "{}", text(&output.stderr));
        let report: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
        // A finding is a finding, expected or not.
        assert_eq!(report["in_sync"], false);
        let met: Vec<_> = (0..2).map(|at| report["expected"][at]["met"] == true).collect();
        assert_eq!(met, [code == 0, true], "{:#}", report["expected"]);
        assert_eq!(report["faults"][0]["at_ns"], 100_000_000);

        let xml = std::fs::read_to_string(&junit).expect("the file was written");
        let xml = roxmltree::Document::parse(&xml).unwrap_or_else(|error| panic!("{error}\n{xml}"));
        let suite = xml.descendants().find(|node| node.has_tag_name("testsuite")).expect("a suite");
        assert_eq!(
            (suite.attribute("tests"), suite.attribute("failures")),
            (Some("2"), Some(failures))
        );
    }
    let path = scratch("expect.toml", &segment("2ms"));
    let output = isocat(&["run", path.to_str().expect("UTF-8")]);
    assert!(text(&output.stdout).contains("Expected: 2 of 2 came so."), "{}", text(&output.stdout));
}

/// The grid of a sweep: a frontier in words and as a page, rows for other programs, and the edge of
/// a value.
#[test]
fn a_sweep_tells_its_grid_as_a_page_and_its_rows_as_parquet() {
    let segment = "cycle = \"1ms\"\nfor = \"50ms\"\n[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\n\
                   count = 2\n[[expect]]\nworst_sync0 = \"1ms\"\n";
    let path = scratch("page.toml", segment);
    let path = path.to_str().expect("a name in UTF-8");
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("sweep-page");
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).expect("a folder");
    let file = |name: &str| folder.join(name).to_str().expect("UTF-8").to_owned();
    let (rows, page) = (file("rows.parquet"), file("page.html"));
    let limits = "expect[0].worst_sync0=1ns,1ms";
    let grid = ["sweep", path, "--vary", limits, "--vary", "cycle=2ms,1ms", "--seeds", "3"];
    let output = isocat(&[&grid[..], &["--rows", &rows, "--page", &page]].concat());
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
    let told = text(&output.stdout);
    assert!(told.contains("cycle 1ms"), "values in their order: {told}");
    assert!(told.contains("1ms and above"), "{told}");
    let bytes = std::fs::read(&rows).expect("rows");
    assert!(bytes.starts_with(b"PAR1") && bytes.ends_with(b"PAR1"));
    let html = std::fs::read_to_string(&page).expect("a page");
    assert!(html.contains("<td>1ms and above</td>") || html.contains(">1ms and above<"), "{html}");
    assert_eq!(html.matches("3 of 3 runs").count(), 2, "points that hold");
    assert_eq!(html.matches("0 of 3 runs").count(), 2, "points that do not");

    let refused = isocat(&[&grid[..], &["--rows", &rows, "--resume"]].concat());
    assert_eq!(refused.status.code(), Some(2));
    assert!(text(&refused.stderr).contains("Parquet"), "{}", text(&refused.stderr));

    let edge = |range: &str| {
        let output = isocat(&["sweep", path, "--bisect", range, "--seeds", "2", "--json"]);
        let found: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
        (output.status.code(), found["edges"].as_array().expect("a list").len())
    };
    assert_eq!(edge("expect[0].worst_sync0=1ns..10us"), (Some(1), 1));
    assert_eq!(edge("expect[0].worst_sync0=500us..1000us"), (Some(0), 0));
}

/// A sweep tells rows, totals and what failed; it goes on where it was cut off, and what it kept
/// fails again.
#[test]
fn a_sweep_can_be_cut_off_and_what_fails_is_kept() {
    let segment = "cycle = \"1ms\"\nfor = \"100ms\"\n[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\n\
                   [[subdevice]]\ndevice = \"simple_io16\"\n[[fault]]\nat = \"in-operation + 20ms\"\n\
                   what = \"sync-off 0\"\nchance = \"50%\"\n";
    let path = scratch("sweep.toml", segment);
    let path = path.to_str().expect("a name in UTF-8");
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("sweep");
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).expect("a folder");
    let rows = folder.join("rows.csv");
    let (rows, failed) = (rows.to_str().expect("UTF-8"), folder.join("failed"));
    let failed = failed.to_str().expect("UTF-8");
    let sweep = |more: &[&str]| {
        let vary = "host.jitter=5us,10us";
        let mut words = vec!["sweep", path, "--vary", vary, "--seeds", "8", "--rows", rows];
        words.extend(more);
        isocat(&words)
    };
    let output = sweep(&["--failed", failed, "--shrink", "--json"]);
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
    let totals: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let good = totals["as_expected"].as_u64().expect("a number");
    assert_eq!(totals["runs"], 16);
    assert!((1..16).contains(&good), "{totals}");
    let whole = std::fs::read_to_string(rows).expect("the file was written");
    assert_eq!(whole.lines().count(), 17);
    assert_eq!(whole.matches(",true,").count() as u64, good);

    // Cut off in the middle of a row.
    let cut = whole.match_indices('\n').nth(9).expect("ten lines").0 + 12;
    std::fs::write(rows, &whole[..cut]).expect("it is written");
    let refused = sweep(&[]);
    assert_eq!(refused.status.code(), Some(2));
    assert!(text(&refused.stderr).contains("is there already"), "{}", text(&refused.stderr));
    sweep(&["--resume"]);
    assert_eq!(std::fs::read_to_string(rows).expect("it is there"), whole);

    let kept: Vec<_> = std::fs::read_dir(failed).expect("a folder").flatten().collect();
    assert_eq!(kept.len() as u64, 16 - good);
    let kept = kept[0].path();
    let small = std::fs::read_to_string(&kept).expect("a file");
    assert_eq!(small.matches("[[subdevice]]").count(), 1, "{small}");
    assert_eq!(isocat(&["run", kept.to_str().expect("UTF-8")]).status.code(), Some(1));
}

#[test]
fn conform_tells_what_it_found_in_every_format() {
    let junit = Path::new(env!("CARGO_TARGET_TMPDIR")).join("conform.xml");
    let path = junit.to_str().expect("a path in UTF-8");
    let segment = "cycle = \"1ms\"\n[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\n\
                   misbehave = [\"wrong-value 1C33:05 1\"]\n";
    let broken = scratch("conform.toml", segment);
    let broken = broken.to_str().expect("a name in UTF-8");
    let output = isocat(&["conform", broken, "--rule", "OBJ", "--junit", path]);
    let report = text(&output.stdout);
    assert_eq!(output.status.code(), Some(1), "{report}{}", text(&output.stderr));
    assert!(report.contains("FAIL  OBJ-09"), "{report}");
    assert!(report.contains("0x1C33:05: expected 250000, found 1"), "{report}");
    let widest = report.lines().map(|line| line.chars().count()).max();
    assert!(widest <= Some(100), "{widest:?} columns:\n{report}");

    let xml = std::fs::read_to_string(&junit).expect("the file was written");
    let xml = roxmltree::Document::parse(&xml).unwrap_or_else(|error| panic!("{error}\n{xml}"));
    let named = |name| xml.descendants().filter(move |node| node.has_tag_name(name));
    assert_eq!(named("testsuite").count(), 1);
    assert_eq!(named("testcase").count(), 16);
    let failures: Vec<_> = named("failure").filter_map(|node| node.parent()).collect();
    assert_eq!(failures.len(), 1);
    assert!(failures[0].attribute("name").is_some_and(|name| name.starts_with("OBJ-09")));
    let suite = named("testsuite").next().expect("a suite");
    assert_eq!(suite.attribute("failures"), Some("1"));

    let output = isocat(&["conform", "simple_io4", "--json"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(report["passed"], true);
    let rules = report["devices"][0]["rules"].as_array().expect("rules");
    assert!(rules.iter().any(|rule| rule["id"] == "AL-04" && rule["verdict"] == "pass"));
}

#[test]
fn conform_lists_its_rules_and_refuses_what_it_does_not_know() {
    let output = isocat(&["conform", "--list", "--rule", "CNT-03"]);
    assert_eq!(output.status.code(), Some(0));
    assert!(text(&output.stdout).starts_with("CNT-03"), "{}", text(&output.stdout));
    for (arguments, expected) in [
        (&["conform", "kollmorgen_akd2"][..], "kollmorgen_akd2g"),
        (&["conform"], "a device or a segment file is needed"),
        (&["conform", "simple_io4", "--rule", "CNT-99"], "unknown rule"),
        (&["conform", "no-such-file.toml"], "no-such-file.toml"),
    ] {
        let output = isocat(arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        let message = text(&output.stderr);
        assert!(message.contains(expected), "{arguments:?}: {message}");
    }
}

#[test]
fn faults_in_a_segment_file_are_named() {
    for (fault, expected) in [
        ("dead-synco", "dead-sync0"),
        ("missed-copy", "missed-copy 3"),
        ("missed-copy 0", "missed-copy 3"),
        ("dead-sync0 1", "dead-sync0"),
        ("wrong-value 1C32 1", "wrong-value 1C32:05 7"),
    ] {
        let segment = format!(
            "cycle = \"1ms\"\n[[subdevice]]\ndevice = \"simple_io4\"\nmisbehave = [\"{fault}\"]\n"
        );
        let file = scratch("misbehave.toml", &segment);
        let output = isocat(&["conform", file.to_str().expect("a name in UTF-8")]);
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{message}");
        assert!(message.contains(expected) && message.contains("misbehave.toml:4"), "{message}");
    }
}

#[test]
fn the_schema_of_the_status_is_committed() {
    is_committed("status.schema.json", &isocat::status::schema());
}

#[cfg(target_os = "linux")]
#[test]
fn the_schema_of_the_interface_report_is_committed() {
    is_committed("interface-report.schema.json", &isocat::report::interface::schema());
}

fn is_committed(name: &str, schema: &serde_json::Value) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs").join(name);
    let now = serde_json::to_string_pretty(schema).expect("JSON") + "\n";
    if std::env::var_os("UPDATE_SCHEMA").is_some() {
        std::fs::write(&path, &now).expect("docs/ is writable");
    }
    let committed = std::fs::read_to_string(&path).expect("the schema is committed");
    assert_eq!(now, committed, "the report changed: run with UPDATE_SCHEMA=1 and raise FORMAT");
    // Every part is closed and complete: no key may be added or left out unnoticed.
    let schema: serde_json::Value = serde_json::from_str(&committed).expect("JSON");
    let parts = schema["$defs"].as_object().expect("parts").values().chain([&schema]);
    for part in parts {
        assert_eq!(part["additionalProperties"], false, "{part}");
        let keys = part["properties"].as_object().expect("keys");
        assert_eq!(part["required"].as_array().map_or(0, Vec::len), keys.len(), "{part}");
        assert!(keys.values().all(|key| key["description"].is_string()), "{part}");
    }
}

#[test]
fn a_cycle_below_the_devices_minimum_is_refused() {
    let segment =
        "cycle = \"125us\"\n\n[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\nmode = \"dc-sync0\"\n";
    for (name, content) in [
        ("too_short.toml", segment.to_owned()),
        ("too_short_any_mode.toml", segment.replace("mode = \"dc-sync0\"\n", "")),
    ] {
        let output = isocat(&["run", scratch(name, content.as_str()).to_str().unwrap()]);
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{message}");
        for expected in ["AKD2G", "0x1C32:05", "125 us", "250 us"] {
            assert!(
                message.to_uppercase().contains(&expected.to_uppercase()),
                "{expected}: {message}"
            );
        }
        assert_eq!(text(&output.stdout), "");
    }
}

#[test]
fn bad_files_are_refused_with_place_and_help() {
    let device = "[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\n";
    let cases = [
        ("unknown_device", "cycle = \"1ms\"\n[[subdevice]]\ndevice = \"kollmorgen_akd2\"\n".to_owned(), ["3:10", "kollmorgen_akd2g"]),
        ("unknown_mode", format!("cycle = \"1ms\"\n{device}mode = \"dc-sinc0\"\n"), ["4:8", "dc-sync0"]),
        ("no_unit", format!("cycle = \"1\"\n{device}"), ["1:9", "ms"]),
        ("zero", format!("cycle = \"0ms\"\n{device}"), ["1:9", "10 us"]),
        ("malformed", "cycle = \n".to_owned(), ["1:", "expected"]),
        ("unknown_key", format!("cycel = \"1ms\"\n{device}"), ["1:1", "cycle"]),
        ("absurd", format!("cycle = \"1ms\"\n{device}clock = \"5000000ppm\"\n"), ["4:9", "1000 ppm"]),
        ("empty", "cycle = \"1ms\"\n".to_owned(), ["subdevice", "expected"]),
        ("impossible_mode", "cycle = \"1ms\"\n[[subdevice]]\ndevice = \"beckhoff_el2502-0010\"\nmode = \"dc-sync0\"\n".to_owned(), ["4:8", "0x1C32:04"]),
    ];
    for (name, content, expected) in cases {
        let path = scratch(&format!("bad_{name}.toml"), &content);
        let output = isocat(&["run", path.to_str().unwrap()]);
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{name}: {message}");
        assert_eq!(text(&output.stdout), "", "{name}");
        assert!(message.contains(&format!("bad_{name}.toml")), "{name}: {message}");
        for expected in expected {
            assert!(message.contains(expected), "{name} lacks {expected}: {message}");
        }
        assert!(message.lines().count() <= 4, "{name}: {message}");
    }
}

#[test]
fn bad_flags_are_refused() {
    for arguments in [
        &["run", "--for", "10"][..],
        &["run", "--for", "0s"],
        &["run", "--for", "10us"],
        &["run", "--seed", "minus one"],
        &["run", "/no/such/file.toml"],
        &["run", "--report", "/no/such/folder/report.txt", "--for", "10ms"],
        &["run", "--capture", "/no/such/folder/run.pcapng"],
        &["run", "--tap", "2"],
        &["run", "--preflight", "--series", "run.csv"],
        &["walk"],
        &["devices", "kolmorgen"],
    ] {
        let output = isocat(arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(!output.stderr.is_empty(), "{arguments:?}");
    }
}

#[test]
fn files_that_can_not_be_had_are_refused_in_words() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let file = |name: &str| folder.join(name).to_str().expect("UTF-8").to_owned();
    let (capture, table, odd) = (file("refused.pcapng"), file("refused.csv"), file("refused.xlsx"));
    let wire = cfg!(target_os = "linux");
    for (arguments, words) in [
        (&["--capture", &capture, "--tap", "5"][..], "expected a position from 0 to 4"),
        (&["--series", &odd], "expected .csv or .parquet, found \"xlsx\""),
        (&["--trace", &table, "--series", &table], "would overwrite --trace"),
        (&["--capture", &table, "--series", &table], "would overwrite --capture"),
        (
            &["--trace", "/no/such/folder/run"],
            "the trace file /no/such/folder/run can't be written",
        ),
        (&["--series", "/no/such/folder/run.csv"], "the series file /no/such/folder/run.csv can't"),
        (&["--interface", "lo", "--trace", &capture], "pulses and steps of real devices"),
        (&["--interface", "lo", "--series", &table], "true time, which real devices do not tell"),
        (
            &["--interface", "lo", "--tap", "1", "--capture", &capture],
            "frames between real devices",
        ),
    ] {
        if arguments[0] == "--interface" && !wire {
            continue;
        }
        let output = isocat(&[&["run"], arguments].concat());
        let message = text(&output.stderr).split_whitespace().collect::<Vec<_>>().join(" ");
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {message}");
        assert!(message.contains(words), "{arguments:?}: {message}");
        for path in [&capture, &table, &odd] {
            assert!(!Path::new(path).exists(), "{arguments:?} leaves {path}");
        }
    }
}

#[test]
fn devices_lists_what_a_description_holds() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/esi/box.xml");
    let output = isocat(&["devices", path]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let list = text(&output.stdout);
    for expected in [
        "Nobody (vendor 0x00000b0c), UTF-8, 6 devices, 2 modules",
        "Drive  revision 0x00010000  Drive with everything",
        "  opmode 1 \"DC\"  0x0300  DC with SYNC0",
        "  first-opmode-without-dc line ",
        "Drive  revision 0x00000001  Drive, old  (hidden by a newer one)",
        "  not simulated: placeholder",
    ] {
        assert!(list.contains(expected), "{expected}\n{list}");
    }
    let output = isocat(&["devices", "/no/such/file.xml"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("can't be read"), "{}", text(&output.stderr));
}

#[test]
fn the_example_segment_runs_and_help_teaches_by_example() {
    let example = isocat(&["example"]);
    let path = scratch("example.toml", &text(&example.stdout));
    let output = isocat(&["run", path.to_str().unwrap(), "--for", "20ms"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let help = isocat(&["--help"]);
    assert_eq!(help.status.code(), Some(0));
    assert!(text(&help.stdout).contains("Examples:"));
    let devices = text(&isocat(&["devices"]).stdout);
    assert_eq!(devices.lines().count(), isocat::profile::built_in_ids().count(), "{devices}");
    assert!(
        devices
            .starts_with("kollmorgen_akd2g             Kollmorgen AKD2G: free-run, sm, dc-sync0")
    );
}

/// A path is no name, and a description no segment: what was probably meant is told.
#[test]
fn a_file_of_another_kind_is_told_from_a_typing_error() {
    let xml = scratch("nobody.xml", "\u{feff}<?xml version=\"1.0\"?>\n<EtherCATInfo/>");
    let eni = scratch("network.xml", "<EtherCATConfig><Config/></EtherCATConfig>");
    let toml = scratch("segment.toml", "cycle = \"1ms\"\n");
    let folder = env!("CARGO_TARGET_TMPDIR");
    let [xml, eni, toml] = [&xml, &eni, &toml].map(|path| path.to_str().unwrap());
    for (arguments, words) in [
        (["devices", folder], "is a folder; expected"),
        (["devices", toml], "A segment file is for isocat plan"),
        (["devices", "/nowhere/at/all"], "can't be read: No such file"),
        (["devices", "kollmorgen_akd2"], "did you mean \"kollmorgen_akd2g\"?"),
        (["plan", xml], "the root element is EtherCATInfo; expected EtherCATConfig"),
        (["plan", xml], "isocat devices"),
        (["run", eni], "isocat eni"),
        (["explain", "AL"], "a number must follow"),
    ] {
        let output = isocat(&arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        let found = text(&output.stderr).split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(found.contains(words), "{arguments:?}: {found}");
        assert_eq!(found.contains("unknown device"), arguments[1] == "kollmorgen_akd2", "{found}");
    }
}

#[test]
fn the_report_goes_to_a_file_as_text_or_json() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    for (name, start) in [("report.txt", "In sync"), ("report.json", "{")] {
        let path = folder.join(name);
        let output = isocat(&["run", "--for", "20ms", "--report", path.to_str().unwrap()]);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        let written = std::fs::read_to_string(path).expect("the report was written");
        assert!(written.starts_with(start), "{written}");
    }
}

/// 0 fits, 1 does not, 2 bad input; the same as JSON.
#[test]
fn the_plan_says_by_its_exit_code_whether_it_fits() {
    let built_in = isocat::SegmentFile::built_in_text();
    let late = built_in.replacen("for = \"10s\"", "for = \"100ms\"\nshift = \"80us\"", 1);
    let late = scratch("late.toml", late.as_str());
    let wrong = scratch("wrong.toml", "cycle = \"1ms\"\n");
    for (arguments, code, words) in [
        (vec!["plan"], 0, "Fits with assumptions: least slack"),
        (vec!["plan", "--prove", "--for", "50ms", "--suggest"], 0, "Proven: 50 ms"),
        (vec!["plan", late.to_str().unwrap()], 1, "Does not fit, because SubDevice 1"),
        (vec!["plan", late.to_str().unwrap(), "--prove"], 1, "Not proven"),
        (vec!["plan", "--start-up"], 0, "Start-up of built-in segment"),
        (vec!["plan", "--what-if=1", "--gone", "50ms"], 0, "\n cable to 1 "),
        (vec!["plan", late.to_str().unwrap(), "--what-if=0"], 1, "the way up failed: OP"),
    ] {
        let output = isocat(&arguments);
        assert_eq!(output.status.code(), Some(code), "{arguments:?} {}", text(&output.stderr));
        assert!(text(&output.stdout).contains(words), "{arguments:?}\n{}", text(&output.stdout));
        let json = isocat(&[&arguments[..], &["--json"]].concat());
        assert_eq!(json.status.code(), Some(code), "{arguments:?}");
        let value: serde_json::Value =
            serde_json::from_str(&text(&json.stdout)).expect("one JSON document");
        assert!(value["format"].is_string());
    }
    let output = isocat(&["plan", wrong.to_str().unwrap()]);
    assert_eq!((output.status.code(), text(&output.stdout).as_str()), (Some(2), ""));
    assert!(text(&output.stderr).contains("[[subdevice]]"), "{}", text(&output.stderr));
    for (arguments, words) in [
        (
            &["plan", "--what-if=0,nobody"][..],
            "no SubDevice \"nobody\"; expected names or positions",
        ),
        (&["plan", "--what-if=99"], "no SubDevice \"99\""),
        (&["plan", "--what-if", "--gone=60.000001s"], "expected 60 s at most"),
        (&["plan", "--gone=1s"], "--what-if"),
        (&["plan", "--seed=1"], "--prove|--what-if"),
    ] {
        let output = isocat(arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(text(&output.stderr).contains(words), "{arguments:?} {}", text(&output.stderr));
    }
}
