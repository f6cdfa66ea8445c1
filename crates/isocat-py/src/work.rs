//! Runs long work on its own thread, while the calling thread waits without the interpreter's lock
//! and handles signals.

use std::any::Any;
use std::panic::resume_unwind;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::thread::{Builder, JoinHandle};
use std::time::Duration;

use pyo3::prelude::*;

use crate::error::{Class, Failure};

/// A flag that asks work to end.
#[derive(Clone, Default)]
pub struct Stop(Arc<AtomicBool>);

impl Stop {
    pub fn is_set(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    pub fn set(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// The flag itself.
    pub fn flag(&self) -> &AtomicBool {
        &self.0
    }

    /// Ends the thread if the flag is set, without a message: its result is no longer wanted.
    pub fn leave_if_set(&self) {
        if self.is_set() {
            resume_unwind(Box::new("stopped"));
        }
    }
}

/// Time between two checks for signals.
const LOOK: Duration = Duration::from_millis(25);

/// Runs the work. On Ctrl-C, sets `stop` and raises the exception at once; the thread ends when it
/// sees the flag.
pub fn interruptible<T: Send + 'static>(
    py: Python<'_>,
    work: impl FnOnce(&Stop) -> T + Send + 'static,
) -> PyResult<T> {
    let (stop, (sender, mut receiver)) = (Stop::default(), sync_channel(1));
    let theirs = stop.clone();
    let thread = spawn(py, move || {
        // The receiver is gone if the caller was interrupted.
        let _ = sender.send(work(&theirs));
    })?;
    match next(py, &stop, &mut receiver)? {
        Some(result) => Ok(result),
        None => Err(broken(py, thread)),
    }
}

/// Receives the next item of a thread; `None`: the thread has ended. Handles signals while it
/// waits.
pub fn next<T: Send>(py: Python<'_>, stop: &Stop, from: &mut Receiver<T>) -> PyResult<Option<T>> {
    loop {
        // A receiver can't be shared with another thread, so the reference is moved.
        let waited = &mut *from;
        match py.detach(move || waited.recv_timeout(LOOK)) {
            Ok(item) => return Ok(Some(item)),
            Err(RecvTimeoutError::Disconnected) => return Ok(None),
            Err(RecvTimeoutError::Timeout) => py.check_signals().inspect_err(|_| stop.set())?,
        }
    }
}

pub fn spawn(py: Python<'_>, work: impl FnOnce() + Send + 'static) -> PyResult<JoinHandle<()>> {
    let name = "isocat".to_owned();
    Builder::new().name(name).stack_size(STACK).spawn(work).map_err(|error| {
        Failure::new(Class::Internal, format!("no thread can be started: {error}")).raise(py)
    })
}

/// Stack size of the thread, bytes: that of a main thread.
const STACK: usize = 8 << 20;

/// The exception for a thread that panicked.
pub fn broken(py: Python<'_>, thread: JoinHandle<()>) -> PyErr {
    let why = py.detach(|| thread.join()).err().map_or_else(String::new, words);
    Failure::new(Class::Internal, format!("a fault in isocat itself, please report it: {why}"))
        .raise(py)
}

fn words(panic: Box<dyn Any + Send>) -> String {
    let text = panic.downcast_ref::<String>().cloned();
    text.or_else(|| panic.downcast_ref::<&str>().map(|text| (*text).to_owned())).unwrap_or_default()
}
