//! MII management (0x0510-0x051B) and the PHYs behind it.
//!
//! The PHY of port p has address p. It has the basic registers 0 to 6 and runs 100 Mbit/s full
//! duplex by auto-negotiation; its link is that of the port. Other addresses and registers do not
//! exist: nothing drives the data line, so it reads ones, which is an error.

use isocat_wire::register;
use isocat_wire::time::{Device, Nanos};
use isocat_wire::{PortNumber, Time};

use crate::chip::{Chip, MiiManagement, PortKind};
use crate::memory::Registers;
use crate::sync_manager::Side;

/// The state of MII management.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Mii {
    /// The command under way and when it is done.
    job: Option<(u16, Time<Device>)>,
    /// Status bits 14:13.
    errors: u16,
    /// Status bits that never change.
    fixed: u16,
    /// PHY registers 0 and 4 of each port.
    phys: [[u16; 2]; 4],
}

impl Mii {
    /// An idle unit whose PHYs have their default registers.
    pub const fn new(chip: &Chip) -> Self {
        let fixed = match chip.mii {
            MiiManagement::Shared => LINK_DETECTION,
            MiiManagement::None | MiiManagement::Ecat => 0,
        };
        Self { job: None, errors: 0, fixed, phys: [[CONTROL, ADVERTISEMENT]; 4] }
    }

    /// Whether `side` may write 0x0510-0x0515 now.
    pub fn may_write(&self, side: Side, registers: &Registers) -> bool {
        let pdi = registers.load(register::MII_PDI_ACCESS) & 1 != 0;
        (side == Side::Pdi) == pdi && self.job.is_none()
    }

    /// Whether the PDI may take the management; giving it back is always allowed.
    pub fn may_take(registers: &Registers) -> bool {
        registers.load(register::MII_ECAT_ACCESS) & 1 == 0
            && registers.load(register::MII_PDI_ACCESS) & FORCED == 0
    }

    /// Handles a write to 0x0517: ECAT gets the management at once if it takes it by force. ECAT
    /// cannot set the PDI's own bit.
    pub fn force(value: u8, registers: &mut Registers) {
        let kept = registers.load(register::MII_PDI_ACCESS) & 1;
        let state = if value & FORCED != 0 { FORCED } else { kept };
        registers.store(register::MII_PDI_ACCESS, state);
    }

    /// Handles a control word written to 0x0510. For a write ECAT needs the write enable bit; the
    /// PDI does not.
    pub fn command(&mut self, side: Side, control: u16, now: Time<Device>) {
        self.errors = 0;
        match control & COMMAND {
            0 => {}
            READ => self.job = Some((READ, now + FRAME_TIME)),
            WRITE if side == Side::Pdi || control & WRITE_ENABLE != 0 => {
                self.job = Some((WRITE, now + FRAME_TIME));
            }
            _ => self.errors = COMMAND_ERROR,
        }
    }

    /// When the command under way is done.
    pub fn due(&self) -> Time<Device> {
        self.job.map_or(Time::NEVER, |(_, due)| due)
    }

    /// Completes the command under way.
    pub fn finish(&mut self, chip: &Chip, links: [bool; 4], registers: &mut Registers) {
        let Some((command, _)) = self.job.take() else { return };
        let address = usize::from(registers.load(register::MII_PHY_ADDRESS) & 0x1F);
        let number = registers.load(register::MII_PHY_REGISTER) & 0x1F;
        let port = PortNumber::ALL.get(address).filter(|port| chip.port(**port) == PortKind::Mii);
        if command == WRITE {
            let value = registers.load(register::MII_DATA);
            match (port, number) {
                // Reset and restart are done before the next command can come.
                (Some(_), 0) => self.phys[address][0] = value & !(RESET | RESTART),
                (Some(_), 4) => self.phys[address][1] = value,
                _ => {}
            }
            return;
        }
        let found = port.and_then(|_| self.phy(address, number, links[address]));
        if found.is_none() {
            self.errors |= READ_ERROR;
        }
        registers.store(register::MII_DATA, found.unwrap_or(0xFFFF));
    }

    /// Writes registers 0x0510 and 0x0518-0x051B.
    pub fn show(&self, chip: &Chip, links: [bool; 4], registers: &mut Registers) {
        if chip.mii == MiiManagement::None {
            return;
        }
        let shared = chip.mii == MiiManagement::Shared;
        let pdi = registers.load(register::MII_PDI_ACCESS) & 1 != 0;
        let bit = |set: bool, bit: u16| if set { bit } else { 0 };
        let job = self.job.map_or(0, |(command, _)| command | BUSY);
        let status = self.fixed
            | self.errors
            | job
            | bit(shared && Self::may_take(registers), PDI_POSSIBLE)
            | bit(pdi, WRITE_ENABLE);
        registers.store(register::MII_STATUS, status);
        if shared {
            let ports = PortNumber::ALL.map(|port| {
                let linked = links[port.index()] && chip.port(port) == PortKind::Mii;
                if linked { LINKED } else { 0 }
            });
            registers.store(register::PHY_STATUS, u32::from_le_bytes(ports));
        }
    }

    fn phy(&self, port: usize, number: u8, link: bool) -> Option<u16> {
        let [control, advertisement] = self.phys[port];
        Some(match number {
            0 => control,
            1 if link => STATUS | STATUS_LINKED,
            1 => STATUS,
            // The PHY has no maker.
            2 | 3 => 0,
            4 => advertisement,
            5 if link => ADVERTISEMENT | PARTNER_ACKNOWLEDGE,
            5 => 0,
            6 => u16::from(link),
            _ => return None,
        })
    }
}

/// Register 0x0510.
const WRITE_ENABLE: u16 = 1 << 0;
const PDI_POSSIBLE: u16 = 1 << 1;
const LINK_DETECTION: u16 = 1 << 2;
const READ: u16 = 1 << 8;
const WRITE: u16 = 1 << 9;
const COMMAND: u16 = READ | WRITE;
const READ_ERROR: u16 = 1 << 13;
const COMMAND_ERROR: u16 = 1 << 14;
const BUSY: u16 = 1 << 15;
/// Register 0x0517: ECAT takes the management by force.
const FORCED: u8 = 1 << 1;
/// Registers 0x0518...: physical link, and it is 100 Mbit/s full duplex.
const LINKED: u8 = 0b11;
/// 64 bits at 2.5 MHz.
const FRAME_TIME: Nanos = Nanos(25_600);
/// PHY register 0: auto-negotiation, 100 Mbit/s, full duplex.
const CONTROL: u16 = 0x3100;
const RESET: u16 = 1 << 15;
const RESTART: u16 = 1 << 9;
/// PHY register 1: 100BASE-TX in both duplexes, auto-negotiation, extended registers.
const STATUS: u16 = 0x6009;
/// PHY register 1: negotiated, link up.
const STATUS_LINKED: u16 = 0x0024;
/// PHY register 4: 100BASE-TX full and half duplex, IEEE 802.3.
const ADVERTISEMENT: u16 = 0x0181;
/// PHY register 5: the partner has seen our page.
const PARTNER_ACKNOWLEDGE: u16 = 1 << 14;
