//! `isocat diagnose`: what it says of captures of simulated segments is what the judges in true
//! time know, from wherever the capture was taken; captures of real segments, if they lie beside
//! the project, give the table of `docs/diagnose.md`.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use isocat::capture::Capture;
use isocat::diagnose::report::{SeenKind, VerdictKind, WeightKind};
use isocat::diagnose::{DiagnoseReport, Diagnosis, Names};
use isocat::reading::{Frame, Reading};
use isocat::{Nanos, Report, Scenario, SegmentFile};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// Runs a segment; its capture, and what was true. `probe`: also taken in front of this position.
fn ran(segment: SegmentFile, probe: Option<usize>) -> (Vec<u8>, Report) {
    let mut scenario = Scenario::from(segment);
    scenario.duration = scenario.duration.min(Nanos::millis(4000));
    let mut file = Vec::new();
    let tap = Capture::new(&mut file).expect("a Vec takes everything");
    let tap = tap.with_probes(&probe.into_iter().collect::<Vec<_>>()).expect("a Vec");
    let outcome = scenario.run().execute(Some(tap), &mut |_| {});
    let report = Report::new(&scenario, &outcome);
    outcome.world.into_tap().expect("the tap").finish().expect("a Vec takes everything");
    (file, report)
}

fn built_in() -> (Vec<u8>, Report) {
    let mut file = SegmentFile::built_in();
    file.duration = Nanos::millis(300);
    ran(file, None)
}

fn diagnosed(file: &[u8]) -> DiagnoseReport {
    let mut diagnosis = Diagnosis::new();
    diagnosis.read("x.pcapng", file).expect("a capture");
    diagnosis.report(&Names::default()).expect("EtherCAT")
}

/// The frames of a capture, changed, as a file again.
fn changed(file: &[u8], change: impl Fn(usize, Frame) -> Option<Frame>) -> Vec<u8> {
    let frames = Reading::of(file).expect("a capture").frames;
    let mut capture = Capture::new(Vec::new()).expect("a Vec takes everything");
    for frame in frames.into_iter().enumerate().filter_map(|(at, frame)| change(at, frame)) {
        capture.write(frame.at, frame.sent == Some(true), &frame.bytes);
    }
    capture.finish().expect("a Vec takes everything")
}

fn kinds(report: &DiagnoseReport, weight: WeightKind) -> Vec<&'static str> {
    report.findings.iter().filter(|one| one.weight == weight).map(|one| one.kind).collect()
}

fn faults(report: &DiagnoseReport) -> Vec<&'static str> {
    kinds(report, WeightKind::Fault)
}

/// From the end of frames to SYNC0 of each device, in ns: what the capture says, shortest and
/// longest, what was true, and how far these may lie apart.
struct Distances {
    seen: [f64; 2],
    truth: [f64; 2],
    allowed: f64,
}

impl Distances {
    fn of(report: &DiagnoseReport, truth: &Report) -> Vec<Self> {
        let devices = report.devices.iter().zip(&truth.devices);
        let all = (0..).zip(devices).filter_map(|(place, (device, truth))| {
            let seen = device.distance.as_ref()?;
            let span = truth.true_time.sm2_to_sync0.as_ref()?;
            let error = truth.true_time.sync0_error.as_ref()?;
            // The judge counts by the device's own oscillator.
            let rate = 1.0 + truth.true_time.clock.deviation_ppb as f64 / 1e9;
            Some(Self {
                seen: [seen.shortest_ns.value as f64, seen.longest_ns.value as f64],
                truth: [span.min_ns / rate, span.max_ns / rate],
                // The reference clock's grain, the device's, the tick of its SYNC0, how far that
                // is off, and the jitter of the hops behind the reference clock.
                allowed: 10.0 + 10.0 + 10.0 + error.worst_ns + 20.0 * f64::from(place),
            })
        });
        all.collect()
    }

    fn check(&self, name: &str) {
        for (seen, truth) in self.seen.iter().zip(self.truth) {
            assert!((seen - truth).abs() <= self.allowed, "{name}: {seen}, {truth} in true time");
        }
    }
}

#[test]
fn a_healthy_run_is_in_sync_and_its_distances_are_true() {
    let (file, truth) = built_in();
    let report = diagnosed(&file);
    assert!(truth.in_sync);
    assert_eq!(report.verdict.kind, VerdictKind::InSync, "{}", report.text());
    assert_eq!(faults(&report), [""; 0]);
    assert_eq!(report.devices.len(), truth.devices.len());
    let all = Distances::of(&report, &truth);
    assert_eq!(all.len(), 3, "devices with SYNC0 and outputs");
    all.iter().for_each(|one| one.check("healthy"));
    for (device, truth) in report.devices.iter().zip(&truth.devices) {
        assert_eq!(device.position.map(usize::from), Some(truth.position));
        assert_eq!(device.state.as_deref(), Some("OP"));
        assert!(device.name.is_some() && device.identity.vendor.is_some());
    }
    let clock = report.clock.as_ref().expect("drift frames");
    assert_eq!((clock.command, clock.reference, clock.bytes), ("FRMW", Some(0), 8));
    let text = report.text();
    for words in ["In sync as far as", "0x1C32:06 (calc and copy time) 60 us", "SYNC0 each 1 ms"] {
        assert!(text.contains(words), "{words}: {text}");
    }
}

/// The stamps of a capture say nothing about SYNC0: in whole milliseconds, all that comes of the
/// reference clock stays as it is.
#[test]
fn bad_stamps_change_no_distance() {
    let (file, _) = built_in();
    let exact = diagnosed(&file);
    let coarse = changed(&file, |_, frame| {
        let at = Duration::from_millis(frame.at.as_millis() as u64);
        Some(Frame { at, ..frame })
    });
    let report = diagnosed(&coarse);
    let of = |report: &DiagnoseReport| {
        let distances = report.devices.iter().map(|device| device.distance.clone());
        let by_clock = report.cycle.as_ref().and_then(|cycle| cycle.by_clock.clone());
        let figures = distances.map(|distance| {
            distance.map(|one| (one.frames, one.shortest_ns.value, one.longest_ns.value))
        });
        (figures.collect::<Vec<_>>(), by_clock.map(|one| (one.mean_ns, one.longest_ns.value)))
    };
    assert_eq!(of(&exact), of(&report));
    assert_eq!(report.verdict.kind, VerdictKind::InSync, "{}", report.text());
}

/// Nothing comes back any more: that is the loudest fault, however healthy all was before. The last
/// frames of a capture may be under way.
#[test]
fn silence_to_the_end_is_a_fault() {
    let (file, _) = built_in();
    let all = Reading::of(&file).expect("a capture").frames;
    let is_answer = |frame: &Frame| frame.bytes.get(6).is_some_and(|octet| octet & 2 != 0);
    let answers: Vec<usize> = (0..all.len()).filter(|at| is_answer(&all[*at])).collect();
    let without = |last: usize| {
        let first = answers[answers.len() - last];
        let cut = |at, frame: Frame| (at < first || !is_answer(&frame)).then_some(frame);
        diagnosed(&changed(&file, cut))
    };
    let silent = |report: &DiagnoseReport| {
        let mut found = report.findings.iter().filter(|one| one.kind == "silent-to-the-end");
        found.next().map(|one| one.what.clone())
    };
    let first = (1..100).find_map(|last| Some((last, silent(&without(last))?)));
    let (last, what) = first.expect("silence is found");
    assert!(what.contains(" 8 cyclic frames"), "{last} frames without an answer: {what}");
    let long = without(1_000);
    assert_eq!(long.verdict.kind, VerdictKind::Found);
    assert_eq!(faults(&long)[0], "silent-to-the-end", "{}", long.text());
}

/// The built-in segment's capture with each reading of AL status changed.
fn with_states(change: impl Fn(&mut [u8])) -> DiagnoseReport {
    let (file, _) = built_in();
    let changed = changed(&file, |_, frame: Frame| {
        let mut bytes = frame.bytes.to_vec();
        for at in 16..bytes.len().saturating_sub(12) {
            let reads = matches!(bytes[at], 1 | 4 | 7) && bytes[at + 4..at + 6] == [0x30, 0x01];
            if reads && matches!(bytes[at + 6], 2 | 6) {
                change(&mut bytes[at..at + 12]);
            }
        }
        Some(Frame { bytes, ..frame })
    });
    diagnosed(&changed)
}

#[test]
fn a_device_that_stays_below_op_is_a_fault() {
    let report = with_states(|datagram| {
        if datagram[10..] == [8, 0] {
            datagram[10] = 4;
        }
    });
    assert_eq!(report.verdict.kind, VerdictKind::Found, "{}", report.text());
    assert!(faults(&report).contains(&"stayed-below-op"), "{}", report.text());
}

/// Frames in time prove nothing while the state of the device is not known.
#[test]
fn a_device_that_was_not_read_in_op_is_not_in_sync() {
    // The registers that are read are others.
    let report = with_states(|datagram| datagram[4] = 0x40);
    assert_eq!(faults(&report), [""; 0], "{}", report.text());
    assert!(report.devices.iter().any(|device| device.distance.is_some()), "{}", report.text());
    assert_eq!(report.verdict.kind, VerdictKind::NothingFound);
    assert!(report.verdict.sentence.contains("was not read in OP"), "{}", report.verdict.sentence);
}

/// A capture that begins anywhere: no fault is made up, and what was before is told as unknown.
#[test]
fn captures_that_begin_in_the_middle() {
    let (file, _) = built_in();
    let all = Reading::of(&file).expect("a capture").frames.len();
    for share in 1..12 {
        let first = all * share / 12;
        let report = diagnosed(&changed(&file, |at, frame| (at >= first).then_some(frame)));
        assert_eq!(faults(&report), [""; 0], "from frame {first} on: {}", report.text());
    }
    let report = diagnosed(&changed(&file, |at, frame| (at >= all - 1000).then_some(frame)));
    assert_eq!(report.verdict.kind, VerdictKind::NothingFound);
    assert!(!report.unknown.is_empty() && report.devices.iter().all(|one| one.distance.is_none()));
    assert!(report.cycle.is_some_and(|cycle| cycle.by_clock.is_some()));
}

#[test]
fn one_direction_alone() {
    let (file, _) = built_in();
    let both = diagnosed(&file);
    let back = diagnosed(&changed(&file, |_, frame| (frame.sent == Some(false)).then_some(frame)));
    assert_eq!(back.tap.as_ref().map(|tap| tap.seen), Some(SeenKind::Back));
    assert_eq!(faults(&back), [""; 0], "{}", back.text());
    let of = |report: &DiagnoseReport| {
        let devices = report.devices.iter();
        devices
            .map(|one| (one.position, one.station.as_ref().map(|at| at.value), one.name.clone()))
            .collect::<Vec<_>>()
    };
    assert_eq!(of(&back), of(&both));
    let ns = |report: &DiagnoseReport| {
        let all = report.devices.iter().filter_map(|device| device.distance.as_ref());
        all.map(|one| (one.shortest_ns.value, one.longest_ns.value)).collect::<Vec<_>>()
    };
    assert_eq!(ns(&back), ns(&both), "the reference's time is in the answers");
    let out = diagnosed(&changed(&file, |_, frame| (frame.sent == Some(true)).then_some(frame)));
    assert_eq!(out.tap.as_ref().map(|tap| tap.seen), Some(SeenKind::Out));
    assert_eq!((out.verdict.kind, faults(&out)), (VerdictKind::NothingFound, vec![]));
}

/// Between the devices frames have passed some of them already; what is known stays the same.
#[test]
fn a_tap_in_the_line() {
    let mut segment = SegmentFile::built_in();
    segment.duration = Nanos::millis(100);
    let (file, _) = ran(segment, Some(2));
    let at_port = diagnosed(&file);
    assert!(at_port.frames.elsewhere > 1000, "the probe is another interface");
    let mut capture = Capture::new(Vec::new()).expect("a Vec");
    for frame in Reading::of(&file).expect("a capture").frames {
        if frame.interface == 1 {
            capture.write(frame.at, frame.sent == Some(true), &frame.bytes);
        }
    }
    let report = diagnosed(&capture.finish().expect("a Vec"));
    let tap = report.tap.as_ref().expect("a tap");
    assert_eq!((tap.behind, tap.marked, tap.seen), (2, false, SeenKind::Both), "{}", report.text());
    // The probe sees frames enter SubDevice 2 and leave it.
    let position = report.devices.iter().map(|device| device.position).collect::<Vec<_>>();
    assert!(position.contains(&Some(2)), "{position:?}");
}

/// Answers that reach the MainDevice late are told from such that are lost, and from such that are
/// only slow.
#[test]
fn answers_that_come_in_the_next_cycle() {
    let with = |what: &str| {
        let text = format!(
            "cycle = \"1ms\"\nfor = \"500ms\"\n[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\ncount = 2\n\
             [[fault]]\nat = \"in-operation + 100ms\"\nwhat = \"{what} for 300ms\"\n"
        );
        diagnosed(&ran(SegmentFile::parse("late.toml", &text).expect("a segment file"), None).0)
    };
    let slow = with("delay 900us 5%");
    assert_eq!(faults(&slow), [""; 0], "{}", slow.text());
    let took = |report: &DiagnoseReport| report.cycle.clone()?.round_trip;
    let longest = took(&slow).expect("both directions").longest_ns.value;
    assert!((900_000..950_000).contains(&longest), "{longest}");
    let late = with("delay 1100us 5%");
    assert_eq!(faults(&late), ["answers-late"], "{}", late.text());
    // The machine gives them up after two cycles, and the capture knows better.
    let given_up = with("delay 5ms 5%");
    assert_eq!(faults(&given_up), ["answers-late"], "{}", given_up.text());
    let lost = with("loss 5%");
    assert_eq!(faults(&lost)[0], "frames-lost", "{}", lost.text());
}

/// Kind of the first fault, and place of the device that it names.
type First = Option<(&'static str, Option<usize>)>;

/// What each of `docs/faults` shows on the wire: the first fault, and the device that it names.
const FAULTS: [(&str, First); 27] = [
    ("al-error", Some(("left-op", Some(1)))),
    ("break", Some(("devices-vanished", Some(1)))),
    // The host counts cycles otherwise; on the wire nothing changes.
    ("clock-jump", None),
    ("clock-walk", None),
    ("clock", None),
    ("damage", Some(("frames-lost", None))),
    ("dead-eeprom", Some(("devices-vanished", Some(2)))),
    // Frames that take longer come back later; they reach the devices as before.
    ("delay", None),
    ("double", Some(("frames-doubled", None))),
    ("drop", Some(("frames-lost", None))),
    ("flap", Some(("devices-vanished", Some(2)))),
    ("heal", Some(("frames-lost", None))),
    ("late-wake-ups", None),
    ("loss", Some(("frames-lost", None))),
    // A device that copies late, and whose counters fall again before they are read.
    ("misbehave", None),
    ("plug", Some(("devices-vanished", Some(2)))),
    ("power-cycle", Some(("devices-vanished", Some(2)))),
    ("power-off", Some(("devices-vanished", Some(2)))),
    ("power-on", Some(("devices-vanished", Some(2)))),
    ("pull", Some(("devices-vanished", Some(1)))),
    // A longer way moves SYNC0 by half a microsecond, which no frame shows.
    ("recable", None),
    ("replace", Some(("devices-vanished", Some(2)))),
    ("second-master", Some(("another-talker", None))),
    ("slow-send", None),
    ("stall", Some(("cycles-skipped", None))),
    ("stuck-mailbox", None),
    ("sync-off", Some(("left-op", Some(1)))),
];

#[test]
fn the_first_fault_is_the_one_that_was_made() {
    let folder = root().join("docs/faults");
    let files = std::fs::read_dir(&folder).expect("the folder").count();
    assert_eq!(files, FAULTS.len() + 1, "all but the ring");
    for (name, expected) in FAULTS {
        let path = folder.join(name).with_extension("toml");
        let segment = SegmentFile::read(&path.display().to_string()).expect("it is right");
        let (file, truth) = ran(segment, None);
        let report = diagnosed(&file);
        let first = report.findings.iter().find(|one| one.weight == WeightKind::Fault);
        let first = first.map(|one| (one.kind, one.device));
        assert_eq!(first, expected, "{name}: {}", report.text());
        // What was in sync in true time is not accused.
        if truth.in_sync && name != "second-master" {
            assert_eq!(report.verdict.kind, VerdictKind::InSync, "{name}");
        }
        // Where devices left, the judges count on while the capture shows nothing of them; with a
        // wrong delay SYNC0 is off.
        if expected.is_none() && name != "recable" {
            Distances::of(&report, &truth).iter().for_each(|one| one.check(name));
        }
    }
}

#[test]
fn both_ends_of_a_ring() {
    let path = root().join("docs/faults/ring.toml").display().to_string();
    let (file, _) = ran(SegmentFile::read(&path).expect("it is right"), None);
    let mut capture = Vec::new();
    std::io::Read::read_to_end(&mut &file[..], &mut capture).expect("in memory");
    let report = diagnosed(&capture);
    assert!(report.tap.as_ref().is_some_and(|tap| tap.ring), "{}", report.text());
    assert!(!faults(&report).contains(&"another-talker"), "{}", report.text());
}

/// Not led, clocks run apart; not locked, the host slides through the cycle.
#[test]
fn clocks_that_nothing_leads() {
    let mut scenario = Scenario::from(SegmentFile::built_in());
    scenario.duration = Nanos::millis(300);
    scenario.drift_compensation = false;
    let tap = Capture::new(Vec::new()).expect("a Vec");
    let outcome = scenario.run().execute(Some(tap), &mut |_| {});
    let file = outcome.world.into_tap().expect("the tap").finish().expect("a Vec");
    let report = diagnosed(&file);
    let found = faults(&report);
    assert!(
        found.contains(&"no-drift-frames") || found.contains(&"drift-frames-stopped"),
        "{}",
        report.text()
    );
}

#[test]
fn several_files_are_one_capture() {
    let (file, _) = built_in();
    let whole = diagnosed(&file);
    let all = Reading::of(&file).expect("a capture").frames.len();
    let half = all / 2;
    let first = changed(&file, |at, frame| (at < half).then_some(frame));
    let second = changed(&file, |at, frame| (at >= half).then_some(frame));
    let mut diagnosis = Diagnosis::new();
    for (name, file) in [("a.pcapng", &first), ("b.pcapng", &second)] {
        diagnosis.read(name, &file[..]).expect("a capture");
    }
    let report = diagnosis.report(&Names::default()).expect("EtherCAT");
    assert_eq!(report.frames, whole.frames);
    let frames = |report: &DiagnoseReport| {
        let all = report.devices.iter().flat_map(|device| &device.states);
        all.map(|state| state.frame).collect::<Vec<_>>()
    };
    for (one, other) in frames(&report).into_iter().zip(frames(&whole)) {
        let before = if one.capture == 0 { 0 } else { half };
        assert_eq!(one.frame + before, other.frame);
    }
    assert_eq!(report.captures.len(), 2);
}

/// Damaged files are read as far as they go, or refused; nothing panics.
#[test]
fn damaged_captures() {
    let mut segment = SegmentFile::built_in();
    segment.duration = Nanos::millis(5);
    let (file, _) = ran(segment, None);
    for at in (0..file.len()).step_by(file.len() / 97) {
        let mut diagnosis = Diagnosis::new();
        if diagnosis.read("cut", &file[..at]).is_ok() {
            let _ = diagnosis.report(&Names::default()).map(|report| report.text());
        }
        let mut damaged = file.clone();
        for byte in damaged.iter_mut().skip(at).step_by(1009) {
            *byte ^= 0x55;
        }
        let mut diagnosis = Diagnosis::new();
        if diagnosis.read("damaged", &damaged[..]).is_ok() {
            let _ = diagnosis.report(&Names::default()).map(|report| report.text());
        }
    }
}

fn isocat(arguments: &[&str]) -> (Option<i32>, String, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_isocat")).args(arguments).output();
    let output = output.expect("the command runs");
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("UTF-8");
    (output.status.code(), text(output.stdout), text(output.stderr))
}

#[test]
fn exit_codes_and_json() {
    let folder = std::env::temp_dir().join(format!("isocat-diagnose-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    let path = |name: &str| folder.join(name).display().to_string();
    let (file, _) = built_in();
    std::fs::write(path("good.pcapng"), &file).expect("written");
    let frames = Reading::of(&file).expect("a capture").frames;
    // Behind the cycles the counters of the devices are read.
    let from = frames.len() - 200;
    let answer = frames[from..].iter().position(|frame| frame.sent == Some(false));
    let answer = from + answer.expect("an answer a cycle");
    let lost = changed(&file, |at, frame| (at != answer).then_some(frame));
    std::fs::write(path("lost.pcapng"), lost).expect("written");
    std::fs::write(path("x.zip"), b"PK\x03\x04").expect("written");
    let (code, text, _) = isocat(&["diagnose", &path("good.pcapng")]);
    assert_eq!((code, text.contains("In sync")), (Some(0), true), "{text}");
    let (code, text, _) = isocat(&["diagnose", "--json", &path("lost.pcapng")]);
    let json: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    assert_eq!((code, &json["findings"][0]["kind"]), (Some(1), &"frames-lost".into()));
    for (name, words) in
        [("x.zip", "zip archive"), ("none.pcapng", "No such file"), ("", "directory")]
    {
        let (code, _, error) = isocat(&["diagnose", &path(name)]);
        assert!(code == Some(2) && error.contains(words), "{name}: {error}");
    }
    let report = path("report.txt");
    let (code, _, _) = isocat(&["diagnose", &path("good.pcapng"), "--report", &report]);
    let text = std::fs::read_to_string(&report).expect("written");
    assert!(code == Some(0) && text.starts_with("In sync as far as"), "{text}");
    std::fs::remove_dir_all(&folder).expect("removed");
}

#[test]
fn the_schema_is_committed() {
    let path = root().join("docs/diagnose.schema.json");
    let now =
        serde_json::to_string_pretty(&isocat::diagnose::report::schema()).expect("JSON") + "\n";
    if std::env::var_os("UPDATE_SCHEMA").is_some() {
        std::fs::write(&path, &now).expect("the schema is writable");
    }
    let committed = std::fs::read_to_string(&path).expect("the schema is committed");
    assert!(
        committed == now,
        "docs/diagnose.schema.json is not what the report is: UPDATE_SCHEMA=1"
    );
}

/// Each kind is told in the documentation.
#[test]
fn all_kinds_are_documented() {
    let page = std::fs::read_to_string(root().join("docs/diagnose.md")).expect("the page");
    for kind in isocat::diagnose::KINDS {
        assert!(page.contains(&format!("| `{kind}` |")), "docs/diagnose.md lacks {kind}");
    }
}

/// Captures of real segments: what is found in each, as the table of the documentation has it.
#[test]
fn captures_of_real_segments() {
    let shared = std::env::var_os("ISOCAT_SHARED").map(PathBuf::from);
    let folder = shared.unwrap_or_else(|| root().join("../shared")).join("captures");
    let Ok(entries) = std::fs::read_dir(&folder) else {
        return eprintln!("skipped: {} is not there", folder.display());
    };
    let mut names: Vec<String> = entries
        .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
        .filter_map(|name| Some(name.strip_suffix(".pcapng")?.to_owned()))
        .collect();
    names.sort();
    let mut table = String::new();
    for name in names {
        let file = std::fs::read(folder.join(&name).with_extension("pcapng")).expect("readable");
        let report = diagnosed(&file);
        let devices = report.devices.iter().map(|device| {
            let product = device.identity.product.as_ref();
            let station = device.station.as_ref().map_or(0, |station| station.value);
            product.map_or(format!("{station:#06x}"), |product| format!("{:08x}", product.value))
        });
        let states = report.devices.iter().map(|device| device.state.clone().unwrap_or_default());
        let clock = report.clock.as_ref();
        let sdos = report.devices.iter().filter_map(|device| device.mailbox.as_ref());
        let aborts: usize = sdos.clone().flat_map(|one| &one.aborts).map(|one| one.count).sum();
        let _ = writeln!(
            table,
            "| {name} | {} + {} | {} | {} | {} | {} + {aborts} | {} |",
            report.frames.pairs,
            report.frames.unanswered + report.frames.answers_alone,
            devices.collect::<Vec<_>>().join(", "),
            states.collect::<Vec<_>>().join(", "),
            clock.map_or(String::new(), |clock| format!("{} {}", clock.frames, clock.command)),
            sdos.map(|mailbox| mailbox.transfers).sum::<u64>(),
            report.findings.iter().map(|one| one.kind).collect::<Vec<_>>().join(", "),
        );
    }
    let page = root().join("docs/diagnose.md");
    let text = std::fs::read_to_string(&page).expect("the page");
    let begin = text.find(FIRST_ROW).expect("the table") + FIRST_ROW.len();
    let end = begin + text[begin..].find("\n\n").expect("the end of the table") + 1;
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        std::fs::write(&page, format!("{}{table}{}", &text[..begin], &text[end..]))
            .expect("written");
        return;
    }
    assert_eq!(&text[begin..end], table, "UPDATE_GOLDEN=1 writes it");
}

const FIRST_ROW: &str = "| capture | pairs + alone | devices | last states | drift frames | SDO + aborts | findings |\n|---|---|---|---|---|---|---|\n";
