//! The register image, and the shadow in which writes of ECAT wait until the frame has proved good.

use core::ops::Range;

use isocat_wire::Register;
use isocat_wire::register::{PROCESS_RAM, SHADOW_END, Value};

use crate::access::{ECAT_WRITABLE, Gate, Units};
use crate::chip::Chip;
use crate::room::Room;

/// Registers and user RAM in force, 0x0000-0x0FFF.
///
/// Only lines of 16 bytes in which an ESC has registers take memory. The other lines read 0 and
/// ignore writes, as registers that do not exist do. Lines of FMMUs, SyncManagers and chip-specific
/// registers stand apart, since their number depends on the chip.
pub(crate) struct Registers {
    common: [u8; 16 * COMMON],
    counted: Room<u8, { 16 * COUNTED }>,
}

impl Registers {
    /// All registers of `chip` are zero.
    pub fn new(chip: &Chip) -> Self {
        Self { common: [0; 16 * COMMON], counted: Room::new(16 * counted_lines(chip), 0) }
    }
    /// Puts a value into force.
    pub fn store<T: Value>(&mut self, register: Register<T>, value: T) {
        if let Some(bytes) = self.run_mut(register.address, T::LEN) {
            bytes.copy_from_slice(value.to_bytes().as_ref());
        }
    }
    /// Puts one byte into force.
    pub fn set_byte(&mut self, address: u16, value: u8) {
        if let Some([byte]) = self.run_mut(address, 1) {
            *byte = value;
        }
    }
    /// Zeroes a range.
    pub fn clear(&mut self, range: Range<u16>) {
        self.bytes_mut(range).fill(0);
    }
    /// A range for writing; empty if it does not lie within one run of lines.
    pub fn bytes_mut(&mut self, range: Range<u16>) -> &mut [u8] {
        self.run_mut(range.start, range.len()).unwrap_or_default()
    }
    /// The value in force.
    #[inline(always)]
    pub fn load<T: Value>(&self, register: Register<T>) -> T {
        let mut bytes = T::Bytes::default();
        if let Some(present) = self.run(register.address, T::LEN) {
            bytes.as_mut().copy_from_slice(present);
        }
        T::from_bytes(bytes)
    }
    /// One byte in force.
    #[inline(always)]
    pub fn byte(&self, address: u16) -> u8 {
        self.run(address, 1).map_or(0, |bytes| bytes[0])
    }
    /// A range for reading; empty if it does not lie within one run of lines.
    pub fn bytes(&self, range: Range<u16>) -> &[u8] {
        self.run(range.start, range.len()).unwrap_or_default()
    }

    #[inline(always)]
    fn run(&self, address: u16, len: usize) -> Option<&[u8]> {
        let from = place(address);
        match from.checked_sub(16 * COMMON) {
            None => self.common.get(from..from + len),
            Some(from) => self.counted.get(from..from + len),
        }
    }

    #[inline(always)]
    fn run_mut(&mut self, address: u16, len: usize) -> Option<&mut [u8]> {
        let from = place(address);
        match from.checked_sub(16 * COMMON) {
            None => self.common.get_mut(from..from + len),
            Some(from) => self.counted.get_mut(from..from + len),
        }
    }
}

/// The lines that have registers in every chip: ranges of addresses divided by 16.
const COMMON_LINES: [Range<usize>; 11] = [
    0x00..0x05,
    0x10..0x16,
    0x20..0x23,
    0x30..0x32,
    0x40..0x45,
    0x50..0x52,
    0x90..0x94,
    0x98..0x9D,
    0x9F..0xA0,
    0xF0..0xF2,
    0xF8..0x100,
];

/// The other lines, in the order in which chips have them: those of chips with 4 SyncManagers, 4
/// FMMUs and 16 chip-specific bytes, those of chips with 8 and 8, with 16 and 16, and the rest.
/// [`READABLE`](crate::access::READABLE) and its likes have a run for each of them.
const COUNTED_LINES: [Range<usize>; 8] = [
    0x80..0x82,
    0x60..0x64,
    0xE0..0xE1,
    0x82..0x84,
    0x64..0x68,
    0x84..0x88,
    0x68..0x70,
    0xE1..0xF0,
];

const COMMON: usize = lines(&COMMON_LINES);
const COUNTED: usize = lines(&COUNTED_LINES);

const fn lines(ranges: &[Range<usize>]) -> usize {
    let (mut sum, mut at) = (0, 0);
    while at < ranges.len() {
        sum += ranges[at].end - ranges[at].start;
        at += 1;
    }
    sum
}

/// The number of the counted lines that `chip` has.
fn counted_lines(chip: &Chip) -> usize {
    let most = match (chip.sm_count.max(chip.fmmu_count), chip.chip_specific.len()) {
        (_, 17..) => 8,
        (9.., _) => 7,
        (5.., _) => 5,
        _ => 3,
    };
    lines(&COUNTED_LINES[..most])
}

/// The place in memory of each line of the address space; that of absent lines is behind all.
const PLACES: [u16; PROCESS_RAM as usize / 16] = {
    let mut places = [u16::MAX; PROCESS_RAM as usize / 16];
    let mut place = 0;
    let mut at = 0;
    while at < COMMON_LINES.len() + COUNTED_LINES.len() {
        let range = match at.checked_sub(COMMON_LINES.len()) {
            None => &COMMON_LINES[at],
            Some(at) => &COUNTED_LINES[at],
        };
        let mut line = range.start;
        while line < range.end {
            places[line] = 16 * place;
            place += 1;
            line += 1;
        }
        at += 1;
    }
    places
};

#[inline(always)]
const fn place(address: u16) -> usize {
    PLACES[(address >> 4) as usize % PLACES.len()] as usize + (address & 15) as usize
}

/// Copies bytes to as many others. Up to 32 need no call of a function, and process data is seldom
/// longer.
#[inline]
pub(crate) fn copy(from: &[u8], to: &mut [u8]) {
    debug_assert_eq!(from.len(), to.len());
    // The ends of both overlap, unless the length is that of two.
    fn ends<const LEN: usize>(from: &[u8], to: &mut [u8]) -> Option<()> {
        let (first, last) = (*from.first_chunk::<LEN>()?, *from.last_chunk::<LEN>()?);
        *to.first_chunk_mut()? = first;
        *to.last_chunk_mut()? = last;
        Some(())
    }
    match from.len() {
        16..=32 => ends::<16>(from, to),
        8..16 => ends::<8>(from, to),
        4..8 => ends::<4>(from, to),
        2..4 => ends::<2>(from, to),
        _ => None,
    }
    .unwrap_or_else(|| to.copy_from_slice(from));
}

/// Bytes that the frame in flight has written to registers.
///
/// Only lines of 16 registers in which ECAT may write have a place, and only those that frames have
/// written take memory.
pub(crate) struct Shadow {
    /// The lines that the frame in flight has written, in the order of the first write to each.
    written: Room<Line, LINES>,
    /// Number of these lines.
    len: u8,
    /// The index of each line in `written`, if its bit of `lines` is set.
    indices: [u8; LINES],
    /// One bit for each line that holds a written byte.
    lines: u64,
    /// Bytes that ECAT may always write, whatever the state of the chip.
    open: [u16; LINES],
}

/// A line of 16 registers.
#[derive(Clone, Copy)]
struct Line {
    bytes: [u8; 16],
    /// One bit for each byte that was written.
    mask: u16,
}

impl Shadow {
    /// An empty shadow.
    pub fn new() -> Self {
        let written = Room::new(0, Line::EMPTY);
        Self { written, len: 0, indices: [0; LINES], lines: 0, open: [0; LINES] }
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
        let (slot, bit) = (usize::from(address & 15), 1 << (address & 15));
        let line = self.line_mut(line);
        if line.mask & bit == 0 {
            line.bytes[slot] = registers.byte(address);
        }
        line.bytes[slot] = line.bytes[slot] & !mask | value & mask;
        line.mask |= bit;
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
        let line = self.line_mut(line);
        let bytes = &mut line.bytes[at..];
        match *data {
            // A datagram of the length of the system time or of most registers is copied without a
            // loop.
            [a, b, c, d, e, f, g, h] => bytes[..8].copy_from_slice(&[a, b, c, d, e, f, g, h]),
            [a, b, c, d] => bytes[..4].copy_from_slice(&[a, b, c, d]),
            _ => bytes[..data.len()].copy_from_slice(data),
        }
        line.mask |= mask;
        true
    }

    /// The line for writing; empty if nothing was written to it.
    #[inline]
    fn line_mut(&mut self, line: usize) -> &mut Line {
        if self.lines & 1 << line == 0 {
            self.lines |= 1 << line;
            self.indices[line] = self.len;
            self.len += 1;
            self.written.grow(self.len.into(), Line::EMPTY);
            self.written[usize::from(self.indices[line])].mask = 0;
        }
        &mut self.written[usize::from(self.indices[line])]
    }

    /// The line, if anything was written to it.
    #[inline]
    fn line(&self, line: usize) -> Option<&Line> {
        (self.lines & 1 << line != 0).then(|| &self.written[usize::from(self.indices[line])])
    }

    /// Clears the shadow.
    pub const fn clear(&mut self) {
        (self.lines, self.len) = (0, 0);
    }

    /// Whether nothing was written.
    pub const fn is_empty(&self) -> bool {
        self.lines == 0
    }

    /// The byte that was written at this address, if any.
    pub fn byte(&self, address: u16) -> Option<u8> {
        let line = self.line(line_of(address)?)?;
        let at = address & 15;
        (line.mask & 1 << at != 0).then(|| line.bytes[usize::from(at)])
    }

    /// Whether any byte of the range was written.
    pub fn touches(&self, range: Range<u16>) -> bool {
        // Works by lines: a mask of the requested bytes is compared with the written ones.
        let mut at = range.start;
        while at < range.end && !self.is_empty() {
            let end = (at | 15).saturating_add(1).min(range.end);
            let mask = (((1u32 << (end - at)) - 1) << (at & 15)) as u16;
            let line = line_of(at).and_then(|line| self.line(line));
            if line.is_some_and(|line| line.mask & mask != 0) {
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
        .flat_map(move |number| {
            let first = FIRST[number];
            let line = &self.written[usize::from(self.indices[number])];
            let mut written = line.mask;
            core::iter::from_fn(move || {
                (written != 0).then(|| {
                    let at = written.trailing_zeros() as u16;
                    written &= written - 1;
                    at
                })
            })
            .map(move |at| (first + at, line.bytes[usize::from(at)]))
        })
    }
}

impl Line {
    const EMPTY: Self = Self { bytes: [0; 16], mask: 0 };
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
    use crate::access::READABLE;
    use crate::{ET1100, ET1200};
    use isocat_wire::register;
    use std::vec::Vec;

    #[test]
    fn lines_have_one_place_each() {
        for (line, first) in FIRST.iter().enumerate() {
            assert_eq!(line_of(*first), Some(line));
            assert_eq!(line_of(*first + 15), Some(line));
        }
    }

    /// A chip has the lines of what it counts; all others read zero and ignore writes.
    #[test]
    fn registers_without_a_place_read_zero() {
        let many = Chip { fmmu_count: 16, sm_count: 16, chip_specific: &[0; 256], ..ET1100 };
        for chip in [ET1200, ET1100, Chip { sm_count: 9, ..ET1200 }, many] {
            let mut registers = Registers::new(&chip);
            let of = |address: u16| address as u8 ^ (address >> 8) as u8 | 1;
            for address in 0..PROCESS_RAM {
                registers.set_byte(address, of(address));
            }
            let common = |line: &usize| COMMON_LINES.iter().any(|lines| lines.contains(line));
            for address in 0..PROCESS_RAM {
                let found = registers.byte(address);
                assert!(found == of(address) || found == 0, "{address:#06x}");
                let counted = match address {
                    0x0600..0x0700 => address < 0x0600 + 16 * u16::from(chip.fmmu_count),
                    0x0800..0x0880 => address < 0x0800 + 8 * u16::from(chip.sm_count),
                    0x0E00..0x0F00 => address < 0x0E00 + chip.chip_specific.len() as u16,
                    _ => false,
                };
                if common(&(usize::from(address) / 16)) || counted {
                    assert_eq!(found, of(address), "{address:#06x}");
                }
            }
        }
        let fresh = Registers::new(&ET1200);
        assert_eq!((fresh.byte(0x0A00), fresh.load(register::fmmu(15)).length), (0, 0));
    }

    /// Each run of the tables lies in one piece of memory, whatever the chip has.
    #[test]
    fn whatever_is_accessed_has_a_place() {
        let chip = Chip { fmmu_count: 16, sm_count: 16, chip_specific: &[0; 256], ..ET1100 };
        let registers = Registers::new(&chip);
        for (start, end) in READABLE.runs().chain(ECAT_WRITABLE.runs()) {
            assert_eq!(registers.bytes(start..end).len(), (end - start).into(), "{start:#06x}");
        }
        let user_ram = isocat_wire::register::SHADOW_END;
        for address in ECAT_WRITABLE.runs().flat_map(|(start, end)| start..end) {
            let shadowed = address >= user_ram || line_of(address).is_some();
            assert!(shadowed, "{address:#06x} is writable");
        }
    }

    #[test]
    fn later_writes_win_and_masked_writes_merge() {
        let mut registers = Registers::new(&ET1100);
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
        shadow.open(&Units::new(&ET1100, 0x0C));
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
