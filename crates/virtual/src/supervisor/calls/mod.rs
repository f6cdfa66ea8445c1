//! The system calls, one file for each kind. A call is tried when it comes, and again whenever its
//! condition may have become true.

mod descriptors;
mod futex;
mod interface;
mod machine;
mod netlink;
mod packet;
mod process;
mod signals;
mod time;
mod wait;

use isocat_wire::time::{Host as Clock, Time};

use super::{Answer, Errno, Outcome, Supervisor, filter};
use crate::kernel::{ObjectId, Source, TaskId};
use crate::sys;
pub(super) use signals::sends_signal;

/// The answer of a call that is complete.
fn done(value: i64) -> Answer {
    Ok(Outcome::Done(value))
}

fn error(number: i32) -> Answer {
    Err(Errno(number))
}

impl Supervisor<'_> {
    /// Tries a call for the first time, or again.
    pub(super) fn call(&mut self, task: TaskId, first: bool) -> Answer {
        let call = self.thread(task).call;
        if call.architecture != filter::X86_64 {
            self.note("calls of another architecture were refused");
            return error(libc::ENOSYS);
        }
        if std::mem::take(&mut self.thread(task).interrupted) && !first {
            return self.interrupted(task);
        }
        let a = call.arguments;
        match call.number {
            libc::SYS_clock_gettime
            | libc::SYS_gettimeofday
            | libc::SYS_time
            | libc::SYS_clock_getres
            | libc::SYS_nanosleep
            | libc::SYS_clock_nanosleep
            | libc::SYS_sched_yield
            | libc::SYS_times
            | libc::SYS_getrusage
            | libc::SYS_clock_settime
            | libc::SYS_settimeofday
            | libc::SYS_adjtimex
            | libc::SYS_clock_adjtime => self.time_call(task, call.number, a, first),
            libc::SYS_futex => self.futex(task, a, first),
            libc::SYS_poll
            | libc::SYS_ppoll
            | libc::SYS_select
            | libc::SYS_pselect6
            | libc::SYS_epoll_wait
            | libc::SYS_epoll_pwait
            | libc::SYS_epoll_pwait2
            | libc::SYS_epoll_create
            | libc::SYS_epoll_create1
            | libc::SYS_epoll_ctl => self.wait_call(task, call.number, a, first),
            libc::SYS_socket
            | libc::SYS_bind
            | libc::SYS_connect
            | libc::SYS_getsockopt
            | libc::SYS_setsockopt
            | libc::SYS_getsockname
            | libc::SYS_getpeername
            | libc::SYS_sendto
            | libc::SYS_recvfrom
            | libc::SYS_sendmsg
            | libc::SYS_recvmsg
            | libc::SYS_sendmmsg
            | libc::SYS_recvmmsg
            | libc::SYS_shutdown
            | libc::SYS_listen
            | libc::SYS_accept
            | libc::SYS_accept4
            | libc::SYS_socketpair
            | libc::SYS_ioctl => self.socket_call(task, call.number, a, first),
            libc::SYS_read
            | libc::SYS_write
            | libc::SYS_readv
            | libc::SYS_writev
            | libc::SYS_close
            | libc::SYS_close_range
            | libc::SYS_dup
            | libc::SYS_dup2
            | libc::SYS_dup3
            | libc::SYS_fcntl
            | libc::SYS_pipe
            | libc::SYS_pipe2
            | libc::SYS_eventfd
            | libc::SYS_eventfd2
            | libc::SYS_timerfd_create
            | libc::SYS_timerfd_settime
            | libc::SYS_timerfd_gettime
            | libc::SYS_open
            | libc::SYS_openat
            | libc::SYS_openat2
            | libc::SYS_creat
            | libc::SYS_sendfile
            | libc::SYS_splice
            | libc::SYS_tee
            | libc::SYS_vmsplice
            | libc::SYS_copy_file_range => self.descriptor_call(task, call.number, a, first),
            libc::SYS_clone
            | libc::SYS_clone3
            | libc::SYS_fork
            | libc::SYS_vfork
            | libc::SYS_execve
            | libc::SYS_execveat
            | libc::SYS_exit
            | libc::SYS_exit_group
            | libc::SYS_wait4
            | libc::SYS_waitid
            | libc::SYS_prctl
            | libc::SYS_arch_prctl
            | libc::SYS_set_tid_address
            | libc::SYS_set_robust_list
            | libc::SYS_gettid
            | libc::SYS_brk
            | libc::SYS_rseq
            | libc::SYS_seccomp
            | libc::SYS_ptrace
            | libc::SYS_unshare
            | libc::SYS_setns => self.process_call(task, call.number, a, first),
            libc::SYS_kill
            | libc::SYS_tkill
            | libc::SYS_tgkill
            | libc::SYS_rt_sigqueueinfo
            | libc::SYS_rt_tgsigqueueinfo
            | libc::SYS_rt_sigsuspend
            | libc::SYS_pause
            | libc::SYS_rt_sigtimedwait
            | libc::SYS_alarm
            | libc::SYS_setitimer
            | libc::SYS_getitimer
            | libc::SYS_timer_create
            | libc::SYS_timer_settime
            | libc::SYS_timer_gettime
            | libc::SYS_timer_getoverrun
            | libc::SYS_timer_delete => self.signal_call(task, call.number, a, first),
            _ => self.machine_call(task, call.number, a),
        }
    }

    /// Refuses a call that is not supported. It is reported by name, and once more at the end.
    fn refuse(&mut self, what: &str, errno: i32) -> Answer {
        self.note(format!("{what}: refused, as it is not served here"));
        error(errno)
    }

    /// Makes the thread wait; `until` is stored with it for the next try.
    fn wait(&mut self, task: TaskId, until: Time<Clock>, sources: Vec<Source>) -> Answer {
        self.thread(task).until = until;
        Ok(Outcome::Wait(until, sources))
    }

    /// Makes the thread wait on objects and on what they watch.
    fn wait_for(&mut self, task: TaskId, until: Time<Clock>, objects: &[ObjectId]) -> Answer {
        let watched = objects.iter().flat_map(|id| self.objects.watched(*id));
        let sources = watched.map(Source::Object).collect();
        self.wait(task, until, sources)
    }

    fn number_of(&mut self, task: TaskId) -> i32 {
        self.process(task).number
    }

    fn read(&mut self, task: TaskId, at: u64, into: &mut [u8]) -> Result<(), Errno> {
        Ok(sys::read_memory(self.number_of(task), at, into)?)
    }

    fn write(&mut self, task: TaskId, at: u64, from: &[u8]) -> Result<(), Errno> {
        Ok(sys::write_memory(self.number_of(task), at, from)?)
    }

    fn read_bytes(&mut self, task: TaskId, at: u64, len: usize) -> Result<Vec<u8>, Errno> {
        let mut bytes = vec![0; len];
        self.read(task, at, &mut bytes)?;
        Ok(bytes)
    }

    fn read_u32(&mut self, task: TaskId, at: u64) -> Result<u32, Errno> {
        let mut bytes = [0; 4];
        self.read(task, at, &mut bytes)?;
        Ok(u32::from_ne_bytes(bytes))
    }

    fn write_u32(&mut self, task: TaskId, at: u64, value: u32) -> Result<(), Errno> {
        self.write(task, at, &value.to_ne_bytes())
    }

    /// Reads words of 64 bits.
    fn read_words<const N: usize>(&mut self, task: TaskId, at: u64) -> Result<[u64; N], Errno> {
        let bytes = self.read_bytes(task, at, 8 * N)?;
        let mut words = [0; N];
        for (word, bytes) in words.iter_mut().zip(bytes.chunks_exact(8)) {
            *word = bytes.first_chunk().map_or(0, |bytes| u64::from_ne_bytes(*bytes));
        }
        Ok(words)
    }

    fn write_words(&mut self, task: TaskId, at: u64, words: &[u64]) -> Result<(), Errno> {
        let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_ne_bytes()).collect();
        self.write(task, at, &bytes)
    }

    /// Reads a text that ends with a zero; only the first 4 KB of a longer one.
    fn read_text(&mut self, task: TaskId, at: u64) -> Result<String, Errno> {
        let mut text = Vec::new();
        while text.len() < 4096 {
            // Only up to the end of a page at a time, since the next page may not exist.
            let from = at + text.len() as u64;
            let part = self.read_bytes(task, from, 256 - (from % 256) as usize)?;
            let end = part.iter().position(|byte| *byte == 0);
            text.extend_from_slice(&part[..end.unwrap_or(part.len())]);
            if end.is_some() {
                break;
            }
        }
        Ok(String::from_utf8_lossy(&text).into_owned())
    }
}
