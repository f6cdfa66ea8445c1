//! The values that C passes and receives, which are trusted: pointers are NULL or as the header
//! demands. All unsafe code is here.
//!
//! Only exported functions call these, with their own arguments. NULL, lengths, and sizes of
//! structs are checked here; no library can check whether memory is really there.
#![allow(unsafe_code)]

use std::ffi::{CStr, CString, c_char};
use std::mem::{MaybeUninit, offset_of};

use crate::application::{Own, isocat_application};
use crate::bus::{isocat_arrival, isocat_sent};
use crate::device::isocat_device_state;
use crate::failure::{Failure, isocat_code, isocat_error};
use crate::plan::{isocat_plan_device, isocat_plan_line, isocat_plan_summary};
use crate::verdict::{isocat_device_verdict, isocat_verdict_summary};

/// A struct that begins with its own size, so that programs and libraries of different ages are
/// compatible.
///
/// # Safety
///
/// It is `repr(C)`, its first field is `size: usize`, and all zeros are a value of it.
pub(crate) unsafe trait Versioned: Copy {
    /// Its name in the header.
    const NAME: &'static str;
    /// Offset of its end in the first version of the library.
    const FIRST: usize;
}

/// Largest size of a struct in any version: a larger value was never set.
const LARGEST: usize = 4096;

macro_rules! versioned {
    ($($name:ident to $last:ident: $type:ty,)*) => {$(
        // SAFETY: numbers, pointers and optional functions, with `size` before them.
        unsafe impl Versioned for $name {
            const NAME: &'static str = stringify!($name);
            const FIRST: usize = offset_of!($name, $last) + size_of::<$type>();
        }
    )*};
}

// Each struct with its last field in the first version, and the type of that field.
versioned! {
    isocat_application to write_object: usize,
    isocat_sent to port: u32,
    isocat_arrival to port: u32,
    isocat_device_state to status_code: u32,
    isocat_plan_summary to has_acting_phase: i32,
    isocat_plan_line to position: i64,
    isocat_plan_device to uses_sync1: i32,
    isocat_verdict_summary to expected: i32,
    isocat_device_verdict to findings: usize,
}

// SAFETY: the library never reads what `user` points to. It is only passed back to the caller's
// functions, on the thread that uses the bus, one at a time: the handle of the bus is locked
// meanwhile.
unsafe impl Send for Own {}

/// The bytes at `pointer`, which may be NULL if `length` is 0.
pub(crate) fn bytes<'a>(
    what: &'static str,
    pointer: *const u8,
    length: usize,
    most: usize,
) -> Result<&'a [u8], Failure> {
    if length > most {
        let found = format!("{what}: length {length}; expected {most} at most");
        return Err(Failure::new(isocat_code::ISOCAT_OUT_OF_RANGE, found));
    }
    if length == 0 {
        return Ok(&[]);
    }
    if pointer.is_null() {
        return Err(Failure::null(what));
    }
    // SAFETY: the header demands `length` bytes there; no object of Rust is longer than `most`.
    Ok(unsafe { std::slice::from_raw_parts(pointer, length) })
}

/// A text that ends with a zero byte.
pub(crate) fn text<'a>(what: &'static str, pointer: *const c_char) -> Result<&'a str, Failure> {
    if pointer.is_null() {
        return Err(Failure::null(what));
    }
    // SAFETY: it ends with a zero byte, as the header demands.
    let bytes = unsafe { CStr::from_ptr(pointer) }.to_bytes();
    utf8(what, bytes)
}

/// Bytes as a text in UTF-8.
pub(crate) fn utf8<'a>(what: &str, bytes: &'a [u8]) -> Result<&'a str, Failure> {
    std::str::from_utf8(bytes).map_err(|error| {
        let at = error.valid_up_to();
        let found = bytes.get(at).copied().unwrap_or_default();
        let text = format!(
            "{what}: byte {at} is 0x{found:02X}, which is no UTF-8; expected a text in UTF-8"
        );
        Failure::new(isocat_code::ISOCAT_NOT_UTF8, text)
    })
}

/// Copies `from` into the caller's buffer, if that is large enough.
pub(crate) fn copy(
    what: &'static str,
    from: &[u8],
    to: *mut u8,
    capacity: usize,
) -> Result<(), Failure> {
    let needed = from.len();
    if needed > capacity {
        let found = format!("{what}: room for {capacity} bytes; expected {needed} at least");
        return Err(Failure::new(isocat_code::ISOCAT_TOO_SMALL, found));
    }
    if needed == 0 {
        return Ok(());
    }
    if to.is_null() {
        return Err(Failure::null(what));
    }
    // SAFETY: the buffer holds `capacity` bytes, and does not overlap memory of the library.
    unsafe { std::ptr::copy_nonoverlapping(from.as_ptr(), to, needed) };
    Ok(())
}

/// Writes a value to the caller's pointer.
pub(crate) fn put<T: Copy>(what: &'static str, to: *mut T, value: T) -> Result<(), Failure> {
    if to.is_null() {
        return Err(Failure::null(what));
    }
    // SAFETY: the header demands room for a value there.
    unsafe { to.write_unaligned(value) };
    Ok(())
}

/// Writes a struct up to the size that the caller knows; fields that only the caller knows become
/// 0.
pub(crate) fn fill<T: Versioned>(to: *mut T, value: T) -> Result<(), Failure> {
    let size = size_of_versioned(to)?;
    let known = size.min(size_of::<T>());
    let first = size_of::<usize>();
    let from = (&raw const value).cast::<MaybeUninit<u8>>();
    let to = to.cast::<MaybeUninit<u8>>();
    // SAFETY: the caller has `size` bytes, of which `size` itself remains; `value` has at least
    // `known`.
    unsafe {
        std::ptr::copy_nonoverlapping(from.add(first), to.add(first), known - first);
        to.add(known).write_bytes(0, size - known);
    }
    Ok(())
}

/// Reads a struct; fields that the caller does not know are 0.
pub(crate) fn read<T: Versioned>(from: *const T) -> Result<T, Failure> {
    let size = size_of_versioned(from)?;
    let mut value = MaybeUninit::<T>::zeroed();
    // SAFETY: the caller has `size` bytes, and all zeros are a valid value.
    unsafe {
        let to = value.as_mut_ptr().cast::<u8>();
        std::ptr::copy_nonoverlapping(from.cast::<u8>(), to, size.min(size_of::<T>()));
        Ok(value.assume_init())
    }
}

/// Refuses a struct whose size was not set, before anything happens.
pub(crate) fn check_size<T: Versioned>(pointer: *const T) -> Result<(), Failure> {
    size_of_versioned(pointer).map(drop)
}

fn size_of_versioned<T: Versioned>(pointer: *const T) -> Result<usize, Failure> {
    stated_size(pointer.cast(), T::NAME, T::FIRST, size_of::<T>())
}

/// The field `size` of a struct. One function for structs of all types.
fn stated_size(
    pointer: *const usize,
    name: &'static str,
    first: usize,
    expected: usize,
) -> Result<usize, Failure> {
    if pointer.is_null() {
        return Err(Failure::null(name));
    }
    // SAFETY: `size` is the first field.
    let size = unsafe { pointer.read_unaligned() };
    if !(first..=LARGEST).contains(&size) {
        let text = format!("{name}.size is {size}; expected sizeof({name}), {expected} here");
        return Err(Failure::new(isocat_code::ISOCAT_STRUCT_SIZE, text));
    }
    Ok(size)
}

/// Makes an object and passes it to the caller through `to`.
pub(crate) fn give<T>(
    what: &'static str,
    to: *mut *mut T,
    make: impl FnOnce() -> Result<T, Failure>,
) -> Result<(), Failure> {
    if to.is_null() {
        return Err(Failure::null(what));
    }
    let made = Box::new(make()?);
    put(what, to, Box::into_raw(made))
}

/// Passes an error to the caller, if the caller wants it.
pub(crate) fn give_error(to: *mut *mut isocat_error, error: isocat_error) {
    if !to.is_null() {
        // SAFETY: the header demands room for a pointer there.
        unsafe { to.write_unaligned(Box::into_raw(Box::new(error))) };
    }
}

/// Takes an object back from the caller, and drops it.
pub(crate) fn take<T>(pointer: *mut T) {
    if !pointer.is_null() {
        // SAFETY: `give` made it, and the caller returns it once.
        drop(unsafe { Box::from_raw(pointer) });
    }
}

/// Borrows an object that the caller owns.
pub(crate) fn borrow<'a, T>(what: &'static str, pointer: *const T) -> Result<&'a T, Failure> {
    // SAFETY: it is NULL, or `give` made it and it was not taken back.
    unsafe { pointer.as_ref() }.ok_or_else(|| Failure::null(what))
}

/// Passes a text to the caller, who owns it.
pub(crate) fn give_text(
    what: &'static str,
    to: *mut *mut c_char,
    text: &str,
) -> Result<(), Failure> {
    if to.is_null() {
        return Err(Failure::null(what));
    }
    put(what, to, c_string(text).into_raw())
}

/// Takes a text back from the caller, and drops it.
pub(crate) fn take_text(pointer: *mut c_char) {
    if !pointer.is_null() {
        // SAFETY: `give_text` made it, and the caller returns it once.
        drop(unsafe { CString::from_raw(pointer) });
    }
}

/// A text for C, without zero bytes inside.
pub(crate) fn c_string(text: &str) -> CString {
    let bytes: Vec<u8> = text.bytes().filter(|byte| *byte != 0).collect();
    CString::new(bytes).unwrap_or_default()
}
