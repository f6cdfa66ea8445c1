//! The data link layer: links, loops and what DL control (0x0100) makes of them.

use isocat_wire::dl::DlStatus;
use isocat_wire::register;
use isocat_wire::time::{Device, Nanos};
use isocat_wire::{PortNumber, Time};

use crate::chip::Chip;
use crate::memory::Registers;

/// The state of the ports.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ports {
    link: [bool; 4],
    closed: [bool; 4],
    /// Loop bits (0x0101) to restore after a temporary setting, and when.
    revert: Option<(u8, Time<Device>)>,
}

impl Ports {
    /// The state at power-on: no port has a link.
    pub const fn new() -> Self {
        Self { link: [false; 4], closed: [true; 4], revert: None }
    }

    /// Plugs or unplugs a port. Returns whether a lost link is to be counted.
    pub fn set_link(&mut self, port: PortNumber, link: bool, registers: &Registers) -> bool {
        let p = port.index();
        let lost = self.link[p] && !link && !self.closed[p] && self.mode(p, registers) == AUTO;
        self.link[p] = link;
        lost
    }

    /// The links at the ports.
    pub const fn links(&self) -> [bool; 4] {
        self.link
    }

    /// Whether a loop that closed by itself waits for a good frame before it opens.
    pub fn waits_for_frame(&self, port: PortNumber, registers: &Registers) -> bool {
        let p = port.index();
        self.link[p] && self.closed[p] && self.mode(p, registers) == AUTO_CLOSE
    }

    /// Sets loops and DL status after a change of links or of DL control. `reopen` has one bit for
    /// each port whose loop may open again after it closed by itself. Returns whether DL status
    /// changed.
    pub fn update(&mut self, chip: &Chip, registers: &mut Registers, reopen: u8) -> bool {
        let before = registers.load(register::DL_STATUS);
        let mut status = before;
        for port in PortNumber::ALL {
            let p = port.index();
            let link = self.link[p] && chip.has_port(port);
            self.closed[p] = !chip.has_port(port)
                || match self.mode(p, registers) {
                    AUTO => !link,
                    AUTO_CLOSE => !link || self.closed[p] && reopen & 1 << p == 0,
                    OPEN => false,
                    _ => true,
                };
            status = status.with_port(port, link, self.closed[p], link);
        }
        registers.store(register::DL_STATUS, status);
        status != before
    }

    /// Handles a write to DL control; `before` is the old byte 0x0101, kept for a temporary
    /// setting.
    pub fn control(&mut self, before: u8, now: Time<Device>, registers: &Registers) {
        let temporary = registers.load(register::DL_CONTROL) & TEMPORARY != 0;
        self.revert = match (temporary, self.revert) {
            (false, _) => None,
            (true, Some((first, _))) => Some((first, now + TEMPORARY_TIME)),
            (true, None) => Some((before, now + TEMPORARY_TIME)),
        };
    }

    /// When a temporary setting ends.
    pub fn due(&self) -> Time<Device> {
        self.revert.map_or(Time::NEVER, |(_, due)| due)
    }

    /// Ends a temporary setting.
    pub fn end_temporary(&mut self, registers: &mut Registers) {
        if let Some((loops, _)) = self.revert.take() {
            let control = registers.load(register::DL_CONTROL) & !TEMPORARY;
            registers.store(register::DL_CONTROL, control);
            registers.set_byte(register::DL_CONTROL.address + 1, loops);
        }
    }

    /// Whether the loop at port 0 closed by itself while another port is open, so that circulating
    /// frames must be stopped. If all ports are closed, port 0 counts as open.
    pub fn stops_circulating(&self, registers: &Registers) -> bool {
        self.closed[0]
            && self.closed != [true; 4]
            && matches!(self.mode(0, registers), AUTO | AUTO_CLOSE)
    }

    fn mode(&self, port: usize, registers: &Registers) -> u8 {
        registers.byte(register::DL_CONTROL.address + 1) >> (2 * port) & 0b11
    }
}

/// Sets or clears a bit of DL status that does not belong to a port.
pub(crate) fn set_status(registers: &mut Registers, bit: u16, set: bool) {
    let DlStatus(status) = registers.load(register::DL_STATUS);
    let status = if set { status | bit } else { status & !bit };
    registers.store(register::DL_STATUS, DlStatus(status));
}

/// The loops of all ports may open again, because their settings were written.
pub(crate) const ALL_PORTS: u8 = 0x0F;
/// Loop settings; 0x0101 has two bits for each port.
const AUTO: u8 = 0;
const AUTO_CLOSE: u8 = 1;
const OPEN: u8 = 2;
/// DL control bit 1: the loop settings hold for about a second.
const TEMPORARY: u32 = 1 << 1;
const TEMPORARY_TIME: Nanos = Nanos(1_000_000_000);
