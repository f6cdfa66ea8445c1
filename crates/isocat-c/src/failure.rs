//! Errors: a code for programs, and a text for people.

use std::any::Any;
use std::ffi::{CString, c_char};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::ptr;
use std::sync::{Mutex, MutexGuard, TryLockError};

use isocat_descriptions::document::FileError;
use isocat_serve::bus::Refused;

use crate::sys;

/// The result of a call. A code below 0 means that nothing was done, except that an error was made.
#[repr(i32)]
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum isocat_code {
    /// The call succeeded.
    ISOCAT_OK = 0,
    /// No error, but there is no result: no answer has come back, or no outputs act.
    ISOCAT_NOTHING = 1,
    /// A pointer is NULL that must not be.
    ISOCAT_NULL_ARGUMENT = -1,
    /// A text is not UTF-8.
    ISOCAT_NOT_UTF8 = -2,
    /// A length, a position or a port does not exist.
    ISOCAT_OUT_OF_RANGE = -3,
    /// The caller's buffer is too small. Its content is unchanged.
    ISOCAT_TOO_SMALL = -4,
    /// An instant has passed, or is too far ahead.
    ISOCAT_TIME = -5,
    /// A file, a text or a fault is wrong, or a segment can't be planned.
    ISOCAT_BAD_INPUT = -6,
    /// The handle is in use: the call comes from a callback or from a second thread.
    ISOCAT_BUSY = -7,
    /// The size of a struct was not set.
    ISOCAT_STRUCT_SIZE = -8,
    /// A bug of this library. A bus or segment on which it happened can only be freed.
    ISOCAT_PANIC = -9,
}

/// An error, which is made by a call that failed and freed by isocat_error_free.
pub struct isocat_error {
    code: isocat_code,
    text: CString,
    file: CString,
    line: u32,
    column: u32,
}

/// An error, before it is converted for C.
#[derive(Debug)]
pub(crate) struct Failure {
    code: isocat_code,
    text: String,
    /// File, line and column.
    place: Option<(String, u32, u32)>,
}

impl Failure {
    pub fn new(code: isocat_code, text: impl Into<String>) -> Self {
        Self { code, text: text.into(), place: None }
    }

    pub fn null(what: &str) -> Self {
        Self::new(
            isocat_code::ISOCAT_NULL_ARGUMENT,
            format!("{what} is NULL; expected a pointer to something"),
        )
    }

    pub fn range(text: impl Into<String>) -> Self {
        Self::new(isocat_code::ISOCAT_OUT_OF_RANGE, text)
    }

    pub fn bad_input(text: impl Into<String>) -> Self {
        Self::new(isocat_code::ISOCAT_BAD_INPUT, text)
    }

    pub fn code(&self) -> isocat_code {
        self.code
    }

    pub fn at(self, file: &str, line: usize, column: usize) -> Self {
        let number = |number: usize| u32::try_from(number).unwrap_or(u32::MAX);
        Self { place: Some((file.to_owned(), number(line), number(column))), ..self }
    }

    fn into_error(self) -> isocat_error {
        let (file, line, column) = self.place.unwrap_or_default();
        let (text, file) = (sys::c_string(&self.text), sys::c_string(&file));
        isocat_error { code: self.code, text, file, line, column }
    }

    fn panic(payload: &(dyn Any + Send)) -> Self {
        let words = payload.downcast_ref::<&str>().copied();
        let words = words.or_else(|| payload.downcast_ref::<String>().map(String::as_str));
        let words = words.unwrap_or("no words");
        Self::new(
            isocat_code::ISOCAT_PANIC,
            format!("a fault of libisocat, please report it: {words}"),
        )
    }
}

impl From<FileError> for Failure {
    fn from(error: FileError) -> Self {
        Self::bad_input(error.to_string()).at(&error.path, error.line, error.column)
    }
}

impl From<Refused> for Failure {
    fn from(refused: Refused) -> Self {
        let code = match refused {
            Refused::Backwards { .. } | Refused::TooFar { .. } => isocat_code::ISOCAT_TIME,
            Refused::Length(_) | Refused::NoSuchPort => isocat_code::ISOCAT_OUT_OF_RANGE,
        };
        Self::new(code, refused.to_string())
    }
}

impl From<()> for isocat_code {
    fn from((): ()) -> Self {
        Self::ISOCAT_OK
    }
}

/// Does the work of a call: turns errors and panics into a code, and into an error if the caller
/// wants one.
pub(crate) fn guard<C: Into<isocat_code>>(
    error: *mut *mut isocat_error,
    work: impl FnOnce() -> Result<C, Failure>,
) -> isocat_code {
    // After a panic the handle's lock is poisoned, so the handle is not used again.
    match catch_unwind(AssertUnwindSafe(|| work().map(C::into))) {
        Ok(Ok(code)) => code,
        Ok(Err(failure)) => failed(error, failure),
        Err(payload) => failed(error, Failure::panic(&*payload)),
    }
}

fn failed(error: *mut *mut isocat_error, failure: Failure) -> isocat_code {
    let code = failure.code;
    sys::give_error(error, failure.into_error());
    code
}

/// Locks a handle for the duration of a call.
pub(crate) fn lock<'a, T>(what: &str, handle: &'a Mutex<T>) -> Result<MutexGuard<'a, T>, Failure> {
    handle.try_lock().map_err(|error| match error {
        TryLockError::WouldBlock => busy(what),
        TryLockError::Poisoned(_) => poisoned(what),
    })
}

fn busy(what: &str) -> Failure {
    Failure::new(
        isocat_code::ISOCAT_BUSY,
        format!(
            "{what} is in use; expected no call from a callback, and none from a second thread meanwhile"
        ),
    )
}

fn poisoned(what: &str) -> Failure {
    Failure::new(
        isocat_code::ISOCAT_PANIC,
        format!("{what} was left in the middle by a fault of libisocat; expected that it is freed"),
    )
}

/// A document as JSON.
pub(crate) fn json(document: &impl serde::Serialize) -> Result<String, Failure> {
    serde_json::to_string_pretty(document).map_err(|error| Failure::panic(&error.to_string()))
}

/// The code of an error; ISOCAT_OK for NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_error_code(error: *const isocat_error) -> isocat_code {
    sys::borrow("error", error).map_or(isocat_code::ISOCAT_OK, |error| error.code)
}

/// The description of an error: the place, what was found and what was expected. One line, or two
/// with a hint. Valid as long as the error; NULL for NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_error_text(error: *const isocat_error) -> *const c_char {
    sys::borrow("error", error).map_or(ptr::null(), |error| error.text.as_ptr())
}

/// The name of the wrong file; empty if no file is wrong. Valid as long as the error; NULL for
/// NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_error_file(error: *const isocat_error) -> *const c_char {
    sys::borrow("error", error).map_or(ptr::null(), |error| error.file.as_ptr())
}

/// The wrong line of that file, from 1; 0 if no line is wrong, and for NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_error_line(error: *const isocat_error) -> u32 {
    sys::borrow("error", error).map_or(0, |error| error.line)
}

/// The wrong column in characters, from 1; 0 if no line is wrong, and for NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_error_column(error: *const isocat_error) -> u32 {
    sys::borrow("error", error).map_or(0, |error| error.column)
}

/// Frees an error; NULL is ignored.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_error_free(error: *mut isocat_error) {
    sys::take(error);
}

/// Frees a text that the caller owns, which a function returned through a `char **`; NULL is
/// ignored.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_text_free(text: *mut c_char) {
    sys::take_text(text);
}
