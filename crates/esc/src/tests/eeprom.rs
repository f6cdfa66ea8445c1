//! The EEPROM interface.

use super::*;
use crate::{ET1100, ET1200, IP_CORE_32, IP_CORE_32_EMULATED};

/// Vectors 12 and 13.
#[test]
fn eeprom_reads() {
    for (chip, busy, idle) in [(&ET1100, 0x8140, 0x0040), (&ET1200, 0x8150, 0x0050)] {
        let mut bench = Bench::new(chip);
        assert_eq!(bench.fpwr(0x0502, &[0x00, 0x01, 0x08, 0, 0, 0]), 1);
        assert_eq!(bench.read(register::EEPROM_STATUS).0, busy);
        assert_eq!(bench.fpwr(0x0502, &[0x00, 0x01, 0x09, 0, 0, 0]), 0, "busy");
        bench.run_to(bench.now + 20_000);
        assert!(matches!(bench.take_events()[..], [(_, EscEvent::EepromDone)]));
        assert_eq!(
            bench.fprd(0x0502, 14),
            (vec![idle as u8, 0, 8, 0, 0, 0, 2, 0, 0, 0, 0x52, 0x2C, 0x4C, 0x04], 1)
        );
        // Cells beyond the end read as erased.
        bench.fpwr(0x0502, &[0x80, 0x01, 0x7F, 0]);
        bench.run_to(bench.now + 20_000);
        assert_eq!(bench.fprd(0x0508, 4).0, [0, 0, 0xFF, 0xFF]);
        bench.fpwr(0x0502, &[0x00, 0x01, 0xFF, 0xFF, 0xFF, 0xFF]);
        bench.run_to(bench.now + 20_000);
        assert_eq!(bench.read(register::EEPROM_DATA), u64::MAX);
    }
    // Four bytes a read.
    let mut bench = Bench::new(&IP_CORE_32);
    bench.fpwr(0x0502, &[0x00, 0x01, 0x08, 0, 0, 0]);
    bench.run_to(bench.now + 20_000);
    assert_eq!(bench.fprd(0x0502, 14).0, [0, 0, 8, 0, 0, 0, 2, 0, 0, 0, 0, 0, 0, 0]);
}

/// 0x0502 bit 4 of an ET1200 reads 1 until SAFEOP is first reached, and from then on 0.
#[test]
fn a_reserved_bit_goes_with_safeop() {
    for (chip, before, after) in [(&ET1200, 0x0050, 0x0040), (&ET1100, 0x0040, 0x0040)] {
        let mut bench = Bench::with(chip, [0x04, 0x01, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
        let status = |bench: &mut Bench| bench.read(register::EEPROM_STATUS).0;
        // The EEPROM is offered to the PDI and taken back, in PREOP.
        for value in [0x01, 0x02, 0x00] {
            bench.fpwr(0x0500, &[value]);
            assert_eq!(status(&mut bench), before, "{}", chip.name);
        }
        for (state, expected) in [(0x11, before), (0x02, before), (0x04, after), (0x01, after)] {
            bench.fpwr(0x0120, &[state, 0]);
            assert_eq!(status(&mut bench), expected, "{} in {state:#04x}", chip.name);
        }
        bench.esc.power_on(Time::new(bench.now), Time::ZERO);
        assert_eq!(bench.esc.register(register::EEPROM_STATUS).0, before, "power-on");
    }
    // The same behaviour behind a CPU, which sets AL status.
    let mut bench = Bench::new(&ET1200);
    for (state, expected) in [(2, 0x0050), (3, 0x0050), (8, 0x0040), (1, 0x0040)] {
        bench.pdi().write(0x0130, &[state]);
        assert_eq!(bench.read(register::EEPROM_STATUS).0, expected, "AL status {state}");
    }
}

/// The burn time, in which the memory acknowledges nothing, is the chip's setting to the tick.
#[test]
fn the_burn_time_is_a_setting() {
    static QUICK: Chip = Chip { eeprom_burn_time: isocat_wire::Nanos(2_400_000), ..ET1100 };
    for (chip, burn) in [(&ET1100, 5_000_000), (&QUICK, 2_400_000)] {
        for (early, expected) in [(10, 0x2040), (0, 0x0040)] {
            let mut bench = Bench::new(chip);
            bench.fpwr(0x0502, &[0x01, 0x02, 0x40, 0, 0, 0, 0x34, 0x12]);
            let written = bench.now + 200_000;
            bench.run_to(written);
            // A read takes 20 us behind its frame, which is one of 60 bytes.
            let frame = duration_ns(60);
            bench.run_to(written + burn - 20_000 - frame - early);
            bench.fpwr(0x0502, &[0x00, 0x01, 0x40, 0, 0, 0]);
            assert_eq!(bench.now, written + burn - 20_000 - early);
            bench.run_to(bench.now + 20_000);
            assert_eq!(bench.esc.register(register::EEPROM_STATUS).0, expected, "{burn} {early}");
        }
    }
}

#[test]
fn eeprom_is_busy_for_its_time_exactly() {
    let mut bench = Bench::new(&ET1100);
    bench.fpwr(0x0502, &[0x00, 0x01, 0x08, 0, 0, 0]);
    let done = bench.now + 20_000;
    bench.run_to(done - 1);
    assert!(bench.esc.register(register::EEPROM_STATUS).busy());
    bench.run_to(done);
    assert!(!bench.esc.register(register::EEPROM_STATUS).busy());
}

#[test]
fn eeprom_writes_need_the_enable_bit_and_the_ownership() {
    let mut bench = Bench::new(&ET1100);
    bench.fpwr(0x0508, &[0xCD, 0xAB]);
    bench.fpwr(0x0502, &[0x00, 0x02, 0x40, 0, 0, 0]);
    assert_eq!(bench.read(register::EEPROM_STATUS).0, 0x4040);
    // One frame with the command first and the data last is one command.
    bench.fpwr(0x0502, &[0x01, 0x02, 0x40, 0, 0, 0, 0x34, 0x12]);
    assert_eq!(bench.read(register::EEPROM_STATUS).0, 0x8240);
    bench.run_to(bench.now + 200_000);
    assert_eq!(bench.esc.eeprom()[0x80..0x82], [0x34, 0x12]);
    assert_eq!(bench.read(register::EEPROM_STATUS).0, 0x0040);
    bench.run_to(bench.now + 5_000_000);
    // An unknown command; the command 000 clears the error.
    bench.fpwr(0x0502, &[0x00, 0x03]);
    assert_eq!(bench.read(register::EEPROM_STATUS).0, 0x2040);
    bench.fpwr(0x0502, &[0x00, 0x00]);
    assert_eq!(bench.read(register::EEPROM_STATUS).0, 0x0040);
    // While the EEPROM is offered to the PDI, neither side may use it until the PDI takes it.
    bench.write(register::EEPROM_CONFIGURATION, 1);
    assert_eq!(bench.fpwr(0x0502, &[0x00, 0x01, 8, 0, 0, 0]), 0);
    bench.pdi().write(0x0502, &[0x00, 0x01, 8, 0, 0, 0]);
    assert!(!bench.read(register::EEPROM_STATUS).busy());
    bench.pdi().store(register::EEPROM_PDI_ACCESS, 1);
    bench.pdi().write(0x0502, &[0x00, 0x01, 8, 0, 0, 0]);
    assert!(bench.read(register::EEPROM_STATUS).busy());
    bench.run_to(bench.now + 20_000);
    assert_eq!(bench.pdi_read(register::EEPROM_DATA) as u32, 2);
    // Taken back by force.
    bench.write(register::EEPROM_CONFIGURATION, 2);
    assert_eq!(bench.read(register::EEPROM_PDI_ACCESS), 0);
    bench.write(register::EEPROM_CONFIGURATION, 0);
    assert_eq!(bench.fpwr(0x0502, &[0x00, 0x01, 8, 0, 0, 0]), 1);
}

/// Bit 13 without an acknowledge; bit 11 is about a checksum, and of a memory that does not answer
/// none was read. A command clears the error, and makes it again.
#[test]
fn a_dead_eeprom_acknowledges_nothing() {
    let mut bench = Bench::new(&ET1100);
    bench.esc.set_eeprom_dead(true);
    for _ in 0..2 {
        bench.fpwr(0x0502, &[0x00, 0x01, 0x08, 0, 0, 0]);
        assert_eq!(bench.read(register::EEPROM_STATUS).0, 0x8140);
        bench.run_to(bench.now + 20_000);
        assert_eq!(bench.read(register::EEPROM_STATUS).0, 0x2040);
    }
    bench.fpwr(0x0502, &[0x00, 0x00]);
    assert_eq!(bench.read(register::EEPROM_STATUS).0, 0x0040, "what was loaded at power-on stays");
    let now = bench.esc.last_frame();
    bench.esc.power_on(now, Time::ZERO);
    assert_eq!(bench.esc.register(register::EEPROM_STATUS).0, 0x3040);
    assert_eq!(bench.esc.register(register::PDI_CONTROL), 0);
    // Alive again, it is read, and a reload makes up for what the power-on missed.
    bench.esc.set_eeprom_dead(false);
    bench.write(register::STATION_ADDRESS, 0x1001);
    bench.fpwr(0x0502, &[0x00, 0x04]);
    bench.run_to(bench.now + 1_000_000);
    assert_eq!(bench.read(register::EEPROM_STATUS).0, 0x0040);
}

#[test]
fn a_wrong_checksum_leaves_the_defaults() {
    let mut wrong = image(SII);
    wrong[14] ^= 1;
    let mut bench = Bench::new(&ET1100);
    bench.esc = Esc::new(&ET1100, wrong, vec![0; 8192]);
    bench.write(register::STATION_ADDRESS, 0x1001);
    assert_eq!(bench.read(register::EEPROM_STATUS).0, 0x1840);
    assert_eq!(bench.read(register::PDI_CONTROL), 0);
    assert_eq!(bench.fprd(0x1000, 2).1, 0, "no process RAM without a configuration");
    // Repair the image over the wire and reload.
    bench.fpwr(0x0502, &[0x01, 0x02, 7, 0, 0, 0, sii::checksum(&SII), 0]);
    bench.run_to(bench.now + 5_200_000);
    bench.fpwr(0x0502, &[0x00, 0x04]);
    bench.run_to(bench.now + 20_000);
    assert_eq!(bench.read(register::EEPROM_STATUS).0, 0x0040);
    assert_eq!(bench.read(register::PDI_CONTROL), 0x80);
    assert_eq!(bench.read(register::STATION_ALIAS), 0, "the alias is loaded at power-on only");
    assert_eq!(bench.fprd(0x1000, 2).1, 1);
    assert_eq!(bench.read(register::SYNC_PULSE_LENGTH), 0x2710);
}

/// Vector 13: after a write the memory burns for some ms and acknowledges nothing.
#[test]
fn a_burning_eeprom_acknowledges_nothing() {
    let mut bench = Bench::new(&ET1100);
    bench.fpwr(0x0502, &[0x01, 0x02, 0x40, 0, 0, 0, 0x34, 0x12]);
    let burns = bench.now + 200_000 + 5_000_000;
    // The read ends one tick (10 ns) before the memory has finished burning, or together with it.
    let read = bench.now + 5_200_000 - 20_000 - duration_ns(60) - 10;
    for (at, status, data) in [(read, 0x2040, [0x34, 0x12]), (read + 10, 0x0040, [0x02, 0x00])] {
        let mut other = Bench::new(&ET1100);
        other.fpwr(0x0502, &[0x01, 0x02, 0x40, 0, 0, 0, 0x34, 0x12]);
        other.run_to(at);
        other.fpwr(0x0502, &[0x00, 0x01, 8, 0, 0, 0]);
        other.run_to(burns);
        assert_eq!(other.read(register::EEPROM_STATUS).0, status);
        assert_eq!(other.fprd(0x0508, 2).0, data);
        // The next valid command clears the error.
        other.fpwr(0x0502, &[0x00, 0x01, 8, 0, 0, 0]);
        assert_eq!(other.read(register::EEPROM_STATUS).0, 0x8140);
    }
}

#[test]
fn the_pdi_needs_no_write_enable() {
    let mut bench = Bench::new(&ET1100);
    bench.write(register::EEPROM_CONFIGURATION, 1);
    bench.pdi().store(register::EEPROM_PDI_ACCESS, 1);
    assert_eq!(bench.read(register::EEPROM_STATUS).0, 0x0041);
    bench.pdi().write(0x0502, &[0x00, 0x02, 0x40, 0, 0, 0, 0x78, 0x56]);
    bench.run_to(bench.now + 199_999);
    assert_eq!(bench.pdi_read(register::EEPROM_STATUS).0, 0x8241);
    bench.run_to(bench.now + 1);
    assert_eq!(bench.esc.eeprom()[0x80..0x82], [0x78, 0x56]);
    // After it is given back, ECAT must enable each write again.
    bench.pdi().store(register::EEPROM_PDI_ACCESS, 0);
    bench.write(register::EEPROM_CONFIGURATION, 0);
    assert_eq!(bench.read(register::EEPROM_STATUS).0, 0x0040);
}

#[test]
fn the_pdi_takes_what_is_offered_only() {
    let mut bench = Bench::new(&ET1100);
    for (configuration, taken) in [(0, 0), (1, 1), (2, 0), (3, 0)] {
        bench.write(register::EEPROM_CONFIGURATION, configuration);
        bench.pdi().store(register::EEPROM_PDI_ACCESS, 1);
        assert_eq!(bench.read(register::EEPROM_PDI_ACCESS), taken, "{configuration}");
    }
    assert_eq!(bench.fpwr(0x0501, &[1]), 0, "ECAT cannot write it");
}

/// Commands wait for the PDI, which answers with the command and its error bits.
#[test]
fn the_pdi_emulates_the_eeprom() {
    let mut bench = Bench::new(&IP_CORE_32_EMULATED);
    let event = register::al_event::EEPROM;
    assert_eq!(bench.read(register::EEPROM_STATUS).0, 0x0020);
    assert_eq!(bench.pdi().events(), 0);
    bench.fpwr(0x0502, &[0x00, 0x01, 8, 0, 0, 0]);
    assert_eq!((bench.last_al_events(), bench.pdi().events()), (event, event));
    assert_eq!(bench.read(register::EEPROM_STATUS).0, 0x8120);
    assert_eq!(bench.fpwr(0x0508, &[1; 4]), 0, "the data are the PDI's now");
    bench.run_to(bench.now + 1_000_000_000);
    assert_eq!(bench.pdi_read(register::EEPROM_ADDRESS), 8, "it waits as long as it takes");
    bench.pdi().write(0x0508, &[0xAA, 0xBB, 0xCC, 0xDD]);
    bench.pdi().write(0x0502, &[0x00, 0x02]);
    assert_eq!(bench.pdi().events(), event, "another command is no answer");
    bench.pdi().write(0x0502, &[0x00, 0x01]);
    assert_eq!(bench.pdi().events(), 0);
    let expected = [0x20, 0, 8, 0, 0, 0, 0xAA, 0xBB, 0xCC, 0xDD, 0, 0, 0, 0];
    assert_eq!(bench.fprd(0x0502, 14), (expected.to_vec(), 1));
    // A write that fails.
    bench.fpwr(0x0502, &[0x01, 0x02, 9, 0, 0, 0, 0x11, 0x22]);
    assert_eq!(bench.pdi_bytes(0x0508, 2), [0x11, 0x22]);
    bench.pdi().write(0x0502, &[0x00, 0x22]);
    assert_eq!(bench.read(register::EEPROM_STATUS).0, 0x2020);
    bench.fpwr(0x0502, &[0x00, 0x00]);
    assert_eq!(bench.read(register::EEPROM_STATUS).0, 0x0020);
    // Without the enable bit the command does not reach the PDI.
    bench.fpwr(0x0502, &[0x00, 0x02, 9, 0, 0, 0]);
    assert_eq!((bench.read(register::EEPROM_STATUS).0, bench.pdi().events()), (0x4020, 0));
    // An answer without a command has no effect; the PDI does not own the interface.
    bench.pdi().write(0x0502, &[0x00, 0x01]);
    assert_eq!(bench.read(register::EEPROM_STATUS).0, 0x4020);
}

/// Word 7 = 0x88A4 is accepted whatever words 0 to 6 hold; a word that differs by one bit is not.
#[test]
fn a_checksum_may_be_switched_off() {
    for (word, status) in [(0x88A4u16, 0x0040), (0x88A5, 0x1840), (0x89A4, 0x1840)] {
        let mut image = image(SII);
        image[14..16].copy_from_slice(&word.to_le_bytes());
        let esc = Esc::new(&ET1100, image, vec![0; 8192]);
        assert_eq!(esc.register(register::EEPROM_STATUS).0, status, "{word:#06x}");
    }
}
