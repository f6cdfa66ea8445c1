//! A LAN9252 behind SPI, register by register, with the software ESC in it.
//!
//! Time passes with the bytes on the bus. Commands to registers, and each word between a FIFO and
//! process RAM, take their own time. Frames arrive when they are due, even during an access.
//! Everything that a driver must not do is recorded as a breach.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;

use embedded_hal::delay::DelayNs;
use embedded_hal::spi::{ErrorKind, ErrorType, Operation, SpiDevice};
use isocat_esc::{Esc, EscEvent, LAN9252, Pdi};
use isocat_wire::sii::{Header, Writer};
use isocat_wire::time::{Device, Time};
use isocat_wire::{Nanos, frame};

/// The chip and its clock.
pub struct Chip {
    pub esc: Esc<Vec<u8>>,
    pub now: Time<Device>,
    /// Events of the ESC that were not taken yet.
    pub events: VecDeque<(Time<Device>, EscEvent)>,
    /// Frames that will arrive, in order, and frames that have passed.
    pub arriving: VecDeque<(Time<Device>, Vec<u8>)>,
    pub passed: Vec<Vec<u8>>,
    /// Wrong accesses of the driver.
    pub breaches: Vec<String>,
    pub bytes: u64,
    pub transactions: u64,
    /// Numbers of the transactions that fail on the bus.
    pub failing: Vec<u64>,
    pub byte_test: u32,
    pub id_rev: u32,
    /// When HW_CFG shows that the chip is ready.
    pub ready_at: Time<Device>,
    /// How long a command to a register takes; `None`: it never ends.
    pub csr_time: Option<Nanos>,
    /// How long a word between FIFO and RAM takes; `None`: it never ends.
    pub word_time: Option<Nanos>,
    /// The value of every byte on a bus that no chip drives.
    pub floating: Option<u8>,
    reset: bool,
    irq_cfg: u32,
    int_en: u32,
    csr: Option<Command>,
    csr_data: u32,
    reader: Transfer,
    writer: Transfer,
}

/// An unfinished command to a register of the ESC.
#[derive(Clone, Copy)]
struct Command {
    word: u32,
    done: Time<Device>,
}

/// One of the two FIFOs, with its access to process RAM.
#[derive(Default)]
struct Transfer {
    place: u32,
    /// Address and bytes left, while the access is busy.
    left: Option<(u16, u16)>,
    fifo: VecDeque<[u8; 4]>,
    /// When the next word moves.
    due: Option<Time<Device>>,
}

impl Transfer {
    fn state(&self, count: usize) -> u32 {
        u32::from(self.left.is_some()) << 31 | (count as u32) << 8 | u32::from(count > 0)
    }

    /// The place and number of the bytes of the next word in RAM.
    fn lanes(address: u16, left: u16) -> (usize, usize) {
        let lead = usize::from(address % 4);
        (lead, usize::from(left).min(4 - lead))
    }
}

impl Chip {
    pub fn new() -> Self {
        let mut sii = vec![0; 256];
        // PDI is SPI; SYNC unit on; SYNC0 pulses of 1 us.
        let header = Header {
            configuration: [0x80, 0x04, 0, 0, 100, 0, 0, 0, 0, 0, 0, 0, 0, 0],
            ..Header::default()
        };
        Writer::new(&mut sii, &header).unwrap().finish().unwrap();
        Self {
            esc: Esc::new(&LAN9252, sii, vec![0; 4096]),
            now: Time::ZERO,
            events: VecDeque::new(),
            arriving: VecDeque::new(),
            passed: Vec::new(),
            breaches: Vec::new(),
            bytes: 0,
            transactions: 0,
            failing: Vec::new(),
            byte_test: 0x8765_4321,
            id_rev: 0x9252_0001,
            ready_at: Time::ZERO,
            csr_time: Some(Nanos(500)),
            word_time: Some(Nanos(300)),
            floating: None,
            reset: false,
            irq_cfg: 0,
            int_en: 0,
            csr: None,
            csr_data: 0,
            reader: Transfer::default(),
            writer: Transfer::default(),
        }
    }

    /// When the next event happens.
    pub fn next(&self) -> Time<Device> {
        let own = [
            self.csr.map(|command| command.done),
            self.reader.due,
            self.writer.due,
            self.arriving.front().map(|(at, _)| *at),
        ];
        own.into_iter().flatten().fold(self.esc.next_event(), Time::min)
    }

    /// The level of the interrupt pin; `None` while the chip does not drive it.
    pub fn pin(&self) -> Option<bool> {
        let active = self.int_en & 1 != 0 && self.esc.interrupt(self.now);
        let active_high = self.irq_cfg & 1 << 4 != 0;
        (self.irq_cfg & 0x101 == 0x101).then_some(active == active_high)
    }

    /// Advances time, and processes all events on the way.
    pub fn advance(&mut self, to: Time<Device>) {
        while self.now < to || self.next() <= to {
            self.now = self.now.max(self.next().min(to));
            let now = self.now;
            self.events.extend(core::iter::from_fn(|| self.esc.step(now)));
            if self.arriving.front().is_some_and(|(at, _)| *at <= now) {
                let (at, mut bytes) = self.arriving.pop_front().expect("one was there");
                let end = at + Nanos(frame::duration_ns(bytes.len()) as i64);
                self.esc.process(&mut bytes, at, end, true);
                self.passed.push(bytes);
            }
            if let Some(command) = self.csr.take_if(|command| command.done <= now) {
                self.end_csr(command.word);
            }
            if self.reader.due.take_if(|due| *due <= now).is_some() {
                self.fetch_word();
            }
            if self.writer.due.take_if(|due| *due <= now).is_some() {
                self.store_word();
            }
        }
    }

    fn after(&self, span: Option<Nanos>) -> Time<Device> {
        span.map_or(Time::NEVER, |span| self.now + span)
    }

    fn breach(&mut self, what: impl Into<String>) {
        self.breaches.push(what.into());
    }

    fn end_csr(&mut self, word: u32) {
        let (address, len) = (word as u16, (word >> 16 & 7) as usize);
        let mut pdi = self.esc.pdi(self.now);
        if word & 1 << 30 != 0 {
            let mut data = [0; 4];
            pdi.read(address, &mut data[..len]);
            self.csr_data = u32::from_le_bytes(data);
        } else {
            pdi.write(address, &self.csr_data.to_le_bytes()[..len]);
        }
    }

    fn start_csr(&mut self, word: u32) {
        let (address, len) = (word as u16, (word >> 16 & 7) as u16);
        if self.csr.is_some() {
            return self.breach("a command while the last one is under way");
        }
        if ![1, 2, 4].contains(&len) || address % len != 0 || address >= 0x1000 {
            return self.breach(format!("a command for {len} bytes at 0x{address:04X}"));
        }
        self.csr = Some(Command { word, done: self.after(self.csr_time) });
    }

    fn start_transfer(&mut self, read: bool, word: u32) {
        let transfer = if read { &mut self.reader } else { &mut self.writer };
        if word & 1 << 30 != 0 {
            (transfer.left, transfer.due) = (None, None);
            transfer.fifo.clear();
        } else if word & 1 << 31 != 0 {
            let (address, len) = (transfer.place as u16, (transfer.place >> 16) as u16);
            if transfer.left.is_some() || !transfer.fifo.is_empty() {
                return self.breach("an access while the last one is under way");
            }
            if address < 0x1000 || len == 0 {
                return self.breach(format!("an access of {len} bytes at 0x{address:04X}"));
            }
            transfer.left = Some((address, len));
            if read {
                self.reader.due = Some(self.after(self.word_time));
            }
        }
    }

    /// Moves a word from RAM to the FIFO.
    fn fetch_word(&mut self) {
        let Some((address, left)) = self.reader.left else { return };
        let (lead, len) = Transfer::lanes(address, left);
        let mut word = [0xEE; 4];
        self.esc.pdi(self.now).read(address, &mut word[lead..lead + len]);
        self.reader.fifo.push_back(word);
        let rest = left - len as u16;
        self.reader.left = (rest > 0).then_some((address.wrapping_add(len as u16), rest));
        self.go_on_reading();
    }

    fn go_on_reading(&mut self) {
        if self.reader.left.is_some() && self.reader.due.is_none() && self.reader.fifo.len() < 16 {
            self.reader.due = Some(self.after(self.word_time));
        }
    }

    /// Moves a word from the FIFO to RAM.
    fn store_word(&mut self) {
        let (Some((address, left)), Some(word)) = (self.writer.left, self.writer.fifo.pop_front())
        else {
            return;
        };
        let (lead, len) = Transfer::lanes(address, left);
        self.esc.pdi(self.now).write(address, &word[lead..lead + len]);
        let rest = left - len as u16;
        self.writer.left = (rest > 0).then_some((address.wrapping_add(len as u16), rest));
        if rest > 0 && !self.writer.fifo.is_empty() {
            self.writer.due = Some(self.after(self.word_time));
        }
    }

    fn read(&mut self, register: u16) -> [u8; 4] {
        let word = match register {
            0x000..0x020 => {
                let word = self.reader.fifo.pop_front();
                if word.is_none() {
                    self.breach("a word read from an empty FIFO");
                }
                self.go_on_reading();
                return word.unwrap_or([0xDD; 4]);
            }
            0x050 => self.id_rev,
            0x064 => self.byte_test,
            0x074 => u32::from(self.now >= self.ready_at) << 27,
            0x1F8 => u32::from(self.reset && self.now < self.ready_at),
            0x300 => {
                if self.csr.is_some() {
                    self.breach("data read while the command is under way");
                }
                self.csr_data
            }
            0x304 => self.csr.map_or(0, |command| command.word),
            0x30C => self.reader.state(self.reader.fifo.len()),
            0x314 => self.writer.state(16 - self.writer.fifo.len()),
            _ => {
                self.breach(format!("register 0x{register:03X} read"));
                0
            }
        };
        word.to_le_bytes()
    }

    fn write(&mut self, register: u16, bytes: [u8; 4]) {
        let word = u32::from_le_bytes(bytes);
        match register {
            0x020..0x040 => {
                if self.writer.fifo.len() >= 16 {
                    return self.breach("a word written to a full FIFO");
                }
                self.writer.fifo.push_back(bytes);
                if self.writer.left.is_some() && self.writer.due.is_none() {
                    self.writer.due = Some(self.after(self.word_time));
                }
            }
            0x054 => self.irq_cfg = word,
            0x05C => self.int_en = word,
            0x1F8 => {
                (self.irq_cfg, self.int_en) = (0, 0);
                self.reset = word & 1 != 0;
                self.esc.power_on(self.now, Time::new(0));
                self.ready_at = self.now + Nanos::millis(10);
                (self.csr, self.reader, self.writer) =
                    (None, Transfer::default(), Transfer::default());
            }
            0x300 => {
                if self.csr.is_some() {
                    self.breach("data written while the command is under way");
                }
                self.csr_data = word;
            }
            0x304 => self.start_csr(word),
            0x308 => self.reader.place = word,
            0x30C => self.start_transfer(true, word),
            0x310 => self.writer.place = word,
            0x314 => self.start_transfer(false, word),
            _ => self.breach(format!("register 0x{register:03X} written")),
        }
    }

    /// Processes one selection of the chip: three bytes of command and address, then words.
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), ErrorKind> {
        self.transactions += 1;
        let fails = self.failing.contains(&self.transactions);
        let mut header = Vec::new();
        let mut word = Vec::new();
        for operation in operations {
            match operation {
                Operation::Write(bytes) => {
                    for &byte in *bytes {
                        self.byte();
                        if header.len() < 3 {
                            header.push(byte);
                            continue;
                        }
                        word.push(byte);
                        if word.len() == 4 {
                            // The transaction fails in the middle.
                            if fails {
                                return Err(ErrorKind::Other);
                            }
                            self.command(&header, 0x02);
                            self.write(register(&header), [word[0], word[1], word[2], word[3]]);
                            word.clear();
                        }
                    }
                }
                Operation::Read(bytes) => {
                    self.command(&header, 0x03);
                    if bytes.len() % 4 != 0 {
                        self.breach("a part of a word read");
                    }
                    for place in bytes.chunks_mut(4) {
                        let found = self.read(register(&header));
                        (0..4).for_each(|_| self.byte());
                        let found = self.floating.map_or(found, |byte| [byte; 4]);
                        place.copy_from_slice(&found[..place.len()]);
                        if fails {
                            return Err(ErrorKind::Other);
                        }
                    }
                }
                Operation::DelayNs(ns) => self.advance(self.now + Nanos::from_u32(*ns)),
                _ => self.breach("an operation other than read and write"),
            }
        }
        if !word.is_empty() {
            self.breach("a part of a word written");
        }
        Ok(())
    }

    fn command(&mut self, header: &[u8], expected: u8) {
        if header.len() != 3 || header[0] != expected || header[1] & 0xC0 != 0 {
            self.breach(format!("command {header:02X?}, expected 0x{expected:02X}"));
        }
    }

    /// Advances time by a byte on the bus.
    fn byte(&mut self) {
        self.bytes += 1;
        self.advance(self.now + BYTE_TIME);
    }
}

fn register(header: &[u8]) -> u16 {
    u16::from_be_bytes([header[1] & 0x3F, header[2]])
}

/// 8 bits at 30 MHz.
const BYTE_TIME: Nanos = Nanos(267);

/// The bus to the chip, and a delay on the chip's clock.
#[derive(Clone)]
pub struct Board(pub Rc<RefCell<Chip>>);

impl Board {
    pub fn new() -> Self {
        Self(Rc::new(RefCell::new(Chip::new())))
    }
}

impl ErrorType for Board {
    type Error = ErrorKind;
}

impl SpiDevice for Board {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), ErrorKind> {
        self.0.borrow_mut().transaction(operations)
    }
}

impl DelayNs for Board {
    fn delay_ns(&mut self, ns: u32) {
        let mut chip = self.0.borrow_mut();
        let end = chip.now + Nanos::from_u32(ns);
        chip.advance(end);
    }
}
