//! The application layer registers: the handshake of AL control, and the events around it.

use isocat_wire::register::{self, al_event};
use isocat_wire::{AlControl, AlState, AlStatus};

use crate::esc::ECAT_AL_STATUS;
use crate::led;
use crate::memory::Registers;

/// The state of the handshake.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Al {
    /// Device emulation: AL control is copied to AL status.
    emulation: bool,
    /// A request waits until the PDI reads it.
    requested: bool,
    /// AL status changed and ECAT has not read it since.
    status_changed: bool,
    /// The process data watchdog expired and the PDI has not read it since.
    watchdog: bool,
}

impl Al {
    /// The state after reset: no request is pending.
    pub const fn new() -> Self {
        Self { emulation: false, requested: false, status_changed: false, watchdog: false }
    }

    /// Sets both registers to INIT.
    pub fn reset_registers(&self, registers: &mut Registers) {
        registers.store(register::AL_CONTROL, AlControl::request(AlState::Init));
        registers.store(register::AL_STATUS, AlStatus::new(AlState::Init));
    }

    /// Takes device emulation from register 0x0141.
    pub fn set_emulation(&mut self, registers: &Registers) {
        self.emulation = registers.load(register::ESC_CONFIGURATION) & 1 != 0;
    }

    /// Whether the ESC answers AL control itself, because the device has no CPU.
    pub const fn is_emulated(&self) -> bool {
        self.emulation
    }

    /// Whether ECAT may write AL control. Only one request may be pending at a time.
    pub const fn may_request(&self) -> bool {
        self.emulation || !self.requested
    }

    /// Whether the PDI may write AL status.
    pub const fn may_write_status(&self) -> bool {
        !self.emulation
    }

    /// Handles a write to AL control, even one with the same value.
    pub fn request(&mut self, registers: &mut Registers) {
        if self.emulation {
            let AlControl(control) = registers.load(register::AL_CONTROL);
            let (before, status) = (registers.load(register::AL_STATUS), AlStatus(control & 0xFF));
            self.status_changed |= before != status;
            registers.store(register::AL_STATUS, status);
            led::state_changed(before, status, registers);
        } else {
            self.requested = true;
        }
    }

    /// Handles a read of AL control by the PDI.
    pub fn acknowledge_request(&mut self) {
        self.requested = false;
    }

    /// Handles a write of AL status by the PDI; its value was `before`.
    pub fn change_status(&mut self, before: AlStatus, registers: &mut Registers) {
        self.status_changed = true;
        led::state_changed(before, registers.load(register::AL_STATUS), registers);
    }

    /// Handles a read of AL status by ECAT.
    pub fn acknowledge_status(&mut self) {
        self.status_changed = false;
    }

    /// Sets the event when the process data watchdog expires, and clears it when the PDI has seen
    /// it.
    pub fn set_watchdog_event(&mut self, expired: bool) {
        self.watchdog = expired;
    }

    /// The bits of the AL event request (0x0220) that come from here.
    pub fn events(&self) -> u32 {
        let bit = |set: bool, bit: u32| if set { bit } else { 0 };
        bit(self.requested, al_event::AL_CONTROL) | bit(self.watchdog, al_event::WATCHDOG)
    }

    /// The bits of the ECAT event request (0x0210) that come from here.
    pub fn ecat_events(&self) -> u16 {
        if self.status_changed { ECAT_AL_STATUS } else { 0 }
    }
}
