//! The chip's own registers on SPI: little-endian words of 32 bits, separate from those of the ESC.

use embedded_hal::spi::{Operation, SpiDevice};

/// Reads the FIFO from process RAM; 0x000-0x01F are the same register.
pub const PRAM_READ_DATA: u16 = 0x000;
/// Writes the FIFO to process RAM; 0x020-0x03F are the same register.
pub const PRAM_WRITE_DATA: u16 = 0x020;
/// Chip in bits 31:16, revision in bits 15:0.
pub const ID_REV: u16 = 0x050;
/// Interrupt pin: push-pull 0, active high 4, enabled 8.
pub const IRQ_CFG: u16 = 0x054;
/// Enables interrupts at the pin; bit 0 is the ESC's.
pub const INT_EN: u16 = 0x05C;
/// Reads [`BYTE_TEST_VALUE`] if the bus works, even before the chip is ready.
pub const BYTE_TEST: u16 = 0x064;
/// Hardware configuration; see [`HW_CFG_READY`].
pub const HW_CFG: u16 = 0x074;
/// Resets; see [`RESET_DIGITAL`].
pub const RESET_CTL: u16 = 0x1F8;
/// Data of an access to an ESC register, in the low bytes.
pub const CSR_DATA: u16 = 0x300;
/// Command of an access to an ESC register: address 15:0, bytes 18:16, read 30, busy 31.
pub const CSR_CMD: u16 = 0x304;
/// Process RAM to read: address 15:0, bytes 31:16.
pub const PRAM_READ_ADDRESS: u16 = 0x308;
/// Command and state of a read: words in the FIFO 12:8, abort 30, busy 31.
pub const PRAM_READ_CMD: u16 = 0x30C;
/// Process RAM to write: address 15:0, bytes 31:16.
pub const PRAM_WRITE_ADDRESS: u16 = 0x310;
/// Command and state of a write: free words in the FIFO 12:8, abort 30, busy 31.
pub const PRAM_WRITE_CMD: u16 = 0x314;

/// The value of [`BYTE_TEST`].
pub const BYTE_TEST_VALUE: u32 = 0x8765_4321;
/// [`HW_CFG`] bit 27: the configuration is loaded, and all registers can be accessed.
pub const HW_CFG_READY: u32 = 1 << 27;
/// [`RESET_CTL`] bit 0: resets all except the PHYs; clears itself.
pub const RESET_DIGITAL: u32 = 1 << 0;
/// Bit 31 of the commands: write 1 to start; reads 1 until the command is done.
pub const BUSY: u32 = 1 << 31;
/// Bit 30 of [`CSR_CMD`]: read instead of write.
pub const CSR_READ: u32 = 1 << 30;
/// Bit 30 of [`PRAM_READ_CMD`] and [`PRAM_WRITE_CMD`]: ends the access and empties its FIFO; clears
/// itself.
pub const PRAM_ABORT: u32 = 1 << 30;
/// [`IRQ_CFG`] bit 0: the pin drives both levels; 0: it only pulls down.
pub const IRQ_PUSH_PULL: u32 = 1 << 0;
/// [`IRQ_CFG`] bit 4: the pin is high during an interrupt.
pub const IRQ_ACTIVE_HIGH: u32 = 1 << 4;
/// [`IRQ_CFG`] bit 8: the pin is enabled.
pub const IRQ_ENABLED: u32 = 1 << 8;
/// [`INT_EN`] bit 0: AL events of the ESC that its mask (0x0204) allows reach the pin.
pub const INT_ESC: u32 = 1 << 0;
/// Words that a FIFO holds.
pub const FIFO_WORDS: usize = 16;

/// SPI command: read, with data directly after the address; up to 30 MHz.
const SPI_READ: u8 = 0x03;
/// SPI command: write.
const SPI_WRITE: u8 = 0x02;

/// Reads a register.
pub(crate) fn read<SPI: SpiDevice>(spi: &mut SPI, address: u16) -> Result<u32, SPI::Error> {
    let mut word = [0; 4];
    read_words(spi, address, &mut word)?;
    Ok(u32::from_le_bytes(word))
}

/// Writes a register.
pub(crate) fn write<SPI: SpiDevice>(
    spi: &mut SPI,
    address: u16,
    value: u32,
) -> Result<(), SPI::Error> {
    write_words(spi, address, &value.to_le_bytes())
}

/// Reads words from one fixed address: those of a FIFO.
pub(crate) fn read_words<SPI: SpiDevice>(
    spi: &mut SPI,
    address: u16,
    words: &mut [u8],
) -> Result<(), SPI::Error> {
    let header = header(SPI_READ, address);
    spi.transaction(&mut [Operation::Write(&header), Operation::Read(words)])
}

/// Writes words to one fixed address.
pub(crate) fn write_words<SPI: SpiDevice>(
    spi: &mut SPI,
    address: u16,
    words: &[u8],
) -> Result<(), SPI::Error> {
    let header = header(SPI_WRITE, address);
    spi.transaction(&mut [Operation::Write(&header), Operation::Write(words)])
}

/// Command and address, high byte first. The upper two bits of the address are 0: others would make
/// it increment.
fn header(command: u8, address: u16) -> [u8; 3] {
    let [high, low] = address.to_be_bytes();
    [command, high, low]
}

/// Words in the FIFO, or free words; `None`: the value is larger than a FIFO.
pub(crate) fn fifo_count(command: u32) -> Option<usize> {
    let count = (command >> 8 & 0x1F) as usize;
    (count <= FIFO_WORDS).then_some(count)
}
