//! The RUN and ERR LEDs, registers 0x0138 and 0x0139.
//!
//! While bit 4 is set, bits 3:0 are whatever was written; else 0x0138 shows what the AL status makes of
//! the RUN LED. A new AL status takes the RUN LED back, a new error the ERR LED.

use isocat_wire::register;
use isocat_wire::{AlState, AlStatus};

use crate::memory::Registers;

/// The override is on.
const OVERRIDE: u8 = 1 << 4;
/// Bit 4 and the code.
const BITS: u8 = 0x1F;
const OFF: u8 = 0x0;
const SINGLE_FLASH: u8 = 0x1;
const BLINKING: u8 = 0xD;
const FLICKERING: u8 = 0xE;
const ON: u8 = 0xF;

/// AL status has become `after`.
pub(crate) fn state_changed(before: AlStatus, after: AlStatus, registers: &mut Registers) {
    let code = match after.state() {
        Ok(AlState::PreOp) => BLINKING,
        Ok(AlState::SafeOp) => SINGLE_FLASH,
        Ok(AlState::Op) => ON,
        Ok(AlState::Boot) => FLICKERING,
        Ok(AlState::Init) => OFF,
        // No state of an ESC: the LED keeps what it shows.
        Err(_) => return,
    };
    registers.store(register::RUN_LED, code);
    if after.error() && !before.error() {
        take_error_led_back(registers);
    }
}

/// Something new is wrong: the override of the ERR LED ends.
pub(crate) fn take_error_led_back(registers: &mut Registers) {
    if registers.load(register::ERR_LED) & OVERRIDE != 0 {
        registers.store(register::ERR_LED, OFF);
    }
}

/// One of the registers was written by either side. Without the override bit the LED shows its own
/// state again.
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
