//! SYNC0 and SYNC1.

use super::*;
use crate::{ET1100, IP_CORE_32, LAN9252};
use isocat_wire::dc::{ActivationStatus, AssignActivate, SyncActivation};

const MS: u64 = 1_000_000;

/// Starts a train with pulses of `pulse` ticks and gives its start in device time.
fn start(bench: &mut Bench, cycle: u32, shift: u32, assign: AssignActivate) -> u64 {
    bench.write(register::SYNC0_CYCLE, cycle);
    bench.write(register::SYNC1_CYCLE, shift);
    let start = (bench.now / MS + 2) * MS;
    bench.write(register::SYNC_START_TIME, start);
    assert_eq!(bench.fpwr(0x0980, &assign.0.to_le_bytes()), 1);
    bench.take_events();
    start
}

/// Device times of SYNC0 and SYNC1 in `cycles` of a ms, relative to `start`, in quarters of a ms.
fn timeline(bench: &mut Bench, start: u64, cycles: u64) -> (Vec<u64>, Vec<u64>) {
    bench.run_to(start + cycles * MS - 1);
    let events = bench.take_events();
    let quarters = |which| {
        let at = events.iter().filter(|(_, event)| *event == which).map(|(at, _)| at - start);
        at.inspect(|at| assert_eq!(at % (MS / 4), 0)).map(|at| at / (MS / 4)).collect()
    };
    (quarters(EscEvent::Sync0), quarters(EscEvent::Sync1))
}

/// The reference timelines of SYNC1, in quarters of the SYNC0 cycle.
#[test]
fn sync1_timelines() {
    for (shift, expected) in [
        (0, [0, 4, 8]),
        (1, [1, 5, 9]),
        (4, [4, 12, 20]),
        (5, [5, 13, 21]),
        (8, [8, 20, 32]),
        (9, [9, 21, 33]),
    ] {
        let mut bench = Bench::new(&LAN9252);
        let shift_ns = shift * (MS as u32 / 4);
        let begin = start(&mut bench, MS as u32, shift_ns, AssignActivate::SYNC0_AND_SYNC1);
        let (sync0, sync1) = timeline(&mut bench, begin, 9);
        assert_eq!(sync0, [0, 4, 8, 12, 16, 20, 24, 28, 32], "shift {shift}");
        assert_eq!(sync1[..3], expected, "shift {shift}");
    }
}

#[test]
fn activation_status_and_next_pulses() {
    let mut bench = Bench::new(&LAN9252);
    let begin = start(&mut bench, MS as u32, 250_000, AssignActivate::SYNC0_AND_SYNC1);
    assert_eq!(bench.read(register::ACTIVATION_STATUS), ActivationStatus(3));
    assert_eq!(bench.read(register::SYNC_START_TIME), begin);
    assert_eq!(bench.read(register::SYNC1_NEXT), begin + 250_000);
    bench.run_to(begin - 1);
    assert_eq!(bench.take_events(), []);
    bench.run_to(begin);
    assert_eq!(bench.take_events(), [(begin, EscEvent::Sync0)]);
    assert_eq!(bench.read(register::ACTIVATION_STATUS), ActivationStatus(2));
    assert_eq!(bench.read(register::SYNC_START_TIME), begin + MS);
    assert_eq!(bench.read(register::SYNC1_NEXT), begin + 250_000);
    bench.run_to(begin + 250_000);
    assert_eq!(bench.read(register::ACTIVATION_STATUS), ActivationStatus(0));
    assert_eq!(bench.read(register::SYNC1_NEXT), begin + MS + 250_000);
    assert_eq!(bench.fpwr(0x0990, &[0; 8]), 0, "not while the unit is active");
    bench.write(register::SYNC_ACTIVATION, SyncActivation(0));
    bench.take_events();
    bench.run_to(bench.now + 5 * MS);
    assert_eq!(bench.take_events(), []);
    assert_eq!(bench.read(register::SYNC_START_TIME), begin, "the start as it was written");
    // An ET1100 has no activation status.
    assert_eq!(Bench::new(&ET1100).fprd(0x0984, 1).1, 0);
}

#[test]
fn only_enabled_outputs_pulse() {
    let mut bench = Bench::new(&LAN9252);
    let begin = start(&mut bench, MS as u32, 0, AssignActivate(0x0500));
    assert_eq!(timeline(&mut bench, begin, 3), (vec![], vec![0, 4, 8]));
    let mut bench = Bench::new(&LAN9252);
    let begin = start(&mut bench, MS as u32, 0, AssignActivate(0x0100));
    assert_eq!(timeline(&mut bench, begin, 3), (vec![], vec![]));
}

#[test]
fn al_events_follow_the_pulse() {
    use register::al_event::{SYNC0, SYNC1};
    let mut bench = Bench::new(&LAN9252);
    let begin = start(&mut bench, MS as u32, 250_000, AssignActivate::SYNC0_AND_SYNC1);
    bench.run_to(begin);
    assert_eq!(bench.pdi().events() & (SYNC0 | SYNC1), SYNC0);
    bench.run_to(begin + 99_999);
    assert_eq!(bench.pdi().events() & (SYNC0 | SYNC1), SYNC0);
    bench.run_to(begin + 100_000);
    assert_eq!(bench.pdi().events() & (SYNC0 | SYNC1), 0);
    bench.run_to(begin + 250_000);
    assert_eq!(bench.pdi().events() & (SYNC0 | SYNC1), SYNC1);
    // Not mapped: the pulse is there, the AL event is not.
    let mut unmapped = SII;
    unmapped[3] = 0x44;
    let mut bench = Bench::with(&LAN9252, unmapped);
    let begin = start(&mut bench, MS as u32, 0, AssignActivate::SYNC0);
    bench.run_to(begin);
    assert_eq!(bench.take_events(), [(begin, EscEvent::Sync0)]);
    assert_eq!(bench.pdi().events() & (SYNC0 | SYNC1), 0);
}

#[test]
fn a_pulse_longer_than_the_cycle_has_one_edge() {
    // 100 us pulses.
    let mut bench = Bench::new(&LAN9252);
    let begin = start(&mut bench, 99_990, 0, AssignActivate::SYNC0);
    bench.run_to(begin + MS);
    assert_eq!(bench.take_events(), [(begin, EscEvent::Sync0)]);
    let mut bench = Bench::new(&LAN9252);
    let begin = start(&mut bench, 100_000, 0, AssignActivate::SYNC0);
    bench.run_to(begin + MS);
    assert_eq!(bench.take_events().len(), 11);
}

#[test]
fn single_shot() {
    let mut bench = Bench::new(&LAN9252);
    let begin = start(&mut bench, 0, 250_000, AssignActivate::SYNC0_AND_SYNC1);
    assert_eq!(timeline(&mut bench, begin, 9), (vec![0], vec![1]));
    // Again after deactivation and a new start.
    bench.write(register::SYNC_ACTIVATION, SyncActivation(0));
    let begin = start(&mut bench, 0, 250_000, AssignActivate::SYNC0_AND_SYNC1);
    assert_eq!(timeline(&mut bench, begin, 9), (vec![0], vec![1]));
}

#[test]
fn acknowledge_mode_waits_for_the_pdi() {
    let mut acknowledge = SII;
    (acknowledge[4], acknowledge[5]) = (0, 0);
    let mut bench = Bench::with(&LAN9252, acknowledge);
    let begin = start(&mut bench, MS as u32, 0, AssignActivate::SYNC0_AND_SYNC1);
    let (sync0, sync1) = timeline(&mut bench, begin, 4);
    assert_eq!((sync0, sync1), (vec![0], vec![0]), "no edge while not acknowledged");
    assert_eq!(bench.read(register::SYNC0_STATUS), 1, "reading from the wire acknowledges nothing");
    assert_eq!(bench.pdi().events() & 0x0C, 0x0C);
    assert_eq!(bench.pdi_read(register::SYNC0_STATUS), 1);
    assert_eq!(bench.pdi().events() & 0x0C, 0x08);
    bench.take_events();
    bench.run_to(begin + 5 * MS);
    assert_eq!(bench.take_events(), [(begin + 5 * MS, EscEvent::Sync0)]);
}

/// A start time that has passed: never on 64 bits, after the wrap on 32, at once with the check.
#[test]
fn a_start_in_the_past() {
    let late = |bench: &mut Bench, bits: u8, by: u64| {
        bench.run_to(10 * MS);
        bench.write(register::SYNC0_CYCLE, MS as u32);
        let offset = bench.esc.register(register::SYSTEM_TIME_OFFSET);
        let system = bench.now.wrapping_add(offset).wrapping_sub(by);
        bench.fpwr(0x0990, &system.to_le_bytes());
        bench.take_events();
        bench.write(register::SYNC_ACTIVATION, SyncActivation(bits));
        (system, bench.now)
    };
    let mut bench = Bench::new(&LAN9252);
    late(&mut bench, 0x03, MS);
    assert_eq!(bench.read(register::ACTIVATION_STATUS), ActivationStatus(5));
    bench.run_to(20_000 * MS);
    assert_eq!(bench.take_events(), []);

    let mut bench = Bench::new(&IP_CORE_32);
    let (system, _) = late(&mut bench, 0x03, MS);
    bench.run_to(system + (1 << 32) + MS);
    let wrapped = (system + (1 << 32)).next_multiple_of(10);
    assert_eq!(bench.take_events()[0], (wrapped, EscEvent::Sync0));

    let mut bench = Bench::new(&LAN9252);
    let (_, now) = late(&mut bench, 0x23, MS);
    bench.run_to(now + 10);
    let at_once = now.next_multiple_of(10);
    assert_eq!(bench.take_events(), [(at_once, EscEvent::Sync0)]);
    assert_eq!(bench.read(register::ACTIVATION_STATUS).0 & 5, 4);
    // Near future as 2.1 s: a start beyond is implausible.
    let mut bench = Bench::new(&LAN9252);
    let (system, now) = late(&mut bench, 0x63, 0u64.wrapping_sub(3_000 * MS));
    assert!(system > now);
    assert_eq!(bench.read(register::ACTIVATION_STATUS).0 & 4, 4);
    // Chips without the enhanced activation know no check.
    let mut bench = Bench::new(&ET1100);
    late(&mut bench, 0x23, MS);
    assert_eq!(bench.read(register::SYNC_ACTIVATION), SyncActivation(0x03));
    bench.run_to(100 * MS);
    assert_eq!(bench.take_events(), []);
}

#[test]
fn auto_activation_extension_and_debug_pulse() {
    let mut bench = Bench::new(&LAN9252);
    bench.write(register::SYSTEM_TIME_OFFSET, 5 << 32);
    bench.write(register::SYNC0_CYCLE, MS as u32);
    bench.write(register::SYNC_ACTIVATION, SyncActivation(0x1A));
    assert_eq!(bench.read(register::SYNC_ACTIVATION), SyncActivation(0x1A));
    let begin = 5 * MS;
    bench.fpwr(0x0990, &(begin as u32).to_le_bytes());
    assert_eq!(bench.read(register::SYNC_ACTIVATION), SyncActivation(0x1B));
    assert_eq!(bench.read(register::SYNC_START_TIME), (5 << 32) + begin);
    bench.run_to(begin);
    assert_eq!(bench.take_events(), [(begin, EscEvent::Sync0)]);

    let mut bench = Bench::new(&LAN9252);
    bench.write(register::SYNC_ACTIVATION, SyncActivation(0x86));
    assert_eq!(bench.read(register::SYNC_ACTIVATION), SyncActivation(0x06));
    let which: Vec<_> = bench.take_events().into_iter().map(|(_, event)| event).collect();
    assert_eq!(which, [EscEvent::Sync0, EscEvent::Sync1]);
}

#[test]
fn the_pdi_may_own_the_unit() {
    let mut bench = Bench::new(&LAN9252);
    bench.write(register::CYCLIC_UNIT_CONTROL, 1);
    assert_eq!(bench.fpwr(0x0981, &[3]), 0);
    assert_eq!(bench.fpwr(0x09A0, &[3; 8]), 0);
    let begin = bench.now.next_multiple_of(10) + 1_000;
    bench.pdi().store(register::SYNC_START_TIME, begin);
    bench.pdi().store(register::SYNC_ACTIVATION, SyncActivation(3));
    bench.run_to(begin);
    assert_eq!(bench.take_events(), [(begin, EscEvent::Sync0)]);
}

#[test]
fn a_changed_offset_misses_pulses_and_floods_nobody() {
    let mut bench = Bench::new(&LAN9252);
    let begin = start(&mut bench, MS as u32, 0, AssignActivate::SYNC0);
    bench.run_to(begin + MS / 2);
    bench.take_events();
    // Years ahead, off the grid by a quarter.
    bench.write(register::SYSTEM_TIME_OFFSET, 700_000_000_000_000_000 + MS / 4);
    bench.run_to(begin + 3 * MS);
    let at: Vec<_> = bench.take_events().into_iter().map(|(at, _)| at - begin).collect();
    assert_eq!(at, [3 * MS / 4, 7 * MS / 4, 11 * MS / 4]);
}

#[test]
fn at_one_instant_the_frame_ends_before_sync() {
    let mut bench = Bench::new(&LAN9252);
    let begin = start(&mut bench, MS as u32, 0, AssignActivate::SYNC0);
    bench.run_to(begin - 5_760);
    bench.events.clear();
    bench.fpwr(0x0200, &[0, 0]);
    assert_eq!(
        bench.events,
        [(begin, EscEvent::FrameEnd { al_events: 0 }), (begin, EscEvent::Sync0)]
    );
}

#[test]
fn a_cycle_below_a_tick_gives_a_pulse_a_tick() {
    let mut short = SII;
    (short[4], short[5]) = (1, 0);
    let mut bench = Bench::with(&LAN9252, short);
    let begin = start(&mut bench, 1, 0, AssignActivate::SYNC0);
    bench.run_to(begin + 1_000);
    assert_eq!(bench.take_events().len(), 101);
}

/// Writes the start time and activates, both in one frame; the instant and system time of the
/// activation.
fn activate_at(bench: &mut Bench, bits: u8, start: impl Fn(u64) -> u64) -> (u64, u64) {
    bench.run_to(bench.now.next_multiple_of(10) + 1_000);
    let activation = [0, bits];
    // Both datagrams in one frame: 14 + 2 + 2 x 12 + 2 + 8 bytes are less than 60.
    let (at, offset) = (bench.now + 5_760, bench.esc.register(register::SYSTEM_TIME_OFFSET));
    let system = at.wrapping_add(offset);
    let start = start(system).to_le_bytes();
    let list = [
        (Command::Fpwr, station(0x0990), &start[..]),
        (Command::Fpwr, station(0x0980), &activation[..]),
    ];
    bench.take_events();
    let answers = bench.frame(true, &list);
    assert_eq!((answers[0].1, answers[1].1, bench.now), (1, 1, at));
    (at, system)
}

/// The first pulse after the start was reached, missed by one ns, or is 1 ns beyond the near future.
#[test]
fn the_start_by_the_smallest_step() {
    const NEAR: u64 = 1 << 31;
    const FAR: u64 = 1 << 32;
    // Chip, bits, start from now, first pulse from now, implausible.
    let table: [(&Chip, u8, i64, Option<u64>, bool); 17] = [
        (&LAN9252, 0x03, 0, Some(0), false),
        (&LAN9252, 0x03, 1, Some(10), false),
        (&LAN9252, 0x03, -1, None, true),
        (&LAN9252, 0x23, 0, Some(0), false),
        (&LAN9252, 0x23, -1, Some(0), true),
        (&LAN9252, 0x23, NEAR as i64, Some(NEAR + 2), false),
        (&LAN9252, 0x63, NEAR as i64 - 1, Some(NEAR + 2), false),
        (&LAN9252, 0x63, NEAR as i64, Some(0), true),
        (&LAN9252, 0x43, NEAR as i64, Some(NEAR + 2), true),
        (&IP_CORE_32, 0x03, 0, Some(0), false),
        (&IP_CORE_32, 0x03, -1, Some(FAR + 4), true),
        (&IP_CORE_32, 0x03, -10, Some(FAR - 6), true),
        (&IP_CORE_32, 0x23, NEAR as i64 - 1, Some(NEAR + 2), false),
        (&IP_CORE_32, 0x23, NEAR as i64, Some(0), true),
        (&IP_CORE_32, 0x23, -1, Some(0), true),
        // Not enhanced: bits 7:3 do not exist.
        (&ET1100, 0x63, -1, None, true),
        (&ET1100, 0x63, NEAR as i64, Some(NEAR + 2), false),
    ];
    for (chip, bits, ahead, first, implausible) in table {
        let name = std::format!("{}, {bits:#x}, {ahead}", chip.name);
        let mut bench = Bench::new(chip);
        bench.write(register::SYNC0_CYCLE, 2_000 * MS as u32);
        let (now, _) = activate_at(&mut bench, bits, |system| system.wrapping_add_signed(ahead));
        if chip.has(register::features::ENHANCED_SYNC_ACTIVATION) {
            let status = bench.esc.pdi(device(now)).load(register::ACTIVATION_STATUS);
            assert_eq!(status.start_implausible(), implausible, "{name}");
        }
        bench.run_to(now + FAR + MS);
        let mut events = bench.take_events();
        events.retain(|(_, event)| *event == EscEvent::Sync0);
        // The first SYNC0 on the first tick at or after its time.
        let due = |after: u64| (now + after) / 10 * 10;
        assert_eq!(events.first().copied(), first.map(|at| (due(at), EscEvent::Sync0)), "{name}");
    }
}

/// The signal's level: as long as the EEPROM says, and never two edges in one.
#[test]
fn the_pulse_has_the_length_of_the_eeprom() {
    for (ticks, length) in [(1u16, 10), (10_000, 100_000), (65_535, 655_350)] {
        let mut configuration = SII;
        configuration[4..6].copy_from_slice(&ticks.to_le_bytes());
        let mut bench = Bench::with(&LAN9252, configuration);
        assert_eq!(bench.read(register::SYNC_PULSE_LENGTH), ticks);
        assert_eq!(bench.fpwr(0x0982, &[1, 0]), 0, "not for ECAT to write");
        bench.pdi().store(register::SYNC_PULSE_LENGTH, 7);
        assert_eq!(bench.read(register::SYNC_PULSE_LENGTH), ticks, "nor for the PDI");
        let begin = start(&mut bench, MS as u32, 0, AssignActivate::SYNC0);
        let level = |bench: &Bench, at: u64| bench.esc.sync_signals(device(at));
        bench.run_to(begin);
        assert_eq!(level(&bench, begin), [true, false]);
        assert_eq!(level(&bench, begin + length - 1), [true, false], "{ticks} ticks");
        assert_eq!(level(&bench, begin + length), [false, false], "{ticks} ticks");
        // Deactivation ends it at once.
        bench.write(register::SYNC_ACTIVATION, SyncActivation(0));
        assert_eq!(level(&bench, bench.now), [false, false]);
    }
}

/// Cycle times written while the unit runs count from the next pulse on.
#[test]
fn changes_while_active() {
    let mut bench = Bench::new(&LAN9252);
    let begin = start(&mut bench, MS as u32, 250_000, AssignActivate::SYNC0_AND_SYNC1);
    bench.run_to(begin + MS / 10);
    // The planned SYNC0 stays; the SYNC1 that waits stays.
    bench.write(register::SYNC0_CYCLE, 2 * MS as u32);
    bench.write(register::SYNC1_CYCLE, 750_000);
    assert_eq!(timeline(&mut bench, begin, 6), (vec![0, 4, 12, 20], vec![1, 7, 15, 23]));
    // An output switched off is silent, and waits for a first pulse when it is on again.
    bench.write(register::SYNC_ACTIVATION, SyncActivation(0x03));
    assert_eq!(timeline(&mut bench, begin, 8), (vec![28], vec![]));
    bench.write(register::SYNC_ACTIVATION, SyncActivation(0x07));
    assert_eq!(bench.read(register::ACTIVATION_STATUS), ActivationStatus(2));
    assert_eq!(timeline(&mut bench, begin, 10), (vec![36], vec![39]));
    assert_eq!(bench.read(register::ACTIVATION_STATUS), ActivationStatus(0));
    // A cycle of 0 makes the next pulse the last, and only a new start brings more.
    bench.write(register::SYNC0_CYCLE, 0);
    assert_eq!(timeline(&mut bench, begin, 20), (vec![44], vec![47]));
    assert_eq!(bench.read(register::SYNC_START_TIME), begin + 11 * MS, "the last");
    assert_eq!(bench.read(register::SYNC1_NEXT), begin + 11 * MS + 750_000);
    bench.write(register::SYNC0_CYCLE, MS as u32);
    assert_eq!(timeline(&mut bench, begin, 30), (vec![], vec![]));
}

/// Acknowledge mode: each output by its own register, and by the PDI alone.
#[test]
fn each_output_is_acknowledged_by_itself() {
    let mut acknowledge = SII;
    (acknowledge[4], acknowledge[5]) = (0, 0);
    let mut bench = Bench::with(&LAN9252, acknowledge);
    let begin = start(&mut bench, MS as u32, 500_000, AssignActivate::SYNC0_AND_SYNC1);
    bench.run_to(begin + MS * 3 / 4);
    assert_eq!(bench.esc.sync_signals(device(bench.now)), [true, true]);
    assert_eq!(bench.read(register::SYNC1_STATUS), 1);
    assert_eq!(bench.pdi_read(register::SYNC1_STATUS), 1);
    assert_eq!(bench.pdi_read(register::SYNC1_STATUS), 0);
    assert_eq!(bench.esc.sync_signals(device(bench.now)), [true, false]);
    bench.take_events();
    // A SYNC0 that falls due meanwhile is not queued.
    bench.run_to(begin + MS * 7 / 4);
    assert_eq!(bench.take_events(), [(begin + MS * 3 / 2, EscEvent::Sync1)]);
    bench.pdi_bytes(0x098E, 2);
    assert_eq!(bench.esc.sync_signals(device(bench.now)), [false, false]);
    bench.run_to(begin + MS * 2);
    assert_eq!(bench.take_events(), [(begin + MS * 2, EscEvent::Sync0)]);
    // In pulse mode the status stays 0.
    let mut bench = Bench::new(&LAN9252);
    let begin = start(&mut bench, MS as u32, 0, AssignActivate::SYNC0);
    bench.run_to(begin + 10);
    assert_eq!(bench.pdi_read(register::SYNC0_STATUS), 0);
    assert_eq!(bench.esc.sync_signals(device(bench.now)), [true, false]);
}

/// An offset that moves back repeats no pulse: the planned one waits until its time comes again.
#[test]
fn an_offset_moved_back_delays_the_next_pulse() {
    for (chip, by) in [(&LAN9252, 3), (&IP_CORE_32, 3)] {
        let mut bench = Bench::new(chip);
        let begin = start(&mut bench, MS as u32, 0, AssignActivate::SYNC0);
        bench.run_to(begin + MS / 2);
        bench.take_events();
        let back = 0u64.wrapping_sub(by * MS).to_le_bytes();
        bench.fpwr(0x0920, &back);
        bench.run_to(begin + 6 * MS - 1);
        let at: Vec<_> = bench.take_events().into_iter().map(|(at, _)| at - begin).collect();
        assert_eq!(at, [4 * MS, 5 * MS], "{}", chip.name);
    }
}

/// A 32-bit start time, written to a 64-bit unit whose upper half has moved on.
#[test]
fn a_start_of_32_bits_is_the_next_one_of_that_time() {
    for (bits, first) in [(0x13, Some(1_000)), (0x03, None)] {
        let mut bench = Bench::new(&LAN9252);
        bench.write(register::SYSTEM_TIME_OFFSET, (5u64 << 32) - 200_000);
        bench.write(register::SYNC0_CYCLE, MS as u32);
        bench.run_to(100_000);
        // The upper half turns over between now and the start.
        let (begin, list) = (201_000u64, 1_000u32.to_le_bytes());
        assert_eq!(bench.fpwr(0x0990, &list), 1);
        bench.take_events();
        bench.write(register::SYNC_ACTIVATION, SyncActivation(bits));
        bench.run_to(begin + MS / 2);
        let expected: Vec<_> = first.iter().map(|_| (begin, EscEvent::Sync0)).collect();
        assert_eq!(bench.take_events(), expected, "{bits:#x}");
    }
}

/// The next pulse in halves, each side for itself; at rest it is the start time as written.
#[test]
fn halves_of_the_next_pulse_belong_together() {
    let mut bench = Bench::new(&LAN9252);
    bench.write(register::SYSTEM_TIME_OFFSET, (5u64 << 32) - 10 * MS);
    bench.write(register::SYNC0_CYCLE, MS as u32);
    let begin = (5u64 << 32) - MS;
    bench.write(register::SYNC_START_TIME, begin);
    assert_eq!(bench.pdi_bytes(0x0994, 4), [4, 0, 0, 0], "at rest nothing runs");
    bench.write(register::SYNC_ACTIVATION, SyncActivation(3));
    assert_eq!(bench.fprd(0x0990, 4).0, begin.to_le_bytes()[..4]);
    bench.run_to(10 * MS - MS / 2);
    assert_eq!(bench.pdi_bytes(0x0990, 8), (begin + MS).to_le_bytes());
    assert_eq!(bench.fprd(0x0994, 4).0, [4, 0, 0, 0]);
    assert_eq!(bench.fprd(0x0990, 4).0, [0; 4]);
    assert_eq!(bench.fprd(0x0994, 4).0, [5, 0, 0, 0]);
}
