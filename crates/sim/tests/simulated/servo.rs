//! The servo against other laws, with fewer starts than in `docs/servo.md` but the same limits.
//!
//! `cargo run --release -p isocat-sim --example servo` prints the table of `docs/servo.md`.

#[path = "../../examples/servo/figures.rs"]
mod figures;
#[path = "../../examples/servo/hosts.rs"]
mod hosts;
#[path = "../../examples/servo/laws.rs"]
mod laws;
#[path = "../../examples/servo/race.rs"]
mod race;

use figures::Summary;
use hosts::COURSES;
use laws::LAWS;

const MILLISECOND: i64 = 1_000_000_000;
const MICROSECOND: f64 = 1_000_000.0;
/// The tick of the reference, ps: figures that differ by less are equal.
const TICK: i64 = 10_000;

/// Within 200 ms each deadline is less than a microsecond off the target and stays so; the phase is
/// the same after every start, to less than a microsecond.
#[test]
fn locked_soon_and_in_the_same_phase_after_every_start() {
    for course in COURSES {
        let ours = Summary::of(&LAWS[0], &course, 20);
        let name = course.name;
        assert_eq!(ours.lock.reached, 20, "{name}");
        assert!(ours.lock.worst < 200 * MILLISECOND, "{name}: {} ps", ours.lock.worst);
        assert!(ours.mean.abs() < MICROSECOND, "{name}: {} ps", ours.mean);
        assert!(ours.repeat < MICROSECOND, "{name}: {} ps", ours.repeat);
        assert!(ours.worst < MICROSECOND as i64, "{name}: {} ps", ours.worst);
        assert!(ours.earliest > -(MICROSECOND as i64), "{name}: {} ps", ours.earliest);
        // A clock with 10 ns ticks cannot be followed better than this, nor can the delay of a host
        // be known at once.
        assert!(ours.repeat > 1.0 && ours.worst > 100, "{name}: {} {}", ours.repeat, ours.worst);
        if course.stamp_noise.0 >= 10_000 {
            assert!(ours.lock.median > 10 * MILLISECOND, "{name}: {} ps", ours.lock.median);
        }
        if course.disturbance.is_some() {
            assert_eq!(ours.recovery.reached, 20, "{name}");
            assert!(ours.recovery.worst < 50 * MILLISECOND, "{name}: {}", ours.recovery.worst);
        }
    }
}

/// No figure is worse than the best of the others; a tick is no difference.
#[test]
fn no_law_of_the_field_is_better() {
    let starts = 10;
    for course in COURSES {
        let all: Vec<Summary> = LAWS.iter().map(|law| Summary::of(law, &course, starts)).collect();
        let (ours, others) = all.split_first().expect("there are laws");
        let window = |summary: &Summary| summary.latest - summary.earliest;
        for (other, law) in others.iter().zip(&LAWS[1..]) {
            let what = format!("{}, {}", course.name, law.name);
            assert!(window(ours) <= window(other) + TICK, "{what}: window");
            assert!(ours.worst <= other.worst + TICK, "{what}: deadlines");
            assert!(ours.repeat <= other.repeat + TICK as f64, "{what}: phase of starts");
            if other.recovery.reached == starts as usize {
                assert!(ours.recovery.worst <= other.recovery.worst, "{what}: recovery");
            }
        }
    }
}

/// The other laws behave as is known of them: the race is neither unfair to them nor too kind.
#[test]
fn the_others_are_as_they_are_known() {
    let starts = 6;
    let ideal = |law: usize| Summary::of(&LAWS[law], &COURSES[0], starts);
    let proportional = ideal(1);
    assert_eq!(proportional.lock.reached, 6, "the PI law locks in the end");
    assert!((500..3_000).contains(&(proportional.lock.median / MILLISECOND)));
    let bang_bang = ideal(2);
    let step = MICROSECOND as i64;
    assert!((step / 2..2 * step).contains(&bang_bang.worst), "it swings by its step");
    let own_phase = ideal(3);
    assert!(own_phase.repeat > 100.0 * MICROSECOND, "any phase of the cycle");
    assert_eq!((own_phase.own_lock.reached, own_phase.lock.reached), (6, 0), "which it keeps");
    let deadbeat = ideal(4);
    assert!(deadbeat.lock.worst < 3 * MILLISECOND, "at once, if nothing disturbs it");
    let noisy = Summary::of(&LAWS[4], &COURSES[1], starts);
    assert!(noisy.worst > 20 * step, "each late frame moves the next deadline");
}
