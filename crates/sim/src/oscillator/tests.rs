use super::*;
use isocat_wire::time::Device;
use proptest::prelude::*;

fn read(oscillator: &Oscillator, ps: u64) -> u64 {
    oscillator.read::<Device>(Time::new(ps)).count()
}

fn of(model: ClockModel) -> Oscillator {
    Oscillator::of(&model, &mut Stream::new(1, "test", 0))
}

const SECOND: u64 = 1_000_000_000_000;

#[test]
fn ten_seconds_at_48_ppm_gain_480_us() {
    let read = |ppb| read(&Oscillator::new(ppb), 10 * SECOND);
    // The rate is rounded down by less than 10⁻¹⁶.
    assert_eq!(read(0), 9_999_999_999);
    assert_eq!(read(48_000).abs_diff(10_000_480_000), 1);
    assert_eq!(read(-35_000).abs_diff(9_999_650_000), 1);
}

#[test]
fn the_inverse_is_the_first_instant() {
    for ppb in [-100_000, -35_001, 0, 1, 48_000, 100_000] {
        let oscillator = Oscillator::new(ppb);
        for reading in [1, 10, 123_456_789, 4_294_967_296, 3_600_000_000_000] {
            let at = oscillator.when::<Device>(Time::new(reading));
            assert_eq!(oscillator.read::<Device>(at).count(), reading, "{ppb} ppb");
            let before = Time::new(at.count() - 1);
            assert_eq!(oscillator.read::<Device>(before).count(), reading - 1, "{ppb} ppb");
        }
    }
    assert_eq!(Oscillator::new(0).when::<Device>(Time::NEVER), Time::NEVER);
}

proptest! {
    /// The multiplication that replaces the division is exact, on both sides of its limit.
    #[test]
    fn the_inverse_is_that_of_a_division(
        ppb in -MOST_DEVIATION_PPB..=MOST_DEVIATION_PPB,
        reading in prop_oneof![0..SHORT, 0..10_000_000_000u64, SHORT - 5..SHORT + 5],
    ) {
        let oscillator = Oscillator::new(ppb);
        let exact = (u128::from(reading) << 64).div_ceil(u128::from(oscillator.rate));
        let at = oscillator.when::<Device>(Time::new(reading)).count();
        prop_assert_eq!(u128::from(at), exact);
    }
}

/// 10 ppm more from 2 s on: at 5 s it is 30 us ahead, and before 2 s it has gained nothing.
#[test]
fn a_step_gains_from_its_instant_on() {
    let step = Step { by_ppb: 10_000, at: Nanos::millis(2_000) };
    let oscillator = of(ClockModel { step: Some(step), ..ClockModel::default() });
    let plain = Oscillator::new(0);
    for at in [0, SECOND, 2 * SECOND - 1, 2 * SECOND] {
        assert_eq!(read(&oscillator, at), read(&plain, at), "{at}");
    }
    let gained = read(&oscillator, 5 * SECOND) - read(&plain, 5 * SECOND);
    assert!((29_999..=30_000).contains(&gained), "{gained}");
    // The first 100 us take 1 ns less: 100 us / 1.00001, rounded up to a picosecond.
    let at = oscillator.when::<Device>(Time::new(2_000_100_000)).count();
    assert_eq!(at, 2 * SECOND + 99_999_001);
}

/// 6.4 ppm in 10 s from 1 s on: half of it on average during the ramp, all of it afterwards.
#[test]
fn a_ramp_grows_evenly_and_stays() {
    let ramp = Ramp { by_ppb: 6_400, from: Nanos::millis(1_000), over: Nanos::millis(10_000) };
    let oscillator = of(ClockModel { ramp: Some(ramp), ..ClockModel::default() });
    let gained = |at| read(&oscillator, at) as i64 - read(&Oscillator::new(0), at) as i64;
    assert_eq!(gained(SECOND), 0);
    // The even ramp gains by × t / over × t / 2. The steps around it deviate by at most by × over /
    // (8 × 64²).
    for tenth in 1..=10 {
        let even = 6_400 * tenth * tenth / 20;
        let stairs = gained(SECOND + tenth as u64 * SECOND);
        assert!((stairs - even).abs() <= 3, "{tenth} s: {stairs} against {even}");
    }
    assert!((gained(21 * SECOND) - 32_000 - 64_000).abs() <= 3);
}

#[test]
fn a_walk_wanders_within_its_bound_and_comes_back() {
    let walk = Walk { step_ppb: 50, every: Nanos::millis(10), bound_ppb: 300 };
    let oscillator = of(ClockModel { walk: Some(walk), ..ClockModel::default() });
    let table = oscillator.shape.as_ref().unwrap().walk.as_ref().unwrap();
    let bound = rate_offset(300);
    assert!(table.rates.iter().all(|rate| rate.abs() <= bound + 1));
    assert!(table.rates.iter().any(|rate| rate.abs() > bound / 2), "it really wanders");
    let step = rate_offset(50);
    assert!(table.rates.windows(2).all(|pair| (pair[1] - pair[0]).abs() <= step + 1));
    // The same piece comes at the same distance before and after the turn.
    let turn = WALK_PIECES as u64;
    for distance in 0..turn {
        assert_eq!(table.interval(turn + distance).0, table.interval(turn - 1 - distance).0);
    }
    assert_eq!(table.interval(2 * turn).0, table.rates[0]);
    let other = Oscillator::of(
        &ClockModel { walk: Some(walk), ..ClockModel::default() },
        &mut Stream::new(1, "test", 1),
    );
    assert_ne!(oscillator, other, "each stream walks its own way");
}

#[test]
#[should_panic(expected = "at most 1 %: 10000001 ppb")]
fn more_than_one_percent_is_no_clock() {
    let step = Step { by_ppb: -1, at: Nanos::ZERO };
    of(ClockModel { deviation_ppb: MOST_DEVIATION_PPB, step: Some(step), ..ClockModel::default() });
}

fn model() -> impl Strategy<Value = ClockModel> {
    let ramp = (-50_000i64..50_000, 0i64..5_000_000_000, 1i64..20_000_000_000)
        .prop_map(|(by_ppb, from, over)| Ramp { by_ppb, from: Nanos(from), over: Nanos(over) });
    let step = (-50_000i64..50_000, 0i64..10_000_000_000)
        .prop_map(|(by_ppb, at)| Step { by_ppb, at: Nanos(at) });
    let walk = (0i64..2_000, 1i64..100_000_000, 0i64..20_000).prop_map(|(step, every, bound)| {
        Walk { step_ppb: step, every: Nanos(every), bound_ppb: bound }
    });
    (-1_000_000i64..1_000_000, of_option(ramp), of_option(step), of_option(walk)).prop_map(
        |(deviation_ppb, ramp, step, walk)| ClockModel { deviation_ppb, ramp, step, walk },
    )
}

fn of_option<T: std::fmt::Debug + Clone>(
    strategy: impl Strategy<Value = T>,
) -> impl Strategy<Value = Option<T>> {
    (any::<bool>(), strategy).prop_map(|(some, value)| some.then_some(value))
}

proptest! {
    /// The count never decreases, and never deviates by more than its model says.
    #[test]
    fn it_is_monotone_and_within_its_model(model in model(), at in 0..40 * SECOND, span in 0..SECOND) {
        let oscillator = of(model);
        let (from, to) = (read(&oscillator, at), read(&oscillator, at + span));
        prop_assert!(from <= to);
        let most = model.most_deviation_ppb();
        let (low, high) = (Oscillator::new(-most), Oscillator::new(most));
        let (fast, slow) = (read(&high, span), read(&low, span));
        prop_assert!((slow.saturating_sub(1)..=fast + 1).contains(&(to - from)), "{slow} {} {fast}", to - from);
    }

    /// `when` is the first instant: the reading is reached there, and not one picosecond earlier.
    #[test]
    fn the_inverse_of_any_model_is_the_first_instant(model in model(), reading in 1..40_000_000_000u64) {
        let oscillator = of(model);
        let at = oscillator.when::<Device>(Time::new(reading)).count();
        prop_assert_eq!(read(&oscillator, at), reading);
        prop_assert_eq!(read(&oscillator, at - 1), reading - 1);
    }

    /// The count is the exact sum of its pieces, however it is computed: adding up rate times time
    /// over random cuts gives the same 2⁻⁶⁴ ns.
    #[test]
    fn sums_do_not_drift(model in model(), cuts in proptest::collection::vec(0..40 * SECOND, 1..20)) {
        let oscillator = of(model);
        let Some(shape) = &oscillator.shape else { return Ok(()) };
        let mut borders: Vec<u64> = shape.pieces.iter().map(|piece| piece.start).collect();
        let end = 40 * SECOND;
        borders.extend(&cuts);
        if let Some(walk) = &shape.walk {
            // All borders of a short walk would be too many, so only those of two turns are used.
            let some = (0..5 * WALK_PIECES as u64).map(|number| number * walk.every);
            borders.extend(some.filter(|at| *at < end));
        }
        borders.sort_unstable();
        let covered = shape.walk.as_ref().map_or(end, |w| (5 * WALK_PIECES as u64 * w.every).min(end));
        let mut sum = 0u128;
        for pair in borders.windows(2) {
            let number = shape.pieces.iter().rposition(|piece| piece.start <= pair[0]).unwrap();
            let walking = shape.walk.as_ref().map_or(0, |walk| walk.interval(pair[0] / walk.every).0);
            let rate = shape.pieces[number].rate.wrapping_add_signed(walking);
            sum += u128::from(pair[1] - pair[0]) * u128::from(rate);
            if pair[1] < covered {
                prop_assert_eq!(shape.count(pair[1]), sum, "at {} ps", pair[1]);
            }
        }
    }
}
