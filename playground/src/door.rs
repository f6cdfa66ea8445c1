//! The way in from the page: a C interface with two buffers, since nothing more is needed.
//!
//! The page asks for room ([`input`]), writes its text there, calls [`work`], and reads as many bytes as that says from
//! [`output`] on. Texts are UTF-8.

use std::sync::{Mutex, MutexGuard, PoisonError};

static INPUT: Mutex<Vec<u8>> = Mutex::new(Vec::new());
static OUTPUT: Mutex<String> = Mutex::new(String::new());

/// There is one thread, and a panic ends the instance.
fn lock<T>(buffer: &Mutex<T>) -> MutexGuard<'_, T> {
    buffer.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Makes room for a text of `length` bytes; says where.
#[unsafe(no_mangle)]
pub extern "C" fn input(length: usize) -> *mut u8 {
    let mut input = lock(&INPUT);
    input.clear();
    input.resize(length, 0);
    input.as_mut_ptr()
}

/// Answers the text that was written to [`input`]; says how many bytes the answer has.
#[unsafe(no_mangle)]
pub extern "C" fn work() -> usize {
    let text = String::from_utf8_lossy(&lock(&INPUT)).into_owned();
    let answer = crate::answer(&text);
    let mut output = lock(&OUTPUT);
    *output = answer;
    output.len()
}

/// Where the answer stands, until the next one.
#[unsafe(no_mangle)]
pub extern "C" fn output() -> *const u8 {
    lock(&OUTPUT).as_ptr()
}
