//! The ports of a device in the letters of an ESI file's `Physics`: one per port, from port 0.

use isocat_esc::chip::{Chip, PortKind};
use isocat_wire::PortNumber;

/// Register 0x0007 from these letters, two bits per port: `Y` is MII, `H` MII with fast hot
/// connect, `K` and `B` are EBUS, a blank is an unused port.
pub(super) fn descriptor(letters: &str) -> u8 {
    let kind = |letter| match letter {
        ' ' => 0,
        'K' | 'B' => EBUS,
        _ => MII,
    };
    letters
        .chars()
        .take(4)
        .enumerate()
        .fold(0, |all, (port, letter)| all | kind(letter) << (2 * port))
}

/// The letters of ports from the names of their kinds in a scan: "MII", "EBUS" or anything else for
/// none.
pub fn port_letters<'a>(kinds: impl Iterator<Item = &'a str>) -> String {
    let letter = |kind| match kind {
        "MII" => 'Y',
        "EBUS" => 'K',
        _ => ' ',
    };
    let all: String = kinds.map(letter).collect();
    all.trim_end().to_owned()
}

/// The letters of a chip's ports, up to the last one that exists.
pub(super) fn letters(chip: &Chip) -> String {
    let letter = |port| match chip.port(port) {
        PortKind::Mii => 'Y',
        PortKind::Ebus => 'K',
        PortKind::None | PortKind::NotConfigured => ' ',
    };
    let all: String = PortNumber::ALL.into_iter().map(letter).collect();
    all.trim_end().to_owned()
}

/// The ports of a chip for the SII, general category, offset 0x10: four bits per port.
pub(super) fn in_sii(chip: &Chip) -> u16 {
    let kind = |port| match chip.port(port) {
        PortKind::Mii => 1,
        PortKind::Ebus => 3,
        PortKind::None | PortKind::NotConfigured => 0_u16,
    };
    PortNumber::ALL.into_iter().fold(0, |all, port| all | kind(port) << (4 * port.index()))
}

/// Values of the two bits in register 0x0007.
const EBUS: u8 = 0b10;
const MII: u8 = 0b11;

#[cfg(test)]
mod tests {
    use isocat_esc::chip::ET1100;

    use super::*;

    #[test]
    fn letters_are_ports() {
        assert_eq!(descriptor("YKY"), ET1100.port_descriptor);
        assert_eq!(descriptor("K KY"), 0b11_10_00_10);
        assert_eq!(in_sii(&ET1100), 0x0131);
        let terminal = ET1100.with_ports(descriptor("KK"));
        assert_eq!(terminal, ET1100.with_ports(0x0A));
        assert_eq!(in_sii(&terminal), 0x0033);
        assert_eq!(letters(&terminal), "KK");
        assert_eq!(letters(&ET1100.with_ports(descriptor("K KY"))), "K KY");
    }
}
