//! Looks after the supervisor from outside: it waits for calls, and some things are no calls.

use std::fs;
use std::io;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crate::sys::Interrupter;

/// A thread that interrupts the supervisor where a process has ended without a call, and where the
/// program makes no call for too long.
#[derive(Debug)]
pub(super) struct Watchdog {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Debug, Default)]
struct Shared {
    /// Goes up with every call.
    calls: AtomicU64,
    stuck: AtomicBool,
    ends: AtomicBool,
    /// The processes that are looked at.
    processes: Mutex<Vec<i32>>,
}

/// A program that makes no call for so long, although nothing keeps it from running, spins. It is
/// measured in what it ran itself, so that a busy machine does it no wrong.
const PATIENCE: Duration = Duration::from_secs(2);
/// How often processes are looked at.
const LOOK: Duration = Duration::from_millis(50);

impl Watchdog {
    /// Looks after the calling thread.
    pub(super) fn new(first: i32) -> io::Result<Self> {
        let shared = Arc::new(Shared::default());
        let (mine, whom) = (Arc::clone(&shared), Interrupter::of_this_thread());
        let builder = std::thread::Builder::new().name("watchdog".into());
        let thread = builder.spawn(move || watch(&mine, whom, first))?;
        Ok(Self { shared, thread: Some(thread) })
    }

    /// A call came.
    pub(super) fn alive(&self) {
        self.shared.calls.fetch_add(1, Ordering::Relaxed);
    }

    /// No call has come for too long.
    pub(super) fn is_stuck(&self) -> bool {
        self.shared.stuck.load(Ordering::SeqCst)
    }

    /// A process is looked at from now on.
    pub(super) fn watch(&self, process: i32) -> io::Result<()> {
        self.processes().push(process);
        Ok(())
    }

    /// A process has ended, and that is known.
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
            // It holds nothing that could fail.
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
            // A call that was to make a thread may have failed, or somebody wants an end.
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

/// How long a process has run on processors: user's and system's time, in the ticks of 10 ms that
/// the kernel tells.
fn cpu_time(process: i32) -> Duration {
    let rest = stat(process).unwrap_or_default();
    let ticks = rest.split(' ').skip(11).take(2).filter_map(|ticks| ticks.parse::<u64>().ok());
    Duration::from_millis(10 * ticks.sum::<u64>())
}
