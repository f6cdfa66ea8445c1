//! Three buffers, FMMUs, the watchdog.

use super::*;
use crate::{ET1100, LAN9252};
use isocat_wire::fmmu::Fmmu;
use isocat_wire::sync_manager::SyncManager;

/// Outputs of 4 bytes at 0x1100 (SM2), inputs of 6 bytes at 0x1180 (SM3), both at logical 0x10000.
fn process_data(chip: &'static Chip) -> Bench {
    let mut bench = Bench::new(chip);
    let outputs = SyncManager::new(0x1100, 4, SyncManager::OUTPUTS, true);
    let inputs = SyncManager::new(0x1180, 6, SyncManager::INPUTS, true);
    bench.fpwr(0x0810, &[outputs.to_bytes(), inputs.to_bytes()].concat());
    bench.fpwr(0x0600, &Fmmu::bytes(0x1_0000, 4, 0x1100, Fmmu::WRITE).to_bytes());
    bench.fpwr(0x0610, &Fmmu::bytes(0x1_0000, 6, 0x1180, Fmmu::READ).to_bytes());
    bench.pdi_bytes(0x0800, 32);
    bench
}

const IMAGE: Address = Address::Logical(0x1_0000);

#[test]
fn working_counters_of_process_data() {
    let mut bench = process_data(&LAN9252);
    assert_eq!(bench.read(register::sm_status(2)), 0x30, "no buffer was ever written");
    // Inputs do not count before the application has written them.
    assert_eq!(bench.send(Command::Lrw, IMAGE, &[1, 2, 3, 4, 5, 6]), (vec![1, 2, 3, 4, 5, 6], 2));
    bench.pdi().write(0x1180, &[9; 6]);
    assert_eq!(bench.send(Command::Lrw, IMAGE, &[1, 2, 3, 4, 5, 6]), (vec![9; 6], 3));
    assert_eq!(bench.send(Command::Lrd, IMAGE, &[0; 6]), (vec![9; 6], 1));
    assert_eq!(bench.send(Command::Lwr, IMAGE, &[1; 6]).1, 1);
    assert_eq!(bench.send(Command::Lrw, Address::Logical(0x1_0006), &[0; 6]).1, 0);
    assert_eq!(bench.send(Command::Lrw, Address::Logical(0x0_FFFA), &[0; 6]).1, 0);
    // An access to a part of an area opens it and does not close it.
    assert_eq!(bench.send(Command::Lrd, IMAGE, &[0; 5]).1, 1);
    assert_eq!(bench.read(register::sm_status(3)) & SyncManager::STATUS_READING, 0x40);
}

/// Bits that no FMMU maps keep their values in process RAM, in the bytes at both ends of a mapping.
#[test]
fn bits_written_through_a_fmmu_leave_their_neighbours() {
    let mut bench = Bench::new(&LAN9252);
    let bits = Fmmu {
        logical_start_bit: 2,
        logical_stop_bit: 5,
        physical_start_bit: 2,
        ..Fmmu::bytes(0x1_0000, 1, 0x1000, Fmmu::WRITE)
    };
    bench.fpwr(0x0600, &bits.to_bytes());
    for (before, sent, after) in
        [(0x00, 0xFF, 0x3C), (0xFF, 0x00, 0xC3), (0xC3, 0xFF, 0xFF), (0x81, 0x14, 0x95)]
    {
        assert_eq!(bench.fpwr(0x1000, &[before, before]), 1);
        assert_eq!(bench.send(Command::Lwr, IMAGE, &[sent]).1, 1);
        assert_eq!(bench.fprd(0x1000, 2).0, [after, before], "{before:#04x}, {sent:#04x} sent");
    }
}

#[test]
fn the_newest_outputs_win() {
    let mut bench = process_data(&ET1100);
    assert_eq!(bench.pdi_bytes(0x1100, 4), [0; 4]);
    bench.send(Command::Lwr, IMAGE, &[1; 4]);
    assert_eq!(bench.last_al_events(), register::al_event::sync_manager(2));
    bench.send(Command::Lwr, IMAGE, &[2; 4]);
    assert_eq!(bench.last_al_events(), 0, "not newly set: nobody has read yet");
    assert_eq!(bench.pdi_bytes(0x1100, 4), [2; 4]);
    assert_eq!(bench.pdi().events(), 0);
    assert_eq!(bench.pdi_bytes(0x1100, 4), [2; 4], "the last outputs stay readable");
    // While the PDI reads, ECAT can write any number of times.
    bench.send(Command::Lwr, IMAGE, &[3; 4]);
    assert_eq!(bench.pdi_bytes(0x1100, 2), [3; 2]);
    for value in 4..9 {
        assert_eq!(bench.send(Command::Lwr, IMAGE, &[value; 4]).1, 1);
    }
    assert_eq!(bench.pdi_bytes(0x1102, 2), [3; 2], "one buffer, one cycle");
    assert_eq!(bench.pdi_bytes(0x1100, 4), [8; 4]);
    // After a bad frame the old outputs remain.
    bench.frame(false, &[(Command::Lwr, IMAGE, &[7; 4])]);
    assert_eq!(bench.pdi_bytes(0x1100, 4), [8; 4]);
    // Neither side can access the other two buffers.
    assert_eq!(bench.fprd(0x1104, 8).1, 0);
    assert_eq!(bench.fprd(0x110C, 1).1, 1);
}

/// The order of the buffers in three-buffer exchange, as the status register shows it.
#[test]
fn last_written_buffer() {
    let mut bench = process_data(&ET1100);
    let mut seen = Vec::new();
    for value in 0..4 {
        bench.send(Command::Lwr, IMAGE, &[value; 4]);
        seen.push(bench.read(register::sm_status(2)) >> 4);
    }
    assert_eq!(seen, [0, 1, 0, 1], "without a reader two buffers take turns");
    bench.pdi_bytes(0x1100, 4);
    bench.send(Command::Lwr, IMAGE, &[9; 4]);
    assert_eq!(bench.read(register::sm_status(2)) >> 4, 0, "the reader holds 1");
}

#[test]
fn inputs_are_of_one_cycle() {
    let mut bench = process_data(&ET1100);
    bench.pdi().write(0x1180, &[1; 3]);
    assert_eq!(bench.send(Command::Lrd, IMAGE, &[0; 6]).1, 0);
    bench.pdi().write(0x1183, &[1; 3]);
    assert_eq!(bench.send(Command::Lrd, IMAGE, &[0; 6]).0, [1; 6]);
    assert_eq!(bench.last_al_events(), register::al_event::sync_manager(3));
    bench.pdi().write(0x1180, &[2; 5]);
    assert_eq!(bench.send(Command::Lrd, IMAGE, &[0; 6]).0, [1; 6]);
}

#[test]
fn overlapping_outputs_and_inputs_exchange() {
    // Outputs and inputs share logical bytes and, in this test, also memory.
    let mut bench = Bench::new(&ET1100);
    bench.fpwr(0x0600, &Fmmu::bytes(0x1_0000, 4, 0x1100, Fmmu::WRITE).to_bytes());
    bench.fpwr(0x0610, &Fmmu::bytes(0x1_0000, 4, 0x1200, Fmmu::READ).to_bytes());
    bench.fpwr(0x1200, &[5, 6, 7, 8]);
    assert_eq!(bench.send(Command::Lrw, IMAGE, &[1, 2, 3, 4]), (vec![5, 6, 7, 8], 3));
    assert_eq!(bench.fprd(0x1100, 4).0, [1, 2, 3, 4]);
}

/// The data sheet's example of a bit-wise FMMU is written, and read back through another FMMU.
#[test]
fn bits_land_where_the_data_sheet_says() {
    let mut bench = Bench::new(&ET1100);
    let write = Fmmu {
        logical_start: 0x0001_0011,
        length: 3,
        logical_start_bit: 3,
        logical_stop_bit: 0,
        physical_start: 0x0F01,
        physical_start_bit: 1,
        kind: Fmmu::WRITE,
        activate: 1,
        reserved: [0; 3],
    };
    bench.fpwr(0x0600, &write.to_bytes());
    bench.fpwr(0x0F00, &[0xFF, 0, 0, 0]);
    let at = Address::Logical(0x1_0011);
    // Mapped: bits 3 to 7, all of the second byte, bit 0 of the third.
    assert_eq!(bench.send(Command::Lwr, at, &[0b1010_1111, 0b1100_0011, 0xFE]).1, 1);
    // In order of the bits: 1,0,1,0,1 | 1,1,0,0,0,0,1,1 | 0, from bit 1 of 0x0F01 on.
    assert_eq!(bench.fprd(0x0F00, 4).0, [0xFF, 0b1110_1010, 0b0011_0000, 0]);
    bench.fpwr(0x0600, &Fmmu { kind: Fmmu::READ, ..write }.to_bytes());
    let (data, wkc) = bench.send(Command::Lrd, at, &[0, 0, 0]);
    assert_eq!((data, wkc), (vec![0b1010_1000, 0b1100_0011, 0], 1));
    let (data, _) = bench.send(Command::Lrd, at, &[0xFF; 3]);
    assert_eq!(data, [0b1010_1111, 0b1100_0011, 0xFE], "other bits stay");
}

#[test]
fn the_watchdog_expires_to_the_tick() {
    let mut bench = process_data(&ET1100);
    assert_eq!(bench.read(register::WATCHDOG_STATUS), 0);
    bench.send(Command::Lwr, IMAGE, &[1; 4]);
    let written = bench.now;
    assert_eq!(bench.pdi_read(register::WATCHDOG_STATUS), 1);
    bench.run_to(written + 60_000_000);
    bench.send(Command::Lwr, IMAGE, &[1; 4]);
    let due = bench.now + 100_000_000;
    bench.take_events();
    bench.run_to(due - 1);
    let others = |events: Vec<(u64, EscEvent)>| -> Vec<_> {
        events.into_iter().filter(|(_, e)| *e == EscEvent::WatchdogExpired).collect()
    };
    assert_eq!(others(bench.take_events()), []);
    bench.run_to(due);
    assert_eq!(others(bench.take_events()), [(due, EscEvent::WatchdogExpired)]);
    assert_eq!(bench.pdi().events() & register::al_event::WATCHDOG, register::al_event::WATCHDOG);
    assert_eq!(bench.pdi_read(register::WATCHDOG_STATUS), 0);
    assert_eq!(bench.pdi().events() & register::al_event::WATCHDOG, 0);
    assert_eq!(bench.read(register::WATCHDOG_COUNTER_PROCESS_DATA), 1);
    bench.bwr(0x0442, &[0, 0]);
    assert_eq!(bench.read(register::WATCHDOG_COUNTER_PROCESS_DATA), 0);
    // A time of zero switches it off, and a bad frame does not restart it.
    bench.send(Command::Lwr, IMAGE, &[1; 4]);
    let due = bench.now + 100_000_000;
    bench.frame(false, &[(Command::Lwr, IMAGE, &[1; 4])]);
    bench.run_to(due);
    assert_eq!(others(bench.take_events()), [(due, EscEvent::WatchdogExpired)]);
    bench.write(register::WATCHDOG_TIME_PROCESS_DATA, 0);
    assert_eq!(bench.read(register::WATCHDOG_STATUS), 1);
    bench.send(Command::Lwr, IMAGE, &[1; 4]);
    bench.run_to(bench.now + 10_000_000_000);
    assert_eq!(others(bench.take_events()), []);
}

/// This digital output device has no CPU: SM0 guards one byte of a register.
#[test]
fn a_sync_manager_over_digital_outputs() {
    let mut bench = Bench::new(&ET1100);
    bench.fpwr(0x0800, &[0x00, 0x0F, 1, 0, 0x44, 0, 1, 0]);
    assert_eq!(bench.fpwr(0x0F00, &[0xA5]), 1);
    assert_eq!(bench.read(register::WATCHDOG_STATUS), 1);
    assert_eq!(bench.fprd(0x0F00, 1).0, [0xA5]);
}
