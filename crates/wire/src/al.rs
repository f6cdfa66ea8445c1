//! The application layer: state, request, status code.

use core::fmt;

use crate::register::newtype_value;

/// A state of the EtherCAT State Machine.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
#[repr(u8)]
pub enum AlState {
    /// Neither mailbox nor process data.
    Init = 1,
    /// The mailbox works.
    PreOp = 2,
    /// Firmware update.
    Boot = 3,
    /// Inputs are valid, outputs are in their safe state.
    SafeOp = 4,
    /// Inputs and outputs are valid.
    Op = 8,
}

/// A state code other than 1, 2, 3, 4 and 8.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct UnknownState(pub u8);

impl AlState {
    /// The name used in documents.
    pub const fn name(self) -> &'static str {
        match self {
            AlState::Init => "INIT",
            AlState::PreOp => "PREOP",
            AlState::Boot => "BOOT",
            AlState::SafeOp => "SAFEOP",
            AlState::Op => "OP",
        }
    }
}

impl TryFrom<u8> for AlState {
    type Error = UnknownState;
    fn try_from(code: u8) -> Result<Self, UnknownState> {
        Ok(match code {
            1 => AlState::Init,
            2 => AlState::PreOp,
            3 => AlState::Boot,
            4 => AlState::SafeOp,
            8 => AlState::Op,
            _ => return Err(UnknownState(code)),
        })
    }
}

impl fmt::Display for AlState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl fmt::Display for UnknownState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "unknown state {:#03x}", self.0)
    }
}

/// AL control, register 0x0120: the state that the MainDevice asks for.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct AlControl(pub u16);
newtype_value!(AlControl u16 2);

impl AlControl {
    const ACKNOWLEDGE: u16 = 0x10;
    const IDENTIFICATION: u16 = 0x20;

    /// A plain request for a state.
    pub const fn request(state: AlState) -> Self {
        Self(state as u16)
    }
    /// A request for a state that also acknowledges an error.
    pub const fn request_and_acknowledge(state: AlState) -> Self {
        Self(state as u16 | Self::ACKNOWLEDGE)
    }
    /// Bits 3:0: the requested state, or the unknown code.
    pub fn state(self) -> Result<AlState, UnknownState> {
        AlState::try_from((self.0 & 0x0F) as u8)
    }
    /// Bit 4: error acknowledge.
    pub const fn acknowledge(self) -> bool {
        self.0 & Self::ACKNOWLEDGE != 0
    }
    /// Bit 5: the MainDevice asks for the device's identification.
    pub const fn identification(self) -> bool {
        self.0 & Self::IDENTIFICATION != 0
    }
}

/// AL status, register 0x0130: the present state of the SubDevice.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct AlStatus(pub u16);
newtype_value!(AlStatus u16 2);

impl AlStatus {
    const ERROR: u16 = 0x10;
    const IDENTIFICATION: u16 = 0x20;

    /// A status without error.
    pub const fn new(state: AlState) -> Self {
        Self(state as u16)
    }
    /// The same state with the error indication set or cleared.
    pub const fn with_error(self, error: bool) -> Self {
        Self(if error { self.0 | Self::ERROR } else { self.0 & !Self::ERROR })
    }
    /// The same state with "identification loaded" set or cleared.
    pub const fn with_identification(self, loaded: bool) -> Self {
        Self(if loaded { self.0 | Self::IDENTIFICATION } else { self.0 & !Self::IDENTIFICATION })
    }
    /// Bits 3:0: the state, or the unknown code.
    pub fn state(self) -> Result<AlState, UnknownState> {
        AlState::try_from((self.0 & 0x0F) as u8)
    }
    /// Bit 4: error indication.
    pub const fn error(self) -> bool {
        self.0 & Self::ERROR != 0
    }
    /// Bit 5: identification loaded.
    pub const fn identification(self) -> bool {
        self.0 & Self::IDENTIFICATION != 0
    }
}

/// Prints `SAFEOP` or `SAFEOP+ERR`.
impl fmt::Display for AlStatus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.state() {
            Ok(state) => write!(f, "{state}")?,
            Err(unknown) => write!(f, "{unknown}")?,
        }
        if self.error() { f.write_str("+ERR") } else { Ok(()) }
    }
}

/// AL status code, register 0x0134. The code space is open, so unknown codes are kept.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default)]
pub struct AlStatusCode(pub u16);
newtype_value!(AlStatusCode u16 2);

macro_rules! codes {
    ($($code:literal $name:ident $text:literal;)*) => {
        impl AlStatusCode {
            $(#[doc = $text] pub const $name: Self = Self($code);)*

            /// Every code that this crate knows, in ascending order.
            pub const ALL: &[Self] = &[$(Self::$name),*];

            /// The meaning of the code in words; `None` for a code that this crate does not know.
            pub const fn meaning(self) -> Option<&'static str> {
                match self.0 {
                    $($code => Some($text),)*
                    _ => None,
                }
            }
        }
    };
}

codes! {
    0x0000 NO_ERROR "no error";
    0x0001 UNSPECIFIED "unspecified error";
    0x0002 NO_MEMORY "no memory";
    0x0003 INVALID_DEVICE_SETUP "invalid device setup";
    0x0004 INVALID_REVISION "invalid revision";
    0x0006 SII_MISMATCH "SII does not match the firmware";
    0x0007 FIRMWARE_UPDATE_FAILED "firmware update failed";
    0x000E LICENSE "license error";
    0x0011 INVALID_STATE_CHANGE "invalid requested state change";
    0x0012 UNKNOWN_STATE "unknown requested state";
    0x0013 BOOTSTRAP_NOT_SUPPORTED "bootstrap not supported";
    0x0014 NO_FIRMWARE "no valid firmware";
    0x0015 INVALID_BOOT_MAILBOX "invalid mailbox configuration (BOOT)";
    0x0016 INVALID_MAILBOX "invalid mailbox configuration (PREOP)";
    0x0017 INVALID_SYNC_MANAGER "invalid SyncManager configuration";
    0x0018 NO_VALID_INPUTS "no valid inputs available";
    0x0019 NO_VALID_OUTPUTS "no valid outputs";
    0x001A SYNCHRONIZATION_ERROR "synchronization error: SYNC and SM events in wrong order too often";
    0x001B WATCHDOG "process data watchdog expired";
    0x001C INVALID_SM_TYPES "invalid SyncManager types";
    0x001D INVALID_OUTPUT_CONFIGURATION "invalid output configuration";
    0x001E INVALID_INPUT_CONFIGURATION "invalid input configuration";
    0x001F INVALID_WATCHDOG_CONFIGURATION "invalid watchdog configuration";
    0x0020 NEEDS_COLD_START "device needs a cold start";
    0x0021 NEEDS_INIT "device needs INIT";
    0x0022 NEEDS_PREOP "device needs PREOP";
    0x0023 NEEDS_SAFEOP "device needs SAFEOP";
    0x0024 INVALID_INPUT_MAPPING "invalid input mapping";
    0x0025 INVALID_OUTPUT_MAPPING "invalid output mapping";
    0x0026 INCONSISTENT_SETTINGS "inconsistent settings";
    0x0027 FREE_RUN_NOT_SUPPORTED "Free Run is not supported";
    0x0028 SYNCHRONIZATION_NOT_SUPPORTED "synchronization is not supported";
    0x0029 FREE_RUN_NEEDS_3_BUFFERS "Free Run needs 3-buffer mode";
    0x002A BACKGROUND_WATCHDOG "background watchdog";
    0x002B NO_VALID_INPUTS_AND_OUTPUTS "no valid inputs and outputs";
    0x002C FATAL_SYNC_ERROR "fatal sync error: SYNC is no longer seen";
    0x002D NO_SYNC "no sync: SYNC was never seen";
    0x002E CYCLE_TIME_TOO_SMALL "cycle time too small (older lists: invalid input FMMU)";
    0x0030 INVALID_DC_SYNC_CONFIGURATION "invalid DC SYNC configuration";
    0x0031 INVALID_DC_LATCH_CONFIGURATION "invalid DC latch configuration";
    0x0032 PLL_ERROR "PLL error: SYNC is seen, the local PLL is not locked";
    0x0033 DC_SYNC_IO_ERROR "DC sync IO error";
    0x0034 DC_SYNC_TIMEOUT "DC sync timeout: too many SM or SYNC events missed";
    0x0035 DC_INVALID_SYNC_CYCLE "DC: invalid sync cycle time";
    0x0036 DC_SYNC0_CYCLE "DC: invalid SYNC0 cycle time";
    0x0037 DC_SYNC1_CYCLE "DC: invalid SYNC1 cycle time";
    0x0041 MAILBOX_AOE "mailbox AoE error";
    0x0042 MAILBOX_EOE "mailbox EoE error";
    0x0043 MAILBOX_COE "mailbox CoE error";
    0x0044 MAILBOX_FOE "mailbox FoE error";
    0x0045 MAILBOX_SOE "mailbox SoE error";
    0x004F MAILBOX_VOE "mailbox VoE error";
    0x0050 EEPROM_NO_ACCESS "EEPROM: no access";
    0x0051 EEPROM_ERROR "EEPROM: error";
    0x0052 HARDWARE_NOT_READY "external hardware not ready";
    0x0060 RESTARTED "SubDevice restarted locally";
    0x0061 IDENTIFICATION_UPDATED "device identification updated";
    0x0070 MODULE_IDENT_MISMATCH "module ident list mismatch";
    0x0080 SUPPLY_VOLTAGE_LOW "supply voltage too low";
    0x0081 SUPPLY_VOLTAGE_HIGH "supply voltage too high";
    0x0082 TEMPERATURE_LOW "temperature too low";
    0x0083 TEMPERATURE_HIGH "temperature too high";
    0x00F0 APPLICATION_CONTROLLER_AVAILABLE "application controller available";
}

/// Prints `0x001A (synchronization error…)`.
impl fmt::Display for AlStatusCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let meaning = self.meaning().unwrap_or("a code of the vendor");
        write!(f, "0x{:04X} ({meaning})", self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    #[test]
    fn status_as_masters_see_it() {
        // Device emulation mirrors the acknowledge bit (facts, vector 11).
        assert_eq!(AlControl::request_and_acknowledge(AlState::Init), AlControl(0x0011));
        assert!(AlStatus(0x0011).error());
        assert_eq!(AlStatus(0x0014).to_string(), "SAFEOP+ERR");
        assert_eq!(AlStatus(0x0007).state(), Err(UnknownState(7)));
    }

    #[test]
    fn unknown_codes_survive() {
        assert_eq!(AlStatusCode(0x8001).to_string(), "0x8001 (a code of the vendor)");
        assert_eq!(AlStatusCode(0x001B), AlStatusCode::WATCHDOG);
    }
}
