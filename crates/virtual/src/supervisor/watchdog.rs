//! Interrupts the supervisor, which waits for calls, when an event is not a call.

use std::fs;
use std::io;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crate::sys::Interrupter;

/// A thread that interrupts the supervisor when a process has ended without a call, or when the
/// program makes no call for too long.
#[derive(Debug)]
pub(super) struct Watchdog {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Debug, Default)]
struct Shared {
    /// Increments with every call.
    calls: AtomicU64,
    stuck: AtomicBool,
    ends: AtomicBool,
    /// The processes that are watched.
    processes: Mutex<Vec<i32>>,
}

/// A program that makes no call for this long, although it could run, spins. The time is the CPU
/// time of the program, so a busy machine does not cause a false alarm.
const PATIENCE: Duration = Duration::from_secs(2);
/// Interval of the checks.
const LOOK: Duration = Duration::from_millis(50);

impl Watchdog {
    /// Watches for the calling thread.
    pub(super) fn new(first: i32) -> io::Result<Self> {
        let shared = Arc::new(Shared::default());
        let (mine, whom) = (Arc::clone(&shared), Interrupter::of_this_thread());
        let builder = std::thread::Builder::new().name("watchdog".into());
        let thread = builder.spawn(move || watch(&mine, whom, first))?;
        Ok(Self { shared, thread: Some(thread) })
    }

    /// Notes that a call came.
    pub(super) fn alive(&self) {
        self.shared.calls.fetch_add(1, Ordering::Relaxed);
    }

    /// Whether no call has come for too long.
    pub(super) fn is_stuck(&self) -> bool {
        self.shared.stuck.load(Ordering::SeqCst)
    }

    /// Watches a process from now on.
    pub(super) fn watch(&self, process: i32) -> io::Result<()> {
        self.processes().push(process);
        Ok(())
    }

    /// Stops watching a process whose end is known.
    pub(super) fn forget(&self, process: i32) {
        self.processes().retain(|other| *other != process);
    }

    fn processes(&self) -> std::sync::MutexGuard<'_, Vec<i32>> {
        self.shared.processes.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Watchdog {
    fn drop(&mut self) {
        self.shared.ends.store(true, Ordering::SeqCst);
        if let Some(thread) = self.thread.take() {
            thread.thread().unpark();
            // The thread holds nothing that could fail.
            let _ = thread.join();
        }
    }
}

fn watch(shared: &Shared, whom: Interrupter, first: i32) {
    let mut calls = 0;
    let mut since = (Instant::now(), cpu_time(first));
    while !shared.ends.load(Ordering::SeqCst) {
        std::thread::park_timeout(LOOK);
        let now = shared.calls.load(Ordering::Relaxed);
        let processes = shared.processes.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let ran = processes.iter().map(|process| cpu_time(*process)).sum();
        if now != std::mem::replace(&mut calls, now) {
            since = (Instant::now(), ran);
        }
        if processes.iter().any(|process| has_ended(*process)) {
            whom.interrupt();
        }
        let (at, ran_then) = since;
        if at.elapsed() >= PATIENCE && ran.saturating_sub(ran_then) >= PATIENCE {
            shared.stuck.store(true, Ordering::SeqCst);
            whom.interrupt();
        } else if at.elapsed() >= LOOK * 2 {
            // A call that should have made a thread may have failed, or the program is to be
            // stopped.
            whom.interrupt();
        }
    }
}

/// The fields of a process's `stat` behind its name.
fn stat(process: i32) -> Option<String> {
    let stat = fs::read_to_string(format!("/proc/{process}/stat")).ok()?;
    stat.rsplit_once(") ").map(|(_, rest)| rest.to_owned())
}

fn has_ended(process: i32) -> bool {
    stat(process).is_none_or(|rest| rest.starts_with('Z') || rest.starts_with('X'))
}

/// CPU time of a process, of user and system, in the kernel's ticks of 10 ms.
fn cpu_time(process: i32) -> Duration {
    let rest = stat(process).unwrap_or_default();
    let ticks = rest.split(' ').skip(11).take(2).filter_map(|ticks| ticks.parse::<u64>().ok());
    Duration::from_millis(10 * ticks.sum::<u64>())
}
