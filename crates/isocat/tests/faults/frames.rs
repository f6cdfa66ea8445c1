//! Words for frames: drop, loss, damage, delay, double; and heal.

use isocat_sim::Lost;

use crate::onlooker::{SEGMENT, outcome, run, with};

#[test]
fn so_many_frames_are_dropped() {
    let (seen, report) = with(100, "drop 3");
    let lost: Vec<_> = seen.lost.iter().filter(|(at, _)| *at >= seen.at(100)).collect();
    assert_eq!(lost.len(), 3);
    assert!(lost.iter().all(|(at, why)| *why == Some(Lost::AtThePort) || *at < seen.at(104)));
    assert_eq!(report.segment.main_device.frames_lost, 3);
}

#[test]
fn frames_are_dropped_on_a_cable_on_one_way() {
    // On the way out behind the first device: it alone has its outputs.
    let (seen, _) = with(100, "drop 1 out at axis");
    let lost: Vec<_> = seen.lost.iter().map(|(_, why)| *why).collect();
    assert_eq!(lost, [Some(Lost::OnTheWay { cable: 1 })]);
    assert_eq!([0, 1, 2].map(|device| seen.outputs(device, 99, 110)), [11, 10, 10]);
    // On the way back: all have them, and the MainDevice sees nothing.
    let (seen, report) = with(100, "drop 1 back at axis");
    assert_eq!([0, 1, 2].map(|device| seen.outputs(device, 99, 110)), [11, 11, 11]);
    assert_eq!((seen.lost.len(), report.segment.main_device.frames_lost), (1, 1));
}

#[test]
fn frames_are_lost_by_chance_for_a_time() {
    let (seen, _) = with(100, "loss 10% for 500ms");
    let lost: Vec<u64> = seen.lost.iter().map(|(at, _)| *at).collect();
    let during = seen.between(&lost, 100, 600);
    // At least one frame a cycle.
    assert!((25..120).contains(&during), "{during}");
    assert_eq!((seen.between(&lost, 0, 100), seen.between(&lost, 601, 1_000)), (0, 0));
    let (seen, _) = with(100, "loss 2% burst 4 out for 500ms");
    let lost: Vec<u64> = seen.lost.iter().map(|(at, _)| *at).collect();
    let rows = lost.chunk_by(|one, next| next - one < 1_500_000).filter(|row| row.len() >= 4);
    assert!(rows.count() >= 2, "{lost:?}");
}

#[test]
fn damaged_frames_are_counted_where_they_are_seen() {
    let text = format!(
        "{SEGMENT}[[fault]]\nat = \"in-operation + 100ms\"\nwhat = \"damage 2 out at last\"\n"
    );
    let (seen, _, outcome) = outcome(&text);
    assert_eq!(seen.lost.iter().filter(|(_, why)| why.is_none()).count(), 2);
    // 0x0300: the last one sees them as invalid, those before it as forwarded errors on the way
    // back.
    let errors = |device: usize, address: usize| {
        outcome.world.segment().devices()[device].esc.registers()[address]
    };
    assert_eq!([errors(2, 0x0300), errors(1, 0x0300), errors(1, 0x0309)], [2, 0, 2]);
}

#[test]
fn frames_come_late() {
    let late = |what: &str, from: u64, to: u64| {
        let (seen, _) = with(100, what);
        let span = seen.at(from)..seen.at(to);
        let pairs = seen.sent.iter().zip(&seen.back).filter(|(sent, _)| span.contains(sent));
        let trips: Vec<u64> = pairs.map(|(sent, back)| back - sent).collect();
        (trips.iter().copied().min().unwrap(), trips.iter().copied().max().unwrap())
    };
    let (least, most) = late("delay 100us 300us for 200ms", 101, 299);
    assert!(least > 100_000 && most < 330_000 && most - least > 150_000, "{least} {most}");
    let (_, usual) = late("delay 100us 300us for 200ms", 301, 900);
    assert!(usual < 20_000, "{usual}");
    // On a cable every frame that goes over it, here once on each way.
    let (least, most) = late("delay 50us out at last for 200ms", 101, 299);
    assert!((50_000..70_000).contains(&least) && most < 70_000, "{least} {most}");
}

/// A late answer is no lost one: the cable is not what is bad.
#[test]
fn what_comes_late_is_not_called_lost() {
    let found = |what: &str| {
        let (_, report) = with(100, what);
        let kinds = report.findings.iter().map(|finding| finding.kind.name());
        kinds.filter(|kind| matches!(*kind, "frames-lost" | "answers-late")).collect::<Vec<_>>()
    };
    // Within the cycle nothing is late, though others wait for it.
    assert_eq!(found("delay 900us 5%"), [""; 0]);
    assert_eq!(found("delay 1100us 5%"), ["answers-late"]);
    // The MainDevice gives a frame up after two cycles.
    assert_eq!(found("delay 1900us 5%"), ["answers-late"]);
    assert_eq!(found("delay 5ms 3"), ["answers-late"]);
    assert_eq!(found("drop 3 back"), ["frames-lost"]);
}

#[test]
fn frames_travel_twice() {
    // Before the segment: its devices see each of them twice.
    let (seen, _) = with(100, "double 4 out");
    assert_eq!(seen.outputs(0, 99, 110), 11 + 4);
    assert_eq!(seen.back.len(), seen.sent.len() + 4);
    // Behind it: the MainDevice alone.
    let (seen, report) = with(100, "double 4 back");
    assert_eq!(seen.outputs(0, 99, 110), 11);
    assert_eq!(seen.back.len(), seen.sent.len() + 4);
    assert!(report.in_sync, "{}", report.verdict);
}

#[test]
fn all_faults_end_at_once() {
    let text = format!(
        "{SEGMENT}[[fault]]\nat = \"in-operation + 100ms\"\nwhat = \"loss 50%\"\n\
         [[fault]]\nat = \"in-operation + 100ms\"\nwhat = \"delay 200us\"\n\
         [[fault]]\nat = \"in-operation + 200ms\"\nwhat = \"heal\"\n"
    );
    let (seen, _) = run(&text);
    let lost: Vec<u64> = seen.lost.iter().map(|(at, _)| *at).collect();
    assert!(seen.between(&lost, 100, 200) > 30);
    assert_eq!(seen.between(&lost, 200, 1_000), 0);
    assert_eq!(seen.instants().iter().filter(|(_, begins)| !begins).count(), 2);
}
