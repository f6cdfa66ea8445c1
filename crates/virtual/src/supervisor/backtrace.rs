//! The position of a thread: its present instruction and, as far as frame pointers lead, its
//! callers.

use std::fs;
use std::path::Path;

use object::{Object, ObjectSection, ObjectSymbol, SymbolKind};

use crate::sys;

/// Largest number of callers in a backtrace.
const MOST_CALLERS: usize = 16;
/// Programs and libraries larger than this are not searched for symbols, bytes.
const LARGEST: u64 = 1 << 29;

/// A part of a process's memory that maps instructions of a file.
struct Mapping {
    from: u64,
    to: u64,
    /// Offset of the part in the file.
    offset: u64,
    path: String,
}

/// The positions of a running thread, innermost first: `function+0x12 (file)`, or the address
/// without a symbol. Empty if the machine does not allow the thread to be inspected.
pub(super) fn places(process: i32, thread: i32) -> Vec<String> {
    let Ok(registers) = sys::registers(thread) else { return Vec::new() };
    let mappings = mappings(process);
    let mut addresses = vec![registers.instruction];
    let mut frame = registers.frame;
    while addresses.len() <= MOST_CALLERS {
        let mut words = [0; 16];
        if !frame.is_multiple_of(8) || sys::read_memory(process, frame, &mut words).is_err() {
            break;
        }
        let word =
            |at: usize| words[at..].first_chunk().map_or(0, |word| u64::from_ne_bytes(*word));
        let (next, back) = (word(0), word(8));
        // A register in other use does not lead to a caller, or leads back.
        if next <= frame || find(&mappings, back).is_none() {
            break;
        }
        addresses.push(back);
        frame = next;
    }
    addresses.iter().map(|address| tell(&mappings, *address)).collect()
}

fn mappings(process: i32) -> Vec<Mapping> {
    let maps = fs::read_to_string(format!("/proc/{process}/maps")).unwrap_or_default();
    let parse = |line: &str| {
        let mut fields = line.split_ascii_whitespace();
        let (from, to) = fields.next()?.split_once('-')?;
        let hex = |text: &str| u64::from_str_radix(text, 16).ok();
        let executable = fields.next()?.contains('x');
        let offset = hex(fields.next()?)?;
        let path = fields.nth(2)?.to_owned();
        executable.then_some(Mapping { from: hex(from)?, to: hex(to)?, offset, path })
    };
    maps.lines().filter_map(parse).collect()
}

fn find(mappings: &[Mapping], address: u64) -> Option<&Mapping> {
    mappings.iter().find(|mapping| (mapping.from..mapping.to).contains(&address))
}

fn tell(mappings: &[Mapping], address: u64) -> String {
    let Some(mapping) = find(mappings, address) else { return format!("{address:#x}") };
    let name = Path::new(&mapping.path)
        .file_name()
        .map_or_else(|| mapping.path.clone(), |name| name.to_string_lossy().into_owned());
    let place = address - mapping.from + mapping.offset;
    match function(&mapping.path, place) {
        Some((function, distance)) => format!("{function}+{distance:#x} ({name})"),
        None => format!("{name}+{place:#x}"),
    }
}

/// The function of a file that contains this byte, and the offset in the function.
fn function(path: &str, place: u64) -> Option<(String, u64)> {
    if fs::metadata(path).ok()?.len() > LARGEST {
        return None;
    }
    let bytes = fs::read(path).ok()?;
    let file = object::File::parse(&*bytes).ok()?;
    let section = file.sections().find_map(|section| {
        let (start, size) = section.file_range()?;
        (start..start + size).contains(&place).then(|| section.address() + place - start)
    });
    let address = section?;
    let all = file.symbols().chain(file.dynamic_symbols());
    let before =
        all.filter(|symbol| symbol.kind() == SymbolKind::Text && symbol.address() <= address);
    let nearest = before.max_by_key(|symbol| symbol.address())?;
    let distance = address - nearest.address();
    let is_in_it = nearest.size() == 0 || distance < nearest.size();
    is_in_it.then(|| (nearest.name().unwrap_or("?").to_owned(), distance))
}
