//! The system calls of the supervisor without a safe wrapper in a library: all unsafe code of this
//! package is here.
#![expect(
    unsafe_code,
    reason = "seccomp notifications and a process's memory have no safe wrapper"
)]

use std::ffi::{CString, c_void};
use std::io;
use std::mem::{MaybeUninit, size_of};
use std::os::fd::{AsRawFd, BorrowedFd, FromRawFd, OwnedFd, RawFd};
use std::ptr;
use std::sync::atomic::{AtomicI32, Ordering};

const RECEIVE: u64 = 0xC050_2100;
const SEND: u64 = 0xC018_2101;
const ADD_DESCRIPTOR: u64 = 0x4018_2103;
const SET_FLAGS: u64 = 0x4008_2104;
const SYNC_WAKE_UP: u64 = 1;
const LISTENER: libc::c_ulong = 1 << 3;
const WAIT_KILLABLE: libc::c_ulong = 1 << 5;
const CONTINUE: u32 = 1;
/// The new descriptor gets the requested number.
const SET_NUMBER: u32 = 1;

/// A system call that stopped a thread.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Stopped {
    /// The number by which it is answered.
    pub id: u64,
    /// The thread's number.
    pub thread: i32,
    pub number: i64,
    /// The architecture that defines the numbers of calls.
    pub architecture: u32,
    /// The address behind the call instruction.
    pub behind: u64,
    pub arguments: [u64; 6],
}

/// How a stopped thread continues.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Reply {
    /// The call returns this: a value, or a negative error.
    Value(i64),
    /// The kernel executes the call.
    Continue,
}

/// The supervisor's end of a filter's notifications.
#[derive(Debug)]
pub(crate) struct Listener(OwnedFd);

/// The result of a launch.
#[derive(Debug)]
pub(crate) struct Launched {
    /// Its process number.
    pub process: i32,
    pub listener: Listener,
    shared: Shared,
}

/// A page that parent and child share.
#[derive(Debug)]
struct Shared(*mut State);

struct State {
    /// The listener's number, or a negative error; [`NOT_YET`] before that.
    listener: AtomicI32,
    /// The parent has taken the listener.
    taken: AtomicI32,
    /// The error that prevented the start; 0 if the program was started.
    failed: AtomicI32,
    /// Not 0 if the program's addresses could not be fixed.
    randomized: AtomicI32,
}

const NOT_YET: i32 = i32::MIN;

impl Shared {
    fn new() -> io::Result<Self> {
        // SAFETY: a new anonymous mapping, to which no other reference exists.
        let page = unsafe {
            let protection = libc::PROT_READ | libc::PROT_WRITE;
            let flags = libc::MAP_SHARED | libc::MAP_ANONYMOUS;
            libc::mmap(ptr::null_mut(), size_of::<State>(), protection, flags, -1, 0)
        };
        if page == libc::MAP_FAILED {
            return Err(io::Error::last_os_error());
        }
        let state = page.cast::<State>();
        // SAFETY: the page is there, large enough and aligned, and lives until `drop`.
        unsafe {
            state.write(State {
                listener: AtomicI32::new(NOT_YET),
                taken: AtomicI32::new(0),
                failed: AtomicI32::new(0),
                randomized: AtomicI32::new(0),
            });
        }
        Ok(Self(state))
    }

    fn state(&self) -> &State {
        // SAFETY: valid from `new` to `drop`; both processes use atomics alone.
        unsafe { &*self.0 }
    }
}

impl Drop for Shared {
    fn drop(&mut self) {
        // SAFETY: mapped by `new` with this size; no reference outlives `self`.
        unsafe { libc::munmap(self.0.cast(), size_of::<State>()) };
    }
}

impl Launched {
    /// Whether the machine does not allow the program's addresses to be fixed, so that they differ
    /// from run to run.
    pub(crate) fn is_randomized(&self) -> bool {
        self.shared.state().randomized.load(Ordering::SeqCst) != 0
    }

    /// The error that prevented the start of the program, if any.
    pub(crate) fn failed(&self) -> Option<io::Error> {
        let error = self.shared.state().failed.load(Ordering::SeqCst);
        (error != 0).then(|| io::Error::from_raw_os_error(error))
    }
}

/// Starts a program whose calls are filtered. It stops at once, at the call that replaces the
/// child.
///
/// The child shares its parent's table of descriptors until then: this hands over the listener
/// without a call that a container could refuse.
pub(crate) fn launch(
    program: &CString,
    arguments: &[CString],
    environment: &[CString],
    filter: &[libc::sock_filter],
) -> io::Result<Launched> {
    let shared = Shared::new()?;
    let pointers = |strings: &[CString]| -> Vec<*const libc::c_char> {
        strings.iter().map(|string| string.as_ptr()).chain([ptr::null()]).collect()
    };
    let (arguments, environment) = (pointers(arguments), pointers(environment));
    let filter = libc::sock_fprog { len: filter.len() as u16, filter: filter.as_ptr().cast_mut() };
    // SAFETY: the child shares no memory but the page; it calls nothing that takes a lock, then
    // execs or exits.
    let process = unsafe {
        let flags = i64::from(libc::CLONE_FILES | libc::SIGCHLD);
        let process = libc::syscall(libc::SYS_clone, flags, 0, 0, 0, 0) as i32;
        if process == 0 {
            child(shared.state(), program, &arguments, &environment, &filter);
        }
        process
    };
    if process < 0 {
        return Err(io::Error::last_os_error());
    }
    let number = loop {
        match shared.state().listener.load(Ordering::SeqCst) {
            NOT_YET if !is_zombie(process) => std::thread::yield_now(),
            number => break number,
        }
    };
    if number < 0 {
        reap(process);
        let error = if number == NOT_YET { libc::ECHILD } else { -number };
        return Err(io::Error::from_raw_os_error(error));
    }
    // SAFETY: the child made this descriptor in the table that both share; it becomes ours alone
    // when the child execs.
    let listener = Listener(unsafe { OwnedFd::from_raw_fd(number) });
    // Without this flag each stop takes far longer; an older kernel returns an error.
    listener.ioctl(SET_FLAGS, SYNC_WAKE_UP as *mut c_void).inspect_err(|_| {
        kill(process, libc::SIGKILL);
        reap(process);
    })?;
    shared.state().taken.store(1, Ordering::SeqCst);
    Ok(Launched { process, listener, shared })
}

/// The child's function until it becomes the program.
///
/// # Safety
///
/// Must run in a child that shares no memory with its parent. `arguments` and `environment` end
/// with a null pointer.
unsafe fn child(
    state: &State,
    program: &CString,
    arguments: &[*const libc::c_char],
    environment: &[*const libc::c_char],
    filter: &libc::sock_fprog,
) -> ! {
    // SAFETY: as of this function; all pointers live until the call that replaces the child.
    unsafe {
        libc::prctl(libc::PR_SET_PDEATHSIG, libc::SIGKILL);
        if libc::personality(libc::ADDR_NO_RANDOMIZE as libc::c_ulong) < 0 {
            state.randomized.store(1, Ordering::SeqCst);
        }
        libc::signal(libc::SIGPIPE, libc::SIG_DFL);
        let mut failed = libc::prctl(libc::PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) < 0;
        let mut listener = -1;
        if !failed {
            let flags = LISTENER | WAIT_KILLABLE;
            listener = libc::syscall(
                libc::SYS_seccomp,
                libc::SECCOMP_SET_MODE_FILTER,
                flags,
                ptr::from_ref(filter),
            ) as i32;
            failed = listener < 0;
        }
        if failed {
            state.listener.store(-*libc::__errno_location(), Ordering::SeqCst);
            libc::_exit(127);
        }
        state.listener.store(listener, Ordering::SeqCst);
        while state.taken.load(Ordering::SeqCst) == 0 {
            libc::syscall(libc::SYS_getppid);
        }
        libc::execve(program.as_ptr(), arguments.as_ptr(), environment.as_ptr());
        state.failed.store(*libc::__errno_location(), Ordering::SeqCst);
        libc::_exit(127)
    }
}

impl Listener {
    /// Waits for the next call that stops a thread. A signal to this thread ends the wait with
    /// `Interrupted`.
    pub(crate) fn receive(&self) -> io::Result<Stopped> {
        // SAFETY: all-zero is a valid notification, and the kernel wants it so.
        let mut notification: libc::seccomp_notif = unsafe { MaybeUninit::zeroed().assume_init() };
        self.ioctl(RECEIVE, (&raw mut notification).cast())?;
        let data = notification.data;
        Ok(Stopped {
            id: notification.id,
            thread: notification.pid as i32,
            number: i64::from(data.nr),
            architecture: data.arch,
            behind: data.instruction_pointer,
            arguments: data.args,
        })
    }

    /// Lets the thread continue. `NotFound`: it does not exist any more.
    pub(crate) fn reply(&self, id: u64, reply: Reply) -> io::Result<()> {
        let (val, error, flags) = match reply {
            Reply::Value(value) if value >= 0 => (value, 0, 0),
            Reply::Value(error) => (0, error as i32, 0),
            Reply::Continue => (0, 0, CONTINUE),
        };
        let mut response = libc::seccomp_notif_resp { id, val, error, flags };
        self.uninterrupted(SEND, (&raw mut response).cast()).map(|_| ())
    }

    /// Installs one of our descriptors in the stopped process, with the lowest free number or with
    /// this one.
    pub(crate) fn add_descriptor(
        &self,
        id: u64,
        ours: BorrowedFd<'_>,
        number: Option<u32>,
        close_on_exec: bool,
    ) -> io::Result<i32> {
        let mut request = libc::seccomp_notif_addfd {
            id,
            flags: if number.is_some() { SET_NUMBER } else { 0 },
            srcfd: ours.as_raw_fd() as u32,
            newfd: number.unwrap_or(0),
            newfd_flags: if close_on_exec { libc::O_CLOEXEC as u32 } else { 0 },
        };
        self.uninterrupted(ADD_DESCRIPTOR, (&raw mut request).cast())
    }

    /// Makes a request again when a signal to this thread cuts it short: the watchdog's comes
    /// whenever a machine stood still for a while, and a request that it cuts short has no effect.
    fn uninterrupted(&self, request: u64, argument: *mut c_void) -> io::Result<i32> {
        loop {
            match self.ioctl(request, argument) {
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                done => return done,
            }
        }
    }

    fn ioctl(&self, request: u64, argument: *mut c_void) -> io::Result<i32> {
        // SAFETY: the argument is what this request takes, as the callers above see to.
        checked(unsafe { libc::ioctl(self.0.as_raw_fd(), request, argument) }.into())
            .map(|result| result as i32)
    }
}

impl AsRawFd for Listener {
    fn as_raw_fd(&self) -> RawFd {
        self.0.as_raw_fd()
    }
}

/// Reads the memory of another process; a short read is an error.
pub(crate) fn read_memory(process: i32, at: u64, into: &mut [u8]) -> io::Result<()> {
    if into.is_empty() {
        return Ok(());
    }
    let local = libc::iovec { iov_base: into.as_mut_ptr().cast(), iov_len: into.len() };
    let remote = libc::iovec { iov_base: at as *mut c_void, iov_len: into.len() };
    // SAFETY: the local part is writable and lives; the kernel checks the remote one.
    let read = unsafe { libc::process_vm_readv(process, &local, 1, &remote, 1, 0) };
    whole(read, into.len())
}

/// Writes the memory of another process, where that process may write itself.
pub(crate) fn write_memory(process: i32, at: u64, from: &[u8]) -> io::Result<()> {
    if from.is_empty() {
        return Ok(());
    }
    let local = libc::iovec { iov_base: from.as_ptr().cast_mut().cast(), iov_len: from.len() };
    let remote = libc::iovec { iov_base: at as *mut c_void, iov_len: from.len() };
    // SAFETY: the local part is readable and lives; the kernel checks the remote one.
    let written = unsafe { libc::process_vm_writev(process, &local, 1, &remote, 1, 0) };
    whole(written, from.len())
}

fn whole(done: isize, wanted: usize) -> io::Result<()> {
    match checked(done as i64)? {
        done if done as usize == wanted => Ok(()),
        _ => Err(io::Error::from_raw_os_error(libc::EFAULT)),
    }
}

/// A new event counter, which represents an object of the virtual kernel in the program.
pub(crate) fn stand_in() -> io::Result<OwnedFd> {
    // SAFETY: no pointers; the new descriptor is ours alone.
    unsafe {
        let number = checked(libc::eventfd(0, libc::EFD_CLOEXEC | libc::EFD_NONBLOCK).into())?;
        Ok(OwnedFd::from_raw_fd(number as i32))
    }
}

/// A socket to the outside.
pub(crate) fn socket(domain: i32, kind: i32, protocol: i32) -> io::Result<OwnedFd> {
    // SAFETY: no pointers; the new descriptor is ours alone.
    unsafe {
        let number = checked(libc::socket(domain, kind | libc::SOCK_CLOEXEC, protocol).into())?;
        Ok(OwnedFd::from_raw_fd(number as i32))
    }
}

/// Memory without a file, shared by every process that maps it.
pub(crate) fn memory(name: &str, bytes: &[u8]) -> io::Result<std::fs::File> {
    let name = CString::new(name)?;
    // SAFETY: the name lives; the new descriptor is ours alone.
    let file = unsafe {
        let number = checked(libc::memfd_create(name.as_ptr(), libc::MFD_CLOEXEC).into())?;
        std::fs::File::from_raw_fd(number as i32)
    };
    std::os::unix::fs::FileExt::write_all_at(&file, bytes, 0)?;
    Ok(file)
}

/// A page of `u64` in memory that is shared with other processes.
#[derive(Debug)]
pub(crate) struct SharedWords(*mut u64);

/// Number of words in a page.
pub(crate) const WORDS: usize = 4096 / 8;

impl SharedWords {
    /// Maps the first page of a file.
    pub(crate) fn map(file: &std::fs::File) -> io::Result<Self> {
        // SAFETY: a new mapping at an address of the kernel's choice.
        let page = unsafe {
            let protection = libc::PROT_READ | libc::PROT_WRITE;
            libc::mmap(ptr::null_mut(), 4096, protection, libc::MAP_SHARED, file.as_raw_fd(), 0)
        };
        if page == libc::MAP_FAILED {
            return Err(io::Error::last_os_error());
        }
        Ok(Self(page.cast()))
    }

    pub(crate) fn get(&self, word: usize) -> u64 {
        assert!(word < WORDS, "the page has {WORDS} words");
        // SAFETY: within the page, aligned; the other side changes it only while this one waits.
        unsafe { self.0.add(word).read_volatile() }
    }

    pub(crate) fn set(&self, word: usize, value: u64) {
        assert!(word < WORDS, "the page has {WORDS} words");
        // SAFETY: as in `get`.
        unsafe { self.0.add(word).write_volatile(value) }
    }
}

impl Drop for SharedWords {
    fn drop(&mut self) {
        // SAFETY: mapped by `map` with this size.
        unsafe { libc::munmap(self.0.cast(), 4096) };
    }
}

/// Sends a signal to a process; it is not an error if the process does not exist any more.
pub(crate) fn kill(process: i32, signal: i32) {
    // SAFETY: no pointers.
    unsafe { libc::kill(process, signal) };
}

/// Waits until the parents of processes that are visibly ended have got their SIGCHLD.
///
/// The kernel marks a process as ended and signals its parent under one lock, but `/proc` shows the
/// mark without taking the lock. A call that searches all processes of a group takes the lock, so
/// it returns after the signal.
pub(crate) fn wait_for_ends_under_way() {
    // SAFETY: no pointers. Signal 0 is not delivered.
    unsafe { libc::kill(0, 0) };
}

/// Sends a signal to a thread, or to the whole process, as one of its own timers would.
pub(crate) fn send_timer_signal(
    process: i32,
    thread: Option<i32>,
    signal: i32,
    timer: i32,
    value: u64,
) -> io::Result<()> {
    // The part of `siginfo_t` that timers fill in: number, error, code, padding, timer, overruns,
    // value.
    let mut info = [0u8; 128];
    info[0..4].copy_from_slice(&signal.to_ne_bytes());
    info[8..12].copy_from_slice(&libc::SI_TIMER.to_ne_bytes());
    info[16..20].copy_from_slice(&timer.to_ne_bytes());
    info[24..32].copy_from_slice(&value.to_ne_bytes());
    // SAFETY: the kernel reads 128 bytes.
    let sent = unsafe {
        match thread {
            Some(thread) => {
                libc::syscall(libc::SYS_rt_tgsigqueueinfo, process, thread, signal, info.as_ptr())
            }
            None => libc::syscall(libc::SYS_rt_sigqueueinfo, process, signal, info.as_ptr()),
        }
    };
    checked(sent).map(|_| ())
}

/// Reaps those of our children that have ended and that no process asked for.
pub(crate) fn reap_orphans(processes: &[i32]) {
    for process in processes {
        // SAFETY: no pointers.
        unsafe { libc::waitpid(*process, ptr::null_mut(), 0) };
    }
}

/// Waits for the end of a child.
pub(crate) fn reap(process: i32) -> Option<Ending> {
    let mut status = 0;
    // SAFETY: `status` lives.
    let reaped = unsafe { libc::waitpid(process, &raw mut status, 0) };
    (reaped == process).then(|| Ending::of(status))
}

/// How a program ended.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Ending {
    /// The program exited with this code.
    Exited(i32),
    /// The program was killed by this signal.
    Killed(i32),
}

impl Ending {
    fn of(status: i32) -> Self {
        match libc::WIFSIGNALED(status) {
            true => Self::Killed(libc::WTERMSIG(status)),
            false => Self::Exited(libc::WEXITSTATUS(status)),
        }
    }
}

fn is_zombie(process: i32) -> bool {
    std::fs::read_to_string(format!("/proc/{process}/stat"))
        .map_or(true, |stat| stat.rsplit(')').next().is_some_and(|rest| rest.starts_with(" Z")))
}

/// Makes orphans of the program children of this process, so that none is left behind.
pub(crate) fn adopt_orphans() {
    // SAFETY: no pointers.
    unsafe { libc::prctl(libc::PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0) };
}

/// Interrupts a thread of this process in its system call, any number of times, by a signal without
/// effect.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Interrupter(libc::pthread_t);

/// The signal for the interruption, which has no other use here.
const NUDGE: i32 = libc::SIGURG;

impl Interrupter {
    /// An interrupter of the calling thread.
    pub(crate) fn of_this_thread() -> Self {
        extern "C" fn nothing(_: i32) {}
        // SAFETY: the handler does nothing; without `SA_RESTART` calls are interrupted.
        unsafe {
            let mut action: libc::sigaction = MaybeUninit::zeroed().assume_init();
            action.sa_sigaction = nothing as *const () as usize;
            libc::sigaction(NUDGE, &raw const action, ptr::null_mut());
            Self(libc::pthread_self())
        }
    }

    pub(crate) fn interrupt(self) {
        // SAFETY: the thread is the supervisor's own and outlives its watchdog.
        unsafe { libc::pthread_kill(self.0, NUDGE) };
    }
}

fn checked(result: i64) -> io::Result<i64> {
    if result < 0 { Err(io::Error::last_os_error()) } else { Ok(result) }
}

/// The registers of a thread that tell its position.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Registers {
    /// The address of the next instruction.
    pub instruction: u64,
    /// The frame pointer, if the code keeps one.
    pub frame: u64,
}

/// Stops a running thread for a moment and reads its registers.
pub(crate) fn registers(thread: i32) -> io::Result<Registers> {
    let ask = |request, data: *mut c_void| {
        // SAFETY: the data of these requests is nothing, or room for the registers.
        match unsafe { libc::ptrace(request, thread, ptr::null_mut::<c_void>(), data) } {
            -1 => Err(io::Error::last_os_error()),
            _ => Ok(()),
        }
    };
    ask(libc::PTRACE_SEIZE, ptr::null_mut())?;
    ask(libc::PTRACE_INTERRUPT, ptr::null_mut())?;
    // SAFETY: this thread has seized it, and it stops at once, since it runs.
    let stopped = unsafe { libc::waitpid(thread, ptr::null_mut(), libc::__WALL) };
    let mut registers = MaybeUninit::<libc::user_regs_struct>::zeroed();
    let read = match stopped {
        -1 => Err(io::Error::last_os_error()),
        _ => ask(libc::PTRACE_GETREGS, registers.as_mut_ptr().cast()),
    };
    // A thread that does not exist any more needs no release.
    let _ = ask(libc::PTRACE_DETACH, ptr::null_mut());
    read?;
    // SAFETY: any bytes are valid registers.
    let registers = unsafe { registers.assume_init() };
    Ok(Registers { instruction: registers.rip, frame: registers.rbp })
}
