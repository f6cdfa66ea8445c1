//! Groups that may be absent, as a user runs them: planned for, taken up at any cycle, and refused
//! where they could not be.

use isocat::{Scenario, SegmentFile};
use isocat_sim::Tap;
use isocat_wire::sii;
use isocat_wire::time::{Time, True};

fn scenario(text: &str) -> Scenario {
    Scenario::from(SegmentFile::parse("group.toml", text).expect("it reads"))
}

/// A drive behind a fork at which a group of 25 with 100 m of cable each comes: 60 us more for the
/// frames to the drive.
const LONG_WAY: &str = r#"
    cycle = "250us"
    for = "3s"
    [[subdevice]]
    device = "kollmorgen_akd2g"
    [[subdevice]]
    device = "simple_io4"
    name = "fork"
    [[subdevice]]
    device = "simple_io4"
    name = "group"
    connect = "fork:1"
    cable = "100m"
    count = 25
    optional = true
    arrives = "1s"
    [[subdevice]]
    device = "kollmorgen_akd2g"
    name = "behind"
    connect = "fork:2"
    clock = "+30ppm"
"#;

#[test]
fn the_way_through_a_group_that_is_absent_is_in_the_plan() {
    let late = isocat::run(&scenario(LONG_WAY));
    assert!(late.in_sync, "{}", late.verdict);
    assert_eq!(late.visits.len(), 2 * 25, "found and admitted, each of them");
    let there = isocat::run(&scenario(&LONG_WAY.replace("arrives = \"1s\"", "")));
    let never = isocat::run(&scenario(&LONG_WAY.replace("\"1s\"", "\"60s\"")));
    assert!(there.in_sync && never.in_sync, "{}, {}", there.verdict, never.verdict);
    assert!(never.verdict.contains("25 optional ones are absent"), "{}", never.verdict);
    // The same phase whether the group is there or not; the estimate of an absent one's way is
    // above, by 1 us at most.
    let phase =
        |report: &isocat::Report| report.segment.plan.as_ref().expect("a plan").sync0_phase_ns;
    let (late, there, never) = (phase(&late), phase(&there), phase(&never));
    assert_eq!(late, never);
    let more = late.expect("SYNC0") - there.expect("SYNC0");
    assert!((0..=1_000).contains(&more), "{more} ns");
}

/// Drift frames for the one that joins do not move those that run, however long the cycle is.
#[test]
fn a_clock_that_joins_does_not_move_others_at_long_cycles() {
    for cycle in [1, 5, 10, 20] {
        let text = format!(
            r#"
            cycle = "{cycle}ms"
            for = "8s"
            [[subdevice]]
            device = "simple_io4"
            name = "fork"
            clock = "-20ppm"
            [[subdevice]]
            device = "kollmorgen_akd2g"
            name = "other"
            clock = "+40ppm"
            connect = "fork:1"
            [[subdevice]]
            device = "simple_io4"
            name = "late"
            connect = "fork:2"
            optional = true
            arrives = "2s"
        "#
        );
        let report = isocat::run(&scenario(&text));
        assert!(report.in_sync, "{cycle} ms: {}", report.verdict);
        let error = report.devices[1].true_time.sync0_error.as_ref().expect("it has SYNC0");
        println!("{cycle} ms: {error:?}");
        // What a loop has to learn anew takes cycles; the plan's clock error has it.
        let limit = 200.0 + 35.0 * f64::from(cycle);
        assert!(error.worst_ns < limit, "{cycle} ms: {error:?}");
        let admitted = report.visits.last().and_then(|visit| visit.since_ns).expect("it came");
        // Drift frames come ten times a cycle while it joins.
        assert!(admitted < 9_000_000_000, "{cycle} ms: after {admitted} ns");
        // Frames of the cycle are told from those that lead the one that joins.
        let phase = report.segment.true_time.host_phase_error.as_ref().expect("there is a host");
        assert!(phase.worst_ns < 30_000.0, "{cycle} ms: {phase:?}");
    }
}

/// A first SubDevice without a clock, so that the one which may be absent would lead.
#[test]
fn the_first_clock_must_always_be_there() {
    let text = r#"
        cycle = "1ms"
        [[subdevice]]
        device = "simple_io4"
        name = "root"
        [[subdevice]]
        device = "kollmorgen_akd2g"
        name = "late"
        optional = true
        arrives = "2s"
    "#;
    let mut run = scenario(text).run();
    let mut image = run.setup.segment[0].device.sii.to_vec();
    // The DC unit is switched off in the configuration word, which has its checksum in word 7.
    image[1] = 0;
    image[14] = sii::checksum(image[..14].first_chunk().expect("an EEPROM is longer"));
    run.setup.segment[0].device.sii = image.into();
    let outcome = run.execute(None::<Nobody>, &mut |_| {});
    let error = outcome.failure.expect("nobody would lead").to_string();
    assert!(error.contains("hot_connect") && error.contains("always there"), "{error}");
}

struct Nobody;

impl Tap for Nobody {
    fn frame(&mut self, _: Time<True>, _: bool, _: &[u8]) {}
}

/// A way that becomes longer is no clock that slides.
#[test]
fn a_group_that_comes_raises_no_alarm_of_other_clocks() {
    let text = r#"
        cycle = "1ms"
        for = "5s"
        [quality]
        [[subdevice]]
        device = "simple_io4"
        name = "fork"
        clock = "-35ppm"
        [[subdevice]]
        device = "kollmorgen_akd2g"
        name = "late"
        connect = "fork:1"
        clock = "+30ppm"
        cable = "40m"
        optional = true
        arrives = "3s"
        [[subdevice]]
        device = "kollmorgen_akd2g"
        name = "behind"
        connect = "fork:2"
        clock = "-80ppm"
    "#;
    let report = isocat::run(&scenario(text));
    assert!(report.in_sync, "{}", report.verdict);
    let quality = report.quality.as_ref().expect("it was asked for");
    let of_others: Vec<_> = quality.alarms.iter().filter(|alarm| alarm.position != 1).collect();
    assert!(of_others.is_empty(), "{of_others:?}");
    // Both were read, before and after.
    assert!(quality.devices[2].clock.as_ref().is_some_and(|clock| clock.readings > 100));
}
