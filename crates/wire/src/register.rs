//! Every ESC register, as one constant of address and value type, which includes the width.
//!
//! Reading or writing a register with the wrong width does not compile:
//!
//! ```compile_fail
//! use isocat_wire::register;
//! let bytes: [u8; 4] = [0; 4];
//! let status: u16 = register::AL_STATUS_CODE.decode(&bytes); // four bytes, the register has two
//! ```
//!
//! Sources: ESC data sheet section II; the order is that of the addresses.

use core::marker::PhantomData;

use crate::al::{AlControl, AlStatus, AlStatusCode};
use crate::dc::{ActivationStatus, SyncActivation, SystemTimeDifference};
use crate::dl::DlStatus;
use crate::eeprom::EepromStatus;
use crate::fmmu::Fmmu;
use crate::sync_manager::SyncManager;

/// A value of fixed width that registers hold.
pub trait Value: Copy {
    /// Its bytes in little-endian order: `[u8; N]`.
    type Bytes: AsRef<[u8]> + AsMut<[u8]> + Default + Copy;
    /// Number of bytes.
    const LEN: usize;
    /// Reads the bytes. Every value is valid; unknown bits are kept.
    fn from_bytes(bytes: Self::Bytes) -> Self;
    /// Writes the bytes.
    fn to_bytes(self) -> Self::Bytes;
}

macro_rules! integers {
    ($($integer:ident $len:literal;)*) => {$(
        impl Value for $integer {
            type Bytes = [u8; $len];
            const LEN: usize = $len;
            fn from_bytes(bytes: [u8; $len]) -> Self { $integer::from_le_bytes(bytes) }
            fn to_bytes(self) -> [u8; $len] { self.to_le_bytes() }
        }
    )*};
}
integers! { u8 1; u16 2; u32 4; u64 8; i16 2; }

/// Implements a register value for a newtype over an integer.
macro_rules! newtype_value {
    ($type:ident $integer:ident $len:literal) => {
        impl crate::register::Value for $type {
            type Bytes = [u8; $len];
            const LEN: usize = $len;
            fn from_bytes(bytes: [u8; $len]) -> Self {
                Self($integer::from_le_bytes(bytes))
            }
            fn to_bytes(self) -> [u8; $len] {
                self.0.to_le_bytes()
            }
        }
    };
}
pub(crate) use newtype_value;

/// A register: its address and, in its type, its value.
#[derive(Debug)]
pub struct Register<T> {
    /// Address in the ESC's memory.
    pub address: u16,
    value: PhantomData<fn() -> T>,
}

impl<T> Clone for Register<T> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<T> Copy for Register<T> {}

impl<T> Register<T> {
    const fn new(address: u16) -> Self {
        Self { address, value: PhantomData }
    }
}

impl<T: Value> Register<T> {
    /// Number of bytes.
    pub const LEN: usize = T::LEN;

    /// The value in these bytes.
    pub fn decode(self, bytes: &T::Bytes) -> T {
        T::from_bytes(*bytes)
    }

    /// The addresses that it covers.
    pub const fn range(self) -> core::ops::Range<usize> {
        self.address as usize..self.address as usize + T::LEN
    }

    /// Reads this register in a memory image that starts at address 0. Panics if the image ends
    /// before the register does.
    pub fn load(self, memory: &[u8]) -> T {
        let mut bytes = T::Bytes::default();
        bytes.as_mut().copy_from_slice(&memory[self.range()]);
        T::from_bytes(bytes)
    }

    /// Writes this register in a memory image that starts at address 0. Panics if the image ends
    /// before the register does.
    pub fn store(self, memory: &mut [u8], value: T) {
        memory[self.range()].copy_from_slice(value.to_bytes().as_ref());
    }
}

macro_rules! registers {
    ($($(#[$doc:meta])* $address:literal $name:ident: $type:ty;)*) => {$(
        $(#[$doc])*
        pub const $name: Register<$type> = Register::new($address);
    )*};
}

registers! {
    /// ESC type: 0x04 IP core, 0x11 ET1100, 0x12 ET1200, 0x98 XMC4x00, 0xC0 LAN925x.
    0x0000 TYPE: u8;
    /// ESC revision.
    0x0001 REVISION: u8;
    /// ESC build.
    0x0002 BUILD: u16;
    /// Number of FMMUs, 0..=16.
    0x0004 FMMU_COUNT: u8;
    /// Number of SyncManagers, 0..=16.
    0x0005 SM_COUNT: u8;
    /// Process RAM from 0x1000, KiB.
    0x0006 RAM_SIZE: u8;
    /// Kind of each port, two bits for each port: 0 none, 1 not configured, 2 EBUS, 3 MII.
    0x0007 PORT_DESCRIPTOR: u8;
    /// Feature bits, see [`features`].
    0x0008 FEATURES: u16;
    /// Configured station address.
    0x0010 STATION_ADDRESS: u16;
    /// Configured station alias, from SII word 4.
    0x0012 STATION_ALIAS: u16;
    /// Register write enable.
    0x0020 REGISTER_WRITE_ENABLE: u8;
    /// Register write protection.
    0x0021 REGISTER_WRITE_PROTECTION: u8;
    /// ESC write enable.
    0x0030 ESC_WRITE_ENABLE: u8;
    /// ESC write protection.
    0x0031 ESC_WRITE_PROTECTION: u8;
    /// ESC reset from ECAT: 'R', 'E', 'S' in three frames.
    0x0040 ESC_RESET_ECAT: u8;
    /// ESC reset from PDI.
    0x0041 ESC_RESET_PDI: u8;
    /// DL control: forwarding, loops, FIFO, alias enable (bit 24).
    0x0100 DL_CONTROL: u32;
    /// Physical read/write offset.
    0x0108 PHYSICAL_OFFSET: u16;
    /// DL status: links, loops, communication at each port.
    0x0110 DL_STATUS: DlStatus;
    /// AL control: the state that the MainDevice asks for.
    0x0120 AL_CONTROL: AlControl;
    /// AL status: the present state of the SubDevice.
    0x0130 AL_STATUS: AlStatus;
    /// AL status code: why the SubDevice refused or left a state.
    0x0134 AL_STATUS_CODE: AlStatusCode;
    /// RUN LED override.
    0x0138 RUN_LED: u8;
    /// ERR LED override.
    0x0139 ERR_LED: u8;
    /// PDI control, SII word 0 low.
    0x0140 PDI_CONTROL: u8;
    /// ESC configuration, SII word 0 high: bit 0 device emulation, 2 SYNC unit on, 3 latch unit on.
    0x0141 ESC_CONFIGURATION: u8;
    /// PDI information.
    0x014E PDI_INFORMATION: u16;
    /// PDI configuration, SII word 1 low.
    0x0150 PDI_CONFIGURATION: u8;
    /// SYNC/LATCH configuration, SII word 1 high: bit 3 SYNC0, bit 7 SYNC1 mapped to AL events.
    0x0151 SYNC_LATCH_CONFIGURATION: u8;
    /// Extended PDI configuration, SII word 3.
    0x0152 EXTENDED_PDI_CONFIGURATION: u16;
    /// ECAT event mask.
    0x0200 ECAT_EVENT_MASK: u16;
    /// AL event mask, towards the PDI interrupt.
    0x0204 AL_EVENT_MASK: u32;
    /// ECAT event request.
    0x0210 ECAT_EVENT_REQUEST: u16;
    /// AL event request, see [`al_event`].
    0x0220 AL_EVENT_REQUEST: u32;
    /// First of eight error counters: invalid frames and RX errors at ports 0 to 3.
    0x0300 RX_ERRORS: u64;
    /// Forwarded RX errors at ports 0 to 3.
    0x0308 FORWARDED_RX_ERRORS: u32;
    /// EPU errors.
    0x030C EPU_ERRORS: u8;
    /// PDI errors.
    0x030D PDI_ERRORS: u8;
    /// PDI error code.
    0x030E PDI_ERROR_CODE: u8;
    /// Lost links at ports 0 to 3.
    0x0310 LOST_LINKS: u32;
    /// Watchdog divider: (divider + 2) times 40 ns.
    0x0400 WATCHDOG_DIVIDER: u16;
    /// PDI watchdog time in divider units, 0 off.
    0x0410 WATCHDOG_TIME_PDI: u16;
    /// Process data watchdog time in divider units, 0 off.
    0x0420 WATCHDOG_TIME_PROCESS_DATA: u16;
    /// Process data watchdog status, bit 0: 1 running or off, 0 expired.
    0x0440 WATCHDOG_STATUS: u16;
    /// Process data watchdog expiries.
    0x0442 WATCHDOG_COUNTER_PROCESS_DATA: u8;
    /// PDI watchdog expiries.
    0x0443 WATCHDOG_COUNTER_PDI: u8;
    /// EEPROM configuration: bit 0 offers it to the PDI, bit 1 takes it back by force.
    0x0500 EEPROM_CONFIGURATION: u8;
    /// EEPROM PDI access state.
    0x0501 EEPROM_PDI_ACCESS: u8;
    /// EEPROM control and status.
    0x0502 EEPROM_STATUS: EepromStatus;
    /// EEPROM word address.
    0x0504 EEPROM_ADDRESS: u32;
    /// EEPROM data; 4 or 8 bytes are valid after a read.
    0x0508 EEPROM_DATA: u64;
    /// MII management control and status.
    0x0510 MII_STATUS: u16;
    /// MII PHY address, bits 4:0.
    0x0512 MII_PHY_ADDRESS: u8;
    /// MII PHY register, bits 4:0.
    0x0513 MII_PHY_REGISTER: u8;
    /// MII PHY data.
    0x0514 MII_DATA: u16;
    /// MII management ECAT access state: bit 0, only ECAT has access.
    0x0516 MII_ECAT_ACCESS: u8;
    /// MII management PDI access state: bit 0, the PDI has access; bit 1, ECAT takes it back by
    /// force.
    0x0517 MII_PDI_ACCESS: u8;
    /// PHY status of ports 0 to 3, one byte for each port.
    0x0518 PHY_STATUS: u32;
    /// FMMU 0; see [`fmmu`].
    0x0600 FMMU_0: Fmmu;
    /// SyncManager 0; see [`sync_manager`].
    0x0800 SM_0: SyncManager;
    /// Receive time of port 0, local time; a write to any of its bytes latches all ports.
    0x0900 RECEIVE_TIME_0: u32;
    /// Receive time port 1, local time.
    0x0904 RECEIVE_TIME_1: u32;
    /// Receive time port 2, local time.
    0x0908 RECEIVE_TIME_2: u32;
    /// Receive time port 3, local time.
    0x090C RECEIVE_TIME_3: u32;
    /// System time as ECAT sees it, ns; a write feeds the drift loop.
    0x0910 SYSTEM_TIME: u64;
    /// Receive time of the EPU, local time.
    0x0918 RECEIVE_TIME_EPU: u64;
    /// System time offset, ns.
    0x0920 SYSTEM_TIME_OFFSET: u64;
    /// System time delay: propagation delay from the reference clock, ns.
    0x0928 SYSTEM_TIME_DELAY: u32;
    /// System time difference, sign-magnitude.
    0x092C SYSTEM_TIME_DIFFERENCE: SystemTimeDifference;
    /// Speed counter start: bandwidth of the drift loop.
    0x0930 SPEED_COUNTER_START: u16;
    /// Speed counter difference: present speed correction.
    0x0932 SPEED_COUNTER_DIFFERENCE: i16;
    /// System time difference filter depth.
    0x0934 TIME_FILTER_DEPTH: u8;
    /// Speed counter filter depth.
    0x0935 SPEED_FILTER_DEPTH: u8;
    /// Receive time latch mode.
    0x0936 RECEIVE_TIME_LATCH_MODE: u8;
    /// Cyclic unit control: owner of SYNC and latch units.
    0x0980 CYCLIC_UNIT_CONTROL: u8;
    /// SYNC activation.
    0x0981 SYNC_ACTIVATION: SyncActivation;
    /// SYNC pulse length, 10 ns units; 0 is acknowledge mode.
    0x0982 SYNC_PULSE_LENGTH: u16;
    /// SYNC activation status.
    0x0984 ACTIVATION_STATUS: ActivationStatus;
    /// SYNC0 status, acknowledge mode.
    0x098E SYNC0_STATUS: u8;
    /// SYNC1 status, acknowledge mode.
    0x098F SYNC1_STATUS: u8;
    /// A write sets the start time; a read gives the next SYNC0 pulse. System time, ns.
    0x0990 SYNC_START_TIME: u64;
    /// Next SYNC1 pulse, system time, ns.
    0x0998 SYNC1_NEXT: u64;
    /// SYNC0 cycle time, ns; 0 is single shot.
    0x09A0 SYNC0_CYCLE: u32;
    /// SYNC1 cycle time, ns: from a SYNC0 to SYNC1.
    0x09A4 SYNC1_CYCLE: u32;
    /// Latch 0 control.
    0x09A8 LATCH0_CONTROL: u8;
    /// Latch 1 control.
    0x09A9 LATCH1_CONTROL: u8;
    /// Latch 0 status.
    0x09AE LATCH0_STATUS: u8;
    /// Latch 1 status.
    0x09AF LATCH1_STATUS: u8;
    /// Latch 0 positive edge, system time.
    0x09B0 LATCH0_POSITIVE: u64;
    /// Latch 0 negative edge, system time.
    0x09B8 LATCH0_NEGATIVE: u64;
    /// Latch 1 positive edge, system time.
    0x09C0 LATCH1_POSITIVE: u64;
    /// Latch 1 negative edge, system time.
    0x09C8 LATCH1_NEGATIVE: u64;
    /// Local time of the frame that caused an ECAT buffer exchange.
    0x09F0 ECAT_BUFFER_CHANGE_TIME: u32;
    /// Local time of a PDI buffer start.
    0x09F8 PDI_BUFFER_START_TIME: u32;
    /// Local time of a PDI buffer change.
    0x09FC PDI_BUFFER_CHANGE_TIME: u32;
}

/// First of the chip-specific registers: power-on values, product and vendor numbers.
pub const CHIP_SPECIFIC: u16 = 0x0E00;
/// First address behind the registers with shadow buffers.
pub const SHADOW_END: u16 = 0x0F80;
/// First address of the process RAM.
pub const PROCESS_RAM: u16 = 0x1000;

/// FMMU `number` (0..=15).
pub const fn fmmu(number: usize) -> Register<Fmmu> {
    assert!(number < 16, "an ESC has at most 16 FMMUs");
    Register::new(FMMU_0.address + 16 * number as u16)
}

/// SyncManager `number` (0..=15).
pub const fn sync_manager(number: usize) -> Register<SyncManager> {
    assert!(number < 16, "an ESC has at most 16 SyncManagers");
    Register::new(SM_0.address + 8 * number as u16)
}

/// Status byte of SyncManager `number`: the mailbox-full bit is 0x08.
pub const fn sm_status(number: usize) -> Register<u8> {
    Register::new(sync_manager(number).address + 5)
}

/// Activate byte of SyncManager `number`.
pub const fn sm_activate(number: usize) -> Register<u8> {
    Register::new(sync_manager(number).address + 6)
}

/// PDI control byte of SyncManager `number`.
pub const fn sm_pdi_control(number: usize) -> Register<u8> {
    Register::new(sync_manager(number).address + 7)
}

/// Bits of register 0x0008.
pub mod features {
    /// FMMUs map whole bytes only.
    pub const FMMU_BYTEWISE: u16 = 1 << 0;
    /// Distributed clocks: at least the receive times.
    pub const DC: u16 = 1 << 2;
    /// DC counts 64 bits; otherwise 32.
    pub const DC_64_BIT: u16 = 1 << 3;
    /// EBUS ports can receive with less jitter: 0x0100 bit 19.
    pub const LOW_JITTER_EBUS: u16 = 1 << 4;
    /// Bits 7:3 of 0x0981 and register 0x0984 exist.
    pub const ENHANCED_SYNC_ACTIVATION: u16 = 1 << 8;
    /// LRW is not supported.
    pub const NO_LRW: u16 = 1 << 9;
    /// BRW, APRW and FPRW are not supported.
    pub const NO_READ_WRITE: u16 = 1 << 10;
}

/// Bits of the AL event request 0x0220.
pub mod al_event {
    /// AL control was written; cleared by reading it.
    pub const AL_CONTROL: u32 = 1 << 0;
    /// A latch captured an edge (units owned by the PDI).
    pub const LATCH: u32 = 1 << 1;
    /// State of SYNC0.
    pub const SYNC0: u32 = 1 << 2;
    /// State of SYNC1.
    pub const SYNC1: u32 = 1 << 3;
    /// The activation register of some SyncManager was written.
    pub const SM_ACTIVATION: u32 = 1 << 4;
    /// The EEPROM is emulated, and a command waits.
    pub const EEPROM: u32 = 1 << 5;
    /// The process data watchdog expired; cleared by reading 0x0440.
    pub const WATCHDOG: u32 = 1 << 6;
    /// The event of SyncManager `number`.
    pub const fn sync_manager(number: usize) -> u32 {
        1 << (8 + number)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_that_others_depend_on() {
        assert_eq!(fmmu(15).address, 0x06F0);
        assert_eq!(sync_manager(3).address, 0x0818);
        assert_eq!(sm_status(1).address, 0x080D);
        assert_eq!(sm_pdi_control(1).address, 0x080F);
        assert_eq!(SYSTEM_TIME.range(), 0x0910..0x0918);
        assert_eq!(Register::<Fmmu>::LEN, 16);
    }

    #[test]
    fn load_and_store_are_little_endian() {
        let mut memory = [0; 0x1000];
        SYNC0_CYCLE.store(&mut memory, 1_000_000);
        assert_eq!(memory[0x09A0..0x09A4], [0x40, 0x42, 0x0F, 0x00]);
        assert_eq!(SYNC0_CYCLE.load(&memory), 1_000_000);
    }
}
