//! Words for clocks: clock, clock-walk, clock-jump.

use isocat_wire::time::{Device, Host, Nanos, Picos, Time, True};

use crate::onlooker::{SEGMENT, outcome};

/// How much faster than true time the oscillator of the axis runs at a point of operation, ppb.
fn rates(what: &str, points: &[u64]) -> Vec<i64> {
    let text = format!("{SEGMENT}[[fault]]\nat = \"in-operation + 100ms\"\nwhat = \"{what}\"\n");
    let (seen, _, outcome) = outcome(&text);
    let oscillator = outcome.world.segment().devices()[1].oscillator();
    let rate = |ms: u64| {
        let from = Time::<True>::new(seen.at(ms) * 1_000);
        let to = from + Picos::from(Nanos::millis(5));
        let counted = oscillator.read::<Device>(to) - oscillator.read::<Device>(from);
        (counted.0 - 5_000_000) * 200
    };
    points.iter().map(|ms| rate(*ms)).collect()
}

fn near(found: &[i64], expected: &[i64]) {
    let all = found.iter().zip(expected);
    assert!(all.clone().all(|(found, expected)| (found - expected).abs() <= 400), "{found:?}");
}

#[test]
fn a_clock_steps_for_its_time() {
    let points = [90, 110, 290, 310, 900];
    let ppm = |all: [i64; 5]| all.map(|ppm| ppm * 1_000);
    near(&rates("clock axis +30ppm for 200ms", &points), &ppm([10, 40, 40, 10, 10]));
    near(&rates("clock axis +30ppm", &points), &ppm([10, 40, 40, 40, 40]));
}

#[test]
fn a_clock_ramps_and_goes_back() {
    let points = [90, 200, 299, 420, 900];
    let found = rates("clock axis -64ppm over 200ms", &points);
    assert!((found[1] + 22_000).abs() < 2_500, "half of the way: {found:?}");
    near(&[found[0], found[3], found[4]], &[10_000, -54_000, -54_000]);
    let found = rates("clock axis -64ppm over 200ms for 100ms", &points);
    near(&[found[0], found[3], found[4]], &[10_000, 10_000, 10_000]);
}

#[test]
fn a_clock_walks_within_its_bound() {
    let points: Vec<u64> = (0..45).map(|point| 102 + 20 * point).collect();
    let found = rates("clock-walk axis 1ppm every 10ms within 3ppm", &points);
    assert!(found.iter().all(|ppb| (ppb - 10_000).abs() <= 3_400), "{found:?}");
    let (least, most) = (found.iter().min().unwrap(), found.iter().max().unwrap());
    assert!(most - least > 2_000, "{found:?}");
}

/// Only the host's clock jumps: its devices go on, and the servo finds the grid again.
#[test]
fn the_clock_of_the_host_jumps() {
    let text =
        format!("{SEGMENT}[[fault]]\nat = \"in-operation + 100ms\"\nwhat = \"clock-jump 3ms\"\n");
    let (seen, _, mut outcome) = outcome(&text);
    let host = outcome.world.host_mut();
    let read = |ms: u64| host.now(Time::new(seen.at(ms) * 1_000));
    let over = |from: u64, to: u64| read(to) - read(from);
    let ahead = over(99, 101) - over(97, 99);
    assert!((ahead.0 - 3_000_000).abs() < 10, "{ahead}");
    assert_eq!((over(101, 103) - over(97, 99)).0.abs() / 10, 0);
    let _: Time<Host> = read(99);
    assert_eq!(seen.edges(1, 0, 900), 900, "SYNC0 does not know of it");
}
