//! The main job on a real wire: the command on one end of a veth pair, a simulated segment behind a
//! raw socket on the other, in a network namespace of the test's own.
//!
//! Needs root and the command `ip`; without them each test says so. A machine that stalls (a busy
//! virtual one does, for tens of milliseconds) throws devices out of sync with good reason: such a
//! run is tried again. Each statement on the command that is none on the wire is made in virtual
//! time, in `tests/command/interface.rs`.

use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, MutexGuard};
use std::thread::JoinHandle;
use std::time::Duration;

use isocat::host::{LinkError, RawSocket, RealTime, Veth, Wish, clock};
use isocat::{Scenario, SegmentFile};
use isocat_sim::Segment;
use isocat_wire::frame::duration_ns;
use isocat_wire::time::{Host, Nanos, Picos, Time, True};
use serde_json::Value;

use crate::alone::{alone, not_shown, skipped};
use crate::service::{ISOCAT, isocat, permitted, text};

/// The wire of one test.
struct Wire {
    veth: Veth,
    _alone: MutexGuard<'static, ()>,
}

impl std::ops::Deref for Wire {
    type Target = Veth;
    fn deref(&self) -> &Veth {
        &self.veth
    }
}

/// The wire of one test; `None`, with a word, where it can't be had.
fn wire(name: &str) -> Option<Wire> {
    let alone = alone();
    match Veth::create(name) {
        Ok(veth) => Some(Wire { veth, _alone: alone }),
        Err(error @ (LinkError::Permission { .. } | LinkError::Ip { .. })) => {
            skipped(&format!("it needs root and ip: {error}"));
            None
        }
        Err(error) => panic!("{error}"),
    }
}

/// A segment at the far end of a wire, in a thread, until it is told to end.
struct Responder {
    stop: Arc<AtomicBool>,
    thread: JoinHandle<u64>,
}

impl Responder {
    fn begin(wire: &Veth, file: &SegmentFile) -> Self {
        let end = wire.segment_end();
        // Before the first frame can come: true time does not run backwards.
        let begin = clock::now();
        let socket = RawSocket::open(&end, Some(wire.namespace())).expect("our own interface");
        let scenario = Scenario::from(file.clone());
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = stop.clone();
        let thread = std::thread::spawn(move || {
            let _real_time = RealTime::ask(Wish::default());
            let segment = Segment::new(scenario.run().setup.segment, scenario.seed);
            respond(socket, segment, begin, &stopped)
        });
        Self { stop, thread }
    }

    /// Ends it; how many frames it has answered.
    fn end(self) -> u64 {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    }
}

/// True time runs with host time. Frames enter when the kernel had them, one behind the other.
/// Gives the number of answers.
fn respond(
    mut socket: RawSocket,
    mut segment: Segment,
    begin: Time<Host>,
    stop: &AtomicBool,
) -> u64 {
    let mut frame = [0; 2048];
    let mut free: Time<True> = Time::ZERO;
    let mut answers = 0;
    while !stop.load(Ordering::Relaxed) {
        if !socket.wait(Some(clock::now() + Nanos::millis(50))).unwrap_or(false) {
            continue;
        }
        // An interface that went down has nothing.
        while let Ok(Some(received)) = socket.receive(&mut frame) {
            let bytes = &mut frame[..received.len];
            let start = (Time::ZERO + Picos::from(received.at - begin)).max(free);
            free = start + Picos::from(Nanos(duration_ns(bytes.len()) as i64 + 960));
            let fate = segment.pass(bytes, start, &mut isocat_sim::Watcher::blind());
            if fate.is_ok_and(|returned| returned.good) && socket.send(bytes).is_ok() {
                answers += 1;
            }
        }
    }
    answers
}

/// The built-in segment with the cycle of a slow machine, as a file of this test's own.
fn slow_segment(name: &str) -> (PathBuf, SegmentFile) {
    let text = SegmentFile::built_in_text().replace("cycle = \"1ms\"", "cycle = \"10ms\"");
    assert_ne!(text, SegmentFile::built_in_text());
    let name = PathBuf::from(format!("{name}.toml"));
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(&name);
    std::fs::write(&path, text).expect("the target directory is writable");
    let file = SegmentFile::read(path.to_str().expect("UTF-8")).expect("a segment");
    (name, file)
}

fn command(wire: &Veth, arguments: &[&str]) -> Command {
    let mut command = Command::new(ISOCAT);
    // No message is to depend on where this checkout lies.
    command.current_dir(env!("CARGO_TARGET_TMPDIR"));
    let interface = wire.main_end();
    command.args(["run", "--interface", &interface, "--netns", wire.namespace()]).args(arguments);
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

fn report(output: &Output) -> Value {
    serde_json::from_slice(&output.stdout)
        .unwrap_or_else(|error| panic!("{error}: {}{}", text(&output.stdout), text(&output.stderr)))
}

fn number(value: &Value) -> u64 {
    value.as_u64().unwrap_or_else(|| panic!("a number is expected: {value}"))
}

#[test]
fn both_sides_of_a_veth_pair_count_the_same_frames() {
    let Some(wire) = wire("ic-run") else { return };
    let (path, file) = slow_segment("interface_run");
    let path = path.to_str().expect("UTF-8");
    let capture = Path::new(env!("CARGO_TARGET_TMPDIR")).join("interface_run.pcapng");
    let capture = capture.to_str().expect("UTF-8");
    let mut why = String::new();
    for _ in 0..5 {
        let segment = Responder::begin(&wire, &file);
        let arguments = [path, "--for", "2s", "--json", "--capture", capture];
        let output = command(&wire, &arguments).output().expect("isocat starts");
        let (report, answers) = (report(&output), segment.end());
        let replayed = isocat(&["replay", capture, "--json"]);
        let replayed: Value = serde_json::from_slice(&replayed.stdout).expect("JSON");
        if report["in_sync"] != true || replayed["unanswered"] != 0 {
            // It throws devices out of sync with good reason, or is late for an answer: that was
            // no run to judge.
            why = report["verdict"].to_string();
            eprintln!("the machine stalls: {why}");
            continue;
        }
        // Each frame that left was answered, and each answer came in: the command's capture has
        // both.
        assert_eq!(number(&replayed["frames"]), answers, "{replayed:#}");
        assert_eq!(number(&replayed["packets"]), 2 * answers, "{replayed:#}");
        assert_eq!(output.status.code(), Some(0), "{report:#}");
        assert_eq!(report["answer"], "in-sync");
        assert_eq!(
            report["verdict"],
            "In sync: 3 of 5 SubDevices, 2 in Free Run as announced or asked for."
        );
        assert_eq!(report["ended_by"], "time");
        // The report was made before the way down; of its frames each that was measured came back.
        let (main, punctual) = (&report["main_device"], &report["punctuality"]);
        let trips = number(&punctual["round_trip"]["span"]["count"]);
        let (up, sent) = (number(&main["bring_up_frames"]), number(&main["frames_sent"]));
        assert!(trips >= number(&punctual["send_lateness"]["span"]["count"]), "{punctual:#}");
        assert!(up + trips <= sent && sent < answers, "{up} + {trips}, {sent}, {answers}");
        return;
    }
    not_shown("interface::both_sides_of_a_veth_pair_count_the_same_frames", &why);
}

#[test]
fn an_interface_that_goes_down_ends_the_run_with_clear_words() {
    let Some(wire) = wire("ic-cable") else { return };
    let (path, file) = slow_segment("interface_cable");
    let mut why = String::new();
    for _ in 0..3 {
        let segment = Responder::begin(&wire, &file);
        let arguments = [path.to_str().expect("UTF-8"), "--for", "10min", "--json"];
        let run = command(&wire, &arguments).spawn().expect("isocat starts");
        std::thread::sleep(Duration::from_secs(6));
        let end = wire.segment_end();
        let ip = |state: &str| {
            let arguments = ["-n", wire.namespace(), "link", "set", &end, state];
            let status = Command::new("ip").args(arguments).status();
            assert!(status.expect("ip is there").success());
        };
        ip("down");
        let output = run.wait_with_output().expect("it ends");
        segment.end();
        ip("up");
        let report = report(&output);
        assert_eq!(output.status.code(), Some(1), "{report:#}");
        if report["ended_by"] == "bring-up" {
            // Six seconds were not enough for the way up on a machine that stalls.
            why = report["verdict"].to_string();
            continue;
        }
        assert_eq!(report["ended_by"], "silence", "{report:#}");
        let verdict = report["findings"].to_string();
        assert!(verdict.contains("nothing comes back on ic-cable any more"), "{verdict}");
        assert!(verdict.contains("no carrier"), "{verdict}");
        // What can't be read any more is not told from memory.
        let registers = &report["devices"][1]["registers"];
        assert_eq!(registers["al_status"], "unknown");
        assert_eq!(registers["system_time_difference_ns"], Value::Null);
        return;
    }
    not_shown("interface::an_interface_that_goes_down_ends_the_run_with_clear_words", &why);
}

#[test]
fn the_machine_is_looked_at_without_sending() {
    let Some(wire) = wire("ic-look") else { return };
    let output = command(&wire, &["--preflight"]).output().expect("isocat starts");
    let report = text(&output.stdout);
    assert!(matches!(output.status.code(), Some(0 | 1)), "{report}{}", text(&output.stderr));
    assert!(report.contains("measured"), "{report}");
    let output = command(&wire, &["--preflight", "--json"]).output().expect("isocat starts");
    let report: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert!(report["wake_up_lateness"]["p99_ns"].is_number(), "{report:#}");
}

/// A user without rights is told what to grant, and to which program.
#[test]
fn an_interface_that_this_user_may_not_open_is_bad_input() {
    if !permitted() {
        return;
    }
    // Such a user may not be able to reach the program where it was built. Another process copies
    // it: one that is open for writing here would be busy in each process that a test starts.
    let program = std::env::temp_dir().join(format!("isocat-of-nobody-{}", std::process::id()));
    let copied = Command::new("cp").arg(ISOCAT).arg(&program).status();
    assert!(copied.expect("cp is there").success());
    // Opening is refused before a missing name matters.
    let verbs = [["run", "isocat-none"], ["scan", "isocat-none"], ["serve", "lo"]];
    let outputs = verbs.map(|[verb, interface]| {
        let mut command = Command::new(&program);
        command.args([verb, "--interface", interface]).uid(65_534).gid(65_534).output()
    });
    std::fs::remove_file(&program).expect("it is ours");
    for (output, [verb, _]) in outputs.into_iter().zip(verbs) {
        let output = output.expect("it starts");
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{verb}: {message}");
        let path = program.display().to_string();
        for expected in ["not permitted", "setcap cap_net_raw", path.as_str()] {
            assert!(message.contains(expected), "{verb}: {message}");
        }
    }
}

#[test]
fn interfaces_that_are_not_there_are_refused_with_those_there_are() {
    let Some(wire) = wire("ic-bad") else { return };
    for (interface, namespace, words) in [
        ("nope", wire.namespace(), "there are lo"),
        ("ic-bad", "no-such-namespace", "no network namespace"),
    ] {
        let output = isocat(&["run", "--interface", interface, "--netns", namespace, "--any"]);
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{interface}: {message}");
        assert!(message.contains(words), "{interface}: {message}");
        assert_eq!(text(&output.stdout), "", "{interface}");
    }
}
