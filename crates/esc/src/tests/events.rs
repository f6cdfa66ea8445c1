//! Ports, DL status, error counters and the ECAT event request.

use super::*;
use crate::chip::{ActivationEvent, ET1100_MII};
use crate::{ET1100, ET1200, LAN9252, PortError};
use isocat_wire::dl::DlStatus;

/// Vector 14.
#[test]
fn dl_status_follows_the_links() {
    let mut bench = Bench::new(&LAN9252);
    bench.pdi().events();
    assert_eq!(bench.read(register::DL_STATUS), DlStatus(0x5617));
    bench.esc.set_port(PortNumber::P1, true);
    assert_eq!(bench.read(register::DL_STATUS), DlStatus(0x5A37));
    let mut bench = Bench::with(&ET1100, [0; 14]);
    bench.esc.set_port(PortNumber::P1, true);
    assert_eq!(bench.read(register::DL_STATUS), DlStatus(0x5A31));
    bench.esc.set_port(PortNumber::P3, true);
    assert_eq!(bench.read(register::DL_STATUS), DlStatus(0x5A31), "an ET1100 has no port 3 here");
}

/// With digital I/O as PDI (0x0140 = 0x04) there is no CPU that could signal that it is alive.
#[test]
fn digital_io_never_misses_the_pdi_watchdog() {
    for (pdi, expected) in [(0x00, 0x5611), (0x03, 0x5611), (0x04, 0x5613), (0x05, 0x5611)] {
        let mut configuration = [0; 14];
        configuration[0] = pdi;
        let mut bench = Bench::with(&LAN9252, configuration);
        assert_eq!(bench.read(register::DL_STATUS), DlStatus(expected), "PDI {pdi:#04x}");
        // This also holds after ten times the watchdog time. With another PDI the access would
        // start it.
        bench.pdi().events();
        bench.run_to(bench.now + 1_000_000_000);
        assert_eq!(bench.read(register::DL_STATUS), DlStatus(expected), "PDI {pdi:#04x}, later");
    }
}

/// Only a read that touches 0x0110, 0x0111 acknowledges the DL event, only one of 0x0130, 0x0131
/// the AL event.
#[test]
fn a_read_beside_a_status_acknowledges_nothing() {
    let mut bench = Bench::new(&LAN9252);
    let requested = |bench: &Bench| bench.esc.ecat_events();
    for (status, event) in [(0x0110, 1 << 2), (0x0130, 1 << 3)] {
        for (first, len, kept) in [
            (status - 2, 2, true),
            (status + 2, 2, true),
            (status - 1, 2, false),
            (status + 1, 2, false),
        ] {
            bench.pdi().write(0x0130, &[2]);
            bench.esc.set_port(PortNumber::P1, true);
            bench.esc.set_port(PortNumber::P1, false);
            assert_ne!(requested(&bench) & event, 0);
            bench.fprd(first, len);
            assert_eq!(requested(&bench) & event != 0, kept, "{len} bytes from {first:#06x}");
        }
    }
}

#[test]
fn loops_by_order() {
    let mut bench = Bench::new(&ET1100);
    for port in [PortNumber::P1, PortNumber::P2] {
        bench.esc.set_port(port, true);
    }
    bench.take_events();
    // Close ports 1, 2 and 3.
    bench.fpwr(0x0101, &[0xFC]);
    let closed = bench.now;
    assert_eq!(bench.take_events(), [(closed, EscEvent::Ports)]);
    let open = |bench: &Bench| PortNumber::ALL.map(|port| bench.esc.dl_status().open(port));
    assert_eq!(open(&bench), [true, false, false, false]);
    assert!(bench.esc.dl_status().link(PortNumber::P1));
    // Automatic again, for about a second.
    bench.fpwr(0x0100, &[0x03, 0x00]);
    let written = bench.now;
    assert_eq!(open(&bench), [true, true, true, false]);
    bench.take_events();
    bench.run_to(written + 999_999_999);
    assert_eq!(bench.take_events(), []);
    bench.run_to(written + 1_000_000_000);
    assert_eq!(bench.take_events(), [(written + 1_000_000_000, EscEvent::Ports)]);
    assert_eq!(open(&bench), [true, false, false, false]);
    assert_eq!(bench.fprd(0x0100, 2).0, [0x01, 0xFC]);
    // Auto-close: after a lost link the port stays closed until the setting is written again.
    bench.fpwr(0x0101, &[0x04]);
    bench.esc.set_port(PortNumber::P1, false);
    bench.esc.set_port(PortNumber::P1, true);
    assert_eq!(open(&bench), [true, false, true, false]);
    bench.fpwr(0x0101, &[0x04]);
    assert_eq!(open(&bench), [true, true, true, false]);
    // It also opens when a good frame is heard at the port. A port that was closed by a setting
    // does not.
    bench.esc.set_port(PortNumber::P1, false);
    assert!(!bench.esc.hear_frame(PortNumber::P1), "no link, no frame");
    bench.esc.set_port(PortNumber::P1, true);
    assert_eq!(open(&bench), [true, false, true, false]);
    bench.read(register::DL_STATUS);
    assert!(!bench.esc.hear_frame(PortNumber::P2), "open already");
    assert!(bench.esc.hear_frame(PortNumber::P1));
    assert_eq!(open(&bench), [true, true, true, false]);
    assert_eq!(bench.read(register::ECAT_EVENT_REQUEST) & 4, 4, "DL status has changed");
    bench.fpwr(0x0101, &[0x0C]);
    assert!(!bench.esc.hear_frame(PortNumber::P1));
    assert_eq!(open(&bench), [true, false, true, false]);
    bench.fpwr(0x0101, &[0x04]);
    // Lost links count at automatic ports only.
    bench.bwr(0x0310, &[0]);
    bench.esc.set_port(PortNumber::P1, false);
    bench.esc.set_port(PortNumber::P2, false);
    assert_eq!(bench.fprd(0x0310, 4).0, [0, 0, 1, 0]);
}

/// Vector 15.
#[test]
fn the_irq_field() {
    let mut bench = Bench::new(&ET1200);
    bench.esc.set_port(PortNumber::P1, true);
    bench.fprd(0x0000, 1);
    assert_eq!(bench.irq, 0);
    bench.bwr(0x0200, &[4, 0]);
    assert_eq!(bench.irq, 0, "the mask is in force at the end of its frame");
    bench.fprd(0x0000, 1);
    assert_eq!(bench.irq, 4);
    assert_eq!(bench.read(register::ECAT_EVENT_REQUEST), 4);
    bench.frame(false, &[(Command::Fprd, station(0x0111), &[0])]);
    bench.fprd(0x0111, 1);
    assert_eq!(bench.irq, 4, "a bad frame acknowledged nothing");
    bench.fprd(0x0000, 1);
    assert_eq!(bench.irq, 0);
    // AL status: set by the PDI, read by ECAT.
    bench.bwr(0x0200, &[8, 0]);
    bench.pdi().store(register::AL_STATUS, isocat_wire::AlStatus(2));
    assert_eq!(bench.read(register::ECAT_EVENT_REQUEST), 8);
    bench.fprd(0x0130, 2);
    assert_eq!(bench.read(register::ECAT_EVENT_REQUEST), 0);
}

#[test]
fn every_changed_sync_manager_is_to_be_acknowledged() {
    let mut bench = Bench::new(&ET1100);
    bench.bwr(0x0800, &[0; 64]);
    assert_eq!(bench.last_al_events(), register::al_event::SM_ACTIVATION);
    bench.pdi_bytes(0x0800, 0x0838 - 0x0800);
    assert_eq!(bench.pdi().events(), register::al_event::SM_ACTIVATION);
    bench.pdi_read(register::sm_activate(7));
    assert_eq!(bench.pdi().events(), 0);
}

/// For a chip with this setting a read of any one activation register is enough; without a read the
/// event stays.
#[test]
fn one_read_may_acknowledge_all_sync_managers() {
    static ANY: Chip = Chip { activation_event: ActivationEvent::Any, ..ET1100_MII };
    let mut bench = Bench::new(&ANY);
    bench.bwr(0x0800, &[0; 64]);
    bench.pdi_bytes(0x0807, 7);
    assert_eq!(
        bench.pdi().events(),
        register::al_event::SM_ACTIVATION,
        "0x0806 and 0x080E were not read"
    );
    bench.pdi_bytes(0x0816, 1);
    assert_eq!(bench.pdi().events(), 0);
}

/// The upper bytes of 0x0220 belong to the moment at which the same side read the first byte.
#[test]
fn halves_of_the_event_request_belong_together() {
    let mut bench = Bench::new(&ET1100);
    let request = register::AL_EVENT_REQUEST.address;
    bench.fpwr(0x0800, &[0x00, 0x10, 4, 0, 0x26, 0, 1, 0]);
    bench.fpwr(0x1000, &[0; 4]);
    let whole = register::al_event::SM_ACTIVATION | register::al_event::sync_manager(0);
    assert_eq!(bench.pdi().events(), whole, "the interrupt's own view is of now");
    assert_eq!(bench.pdi_bytes(request + 1, 1), [0], "the first byte was never read");
    assert_eq!(bench.pdi_bytes(request, 1), [whole as u8]);
    assert_eq!(bench.pdi_bytes(request + 1, 3), whole.to_le_bytes()[1..]);
    assert_eq!(bench.fprd(request + 1, 3).0, [0; 3], "one side's read is not the other's");
    // An event that has ended is shown until the first byte is read again.
    bench.pdi_bytes(0x1000, 4);
    assert_eq!(bench.pdi_bytes(request + 1, 1), [1]);
    assert_eq!(bench.pdi_bytes(request, 2), [whole as u8, 0]);
    assert_eq!(bench.fprd(request, 4).0, register::al_event::SM_ACTIVATION.to_le_bytes());
}

#[test]
fn error_counters_saturate_and_clear_by_groups() {
    let mut bench = Bench::new(&ET1100);
    for _ in 0..300 {
        bench.esc.count_error(PortNumber::P1, PortError::InvalidFrame);
    }
    bench.esc.count_error(PortNumber::P0, PortError::RxError);
    bench.esc.count_error(PortNumber::P2, PortError::Forwarded);
    assert_eq!(bench.fprd(0x0300, 12).0, [0, 1, 0xFF, 0, 0, 0, 0, 0, 0, 0, 1, 0]);
    bench.bwr(0x030C, &[0]);
    assert_eq!(bench.fprd(0x0302, 1).0, [0xFF]);
    bench.bwr(0x0300, &[0x77]);
    assert_eq!(bench.fprd(0x0300, 12).0, [0; 12]);
}

/// Register 0x0204 decides which events interrupt the CPU, and changes nothing else.
#[test]
fn the_interrupt_line() {
    let mut bench = Bench::new(&LAN9252);
    let line = |bench: &Bench| bench.esc.interrupt(device(bench.now));
    assert_eq!(bench.read(register::AL_EVENT_MASK), 0x00FF_FF0F);
    assert!(!line(&bench));
    bench.bwr(0x0120, &[2, 0]);
    assert!(line(&bench));
    bench.pdi().store(register::AL_EVENT_MASK, 0x00FF_FF0E);
    assert!(!line(&bench));
    assert_eq!(bench.pdi_read(register::AL_EVENT_REQUEST), 1, "the request does not care");
    bench.fpwr(0x0800, &[0x00, 0x10, 4, 0, 0x26, 0, 1, 0]);
    assert!(!line(&bench), "SM activation is masked at reset");
    bench.pdi().store(register::AL_EVENT_MASK, 0x0000_0010);
    assert!(line(&bench));
    assert_eq!(bench.fpwr(0x0204, &[0; 4]), 0, "the mask is the PDI's");
}

/// The ring is broken: port 0 has closed by itself.
#[test]
fn circulating_frames_stop() {
    let mut bench = Bench::new(&ET1100);
    bench.esc.set_port(PortNumber::P1, true);
    bench.esc.set_port(PortNumber::P0, false);
    let mut buffer = [0; 60];
    let mut writer = FrameWriter::new(&mut buffer, [0x10; 6]);
    let at = writer.push(Command::Brd, 0, Address::Broadcast(0), &[0]).unwrap();
    writer.finish();
    let pass = |bench: &mut Bench, buffer: &mut [u8]| {
        bench.esc.process(buffer, device(bench.now), device(bench.now + 5_760), true).destroyed
    };
    assert!(!pass(&mut bench, &mut buffer));
    assert_eq!((buffer[at - 3] & 0x40, buffer[at + 1]), (0x40, 1));
    assert!(pass(&mut bench, &mut buffer));
    assert_eq!(buffer[at + 1], 1, "not processed again");
    bench.esc.set_port(PortNumber::P0, true);
    assert!(!pass(&mut bench, &mut buffer));
}

#[test]
fn the_pdi_watchdog() {
    let mut bench = Bench::new(&ET1100);
    assert_eq!(bench.esc.dl_status().0 & DlStatus::PDI_WATCHDOG, 0);
    bench.pdi().events();
    assert_ne!(bench.esc.dl_status().0 & DlStatus::PDI_WATCHDOG, 0);
    let due = bench.now + 100_000_000;
    bench.take_events();
    bench.run_to(due - 1);
    assert_eq!(bench.take_events(), []);
    bench.run_to(due);
    assert_eq!(bench.take_events(), [(due, EscEvent::PdiWatchdogExpired)]);
    assert_eq!(bench.esc.dl_status().0 & DlStatus::PDI_WATCHDOG, 0);
    assert_eq!(bench.read(register::WATCHDOG_COUNTER_PDI), 1);
}
