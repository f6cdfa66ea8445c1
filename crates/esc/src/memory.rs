//! The register image, and the shadow in which writes of ECAT wait until the frame has proved good.

use core::ops::Range;

use isocat_wire::Register;
use isocat_wire::register::{PROCESS_RAM, SHADOW_END, Value};

use crate::access::{ECAT_WRITABLE, Gate, Units};

/// Registers and user RAM in force, 0x0000-0x0FFF.
///
/// Only blocks of 128 bytes in which an ESC has registers take memory. The other blocks read 0 and
/// ignore writes, as registers that do not exist do.
pub(crate) struct Registers([u8; BLOCK * (BLOCKS.len() + 1)]);

impl Registers {
    /// All registers are zero.
    pub const fn new() -> Self {
        Self([0; BLOCK * (BLOCKS.len() + 1)])
    }
    /// Puts a value into force.
    pub fn store<T: Value>(&mut self, register: Register<T>, value: T) {
        let from = place(register.address);
        self.0[from..from + T::LEN].copy_from_slice(value.to_bytes().as_ref());
        self.keep_nowhere(register.address);
    }
    /// Puts one byte into force.
    pub fn set_byte(&mut self, address: u16, value: u8) {
        self.0[place(address)] = value;
        self.keep_nowhere(address);
    }
    /// Zeroes a range.
    pub fn clear(&mut self, range: Range<u16>) {
        self.bytes_mut(range).fill(0);
    }
    /// A range for writing; it must lie within one run of blocks.
    pub fn bytes_mut(&mut self, range: Range<u16>) -> &mut [u8] {
        let (from, len) = (place(range.start), usize::from(range.end - range.start));
        &mut self.0[from..from + len]
    }
    /// The value in force.
    pub fn load<T: Value>(&self, register: Register<T>) -> T {
        let from = place(register.address);
        let mut bytes = T::Bytes::default();
        bytes.as_mut().copy_from_slice(&self.0[from..from + T::LEN]);
        T::from_bytes(bytes)
    }
    /// One byte in force.
    pub fn byte(&self, address: u16) -> u8 {
        self.0[place(address)]
    }
    /// A range for reading; it must lie within one run of blocks.
    pub fn bytes(&self, range: Range<u16>) -> &[u8] {
        let (from, len) = (place(range.start), usize::from(range.end - range.start));
        &self.0[from..from + len]
    }

    fn keep_nowhere(&mut self, address: u16) {
        if usize::from(PLACES[block(address)]) == BLOCKS.len() {
            self.0[BLOCK * BLOCKS.len()..].fill(0);
        }
    }
}

const BLOCK: usize = 128;

/// The first address of each block that has registers. Blocks that follow without a gap form one
/// run.
const BLOCKS: [u16; 15] = [
    0x0000, 0x0100, 0x0200, 0x0300, 0x0400, 0x0500, 0x0600, 0x0680, 0x0800, 0x0900, 0x0980, 0x0E00,
    0x0E80, 0x0F00, 0x0F80,
];

/// The index of each block of the address space in memory; the last index stands for absent blocks.
const PLACES: [u8; PROCESS_RAM as usize / BLOCK] = {
    let mut places = [BLOCKS.len() as u8; PROCESS_RAM as usize / BLOCK];
    let mut place = 0;
    while place < BLOCKS.len() {
        places[BLOCKS[place] as usize / BLOCK] = place as u8;
        place += 1;
    }
    places
};

const fn block(address: u16) -> usize {
    address as usize / BLOCK % PLACES.len()
}

const fn place(address: u16) -> usize {
    PLACES[block(address)] as usize * BLOCK + address as usize % BLOCK
}

/// Bytes that the frame in flight has written to registers.
///
/// Only lines of 16 registers in which ECAT may write take memory; one bit for each byte tells
/// which bytes were written.
pub(crate) struct Shadow {
    bytes: [u8; 16 * LINES],
    written: [u16; LINES],
    /// One bit for each line that holds a written byte.
    lines: u64,
    /// Bytes that ECAT may always write, whatever the state of the chip.
    open: [u16; LINES],
}

impl Shadow {
    /// An empty shadow.
    pub const fn new() -> Self {
        Self { bytes: [0; 16 * LINES], written: [0; LINES], lines: 0, open: [0; LINES] }
    }

    /// Marks the registers that ECAT may always write, whatever the state of the chip.
    pub fn open(&mut self, units: &Units) {
        self.open = [0; LINES];
        let mut at = 0;
        while at < SHADOW_END {
            let (end, gate) = units.run(&ECAT_WRITABLE, at);
            if gate == Some(Gate::Open) {
                for address in at..end.min(SHADOW_END) {
                    if let Some(line) = line_of(address) {
                        self.open[line] |= 1 << (address & 15);
                    }
                }
            }
            at = end;
        }
    }

    /// Writes the bits of `mask`. The other bits keep what was written before, or else the value in
    /// force.
    pub fn put(&mut self, registers: &Registers, address: u16, value: u8, mask: u8) {
        let Some(line) = line_of(address) else { return };
        let (slot, bit) = (16 * line + usize::from(address & 15), 1 << (address & 15));
        if self.written[line] & bit == 0 {
            self.bytes[slot] = registers.byte(address);
        }
        self.bytes[slot] = self.bytes[slot] & !mask | value & mask;
        self.written[line] |= bit;
        self.lines |= 1 << line;
    }

    /// Writes whole bytes if all of them lie in one line and are open; otherwise does nothing and
    /// returns `false`.
    pub fn put_in_line(&mut self, address: u16, data: &[u8]) -> bool {
        let at = usize::from(address & 15);
        if at + data.len() > 16 {
            return false;
        }
        let Some(line) = line_of(address) else { return false };
        let mask = (((1u32 << data.len()) - 1) << at) as u16;
        if mask & !self.open[line] != 0 {
            return false;
        }
        let bytes = &mut self.bytes[16 * line + at..];
        match *data {
            // A datagram of the length of the system time or of most registers is copied without a
            // loop.
            [a, b, c, d, e, f, g, h] => bytes[..8].copy_from_slice(&[a, b, c, d, e, f, g, h]),
            [a, b, c, d] => bytes[..4].copy_from_slice(&[a, b, c, d]),
            _ => bytes[..data.len()].copy_from_slice(data),
        }
        self.written[line] |= mask;
        self.lines |= 1 << line;
        true
    }

    /// Clears the shadow.
    pub fn clear(&mut self) {
        let mut lines = self.lines;
        while lines != 0 {
            self.written[lines.trailing_zeros() as usize] = 0;
            lines &= lines - 1;
        }
        self.lines = 0;
    }

    /// Whether nothing was written.
    pub const fn is_empty(&self) -> bool {
        self.lines == 0
    }

    /// The byte that was written at this address, if any.
    pub fn byte(&self, address: u16) -> Option<u8> {
        let line = line_of(address)?;
        let at = address & 15;
        (self.written[line] & 1 << at != 0).then(|| self.bytes[16 * line + usize::from(at)])
    }

    /// Whether any byte of the range was written.
    pub fn touches(&self, range: Range<u16>) -> bool {
        // Works by lines: a mask of the requested bytes is compared with the written ones.
        let mut at = range.start;
        while at < range.end && !self.is_empty() {
            let end = (at | 15).saturating_add(1).min(range.end);
            let mask = (((1u32 << (end - at)) - 1) << (at & 15)) as u16;
            if line_of(at).is_some_and(|line| self.written[line] & mask != 0) {
                return true;
            }
            at = end;
        }
        false
    }

    /// Whether anything was written in the page of 256 registers that holds `address`.
    pub const fn touches_page(&self, address: u16) -> bool {
        self.lines & PAGES[(address >> 8) as usize & 15] != 0
    }

    /// All bytes written, in the order of their addresses.
    pub fn written(&self) -> impl Iterator<Item = (u16, u8)> + '_ {
        let mut lines = self.lines;
        core::iter::from_fn(move || {
            (lines != 0).then(|| {
                let line = lines.trailing_zeros() as usize;
                lines &= lines - 1;
                line
            })
        })
        .flat_map(move |line| {
            let first = FIRST[line];
            let mut written = self.written[line];
            core::iter::from_fn(move || {
                (written != 0).then(|| {
                    let at = written.trailing_zeros() as u16;
                    written &= written - 1;
                    at
                })
            })
            .map(move |at| (first + at, self.bytes[16 * line + usize::from(at)]))
        })
    }
}

/// The index of the line of 16 registers that holds `address`.
const fn line_of(address: u16) -> Option<usize> {
    let line = (address >> 4) as usize;
    Some(match line {
        0x00..=0x04 => line,
        0x10..=0x13 => line - 0x10 + 0x05,
        0x20 => 0x09,
        0x30..=0x31 => line - 0x30 + 0x0A,
        0x40..=0x44 => line - 0x40 + 0x0C,
        0x50..=0x51 => line - 0x50 + 0x11,
        0x60..=0x6F => line - 0x60 + 0x13,
        0x80..=0x87 => line - 0x80 + 0x23,
        0x90..=0x9A => line - 0x90 + 0x2B,
        0xF0..=0xF1 => line - 0xF0 + 0x36,
        _ => return None,
    })
}

const LINES: usize = 0x38;

/// First address of each line.
const FIRST: [u16; LINES] = {
    let mut first = [0; LINES];
    let mut address = 0u16;
    while address < PROCESS_RAM {
        if let Some(line) = line_of(address) {
            first[line] = address;
        }
        address += 16;
    }
    first
};

/// The lines of each page of 256 registers.
const PAGES: [u64; 16] = {
    let mut pages = [0; 16];
    let mut line = 0;
    while line < LINES {
        pages[(FIRST[line] >> 8) as usize] |= 1 << line;
        line += 1;
    }
    pages
};

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    #[test]
    fn lines_have_one_place_each() {
        for (line, first) in FIRST.iter().enumerate() {
            assert_eq!(line_of(*first), Some(line));
            assert_eq!(line_of(*first + 15), Some(line));
        }
    }

    #[test]
    fn registers_without_a_place_read_zero() {
        let mut registers = Registers::new();
        for address in 0..PROCESS_RAM {
            registers.set_byte(address, address as u8 ^ (address >> 8) as u8 | 1);
        }
        for address in 0..PROCESS_RAM {
            let has_place = BLOCKS.contains(&(address & !127));
            let expected = address as u8 ^ (address >> 8) as u8 | 1;
            let expected = if has_place { expected } else { 0 };
            assert_eq!(registers.byte(address), expected, "{address:#06x}");
        }
        // Every register that ECAT may write has a block.
        assert!(FIRST.iter().all(|first| BLOCKS.contains(&(first & !127))));
        assert_eq!(registers.bytes(0x0600..0x0700).len(), 256);
    }

    #[test]
    fn whatever_is_accessed_has_a_place() {
        use crate::access::{ECAT_WRITABLE, READABLE};
        for address in READABLE.addresses() {
            assert!(BLOCKS.contains(&(address & !127)), "{address:#06x} is readable");
        }
        let user_ram = isocat_wire::register::SHADOW_END;
        for address in ECAT_WRITABLE.addresses().filter(|address| *address < user_ram) {
            assert!(line_of(address).is_some(), "{address:#06x} is writable");
        }
    }

    #[test]
    fn later_writes_win_and_masked_writes_merge() {
        let mut registers = Registers::new();
        registers.set_byte(0x0F00, 0b1000_0000);
        let mut shadow = Shadow::new();
        shadow.put(&registers, 0x0F00, 0xFF, 0b0000_0001);
        shadow.put(&registers, 0x0F00, 0xFF, 0b0000_0100);
        shadow.put(&registers, 0x0010, 1, 0xFF);
        shadow.put(&registers, 0x0010, 2, 0xFF);
        assert_eq!(shadow.written().collect::<Vec<_>>(), [(0x0010, 2), (0x0F00, 0b1000_0101)]);
        assert!(shadow.touches_page(0x0F00) && !shadow.touches_page(0x0800));
        shadow.clear();
        assert!(shadow.is_empty() && shadow.byte(0x0010).is_none());
        shadow.open(&Units::new(&crate::chip::ET1100, 0x0C));
        assert!(shadow.put_in_line(0x0910, &[1, 2, 3, 4]));
        assert_eq!(shadow.byte(0x0913).zip(shadow.byte(0x0910)), Some((4, 1)));
        assert!(shadow.touches(0x0913..0x0914) && !shadow.touches(0x0914..0x0918));
        assert!(!shadow.touches(0x0900..0x0910) && shadow.touches(0x0900..0x0911));
        assert!(shadow.put_in_line(0x0920, &[9; 12]));
        assert!(shadow.byte(0x091F).is_none() && shadow.byte(0x092B) == Some(9));
        // Bytes that cannot be written, bytes whose gate depends on the state, and bytes in two
        // lines.
        for (address, len) in [(0x0928, 5), (0x0120, 2), (0x0060, 2), (0x060C, 8), (0x0918, 2)] {
            assert!(!shadow.put_in_line(address, &[9; 8][..len]), "{address:#06x}");
            assert!(shadow.byte(address + len as u16 - 1).is_none(), "{address:#06x}");
        }
    }
}
