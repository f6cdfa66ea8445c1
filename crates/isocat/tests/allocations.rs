//! After start-up the cyclic path of both sides allocates nothing.

use isocat::{NoTap, Scenario, SegmentFile};
use isocat_maindevice::Event;
use isocat_sim::{Motion, World};
use isocat_wire::time::{Picos, Time};

#[test]
fn a_hundred_cycles_allocate_nothing() {
    let scenario = Scenario::from(SegmentFile::built_in());
    let mut world = World::new(scenario.run().setup, Motion::default(), None::<NoTap>);
    let limit = Time::new(20_000_000_000_000);
    while !matches!(world.poll_event(), Some(Event::InOperation { .. })) {
        assert!(world.step(limit), "the segment does not come up");
    }
    // A few cycles to fill every buffer once: drives switch on, frames find their spares.
    run_for(&mut world, 50);
    let cycles = world.main().statistics().cycles;
    let allocations = allocation_counter::measure(|| run_for(&mut world, 100));
    assert_eq!(world.main().statistics().cycles - cycles, 100);
    assert_eq!(allocations.count_total, 0, "{allocations:?}");

    // The counter counts: one step outside the cyclic path allocates.
    let counted = allocation_counter::measure(|| {
        world.main_mut().upload(0, isocat_wire::ObjectAddress::new(0x1018, 1));
        run_for(&mut world, 5);
    });
    assert!(counted.count_total > 0);
}

/// Nor does it between two latches of delays that are watched.
#[test]
fn watching_delays_allocates_only_when_it_latches() {
    let mut setup = Scenario::from(SegmentFile::built_in()).run().setup;
    setup.config.delay_watch = Some(isocat_maindevice::DelayWatch::default());
    let mut world = World::new(setup, Motion::default(), None::<NoTap>);
    let limit = Time::new(20_000_000_000_000);
    while !matches!(world.poll_event(), Some(Event::InOperation { .. })) {
        assert!(world.step(limit), "the segment does not come up");
    }
    run_for(&mut world, 50);
    let latches = world.main().statistics().delay_latches;
    let between = allocation_counter::measure(|| run_for(&mut world, 900));
    assert_eq!(between.count_total, 0, "{between:?}");
    let latching = allocation_counter::measure(|| run_for(&mut world, 100));
    assert_eq!(world.main().statistics().delay_latches - latches, 1);
    assert!(latching.count_total > 0);
}

fn run_for(world: &mut World<Motion, NoTap>, milliseconds: i64) {
    let end = world.now() + Picos(milliseconds * 1_000_000_000);
    while world.step(end) {
        while world.poll_event().is_some() {}
    }
}
