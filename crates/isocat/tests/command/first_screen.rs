//! What the command prints first where a segment is not in sync: cause and remedy, where the remedy
//! is written, and that it helps. And equal devices told as one.

use std::path::{Path, PathBuf};
use std::process::Command;

use isocat::recording::Recording;
use isocat::{Report, Scenario, SegmentFile};

/// A drive that copies its outputs later than it states: it refuses OP.
const LATE: &str = r#"cycle = "500us"
for = "100ms"
[[subdevice]]
device = "beckhoff_ek1100"
name = "coupler"
[[subdevice]]
device = "kollmorgen_akd2g"
name = "axis 1"
connect = "coupler:2"
copy_time = "400us"
[[subdevice]]
device = "kollmorgen_akd2g"
name = "axis 2"
[[subdevice]]
device = "simple_io16"
name = "io"
count = 12
"#;

struct Ran {
    text: String,
    report: serde_json::Value,
    code: Option<i32>,
}

/// Runs the command on this segment, in a folder of its own.
fn run(name: &str, text: &str, more: &[&str]) -> Ran {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("first_screen").join(name);
    std::fs::create_dir_all(&folder).expect("a folder");
    std::fs::write(folder.join("my.toml"), text).expect("it is written");
    let mut command = Command::new(env!("CARGO_BIN_EXE_isocat"));
    command.current_dir(&folder).args(["run", "my.toml", "--report", "run.json"]).args(more);
    let output = command.output().expect("it runs");
    let report = std::fs::read_to_string(folder.join("run.json")).expect("a report");
    Ran {
        text: String::from_utf8(output.stdout).expect("text"),
        report: serde_json::from_str(&report).expect("JSON"),
        code: output.status.code(),
    }
}

fn golden(name: &str, text: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/run").join(name);
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        std::fs::create_dir_all(path.parent().expect("a folder")).expect("it is made");
        std::fs::write(&path, text).expect("it is written");
    }
    let expected = std::fs::read_to_string(&path).unwrap_or_default();
    assert_eq!(text, expected, "{name}: UPDATE_GOLDEN=1 rewrites it");
}

/// What stands in quotes behind a key: in the first remedy that has it.
fn value<'a>(remedies: &'a str, key: &str) -> &'a str {
    let behind = remedies.split(&format!("{key} = \"")).nth(1);
    behind.and_then(|rest| rest.split('"').next()).unwrap_or_else(|| panic!("{key}: {remedies}"))
}

#[test]
fn a_way_up_that_fails_says_why_and_what_to_do() {
    let ran = run("late", LATE, &[]);
    assert_eq!(ran.code, Some(1));
    golden("late.txt", &ran.text);
    assert!(ran.text.lines().all(|line| line.chars().count() <= 100));
    let screen: Vec<&str> = ran.text.lines().take(24).collect();
    let place = |what: &str| screen.iter().position(|line| line.contains(what));
    assert!(place("Cause:") < place("Remedy:") && place("Cause:").is_some(), "{screen:#?}");
    let told = &ran.report["diagnoses"][0];
    assert_eq!(told["position"], 1);
    let remedies = told["remedies"].to_string().replace("\\\"", "\"");
    // The lines that it names stand where it names them, and each of the two cures.
    assert!(remedies.contains("in the head of my.toml: shift"), "{remedies}");
    assert!(remedies.contains("in [[subdevice]] \"axis 1\" (line 6 of my.toml): calc_copy"));
    assert_eq!(LATE.lines().nth(5), Some("[[subdevice]]"));
    let calc_copy = format!("calc_copy = \"{}\"\n", value(&remedies, "calc_copy"));
    let copies = "copy_time = \"400us\"\n";
    let stated = LATE.replace(copies, &calc_copy);
    assert_eq!(run("stated", &stated, &[]).code, Some(0), "{calc_copy}");
    for shift in remedies.split("shift = \"").skip(1) {
        let (shift, _) = shift.split_once('"').expect("it ends");
        let later = format!("shift = \"{shift}\"\n{LATE}");
        assert_eq!(run("later", &later, &[]).code, Some(0), "{shift}");
    }
}

#[test]
fn the_page_the_text_and_json_have_the_same_causes() {
    let alone = run("alone", LATE, &[]);
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("first_screen/alone");
    let page = Command::new(env!("CARGO_BIN_EXE_isocat"))
        .current_dir(&folder)
        .args(["run", "my.toml", "--report", "run.html"])
        .output()
        .expect("it runs");
    // With a page the run is recorded at once, without one it is run again: both are the same run.
    assert_eq!(String::from_utf8_lossy(&page.stdout), alone.text);
    let page = std::fs::read_to_string(folder.join("run.html")).expect("a page");
    let diagnoses = alone.report["diagnoses"].as_array().expect("a list");
    let words = diagnoses.iter().flat_map(|told| {
        let lists = ["causes", "remedies"].map(|key| told[key].as_array().expect("a list"));
        lists.into_iter().flatten().map(|words| words.as_str().expect("text"))
    });
    for words in words {
        let escaped = words.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
        assert!(page.contains(&escaped.replace('"', "&quot;")), "{words}");
    }
}

#[test]
fn a_loss_in_operation_says_why_too_and_a_good_run_nothing() {
    let lost = LATE.replace("copy_time = \"400us\"\n", "")
        + "[[fault]]\nat = \"in-operation + 50ms\"\nwhat = \"misbehave 1 dead-sync0 for 5ms\"\n";
    let lost = run("lost", &lost, &[]);
    assert_eq!(lost.code, Some(1));
    golden("lost.txt", &lost.text);
    let good = run("good", &LATE.replace("copy_time = \"400us\"\n", ""), &[]);
    assert_eq!(good.code, Some(0));
    golden("good.txt", &good.text);
    assert_eq!(good.report["diagnoses"].as_array().map(Vec::len), Some(0));
    assert!(!good.text.contains("Cause") && !good.text.contains("closer"), "{}", good.text);
}

/// Causes that lie outside of the SubDevice with the finding, each beside a segment that is right
/// in the same place.
#[test]
fn what_others_do_to_a_device_is_told_as_theirs() {
    const PAIR: &str = "cycle = \"1ms\"\nfor = \"3s\"\n[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\nname = \"near\"\n\
                        [[subdevice]]\ndevice = \"kollmorgen_akd2g\"\nname = \"far\"\n";
    let why = |name: &str, text: &str| run(name, text, &[]).report["diagnoses"].to_string();
    // A host that leads the clocks and is late, one that leads and is not, and one that follows.
    let slow = "[[fault]]\nat = \"in-operation + 500ms\"\nwhat = \"slow-send 200us 400us 3%\"\n";
    let leads = format!("direction = \"drive-reference\"\n{PAIR}");
    let told = why("leads-late", &format!("{leads}{slow}"));
    assert!(told.contains("follow-reference") && told.contains("The host leads"), "{told}");
    assert_eq!(why("leads", &leads), "[]");
    let told = why("follows-late", &format!("{PAIR}{slow}"));
    assert!(!told.contains("follow-reference"), "{told}");
    // Ways out and back that differ, and equal ones.
    let fibre = format!("{PAIR}cable = \"900m\"\nfibre = true\n");
    let told = why("unequal", &format!("{fibre}cable_asymmetry = \"3us\"\n"));
    assert!(told.contains("out and back differ"), "{told}");
    assert_eq!(why("equal", &fibre), "[]");
    // One way of a cable that is dead: between these two, and before all of them.
    let broken = |at: &str| {
        format!("{PAIR}[[fault]]\nat = \"in-operation + 500ms\"\nwhat = \"break {at} out\"\n")
    };
    let told = why("dead-between", &broken("far"));
    assert!(told.contains("dead behind SubDevice 0 (near)"), "{told}");
    let told = why("dead-before", &broken("near"));
    assert!(told.contains("the first cable") && !told.contains("dead behind"), "{told}");
}

/// Rows of the first table that begin with this place.
fn rows(text: &str) -> Vec<String> {
    let table = text.split("0B 0C 0D 20\n").nth(1).unwrap_or_default();
    let rows = table.lines().take_while(|line| line.starts_with(' ') && !line.starts_with("  "));
    rows.map(|row| row.split_whitespace().collect::<Vec<_>>().join(" ")).collect()
}

#[test]
fn equal_neighbours_are_one_row_from_three_on() {
    let head = "cycle = \"1ms\"\nfor = \"50ms\"\n[[subdevice]]\ndevice = \"beckhoff_ek1100\"\n";
    let of = |count: usize| {
        let io =
            format!("[[subdevice]]\ndevice = \"simple_io16\"\nname = \"io\"\ncount = {count}\n");
        let axis = "[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\nname = \"axis\"\n";
        let connect = "[[subdevice]]\ndevice = \"simple_io16\"\nname = \"first\"\nconnect = \"beckhoff_ek1100 0:2\"\n";
        let scenario = SegmentFile::parse("my.toml", &format!("{head}{connect}{axis}{io}"));
        let report = isocat::run(&Scenario::from(scenario.expect("it is right")));
        (rows(&anstream::adapter::strip_str(&report.text()).to_string()), report)
    };
    let (two, _) = of(2);
    assert_eq!(two.len(), 5, "{two:#?}");
    let (three, report) = of(3);
    assert_eq!(three.len(), 4, "{three:#?}");
    assert!(three[3].starts_with("3 to 5 io 0..2 (3) sm 1 ms OP"), "{three:#?}");
    // The first is equal, too, but a drive stands between them. All are in the document.
    assert!(three[1].starts_with("1 first"), "{three:#?}");
    let all = serde_json::to_value(&report).expect("JSON");
    assert_eq!(all["devices"].as_array().map(Vec::len), Some(6));
    let (thirty, _) = of(30);
    assert_eq!(thirty.len(), 4, "{thirty:#?}");
    assert!(thirty[3].starts_with("3 to 32 io 0..29 (30)"), "{thirty:#?}");
}

#[test]
fn a_row_of_several_has_the_worst_of_their_figures() {
    let text = "cycle = \"1ms\"\nfor = \"100ms\"\n[[subdevice]]\ndevice = \"model_every_mode\"\nname = \"m\"\nmode = \"dc-sync0\"\n\
                clock = \"0ppm\"\ncount = 6\n";
    let report = isocat::run(&Scenario::from(SegmentFile::parse("my.toml", text).expect("right")));
    assert!(report.in_sync, "{}", report.verdict);
    let plain = anstream::adapter::strip_str(&report.text()).to_string();
    let row = rows(&plain);
    // The reference clock stands alone.
    assert_eq!(row.len(), 2, "{row:#?}");
    let seen = || report.devices[1..].iter().map(|device| &device.true_time);
    let error = seen().map(|seen| seen.sync0_error.expect("SYNC0").worst_ns).fold(0.0, f64::max);
    let margins = seen().map(|seen| seen.sync0_margin.expect("outputs").min_ns);
    let margin = margins.fold(f64::INFINITY, f64::min);
    assert!(row[1].contains(&format!(" {error:.1} ")), "{error}: {row:#?}");
    assert!(row[1].contains(&format!(" {:.3} us", margin.floor() / 1e3)), "{margin}: {row:#?}");
    let ages = seen().map(|seen| seen.outputs_age.expect("outputs").max_ns).fold(0.0, f64::max);
    let table = plain.split("age of outputs").nth(1).expect("the table");
    assert!(table.contains(&format!("{:.3}", ages / 1e3)), "{ages}: {table}");
}

/// One that is told to be wrong is not hidden among those that are right.
#[test]
fn a_device_with_a_finding_is_no_part_of_a_row() {
    let text = "cycle = \"1ms\"\nfor = \"100ms\"\n[[subdevice]]\ndevice = \"model_every_mode\"\nname = \"m\"\nmode = \"dc-sync0\"\n\
                count = 9\n[[fault]]\nat = \"in-operation + 50ms\"\nwhat = \"misbehave 4 dead-sync0 for 5ms\"\n";
    let scenario = Scenario::from(SegmentFile::parse("my.toml", text).expect("right"));
    let outcome = scenario.run().execute(Some(Recording::of(&scenario)), &mut |_| {});
    let mut report = Report::new(&scenario, &outcome);
    let segment = outcome.world.main().segment().clone();
    let recorded = outcome.world.into_tap().expect("the tap").finish();
    report.explain(&recorded, &segment, scenario.sync0_limit);
    assert!(!report.in_sync);
    let rows: Vec<_> = report.alike().iter().map(|row| (row[0].position, row.len())).collect();
    assert_eq!(rows, [(0, 1), (1, 3), (4, 1), (5, 4)]);
}
