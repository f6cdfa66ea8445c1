//! The CPU: how deep its call stack was, and what it does after a fault. The one file with unsafe code.
#![expect(
    unsafe_code,
    reason = "the call stack is looked at from outside; the handler must be unsafe"
)]

use core::ptr::{addr_of, read_volatile};

use cortex_m_rt::{ExceptionFrame, STACK_PAINT_VALUE};
use cortex_m_semihosting::debug::{self, EXIT_FAILURE};
use cortex_m_semihosting::hprintln;

unsafe extern "C" {
    /// Behind the highest byte of the call stack.
    static _stack_start: u32;
    /// The lowest byte that it may use.
    static _stack_end: u32;
}

/// Bytes of call stack that were ever used: it was painted before `main`.
pub fn stack_used() -> usize {
    let (mut at, top) = (addr_of!(_stack_end), addr_of!(_stack_start));
    // SAFETY: the linker script sets both ends around memory that belongs to the call stack alone, word by
    // word; it is read volatile since others write it.
    while at < top && unsafe { read_volatile(at) } == STACK_PAINT_VALUE {
        at = at.wrapping_add(1);
    }
    top as usize - at as usize
}

/// A call stack that is too small ends here, for instance.
#[cortex_m_rt::exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    hprintln!("FAILED hard fault at 0x{:08X}", frame.pc());
    debug::exit(EXIT_FAILURE);
    unreachable!("the emulator has ended");
}
