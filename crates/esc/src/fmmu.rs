//! FMMUs: where the logical bits of a datagram lie in this ESC's memory.

use core::ops::Range;

use isocat_wire::fmmu::Fmmu;
use isocat_wire::register;

use crate::memory::Registers;

/// The FMMUs in force, with summaries that let datagrams without a hit pass quickly.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fmmus {
    count: usize,
    active: u16,
    /// First logical byte that any FMMU maps, and the one behind the last.
    hull: (u32, u64),
    /// The FMMU for reading and the one for writing, in the common case that each is the only one
    /// of its kind and maps whole bytes.
    single: [Option<Single>; 2],
    /// Whether some FMMU is active for reading, and for writing.
    any: [bool; 2],
}

/// An FMMU that maps whole bytes and is the only one for its kind of access.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Single {
    pub logical: u32,
    pub length: u16,
    pub physical: u16,
}

impl Fmmus {
    /// `count` FMMUs, none active.
    pub const fn new(count: u8) -> Self {
        Self {
            count: if count > 16 { 16 } else { count as usize },
            active: 0,
            hull: (0, 0),
            single: [None; 2],
            any: [false; 2],
        }
    }

    /// Applies the registers after ECAT wrote them.
    pub fn configure(&mut self, registers: &Registers) {
        (self.active, self.hull) = (0, (u32::MAX, 0));
        self.any = [false; 2];
        for number in 0..self.count {
            let fmmu = registers.load(register::fmmu(number));
            if fmmu.is_active() && fmmu.bits() > 0 {
                self.active |= 1 << number;
                self.any[0] |= fmmu.kind & Fmmu::READ != 0;
                self.any[1] |= fmmu.kind & Fmmu::WRITE != 0;
                self.hull.0 = self.hull.0.min(fmmu.logical_start);
                self.hull.1 = self.hull.1.max(logical_end(&fmmu));
            }
        }
        self.single = [self.only(registers, Fmmu::READ), self.only(registers, Fmmu::WRITE)];
    }

    /// The only FMMU of a kind, if it maps whole bytes and stays within both address spaces.
    fn only(&self, registers: &Registers, kind: u8) -> Option<Single> {
        let numbers = (0..self.count).filter(|number| self.active & 1 << number != 0);
        let mut all =
            numbers.map(|n| registers.load(register::fmmu(n))).filter(|fmmu| fmmu.kind & kind != 0);
        let (fmmu, other) = (all.next()?, all.next());
        let inside = logical_end(&fmmu) <= u64::from(u32::MAX)
            && u32::from(fmmu.physical_start) + u32::from(fmmu.length) <= 0x1_0000;
        (other.is_none() && fmmu.is_bytewise() && inside).then_some(Single {
            logical: fmmu.logical_start,
            length: fmmu.length,
            physical: fmmu.physical_start,
        })
    }

    /// Where the datagram's bytes lie if one FMMU alone decides that: the memory address, and which
    /// bytes. `Ok(None)`: none of them is mapped. `Err`: use [`Self::hits`].
    pub fn alone(
        &self,
        kind: u8,
        logical: u32,
        len: usize,
    ) -> Result<Option<(u16, Range<usize>)>, Complicated> {
        let Some(single) = self.single[usize::from(kind != Fmmu::READ)] else {
            return Err(Complicated);
        };
        let (start, first) = (u64::from(single.logical), u64::from(logical));
        let from = start.max(first);
        let end = (start + u64::from(single.length)).min(first + len as u64);
        if from >= end {
            return Ok(None);
        }
        let address = single.physical + (from - start) as u16;
        Ok(Some((address, (from - first) as usize..(end - first) as usize)))
    }

    /// The FMMU that alone decides all datagrams of a kind; `Ok(None)` if no FMMU maps anything for
    /// it. `Err`: use [`Self::hits`].
    pub fn single(&self, kind: u8) -> Result<Option<Single>, Complicated> {
        match self.single[usize::from(kind != Fmmu::READ)] {
            None if self.any[usize::from(kind != Fmmu::READ)] => Err(Complicated),
            single => Ok(single),
        }
    }

    /// First logical byte that any FMMU maps, and the one behind the last; equal if no byte is
    /// mapped.
    pub const fn hull(&self) -> (u32, u64) {
        if self.active == 0 { (0, 0) } else { self.hull }
    }

    /// The FMMUs that a datagram of `len` bytes at `logical` hits for this kind of access
    /// ([`Fmmu::READ`] or [`Fmmu::WRITE`]). `None` for most datagrams of a big segment.
    pub fn hits(&self, registers: &Registers, kind: u8, logical: u32, len: usize) -> Option<Hits> {
        let end = u64::from(logical) + len as u64;
        if self.active == 0 || u64::from(logical) >= self.hull.1 || end <= u64::from(self.hull.0) {
            return None;
        }
        let mut hits = Hits { fmmus: [Fmmu::default(); 16], len: 0 };
        for number in (0..self.count).filter(|number| self.active & 1 << number != 0) {
            let fmmu = registers.load(register::fmmu(number));
            if fmmu.kind & kind != 0
                && u64::from(fmmu.logical_start) < end
                && logical_end(&fmmu) > u64::from(logical)
            {
                hits.fmmus[hits.len] = fmmu;
                hits.len += 1;
            }
        }
        (hits.len > 0).then_some(hits)
    }
}

/// A byte may be mapped by more than one FMMU, or only some of its bits are mapped.
pub(crate) struct Complicated;

/// The FMMUs that a datagram hits, in the order of their numbers.
pub(crate) struct Hits {
    fmmus: [Fmmu; 16],
    len: usize,
}

/// Memory that a datagram's bits map to.
pub(crate) enum Target {
    /// Whole bytes of the datagram lie at `address` and following.
    Bytes { address: u16, data: Range<usize> },
    /// The bits `mask` of the byte at `address`. Bit 0 of that byte belongs to bit `data_bit` of
    /// the datagram, which may be negative.
    Bits { address: u16, mask: u8, data_bit: i64 },
}

impl Hits {
    /// Calls `each` with all targets of a datagram of `len` bytes at `logical`. Where FMMUs
    /// overlap, the one with the lower number maps the bit.
    pub fn targets(&self, logical: u32, len: usize, mut each: impl FnMut(Target)) {
        for at in 0..self.len {
            let (fmmu, lower) = (&self.fmmus[at], &self.fmmus[..at]);
            if fmmu.is_bytewise() && !lower.iter().any(|other| overlap(fmmu, other)) {
                bytes(fmmu, logical, len, &mut each);
            } else {
                bits(fmmu, lower, logical, len, &mut each);
            }
        }
    }
}

/// Targets of an FMMU that maps whole bytes.
fn bytes(fmmu: &Fmmu, logical: u32, len: usize, each: &mut impl FnMut(Target)) {
    let first = u64::from(fmmu.logical_start.max(logical));
    let end = logical_end(fmmu).min(u64::from(logical) + len as u64);
    let address = u64::from(fmmu.physical_start) + (first - u64::from(fmmu.logical_start));
    // Memory ends at 64 KiB.
    let run = (end - first).min(0x1_0000u64.saturating_sub(address));
    if let (Ok(address), true) = (u16::try_from(address), run > 0) {
        let from = (first - u64::from(logical)) as usize;
        each(Target::Bytes { address, data: from..from + run as usize });
    }
}

/// Targets of an FMMU that maps bits, grouped by bytes of memory so that each is accessed once.
fn bits(fmmu: &Fmmu, lower: &[Fmmu], logical: u32, len: usize, each: &mut impl FnMut(Target)) {
    // All positions are bits; logical ones count from the datagram's first bit.
    let run = (i64::from(fmmu.logical_start) - i64::from(logical)) * 8
        + i64::from(fmmu.logical_start_bit & 7);
    let physical = i64::from(fmmu.physical_start) * 8 + i64::from(fmmu.physical_start_bit & 7);
    let first = run.max(0);
    let end = (run + i64::from(fmmu.bits())).min(len as i64 * 8);
    let mut bit = first;
    while bit < end {
        let at = physical + (bit - run);
        let data_bit = bit - at % 8;
        let stop = (data_bit + 8).min(end);
        let mut mask = 0;
        for position in bit..stop {
            if !lower.iter().any(|other| maps(other, i64::from(logical) * 8 + position)) {
                mask |= 1 << (position - data_bit);
            }
        }
        if let (Ok(address), true) = (u16::try_from(at / 8), mask != 0) {
            each(Target::Bits { address, mask, data_bit });
        }
        bit = stop;
    }
}

/// Whether an FMMU maps a logical bit, counted from logical address 0.
fn maps(fmmu: &Fmmu, bit: i64) -> bool {
    let first = i64::from(fmmu.logical_start) * 8 + i64::from(fmmu.logical_start_bit & 7);
    (first..first + i64::from(fmmu.bits())).contains(&bit)
}

fn overlap(one: &Fmmu, other: &Fmmu) -> bool {
    u64::from(one.logical_start) < logical_end(other)
        && u64::from(other.logical_start) < logical_end(one)
}

/// The logical byte behind the last one that the FMMU maps.
fn logical_end(fmmu: &Fmmu) -> u64 {
    u64::from(fmmu.logical_start) + u64::from(fmmu.length)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    fn targets(fmmus: &[Fmmu], logical: u32, len: usize) -> Vec<(u16, u8, i64)> {
        let mut registers = Registers::new(&crate::chip::ET1100);
        for (number, fmmu) in fmmus.iter().enumerate() {
            registers.store(register::fmmu(number), *fmmu);
        }
        let mut all = Fmmus::new(8);
        all.configure(&registers);
        let mut found = Vec::new();
        let short = all.alone(Fmmu::READ, logical, len);
        if let Some(hits) = all.hits(&registers, Fmmu::READ, logical, len) {
            hits.targets(logical, len, |target| match target {
                Target::Bytes { address, data } => {
                    for (number, at) in data.enumerate() {
                        found.push((address + number as u16, 0xFF, at as i64 * 8));
                    }
                }
                Target::Bits { address, mask, data_bit } => found.push((address, mask, data_bit)),
            });
        }
        // Where `alone` gives an answer, it is the same as that of `hits`.
        if let Ok(alone) = short {
            let bytes = alone.into_iter().flat_map(|(address, data)| {
                data.enumerate().map(move |(n, at)| (address + n as u16, 0xFF, at as i64 * 8))
            });
            assert_eq!(bytes.collect::<Vec<_>>(), found);
        }
        found
    }

    /// The data sheet's example: logical 0x00010011 bit 3 to 0x00010013 bit 0, physical 0x0F01 bit
    /// 1.
    const EXAMPLE: Fmmu = Fmmu {
        logical_start: 0x0001_0011,
        length: 3,
        logical_start_bit: 3,
        logical_stop_bit: 0,
        physical_start: 0x0F01,
        physical_start_bit: 1,
        kind: Fmmu::READ,
        activate: 1,
        reserved: [0; 3],
    };

    #[test]
    fn a_stop_bit_below_the_start_bit() {
        // 14 bits: 7 in the first byte of memory (bits 1 to 7), 7 in the second (bits 0 to 6).
        assert_eq!(
            targets(&[EXAMPLE], 0x0001_0011, 3),
            [(0x0F01, 0b1111_1110, 2), (0x0F02, 0b0111_1111, 10)]
        );
        // A datagram that covers only the second logical byte gets the eight bits of that byte.
        assert_eq!(
            targets(&[EXAMPLE], 0x0001_0012, 1),
            [(0x0F01, 0b1100_0000, -6), (0x0F02, 0b0011_1111, 2)]
        );
        assert_eq!(targets(&[EXAMPLE], 0x0001_0014, 1), []);
        assert_eq!(targets(&[EXAMPLE], 0x0001_0010, 1), []);
    }

    #[test]
    fn bytes_by_part_and_by_whole() {
        let fmmu = Fmmu::bytes(0x100, 4, 0x1000, Fmmu::READ);
        assert_eq!(targets(&[fmmu], 0x102, 8), [(0x1002, 0xFF, 0), (0x1003, 0xFF, 8)]);
        assert_eq!(targets(&[fmmu], 0xFE, 3), [(0x1000, 0xFF, 16)]);
        assert_eq!(targets(&[fmmu], 0x104, 1), []);
        assert_eq!(targets(&[fmmu], 0x103, 1), [(0x1003, 0xFF, 0)]);
        assert_eq!(targets(&[fmmu], 0xFF, 1), []);
        assert_eq!(targets(&[Fmmu { activate: 0, ..fmmu }], 0x100, 1), []);
        assert_eq!(targets(&[Fmmu { kind: Fmmu::WRITE, ..fmmu }], 0x100, 1), []);
    }

    #[test]
    fn the_lower_number_has_the_bit() {
        let low = Fmmu { logical_stop_bit: 3, ..Fmmu::bytes(0x100, 1, 0x1000, Fmmu::READ) };
        let high = Fmmu::bytes(0x100, 1, 0x1100, Fmmu::READ);
        assert_eq!(targets(&[low, high], 0x100, 1), [(0x1000, 0x0F, 0), (0x1100, 0xF0, 0)]);
    }

    #[test]
    fn the_ends_of_both_address_spaces() {
        let fmmu = Fmmu::bytes(u32::MAX, 2, 0xFFFF, Fmmu::READ);
        assert_eq!(targets(&[fmmu], u32::MAX, 2), [(0xFFFF, 0xFF, 0)]);
        let bits = Fmmu { physical_start_bit: 4, ..fmmu };
        assert_eq!(targets(&[bits], u32::MAX, 2), [(0xFFFF, 0xF0, -4)]);
    }
}
