//! Which clock leads: the reference clock's own quartz, or the host's clock by way of writes to
//! 0x0910.

use isocat::{Nanos, Scenario, SegmentFile};
use isocat_maindevice::{Application, Cycle, Event};
use isocat_sim::host::Delay;
use isocat_sim::{Setup, Tap, World};
use isocat_sync::phase::drive::{Injected, Limits};
use isocat_sync::phase::external::{Source, Stamps};
use isocat_sync::phase::{Direction, State};
use isocat_wire::time::{Picos, Time, True};

/// Faster than the default, so that runs are short; the drift loops of the segment lag behind by
/// 0.2 us meanwhile.
const LIMITS: Limits = Limits { slew_ppb: 10_000, acceleration_ppb: 2_000, most: Nanos(1_000) };

/// The built-in segment, its host 20 ppm fast against true time.
fn setup(direction: Direction, hold_ups: Option<Delay>) -> Setup {
    let mut scenario = Scenario::from(SegmentFile::built_in());
    scenario.host.clock_ppb = HOST_PPB;
    scenario.host.hold_ups = hold_ups;
    let mut setup = scenario.run().setup;
    setup.config.direction = direction;
    setup.config.stamp_noise = hold_ups.map_or(Nanos::ZERO, |delay| delay.mean);
    setup
}

const HOST_PPB: i64 = 20_000;

struct NoTap;

impl Tap for NoTap {
    fn frame(&mut self, _: Time<True>, _: bool, _: &[u8]) {}
}

type Run<A> = World<A, NoTap>;

fn operating<A: Application>(setup: Setup, application: A) -> Run<A> {
    let mut world = World::new(setup, application, None);
    loop {
        assert!(world.step(Time::new(60_000_000_000_000)), "not in operation after a minute");
        while let Some(event) = world.poll_event() {
            match event {
                Event::InOperation { .. } => return world,
                Event::Failed(error) => panic!("{error}"),
                _ => {}
            }
        }
    }
}

fn run_for<A: Application>(world: &mut Run<A>, ms: i64) {
    let end = world.now() + Picos::from(Nanos::millis(ms));
    while world.step(end) {
        while world.poll_event().is_some() {}
    }
}

/// System time of the reference every 10 ms, less what the host's clock counted: ns.
fn differences<A: Application>(world: &mut Run<A>, count: usize) -> Vec<f64> {
    let reading = |world: &mut Run<A>| {
        run_for(world, 10);
        let now = world.now();
        let system = world.segment().devices()[0].system_time_ps(now);
        let host = i128::from(now.count()) * i128::from(1_000_000_000 + HOST_PPB) / 1_000_000_000;
        (system - host) as f64 / 1_000.0
    };
    let first = reading(world);
    (0..count).map(|_| reading(world) - first).collect()
}

/// ppb, from readings every 10 ms.
fn rate(differences: &[f64]) -> f64 {
    (differences[differences.len() - 1] - differences[0]) / (0.01 * (differences.len() - 1) as f64)
}

/// Standard deviation of the second differences: how unsteady the clock runs, ns.
fn unsteadiness(differences: &[f64]) -> f64 {
    let bends: Vec<f64> =
        differences.windows(3).map(|three| three[0] - 2.0 * three[1] + three[2]).collect();
    (bends.iter().map(|bend| bend * bend).sum::<f64>() / bends.len() as f64).sqrt()
}

fn injected<A: Application>(world: &Run<A>) -> Injected {
    world.main().drive().expect("the reference is led").injected()
}

#[test]
fn the_reference_leads_unless_told_otherwise() {
    let mut world = operating(setup(Direction::default(), None), ());
    assert!(world.main().drive().is_none());
    let rate = rate(&differences(&mut world, 100));
    // The reference's own quartz, whatever it is, and not the host's.
    assert!((rate - world.main().rate_ppb().unwrap() as f64).abs() < 100.0, "{rate}");
    assert!(rate.abs() > 5_000.0, "{rate}");
}

#[test]
fn the_host_leads_the_reference_and_all_that_follow_it() {
    let direction = Direction::DriveReference { limits: LIMITS };
    let mut world = operating(setup(direction, None), ());
    run_for(&mut world, 45_000);
    let differences = differences(&mut world, 500);
    assert!(rate(&differences).abs() < 20.0, "{} ppb", rate(&differences));
    assert!(unsteadiness(&differences) < 20.0, "{} ns", unsteadiness(&differences));
    assert_eq!(world.main().phase(), Some(State::Locked));
    assert_eq!(world.main().statistics().working_counter_errors, 0);
    println!("leads: {:.1} ns, {:?}", unsteadiness(&differences), injected(&world));
    // Stamps are exact here: what is put into the clock is what its drift loop has to be told.
    let injected = injected(&world);
    assert!(injected.count > 20_000, "{injected:?}");
    assert!(injected.deviation_ns < 200.0 && injected.peak_ns < 1_100, "{injected:?}");
    // The others have followed.
    let now = world.now();
    world.catch_up();
    let at = |position: usize| world.segment().devices()[position].system_time_ps(now);
    for position in [1, 3] {
        let off = (at(position) - at(0)) as f64 / 1_000.0;
        assert!(off.abs() < 100.0, "{position}: {off} ns");
    }
}

/// Frames that are held up behind their stamps: nothing of it is in the clocks if the reference
/// leads, and what the figures of injection say if the host does.
#[test]
fn what_the_host_is_late_by_goes_into_the_clocks_only_if_it_leads() {
    let hold_ups = Delay { mean: Nanos(2_000), one_of: 0, more: (Nanos::ZERO, Nanos::ZERO) };
    let mut follows = operating(setup(Direction::FollowReference, Some(hold_ups)), ());
    run_for(&mut follows, 5_000);
    let quiet = unsteadiness(&differences(&mut follows, 500));
    assert!(quiet < 20.0, "{quiet} ns");
    let direction = Direction::DriveReference { limits: LIMITS };
    let mut leads = operating(setup(direction, Some(hold_ups)), ());
    run_for(&mut leads, 35_000);
    let differences = differences(&mut leads, 500);
    let restless = unsteadiness(&differences);
    // The clocks' own loops take most of it away.
    assert!(restless > 3.0 && restless < 2_000.0, "{restless} ns");
    let injected = injected(&leads);
    // An exponential time: its deviation is its mean.
    assert!((1_700.0..2_500.0).contains(&injected.deviation_ns), "{injected:?}");
    assert!(injected.peak_ns > 10_000, "{injected:?}");
    println!("follows: {quiet:.1} ns; leads: {restless:.1} ns, {injected:?}");
}

/// Every 10 ms the application reads a hardware clock that runs 45 ppm faster than true time.
struct Hardware;

impl Application for Hardware {
    fn cycle(&mut self, cycle: &mut Cycle<'_>) {
        let Some(host) = cycle.next().filter(|_| cycle.number().is_multiple_of(10)) else { return };
        // 25 ppm faster than the host's clock.
        let external = host.count() + host.count() / 1_000_000 * 25 + 1_000_000_000;
        let (before, after) = (host + Nanos(-500), host + Nanos(500));
        cycle.external_stamps(Stamps::Hardware { before, external: Time::new(external), after });
    }
}

#[test]
fn an_external_time_leads_the_reference() {
    let direction = Direction::External { limits: LIMITS, source: Source::default() };
    let mut world = operating(setup(direction, None), Hardware);
    run_for(&mut world, 60_000);
    let rate = rate(&differences(&mut world, 500));
    assert!((rate - 25_000.0).abs() < 50.0, "{rate} ppb");
    assert!(world.main().drive().is_some_and(|drive| drive.offset().is_some()));
}

/// Settings that can't lead are refused before a frame is sent.
#[test]
fn limits_of_zero_are_refused() {
    for limits in [
        Limits { slew_ppb: 0, ..LIMITS },
        Limits { acceleration_ppb: 0, ..LIMITS },
        Limits { most: Nanos::ZERO, ..LIMITS },
    ] {
        let setup = setup(Direction::DriveReference { limits }, None);
        let mut world: Run<()> = World::new(setup, (), None);
        while world.step(Time::new(1_000_000_000_000)) {}
        let failed = std::iter::from_fn(|| world.poll_event())
            .any(|event| matches!(event, Event::Failed(error) if error.to_string().contains("direction")));
        assert!(failed, "{limits:?}");
        assert_eq!(world.main().statistics().frames_sent, 0);
    }
}

/// Clocks 200 ppm apart, at the longest cycle in which the host may lead; one step longer is
/// refused.
#[test]
fn the_host_leads_up_to_a_cycle_of_2_ms() {
    let text = |cycle: &str| {
        let device = "[[subdevice]]\ndevice = \"kollmorgen_akd2g\"";
        format!(
            "cycle = \"{cycle}\"\nfor = \"60s\"\ndirection = \"drive-reference\"\n{device}\nclock = \"-100ppm\"\n\
             {device}\nclock = \"100ppm\"\n"
        )
    };
    let run = |cycle: &str| {
        let file = SegmentFile::parse("led.toml", &text(cycle)).expect("it reads");
        isocat::run(&Scenario::from(file))
    };
    let longest = run("2ms");
    assert!(longest.in_sync, "{}", longest.verdict);
    let error = longest.devices[1].true_time.sync0_error.as_ref().expect("it has SYNC0");
    assert!((50.0..300.0).contains(&error.worst_ns), "{error:?}");
    let longer = run("2001us");
    assert!(longer.verdict.contains("2 ms at most"), "{}", longer.verdict);
}
