//! The drift loop's registers, its limits and its model.

use super::*;
use crate::{DriftLaw, ET1100, LAN9252};
use isocat_wire::dc::SystemTimeDifference;

/// A difference of zero shows as ahead.
#[test]
fn a_difference_of_zero_is_ahead_or_equal() {
    let mut bench = Bench::new(&ET1100);
    bench.write(register::TIME_FILTER_DEPTH, 0);
    bench.fpwr(0x0930, &[0x00, 0x10]);
    assert_eq!(bench.read(register::SYSTEM_TIME_DIFFERENCE), SystemTimeDifference(0));
    bench.run_to(bench.now.next_multiple_of(10) + 100);
    let equal = (bench.now as u32).to_le_bytes();
    bench.send(Command::Frmw, Address::Station(StationAddress(1), 0x0910), &equal);
    assert_eq!(bench.read(register::SYSTEM_TIME_DIFFERENCE), SystemTimeDifference(0));
    assert_eq!(bench.esc.system_time_difference().0, 0);
}

/// One datagram writes offset and delay, as a MainDevice does. A time received in the same frame is
/// compared with the old values.
#[test]
fn offset_and_delay_come_into_force_together() {
    let mut bench = Bench::new(&LAN9252);
    // This law makes no steps of the local time.
    bench.esc = bench.esc.with_drift_law(DriftLaw::PROPORTIONAL);
    bench.write(register::TIME_FILTER_DEPTH, 0);
    bench.run_to(bench.now.next_multiple_of(10) + 100);
    let mut written = [0; 0x1C];
    written[..4].copy_from_slice(&(bench.now as u32 - 40).to_le_bytes());
    written[0x10..0x18].copy_from_slice(&1_000_000u64.to_le_bytes());
    written[0x18..].copy_from_slice(&7_000u32.to_le_bytes());
    bench.fpwr(0x0910, &written);
    assert_eq!(bench.esc.system_time_difference().0, 40);
    bench.run_to(bench.now.next_multiple_of(10) + 100);
    assert_eq!(bench.read(register::SYSTEM_TIME), bench.now - 5_760 + 1_000_000 - 7_000);
}

/// Newer cores restart the filters when their depths are written.
#[test]
fn writing_a_filter_depth() {
    for (chip, newer) in [(&ET1100, false), (&LAN9252, true)] {
        let mut bench = Bench::new(chip);
        bench.esc = bench.esc.with_drift_law(DriftLaw::PROPORTIONAL);
        let other = Address::Station(StationAddress(1), 0x0910);
        bench.write(register::TIME_FILTER_DEPTH, 0);
        bench.write(register::SPEED_FILTER_DEPTH, 0);
        let ahead = bench.esc.system_time(device(bench.now)).count() as u32 + 300;
        bench.send(Command::Frmw, other, &ahead.to_le_bytes());
        assert_eq!(bench.esc.system_time_difference().0, -300);
        assert_eq!(bench.read(register::SPEED_COUNTER_DIFFERENCE), 1_200);
        bench.write(register::TIME_FILTER_DEPTH, 4);
        let shown = bench.esc.system_time_difference().0;
        assert_eq!(shown, if newer { 0 } else { -300 }, "{}", chip.name);
        assert_eq!(bench.read(register::SPEED_COUNTER_DIFFERENCE), 1_200);
        bench.write(register::SPEED_FILTER_DEPTH, 12);
        let speed = bench.read(register::SPEED_COUNTER_DIFFERENCE);
        assert_eq!(speed, if newer { 0 } else { 1_200 }, "{}", chip.name);
        // A write of the bandwidth resets both on every chip.
        bench.write(register::SPEED_COUNTER_START, 0x1000);
        assert_eq!(bench.read(register::SYSTEM_TIME_DIFFERENCE), SystemTimeDifference(0));
        assert_eq!(bench.read(register::SPEED_COUNTER_DIFFERENCE), 0);
    }
}

/// The law of the chip is replaced by another, which stays over a reset.
#[test]
fn the_law_can_be_replaced() {
    let mut bench = Bench::new(&LAN9252);
    bench.esc = bench.esc.with_drift_law(DriftLaw::PROPORTIONAL);
    for _ in 0..2 {
        bench.write(register::SPEED_FILTER_DEPTH, 0);
        bench.write(register::TIME_FILTER_DEPTH, 0);
        let other = Address::Station(StationAddress(1), 0x0910);
        let ahead = bench.esc.system_time(device(bench.now)).count() as u32 + 300;
        bench.send(Command::Frmw, other, &ahead.to_le_bytes());
        assert_eq!(bench.read(register::SPEED_COUNTER_DIFFERENCE), 1_200);
        for byte in *b"RES" {
            bench.fpwr(0x0040, &[byte]);
        }
        bench.write(register::STATION_ADDRESS, 0x1001);
    }
}

/// One huge difference arrives. At the usual depth the speed changes by one unit at most, and the
/// time moves by the largest step.
#[test]
fn one_huge_difference() {
    for (law, unit) in [(DriftLaw::HOLD, -1), (DriftLaw::BLOCK, 0), (DriftLaw::PROPORTIONAL, -1)] {
        let mut bench = Bench::new(&ET1100);
        bench.esc = bench.esc.with_drift_law(law);
        bench.write(register::TIME_FILTER_DEPTH, 0);
        bench.fpwr(0x0930, &[0x00, 0x10]);
        bench.run_to(bench.now + 200_000_000);
        let behind = bench.esc.system_time(device(bench.now)).count() as u32;
        let behind = behind.wrapping_sub(1_691_400_000).to_le_bytes();
        let free = |bench: &Bench| {
            bench.esc.local_time(device(bench.now)).count() as i64 - bench.now as i64
        };
        let before = free(&bench);
        bench.send(Command::Frmw, Address::Station(StationAddress(1), 0x0910), &behind);
        let moved = free(&bench) - before;
        assert_eq!(bench.read(register::SPEED_COUNTER_DIFFERENCE), unit, "{law}");
        let step = if law == DriftLaw::PROPORTIONAL { -10..=0 } else { -110..=-90 };
        assert!(step.contains(&moved), "{law}: {moved}");
    }
}

/// The laws that the record admits compare zeros like any other value: a captured chip kept a trace
/// of them.
#[test]
fn zeros_are_compared() {
    for (law, moves) in
        [(DriftLaw::HOLD, true), (DriftLaw::BLOCK, true), (DriftLaw::PROPORTIONAL, false)]
    {
        let mut bench = Bench::new(&ET1100);
        bench.esc = bench.esc.with_drift_law(law);
        bench.write(register::TIME_FILTER_DEPTH, 0);
        bench.run_to(1_000_000_000);
        let free = bench.esc.local_time(device(bench.now)).count() as i64 - bench.now as i64;
        bench.bwr(0x0910, &[0; 32]);
        let now = bench.esc.local_time(device(bench.now)).count() as i64 - bench.now as i64;
        assert_eq!((now - free).abs() > 10, moves, "{law}: {}", now - free);
        let shown = bench.esc.system_time_difference().0;
        assert!((999_990_000..=1_000_000_100).contains(&shown), "{law}: {shown}");
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
