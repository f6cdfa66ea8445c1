//! How often `isocat diagnose` is right: segments with seeds, each kind of fault at each device,
//! captured at the MainDevice's port, with the way back alone, with coarse stamps and such that
//! jitter, from the middle on, and in the line. The table of `docs/diagnose.md` is made of it.

use std::fmt::Write as _;
use std::path::Path;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use isocat::capture::Capture;
use isocat::diagnose::report::WeightKind;
use isocat::diagnose::{DiagnoseReport, Diagnosis, Names};
use isocat::reading::{Frame, Reading};
use isocat::{Scenario, SegmentFile};

/// Three axes behind an I/O device.
const SEGMENT: &str = r#"
cycle = "1ms"
for = "600ms"
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
[[subdevice]]
device = "hpmicro_ecat_cia402_ssc"
mode = "dc-sync0"
name = "axis 3"
"#;

/// A fault, what it shows first, and whether that has the device in it. `AXIS` stands for each axis
/// in turn.
struct Made {
    what: &'static str,
    kind: Option<&'static str>,
    names: bool,
}

impl Made {
    /// On the way back alone, lost frames and such that were never sent look alike. A tap in the
    /// line does not see frames that were lost before they came there.
    fn kind(&self, tap: usize, axis: usize) -> Option<&'static str> {
        match self.kind {
            Some("frames-lost") if tap == IN_LINE && axis == 1 => Some("cycles-skipped"),
            Some("cycles-skipped" | "frames-lost") if tap == 2 => Some("cycles-missing"),
            kind => kind,
        }
    }
}

const FAULTS: [Made; 15] = [
    Made { what: "", kind: None, names: false },
    Made { what: "pull AXIS for 200ms", kind: Some("devices-vanished"), names: true },
    Made { what: "power-off AXIS for 200ms", kind: Some("devices-vanished"), names: true },
    Made { what: "power-cycle AXIS 100ms", kind: Some("devices-vanished"), names: true },
    Made { what: "replace AXIS simple_io16 100ms", kind: Some("devices-vanished"), names: true },
    Made { what: "break AXIS back for 200ms", kind: Some("devices-vanished"), names: true },
    Made { what: "flap AXIS 5ms 145ms for 160ms", kind: Some("devices-vanished"), names: true },
    Made { what: "al-error AXIS 0x8001", kind: Some("left-op"), names: true },
    Made { what: "sync-off AXIS for 20ms", kind: Some("left-op"), names: true },
    Made { what: "stall 5ms", kind: Some("cycles-skipped"), names: false },
    Made { what: "drop 1", kind: Some("frames-lost"), names: false },
    Made { what: "loss 2% for 300ms", kind: Some("frames-lost"), names: false },
    Made { what: "damage 3 out at AXIS", kind: Some("frames-lost"), names: false },
    Made { what: "double 5 out", kind: Some("frames-doubled"), names: false },
    Made { what: "second-master count 10ms for 300ms", kind: Some("another-talker"), names: false },
];

/// How a capture was taken.
const TAPS: [&str; 6] = [
    "port",
    "stamps of 1 ms",
    "way back alone",
    "from the middle on",
    "stamps late by up to 0.3 ms",
    "in the line",
];
/// The last of them: in front of the first axis.
const IN_LINE: usize = 5;

fn captured(what: &str, axis: usize, seed: u64) -> Vec<u8> {
    let mut text = SEGMENT.to_owned();
    if !what.is_empty() {
        let what = what.replace("AXIS", &format!("axis {axis}"));
        let _ = write!(text, "[[fault]]\nat = \"in-operation + 200ms\"\nwhat = \"{what}\"\n");
    }
    let mut scenario = Scenario::from(SegmentFile::parse("made.toml", &text).expect("right"));
    scenario.seed = seed;
    let tap = Capture::new(Vec::new()).and_then(|capture| capture.with_cables(&[1]));
    let tap = tap.expect("a Vec takes everything");
    let outcome = scenario.run().execute(Some(tap), &mut |_| {});
    outcome.world.into_tap().expect("the tap").finish().expect("a Vec takes everything")
}

/// The capture as another tap has it.
fn seen(file: &[u8], tap: usize) -> Vec<u8> {
    let frames = Reading::of(file).expect("a capture").frames;
    // SYNC is set up by then, and the fault comes later.
    let first = frames.last().map_or(Duration::ZERO, |last| last.at) - Duration::from_millis(600);
    let mut capture = Capture::new(Vec::new()).expect("a Vec takes everything");
    let mut late = Duration::ZERO;
    for Frame { number, at, sent, bytes, interface } in frames {
        if (interface == 0) != (tap != IN_LINE) {
            continue;
        }
        // Any figure that looks like none, and stamps in the order of the frames.
        late = late.max(at + Duration::from_nanos((number as u64 * 7919) % 300_000));
        let coarse = Duration::from_millis(at.as_millis() as u64);
        match tap {
            0 => capture.write(at, sent == Some(true), &bytes),
            1 => capture.write(coarse, sent == Some(true), &bytes),
            2 if sent != Some(false) => {}
            3 if at < first => {}
            4 => capture.write(late, sent == Some(true), &bytes),
            _ => capture.write(at, sent == Some(true), &bytes),
        }
    }
    capture.finish().expect("a Vec takes everything")
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Hit {
    Right,
    Unknown,
    Wrong,
}

fn hit(report: &DiagnoseReport, made: &Made, axis: usize, tap: usize) -> Hit {
    let first = report.findings.iter().find(|one| one.weight == WeightKind::Fault);
    let Some(first) = first else {
        return if made.kind.is_none() { Hit::Right } else { Hit::Unknown };
    };
    let device = first.device.map(|place| &report.devices[place]);
    // From the middle on a device is known by its station, which counts from 0x1001 at position 0.
    let station = device.and_then(|device| device.station.as_ref()).map(|station| station.value);
    let names = !made.names || station == Some(0x1001 + axis as u16);
    match Some(first.kind) == made.kind(tap, axis) {
        true if names => Hit::Right,
        true if device.is_none() => Hit::Unknown,
        _ => Hit::Wrong,
    }
}

/// By tap: how often the first cause was right, unknown, wrong; and what was not right.
type Row = ([[u32; 3]; TAPS.len()], String);

/// What is found of a fault at each device and with each seed.
fn row(made: &Made) -> Row {
    let (mut counts, mut wrong) = ([[0; 3]; TAPS.len()], String::new());
    let has_axis = made.what.contains("AXIS");
    let axes = if has_axis { 1..4 } else { 1..2 };
    let seeds = if has_axis { 1..4 } else { 1..9 };
    for (axis, seed) in axes.flat_map(|axis| seeds.clone().map(move |seed| (axis, seed))) {
        let file = captured(made.what, axis, seed);
        for (tap, counts) in counts.iter_mut().enumerate() {
            let mut diagnosis = Diagnosis::new();
            diagnosis.read("made", &seen(&file, tap)[..]).expect("a capture");
            let report = diagnosis.report(&Names::default()).expect("EtherCAT");
            let hit = hit(&report, made, axis, tap);
            counts[hit as usize] += 1;
            if hit != Hit::Right {
                let first = report.findings.first().map(|one| (one.kind, one.device));
                let (what, tap) = (made.what, TAPS[tap]);
                let _ =
                    writeln!(wrong, "{what}, axis {axis}, seed {seed}, {tap}: {hit:?}: {first:?}");
            }
        }
    }
    (counts, wrong)
}

#[test]
fn the_first_cause_is_right() {
    // Each fault for itself, so that the processors share them.
    let rows: Vec<OnceLock<Row>> = FAULTS.iter().map(|_| OnceLock::new()).collect();
    let next = AtomicUsize::new(0);
    std::thread::scope(|scope| {
        for _ in 0..std::thread::available_parallelism().map_or(2, usize::from) {
            scope.spawn(|| {
                loop {
                    let at = next.fetch_add(1, Ordering::Relaxed);
                    let Some(made) = FAULTS.get(at) else { break };
                    assert!(rows[at].set(row(made)).is_ok(), "each is taken once");
                }
            });
        }
    });
    let rows: Vec<Row> = rows.into_iter().map(|row| row.into_inner().expect("all")).collect();
    let counts: Vec<_> = rows.iter().map(|(counts, _)| *counts).collect();
    let wrong: String = rows.iter().map(|(_, wrong)| wrong.as_str()).collect();
    let mut table = String::new();
    for (made, taps) in FAULTS.iter().zip(&counts) {
        let what = if made.what.is_empty() { "healthy" } else { made.what };
        let cells: Vec<String> = taps
            .iter()
            .map(|[right, unknown, wrong]| format!("{right} / {unknown} / {wrong}"))
            .collect();
        let kind = made.kind.map_or("none".to_owned(), |kind| format!("`{kind}`"));
        let _ = writeln!(table, "| {what} | {kind} | {} |", cells.join(" | "));
    }
    let sum = |hit: usize, taps: std::ops::Range<usize>| -> u32 {
        counts.iter().flat_map(|row| &row[taps.clone()]).map(|cell| cell[hit]).sum()
    };
    let all: u32 = (0..3).map(|hit| sum(hit, 0..1)).sum();
    assert!(sum(0, 0..1) * 100 >= all * 95, "at the port\n{table}{wrong}");
    let wrongs = sum(2, 0..TAPS.len());
    assert!(wrongs * 100 <= all * TAPS.len() as u32, "wrong\n{table}{wrong}");
    assert!(counts[0].iter().all(|cell| cell[1..] == [0, 0]), "false alarms\n{table}{wrong}");
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/diagnose.md");
    let text = std::fs::read_to_string(&page).expect("the page");
    let begin = text.find(HEAD).expect("the table") + HEAD.len();
    let end = begin + text[begin..].find("\n\n").expect("the end of the table") + 1;
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        std::fs::write(&page, format!("{}{table}{}", &text[..begin], &text[end..]))
            .expect("written");
        return;
    }
    assert_eq!(&text[begin..end], table, "UPDATE_GOLDEN=1 writes it\n{wrong}");
}

const HEAD: &str = "| fault | first | port | stamps of 1 ms | way back alone | from the middle on | stamps late by up to 0.3 ms | in the line |\n|---|---|---|---|---|---|---|---|\n";
