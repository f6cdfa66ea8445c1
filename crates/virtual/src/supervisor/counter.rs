//! The processor's time stamp counter: reading it is an instruction and not a call, so it cannot be
//! answered from virtual time. Programs whose code reads it are reported.

use std::fs::File;

use memchr::memmem;
use object::read::elf::ElfFile64;
use object::{Object, ObjectSection, ReadCache, SectionKind};

/// `RDTSC`.
const READS: [u8; 2] = [0x0F, 0x31];
/// `shl rdx, 32`: compilers put it behind the read to join both halves of the count. The two bytes
/// of `RDTSC` alone occur in any code by chance.
const JOINS: [u8; 4] = [0x48, 0xC1, 0xE2, 0x20];
/// Largest number of bytes between the two instructions.
const BETWEEN: usize = 12;

/// Whether the code of the program that a process runs reads the counter, as far as its file shows.
/// Libraries are not searched: the C library's loader contains the instruction but does not need
/// it.
pub(super) fn is_read_by(process: i32) -> bool {
    let Ok(file) = File::open(format!("/proc/{process}/exe")) else { return false };
    let cache = ReadCache::new(file);
    let Ok(program) = ElfFile64::<object::Endianness, _>::parse(&cache) else { return false };
    let code = program.sections().filter(|section| section.kind() == SectionKind::Text);
    code.filter_map(|section| section.data().ok()).any(reads)
}

fn reads(code: &[u8]) -> bool {
    let joins = |at: usize| {
        let behind = &code[at + READS.len()..];
        memmem::find(&behind[..behind.len().min(BETWEEN + JOINS.len())], &JOINS).is_some()
    };
    memmem::find_iter(code, &READS).any(joins)
}

#[cfg(test)]
mod tests {
    use super::reads;

    #[test]
    fn the_instruction_is_known_by_what_follows_it() {
        let code = |between: usize| {
            let fill = vec![0x90; between];
            [&[0x55, 0x0F, 0x31][..], &fill, &[0x48, 0xC1, 0xE2, 0x20, 0xC3]].concat()
        };
        assert!(reads(&code(0)) && reads(&code(12)));
        assert!(!reads(&code(13)));
        assert!(!reads(&[0x0F, 0x31]) && !reads(&[0x48, 0xC1, 0xE2, 0x20]) && !reads(&[]));
    }
}
