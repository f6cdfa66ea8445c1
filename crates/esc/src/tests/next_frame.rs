//! Receive times of chips on which a write to 0x0900 enables the ports to stamp the next frame.

use super::*;
use crate::{ET1200, LAN9252};

/// Registers 0x0900 and 0x0904.
fn times(bench: &mut Bench) -> [u32; 2] {
    [register::RECEIVE_TIME_0, register::RECEIVE_TIME_1].map(|time| bench.esc.register(time))
}

/// A frame that writes 0x0900 arrives at port 0 at the instant `at`.
fn latch(bench: &mut Bench, at: u64) {
    bench.run_to(at);
    assert_eq!(bench.bwr(0x0900, &[0; 4]), 1);
    assert!(bench.processed.latch_ports);
    bench.esc.receive_at_port(PortNumber::P0, device(at));
}

/// If no other frame is on its way, the next frame is the one that wrote; later frames change
/// nothing.
#[test]
fn alone_the_writing_frame_is_the_next_one() {
    let mut bench = Bench::new(&ET1200);
    assert!(!bench.esc.awaits_frame(PortNumber::P1));
    latch(&mut bench, 50_000);
    assert!(bench.esc.awaits_frame(PortNumber::P1) && !bench.esc.awaits_frame(PortNumber::P0));
    bench.esc.receive_at_port(PortNumber::P1, device(50_310));
    assert!(!bench.esc.awaits_frame(PortNumber::P1));
    assert!(bench.esc.awaits_frame(PortNumber::P3), "each port for itself");
    assert_eq!(times(&mut bench), [50_000, 50_310]);
    bench.esc.receive_at_port(PortNumber::P1, device(70_310));
    assert_eq!(times(&mut bench), [50_000, 50_310]);
    latch(&mut bench, 100_000);
    bench.esc.receive_at_port(PortNumber::P1, device(100_320));
    assert_eq!(times(&mut bench), [100_000, 100_320]);
}

/// A frame that was still behind the port is stamped instead, if it begins there no earlier than
/// the writing frame begins at the EPU.
#[test]
fn a_frame_on_its_way_is_stamped_instead() {
    for (before, stamp) in [(10, 58_000), (0, 50_000)] {
        let mut bench = Bench::new(&ET1200);
        latch(&mut bench, 50_000);
        bench.esc.receive_at_port(PortNumber::P1, device(50_000 - before));
        bench.esc.receive_at_port(PortNumber::P1, device(58_000));
        assert_eq!(times(&mut bench), [50_000, stamp], "{before} ns before");
    }
    // Other chips identify the frame: they keep the last arrival that was reported.
    let mut bench = Bench::new(&LAN9252);
    latch(&mut bench, 50_000);
    assert!(!bench.esc.awaits_frame(PortNumber::P1));
    bench.esc.receive_at_port(PortNumber::P1, device(58_000));
    assert_eq!(times(&mut bench), [50_000, 58_000]);
}

/// A port stays enabled until a frame arrives or the chip is reset. A port that was not enabled
/// stamps nothing.
#[test]
fn a_port_waits_for_its_frame() {
    let mut bench = Bench::new(&ET1200);
    bench.frame(false, &[(Command::Bwr, Address::Broadcast(0x0900), &[0])]);
    assert!(!bench.esc.awaits_frame(PortNumber::P1), "a bad frame");
    let position = Address::Position(AutoIncrementAddress(0), 0x0900);
    assert_eq!(bench.send(Command::Apwr, position, &[0; 4]).1, 1);
    assert!(!bench.esc.awaits_frame(PortNumber::P1), "not a BWR or FPWR");
    bench.esc.receive_at_port(PortNumber::P1, device(bench.now));
    assert_eq!(times(&mut bench)[1], 0);
    latch(&mut bench, 100_000);
    bench.run_to(5_000_000);
    bench.esc.receive_at_port(PortNumber::P1, device(5_000_000));
    assert_eq!(times(&mut bench), [100_000, 5_000_000]);
    latch(&mut bench, 6_000_000);
    for byte in *b"RES" {
        bench.fpwr(0x0040, &[byte]);
    }
    assert!(!bench.esc.awaits_frame(PortNumber::P1));
    // In reverse mode the ports have stamped before the frame wrote.
    let mut bench = Bench::new(&ET1200);
    bench.write(register::RECEIVE_TIME_LATCH_MODE, 1);
    latch(&mut bench, 100_000);
    assert!(!bench.esc.awaits_frame(PortNumber::P1));
}
