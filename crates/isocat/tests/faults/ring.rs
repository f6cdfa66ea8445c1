//! A ring in a segment file, and its cables: `pull`, `plug`, `break`, `flap` and `drop` on each of
//! them, the one that closes the ring by its name.

use isocat::plan::{Plan, proof};
use isocat::{Nanos, Report, Scenario, SegmentFile};
use isocat_wire::AlState;

use crate::onlooker::{SEGMENT, Seen, run};

/// The cables of the segment in the words of a fault, and the positions on both sides of each.
const CABLES: [(&str, &str); 4] = [
    ("first", "between the primary port and SubDevice 0"),
    ("axis", "between SubDevice 0 and SubDevice 1"),
    ("last", "between SubDevice 1 and SubDevice 2"),
    ("ring", "between SubDevice 2 and the secondary port"),
];

fn ring(faults: &[(u64, &str)]) -> (Seen, Report) {
    ring_of(SEGMENT, faults)
}

fn ring_of(segment: &str, faults: &[(u64, &str)]) -> (Seen, Report) {
    let tables = faults.iter().map(|(after, what)| {
        format!("[[fault]]\nat = \"in-operation + {after}ms\"\nwhat = \"{what}\"\n")
    });
    run(&format!("ring = true\n{segment}{}", tables.collect::<String>()))
}

fn told(report: &Report, kind: &str) -> Vec<String> {
    let of_kind = report.findings.iter().filter(|finding| finding.kind.name() == kind);
    of_kind.map(|finding| finding.sentence()).collect()
}

/// Cycles between two ms of operation in which each device got no outputs; none of them left OP.
fn lost_cycles(seen: &Seen, from: u64, to: u64) -> [usize; 3] {
    for device in 0..3 {
        assert_eq!(seen.moves(device), [], "{device}");
    }
    [0, 1, 2].map(|device| (to - from) as usize - seen.outputs(device, from, to))
}

#[test]
fn nothing_happens_in_a_whole_ring() {
    let (seen, report) = ring(&[]);
    assert!(report.in_sync, "{}", report.text());
    assert_eq!(lost_cycles(&seen, 0, 1_999), [0; 3]);
    assert_eq!(seen.lost, []);
    assert_eq!(report.segment.copies_lost, 0);
    let closed = report.segment.ring.expect("the report tells of it");
    assert_eq!((closed.position, closed.port, closed.cable_mm), (2, 1, 10_000));
}

#[test]
fn a_cable_that_is_pulled_costs_the_cycle_that_it_meets() {
    for (cable, between) in CABLES {
        let (seen, report) = ring(&[(100, &format!("pull {cable} for 200ms"))]);
        let lost = lost_cycles(&seen, 99, 1_999);
        assert!(lost.iter().all(|lost| *lost <= 1), "{cable}: {lost:?}");
        let cut = told(&report, "ring-cut");
        assert!(matches!(&cut[..], [cut] if cut.contains(between)), "{cable}: {cut:?}");
        assert_eq!(told(&report, "ring-healed").len(), 1, "{cable}");
        // The cut is told before what follows from it.
        assert_eq!(report.findings[0].kind.name(), "ring-cut", "{}", report.text());
    }
}

/// Frames are under way for some 15 us.
#[test]
fn a_cable_that_breaks_under_way_costs_no_more() {
    let (whole, _) = ring(&[]);
    let begin = whole.at(100);
    let leaves =
        whole.sent.iter().find(|at| **at > begin + 10_000).expect("a frame a cycle") - begin;
    let mut lost_in_all = 0;
    for (cable, _) in CABLES {
        for micros in (leaves / 1_000 - 10..leaves / 1_000 + 20).step_by(3) {
            let (seen, _) = run(&format!(
                "ring = true\n{SEGMENT}[[fault]]\nat = \"in-operation + {}us\"\nwhat = \"pull {cable}\"\n",
                100_000 + micros
            ));
            let lost = lost_cycles(&seen, 98, 300);
            assert!(lost.iter().all(|lost| *lost <= 1), "{cable} at {micros} us: {lost:?}");
            assert!(seen.sent.iter().any(|at| at.abs_diff(seen.at(100) + leaves) < 1_000));
            lost_in_all += lost.iter().sum::<usize>();
        }
    }
    assert!(lost_in_all > 0, "some of them must meet a frame");
}

#[test]
fn the_cable_that_closes_the_ring_is_pulled_until_it_is_plugged_in() {
    let (_, report) = ring(&[(100, "pull ring")]);
    assert_eq!(told(&report, "ring-healed").len(), 0);
    let (seen, report) = ring(&[(100, "pull ring"), (300, "plug ring")]);
    assert_eq!((told(&report, "ring-cut").len(), told(&report, "ring-healed").len()), (1, 1));
    assert!(lost_cycles(&seen, 99, 1_999).iter().all(|lost| *lost <= 1));
    let told: Vec<&str> = report.faults.iter().map(|fault| &*fault.what).collect();
    assert_eq!(
        told,
        [
            "the cable that closes the ring is pulled",
            "the cable that closes the ring is plugged in"
        ]
    );
}

/// On the way to the secondary port nothing comes there any more: what the last device sends is
/// lost, as it keeps its link. On the way from it the last device loses its link, and closes the
/// port.
#[test]
fn one_way_of_it_breaks() {
    let (seen, report) = ring(&[(100, "break ring back for 200ms")]);
    assert!(lost_cycles(&seen, 99, 1_999).iter().all(|lost| *lost <= 1));
    assert_eq!((told(&report, "ring-cut").len(), told(&report, "ring-healed").len()), (1, 1));

    let (seen, report) = ring(&[(100, "break ring out for 200ms")]);
    for device in 0..3 {
        // Copy A passes all of them, on its way to where it is lost.
        assert!(seen.outputs(device, 99, 299) >= 199, "{device}");
    }
    // Nothing of process data comes back meanwhile.
    assert!(report.segment.main_device.frames_lost > 150, "{}", report.text());
}

#[test]
fn it_flaps() {
    let (seen, report) = ring(&[(100, "flap ring 10ms 340ms for 800ms")]);
    // Pulled at 100, 450 and 800 ms; each time there is a link again 300 ms after plugging in.
    assert_eq!((told(&report, "ring-cut").len(), told(&report, "ring-healed").len()), (3, 3));
    assert!(lost_cycles(&seen, 99, 1_999).iter().all(|lost| *lost <= 3));
}

/// Against the order of the whole ring a copy that is lost is missed by none; in the order it costs
/// a cycle.
#[test]
fn frames_are_lost_on_it() {
    let (seen, report) = ring(&[(100, "drop 5 back at ring")]);
    assert_eq!(lost_cycles(&seen, 99, 1_999), [0; 3]);
    let lost = report.segment.main_device.frames_lost;
    assert_eq!((report.segment.copies_lost, lost), (5, 0));
    assert!(report.in_sync, "{}", report.text());

    let (seen, report) = ring(&[(100, "drop 1 out at ring")]);
    assert_eq!(lost_cycles(&seen, 99, 1_999), [0; 3]);
    assert_eq!(report.segment.main_device.frames_lost, 1);
}

/// The plan counts with the longest and the shortest way of the frames: what is seen in true time
/// is within its bounds, whole or cut, whichever of the two cables at the MainDevice is the longer
/// one.
#[test]
fn the_plan_holds_behind_each_cut() {
    for (first, closing) in [("10m", "10m"), ("5m", "2000m"), ("2000m", "5m")] {
        for (cable, _) in CABLES {
            let text = format!("ring = \"{closing}\"\n{SEGMENT}").replace(
                "name = \"first\"",
                &format!("name = \"first\"\nfibre = true\ncable = \"{first}\""),
            );
            let fault =
                format!("[[fault]]\nat = \"in-operation + 100ms\"\nwhat = \"pull {cable}\"\n");
            let file = SegmentFile::parse("ring.toml", &(text + &fault)).unwrap();
            let mut scenario = Scenario::from(file);
            scenario.duration = Nanos::millis(300);
            let plan = Plan::of(&scenario).unwrap();
            let mut report = plan.report(&scenario);
            let proof = proof::prove(&plan, &scenario);
            proof.fill(&mut report);
            // The cut is what the run finds; every bound that did not hold would be one more.
            let found: Vec<&str> =
                proof.run.findings.iter().map(|finding| finding.kind.name()).collect();
            assert!(matches!(found[..], ["ring-cut"] | ["ring-cut", "clocks-split"]), "{found:?}");
            let told = report.proof.expect("it was proven").findings;
            assert_eq!(told.len(), found.len(), "{first}, {closing}, {cable}: {told:#?}");
        }
    }
}

/// Two cables: the devices between them are cut off, and are back behind the repair.
#[test]
fn between_two_cuts_is_lost() {
    let (seen, report) = ring(&[(100, "pull axis for 300ms"), (200, "pull last for 300ms")]);
    assert!(seen.outputs(0, 99, 1_999) >= 1_898 && seen.outputs(2, 99, 1_999) >= 1_898);
    assert_eq!((seen.moves(0), seen.moves(2)), (vec![], vec![]));
    let moves = seen.moves(1);
    assert!(moves.len() > 1, "{moves:?}");
    assert_eq!(moves.last().map(|last| last.1), Some(AlState::Op), "{}", report.text());
    let lost = report.findings.iter().filter(|finding| finding.kind.name() == "lost");
    assert_eq!(lost.map(|finding| finding.position).collect::<Vec<_>>(), [Some(1)]);
}

/// A ring of one device, and one behind a coupler whose cable is at its port 2.
#[test]
fn other_rings() {
    let head = "cycle = \"1ms\"\nfor = \"500ms\"\n[host]\njitter = \"0ns\"\n";
    let alone = format!("{head}[[subdevice]]\ndevice = \"simple_io16\"\nname = \"x\"\n");
    let coupler = format!(
        "{head}[[subdevice]]\ndevice = \"beckhoff_ek1100\"\nname = \"x\"\n\
         [[subdevice]]\ndevice = \"beckhoff_el2502-0010\"\ncount = 2\n"
    );
    for (segment, closed) in [(alone, (0, 1)), (coupler, (0, 2))] {
        for cable in ["x", "ring"] {
            let (seen, report) = ring_of(&segment, &[(100, &format!("pull {cable} for 50ms"))]);
            let found = report.segment.ring.expect("it is a ring");
            assert_eq!((found.position, found.port), closed);
            assert_eq!(
                (told(&report, "ring-cut").len(), told(&report, "ring-healed").len()),
                (1, 1)
            );
            let last = report.devices.len() - 1;
            assert!(seen.outputs(last, 99, 499) >= 399, "{}", report.text());
            assert_eq!(seen.moves(last), []);
        }
    }
}
