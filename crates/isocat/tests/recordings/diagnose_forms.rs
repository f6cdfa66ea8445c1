//! The forms in which `isocat diagnose` hands over what it found: copies of captures with comments,
//! pages, timelines.

use std::path::{Path, PathBuf};
use std::process::Command;

use isocat::reading::Reading;

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

/// The capture of a run with a fault of `docs/faults`.
fn captured(folder: &Folder, fault: &str) -> String {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let segment = root.join("docs/faults").join(fault).with_extension("toml");
    let capture = folder.path(&format!("{fault}.pcapng"));
    isocat(&["run", &segment.display().to_string(), "--capture", &capture]);
    capture
}

#[test]
fn a_copy_has_all_packets_and_the_findings() {
    let folder = Folder::new("annotate");
    let (stall, pull) = (captured(&folder, "stall"), captured(&folder, "pull"));
    let copy = folder.path("copy.pcapng");
    let (code, text, error) = isocat(&["diagnose", &stall, &pull, "--annotate", &copy, "--json"]);
    assert_eq!(code, Some(1), "{error}");
    let report: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    let frames = |path: &str| Reading::of(&std::fs::read(path).expect("read")).expect("a capture");
    let expected: Vec<_> = [frames(&stall), frames(&pull)]
        .into_iter()
        .flat_map(|reading| reading.frames)
        .map(|frame| (frame.at, frame.bytes))
        .collect();
    let found: Vec<_> =
        frames(&copy).frames.into_iter().map(|frame| (frame.at, frame.bytes)).collect();
    assert!(found == expected, "{} packets of {}", found.len(), expected.len());
    let bytes = std::fs::read(&copy).expect("read");
    for finding in report["findings"].as_array().expect("findings") {
        let what = format!("{}: {}", finding["kind"], finding["what"]).replace('"', "");
        let there = bytes.windows(what.len()).any(|window| window == what.as_bytes());
        assert!(there, "{what} is no comment");
    }
    // The report's frame is of its own capture; evidence is told with numbers of the copy.
    let second = report["findings"].as_array().expect("findings").iter();
    let second = second.filter(|one| one["capture"] == 1 && one["evidence"][0].is_object());
    let before = report["captures"][0]["packets"].as_u64().expect("a number");
    let mut told = 0;
    for finding in second {
        let frame = finding["frame"].as_u64().expect("a number") + before;
        let kind = finding["kind"].as_str().expect("a kind");
        let words = format!("belongs to {kind} of frame {frame}");
        assert!(bytes.windows(words.len()).any(|window| window == words.as_bytes()), "{words}");
        told += 1;
    }
    assert!(told > 0, "the second capture has findings");
    // The copy is read as the captures were.
    let (code, again, _) = isocat(&["diagnose", &copy, "--json"]);
    let again: serde_json::Value = serde_json::from_str(&again).expect("JSON");
    assert_eq!((code, &again["frames"]), (Some(1), &report["frames"]));
}

#[test]
fn a_copy_is_refused_where_it_would_do_harm() {
    let folder = Folder::new("annotate-refused");
    let stall = captured(&folder, "stall");
    let before = std::fs::read(&stall).expect("read");
    let same = folder.0.join(".").join("stall.pcapng").display().to_string();
    for (capture, copy, words) in [
        (&*stall, &*stall, "would overwrite a capture"),
        (&stall, &same, "would overwrite a capture"),
        ("/dev/null", &folder.path("x.pcapng"), "an ordinary file"),
        (&stall, &folder.path("no/folder/x.pcapng"), "can't be written"),
    ] {
        let (code, _, error) = isocat(&["diagnose", capture, "--annotate", copy]);
        assert!(code == Some(2) && error.contains(words), "{capture} {copy}: {error}");
    }
    let report = folder.path("both.txt");
    let (code, _, error) =
        isocat(&["diagnose", &stall, "--annotate", &report, "--report", &report]);
    assert!(code == Some(2) && error.contains("would overwrite the report"), "{error}");
    assert_eq!(std::fs::read(&stall).expect("read"), before);
}

/// What happened around the first fault: a MainDevice that stood still for 5 ms, in frames of 1 ms.
#[test]
fn the_frames_around_the_first_fault() {
    let folder = Folder::new("around");
    let stall = captured(&folder, "stall");
    let (_, text, _) = isocat(&["diagnose", &stall, "--json"]);
    let report: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    let around = &report["around"];
    let first = &report["findings"][around["finding"].as_u64().expect("a place") as usize];
    assert_eq!((&first["kind"], &first["weight"]), (&"cycles-skipped".into(), &"fault".into()));
    let moments = around["moments"].as_array().expect("moments");
    let fault = moments.iter().position(|one| one["at_ns"] == 0).expect("the fault");
    let (before, at) = (&moments[fault - 1], &moments[fault]);
    assert_eq!(at["answer"]["frame"], first["frame"]);
    assert!(at["findings"].as_array().expect("kinds").contains(&"cycles-skipped".into()));
    // The last frame before it left 6 ms earlier; the working counter fell behind the stall.
    let since = -before["at_ns"].as_i64().expect("ns");
    assert!((5_900_000..6_100_000).contains(&since), "{since}");
    let says = |moment: &serde_json::Value, what: &str| {
        moment["what"].as_str().is_some_and(|words| words.contains(what))
    };
    assert!(says(before, "LRW 0x00000000, wkc 9") && says(at, "LRW 0x00000000, wkc 5"));
    let next = &moments[fault + 1];
    assert!(says(next, "= SAFEOP+ERR, code 0x001a"), "{next}");
    // Frames that say the same are one moment, and none is left out between two.
    assert!(moments.iter().any(|one| one["times"].as_u64() > Some(100)), "{around}");
    for pair in moments.windows(2) {
        let last = pair[0]["last"]["frame"].as_u64().expect("a frame");
        assert_eq!(pair[1]["request"]["frame"], last + 1);
    }
    assert_eq!((fault <= 6, moments.len() <= fault + 7), (true, true));
    let (_, text, _) = isocat(&["diagnose", &stall]);
    assert!(text.contains("Around the first fault"), "{text}");
}

#[test]
fn nothing_is_around_where_nothing_went_wrong() {
    let folder = Folder::new("around-nothing");
    let healthy = folder.path("healthy.pcapng");
    isocat(&["run", "--for", "100ms", "--capture", &healthy]);
    let (code, text, _) = isocat(&["diagnose", &healthy, "--json"]);
    let report: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    assert_eq!((code, &report["around"]), (Some(0), &serde_json::Value::Null));
}

/// The part of a page that is read, and the report in it.
fn page(path: &str) -> (String, serde_json::Value) {
    let page = std::fs::read_to_string(path).expect("written");
    let (shown, rest) = page.split_once("<script id=\"report\"").expect("the report");
    let (_, rest) = rest.split_once('>').expect("it begins");
    let (json, _) = rest.split_once("</script>").expect("it ends");
    for asks in ["<link rel=\"stylesheet", "<script src", "@import", "<img", "<iframe", "NaN"] {
        assert!(!page.contains(asks), "{asks}");
    }
    assert!(page.len() < 2_000_000, "{} bytes", page.len());
    (shown.to_owned(), serde_json::from_str(json).expect("JSON"))
}

/// Device, cause, remedy and evidence stand before all figures.
#[test]
fn a_page_says_first_what_went_wrong() {
    let folder = Folder::new("page");
    let pull = captured(&folder, "pull");
    let path = folder.path("pull.html");
    let (code, text, _) = isocat(&["diagnose", &pull, "--json", "--report", &path]);
    let report: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    let (shown, json) = page(&path);
    assert_eq!((code, &json), (Some(1), &report));
    let (first, rest) = shown.split_once("class=\"tiles\"").expect("figures");
    let fault = &report["findings"][0];
    let device = &report["devices"][fault["device"].as_u64().expect("a device") as usize];
    let name = device["name"].as_str().expect("a name");
    let remedy = fault["remedies"][0].as_str().expect("a remedy");
    let frame = format!("frame {}", fault["frame"]);
    for words in [name, fault["kind"].as_str().expect("a kind"), remedy, &frame] {
        assert!(first.contains(words), "{words} is not on the first screen");
    }
    for part in
        ["id=\"around\"", "states-area", "distance-1-area", "by-clock-area", "by-stamps-area"]
    {
        assert!(rest.contains(part), "{part}");
    }
    // A chart of each device whose distance is known, and of no other.
    let devices = report["devices"].as_array().expect("devices").iter().enumerate();
    for (place, device) in devices {
        let drawn = rest.contains(&format!("id=\"distance-{place}-area\""));
        assert_eq!(drawn, !device["distance"].is_null(), "device {place}");
    }
}

/// What the page draws is what the report says: the band goes from the least to the largest figure.
#[test]
fn the_pictures_have_the_figures_of_the_report() {
    let folder = Folder::new("page-figures");
    let healthy = folder.path("healthy.pcapng");
    isocat(&["run", "--for", "300ms", "--capture", &healthy]);
    let path = folder.path("healthy.html");
    let (code, _, _) = isocat(&["diagnose", &healthy, "--report", &path]);
    let (shown, report) = page(&path);
    assert_eq!((code, shown.contains("What went wrong first")), (Some(0), false));
    let mut compared = 0;
    for (place, device) in report["devices"].as_array().expect("devices").iter().enumerate() {
        let distance = &device["distance"];
        let Some(frames) = distance["frames"].as_u64() else { continue };
        let picture =
            shown.split("<svg").find(|svg| svg.contains(&format!("distance-{place}-area")));
        let picture = picture.expect("a picture");
        let (_, series) = picture.split_once("data-series=\"").expect("a series");
        let (series, _) = series.split_once('"').expect("it ends");
        let spans: Vec<Vec<f64>> = series
            .split(' ')
            .map(|span| span.split(',').map(|figure| figure.parse().expect("a figure")).collect())
            .collect();
        let least = spans.iter().map(|span| span[2]).fold(f64::MAX, f64::min);
        let largest = spans.iter().map(|span| span[4]).fold(f64::MIN, f64::max);
        let value = |of: &str| distance[of]["value"].as_f64().expect("a figure");
        assert_eq!(
            (least, largest),
            (value("shortest_ns"), value("longest_ns")),
            "{frames} frames"
        );
        compared += 1;
    }
    assert!(compared > 0, "no device has a distance");
}
