//! `isocat diagnose` of what is no capture, or no good one: a clear word and exit code 2, or what
//! can be read with a note; never a false fault.

use std::path::PathBuf;
use std::process::Command;
use std::time::Duration;

use isocat::reading::{Frame, Reading};

/// A folder of one test's own.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let folder = std::env::temp_dir().join(format!("isocat-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a folder");
        Self(folder)
    }

    fn path(&self, name: &str) -> String {
        self.0.join(name).display().to_string()
    }

    fn write(&self, name: &str, bytes: &[u8]) -> String {
        let path = self.path(name);
        std::fs::write(&path, bytes).expect("written");
        path
    }

    /// The frames of a healthy run of 200 ms.
    fn healthy(&self) -> Vec<Frame> {
        let path = self.path("healthy.pcapng");
        isocat(&["run", "--for", "200ms", "--capture", &path]);
        Reading::of(&std::fs::read(path).expect("read")).expect("a capture").frames
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

fn isocat(arguments: &[&str]) -> (Option<i32>, String, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_isocat")).args(arguments).output();
    let output = output.expect("the command runs");
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("UTF-8");
    (output.status.code(), text(output.stdout), text(output.stderr))
}

/// Exit code and report of a capture of these frames.
fn diagnosed(folder: &Folder, frames: &[Frame]) -> (Option<i32>, serde_json::Value) {
    let mut file = pcap(1, &[]);
    for Frame { at, bytes, .. } in frames {
        packet(&mut file, *at, bytes, bytes.len() as u32);
    }
    let path = folder.write("made.pcap", &file);
    let (code, text, error) = isocat(&["diagnose", &path, "--json"]);
    (code, serde_json::from_str(&text).unwrap_or_else(|_| panic!("{error}")))
}

/// The kinds of the findings.
fn kinds(report: &serde_json::Value) -> Vec<String> {
    let findings = report["findings"].as_array().expect("findings").iter();
    findings.map(|one| one["kind"].to_string()).collect()
}

/// A pcap file of a link type with packets: their bytes and how long they were on the wire.
fn pcap(link: u32, packets: &[(&[u8], u32)]) -> Vec<u8> {
    let mut file = Vec::new();
    // Stamps of nanoseconds.
    for word in [0xA1B2_3C4D_u32, 0x0004_0002, 0, 0, 65_535, link] {
        file.extend(word.to_le_bytes());
    }
    for (bytes, length) in packets {
        packet(&mut file, Duration::ZERO, bytes, *length);
    }
    file
}

/// A packet in the order of the calls, whatever its stamp is.
fn packet(file: &mut Vec<u8>, at: Duration, bytes: &[u8], length: u32) {
    for word in [at.as_secs() as u32, at.subsec_nanos(), bytes.len() as u32, length] {
        file.extend(word.to_le_bytes());
    }
    file.extend(bytes);
}

#[test]
fn what_is_no_capture_has_a_word() {
    let folder = Folder::new("bad-no-capture");
    let arp = [&[0xFF; 12][..], &[0x08, 0x06], &[0; 46]].concat();
    let ethercat = [&[0xFF; 12][..], &[0x88, 0xA4, 0x2C, 0x10], &[0; 44]].concat();
    for (name, bytes, words) in [
        ("x.zip", b"PK\x03\x04....".to_vec(), "zip archive"),
        ("x.gz", vec![0x1F, 0x8B, 8, 0, 0], "packed by gzip"),
        ("x.zst", vec![0x28, 0xB5, 0x2F, 0xFD, 0], "packed by zstd"),
        ("x.xz", b"\xFD7zXZ\0".to_vec(), "packed by xz"),
        ("x.txt", b"No. Time Source".to_vec(), "a text that begins with \"No. \""),
        ("empty.pcapng", vec![], "the file is empty"),
        ("x.snoop", b"snoop\0\0\0".to_vec(), "editcap"),
        ("head.pcap", pcap(1, &[])[..20].to_vec(), "header of the pcap file is damaged"),
        ("nothing.pcap", pcap(1, &[]), "found 0 packets"),
        ("wifi.pcap", pcap(105, &[(&arp, 58)]), "link type 105"),
        ("arp.pcap", pcap(1, &[(&arp, 58)]), "found 1 packets, 1 of other protocols"),
        ("snap.pcap", pcap(1, &[(&ethercat[..20], 60)]), "1 cut by a snap length"),
        ("broken.pcap", pcap(1, &[(&ethercat[..58], 58)]), "with damaged datagrams"),
    ] {
        let path = folder.write(name, &bytes);
        let (code, text, error) = isocat(&["diagnose", &path]);
        // Lines are wrapped.
        let error = error.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(code == Some(2) && text.is_empty(), "{name}: {code:?} {text}");
        assert!(error.contains(words) && error.contains(name), "{name}: {error}");
    }
}

/// A ring of captures begins with an empty file: it is told, and the others are read.
#[test]
fn an_empty_file_among_others() {
    let folder = Folder::new("bad-empty");
    folder.healthy();
    let (healthy, empty) = (folder.path("healthy.pcapng"), folder.write("empty.pcapng", b""));
    let copy = folder.path("copy.pcapng");
    let (code, text, error) =
        isocat(&["diagnose", &empty, &healthy, "--json", "--annotate", &copy]);
    let report: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    assert_eq!((code, &report["captures"][0]["ended"]), (Some(0), &"the file is empty".into()));
    assert_eq!(report["captures"][1]["ended"], serde_json::Value::Null);
    assert!(error.contains("empty.pcapng is left out"), "{error}");
    let (_, alone, _) = isocat(&["diagnose", &healthy, "--json"]);
    let alone: serde_json::Value = serde_json::from_str(&alone).expect("JSON");
    assert_eq!(report["frames"]["pairs"], alone["frames"]["pairs"]);
    // What is no capture at all is an error, whatever stands beside it.
    let zip = folder.write("x.zip", b"PK\x03\x04");
    assert_eq!(isocat(&["diagnose", &healthy, &zip]).0, Some(2));
}

#[test]
fn a_capture_that_ends_in_the_middle_is_read_up_to_there() {
    let folder = Folder::new("bad-cut");
    folder.healthy();
    let bytes = std::fs::read(folder.path("healthy.pcapng")).expect("read");
    let cut = folder.write("cut.pcapng", &bytes[..bytes.len() - 7]);
    let (code, text, _) = isocat(&["diagnose", &cut]);
    assert_eq!(code, Some(0), "{text}");
    assert!(text.contains("not read to its end: the file ends in the middle"), "{text}");
    // A block whose two lengths differ: the first in the second half of the file.
    let mut damaged = bytes.clone();
    let mut block = 0;
    while block < damaged.len() / 2 {
        let length = damaged[block + 4..].first_chunk().expect("a block has a length");
        block += u32::from_le_bytes(*length) as usize;
    }
    damaged[block..block + 64].fill(0xA5);
    let damaged = folder.write("damaged.pcapng", &damaged);
    let (_, text, _) = isocat(&["diagnose", &damaged]);
    assert!(text.contains("not read to its end: a block is not as it should be"), "{text}");
}

/// A mirror of both directions of a switch's port: each frame is there twice.
#[test]
fn frames_of_a_mirror_port_are_one() {
    let folder = Folder::new("bad-mirror");
    let frames = folder.healthy();
    let (code, alone) = diagnosed(&folder, &frames);
    assert_eq!(code, Some(0), "{:?}", kinds(&alone));
    let late = |frame: &Frame| Frame { at: frame.at + Duration::from_micros(3), ..frame.clone() };
    let twice: Vec<Frame> = frames.iter().flat_map(|frame| [frame.clone(), late(frame)]).collect();
    let (code, report) = diagnosed(&folder, &twice);
    assert_eq!((code, kinds(&report)), (Some(0), kinds(&alone)));
    assert_eq!(report["frames"]["pairs"], alone["frames"]["pairs"]);
    assert_eq!(report["frames"]["duplicates"], frames.len());
    assert_eq!(report["devices"][1]["distance"]["shortest_ns"]["value"], {
        let distance = &alone["devices"][1]["distance"];
        distance["shortest_ns"]["value"].clone()
    });
}

/// The clock of the capturing machine is set by two hours, forth and back: no device did anything.
#[test]
fn stamps_that_jump_are_no_fault() {
    let folder = Folder::new("bad-jump");
    let frames = folder.healthy();
    let (_, alone) = diagnosed(&folder, &frames);
    let hours = Duration::from_secs(7200);
    let middle = frames.len() - 150;
    for forth in [true, false] {
        let jumped: Vec<Frame> = frames
            .iter()
            .enumerate()
            .map(|(place, frame)| {
                let late = (place > middle) == forth;
                let at = if late { frame.at + hours } else { frame.at };
                Frame { at, ..frame.clone() }
            })
            .collect();
        let (code, report) = diagnosed(&folder, &jumped);
        let kinds = report["findings"].as_array().expect("findings").iter();
        let faults: Vec<_> = kinds.filter(|one| one["weight"] == "fault").collect();
        assert_eq!((code, faults.len()), (Some(0), 0), "{faults:?}");
        assert_eq!(report["frames"]["backwards"].as_u64() > Some(0), !forth);
        assert_eq!(report["frames"]["unanswered"], alone["frames"]["unanswered"]);
    }
}

/// Packets of two interfaces in the wrong order: each answer stands before its request.
#[test]
fn packets_out_of_order_are_no_fault() {
    let folder = Folder::new("bad-order");
    let mut frames = folder.healthy();
    let (_, alone) = diagnosed(&folder, &frames);
    let operating = frames.len() / 2;
    let mut swapped = 0;
    for place in operating..frames.len() - 1 {
        let pair = frames[place].sent == Some(true) && frames[place + 1].sent == Some(false);
        if pair && place % 7 == 0 {
            frames.swap(place, place + 1);
            swapped += 1;
        }
    }
    let (code, report) = diagnosed(&folder, &frames);
    assert!(swapped > 10 && code == Some(0), "{swapped} {:?}", kinds(&report));
    assert_eq!(report["frames"]["pairs"], alone["frames"]["pairs"]);
    assert_eq!(report["frames"]["backwards"].as_u64(), Some(0), "exchanges go by their requests");
}

/// A probe writes its own instants into the packets: those count, and not the coarse stamps.
#[test]
fn a_probe_with_stamps_in_its_header() {
    let folder = Folder::new("bad-probe");
    let frames = folder.healthy();
    let (_, alone) = diagnosed(&folder, &frames);
    let mut file = pcap(1, &[]);
    for (place, frame) in frames.iter().enumerate() {
        let mut header = vec![1, 1, 5, 0x10, 0, 0, 0x80, 0x20];
        header.extend((frame.at.as_nanos() as u64).to_le_bytes());
        let bytes = match place % 2 {
            0 => [&header[..], &frame.bytes].concat(),
            _ => [&frame.bytes[..], &header].concat(),
        };
        let coarse = Duration::from_millis(frame.at.as_millis() as u64);
        packet(&mut file, coarse, &bytes, bytes.len() as u32);
    }
    let path = folder.write("probe.pcap", &file);
    let (code, text, error) = isocat(&["diagnose", &path, "--probe", "esl", "--json"]);
    let report: serde_json::Value = serde_json::from_str(&text).expect(&error);
    assert_eq!((code, kinds(&report)), (Some(0), kinds(&alone)));
    assert_eq!(report["cycle"], alone["cycle"]);
    let (code, _, error) = isocat(&["diagnose", &path, "--probe", "profishark"]);
    assert!(code == Some(2) && error.contains("expected esl or et2000"), "{error}");
}
