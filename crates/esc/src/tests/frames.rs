//! Frames of all kinds on their way through the EPU.

use super::*;
use crate::{ET1100, ET1200, LAN9252};

/// A BRD of the type register in a frame whose Ethernet header ends with `head`.
fn brd(head: &[u8]) -> (Vec<u8>, usize) {
    let mut buffer = [0; 60];
    let mut writer = FrameWriter::new(&mut buffer, [0x10; 6]);
    let at = writer.push(Command::Brd, 0, Address::Broadcast(0), &[0]).expect("room");
    writer.finish();
    let mut frame = buffer[..12].to_vec();
    frame.extend(head);
    frame.extend(&buffer[14..]);
    (frame, at + head.len() - 2)
}

fn pass(bench: &mut Bench, frame: &mut [u8], good: bool) -> Processed {
    bench.run_to(bench.now);
    let end = bench.now + duration_ns(frame.len());
    let processed = bench.esc.process(frame, device(bench.now), device(end), good);
    bench.run_to(end);
    processed
}

/// IPv4 without options, UDP to port `port`, checksum 0xBEEF.
fn udp(protocol: u8, port: u16) -> Vec<u8> {
    let mut head = vec![0x08, 0x00, 0x45];
    head.extend([0; 8]);
    head.push(protocol);
    head.extend([0; 12]);
    head.extend(port.to_be_bytes());
    head.extend([0x00, 0x17, 0xBE, 0xEF]);
    head
}

#[test]
fn the_udp_variant_is_answered_and_its_checksum_cleared() {
    let mut bench = Bench::new(&ET1100);
    let (mut frame, at) = brd(&udp(17, 0x88A4));
    let before = frame.clone();
    assert_eq!(pass(&mut bench, &mut frame, true), Processed::default());
    assert_eq!(frame[at..at + 3], [0x11, 1, 0]);
    assert_eq!((frame[6], &frame[40..42]), (0x12, &[0, 0][..]));
    // Only the position and the data behind it have changed.
    assert_eq!(frame[7..40], before[7..40]);
    assert_eq!(frame[42..at - 8], before[42..at - 8]);
    for (protocol, port) in [(6, 0x88A4), (17, 0x88A3), (17, 0xA488)] {
        let (mut frame, _) = brd(&udp(protocol, port));
        let before = frame.clone();
        assert!(pass(&mut bench, &mut frame, true).destroyed);
        assert_eq!(frame, before);
    }
}

#[test]
fn a_vlan_tag_stays_as_it_is() {
    let mut bench = Bench::new(&ET1100);
    let (mut frame, at) = brd(&[0x81, 0x00, 0x60, 0x01, 0x88, 0xA4]);
    assert!(!pass(&mut bench, &mut frame, true).destroyed);
    assert_eq!(frame[12..18], [0x81, 0x00, 0x60, 0x01, 0x88, 0xA4]);
    assert_eq!(frame[at..at + 3], [0x11, 1, 0]);
    // The UDP variant behind a tag.
    let (mut frame, at) = brd(&[&[0x81, 0x00, 0x60, 0x01][..], &udp(17, 0x88A4)].concat());
    assert!(!pass(&mut bench, &mut frame, true).destroyed);
    assert_eq!((frame[at], &frame[44..46]), (0x11, &[0, 0][..]));
}

/// DL control bit 0: frames of other protocols end here (the reset value) or pass without a mark.
#[test]
fn frames_of_others() {
    let mut bench = Bench::new(&LAN9252);
    let arp = {
        let mut frame = vec![0xFF; 60];
        frame[12..14].copy_from_slice(&[0x08, 0x06]);
        frame
    };
    let (variables, _) = brd(&[0x88, 0xA4]);
    let mut variables = variables;
    variables[15] = 0x40;
    for (forward, destroyed) in [(1, true), (0, false)] {
        bench.bwr(0x0100, &[1]);
        let (mut mark, _) = brd(&[0x88, 0xA4]);
        bench.write(register::DL_CONTROL, 0x0007_F000 | forward);
        for other in [&arp[..], &arp[..13], &[]] {
            let mut frame = other.to_vec();
            assert_eq!(pass(&mut bench, &mut frame, true).destroyed, destroyed);
            assert_eq!(frame, other);
        }
        // A frame without datagrams is still an EtherCAT frame.
        let mut frame = variables.clone();
        assert!(!pass(&mut bench, &mut frame, true).destroyed);
        assert_eq!(frame, variables);
        // Frames of datagrams are marked by the same bit.
        assert!(!pass(&mut bench, &mut mark, true).destroyed);
        assert_eq!(mark[6], if forward == 1 { 0x12 } else { 0x10 });
    }
}

#[test]
fn unknown_commands_pass_untouched() {
    let mut bench = Bench::new(&ET1100);
    bench.bwr(0x0200, &[4, 0]);
    bench.esc.set_port(PortNumber::P1, true);
    for code in [0, 15, 0x80, 0xFF] {
        let (mut frame, at) = brd(&[0x88, 0xA4]);
        frame[at - 10] = code;
        let before = frame.clone();
        assert!(!pass(&mut bench, &mut frame, true).destroyed);
        assert_eq!(frame[7..], before[7..], "{code:#04x}");
    }
}

/// Commands that the feature bits of a chip exclude are not answered, but positions are
/// incremented.
#[test]
fn commands_that_a_chip_does_not_have() {
    use isocat_wire::register::features::{NO_LRW, NO_READ_WRITE};
    static CHIP: Chip =
        Chip { features: 0x01CC | NO_LRW | NO_READ_WRITE, ..crate::chip::IP_CORE_BASE };
    let mut bench = Bench::new(&CHIP);
    bench.fpwr(0x0600, &isocat_wire::fmmu::Fmmu::bytes(0, 2, 0x1000, 3).to_bytes());
    let image = Address::Logical(0);
    let position = Address::Position(AutoIncrementAddress(0), 0x1000);
    for (command, address) in [
        (Command::Lrw, image),
        (Command::Aprw, position),
        (Command::Fprw, station(0x1000)),
        (Command::Brw, Address::Broadcast(0x1000)),
    ] {
        assert_eq!(bench.send(command, address, &[7, 7]), (vec![7, 7], 0), "{command}");
    }
    assert_eq!(bench.send(Command::Lrd, image, &[7, 7]), (vec![0, 0], 1), "and nothing written");
    assert_eq!(bench.send(Command::Lwr, image, &[1, 2]).1, 1);
    assert_eq!(bench.fprd(0x1000, 2).0, [1, 2]);
}

/// All datagrams of a frame show the events that were set at its arrival.
#[test]
fn the_irq_field_is_sampled_once_a_frame() {
    let mut bench = Bench::new(&ET1100);
    bench.bwr(0x0200, &[0xF0, 0x0F]);
    // SM0, read by ECAT, raises ECAT event bit 4 when the PDI has written.
    bench.fpwr(0x0800, &[0x00, 0x10, 4, 0, 0x12, 0, 1, 0]);
    bench.pdi().write(0x1000, &[1; 4]);
    let mut buffer = [0; 100];
    let mut writer = FrameWriter::new(&mut buffer, [0x10; 6]);
    writer.push(Command::Fprd, 0, station(0x1000), &[0; 4]).expect("room");
    writer.push(Command::Fprd, 1, station(0x0000), &[0]).expect("room");
    let len = writer.finish();
    pass(&mut bench, &mut buffer[..len], true);
    let irq = |frame: &[u8]| -> Vec<u16> {
        datagrams(payload(frame).expect("a frame"))
            .map(|datagram| datagram.expect("whole").header.irq)
            .collect()
    };
    assert_eq!(irq(&buffer[..len]), [0x0010, 0x0010]);
    // Bits that other devices have set in the field stay.
    bench.pdi().write(0x1000, &[1; 4]);
    (buffer[24], buffer[25]) = (0x03, 0);
    pass(&mut bench, &mut buffer[..len], true);
    assert_eq!(irq(&buffer[..len])[0], 0x0013);
}

/// Register 0x030C: bad frames, and chains of datagrams that are cut off.
#[test]
fn the_epu_counts_what_it_cannot_process() {
    let mut bench = Bench::new(&ET1100);
    let (frame, at) = brd(&[0x88, 0xA4]);
    let count = |bench: &Bench| bench.esc.register(register::EPU_ERRORS);
    pass(&mut bench, &mut frame.clone(), true);
    assert_eq!(count(&bench), 0);
    pass(&mut bench, &mut frame.clone(), false);
    assert_eq!(count(&bench), 1);
    let mut cut = frame.clone();
    cut[at - 3] |= 0x80;
    cut.truncate(at + 3 + 11);
    pass(&mut bench, &mut cut, true);
    assert_eq!((count(&bench), &cut[at..at + 3]), (2, &[0x11, 1, 0][..]), "the whole one counts");
    let mut cut = frame[..at + 2].to_vec();
    pass(&mut bench, &mut cut, true);
    assert_eq!((count(&bench), cut[at]), (3, 0));
    pass(&mut bench, &mut cut, false);
    assert_eq!(count(&bench), 4, "one fault, one count");
    assert_eq!(bench.fprd(0x0300, 12).0, [0; 12], "ports count for themselves");
    bench.bwr(0x030C, &[0xFF]);
    assert_eq!(count(&bench), 0);
    for _ in 0..256 {
        pass(&mut bench, &mut frame.clone(), false);
    }
    assert_eq!(count(&bench), 255);
}

/// Registers 0x0300-0x0313 form four groups; any write into a group clears that group only.
#[test]
fn error_counters_clear_by_groups() {
    use crate::PortError;
    let all = [1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 0, 0, 0, 1, 1, 1, 1];
    for (address, cleared) in [
        (0x02FF, 0..0),
        (0x0300, 0..12),
        (0x030B, 0..12),
        (0x030C, 12..13),
        (0x030D, 13..14),
        (0x0310, 16..20),
        (0x0313, 16..20),
        (0x0314, 0..0),
    ] {
        let mut bench = Bench::new(&ET1100);
        for port in PortNumber::ALL {
            bench.esc.count_error(port, PortError::InvalidFrame);
            bench.esc.count_error(port, PortError::RxError);
            bench.esc.count_error(port, PortError::Forwarded);
            bench.esc.set_port(port, true);
            bench.esc.set_port(port, false);
        }
        let (mut bad, _) = brd(&[0x88, 0xA4]);
        pass(&mut bench, &mut bad, false);
        let mut expected = all;
        // A port that the chip does not have was never open.
        expected[19] = 0;
        assert_eq!(bench.fprd(0x0300, 20).0, expected);
        assert_eq!(bench.bwr(address, &[0]), u16::from(!cleared.is_empty()), "{address:#06x}");
        expected[cleared].fill(0);
        assert_eq!(bench.fprd(0x0300, 20).0, expected, "{address:#06x}");
    }
}

/// Register 0x0108: a read-write command writes at a higher address than it reads.
#[test]
fn a_physical_offset() {
    let mut bench = Bench::new(&LAN9252);
    bench.fpwr(0x1100, &[1, 2, 3, 4]);
    bench.write(register::PHYSICAL_OFFSET, 0x0100);
    assert_eq!(bench.send(Command::Fprw, station(0x1100), &[9; 4]), (vec![1, 2, 3, 4], 3));
    assert_eq!(bench.fprd(0x1100, 4).0, [1, 2, 3, 4]);
    assert_eq!(bench.fprd(0x1200, 4).0, [9; 4]);
    // Plain reads and writes ignore it.
    bench.fpwr(0x1100, &[5]);
    assert_eq!((bench.fprd(0x1100, 1).0, bench.fprd(0x1200, 1).0), (vec![5], vec![9]));
    // With an offset of one byte, each byte read is the one written just before.
    bench.write(register::PHYSICAL_OFFSET, 1);
    bench.fpwr(0x1300, &[7, 0, 0, 0]);
    assert_eq!(bench.send(Command::Brw, Address::Broadcast(0x1300), &[1, 2, 3]).0, [7, 3, 3]);
    assert_eq!(bench.fprd(0x1300, 4).0, [7, 1, 2, 3]);
    // A write beyond the memory is not counted, but the read is. Across the end of the address
    // space both are counted.
    bench.write(register::PHYSICAL_OFFSET, 0x4000);
    assert_eq!(bench.send(Command::Fprw, station(0x1100), &[9]).1, 1);
    bench.write(register::PHYSICAL_OFFSET, 0xFF00);
    assert_eq!(bench.send(Command::Fprw, station(0x1200), &[8]).1, 3);
    assert_eq!(bench.fprd(0x1100, 1).0, [8]);
    // This chip does not have the register.
    let mut bench = Bench::new(&ET1200);
    assert_eq!((bench.fprd(0x0108, 2).1, bench.fpwr(0x0108, &[0, 1])), (0, 0));
}
