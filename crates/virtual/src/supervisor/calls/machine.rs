//! The machine that a program sees: one processor, seeded random numbers, priorities. This file
//! also handles the calls that are not supported.

use super::{Answer, Outcome, done, error};
use crate::kernel::TaskId;
use crate::supervisor::Supervisor;

impl Supervisor<'_> {
    pub(super) fn machine_call(&mut self, task: TaskId, number: i64, a: [u64; 6]) -> Answer {
        match number {
            libc::SYS_getrandom => {
                let mut bytes = vec![0; (a[1] as usize).min(1 << 16)];
                self.host.random(&mut bytes);
                self.write(task, a[0], &bytes)?;
                done(bytes.len() as i64)
            }
            libc::SYS_sched_getaffinity => {
                // Only the first processor exists.
                let len = (a[1] as usize).min(8);
                if len < 8 {
                    return error(libc::EINVAL);
                }
                self.write_words(task, a[2], &[1])?;
                done(8)
            }
            libc::SYS_getcpu => {
                for at in [a[0], a[1]].into_iter().filter(|at| *at != 0) {
                    self.write_u32(task, at, 0)?;
                }
                done(0)
            }
            libc::SYS_sched_setscheduler => self.set_priority(task, a[0], a[2]),
            libc::SYS_sched_setparam => self.set_priority(task, a[0], a[1]),
            libc::SYS_sched_getparam => {
                self.write_u32(task, a[1], 0)?;
                done(0)
            }
            libc::SYS_sched_getscheduler => done(0),
            libc::SYS_sched_get_priority_max => done(99),
            libc::SYS_sched_get_priority_min => done(1),
            libc::SYS_sched_rr_get_interval => {
                self.write_words(task, a[1], &[0, 100_000_000])?;
                done(0)
            }
            // These calls are granted, since they would change nothing here.
            libc::SYS_sched_setaffinity
            | libc::SYS_sched_setattr
            | libc::SYS_mlockall
            | libc::SYS_mlock2
            | libc::SYS_munlockall
            | libc::SYS_setpriority
            | libc::SYS_ioprio_set => done(0),
            libc::SYS_sysinfo => {
                let mut about = [0u64; 14];
                (about[0], about[4], about[5]) =
                    (self.now().count() / 1_000_000_000, 1 << 32, 1 << 31);
                about[13] = 1;
                self.write_words(task, a[0], &about)?;
                done(0)
            }
            libc::SYS_io_uring_setup | libc::SYS_io_uring_enter | libc::SYS_io_uring_register => {
                self.refuse("io_uring", libc::ENOSYS)
            }
            libc::SYS_setuid
            | libc::SYS_setgid
            | libc::SYS_setreuid
            | libc::SYS_setregid
            | libc::SYS_setresuid
            | libc::SYS_setresgid
            | libc::SYS_setgroups
            | libc::SYS_personality
            | libc::SYS_sync
            | libc::SYS_sync_file_range
            | libc::SYS_fchownat
            | libc::SYS_utime
            | libc::SYS_utimes
            | libc::SYS_futimesat
            | libc::SYS_setxattr
            | libc::SYS_inotify_init1
            | libc::SYS_mknod
            | libc::SYS_readahead
            | libc::SYS_syncfs => Ok(Outcome::Pass),
            number => {
                let name = usize::try_from(number).ok().and_then(syscalls::Sysno::new);
                let name = name.map_or(format!("call {number}"), |name| name.name().to_owned());
                self.refuse(&name, libc::ENOSYS)
            }
        }
    }

    /// Sets the priority of the calling thread, or of another one, as for `SCHED_FIFO`.
    fn set_priority(&mut self, task: TaskId, thread: u64, at: u64) -> Answer {
        let priority = self.read_u32(task, at)?.min(99) as u8;
        let whom = match thread as i32 {
            0 => Some(task),
            number => self.task_of(number),
        };
        let Some(whom) = whom else { return error(libc::ESRCH) };
        self.scheduler.set_priority(whom, priority);
        done(0)
    }
}
