//! Processes and threads: their start, replacement and end, and waits for children.

use isocat_wire::time::Time;

use super::{Answer, Outcome, error};
use crate::kernel::{Source, TaskId};
use crate::supervisor::Supervisor;

impl Supervisor<'_> {
    pub(super) fn process_call(
        &mut self,
        task: TaskId,
        number: i64,
        a: [u64; 6],
        first: bool,
    ) -> Answer {
        match number {
            libc::SYS_wait4 => {
                let (wanted, no_hang) = (a[0] as i32, a[2] as i32 & libc::WNOHANG != 0);
                self.wait_for_child(task, wanted, no_hang, first)
            }
            libc::SYS_waitid => {
                let wanted = if a[0] == libc::P_PID as u64 { a[1] as i32 } else { -1 };
                self.wait_for_child(task, wanted, a[3] as i32 & libc::WNOHANG != 0, first)
            }
            // The C library then asks the kernel for the processor's number, and gets the virtual
            // one.
            libc::SYS_rseq => error(libc::ENOSYS),
            libc::SYS_seccomp => self.refuse("a seccomp filter of the program's own", libc::EPERM),
            libc::SYS_ptrace => self.refuse("ptrace", libc::EPERM),
            libc::SYS_unshare | libc::SYS_setns => {
                self.refuse("a namespace of the program's own", libc::EPERM)
            }
            _ => Ok(Outcome::Pass),
        }
    }

    /// The kernel answers once a child has ended; until then the wait is in virtual time.
    fn wait_for_child(&mut self, task: TaskId, wanted: i32, no_hang: bool, _first: bool) -> Answer {
        let parent = self.threads[task.0 as usize].process;
        let mine = |process: &&mut crate::supervisor::program::Process| {
            process.parent == Some(parent) && (wanted <= 0 || process.number == wanted)
        };
        let ended = self.processes.iter_mut().filter(mine).find(|process| process.unclaimed);
        if let Some(process) = ended {
            process.unclaimed = false;
            return Ok(Outcome::Pass);
        }
        let alive = self.processes.iter_mut().filter(mine).any(|process| !process.gone);
        match alive && !no_hang {
            true => self.wait(task, Time::NEVER, vec![Source::Child]),
            // The kernel answers at once that there is no child, or none that has ended.
            false => Ok(Outcome::Pass),
        }
    }

    /// What a thread waits for, in words.
    pub(in crate::supervisor) fn waits_for(&self, task: TaskId) -> String {
        let call = self.threads[task.0 as usize].call;
        let name = syscalls::Sysno::new(call.number as usize).map_or("a call", |call| call.name());
        let what: Vec<String> = self.scheduler.sources(task).iter().map(words).collect();
        match what.is_empty() {
            true => format!("in {name}, for nothing that could come"),
            false => format!("in {name}, for {}", what.join(", ")),
        }
    }
}

fn words(source: &Source) -> String {
    match source {
        Source::Object(id) => format!("object {}", id.0),
        Source::Futex(key) => format!("the futex at {:#x}", key.place),
        Source::Child => "a child".into(),
        Source::Signal => "a signal".into(),
    }
}
