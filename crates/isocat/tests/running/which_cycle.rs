//! Outputs act in the cycle whose frame brought them, and inputs arrive with the first frame behind
//! their pulse: what is a whole cycle late is found, what is not is not, and both edges are sharp.

use std::path::Path;
use std::process::Command;

use isocat::diagnosis::diagnose;
use isocat::recording::Recording;
use isocat::report::Span;
use isocat::{Nanos, Report, Scenario, SegmentFile};
use isocat_segment::profile;
use isocat_sync::SyncMode;

/// SYNC1 lies 657 us behind the frame, so SYNC0 fetches outputs before they come.
const OUTPUTS_LATE: &str = r#"
    cycle = "1ms"
    shift = "657us"
    [[subdevice]]
    device = "model_every_mode"
    mode = "dc-sync1"
    sync1 = "800us"
"#;

/// Inputs are latched 1157 us behind the frame: behind the next one.
const INPUTS_LATE: &str = r#"
    cycle = "1ms"
    shift = "657us"
    [[subdevice]]
    device = "model_every_mode"
    mode = "dc-sync0"
    input_shift = "500us"
"#;

/// As found in the field: one phase for both, and it suits neither.
const BOTH_LATE: &str = r#"
    cycle = "1ms"
    [[subdevice]]
    device = "model_every_mode"
    mode = "dc-sync1"
    sync1 = "800us"
    [[subdevice]]
    device = "model_every_mode"
    mode = "dc-sync0"
    input_shift = "500us"
"#;

fn scenario(text: &str) -> Scenario {
    let file = SegmentFile::parse("test.toml", text).expect("a segment file");
    Scenario { force: true, duration: Nanos::millis(200), ..Scenario::from(file) }
}

fn run(text: &str) -> Report {
    let scenario = scenario(text);
    let outcome = scenario.run().execute(None::<Recording>, &mut |_| {});
    Report::new(&scenario, &outcome)
}

/// Where something was late, and what.
fn late(report: &Report) -> Vec<(usize, &'static str)> {
    let findings = report
        .findings
        .iter()
        .map(|finding| (finding.position.expect("of a device"), finding.kind.name()));
    findings.collect()
}

fn mean_us(age: Option<Span>) -> f64 {
    age.expect("it has process data").mean_ns / 1e3
}

/// Of the command: exit code and kinds.
fn command(name: &str, text: &str) -> (Option<i32>, Vec<String>) {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    std::fs::write(&path, text).expect("the target directory is writable");
    let mut command = Command::new(env!("CARGO_BIN_EXE_isocat"));
    command.args(["run", "--force", "--json", "--for", "200ms"]).arg(path);
    let output = command.output().expect("isocat starts");
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).expect("a report");
    let findings = report["findings"].as_array().expect("findings");
    let kinds = findings.iter().map(|finding| finding["kind"].as_str().expect("a kind").to_owned());
    (output.status.code(), kinds.collect())
}

#[test]
fn a_cycle_late_is_not_in_sync() {
    let kinds = |kinds: &[&str]| kinds.iter().map(|kind| (*kind).to_owned()).collect::<Vec<_>>();
    assert_eq!(command("outputs.toml", OUTPUTS_LATE), (Some(1), kinds(&["outputs-late"])));
    assert_eq!(command("inputs.toml", INPUTS_LATE), (Some(1), kinds(&["inputs-late"])));
    let both = kinds(&["outputs-late", "inputs-late"]);
    assert_eq!(command("both.toml", BOTH_LATE), (Some(1), both));
    let mended = OUTPUTS_LATE.replace("800us", "600us");
    assert_eq!(command("outputs-mended.toml", &mended), (Some(0), Vec::new()));
    let mended = INPUTS_LATE.replace("500us", "300us");
    assert_eq!(command("inputs-mended.toml", &mended), (Some(0), Vec::new()));
    let mended = BOTH_LATE.replace("800us", "300us").replace("500us", "200us");
    assert_eq!(command("both-mended.toml", &mended), (Some(0), Vec::new()));
}

#[test]
fn ages_are_those_of_true_time() {
    let report = run(BOTH_LATE);
    assert_eq!(late(&report), [(0, "outputs-late"), (1, "inputs-late")]);
    let [late, other] = [0, 1].map(|at| &report.devices[at].true_time);
    // Pulse and delay of 30 us, less what the host is late on average; and a cycle more.
    let outputs = mean_us(other.outputs_age);
    assert!((675.0..=687.0).contains(&outputs), "{outputs}");
    assert!((mean_us(late.outputs_age) - outputs - 1_000.0).abs() < 0.1);
    // From SYNC1 to the next frame; from SYNC0, 500 us later, to the one behind that.
    let inputs = mean_us(late.inputs_age);
    assert!((343.0..=365.0).contains(&inputs), "{inputs}");
    assert!((mean_us(other.inputs_age) - inputs - 500.0).abs() < 0.1);
    assert!(late.outputs_late >= 195 && late.outputs_late <= 200, "{}", late.outputs_late);
    assert_eq!((late.inputs_late, other.outputs_late), (0, 0));
}

#[test]
fn the_cause_is_told_with_its_figures() {
    let scenario = scenario(BOTH_LATE);
    let recording = Recording::new(scenario.duration, scenario.sync0_limit, 100);
    let outcome = scenario.run().execute(Some(recording), &mut |_| {});
    let report = Report::new(&scenario, &outcome);
    let segment = outcome.world.main().segment().clone();
    let recorded = outcome.world.into_tap().expect("the tap").finish();
    let all = diagnose(&report, &recorded, &segment, scenario.sync0_limit);
    assert_eq!(all.len(), 2);
    for diagnosis in &all {
        assert!(diagnosis.causes.len() >= 2 && !diagnosis.remedies.is_empty(), "{diagnosis:?}");
    }
}

/// Every built-in device in each of its modes, as a plain segment has it.
#[test]
fn no_mode_of_a_built_in_device_is_called_late() {
    let mut tried = [0; SyncMode::ALL.len()];
    for id in profile::built_in_ids() {
        for (at, mode) in SyncMode::ALL.into_iter().enumerate() {
            let sync0 = match mode {
                SyncMode::DcSubordinated => "sync0_cycle = \"500us\"",
                _ => "",
            };
            let text = format!(
                "cycle = \"2ms\"\n[[subdevice]]\ndevice = \"{}\"\nmode = \"{mode}\"\n{sync0}\n",
                id
            );
            let on_ebus = format!("{text}[host]\nport = \"ebus\"\n");
            let read = |text: &str| SegmentFile::parse("test.toml", text);
            let Ok(file) = read(&text).or_else(|_| read(&on_ebus)) else { continue };
            let scenario = Scenario { duration: Nanos::millis(100), ..Scenario::from(file) };
            let outcome = scenario.run().execute(None::<Recording>, &mut |_| {});
            let report = Report::new(&scenario, &outcome);
            assert!(report.in_sync, "{} {mode}: {:?}", id, report.findings);
            let [outputs, inputs] = {
                let seen = &report.devices[0].true_time;
                [(seen.outputs_age, seen.outputs_late), (seen.inputs_age, seen.inputs_late)]
            };
            let device = &outcome.world.main().segment().devices[0];
            for ((age, late), length) in
                [(outputs, device.outputs.length), (inputs, device.inputs.length)]
            {
                assert_eq!(late, 0, "{} {mode}", id);
                assert_eq!(age.is_some(), length > 0, "{} {mode}", id);
                // Older than light and younger than two cycles.
                let sane = age.is_none_or(|age| age.min_ns > 0.0 && age.max_ns < 4e6);
                assert!(sane, "{} {mode}: {age:?}", id);
            }
            tried[at] += 1;
        }
    }
    // Free Run, SM, DC SYNC0, and what only some have.
    assert!(
        tried.iter().zip([20, 15, 12, 1, 4, 1]).all(|(tried, least)| *tried >= least),
        "{tried:?}"
    );
}

/// Slow groups, shifts, a faster SYNC0, all beside each other and with a host that is late.
#[test]
fn shifts_and_groups_are_intended() {
    let report = run(r#"
        cycle = "1ms"
        [host]
        jitter = "100us"
        [[subdevice]]
        device = "model_every_mode"
        mode = "dc-sync0"
        shift = "150us"
        input_shift = "120us"
        [[subdevice]]
        device = "model_every_mode"
        mode = "dc-shift-sync1"
        sync1 = "100us"
        clock = "-37ppm"
        [[subdevice]]
        device = "model_every_mode"
        mode = "dc-sync1"
        cycle = "4ms"
        [[subdevice]]
        device = "model_every_mode"
        mode = "dc-subordinated"
        sync0_cycle = "250us"
        [[subdevice]]
        device = "model_every_mode"
        mode = "sm"
        input_shift = "400us"
        cycle = "2ms"
        [[subdevice]]
        device = "model_every_mode"
        mode = "free-run"
    "#);
    assert!(report.in_sync, "{:?}", report.findings);
    assert!(report.devices.iter().all(|device| device.true_time.outputs_age.is_some()));
}

/// A timer shifts the latch so that inputs miss the next frame: nothing counts that. Without a
/// shift a device may need the whole cycle, and what misses the next SM2 event is counted in
/// 0x1C32:0C as well.
#[test]
fn sm_mode_has_until_the_next_event_and_with_a_shift_until_the_next_frame() {
    let of = |keys: &str| {
        late(&run(&format!(
            "cycle = \"1ms\"\n[host]\njitter = \"0us\"\n[[subdevice]]\ndevice = \
             \"model_every_mode\"\nmode = \"sm\"\n{keys}\n"
        )))
    };
    assert_eq!(of("input_shift = \"975us\""), []);
    assert_eq!(of("input_shift = \"985us\""), [(0, "inputs-late")]);
    assert_eq!(of("copy_time = \"980us\""), []);
    assert_eq!(of("copy_time = \"1000us\""), [(0, "outputs-late"), (0, "cycle-time-too-small")]);
}

/// SYNC0 that fetches just before and just behind the frame, by what the frame wanders and a tick.
#[test]
fn both_sides_of_the_pulse_that_fetches() {
    let at = |shift: i64| {
        format!(
            "cycle = \"1ms\"\nshift = \"{shift} ns\"\n[host]\njitter = \"0us\"\n[[subdevice]]\ndevice = \
             \"model_every_mode\"\nmode = \"dc-sync1\"\nsync1 = \"500us\"\n"
        )
    };
    let wide = run(&at(657_000));
    let distance = wide.devices[0].true_time.sm2_to_sync0.expect("SM2 and SYNC0");
    // With this shift SYNC0 and SM2 meet.
    let edge = 657_000.0 - distance.min_ns;
    let wander = distance.max_ns - distance.min_ns + 10.0;
    assert!(wander < 200.0, "{distance:?}");
    let behind = run(&at((edge + wander) as i64 + 10));
    assert!(late(&behind).is_empty(), "{:?}", behind.findings);
    let before = run(&at((edge - wander) as i64 - 10));
    assert_eq!(late(&before), [(0, "outputs-late")]);
}
