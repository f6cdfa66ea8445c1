//! SyncManagers with a handshake.

use super::*;
use crate::{ET1100, LAN9252};
use isocat_wire::sync_manager::SyncManager;

/// SM0 at 0x1000 and SM1 at 0x1080, 128 bytes each, as every MainDevice sets them.
fn mailboxes(chip: &'static Chip) -> Bench {
    let mut bench = Bench::new(chip);
    let out = SyncManager::new(0x1000, 128, SyncManager::MAILBOX_OUT, true);
    let back = SyncManager::new(0x1080, 128, SyncManager::MAILBOX_IN, true);
    let both = [out.to_bytes(), back.to_bytes()].concat();
    assert_eq!(bench.fpwr(0x0800, &both), 1);
    assert_eq!(bench.last_al_events(), register::al_event::SM_ACTIVATION);
    bench.pdi_bytes(0x0800, 16);
    assert_eq!(bench.pdi().events(), 0);
    bench
}

/// Vectors 16 and 17.
#[test]
fn the_life_of_two_mailboxes() {
    let mut bench = mailboxes(&LAN9252);
    let (sm0, sm1) = (register::sm_status(0), register::sm_status(1));
    assert_eq!((bench.read(sm0), bench.read(sm1)), (0x00, 0x00));
    assert_eq!(bench.send(Command::Fprd, station(0x1080), &[5; 128]), (vec![5; 128], 0));
    // MainDevice to SubDevice.
    assert_eq!(bench.fpwr(0x1000, &[0x11; 128]), 1);
    assert_eq!(bench.last_al_events(), register::al_event::sync_manager(0));
    assert_eq!(bench.read(sm0), 0x09);
    assert_eq!(bench.fpwr(0x1000, &[0x22; 128]), 0, "full");
    assert_eq!(bench.pdi_bytes(0x1000, 128), [0x11; 128]);
    assert_eq!(bench.pdi().events(), 0);
    assert_eq!(bench.read(sm0), 0x02);
    assert_eq!(bench.pdi_bytes(0x1000, 128), [0; 128], "read once");
    // And back.
    bench.pdi().write(0x1080, &[0x33; 128]);
    assert_eq!(bench.read(sm1), 0x09);
    bench.pdi().write(0x1080, &[0x44; 128]);
    assert_eq!(bench.fprd(0x1080, 128), (vec![0x33; 128], 1));
    assert_eq!(bench.last_al_events(), register::al_event::sync_manager(1));
    assert_eq!(bench.read(sm1), 0x02);
    assert_eq!(bench.fprd(0x1080, 128).1, 0);
    // The application acknowledges by opening the buffer for its next message.
    bench.pdi().write(0x1080, &[0]);
    assert_eq!(bench.read(sm1), 0x80);
    assert_eq!(bench.pdi().events(), 0);
}

/// TwinCAT writes the used bytes and then the last byte in one frame; each datagram counts.
#[test]
fn parts_of_a_mailbox() {
    let mut bench = mailboxes(&LAN9252);
    let head = (Command::Fpwr, station(0x1000), &[1, 2, 3][..]);
    let tail = (Command::Fpwr, station(0x107F), &[9][..]);
    let wkc: Vec<_> = bench.frame(true, &[head, tail]).into_iter().map(|(_, wkc)| wkc).collect();
    assert_eq!(wkc, [1, 1]);
    assert_eq!(bench.pdi_bytes(0x1000, 4), [1, 2, 3, 0]);
    assert_eq!(bench.read(register::sm_status(0)), 0x48, "opened, not yet read");
    assert_eq!(bench.pdi_bytes(0x107F, 1), [9]);
    assert_eq!(bench.read(register::sm_status(0)), 0x02);
    // Without its first byte a mailbox does not open.
    assert_eq!(bench.fpwr(0x1001, &[7; 127]), 0);
    assert_eq!(bench.fpwr(0x107F, &[7]), 0);
    // Against the direction of the mailbox no access succeeds.
    assert_eq!(bench.fprd(0x1000, 128).1, 0);
    assert_eq!(bench.fpwr(0x1080, &[1; 128]), 0);
    // One datagram covers two areas: only the free one accepts its part.
    assert_eq!(bench.fpwr(0x1000, &[6; 256]), 1);
    assert_eq!(bench.pdi_bytes(0x1000, 128), [6; 128]);
}

#[test]
fn a_bad_frame_changes_no_hands() {
    let mut bench = mailboxes(&ET1100);
    bench.pdi().write(0x1080, &[0x33; 128]);
    let read = [(Command::Fprd, station(0x1080), &[0; 128][..])];
    assert_eq!(bench.frame(false, &read)[0].1, 1);
    assert_eq!(bench.fprd(0x1080, 128), (vec![0x33; 128], 1), "still there");
    let write = [(Command::Fpwr, station(0x1000), &[1; 128][..])];
    assert_eq!(bench.frame(false, &write)[0].1, 1);
    assert_eq!(bench.esc.register(register::sm_status(0)) & 0x09, 0, "not full");
    assert_eq!(bench.fpwr(0x1000, &[2; 128]), 1);
    assert_eq!(bench.pdi_bytes(0x1000, 128), [2; 128]);
}

#[test]
fn a_running_sync_manager_keeps_its_configuration() {
    let mut bench = mailboxes(&ET1100);
    assert_eq!(bench.fpwr(0x0800, &[0xFF; 5]), 0);
    // The same write with the activate byte counts for that byte only.
    assert_eq!(bench.fpwr(0x0800, &[0, 0x12, 0x40, 0, 0x26, 0, 1, 0]), 1);
    assert_eq!(bench.read(register::SM_0).start, 0x1000);
    // Switched off first, it can be configured in one write.
    bench.fpwr(0x0806, &[0]);
    assert_eq!(bench.fprd(0x1000, 4).1, 1, "plain memory now");
    bench.fpwr(0x0800, &[0, 0x12, 0x40, 0, 0x26, 0, 1, 0]);
    assert_eq!(bench.read(register::SM_0).start, 0x1200);
    assert_eq!(bench.fprd(0x1200, 4).1, 0);
}

#[test]
fn the_pdi_deactivates_and_answers_repeat_requests() {
    let mut bench = mailboxes(&ET1100);
    let control = register::sm_pdi_control(1);
    bench.pdi().write(0x1080, &[0x33; 128]);
    bench.pdi().store(control, 1);
    assert_eq!(bench.pdi_read(control), 1);
    assert_eq!((bench.fprd(0x1080, 128).1, bench.read(register::sm_status(1))), (0, 0));
    bench.pdi().write(0x1080, &[0x44; 128]);
    bench.pdi().store(control, 0);
    assert_eq!(bench.fprd(0x1080, 128).1, 0, "it must be written first");
    // Repeat: two bytes from the status on, as SOEM writes them.
    assert_eq!(bench.fpwr(0x080D, &[0, 3]), 1);
    assert_eq!(bench.last_al_events(), register::al_event::SM_ACTIVATION);
    bench.pdi().write(0x1080, &[0x55; 128]);
    bench.pdi().store(control, 2);
    assert_eq!(bench.read(control), 2);
    assert_eq!(bench.fprd(0x1080, 128), (vec![0x55; 128], 1), "a toggled bit resets nothing");
}

#[test]
fn deactivation_waits_for_the_end_of_the_frame() {
    let mut bench = mailboxes(&ET1100);
    bench.pdi().write(0x1080, &[0x33; 128]);
    let mut buffer = [0; MAX_LEN];
    let mut writer = FrameWriter::new(&mut buffer, [0x10; 6]);
    writer.push(Command::Fprd, 0, station(0x1080), &[0; 128]).unwrap();
    let len = writer.finish();
    let (start, end) = (bench.now, bench.now + duration_ns(len));
    bench.esc.process(&mut buffer[..len], device(start), device(end), true);
    bench.now = start + 10;
    let control = register::sm_pdi_control(1);
    bench.pdi().store(control, 1);
    assert_eq!(bench.pdi_read(control), 0);
    bench.run_to(end);
    assert_eq!(bench.pdi_read(control), 1);
}

/// The mailbox-full flag in the process image: an FMMU maps one bit of a register.
#[test]
fn the_mailbox_flag_in_the_process_image() {
    let mut bench = mailboxes(&ET1100);
    let fmmu = [0, 0, 0, 9, 1, 0, 0, 0, 0x0D, 0x08, 3, 1, 1, 0, 0, 0];
    bench.fpwr(0x0620, &fmmu);
    let image = Address::Logical(0x0900_0000);
    assert_eq!(bench.send(Command::Lrd, image, &[0xF1]), (vec![0xF0], 1));
    bench.pdi().write(0x1080, &[0x33; 128]);
    assert_eq!(bench.send(Command::Lrd, image, &[0xF0]), (vec![0xF1], 1));
    assert_eq!(bench.send(Command::Lwr, image, &[0xFF]).1, 0);
}
