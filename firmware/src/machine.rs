//! The CPU: measures the call stack of a piece of work, and handles a hard fault. With `footprint`,
//! which is another program, this is the only unsafe code.
#![expect(
    unsafe_code,
    reason = "the call stack is looked at from outside; the handler must be unsafe"
)]

use core::ptr::write_volatile;
use core::ptr::{addr_of, read_volatile, with_exposed_provenance, with_exposed_provenance_mut};

use cortex_m::register::msp;
use cortex_m_rt::ExceptionFrame;
use cortex_m_semihosting::debug::{self, EXIT_FAILURE};
use cortex_m_semihosting::hprintln;

unsafe extern "C" {
    /// The lowest byte that the call stack may use, from the linker script.
    static _stack_end: u32;
}

/// Does some work and returns the number of bytes of call stack that it took, in whole words. Fills
/// the free part with a pattern before, and searches the lowest changed word afterwards.
#[inline(never)]
pub fn call_stack_of(work: impl FnOnce()) -> usize {
    let top = msp::read() as usize;
    let bottom = addr_of!(_stack_end) as usize;
    let free = || (bottom..top - MARGIN).step_by(size_of::<u32>());
    for at in free() {
        // SAFETY: memory from the end of the call stack up to the stack pointer is unused, and no
        // interrupt is on.
        unsafe { write_volatile(with_exposed_provenance_mut(at), PAINT) };
    }
    apart(work);
    // SAFETY: the same words as above.
    let is_painted =
        |at: usize| unsafe { read_volatile::<u32>(with_exposed_provenance(at)) } == PAINT;
    free().find(|&at| !is_painted(at)).map_or(0, |at| top - at)
}

/// Keeps the work's memory out of this function's own frame.
#[inline(never)]
fn apart(work: impl FnOnce()) {
    work();
}

/// Ends the program after a hard fault, for example if the call stack is too small.
#[cortex_m_rt::exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    hprintln!("FAILED hard fault at 0x{:08X}", frame.pc());
    debug::exit(EXIT_FAILURE);
    unreachable!("the emulator has ended");
}

/// A pattern that is unlikely to be written by accident.
const PAINT: u32 = 0x5AFE_57AC;
/// Bytes below the stack pointer that the measuring function may need itself.
const MARGIN: usize = 64;
