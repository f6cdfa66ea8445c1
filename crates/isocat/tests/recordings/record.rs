//! Frames that are kept for the moment in which something happens: the judge that looks at them as
//! they come, the files that are written for it, and `isocat record` as a command.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Receiver;
use std::time::Duration;

use isocat::capture::Capture;
use isocat::diagnose::live::{Live, News, Symptom};
use isocat::diagnose::{DiagnoseReport, Diagnosis, Names};
use isocat::flight::{Limits, Told};
use isocat::reading::{Frame, Reading};
use isocat::record::{Event, Guard, On, Wanted};
use isocat::{Scenario, SegmentFile};

const SEGMENT: &str = r#"
cycle = "1ms"
for = "3s"
recovery = { first = "20ms", longest = "100ms" }
[[subdevice]]
device = "simple_io16"
name = "io"
[[subdevice]]
device = "model_every_mode"
mode = "dc-sync0"
name = "axis 1"
[[subdevice]]
device = "kollmorgen_akd2g"
name = "axis 2"
"#;

/// Frames of a run with these faults, each at an instant behind the beginning of operation.
fn frames(faults: &[(&str, &str)]) -> Vec<Frame> {
    let mut text = SEGMENT.to_owned();
    for (at, what) in faults {
        text += &format!("[[fault]]\nat = \"in-operation + {at}\"\nwhat = \"{what}\"\n");
    }
    let scenario = Scenario::from(SegmentFile::parse("made.toml", &text).expect("it is right"));
    let tap = Capture::new(Vec::new()).expect("a Vec takes everything");
    let outcome = scenario.run().execute(Some(tap), &mut |_| {});
    let file = outcome.world.into_tap().expect("it was given").finish().expect("a Vec");
    Reading::of(&file).expect("a capture").frames
}

/// A folder of one test's own, removed at its end.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let name = format!("isocat-record-{}-{name}", std::process::id());
        let path = std::env::temp_dir().join(name);
        let _ = std::fs::remove_dir_all(&path);
        Self(path)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

fn wanted(on: &[On]) -> Wanted {
    let limits = Limits {
        keep: Duration::from_millis(200),
        after: Duration::from_millis(100),
        most_bytes: 64 << 20,
        most_files: 10,
    };
    let positions = ["io", "axis 1", "axis 2"].map(str::to_owned).to_vec();
    Wanted { limits, on: on.to_vec(), names: Names { positions, ..Names::default() }, claims: None }
}

/// A guard that saw all these frames; `hook` comes before each. Its events.
fn guarded(
    folder: &Folder,
    on: &[On],
    frames: &[Frame],
    mut hook: impl FnMut(usize, &AtomicBool),
) -> Vec<Event> {
    let asked = Arc::new(AtomicBool::new(false));
    let (mut guard, events) =
        Guard::new(&folder.0, "eth0", wanted(on), asked.clone()).expect("it is writable");
    for (number, frame) in frames.iter().enumerate() {
        hook(number, &asked);
        guard.frame(frame.at, frame.sent == Some(true), &frame.bytes);
    }
    // What was lost at the end is known a second later.
    let last = frames.last().map_or(Duration::ZERO, |frame| frame.at);
    guard.idle(last + Duration::from_secs(2));
    guard.finish();
    Receiver::into_iter(events).collect()
}

fn happened(events: &[Event]) -> Vec<(&'static str, Option<usize>)> {
    let happened = events.iter().filter_map(|event| match event {
        Event::Happened { frame, reason, .. } => Some((reason.kind, *frame)),
        Event::File(_) => None,
    });
    happened.collect()
}

fn files(events: &[Event]) -> Vec<&Path> {
    let files = events.iter().filter_map(|event| match event {
        Event::File(Told::Written { path, .. }) => Some(path.as_path()),
        Event::File(other) => panic!("{other:?}"),
        Event::Happened { .. } => None,
    });
    files.collect()
}

fn diagnosed(path: &Path) -> DiagnoseReport {
    let mut diagnosis = Diagnosis::new();
    let file = std::fs::File::open(path).expect("it was written");
    diagnosis.read("x.pcapng", file).expect("a capture");
    diagnosis.report(&Names::default()).expect("EtherCAT")
}

/// What a live judge says that is asked each 20 ms: each news with the time at which it was told.
fn told(frames: &[Frame], mut forgets: impl FnMut(Duration) -> bool) -> Vec<(Duration, News)> {
    let mut live = Live::new("eth0");
    let mut all = Vec::new();
    let mut look = frames[0].at;
    for frame in frames {
        if frame.at >= look {
            look = frame.at + Duration::from_millis(20);
            let news = live.news(&Names::default());
            all.extend(news.into_iter().map(|news| (frame.at, news)));
            if forgets(frame.at) {
                live.forget();
            }
        }
        live.frame(frame.clone());
    }
    all
}

#[test]
fn a_fault_is_told_while_it_is_young() {
    for (what, kind, symptom, late) in [
        ("pull axis 1 for 200ms", "devices-vanished", Symptom::State, 100),
        ("al-error axis 1 0x8001", "left-op", Symptom::State, 100),
        ("stall 5ms", "cycles-skipped", Symptom::Sync, 100),
        // That no answer comes is known when it has not come for a second.
        ("drop 1", "frames-lost", Symptom::Frames, 1100),
    ] {
        let frames = frames(&[("1200ms", what)]);
        let told = told(&frames, |_| false);
        let Some((at, news)) = told.iter().find(|(_, news)| news.finding.kind == kind) else {
            panic!("{what}: {told:?}")
        };
        assert_eq!(news.symptom, symptom, "{what}");
        let shown = frames[news.frame - 1].at;
        let lateness = *at - shown;
        assert!(lateness <= Duration::from_millis(late), "{what}: {lateness:?} late");
        // The same frame that the whole capture is told with.
        let mut diagnosis = Diagnosis::new();
        let mut capture = Capture::new(Vec::new()).expect("a Vec takes everything");
        for frame in &frames {
            capture.write(frame.at, frame.sent == Some(true), &frame.bytes);
        }
        let file = capture.finish().expect("a Vec takes everything");
        diagnosis.read("x.pcapng", &file[..]).expect("a capture");
        let report = diagnosis.report(&Names::default()).expect("EtherCAT");
        let first = report.findings.iter().find(|finding| finding.kind == kind);
        assert_eq!(first.map(|first| first.frame.frame), Some(news.frame), "{what}");
    }
}

#[test]
fn a_healthy_segment_is_no_news() {
    assert!(told(&frames(&[]), |_| false).is_empty());
    // Forgetting makes none either.
    assert!(told(&frames(&[]), |_| true).is_empty());
}

#[test]
fn what_happens_again_is_told_again() {
    let frames = frames(&[("500ms", "drop 1"), ("2s", "drop 1")]);
    let counts = |told: &[(Duration, News)]| {
        told.iter().filter(|(_, news)| news.finding.kind == "frames-lost").count()
    };
    let once = told(&frames, |_| false);
    assert_eq!(counts(&once), 1, "what was told is not told again");
    let second = frames[0].at + Duration::from_millis(10);
    let mut next = second;
    let again = told(&frames, |now| {
        let due = now >= next;
        next = if due { now + Duration::from_millis(100) } else { next };
        due
    });
    assert_eq!(counts(&again), 2, "{again:?}");
}

#[test]
fn files_have_the_fault_and_its_reason() {
    let folder = Folder::new("reason");
    let frames = frames(&[("1200ms", "al-error axis 1 0x8001")]);
    let events = guarded(&folder, &On::ALL, &frames, |_, _| {});
    let left_op = happened(&events).into_iter().find(|(kind, _)| *kind == "left-op");
    let Some((_, Some(frame))) = left_op else { panic!("{events:?}") };
    let [path] = files(&events)[..] else { panic!("{events:?}") };
    let report = diagnosed(path);
    assert!(report.findings.iter().any(|finding| finding.kind == "left-op"), "{}", report.text());

    let file = std::fs::File::open(path).expect("it was written");
    let mut reader = pcap_file::pcapng::PcapNgReader::new(file).expect("pcapng");
    let mut commented = Vec::new();
    while let Some(block) = reader.next_block() {
        use pcap_file::pcapng::Block;
        use pcap_file::pcapng::blocks::enhanced_packet::EnhancedPacketOption::Comment;
        let Block::EnhancedPacket(packet) = block.expect("whole") else { continue };
        let is = |option: &_| matches!(option, Comment(words) if words.contains("left-op"));
        if packet.options.iter().any(is) {
            commented.push((packet.timestamp, packet.data.into_owned()));
        }
    }
    let shows = &frames[frame - 1];
    assert_eq!(commented, [(shows.at, shows.bytes.clone())], "the very frame has the comment");
}

#[test]
fn only_what_was_asked_for_is_written() {
    let frames = frames(&[("1200ms", "al-error axis 1 0x8001")]);
    let quiet = Folder::new("quiet");
    assert!(guarded(&quiet, &[On::Lost, On::Signal], &frames, |_, _| {}).is_empty());

    let signal = Folder::new("signal");
    let events = guarded(&signal, &[On::Signal], &frames, |number, asked| {
        if number == 1000 {
            asked.store(true, Ordering::Relaxed);
        }
    });
    assert_eq!(happened(&events), [("signal", None)]);
    assert_eq!(files(&events).len(), 1);

    let deaf = Folder::new("deaf");
    let events = guarded(&deaf, &[On::Lost], &frames, |_, asked| {
        asked.store(true, Ordering::Relaxed);
    });
    assert!(events.is_empty(), "{events:?}");
}

#[test]
fn a_fault_behind_another_is_not_lost() {
    let folder = Folder::new("behind");
    let frames =
        frames(&[("500ms", "al-error axis 1 0x8001"), ("1500ms", "al-error axis 2 0x8002")]);
    let events = guarded(&folder, &[On::AlState], &frames, |_, _| {});
    assert_eq!(files(&events).len(), 2, "{events:?}");
    let kinds: Vec<_> = happened(&events).into_iter().map(|(kind, _)| kind).collect();
    assert_eq!(kinds, ["left-op", "left-op"]);
}

#[cfg(target_os = "linux")]
mod command {
    use std::process::{Command, Output};

    fn isocat(arguments: &[&str]) -> Output {
        Command::new(env!("CARGO_BIN_EXE_isocat")).args(arguments).output().expect("it starts")
    }

    fn refused(arguments: &[&str], says: &str) {
        let output = isocat(arguments);
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {text}");
        let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(text.contains(says), "{arguments:?}: {text}");
    }

    #[test]
    fn bad_input_is_told() {
        let record = |more: &[&'static str]| {
            let mut all = vec!["record", "--interface", "isct-none"];
            all.extend(more);
            all
        };
        refused(&record(&["--keep", "0s"]), "expected 10ms to 10min, found 0s");
        refused(&record(&["--keep", "8760h"]), "expected 10ms to 10min, found 8760h");
        refused(&record(&["--after", "61s"]), "expected 0s to 1min, found 61s");
        refused(&record(&["--most-files", "0"]), "0 is not in 1..=10000");
        refused(&record(&["--memory", "0"]), "0 is not in 1..=16384");
        refused(&record(&["--on", "wkc,thunder"]), "thunder");
        refused(&record(&["--for", "0s"]), "expected a duration above zero");
        refused(&["record"], "--interface <IF>");
        refused(&["run", "--record", "x"], "go with --interface");
        refused(&["run", "--interface", "isct-none", "--keep", "1s"], "isct-none");
        refused(&["watch", "--after", "1s"], "go with --interface");
        refused(&["diagnose", "--for", "1s"], "--interface <IF>");
        refused(&["diagnose", "x.pcapng", "--interface", "lo"], "cannot be used with");
    }

    /// With or without the right to raw sockets.
    #[test]
    fn interfaces_that_can_not_be_heard_are_told() {
        for verb in ["record", "diagnose"] {
            let output = isocat(&[verb, "--interface", "isct-none", "--for", "100ms"]);
            let text = String::from_utf8_lossy(&output.stderr).into_owned();
            assert_eq!(output.status.code(), Some(2), "{text}");
            let known = text.contains("there is no network interface \"isct-none\"")
                || text.contains("is not permitted");
            assert!(known, "{text}");
        }
    }
}
