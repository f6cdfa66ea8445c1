//! Devices that state none of their times and measure them on command (0x1C32:08). They measure
//! what their CPU needs, and the plan uses these times, to the nanosecond.

use isocat_engine::plan::{Plan, PlanReport};
use isocat_engine::{NoTap, Report, run};
use isocat_maindevice::config::{MeasureTimes, MeasuredTimes};
use isocat_maindevice::{Cause, OwnTimes};
use isocat_segment::profile::{Profile, built_in_text};
use isocat_segment::{Scenario, SegmentFile};
use isocat_sim::HostModel;
use isocat_sync::budget::Check;
use isocat_wire::time::Nanos;

/// Times that its CPU needs, ns: from SM2 to mapped outputs, the application, and from Input Latch
/// to inputs in the buffer.
const COPY: i64 = 20_000;
const APPLICATION: i64 = 7_000;
const INPUT_COPY: i64 = 12_000;

/// One device with each mode that has dynamic times, on perfect clocks, with a changed profile.
fn scenario(keys: &str, change: impl Fn(String) -> String) -> Scenario {
    let text = format!(
        "cycle = \"1ms\"\nclocks = \"0ppm\"\nmeasure_times = true\n[[subdevice]]\ndevice = \"model_every_mode\"\n{keys}"
    );
    let mut scenario =
        Scenario::from(SegmentFile::parse("dynamic.toml", &text).expect("a segment file"));
    let profile = built_in_text("model_every_mode").expect("built in");
    let dynamic = profile.replace("[behaviour]\n", "[behaviour]\ndynamic_times = true\n");
    assert_ne!(profile, dynamic);
    scenario.devices[0].profile =
        Profile::from_toml("dynamic", &change(dynamic)).expect("a profile");
    scenario.host = HostModel { clock_ppb: 0, jitter: Nanos::ZERO, ..HostModel::default() };
    scenario.duration = Nanos::millis(50);
    scenario.hop_jitter = false;
    scenario
}

fn same(profile: String) -> String {
    profile
}

/// The times that the device measured in a run, and the report.
fn measured(scenario: &Scenario) -> (OwnTimes, Report) {
    let outcome = scenario.run().execute(None::<NoTap>, &mut |_| {});
    let report = Report::new(scenario, &outcome);
    let own = outcome.world.main().segment().devices[0].own_times;
    (own.unwrap_or_else(|| panic!("nothing was measured: {}", report.verdict)), report)
}

#[test]
fn a_device_measures_what_its_cpu_needs() {
    // After SYNC0 inputs are latched before the application, so its work is part of their time.
    let all = COPY + APPLICATION + INPUT_COPY;
    for (mode, delay, work) in
        [("dc-sync0", APPLICATION, all - APPLICATION), ("sm", COPY + APPLICATION, all)]
    {
        let scenario = scenario(&format!("mode = \"{mode}\"\n"), same);
        let (own, report) = measured(&scenario);
        assert!(report.in_sync, "{mode}: {}", report.verdict);
        assert!(own.settled, "{mode}: {own:?}");
        // The values must be stable for a second, and are read every 50 ms.
        assert!((1_000..1_300).contains(&(own.after.0 / 1_000_000)), "{mode}: {own:?}");
        assert_eq!(own.times.outputs_calc_and_copy, Some(Nanos(COPY)), "{mode}");
        assert_eq!(own.times.inputs_calc_and_copy, Some(Nanos(INPUT_COPY)), "{mode}");
        assert_eq!(own.times.outputs_delay, Some(Nanos(delay)), "{mode}");
        assert_eq!(own.times.minimum_cycle, Some(Nanos(work)), "{mode}");
        let note = report.text();
        assert!(note.contains("measured its times (0x1C32:08), stable"), "{note}");
    }
}

#[test]
fn what_does_not_lack_times_does_not_measure() {
    let found = |scenario: &Scenario| {
        let outcome = scenario.run().execute(None::<NoTap>, &mut |_| {});
        assert!(outcome.in_sync(), "{:?}", outcome.findings);
        outcome.world.main().segment().devices[0].own_times
    };
    // In Free Run its times do not matter; stated times are used; measured ones are stored.
    assert_eq!(found(&scenario("mode = \"free-run\"\n", same)), None);
    let stated = |text: String| text.replace("dynamic_times = true\n", "");
    assert_eq!(found(&scenario("mode = \"dc-sync0\"\n", stated)), None);
    let kept = "mode = \"dc-sync0\"\nmeasured_times = { outputs_calc_and_copy = \"20us\" }\n";
    assert_eq!(found(&scenario(kept, same)), None);
    // Nothing is measured unless requested.
    let mut unasked = scenario("mode = \"dc-sync0\"\n", same);
    unasked.operation.measure_times = false;
    assert_eq!(found(&unasked), None);
}

/// Times that change until the time limit are reported as not stable, and used nevertheless.
#[test]
fn times_that_do_not_settle_in_time_are_told() {
    let with = |settled, longest| {
        let scenario = scenario("mode = \"dc-sync0\"\n", same);
        let mut run = scenario.run();
        let wish =
            MeasureTimes { settled: Nanos::millis(settled), longest: Nanos::millis(longest) };
        run.setup.config.measure_times = Some(wish);
        let outcome = run.execute(None::<NoTap>, &mut |_| {});
        let own = outcome.world.main().segment().devices.first().and_then(|d| d.own_times);
        (own.map(|own| (own.settled, own.times.outputs_calc_and_copy)), outcome.failure)
    };
    // The first values come with the first reading, some 50 ms after the command.
    assert_eq!(with(500, 500), (Some((false, Some(Nanos(COPY)))), None));
    assert_eq!(with(500, 700), (Some((true, Some(Nanos(COPY)))), None));
    let (own, failure) = with(500, 499);
    assert_eq!(own, None);
    assert!(matches!(failure.map(|e| e.cause), Some(Cause::Setting { name: "measure_times", .. })));
}

/// SYNC0 moves from the middle that an unknown copy time leaves to that of the measured one.
#[test]
fn the_plan_moves_for_what_was_measured() {
    let slow = |text: String| {
        text.replace("\"20us\",   \"Calc", "\"400us\",   \"Calc").replace("\"60us\"", "\"900us\"")
    };
    let mut scenario = scenario("mode = \"dc-sync0\"\n", slow);
    let (own, report) = measured(&scenario);
    assert_eq!(own.times.outputs_calc_and_copy, Some(Nanos(400_000)));
    assert!(report.in_sync, "{}", report.verdict);
    let moved = report.segment.plan.and_then(|plan| plan.sync0_phase_ns).expect("SYNC0");
    assert!((600_000..800_000).contains(&moved), "{moved}");
    scenario.operation.measure_times = false;
    let report = run(&scenario);
    let first = report.segment.plan.and_then(|plan| plan.sync0_phase_ns).expect("SYNC0");
    assert!((400_000..600_000).contains(&first), "{first}");
}

fn planned(scenario: &Scenario) -> PlanReport {
    Plan::of(scenario).expect("a plan").report(scenario)
}

/// SYNC0 is tested at the first instant that the measured copy time allows, and a nanosecond before
/// it: on the way up, and in a plan with the times that the run reported.
#[test]
fn a_nanosecond_too_early_is_refused() {
    let free = scenario("mode = \"dc-sync0\"\n", same);
    let (own, _) = measured(&free);
    let MeasuredTimes { outputs_calc_and_copy, inputs_calc_and_copy, outputs_delay, .. } =
        own.times;
    let ns = |time: Option<Nanos>| time.expect("measured").0;
    let keys = format!(
        "mode = \"dc-sync0\"\nmeasured_times = {{ outputs_calc_and_copy = \"{}ns\", \
         inputs_calc_and_copy = \"{}ns\", outputs_delay = \"{}ns\", minimum_cycle = \"{}ns\" }}\n",
        ns(outputs_calc_and_copy),
        ns(inputs_calc_and_copy),
        ns(outputs_delay),
        ns(own.times.minimum_cycle),
    );
    let mut known = scenario(&keys, same);
    let report = planned(&known);
    assert!(report.fits, "{}", report.verdict);
    let line = report.devices[0].lines.iter().find(|l| l.check == Check::OutputsBeforeSync0);
    let line = line.expect("outputs go before SYNC0");
    let copy = line.needed.iter().find(|term| term.what.contains("calc and copy")).expect("a term");
    assert_eq!((copy.value_ns, &*copy.origin), (COPY, "0x1C32:06, measured by the device"));

    let earliest = Nanos(line.needed_ns);
    for (shift, fits) in [(earliest, true), (earliest - Nanos(1), false)] {
        known.shift = Some(shift);
        assert_eq!(planned(&known).fits, fits, "plan at {shift}");
        let mut measuring = free.clone();
        measuring.shift = Some(shift);
        let outcome = measuring.run().execute(None::<NoTap>, &mut |_| {});
        let cause = outcome.failure.as_ref().map(|error| &error.cause);
        match fits {
            true => assert!(outcome.in_sync(), "{cause:?} {:?}", outcome.findings),
            false => {
                let Some(Cause::Plan { line, .. }) = cause else { panic!("{cause:?}") };
                assert_eq!((line.check, line.slack()), (Check::OutputsBeforeSync0, Nanos(-1)));
            }
        }
    }
}

/// Before the measurement the plan says that the times are not known.
#[test]
fn unknown_times_are_assumptions() {
    let report = planned(&scenario("mode = \"dc-sync0\"\n", same));
    assert!(report.verdict.starts_with("Fits with assumptions"), "{}", report.verdict);
    let unknown = report.assumptions.iter().filter(|text| text.contains("states 0"));
    assert!(unknown.count() >= 2, "{:?}", report.assumptions);
}
