//! Commands, working counters, shadow registers, the EEPROM and other registers.

use super::*;
use crate::{ET1100, ET1100_MII, ET1200, IP_CORE_32, LAN9252, XMC4800};
use isocat_wire::{AlControl, AlState, AlStatus, AlStatusCode};

#[test]
fn signatures() {
    for (chip, bytes) in [
        (&ET1100, [0x11, 0x00, 0x03, 0x00, 0x08, 0x08, 0x08, 0x3B, 0xFC, 0x00]),
        (&ET1200, [0x12, 0x01, 0x01, 0x00, 0x03, 0x04, 0x01, 0x4A, 0xFC, 0x01]),
        (&IP_CORE_32, [0x04, 0x02, 0x43, 0x00, 0x03, 0x04, 0x04, 0x0F, 0x84, 0x01]),
        (&LAN9252, [0xC0, 0x02, 0x00, 0x00, 0x03, 0x04, 0x04, 0x0F, 0xCC, 0x01]),
        (&XMC4800, [0x98, 0x01, 0x01, 0x00, 0x08, 0x08, 0x08, 0x0F, 0xCC, 0x01]),
    ] {
        assert_eq!(Bench::new(chip).fprd(0x0000, 10), (bytes.to_vec(), 1), "{}", chip.name);
        // IgH reads two bytes more.
        assert_eq!(Bench::new(chip).fprd(0x0000, 12).1, 1);
    }
}

/// Vector 1: three devices OR their types; each adds one to the position and to the counter.
#[test]
fn broadcast_read_through_three() {
    let mut buffer = [0; 60];
    let mut writer = FrameWriter::new(&mut buffer, [0x10; 6]);
    let at = writer.push(Command::Brd, 7, Address::Broadcast(0x0000), &[0]).unwrap();
    writer.finish();
    for chip in [&ET1100, &ET1200, &ET1100] {
        let mut esc = Esc::new(chip, image(SII), vec![0; 1024]);
        esc.process(&mut buffer, device(1_000), device(6_760), true);
        assert_eq!(esc.next_event(), Time::NEVER, "a read leaves nothing to do");
    }
    assert_eq!(buffer[at..at + 3], [0x13, 3, 0]);
    assert_eq!(buffer[at - 8..at - 6], [3, 0]);
    assert_eq!(buffer[at - 9], 7);
}

#[test]
fn who_is_addressed() {
    let mut bench = Bench::new(&ET1100);
    let position = |adp| Address::Position(AutoIncrementAddress(adp), 0x0000);
    let other = |adp| Address::Station(StationAddress(adp), 0x0000);
    assert_eq!(bench.send(Command::Aprd, position(0), &[0]), (vec![0x11], 1));
    assert_eq!(bench.send(Command::Aprd, position(0xFFFF), &[0]), (vec![0], 0));
    assert_eq!(bench.send(Command::Fprd, other(0x1001), &[0]).1, 1);
    assert_eq!(bench.send(Command::Fprd, other(0x1000), &[0]).1, 0);
    // The alias (0x1234 in the SII) counts once DL control bit 24 enables it.
    assert_eq!(bench.send(Command::Fprd, other(0x1234), &[0]).1, 0);
    assert_eq!(bench.bwr(0x0103, &[1]), 1);
    assert_eq!(bench.send(Command::Fprd, other(0x1234), &[0]).1, 1);
    assert_eq!(bench.send(Command::Nop, other(0x1001), &[0]), (vec![0], 0));
}

#[test]
fn working_counters_of_read_and_write() {
    let mut bench = Bench::new(&ET1100);
    let at = |ado| Address::Broadcast(ado);
    assert_eq!(bench.send(Command::Fprw, station(0x1100), &[1, 2]), (vec![0, 0], 3));
    assert_eq!(bench.send(Command::Fprw, station(0x1100), &[3, 4]), (vec![1, 2], 3));
    // BRW gives the old content OR the data as received, and writes the data as received.
    assert_eq!(bench.send(Command::Brw, at(0x1100), &[0x10, 0x20]), (vec![0x13, 0x24], 3));
    assert_eq!(bench.fprd(0x1100, 2), (vec![0x10, 0x20], 1));
    assert_eq!(bench.send(Command::Fprw, station(0x0000), &[0xFF]), (vec![0x11], 1));
    // More than one chunk of an exchange.
    let ramp: Vec<u8> = (0..100).collect();
    assert_eq!(bench.send(Command::Fprw, station(0x1200), &ramp), (vec![0; 100], 3));
    assert_eq!(bench.send(Command::Fprw, station(0x1200), &[9; 100]), (ramp, 3));
    // ARMW and FRMW: the one that matches reads, the others write, each counts one.
    bench.fpwr(0x1100, &[5]);
    assert_eq!(bench.send(Command::Frmw, station(0x1100), &[0]), (vec![5], 1));
    let other = Address::Station(StationAddress(0x1000), 0x1100);
    assert_eq!(bench.send(Command::Frmw, other, &[6]), (vec![6], 1));
    assert_eq!(bench.fprd(0x1100, 1), (vec![6], 1));
}

/// Vectors 6, 7, 8 and 19, and the writes of common MainDevices at start-up.
#[test]
fn what_counts_and_what_does_not() {
    let mut bench = Bench::with(&ET1200, [0; 14]);
    assert_eq!(bench.fprd(0x0900, 16).1, 1);
    assert_eq!(bench.bwr(0x0900, &[0]), 1);
    for address in [0x0910, 0x0918, 0x0920, 0x0928, 0x092C, 0x0981, 0x0990, 0x09A0] {
        assert_eq!(bench.fprd(address, 4).1, 0, "{address:#06x}");
        assert_eq!(bench.bwr(address, &[0; 4]), 0, "{address:#06x}");
    }

    let mut bench = Bench::new(&ET1100);
    assert_eq!(bench.bwr(0x0680, &[0; 128]), 0);
    assert_eq!(bench.bwr(0x0840, &[0; 64]), 0);
    assert_eq!(bench.bwr(0x0600, &[0; 256]), 1);
    assert_eq!(bench.bwr(0x0800, &[0; 256]), 1);
    assert_eq!(bench.bwr(0x092C, &[0; 4]), 0);
    assert_eq!(bench.bwr(0x0910, &[0; 32]), 1);
    assert_eq!(bench.bwr(0x0500, &[0; 2]), 1);
    assert_eq!(bench.bwr(0x0300, &[0; 20]), 1);
    assert_eq!(bench.bwr(0x0110, &[0; 2]), 0);
    assert_eq!(bench.bwr(0x0130, &[0; 2]), 0);
    assert_eq!(bench.fprd(0x0130, 6).1, 1);
    // Addresses that do not exist give no count and leave the data unchanged.
    assert_eq!(bench.send(Command::Fprd, station(0x0A00), &[7; 4]), (vec![7; 4], 0));
    assert_eq!(bench.send(Command::Fprd, station(0x3000), &[7; 4]), (vec![7; 4], 0));
    assert_eq!(bench.send(Command::Fprd, station(0x2FFE), &[7; 4]), (vec![0, 0, 7, 7], 1));
    assert_eq!(bench.send(Command::Fprd, station(0xFFFE), &[7; 4]), (vec![7; 4], 0));

    let mut bench = Bench::new(&IP_CORE_32);
    let (data, wkc) = bench.fprd(0x0900, 32);
    assert_eq!((wkc, &data[0x14..0x18], &data[0x1C..0x20]), (1, &[0; 4][..], &[0; 4][..]));
    assert_ne!(data[0x10..0x14], [0; 4]);
    assert_eq!(bench.bwr(0x0924, &[1; 4]), 0, "no upper half of the offset");
}

#[test]
fn registers_change_at_the_end_of_a_good_frame() {
    let mut bench = Bench::new(&ET1100);
    let write = (Command::Fpwr, station(0x0400), &[0x10, 0x20][..]);
    let read = (Command::Fprd, station(0x0400), &[0, 0][..]);
    let answers = bench.frame(true, &[write, read]);
    assert_eq!(answers, [(vec![0x10, 0x20], 1), (vec![0xC2, 0x09], 1)]);
    assert_eq!(bench.read(register::WATCHDOG_DIVIDER), 0x2010);
    // A register does not change before the last bit of the frame.
    let mut buffer = [0; 60];
    let mut writer = FrameWriter::new(&mut buffer, [0x10; 6]);
    writer.push(Command::Fpwr, 0, station(0x0400), &[0x33, 0]).unwrap();
    writer.finish();
    let (start, end) = (bench.now, bench.now + 5_760);
    bench.esc.process(&mut buffer, device(start), device(end), true);
    assert_eq!(bench.esc.next_event(), device(end));
    assert_eq!(bench.esc.step(device(end - 1)), None);
    assert_eq!(bench.esc.register(register::WATCHDOG_DIVIDER), 0x2010);
    let event = Some((device(end), EscEvent::FrameEnd { al_events: 0 }));
    assert_eq!(bench.esc.step(device(end)), event);
    assert_eq!(bench.esc.register(register::WATCHDOG_DIVIDER), 0x33);
    // User RAM and process RAM change at once, even by a bad frame.
    bench.now = end;
    let list = [
        (Command::Fpwr, station(0x0F80), &[1][..]),
        (Command::Fprd, station(0x0F80), &[0][..]),
        (Command::Fpwr, station(0x1000), &[2][..]),
        (Command::Fpwr, station(0x0400), &[0x44][..]),
    ];
    assert_eq!(bench.frame(false, &list)[1], (vec![1], 1));
    assert_eq!(bench.fprd(0x1000, 1).0, [2]);
    assert_eq!(bench.read(register::WATCHDOG_DIVIDER), 0x33);
}

#[test]
fn a_forgotten_frame_end_is_reported_late_and_not_lost() {
    let mut bench = Bench::new(&ET1100);
    let mut buffer = [0; 60];
    let mut writer = FrameWriter::new(&mut buffer, [0x10; 6]);
    writer.push(Command::Fpwr, 0, station(0x0120), &[2, 0]).unwrap();
    writer.finish();
    let end = bench.now + 5_760;
    bench.esc.process(&mut buffer.clone(), device(bench.now), device(end), true);
    bench.esc.process(&mut buffer, device(end), device(end + 5_760), true);
    assert_eq!(
        bench.esc.step(device(end)),
        Some((device(end), EscEvent::FrameEnd { al_events: 1 }))
    );
}

/// Vector 10: one request at a time.
#[test]
fn al_control_waits_for_the_pdi() {
    let mut bench = Bench::new(&LAN9252);
    assert_eq!(bench.bwr(0x0120, &[0x11, 0]), 1);
    assert_eq!(bench.last_al_events(), register::al_event::AL_CONTROL);
    assert_eq!(bench.bwr(0x0120, &[0x12, 0]), 0);
    assert_eq!(bench.pdi().events(), 1);
    let asked = bench.pdi_read(register::AL_CONTROL);
    assert_eq!(asked, AlControl::request_and_acknowledge(AlState::Init));
    assert_eq!(bench.pdi().events(), 0);
    // The event comes even if the value is the same.
    assert_eq!(bench.bwr(0x0120, &[0x11, 0]), 1);
    assert_eq!(bench.last_al_events(), 1);
    bench.pdi().store(register::AL_STATUS_CODE, AlStatusCode(0x16));
    bench.pdi().store(register::AL_STATUS, AlStatus(0x11));
    assert_eq!(bench.fprd(0x0130, 6).0, [0x11, 0, 0, 0, 0x16, 0]);
    assert_eq!(bench.fpwr(0x0130, &[1, 0]), 0);
}

/// Vector 11: device emulation mirrors everything.
#[test]
fn device_emulation() {
    let mut bench = Bench::with(&ET1100, [0x04, 0x01, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
    for asked in [0x0011, 0x0012, 0x0004] {
        assert_eq!(bench.bwr(0x0120, &u16::to_le_bytes(asked)), 1);
        assert_eq!(bench.read(register::AL_STATUS), AlStatus(asked));
    }
    bench.pdi().store(register::AL_STATUS, AlStatus(1));
    assert_eq!(bench.read(register::AL_STATUS), AlStatus(4));
    assert_eq!(bench.pdi().events(), 0);
}

/// The circuit of a device without CPU sees each exchange and each change of state; a CPU sees only
/// events that may interrupt it.
#[test]
fn without_a_cpu_exchanges_need_no_interrupt() {
    for (emulation, exchange) in [(1, register::al_event::sync_manager(0)), (0, 0)] {
        let mut bench = Bench::with(&ET1100, [0x04, emulation, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
        bench.fpwr(0x0800, &[0x00, 0x0F, 1, 0, 0x44, 0, 1, 0]);
        bench.fpwr(0x0F00, &[0xA5]);
        assert_eq!(bench.last_al_events(), exchange);
        bench.fpwr(0x0F01, &[0xA5]);
        assert_eq!(bench.last_al_events(), 0, "nothing guards this byte");
        bench.bwr(0x0120, &[4, 0]);
        assert_eq!(bench.last_al_events(), register::al_event::AL_CONTROL);
        if emulation == 1 {
            bench.bwr(0x0120, &[4, 0]);
            assert_eq!(bench.last_al_events(), 0, "nothing has changed");
        }
    }
}

#[test]
fn write_protection() {
    let mut bench = Bench::new(&ET1100);
    bench.write(register::REGISTER_WRITE_PROTECTION, 1);
    assert_eq!(bench.fpwr(0x0400, &[1, 0]), 0);
    assert_eq!(bench.fpwr(0x1000, &[1, 0]), 1);
    let enable = (Command::Fpwr, station(0x0020), &[0][..]);
    let write = (Command::Fpwr, station(0x0400), &[1, 0][..]);
    assert_eq!(bench.frame(true, &[enable, write])[1].1, 1);
    assert_eq!(bench.read(register::WATCHDOG_DIVIDER), 1);
    assert_eq!(bench.fpwr(0x0400, &[2, 0]), 0, "the enable lasts for one frame");
    let lock = (Command::Fpwr, station(0x0031), &[1][..]);
    bench.frame(true, &[enable, lock]);
    assert_eq!(bench.fpwr(0x1000, &[1, 0]), 0);
    assert_eq!(bench.frame(true, &[(Command::Fpwr, station(0x0030), &[0]), write])[1].1, 0);
}

/// The write enables last until the next frame arrives, whatever that frame contains.
#[test]
fn write_enables_can_be_read_between_frames() {
    let mut bench = Bench::new(&ET1100);
    for enable in [register::REGISTER_WRITE_ENABLE, register::ESC_WRITE_ENABLE] {
        bench.write(enable, 1);
        assert_eq!(bench.pdi_read(enable), 1);
        assert_eq!(bench.read(enable), 0);
        assert_eq!(bench.pdi_read(enable), 0);
    }
    // Each enables its own protection only.
    bench.write(register::ESC_WRITE_PROTECTION, 1);
    let write = (Command::Fpwr, station(0x1000), &[1][..]);
    for (enable, counted) in [(0x0020, 0), (0x0030, 1)] {
        let enable = (Command::Fpwr, station(enable), &[0][..]);
        assert_eq!(bench.frame(true, &[enable, write])[1].1, counted);
        assert_eq!(bench.frame(true, &[write, enable])[0].1, 0, "too late");
    }
    // Reads, and accesses of the PDI, are not protected.
    assert_eq!(bench.fprd(0x1000, 1).1, 1);
    bench.pdi().write(0x1000, &[7]);
    assert_eq!(bench.fprd(0x1000, 1).0, [7]);
}

/// Which optional registers a chip has: unimplemented ones do not count.
#[test]
fn registers_by_chip() {
    let optional = [0x0108, 0x0138, 0x0510, 0x0516, 0x0910, 0x0984, 0x0E00, 0x0E02, 0x0E0F, 0x0E10];
    for (chip, exist) in [
        (&ET1100, [0, 0, 1, 0, 1, 0, 1, 0, 0, 0]),
        (&ET1100_MII, [0, 0, 1, 0, 1, 0, 1, 0, 0, 0]),
        (&ET1200, [0, 0, 1, 0, 1, 1, 1, 0, 0, 0]),
        (&IP_CORE_32, [1, 1, 1, 1, 1, 1, 1, 1, 1, 0]),
        (&LAN9252, [1, 1, 1, 1, 1, 1, 1, 1, 1, 0]),
        (&XMC4800, [1, 1, 1, 1, 1, 1, 1, 1, 1, 0]),
    ] {
        let mut bench = Bench::new(chip);
        let found = optional.map(|address| bench.fprd(address, 1).1);
        assert_eq!(found, exist, "{}", chip.name);
        assert_eq!(bench.bwr(0x0E00, &[1]), 0, "read-only");
    }
}

/// Product and vendor numbers come from the profile.
#[test]
fn product_and_vendor() {
    static CHIP: Chip = Chip {
        chip_specific: &[1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16],
        ..crate::chip::IP_CORE_BASE
    };
    let mut bench = Bench::new(&CHIP);
    let numbers: Vec<u8> = (1..=16).collect();
    assert_eq!(bench.fprd(0x0E00, 16), (numbers.clone(), 1));
    assert_eq!(bench.pdi_bytes(0x0E00, 16), numbers);
}

/// From the PDI's side the same three letters reset the ESC, each in its own access.
#[test]
fn the_pdi_resets_too() {
    let mut bench = Bench::new(&LAN9252);
    bench.pdi().store(register::ESC_RESET_PDI, b'R');
    bench.pdi().store(register::ESC_RESET_PDI, b'R');
    bench.pdi().store(register::ESC_RESET_PDI, b'E');
    assert_eq!(bench.pdi_read(register::ESC_RESET_PDI), 2);
    assert_eq!(bench.fpwr(0x0041, b"S"), 0, "ECAT has a register of its own");
    bench.write(register::ESC_RESET_ECAT, b'S');
    assert_eq!(bench.pdi_read(register::ESC_RESET_PDI), 2);
    bench.pdi().store(register::ESC_RESET_PDI, b'S');
    bench.run_to(bench.now);
    assert!(matches!(bench.take_events()[..], [.., (_, EscEvent::Reset)]));
    assert_eq!(bench.esc.register(register::STATION_ADDRESS), 0);
}

#[test]
fn three_letters_reset() {
    let mut bench = Bench::new(&ET1100);
    bench.write(register::ESC_RESET_ECAT, b'R');
    bench.write(register::ESC_RESET_ECAT, b'E');
    assert_eq!(bench.read(register::ESC_RESET_ECAT), 2);
    bench.write(register::ESC_RESET_ECAT, b'X');
    assert_eq!(bench.read(register::ESC_RESET_ECAT), 0);
    for letter in *b"RES" {
        bench.write(register::ESC_RESET_ECAT, letter);
    }
    assert!(bench.take_events().iter().any(|(_, event)| *event == EscEvent::Reset));
    assert_eq!(bench.esc.register(register::STATION_ADDRESS), 0);
    assert!(bench.esc.dl_status().open(PortNumber::P0), "links stay");
    assert_eq!(bench.esc.register(register::STATION_ALIAS), 0x1234);
    // The local time restarts.
    assert!(bench.esc.local_time(device(bench.now)).count() < 100);
}

/// After power-on everything is as in a new chip, except the EEPROM.
#[test]
fn power_on_begins_anew() {
    let mut bench = Bench::new(&LAN9252);
    let fresh = Esc::new(&LAN9252, image(SII), vec![0; 4096]).registers();
    bench.esc.pdi(Time::new(bench.now)).write(0x1000, &[7; 8]);
    assert_eq!(bench.esc.ram()[..8], [7; 8]);
    let now = Time::new(bench.now + 1_000);
    bench.esc.power_on(now, Time::new(0));
    assert_eq!(bench.esc.ram()[..8], [0; 8]);
    assert_eq!(bench.esc.system_time(now).count(), 0);
    let found = bench.esc.registers();
    let other: Vec<_> = (0..found.len()).filter(|at| found[*at] != fresh[*at]).collect();
    assert!(other.is_empty(), "{other:04x?}");
}

/// What docs/dc.md says of registers that are not modelled.
#[test]
fn registers_that_are_not_modelled() {
    for chip in [&ET1100, &LAN9252] {
        let mut bench = Bench::new(chip);
        for (first, end) in [
            (0x0142, 0x0144),
            (0x0938, 0x0980),
            (0x0986, 0x0987),
            (0x098C, 0x098E),
            (0x09AA, 0x09AE),
            (0x09D0, 0x09F0),
        ] {
            for address in first..end {
                assert_eq!(bench.fprd(address, 1).1, 0, "{}: {address:#06x} reads", chip.name);
                assert_eq!(bench.fpwr(address, &[0xFF]), 0, "{}: {address:#06x}", chip.name);
            }
        }
        assert_eq!(bench.esc.register(register::FEATURES) & 1 << 12, 0);
        // Read as written, without effect.
        bench.write(register::CYCLIC_UNIT_CONTROL, 0x0E);
        assert_eq!(bench.read(register::CYCLIC_UNIT_CONTROL), 0x0E);
        assert_eq!(bench.fpwr(0x0981, &[0x02]), 1, "ECAT owns SYNC0 and SYNC1");
        bench.fpwr(0x0810, &[0x00, 0x10, 4, 0, 0xE4, 0, 1, 0]);
        bench.fpwr(0x1000, &[0; 4]);
        bench.pdi().write(0x0817, &[0xC0]);
        assert_eq!(bench.fprd(0x0814, 4).0, [0xE4, 0x01, 1, 0]);
    }
}
