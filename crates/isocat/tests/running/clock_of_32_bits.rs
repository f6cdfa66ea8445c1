//! Clocks of 32 bits: a run is in sync past the end of their counters, every 4.295 s, be it the
//! reference clock's or one that follows.

use std::path::PathBuf;

use isocat::{NoTap, Report, Scenario, SegmentFile};

/// The profile of a drive with another chip.
fn drive(chip: &str) -> PathBuf {
    let ours = concat!(env!("CARGO_MANIFEST_DIR"), "/../segment/profiles/kollmorgen_akd2g.toml");
    let text = std::fs::read_to_string(ours).expect("our own profile");
    let changed = text.replacen("chip = \"ET1100\"", &format!("chip = \"{chip}\""), 1).replacen(
        "kollmorgen_akd2g",
        &format!("drive_{}", chip.to_lowercase()),
        1,
    );
    let name = format!("isocat-clock-of-32-bits-{}-{chip}.toml", std::process::id());
    let path = std::env::temp_dir().join(name);
    std::fs::write(&path, changed).expect("a profile is written");
    path
}

/// Runs drives with these chips for longer than their counters last.
fn run(cycle: &str, chips: &[&str]) -> Report {
    let mut text = format!("cycle = \"{cycle}\"\nfor = \"9s\"\n");
    for (number, chip) in chips.iter().enumerate() {
        let path = drive(chip);
        let speed = 20 * number;
        text += &format!(
            "[[subdevice]]\ndevice = \"{}\"\nname = \"{number}\"\nclock = \"{speed}ppm\"\n",
            path.display()
        );
    }
    let file = SegmentFile::parse("clocks.toml", &text).expect("a segment file");
    let scenario = Scenario::from(file);
    let outcome = scenario.run().execute(None::<NoTap>, &mut |_| {});
    Report::new(&scenario, &outcome)
}

/// 2^32 ns is a whole number of none of these cycles. If the grid started from zero again when the
/// counter wraps, SYNC0 would be off it.
#[test]
fn a_run_goes_on_past_the_end_of_the_counter() {
    const NARROW: &str = "IP_CORE_32";
    for (cycle, chips) in [
        ("1ms", &[NARROW][..]),
        ("1ms", &[NARROW, "ET1100"]),
        ("1ms", &["ET1100", NARROW]),
        ("3ms", &[NARROW, NARROW]),
    ] {
        let report = run(cycle, chips);
        assert!(report.in_sync, "{cycle}, {chips:?}: {:?}", report.findings);
        for device in &report.devices {
            let error = device.true_time.sync0_error.as_ref().expect("SYNC0 was measured");
            assert!(error.worst_ns.abs() < 1_000.0, "{cycle}, {chips:?}: {error:?}");
        }
    }
}
