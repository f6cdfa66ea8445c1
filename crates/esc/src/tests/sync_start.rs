//! The start of the SYNC unit: which byte of the start time activates it, its upper half, the
//! shortest cycle.

use super::sync_signals::MS;
use super::*;
use crate::{ET1100, IP_CORE_32, LAN9252};
use isocat_wire::dc::SyncActivation;

const START: u16 = 0x0990;

fn is_active(bench: &mut Bench) -> bool {
    bench.read(register::SYNC_ACTIVATION).active()
}

/// With bit 3 the last byte of the start time activates: the eighth of 64 bits, or the fourth of 32
/// bits or with the extension of bit 4. No other byte activates.
#[test]
fn the_last_byte_activates() {
    for (chip, bits, last) in
        [(&LAN9252, 0x0A, 7), (&LAN9252, 0x1A, 3), (&IP_CORE_32, 0x0A, 3), (&IP_CORE_32, 0x1A, 3)]
    {
        for byte in 0..8 {
            let mut bench = Bench::new(chip);
            bench.write(register::SYNC_ACTIVATION, SyncActivation(bits));
            let there = u16::from(byte < 4 || chip.counts_64_bit());
            assert_eq!(bench.fpwr(START + byte, &[0]), there);
            assert_eq!(is_active(&mut bench), byte == last, "{}: byte {byte}", chip.name);
        }
        // The PDI activates in the same way.
        for byte in [last - 1, last] {
            let mut bench = Bench::new(chip);
            bench.write(register::CYCLIC_UNIT_CONTROL, 1);
            bench.pdi().store(register::SYNC_ACTIVATION, SyncActivation(bits));
            bench.pdi().write(START + byte, &[0]);
            assert_eq!(is_active(&mut bench), byte == last, "{}: byte {byte}", chip.name);
        }
    }
    // Without the enhanced activation there is no bit 3.
    let mut bench = Bench::new(&ET1100);
    bench.write(register::SYNC_ACTIVATION, SyncActivation(0x0A));
    bench.fpwr(START, &[0; 8]);
    assert!(!is_active(&mut bench));
}

/// A 64-bit start time is written in two halves. Lower half first, the start is right; upper half
/// first, the unit starts with half of a time.
#[test]
fn a_start_in_two_halves() {
    for upper_first in [false, true] {
        let mut bench = Bench::new(&LAN9252);
        bench.write(register::SYSTEM_TIME_OFFSET, (5 << 32) - MS);
        bench.write(register::SYNC0_CYCLE, 0);
        bench.write(register::SYNC_ACTIVATION, SyncActivation(0x0A));
        let start = ((5u64 << 32) + 2 * MS).to_le_bytes();
        let (lower, upper) = start.split_at(4);
        let halves = [(START, lower), (START + 4, upper)];
        bench.take_events();
        for number in 0..2 {
            let (address, half) = halves[number ^ usize::from(upper_first)];
            let taken = u16::from(number == 0 || !upper_first);
            assert_eq!(bench.fpwr(address, half), taken, "not while it is active");
        }
        bench.run_to(4 * MS);
        let expected = if upper_first { (MS, 5 << 32) } else { (3 * MS, (5 << 32) + 2 * MS) };
        assert_eq!(bench.take_events(), [(expected.0, EscEvent::Sync0)]);
        assert_eq!(bench.read(register::SYNC_START_TIME), expected.1);
    }
}

/// The extension takes the upper half of the next system time with these lower 32 bits, counted
/// from the frame that wrote byte 0x0993.
#[test]
fn the_upper_half_of_an_extended_start() {
    for (late, upper) in [(0, 5), (1, 6)] {
        let mut bench = Bench::new(&LAN9252);
        bench.write(register::SYSTEM_TIME_OFFSET, 5 << 32);
        bench.write(register::SYNC_ACTIVATION, SyncActivation(0x12));
        let end = (bench.now + duration_ns(60)).next_multiple_of(10);
        bench.fpwr(START, &(end as u32 - late).to_le_bytes());
        assert_eq!(bench.read(register::SYNC_START_TIME), (upper << 32) + end - u64::from(late));
    }
    // Three bytes are not a start time, and the upper half stays as written.
    let mut bench = Bench::new(&LAN9252);
    bench.write(register::SYSTEM_TIME_OFFSET, 5 << 32);
    bench.write(register::SYNC_ACTIVATION, SyncActivation(0x12));
    bench.fpwr(START, &[0xFF; 3]);
    assert_eq!(bench.read(register::SYNC_START_TIME), 0x00FF_FFFF);
}

/// The upper half may change between the write and the start.
#[test]
fn an_extended_start_comes_in_time() {
    for (bits, first) in [(0x12, Some(1_000)), (0x02, None)] {
        let mut bench = Bench::new(&LAN9252);
        bench.write(register::SYSTEM_TIME_OFFSET, (5u64 << 32) - 200_000);
        bench.write(register::SYNC_ACTIVATION, SyncActivation(bits));
        bench.run_to(100_000);
        let begin = 201_000u64;
        assert_eq!(bench.fpwr(START, &1_000u32.to_le_bytes()), 1);
        bench.write(register::SYNC_ACTIVATION, SyncActivation(bits | 1));
        bench.take_events();
        bench.run_to(begin + MS / 2);
        let expected: Vec<_> = first.iter().map(|_| (begin, EscEvent::Sync0)).collect();
        assert_eq!(bench.take_events(), expected, "{bits:#x}");
    }
}

/// Traps of the extension: bit 4 set after the start time extends nothing, and a unit that is
/// activated after its extended start has missed it.
#[test]
fn an_extension_that_comes_too_late() {
    let mut bench = Bench::new(&LAN9252);
    bench.write(register::SYSTEM_TIME_OFFSET, 5 << 32);
    bench.fpwr(START, &(MS as u32).to_le_bytes());
    bench.write(register::SYNC_ACTIVATION, SyncActivation(0x13));
    bench.take_events();
    assert_eq!(bench.read(register::ACTIVATION_STATUS).0 & 4, 4, "the start is implausible");
    bench.run_to(10_000 * MS);
    assert_eq!(bench.take_events(), []);

    for (behind, starts) in [(false, true), (true, false)] {
        let mut bench = Bench::new(&LAN9252);
        bench.write(register::SYSTEM_TIME_OFFSET, 5 << 32);
        bench.write(register::SYNC_ACTIVATION, SyncActivation(0x12));
        bench.fpwr(START, &(MS as u32).to_le_bytes());
        bench.run_to(if behind { MS + 10 } else { MS / 2 });
        bench.write(register::SYNC_ACTIVATION, SyncActivation(0x13));
        bench.take_events();
        // Longer than 32 bits last.
        bench.run_to(10_000 * MS);
        let expected: Vec<_> = starts.then_some((MS, EscEvent::Sync0)).into_iter().collect();
        assert_eq!(bench.take_events(), expected);
    }
}

/// A cycle below 60 ns runs as one of 60 ns and reads back as written; 0 stays a single pulse.
#[test]
fn the_shortest_cycle() {
    let mut short = SII;
    (short[4], short[5]) = (1, 0);
    for (cycle, pulses) in [(1, 101), (59, 101), (60, 101), (61, 99), (70, 86), (0, 1)] {
        let mut bench = Bench::with(&LAN9252, short);
        bench.write(register::SYNC0_CYCLE, cycle);
        let begin = MS;
        bench.write(register::SYNC_START_TIME, begin);
        bench.write(register::SYNC_ACTIVATION, SyncActivation(3));
        bench.take_events();
        bench.run_to(begin + 6_000);
        assert_eq!(bench.take_events().len(), pulses, "{cycle} ns");
        assert_eq!(bench.esc.register(register::SYNC0_CYCLE), cycle);
    }
}
