//! Driver for LAN9252, LAN9253 and LAN9254 behind SPI, which connects the SubDevice stack to a real
//! ESC.
//!
//! [`Lan925x`] takes an `embedded-hal` SPI device and is an [`isocat_esc::Pdi`]. An access of the
//! stack takes one of two ways:
//!
//! 1. Registers, 0x0000-0x0FFF, by a command and a data word (`csr`): the command has address,
//!    width and direction, and its busy bit tells when the ESC has executed it. It accesses 1, 2 or
//!    4 bytes, at an address that is a multiple of this number.
//! 2. Process RAM from 0x1000 on, by two FIFOs of 16 words (`process_ram`): one command for the
//!    whole access, so that one access opens and closes a SyncManager's buffer, then words as the
//!    FIFO has data or space.
//!
//! Both use the chip's own registers, which SPI reads and writes directly (`system`).
//!
//! The bus runs in mode 0 or 3, at up to 30 MHz: reads use the command without a dummy byte. The
//! EEPROM must configure SPI with the LAN9252's indirect access as PDI. A cycle with DC SYNC0 and
//! four bytes in each direction takes about 12 transactions and 84 bytes on the bus: 22 us at 30
//! MHz, plus the pauses between transactions.
//!
//! The driver was tested with a model of the chip's registers (`tests/chip`), but not with a real
//! chip yet.
//!
//! ```no_run
//! # fn device<SPI: embedded_hal::spi::SpiDevice>(
//! #     spi: SPI,
//! #     mut delay: impl embedded_hal::delay::DelayNs,
//! # ) -> Result<(), isocat_lan925x::Error<SPI::Error>> {
//! use isocat_esc::Pdi;
//! use isocat_lan925x::Lan925x;
//!
//! let mut chip = Lan925x::new(spi);
//! let id = chip.reset(&mut delay)?; // the chip is there, and ready
//! let events = chip.events(); // what the stack's `poll` begins with
//! if let Some(fault) = chip.take_fault() {
//!     return Err(fault); // the bus failed since the last look
//! }
//! # Ok(())
//! # }
//! ```
#![no_std]
#![forbid(unsafe_code)]

mod csr;
mod driver;
mod error;
mod process_ram;
pub mod system;

pub use driver::{ChipId, Lan925x};
pub use error::{Access, Direction, Error};
