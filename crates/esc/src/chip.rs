//! Chip profiles: what differs between the ESCs that devices are built with.

use isocat_wire::dc::DifferencePolarity;
use isocat_wire::register::features;
use isocat_wire::{Nanos, Picos, PortNumber};

use crate::dc::drift_law::DriftLaw;
use crate::rx_fifo::RxFifo;

/// One kind of ESC: its identification, its limits and its delays.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Chip {
    /// The name on the package.
    pub name: &'static str,
    /// Register 0x0000.
    pub kind: u8,
    /// Register 0x0001.
    pub revision: u8,
    /// Register 0x0002.
    pub build: u16,
    /// Register 0x0004: number of FMMUs, 0..=16.
    pub fmmu_count: u8,
    /// Register 0x0005: number of SyncManagers, 0..=16.
    pub sm_count: u8,
    /// Register 0x0006: process RAM from 0x1000, KiB.
    pub ram_kib: u8,
    /// Register 0x0007: two bits for each port, see [`Chip::port`].
    pub port_descriptor: u8,
    /// Register 0x0008, see [`isocat_wire::register::features`].
    pub features: u16,
    /// Which DC units exist in addition to the receive times.
    pub dc_units: DcUnits,
    /// Register 0x0936 exists: receive times of ports 1-3 can be latched for frames that enter
    /// there.
    pub receive_time_latch_mode: bool,
    /// A write to 0x0900 enables ports 1-3 to stamp the next frame that arrives there, whatever
    /// that frame contains (ESC20 and ET1200). Frames that are still behind the port therefore
    /// spoil the receive times. Other chips stamp the frame that wrote, even if other frames arrive
    /// first. Reverse mode (0x0936) is not affected.
    pub stamps_next_frame: bool,
    /// The PDI and not ECAT writes the system time unit (0x0910-0x0935): an option of the IP core
    /// for devices that bridge two segments. What the PDI writes to 0x0910-0x0913 is compared with
    /// the last positive edge of LATCH0 (0x09B0) when byte 0x0913 is written.
    pub system_time_by_pdi: bool,
    /// Which read by the PDI clears bit 4 of the AL event request, register 0x0220. This is a
    /// setting, because no register text decides it.
    pub activation_event: ActivationEvent,
    /// Reset value of DL control, register 0x0100.
    pub dl_control: u32,
    /// Number of bytes that one EEPROM read gives, 4 or 8.
    pub eeprom_read_len: u8,
    /// Reserved bits of register 0x0502 that read 1 from power-on until SAFEOP is first reached,
    /// then
    /// 0. Captured on the ET1200: the bit stayed set when the EEPROM was offered to the PDI and
    ///    taken back. It was clear after a SyncManager and an FMMU were set up and SAFEOP was
    ///    reached. Which of these steps clears it is not known.
    pub eeprom_status_reserved: u16,
    /// How long an EEPROM read keeps the interface busy. The value is set short, so that the EEPROM
    /// does not dominate bring-up in virtual time; a real I2C read of 8 bytes at 100 kHz takes
    /// about 1 ms.
    pub eeprom_read_time: Nanos,
    /// How long an EEPROM write keeps the interface busy. The value is the transfer on the I2C bus.
    pub eeprom_write_time: Nanos,
    /// How long the EEPROM burns after a write; meanwhile it acknowledges no command (0x0502 bit
    /// 13). The value is the longest time that the usual parts state, 5 ms. Parts in use were
    /// captured with 2.1 to 2.7 ms.
    pub eeprom_burn_time: Nanos,
    /// The PDI emulates the EEPROM: it gets the commands by AL event bit 5, and a read gives four
    /// bytes. The image then holds only the configuration that the core was generated with.
    pub eeprom_emulated: bool,
    /// SyncManager status bits 6 and 7 say that a buffer is in use. The captured ET1100 does not
    /// have these bits.
    pub sm_buffer_in_use: bool,
    /// Register 0x0108, the offset between the read and the write address of a read-write command.
    pub physical_offset: bool,
    /// Registers 0x0138 and 0x0139, which override the RUN and ERR LEDs.
    pub led_override: bool,
    /// Register 0x014E bit 0: the PDI acknowledges by a write what it acknowledges by a read
    /// elsewhere. This is chosen when a core is generated or the PDI is configured.
    pub acknowledge_by_write: bool,
    /// How the drift loop turns time differences into a speed. No maker publishes it.
    pub drift_law: DriftLaw,
    /// What the sign of register 0x092C means.
    pub difference_polarity: DifferencePolarity,
    /// MII management.
    pub mii: MiiManagement,
    /// The contents of the registers from 0x0E00 on, 256 bytes at most. An ASIC shows the values of
    /// its configuration pins there (all low unless a board says otherwise), a core its product and
    /// vendor number.
    pub chip_specific: &'static [u8],
    /// Delay from a port's receive stamp through the EPU to the transmitter of the next port,
    /// without PHYs.
    pub processing_delay: Picos,
    /// Delay from a port's receive stamp to the transmitter of the next port, past the EPU, without
    /// PHYs.
    pub forwarding_delay: Picos,
    /// Delay through the PHY of an MII port, one way (receive or transmit). EBUS ports have none.
    pub phy_delay: Picos,
    /// The receive FIFOs: they decide how much the delay of a frame varies at each hop.
    pub rx_fifo: RxFifo,
}

/// Which of the system time, SYNC and latch units exist.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum DcUnits {
    /// SII word 0 decides: bit 10 (0x0141 bit 2) switches the SYNC unit on, bit 11 (0x0141 bit 3)
    /// the latch unit. Without either of them there is no system time unit.
    ByEeprom,
    /// All units exist whatever the EEPROM says.
    Always,
}

/// What clears bit 4 of the AL event request (0x0220), which ECAT's write to a SyncManager's
/// activation register (0x0806 + 8 n) sets.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ActivationEvent {
    /// Reading the activation register of each SyncManager that was written.
    Each,
    /// Reading the activation register of any SyncManager.
    Any,
}

/// The registers of MII management that exist.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum MiiManagement {
    /// No MII management: the chip has no PHYs, or no side can access them.
    None,
    /// 0x0510-0x0515: ECAT alone talks to the PHYs.
    Ecat,
    /// 0x0510-0x051B: ECAT and PDI share it, and the ESC itself watches the links.
    Shared,
}

/// What a port is built for, register 0x0007.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum PortKind {
    /// Not implemented.
    None,
    /// Not configured.
    NotConfigured,
    /// EBUS (LVDS).
    Ebus,
    /// MII, RMII or RGMII to a PHY.
    Mii,
}

impl Chip {
    /// The same chip on a board that uses other ports. This changes register 0x0007 and the reset
    /// value of DL control (0x0100, two bits for each port from bit 8), which keeps the loop of an
    /// absent port closed.
    pub const fn with_ports(self, port_descriptor: u8) -> Self {
        let mut closed = 0;
        let mut port = 0;
        while port < 4 {
            if port_descriptor >> (2 * port) & 0b10 == 0 {
                closed |= 0b11 << (8 + 2 * port);
            }
            port += 1;
        }
        Self { port_descriptor, dl_control: self.dl_control & !0xFF00 | closed, ..self }
    }

    /// Whether its ports can be EBUS. Only the ASICs have EBUS; cores and chips built around a core
    /// have MII.
    pub const fn can_have_ebus(&self) -> bool {
        matches!(self.kind, ET1100_KIND | ET1200_KIND)
    }

    /// What this port is built for.
    pub const fn port(&self, port: PortNumber) -> PortKind {
        match self.port_descriptor >> (2 * port.index()) & 0b11 {
            0 => PortKind::None,
            1 => PortKind::NotConfigured,
            2 => PortKind::Ebus,
            _ => PortKind::Mii,
        }
    }

    /// Whether this port can have a link at all.
    pub const fn has_port(&self, port: PortNumber) -> bool {
        matches!(self.port(port), PortKind::Ebus | PortKind::Mii)
    }

    /// Time through the PHY of this port, one way.
    pub const fn port_delay(&self, port: PortNumber) -> Picos {
        match self.port(port) {
            PortKind::Mii => self.phy_delay,
            _ => Picos(0),
        }
    }

    /// A feature bit of register 0x0008.
    pub const fn has(&self, feature: u16) -> bool {
        self.features & feature != 0
    }

    /// Whether DC counts 64 bits; otherwise it counts 32.
    pub const fn counts_64_bit(&self) -> bool {
        self.has(features::DC_64_BIT)
    }
}

/// Beckhoff ET1100: 8 FMMUs, 8 SyncManagers, 8 KiB, DC with 64 bits, without the enhanced SYNC
/// activation. Its ports are those of a bus coupler: MII, EBUS, MII.
pub static ET1100: Chip = ET1100_BASE;

const ET1100_BASE: Chip = Chip {
    name: "ET1100",
    kind: ET1100_KIND,
    revision: 0x00,
    build: 0x0003,
    fmmu_count: 8,
    sm_count: 8,
    ram_kib: 8,
    port_descriptor: 0x3B,
    features: 0x00FC,
    dc_units: DcUnits::ByEeprom,
    dl_control: 0x00C7_C001,
    eeprom_read_len: 8,
    eeprom_status_reserved: 0,
    sm_buffer_in_use: false,
    mii: MiiManagement::Ecat,
    chip_specific: &[0; 2],
    ..COMMON
};

/// An ET1100 as in a drive: ports 0 and 1 are MII, and there are no others.
pub static ET1100_MII: Chip = Chip {
    name: "ET1100, two MII ports",
    port_descriptor: 0x0F,
    dl_control: 0x00C7_F001,
    ..ET1100_BASE
};

/// Beckhoff ET1200: 3 FMMUs, 4 SyncManagers, 1 KiB, two EBUS ports.
pub static ET1200: Chip = Chip {
    name: "ET1200",
    kind: ET1200_KIND,
    revision: 0x01,
    build: 0x0001,
    fmmu_count: 3,
    sm_count: 4,
    ram_kib: 1,
    port_descriptor: 0x4A,
    features: 0x01FC,
    dc_units: DcUnits::ByEeprom,
    receive_time_latch_mode: true,
    stamps_next_frame: true,
    dl_control: 0x00C7_F001,
    eeprom_read_len: 8,
    eeprom_status_reserved: 0x0010,
    mii: MiiManagement::Ecat,
    chip_specific: &[0; 1],
    ..COMMON
};

/// An IP core as built into a drive: 3 FMMUs, 4 SyncManagers, 4 KiB, DC with 32 bits.
pub static IP_CORE_32: Chip = IP_CORE_BASE;

/// The same core in a drive whose CPU emulates the EEPROM.
pub static IP_CORE_32_EMULATED: Chip =
    Chip { name: "IP core, 32-bit DC, EEPROM emulated", eeprom_emulated: true, ..IP_CORE_BASE };

pub(crate) const IP_CORE_BASE: Chip = Chip {
    name: "IP core, 32-bit DC",
    kind: 0x04,
    revision: 0x02,
    build: 0x0043,
    fmmu_count: 3,
    sm_count: 4,
    ram_kib: 4,
    port_descriptor: 0x0F,
    features: 0x0184,
    dc_units: DcUnits::Always,
    dl_control: 0x0007_F001,
    eeprom_read_len: 4,
    eeprom_status_reserved: 0,
    ..CORE
};

/// Microchip LAN9252: 3 FMMUs, 4 SyncManagers, 4 KiB, two ports with built-in PHYs. Its build
/// number and its EEPROM read width are not confirmed by a capture; both follow the IP core it
/// contains.
pub static LAN9252: Chip = Chip {
    name: "LAN9252",
    kind: 0xC0,
    revision: 0x02,
    build: 0x0000,
    fmmu_count: 3,
    sm_count: 4,
    ram_kib: 4,
    port_descriptor: 0x0F,
    features: 0x01CC,
    dc_units: DcUnits::ByEeprom,
    dl_control: 0x0007_F001,
    eeprom_read_len: 4,
    eeprom_status_reserved: 0,
    ..CORE
};

/// Infineon XMC4800: 8 FMMUs, 8 SyncManagers, 8 KiB, two MII ports. On the real chip the CPU
/// emulates the EEPROM; this profile has a plain EEPROM.
pub static XMC4800: Chip = Chip {
    name: "XMC4800",
    kind: 0x98,
    revision: 0x01,
    build: 0x0001,
    fmmu_count: 8,
    sm_count: 8,
    ram_kib: 8,
    port_descriptor: 0x0F,
    features: 0x01CC,
    dc_units: DcUnits::Always,
    dl_control: 0x0007_C001,
    eeprom_read_len: 8,
    eeprom_status_reserved: 0,
    ..CORE
};

/// Registers that chips around an IP core have in addition to those of the ASICs. Not every vendor
/// publishes which of the options it chose; a profile may say otherwise.
const CORE: Chip = Chip {
    physical_offset: true,
    led_override: true,
    mii: MiiManagement::Shared,
    chip_specific: &[0; 16],
    ..COMMON
};

/// Values that all profiles share, mostly because no data sheet gives them for each chip.
///
/// The delays come from two captures. EBUS, three devices: the first sees a loop of 600 ns, the
/// second one of 310 ns, so two processing passes take 310 ns and one processing plus one
/// forwarding pass 290 ns. Two LAN9252: a loop of 1440 ns, two processing passes and four passes of
/// a PHY.
const COMMON: Chip = Chip {
    name: "",
    kind: 0,
    revision: 0,
    build: 0,
    fmmu_count: 0,
    sm_count: 0,
    ram_kib: 0,
    port_descriptor: 0,
    features: 0,
    dc_units: DcUnits::ByEeprom,
    receive_time_latch_mode: false,
    stamps_next_frame: false,
    system_time_by_pdi: false,
    activation_event: ActivationEvent::Each,
    dl_control: 0x0007_C001,
    eeprom_read_len: 8,
    eeprom_status_reserved: 0,
    eeprom_read_time: Nanos(20_000),
    eeprom_write_time: Nanos(200_000),
    eeprom_burn_time: Nanos(5_000_000),
    eeprom_emulated: false,
    sm_buffer_in_use: true,
    physical_offset: false,
    led_override: false,
    acknowledge_by_write: false,
    drift_law: DriftLaw::HOLD,
    difference_polarity: DifferencePolarity::PositiveAhead,
    mii: MiiManagement::None,
    chip_specific: &[],
    processing_delay: Picos(155_000),
    forwarding_delay: Picos(135_000),
    phy_delay: Picos(280_000),
    rx_fifo: RxFifo::COMMON,
};

const ET1100_KIND: u8 = 0x11;
const ET1200_KIND: u8 = 0x12;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ports_by_descriptor() {
        use PortKind::*;
        assert_eq!(PortNumber::ALL.map(|p| ET1100.port(p)), [Mii, Ebus, Mii, None]);
        assert_eq!(PortNumber::ALL.map(|p| ET1200.port(p)), [Ebus, Ebus, None, NotConfigured]);
        assert!(!ET1200.has_port(PortNumber::P3));
    }

    /// Register 0x0007 and the reset value of 0x0100 agree, as in the captured chips.
    #[test]
    fn other_ports_have_their_own_loops() {
        for chip in [ET1100, ET1100_MII, ET1200, LAN9252] {
            assert_eq!(chip.with_ports(chip.port_descriptor), chip);
        }
        let terminal = ET1100.with_ports(0x0A);
        assert_eq!(
            (terminal.port(PortNumber::P1), terminal.dl_control),
            (PortKind::Ebus, 0xC7_F001)
        );
        assert_eq!(ET1100.with_ports(0b11_10_00_10).dl_control, 0xC7_0C01);
        assert_eq!([ET1100, LAN9252].map(|chip| chip.can_have_ebus()), [true, false]);
    }

    /// The delays add up to the captured loops that they come from.
    #[test]
    fn delays_give_the_captured_loops() {
        let (process, forward) = (COMMON.processing_delay.0, COMMON.forwarding_delay.0);
        assert_eq!(2 * process, 310_000);
        assert_eq!(3 * process + forward, 600_000);
        // Cables of about 1 m explain the remaining 10 ns of 1440.
        assert_eq!(2 * process + 4 * COMMON.phy_delay.0, 1_430_000);
    }
}
