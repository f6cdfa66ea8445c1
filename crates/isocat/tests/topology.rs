//! Trees, and cables pulled while a MainDevice is at work.

use isocat::{Nanos, NoTap, Scenario, SegmentFile, run};
use isocat_maindevice::Event;
use isocat_sim::{Motion, World};
use isocat_wire::time::{Picos, Time};

const TREE: &str = r#"
    cycle = "1ms"
    for = "300ms"
    [[subdevice]]
    name = "root"
    device = "kollmorgen_akd2g"
    clock_walk = { step = "0.02ppm", every = "1ms", within = "1ppm" }
    [[subdevice]]
    name = "late"
    device = "kollmorgen_akd2g"
    connect = "root:2"
    clock = "-35ppm"
    [[subdevice]]
    name = "early"
    device = "kollmorgen_akd2g"
    connect = "1:1"
    clock = "+20ppm"
    [[subdevice]]
    name = "end of early"
    device = "hpmicro_ecat_cia402_ssc"
    port = 1
"#;

/// A fork, a swapped cable at an end, a clock that wanders: in sync all the same.
#[test]
fn a_tree_comes_into_synchronization() {
    let scenario = Scenario::from(SegmentFile::parse("tree.toml", TREE).expect("it reads"));
    let report = run(&scenario);
    let names: Vec<_> = report.devices.iter().map(|device| device.name.as_str()).collect();
    assert_eq!(names, ["root", "early", "end of early", "late"]);
    assert!(report.in_sync, "{}", report.verdict);
    for device in &report.devices {
        let error = device.true_time.sync0_error.expect("SYNC0 runs");
        assert!(error.worst_ns < 150.0, "{}: {error:?}", device.name);
        assert!(device.position == 0 || error.standard_deviation_ns > 0.5, "{}", device.name);
    }
}

/// The cable to the last device is pulled for 20 ms in the middle of a run.
#[test]
fn a_pulled_cable_shows_in_the_working_counter_and_goes_again() {
    let scenario = Scenario::from(SegmentFile::built_in());
    let mut world = World::new(scenario.run().setup, Motion::default(), None::<NoTap>);
    let limit = Time::new(20_000_000_000_000);
    while !matches!(world.poll_event(), Some(Event::InOperation { .. })) {
        assert!(world.step(limit), "the segment does not come up");
    }
    let last = world.segment().devices().len() - 1;
    let wrong = |world: &mut World<Motion, NoTap>, milliseconds: i64| {
        let end = world.now() + Nanos::millis(milliseconds).into();
        let mut wrong = 0;
        while world.step(end) {
            while let Some(event) = world.poll_event() {
                wrong += u32::from(matches!(event, Event::WorkingCounter { .. }));
            }
        }
        wrong
    };
    assert_eq!(wrong(&mut world, 50), 0);
    let pulled = world.now() + Picos(300_000_000);
    world.segment_mut().unplug(last, pulled);
    let cut = wrong(&mut world, 20);
    assert!((15..=21).contains(&cut), "{cut} cycles with a wrong working counter");
    // A link needs 300 ms to come back.
    let plugged = world.now();
    world.segment_mut().plug(last, plugged);
    assert!((290..=300).contains(&wrong(&mut world, 299)));
    assert_eq!(world.segment().path().entries.len(), last);
    let after = wrong(&mut world, 20);
    assert_eq!(world.segment().path().entries.len(), last + 1, "{after}");
}
