//! The chip's own registers, as SPI reaches them: words of 32 bits, little-endian, beside the ESC's.

use embedded_hal::spi::{Operation, SpiDevice};

/// What is read here comes out of the FIFO of process RAM that was asked for; 0x000-0x01F are the same.
pub const PRAM_READ_DATA: u16 = 0x000;
/// What is written here goes into the FIFO towards process RAM; 0x020-0x03F are the same.
pub const PRAM_WRITE_DATA: u16 = 0x020;
/// Chip in bits 31:16, revision in bits 15:0.
pub const ID_REV: u16 = 0x050;
/// Interrupt pin: push-pull 0, active high 4, enabled 8.
pub const IRQ_CFG: u16 = 0x054;
/// Which interrupts reach the pin; bit 0 is the ESC's.
pub const INT_EN: u16 = 0x05C;
/// Reads [`BYTE_TEST_VALUE`] once the bus works, even before the chip is ready.
pub const BYTE_TEST: u16 = 0x064;
/// Hardware configuration; see [`HW_CFG_READY`].
pub const HW_CFG: u16 = 0x074;
/// Resets; see [`RESET_DIGITAL`].
pub const RESET_CTL: u16 = 0x1F8;
/// Data of an access to an ESC register, in the low bytes.
pub const CSR_DATA: u16 = 0x300;
/// Command of an access to an ESC register: address 15:0, bytes 18:16, read 30, busy 31.
pub const CSR_CMD: u16 = 0x304;
/// Process RAM to be read: address 15:0, bytes 31:16.
pub const PRAM_READ_ADDRESS: u16 = 0x308;
/// Command and state of the read: words in the FIFO 12:8, abort 30, busy 31.
pub const PRAM_READ_CMD: u16 = 0x30C;
/// Process RAM to be written: address 15:0, bytes 31:16.
pub const PRAM_WRITE_ADDRESS: u16 = 0x310;
/// Command and state of the write: words that the FIFO has room for 12:8, abort 30, busy 31.
pub const PRAM_WRITE_CMD: u16 = 0x314;

/// What [`BYTE_TEST`] reads.
pub const BYTE_TEST_VALUE: u32 = 0x8765_4321;
/// [`HW_CFG`] bit 27: everything is loaded and can be accessed.
pub const HW_CFG_READY: u32 = 1 << 27;
/// [`RESET_CTL`] bit 0: resets all but the PHYs; clears itself.
pub const RESET_DIGITAL: u32 = 1 << 0;
/// Bit 31 of the commands: written to start, reads 1 until it is done.
pub const BUSY: u32 = 1 << 31;
/// Bit 30 of [`CSR_CMD`]: read instead of write.
pub const CSR_READ: u32 = 1 << 30;
/// Bit 30 of [`PRAM_READ_CMD`] and [`PRAM_WRITE_CMD`]: the access ends, its FIFO is emptied; clears
/// itself.
pub const PRAM_ABORT: u32 = 1 << 30;
/// [`IRQ_CFG`] bit 0: the pin drives both levels, else it pulls down only.
pub const IRQ_PUSH_PULL: u32 = 1 << 0;
/// [`IRQ_CFG`] bit 4: the pin is high while an interrupt stands.
pub const IRQ_ACTIVE_HIGH: u32 = 1 << 4;
/// [`IRQ_CFG`] bit 8: the pin works.
pub const IRQ_ENABLED: u32 = 1 << 8;
/// [`INT_EN`] bit 0: an AL event of the ESC that its mask (0x0204) lets through reaches the pin.
pub const INT_ESC: u32 = 1 << 0;
/// Words that a FIFO holds.
pub const FIFO_WORDS: usize = 16;

/// SPI command: read, the data follow the address at once; up to 30 MHz.
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

/// Reads words from one address that stays the same: those of a FIFO.
pub(crate) fn read_words<SPI: SpiDevice>(
    spi: &mut SPI,
    address: u16,
    words: &mut [u8],
) -> Result<(), SPI::Error> {
    let header = header(SPI_READ, address);
    spi.transaction(&mut [Operation::Write(&header), Operation::Read(words)])
}

/// Writes words to one address that stays the same.
pub(crate) fn write_words<SPI: SpiDevice>(
    spi: &mut SPI,
    address: u16,
    words: &[u8],
) -> Result<(), SPI::Error> {
    let header = header(SPI_WRITE, address);
    spi.transaction(&mut [Operation::Write(&header), Operation::Write(words)])
}

/// Command and address, high byte first. Its upper two bits would make the address count.
fn header(command: u8, address: u16) -> [u8; 3] {
    let [high, low] = address.to_be_bytes();
    [command, high, low]
}

/// Words in the FIFO, or that it has room for; `None` if no FIFO can be so long.
pub(crate) fn fifo_count(command: u32) -> Option<usize> {
    let count = (command >> 8 & 0x1F) as usize;
    (count <= FIFO_WORDS).then_some(count)
}
