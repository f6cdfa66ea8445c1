//! Access to the ESC's registers, 0x0000-0x0FFF: a command with a busy bit, and a data word.

use embedded_hal::spi::SpiDevice;

use crate::driver::Lan925x;
use crate::error::{Access, Direction, Error};
use crate::system::{self, BUSY, CSR_CMD, CSR_DATA, CSR_READ};

impl<SPI: SpiDevice> Lan925x<SPI> {
    /// Reads registers, in pieces that one command can access.
    pub(crate) fn read_registers(
        &mut self,
        mut address: u16,
        mut data: &mut [u8],
    ) -> Result<(), Error<SPI::Error>> {
        while !data.is_empty() {
            let (piece, rest) = data.split_at_mut(piece_len(address, data.len()));
            self.csr(Direction::Read, address, piece.len())?;
            let word = system::read(&mut self.spi, CSR_DATA).map_err(Error::Bus)?.to_le_bytes();
            piece.copy_from_slice(&word[..piece.len()]);
            address += piece.len() as u16;
            data = rest;
        }
        Ok(())
    }

    /// Writes registers, in pieces that one command can access.
    pub(crate) fn write_registers(
        &mut self,
        mut address: u16,
        mut data: &[u8],
    ) -> Result<(), Error<SPI::Error>> {
        while !data.is_empty() {
            let (piece, rest) = data.split_at(piece_len(address, data.len()));
            let mut word = [0; 4];
            word[..piece.len()].copy_from_slice(piece);
            // Must come before the data: an unfinished command still uses the data register.
            self.finish_csr(Direction::Write, address, piece.len())?;
            system::write(&mut self.spi, CSR_DATA, u32::from_le_bytes(word)).map_err(Error::Bus)?;
            self.csr(Direction::Write, address, piece.len())?;
            address += piece.len() as u16;
            data = rest;
        }
        Ok(())
    }

    /// Sends one command and waits for its end.
    fn csr(
        &mut self,
        direction: Direction,
        address: u16,
        len: usize,
    ) -> Result<(), Error<SPI::Error>> {
        self.finish_csr(direction, address, len)?;
        let read = if direction == Direction::Read { CSR_READ } else { 0 };
        let command = BUSY | read | (len as u32) << 16 | u32::from(address);
        self.unfinished.csr = true;
        system::write(&mut self.spi, CSR_CMD, command).map_err(Error::Bus)?;
        self.finish_csr(direction, address, len)
    }

    /// Waits for the end of an unfinished command; `direction`, `address` and `len` are the access
    /// for the error.
    fn finish_csr(
        &mut self,
        direction: Direction,
        address: u16,
        len: usize,
    ) -> Result<(), Error<SPI::Error>> {
        let mut polls = 0;
        while self.unfinished.csr {
            let state = system::read(&mut self.spi, CSR_CMD).map_err(Error::Bus)?;
            self.unfinished.csr = state & BUSY != 0;
            polls += 1;
            if self.unfinished.csr && polls >= self.polls {
                return Err(Error::Busy(Access { direction, address, len: len as u16 }));
            }
        }
        Ok(())
    }
}

/// Number of bytes of the next command: 1, 2 or 4, at an address that is a multiple of it.
fn piece_len(address: u16, left: usize) -> usize {
    let aligned = match address % 4 {
        0 => 4,
        2 => 2,
        _ => 1,
    };
    let fits = match left {
        1 => 1,
        2 | 3 => 2,
        _ => 4,
    };
    aligned.min(fits)
}
