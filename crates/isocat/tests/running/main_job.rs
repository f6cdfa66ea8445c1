//! The main job, judged in true time.

use isocat::profile::Overrides;
use isocat::quantity::Ppb;
use isocat::segment_file::Clock;
use isocat::{Nanos, Report, Scenario, SegmentFile, run};
use isocat_esc::DriftLaw;
use isocat_sim::HostModel;
use isocat_sync::SyncMode;

fn built_in(milliseconds: i64) -> Scenario {
    let mut scenario = Scenario::from(SegmentFile::built_in());
    scenario.duration = Nanos::millis(milliseconds);
    scenario
}

/// The built-in segment without any imperfection: clocks agree, the host is never late. Every cycle
/// then is like the other, so that an edge can be met to the nanosecond.
fn ideal(shift: Nanos) -> Scenario {
    let mut scenario = built_in(200);
    scenario.host = HostModel { clock_ppb: 0, jitter: Nanos::ZERO, ..HostModel::default() };
    scenario.shift = Some(shift);
    // Its clocks make no steps.
    scenario.drift_law = Some(DriftLaw::PROPORTIONAL);
    scenario.hop_jitter = false;
    for device in &mut scenario.devices {
        device.clock = Clock::Given(Ppb(0));
        device.profile = device
            .profile
            .with(Overrides { jitter: Some(Nanos::ZERO), ..Overrides::default() })
            .expect("jitter is no object");
    }
    scenario
}

fn findings(report: &Report) -> String {
    report.findings.iter().map(|finding| format!("{}\n", finding.sentence())).collect()
}

#[test]
fn sync0_edges_are_within_100_ns_over_10_s_and_not_too_good() {
    let report = run(&built_in(10_000));
    assert!(report.in_sync, "{}", findings(&report));
    let synchronized: Vec<_> =
        report.devices.iter().filter(|d| d.mode == SyncMode::DcSync0).collect();
    assert_eq!(synchronized.len(), 3);
    for device in &synchronized {
        let error = device.true_time.sync0_error.expect("SYNC0 runs");
        assert!((10_000..=10_001).contains(&error.count), "{}: {} edges", device.name, error.count);
        assert!(error.worst_ns < 100.0, "{}: {error:?}", device.name);
        if device.position > 0 {
            // Steered in steps of a 10 ns tick: it can't be better than that.
            assert!(error.standard_deviation_ns > 0.5, "{}: {error:?}", device.name);
        }
    }
    let free = &report.devices[3];
    assert_eq!((free.mode, free.registers.al_status.is_op()), (SyncMode::FreeRun, true));
    assert_eq!(free.true_time.sync0_error, None);
}

#[test]
fn without_drift_compensation_the_same_judge_sees_clocks_run_apart() {
    let mut scenario = built_in(10_000);
    scenario.drift_compensation = false;
    let report = run(&scenario);
    assert!(!report.in_sync);
    // 55 ppm and 83 ppm against the reference, for ten seconds: 550 us and 830 us.
    for (position, ppm) in [(1, 55.0), (4, 83.0)] {
        let worst = report.devices[position].true_time.sync0_error.expect("SYNC0 runs").worst_ns;
        // Some of it was there when the judging began: from the offsets until OP.
        let expected = ppm * 10_000.0;
        assert!((1.0..1.1).contains(&(worst / expected)), "device {position}: {worst} ns");
    }
    assert!(findings(&report).contains("off the grid"), "{}", findings(&report));
    // SYNC0 has slid into the arrival of the frames: both devices have fallen, and are reported
    // fallen.
    for position in [1, 4] {
        let device = &report.devices[position];
        assert_eq!(device.registers.al_status.to_string(), "SAFEOP+ERR", "{}", device.name);
        assert_eq!(device.registers.al_status_code, 0x001A, "{}", device.name);
        assert!(device.registers.output_counters.sm_event_missed > Some(4), "{}", device.name);
    }
    assert!(report.devices[0].registers.al_status.is_op());
}

/// Slack 0 ns runs clean, -1 ns raises exactly the predicted counter at exactly that device.
#[test]
fn the_copy_time_may_use_the_last_nanosecond_but_no_more() {
    let shift = Nanos::micros(300);
    let before = run(&ideal(shift));
    assert!(before.in_sync, "{}", findings(&before));
    for late in [0, 1, 4] {
        let distance = before.devices[late].true_time.sm2_to_sync0.expect("SM2 and SYNC0");
        assert_eq!(distance.min_ns, distance.max_ns, "the ideal segment repeats itself");
        let with_copy_time = |ns: i64| {
            let mut scenario = ideal(shift);
            let needed = Overrides { calc_and_copy: Some(Nanos(ns)), ..Overrides::default() };
            let device = &mut scenario.devices[late];
            device.profile = device.profile.with(needed).expect("the CPU's time is no object");
            run(&scenario)
        };
        let exact = distance.min_ns as i64;
        let clean = with_copy_time(exact);
        assert!(clean.in_sync, "device {late}: {}", findings(&clean));
        assert_eq!(clean.devices[late].true_time.sync0_margin.expect("margins").min_ns, 0.0);

        let missed = with_copy_time(exact + 1);
        assert!(!missed.in_sync, "device {late}");
        for device in &missed.devices {
            let counters = &device.registers.output_counters;
            let counted = counters.sm_event_missed.unwrap_or(0);
            let too_small = counters.cycle_time_too_small.unwrap_or(0);
            assert_eq!(too_small, 0, "{}", device.name);
            if device.position == late {
                // Three for each miss, until the limit of 0x10F1:02 is passed: the device never
                // sees a valid sequence, and after its time-out refuses OP.
                assert!(counted > 4, "{}: 0x1C32:0B = {counted}", device.name);
                assert_eq!(device.registers.al_status.to_string(), "SAFEOP+ERR");
                assert_eq!(device.registers.al_status_code, 0x001A);
            } else {
                assert_eq!(counted, 0, "{}", device.name);
                assert!(!device.registers.al_status.is_error(), "{}", device.name);
            }
        }
    }
}

/// The same edge in the plan: it refuses what would miss by one nanosecond.
#[test]
fn the_plan_refuses_one_nanosecond_too_much() {
    let shift = Nanos::micros(300);
    let before = run(&ideal(shift));
    let line = |report: &Report, position: usize| {
        let plan = &report.devices[position].plan;
        plan.iter().find(|line| line.object == "0x1C32:06").cloned().expect("the line")
    };
    let slack = line(&before, 1).slack_ns;
    let with_stated = |more: i64| {
        let mut scenario = ideal(shift);
        let device = &mut scenario.devices[1];
        let entry = isocat_wire::ObjectAddress::new(0x1C32, 6);
        let now = device.profile.value(entry).expect("0x1C32:06") as i64;
        let stated =
            Overrides { stated_calc_and_copy: Some(Nanos(now + more)), ..Overrides::default() };
        device.profile = device.profile.with(stated).expect("0x1C32:06");
        run(&scenario)
    };
    let fits = with_stated(slack);
    assert!(fits.in_sync, "{}", findings(&fits));
    assert_eq!(line(&fits, 1).slack_ns, 0);
    let refused = with_stated(slack + 1);
    assert!(!refused.in_sync);
    let text = findings(&refused);
    assert!(text.contains("0x1C32:06") && text.contains("slack -1 ns"), "{text}");
}

#[test]
fn an_sm_synchronous_drive_runs_beside_dc_drives() {
    let text = SegmentFile::built_in_text().replace("mode = \"dc-sync0\"", "mode = \"sm\"");
    let file = SegmentFile::parse("sm.toml", &text).expect("a segment file");
    let mut scenario = Scenario::from(file);
    scenario.duration = Nanos::millis(300);
    let report = run(&scenario);
    assert!(report.in_sync, "{}", findings(&report));
    let modes: Vec<_> = report.devices.iter().map(|device| device.mode.name()).collect();
    assert_eq!(modes[0], "sm");
    for device in report.devices.iter().filter(|device| device.mode == SyncMode::SmSynchronous) {
        assert!(device.registers.al_status.is_op());
        assert_eq!(device.registers.output_sync_type, Some(1));
        assert_eq!(device.registers.input_sync_type, Some(0x22));
        assert_eq!(device.true_time.sync0_error, None);
    }
}

#[test]
fn drives_follow_their_targets() {
    let report = run(&built_in(1_000));
    for position in [0, 1, 4] {
        let text = &report.devices[position].application;
        assert!(text.contains("operation enabled"), "{text}");
        assert!(!text.contains("moved 0 increments"), "{text}");
    }
}
