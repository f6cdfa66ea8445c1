//! The clocks that programs read without a system call.
//!
//! The kernel maps a small library into each program, the vdso, whose functions read the real
//! clock. They are overwritten: each makes the system call of its name, which stops at the
//! supervisor. Reading the clock is the most frequent call, so `clock_gettime` is faster: a page
//! that program and supervisor share holds virtual time. As long as no other thread is due, the
//! program itself advances it by the cost of the call.
//!
//! Only the program can map that page into its memory. So at one of its first calls, the
//! instructions behind that call are replaced by a jump into code at the place of `clock_gettime`.
//! The code maps the page, closes the descriptor, and jumps back. The supervisor sees that the
//! descriptor is closed and restores the instructions.

use object::read::elf::{ElfFile64, FileHeader};
use object::{Endianness, Object, ObjectSymbol};

/// Address of the shared page in every program.
pub(super) const PAGE: u64 = 0x2000_0000_0000;
/// The number of its descriptor while it is being mapped.
pub(super) const PAGE_DESCRIPTOR: u32 = 1_000;
/// Real-time clocks count from 1970: virtual time zero is 2026-01-01 00:00 UTC, until a fault makes
/// them jump.
pub(super) const EPOCH: u64 = 1_767_225_600_000_000_000;

/// Indices of the words of the shared page.
pub(super) mod word {
    /// Virtual time, ns.
    pub const NOW: usize = 0;
    /// From this time on the system call is made.
    pub const LIMIT: usize = 1;
    /// Cost of a reading, ns.
    pub const COST: usize = 2;
    /// Number of readings without a stop so far.
    pub const READINGS: usize = 3;
    /// Difference between real-time clocks and virtual time, ns.
    pub const EPOCH: usize = 4;
}

/// Bytes to be written at an address.
#[derive(Debug)]
pub(super) struct Patch {
    pub address: u64,
    pub bytes: Vec<u8>,
}

/// The vdso of a program that is mapped at `base`.
#[derive(Debug)]
pub(super) struct Vdso {
    /// The functions that show the real machine: address and size in the image, and the call of
    /// each. `None` for functions that only return `ENOSYS`.
    functions: Vec<(u64, u64, Option<i64>)>,
    /// Address of `clock_gettime` in the image, and the space available there.
    clock: Option<(u64, usize)>,
    base: u64,
}

impl Vdso {
    /// Reads the image that is mapped at `base`.
    pub(super) fn parse(base: u64, image: &[u8]) -> Option<Self> {
        let file = ElfFile64::<Endianness>::parse(image).ok()?;
        let is_64_bit = file.elf_header().is_class_64();
        let mut functions = Vec::new();
        let mut clock = None;
        for symbol in file.dynamic_symbols().filter(|symbol| is_64_bit && symbol.is_definition()) {
            let number = match symbol.name().unwrap_or_default() {
                "__vdso_clock_gettime" => {
                    clock = Some((symbol.address(), symbol.size() as usize));
                    Some(libc::SYS_clock_gettime)
                }
                "__vdso_gettimeofday" => Some(libc::SYS_gettimeofday),
                "__vdso_time" => Some(libc::SYS_time),
                "__vdso_clock_getres" => Some(libc::SYS_clock_getres),
                "__vdso_getcpu" => Some(libc::SYS_getcpu),
                "__vdso_getrandom" => None,
                _ => continue,
            };
            functions.push((symbol.address(), symbol.size(), number));
        }
        clock.is_some().then_some(Self { functions, clock, base })
    }

    /// The patches that make every function a system call.
    pub(super) fn patches(&self) -> Vec<Patch> {
        let patch = |(address, _, number): &(u64, u64, Option<i64>)| Patch {
            address: self.base + address,
            bytes: number.map_or_else(refusal, call),
        };
        self.functions.iter().map(patch).collect()
    }

    /// The address of `clock_gettime` and its patched first bytes, which show whether the vdso was
    /// patched.
    pub(super) fn first(&self) -> (u64, Vec<u8>) {
        let (address, _) = self.clock.unwrap_or_default();
        (self.base + address, call(libc::SYS_clock_gettime))
    }

    /// The clock that counts in the shared page, and the address of the code that maps the page and
    /// then jumps to `back`. `None`: there is not enough space for it.
    pub(super) fn counting_clock(&self, back: u64) -> Option<(Patch, u64)> {
        let (address, room) = self.clock?;
        let (mut bytes, stub) = counting_clock_code();
        let place = bytes.len() - LAST_JUMP + 2;
        bytes[place..place + 8].copy_from_slice(&back.to_le_bytes());
        let address = self.base + address;
        let patch = Patch { address, bytes };
        (patch.bytes.len() <= room.max(self.room_behind())).then_some((patch, address + stub))
    }

    /// The space from `clock_gettime` to the next function in use, or to the end of the image's
    /// page.
    fn room_behind(&self) -> usize {
        let Some((clock, size)) = self.clock else { return 0 };
        let others = self.functions.iter().map(|(address, ..)| *address);
        let next = others.filter(|address| *address > clock).min();
        next.map_or(size, |next| (next - clock) as usize)
    }
}

/// A jump to an address, through a register that calls overwrite anyway.
pub(super) fn jump(to: u64) -> Vec<u8> {
    // mov r11, to; jmp r11
    let mut bytes = vec![0x49, 0xBB];
    bytes.extend(to.to_le_bytes());
    bytes.extend([0x41, 0xFF, 0xE3]);
    bytes
}

/// Whether these are the first bytes of the clock that counts in the shared page.
pub(super) fn is_counting(bytes: &[u8]) -> bool {
    bytes.starts_with(&[0x49, 0xB8])
}

/// A function that makes a system call.
fn call(number: i64) -> Vec<u8> {
    // mov eax, number; syscall; ret
    let mut bytes = vec![0xB8];
    bytes.extend((number as u32).to_le_bytes());
    bytes.extend([0x0F, 0x05, 0xC3]);
    bytes
}

/// A function that returns `ENOSYS`.
fn refusal() -> Vec<u8> {
    let mut bytes = vec![0xB8];
    bytes.extend((-libc::ENOSYS).to_le_bytes());
    bytes.push(0xC3);
    bytes
}

/// Length of the jump at the end of the code below.
const LAST_JUMP: usize = 13;

/// `clock_gettime` with the shared page, followed by the code that maps that page. Returns all
/// bytes, and the offset of the second part.
fn counting_clock_code() -> (Vec<u8>, u64) {
    let page = PAGE.to_le_bytes();
    let mut code = Vec::new();
    // The clock: rdi is the clock's number, rsi the address of the result.
    code.extend([0x49, 0xB8]); // movabs r8, page
    code.extend(page);
    code.extend([0x49, 0x8B, 0x00]); // mov rax, [r8]          now
    code.extend([0x49, 0x03, 0x40, 0x10]); // add rax, [r8+16]  cost
    code.extend([0x49, 0x3B, 0x40, 0x08]); // cmp rax, [r8+8]   limit
    let to_call = Jump::put(&mut code, 0x73); // jae call
    code.extend([0x83, 0xFF, 0x0B]); // cmp edi, 11: no clock beyond TAI
    let beyond = Jump::put(&mut code, 0x77); // ja call
    code.extend([0x83, 0xFF, 0x02]); // cmp edi, 2: CPU time of the process
    let process = Jump::put(&mut code, 0x74); // je call
    code.extend([0x83, 0xFF, 0x03]); // cmp edi, 3: CPU time of the thread
    let thread = Jump::put(&mut code, 0x74); // je call
    code.extend([0x83, 0xFF, 0x0A]); // cmp edi, 10: there is none
    let none = Jump::put(&mut code, 0x74); // je call
    code.extend([0x49, 0x89, 0x00]); // mov [r8], rax
    code.extend([0x49, 0xFF, 0x40, 0x18]); // inc qword [r8+24] readings
    code.extend([0x83, 0xFF, 0x00]); // cmp edi, 0: real time
    let real = Jump::put(&mut code, 0x74); // je since1970
    code.extend([0x83, 0xFF, 0x05]); // cmp edi, 5: the coarse one
    let coarse = Jump::put(&mut code, 0x74); // je since1970
    code.extend([0x83, 0xFF, 0x08]); // cmp edi, 8: the one with alarms
    let alarm = Jump::put(&mut code, 0x74); // je since1970
    code.extend([0x83, 0xFF, 0x0B]); // cmp edi, 11: TAI
    let other = Jump::put(&mut code, 0x75); // jne split
    [real, coarse, alarm].into_iter().for_each(|jump| jump.lands(&mut code));
    code.extend([0x49, 0x03, 0x40, 0x20]); // since1970: add rax, [r8+32]
    other.lands(&mut code);
    code.extend([0x31, 0xD2]); // split: xor edx, edx
    code.extend([0xB9, 0x00, 0xCA, 0x9A, 0x3B]); // mov ecx, 1_000_000_000
    code.extend([0x48, 0xF7, 0xF1]); // div rcx
    code.extend([0x48, 0x89, 0x06]); // mov [rsi], rax
    code.extend([0x48, 0x89, 0x56, 0x08]); // mov [rsi+8], rdx
    code.extend([0x31, 0xC0, 0xC3]); // xor eax, eax; ret
    [to_call, beyond, process, thread, none].into_iter().for_each(|jump| jump.lands(&mut code));
    code.extend(call(libc::SYS_clock_gettime));
    let stub = code.len() as u64;
    // The stub keeps all registers except r11 and rcx, which calls overwrite.
    code.extend([0x48, 0x8D, 0x64, 0x24, 0x80]); // lea rsp, [rsp-128]: below the red zone
    let saved =
        [[0x50].as_slice(), &[0x57], &[0x56], &[0x52], &[0x41, 0x52], &[0x41, 0x50], &[0x41, 0x51]];
    saved.into_iter().for_each(|push| code.extend(push));
    code.extend([0x48, 0xBF]); // movabs rdi, page
    code.extend(page);
    code.extend([0xBE, 0x00, 0x10, 0x00, 0x00]); // mov esi, 4096
    code.extend([0xBA, 0x03, 0x00, 0x00, 0x00]); // mov edx, read and write
    code.extend([0x41, 0xBA, 0x01, 0x00, 0x10, 0x00]); // mov r10d, shared, fixed, not over another
    code.extend([0x41, 0xB8]); // mov r8d, descriptor
    code.extend(PAGE_DESCRIPTOR.to_le_bytes());
    code.extend([0x45, 0x31, 0xC9]); // xor r9d, r9d
    code.extend([0xB8, 0x09, 0x00, 0x00, 0x00, 0x0F, 0x05]); // mmap
    code.extend([0x48, 0x89, 0xC6]); // mov rsi, rax: tells how it went
    code.push(0xBF); // mov edi, descriptor
    code.extend(PAGE_DESCRIPTOR.to_le_bytes());
    code.extend([0xB8, 0x03, 0x00, 0x00, 0x00, 0x0F, 0x05]); // close
    let restored =
        [[0x41, 0x59].as_slice(), &[0x41, 0x58], &[0x41, 0x5A], &[0x5A], &[0x5E], &[0x5F], &[0x58]];
    restored.into_iter().for_each(|pop| code.extend(pop));
    code.extend([0x48, 0x8D, 0xA4, 0x24, 0x80, 0x00, 0x00, 0x00]); // lea rsp, [rsp+128]
    code.extend(jump(0));
    (code, stub)
}

/// A short forward jump whose target is set later.
struct Jump(usize);

impl Jump {
    fn put(code: &mut Vec<u8>, instruction: u8) -> Self {
        code.extend([instruction, 0]);
        Self(code.len())
    }

    /// Sets the target to the present end of the code.
    fn lands(self, code: &mut [u8]) {
        let distance = code.len() - self.0;
        assert!(distance < 128, "a short jump reaches 127 bytes");
        code[self.0 - 1] = distance as u8;
    }
}
