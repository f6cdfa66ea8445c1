//! The drift loop's registers, its limits and its model.

use super::*;
use crate::{DRIFT_FRACTION, DriftInput, DriftModel, ET1100, LAN9252, ProportionalIntegral};
use isocat_wire::dc::SystemTimeDifference;

/// An exact agreement counts as ahead; after a reset there is no measurement at all.
#[test]
fn a_difference_of_zero_is_ahead_or_equal() {
    let mut bench = Bench::new(&ET1100);
    bench.write(register::TIME_FILTER_DEPTH, 0);
    bench.fpwr(0x0930, &[0x00, 0x10]);
    assert_eq!(bench.read(register::SYSTEM_TIME_DIFFERENCE), SystemTimeDifference(0));
    bench.run_to(bench.now.next_multiple_of(10) + 100);
    let equal = (bench.now as u32).to_le_bytes();
    bench.send(Command::Frmw, Address::Station(StationAddress(1), 0x0910), &equal);
    assert_eq!(bench.read(register::SYSTEM_TIME_DIFFERENCE), SystemTimeDifference(0x8000_0000));
}

/// One datagram writes offset and delay, as a MainDevice does; with a received time in the same frame,
/// that is compared with the old ones.
#[test]
fn offset_and_delay_come_into_force_together() {
    let mut bench = Bench::new(&LAN9252);
    bench.write(register::TIME_FILTER_DEPTH, 0);
    bench.run_to(bench.now.next_multiple_of(10) + 100);
    let mut written = [0; 0x1C];
    written[..4].copy_from_slice(&(bench.now as u32 - 40).to_le_bytes());
    written[0x10..0x18].copy_from_slice(&1_000_000u64.to_le_bytes());
    written[0x18..].copy_from_slice(&7_000u32.to_le_bytes());
    bench.fpwr(0x0910, &written);
    assert_eq!(bench.read(register::SYSTEM_TIME_DIFFERENCE).nanos().0, 40);
    bench.run_to(bench.now.next_multiple_of(10) + 100);
    assert_eq!(bench.read(register::SYSTEM_TIME), bench.now - 5_760 + 1_000_000 - 7_000);
}

/// Newer cores start the filters anew when their depths are written.
#[test]
fn writing_a_filter_depth() {
    for (chip, newer) in [(&ET1100, false), (&LAN9252, true)] {
        let mut bench = Bench::new(chip);
        let other = Address::Station(StationAddress(1), 0x0910);
        bench.write(register::TIME_FILTER_DEPTH, 0);
        bench.write(register::SPEED_FILTER_DEPTH, 0);
        let ahead = bench.esc.system_time(device(bench.now)).count() as u32 + 300;
        bench.send(Command::Frmw, other, &ahead.to_le_bytes());
        assert_eq!(bench.read(register::SYSTEM_TIME_DIFFERENCE).nanos().0, -300);
        assert_eq!(bench.read(register::SPEED_COUNTER_DIFFERENCE), 1_200);
        bench.write(register::TIME_FILTER_DEPTH, 4);
        let shown = bench.read(register::SYSTEM_TIME_DIFFERENCE).nanos().0;
        assert_eq!(shown, if newer { 0 } else { -300 }, "{}", chip.name);
        assert_eq!(bench.read(register::SPEED_COUNTER_DIFFERENCE), 1_200);
        bench.write(register::SPEED_FILTER_DEPTH, 12);
        let speed = bench.read(register::SPEED_COUNTER_DIFFERENCE);
        assert_eq!(speed, if newer { 0 } else { 1_200 }, "{}", chip.name);
        // The bandwidth resets both on every chip.
        bench.write(register::SPEED_COUNTER_START, 0x1000);
        assert_eq!(bench.read(register::SYSTEM_TIME_DIFFERENCE), SystemTimeDifference(0));
        assert_eq!(bench.read(register::SPEED_COUNTER_DIFFERENCE), 0);
    }
}

/// Another model in the place of the unpublished part: the published limits hold around it.
#[test]
fn the_model_can_be_replaced() {
    /// One unit for each received time, by the sign of the difference.
    struct OneStep;
    impl DriftModel for OneStep {
        fn steer(&self, input: &DriftInput) -> i64 {
            input.applied - (i64::from(input.difference.signum()) << DRIFT_FRACTION)
        }
    }
    static ONE_STEP: OneStep = OneStep;
    let mut bench = Bench::new(&LAN9252);
    bench.esc = bench.esc.with_drift_model(&ONE_STEP);
    bench.write(register::SPEED_FILTER_DEPTH, 0);
    bench.write(register::SPEED_COUNTER_START, 0x0100);
    let other = Address::Station(StationAddress(1), 0x0910);
    for expected in (1..=129).chain([129]) {
        let ahead = bench.esc.system_time(device(bench.now)).count() as u32 + 30_000;
        bench.send(Command::Frmw, other, &ahead.to_le_bytes());
        assert_eq!(bench.read(register::SPEED_COUNTER_DIFFERENCE), expected);
    }
    // The model stays over a reset.
    for byte in *b"RES" {
        bench.fpwr(0x0040, &[byte]);
    }
    bench.write(register::STATION_ADDRESS, 0x1001);
    bench.write(register::SPEED_FILTER_DEPTH, 0);
    bench.send(Command::Frmw, other, &[0xFF, 0xFF, 0xFF, 0x3F]);
    assert_eq!(bench.read(register::SPEED_COUNTER_DIFFERENCE), 1);
}

/// The limits of what the default model asks for, by the smallest step.
#[test]
fn the_default_model_is_limited() {
    let model = ProportionalIntegral::DEFAULT;
    let steer = |start, ns: i64, mean: i64| {
        let filtered = ns << DRIFT_FRACTION;
        let (applied, mean) = (0, mean << DRIFT_FRACTION);
        let (interval, time_depth) = (1_000, 0);
        let difference = ns as i32;
        let input = DriftInput { difference, filtered, interval, time_depth, start, applied, mean };
        model.steer(&input) >> DRIFT_FRACTION
    };
    assert_eq!(steer(0x1000, 999, 0), -3_996);
    assert_eq!(steer(0x1000, 1_000, 0), -4_000);
    assert_eq!(steer(0x1000, 1_001, 0), -4_000);
    assert_eq!(steer(0x1000, -1_001, 70), 4_070);
    assert_eq!([steer(0x0100, 4, 0), steer(0x0400, 4, 0), steer(0x3000, 4, 0)], [-1, -4, -16]);
    // Any input whatever.
    let widest = ProportionalIntegral { gain: u16::MAX, limit: u16::MAX };
    let input = DriftInput {
        difference: i32::MIN,
        filtered: i64::MIN >> 12,
        interval: i64::MAX,
        time_depth: 15,
        start: 0x3FFF,
        applied: 0,
        mean: 0x3F80 << DRIFT_FRACTION,
    };
    assert!(widest.steer(&input) > 0);
}

/// Received times that are far apart: the whole difference until the next, or what the gain asks for if
/// that is less.
#[test]
fn rare_times_steer_by_the_difference_and_no_more() {
    let model = ProportionalIntegral::DEFAULT;
    let speed = |interval: i64, time_depth: u8| {
        let filtered = 100 << DRIFT_FRACTION;
        let (start, applied, mean) = (0x1000, 0, 0);
        let input =
            DriftInput { difference: 100, filtered, interval, time_depth, start, applied, mean };
        // At no difference a unit is worth 1 / (5 A²) of the speed.
        let units = -model.steer(&input) as f64 / f64::from(1 << DRIFT_FRACTION);
        units / (5.0 * 4098.0 * 4098.0) * interval as f64
    };
    assert!((speed(1_000_000, 0) - 4.76).abs() < 0.02, "the gain: {}", speed(1_000_000, 0));
    for interval in [30_000_000, 100_000_000, 1_000_000_000] {
        let corrected = speed(interval, 0);
        assert!((99.9..=100.1).contains(&corrected), "{interval}: {corrected} of 100 ns");
        assert!((speed(interval, 4) - corrected / 4.0).abs() < 0.1, "{interval} filtered");
    }
}

/// Register 0x0932 is limited to the start less 0x7F, on both sides.
#[test]
fn the_range_of_the_speed_counter_difference() {
    for (start, range) in
        [(0x0080, 1), (0x0081, 2), (0x1000, 3_969), (0x3FFE, 16_255), (0x3FFF, 16_256)]
    {
        for sign in [1, -1] {
            let mut bench = Bench::new(&LAN9252);
            bench.write(register::SPEED_FILTER_DEPTH, 0);
            bench.write(register::SPEED_COUNTER_START, start);
            let other = Address::Station(StationAddress(1), 0x0910);
            for _ in 0..200 {
                let copy = bench.esc.system_time(device(bench.now)).count() as i64;
                let received = (copy + sign * 1_000_000_000) as u32;
                bench.send(Command::Frmw, other, &received.to_le_bytes());
            }
            let speed = bench.read(register::SPEED_COUNTER_DIFFERENCE);
            assert_eq!(i64::from(speed), sign * range, "start {start:#x}");
        }
    }
}
