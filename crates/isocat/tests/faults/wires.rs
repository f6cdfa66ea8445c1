//! Words for cables and power: pull, plug, break, flap, recable, power-off, power-on, power-cycle,
//! replace.

use isocat_sim::Lost;
use isocat_wire::AlState;

use crate::onlooker::{SEGMENT, ms, outcome, run, with};

/// A link is noticed to be gone 15 us behind the cut, and has come again 300 ms after plugging in.
#[test]
fn a_pulled_cable_is_pulled_for_its_time() {
    let (seen, report) = with(100, "pull axis for 200ms");
    assert_eq!(seen.instants(), [(ms(100), true), (ms(300), false)]);
    assert_eq!([0, 1, 2].map(|device| seen.outputs(device, 101, 599)), [498, 0, 0]);
    // The axis leaves OP by itself, without its frames.
    assert!(seen.moves(1).iter().any(|(_, state, _)| *state == AlState::SafeOp));
    assert_eq!(seen.moves(0), []);
    let named: Vec<_> = report.findings.iter().filter_map(|finding| finding.position).collect();
    assert_eq!(named[0], 1, "{named:?}");
}

#[test]
fn a_cable_is_pulled_until_it_is_plugged_in() {
    let text = format!(
        "{SEGMENT}[[fault]]\nat = \"in-operation + 100ms\"\nwhat = \"pull 2\"\n\
         [[fault]]\nat = \"in-operation + 300ms\"\nwhat = \"plug 2\"\n"
    );
    let (seen, _) = run(&text);
    assert_eq!(seen.outputs(2, 101, 599), 0);
    let last = seen.moves(2).last().copied();
    assert!(matches!(last, Some((601.., AlState::Op, 0))), "{last:?}");
}

/// Broken on the way out to the axis: it loses its link, the first device keeps its own and sends
/// all frames into nothing. On the way back it is the first device that loses its link: it closes
/// the port, and those behind are cut off.
#[test]
fn one_way_of_a_cable_breaks() {
    let (seen, _) = with(100, "break axis out for 200ms");
    let lost = |why| seen.lost.iter().filter(|(_, of)| *of == Some(why)).count();
    assert!(lost(Lost::Unplugged { cable: 1 }) > 150, "{:?}", seen.lost.first());
    assert_eq!([0, 1].map(|device| seen.outputs(device, 101, 299)), [198, 0]);

    let (seen, _) = with(100, "break axis back for 200ms");
    let during = seen.lost.iter().filter(|(at, _)| *at > seen.at(101) && *at < seen.at(299));
    assert_eq!(during.count(), 0, "the port is closed");
    assert_eq!([0, 1].map(|device| seen.outputs(device, 101, 299)), [198, 0]);
}

#[test]
fn a_link_flaps() {
    let (seen, _) = with(100, "flap last 10ms 340ms for 800ms");
    // Pulled at 100, 450 and 800 ms; each time there is a link again 300 ms after plugging in.
    let there = [(102, 408), (412, 449), (452, 758), (762, 799), (802, 1_000)];
    let outputs = there.map(|(from, to)| seen.outputs(2, from, to));
    assert_eq!((outputs[0], outputs[2], outputs[4]), (0, 0, 0), "{outputs:?}");
    assert_eq!(seen.outputs(1, 102, 1_000), 898);
}

#[test]
fn power_goes_and_comes() {
    let (seen, _) = with(100, "power-cycle last 200ms");
    let moves = seen.moves(2);
    assert_eq!((moves[0].0, moves[0].1), (100, AlState::Init), "{moves:?}");
    assert_eq!(seen.edges(2, 101, 300), 0);

    let text = format!(
        "{SEGMENT}[[fault]]\nat = \"in-operation + 100ms\"\nwhat = \"power-off last\"\n\
         [[fault]]\nat = \"in-operation + 200ms\"\nwhat = \"power-on last\"\n"
    );
    let (seen, report, outcome) = outcome(&text);
    assert_eq!(seen.instants(), [(ms(100), true), (ms(200), true)]);
    assert!(outcome.world.segment().devices()[2].is_powered());
    // It is brought up again from INIT.
    assert_eq!(seen.moves(2).last().map(|last| last.1), Some(AlState::Op), "{}", report.verdict);
}

/// 70 m more, there and back: 700 ns.
#[test]
fn a_cable_becomes_longer() {
    for (what, lost) in [("recable last 80m 0", false), ("recable last 80m 100ms", true)] {
        let (seen, _) = with(500, what);
        let round_trips = |from: usize, to: usize| {
            let (from, to) = (seen.at(from as u64), seen.at(to as u64));
            let is_in = |at: &&u64| (from..to).contains(*at);
            let pairs = seen.sent.iter().filter(is_in).map(|sent| {
                let back = seen.back.iter().find(|back| *back > sent);
                back.map_or(u64::MAX, |back| back - sent)
            });
            pairs.min().unwrap()
        };
        let (before, after) = (round_trips(300, 480), round_trips(1_700, 1_980));
        assert!((600..=800).contains(&(after - before)), "{what}: {before} and {after} ns");
        assert_eq!(seen.moves(2).is_empty(), !lost, "{what}");
    }
}

#[test]
fn another_device_comes_in_the_place_of_one() {
    let (seen, report) = with(100, "replace last simple_io16 100ms");
    assert_eq!(seen.edges(2, 101, 1_000), 0, "the one that comes has no SYNC0");
    // The MainDevice does not take it for the one that it knows.
    let refused =
        report.findings.iter().any(|f| f.position == Some(2) && f.kind.name() == "not-admitted");
    assert!(refused, "{:#?}", report.findings);

    // The same kind is taken, with counters of its own from 0.
    let (seen, report) = with(100, "replace last kollmorgen_akd2g 100ms");
    assert_eq!(
        seen.moves(2).last().map(|last| last.1),
        Some(AlState::Op),
        "{:#?}",
        report.findings
    );
}
