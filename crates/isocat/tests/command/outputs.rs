//! Files that the command writes appear whole or not at all: what stood there before survives a run
//! that fails.
#![cfg(unix)]

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// Runs the command.
fn isocat(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_isocat")).args(arguments).output().expect("isocat starts")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).expect("isocat prints UTF-8")
}

/// An empty folder of one test's own.
fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("outputs_{name}"));
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).expect("the target directory is writable");
    folder
}

#[test]
fn a_run_that_is_refused_leaves_the_files_of_before() {
    let folder = folder("refused");
    let segment = folder.join("tight.toml");
    // No cycle of 10 us holds the frame of 60 devices.
    let text = "cycle = \"10us\"\n[[subdevice]]\ndevice = \"simple_io16\"\ncount = 60\n";
    std::fs::write(&segment, text).expect("writable");
    let report = folder.join("no/such/folder/report.html");
    let capture = folder.join("run.pcapng");
    std::fs::write(&capture, "good").expect("writable");
    let output = isocat(&[
        "run",
        segment.to_str().expect("UTF-8"),
        "--for",
        "1ms",
        "--series",
        report.to_str().expect("UTF-8"),
        "--capture",
        capture.to_str().expect("UTF-8"),
    ]);
    assert_eq!(output.status.code(), Some(2));
    assert_eq!(std::fs::read_to_string(&capture).expect("it is there"), "good");
    assert_eq!(std::fs::read_dir(&folder).expect("ours").count(), 2);
}

#[test]
fn devices_and_pipes_are_written_directly() {
    let output = isocat(&["run", "--for", "10ms", "--json", "--report", "/dev/null"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let output = isocat(&["run", "--for", "10ms", "--report", "/dev/stdout"]);
    let printed = text(&output.stdout);
    assert_eq!(printed.matches("In sync").count(), 2, "{printed}");
    if Path::new("/dev/full").exists() {
        let output = isocat(&["run", "--for", "10ms", "--report", "/dev/full"]);
        assert_eq!(output.status.code(), Some(2));
        assert!(text(&output.stderr).contains("no space left"), "{}", text(&output.stderr));
    }

    let fifo = folder("fifo").join("pipe.json");
    match Command::new("mkfifo").arg(&fifo).status() {
        Ok(status) if status.success() => {}
        _ => return println!("skipped: no mkfifo"),
    }
    let path = fifo.clone();
    let reader = std::thread::spawn(move || std::fs::read_to_string(path).expect("a text"));
    let output = isocat(&["run", "--for", "10ms", "--report", fifo.to_str().expect("UTF-8")]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let read = reader.join().expect("no panic");
    assert!(read.trim_end().ends_with('}') && read.contains("\"in_sync\": true"), "{read}");
}
