use std::string::ToString;

use super::*;

#[test]
fn the_published_speed_is_solved_for_the_difference() {
    for start in [0x0080, 0x0081, 0x0100, 0x1000, 0x3FFF] {
        let (a, most) = (f64::from(start) + 2.0, i64::from(range(start)));
        for d in (-most..=most).step_by((most as usize / 50).max(1)) {
            let d = d as f64;
            let speed = d / (5.0 * (a + d) * (a - d)) * (1u64 << 60) as f64;
            let found = whole(counter_difference(speed as i64, start));
            assert_eq!(found, d as i64, "start {start:#x}");
        }
        for (speed, expected) in [(fastest(start), most), (-fastest(start), -most)] {
            let found = whole(counter_difference(speed, start));
            assert_eq!(found, expected, "start {start:#x}");
        }
    }
}

/// Near a speed the parabola gives the same difference, or none; as a rule it gives one.
#[test]
fn near_a_speed_the_difference_is_the_same() {
    for start in [0x0080, 0x0081, 0x00C0, 0x0100, 0x0200, 0x0400, 0x0FFF, 0x1000, 0x2000, 0x3FFF] {
        let (fastest, unit) = (fastest(start), speed_at(1, start) << 20);
        let (mut found, mut all) = (0, 0);
        for number in 0..400 {
            let at = fastest / 400 * (2 * number - 399);
            let near = Near::of(at, counter_difference(at, start), start);
            let reach = (i64::from(start) >> 8) + 2;
            for step in -500..=500i64 {
                let speed = (at + unit * reach / 500 * step).clamp(-fastest, fastest);
                let exact = whole(counter_difference(speed, start));
                let difference = near.difference(speed);
                assert!(difference.is_none_or(|it| it == exact), "{start:#x}, {at}, {speed}");
                let is_small = exact.abs() < i64::from(start) / 3 && step.abs() < 250;
                found += u32::from(is_small && difference.is_some());
                all += u32::from(is_small);
            }
        }
        assert!(start < 0x0400 || found > all / 10 * 9, "{start:#x}: {found} of {all}");
    }
}

#[test]
fn names() {
    for (name, law) in DriftLaw::NAMED {
        assert_eq!((name.parse(), law.to_string().as_str()), (Ok(law), name));
    }
    assert_eq!("Hold".parse::<DriftLaw>(), Err(UnknownDriftLaw));
    assert_eq!(DriftLaw::Hold { phase: 11 }.to_string(), "hold 11");
}

/// No input makes the arithmetic overflow.
#[test]
fn any_input() {
    for (_, law) in DriftLaw::NAMED.into_iter().chain([("", DriftLaw::Hold { phase: 255 })]) {
        for start in [0x0080, 0x1000, 0x3FFF] {
            for difference in [i32::MIN, i32::MAX, 0] {
                let mut steering = Steering::default();
                let mut filtered = 0;
                for (number, interval) in
                    [0, 1, i64::MAX, 1_000_000, -1, i64::MAX].into_iter().enumerate()
                {
                    let difference = if number % 2 == 0 { difference } else { !difference };
                    filtered += ((i64::from(difference) << FRACTION) - filtered) >> 1;
                    let received = Received {
                        difference,
                        filtered,
                        interval,
                        first: number == 0,
                        start,
                        time_depth: number as u8,
                        speed_depth: 0,
                    };
                    let step = steering.follow(&law, &received);
                    assert!(step.abs() <= 100);
                    assert!(i64::from(steering.applied()).abs() <= i64::from(range(start)));
                }
            }
        }
    }
}
