//! `isocat run NETWORK.xml --interface`: what a configuration tool wrote is executed to the letter
//! on the segment behind the interface, in virtual time, and what does not fit is refused or found.
#![cfg(all(target_os = "linux", target_arch = "x86_64"))]

use isocat_wire::{Command as Access, register};
use serde_json::Value;

use crate::supervised::{Folder, ISOCAT, Told, broadcast, in_the_role, role};

const TWO_DRIVES: &str = "cycle = \"2ms\"\nfor = \"1s\"\n[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\n\
                          [[subdevice]]\ndevice = \"kollmorgen_akd2g\"\n";

/// A folder with the ENI of a segment, `network.xml`, and the segment that is served,
/// `segment.toml`.
fn folder(name: &str, planned: &str, served: &str) -> Folder {
    let folder = Folder::new(&format!("eni-{name}"));
    folder.write("planned.toml", planned);
    folder.write("segment.toml", served);
    let output = folder.isocat(&["plan", "planned.toml", "--eni", "network.xml"]);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    folder
}

/// Two drives, of which the first is of another make.
fn another_drive() -> String {
    TWO_DRIVES.replacen("kollmorgen_akd2g", "hpmicro_ecat_cia402_ssc", 1)
}

/// Runs the command on the segment of a folder.
fn isocat(folder: &Folder, arguments: &[&str]) -> Option<Told> {
    folder.supervised("segment.toml", &[&[ISOCAT], arguments, &["--interface", "vt0"]].concat())
}

/// The same with a script of the shell, `RUN` for the command on the interface. Behind it the named
/// test is started again, and finds the devices in INIT.
fn down_to_init(folder: &Folder, script: &str, test: &str) -> Option<Told> {
    let look = in_the_role("finds-init", &format!("eni_interface::{test}"));
    let script = script.replace("RUN", &format!("'{ISOCAT}' run --interface vt0"));
    let script = format!("{script}; code=$?; {look} || exit 99; exit $code");
    folder.supervised("segment.toml", &["sh", "-c", &script])
}

/// The role of a test that is started again.
fn are_in_init() {
    let frame = broadcast(Access::Brd, register::AL_STATUS.address, &[0; 2]);
    // Both devices answer, and no bit is set but that of INIT: in none an error is.
    assert_eq!(frame[26..30], [1, 0, 2, 0], "{:02x?}", &frame[14..30]);
}

fn list(value: &Value) -> &[Value] {
    value.as_array().unwrap_or_else(|| panic!("a list is expected: {value}"))
}

/// What the segment saw the MainDevice do, in its words, with how often.
fn steps(told: &Told) -> Vec<(String, u64)> {
    let sessions = list(&told.summary["sessions"]).iter();
    let steps = sessions.flat_map(|session| list(&session["steps"]));
    let step = |step: &Value| Some((step["what"].as_str()?.to_owned(), step["count"].as_u64()?));
    steps.map(|one| step(one).expect("words and a count")).collect()
}

#[test]
fn our_own_export_runs() {
    if role().is_some() {
        return are_in_init();
    }
    let folder = folder("run", TWO_DRIVES, TWO_DRIVES);
    let run = "RUN network.xml --for 1s --json --capture run.pcapng --report run.txt";
    let Some(told) = down_to_init(&folder, run, "our_own_export_runs") else { return };
    let report = told.report();
    assert_eq!((told.exit, told.code()), (Some(0), Some(0)), "{report:#}");
    assert_eq!(report["format"], "isocat-eni-run/3");
    let (run, interface) = (&report["run"], &report["run"]["interface"]);
    assert_eq!((&run["failure"], &run["summary"]), (&Value::Null, &Value::Null));
    assert_eq!((&interface["answer"], &interface["ended_by"]), (&"in-sync".into(), &"time".into()));
    let judged = interface["judged_ns"].as_i64().expect("it came to operation");
    // The time that was asked for, and up to two cycles until it is seen to be over.
    // The time that was asked for, and before it the reading of the counters, which it begins with.
    assert!((1_000_000_000..1_050_000_000).contains(&judged), "{judged}");
    assert!(run["commands"].as_u64() > Some(30), "{run:#}");
    assert_eq!(report["differences"], Value::Array(Vec::new()));
    // A cycle of 2 ms: those of the way up and of the way down are counted, too.
    let cycles = run["cycles"].as_u64().expect("a count");
    let of_judged = judged as u64 / 2_000_000;
    assert!((of_judged..of_judged + 2_000).contains(&cycles), "{cycles}");
    for device in list(&interface["devices"]) {
        assert_eq!(device["registers"]["al_status"], "OP", "{device:#}");
        assert_eq!(device["mode"], "dc-sync0");
        let missed = |counters: &Value| counters["sm_event_missed"].clone();
        let after = missed(&device["registers"]["output_counters"]);
        assert!(after.is_u64(), "{device:#}");
        assert_eq!(after, missed(&device["output_counters_before"]));
    }
    // What is read in the background is read between the list's frames.
    let clock = &interface["quality"]["devices"][1]["clock"];
    assert!(clock["readings"].as_u64() >= Some(20), "{interface:#}");
    let written = folder.read("run.txt");
    assert!(written.starts_with("In sync: the ENI was executed to the letter."), "{written}");
    assert!(written.contains("0x092C [r]") && written.contains("first pulse at"), "{written}");
    // The segment saw the same in true time, and answered each frame.
    let session = &told.summary["sessions"][0];
    assert_eq!((&session["answer"], &session["judged"]["in_op"]), (&"in-sync".into(), &2.into()));
    let frames = told.counted("frames");
    assert_eq!(
        (told.counted("answered"), &interface["punctuality"]["frames_lost"]),
        (frames, &0.into())
    );
    let replayed = folder.isocat(&["replay", "run.pcapng", "--json"]);
    let replayed: Value = serde_json::from_slice(&replayed.stdout).expect("JSON");
    // All but the one that looked for INIT.
    assert_eq!(replayed["frames"], frames - 1);
}

/// What answers is compared with the list before anything is set up.
#[test]
fn other_devices_are_refused_before_anything_is_written() {
    let folder = folder("other", TWO_DRIVES, &another_drive());
    let run = ["run", "network.xml", "--for", "1s"];
    let Some(told) = isocat(&folder, &run) else { return };
    assert_eq!(told.code(), Some(2), "{}", told.errors);
    assert!(told.message().contains("SubDevice 0 is vendor"), "{}", told.errors);
    assert!(told.message().contains("as the ENI names it"), "{}", told.errors);
    let told = isocat(&folder, &[&run[..], &["--json"]].concat()).expect("as before");
    let report = told.report();
    assert_eq!(told.code(), Some(2));
    assert_eq!(report["run"]["failure"]["kind"], "identity");
    assert_eq!(report["run"]["commands"], 0);
    // All that it wrote is what reads an EEPROM.
    let steps: Vec<String> = steps(&told).into_iter().map(|(what, _)| what).collect();
    assert_eq!(steps, ["counts the SubDevices (BRD)", "reads SII EEPROMs"]);
}

#[test]
fn a_scan_names_another_device() {
    let folder = folder("scan", TWO_DRIVES, &another_drive());
    let Some(told) = isocat(&folder, &["scan", "network.xml", "--json"]) else { return };
    let found = told.report();
    assert_eq!(told.code(), Some(1), "{found:#}");
    let mismatches = list(&found["mismatches"]);
    assert_eq!(mismatches.len(), 1, "{mismatches:#?}");
    assert_eq!(mismatches[0]["kind"], "identity");
    assert_eq!((&mismatches[0]["on_wire"], &mismatches[0]["in_eni"]), (&0.into(), &0.into()));
}

#[test]
fn another_number_of_devices_is_refused_and_told_by_a_scan() {
    let three = format!("{TWO_DRIVES}[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\n");
    let folder = folder("three", &three, TWO_DRIVES);
    let Some(told) = isocat(&folder, &["run", "network.xml", "--for", "1s"]) else { return };
    assert_eq!(told.code(), Some(2), "{}", told.errors);
    assert!(told.message().contains("2 SubDevices answer; expected 3"), "{}", told.errors);
    let told = isocat(&folder, &["scan", "network.xml"]).expect("as before");
    assert_eq!(told.code(), Some(1));
    let missing = "SubDevice 2 of the ENI: the wire has nothing";
    assert!(told.printed.contains(missing), "{}", told.printed);
    // The ENI of what is there fits, and a segment file says nothing of a wire.
    let output = folder.isocat(&["plan", "segment.toml", "--eni", "same.xml"]);
    assert_eq!(output.status.code(), Some(0));
    let told = isocat(&folder, &["scan", "same.xml"]).expect("as before");
    assert!(told.printed.starts_with("What answers is what"), "{}", told.printed);
    assert_eq!(told.code(), Some(0), "{}", told.errors);
    let told = isocat(&folder, &["scan", "segment.toml"]).expect("as before");
    assert_eq!(told.code(), Some(2));
    assert!(told.message().contains("expected an ENI"), "{}", told.errors);
}

/// The first signal ends a run as its time does: judged, and down to INIT.
#[test]
fn a_signal_ends_it_in_init() {
    if role().is_some() {
        return are_in_init();
    }
    let folder = folder("signal", TWO_DRIVES, TWO_DRIVES);
    let script = "RUN network.xml --for 10min --json & sleep 6; kill -INT $!; wait $!";
    let Some(told) = down_to_init(&folder, script, "a_signal_ends_it_in_init") else { return };
    let report = told.report();
    let interface = &report["run"]["interface"];
    assert_eq!(told.code(), Some(0), "{report:#}");
    assert_eq!(interface["ended_by"], "signal", "{report:#}");
    let judged = interface["judged_ns"].as_i64().expect("it came to operation");
    // It is over at the signal, and the way up had its share of the six seconds.
    assert!((3_000_000_000..6_000_000_000).contains(&judged), "{judged}");
    assert!(interface["notes"].to_string().contains("ended by a signal"), "{report:#}");
}

/// A device that loses power in operation is found: by the frames, and by its state.
#[test]
fn what_goes_wrong_in_operation_is_found() {
    let fault = "[[fault]]\nat = \"in-operation + 500ms\"\nwhat = \"power-cycle 1 200ms\"\n";
    let folder = folder("power", TWO_DRIVES, &format!("{TWO_DRIVES}{fault}"));
    let Some(told) = isocat(&folder, &["run", "network.xml", "--for", "3s", "--json"]) else {
        return;
    };
    let report = told.report();
    assert_eq!(told.code(), Some(1), "{report:#}");
    let findings = list(&report["run"]["interface"]["findings"]);
    let kinds: Vec<_> = findings.iter().filter_map(|one| one["kind"].as_str()).collect();
    assert!(kinds.contains(&"working-counter"), "{report:#}");
    // The device that has its power all the time is not blamed.
    let positions: Vec<_> = findings.iter().filter_map(|one| one["position"].as_u64()).collect();
    assert!(!positions.is_empty() && positions.iter().all(|at| *at == 1), "{report:#}");
}

/// A command that fails ends the way up: it is told with its device, its state, and all go to INIT.
#[test]
fn a_command_that_fails_is_a_finding() {
    if role().is_some() {
        return are_in_init();
    }
    let folder = folder("fails", TWO_DRIVES, TWO_DRIVES);
    let eni = folder.read("network.xml");
    let control = eni.rfind("<Ado>288</Ado>").expect("AL control, last of all for OP");
    // The last request is for a state that there is not: 5.
    let (before, behind) = eni.split_at(control);
    let broken = format!("{before}{}", behind.replacen("<Data>08", "<Data>05", 1));
    assert_ne!(broken, eni);
    folder.write("broken.xml", &broken);
    let (run, test) = ("RUN broken.xml --for 1s --json", "a_command_that_fails_is_a_finding");
    let Some(told) = down_to_init(&folder, run, test) else { return };
    let report = told.report();
    assert_eq!(told.code(), Some(1), "{report:#}");
    let interface = &report["run"]["interface"];
    assert_eq!(interface["findings"][0]["kind"], "command-failed", "{report:#}");
    assert_eq!(interface["findings"][0]["position"], 1, "{report:#}");
    assert_eq!(interface["ended_by"], "bring-up");
    let devices = list(&interface["devices"]).iter();
    let states: Vec<_> = devices.map(|device| device["registers"]["al_status"].clone()).collect();
    assert_eq!(states[0], "OP", "{states:?}");
    assert!(states[1].as_str().is_some_and(|state| state.starts_with("SAFEOP")), "{states:?}");
}

/// Without an interface that can be opened nothing is said of the list, and flags of the other kind
/// of run are refused.
#[test]
fn nothing_that_answers_is_told() {
    let folder = folder("nobody", TWO_DRIVES, TWO_DRIVES);
    for (arguments, words) in [
        (&["--interface", "no-such-interface"][..], "no-such-interface"),
        (&["--interface", "lo", "--metrics", "9999"], "--metrics is beside an ENI"),
        (&["--capture", "run.pcapng"], "--capture without --interface"),
    ] {
        let output = folder.isocat(&[&["run", "network.xml"], arguments].concat());
        let message = String::from_utf8_lossy(&output.stderr);
        let message = message.split_whitespace().collect::<Vec<_>>().join(" ");
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {message}");
        assert!(message.contains(words), "{arguments:?}: {message}");
    }
}

/// With a cycle of 1 ms, and the same each time.
#[test]
fn two_runs_are_the_same() {
    let fast = TWO_DRIVES.replace("2ms", "1ms");
    let folder = folder("twice", &fast, &fast);
    let run = || isocat(&folder, &["run", "network.xml", "--for", "1s"]);
    let Some(first) = run() else { return };
    assert_eq!(first.summary["sessions"][0]["answer"], "in-sync", "{}", first.errors);
    assert_eq!((first.exit, first.code()), (Some(0), Some(0)), "{}", first.errors);
    let second = run().expect("as before");
    assert_eq!(first.summary, second.summary);
    assert_eq!(first.printed, second.printed);
}
