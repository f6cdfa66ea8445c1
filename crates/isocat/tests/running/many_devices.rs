//! Segments of the size that the field speaks of: a hundred SubDevices from cold, three hundred on
//! 120 m of cable.

use std::fmt::Write;

use isocat::quantity::Ppb;
use isocat::segment_file::Clock;
use isocat::{Nanos, NoTap, Report, Scenario, SegmentFile};
use isocat_esc::Chip;
use isocat_wire::Picos;

/// Clocks from -50 to +50 ppm without order, counters anywhere, CoE mailboxes: all in OP, and every
/// SYNC0 within 100 ns of the grid in true time. What that takes in virtual time and frames has a
/// limit on either side.
#[test]
fn a_hundred_from_cold() {
    let mut text = String::from("cycle = \"1ms\"\nfor = \"2s\"\nseed = 7\n");
    for i in 0..100_i64 {
        // 37 and 101 have no common factor: each ppm once.
        let ppm = i * 37 % 101 - 50;
        write!(
            text,
            "[[subdevice]]\ndevice = \"model_every_mode\"\nmode = \"dc-sync0\"\nclock = \"{ppm}ppm\"\n"
        )
        .unwrap();
    }
    let mut scenario =
        Scenario::from(SegmentFile::parse("hundred", &text).expect("a segment file"));
    // With it SYNC0 leaves these 100 ns by far, at some devices for moments: docs/dc.md, "Hops that
    // jitter".
    scenario.hop_jitter = false;
    let report = isocat::run(&scenario);
    assert!(report.in_sync, "{}", report.verdict);
    let worst = |report: &Report| {
        let errors = report
            .devices
            .iter()
            .map(|device| device.true_time.sync0_error.as_ref().expect("SYNC0 in use").worst_ns);
        errors.fold(0.0, f64::max)
    };
    let (main, took) = (
        &report.segment.main_device,
        report.segment.true_time.time_to_synchronization_ns.expect("synchronized"),
    );
    println!(
        "100 SubDevices from cold: {} ms of virtual time, {} frames, of these {} for the clocks; SYNC0 within {:.1} ns",
        took as f64 / 1e6,
        main.bring_up_frames,
        main.drift_frames,
        worst(&report)
    );
    assert!((1.0..100.0).contains(&worst(&report)), "{}", worst(&report));
    assert!((300_000_000..800_000_000).contains(&took), "{took}");
    assert!((1_000..6_000).contains(&main.bring_up_frames), "{}", main.bring_up_frames);
    for device in &report.devices {
        assert!(device.registers.al_status.is_op(), "{}", device.registers.al_status);
    }
}

/// Four hundred copper hops that jitter, and one drift datagram in 5 ms: a loop that took the
/// jitter for a speed would let clocks wander by 0.6 us.
#[test]
fn clocks_of_a_long_line_stay_together_at_a_long_cycle() {
    let text = "cycle = \"5ms\"\nfor = \"1s\"\n[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\ncount = 400\n";
    let report = isocat::run(&Scenario::from(SegmentFile::parse("line", text).expect("it reads")));
    assert!(report.in_sync, "{}", report.verdict);
    let errors = report
        .devices
        .iter()
        .map(|device| device.true_time.sync0_error.as_ref().expect("SYNC0 in use").worst_ns);
    let worst = errors.fold(0.0, f64::max);
    assert!((20.0..250.0).contains(&worst), "{worst}");
}

/// Mean and spread of the last SubDevice's SYNC0 against the first's, ns in true time, of 300 on
/// 120 m.
fn last_of_three_hundred(chip: &Chip) -> (f64, f64) {
    let text = "cycle = \"1ms\"\nfor = \"300ms\"\n[[subdevice]]\ndevice = \"model_every_mode\"\nmode = \"dc-sync0\"\n\
                cable = \"400mm\"\ncount = 300\n";
    let mut scenario = Scenario::from(SegmentFile::parse("line", text).expect("a segment file"));
    scenario.hop_jitter = false;
    for (i, device) in scenario.devices.iter_mut().enumerate() {
        device.clock = Clock::Given(Ppb::ppm(i as i64 * 37 % 101 - 50));
    }
    let mut run = scenario.run();
    // The burst of drift frames goes on until what is left of the drift is below what is to be
    // seen.
    run.setup.config.drift_threshold = Nanos(15);
    run.setup.config.clock_error = Some(Nanos(200));
    for connection in &mut run.setup.segment {
        connection.device.chip = *chip;
    }
    let outcome = run.execute(None::<NoTap>, &mut |_| {});
    let report = Report::new(&scenario, &outcome);
    assert!(report.in_sync, "{}", report.verdict);
    let edges = |at: usize| *outcome.bench.devices()[at].sync0.as_ref().unwrap().statistics();
    let (first, last) = (edges(0), edges(299));
    ((last.mean() - first.mean()) / 1e3, last.standard_deviation() / 1e3)
}

/// Quantisation does not add up along a line: identical ESCs whose two delays are known are nearly
/// exact. A delay that differs from what is known by 1 ns in each ESC adds half of that per hop:
/// 298 / 2 = 149 ns.
#[test]
fn three_hundred_on_120_m() {
    let chip = &isocat_esc::chip::ET1100;
    let off = &Chip { processing_delay: chip.processing_delay + Picos(1_000), ..*chip };
    let mut table = String::from(
        "# 300 SubDevices, 120 m: SYNC0 of the last against the first, ns in true time, to the next ns.\n",
    );
    let (exact, spread) = last_of_three_hundred(chip);
    writeln!(table, "identical ESCs: mean {exact:.0}, standard deviation {spread:.0}").unwrap();
    assert!(exact.abs() < 25.0, "{exact}");
    assert!((0.5..25.0).contains(&spread), "{spread}");
    let (wrong, spread) = last_of_three_hundred(off);
    writeln!(table, "1 ns of tDiff error: mean {wrong:.0}, standard deviation {spread:.0}")
        .unwrap();
    // Each of the two runs is left with a drift below the threshold of 15 ns.
    assert!(((wrong - exact).abs() - 149.0).abs() < 15.0, "{wrong} and {exact}");
    golden("many/line_of_300.txt", &table);
}

fn golden(name: &str, text: &str) {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(name);
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        std::fs::write(&path, text).unwrap();
    }
    let golden = std::fs::read_to_string(&path).unwrap_or_default();
    assert_eq!(text, golden, "{}: UPDATE_GOLDEN=1 rewrites it", path.display());
}
