//! Clocks with a given deviation, or one drawn by the seed.

use super::*;
use crate::Scenario;

/// A line of devices with this head of the file.
fn line(head: &str, count: usize) -> SegmentFile {
    let text = format!(
        "cycle = \"1ms\"\n{head}\n[[subdevice]]\ndevice = \"simple_io4\"\ncount = {count}\n"
    );
    SegmentFile::parse("s.toml", &text).unwrap()
}

/// Deviations of the simulated oscillators, ppb.
fn deviations(file: SegmentFile) -> Vec<i64> {
    let setup = Scenario::from(file).run().setup;
    setup.segment.iter().map(|connection| connection.device.clock.deviation_ppb).collect()
}

#[test]
fn no_two_devices_share_a_perfect_crystal() {
    let mut drawn = deviations(line("", 400));
    assert!(drawn.iter().all(|ppb| ppb.abs() <= 25_000), "{drawn:?}");
    // The draw is even: each tenth of the range has its share of 400, and the mean is near 0
    // (standard error 720).
    for tenth in 0..10 {
        let least = -25_000 + 5_000 * tenth;
        let here = drawn.iter().filter(|ppb| (least..least + 5_000).contains(*ppb)).count();
        assert!((20..=64).contains(&here), "{here} from {least}");
    }
    let mean = drawn.iter().sum::<i64>() / 400;
    assert!(mean.abs() < 3_000, "{mean}");
    drawn.sort_unstable();
    drawn.dedup();
    assert!(drawn.len() > 390, "{} different ones of 400", drawn.len());
}

#[test]
fn a_draw_repeats_and_depends_on_seed_and_position_alone() {
    let twenty = deviations(line("", 20));
    assert_eq!(twenty, deviations(line("", 20)));
    assert_ne!(twenty, deviations(line("seed = 2", 20)));
    // More devices behind, the host's draws and another cycle change nothing.
    assert_eq!(twenty, deviations(line("", 30))[..20]);
    assert_eq!(twenty, deviations(line("for = \"1s\"\nhost = { jitter = \"0ns\" }", 20)));
    // The seed may also be set outside the file.
    let mut scenario = Scenario::from(line("", 20));
    scenario.seed = 2;
    let setup = scenario.run().setup;
    let seconds = setup.segment.iter().map(|connection| connection.device.clock.deviation_ppb);
    assert_eq!(seconds.collect::<Vec<_>>(), deviations(line("seed = 2", 20)));
}

#[test]
fn the_tolerance_is_that_of_file_profile_or_field() {
    assert_eq!(deviations(line("clocks = \"0ppm\"", 5)), [0; 5]);
    let wide = deviations(line("clocks = \"100ppm\"", 50));
    let most = wide.iter().map(|ppb| ppb.abs()).max().unwrap();
    assert!((50_000..=100_000).contains(&most), "{most}");
    let text = profile::built_in_text("simple_io4").unwrap();
    let text = text.replace("sync_unit = true", "sync_unit = true\nclock_tolerance = \"3ppm\"");
    let stated = Profile::from_toml("p.toml", &text.replace("simple_io4", "stated")).unwrap();
    assert_eq!(stated.clock_tolerance, Some(Ppb::ppm(3)));
    let folder = std::env::temp_dir().join(format!("isocat-clock-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(folder.join("stated.toml"), text.replace("simple_io4", "stated")).unwrap();
    let clock = |head: &str, device: &str| {
        let text =
            format!("cycle = \"1ms\"\n{head}\n[[subdevice]]\ndevice = \"stated.toml\"\n{device}");
        let path = folder.join("s.toml").display().to_string();
        SegmentFile::parse(&path, &text).unwrap().subdevices[0].clock
    };
    assert_eq!(clock("", ""), Clock::DrawnWithin(Ppb::ppm(3)));
    assert_eq!(clock("clocks = \"7ppm\"", ""), Clock::DrawnWithin(Ppb::ppm(7)));
    assert_eq!(clock("clocks = \"7ppm\"", "clock = \"-9ppm\""), Clock::Given(Ppb::ppm(-9)));
    assert_eq!(clock("", "clock = \"0ppm\""), Clock::Given(Ppb(0)));
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn tolerances_have_no_sign() {
    let text = one("").replace("cycle", "clocks = \"-5ppm\"\ncycle");
    assert_eq!(
        refused(&text).0,
        "1:10 clocks = \"-5ppm\" is out of range; expected 0 ppm to +1000 ppm"
    );
}
