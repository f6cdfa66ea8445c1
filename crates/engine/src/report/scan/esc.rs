//! Registers of an ESC in words.

use std::fmt;

use isocat_maindevice::SubDevice;
use isocat_maindevice::segment::DcCapability;
use isocat_wire::PortNumber;
use isocat_wire::register::features;
use isocat_wire::sii::{Header, sm_type};
use isocat_wire::sync_manager::SyncManager;

use super::Esc;

pub(super) fn esc(device: &SubDevice) -> Esc {
    let esc = &device.esc;
    let words = &device.sii.header.configuration;
    let pulse = i64::from(u16::from_le_bytes([words[4], words[5]])) * TICK;
    // Of an SII that could not be read nothing is known.
    let is_read = words.iter().any(|byte| *byte != 0);
    let sync_unit = esc.configuration & SYNC_UNIT != 0;
    Esc {
        kind: esc.kind,
        kind_name: kind(esc.kind).to_owned(),
        revision: esc.revision,
        build: esc.build,
        fmmus: esc.fmmus,
        sync_managers: esc.sync_managers,
        ram_kib: esc.ram,
        features: esc.features,
        features_in_words: self::words(&FEATURES, esc.features),
        pdi: device.observed.pdi,
        pdi_name: device.observed.pdi.map(|kind| pdi(kind).to_owned()),
        device_emulation: esc.device_emulation(),
        dc: dc(device.dc).to_owned(),
        sync_unit,
        sync_pulse_ns: (sync_unit && is_read).then_some(pulse),
        latch_unit: esc.configuration & LATCH_UNIT != 0,
        sync_latch: device.observed.sync_latch,
        pins: device.observed.sync_latch.map_or(Vec::new(), pins),
    }
}

/// Name of an ESC type, register 0x0000.
fn kind(kind: u8) -> &'static str {
    match kind {
        0x04 => "IP core",
        0x11 => "ET1100",
        0x12 => "ET1200",
        0x98 => "XMC4x00",
        0xC0 => "LAN925x",
        _ => "unknown kind",
    }
}

/// Name of a PDI, register 0x0140.
fn pdi(kind: u8) -> &'static str {
    match kind {
        0x00 => "none",
        0x01..=0x03 => "digital I/O, 4 bit",
        0x04 => "digital I/O",
        0x05 => "SPI",
        0x06 => "oversampling I/O",
        0x07 => "EtherCAT bridge",
        0x08 => "16 bit asynchronous microcontroller",
        0x09 => "8 bit asynchronous microcontroller",
        0x0A => "16 bit synchronous microcontroller",
        0x0B => "8 bit synchronous microcontroller",
        0x10..=0x14 => "digital I/O, 32 bit",
        0x80 => "on-chip bus",
        _ => "unknown",
    }
}

pub(super) fn dc(capability: DcCapability) -> &'static str {
    match capability {
        DcCapability::None => "none",
        DcCapability::ReceiveTimes => "receive-times",
        DcCapability::Clock32 => "32-bit",
        DcCapability::Clock64 => "64-bit",
    }
}

/// Register 0x0151 in words: the use of either pin, and whether its pulse reaches the PDI as an
/// event.
fn pins(word: u8) -> Vec<String> {
    let pin = |number: u8, bits: u8| {
        let driver =
            ["push-pull, active low", "open drain", "push-pull, active high", "open source"]
                [usize::from(bits & 3)];
        let use_ = match bits & 4 != 0 {
            true => format!("SYNC{number} output ({driver})"),
            false => format!("LATCH{number} input"),
        };
        let event = if bits & 8 != 0 { "" } else { "not " };
        format!("{use_}, SYNC{number} {event}mapped to the AL event")
    };
    vec![pin(0, word & 0x0F), pin(1, word >> 4)]
}

/// Kind of a port, register 0x0007.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum PortKind {
    /// There is no such port.
    None,
    /// Not configured (SII EEPROM).
    NotConfigured,
    /// EBUS.
    Ebus,
    /// MII, RMII or RGMII.
    Mii,
}

impl PortKind {
    /// The kind of one port in the descriptor.
    pub(super) fn of(descriptor: u8, port: PortNumber) -> Self {
        let all = [Self::None, Self::NotConfigured, Self::Ebus, Self::Mii];
        all[usize::from(descriptor >> (2 * port.index()) & 3)]
    }

    /// Whether there is such a port.
    pub(super) fn is_there(self) -> bool {
        matches!(self, Self::Ebus | Self::Mii)
    }
}

impl fmt::Display for PortKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::None => "none",
            Self::NotConfigured => "not configured",
            Self::Ebus => "EBUS",
            Self::Mii => "MII",
        })
    }
}

/// A control byte of a SyncManager in words.
pub(super) fn control(control: u8) -> String {
    let manager = SyncManager::new(0, 0, control, true);
    let mut text = String::from(match control & 3 {
        0 => "three buffers",
        2 => "mailbox",
        _ => "unknown mode",
    });
    text += if manager.is_ecat_write() { ", MainDevice writes" } else { ", MainDevice reads" };
    for (bit, word) in [
        (SyncManager::CONTROL_ECAT_EVENT, ", ECAT event"),
        (SyncManager::CONTROL_AL_EVENT, ", AL event"),
        (SyncManager::CONTROL_WATCHDOG, ", watchdog"),
    ] {
        text += if control & bit != 0 { word } else { "" };
    }
    text
}

/// The use of a SyncManager in words.
pub(super) fn sync_manager_use(kind: u8) -> String {
    match kind {
        sm_type::UNUSED => "unused".to_owned(),
        sm_type::MAILBOX_OUT => "mailbox out".to_owned(),
        sm_type::MAILBOX_IN => "mailbox in".to_owned(),
        sm_type::OUTPUTS => "outputs".to_owned(),
        sm_type::INPUTS => "inputs".to_owned(),
        other => format!("unknown use {other}"),
    }
}

/// Mailbox protocols of the SII.
pub(super) fn protocols(header: &Header) -> Vec<String> {
    words(&PROTOCOLS, header.protocols)
}

/// The bit of a protocol in word 0x1C of the SII, by its word in the document: `CoE`, or `bit 6`
/// for one without a name.
pub fn protocol(word: &str) -> Option<u16> {
    (0..16)
        .map(|bit| 1 << bit)
        .find(|bit| words(&PROTOCOLS, *bit).iter().any(|known| known == word))
}

/// CoE details of the SII.
pub(super) fn coe_details(details: u8) -> Vec<String> {
    words(&COE_DETAILS, details.into())
}

/// The words of the bits that are set; bits without a word by their number.
fn words(table: &[(u16, &str)], word: u16) -> Vec<String> {
    let known = table.iter().fold(0, |known, (bit, _)| known | bit);
    let named = table.iter().filter(|(bit, _)| word & bit != 0).map(|(_, word)| (*word).to_owned());
    let unknown = (0..16).filter(|bit| word & !known & 1 << bit != 0);
    named.chain(unknown.map(|bit| format!("bit {bit}"))).collect()
}

/// Tick of the pulse length, ns.
const TICK: i64 = 10;
/// Bit of register 0x0141.
const SYNC_UNIT: u8 = 1 << 2;
/// Bit of register 0x0141.
const LATCH_UNIT: u8 = 1 << 3;

/// Bits of register 0x0008.
const FEATURES: [(u16, &str); 12] = [
    (features::FMMU_BYTEWISE, "FMMUs byte-wise"),
    (1 << 1, "unused registers can be accessed"),
    (features::DC, "DC"),
    (features::DC_64_BIT, "DC 64 bit"),
    (1 << 4, "EBUS with low jitter"),
    (1 << 5, "enhanced link detection EBUS"),
    (1 << 6, "enhanced link detection MII"),
    (1 << 7, "frames with wrong FCS told apart"),
    (features::ENHANCED_SYNC_ACTIVATION, "enhanced SYNC activation"),
    (features::NO_LRW, "no LRW"),
    (features::NO_READ_WRITE, "no BRW, APRW, FPRW"),
    (1 << 11, "FMMUs and SyncManagers fixed"),
];

const PROTOCOLS: [(u16, &str); 6] = [
    (1 << 0, "AoE"),
    (1 << 1, "EoE"),
    (Header::COE, "CoE"),
    (1 << 3, "FoE"),
    (1 << 4, "SoE"),
    (1 << 5, "VoE"),
];

const COE_DETAILS: [(u16, &str); 6] = [
    (1 << 0, "SDO"),
    (1 << 1, "SDO information"),
    (1 << 2, "PDO assignment"),
    (1 << 3, "PDO configuration"),
    (1 << 4, "upload at start"),
    (1 << 5, "complete access"),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn registers_in_words() {
        assert_eq!(words(&FEATURES, 0x1004), ["DC", "bit 12"]);
        for bit in 0..16 {
            assert_eq!(protocol(&words(&PROTOCOLS, 1 << bit)[0]), Some(1 << bit));
        }
        assert_eq!(["bit 16", "bit x", "coe"].map(protocol), [None; 3]);
        assert_eq!(PortKind::of(0x0B, PortNumber::P0), PortKind::Mii);
        assert_eq!(PortKind::of(0x0B, PortNumber::P1), PortKind::Ebus);
        assert!(PortKind::of(0x0B, PortNumber::P1).is_there());
        assert!(!PortKind::of(0x0B, PortNumber::P2).is_there());
        assert!(!PortKind::of(0x10, PortNumber::P2).is_there(), "not configured");
        assert_eq!(control(0x64), "three buffers, MainDevice writes, AL event, watchdog");
        assert_eq!(control(0x22), "mailbox, MainDevice reads, AL event");
    }

    /// Values of published SII images: both pins SYNC outputs with and without the event, and one
    /// of each.
    #[test]
    fn pins_of_real_devices() {
        assert_eq!(
            pins(0xEE)[1],
            "SYNC1 output (push-pull, active high), SYNC1 mapped to the AL event"
        );
        assert_eq!(
            pins(0x44)[0],
            "SYNC0 output (push-pull, active low), SYNC0 not mapped to the AL event"
        );
        assert_eq!(pins(0x06)[1], "LATCH1 input, SYNC1 not mapped to the AL event");
    }
}
