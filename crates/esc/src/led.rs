//! The RUN and ERR LEDs, registers 0x0138 and 0x0139.
//!
//! While bit 4 is set, bits 3:0 keep the written value; otherwise 0x0138 shows the RUN LED code of
//! the AL status. A new AL status ends the override of the RUN LED, a new error that of the ERR
//! LED.

use isocat_wire::register;
use isocat_wire::{AlState, AlStatus};

use crate::memory::Registers;

/// The override is on.
const OVERRIDE: u8 = 1 << 4;
/// The override bit and the code.
const BITS: u8 = 0x1F;
const OFF: u8 = 0x0;
const SINGLE_FLASH: u8 = 0x1;
const BLINKING: u8 = 0xD;
const FLICKERING: u8 = 0xE;
const ON: u8 = 0xF;

/// Handles the change of AL status to `after`.
pub(crate) fn state_changed(before: AlStatus, after: AlStatus, registers: &mut Registers) {
    let code = match after.state() {
        Ok(AlState::PreOp) => BLINKING,
        Ok(AlState::SafeOp) => SINGLE_FLASH,
        Ok(AlState::Op) => ON,
        Ok(AlState::Boot) => FLICKERING,
        Ok(AlState::Init) => OFF,
        // This is not a state of an ESC, so the LED keeps its code.
        Err(_) => return,
    };
    registers.store(register::RUN_LED, code);
    if after.error() && !before.error() {
        take_error_led_back(registers);
    }
}

/// Ends the override of the ERR LED, because a new error occurred.
pub(crate) fn take_error_led_back(registers: &mut Registers) {
    if registers.load(register::ERR_LED) & OVERRIDE != 0 {
        registers.store(register::ERR_LED, OFF);
    }
}

/// Handles a write to one of the registers from either side. Without the override bit the LED shows
/// its own state again.
pub(crate) fn write(address: u16, value: u8, registers: &mut Registers) {
    registers.set_byte(address, value & BITS);
    if value & OVERRIDE == 0 {
        registers.set_byte(address, OFF);
        if address == register::RUN_LED.address {
            let status = registers.load(register::AL_STATUS);
            state_changed(status, status, registers);
        }
    }
}
