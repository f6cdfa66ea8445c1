//! The real-time settings that a loop asks of the machine, for each thread.

use std::fs::{File, OpenOptions};
use std::io::Write;
use std::num::NonZeroU64;

use rustix::mm::{MlockAllFlags, mlockall};
use rustix::thread::{CpuSet, sched_setaffinity, set_current_timer_slack};

use super::sys;

/// The settings to ask for.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Wish {
    /// The CPU of the thread; `None`: any.
    pub cpu: Option<usize>,
    /// The thread never sleeps.
    pub busy: bool,
}

/// The settings that the calling thread got. Scheduling and CPU stay with the thread until it ends.
/// Processors may sleep deeply again when this is dropped.
#[derive(Debug)]
pub struct RealTime {
    /// What was granted, in words.
    pub granted: Vec<String>,
    /// What was refused, each with advice. None of it prevents a run.
    pub refused: Vec<String>,
    awake: Option<File>,
}

impl RealTime {
    /// Asks for everything for the calling thread.
    pub fn ask(wish: Wish) -> Self {
        let mut answer = Self { granted: Vec::new(), refused: Vec::new(), awake: None };
        if let Some(cpu) = wish.cpu {
            let mut set = CpuSet::new();
            // CPUs beyond the size of the set do not exist.
            if cpu < CpuSet::MAX_CPU {
                set.set(cpu);
            }
            answer.note(
                sched_setaffinity(None, &set).map_err(Into::into),
                format!("CPU {cpu}"),
                "staying on one CPU was refused",
                "expected a CPU that is online and open to this process (taskset -p shows which)",
            );
        }
        let priority = if wish.busy { BUSY_PRIORITY } else { PRIORITY };
        answer.note(
            sys::schedule_fifo(priority),
            format!("SCHED_FIFO {priority}"),
            "real-time scheduling (SCHED_FIFO) was refused, so other programs delay the loop",
            &grant("cap_sys_nice"),
        );
        answer.note(
            lock_memory(),
            "memory locked".to_owned(),
            "locking memory was refused, so a page that was swapped out delays the loop",
            &grant("cap_ipc_lock"),
        );
        answer.note(
            set_current_timer_slack(NonZeroU64::new(1)).map_err(Into::into),
            "timer slack 1 ns".to_owned(),
            "a timer slack of 1 ns was refused, so wake-ups are up to 50 us late",
            "nothing to grant: the kernel is unusual",
        );
        match keep_awake() {
            Ok(file) => {
                answer.awake = Some(file);
                answer.granted.push("processors kept out of deep sleep".to_owned());
            }
            Err(error) => answer.note(
                Err(error),
                String::new(),
                "keeping processors out of deep sleep (/dev/cpu_dma_latency) was refused",
                "grant it: sudo chmod o+w /dev/cpu_dma_latency, or run as root",
            ),
        }
        answer
    }

    /// Whether processors are kept out of deep sleep.
    pub fn keeps_awake(&self) -> bool {
        self.awake.is_some()
    }

    fn note(&mut self, result: std::io::Result<()>, granted: String, refused: &str, advice: &str) {
        match result {
            Ok(()) => self.granted.push(granted),
            Err(error) => self.refused.push(format!("{refused} ({error}); {advice}")),
        }
    }
}

/// Locks all memory that is mapped now and later.
///
/// Without the capability there is a limit, and an allocation beyond it would end the program in
/// the middle of a run. Nothing is locked then.
fn lock_memory() -> std::io::Result<()> {
    let limit = rustix::process::getrlimit(rustix::process::Resource::Memlock);
    if limit.current.is_some() && !has_capability(CAP_IPC_LOCK) {
        return Err(std::io::ErrorKind::PermissionDenied.into());
    }
    Ok(mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE)?)
}

/// Whether this process has a capability in its effective set.
fn has_capability(number: u32) -> bool {
    let status = std::fs::read_to_string("/proc/thread-self/status").unwrap_or_default();
    let set = status.lines().find_map(|line| line.strip_prefix("CapEff:"));
    set.and_then(|set| u64::from_str_radix(set.trim(), 16).ok())
        .is_some_and(|set| set & (1 << number) != 0)
}

/// Asks the kernel's power management for a latency of 0 us, which holds while the file is open.
fn keep_awake() -> std::io::Result<File> {
    let mut file = OpenOptions::new().write(true).open("/dev/cpu_dma_latency")?;
    file.write_all(&0_i32.to_ne_bytes())?;
    Ok(file)
}

fn grant(capability: &str) -> String {
    let program = std::env::current_exe().unwrap_or_else(|_| "isocat".into());
    format!("run as root, or grant {capability}: sudo setcap {EVERYTHING}+ep {}", program.display())
}

/// `setcap` replaces what was granted before, so this names everything that a run on an interface
/// needs.
const EVERYTHING: &str = "cap_net_raw,cap_sys_nice,cap_ipc_lock";
const CAP_IPC_LOCK: u32 = 14;
/// Above the interrupt threads of a PREEMPT_RT kernel (50), since the loop sleeps most of the time.
const PRIORITY: i32 = 80;
/// Below the interrupt threads: a loop that never sleeps must let the interface's interrupt thread
/// run.
const BUSY_PRIORITY: i32 = 40;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn everything_is_granted_or_refused_with_advice() {
        // A separate thread, so that its scheduling ends with it.
        let answer = std::thread::spawn(|| RealTime::ask(Wish { cpu: Some(0), busy: false }));
        let answer = answer.join().expect("asking never panics");
        assert_eq!(answer.granted.len() + answer.refused.len(), 5, "{answer:?}");
        assert!(answer.refused.iter().all(|note| note.contains("; ")), "{answer:?}");
    }

    #[test]
    fn a_cpu_that_is_not_there_is_a_note() {
        let wish = Wish { cpu: Some(100_000), busy: true };
        let answer = std::thread::spawn(move || RealTime::ask(wish)).join().expect("no panic");
        assert!(answer.refused.iter().any(|note| note.contains("CPU")), "{answer:?}");
    }
}
