//! Every synchronization mode, seen in true time: the timeline of two cycles is a golden text, and
//! what the mode promises is judged with the figures that the device states.

use std::path::Path;

use isocat::profile::Profile;
use isocat::timeline::{Moment, Timeline, record};
use isocat::{Nanos, Scenario, SegmentFile};
use isocat_sim::HostModel;

/// What the device states, ns: 0x1C32:06, 0x1C32:09, 0x1C33:06, 0x1C33:09, and its application's
/// time.
const COPY: i64 = 20_000;
const DELAY: i64 = 30_000;
const INPUT_COPY: i64 = 12_000;
const INPUT_DELAY: i64 = 2_000;
const APPLICATION: i64 = 7_000;

/// One device with ideal clocks, so that each cycle is like the other.
fn scenario(keys: &str, change: impl Fn(String) -> String) -> Scenario {
    let text = format!(
        "cycle = \"1ms\"\nclocks = \"0ppm\"\n[[subdevice]]\ndevice = \"model_every_mode\"\n{keys}"
    );
    let mut scenario = Scenario::from(SegmentFile::parse("modes", &text).expect("a segment file"));
    let profile = isocat::profile::built_in_text("model_every_mode").expect("built in").to_owned();
    let changed = change(profile.clone());
    if changed != profile {
        scenario.devices[0].profile =
            Profile::from_toml("changed", &changed).expect("still a profile");
    }
    scenario.host = HostModel { clock_ppb: 0, jitter: Nanos::ZERO, ..HostModel::default() };
    scenario.duration = Nanos::millis(20);
    scenario.hop_jitter = false;
    scenario
}

fn run(name: &str, keys: &str, change: impl Fn(String) -> String) -> Cycle {
    let scenario = scenario(keys, change);
    let (timeline, report) = record(&scenario, 0, Nanos::millis(5), 2);
    let findings: Vec<_> = report.findings.iter().map(|finding| finding.sentence()).collect();
    assert!(report.in_sync, "{name}: {}\n{findings:#?}\n{timeline}", report.verdict);
    let text = format!("{name}: {}\n\n{timeline}", keys.trim().replace('\n', ", "));
    golden(name, &text);
    Cycle(timeline)
}

fn golden(name: &str, text: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/golden/modes/{name}.txt"));
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        std::fs::create_dir_all(path.parent().unwrap()).expect("a folder");
        std::fs::write(&path, text).expect("the golden files are writable");
    }
    let committed = std::fs::read_to_string(&path).unwrap_or_default();
    assert_eq!(text, committed, "{}: UPDATE_GOLDEN=1 rewrites it", path.display());
}

/// The first whole cycle of a timeline, in ns.
struct Cycle(Timeline);

impl Cycle {
    fn all(&self, moment: Moment) -> Vec<i64> {
        let of = |(at, m): &(isocat_wire::time::Picos, Moment)| {
            // Instants of a device lie on its 1 ns; true time has the rest.
            (*m == moment).then_some((at.0 + 500) / 1_000)
        };
        self.0.entries.iter().filter_map(of).collect()
    }

    /// The first of its kind at or behind `from`.
    fn next(&self, moment: Moment, from: i64) -> i64 {
        let all = self.all(moment);
        *all.iter()
            .find(|at| **at >= from)
            .unwrap_or_else(|| panic!("{moment:?}: {all:?}\n{}", self.0))
    }

    fn first(&self, moment: Moment) -> i64 {
        self.next(moment, 0)
    }
}

fn assert_near(found: i64, expected: i64, what: &str, cycle: &Cycle) {
    // Times are rounded once, pulses come on ticks of 10 ns.
    assert!((found - expected).abs() <= 1, "{what}: {found}, expected {expected}\n{}", cycle.0);
}

fn same(text: String) -> String {
    text
}

#[test]
fn free_run() {
    let cycle = run("free_run", "mode = \"free-run\"\n", same);
    let ready = cycle.first(Moment::OutputsReady);
    let fetched = cycle.all(Moment::OutputsFetched);
    assert_near(ready - fetched[0], COPY, "copy", &cycle);
    let available = cycle.next(Moment::InputsAvailable, ready);
    assert!(available - fetched[0] <= 60_000, "within 0x1C32:05\n{}", cycle.0);
    assert!(cycle.all(Moment::Sync0).is_empty());
}

#[test]
fn sm_synchronous() {
    let cycle = run("sm", "mode = \"sm\"\n", same);
    let sm2 = cycle.first(Moment::Sm2);
    assert_near(cycle.first(Moment::OutputsReady), sm2 + COPY, "ready", &cycle);
    let valid = cycle.next(Moment::OutputsValid, sm2);
    assert_near(valid, sm2 + COPY + APPLICATION, "Outputs Valid", &cycle);
    assert_near(cycle.next(Moment::InputLatch, valid), valid, "Input Latch", &cycle);
    assert!(cycle.next(Moment::InputsAvailable, valid) <= sm2 + 60_000, "{}", cycle.0);
}

#[test]
fn sm_shifted() {
    let cycle = run("sm_shift", "mode = \"sm\"\ninput_shift = \"400us\"\n", same);
    let sm2 = cycle.first(Moment::Sm2);
    assert_near(cycle.next(Moment::OutputsValid, sm2), sm2 + COPY + APPLICATION, "OV", &cycle);
    let latch = cycle.next(Moment::InputLatch, sm2);
    assert_near(latch, sm2 + 400_000, "latch", &cycle);
    assert_near(cycle.next(Moment::InputsAvailable, latch), latch + INPUT_COPY, "inputs", &cycle);
}

/// What holds in all modes in which SM2 starts and SYNC0 acts.
fn outputs_at(cycle: &Cycle, pulse: Moment, delay: i64) -> i64 {
    let sm2 = cycle.first(Moment::Sm2);
    let acting = cycle.next(pulse, sm2);
    assert_near(cycle.next(Moment::OutputsReady, sm2), sm2 + COPY, "ready", cycle);
    assert!(sm2 + COPY <= acting, "outputs are ready before they act\n{}", cycle.0);
    assert_near(cycle.next(Moment::OutputsValid, acting), acting + delay, "OV", cycle);
    acting
}

fn inputs_at(cycle: &Cycle, from: i64, latch: i64) {
    assert_near(cycle.next(Moment::InputLatch, from), latch, "Input Latch", cycle);
    let available = cycle.next(Moment::InputsAvailable, latch);
    assert_near(available, latch + INPUT_COPY, "inputs available", cycle);
    let next_frame = cycle.next(Moment::Sm3, latch);
    assert!(available <= next_frame, "in the buffer before they are fetched\n{}", cycle.0);
}

#[test]
fn dc_sync0() {
    let cycle = run("dc_sync0", "mode = \"dc-sync0\"\n", same);
    let sync0 = outputs_at(&cycle, Moment::Sync0, DELAY);
    inputs_at(&cycle, sync0, sync0);
    assert_eq!(cycle.all(Moment::Sync0).len(), 2);
    assert!(cycle.all(Moment::Sync1).is_empty());
}

#[test]
fn dc_sync0_shifted() {
    let keys = "mode = \"dc-sync0\"\nshift = \"150us\"\ninput_shift = \"200us\"\n";
    let cycle = run("dc_shift", keys, same);
    let sync0 = outputs_at(&cycle, Moment::Sync0, 150_000);
    inputs_at(&cycle, sync0, sync0 + 200_000);
}

#[test]
fn dc_shifted_by_sync1() {
    let keys = "mode = \"dc-shift-sync1\"\nsync1 = \"100us\"\n";
    let cycle = run("dc_shift_sync1", keys, same);
    let sync0 = outputs_at(&cycle, Moment::Sync0, DELAY);
    assert_near(cycle.next(Moment::Sync1, sync0), sync0 + 100_000, "SYNC1", &cycle);
    inputs_at(&cycle, sync0, sync0 + 100_000 + INPUT_DELAY);
}

/// 0x1C32:04 with bits 6:5 = 10: outputs are shifted by SYNC1 too.
#[test]
fn dc_outputs_shifted_by_sync1() {
    let keys = "mode = \"dc-shift-sync1\"\nsync1 = \"100us\"\n";
    let by_sync1 = |text: String| {
        text.replace("0x003F,   \"Sync", "0x005F,   \"Sync").replace(
            "[0x03, \"UNSIGNED32\", \"rw preop\", \"0ns\",    \"Shift time\"]",
            "[0x03, \"UNSIGNED32\", \"ro\", \"0ns\",    \"Shift time\"]",
        )
    };
    let cycle = run("dc_outputs_on_sync1", keys, by_sync1);
    let sync1 = outputs_at(&cycle, Moment::Sync1, DELAY);
    inputs_at(&cycle, sync1, sync1 + INPUT_DELAY);
}

#[test]
fn dc_sync1() {
    let cycle = run("dc_sync1", "mode = \"dc-sync1\"\nsync1 = \"50us\"\n", same);
    let sm2 = cycle.first(Moment::Sm2);
    let sync0 = cycle.next(Moment::Sync0, sm2);
    assert_near(cycle.next(Moment::OutputsFetched, sm2), sync0, "fetched at SYNC0", &cycle);
    assert_near(cycle.next(Moment::OutputsReady, sync0), sync0 + COPY, "ready", &cycle);
    let sync1 = cycle.next(Moment::Sync1, sync0);
    assert_near(sync1, sync0 + 50_000, "SYNC1", &cycle);
    assert!(sync1 - sync0 >= COPY);
    assert_near(cycle.next(Moment::OutputsValid, sync1), sync1 + DELAY, "OV", &cycle);
    inputs_at(&cycle, sync1, sync1);
}

#[test]
fn dc_subordinated() {
    let keys = "mode = \"dc-subordinated\"\nsync0_cycle = \"250us\"\n";
    let cycle = run("dc_subordinated", keys, same);
    let sync1 = outputs_at(&cycle, Moment::Sync1, DELAY);
    let sync0 = cycle.all(Moment::Sync0);
    assert_eq!(sync0.len(), 8, "four SYNC0 in a cycle\n{}", cycle.0);
    assert!(sync0.windows(2).all(|pair| (pair[1] - pair[0] - 250_000).abs() <= 1), "{sync0:?}");
    assert_eq!(cycle.all(Moment::ApplicationBegins).len(), 8, "the application at each of them");
    // SYNC1 comes together with a SYNC0, the last of its cycle: that one takes the inputs.
    assert_near(cycle.next(Moment::Sync0, sync1 - 1), sync1, "SYNC0 with SYNC1", &cycle);
    inputs_at(&cycle, sync1 - 1, sync1);
    assert_eq!(cycle.all(Moment::InputLatch).len(), 2, "once a cycle");
}

/// The application at SYNC1, SYNC0 for the cycles below it only.
#[test]
fn dc_subordinated_with_the_application_at_sync1() {
    let keys = "mode = \"dc-subordinated\"\nsync0_cycle = \"250us\"\n";
    let at_sync1 = |text: String| text + "application_on_sync1 = true\n";
    let cycle = run("dc_subordinated_application_on_sync1", keys, at_sync1);
    let sync1 = outputs_at(&cycle, Moment::Sync1, DELAY);
    assert_eq!(cycle.all(Moment::ApplicationBegins).len(), 2);
    assert_near(cycle.next(Moment::ApplicationBegins, sync1), sync1, "application", &cycle);
}

/// Chains without SM2: outputs are looked for at SYNC0, and act when the stated times are over.
#[test]
fn dc_sync0_without_sm2() {
    let polls = |text: String| text + "polls_outputs = true\n";
    let cycle = run("chain_sync0", "mode = \"dc-sync0\"\n", polls);
    let sync0 = cycle.first(Moment::Sync0);
    assert_near(cycle.first(Moment::OutputsFetched), sync0, "fetched at SYNC0", &cycle);
    assert_near(cycle.next(Moment::OutputsValid, sync0), sync0 + COPY + DELAY, "OV", &cycle);
    assert_near(cycle.next(Moment::InputLatch, sync0), sync0, "Input Latch", &cycle);
}

#[test]
fn dc_sync0_and_sync1_without_sm2() {
    let polls = |text: String| text + "polls_outputs = true\n";
    let keys = "mode = \"dc-shift-sync1\"\nsync1 = \"100us\"\n";
    let cycle = run("chain_sync0_sync1", keys, polls);
    let sync0 = cycle.first(Moment::Sync0);
    assert_near(cycle.next(Moment::OutputsValid, sync0), sync0 + COPY + DELAY, "OV", &cycle);
    inputs_at(&cycle, sync0, sync0 + 100_000 + INPUT_DELAY);
}

/// An application that now and then takes longer than a cycle: 0x1C32:0C tells, and nothing else.
#[test]
fn an_application_that_overruns_is_counted() {
    let overruns = |one_in: u32| {
        let change = |text: String| {
            let overrun = format!("overrun = {{ one_in = {one_in}, by = \"1ms\" }}\n");
            text.replace("application = \"7us\"\n", &format!("application = \"7us\"\n{overrun}"))
        };
        let mut scenario = scenario("mode = \"sm\"\n", change);
        scenario.duration = Nanos::millis(500);
        let (_, report) = record(&scenario, 0, Nanos::ZERO, 1);
        let counters = &report.devices[0].registers.output_counters;
        assert_eq!(counters.sm_event_missed, Some(0));
        (counters.cycle_time_too_small.expect("0C is there"), report.in_sync)
    };
    let (often, in_sync) = overruns(50);
    assert!((3..=25).contains(&often) && !in_sync, "{often} of 500 cycles, one in 50 asked");
    assert_eq!(overruns(1_000_000_000), (0, true));
}
