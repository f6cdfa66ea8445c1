//! The interface to the page: C functions with two buffers, because the page needs no more.
//!
//! The page requests memory ([`input`]), writes its text there, calls [`work`], and reads the
//! returned number of bytes from [`output`] on. Texts are UTF-8.

use std::sync::{Mutex, MutexGuard, PoisonError};

static INPUT: Mutex<Vec<u8>> = Mutex::new(Vec::new());
static OUTPUT: Mutex<String> = Mutex::new(String::new());

/// Locks a buffer. There is one thread, and a panic ends the instance, so a poisoned lock does not
/// matter.
fn lock<T>(buffer: &Mutex<T>) -> MutexGuard<'_, T> {
    buffer.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Allocates memory for a text of `length` bytes; returns its address.
#[unsafe(no_mangle)]
pub extern "C" fn input(length: usize) -> *mut u8 {
    let mut input = lock(&INPUT);
    input.clear();
    input.resize(length, 0);
    input.as_mut_ptr()
}

/// Answers the text that was written to [`input`]; returns the number of bytes of the answer.
#[unsafe(no_mangle)]
pub extern "C" fn work() -> usize {
    let text = String::from_utf8_lossy(&lock(&INPUT)).into_owned();
    let answer = crate::answer(&text);
    let mut output = lock(&OUTPUT);
    *output = answer;
    output.len()
}

/// The address of the answer, which is valid until the next one.
#[unsafe(no_mangle)]
pub extern "C" fn output() -> *const u8 {
    lock(&OUTPUT).as_ptr()
}
