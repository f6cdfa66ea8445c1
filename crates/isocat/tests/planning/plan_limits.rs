//! What the judges of a run refuse is a line of the plan, and each moment of the plan holds what is
//! seen: minimal segments at both sides of the edge.

use isocat::plan::{Plan, PlanReport, proof};
use isocat::report::NoteKind;
use isocat::{Nanos, Scenario, SegmentFile};
use isocat_sync::Moment;
use isocat_sync::budget::Check;

/// The segment, for half a second.
fn scenario(text: &str) -> Scenario {
    let mut scenario =
        Scenario::from(SegmentFile::parse("limits.toml", text).expect("a segment file"));
    scenario.duration = Nanos::millis(500);
    scenario
}

/// One device that has every mode.
fn alone(cycle: &str, keys: &str) -> Scenario {
    scenario(&format!("cycle = \"{cycle}\"\n[[subdevice]]\ndevice = \"model_every_mode\"\n{keys}"))
}

fn proven(scenario: &Scenario) -> PlanReport {
    let plan = Plan::of(scenario).expect("a plan");
    let mut report = plan.report(scenario);
    proof::prove(&plan, scenario).fill(&mut report);
    report
}

fn holds(report: &PlanReport) {
    let proof = report.proof.as_ref().expect("it was proven");
    assert!(report.fits && proof.holds, "{}: {:#?}", report.verdict, proof.findings);
}

fn slack(report: &PlanReport, position: usize, check: Check) -> Option<i64> {
    let lines = &report.devices[position].lines;
    lines.iter().find(|line| line.check == check).map(|line| line.slack_ns)
}

fn notes(report: &PlanReport) -> Vec<NoteKind> {
    report.warnings.iter().map(|note| note.kind).collect()
}

#[test]
fn a_shift_by_timer_counts_in_no_plan_whose_outputs_act_at_sync1() {
    let by_sync1 = proven(&alone("5ms", "mode = \"dc-sync1\"\nshift = \"904us\""));
    holds(&by_sync1);
    let valid = |report: &PlanReport| {
        let of_valid =
            |moment: &&isocat::plan::report::Moment| moment.event == Moment::OutputsValid;
        report.devices[0].moments.iter().find(of_valid).cloned().expect("outputs act")
    };
    let (phase, delay) = (by_sync1.segment.acting_phase_ns.expect("SYNC1"), 30_000);
    let Some(seen) = valid(&by_sync1).measured else { panic!("it was never seen") };
    assert!((seen.latest_ns - (phase + delay) as f64).abs() < 20.0, "{seen:?}");
    assert!(notes(&by_sync1).contains(&NoteKind::ShiftUnused));
    let by_sync0 = proven(&alone("5ms", "mode = \"dc-sync0\"\nshift = \"904us\""));
    holds(&by_sync0);
    let shift = valid(&by_sync0).latest_ns - by_sync0.segment.acting_phase_ns.expect("SYNC0");
    assert!((904_000..905_000).contains(&shift), "{shift}");
    assert!(!notes(&by_sync0).contains(&NoteKind::ShiftUnused));
}

/// 999 ns and 1 ns of clock speed are 1 us; a run of what does not fit is not in sync.
#[test]
fn the_spread_of_outputs_is_a_line_and_a_setting() {
    let with = |limit: &str, jitter: &str| {
        let keys = format!("mode = \"dc-sync0\"\njitter = \"{jitter}\"");
        let mut scenario = alone("1ms", &keys);
        if !limit.is_empty() {
            let text = format!(
                "outputs_spread = \"{limit}\"\ncycle = \"1ms\"\n[[subdevice]]\ndevice = \"simple_io4\""
            );
            let file = SegmentFile::parse("limits.toml", &text).expect("a segment file");
            scenario.outputs_spread = file.outputs_spread;
        }
        scenario
    };
    let left = |scenario: &Scenario| {
        slack(&proven(scenario), 0, Check::OutputsSpreadWithinLimit).expect("it has jitter")
    };
    assert_eq!([left(&with("", "999ns")), left(&with("", "1us"))], [0, -1]);
    assert_eq!([left(&with("5001ns", "5us")), left(&with("5us", "5us"))], [0, -1]);
    holds(&proven(&with("5001ns", "5us")));
    assert!(isocat::run(&with("5001ns", "5us")).in_sync);
    let refused = isocat::run(&with("", "5us"));
    assert!(!refused.in_sync && refused.judged_ns == 0, "{}", refused.verdict);
    let forced = isocat::run(&Scenario { force: true, ..with("", "5us") });
    assert!(!forced.in_sync && forced.judged_ns > 0, "{}", forced.verdict);
    let even = proven(&alone("1ms", "mode = \"dc-sync0\""));
    assert_eq!(slack(&even, 0, Check::OutputsSpreadWithinLimit), None);
}

/// 0x1C32:05 is 60 us.
#[test]
fn a_copy_time_above_the_minimum_cycle_is_named_and_its_moments_hold() {
    let with = |copy: &str| {
        proven(&alone(
            "2ms",
            &format!("mode = \"sm\"\ncalc_copy = \"{copy}\"\ncopy_time = \"30us\""),
        ))
    };
    let believed = with("60us");
    holds(&believed);
    assert!(!notes(&believed).contains(&NoteKind::CopyLongerThanCycle));
    let doubted = with("60001ns");
    holds(&doubted);
    assert!(notes(&doubted).contains(&NoteKind::CopyLongerThanCycle));
    let honest = proven(&alone("2ms", "mode = \"sm\"\ncalc_copy = \"100us\""));
    holds(&honest);
    // What it takes does not go into 125 us with the jitter of 12.5 us; with what it states it
    // would.
    let short = Plan::of(&alone("125us", "mode = \"sm\"\ncalc_copy = \"100us\"")).expect("a plan");
    assert!(!short.fits());
}

#[test]
fn clocks_count_with_what_the_file_says_of_them() {
    let with = |clock: &str| {
        scenario(&format!(
            "cycle = \"1ms\"\n[[subdevice]]\ndevice = \"model_every_mode\"\nmode = \"dc-sync0\"\n\
             clock = \"0ppm\"\n[[subdevice]]\ndevice = \"model_every_mode\"\nmode = \"dc-sync0\"\nshift = \"400us\"\n{clock}"
        ))
    };
    let left = |clock: &str| {
        let report = proven(&with(clock));
        holds(&report);
        slack(&report, 1, Check::OutputsValidInCycle).expect("a line")
    };
    let usual = left("clock = \"100ppm\"");
    // 400 us by 37 ppm more.
    let slower = usual - left("clock = \"-137ppm\"");
    assert!((15..=25).contains(&slower), "{slower} ns: by 15, and up to a tick");
    let ramped = usual - left("clock_ramp = { by = \"137ppm\", from = \"0s\", over = \"100s\" }");
    assert!((15..=25).contains(&ramped), "{ramped} ns");
    assert_eq!(usual, left(""));
}

#[test]
fn the_clock_error_follows_from_cycle_and_deviation() {
    let pair = |ppm: u32| {
        let mut scenario = scenario(&format!(
            "cycle = \"10ms\"\n[[subdevice]]\ndevice = \"model_every_mode\"\nmode = \"dc-sync0\"\n\
             [[subdevice]]\ndevice = \"model_every_mode\"\nmode = \"dc-sync0\"\nclock = \"{ppm}ppm\""
        ));
        scenario.duration = Nanos::millis(5_000);
        scenario
    };
    let (usual, bad) = (proven(&pair(100)), proven(&pair(150)));
    holds(&usual);
    holds(&bad);
    assert!(usual.segment.clock_error_ns < bad.segment.clock_error_ns);
    // More than the limit may be.
    let lost = proven(&pair(700));
    assert!(slack(&lost, 1, Check::Sync0WithinLimit).is_some_and(|slack| slack < 0));
}

/// The limit is the clock error and a tick, or a nanosecond less.
#[test]
fn the_error_of_sync0_is_a_line_and_a_setting() {
    let with = |limit| Scenario {
        sync0_limit: Nanos(limit),
        ..alone("1ms", "mode = \"dc-sync0\"\nclock = \"20ppm\"")
    };
    let (enough, short) = (proven(&with(210)), proven(&with(209)));
    holds(&enough);
    assert_eq!(slack(&enough, 0, Check::Sync0WithinLimit), Some(0));
    assert_eq!(slack(&short, 0, Check::Sync0WithinLimit), Some(-1));
    // What fits is no slack of the cycle.
    assert!(enough.segment.least_slack_ns > 1_000 && short.segment.least_slack_ns == -1);
}

/// SYNC0 fetches and SYNC1 acts: the distance from SM2 ends at SYNC0.
#[test]
fn the_distance_from_sm2_ends_at_sync0_where_sync1_acts() {
    let distance = |mode: &str| {
        let report = isocat::run(&alone("5ms", &format!("mode = \"{mode}\"\nsync1 = \"1560us\"")));
        assert!(report.in_sync, "{}", report.verdict);
        let plan =
            report.segment.plan.as_ref().and_then(|plan| plan.sync0_phase_ns).expect("SYNC0");
        (report.devices[0].true_time.sm2_to_sync0.expect("both came").min_ns, plan as f64)
    };
    let (fetched, acting) = distance("dc-sync1");
    assert!(fetched < acting - 1_560_000.0, "{fetched} of {acting}");
    assert!(fetched > acting - 1_560_000.0 - 40_000.0, "{fetched} of {acting}");
}
