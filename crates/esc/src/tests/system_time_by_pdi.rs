//! A system time that the PDI sets, in a device that bridges two segments.

use super::*;
use crate::{IP_CORE_32, LAN9252, LatchInput};
use isocat_wire::dc::SystemTimeDifference;

static BRIDGE: Chip = Chip { system_time_by_pdi: true, ..LAN9252 };

/// Raises LATCH0 at the instant `at` and lowers it again.
fn edge(bench: &mut Bench, at: u64) {
    bench.run_to(at);
    bench.esc.set_latch_input(LatchInput::Latch0, true, device(at));
    bench.run_to(at + 100);
    bench.esc.set_latch_input(LatchInput::Latch0, false, device(at + 100));
    bench.run_to(at + 200);
}

fn difference(bench: &Bench) -> SystemTimeDifference {
    bench.esc.register(register::SYSTEM_TIME_DIFFERENCE)
}

/// ECAT reads the time and cannot write its unit; a drift datagram passes unused.
#[test]
fn ecat_reads_only() {
    for (chip, wkc) in [(&BRIDGE, 0), (&LAN9252, 1)] {
        let mut bench = Bench::new(chip);
        for (address, len) in
            [(0x0910, 4), (0x0910, 8), (0x0920, 8), (0x0928, 4), (0x0930, 2), (0x0934, 2)]
        {
            assert_eq!(bench.fpwr(address, &vec![1; len]), wkc, "{}: {address:#06x}", chip.name);
        }
        let other = Address::Station(StationAddress(1), 0x0910);
        assert_eq!(bench.send(Command::Frmw, other, &[9; 8]).1, wkc);
        assert_eq!(bench.fprd(0x0910, 8).1, 1);
        assert_eq!(bench.bwr(0x0900, &[0]), 1, "receive times are ECAT's");
        assert_eq!(bench.fpwr(0x0980, &[0]), 1);
    }
}

/// The written time is compared with the last positive edge of LATCH0, in the width of 32 bits and
/// without the delay, when its last byte is written.
#[test]
fn the_last_byte_compares_with_the_edge() {
    let mut bench = Bench::new(&BRIDGE);
    bench.pdi().store(register::TIME_FILTER_DEPTH, 0);
    bench.pdi().store(register::SYSTEM_TIME_OFFSET, 7 << 32);
    bench.pdi().store(register::SYSTEM_TIME_DELAY, 70);
    edge(&mut bench, 1_000_000);
    assert_eq!(bench.esc.system_time(device(1_000_000)).count(), (7 << 32) + 1_000_000);
    let later = 1_000_300u32.to_le_bytes();
    bench.pdi().write(0x0910, &later[..3]);
    assert_eq!(difference(&bench), SystemTimeDifference(0), "not whole");
    bench.pdi().write(0x0910, &later);
    assert_eq!(difference(&bench), SystemTimeDifference(0x8000_012C), "300 ns behind");
    bench.pdi().store(register::SPEED_COUNTER_START, 0x1000);
    assert_eq!(difference(&bench), SystemTimeDifference(0));
    // Bytes that are not written count as equal.
    bench.pdi().write(0x0913, &later[3..]);
    assert_eq!(difference(&bench).magnitude(), 0);
    bench.pdi().write(0x0910, &999_700u32.to_le_bytes());
    assert_eq!(difference(&bench), SystemTimeDifference(300));
    // A negative edge, an edge of LATCH1 and the time of the write do not count.
    bench.run_to(1_500_000);
    bench.pdi().write(0x0910, &999_700u32.to_le_bytes());
    assert_eq!(difference(&bench), SystemTimeDifference(300));
}

/// The written times steer the clock as drift datagrams do: here one edge per millisecond from a
/// clock that runs 80 ppm faster.
#[test]
fn the_clock_follows_the_edges() {
    let mut bench = Bench::new(&BRIDGE);
    bench.pdi().write(0x0934, &[4, 6]);
    bench.pdi().store(register::SPEED_COUNTER_START, 0x1000);
    let reference = |at: u64| at + at * 80 / 1_000_000;
    let mut before = 0;
    for number in 1..=20_000u64 {
        let at = number * 1_000_000;
        edge(&mut bench, at);
        bench.pdi().write(0x0910, &(reference(at) as u32).to_le_bytes());
        bench.events.clear();
        let apart = bench.esc.system_time(device(at)).count() as i64 - reference(at) as i64;
        before = if number == 10 { apart } else { before };
        assert!(number < 20_000 || apart.abs() <= 20, "{apart} ns at the end");
    }
    assert!(before < -700, "it was led: {before} ns after ten edges");
    let speed = bench.esc.register(register::SPEED_COUNTER_DIFFERENCE);
    assert!((2_985..3_085).contains(&speed), "{speed}, where 3035 are 80 ppm");
}

/// On other chips the PDI cannot write the unit.
#[test]
fn other_chips_are_not_led() {
    for chip in [&LAN9252, &IP_CORE_32] {
        let mut bench = Bench::new(chip);
        bench.write(register::TIME_FILTER_DEPTH, 0);
        edge(&mut bench, 1_000_000);
        bench.pdi().write(0x0910, &9_000_000u32.to_le_bytes());
        bench.pdi().store(register::SYSTEM_TIME_OFFSET, 77);
        bench.pdi().store(register::SPEED_COUNTER_START, 0x0200);
        assert_eq!(difference(&bench), SystemTimeDifference(0));
        assert_eq!(bench.read(register::SYSTEM_TIME_OFFSET), 0);
        assert_eq!(bench.read(register::SPEED_COUNTER_START), 0x1000);
    }
}
