//! `isocat replay`: captures of our own segments are exact, a changed byte is named, no file brings
//! it down; captures of real segments, if they lie beside the project, give the table of
//! `docs/replay.md`.
//!
//! `UPDATE_GOLDEN=1` writes the table of `docs/replay.md` and `docs/replay.schema.json`.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use isocat::capture::Capture;
use isocat::reading::{Frame, Reading};
use isocat::replay::{Nothing, ReplayReport, Told, replay};
use isocat::{Nanos, Scenario, SegmentFile};
use isocat_wire::datagram::Layouts;
use isocat_wire::frame;

/// The capture of a run of this segment, in memory.
fn file_of(segment: SegmentFile) -> Vec<u8> {
    let mut scenario = Scenario::from(segment);
    scenario.duration = Nanos::millis(20);
    let mut file = Vec::new();
    let tap = Capture::new(&mut file).expect("a Vec takes everything");
    let outcome = scenario.run().execute(Some(tap), &mut |_| {});
    outcome.world.into_tap().expect("the tap").finish().expect("a Vec takes everything");
    file
}

fn reading(file: &[u8]) -> Reading {
    Reading::of(file).expect("a capture")
}

fn built_in() -> (Vec<u8>, Vec<Told>) {
    let segment = SegmentFile::built_in();
    let told = segment.subdevices.iter().map(|device| Told {
        name: device.name.clone(),
        chip: *device.profile.esc(),
        sii: device.profile.sii.to_vec(),
    });
    let told = told.collect();
    (file_of(segment), told)
}

fn differences(report: &ReplayReport) -> String {
    report.text(true)
}

/// Each answer bit for bit, with and without knowing the chips.
#[test]
fn our_own_segment_is_exact() {
    let (file, told) = built_in();
    for told in [Some(&told[..]), None] {
        let report = replay("own", &reading(&file), told).expect("something to compare");
        assert_eq!(report.exact, report.frames, "{}", differences(&report));
        assert!(report.agrees && report.frames > 1000 && report.bytes > 10_000);
        assert_eq!((report.unanswered, report.answers_alone, report.left_out), (0, 0, 0));
    }
}

/// The last answer with a datagram that `wanted` picks out by command, first address and length;
/// its place in the capture, and in its bytes the datagram's data and working counter.
fn last(reading: &Reading, wanted: impl Fn(&str, u16, u16) -> bool) -> (usize, usize, usize) {
    let place = |frame: &Frame| {
        let start = frame::payload_offset(&frame.bytes).ok()?;
        let payload = frame::payload(&frame.bytes).ok()?;
        let mut layouts = Layouts::new();
        while let Some(Ok(layout)) = layouts.next(payload) {
            let header = layout.header;
            let name = header.command().ok()?.name();
            let counted = payload[layout.wkc()] > 0 && frame.bytes[6] & 2 != 0;
            if counted && wanted(name, header.ado(), header.len) {
                return Some((start + layout.data(), start + layout.wkc()));
            }
        }
        None
    };
    let mut found = reading.frames.iter().enumerate().rev();
    let (at, (data, wkc)) =
        found.find_map(|(at, frame)| Some((at, place(frame)?))).expect("such a frame");
    (at, data, wkc)
}

/// Reads this register first of all, from one SubDevice.
fn reads(register: u16) -> impl Fn(&str, u16, u16) -> bool {
    move |name, first, _| ["APRD", "FPRD"].contains(&name) && first == register
}

#[test]
fn a_changed_byte_is_named() {
    let (file, told) = built_in();
    let original = reading(&file);
    for (wanted, kind, place) in [
        (0x0110, "data-link", "DL status (0x0110)"),
        (0x0502, "eeprom", "EEPROM control and status (0x0502)"),
        (0x080D, "sync-manager", "SyncManager 1 status (0x080d)"),
    ] {
        let mut changed = original.clone();
        let (at, data, _) = last(&original, reads(wanted));
        changed.frames[at].bytes[data] ^= 0x01;
        let report = replay("changed", &changed, Some(&told)).expect("something to compare");
        assert!(!report.agrees);
        let difference = &report.differences[0];
        assert_eq!((difference.kind, &difference.place[..]), (kind, place));
        assert_eq!(difference.frame, original.frames[at].number);
        assert_ne!(difference.expected, difference.found);
        let number = |text: &str| u8::from_str_radix(text, 16).expect("one byte in hex");
        assert_eq!(number(&difference.expected) ^ number(&difference.found), 0x01, "{wanted:#06x}");
    }
    // The working counter of process data.
    let mut changed = original.clone();
    let (at, _, wkc) = last(&original, |name, _, _| name.starts_with("LR"));
    let before = changed.frames[at].bytes[wkc];
    changed.frames[at].bytes[wkc] += 1;
    let report = replay("changed", &changed, Some(&told)).expect("something to compare");
    let [difference] = &report.differences[..] else {
        panic!("{}", differences(&report));
    };
    assert_eq!((difference.kind, &difference.place[..]), ("working-counter", "working counter"));
    let counters = [&difference.expected, &difference.found].map(|text| text.parse::<u8>());
    assert_eq!(counters, [Ok(before + 1), Ok(before)]);
    assert_eq!((report.different, report.exact), (1, report.frames - 1));
}

#[test]
fn what_can_not_be_compared_is_said() {
    let (file, told) = built_in();
    let whole = reading(&file);
    let only = |answers: bool| {
        let mut some = whole.clone();
        some.frames.retain(|frame| (frame.bytes[6] & 2 != 0) == answers);
        some
    };
    let requests = only(false).frames.len();
    assert_eq!(
        replay("x", &only(false), None),
        Err(Nothing::NoAnswers { requests, unreadable: 0 })
    );
    assert_eq!(replay("x", &only(true), None), Err(Nothing::NoRequests { answers: requests }));
    let none = Nothing::NoFrames { foreign: 0, unreadable: 0 };
    assert_eq!(replay("x", &Reading::default(), None), Err(none));
    let found = told.len();
    let other = Nothing::OtherSegment { expected: found - 1, found };
    assert_eq!(replay("x", &whole, Some(&told[1..])), Err(other));
    // Requests that come back unchanged except for the mark: no device is there.
    let mut looped = Reading::default();
    for request in only(false).frames.into_iter().take(9) {
        let mut answer = request.clone();
        answer.bytes[6] |= 2;
        looped.frames.extend([request, answer]);
    }
    assert_eq!(replay("x", &looped, None), Err(Nothing::NoDevices { frames: 9 }));
}

/// Frames that are in the file twice, among those of others, are compared once.
#[test]
fn duplicates_and_strangers_change_nothing() {
    let (file, told) = built_in();
    let whole = reading(&file);
    let expected = replay("x", &whole, Some(&told)).expect("something to compare");
    let mut doubled = whole.clone();
    doubled.frames.clear();
    for frame in &whole.frames {
        let mut stranger = frame.clone();
        stranger.bytes[12..14].copy_from_slice(&[0x08, 0x06]);
        doubled.frames.extend([frame.clone(), frame.clone(), stranger]);
    }
    let report = replay("x", &doubled, Some(&told)).expect("something to compare");
    assert_eq!((report.frames, report.exact), (expected.frames, expected.exact));
    assert_eq!((report.duplicates, report.left_out), (whole.frames.len(), whole.frames.len()));
}

/// No damage to a capture makes more of it than differences or clear words.
#[test]
fn damaged_captures() {
    let (file, _) = built_in();
    let mut whole = reading(&file);
    whole.frames.truncate(600);
    let mut seed = 0x9E37_79B9_7F4A_7C15_u64;
    let mut random = |below: usize| {
        seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (seed >> 33) as usize % below
    };
    let mut compared = 0;
    for _ in 0..60 {
        let mut damaged = whole.clone();
        for _ in 0..20 {
            let at = random(damaged.frames.len());
            match random(4) {
                0 => drop(damaged.frames.remove(at)),
                1 => {
                    let len = random(damaged.frames[at].bytes.len());
                    damaged.frames[at].bytes.truncate(len);
                }
                2 => {
                    let other = random(damaged.frames.len());
                    damaged.frames.swap(at, other);
                }
                _ => {
                    let bytes = &mut damaged.frames[at].bytes;
                    let place = random(bytes.len().max(1));
                    if let Some(byte) = bytes.get_mut(place) {
                        *byte = random(256) as u8;
                    }
                }
            }
        }
        match replay("damaged", &damaged, None) {
            Ok(report) => compared += usize::from(report.exact + report.different > 0),
            Err(nothing) => assert!(!nothing.to_string().is_empty()),
        }
    }
    assert!(compared > 30, "most are still compared: {compared}");
}

#[test]
fn exit_codes_and_json() {
    let folder = std::env::temp_dir().join(format!("isocat-replay-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder for temporary files");
    let path = folder.join("own.pcapng");
    let (file, _) = built_in();
    std::fs::write(&path, &file).expect("written");
    let run = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_isocat"));
        command.arg("replay").args(arguments).output().expect("isocat runs")
    };
    let path = path.to_str().expect("a plain path");
    let exact = run(&[path, "--json"]);
    assert_eq!(exact.status.code(), Some(0));
    let document: serde_json::Value = serde_json::from_slice(&exact.stdout).expect("JSON");
    assert_eq!(document["format"], "isocat-replay/1");
    assert_eq!(document["frames"], document["exact"]);
    let mut changed = file.clone();
    let original = reading(&file);
    let (at, data, _) = last(&original, reads(0x0110));
    let bytes = &original.frames[at].bytes;
    let place = file.windows(bytes.len()).position(|window| window == bytes).expect("in the file");
    changed[place + data] ^= 1;
    let other = folder.join("changed.pcapng");
    std::fs::write(&other, changed).expect("written");
    let differs = run(&[other.to_str().expect("a plain path")]);
    assert_eq!(differs.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&differs.stdout).contains("DL status (0x0110)"));
    std::fs::write(&other, b"no capture at all").expect("written");
    assert_eq!(run(&[other.to_str().expect("a plain path")]).status.code(), Some(2));
    assert_eq!(run(&["nowhere.pcapng"]).status.code(), Some(2));
    std::fs::remove_dir_all(folder).expect("removed");
}

#[test]
fn the_schema_is_committed() {
    let text = serde_json::to_string_pretty(&isocat::replay::schema()).expect("JSON") + "\n";
    compare(&docs().join("replay.schema.json"), &text);
}

/// What was kept of the captures beside the project: devices, frames, differences by kinds.
#[test]
fn captures_of_real_segments() {
    let folder = std::env::var_os("ISOCAT_SHARED")
        .map_or_else(
            || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared"),
            PathBuf::from,
        )
        .join("captures");
    let Ok(list) = std::fs::read_dir(&folder) else {
        println!("{} is not there: skipped", folder.display());
        return;
    };
    let mut files: Vec<PathBuf> = list.map(|entry| entry.expect("readable").path()).collect();
    files.retain(|path| path.extension().is_some_and(|ending| ending == "pcapng"));
    files.sort();
    let mut table = String::from(
        "| capture | devices | frames | exact | known variances | not explained | by kinds |\n|---|---|---|---|---|---|---|\n",
    );
    let mut sums = [0; 4];
    for path in &files {
        let name = path.file_stem().and_then(|name| name.to_str()).expect("a plain name");
        let reading = reading(&std::fs::read(path).expect("readable"));
        let row = match replay(name, &reading, None) {
            Ok(report) => {
                let counts = [report.frames, report.exact, report.explained, report.different];
                sums = std::array::from_fn(|at| sums[at] + counts[at]);
                row(&report)
            }
            Err(nothing) => format!("| {name} | | | | | | {nothing} |"),
        };
        writeln!(table, "{row}").expect("a String takes everything");
    }
    let [frames, exact, explained, different] = sums;
    writeln!(
        table,
        "| **sum** | | **{frames}** | **{exact}** | **{explained}** | **{different}** | |"
    )
    .expect("a String takes everything");
    let path = docs().join("replay.md");
    let page = std::fs::read_to_string(&path).expect("the page is committed");
    let (before, rest) = page.split_once(BEGIN).expect("the table's place");
    let (_, after) = rest.split_once(END).expect("the table's end");
    compare(&path, &format!("{before}{BEGIN}{table}{END}{after}"));
}

fn row(report: &ReplayReport) -> String {
    let chips: Vec<&str> = report.devices.iter().map(|device| device.chip).collect();
    let kinds: Vec<String> =
        report.kinds.iter().map(|kind| format!("{} {}", kind.kind, kind.frames)).collect();
    format!(
        "| {} | {} | {} | {} | {} | {} | {} |",
        report.capture,
        chips.join(", "),
        report.frames,
        report.exact,
        report.explained,
        report.different,
        kinds.join(", ")
    )
}

fn docs() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs")
}

fn compare(path: &Path, text: &str) {
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        std::fs::write(path, text).expect("writable");
    }
    let committed = std::fs::read_to_string(path).unwrap_or_default();
    assert!(committed == text, "{} changed: UPDATE_GOLDEN=1 takes the new one", path.display());
}

const BEGIN: &str = "<!-- The table is made by crates/isocat/tests/recordings/replay.rs with UPDATE_GOLDEN=1. -->\n\n";
const END: &str = "\n<!-- End of the table. -->";
