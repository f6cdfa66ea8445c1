//! The common rules of SyncManagers and FMMUs, tested one by one.

use super::*;
use crate::{ET1100, ET1200, IP_CORE_32, LAN9252};
use isocat_wire::fmmu::Fmmu;
use isocat_wire::sync_manager::SyncManager;

fn configure(bench: &mut Bench, number: usize, start: u16, length: u16, control: u8) {
    let manager = SyncManager::new(start, length, control, true);
    let address = register::sync_manager(number).address;
    assert_eq!(bench.fpwr(address, &manager.to_bytes()), 1);
    bench.pdi_bytes(address, 8);
}

fn wkc(answers: Vec<(Vec<u8>, u16)>) -> Vec<u16> {
    answers.into_iter().map(|(_, wkc)| wkc).collect()
}

#[test]
fn a_buffer_is_filled_over_several_frames() {
    let mut bench = Bench::new(&LAN9252);
    configure(&mut bench, 0, 0x1000, 8, SyncManager::MAILBOX_OUT);
    let status = |bench: &mut Bench| bench.read(register::sm_status(0));
    assert_eq!(bench.fpwr(0x1002, &[9]), 0, "an inner byte of a closed buffer");
    assert_eq!(bench.fpwr(0x1000, &[1]), 1);
    assert_eq!(status(&mut bench), SyncManager::STATUS_WRITING);
    assert_eq!(bench.fpwr(0x1004, &[5, 6]), 1);
    assert_eq!(bench.fpwr(0x1002, &[3]), 1, "in any order");
    // A write of the first byte starts again from the beginning.
    assert_eq!(bench.fpwr(0x1000, &[0x11]), 1);
    assert_eq!(status(&mut bench), SyncManager::STATUS_WRITING);
    assert_eq!(bench.fpwr(0x1007, &[8]), 1);
    assert_eq!(status(&mut bench), 0x09);
    assert_eq!(bench.fpwr(0x1004, &[0]), 0);
    assert_eq!(bench.pdi_bytes(0x1000, 8), [0x11, 0, 3, 0, 5, 6, 0, 8]);
}

/// Status bits 6 and 7 exist on all chips but the ET1100. The buffers behave in the same way there:
/// the bit of the buffer that was read is cleared when the next one is opened.
#[test]
fn buffers_in_use_show_by_chip() {
    for (chip, shown) in [(&ET1100, 0x00), (&ET1200, 0xC0), (&LAN9252, 0xC0), (&IP_CORE_32, 0xC0)] {
        let mut bench = Bench::new(chip);
        configure(&mut bench, 0, 0x1000, 8, SyncManager::MAILBOX_OUT);
        configure(&mut bench, 1, 0x1080, 8, SyncManager::MAILBOX_IN);
        bench.pdi().write(0x1080, &[1; 8]);
        assert_eq!(bench.fprd(0x1080, 8).1, 1);
        assert_eq!(bench.read(register::sm_status(1)), SyncManager::STATUS_READ);
        bench.pdi().write(0x1080, &[1; 7]);
        assert_eq!(bench.read(register::sm_status(1)), shown & 0x80, "{} writes", chip.name);
        bench.pdi().write(0x1087, &[1]);
        assert_eq!(bench.read(register::sm_status(1)), 0x09, "{} has written", chip.name);
        bench.fpwr(0x1000, &[2; 8]);
        bench.pdi_bytes(0x1000, 1);
        assert_eq!(bench.read(register::sm_status(0)), 0x08 | shown & 0x40, "{} reads", chip.name);
        bench.pdi_bytes(0x1007, 1);
        assert_eq!(bench.read(register::sm_status(0)), 0x02, "{} has read", chip.name);
    }
}

/// Bits 4 to 11 of the ECAT event request, and so the IRQ field of every frame, show only events of
/// SyncManagers that are set to raise them: control bit 4.
#[test]
fn ecat_events_only_of_sync_managers_that_raise_them() {
    for (control, expected) in [(0x00, [0, 0]), (SyncManager::CONTROL_ECAT_EVENT, [1 << 4, 1 << 5])]
    {
        let mut bench = Bench::new(&LAN9252);
        configure(&mut bench, 0, 0x1000, 8, SyncManager::MAILBOX_OUT | control);
        configure(&mut bench, 1, 0x1080, 8, SyncManager::MAILBOX_IN | control);
        bench.read(register::DL_STATUS);
        bench.write(register::ECAT_EVENT_MASK, 0x0FF0);
        let requested = |bench: &mut Bench| bench.read(register::ECAT_EVENT_REQUEST) & 0x0FF0;
        assert_eq!(requested(&mut bench), 0, "nothing was exchanged yet");
        bench.fpwr(0x1000, &[2; 8]);
        assert_eq!(requested(&mut bench), 0, "the PDI has not read yet");
        bench.pdi_bytes(0x1000, 8);
        assert_eq!((requested(&mut bench), bench.irq), (expected[0], expected[0]));
        bench.fpwr(0x1000, &[2; 8]);
        bench.pdi().write(0x1080, &[1; 8]);
        assert_eq!((requested(&mut bench), bench.irq), (expected[1], expected[1]));
    }
}

/// One frame opens and closes the buffer, then opens it again: it stays open.
#[test]
fn the_first_byte_restarts_also_within_a_frame() {
    let mut bench = Bench::new(&LAN9252);
    configure(&mut bench, 0, 0x1000, 4, SyncManager::MAILBOX_OUT);
    let whole = (Command::Fpwr, station(0x1000), &[1; 4][..]);
    let first = (Command::Fpwr, station(0x1000), &[2][..]);
    assert_eq!(wkc(bench.frame(true, &[whole, first])), [1, 1]);
    assert_eq!(bench.read(register::sm_status(0)), SyncManager::STATUS_WRITING);
    assert_eq!(bench.fpwr(0x1003, &[3]), 1);
    assert_eq!(bench.pdi_bytes(0x1000, 4), [2, 1, 1, 3]);
}

/// After a bad frame status and buffers, opened or not, are as before it.
#[test]
fn a_bad_frame_is_as_if_it_had_not_been() {
    let mut bench = Bench::new(&ET1100);
    configure(&mut bench, 0, 0x1000, 4, SyncManager::MAILBOX_OUT);
    configure(&mut bench, 1, 0x1080, 4, SyncManager::MAILBOX_IN);
    configure(&mut bench, 2, 0x1100, 4, SyncManager::INPUTS);
    bench.fpwr(0x1000, &[1; 2]);
    bench.pdi().write(0x1080, &[2; 4]);
    for value in [3, 4] {
        bench.pdi().write(0x1100, &[value; 4]);
    }
    let before = bench.esc.registers().to_vec();
    let events = bench.pdi().events();
    let list = [
        (Command::Fpwr, station(0x1000), &[9; 4][..]),
        (Command::Fprd, station(0x1080), &[0; 4][..]),
        (Command::Fprd, station(0x1100), &[0; 4][..]),
        (Command::Fprd, station(0x1080), &[0; 1][..]),
    ];
    assert_eq!(wkc(bench.frame(false, &list)), [1, 1, 1, 1]);
    assert_eq!(bench.esc.registers()[0x0800..0x0880], before[0x0800..0x0880]);
    assert_eq!(bench.pdi().events(), events);
    // The outputs that were half written are completed; the other outputs are read.
    assert_eq!(bench.fpwr(0x1002, &[1; 2]), 1);
    assert_eq!(bench.pdi_bytes(0x1002, 2), [0; 2]);
    assert_eq!(bench.fprd(0x1080, 4), (vec![2; 4], 1));
    assert_eq!(bench.fprd(0x1100, 4), (vec![4; 4], 1));
}

#[test]
fn the_configuration_is_locked_from_before_the_frame() {
    let mut bench = Bench::new(&ET1100);
    configure(&mut bench, 0, 0x1000, 4, SyncManager::MAILBOX_OUT);
    // A switch-off in the same frame comes too late for this frame.
    let off = (Command::Fpwr, station(0x0806), &[0][..]);
    let start = (Command::Fpwr, station(0x0800), &[0x00, 0x12][..]);
    assert_eq!(wkc(bench.frame(true, &[off, start])), [1, 0]);
    assert_eq!(bench.read(register::SM_0).start, 0x1000);
    assert_eq!(wkc(bench.frame(true, &[start])), [1]);
    // The wire cannot write status and PDI control.
    assert_eq!((bench.fpwr(0x0805, &[0xFF]), bench.fpwr(0x0807, &[0xFF])), (0, 0));
    // Switched on and configured in two datagrams of one frame.
    let on = (Command::Fpwr, station(0x0806), &[1][..]);
    let rest = (Command::Fpwr, station(0x0802), &[2, 0, 0x26][..]);
    assert_eq!(wkc(bench.frame(true, &[on, rest])), [1, 1]);
    assert_eq!(bench.fpwr(0x1200, &[1, 2]), 1);
    assert_eq!(bench.read(register::sm_status(0)), 0x09);
    // Switched off and on again, the mailbox is empty.
    bench.fpwr(0x0806, &[0]);
    assert_eq!(bench.read(register::sm_status(0)), 0x00);
    bench.fpwr(0x0806, &[1]);
    assert_eq!(bench.fpwr(0x1200, &[3, 4]), 1);
}

#[test]
fn one_byte_has_no_handshake() {
    for control in [SyncManager::MAILBOX_OUT, SyncManager::OUTPUTS] {
        let mut bench = Bench::new(&ET1100);
        configure(&mut bench, 0, 0x1000, 1, control);
        for value in [1, 2] {
            assert_eq!(bench.fpwr(0x1000, &[value]), 1, "never full");
            assert_eq!(bench.pdi().events(), register::al_event::sync_manager(0));
        }
        assert_eq!(bench.pdi_bytes(0x1000, 1), [2]);
        assert_eq!(bench.pdi().events(), 0);
        assert_eq!(bench.pdi_bytes(0x1000, 1), [2], "never empty");
        assert_eq!(bench.fpwr(0x1001, &[7; 2]), 1, "one byte reserves one byte");
        // The direction stays in force.
        assert_eq!(bench.fprd(0x1000, 1).1, 0);
        bench.pdi().write(0x1000, &[9]);
        assert_eq!(bench.pdi_bytes(0x1000, 1), [2]);
    }
}

#[test]
fn no_byte_guards_nothing() {
    let mut bench = Bench::new(&ET1100);
    configure(&mut bench, 0, 0x1000, 0, SyncManager::MAILBOX_OUT);
    assert_eq!(bench.fpwr(0x1000, &[1; 4]), 1);
    assert_eq!(bench.fprd(0x1000, 4), (vec![1; 4], 1));
    assert_eq!(bench.pdi().events(), 0);
}

/// Where areas overlap, the SyncManager with the lower number guards the byte.
#[test]
fn overlapping_areas() {
    let mut bench = Bench::new(&ET1100);
    configure(&mut bench, 0, 0x1000, 4, SyncManager::MAILBOX_OUT);
    configure(&mut bench, 1, 0x1002, 4, SyncManager::MAILBOX_IN);
    assert_eq!(bench.fpwr(0x1000, &[1, 2, 3, 4]), 1);
    assert_eq!(bench.read(register::sm_status(0)), 0x09);
    assert_eq!(bench.read(register::sm_status(1)), 0x00);
    assert_eq!(bench.pdi_bytes(0x1000, 4), [1, 2, 3, 4]);
    // SM1's first byte belongs to SM0, so SM1 never opens.
    bench.pdi().write(0x1002, &[5; 4]);
    assert_eq!(bench.fprd(0x1004, 2).1, 0);
}

/// One datagram covers free memory, two areas and free memory again: each part is accessed where
/// allowed.
#[test]
fn one_access_over_several_areas() {
    let mut bench = Bench::new(&LAN9252);
    configure(&mut bench, 0, 0x1010, 4, SyncManager::MAILBOX_OUT);
    configure(&mut bench, 1, 0x1014, 4, SyncManager::MAILBOX_IN);
    let data: Vec<u8> = (1..=16).collect();
    assert_eq!(bench.fpwr(0x100C, &data), 1);
    assert_eq!(bench.pdi_bytes(0x1010, 4), [5, 6, 7, 8]);
    assert_eq!(bench.send(Command::Fprd, station(0x100C), &[0xEE; 16]), {
        let mut expected = vec![0xEE; 16];
        expected[..4].copy_from_slice(&[1, 2, 3, 4]);
        expected[12..].copy_from_slice(&[13, 14, 15, 16]);
        (expected, 1)
    });
}

#[test]
fn repeat_gives_the_last_mailbox_again() {
    let mut bench = Bench::new(&LAN9252);
    configure(&mut bench, 1, 0x1080, 4, SyncManager::MAILBOX_IN);
    bench.pdi().write(0x1080, &[1; 4]);
    assert_eq!(bench.fprd(0x1080, 4).1, 1);
    bench.pdi().write(0x1080, &[2; 4]);
    // The answer of the read was lost: the MainDevice toggles the request.
    assert_eq!(bench.fpwr(0x080D, &[0, 3]), 1);
    assert_eq!(bench.last_al_events(), register::al_event::SM_ACTIVATION);
    assert_eq!(bench.pdi_read(register::sm_activate(1)), 3);
    // A newer mailbox is waiting: discard it, provide the last one again, then acknowledge.
    let control = register::sm_pdi_control(1);
    bench.pdi().store(control, 1);
    bench.pdi().store(control, 0);
    bench.pdi().write(0x1080, &[1; 4]);
    bench.pdi().store(control, 2);
    assert_eq!(bench.read(control), 2);
    assert_eq!(bench.fprd(0x1080, 4), (vec![1; 4], 1));
}

/// An area that the PDI deactivated is locked for both sides, has no events, and is empty
/// afterwards.
#[test]
fn deactivated_areas_are_locked() {
    let mut bench = Bench::new(&ET1100);
    configure(&mut bench, 2, 0x1100, 4, SyncManager::OUTPUTS);
    bench.fpwr(0x1100, &[1; 4]);
    let event = register::al_event::sync_manager(2);
    assert_eq!(bench.pdi().events(), event);
    let control = register::sm_pdi_control(2);
    bench.pdi().store(control, 1);
    assert_eq!(bench.pdi().events(), 0);
    assert_eq!(bench.fpwr(0x1100, &[2; 4]), 0);
    assert_eq!(bench.pdi_bytes(0x1100, 4), [0; 4]);
    bench.pdi().store(control, 0);
    assert_eq!(bench.pdi_bytes(0x1100, 4), [0; 4], "nothing was written since");
    assert_eq!(bench.fpwr(0x1100, &[3; 4]), 1);
    assert_eq!(bench.pdi().events(), event);
    assert_eq!(bench.pdi_bytes(0x1100, 4), [3; 4]);
}

#[test]
fn several_fmmus_in_one_datagram_count_once() {
    let mut bench = Bench::new(&ET1100);
    for (number, logical, physical) in [(0, 0x100, 0x1100), (1, 0x104, 0x1200), (2, 0x108, 0x080D)]
    {
        let len = if number == 2 { 1 } else { 2 };
        let fmmu = Fmmu::bytes(logical, len, physical, Fmmu::READ);
        bench.fpwr(register::fmmu(number).address, &fmmu.to_bytes());
    }
    bench.fpwr(register::fmmu(3).address, &Fmmu::bytes(0x100, 9, 0x1300, Fmmu::WRITE).to_bytes());
    bench.fpwr(0x1100, &[1, 2]);
    bench.fpwr(0x1200, &[3, 4]);
    let image = Address::Logical(0x100);
    let (data, wkc) = bench.send(Command::Lrd, image, &[0xEE; 9]);
    assert_eq!((&data[..], wkc), (&[1, 2, 0xEE, 0xEE, 3, 4, 0xEE, 0xEE, 0x30][..], 1));
    let (_, wkc) = bench.send(Command::Lrw, image, &[7; 9]);
    assert_eq!(wkc, 3);
    assert_eq!(bench.fprd(0x1300, 9).0, [7; 9]);
    // No FMMU maps the bytes between the two.
    assert_eq!(bench.send(Command::Lrd, Address::Logical(0x102), &[5; 2]), (vec![5; 2], 0));
}

/// A process image in two datagrams: the first opens the buffer, the second closes it.
#[test]
fn a_datagram_may_cover_a_part_of_an_area() {
    let mut bench = Bench::new(&ET1100);
    configure(&mut bench, 2, 0x1100, 4, SyncManager::OUTPUTS);
    bench.fpwr(0x0600, &Fmmu::bytes(0x200, 4, 0x1100, Fmmu::WRITE).to_bytes());
    let head = (Command::Lwr, Address::Logical(0x200), &[1, 2][..]);
    let tail = (Command::Lwr, Address::Logical(0x202), &[3, 4][..]);
    assert_eq!(wkc(bench.frame(true, &[tail])), [0], "not open");
    assert_eq!(wkc(bench.frame(true, &[head, tail])), [1, 1]);
    assert_eq!(bench.pdi_bytes(0x1100, 4), [1, 2, 3, 4]);
}

/// FMMUs that map registers follow the rules of registers.
#[test]
fn a_fmmu_onto_registers() {
    let mut bench = Bench::new(&ET1100);
    bench.fpwr(0x0600, &Fmmu::bytes(0x300, 2, 0x0400, Fmmu::WRITE).to_bytes());
    bench.fpwr(0x0610, &Fmmu::bytes(0x300, 2, 0x0400, Fmmu::READ).to_bytes());
    bench.fpwr(0x0620, &Fmmu::bytes(0x310, 2, 0x0000, Fmmu::WRITE).to_bytes());
    bench.fpwr(0x0630, &Fmmu::bytes(0x320, 2, 0x0A00, Fmmu::READ).to_bytes());
    let image = Address::Logical(0x300);
    assert_eq!(bench.send(Command::Lrw, image, &[0x34, 0x12]), (vec![0xC2, 0x09], 3));
    assert_eq!(bench.read(register::WATCHDOG_DIVIDER), 0x1234);
    bench.frame(false, &[(Command::Lwr, image, &[0, 0])]);
    assert_eq!(bench.read(register::WATCHDOG_DIVIDER), 0x1234);
    assert_eq!(bench.send(Command::Lwr, Address::Logical(0x310), &[1, 2]).1, 0, "read-only");
    assert_eq!(bench.send(Command::Lrd, Address::Logical(0x320), &[1, 2]), (vec![1, 2], 0));
}

/// Registers 0x09F0, 0x09F8, 0x09FC: local times of buffer changes, for SyncManagers that ask for
/// them.
#[test]
fn buffer_change_times() {
    let mut bench = Bench::new(&ET1100);
    let times = |bench: &Bench| {
        [
            bench.esc.register(register::ECAT_BUFFER_CHANGE_TIME),
            bench.esc.register(register::PDI_BUFFER_START_TIME),
            bench.esc.register(register::PDI_BUFFER_CHANGE_TIME),
        ]
    };
    configure(&mut bench, 2, 0x1100, 4, SyncManager::OUTPUTS);
    bench.fpwr(0x1100, &[1; 4]);
    bench.pdi_bytes(0x1100, 4);
    assert_eq!(times(&bench), [0; 3], "nobody asked");
    // For ECAT the arrival of the frame that closes counts, not of the one that opens.
    assert_eq!(bench.fpwr(0x0816, &[SyncManager::ENABLE | SyncManager::LATCH_ECAT]), 1);
    assert_eq!(bench.fpwr(0x1100, &[2; 2]), 1);
    assert_eq!(times(&bench), [0; 3]);
    bench.run_to(bench.now + 1_237);
    let local = |bench: &Bench| bench.esc.local_time(device(bench.now)).count() as u32;
    let ecat = local(&bench);
    bench.frame(false, &[(Command::Fpwr, station(0x1102), &[2; 2])]);
    assert_eq!(times(&bench), [0; 3], "a bad frame changes no buffer");
    let ecat = ecat + duration_ns(60) as u32;
    assert_eq!(bench.fpwr(0x1102, &[2; 2]), 1);
    // The frame arrived between two ticks, and its end waits for the next tick.
    assert_eq!(times(&bench), [0; 3]);
    bench.run_to(bench.now.next_multiple_of(10));
    assert_eq!(times(&bench), [ecat, 0, 0]);
    bench.pdi_bytes(0x1100, 4);
    assert_eq!(times(&bench), [ecat, 0, 0]);
    // PDI: opening and closing.
    bench.fpwr(0x0816, &[SyncManager::ENABLE | SyncManager::LATCH_PDI]);
    bench.fpwr(0x1100, &[3; 4]);
    bench.run_to(bench.now + 555);
    let start = local(&bench);
    bench.pdi_bytes(0x1100, 1);
    assert_eq!(times(&bench), [ecat, start, 0]);
    bench.run_to(bench.now + 5_000);
    bench.pdi_bytes(0x1101, 2);
    assert_eq!(times(&bench), [ecat, start, 0]);
    bench.pdi_bytes(0x1103, 1);
    assert_eq!(times(&bench), [ecat, start, local(&bench)]);
    assert_eq!(bench.fprd(0x09F0, 4).0, ecat.to_le_bytes());
    assert_eq!(bench.bwr(0x09F0, &[0; 16]), 0, "read-only");
}
