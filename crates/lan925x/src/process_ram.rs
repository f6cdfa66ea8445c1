//! Access to process RAM, from 0x1000 on: one command for the whole access, and a FIFO of words.
//!
//! The words of the FIFO are those of RAM, so the address of the first byte determines its place in
//! its word.

use embedded_hal::spi::SpiDevice;

use crate::driver::Lan925x;
use crate::error::{Access, Direction, Error};
use crate::system::{
    self, BUSY, FIFO_WORDS, PRAM_ABORT, PRAM_READ_ADDRESS, PRAM_READ_CMD, PRAM_READ_DATA,
    PRAM_WRITE_ADDRESS, PRAM_WRITE_CMD, PRAM_WRITE_DATA,
};

impl<SPI: SpiDevice> Lan925x<SPI> {
    /// Reads process RAM with one access.
    pub(crate) fn read_ram(
        &mut self,
        address: u16,
        data: &mut [u8],
    ) -> Result<(), Error<SPI::Error>> {
        let access = Access { direction: Direction::Read, address, len: data.len() as u16 };
        self.start(access)?;
        let mut fifo = [0; 4 * FIFO_WORDS];
        let mut lead = usize::from(address % 4);
        let mut done = 0;
        while done < data.len() {
            let left = lead + data.len() - done;
            let words = self.available(access)?.min(left.div_ceil(4));
            let words = &mut fifo[..4 * words];
            system::read_words(&mut self.spi, PRAM_READ_DATA, words).map_err(Error::Bus)?;
            let found = &words[lead..words.len().min(left)];
            data[done..done + found.len()].copy_from_slice(found);
            done += found.len();
            lead = 0;
        }
        self.unfinished.read = false;
        Ok(())
    }

    /// Writes process RAM with one access; on return, all data are in RAM.
    pub(crate) fn write_ram(&mut self, address: u16, data: &[u8]) -> Result<(), Error<SPI::Error>> {
        let access = Access { direction: Direction::Write, address, len: data.len() as u16 };
        self.start(access)?;
        let mut fifo = [0; 4 * FIFO_WORDS];
        let mut lead = usize::from(address % 4);
        let mut done = 0;
        while done < data.len() {
            let left = lead + data.len() - done;
            let words = self.available(access)?.min(left.div_ceil(4));
            let words = &mut fifo[..4 * words];
            let room = lead..words.len().min(left);
            let len = room.len();
            words[room].copy_from_slice(&data[done..done + len]);
            system::write_words(&mut self.spi, PRAM_WRITE_DATA, words).map_err(Error::Bus)?;
            done += len;
            lead = 0;
        }
        self.drain(access)?;
        self.unfinished.write = false;
        Ok(())
    }

    /// Starts an access, after ending an unfinished one in the same direction.
    fn start(&mut self, access: Access) -> Result<(), Error<SPI::Error>> {
        let (address, command, unfinished) = match access.direction {
            Direction::Read => (PRAM_READ_ADDRESS, PRAM_READ_CMD, &mut self.unfinished.read),
            Direction::Write => (PRAM_WRITE_ADDRESS, PRAM_WRITE_CMD, &mut self.unfinished.write),
        };
        if core::mem::replace(unfinished, true) {
            system::write(&mut self.spi, command, PRAM_ABORT).map_err(Error::Bus)?;
            self.drain(access)?;
        }
        let place = u32::from(access.len) << 16 | u32::from(access.address);
        system::write(&mut self.spi, address, place).map_err(Error::Bus)?;
        system::write(&mut self.spi, command, BUSY).map_err(Error::Bus)
    }

    /// Waits until the FIFO has words, or space for them, and returns how many.
    fn available(&mut self, access: Access) -> Result<usize, Error<SPI::Error>> {
        for _ in 0..self.polls {
            let state = self.state(access.direction)?;
            match system::fifo_count(state) {
                Some(0) => {}
                Some(count) => return Ok(count),
                None => return Err(Error::FifoCount { access, found: state }),
            }
        }
        Err(Error::Busy(access))
    }

    /// Waits until the access has ended.
    fn drain(&mut self, access: Access) -> Result<(), Error<SPI::Error>> {
        for _ in 0..self.polls {
            if self.state(access.direction)? & BUSY == 0 {
                return Ok(());
            }
        }
        Err(Error::Busy(access))
    }

    fn state(&mut self, direction: Direction) -> Result<u32, Error<SPI::Error>> {
        let command = match direction {
            Direction::Read => PRAM_READ_CMD,
            Direction::Write => PRAM_WRITE_CMD,
        };
        system::read(&mut self.spi, command).map_err(Error::Bus)
    }
}
