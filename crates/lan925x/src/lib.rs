//! LAN9252, LAN9253 and LAN9254 behind SPI: the door between the SubDevice stack and a real ESC.
//!
//! [`Lan925x`] takes an `embedded-hal` SPI device and is an [`isocat_esc::Pdi`]. An access of the stack goes
//! one of two ways:
//!
//! 1. Registers, 0x0000-0x0FFF, through a command and a data word (`csr`): the command names address, width
//!    and direction, its busy bit says when the ESC has done it. 1, 2 or 4 bytes at once, at addresses that
//!    are a multiple of their number.
//! 2. Process RAM from 0x1000 on, through two FIFOs of 16 words (`process_ram`): one command for the
//!    whole access, so that a SyncManager's buffer is opened and closed by one access, then words as they
//!    come or find room.
//!
//! Both stand on the chip's own registers, which SPI reads and writes directly (`system`).
//!
//! The bus runs in mode 0 or 3, at up to 30 MHz: reads use the command without a dummy byte. The EEPROM must
//! configure SPI with the LAN9252's indirect access as PDI. A cycle with DC SYNC0 and four bytes each way
//! takes about 15 transactions and 105 bytes of the bus: 28 us at 30 MHz, pauses between them apart.
//!
//! The driver was tested against a model of the chip's registers (`tests/chip`), not on a chip yet.
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
