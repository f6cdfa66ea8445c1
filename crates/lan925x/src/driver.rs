//! The driver: start of the chip, access for the stack, and faults.

use embedded_hal::delay::DelayNs;
use embedded_hal::spi::SpiDevice;
use isocat_esc::Pdi;

use crate::error::Error;
use crate::system::{
    self, BYTE_TEST, BYTE_TEST_VALUE, HW_CFG, HW_CFG_READY, ID_REV, INT_EN, INT_ESC,
    IRQ_ACTIVE_HIGH, IRQ_CFG, IRQ_ENABLED, IRQ_PUSH_PULL, RESET_CTL, RESET_DIGITAL,
};

/// A LAN9252, LAN9253 or LAN9254 behind SPI.
///
/// - start: [`reset`](Self::reset) or, if the chip was reset with the CPU,
///   [`connect`](Self::connect); then [`enable_interrupt`](Self::enable_interrupt);
/// - access for the stack: [`Pdi`], which returns no errors;
/// - the same access with errors: [`try_read`](Self::try_read), [`try_write`](Self::try_write);
/// - faults: [`fault`](Self::fault), [`take_fault`](Self::take_fault), [`faults`](Self::faults),
///   [`check`](Self::check);
/// - the chip's own registers: [`read_system`](Self::read_system),
///   [`write_system`](Self::write_system).
///
/// **Faults.** A failed access through [`Pdi`] reads only zeros, or writes nothing or a part of its
/// data. The first error is kept until it is taken, and all errors are counted. The next access is
/// tried normally: a disturbed transfer costs one access, and an access that was not finished is
/// ended first. Zeros are no event and no state, so the stack waits meanwhile. The main loop should
/// check [`fault`](Self::fault) once per turn and decide what to do.
///
/// Process data are the exception: zeros may be outputs. As long as the buffer of SM2 was not read,
/// its event remains and the interrupt line stays active, so a handler that runs until the line is
/// inactive reads the buffer again. If the chip had already released the buffer, the application
/// gets zeros for one cycle.
///
/// **Time.** The driver has no clock: it gives up an access that the chip does not end after a
/// number of polls, [`with_polls`](Self::with_polls).
#[derive(Debug)]
pub struct Lan925x<SPI: SpiDevice> {
    pub(crate) spi: SPI,
    /// How often the chip is polled for the end of an access.
    pub(crate) polls: u32,
    pub(crate) unfinished: Unfinished,
    fault: Option<Error<SPI::Error>>,
    faults: u32,
}

/// Accesses that were started and whose end was not read yet.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Unfinished {
    pub csr: bool,
    pub read: bool,
    pub write: bool,
}

/// The type of a chip.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct ChipId {
    /// 0x9252, 0x9253 or 0x9254.
    pub chip: u16,
    /// Revision of the silicon.
    pub revision: u16,
}

impl<SPI: SpiDevice> Lan925x<SPI> {
    /// A driver that has not accessed its chip yet.
    pub fn new(spi: SPI) -> Self {
        // An earlier user of the bus may have left accesses unfinished.
        let unfinished = Unfinished { csr: true, read: true, write: true };
        Self { spi, polls: POLLS, unfinished, fault: None, faults: 0 }
    }

    /// Sets the number of polls (at least 1) after which an access is given up. One poll takes 7
    /// bytes on the bus, about 2 us at 30 MHz.
    pub fn with_polls(mut self, polls: u32) -> Self {
        self.polls = polls.max(1);
        self
    }

    /// Resets the chip except its PHYs, but with ESC and EEPROM loader, and waits until it is
    /// ready. The ESC starts in INIT, as after power-on.
    pub fn reset(&mut self, delay: &mut impl DelayNs) -> Result<ChipId, Error<SPI::Error>> {
        // A command may not reach the chip before it answers.
        self.await_system(delay, BYTE_TEST, |found| found == BYTE_TEST_VALUE)?
            .map_err(|found| Error::ByteTest { found })?;
        self.write_system(RESET_CTL, RESET_DIGITAL)?;
        self.unfinished = Unfinished { csr: true, read: true, write: true };
        delay.delay_ns(RESET_TIME_NS);
        let id = self.connect(delay)?;
        let found = self.read_system(RESET_CTL)?;
        if found & RESET_DIGITAL == 0 { Ok(id) } else { Err(Error::InReset { found }) }
    }

    /// Waits until the chip answers and then until it is ready, at most 0.2 s each; returns its
    /// type.
    pub fn connect(&mut self, delay: &mut impl DelayNs) -> Result<ChipId, Error<SPI::Error>> {
        self.await_system(delay, BYTE_TEST, |found| found == BYTE_TEST_VALUE)?
            .map_err(|found| Error::ByteTest { found })?;
        self.await_system(delay, HW_CFG, |found| found & HW_CFG_READY != 0)?
            .map_err(|found| Error::NotReady { found })?;
        let found = self.read_system(ID_REV)?;
        let id = ChipId { chip: (found >> 16) as u16, revision: found as u16 };
        if KNOWN.contains(&id.chip) { Ok(id) } else { Err(Error::UnknownChip { found }) }
    }

    /// Connects the ESC's interrupt to the pin, which drives both levels. It is active as long as
    /// there is an AL event that the mask (0x0204) allows. A reset disconnects it.
    pub fn enable_interrupt(&mut self, active_high: bool) -> Result<(), Error<SPI::Error>> {
        let polarity = if active_high { IRQ_ACTIVE_HIGH } else { 0 };
        self.write_system(IRQ_CFG, IRQ_ENABLED | IRQ_PUSH_PULL | polarity)?;
        self.write_system(INT_EN, INT_ESC)
    }

    /// Checks whether the chip still answers: reads BYTE_TEST once. This detects a bus that reads
    /// zeros, which otherwise looks like an ESC without events.
    pub fn check(&mut self) -> Result<(), Error<SPI::Error>> {
        let found = self.read_system(BYTE_TEST)?;
        if found == BYTE_TEST_VALUE { Ok(()) } else { Err(Error::ByteTest { found }) }
    }

    /// Reads from the ESC's address space. Addresses beyond its end read 0.
    pub fn try_read(&mut self, address: u16, data: &mut [u8]) -> Result<(), Error<SPI::Error>> {
        let (registers, end) = split(address, data.len());
        let (data, beyond) = data.split_at_mut(end);
        let (low, high) = data.split_at_mut(registers);
        beyond.fill(0);
        self.read_registers(address, low)?;
        if high.is_empty() { Ok(()) } else { self.read_ram(address.max(PROCESS_RAM), high) }
    }

    /// Writes to the ESC's address space. Data beyond its end are dropped.
    pub fn try_write(&mut self, address: u16, data: &[u8]) -> Result<(), Error<SPI::Error>> {
        let (registers, end) = split(address, data.len());
        let (low, high) = data[..end].split_at(registers);
        self.write_registers(address, low)?;
        if high.is_empty() { Ok(()) } else { self.write_ram(address.max(PROCESS_RAM), high) }
    }

    /// Reads a register of the chip itself; see [`system`].
    pub fn read_system(&mut self, address: u16) -> Result<u32, Error<SPI::Error>> {
        system::read(&mut self.spi, address).map_err(Error::Bus)
    }

    /// Writes a register of the chip itself; see [`system`]. The registers at 0x300-0x317 belong to
    /// the driver.
    pub fn write_system(&mut self, address: u16, value: u32) -> Result<(), Error<SPI::Error>> {
        system::write(&mut self.spi, address, value).map_err(Error::Bus)
    }

    /// Returns the first error of [`Pdi`] since the last call, and clears it.
    pub fn take_fault(&mut self) -> Option<Error<SPI::Error>> {
        self.fault.take()
    }

    /// Returns the bus.
    pub fn release(self) -> SPI {
        self.spi
    }

    /// The first error of [`Pdi`] since the last [`take_fault`](Self::take_fault).
    pub fn fault(&self) -> Option<&Error<SPI::Error>> {
        self.fault.as_ref()
    }

    /// Number of failed accesses through [`Pdi`]. Saturates.
    pub fn faults(&self) -> u32 {
        self.faults
    }

    /// Reads a register of the chip until its value is right; the inner error is the last value.
    fn await_system(
        &mut self,
        delay: &mut impl DelayNs,
        address: u16,
        right: impl Fn(u32) -> bool,
    ) -> Result<Result<(), u32>, Error<SPI::Error>> {
        let mut found = self.read_system(address)?;
        for _ in 0..READY_MS {
            if right(found) {
                break;
            }
            delay.delay_ms(1);
            found = self.read_system(address)?;
        }
        Ok(if right(found) { Ok(()) } else { Err(found) })
    }

    fn keep(&mut self, fault: Error<SPI::Error>) {
        self.fault.get_or_insert(fault);
        self.faults = self.faults.saturating_add(1);
    }
}

impl<SPI: SpiDevice> Pdi for Lan925x<SPI> {
    fn read(&mut self, address: u16, data: &mut [u8]) {
        if let Err(fault) = self.try_read(address, data) {
            data.fill(0);
            self.keep(fault);
        }
    }

    fn write(&mut self, address: u16, data: &[u8]) {
        if let Err(fault) = self.try_write(address, data) {
            self.keep(fault);
        }
    }
}

/// The number of bytes that are registers, and the number that exist at all, of `len` bytes from
/// `address` on.
fn split(address: u16, len: usize) -> (usize, usize) {
    let end = len.min(usize::from(u16::MAX - address) + 1);
    (end.min(usize::from(PROCESS_RAM.saturating_sub(address))), end)
}

/// Where process RAM begins.
const PROCESS_RAM: u16 = 0x1000;
/// Chips that this driver supports.
const KNOWN: [u16; 3] = [0x9252, 0x9253, 0x9254];
/// Polls until a command is given up: about 2 ms at 30 MHz, while an access takes microseconds.
const POLLS: u32 = 1_000;
/// Time that the chip has to answer, and again to become ready.
const READY_MS: u32 = 200;
/// Time without access after a reset command, ns. Chosen so that the chip no longer shows its state
/// before the reset.
const RESET_TIME_NS: u32 = 1_000_000;
