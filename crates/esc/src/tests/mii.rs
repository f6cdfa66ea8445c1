//! MII management and the PHYs.

use super::*;
use crate::{ET1100, ET1100_MII, LAN9252};

/// Reads a PHY register from the wire; status and data.
fn read_phy(bench: &mut Bench, phy: u8, number: u8) -> (u16, u16) {
    assert_eq!(bench.fpwr(0x0510, &[0x00, 0x01, phy, number]), 1);
    bench.run_to(bench.now + 25_600);
    (bench.read(register::MII_STATUS), bench.read(register::MII_DATA))
}

#[test]
fn a_transaction_takes_its_64_bits() {
    let mut bench = Bench::new(&ET1100_MII);
    assert_eq!(bench.read(register::MII_STATUS), 0x0000);
    bench.fpwr(0x0510, &[0x00, 0x01, 1, 4]);
    let done = bench.now + 25_600;
    bench.run_to(done - 1);
    assert_eq!(bench.esc.register(register::MII_STATUS), 0x8100);
    assert_eq!(bench.esc.register(register::MII_DATA), 0);
    bench.run_to(done);
    assert_eq!(bench.esc.register(register::MII_STATUS), 0x0000);
    assert_eq!(bench.esc.register(register::MII_DATA), 0x0181);
    assert_eq!(bench.take_events(), [], "nobody is told");
    // While busy it accepts no second command.
    bench.fpwr(0x0510, &[0x00, 0x01, 1, 4]);
    assert_eq!(bench.fpwr(0x0510, &[0x00, 0x01, 1, 0]), 0);
}

#[test]
fn phys_know_their_links() {
    let mut bench = Bench::new(&ET1100_MII);
    // Port 0 has a link, port 1 has none; PHY 2 and register 7 do not exist.
    assert_eq!(read_phy(&mut bench, 0, 1), (0x0000, 0x602D));
    assert_eq!(read_phy(&mut bench, 1, 1), (0x0000, 0x6009));
    bench.esc.set_port(PortNumber::P1, true);
    assert_eq!(read_phy(&mut bench, 1, 1), (0x0000, 0x602D));
    assert_eq!(read_phy(&mut bench, 1, 5), (0x0000, 0x4181));
    for (phy, number) in [(2, 1), (31, 1), (0, 7), (0, 31)] {
        assert_eq!(read_phy(&mut bench, phy, number), (0x2000, 0xFFFF), "{phy} {number}");
    }
    assert_eq!(read_phy(&mut bench, 0, 2), (0x0000, 0), "the next command clears the error");
    // An EBUS port has no PHY.
    let mut bench = Bench::new(&ET1100);
    assert_eq!(read_phy(&mut bench, 0, 1).0, 0x0000);
    assert_eq!(read_phy(&mut bench, 1, 1).0, 0x2000);
}

#[test]
fn writes_need_the_enable_bit() {
    let mut bench = Bench::new(&ET1100_MII);
    bench.fpwr(0x0510, &[0x00, 0x02, 0, 4, 0x41, 0x00]);
    assert_eq!(bench.read(register::MII_STATUS), 0x4000);
    assert_eq!(read_phy(&mut bench, 0, 4), (0, 0x0181));
    bench.fpwr(0x0510, &[0x01, 0x02, 0, 4, 0x41, 0x00]);
    assert_eq!(bench.read(register::MII_STATUS), 0x8200);
    bench.run_to(bench.now + 25_600);
    assert_eq!(read_phy(&mut bench, 0, 4), (0, 0x0041));
    assert_eq!(read_phy(&mut bench, 1, 4), (0, 0x0181), "the other PHY");
    // Reset and restart of the negotiation clear themselves.
    bench.fpwr(0x0510, &[0x01, 0x02, 0, 0, 0x00, 0xB3]);
    bench.run_to(bench.now + 25_600);
    assert_eq!(read_phy(&mut bench, 0, 0), (0, 0x3100));
    // There is no command 11; no command clears the error.
    bench.fpwr(0x0510, &[0x01, 0x03]);
    assert_eq!(bench.read(register::MII_STATUS), 0x4000);
    bench.fpwr(0x0510, &[0x00, 0x00]);
    assert_eq!(bench.read(register::MII_STATUS), 0x0000);
    bench.frame(false, &[(Command::Fpwr, station(0x0510), &[0x00, 0x01])]);
    assert_eq!(bench.read(register::MII_STATUS), 0x0000, "a bad frame commands nothing");
}

#[test]
fn ecat_and_pdi_share_it() {
    let mut bench = Bench::new(&LAN9252);
    assert_eq!(bench.read(register::MII_STATUS), 0x0006);
    bench.pdi().write(0x0510, &[0x00, 0x01, 0, 1]);
    assert_eq!(bench.read(register::MII_STATUS), 0x0006, "it has not taken it");
    bench.pdi().store(register::MII_PDI_ACCESS, 1);
    assert_eq!(bench.read(register::MII_STATUS), 0x0007);
    assert_eq!(bench.fpwr(0x0510, &[0x00, 0x01, 0, 1]), 0);
    bench.pdi().write(0x0510, &[0x00, 0x01, 0, 1]);
    bench.run_to(bench.now + 25_600);
    assert_eq!(bench.pdi_read(register::MII_DATA), 0x602D);
    // Taken by force, the PDI loses it and cannot take it while the force lasts.
    assert_eq!(bench.fpwr(0x0517, &[1]), 1);
    assert_eq!(bench.read(register::MII_PDI_ACCESS), 1, "bit 0 is not ECAT's");
    bench.write(register::MII_PDI_ACCESS, 2);
    assert_eq!(bench.read(register::MII_PDI_ACCESS), 2);
    bench.pdi().store(register::MII_PDI_ACCESS, 1);
    assert_eq!(bench.read(register::MII_PDI_ACCESS), 2);
    bench.write(register::MII_PDI_ACCESS, 0);
    // ECAT alone has access.
    bench.write(register::MII_ECAT_ACCESS, 1);
    assert_eq!(bench.read(register::MII_STATUS), 0x0004);
    bench.pdi().store(register::MII_PDI_ACCESS, 1);
    assert_eq!(bench.read(register::MII_PDI_ACCESS), 0);
    bench.write(register::MII_ECAT_ACCESS, 0);
    bench.pdi().store(register::MII_PDI_ACCESS, 1);
    assert_eq!(bench.read(register::MII_PDI_ACCESS), 1);
}

#[test]
fn phy_status_of_the_ports() {
    let mut bench = Bench::new(&LAN9252);
    assert_eq!(bench.read(register::PHY_STATUS), 0x0000_0003);
    bench.esc.set_port(PortNumber::P1, true);
    bench.esc.set_port(PortNumber::P0, false);
    assert_eq!(bench.read(register::PHY_STATUS), 0x0000_0300);
    assert_eq!(bench.bwr(0x0518, &[0xFF; 4]), 1);
    assert_eq!(bench.read(register::PHY_STATUS), 0x0000_0300);
    // An ET1100 has neither the link registers nor the access registers.
    let mut bench = Bench::new(&ET1100_MII);
    assert_eq!(bench.fprd(0x0510, 6).1, 1);
    assert_eq!((bench.fprd(0x0516, 2).1, bench.fprd(0x0518, 4).1), (0, 0));
}
