//! 0x092C is read once more when a run ends. If it was followed all the time, one such reading
//! beyond the limit is a doubt and no finding: the frame may have taken another path. If it was not
//! followed, that reading is the only one.

use isocat_engine::NoTap;
use isocat_engine::verdict::{self, Engine, Gap, Readings, Verdict};
use isocat_maindevice::{Event, Motion};
use isocat_segment::{Scenario, SegmentFile};
use isocat_sim::{Judged, Kind, World};
use isocat_wire::time::{Nanos, Picos, Time};

const LIMIT: Nanos = Nanos::micros(1);

/// The verdict on two drives, the second of which shows this difference at the end.
fn verdict(is_followed: bool, difference: Nanos) -> Verdict {
    let text = "cycle = \"1ms\"\n[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\ncount = 2\n";
    let scenario = Scenario::from(SegmentFile::parse("two.toml", text).expect("it reads"));
    let mut setup = scenario.run().setup;
    if is_followed {
        setup.config = verdict::with_reads(setup.config);
    }
    let mut world = World::new(setup, Motion::default(), None::<NoTap>);
    let limit = Time::new(30_000_000_000_000);
    while !matches!(world.poll_event(), Some(Event::InOperation { .. })) {
        assert!(world.step(limit), "it comes up");
    }
    let began = world.now();
    let mut engine = Engine::begin(world.main(), LIMIT, Vec::new());
    let at = |world: &World<Motion, NoTap>| Nanos((world.now() - began).0 / 1_000);
    while world.step(began + Picos(500_000_000_000)) {
        while let Some(event) = world.poll_event() {
            engine.event(at(&world), &event);
        }
        engine.cycle(at(&world), world.main());
    }
    let second = Readings { difference: Some(difference), ..Readings::default() };
    let readings = [Readings::default(), second];
    engine.end(at(&world), world.main(), world.application().axes(), &readings)
}

fn clocks_off(verdict: &Verdict) -> Vec<Nanos> {
    let off = verdict.findings.iter().filter_map(|finding| match finding.kind {
        Kind::Judged(Judged::ClockOff { difference, .. }) => Some(difference),
        _ => None,
    });
    off.collect()
}

fn doubts(verdict: &Verdict) -> Vec<Nanos> {
    let near = verdict.unknown.iter().filter_map(|unknown| match unknown.kind {
        Gap::ClockNearLimit { bound, .. } => Some(bound),
        _ => None,
    });
    near.collect()
}

#[test]
fn one_reading_beyond_the_limit_is_a_doubt_where_the_clock_was_followed() {
    for (difference, doubt) in [
        (LIMIT, vec![]),
        (LIMIT + Nanos(1), vec![LIMIT + Nanos(1)]),
        (-(LIMIT + Nanos(1)), vec![LIMIT + Nanos(1)]),
    ] {
        let verdict = verdict(true, difference);
        assert_eq!(clocks_off(&verdict), [], "{difference}");
        assert_eq!(doubts(&verdict), doubt, "{difference}");
    }
}

#[test]
fn one_reading_beyond_the_limit_is_a_finding_where_there_is_no_other() {
    for (difference, found) in [(LIMIT, vec![]), (LIMIT + Nanos(1), vec![LIMIT + Nanos(1)])] {
        let verdict = verdict(false, difference);
        assert_eq!(clocks_off(&verdict), found, "{difference}");
        assert_eq!(doubts(&verdict), [], "{difference}");
    }
}
