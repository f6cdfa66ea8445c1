//! RUN and ERR LEDs, and the identification bits of AL control and status.

use super::*;
use crate::{ET1100, LAN9252};
use isocat_wire::{AlControl, AlState, AlStatus, AlStatusCode};

fn enter(bench: &mut Bench, status: u16) {
    bench.pdi().store(register::AL_STATUS, AlStatus(status));
}

#[test]
fn the_run_led_follows_the_state() {
    let mut bench = Bench::new(&LAN9252);
    assert_eq!(bench.read(register::RUN_LED), 0x0);
    for (status, code) in [(2, 0xD), (4, 0x1), (8, 0xF), (0x14, 0x1), (3, 0xE), (1, 0x0)] {
        enter(&mut bench, status);
        assert_eq!(bench.read(register::RUN_LED), code, "AL status {status:#x}");
    }
    enter(&mut bench, 8);
    enter(&mut bench, 7);
    assert_eq!(bench.read(register::RUN_LED), 0xF, "7 is no state");
}

#[test]
fn either_side_overrides_until_the_next_state() {
    let mut bench = Bench::new(&LAN9252);
    enter(&mut bench, 2);
    bench.write(register::RUN_LED, 0xFF);
    assert_eq!(bench.read(register::RUN_LED), 0x1F, "bits 7:5 do not exist");
    bench.pdi().store(register::RUN_LED, 0x13);
    assert_eq!(bench.read(register::RUN_LED), 0x13);
    enter(&mut bench, 4);
    assert_eq!(bench.read(register::RUN_LED), 0x01);
    // Without bit 4 the LED shows the state.
    bench.write(register::RUN_LED, 0x0F);
    assert_eq!(bench.read(register::RUN_LED), 0x01);
    // A bad frame has no effect on the LED.
    bench.frame(false, &[(Command::Fpwr, station(0x0138), &[0x1F])]);
    assert_eq!(bench.read(register::RUN_LED), 0x01);
}

#[test]
fn a_new_error_takes_the_err_led_back() {
    let mut bench = Bench::new(&LAN9252);
    bench.write(register::ERR_LED, 0x1E);
    enter(&mut bench, 4);
    assert_eq!(bench.read(register::ERR_LED), 0x1E, "no error");
    enter(&mut bench, 0x14);
    assert_eq!(bench.read(register::ERR_LED), 0x00);
    bench.pdi().store(register::ERR_LED, 0x1E);
    enter(&mut bench, 0x12);
    assert_eq!(bench.read(register::ERR_LED), 0x1E, "the same error still");
    // So do the watchdogs.
    bench.fpwr(0x0800, &[0x00, 0x10, 1, 0, 0x64, 0, 1, 0]);
    bench.fpwr(0x1000, &[1]);
    bench.write(register::WATCHDOG_TIME_PDI, 0);
    bench.run_to(bench.now + 99_000_000);
    assert_eq!(bench.read(register::ERR_LED), 0x1E);
    bench.run_to(bench.now + 1_000_000);
    assert_eq!(bench.read(register::ERR_LED), 0x00);
}

#[test]
fn a_chip_without_override() {
    let mut bench = Bench::new(&ET1100);
    for address in [0x0138, 0x0139] {
        assert_eq!((bench.fprd(address, 1).1, bench.bwr(address, &[0x1F])), (0, 0));
    }
}

/// The MainDevice asks for the identification, and the device loads it into the AL status code.
#[test]
fn identification() {
    let mut bench = Bench::new(&LAN9252);
    bench.bwr(0x0120, &[0x21, 0]);
    let asked = bench.pdi_read(register::AL_CONTROL);
    assert_eq!(asked, AlControl(0x21));
    bench.pdi().store(register::AL_STATUS_CODE, AlStatusCode(0x1234));
    let loaded = AlStatus::new(AlState::Init).with_identification(true);
    bench.pdi().store(register::AL_STATUS, loaded);
    assert_eq!(bench.fprd(0x0130, 6).0, [0x21, 0, 0, 0, 0x34, 0x12]);
    bench.bwr(0x0120, &[0x01, 0]);
    bench.pdi().store(register::AL_STATUS, AlStatus::new(AlState::Init));
    assert_eq!(bench.fprd(0x0130, 2).0, [0x01, 0]);
}
