//! `isocat run --interface` and `isocat scan --interface`, as programs under `isocat virtual`: what
//! the command tells of an interface agrees with what the segment tells from the other side.
//!
//! It is the code that a real interface runs, over the same packet sockets, in virtual time: each
//! run is the same on any machine. What an interface of the kernel adds is stated by the program
//! `wire`.
#![cfg(all(target_os = "linux", target_arch = "x86_64"))]

use isocat::host::{LinkError, RawSocket};
use isocat::report::scan::{Place, ScanReport};
use isocat::{Scenario, SegmentFile};
use isocat_wire::frame::LOCALLY_ADMINISTERED;
use isocat_wire::time::Nanos;
use isocat_wire::{Command as Access, register};
use serde_json::Value;

use crate::supervised::{Folder, ISOCAT, Told, broadcast, in_the_role, pause, role};

/// The built-in segment as a file, with more in it.
fn built_in(name: &str, more: &str) -> Folder {
    let folder = Folder::new(name);
    folder.write("segment.toml", &format!("{}\n{more}", SegmentFile::built_in_text()));
    folder
}

/// Runs the command's `run` on the segment of a folder.
fn run(folder: &Folder, arguments: &[&str]) -> Option<Told> {
    let run = [ISOCAT, "run", "--interface", "vt0"];
    folder.supervised("segment.toml", &[&run, arguments].concat())
}

fn number(value: &Value) -> u64 {
    value.as_u64().unwrap_or_else(|| panic!("a number is expected: {value}"))
}

fn list(value: &Value) -> &[Value] {
    value.as_array().unwrap_or_else(|| panic!("a list is expected: {value}"))
}

#[test]
fn the_built_in_segment_is_brought_into_sync() {
    let folder = built_in("sync", "[quality]\n");
    let files = ["--capture", "run.pcapng", "--report", "run.txt"];
    let arguments = [&["segment.toml", "--for", "2s", "--json"][..], &files].concat();
    let Some(told) = run(&folder, &arguments) else { return };
    let report = told.report();
    assert_eq!((told.exit, told.code()), (Some(0), Some(0)), "{report:#}");
    assert_eq!(report["format"], "isocat-interface-report/7");
    assert_eq!(
        report["verdict"],
        "In sync: 3 of 5 SubDevices, 2 in Free Run as announced or asked for."
    );
    assert_eq!(report["answer"], "in-sync");
    // What no wire shows is told, and changes nothing.
    let unknown = list(&report["unknown"]);
    assert!(unknown.iter().all(|unknown| unknown["decides"] == false), "{unknown:#?}");
    assert!(unknown.iter().any(|unknown| unknown["kind"] == "pins"), "{unknown:#?}");
    assert_eq!(report["ended_by"], "time");
    // The time that was asked for, and up to a cycle and a frame more until it is seen to be over.
    let judged = number(&report["judged_ns"]);
    assert!((2_000_000_000..2_010_000_000).contains(&judged), "{judged}");
    the_devices_are_in_step(&report, &told);
    what_is_read_in_the_background_is_there(&report);
    both_sides_count_the_same(&folder, &report, &told);

    let written = folder.read("run.txt");
    assert!(written.starts_with("In sync: 3 of 5 SubDevices"), "{written}");
    for words in ["0x092C [r]", "round trip", "frames late, in operation", "[m]"] {
        assert!(written.contains(words), "{words}: {written}");
    }
    assert!(!written.contains("true time") && !written.contains("[t]"), "{written}");
    let widest = written.lines().map(|line| line.chars().count()).max();
    assert!(widest <= Some(100), "{widest:?} columns:\n{written}");
}

/// By the registers, and by what the segment saw in true time.
fn the_devices_are_in_step(report: &Value, told: &Told) {
    let devices = list(&report["devices"]);
    let modes: Vec<_> = devices.iter().map(|device| device["mode"].clone()).collect();
    assert_eq!(modes, ["dc-sync0", "dc-sync0", "free-run", "free-run", "dc-sync0"]);
    let session = &told.summary["sessions"][0];
    assert_eq!((&session["answer"], &session["judged"]["in_op"]), (&"in-sync".into(), &5.into()));
    for (device, judged) in devices.iter().zip(list(&session["judged"]["devices"])) {
        let registers = &device["registers"];
        assert_eq!((&registers["al_status"], &judged["state"]), (&"OP".into(), &"OP".into()));
        assert_eq!(judged["mode"], device["mode"]);
        // Clocks that follow the reference without a host's jitter are off by a few ticks of 10 ns.
        let difference = registers["system_time_difference_ns"].as_i64().unwrap_or(0);
        assert!(difference.abs() < 100, "{device:#}");
        for counter in ["sm_event_missed", "cycle_time_too_small", "shift_time_too_short"] {
            let before = &device["output_counters_before"][counter];
            assert_eq!(registers["output_counters"][counter], *before, "{counter}: {device:#}");
        }
    }
}

fn what_is_read_in_the_background_is_there(report: &Value) {
    let quality = &report["quality"];
    // Ten permille of the wire are asked for. A reading is begun while the share allows it, so that
    // the last one may exceed it.
    let taken = quality["share_taken_permille"].as_f64().expect("a share");
    assert!((9.5..=10.5).contains(&taken), "{taken} permille");
    for at in [1, 3, 4] {
        let device = &quality["devices"][at];
        assert!(number(&device["clock"]["readings"]) >= 50, "{device:#}");
        assert!(device["clock"]["bound_ns"].as_i64() < Some(200), "{device:#}");
        assert!(list(&device["entries"]).len() >= 6, "{device:#}");
        assert!(device["entries"][0]["value"].is_u64(), "{device:#}");
    }
}

/// Round trips and frames, by the command, by its capture and by the segment.
fn both_sides_count_the_same(folder: &Folder, report: &Value, told: &Told) {
    let (trip, main) = (&report["punctuality"]["round_trip"], &report["main_device"]);
    let trips = number(&trip["span"]["count"]);
    let in_buckets = list(&trip["buckets"]).iter().map(|bucket| number(&bucket["count"]));
    assert_eq!(in_buckets.sum::<u64>(), trips);
    assert!(trip["p99_ns"].as_f64() <= trip["span"]["max_ns"].as_f64(), "{trip:#}");
    assert_eq!(report["punctuality"]["frames_lost"], 0);
    assert_eq!(report["punctuality"]["cycles_skipped"], 0);
    // One frame leaves each cycle of the time that is judged, but that at either end of it.
    let sent = number(&report["punctuality"]["send_lateness"]["span"]["count"]);
    let cycles = number(&report["judged_ns"]) / number(&report["cycle_ns"]);
    assert!((cycles - 3..=cycles).contains(&sent), "{sent} of {cycles}");
    // Each frame that was sent behind the way up came back. All are measured, but those that read
    // counters before and after the time that is judged: fifteen for each device at most.
    let behind = number(&main["frames_sent"]) - number(&main["bring_up_frames"]);
    assert!((sent..=behind).contains(&trips) && behind - trips <= 5 * 15, "{trips} of {behind}");
    // The segment answered each frame, and the report was made before the way down.
    let frames = told.counted("frames");
    assert_eq!((told.counted("answered"), told.counted("lost")), (frames, 0));
    assert_eq!(told.summary["program"]["frames_sent"], frames);
    assert_eq!(told.summary["program"]["frames_received"], frames);
    let down = frames - number(&main["frames_sent"]);
    assert!((5..=100).contains(&down), "{down} frames of the way down");
    // The capture of the interface has each frame twice: as it left, and as it came back.
    let replayed = folder.isocat(&["replay", "run.pcapng", "--json"]);
    let replayed: Value = serde_json::from_slice(&replayed.stdout).expect("JSON");
    assert_eq!(replayed["frames"], frames);
    assert!(number(&report["machine"]["wake_up_lateness"]["span"]["count"]) >= 10);
}

#[test]
fn whatever_is_there_is_taken() {
    let folder = built_in("any", "");
    let arguments = ["--any", "--cycle", "2ms", "--for", "500ms", "--json"];
    let Some(told) = run(&folder, &arguments) else { return };
    let report = told.report();
    assert_eq!(told.code(), Some(0), "{report:#}");
    assert_eq!(report["segment_file"], Value::Null);
    assert_eq!(report["cycle_ns"], 2_000_000);
    // Without a file the names are those that the devices have themselves.
    let names: Vec<_> = list(&report["devices"]).iter().map(|device| &device["name"]).collect();
    assert_eq!(names, ["AKD2G", "AKD2G", "EK1100", "EL2502-0010", "ECAT_CIA402"]);
}

/// What is found on an interface is what is found by a scan of the virtual segment.
#[test]
fn a_scan_finds_what_is_there() {
    let folder = built_in("scan", "");
    let scan = [ISOCAT, "scan", "--interface", "vt0", "--json"];
    let Some(told) = folder.supervised("segment.toml", &scan) else { return };
    let found = told.report();
    assert_eq!(told.code(), Some(0), "{found:#}");
    assert_eq!((&found["interface"], &found["segment_file"]), (&"vt0".into(), &Value::Null));
    let file = SegmentFile::parse("segment.toml", &folder.read("segment.toml")).expect("a segment");
    let expected = isocat::Scan::of(&Scenario::from(file), true, &mut |_| {});
    let expected = ScanReport::new(Place::Virtual(""), &expected);
    let expected = serde_json::to_value(expected).expect("JSON");
    assert_eq!(list(&found["devices"]).len(), 5);
    let pairs = list(&found["devices"]).iter().zip(list(&expected["devices"]));
    for (at, (found, expected)) in pairs.enumerate() {
        for (key, expected) in expected.as_object().expect("a device") {
            if !["delay", "clock"].contains(&key.as_str()) {
                assert_eq!(found[key], *expected, "{key} of SubDevice {at}");
            }
        }
        // Both are measured, at other instants: a latch counts ticks of 10 ns, and a delay is half
        // of the difference of two.
        let ns = |report: &Value| report["delay"]["ns"].as_f64().expect("a delay");
        let off = ns(found) - ns(expected);
        assert!(off.abs() <= 20.0, "{found:#}");
        let of_clock = |report: &Value, key: &str| report["clock"][key].as_f64().expect("a figure");
        let off = of_clock(found, "speed_ppm") - of_clock(expected, "speed_ppm");
        let error = of_clock(found, "speed_error_ppm") + of_clock(expected, "speed_error_ppm");
        assert!(off.abs() <= error && error < 0.5, "{found:#}");
    }
}

/// Bit 0 of 0x0100 was cleared at every device, so that frames come back with their own source
/// address: they are answers all the same, and are marked again behind the scan.
#[test]
fn a_segment_that_does_not_mark_frames_is_scanned() {
    if let Some(role) = role() {
        return clears_the_mark(&role);
    }
    let folder = built_in("mark", "");
    let test = "interface::a_segment_that_does_not_mark_frames_is_scanned";
    let (clear, check) = (in_the_role("clear", test), in_the_role("check", test));
    // 1: found, and something there is noted; 2 would be that nothing was found.
    let scan = format!("'{ISOCAT}' scan --interface vt0 --json --quick; test $? -le 1");
    let script = format!("{clear} && {{ {scan}; }} && {check}");
    let Some(told) = folder.supervised("segment.toml", &["sh", "-c", &script]) else { return };
    assert_eq!(told.code(), Some(0), "{}", told.errors);
    assert_eq!(list(&told.report()["devices"]).len(), 5);
}

/// Clears the mark and finds it gone, or finds it there again.
fn clears_the_mark(role: &str) {
    let ask = |command, ado| broadcast(command, ado, &[0])[6] & LOCALLY_ADMINISTERED != 0;
    if role == "check" {
        return assert!(ask(Access::Brd, 0), "it marks frames again");
    }
    assert!(ask(Access::Brd, 0), "it marks frames");
    ask(Access::Bwr, register::DL_CONTROL.address);
    assert!(!ask(Access::Brd, 0), "it still marks frames");
}

/// The first cable, at an instant.
fn pulled(at: &str) -> String {
    format!("[[fault]]\nat = \"{at}\"\nwhat = \"pull AKD2G axis 1\"\n")
}

#[test]
fn a_wire_without_devices_says_so() {
    let folder = built_in("none", &pulled("0s"));
    let Some(told) = run(&folder, &["--any", "--json"]) else { return };
    let report = told.report();
    assert_eq!(told.code(), Some(1), "{report:#}");
    let verdict = report["verdict"].as_str().expect("a verdict");
    assert!(verdict.contains("no SubDevice answers on vt0"), "{verdict}");
    assert_eq!(list(&report["devices"]).len(), 0);
    assert_eq!(told.counted("answered"), 0);

    let scan = [ISOCAT, "scan", "--interface", "vt0"];
    let told = folder.supervised("segment.toml", &scan).expect("as before");
    assert_eq!((told.code(), told.printed.as_str()), (Some(2), ""), "{}", told.errors);
    assert!(told.message().contains("vt0: no frame came back in"), "{}", told.errors);
}

#[test]
fn another_segment_than_the_file_expects_is_bad_input() {
    let folder = built_in("other", "");
    folder.write("one.toml", "cycle = \"1ms\"\n[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\n");
    let Some(told) = run(&folder, &["one.toml"]) else { return };
    assert_eq!(told.code(), Some(2), "{}", told.errors);
    assert!(told.message().contains("5 SubDevices answer, expected 1"), "{}", told.errors);
    assert_eq!(told.summary["sessions"][0]["judged"], Value::Null, "no SubDevice was led to OP");
}

#[test]
fn a_signal_ends_the_run_with_a_report() {
    let folder = built_in("signal", "");
    let run = format!("'{ISOCAT}' run segment.toml --interface vt0 --for 10min --json");
    for signal in ["INT", "TERM"] {
        let script = format!("{run} & sleep 6; kill -{signal} $!; wait $!");
        let Some(told) = folder.supervised("segment.toml", &["sh", "-c", &script]) else { return };
        let report = told.report();
        assert_eq!(told.code(), Some(0), "{report:#}");
        assert_eq!((&report["ended_by"], &report["answer"]), (&"signal".into(), &"in-sync".into()));
        // It is over at the signal, and the way up had its share of the six seconds.
        let judged = number(&report["judged_ns"]);
        assert!((5_000_000_000..6_000_000_000).contains(&judged), "{judged}");
        let notes = report["notes"].to_string();
        assert!(notes.contains("ended by a signal"), "{notes}");
        assert!(!notes.contains("the way down"), "{notes}");
        // The devices are led to INIT behind it, in less than a second.
        let lasted = number(&told.summary["program"]["lasted_ns"]);
        assert!((6_000_000_000..7_000_000_000).contains(&lasted), "{lasted}");
    }
}

#[test]
fn a_cable_pulled_ends_the_run_with_clear_words() {
    let folder = built_in("cable", &pulled("in-operation + 500ms"));
    let arguments = ["segment.toml", "--for", "10min", "--json"];
    let Some(told) = run(&folder, &arguments) else { return };
    let report = told.report();
    assert_eq!(told.code(), Some(1), "{report:#}");
    assert_eq!(report["ended_by"], "silence", "{report:#}");
    let findings = report["findings"].to_string();
    assert!(findings.contains("nothing comes back on vt0 any more"), "{findings}");
    // The interface has a carrier, so that the cable is one further on.
    assert!(findings.contains("a cable further on was pulled"), "{findings}");
    // What can't be read any more is not told from memory.
    let registers = &report["devices"][1]["registers"];
    assert_eq!(registers["al_status"], "unknown");
    assert_eq!(registers["system_time_difference_ns"], Value::Null);
    // All frames behind the cut are lost, and none before it.
    let lost = told.counted("lost");
    assert_eq!(told.counted("answered") + lost, told.counted("frames"));
    assert_eq!(told.summary["program"]["frames_received"], told.counted("answered"));
    assert!(number(&report["main_device"]["frames_lost"]) <= lost, "{report:#}");
}

#[test]
fn another_maindevice_on_the_wire_is_named() {
    if role().is_some() {
        return talks_in_between();
    }
    let folder = built_in("talk", "");
    let talker = in_the_role("talks", "interface::another_maindevice_on_the_wire_is_named");
    let run = format!("'{ISOCAT}' run segment.toml --interface vt0 --for 500ms --json");
    let script = format!("{talker} & {run}; code=$?; kill $!; exit $code");
    let Some(told) = folder.supervised("segment.toml", &["sh", "-c", &script]) else { return };
    let report = told.report();
    assert_eq!(told.code(), Some(0), "it harms nothing: {report:#}");
    let notes = report["notes"].to_string();
    assert!(notes.contains("02:0a:0b:0c:0d:0e"), "{notes}");
    assert!(notes.contains("second MainDevice"), "{notes}");
    // One frame in 5 ms, for as long as the run counts them: 500 ms of operation at least.
    let foreign = number(&report["punctuality"]["frames_of_others"]);
    let lasted = number(&told.summary["program"]["lasted_ns"]);
    assert!((100..=lasted / 5_000_000 + 1).contains(&foreign), "{foreign}");
}

/// Sends a foreign frame every 5 ms until it is killed.
fn talks_in_between() {
    let socket = RawSocket::open("vt0", None).expect("the end of the segment");
    let mut frame = [0; 60];
    frame[..6].fill(0xFF);
    frame[6..12].copy_from_slice(&[0x02, 0x0A, 0x0B, 0x0C, 0x0D, 0x0E]);
    // EtherType, 14 bytes of datagrams: one NOP with two bytes.
    frame[12..18].copy_from_slice(&[0x88, 0xA4, 0x0E, 0x10, 0x00, 0x77]);
    loop {
        socket.send(&frame).expect("an interface that is up");
        pause(Nanos::millis(5));
    }
}

/// What is refused before an interface is opened, so that no rights are needed to see it.
#[test]
fn bad_flags_are_refused_before_an_interface_is_opened() {
    let folder = Folder::new("flags");
    let on = ["--interface", "isocat-none"];
    for (arguments, words) in [
        (&[&on[..], &["--any", "--cpu", "4000"]].concat()[..], "--cpu 4000"),
        (&[&on[..], &["--cycle", "1ms"]].concat(), "needs --any"),
        (&[&on[..], &["--any", "--cycle", "1us"]].concat(), "10 us"),
        (&[&on[..], &["--seed", "1"]].concat(), "--seed"),
        (&["--netns", "isocat-none"], "--interface"),
        (&["--busy"], "--interface"),
    ] {
        let output = folder.isocat(&[&["run"], arguments].concat());
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {message}");
        assert!(message.contains(words), "{arguments:?}: {message}");
        assert_eq!(String::from_utf8_lossy(&output.stdout), "", "{arguments:?}");
    }
}

/// A user without rights is told what to grant, and one with rights which interfaces there are.
#[test]
fn an_interface_that_can_not_be_opened_is_bad_input() {
    let words = match RawSocket::open("isocat-none", None).map(drop) {
        Err(LinkError::Permission { .. }) => "setcap cap_net_raw",
        Err(_) => "there are lo",
        Ok(()) => panic!("there is an interface isocat-none"),
    };
    let folder = Folder::new("opened");
    for verb in ["run", "scan"] {
        let output = folder.isocat(&[verb, "--interface", "isocat-none"]);
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{verb}: {message}");
        assert!(message.contains(words), "{verb}: {message}");
    }
}
