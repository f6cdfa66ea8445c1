//! SYNC0 and SYNC1.

use super::*;
use crate::{ET1100, IP_CORE_32, LAN9252};
use isocat_wire::dc::{ActivationStatus, AssignActivate, SyncActivation};

pub(super) const MS: u64 = 1_000_000;

/// Starts a train with pulses of `pulse` ticks and returns its start in device time.
pub(super) fn start(bench: &mut Bench, cycle: u32, shift: u32, assign: AssignActivate) -> u64 {
    bench.write(register::SYNC0_CYCLE, cycle);
    bench.write(register::SYNC1_CYCLE, shift);
    let start = (bench.now / MS + 2) * MS;
    bench.write(register::SYNC_START_TIME, start);
    assert_eq!(bench.fpwr(0x0980, &assign.0.to_le_bytes()), 1);
    bench.take_events();
    start
}

/// Device times of SYNC0 and SYNC1 during `cycles` ms, relative to `start`, in quarters of a ms.
pub(super) fn timeline(bench: &mut Bench, start: u64, cycles: u64) -> (Vec<u64>, Vec<u64>) {
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
    // Without mapping there is a pulse, but no AL event.
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
    assert_eq!(bench.esc.sync_pulses_without_edge(), [10, 0]);
    let mut bench = Bench::new(&LAN9252);
    let begin = start(&mut bench, 100_000, 0, AssignActivate::SYNC0);
    bench.run_to(begin + MS);
    assert_eq!(bench.take_events().len(), 11);
    assert_eq!(bench.esc.sync_pulses_without_edge(), [0, 0]);
}

#[test]
fn single_shot() {
    let mut bench = Bench::new(&LAN9252);
    let begin = start(&mut bench, 0, 250_000, AssignActivate::SYNC0_AND_SYNC1);
    assert_eq!(timeline(&mut bench, begin, 9), (vec![0], vec![1]));
    // The unit starts again after deactivation and a new start time.
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

/// A start time in the past: never on 64 bits, after the wrap on 32 bits, at once with the check.
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
    // The near future is 2.1 s: a start beyond it is implausible.
    let mut bench = Bench::new(&LAN9252);
    let (system, now) = late(&mut bench, 0x63, 0u64.wrapping_sub(3_000 * MS));
    assert!(system > now);
    assert_eq!(bench.read(register::ACTIVATION_STATUS).0 & 4, 4);
    // Chips without the enhanced activation have no check.
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
