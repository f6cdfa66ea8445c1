//! What a configuration tool wrote, on a real wire: `isocat run network.xml --interface` against
//! `isocat serve` over a veth pair in a namespace of the test's own, and against `isocat virtual`.
//!
//! Needs root and the command `ip`; without them each test says so and passes. A machine that
//! stalls throws devices out of sync with good reason: such a run is recognized by what it
//! measured, and tried again.

#![cfg(target_os = "linux")]

use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Output, Stdio};
use std::sync::MutexGuard;

use serde_json::Value;

use crate::alone::alone;

const ISOCAT: &str = env!("CARGO_BIN_EXE_isocat");
/// Slow, for a machine that has other things to do.
const TWO_DRIVES: &str = "cycle = \"10ms\"\nfor = \"1s\"\n[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\n\
                          [[subdevice]]\ndevice = \"kollmorgen_akd2g\"\n";

fn isocat(arguments: &[&str]) -> Output {
    Command::new(ISOCAT).args(arguments).output().expect("isocat starts")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Without the ends of lines, where a message is folded.
fn told(output: &Output) -> String {
    text(&output.stderr).split_whitespace().collect::<Vec<_>>().join(" ")
}

fn json(output: &Output) -> Value {
    let (out, err) = (text(&output.stdout), text(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap_or_else(|error| panic!("{error}: {out}{err}"))
}

fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("eni-interface-{name}"));
    std::fs::create_dir_all(&folder).expect("a folder");
    folder
}

/// A segment file, and its plan as ENI.
fn files(name: &str, segment: &str) -> (String, String) {
    let folder = folder(name);
    let paths = ["served.toml", "network.xml"].map(|file| folder.join(file).display().to_string());
    let [toml, eni] = paths;
    std::fs::write(&toml, segment).expect("the folder is ours");
    let output = isocat(&["plan", &toml, "--eni", &eni]);
    assert_eq!(output.status.code(), Some(0), "{}", told(&output));
    (toml, eni)
}

/// A served segment in a namespace of its own, which goes with it.
struct Service {
    child: Child,
    name: &'static str,
    output: BufReader<ChildStdout>,
    _alone: MutexGuard<'static, ()>,
}

impl Service {
    /// `None`, with a word, where namespaces can't be had.
    fn start(name: &'static str, segment: &str) -> Option<Self> {
        let alone = alone();
        let probe = format!("{name}-probe");
        let made = Command::new("ip").args(["netns", "add", &probe]).output();
        let permitted = made.is_ok_and(|output| output.status.success());
        let _ = Command::new("ip").args(["netns", "del", &probe]).output();
        if !permitted {
            eprintln!("skipped: it needs root and the command ip (iproute2)");
            return None;
        }
        let mut child = Command::new(ISOCAT)
            .args(["serve", segment, "--setup-veth", name])
            .stdout(Stdio::piped())
            .stderr(Stdio::inherit())
            .spawn()
            .expect("it starts");
        let mut output = BufReader::new(child.stdout.take().expect("a pipe"));
        let mut line = String::new();
        output.read_line(&mut line).expect("a first line");
        assert!(line.contains("erving"), "{line}");
        Some(Self { child, name, output, _alone: alone })
    }

    fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(ISOCAT);
        command.args(arguments).args(["--interface", self.name, "--netns", self.name]);
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }

    fn run(&self, arguments: &[&str]) -> Output {
        self.command(arguments).output().expect("isocat starts")
    }

    /// Reads what it prints until a line has these words, as often as `times`.
    fn until(&mut self, words: &str, times: usize) {
        let mut seen = 0;
        while seen < times {
            let mut line = String::new();
            assert_ne!(self.output.read_line(&mut line).expect("UTF-8"), 0, "it ended");
            seen += usize::from(line.contains(words));
        }
    }

    /// What it says at its end.
    fn finish(mut self) -> String {
        interrupt(&self.child);
        let mut rest = String::new();
        self.output.read_to_string(&mut rest).expect("UTF-8");
        rest
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        // Ended already, if all went well.
        let _ = self.child.kill();
        let _ = self.child.wait();
        let _ = Command::new("ip").args(["netns", "del", self.name]).output();
    }
}

/// Ctrl-C for a program of ours.
fn interrupt(child: &Child) {
    let id = child.id().to_string();
    let sent = Command::new("kill").args(["-INT", &id]).status();
    assert!(sent.expect("kill is there").success());
}

/// Runs until the machine did not stall; `None`, with a word, if it always does.
fn without_stalls(mut run: impl FnMut() -> Output) -> Option<(Output, Value)> {
    for _ in 0..5 {
        let output = run();
        let report = json(&output);
        let interface = &report["run"]["interface"];
        let counted = |what: &str| interface["punctuality"][what].as_u64() > Some(0);
        let late = interface["punctuality"]["send_lateness"]["span"]["max_ns"].as_f64();
        let skipped = counted("cycles_skipped") || counted("frames_lost");
        let open = interface["answer"] == "not-known";
        let stalled = skipped || open || late.is_none_or(|ns| ns > 2e6);
        if report["run"]["in_sync"] == true || !stalled {
            return Some((output, report));
        }
        eprintln!("the machine stalls: {}", interface["verdict"]);
    }
    eprintln!("skipped: this machine stalls all the time");
    None
}

#[test]
fn our_own_export_runs_on_a_wire() {
    let (segment, eni) = files("run", TWO_DRIVES);
    let Some(service) = Service::start("isct-en-run", &segment) else { return };
    let capture = folder("run").join("run.pcapng").display().to_string();
    let written = folder("run").join("run.txt").display().to_string();
    let arguments =
        ["run", &eni, "--for", "1s", "--json", "--capture", &capture, "--report", &written];
    let Some((output, report)) = without_stalls(|| service.run(&arguments)) else { return };
    assert_eq!(output.status.code(), Some(0), "{report:#}");
    assert_eq!(report["format"], "isocat-eni-run/2");
    let (run, interface) = (&report["run"], &report["run"]["interface"]);
    assert_eq!((&run["failure"], &run["summary"]), (&Value::Null, &Value::Null));
    assert_eq!((&interface["answer"], &interface["ended_by"]), (&"in-sync".into(), &"time".into()));
    assert!(interface["judged_ns"].as_i64() >= Some(1_000_000_000), "{report:#}");
    assert!(run["commands"].as_u64() > Some(30) && run["cycles"].as_u64() > Some(90), "{run:#}");
    assert_eq!(report["differences"], Value::Array(Vec::new()));
    for device in interface["devices"].as_array().expect("devices") {
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
    let written = std::fs::read_to_string(written).expect("the report was written");
    assert!(written.starts_with("In sync: the ENI was executed to the letter."), "{written}");
    assert!(written.contains("0x092C [r]") && written.contains("first pulse at"), "{written}");
    assert!(std::fs::metadata(capture).expect("a capture").len() > 100_000);
    // The served segment knows true time, and its devices were left in INIT.
    let summary = service.finish();
    assert!(summary.contains("In sync") && summary.contains(": INIT"), "{summary}");
}

/// What answers is compared with the list before anything is set up.
#[test]
fn other_devices_are_refused_before_anything_is_written() {
    let (_, eni) = files("other", TWO_DRIVES);
    let other = TWO_DRIVES.replacen("kollmorgen_akd2g", "hpmicro_ecat_cia402_ssc", 1);
    let (segment, _) = files("other-served", &other);
    let Some(service) = Service::start("isct-en-oth", &segment) else { return };
    let output = service.run(&["run", &eni, "--for", "1s"]);
    assert_eq!(output.status.code(), Some(2), "{}", told(&output));
    assert!(told(&output).contains("SubDevice 0 is vendor"), "{}", told(&output));
    assert!(told(&output).contains("as the ENI names it"), "{}", told(&output));
    let output = service.run(&["run", &eni, "--for", "1s", "--json"]);
    let report = json(&output);
    assert_eq!(output.status.code(), Some(2));
    assert_eq!(report["run"]["failure"]["kind"], "identity");
    assert_eq!(report["run"]["commands"], 0);
    // All that either run wrote is what reads an EEPROM.
    let summary = service.finish();
    assert!(summary.contains("reads SII EEPROMs"), "{summary}");
    assert!(!summary.contains("requests ") && !summary.contains("station addresses"), "{summary}");
}

/// A scan says what differs.
#[test]
fn a_scan_names_another_device() {
    let (_, eni) = files("scan", TWO_DRIVES);
    let other = TWO_DRIVES.replacen("kollmorgen_akd2g", "hpmicro_ecat_cia402_ssc", 1);
    let (segment, _) = files("scan-served", &other);
    let Some(service) = Service::start("isct-en-scn", &segment) else { return };
    let output = service.run(&["scan", &eni, "--json"]);
    let found = json(&output);
    assert_eq!(output.status.code(), Some(1), "{found:#}");
    let mismatches = found["mismatches"].as_array().expect("a list");
    assert_eq!(mismatches.len(), 1, "{mismatches:#?}");
    assert_eq!(mismatches[0]["kind"], "identity");
    assert_eq!((&mismatches[0]["on_wire"], &mismatches[0]["in_eni"]), (&0.into(), &0.into()));
}

#[test]
fn another_number_of_devices_is_refused_and_told_by_a_scan() {
    let three = format!("{TWO_DRIVES}[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\n");
    let (_, eni) = files("three", &three);
    let (segment, same) = files("three-served", TWO_DRIVES);
    let Some(service) = Service::start("isct-en-thr", &segment) else { return };
    let output = service.run(&["run", &eni, "--for", "1s"]);
    assert_eq!(output.status.code(), Some(2), "{}", told(&output));
    assert!(told(&output).contains("2 SubDevices answer; expected 3"), "{}", told(&output));
    let output = service.run(&["scan", &eni]);
    assert_eq!(output.status.code(), Some(1));
    let out = text(&output.stdout);
    assert!(out.contains("SubDevice 2 of the ENI: the wire has nothing"), "{out}");
    let output = service.run(&["scan", &same]);
    assert!(text(&output.stdout).starts_with("What answers is what"), "{}", text(&output.stdout));
    assert_eq!(output.status.code(), Some(0), "{}", told(&output));
    // A segment file says nothing of a wire.
    let output = service.run(&["scan", &segment]);
    assert_eq!(output.status.code(), Some(2));
    assert!(told(&output).contains("expected an ENI"), "{}", told(&output));
}

/// The first signal ends a run as its time does: judged, and down to INIT.
#[test]
fn a_signal_ends_it_in_init() {
    let (segment, eni) = files("signal", TWO_DRIVES);
    let Some(mut service) = Service::start("isct-en-sig", &segment) else { return };
    let run =
        service.command(&["run", &eni, "--for", "10min", "--json"]).spawn().expect("it starts");
    service.until("in operation: 2 SubDevices", 1);
    std::thread::sleep(std::time::Duration::from_millis(500));
    interrupt(&run);
    let output = run.wait_with_output().expect("it ends");
    let report = json(&output);
    let interface = &report["run"]["interface"];
    assert_eq!(interface["ended_by"], "signal", "{report:#}");
    assert!(interface["judged_ns"].as_i64() > Some(0), "{report:#}");
    assert!(interface["notes"].to_string().contains("ended by a signal"), "{report:#}");
    let summary = service.finish();
    assert_eq!(summary.matches(": INIT").count(), 2, "{summary}");
}

/// A device that loses power in operation is found: by the frames, and by its state.
#[test]
fn what_goes_wrong_in_operation_is_found() {
    let (segment, eni) = files("power", TWO_DRIVES);
    let Some(mut service) = Service::start("isct-en-pow", &segment) else { return };
    let run = service.command(&["run", &eni, "--for", "3s", "--json"]).spawn().expect("it starts");
    service.until("in operation: 2 SubDevices", 1);
    let port = format!("{}-seg", service.name);
    let output = isocat(&["control", &port, "power-cycle", "1", "200ms"]);
    assert!(output.status.success(), "{}", told(&output));
    let output = run.wait_with_output().expect("it ends");
    let report = json(&output);
    assert_eq!(output.status.code(), Some(1), "{report:#}");
    let findings = report["run"]["interface"]["findings"].as_array().expect("findings");
    let kinds: Vec<_> = findings.iter().filter_map(|one| one["kind"].as_str()).collect();
    assert!(kinds.contains(&"working-counter"), "{report:#}");
    let of_device = |one: &&Value| one["position"] == 1;
    assert!(findings.iter().any(|one| of_device(&one)), "{report:#}");
}

/// A command that fails ends the way up: it is told with its device, its state, and all go to INIT.
#[test]
fn a_command_that_fails_is_a_finding() {
    let (segment, eni) = files("fails", TWO_DRIVES);
    let text_of = std::fs::read_to_string(&eni).expect("it was written");
    let control = text_of.rfind("<Ado>288</Ado>").expect("AL control, last of all for OP");
    // The last request is for a state that there is not: 5.
    let (before, behind) = text_of.split_at(control);
    let broken = folder("fails").join("broken.xml").display().to_string();
    std::fs::write(&broken, format!("{before}{}", behind.replacen("<Data>08", "<Data>05", 1)))
        .expect("the folder is ours");
    let Some(service) = Service::start("isct-en-cmd", &segment) else { return };
    let output = service.run(&["run", &broken, "--for", "1s", "--json"]);
    let report = json(&output);
    assert_eq!(output.status.code(), Some(1), "{report:#}");
    let interface = &report["run"]["interface"];
    assert_eq!(interface["findings"][0]["kind"], "command-failed", "{report:#}");
    assert_eq!(interface["findings"][0]["position"], 1, "{report:#}");
    assert_eq!(interface["ended_by"], "bring-up");
    let states: Vec<_> = (0..2)
        .map(|at| interface["devices"][at]["registers"]["al_status"].as_str().unwrap_or_default())
        .collect();
    assert_eq!(states[0], "OP", "{states:?}");
    assert!(states[1].starts_with("SAFEOP"), "{states:?}");
    let summary = service.finish();
    assert_eq!(summary.matches(": INIT").count(), 2, "{summary}");
}

/// On a wire without SubDevices nothing is said of the list.
#[test]
fn nothing_that_answers_is_told() {
    let (_, eni) = files("nobody", TWO_DRIVES);
    let output = isocat(&["run", &eni, "--interface", "no-such-interface"]);
    assert_eq!(output.status.code(), Some(2), "{}", told(&output));
    let output = isocat(&["run", &eni, "--interface", "lo", "--metrics", "9999"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(told(&output).contains("--metrics is beside an ENI"), "{}", told(&output));
    let output = isocat(&["run", &eni, "--capture", "run.pcapng"]);
    assert!(told(&output).contains("--capture without --interface"), "{}", told(&output));
}

/// As an unmodified program in virtual time: exact, and the same each time.
#[test]
#[cfg(target_arch = "x86_64")]
fn it_runs_in_virtual_time() {
    let (segment, eni) = files("virtual", &TWO_DRIVES.replace("10ms", "1ms"));
    let run = || {
        let program = ["--", ISOCAT, "run", &eni, "--interface", "vt0", "--for", "1s"];
        isocat(&[&["virtual", &segment, "--json"], &program[..]].concat())
    };
    let output = run();
    let errors = text(&output.stderr);
    if errors.contains("can't be supervised here") {
        println!("skipped: {errors}");
        return;
    }
    let out = text(&output.stdout);
    let line = out.lines().last().unwrap_or_else(|| panic!("no summary: {errors}"));
    let summary: Value = serde_json::from_str(line).expect("JSON");
    assert_eq!(summary["sessions"][0]["answer"], "in-sync", "{out}\n{errors}");
    assert_eq!(output.status.code(), Some(0), "{out}\n{errors}");
    let again = text(&run().stdout);
    let again: Value = serde_json::from_str(again.lines().last().expect("a line")).expect("JSON");
    assert_eq!(summary, again);
}
