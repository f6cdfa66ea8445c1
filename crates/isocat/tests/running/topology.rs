//! Trees, and cables pulled while a MainDevice is at work.

use isocat::{Nanos, NoTap, Scenario, SegmentFile, run};
use isocat_maindevice::{Event, Motion};
use isocat_sim::World;
use isocat_wire::AlState;
use isocat_wire::time::{Picos, Time};

const TREE: &str = r#"
    cycle = "1ms"
    for = "300ms"
    [[subdevice]]
    name = "root"
    device = "model_every_mode"
    mode = "dc-sync0"
    clock_walk = { step = "0.02ppm", every = "1ms", within = "1ppm" }
    [[subdevice]]
    name = "late"
    device = "kollmorgen_akd2g"
    connect = "root:2"
    clock = "-35ppm"
    [[subdevice]]
    name = "early"
    device = "kollmorgen_akd2g"
    connect = "0:1"
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

/// The cable to the last device is pulled in the middle of a run and plugged in 20 ms later.
#[test]
fn a_pulled_cable_shows_in_the_working_counter_until_it_is_back() {
    let scenario = Scenario::from(SegmentFile::built_in());
    // Nobody is to bring it back.
    let mut setup = scenario.run().setup;
    setup.config.readmission = None;
    let mut world = World::new(setup, Motion::default(), None::<NoTap>);
    let limit = Time::new(20_000_000_000_000);
    while !matches!(world.poll_event(), Some(Event::InOperation { .. })) {
        assert!(world.step(limit), "the segment does not come up");
    }
    let last = world.segment().devices().len() - 1;
    // Datagrams (two a cycle) whose working counter is wrong, frames that do not come back, in so
    // much time.
    let run_for = |world: &mut World<Motion, NoTap>, milliseconds: i64| {
        let (before, end) =
            (world.main().statistics(), world.now() + Nanos::millis(milliseconds).into());
        while world.step(end) {
            while world.poll_event().is_some() {}
        }
        let after = world.main().statistics();
        let wrong = after.working_counter_errors - before.working_counter_errors;
        (wrong, after.frames_lost - before.frames_lost)
    };
    assert_eq!(run_for(&mut world, 50), (0, 0));
    // Between two frames, so that no frame meets the cut before the ESC above it knows.
    let pulled = world.now() + Picos(300_000_000);
    world.segment_mut().unplug(last, pulled);
    let (wrong, lost) = run_for(&mut world, 20);
    assert!((38..=40).contains(&wrong) && lost == 0, "{wrong} wrong, {lost} lost");
    assert_eq!(world.segment().path().entries.len(), last);
    let plugged = world.now();
    world.segment_mut().plug(last, plugged);
    // A link needs 300 ms to come back.
    let (wrong, lost) = run_for(&mut world, 299);
    assert!((596..=598).contains(&wrong) && lost == 0, "{wrong} wrong, {lost} lost");
    let (_, lost) = run_for(&mut world, 3);
    assert_eq!((world.segment().path().entries.len(), lost), (last + 1, 0));
    // It answers again, but its watchdog has taken it to SAFEOP: its inputs count, its outputs do
    // not.
    assert_eq!(world.segment().devices()[last].stack.state(), AlState::SafeOp);
    assert_eq!(run_for(&mut world, 20), (20, 0));
}

/// The last device loses its power in the middle of a run: it comes back in INIT, without an
/// address.
#[test]
fn a_power_cycle_leaves_the_device_behind_in_init() {
    let text = "cycle = \"1ms\"\n[[subdevice]]\ndevice = \"simple_io16\"\ncount = 3\n";
    let scenario = Scenario::from(SegmentFile::parse("simple.toml", text).expect("it reads"));
    let outcome = || {
        let mut setup = scenario.run().setup;
        setup.config.readmission = None;
        let mut world = World::new(setup, Motion::default(), None::<NoTap>);
        let limit = Time::new(20_000_000_000_000);
        while !matches!(world.poll_event(), Some(Event::InOperation { .. })) {
            assert!(world.step(limit), "the segment does not come up");
        }
        let mut wrong = Vec::new();
        let off = world.now() + Picos(10_300_000_000);
        world.segment_mut().power_off(2, off);
        world.segment_mut().power_on(2, off + Picos(20_000_000_000));
        for milliseconds in [10, 20, 301, 20] {
            let before = world.main().statistics().working_counter_errors;
            let end = world.now() + Nanos::millis(milliseconds).into();
            while world.step(end) {
                while world.poll_event().is_some() {}
            }
            wrong.push(world.main().statistics().working_counter_errors - before);
        }
        assert_eq!(world.segment().path().entries.len(), 3, "frames pass it again");
        let device = &world.segment().devices()[2];
        assert_eq!(device.stack.state(), AlState::Init);
        assert_eq!(device.esc.register(isocat_wire::register::STATION_ADDRESS), 0);
        assert_eq!(world.segment().devices()[1].stack.state(), AlState::Op);
        (wrong, world.segment().devices().iter().map(|d| d.esc.registers()).collect::<Vec<_>>())
    };
    let (wrong, registers) = outcome();
    // Process data and AL status, once a cycle each; the device answers neither any more. The cycle
    // is that of the reference clock, so one more may begin in the time.
    assert_eq!(wrong[0], 0);
    assert!(
        wrong[1..].iter().zip([20, 301, 20]).all(|(n, ms)| (ms - 1..=2 * (ms + 1)).contains(n)),
        "{wrong:?}"
    );
    assert!(outcome() == (wrong, registers), "it repeats itself");
}
