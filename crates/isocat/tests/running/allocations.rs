//! After start-up the cyclic path of both sides allocates nothing.

use std::cell::Cell;
use std::rc::Rc;

#[cfg(target_os = "linux")]
use isocat::host::{Exchange, RawSocket, Waiting};
use isocat::{NoTap, Scenario, SegmentFile};
use isocat_maindevice::{Event, Motion};
use isocat_sim::observation::Observation;
use isocat_sim::{Segment, Tap, World};
#[cfg(target_os = "linux")]
use isocat_wire::time::Nanos;
use isocat_wire::time::{Picos, Time, True};
use isocat_wire::{Command, datagram, frame};

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
    let counted = world.main().statistics().cycles - cycles;
    assert!((99..=101).contains(&counted), "{counted}");
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

/// Tells whether anything but the cycle's own frames was sent.
#[derive(Clone, Default)]
struct Acyclic(Rc<Cell<bool>>);

impl Tap for Acyclic {
    fn frame(&mut self, _: Time<True>, _: bool, bytes: &[u8]) {
        let payload = frame::payload(bytes).expect("our own frame");
        let is_acyclic = datagram::datagrams(payload).any(|datagram| {
            let header = datagram.expect("our own datagram").header;
            matches!(header.command(), Ok(Command::Fprd | Command::Fpwr))
        });
        self.0.set(self.0.get() | is_acyclic);
    }
    fn observed(&mut self, _: &Segment, _: Time<True>, _: &Observation) {}
}

/// Nor does it between two readings of objects; a reading of an object does allocate, and so does a
/// step in which one is under way. Registers of clocks are read without. Rings, moments and alarms
/// take no memory while the segment runs.
#[test]
fn watching_quality_allocates_only_when_it_reads() {
    let mut setup = Scenario::from(SegmentFile::built_in()).run().setup;
    let watch =
        isocat_maindevice::QualityWatch { share_permille: 1, history: 16, ..Default::default() };
    setup.config.quality = Some(watch);
    let acyclic = Acyclic::default();
    let mut world = World::new(setup, Motion::default(), Some(acyclic.clone()));
    let limit = Time::new(20_000_000_000_000);
    while !matches!(world.poll_event(), Some(Event::InOperation { .. })) {
        assert!(world.step(limit), "the segment does not come up");
    }
    run_for(&mut world, 400);
    let (mut quiet, mut reading, mut allocating) = (0, 0, 0);
    let mut before = true;
    for _ in 0..2_000 {
        acyclic.0.set(false);
        let allocations = allocation_counter::measure(|| run_for(&mut world, 1)).count_total;
        // Their answers come in the next millisecond at the latest.
        let reads = acyclic.0.get();
        if reads || before {
            reading += 1;
            allocating += u64::from(allocations > 0);
        } else {
            quiet += 1;
            assert_eq!(allocations, 0, "after {quiet} quiet milliseconds, {reading} with readings");
        }
        before = reads;
    }
    assert!(quiet > 1_600 && allocating > 10, "{quiet} quiet, {reading} reading, {allocating}");
    let snapshot = world.main().snapshot().expect("it is watched");
    assert_eq!((snapshot.moments().count(), snapshot.clocks[0].readings().count()), (16, 16));
}

/// Nor does the loop of a real interface: here over a packet socket, under supervision.
#[cfg(all(target_os = "linux", target_arch = "x86_64"))]
#[test]
fn a_hundred_cycles_on_an_interface_allocate_nothing() {
    use crate::supervised::{Line, again, writes_to};

    let scenario = Scenario::from(SegmentFile::built_in());
    let Some(path) = writes_to() else {
        let mut line = Line::new(Segment::new(scenario.run().setup.segment, scenario.seed));
        let test = "allocations::a_hundred_cycles_on_an_interface_allocate_nothing";
        let Some(counted) = again(test, &mut line) else { return };
        return assert_eq!(counted, "100 cycles, 0 allocations");
    };
    let socket = RawSocket::open("vt0", None).expect("the end of the segment");
    let waiting = Waiting::Sleep { lead: Nanos::ZERO };
    let mut exchange = Exchange::new(scenario.config(), socket, waiting, None, Motion::default());
    let limit = exchange.now() + Nanos::millis(20_000);
    while !matches!(exchange.poll_event(), Some(Event::InOperation { .. })) {
        assert!(exchange.step(limit).expect("it is up") && exchange.now() < limit);
    }
    exchange.measure(true);
    let cycles = |exchange: &mut Exchange<Motion>, count: u64| {
        let begin = exchange.main().statistics().cycles;
        while exchange.main().statistics().cycles < begin + count {
            assert!(exchange.step(limit).expect("it is up") && exchange.now() < limit);
            while exchange.poll_event().is_some() {}
        }
        exchange.main().statistics().cycles - begin
    };
    // Drives switch on, buffers find their size.
    cycles(&mut exchange, 50);
    let mut counted = 0;
    let allocations = allocation_counter::measure(|| counted = cycles(&mut exchange, 100));
    // The counter counts: one step outside the cyclic path allocates.
    let outside = allocation_counter::measure(|| {
        exchange.main_mut().upload(0, isocat_wire::ObjectAddress::new(0x1018, 1));
        cycles(&mut exchange, 5);
    });
    assert!(outside.count_total > 0);
    let counted = format!("{counted} cycles, {} allocations", allocations.count_total);
    std::fs::write(path, counted).expect("the folder for temporary files is writable");
}

fn run_for<T: Tap>(world: &mut World<Motion, T>, milliseconds: i64) {
    let end = world.now() + Picos(milliseconds * 1_000_000_000);
    while world.step(end) {
        while world.poll_event().is_some() {}
    }
}
