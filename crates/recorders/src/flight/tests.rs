use super::*;
use std::fs;

use pcap_file::pcapng::blocks::enhanced_packet::EnhancedPacketOption;
use pcap_file::pcapng::{Block, PcapNgReader};

const MS: Duration = Duration::from_millis(1);
const NS: Duration = Duration::from_nanos(1);
/// Wall time at which the tests begin.
const START: Duration = Duration::from_secs(1_795_459_200);

/// A folder for one test, which is removed at its end.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let name = format!("isocat-flight-{}-{name}", std::process::id());
        let path = std::env::temp_dir().join(name);
        let _ = fs::remove_dir_all(&path);
        Self(path)
    }

    fn names(&self) -> Vec<String> {
        let entries = fs::read_dir(&self.0).expect("our folder");
        let name = |entry: fs::DirEntry| entry.file_name().to_string_lossy().into_owned();
        let mut names: Vec<String> = entries.flatten().map(name).collect();
        names.sort();
        names
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn limits(keep: Duration, after: Duration, most_files: usize) -> Limits {
    Limits { keep, after, most_bytes: 1 << 20, most_files }
}

fn reason(what: &str) -> Reason {
    Reason { kind: "test", what: what.to_owned() }
}

/// Frames of a capture as their first byte, each with its comments.
fn frames(path: &Path) -> Vec<(u8, Vec<String>)> {
    let file = fs::File::open(path).expect("it is there");
    let mut reader = PcapNgReader::new(file).expect("pcapng");
    let mut all = Vec::new();
    while let Some(block) = reader.next_block() {
        let Block::EnhancedPacket(packet) = block.expect("a whole block") else { continue };
        let comments = packet.options.iter().filter_map(|option| match option {
            EnhancedPacketOption::Comment(words) => Some(words.to_string()),
            _ => None,
        });
        all.push((packet.data[0], comments.collect()));
    }
    all
}

/// Feeds frames 1 to `count`, a millisecond apart from [`START`] on; calls `hook` after each.
fn feed(recorder: &mut FlightRecorder, count: u8, mut hook: impl FnMut(&mut FlightRecorder, u64)) {
    for number in 1..=count {
        let at = START + u32::from(number) * MS;
        let given = recorder.frame(at, number % 2 == 1, &[number; 60]);
        hook(recorder, given);
    }
}

fn written(told: Vec<Told>) -> Vec<(PathBuf, u64)> {
    let written = told.into_iter().map(|told| match told {
        Told::Written { path, frames, .. } => (path, frames),
        other => panic!("{other:?}"),
    });
    written.collect()
}

#[test]
fn a_file_reaches_from_before_to_behind_what_happened() {
    let folder = Folder::new("span");
    let mut recorder =
        FlightRecorder::new(&folder.0, "eth0", limits(5 * MS, 3 * MS, 10)).expect("writable");
    feed(&mut recorder, 30, |recorder, number| {
        if number == 20 {
            recorder.trigger(None, reason("it broke"));
        }
    });
    let told = written(recorder.finish());
    let [(path, count)] = &told[..] else { panic!("{told:?}") };
    assert_eq!(
        path.file_name().and_then(|name| name.to_str()),
        Some("eth0-20261123T184000.020Z-test.pcapng")
    );
    let frames = frames(path);
    let numbers: Vec<u8> = frames.iter().map(|(number, _)| *number).collect();
    assert_eq!(numbers, (15..=23).collect::<Vec<u8>>(), "both ends are in it, and nothing beyond");
    assert_eq!(*count, 9);
    for (number, comments) in frames {
        let expected: &[&str] = if number == 20 { &["isocat: test: it broke"] } else { &[] };
        assert_eq!(comments, expected, "frame {number}");
    }
}

#[test]
fn a_frame_a_nanosecond_beyond_an_end_is_not_in_it() {
    let folder = Folder::new("edges");
    let mut recorder =
        FlightRecorder::new(&folder.0, "eth0", limits(5 * MS, 3 * MS, 10)).expect("writable");
    let at = START + 100 * MS;
    let times = [at - 5 * MS - NS, at - 5 * MS, at, at + 3 * MS, at + 3 * MS + NS];
    for (number, time) in (1..).zip(times) {
        recorder.frame(time, true, &[number; 60]);
        if number == 3 {
            recorder.trigger(Some(3), reason("now"));
        }
        // At its last instant an incident is not over yet.
        assert_eq!(recorder.until().is_some(), number == 3 || number == 4, "{number}");
    }
    let told = written(recorder.finish());
    let numbers: Vec<u8> = frames(&told[0].0).iter().map(|(number, _)| *number).collect();
    assert_eq!(numbers, [2, 3, 4]);
}

#[test]
fn what_follows_belongs_to_the_same_incident_or_to_the_next() {
    let folder = Folder::new("next");
    let mut recorder =
        FlightRecorder::new(&folder.0, "eth0", limits(5 * MS, 4 * MS, 10)).expect("writable");
    feed(&mut recorder, 60, |recorder, number| match number {
        // Frame 24 is at the last instant of the time after frame 20, frame 25 is after it.
        20 | 24 | 25 => recorder.trigger(None, reason(&format!("at {number}"))),
        _ => {}
    });
    let told = written(recorder.finish());
    let spans: Vec<Vec<u8>> = told
        .iter()
        .map(|(path, _)| frames(path).iter().map(|(number, _)| *number).collect())
        .collect();
    assert_eq!(spans, [(15..=28).collect::<Vec<u8>>(), (20..=29).collect()]);
    let comments = |path: &Path| {
        let marked = frames(path).into_iter().filter(|(_, comments)| !comments.is_empty());
        marked.collect::<Vec<_>>()
    };
    let at = |number: u8| (number, vec![format!("isocat: test: at {number}")]);
    assert_eq!(comments(&told[0].0), [at(20), at(24)]);
    assert_eq!(comments(&told[1].0), [at(25)]);
}

#[test]
fn what_is_told_late_stands_at_its_frame() {
    let folder = Folder::new("late");
    let mut recorder =
        FlightRecorder::new(&folder.0, "eth0", limits(5 * MS, 2 * MS, 10)).expect("writable");
    feed(&mut recorder, 60, |recorder, number| {
        if number == 50 {
            recorder.trigger(Some(20), reason("long ago"));
        }
    });
    let told = written(recorder.finish());
    let numbers: Vec<u8> = frames(&told[0].0).iter().map(|(number, _)| *number).collect();
    assert_eq!(numbers, (15..=22).collect::<Vec<u8>>());
    assert_eq!(frames(&told[0].0)[5], (20, vec!["isocat: test: long ago".to_owned()]));
}

#[test]
fn the_first_file_and_the_newest_stay() {
    let folder = Folder::new("most");
    let mut recorder =
        FlightRecorder::new(&folder.0, "eth0", limits(2 * MS, MS, 3)).expect("writable");
    feed(&mut recorder, 200, |recorder, number| {
        if number % 20 == 0 {
            recorder.trigger(None, reason("again"));
        }
    });
    let told = recorder.finish();
    assert_eq!(told.len(), 10);
    let removed = told.iter().filter(|told| matches!(told, Told::Written { removed: Some(_), .. }));
    assert_eq!(removed.count(), 7);
    let name = |ms: u32| format!("eth0-20261123T184000.{ms:03}Z-test.pcapng");
    assert_eq!(folder.names(), [name(20), name(180), name(200)]);
}

#[test]
fn of_one_file_the_first_stays() {
    let folder = Folder::new("one");
    let mut recorder =
        FlightRecorder::new(&folder.0, "eth0", limits(2 * MS, MS, 1)).expect("writable");
    feed(&mut recorder, 60, |recorder, number| {
        if number % 20 == 0 {
            recorder.trigger(None, reason("again"));
        }
    });
    let told = recorder.finish();
    assert!(
        matches!(told[..], [Told::Written { .. }, Told::NotKept { .. }, Told::NotKept { .. }]),
        "{told:?}"
    );
    assert_eq!(folder.names(), ["eth0-20261123T184000.020Z-test.pcapng"]);
}

#[test]
fn a_folder_that_is_gone_is_told_and_harms_nothing() {
    let folder = Folder::new("gone");
    let mut recorder =
        FlightRecorder::new(&folder.0, "eth0", limits(2 * MS, MS, 10)).expect("writable");
    feed(&mut recorder, 60, |recorder, number| match number {
        10 => {
            fs::remove_dir_all(&folder.0).expect("ours");
            recorder.trigger(None, reason("lost"));
        }
        30 => {
            // The first one has failed by then.
            while !matches!(recorder.poll(), Some(Told::Failed { .. })) {
                std::thread::sleep(MS);
            }
            fs::create_dir_all(&folder.0).expect("ours");
            recorder.trigger(None, reason("kept"));
        }
        _ => {}
    });
    let told = written(recorder.finish());
    assert_eq!((told.len(), folder.names().len()), (1, 1), "{told:?}");
}

#[test]
fn a_file_is_no_folder() {
    let folder = Folder::new("file");
    fs::create_dir_all(&folder.0).expect("writable");
    let file = folder.0.join("file");
    fs::write(&file, "").expect("writable");
    assert!(FlightRecorder::new(&file, "eth0", limits(MS, MS, 1)).is_err());
    assert!(FlightRecorder::new(&file.join("below"), "eth0", limits(MS, MS, 1)).is_err());
    assert_eq!(folder.names(), ["file"]);
}

#[test]
fn without_a_frame_there_is_no_file() {
    let folder = Folder::new("empty");
    let mut recorder =
        FlightRecorder::new(&folder.0, "eth0", limits(MS, MS, 10)).expect("writable");
    recorder.tick(START);
    recorder.trigger(None, reason("asked"));
    recorder.tick(START + 10 * MS);
    assert!(matches!(recorder.poll(), Some(Told::Empty { .. })));
    assert!(recorder.finish().is_empty() && folder.names().is_empty());
}

#[test]
fn memory_that_is_too_small_is_told() {
    for (most_bytes, crowds) in [(1 << 20, false), (10 * 71, false), (10 * 71 - 1, true)] {
        let folder = Folder::new("crowded");
        let limits = Limits { most_bytes, ..limits(5 * MS, 4 * MS, 10) };
        let mut recorder = FlightRecorder::new(&folder.0, "eth0", limits).expect("writable");
        feed(&mut recorder, 20, |recorder, number| {
            if number == 16 {
                recorder.trigger(None, reason("now"));
            }
        });
        let told = recorder.finish();
        let [Told::Written { crowded, frames, .. }] = &told[..] else { panic!("{told:?}") };
        assert_eq!((*crowded, *frames), (crowds, if crowds { 9 } else { 10 }), "{most_bytes}");
    }
}

#[test]
fn reasons_beyond_the_bound_are_counted() {
    let folder = Folder::new("many");
    let mut recorder =
        FlightRecorder::new(&folder.0, "eth0", limits(5 * MS, 4 * MS, 10)).expect("writable");
    feed(&mut recorder, 20, |recorder, number| {
        if number == 10 {
            (0..MOST_REASONS + 3).for_each(|_| recorder.trigger(None, reason("much")));
        }
    });
    let told = written(recorder.finish());
    let frames = frames(&told[0].0);
    let (_, comments) = frames.iter().find(|(number, _)| *number == 10).expect("it is in it");
    assert_eq!(comments.len(), MOST_REASONS + 1);
    assert_eq!(comments[MOST_REASONS], "isocat: 3 more reasons came later");
}

#[test]
fn frames_allocate_nothing_after_warm_up() {
    let folder = Folder::new("allocations");
    let mut recorder =
        FlightRecorder::new(&folder.0, "eth0", limits(100 * MS, MS, 10)).expect("writable");
    let mut feed = |milliseconds: std::ops::Range<u32>| {
        for number in milliseconds {
            recorder.frame(START + number * MS, true, &[0; 200]);
        }
    };
    feed(0..5_000);
    let counted = allocation_counter::measure(|| feed(5_000..50_000));
    assert_eq!(counted.count_total, 0, "{counted:?}");
}
