//! `isocat scan`: what a MainDevice finds out about a segment before any cycle, against what the
//! segment is.

use std::path::Path;
use std::process::{Command, Output};
use std::sync::Arc;

use isocat::report::scan::{Place, ScanReport, schema};
use isocat::scan::config;
use isocat::{NoTap, Scan, Scenario, SegmentFile};
use isocat_esc::Chip;
use isocat_esc::chip::ET1100;
use isocat_maindevice::Event;
use isocat_sim::world::{Setup, World};
use isocat_wire::register::features;
use isocat_wire::time::Time;
use isocat_wire::{AlState, ObjectAddress};

/// A fork with a swapped cable at one end and clocks that differ.
const TREE: &str = r#"
    cycle = "1ms"
    [[subdevice]]
    name = "root"
    device = "model_every_mode"
    mode = "dc-sync0"
    clock = "+10ppm"
    [[subdevice]]
    name = "late"
    device = "kollmorgen_akd2g"
    connect = "root:2"
    clock = "-35ppm"
    cable = "90m"
    [[subdevice]]
    name = "early"
    device = "simple_io16"
    connect = "0:1"
    [[subdevice]]
    name = "end of early"
    device = "hpmicro_ecat_cia402_ssc"
    port = 1
    clock = "+60ppm"
    cable = "3m"
"#;

/// Two branches behind a junction.
const FORK: &str = r#"
    cycle = "1ms"
    [[subdevice]]
    device = "kollmorgen_akd2g"
    [[subdevice]]
    name = "junction"
    device = "simple_io16"
    cable = "40m"
    [[subdevice]]
    device = "kollmorgen_akd2g"
    connect = "junction:1"
    cable = "7m"
    [[subdevice]]
    device = "kollmorgen_akd2g"
    connect = "junction:2"
    clock = "-30ppm"
    cable = "90m"
"#;

/// A device that says one thing here and another there.
const DOUBTFUL: &str = r#"
    cycle = "1ms"
    [[subdevice]]
    device = "kollmorgen_akd2g"
    [[subdevice]]
    device = "kollmorgen_akd2g"
    misbehave = [
        "wrong-value 1C32:01 3",
        "wrong-value 1C32:04 0x0C27",
        "wrong-value 1C32:06 300000",
        "read-only 1C32:03",
        "missing-entry 1C32:0C",
        "wrong-value 1C33:05 0",
        "wrong-value 1C33:0B 7",
    ]
"#;

fn scenario(text: &str) -> Scenario {
    Scenario::from(SegmentFile::parse("scan.toml", text).expect("it reads"))
}

fn setup(scenario: &Scenario) -> Setup {
    let mut setup = scenario.run().setup;
    setup.config = config(true);
    setup
}

fn report(scan: &Scan) -> ScanReport {
    ScanReport::new(Place::Virtual("scan.toml"), scan)
}

fn golden(name: &str, text: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/golden/scan/{name}.txt"));
    let text = anstream::adapter::strip_str(text).to_string();
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        std::fs::create_dir_all(path.parent().unwrap()).expect("a folder");
        std::fs::write(&path, &text).expect("the golden files are writable");
    }
    let committed = std::fs::read_to_string(&path).unwrap_or_default();
    assert_eq!(text, committed, "{}: UPDATE_GOLDEN=1 rewrites it", path.display());
    let long = text.lines().find(|line| line.chars().count() > 100);
    assert_eq!(long, None, "a hundred columns");
}

fn kinds(notes: &[isocat::report::scan::Note], position: usize) -> Vec<&'static str> {
    notes
        .iter()
        .filter(|note| note.position == Some(position))
        .map(|note| note.kind.name())
        .collect()
}

/// What was found is what was built: parents, ports, and the speed of every clock within its error.
#[test]
fn the_tree_and_its_clocks_are_those_that_were_built() {
    let scenario = scenario(TREE);
    let scan = Scan::of(&scenario, true, &mut |_| {});
    assert_eq!((&scan.failure, &scan.way_down), (&None, &None));
    let report = report(&scan);
    // One of them is plugged in at its port 1, which is all that speaks against the segment.
    let found: Vec<_> = report.findings.iter().map(|n| (n.position, n.kind.name())).collect();
    assert_eq!(found, [(Some(2), "ports-swapped")]);
    let parents: Vec<_> = report.devices.iter().map(|d| (d.parent, d.parent_port)).collect();
    let expected = [(None, None), (Some(0), Some(1)), (Some(1), Some(1)), (Some(0), Some(2))];
    assert_eq!(parents, expected);
    assert!(report.devices[2].ports[1].entry && !report.devices[2].ports[0].entry, "swapped");
    let reference = scenario.devices[0].clock.deviation(scenario.seed, 0).0 as f64 / 1e3;
    for (found, built) in report.devices.iter().zip(&scenario.devices) {
        assert_eq!(found.state.al_status, "PREOP", "{}", built.name);
        assert_eq!(found.state_before.as_ref().map(|state| state.al_status.as_str()), Some("INIT"));
        let speed = found.clock.speed_ppm.expect("all of them have receive times");
        let error = found.clock.speed_error_ppm.expect("with the speed");
        let truth = built.clock.deviation(scenario.seed, found.position).0 as f64 / 1e3 - reference;
        // Deviations of some 10 ppm multiply, by less than the last digit.
        assert!((speed - truth).abs() <= error + 0.01, "{}: {speed} for {truth}", built.name);
        // A tick at either end, and the jitter of the hops in two frames.
        assert!((0.0..1.0).contains(&error), "{error}");
    }
    golden("tree", &report.text(None));
}

/// A junction without receive times: the delays behind it are not known, which is no fault of the
/// segment's.
#[test]
fn delays_that_cannot_be_known_are_said_to_be() {
    static JUNCTION: Chip =
        Chip { features: ET1100.features & !(features::DC | features::DC_64_BIT), ..ET1100 };
    let mut setup = setup(&scenario(FORK));
    setup.segment[1].device.chip = JUNCTION;
    let scan = Scan::of_setup(setup, &mut |_| {});
    let report = report(&scan);
    assert!(report.consistent, "{:?}", report.findings);
    assert_eq!(report.devices[1].esc.dc, "none");
    for device in &report.devices[2..] {
        let delay = &device.delay;
        assert!(delay.ns.is_none() && delay.error_ns.is_none() && delay.unknown.is_some());
        let (least, most) = (delay.least_ns.expect("a bound"), delay.most_ns.expect("a bound"));
        let written = delay.written_ns.expect("it has a clock") as f64;
        assert!((least..=most).contains(&written), "{delay:?}");
        assert_eq!(kinds(&report.doubts, device.position), ["delay-unknown"]);
        assert!(device.clock.speed_ppm.is_some(), "speeds need no delay");
    }
    golden("junction", &report.text(None));
}

/// Each thing that is wrong has its name; the device beside it has none.
#[test]
fn contradictions_and_doubts_have_names() {
    let scan = Scan::of(&scenario(DOUBTFUL), true, &mut |_| {});
    let report = report(&scan);
    assert!(!report.consistent);
    assert_eq!(kinds(&report.findings, 0), [""; 0]);
    assert_eq!(kinds(&report.doubts, 0), [""; 0]);
    assert_eq!(
        kinds(&report.findings, 1),
        ["type-not-announced", "shift-read-only", "copy-longer-than-cycle"]
    );
    assert_eq!(
        kinds(&report.doubts, 1),
        ["delay-both", "delay-not-fixed", "missing", "counted", "not-stated"]
    );
    golden("doubtful", &report.text(None));
    golden("doubtful_device", &report.text(Some(1)));
}

/// One SubDevice whose SII has no end, one that refuses PREOP: the others are read all the same,
/// and the delays of all.
#[test]
fn what_fails_at_one_ends_nothing_at_the_others() {
    let text = "cycle = \"1ms\"\n[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\ncount = 4\n";
    let scenario = scenario(
        &(text.to_owned()
            + "[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\nmisbehave = [\"refused-state PREOP\"]\n"),
    );
    let mut setup = setup(&scenario);
    let mut image = setup.segment[1].device.sii.to_vec();
    // The length of the first category, in words.
    image[0x82..0x84].fill(0xFF);
    setup.segment[1].device.sii = Arc::from(image);
    let scan = Scan::of_setup(setup, &mut |_| {});
    assert_eq!((&scan.failure, &scan.way_down), (&None, &None));
    let report = report(&scan);
    let found: Vec<_> =
        report.findings.iter().map(|note| (note.position, note.kind.name())).collect();
    // In the order in which it is found out: the categories of the SII are not needed before the
    // objects.
    let places = [4, 1, 1].map(|position| (Some(position), "not-read"));
    assert_eq!(found, places, "{:#?}", report.findings);
    assert!(report.findings[0].what.contains("refuses PREOP"), "{:?}", report.findings);
    assert!(report.findings[1].what.contains("no end mark 0xFFFF"), "{:?}", report.findings);
    assert!(report.findings[2].what.contains("no SyncManager is there"), "{:?}", report.findings);
    let read: Vec<_> = report.devices.iter().map(|device| device.output_sync.is_some()).collect();
    assert_eq!(read, [true, true, true, true, false]);
    let states: Vec<_> = report.devices.iter().map(|device| &device.state.al_status[..]).collect();
    assert_eq!(states, ["PREOP", "PREOP", "PREOP", "PREOP", "INIT+ERR"]);
    assert!(report.devices.iter().all(|device| device.delay.ns.is_some()));
    assert_eq!(report.devices[1].vendor_id, report.devices[0].vendor_id, "its header was read");
}

/// Without objects the SII says what process data there are.
#[test]
fn a_quick_scan_reads_no_objects() {
    let built_in = Scenario::from(SegmentFile::built_in());
    let (quick, whole) =
        (Scan::of(&built_in, false, &mut |_| {}), Scan::of(&built_in, true, &mut |_| {}));
    let (quick, whole) = (report(&quick), report(&whole));
    let devices = quick.devices.iter().zip(&whole.devices).zip(&built_in.devices);
    for ((quick, whole), _) in devices.filter(|(_, built)| built.profile.has_mailbox()) {
        assert!(quick.output_sync.is_none() && whole.output_sync.is_some());
        assert_eq!(quick.outputs.source, "SII");
        assert_eq!(whole.outputs.source, "objects");
        assert_eq!(quick.product_code, whole.product_code);
    }
    assert!(quick.consistent, "{:?}", quick.findings);
    assert_eq!(quick.devices[0].outputs.pdos, whole.devices[0].outputs.pdos);
}

/// After a survey the MainDevice still answers, in PREOP, and takes everybody back to INIT.
#[test]
fn a_survey_answers_until_it_is_stopped() {
    let mut world = World::new(setup(&scenario(TREE)), (), None::<NoTap>);
    let limit = Time::new(60_000_000_000_000);
    let mut until = |ask: &mut dyn FnMut(&mut World<(), NoTap>), is: &dyn Fn(&Event) -> bool| {
        ask(&mut world);
        loop {
            match world.poll_event() {
                Some(event) if is(&event) => break,
                Some(Event::Failed(error)) => panic!("{error}"),
                Some(_) => {}
                None => assert!(world.step(limit), "it has come to a stand"),
            }
        }
        world.segment().devices().iter().map(|device| device.stack.state()).collect::<Vec<_>>()
    };
    let states = until(&mut |_| {}, &|event| *event == Event::Surveyed);
    assert_eq!(states, [AlState::PreOp; 4]);
    let object = ObjectAddress::new(0x1C32, 4);
    until(
        &mut |world| _ = world.main_mut().upload(3, object),
        &|event| matches!(event, Event::Uploaded { result: Ok(bytes), .. } if *bytes == [0x27, 0x04]),
    );
    let states = until(&mut |world| world.main_mut().stop(), &|event| *event == Event::Stopped);
    assert_eq!(states, [AlState::Init; 4]);
    assert_eq!(world.main().statistics().cycles, 0);
}

/// A line of three hundred stands in one column, however long it is.
#[test]
fn a_long_line_stays_a_line() {
    let text = "cycle = \"4ms\"\n[[subdevice]]\ndevice = \"simple_io16\"\ncount = 300\n";
    let scan = Scan::of(&scenario(text), true, &mut |_| {});
    let text = anstream::adapter::strip_str(&report(&scan).text(None)).to_string();
    assert!(text.contains("\n  ↓[1>0] 63 "), "{text}");
    assert!(text.contains("… and 236 more; --json lists them all"), "{text}");
    let long = text.lines().find(|line| line.chars().count() > 100);
    assert_eq!(long, None, "a hundred columns");
}

/// What hangs on what is read from the columns alone, as the legend says it, and compared with what
/// the scan knows.
#[test]
fn the_tree_tells_what_hangs_on_what() {
    // Couplers in a line with devices behind each; and a comb, deeper than it can be drawn.
    let terminals = "device = \"simple_io16\"\ncount = 3\n";
    let mut couplers = String::from("cycle = \"4ms\"\n");
    for (name, connect) in [("a", ""), ("b", "connect = \"a:2\"\n"), ("c", "connect = \"b:2\"\n")] {
        couplers += &format!(
            "[[subdevice]]\ndevice = \"model_every_mode\"\nname = \"{name}\"\n{connect}[[subdevice]]\n{terminals}"
        );
    }
    let mut comb = String::from("cycle = \"4ms\"\n");
    for level in 0..12 {
        let connect = match level {
            0 => String::new(),
            _ => format!("connect = \"fork {}:1\"\n", level - 1),
        };
        comb += &format!(
            "[[subdevice]]\ndevice = \"model_every_mode\"\nname = \"fork {level}\"\n{connect}"
        );
    }
    // Behind each fork, from the deepest to the first, a line at the port that frames visit last.
    for level in (0..12).rev() {
        comb += &format!(
            "[[subdevice]]\ndevice = \"simple_io16\"\nname = \"end {level}\"\nconnect = \"fork {level}:2\"\n"
        );
    }
    for (file, named) in [(couplers, 0), (comb, 1)] {
        let scan = Scan::of(&scenario(&file), true, &mut |_| {});
        let report = report(&scan);
        let text = anstream::adapter::strip_str(&report.text(None)).to_string();
        assert!(text.lines().all(|line| line.chars().count() <= 100), "{text}");
        let tree = text.lines().skip_while(|line| *line != " MainDevice").skip(1);
        let mut rows: Vec<(usize, usize)> = Vec::new();
        let mut names = 0;
        for row in tree.take(report.devices.len()) {
            let (lead, rest) = row.split_once('[').expect("a place");
            let (ports, rest) = rest.split_once("] ").expect("it ends");
            let at: usize = rest.split(' ').next().and_then(|at| at.parse().ok()).expect("a place");
            let column = lead.chars().count();
            let above = |wanted: usize| {
                rows.iter().rev().find(|(column, _)| *column == wanted).map(|(_, at)| *at)
            };
            let parent = match ports.split_once(':') {
                Some((parent, _)) => {
                    names += 1;
                    parent.parse().ok()
                }
                None if lead.ends_with('↓') => above(column),
                None => above(column - 3),
            };
            assert_eq!(parent, report.devices[at].parent, "{row}\n{text}");
            rows.push((column, at));
        }
        assert_eq!(rows.len(), report.devices.len());
        assert_eq!(names > 0, named > 0, "{text}");
    }
}

fn isocat(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_isocat"));
    command.current_dir(env!("CARGO_TARGET_TMPDIR")).args(arguments);
    command.output().expect("isocat starts")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).expect("isocat prints UTF-8")
}

#[test]
fn the_command_says_by_its_exit_code_what_it_found() {
    let output = isocat(&["scan"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    golden("built_in", &text(&output.stdout));

    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("doubtful.toml");
    std::fs::write(path, DOUBTFUL).expect("the target directory is writable");
    let output = isocat(&["scan", "doubtful.toml", "--json"]);
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
    let value: serde_json::Value = serde_json::from_str(&text(&output.stdout)).expect("JSON");
    assert_eq!(value["format"], "isocat-scan/1");
    assert_eq!(value["findings"].as_array().map(Vec::len), Some(3));

    for (arguments, words) in [
        (&["scan", "--device", "5"][..], "no such SubDevice, expected 0 to 4"),
        (&["scan", "--interface", "no-such-if"], "no-such-if"),
        (&["scan", "/no/such/file.toml"], "can't be read"),
        (&["scan", "doubtful.toml", "--interface", "eth0"], "expected an ENI"),
        (&["scan", "--netns", "somewhere"], "--interface"),
    ] {
        let output = isocat(arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert_eq!(text(&output.stdout), "", "{arguments:?}");
        let message = text(&output.stderr).split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(message.contains(words), "{arguments:?}: {message}");
    }
}

#[test]
fn the_schema_of_the_scan_is_committed() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/scan.schema.json");
    let now = serde_json::to_string_pretty(&schema()).expect("JSON") + "\n";
    if std::env::var_os("UPDATE_SCHEMA").is_some() {
        std::fs::write(&path, &now).expect("docs/ is writable");
    }
    let committed = std::fs::read_to_string(&path).unwrap_or_default();
    assert_eq!(now, committed, "the scan changed: run with UPDATE_SCHEMA=1 and raise FORMAT");
    let schema: serde_json::Value = serde_json::from_str(&committed).expect("JSON");
    for part in schema["$defs"].as_object().expect("parts").values().chain([&schema]) {
        assert_eq!(part["additionalProperties"], false, "{part}");
        let keys = part["properties"].as_object().expect("keys");
        assert_eq!(part["required"].as_array().map_or(0, Vec::len), keys.len(), "{part}");
        assert!(keys.values().all(|key| key["description"].is_string()), "{part}");
    }
}
