//! What a recording keeps of a run: phases where the plan has them, errors as the judges have them,
//! what led to a missed event.

use isocat::recording::cycle::Origin;
use isocat::recording::{Recorded, Recording};
use isocat::timeline::Moment;
use isocat::{Nanos, Report, Scenario, SegmentFile};
use isocat_maindevice::segment::Timing;

fn record(text: &str) -> (Report, Recorded, Timing) {
    let mut scenario = Scenario::from(SegmentFile::parse("test.toml", text).expect("it is right"));
    scenario.duration = Nanos::millis(300);
    let recording = Recording::new(scenario.duration, scenario.sync0_limit, 64);
    let outcome = scenario.run().execute(Some(recording), &mut |_| {});
    let report = Report::new(&scenario, &outcome);
    let timing = outcome.world.main().segment().timing.clone().expect("operation was reached");
    (report, outcome.world.into_tap().expect("the tap").finish(), timing)
}

const EVERY_MODE: &str = r#"
cycle = "1ms"
for = "300ms"
seed = 3
[host]
jitter = "20us"
clock = "40ppm"
[[subdevice]]
device = "model_every_mode"
name = "leads"
mode = "dc-sync0"
[[subdevice]]
device = "model_every_mode"
name = "shifts"
mode = "dc-shift-sync1"
clock = "-30ppm"
[[subdevice]]
device = "model_every_mode"
name = "calculates at SYNC0"
mode = "dc-sync1"
clock = "25ppm"
[[subdevice]]
device = "model_every_mode"
name = "follows frames"
mode = "sm"
[[subdevice]]
device = "model_every_mode"
name = "follows nothing"
mode = "free-run"
"#;

#[test]
fn events_lie_where_the_plan_has_them_in_every_mode() {
    let (report, recorded, timing) = record(EVERY_MODE);
    assert!(report.in_sync, "{}", report.verdict);
    for (position, device) in recorded.devices.iter().enumerate() {
        let cycle = device.cycle.as_ref().expect("it does something");
        let own = position == 4;
        assert_eq!(cycle.origin == Origin::OwnCycle, own, "{position}");
        let moments = timing.moments(position).expect("it is planned");
        let mut compared = 0;
        for (moment, seen) in &cycle.moments {
            // SM3 is planned by its frame's begin.
            let Some(span) = moments.of(*moment).filter(|_| !own && *moment != Moment::Sm3) else {
                continue;
            };
            compared += 1;
            let (least, largest) = (span.earliest.0 * 1_000, span.latest.0 * 1_000);
            assert!(
                least <= seen.least() && seen.largest() <= largest,
                "{position} {moment:?}: seen {} to {} ps, planned {least} to {largest}",
                seen.least(),
                seen.largest()
            );
            assert!(seen.count() >= 270, "{position} {moment:?}: {}", seen.count());
        }
        assert!(compared >= if own { 0 } else { 5 }, "{position}: {compared}");
        let at = |moment| cycle.of(moment).map(|seen| seen.mean());
        if let (Some(begin), Some(end)) = (at(Moment::OutputsFetched), at(Moment::OutputsReady)) {
            assert!(begin < end && end - begin < 1e9, "{position}: {begin} {end}");
        }
    }
}

#[test]
fn errors_are_those_of_the_judges() {
    let (report, recorded, _) = record(EVERY_MODE);
    for (device, recorded) in report.devices.iter().zip(&recorded.devices) {
        let Some(error) = device.true_time.sync0_error else {
            assert_eq!(recorded.sync0.count(), 0);
            continue;
        };
        // A cycle more or less at either end.
        assert!(recorded.sync0.count().abs_diff(error.count) <= 4, "{}", recorded.sync0.count());
        let mean = recorded.sync0.mean().expect("there are edges") / 1e3;
        assert!((mean - error.mean_ns).abs() < 0.5, "{mean} {}", error.mean_ns);
        let counted: u64 = recorded.histogram.bins().map(|(_, count)| count).sum();
        assert_eq!(counted, recorded.sync0.count());
        let (least, largest) = recorded.sync0.range().expect("there are edges");
        assert!(least as f64 / 1e3 >= error.min_ns - 1e-3);
        assert!(largest as f64 / 1e3 <= error.max_ns + 1e-3);
    }
    let host = report.segment.true_time.host_phase_error.expect("frames went");
    let mean = recorded.host_phase.mean().expect("frames went") / 1e3;
    assert!((mean - host.mean_ns).abs() < 100.0, "{mean} {}", host.mean_ns);
    assert!(recorded.host_phase.spans().len() <= 64);
    assert!(recorded.incidents.is_empty(), "{:?}", recorded.incidents);
    let locked = isocat_sync::phase::State::Locked;
    assert_eq!(recorded.servo.iter().map(|(_, state)| *state).collect::<Vec<_>>(), [locked]);
}

#[test]
fn the_first_missed_event_is_kept_with_what_led_to_it() {
    let text = r#"
cycle = "1ms"
for = "300ms"
shift = "200us"
clocks = "0ppm" # so that the CPU's times are those of true time
[[subdevice]]
device = "model_every_mode"
[[subdevice]]
device = "model_every_mode"
name = "slow"
copy_time = "200us"
"#;
    let (report, recorded, _) = record(text);
    assert!(!report.in_sync && !recorded.operating, "it refuses OP: {}", report.verdict);
    let slow = &recorded.devices[1];
    let around = slow.around_miss.as_ref().expect("it is kept");
    let sync0 = around.entries.iter().any(|(at, m)| *m == Moment::Sync0 && at.0.abs() <= 1_000_000);
    assert!(sync0, "counted at a pulse: {:?}", around.entries);
    assert!(around.entries.first().is_some_and(|(at, _)| at.0 < 0));
    let left = slow.cycle.as_ref().expect("it works").outputs_left;
    assert!(left.largest() < 0 && left.least() > -40_000_000, "{left:?}");
    let took = slow.cycle.as_ref().expect("it works").outputs_took;
    assert_eq!(took.least() / 1_000_000, 200, "{took:?}");
    assert!(recorded.incidents.iter().any(|i| i.device == Some(1) && i.what.contains("0x001A")));
    assert_eq!(recorded.devices[0].around_miss, None);
}

#[test]
fn events_missed_in_operation_are_counted_and_marked() {
    // Late in some cycles only: the frames that are later than others.
    let text = r#"
cycle = "1ms"
for = "300ms"
shift = "200us"
clocks = "0ppm" # so that the CPU's times are those of true time
[[subdevice]]
device = "model_every_mode"
[[subdevice]]
device = "model_every_mode"
name = "slow"
copy_time = "180us"
"#;
    let (report, recorded, _) = record(text);
    assert!(!report.in_sync && recorded.operating, "it comes to OP: {}", report.verdict);
    let slow = &recorded.devices[1];
    assert_eq!(slow.missed_count, report.devices[1].true_time.missed_events, "{:?}", slow.missed);
    assert!(slow.missed_count > 0 && slow.missed[0].1 > 0, "{:?}", slow.missed);
    let left = slow.cycle.as_ref().expect("it works").outputs_left;
    assert!(left.least() < 0 && left.largest() > 0, "{left:?}");
    assert!(recorded.incidents.iter().any(|i| i.device == Some(1) && i.what.contains("0x1C32:0B")));
}
