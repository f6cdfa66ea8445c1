//! Propagation delays over a whole way up: what is measured, what can't be, and what is watched
//! afterwards.

use isocat::{Nanos, NoTap, Scenario, SegmentFile, run};
use isocat_esc::Chip;
use isocat_esc::chip::ET1100;
use isocat_maindevice::{DelayWatch, Event, Motion};
use isocat_sim::World;
use isocat_sim::world::Setup;
use isocat_sync::delay::{Delay, Why};
use isocat_wire::register::{self, features};
use isocat_wire::time::{Picos, Time};

const FORK: &str = r#"
    cycle = "1ms"
    for = "100ms"
    [[subdevice]]
    device = "kollmorgen_akd2g"
    clock_walk = { step = "0.02ppm", every = "1ms", within = "1ppm" }
    [[subdevice]]
    name = "junction"
    device = "simple_io16"
    cable = "40m"
    [[subdevice]]
    name = "near"
    device = "kollmorgen_akd2g"
    connect = "junction:1"
    cable = "7m"
    [[subdevice]]
    name = "far"
    device = "kollmorgen_akd2g"
    connect = "junction:2"
    clock = "-30ppm"
    cable = "90m"
"#;

fn scenario(text: &str) -> Scenario {
    Scenario::from(SegmentFile::parse("delays.toml", text).expect("it reads"))
}

/// Brings it up; what happened on the way.
fn operating(setup: Setup) -> (World<Motion, NoTap>, Vec<Event>) {
    let mut world = World::new(setup, Motion::default(), None::<NoTap>);
    let limit = Time::new(20_000_000_000_000);
    let mut events = Vec::new();
    loop {
        while let Some(event) = world.poll_event() {
            if let Event::InOperation { .. } = event {
                return (world, events);
            }
            events.push(event);
        }
        assert!(world.step(limit), "the segment does not come up: {events:?}");
    }
}

fn run_for(world: &mut World<Motion, NoTap>, time: Nanos) -> Vec<Event> {
    let end = world.now() + Picos::from(time);
    let mut events = Vec::new();
    while world.step(end) {
        events.extend(std::iter::from_fn(|| world.poll_event()));
    }
    events
}

/// ps from the reference's processing unit to that of each, in true time; of the last frame.
fn true_delays(world: &World<Motion, NoTap>) -> Vec<i64> {
    let entries = &world.segment().path().entries;
    let reference = world.main().segment().reference.expect("there is a clock");
    entries.iter().map(|entry| (entry.after - entries[reference].after).0).collect()
}

/// Every delay of a fork is within the error that it states, which the report shows as well: with
/// the jitter of hops it is larger, and more latches are taken.
#[test]
fn delays_are_within_their_errors() {
    for hop_jitter in [false, true] {
        fork_within_its_errors(hop_jitter);
    }
}

fn fork_within_its_errors(hop_jitter: bool) {
    let still = Scenario { hop_jitter: false, ..scenario(FORK) };
    let (world, _) = operating(still.run().setup);
    let truth = true_delays(&world);
    let scenario = Scenario { hop_jitter, ..still };
    let (world, _) = operating(scenario.run().setup);
    let statistics = world.main().statistics();
    // Clocks of almost one speed stand to each other as they are: latches average little.
    let (latches, most) = if hop_jitter { (17..=128, 20_000) } else { (16..=16, 5_000) };
    assert!(latches.contains(&statistics.delay_latches), "{}", statistics.delay_latches);
    assert_eq!(statistics.delay_latches_lost, 0);
    for (device, truth) in world.main().segment().devices.iter().zip(truth) {
        let measured = device.measured_delay.expect("it was measured");
        let Delay::Known { delay, standard_error, systematic } = measured else {
            panic!("{}: {measured:?}", device.name)
        };
        assert_eq!(device.delay, measured.nanos());
        assert_eq!(device.delay_latches_left_out, 0);
        let error = (delay.0 - truth).abs();
        assert!(error <= 4 * standard_error.0 + systematic.0, "{}: {error} ps", device.name);
        assert!(standard_error.0 <= most, "{}: {standard_error:?}", device.name);
        let first = device.position == 0;
        assert!(first == (standard_error.0 == 0) && first == (systematic.0 == 0));
    }
    let report = run(&scenario);
    assert!(report.in_sync, "{}", report.verdict);
    for device in &report.devices {
        let registers = &device.registers;
        let error = registers.delay_error_ns.expect("it was measured");
        assert!((0..80).contains(&error) && registers.delay_unknown.is_none(), "{registers:?}");
    }
}

/// A junction without DC unit.
static JUNCTION: Chip =
    Chip { features: ET1100.features & !(features::DC | features::DC_64_BIT), ..ET1100 };

/// Behind a junction without receive times nobody knows the delays. They are named, with the reason
/// and what is possible, and the clocks run with the middle of it.
#[test]
fn a_junction_without_receive_times() {
    let mut setup = scenario(FORK).run().setup;
    setup.segment[1].device.chip = JUNCTION;
    let (world, events) = operating(setup);
    let truth = true_delays(&world);
    let segment = world.main().segment();
    let mut unknown = Vec::new();
    for event in &events {
        let Event::DelayUnknown { position, why, between, used } = event else { continue };
        unknown.push(*position);
        assert_eq!(*why, Why::BranchWithoutTimes { at: 1 });
        let (least, most) = between.expect("the branch has a length");
        assert!((least.0..=most.0).contains(&truth[*position]), "{least:?} to {most:?}");
        assert!((used.0 * 1_000 - (least.0 + most.0) / 2).abs() <= 500);
        let device = &segment.devices[*position];
        assert_eq!(device.delay, Some(*used));
        assert!(matches!(device.measured_delay, Some(Delay::Indeterminate { .. })));
        let esc = &world.segment().devices()[*position].esc;
        assert_eq!(i64::from(esc.register(register::SYSTEM_TIME_DELAY)), used.0);
    }
    assert_eq!(unknown, [2, 3]);
    let why = Why::NoReceiveTimes;
    let expected = Some(Delay::Indeterminate { why, between: None });
    assert_eq!((segment.devices[1].measured_delay, segment.devices[1].delay), (expected, None));
}

#[test]
fn the_report_says_which_delay_is_not_known_and_why() {
    let scenario = scenario(FORK);
    let mut run = scenario.run();
    run.setup.segment[1].device.chip = JUNCTION;
    let outcome = run.execute(None::<NoTap>, &mut |_| {});
    let report = isocat::Report::new(&scenario, &outcome);
    let unknown = |device: &isocat::report::Device| device.registers.delay_unknown.clone();
    let why: Vec<_> = report.devices.iter().map(unknown).collect();
    assert!(why[0].is_none() && why[1].is_none(), "{why:?}");
    for why in &why[2..] {
        let why = why.as_ref().expect("it is behind the junction");
        assert!(why.starts_with("SubDevice 1, which branches above it,"), "{why}");
        assert!(why.contains(" ns are possible"), "{why}");
    }
    assert_eq!(report.devices[2].registers.delay_error_ns, None);
    let text = report.text();
    assert!(text.contains("SubDevice 3: its delay can't be known, "), "{text}");
}

/// In a line with a swapped cable SubDevices behind port 0 are processed before the one that they
/// hang on.
#[test]
fn a_swapped_cable_in_the_middle() {
    // What hops jitter counts but once where cables are swapped: without it.
    const TEXT: &str = r#"
        cycle = "1ms"
        hop_jitter = false
        [[subdevice]]
        name = "first"
        device = "simple_io16"
        [[subdevice]]
        name = "swapped"
        device = "simple_io16"
        port = 1
        [[subdevice]]
        name = "last"
        device = "simple_io16"
        connect = "swapped:0"
    "#;
    let mut setup = match SegmentFile::parse("swapped.toml", TEXT) {
        Ok(file) => Scenario::from(file).run().setup,
        Err(error) => panic!("{error}"),
    };
    setup.config.devices.clear();
    let (world, _) = operating(setup);
    let found = &world.main().segment().devices;
    let parents: Vec<_> =
        found.iter().map(|d| d.parent.map(|(parent, port)| (parent, port.index()))).collect();
    assert_eq!(parents, [None, Some((2, 0)), Some((0, 1))]);
    for (device, truth) in found.iter().zip(true_delays(&world)) {
        let delay = device.measured_delay.expect("measured");
        let error = Picos::from(delay.nanos().expect("known")).0 - truth;
        assert!(error.abs() <= delay.bar().unwrap().0 + 2_000, "{}: {error} ps", device.name);
    }
}

/// Measuring on disturbs nothing and finds nothing as long as nothing changes.
#[test]
fn watching_a_segment_that_stays_as_it_is() {
    let mut setup = scenario(FORK).run().setup;
    let every = Nanos::millis(5);
    setup.config.delay_watch = Some(DelayWatch { every, latches: 4, rewrite: true });
    let (mut world, _) = operating(setup);
    let before = world.main().statistics();
    let delays: Vec<_> = world.main().segment().devices.iter().map(|device| device.delay).collect();
    let events = run_for(&mut world, Nanos::millis(500));
    let changed =
        |event: &&Event| matches!(event, Event::DelayChanged { .. } | Event::DelayRestored { .. });
    assert_eq!(events.iter().find(changed), None);
    let after = world.main().statistics();
    let latches = after.delay_latches - before.delay_latches;
    // Each takes a cycle or two more than the pause.
    assert!((60..=100).contains(&latches), "{latches} latches");
    assert_eq!(after.delay_latches_lost, 0);
    assert_eq!(after.working_counter_errors, before.working_counter_errors);
    let now: Vec<_> = world.main().segment().devices.iter().map(|device| device.delay).collect();
    assert_eq!(now, delays);
    for device in world.segment().devices() {
        assert_eq!(device.esc.register(register::SPEED_COUNTER_START), 0x1000, "never written");
    }
}

/// A cable pulled: latches that not all SubDevices take are counted, and measured with nothing.
#[test]
fn a_latch_that_not_all_take_is_none() {
    let mut setup = scenario(FORK).run().setup;
    let every = Nanos::millis(5);
    setup.config.delay_watch = Some(DelayWatch { every, latches: 4, rewrite: true });
    // With it, no device latches while one is lost.
    setup.config.readmission = None;
    let (mut world, _) = operating(setup);
    let before = world.main().statistics();
    let pulled = world.now() + Picos(300_000_000);
    world.segment_mut().unplug(3, pulled);
    let events = run_for(&mut world, Nanos::millis(200));
    let changed = |event: &Event| matches!(event, Event::DelayChanged { .. });
    assert!(!events.iter().any(changed));
    let after = world.main().statistics();
    assert!(after.delay_latches_lost - before.delay_latches_lost >= 20, "{after:?}");
    assert!(after.delay_latches - before.delay_latches <= 1);
}

/// A cable of 90 m is replaced by one of 10 m: it is told, and with the setting the delay is put
/// right.
#[test]
fn a_delay_that_changed_is_told_and_put_right_if_wished() {
    for rewrite in [false, true] {
        let mut setup = scenario(FORK).run().setup;
        let every = Nanos::millis(5);
        setup.config.delay_watch = Some(DelayWatch { every, latches: 16, rewrite });
        let (mut world, _) = operating(setup);
        let written = world.main().segment().devices[3].delay.expect("measured");
        world.segment_mut().replace_cable(3, isocat_sim::Cable::of_length(10_000));
        let events = run_for(&mut world, Nanos::millis(300));
        let changes: Vec<_> = events
            .iter()
            .filter(|event| {
                matches!(event, Event::DelayChanged { .. } | Event::DelayRestored { .. })
            })
            .collect();
        let [Event::DelayChanged { position: 3, written: old, found, rewritten }] = changes[..]
        else {
            panic!("{changes:?}")
        };
        assert_eq!((*old, *rewritten), (written, rewrite));
        let found = found.nanos().expect("known");
        // 80 m less, at 5 ns/m.
        assert!((written - found - Nanos(400)).0.abs() <= 15, "{written} to {found}");
        let expected = if rewrite { found } else { written };
        assert_eq!(world.main().segment().devices[3].delay, Some(expected));
        let esc = &world.segment().devices()[3].esc;
        assert_eq!(i64::from(esc.register(register::SYSTEM_TIME_DELAY)), expected.0);
    }
}

/// What is written to 0x0928 is right over copper, over EBUS, and where a coupler joins both: from
/// the captures, by hand.
#[test]
fn copper_and_ebus_have_their_own_hops() {
    let line = |devices: &[(&str, &str)]| {
        let table = |(device, lines): &(&str, &str)| {
            format!("[[subdevice]]\ndevice = \"{device}\"\n{lines}\n")
        };
        let text = format!(
            "cycle = \"1ms\"\nfor = \"50ms\"\n{}",
            devices.iter().map(table).collect::<String>()
        );
        let report = isocat::run(&scenario(&text));
        assert!(report.in_sync, "{}", report.verdict);
        let written = |device: &isocat::report::Device| device.registers.delay_ns.expect("a clock");
        report.devices.iter().map(written).collect::<Vec<_>>()
    };
    let near = |found: Vec<i64>, expected: &[i64]| {
        let right =
            found.iter().zip(expected).all(|(found, expected)| (found - expected).abs() <= 6);
        assert!(right && found.len() == expected.len(), "{found:?} for {expected:?}");
    };
    // Two LAN9252 with a cable of 1 m were captured with 720 ns.
    let drive = "hpmicro_ecat_cia402_ssc";
    near(line(&[(drive, ""), (drive, "cable = \"1m\"")]), &[0, 720]);
    // A coupler and its terminals were captured with 0, 145 and 300 ns, in ticks of 10 ns: a hop of
    // 155 less a tick.
    let terminal = "beckhoff_el3632";
    let rail = [("beckhoff_ek1100", "name = \"coupler\""), (terminal, ""), (terminal, "")];
    near(line(&rail), &[0, 155, 310]);
    // The coupler's captured loop is 600 ns, then 135 ns past its processing unit, two PHYs and 1 m
    // to a drive.
    let behind = (drive, "connect = \"coupler:2\"\ncable = \"1m\"");
    near(line(&[&rail[..], &[behind]].concat()), &[0, 155, 310, 600 + 135 + 565]);
    // Or on from the last terminal by an extension.
    let on = [("beckhoff_ek1110", ""), (drive, "cable = \"1m\"")];
    near(line(&[&rail[..], &on].concat()), &[0, 155, 310, 465, 465 + 155 + 565]);
}
