//! Reports as pages: whole in one file, small, with causes and remedies where something is wrong.

use isocat::diagnosis::diagnose;
use isocat::html::run::{self, Run};
use isocat::plan::what_if::{self, Settings};
use isocat::plan::{Plan, proof};
use isocat::recording::{Recorded, Recording};
use isocat::{Nanos, Report, Scenario, SegmentFile, html};
use isocat_maindevice::Segment;

/// The largest SYNC0 error that scenarios allow, if they say nothing else.
const LIMIT: Nanos = Nanos(1_000);

fn run(text: &str) -> (Report, Recorded, Segment, String) {
    let mut scenario = Scenario::from(SegmentFile::parse("test.toml", text).expect("it is right"));
    scenario.force = text.contains("# forced");
    let spans = run::spans(scenario.devices.len());
    let recording = Recording::new(scenario.duration, scenario.sync0_limit, spans);
    let outcome = scenario.run().execute(Some(recording), &mut |_| {});
    let report = Report::new(&scenario, &outcome);
    let segment = outcome.world.main().segment().clone();
    let recorded = outcome.world.into_tap().expect("the tap").finish();
    let (command, limit) = ("isocat run test.toml", scenario.sync0_limit);
    let (on, found) = (&recorded, &segment);
    let page = Run { report: &report, recorded: on, segment: found, limit, command }.page();
    (report, recorded, segment, page.render())
}

/// A page needs nothing but itself.
fn is_alone(page: &str) {
    for asks in ["<link rel=\"stylesheet", "<script src", "@import", "<img", "<iframe", "url(http"]
    {
        assert!(!page.contains(asks), "{asks}");
    }
    let without_names = page.replace("http://www.w3.org/2000/svg", "");
    assert!(
        !without_names.contains("http://") && !without_names.contains("https://"),
        "an address"
    );
    assert!(!page.contains("NaN"), "a figure that is none");
}

/// The JSON in a page.
fn json(page: &str) -> serde_json::Value {
    let (_, rest) = page.split_once("type=\"application/json\">").expect("it is there");
    let (text, _) = rest.split_once("</script>").expect("it ends");
    serde_json::from_str(text).expect("it is JSON")
}

const GOOD: &str = r#"
cycle = "1ms"
for = "200ms"
[[subdevice]]
device = "model_every_mode"
name = "</script><b>&amp;"
[[subdevice]]
device = "model_every_mode"
name = "shifts"
mode = "dc-shift-sync1"
clock = "-30ppm"
[[subdevice]]
device = "simple_io16"
name = "plain"
"#;

#[test]
fn a_page_has_the_verdict_the_figures_and_the_whole_report() {
    let (report, _, _, page) = run(GOOD);
    is_alone(&page);
    assert!(page.contains(&report.verdict), "{}", report.verdict);
    assert!(!page.contains("Why, and what to do"));
    let (shown, _) = page.split_once("<script id=\"report\"").expect("it is there");
    assert!(!shown.contains("<b>") && shown.contains("&lt;b&gt;"), "names are no markup");
    assert_eq!(page.matches("</script>").count(), 3, "nothing but ours ends a script");
    assert_eq!(json(&page), serde_json::to_value(&report).expect("JSON"));
    for part in [
        "cycle-0-area",
        "cycle-1-area",
        "error-1-area",
        "host-phase-area",
        "1C32:02",
        "1C32:06",
        "1C32:09",
        "1C33:06",
        "seed 1",
        "isocat run test.toml",
        "slack",
    ] {
        assert!(page.contains(part), "{part}");
    }
}

#[test]
fn fifty_devices_take_less_than_two_megabytes() {
    let text = r#"
cycle = "2ms"
for = "1s"
[[subdevice]]
device = "kollmorgen_akd2g"
clock = "20ppm"
[[subdevice]]
device = "model_every_mode"
count = 49
clock = "-31ppm"
"#;
    let (report, recorded, _, page) = run(text);
    assert!(report.in_sync, "{}", report.verdict);
    assert!(recorded.devices.iter().all(|device| device.sync0.count() > 400));
    assert!(page.len() < 2_000_000, "{} bytes", page.len());
    is_alone(&page);
}

const LATE: &str = r#"
cycle = "1ms"
clocks = "0ppm" # so that the CPU's times are those of true time
hop_jitter = false
for = "500ms"
shift = "200us"
[[subdevice]]
device = "model_every_mode"
name = "conveyor"
[[subdevice]]
device = "model_every_mode"
name = "gripper"
copy_time = "178us"
"#;

#[test]
fn a_device_that_is_late_is_named_with_cause_and_remedy() {
    let (report, recorded, segment, page) = run(LATE);
    assert!(!report.in_sync);
    let all = diagnose(&report, &recorded, &segment, LIMIT);
    assert_eq!(all.iter().map(|d| d.position).collect::<Vec<_>>(), [Some(1)], "{all:?}");
    let (causes, remedies) = (all[0].causes.join(" "), all[0].remedies.join(" "));
    let left = recorded.devices[1].cycle.as_ref().expect("it works").outputs_left.least();
    assert!((-8_000_000..0).contains(&left), "{left}");
    let late = isocat::quantity::time(-left as f64 / 1e3);
    assert!(causes.contains(&format!("up to {late} after the SYNC0")), "{causes}");
    assert!(causes.contains("took up to 178 us, but 0x1C32:06 states 20 us"), "{causes}");
    assert!(remedies.contains("0x1C32:06 = 178000 ns"), "{remedies}");
    assert!(page.contains("Why, and what to do") && page.contains("SubDevice 1 (gripper)"));
    // What it says helps: the pulse as late as it says, and nothing is missed.
    let shift = remedies.split("shift = \"").nth(1).and_then(|rest| rest.split('"').next());
    let shift = shift.expect("it proposes a shift");
    let (mended, ..) = run(&LATE.replace("200us", shift));
    assert!(mended.in_sync, "{}", mended.verdict);
    // ... and so does the time that it really needs.
    let stated = LATE.replace("copy_time = \"178us\"", "calc_copy = \"178000 ns\"");
    let (mended, ..) = run(&stated.replace("shift = \"200us\"\n", ""));
    assert!(mended.in_sync, "{}", mended.verdict);
}

#[test]
fn a_clock_that_nobody_leads_is_told_from_one_that_is_off() {
    let text = r#"
cycle = "1ms"
for = "500ms"
[host]
drift_compensation = false
[[subdevice]]
device = "model_every_mode"
clock = "0ppm"
[[subdevice]]
device = "model_every_mode"
name = "runs away"
clock = "40ppm"
"#;
    let (report, recorded, segment, _) = run(text);
    assert!(!report.in_sync, "{}", report.verdict);
    let all = diagnose(&report, &recorded, &segment, LIMIT);
    let one = all.iter().find(|d| d.position == Some(1)).expect("it is told");
    let causes = one.causes.join(" ");
    // A faster clock comes earlier.
    assert!(causes.contains("runs away by -40") || causes.contains("runs away by -39"), "{causes}");
    assert!(one.remedies.join(" ").contains("drift_compensation"), "{:?}", one.remedies);
}

#[test]
fn a_plan_that_was_forced_says_which_line_had_warned() {
    let text = r#"
# forced
cycle = "1ms"
clocks = "0ppm"
for = "200ms"
shift = "40us"
[[subdevice]]
device = "model_every_mode"
[[subdevice]]
device = "model_every_mode"
"#;
    let (report, recorded, segment, page) = run(text);
    assert!(!report.in_sync, "{}", report.verdict);
    let all = diagnose(&report, &recorded, &segment, LIMIT);
    let causes: String = all.iter().flat_map(|d| d.causes.clone()).collect();
    assert!(causes.contains("The plan had said so: 0x1C32:06"), "{all:?}");
    is_alone(&page);
}

#[test]
fn plans_have_pages_too() {
    let scenario =
        Scenario { duration: Nanos::millis(100), ..Scenario::from(SegmentFile::built_in()) };
    let plan = Plan::of(&scenario).expect("it can be planned");
    let mut report = plan.report(&scenario);
    let bare = html::plan::page(&plan, &report, "isocat plan").render();
    assert!(!bare.contains("The proof") && !bare.contains("what-if"));
    proof::prove(&plan, &scenario).fill(&mut report);
    let page = html::plan::page(&plan, &report, "isocat plan --prove").render();
    is_alone(&page);
    assert!(page.contains(&report.verdict.replace('<', "&lt;").replace('>', "&gt;")));
    assert!(page.contains("It holds") && page.contains("slack seen [t]"));
    assert_eq!(json(&page)["format"], report.format);

    let settings = Settings { gone: Nanos::millis(50), devices: vec![1], threads: 1 };
    let found = what_if::what_if(&plan, &scenario, &settings, &mut |_| {});
    report.what_if = Some(found.clone());
    let page = html::plan::page(&plan, &report, "isocat plan --what-if=1").render();
    is_alone(&page);
    for case in &found.cases {
        assert!(page.contains(&found.goes(case)));
        assert!(found.rows(case).iter().all(|row| page.contains(&row.what)));
    }
    assert_eq!(json(&page)["what_if"]["cases"].as_array().map(Vec::len), Some(2));
}

/// Lost pulses: the program is too slow, or it went deaf for a while.
#[test]
fn lost_sync_pulses_have_a_cause_each() {
    const DEVICE: &str = "cycle = \"500us\"\nfor = \"200ms\"\n[[subdevice]]\ndevice = \"model_every_mode\"\nmode = \"dc-sync0\"\n";
    for (keys, cause, remedy) in [
        (
            "# forced\npulse = \"0ns\"\nacknowledge = \"600us\"",
            "acknowledges SYNC 600 us behind the pulse",
            "read 0x098E (SYNC1: 0x098F) as soon as",
        ),
        (
            "pulse = \"0ns\"\n[[fault]]\nat = \"in-operation + 50ms\"\nwhat = \"misbehave 0 dead-sync0 for 5ms\"",
            "it did not notice the pulse",
            "program it again (0x0981)",
        ),
    ] {
        let (report, recorded, segment, page) = run(&format!("{DEVICE}{keys}\n"));
        let all = diagnose(&report, &recorded, &segment, LIMIT);
        let (causes, remedies) = (all[0].causes.join(" "), all[0].remedies.join(" "));
        assert!(causes.contains(cause), "{keys}: {causes}");
        assert!(remedies.contains(remedy), "{keys}: {remedies}");
        let said = causes.contains("The plan had said so: 0x0982");
        assert_eq!(said, keys.contains("forced"), "{causes}");
        assert!(page.contains("made no edge"), "{keys}");
    }
}
