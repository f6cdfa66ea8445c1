//! Errors between the CPU and the chip.

use core::fmt;

use crate::system::{BYTE_TEST_VALUE, HW_CFG_READY};

/// Why an access to the chip failed.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Error<E> {
    /// The SPI bus reported a fault.
    Bus(E),
    /// BYTE_TEST (0x064) does not read 0x87654321: no chip, wrong bus mode, or not ready yet.
    ByteTest {
        /// The last value that was read.
        found: u32,
    },
    /// HW_CFG (0x074) bit 27 stays 0: the chip is not ready, for example without a working EEPROM.
    NotReady {
        /// The last value of HW_CFG.
        found: u32,
    },
    /// RESET_CTL (0x1F8) bit 0 stays 1.
    InReset {
        /// The last value of RESET_CTL.
        found: u32,
    },
    /// ID_REV (0x050) names a chip that this driver does not support.
    UnknownChip {
        /// The value that was read.
        found: u32,
    },
    /// The chip did not end an access to the ESC.
    Busy(Access),
    /// The FIFO of an access to process RAM claims more words than it can hold: no chip drives the
    /// bus.
    FifoCount {
        /// The access.
        access: Access,
        /// The value of the command register.
        found: u32,
    },
}

/// An access to the ESC's registers or process RAM.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Access {
    /// Read or write.
    pub direction: Direction,
    /// First byte, as address of the ESC.
    pub address: u16,
    /// Number of bytes.
    pub len: u16,
}

/// The direction of the data of an access.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Direction {
    /// From the ESC.
    Read,
    /// To the ESC.
    Write,
}

impl<E: fmt::Debug> fmt::Display for Error<E> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Error::Bus(fault) => write!(f, "SPI: {fault:?}"),
            Error::ByteTest { found } => {
                write!(
                    f,
                    "BYTE_TEST (0x064): expected {BYTE_TEST_VALUE:#010x}, found {found:#010x}"
                )
            }
            Error::NotReady { found } => write!(
                f,
                "HW_CFG (0x074): expected bit 27 ({HW_CFG_READY:#010x}), found {found:#010x}"
            ),
            Error::InReset { found } => {
                write!(f, "RESET_CTL (0x1F8): expected bit 0 clear, found {found:#010x}")
            }
            Error::UnknownChip { found } => write!(
                f,
                "ID_REV (0x050): expected 0x9252, 0x9253 or 0x9254 in bits 31:16, found {found:#010x}"
            ),
            Error::Busy(access) => write!(f, "{access}: still busy"),
            Error::FifoCount { access, found } => {
                write!(f, "{access}: expected at most 16 words in the FIFO, found {found:#010x}")
            }
        }
    }
}

impl<E: fmt::Debug> core::error::Error for Error<E> {}

impl fmt::Display for Access {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let verb = match self.direction {
            Direction::Read => "read",
            Direction::Write => "write",
        };
        write!(f, "{verb} of {} bytes at 0x{:04X}", self.len, self.address)
    }
}
