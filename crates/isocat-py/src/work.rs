//! Runs long work on another thread, while the calling thread waits without the interpreter's lock
//! and handles signals.

use std::any::Any;
use std::mem::forget;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::process;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex};
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
    hand_over(
        py,
        Box::new(move |free| {
            let done = catch_unwind(AssertUnwindSafe(|| work(&theirs)));
            free();
            // The receiver is gone if the caller was interrupted.
            let _ = sender.send(done);
        }),
    )?;
    match next(py, &stop, &mut receiver)? {
        Some(Ok(result)) => Ok(result),
        Some(Err(panic)) => Err(fault(py, &words(panic))),
        None => Err(fault(py, "its thread ended")),
    }
}

/// Work for a thread. It calls its argument when its thread is free for other work.
type Work = Box<dyn FnOnce(&dyn Fn()) + Send>;

/// A thread that waits for work.
struct Idle {
    /// Its process: a forked child has none of its parent's threads.
    process: u32,
    work: SyncSender<Work>,
}

/// Threads that wait. A new thread for each run would take 3 % of the time of short runs: its stack
/// is new, and so is its processor's cache.
static IDLE: Mutex<Vec<Idle>> = Mutex::new(Vec::new());
/// Largest number of threads that are kept.
const MOST_IDLE: usize = 16;

/// Gives work to a thread that waits, or to a new one.
fn hand_over(py: Python<'_>, work: Work) -> PyResult<()> {
    let Some(idle) = waiting() else {
        let (sender, receiver) = sync_channel::<Work>(1);
        let own = sender.clone();
        spawn(py, move || serve(&own, &receiver))?;
        // The thread has the other end.
        let _ = sender.send(work);
        return Ok(());
    };
    // A thread that waits has the other end.
    let _ = idle.work.send(work);
    Ok(())
}

/// Takes a thread that waits. The lock is not waited for: a child may have been forked while a
/// thread of its parent held it.
fn waiting() -> Option<Idle> {
    let mut idle = IDLE.try_lock().ok()?;
    while let Some(one) = idle.pop() {
        if one.process == process::id() {
            return Some(one);
        }
        // Its thread is the parent's, and so is what the channel's lock may wait for.
        forget(one);
    }
    None
}

/// A thread's life: works, and waits among [`IDLE`], as long as it is kept.
fn serve(own: &SyncSender<Work>, receiver: &Receiver<Work>) {
    let kept = AtomicBool::new(true);
    let free = || {
        let place = IDLE.try_lock().ok().filter(|idle| idle.len() < MOST_IDLE);
        kept.store(place.is_some(), Ordering::Relaxed);
        if let Some(mut idle) = place {
            idle.push(Idle { process: process::id(), work: own.clone() });
        }
    };
    while kept.load(Ordering::Relaxed) {
        match receiver.recv() {
            Ok(work) => work(&free),
            Err(_) => return,
        }
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
    fault(py, &why)
}

fn fault(py: Python<'_>, why: &str) -> PyErr {
    Failure::new(Class::Internal, format!("a fault in isocat itself, please report it: {why}"))
        .raise(py)
}

fn words(panic: Box<dyn Any + Send>) -> String {
    let text = panic.downcast_ref::<String>().cloned();
    text.or_else(|| panic.downcast_ref::<&str>().map(|text| (*text).to_owned())).unwrap_or_default()
}
