//! SYNC0 and SYNC1 at the edges: starts by the smallest step, levels, changes while they run.

use super::sync_signals::{MS, start, timeline};
use super::*;
use crate::{ET1100, IP_CORE_32, LAN9252};
use isocat_wire::dc::{ActivationStatus, AssignActivate, SyncActivation};

/// Writes the start time and activates the unit, both in one frame. Returns the instant and the
/// system time of the activation.
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

/// The first pulse when the start is just reached, is missed by 1 ns, or lies 1 ns beyond the near
/// future.
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

/// The signal stays active for the length that the EEPROM sets, and never has two edges in one
/// pulse.
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
    // The planned SYNC0 stays, and so does the SYNC1 that waits.
    bench.write(register::SYNC0_CYCLE, 2 * MS as u32);
    bench.write(register::SYNC1_CYCLE, 750_000);
    assert_eq!(timeline(&mut bench, begin, 6), (vec![0, 4, 12, 20], vec![1, 7, 15, 23]));
    // An output that is switched off gives no pulse; switched on again it waits for a first pulse.
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

/// Acknowledge mode: each output is acknowledged by its own register, and only by the PDI.
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
    // A SYNC0 that falls due meanwhile is lost.
    bench.run_to(begin + MS * 7 / 4);
    assert_eq!(bench.take_events(), [(begin + MS * 3 / 2, EscEvent::Sync1)]);
    assert_eq!(bench.esc.sync_pulses_without_edge(), [1, 0]);
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

/// The next pulse is read in halves, consistently for each side; at rest it is the start time as
/// written.
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
