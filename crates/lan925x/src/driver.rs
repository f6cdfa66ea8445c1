//! The driver: the chip's start, and the stack's door with its faults.

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
/// - start: [`reset`](Self::reset) or, if the chip was reset with the CPU, [`connect`](Self::connect); then
///   [`enable_interrupt`](Self::enable_interrupt);
/// - the stack's door: [`Pdi`], where nothing fails visibly;
/// - the same with errors: [`try_read`](Self::try_read), [`try_write`](Self::try_write);
/// - faults: [`fault`](Self::fault), [`take_fault`](Self::take_fault), [`faults`](Self::faults),
///   [`check`](Self::check);
/// - the chip's own registers: [`read_system`](Self::read_system), [`write_system`](Self::write_system).
///
/// **Faults.** An access through [`Pdi`] that fails reads zeros, all of them, or writes nothing or a part;
/// the first error is kept until it is taken, and all are counted. The next access is tried as if
/// nothing had happened: a disturbed transfer costs one access, and one that was left half done is
/// ended first. Zeros are no event and no state, so the stack waits meanwhile. Whoever runs the main
/// loop looks at [`fault`](Self::fault) once a turn and decides.
///
/// Process data are the exception: zeros may be outputs. As long as the buffer of SM2 was not read its event
/// stands and the interrupt line stays active: a handler that runs until the line falls fetches it again.
/// Where the chip had already given the buffer out, the application sees zeros for one cycle.
///
/// **Time.** The driver knows no clock: an access that the chip does not end is given up after a number
/// of looks, [`with_polls`](Self::with_polls).
#[derive(Debug)]
pub struct Lan925x<SPI: SpiDevice> {
    pub(crate) spi: SPI,
    /// How often the chip is asked whether an access has ended.
    pub(crate) polls: u32,
    pub(crate) unfinished: Unfinished,
    fault: Option<Error<SPI::Error>>,
    faults: u32,
}

/// Accesses of the chip that were started and whose end was not seen.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Unfinished {
    pub csr: bool,
    pub read: bool,
    pub write: bool,
}

/// Which chip it is.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct ChipId {
    /// 0x9252, 0x9253 or 0x9254.
    pub chip: u16,
    /// Revision of the silicon.
    pub revision: u16,
}

impl<SPI: SpiDevice> Lan925x<SPI> {
    /// A driver that has not talked to its chip yet.
    pub fn new(spi: SPI) -> Self {
        // Who had the bus before may have left anything under way.
        let unfinished = Unfinished { csr: true, read: true, write: true };
        Self { spi, polls: POLLS, unfinished, fault: None, faults: 0 }
    }

    /// The same driver that looks `polls` times (at least once) whether an access has ended, before it gives
    /// it up. One look takes 7 bytes on the bus, about 2 us at 30 MHz.
    pub fn with_polls(mut self, polls: u32) -> Self {
        self.polls = polls.max(1);
        self
    }

    /// Resets the chip but for its PHYs, ESC and EEPROM loader included, and waits until it is ready.
    /// The ESC starts in INIT, as after power-on.
    pub fn reset(&mut self, delay: &mut impl DelayNs) -> Result<ChipId, Error<SPI::Error>> {
        // Before it answers, a command may not reach it.
        self.await_system(delay, BYTE_TEST, |found| found == BYTE_TEST_VALUE)?
            .map_err(|found| Error::ByteTest { found })?;
        self.write_system(RESET_CTL, RESET_DIGITAL)?;
        self.unfinished = Unfinished { csr: true, read: true, write: true };
        delay.delay_ns(RESET_TIME_NS);
        let id = self.connect(delay)?;
        let found = self.read_system(RESET_CTL)?;
        if found & RESET_DIGITAL == 0 { Ok(id) } else { Err(Error::InReset { found }) }
    }

    /// Waits until the chip answers and is ready, at most 0.2 s each, and tells which it is.
    pub fn connect(&mut self, delay: &mut impl DelayNs) -> Result<ChipId, Error<SPI::Error>> {
        self.await_system(delay, BYTE_TEST, |found| found == BYTE_TEST_VALUE)?
            .map_err(|found| Error::ByteTest { found })?;
        self.await_system(delay, HW_CFG, |found| found & HW_CFG_READY != 0)?
            .map_err(|found| Error::NotReady { found })?;
        let found = self.read_system(ID_REV)?;
        let id = ChipId { chip: (found >> 16) as u16, revision: found as u16 };
        if KNOWN.contains(&id.chip) { Ok(id) } else { Err(Error::UnknownChip { found }) }
    }

    /// Lets the ESC's interrupt reach the pin, which drives both levels: a level, active as long as an AL
    /// event stands that the mask (0x0204) lets through. A reset switches it off.
    pub fn enable_interrupt(&mut self, active_high: bool) -> Result<(), Error<SPI::Error>> {
        let polarity = if active_high { IRQ_ACTIVE_HIGH } else { 0 };
        self.write_system(IRQ_CFG, IRQ_ENABLED | IRQ_PUSH_PULL | polarity)?;
        self.write_system(INT_EN, INT_ESC)
    }

    /// Whether the chip still answers: reads BYTE_TEST once. A bus that reads zeros looks like an ESC
    /// without events; this tells them apart.
    pub fn check(&mut self) -> Result<(), Error<SPI::Error>> {
        let found = self.read_system(BYTE_TEST)?;
        if found == BYTE_TEST_VALUE { Ok(()) } else { Err(Error::ByteTest { found }) }
    }

    /// Reads from the ESC's address space. What lies beyond its end reads 0.
    pub fn try_read(&mut self, address: u16, data: &mut [u8]) -> Result<(), Error<SPI::Error>> {
        let (registers, end) = split(address, data.len());
        let (data, beyond) = data.split_at_mut(end);
        let (low, high) = data.split_at_mut(registers);
        beyond.fill(0);
        self.read_registers(address, low)?;
        if high.is_empty() { Ok(()) } else { self.read_ram(address.max(PROCESS_RAM), high) }
    }

    /// Writes to the ESC's address space. What lies beyond its end is dropped.
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

    /// Writes a register of the chip itself; see [`system`]. The commands at 0x300-0x317 are the driver's.
    pub fn write_system(&mut self, address: u16, value: u32) -> Result<(), Error<SPI::Error>> {
        system::write(&mut self.spi, address, value).map_err(Error::Bus)
    }

    /// Gives the first error of [`Pdi`] since the last call, and forgets it.
    pub fn take_fault(&mut self) -> Option<Error<SPI::Error>> {
        self.fault.take()
    }

    /// Gives the bus back.
    pub fn release(self) -> SPI {
        self.spi
    }

    /// The first error of [`Pdi`] that was not taken yet.
    pub fn fault(&self) -> Option<&Error<SPI::Error>> {
        self.fault.as_ref()
    }

    /// Accesses through [`Pdi`] that failed since the beginning. Saturates.
    pub fn faults(&self) -> u32 {
        self.faults
    }

    /// Reads a register of the chip until it is right; the inner error is what it read last.
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

/// How many of `len` bytes from `address` on are registers, and how many exist at all.
fn split(address: u16, len: usize) -> (usize, usize) {
    let end = len.min(usize::from(u16::MAX - address) + 1);
    (end.min(usize::from(PROCESS_RAM.saturating_sub(address))), end)
}

/// Where process RAM begins.
const PROCESS_RAM: u16 = 0x1000;
/// The chips whose SPI access is the one of this driver.
const KNOWN: [u16; 3] = [0x9252, 0x9253, 0x9254];
/// Looks at a command until it is given up: about 2 ms at 30 MHz, where an access takes microseconds.
const POLLS: u32 = 1_000;
/// How long the chip has to answer, and again to get ready.
const READY_MS: u32 = 200;
/// How long the chip is left alone after a reset command, ns. Setting: it then no longer shows the state
/// of before.
const RESET_TIME_NS: u32 = 1_000_000;
