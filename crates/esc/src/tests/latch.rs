//! The latch unit.

use super::*;
use crate::{ET1200, LAN9252, LatchInput};
use isocat_wire::fmmu::Fmmu;
use isocat_wire::register::al_event::LATCH;

const LATCHED: EscEvent = EscEvent::Latched { al_event: false };
/// Single events on both edges, PDI owns both units.
const PDI_OWNS: u8 = 0x30;

impl Bench {
    /// Sets the pin of `input` to this level from `at` on.
    fn pin(&mut self, input: LatchInput, level: bool, at: u64) {
        self.run_to(at);
        self.esc.set_latch_input(input, level, device(at));
    }

    fn ecat_request(&mut self) -> u16 {
        self.read(register::ECAT_EVENT_REQUEST) & 1
    }
}

/// An edge is stamped with the first tick at or after it, in system time.
#[test]
fn edges_are_sampled_on_the_tick() {
    for (after, tick) in [(0, 0), (1, 10), (9, 10), (10, 10), (11, 20)] {
        let mut bench = Bench::new(&LAN9252);
        bench.write(register::SYSTEM_TIME_OFFSET, 5);
        bench.pin(LatchInput::Latch0, true, 1_000_000 + after);
        bench.take_events();
        bench.run_to(1_000_000 + tick);
        assert_eq!(bench.take_events(), [(1_000_000 + tick, LATCHED)]);
        assert_eq!(bench.read(register::LATCH0_POSITIVE), 1_000_005 + tick);
        assert_eq!(bench.read(register::LATCH0_NEGATIVE), 0);
        assert_eq!(bench.read(register::LATCH1_POSITIVE), 0);
    }
}

/// With a corrected clock, whose ticks are 9 to 11 ns, a stamp is up to 11 ns late and never early.
#[test]
fn the_jitter_is_that_of_a_corrected_tick() {
    let mut bench = Bench::new(&LAN9252);
    bench.write(register::SPEED_FILTER_DEPTH, 0);
    bench.write(register::SPEED_COUNTER_START, 0x0100);
    let other = Address::Station(StationAddress(1), 0x0910);
    for _ in 0..20 {
        let ahead = bench.esc.system_time(device(bench.now)).count() as u32 + 5_000;
        bench.send(Command::Frmw, other, &ahead.to_le_bytes());
    }
    assert_eq!(bench.read(register::SPEED_COUNTER_DIFFERENCE), 129, "each 129th tick is one of 11");
    let (mut least, mut most) = (i64::MAX, i64::MIN);
    for edge in 0..20_000u64 {
        let at = bench.now.next_multiple_of(10) + 1_000 + edge % 10;
        bench.pin(LatchInput::Latch1, edge % 2 == 0, at);
        // The edge lies between two ticks of the clock.
        let ns = (edge % 10) as i64;
        let before = bench.esc.system_time(device(at)).count() as i64 + ns;
        bench.run_to(at + 10);
        let register =
            if edge % 2 == 0 { register::LATCH1_POSITIVE } else { register::LATCH1_NEGATIVE };
        let late = bench.pdi_read(register) as i64 - before;
        (least, most) = (least.min(late), most.max(late));
        bench.events.clear();
    }
    assert_eq!((least, most), (0, 10), "an 11 ns tick begins after 1 ns at the earliest");
}

/// A level that changes and changes back between two ticks is not seen.
#[test]
fn a_pulse_between_two_ticks_is_not_seen() {
    let mut bench = Bench::new(&LAN9252);
    bench.pin(LatchInput::Latch0, true, 1_000_001);
    bench.pin(LatchInput::Latch0, false, 1_000_009);
    bench.run_to(1_100_000);
    assert_eq!(bench.take_events(), []);
    assert_eq!(bench.read(register::LATCH0_STATUS), 0);
    // A pulse across two ticks is seen.
    bench.pin(LatchInput::Latch0, true, 1_200_001);
    bench.pin(LatchInput::Latch0, false, 1_200_011);
    bench.run_to(1_300_000);
    assert_eq!(bench.take_events(), [(1_200_010, LATCHED), (1_200_020, LATCHED)]);
    assert_eq!(bench.read(register::LATCH0_POSITIVE), 1_200_010);
    assert_eq!(bench.read(register::LATCH0_NEGATIVE), 1_200_020);
}

/// Continuous mode: every edge overwrites the time, the status shows only the pin, and there is no
/// event.
#[test]
fn continuous_mode_keeps_the_last_edge() {
    let mut bench = Bench::new(&LAN9252);
    for owner in [0, PDI_OWNS] {
        bench.write(register::CYCLIC_UNIT_CONTROL, owner);
        for _ in 0..3 {
            let at = bench.now.next_multiple_of(10) + 100;
            bench.pin(LatchInput::Latch1, true, at);
            bench.run_to(at);
            assert_eq!(bench.read(register::LATCH1_STATUS), 4);
            assert_eq!(bench.pdi_read(register::LATCH1_POSITIVE), at);
            assert_eq!((bench.ecat_request(), bench.pdi().events() & LATCH), (0, 0));
            let at = bench.now.next_multiple_of(10) + 100;
            bench.pin(LatchInput::Latch1, false, at);
            bench.run_to(at);
            assert_eq!(bench.read(register::LATCH1_STATUS), 0);
            assert_eq!(bench.pdi_read(register::LATCH1_NEGATIVE), at);
        }
    }
}

/// Single event, one edge after the other: the first is kept until the owner has read it.
#[test]
fn single_events_wait_for_their_owner() {
    for owner in [0, PDI_OWNS] {
        let mut bench = Bench::new(&LAN9252);
        let ecat = owner == 0;
        bench.write(register::LATCH0_CONTROL, 3);
        bench.write(register::CYCLIC_UNIT_CONTROL, owner);
        for (level, at) in [(true, 1_000_000), (false, 1_100_000), (true, 1_200_000)] {
            bench.pin(LatchInput::Latch0, level, at);
        }
        bench.run_to(1_300_000);
        let al_event = EscEvent::Latched { al_event: !ecat };
        assert_eq!(bench.take_events(), [(1_000_000, al_event), (1_100_000, LATCHED)]);
        assert_eq!(bench.read(register::LATCH0_STATUS), 7);
        assert_eq!(bench.ecat_request(), u16::from(ecat));
        assert_eq!(bench.pdi().events() & LATCH, if ecat { 0 } else { LATCH });
        // A read by the other side has no effect.
        let read = |bench: &mut Bench, ecat: bool, register| match ecat {
            true => bench.read(register),
            false => bench.pdi_read(register),
        };
        assert_eq!(read(&mut bench, !ecat, register::LATCH0_POSITIVE), 1_000_000);
        assert_eq!(bench.read(register::LATCH0_STATUS), 7);
        // The owner frees each edge separately.
        assert_eq!(read(&mut bench, ecat, register::LATCH0_POSITIVE), 1_000_000);
        assert_eq!(bench.read(register::LATCH0_STATUS), 6);
        assert_eq!(bench.ecat_request(), u16::from(ecat));
        assert_eq!(read(&mut bench, ecat, register::LATCH0_NEGATIVE), 1_100_000);
        assert_eq!(bench.read(register::LATCH0_STATUS), 4);
        assert_eq!((bench.ecat_request(), bench.pdi().events() & LATCH), (0, 0));
        // The next edge is stored then.
        bench.pin(LatchInput::Latch0, false, 2_000_000);
        bench.pin(LatchInput::Latch0, true, 2_100_000);
        bench.run_to(2_200_000);
        assert_eq!(bench.read(register::LATCH0_STATUS), 7);
        assert_eq!(read(&mut bench, ecat, register::LATCH0_POSITIVE), 2_100_000);
    }
}

/// When the unit changes hands, a stored edge raises the event of the new owner.
#[test]
fn an_edge_goes_with_its_unit() {
    let mut bench = Bench::new(&LAN9252);
    bench.write(register::LATCH1_CONTROL, 1);
    bench.pin(LatchInput::Latch1, true, 1_000_000);
    bench.run_to(1_000_100);
    assert_eq!((bench.ecat_request(), bench.pdi().events() & LATCH), (1, 0));
    // Unit 0 has no stored edge.
    bench.fpwr(0x0980, &[0x10]);
    assert_eq!(bench.last_al_events(), 0);
    bench.fpwr(0x0980, &[0x20]);
    assert_eq!(bench.last_al_events(), LATCH);
    assert_eq!((bench.ecat_request(), bench.pdi().events() & LATCH), (0, LATCH));
}

/// Single on one edge, continuous on the other.
#[test]
fn each_edge_has_its_mode() {
    let mut bench = Bench::new(&LAN9252);
    bench.write(register::LATCH0_CONTROL, 2);
    for cycle in 0..3 {
        bench.pin(LatchInput::Latch0, true, 1_000_000 + cycle * 1_000);
        bench.pin(LatchInput::Latch0, false, 1_000_500 + cycle * 1_000);
    }
    bench.run_to(1_100_000);
    assert_eq!(bench.read(register::LATCH0_STATUS), 2);
    assert_eq!(bench.pdi_read(register::LATCH0_POSITIVE), 1_002_000, "the last");
    assert_eq!(bench.pdi_read(register::LATCH0_NEGATIVE), 1_000_500, "the first");
    // Without a single event no time is kept.
    bench.write(register::LATCH0_CONTROL, 0);
    assert_eq!(bench.read(register::LATCH0_STATUS), 0);
    bench.write(register::LATCH0_CONTROL, 2);
    assert_eq!(bench.read(register::LATCH0_STATUS), 0);
}

/// A read in a frame that proves bad acknowledges nothing; a good frame acknowledges at its end.
#[test]
fn a_bad_frame_acknowledges_nothing() {
    let mut bench = Bench::new(&LAN9252);
    bench.write(register::LATCH0_CONTROL, 1);
    bench.pin(LatchInput::Latch0, true, 1_000_000);
    bench.run_to(1_000_100);
    bench.frame(false, &[(Command::Fprd, station(0x09B0), &[0; 8])]);
    assert_eq!(bench.read(register::LATCH0_STATUS), 5);
    // Upper bytes alone acknowledge nothing either.
    bench.fprd(0x09B4, 4);
    assert_eq!(bench.read(register::LATCH0_STATUS), 5);
    let list = [
        (Command::Fprd, station(0x09B0), &[0; 4][..]),
        (Command::Fprd, station(0x09AE), &[0; 1][..]),
    ];
    assert_eq!(bench.frame(true, &list)[1].0, [5], "within the frame it is still there");
    assert_eq!(bench.read(register::LATCH0_STATUS), 4);
}

/// The upper bytes belong to the moment at which the side read the first byte.
#[test]
fn halves_of_a_time_belong_together() {
    let mut bench = Bench::new(&LAN9252);
    bench.write(register::SYSTEM_TIME_OFFSET, (7 << 32) - 1_000_000);
    // 2^32 ns are not a whole number of ticks.
    let (before, after) = (7u64 << 32, (8u64 << 32) + 14);
    bench.pin(LatchInput::Latch0, true, 1_000_000);
    bench.run_to(1_000_000);
    let lower = |time: u64| time.to_le_bytes()[..4].to_vec();
    let upper = |time: u64| time.to_le_bytes()[4..].to_vec();
    assert_eq!(bench.pdi_bytes(0x09B0, 4), lower(before));
    assert_eq!(bench.fprd(0x09B0, 4).0, lower(before));
    bench.pin(LatchInput::Latch0, false, 2_000_000);
    bench.pin(LatchInput::Latch0, true, 1_000_010 + (1 << 32));
    bench.run_to(1_000_020 + (1 << 32));
    assert_eq!(bench.fprd(0x09B4, 4).0, upper(before), "one side");
    assert_eq!(bench.fprd(0x09B0, 4).0, lower(after));
    assert_eq!(bench.fprd(0x09B4, 4).0, upper(after));
    assert_eq!(bench.pdi_bytes(0x09B4, 4), upper(before), "the other side");
    assert_eq!(bench.pdi_bytes(0x09B0, 8), after.to_le_bytes());
}

#[test]
fn only_the_owner_writes_the_control() {
    let mut bench = Bench::new(&LAN9252);
    bench.write(register::CYCLIC_UNIT_CONTROL, 0x10);
    // Unit 0 belongs to the PDI, unit 1 does not.
    assert_eq!(bench.fpwr(0x09A8, &[1]), 0);
    assert_eq!(bench.fpwr(0x09A9, &[2]), 1);
    bench.pdi().store(register::LATCH0_CONTROL, 3);
    bench.pdi().store(register::LATCH1_CONTROL, 3);
    assert_eq!(bench.read(register::LATCH0_CONTROL), 3);
    assert_eq!(bench.read(register::LATCH1_CONTROL), 2);
    // Neither side can write times and status.
    assert_eq!(bench.bwr(0x09AE, &[0xFF; 34]), 0);
}

/// A latch unit that the EEPROM has switched off sees nothing.
#[test]
fn without_latch_unit_nothing_happens() {
    let mut off = SII;
    off[1] = 0x06;
    let mut bench = Bench::with(&ET1200, off);
    bench.pin(LatchInput::Latch0, true, 1_000_000);
    bench.run_to(1_100_000);
    assert_eq!(bench.take_events(), []);
    assert_eq!(bench.fprd(0x09A8, 2).1, 0);
    assert_eq!(bench.fprd(0x09AE, 34).1, 0);
    assert_eq!(bench.fprd(0x0990, 8).1, 1, "the SYNC unit is there");
}

/// A reset clears the times, but the level of the pin stays.
#[test]
fn a_reset_leaves_the_pins() {
    let mut bench = Bench::new(&LAN9252);
    bench.pin(LatchInput::Latch1, true, 1_000_000);
    bench.run_to(1_000_100);
    for byte in *b"RES" {
        bench.fpwr(0x0040, &[byte]);
    }
    bench.write(register::STATION_ADDRESS, 0x1001);
    assert_eq!(bench.read(register::LATCH1_POSITIVE), 0);
    assert_eq!(bench.read(register::LATCH1_STATUS), 4);
}

/// A FMMU maps the unit into the process image: what arrives there are the registers, and as any
/// read of them by the owner it frees the edge.
#[test]
fn a_fmmu_reads_the_unit() {
    let mut bench = Bench::new(&LAN9252);
    bench.write(register::LATCH0_CONTROL, 1);
    bench.pin(LatchInput::Latch0, true, 1_000_000);
    bench.run_to(1_100_000);
    let fmmu = Fmmu::bytes(0, 10, register::LATCH0_STATUS.address, Fmmu::READ);
    bench.fpwr(0x0600, &fmmu.to_bytes());
    let mut expected = vec![0x05, 0x00];
    expected.extend(1_000_000_u64.to_le_bytes());
    // As the inputs of LRW, whatever outputs travel in the same bytes.
    assert_eq!(bench.send(Command::Lrw, Address::Logical(0), &[0xAA; 10]), (expected.clone(), 1));
    expected[0] = 0x04;
    assert_eq!(bench.send(Command::Lrd, Address::Logical(0), &[0; 10]), (expected, 1));
}
