//! What the live view shows agrees with itself and with the report of a run: nothing between two
//! statuses is missed, and filling one allocates nothing.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use isocat::status::{Board, Kind, Scribe, Status};
use isocat::watch::Source;
use isocat::watch::source::Speed;
use isocat::{NoTap, Scenario, SegmentFile};
use isocat_maindevice::{Event, Motion};
use isocat_sim::World;
use isocat_wire::time::{Picos, Time};

fn scenario() -> Scenario {
    let mut scenario = Scenario::from(SegmentFile::built_in());
    scenario.operation.quality.get_or_insert_default();
    scenario
}

/// Statuses up to a time of the segment.
fn statuses(scenario: Scenario, until_ns: i64, look_at: Option<usize>) -> Vec<Status> {
    let source = Source::simulated(scenario, Speed::Max, Arc::new(AtomicBool::new(false)));
    source.look_at(look_at);
    let mut all = Vec::new();
    loop {
        // Asked before the last status is taken: a source that is over sends none behind it.
        let is_over = source.is_over();
        match source.take() {
            Some(status) => all.push(status),
            None => {
                assert!(!is_over, "the source ended without a word behind {:?}", all.last());
                std::thread::sleep(Duration::from_millis(1));
            }
        }
        let last: Option<&Status> = all.last();
        if last.is_some_and(|status| status.at_ns >= until_ns || status.has_ended()) {
            source.end();
            return all;
        }
    }
}

/// The largest of late, taken together, is the largest in operation: no edge falls between two
/// statuses. The judges of a run of that length find the same.
#[test]
fn no_edge_is_missed() {
    let all = statuses(scenario(), 4_000_000_000, None);
    for pair in all.windows(2) {
        assert_eq!(pair[1].since_ns, pair[0].at_ns.max(pair[1].since_ns), "a hole");
        assert_eq!(pair[1].at_ns - pair[0].at_ns, 100_000_000);
    }
    let last = all.last().expect("some");
    assert!(last.in_operation() && last.verdict().good, "{:?}", last.verdict());
    for device in last.devices.iter().filter(|device| device.has_sync) {
        let errors = all.iter().filter_map(|status| status.devices[device.position].error);
        let recent = errors.clone().filter_map(|error| error.recent_ns).fold(0.0, f64::max);
        let error = device.error.expect("it has SYNC");
        assert_eq!(recent, error.worst_ns, "{}", device.name);
        assert!(error.worst_ns > 0.0 && error.count > 3_000, "{error:?}");
        assert!(errors.clone().all(|error| error.now_ns.abs() <= error.worst_ns));
        let margins = all.iter().filter_map(|status| status.devices[device.position].margin);
        let least = margins.map(|margin| margin.now_ns).fold(f64::INFINITY, f64::min);
        let margin = device.margin.expect("it has SYNC");
        assert!(least >= margin.least_ns && margin.least_ns > 400_000.0, "{least} {margin:?}");
    }
    let mut same = scenario();
    same.duration = isocat::Nanos(last.operation_ns.expect("in operation"));
    let report = isocat::run(&same);
    for (device, reported) in last.devices.iter().zip(&report.devices) {
        let reported = reported.true_time.sync0_error.as_ref();
        let figures = device.error.map(|error| (error.worst_ns, error.count));
        assert_eq!(figures, reported.map(|error| (error.worst_ns, error.count)), "{}", device.name);
    }
    // The run reads its counters once more when it is over.
    let frames = report.segment.main_device.frames_sent - last.host.frames_sent;
    assert!(frames < 100, "{frames} frames more");
}

/// What is seen of a cycle lies within what was planned for it.
#[test]
fn a_cycle_that_is_looked_at_is_seen_where_it_was_planned() {
    let all = statuses(scenario(), 3_000_000_000, Some(1));
    let last = all.last().expect("some");
    assert!(last.devices[0].moments.iter().all(|moment| moment.seen_ns.is_none()), "not looked at");
    let moments = &last.devices[1].moments;
    let seen: Vec<_> =
        moments.iter().filter_map(|moment| Some((moment, moment.seen_ns?))).collect();
    assert!(seen.len() >= 5, "{moments:?}");
    for (moment, (from, to)) in seen {
        let planned = moment.earliest_ns as f64..=moment.latest_ns as f64;
        assert!(planned.contains(&from) && planned.contains(&to), "{moment:?}");
    }
}

/// What is told on the way up comes as it happens, and a way up that fails says why.
#[test]
fn the_way_up_is_told() {
    let all = statuses(scenario(), 2_000_000_000, None);
    let told: Vec<&str> =
        all.iter().flat_map(|status| &status.events).map(|event| &*event.what).collect();
    for what in ["stage scan", "PREOP", "stage SYNC", "SAFEOP", "OP", "all in OP: in operation"] {
        assert!(told.contains(&what), "{what} is not among {told:?}");
    }
    let short = "cycle = \"125us\"\n[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\n";
    let file = SegmentFile::parse("short.toml", short).expect("a segment");
    let all = statuses(Scenario::from(file), 60_000_000_000, None);
    let last = all.last().expect("some");
    assert!(last.has_ended() && !last.verdict().good);
    assert!(last.failure.as_ref().is_some_and(|why| why.contains("0x1C32:05")), "{last:?}");
}

/// The loop of a real wire fills the board in its cycles: that takes no memory, whether somebody
/// looks or not.
#[test]
fn filling_the_board_allocates_nothing() {
    let setup = Scenario::from(SegmentFile::built_in()).run().setup;
    let board = Board::new(Status::new("x".into(), Kind::Wire, 1_000_000, 1_000));
    let mut scribe = Scribe::new(board.clone(), &setup.config);
    let mut world = World::new(setup, Motion::default(), None::<NoTap>);
    let at = |world: &World<Motion, NoTap>| world.now().as_nanos() as i64;
    let limit = Time::new(20_000_000_000_000);
    'up: loop {
        assert!(world.step(limit), "the segment does not come up");
        while let Some(event) = world.poll_event() {
            scribe.event(at(&world), &event);
            if matches!(event, Event::InOperation { .. }) {
                break 'up;
            }
        }
    }
    let mut run = |looks: bool| {
        let end = world.now() + Picos(50_000_000_000);
        while world.step(end) {
            while let Some(event) = world.poll_event() {
                scribe.event(at(&world), &event);
            }
            scribe.cycle(world.main());
            assert!(scribe.publish(at(&world), world.main(), |_, _| {}));
        }
        looks.then(|| board.take())
    };
    // Buffers find their size.
    run(true);
    run(true);
    let before = run(true).flatten().expect("filled").host.cycles;
    let unseen = allocation_counter::measure(|| drop(run(false)));
    assert_eq!(unseen.count_total, 0, "{unseen:?}");
    // The counter works: every reader takes a copy.
    let looked = allocation_counter::measure(|| drop(run(true)));
    assert!(looked.count_total > 0);
    let after = run(true).flatten().expect("filled").host.cycles;
    assert!(after >= before + 140, "{before} {after}");
}
