//! `isocat virtual`, with the command itself as the unmodified program: `isocat run --interface
//! vt0`.
#![cfg(all(target_os = "linux", target_arch = "x86_64"))]

use std::path::PathBuf;
use std::process::{Command, Output};

use serde_json::Value;

use crate::supervised::{Folder, ISOCAT, Told, cannot_be_supervised};

impl Folder {
    /// A segment file of two drives.
    fn segment(&self, more: &str) -> String {
        let text = format!(
            "cycle = \"1ms\"\n{more}\n[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\n\n[[subdevice]]\ndevice = \"model_every_mode\"\nclock = \"+30ppm\"\n"
        );
        self.write("segment.toml", &text);
        self.file("segment.toml")
    }
}

fn isocat(arguments: &[&str]) -> Output {
    Command::new(ISOCAT).args(arguments).output().expect("the command runs")
}

/// Runs our own MainDevice on a segment; its summary and the exit code. `None`: programs can't be
/// supervised here.
fn supervised(arguments: &[&str], segment: &str) -> Option<(Value, i32)> {
    let program = ["--", ISOCAT, "run", segment, "--interface", "vt0", "--for", "2s"];
    let output = isocat(&[&["virtual", segment, "--json"], arguments, &program].concat());
    let told = Told::of(&output)?;
    Some((told.summary, output.status.code().expect("it ends")))
}

#[test]
fn our_own_main_device_is_in_sync_and_the_same_twice() {
    let folder = Folder::new("twice");
    let segment = folder.segment("");
    let Some((first, code)) = supervised(&[], &segment) else { return };
    assert_eq!((code, &first["sessions"][0]["answer"]), (0, &"in-sync".into()), "{first}");
    let Some((second, _)) = supervised(&[], &segment) else { return };
    assert_eq!(first, second);
    let (other, _) = supervised(&["--seed", "2"], &segment).expect("as before");
    assert_ne!(first["program"]["wire_hash"], other["program"]["wire_hash"]);
}

#[test]
fn a_machine_that_stands_still_loses_cycles_and_goes_on() {
    let folder = Folder::new("stall");
    let fault = "[[fault]]\nwhat = \"stall for 7ms\"\nat = \"in-operation + 500ms\"\n";
    let longest = |more: &str| {
        let segment = folder.segment(more);
        let (summary, code) = supervised(&[], &segment)?;
        let interval = &summary["sessions"][0]["cycle"]["interval"];
        Some((interval["max_ns"].as_f64().expect("it came to operation") as i64, code))
    };
    let Some((calm, code)) = longest("") else { return };
    assert!(calm < 1_100_000 && code == 0, "{calm}");
    let (stalled, code) = longest(fault).expect("as before");
    assert!((7_000_000..8_100_000).contains(&stalled) && code == 1, "{stalled} {code}");
}

#[test]
fn late_wake_ups_and_slow_sends_of_a_file_show_in_its_frames() {
    let folder = Folder::new("late");
    let deviation = |what: &str| {
        let fault = format!("[[fault]]\nwhat = \"{what}\"\nat = \"in-operation\"\n");
        let segment = folder.segment(if what.is_empty() { "" } else { &fault });
        let (summary, _) = supervised(&[], &segment)?;
        summary["sessions"][0]["cycle"]["interval"]["standard_deviation_ns"].as_f64()
    };
    let Some(calm) = deviation("") else { return };
    for what in ["late-wake-ups 60us", "slow-send 60us"] {
        let late = deviation(what).expect("as before");
        assert!(late > 5.0 * calm, "{what}: {late} {calm}");
    }
}

#[test]
fn files_of_the_field_are_written_while_it_runs() {
    let folder = Folder::new("files");
    let segment = folder.segment("");
    let files =
        ["run.pcapng", "run.vcd", "run.perfetto", "run.html", "run.xml"].map(|n| folder.file(n));
    let [capture, waves, trace, page, junit] = &files;
    let arguments = [
        "--capture",
        capture,
        "--waves",
        waves,
        "--trace",
        trace,
        "--report",
        page,
        "--junit",
        junit,
    ];
    let Some((summary, _)) = supervised(&arguments, &segment) else { return };
    for file in &files {
        assert!(std::fs::metadata(file).is_ok_and(|about| about.len() > 500), "{file}");
    }
    let frames = summary["frames"].as_u64().expect("a number");
    let output = isocat(&["replay", capture, "--json"]);
    let replayed: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!((replayed["frames"].as_u64(), &replayed["agrees"]), (Some(frames), &true.into()));
}

/// A recorder sees more events than the judges need; what they say is the same. One drive follows
/// its frames, which come late and then not at all for a while.
#[test]
fn recordings_never_change_the_verdict() {
    let folder = Folder::new("recorded");
    let faults = "[[fault]]\nwhat = \"stall for 5ms\"\nat = \"in-operation + 500ms\"\n";
    let follows =
        "[[subdevice]]\ndevice = \"model_every_mode\"\nmode = \"sm\"\nclock = \"-20ppm\"\n";
    let segment = folder.segment(&format!("{faults}{follows}"));
    let judged = |recording: &[&str]| {
        let (summary, code) = supervised(recording, &segment)?;
        Some((code, summary["sessions"].clone(), summary["program"]["wire_hash"].clone()))
    };
    let Some(plain) = judged(&[]) else { return };
    let recordings =
        [("--capture", "pcapng"), ("--waves", "vcd"), ("--trace", "perfetto"), ("--series", "csv")];
    for (recording, extension) in recordings {
        let to = folder.file(&format!("recorded.{extension}"));
        assert_eq!(judged(&[recording, &to]), Some(plain.clone()), "{recording}");
    }
}

#[test]
fn a_series_has_the_figures_of_the_summary_one_by_one() {
    let folder = Folder::new("series");
    let (segment, file) = (folder.segment(""), folder.file("series.csv"));
    let Some((summary, _)) = supervised(&["--series", &file], &segment) else { return };
    let text = std::fs::read_to_string(&file).expect("it was written");
    let rows: Vec<Vec<&str>> = text.lines().map(|line| line.split(',').collect()).collect();
    let column = |name: &str| rows[0].iter().position(|other| *other == name).expect(name);
    let (position, margin) = (column("position"), column("margin_ns"));
    for (place, device) in
        summary["sessions"][0]["judged"]["devices"].as_array().expect("a list").iter().enumerate()
    {
        let of_device = rows[1..].iter().filter(|row| row[position] == place.to_string());
        let margins: Vec<f64> = of_device.filter_map(|row| row[margin].parse().ok()).collect();
        let told = &device["sync0_margin"];
        let least = margins.iter().copied().reduce(f64::min);
        assert_eq!(least, told["min_ns"].as_f64(), "SubDevice {place}");
        // A pulse behind the last frame with process data has no row any more.
        let count = told["count"].as_u64().unwrap_or(0);
        let rows = margins.len() as u64;
        assert!(rows == count || rows + 1 == count, "SubDevice {place}: {rows} of {count}");
    }
    let output = isocat(&["virtual", "--series", "series.txt", "--", "true"]);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(
        output.status.code() == Some(2) && errors.contains("expected .csv or .parquet"),
        "{errors}"
    );
}

#[test]
fn many_seeds_are_a_table_in_which_each_can_be_repeated() {
    let folder = Folder::new("seeds");
    let segment = folder.segment("for = \"400ms\"");
    let (rows, failed) = (folder.file("rows.csv"), folder.file("failed"));
    let program = ["--", ISOCAT, "run", &segment, "--interface", "vt0", "--for", "1s"];
    let flags = [
        "virtual",
        &segment,
        "--seeds",
        "4",
        "--faults",
        "swarm",
        "--rows",
        &rows,
        "--failed",
        &failed,
        "--lateness",
        "40us",
        "--json",
    ];
    let output = isocat(&[&flags[..], &program].concat());
    let errors = String::from_utf8_lossy(&output.stderr);
    if cannot_be_supervised(&errors) {
        return;
    }
    let summary: Value = serde_json::from_slice(&output.stdout).expect(&errors);
    let all = summary["rows"].as_array().expect("rows");
    assert_eq!(
        (all.len(), std::fs::read_to_string(&rows).expect("it is there").lines().count()),
        (4, 5)
    );
    assert_eq!(all.iter().filter_map(|row| row["seed"].as_u64()).collect::<Vec<_>>(), [1, 2, 3, 4]);
    let bad = all.iter().find(|row| row["code"] != 0).expect("four swarms leave none in peace");
    let text =
        PathBuf::from(&failed).join(format!("run-{}.toml", bad["number"])).display().to_string();
    let text = std::fs::read_to_string(text).expect("it is kept");
    let command = text.lines().last().and_then(|line| line.strip_prefix("# isocat ")).expect(&text);
    assert!(command.contains("--lateness 40us"), "{command}");
    let again = Command::new("sh").args(["-c", &format!("{ISOCAT} {command}")]).output();
    let errors = String::from_utf8_lossy(&again.expect("a shell").stderr).into_owned();
    assert!(errors.contains(bad["wire"].as_str().expect("a hash")), "{errors}");
}

#[test]
fn mistakes_on_purpose_are_held_against_what_they_did() {
    let folder = Folder::new("mutate");
    let segment = folder.segment("");
    let program = ["--", ISOCAT, "run", &segment, "--interface", "vt0", "--for", "200ms"];
    let output =
        isocat(&[&["virtual", &segment, "--mutate", "10", "--json"], &program[..]].concat());
    let errors = String::from_utf8_lossy(&output.stderr);
    if cannot_be_supervised(&errors) {
        return;
    }
    let table: Value = serde_json::from_slice(&output.stdout).expect(&errors);
    let rows = table["rows"].as_array().expect("rows");
    let door = &table["doors"]["virtual"];
    let count = |key: &str| door[key].as_u64().expect(key);
    let of_effect =
        ["green", "red", "open", "program"].map(|said| count(&format!("effect_{said}")));
    let harmful = rows.iter().filter(|row| row["effects"] != serde_json::json!([])).count() as u64;
    assert_eq!((rows.len(), of_effect.iter().sum::<u64>()), (10, harmful), "{table}");
    assert!(harmful > 0, "{table}");
    assert_eq!((count("effect_green"), count("none_red")), (0, 0), "{table}");
    assert_eq!(output.status.code(), Some(0), "{table}");
}

#[test]
fn a_program_that_fails_without_a_mistake_is_not_mutated() {
    let folder = Folder::new("mutate-bad");
    let segment = folder.segment("");
    let output = isocat(&["virtual", &segment, "--mutate", "1", "--", "sh", "-c", "exit 3"]);
    let errors = String::from_utf8_lossy(&output.stderr);
    if cannot_be_supervised(&errors) {
        return;
    }
    assert_eq!(output.status.code(), Some(2), "{errors}");
    assert!(errors.contains("expected 0, so that mistakes show"), "{errors}");
}

#[test]
fn what_can_not_be_run_is_refused_with_what_was_expected() {
    let folder = Folder::new("refused");
    let (script, text) = (folder.file("script"), folder.file("text"));
    std::fs::write(&script, "#!\n").expect("it can be written");
    std::fs::write(&text, "hello").expect("it can be written");
    Command::new("chmod").args(["+x", &script, &text]).status().expect("chmod");
    for (arguments, expected) in [
        (&["--", "no-such-program"][..], "there is no such program in PATH"),
        (&["--", "/tmp"], "a folder; expected a program"),
        (&["--", "/etc/passwd"], "may not be executed"),
        (&["--", &script], "names no interpreter"),
        (&["--", &text], "neither a program"),
        (&["--interface", "lo", "--", "true"], "this machine has such an interface"),
        (&["--interface", "a-name-that-is-too-long", "--", "true"], "the name of an interface"),
        (&["--secondary", "vt1", "--", "true"], "no --secondary, as it is no ring"),
        (&["--lateness-from", "/no/such/file", "--", "true"], "/no/such/file"),
        (&["--preemption", "10", "--", "true"], "1000:300us"),
    ] {
        let output = isocat(&[&["virtual"], arguments].concat());
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(
            output.status.code() == Some(2) && errors.contains(expected),
            "{arguments:?}: {errors}"
        );
    }
}
