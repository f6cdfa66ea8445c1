//! SYNC signals that fall when the device's program acknowledges them, or by themselves: in segment
//! files, by the plan and in true time.
//!
//! Device 0 has the reference clock: its pulses come on its own ticks, so that edges can be met to
//! the tick.

use std::cell::RefCell;
use std::rc::Rc;

use isocat::plan::{Plan, proof};
use isocat::{Nanos, Report, Scenario, SegmentFile};
use isocat_sim::observation::{Observation, Observed};
use isocat_sim::{HostModel, Judged, Kind, Segment, Tap};
use isocat_subdevice::Event;
use isocat_sync::budget::Check;
use isocat_wire::time::{Time, True};
use isocat_wire::{AlState, register};

/// One device without jitter anywhere, all clocks ideal, and nothing planned for clocks.
fn ideal(cycle: &str, keys: &str) -> Scenario {
    let mut scenario = real(cycle, &format!("clock = \"0ppm\"\n{keys}"));
    scenario.host = HostModel { clock_ppb: 0, jitter: Nanos::ZERO, ..HostModel::default() };
    scenario.clock_error = Some(Nanos::ZERO);
    scenario.hop_jitter = false;
    scenario
}

fn real(cycle: &str, keys: &str) -> Scenario {
    let text = format!(
        "cycle = \"{cycle}\"\nfor = \"100ms\"\n[[subdevice]]\ndevice = \"model_every_mode\"\n{keys}"
    );
    Scenario::from(
        SegmentFile::parse("acknowledge", &text).unwrap_or_else(|error| panic!("{error}")),
    )
}

/// What is seen of one device's SYNC in OP.
#[derive(Default)]
struct Seen {
    in_op: bool,
    /// SYNC0 edges.
    edges: Vec<Time<True>>,
    /// Acknowledgements of SYNC0.
    acknowledged: Vec<Time<True>>,
    /// SYNC0 pulses without an edge.
    lost: Vec<Time<True>>,
    /// The same of SYNC1.
    sync1: [usize; 3],
}

#[derive(Clone, Default)]
struct Onlooker(Rc<RefCell<Seen>>);

impl Tap for Onlooker {
    fn frame(&mut self, _: Time<True>, _: bool, _: &[u8]) {}

    fn observed(&mut self, _: &Segment, at: Time<True>, observation: &Observation) {
        let mut seen = self.0.borrow_mut();
        if observation.device > 0 {
            return;
        }
        if let Observed::State(AlState::Op, _) = observation.event {
            seen.in_op = true;
        }
        if !seen.in_op {
            return;
        }
        match observation.event {
            Observed::Sync0 => seen.edges.push(at),
            Observed::Acknowledged(Event::Sync0) => seen.acknowledged.push(at),
            Observed::StillActive(Event::Sync0) => seen.lost.push(at),
            Observed::Sync1 => seen.sync1[0] += 1,
            Observed::Acknowledged(Event::Sync1) => seen.sync1[1] += 1,
            Observed::StillActive(Event::Sync1) => seen.sync1[2] += 1,
            _ => {}
        }
    }
}

/// Runs it, whatever the plan says.
fn run(scenario: &Scenario) -> (Seen, Report) {
    let scenario = Scenario { force: true, ..scenario.clone() };
    let onlooker = Onlooker::default();
    let outcome = scenario.run().execute(Some(onlooker.clone()), &mut |_| {});
    let report = Report::new(&scenario, &outcome);
    drop(outcome);
    (onlooker.0.take(), report)
}

fn slack(scenario: &Scenario) -> Option<i64> {
    let plan = Plan::of(scenario).expect("a plan");
    let demand = plan.timing().demand(0, Check::Sync0FallsInCycle)?;
    Some(demand.slack().0)
}

fn still_active(report: &Report) -> Option<(u64, u64, bool)> {
    report.findings.iter().find_map(|finding| match finding.kind {
        Kind::Judged(Judged::SyncStillActive { sync0, sync1, acknowledged }) => {
            Some((sync0, sync1, acknowledged))
        }
        _ => None,
    })
}

const MODES: [&str; 4] = [
    "mode = \"dc-sync0\"\n",
    "mode = \"dc-shift-sync1\"\nsync1 = \"100us\"\n",
    "mode = \"dc-sync1\"\nsync1 = \"50us\"\n",
    "mode = \"dc-subordinated\"\nsync0_cycle = \"500us\"\n",
];

/// The whole cycle is enough; 10 ns more, and every second pulse is lost.
#[test]
fn acknowledged_as_late_as_the_next_pulse_and_a_tick_later() {
    for mode in MODES {
        let cycle = if mode.contains("subordinated") { 500_000 } else { 1_000_000 };
        let with =
            |time: i64| ideal("1ms", &format!("{mode}pulse = \"0ns\"\nacknowledge = \"{time}ns\""));
        let exact = with(cycle);
        assert_eq!(slack(&exact), Some(0), "{mode}");
        let report = isocat::run(&exact);
        assert!(report.in_sync, "{mode}: {:?}", report.findings);
        let (seen, _) = run(&exact);
        assert_eq!(seen.lost, [], "{mode}");
        assert!(seen.edges.len() as i64 >= 98_000_000 / cycle, "{mode}: {}", seen.edges.len());
        for (edge, read) in seen.edges.iter().zip(&seen.acknowledged[1..]) {
            assert_eq!((*read - *edge).0, cycle * 1_000, "{mode}");
        }

        let late = with(cycle + 10);
        assert_eq!(slack(&late), Some(-10), "{mode}");
        let refused = isocat::run(&late);
        assert!(!refused.in_sync, "{mode}");
        let words: String = refused.findings.iter().map(|finding| finding.sentence()).collect();
        assert!(words.contains(Check::Sync0FallsInCycle.words()), "{mode}: {words}");

        let (seen, report) = run(&late);
        let (edges, lost) = (seen.edges.len(), seen.lost.len());
        assert!(lost > 20 && edges.abs_diff(lost) <= 2, "{mode}: {edges} edges, {lost} lost");
        let (sync0, _, acknowledged) = still_active(&report).expect("the judge sees it");
        assert!(sync0 > 20 && acknowledged, "{mode}: {sync0}");
        assert!(!report.in_sync, "{mode}");
    }
}

/// A program that takes longer than a cycle loses every second pulse. With more than two, SYNC0
/// comes each 3 ms, which to the supervision of a device is no SYNC0 any more: it refuses OP.
#[test]
fn the_later_the_more_are_lost() {
    for (time, of_edge) in [("999us", 0), ("1001us", 1), ("1999us", 1)] {
        let keys = format!("mode = \"dc-sync0\"\npulse = \"0ns\"\nacknowledge = \"{time}\"");
        let (seen, _) = run(&ideal("1ms", &keys));
        let (edges, lost) = (seen.edges.len(), seen.lost.len());
        let expected = of_edge * edges;
        assert!(edges > 20 && lost.abs_diff(expected) <= 1, "{time}: {edges}, {lost}");
    }
    let keys = "mode = \"dc-sync0\"\npulse = \"0ns\"\nacknowledge = \"2001us\"";
    let (seen, report) = run(&ideal("1ms", keys));
    assert!(!report.in_sync && !seen.in_op);
    assert_eq!(report.devices[0].registers.al_status_code, 0x001A, "{:?}", report.findings);
}

/// Jitter of the interrupt comes on top: by the plan at its worst, in truth with every value up to
/// it.
#[test]
fn jitter_makes_it_later() {
    let with = |time: i64| {
        let keys = format!(
            "mode = \"dc-sync0\"\npulse = \"0ns\"\nacknowledge = \"{time}ns\"\njitter = \"2us\""
        );
        let mut scenario = ideal("1ms", &keys);
        scenario.outputs_spread = Nanos::micros(10);
        scenario
    };
    let exact = with(998_000);
    assert_eq!(slack(&exact), Some(0));
    let (seen, report) = run(&exact);
    assert!(report.in_sync && seen.lost.is_empty(), "{:?}", report.findings);
    let spans =
        seen.edges.iter().zip(&seen.acknowledged[1..]).map(|(edge, read)| (*read - *edge).0);
    let (least, most) = spans.fold((i64::MAX, 0), |(l, m), span| (l.min(span), m.max(span)));
    assert!((998_000_000..998_200_000).contains(&least), "{least} ps");
    assert!((999_800_000..=1_000_000_000).contains(&most), "{most} ps");

    // A late one is lost where an edge and its acknowledgement are more than a cycle apart.
    let late = with(999_000);
    assert_eq!(slack(&late), Some(-1_000));
    let (seen, _) = run(&late);
    let (edges, lost) = (seen.edges.len(), seen.lost.len());
    // Half of the values are too late.
    assert!(lost > 20 && edges > lost + 10, "{edges} edges, {lost} lost");
}

/// SYNC1 is acknowledged by a register of its own.
#[test]
fn sync1_is_acknowledged_too() {
    let keys = |more: &str| {
        format!("mode = \"dc-shift-sync1\"\nsync1 = \"100us\"\npulse = \"0ns\"\n{more}")
    };
    let (seen, report) = run(&ideal("1ms", &keys("acknowledge = \"30us\"")));
    assert!(report.in_sync, "{:?}", report.findings);
    let [edges, acknowledged, lost] = seen.sync1;
    assert!(edges > 90 && edges.abs_diff(acknowledged) <= 1 && lost == 0, "{:?}", seen.sync1);
    let (seen, report) = run(&ideal("1ms", &keys("acknowledge = \"1000010ns\"")));
    let (_, sync1, _) = still_active(&report).expect("the judge sees it");
    // Each SYNC0 arms SYNC1, with an edge or without.
    assert!(seen.sync1[2] > 20 && sync1 > 20, "{:?}, {sync1}", seen.sync1);
}

/// A pulse that is as long as its cycle falls when the next is due; 10 ns more, and it never falls.
#[test]
fn a_pulse_as_long_as_its_cycle_and_a_tick_longer() {
    let with = |pulse: i64| ideal("500us", &format!("mode = \"dc-sync0\"\npulse = \"{pulse}ns\""));
    assert_eq!(slack(&with(249_990)), None, "nothing to speak of");
    assert_eq!(slack(&with(250_000)), Some(250_000));
    let exact = with(500_000);
    assert_eq!(slack(&exact), Some(0));
    assert!(isocat::run(&exact).in_sync);
    let longer = with(500_010);
    assert_eq!(slack(&longer), Some(-10));
    assert!(!isocat::run(&longer).in_sync);
    // The device never sees a second pulse: it does not come to OP.
    let (seen, report) = run(&longer);
    assert!(!report.in_sync && seen.edges.is_empty(), "{:?}", report.findings);
}

/// Clocks that differ, hops that jitter and a host that is late: what the plan allows holds, and
/// the proof finds its bound tight.
#[test]
fn with_real_clocks_the_plan_holds_and_is_not_far_off() {
    let keys = |time: i64| {
        let acknowledge =
            format!("mode = \"dc-sync0\"\npulse = \"0ns\"\nacknowledge = \"{time}ns\"\n");
        format!(
            "{acknowledge}clock = \"80ppm\"\n[[subdevice]]\ndevice = \"model_every_mode\"\n{acknowledge}clock = \"-80ppm\""
        )
    };
    let slack = slack(&real("1ms", &keys(900_000))).expect("the line");
    let full = real("1ms", &keys(900_000 + slack / 10 * 10 - 10));
    let plan = Plan::of(&full).expect("a plan");
    let proof = proof::prove(&plan, &full);
    assert!(proof.run.in_sync, "{:?}", proof.run.findings);
    for position in [0, 1] {
        let planned = plan.timing().demand(position, Check::Sync0FallsInCycle).unwrap().slack().0;
        let (seen, count) = proof.slack(Some(position), Check::Sync0FallsInCycle).unwrap();
        assert!(count > 80 && seen >= planned as f64, "{position}: {seen} ns, planned {planned}");
        assert!(seen < planned as f64 + 600.0, "{position}: {seen} ns, planned {planned}");
    }
}

/// The whole run, the plan and its page say it; the smallest cycle that is suggested leaves time to
/// acknowledge.
#[test]
fn the_plan_names_it_and_its_smallest_cycle_leaves_the_time() {
    let scenario = ideal("1ms", "mode = \"dc-sync0\"\npulse = \"0ns\"\nacknowledge = \"700us\"");
    let plan = Plan::of(&scenario).expect("a plan");
    let mut report = plan.report(&scenario);
    report.suggestion = Some(isocat::plan::suggest::suggest(&plan, &scenario));
    assert_eq!(report.devices[0].acknowledge_ns, Some(700_000));
    assert!(report.text().contains("acknowledged after 700 us"), "{}", report.text());
    let smallest = report.suggestion.and_then(|found| found.smallest_cycle_ns);
    assert_eq!(smallest, Some(700_000));
    let usual = ideal("1ms", "mode = \"dc-sync0\"");
    assert_eq!(Plan::of(&usual).unwrap().report(&usual).devices[0].acknowledge_ns, None);
}

/// The segment file of the documentation runs as it says.
#[test]
fn the_segment_file_of_the_documentation_holds() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/acknowledge.toml");
    let file = SegmentFile::read(path).unwrap_or_else(|error| panic!("{error}"));
    assert!(!file.expectations.is_empty());
    let report = isocat::run(&Scenario::from(file));
    assert!(report.as_expected() && report.in_sync, "{}", report.text());
}

#[test]
fn the_eeprom_says_what_the_register_shows() {
    for (pulse, ticks) in [("0ns", 0), ("10ns", 1), ("655350ns", 65_535)] {
        let scenario = ideal("1ms", &format!("mode = \"dc-sync0\"\npulse = \"{pulse}\""));
        let outcome = scenario.run().execute(None::<Onlooker>, &mut |_| {});
        let esc = &outcome.world.segment().devices()[0].esc;
        assert_eq!(esc.register(register::SYNC_PULSE_LENGTH), ticks);
        assert!(outcome.in_sync(), "{pulse}: {:?}", outcome.findings);
    }
}
