//! The start and the end of threads and processes.

use std::fs;
use std::io;
use std::sync::atomic::Ordering;
use std::time::Duration;

use super::backtrace;
use super::program::{Made, Process, ProcessId, Thread};
use super::{How, Supervisor};
use crate::kernel::{Source, TaskId};
use crate::sys::{self, Reply, Stopped};

impl Supervisor<'_> {
    /// Prepares a thread before it continues. Returns whether its call makes another thread.
    pub(super) fn before_release(&mut self, task: TaskId) -> io::Result<bool> {
        let Thread { call, reply, .. } = *self.thread(task);
        if reply != Reply::Continue {
            return Ok(false);
        }
        if matches!(call.number, libc::SYS_execve | libc::SYS_execveat) {
            self.process(task).prepared = false;
        }
        self.made = self.makes(task, &call)?;
        if let Some(Made { waits: Some(_), .. }) = self.made {
            self.scheduler.outside(task);
        }
        Ok(self.made.is_some())
    }

    /// What a call makes, according to its flags.
    fn makes(&self, task: TaskId, call: &Stopped) -> io::Result<Option<Made>> {
        let process = self.processes[self.threads[task.0 as usize].process.0].number;
        let [first, _, _, fourth, ..] = call.arguments;
        let (flags, clears) = match call.number {
            libc::SYS_clone => (first, fourth),
            libc::SYS_clone3 => {
                let mut arguments = [0; 24];
                sys::read_memory(process, first, &mut arguments)?;
                let word = |at: usize| {
                    arguments[at..].first_chunk().map_or(0, |word| u64::from_ne_bytes(*word))
                };
                (word(0), word(16))
            }
            libc::SYS_fork => (0, 0),
            libc::SYS_vfork => (VFORK | MEMORY, 0),
            _ => return Ok(None),
        };
        let is = |flag: u64| flags & flag != 0;
        Ok(Some(Made {
            clear_at_end: if is(libc::CLONE_CHILD_CLEARTID as u64) { clears } else { 0 },
            shares_memory: is(MEMORY) && !is(libc::CLONE_THREAD as u64),
            waits: is(VFORK).then_some(task),
        }))
    }

    /// Handles what follows after a thread has continued.
    pub(super) fn after_release(&mut self, task: TaskId) -> io::Result<()> {
        let Thread { call, reply, number, process, .. } = *self.thread(task);
        if reply != Reply::Continue {
            return Ok(());
        }
        match call.number {
            libc::SYS_exit => {
                let leader = self.processes[process.0].number;
                // The last thread of a process ends the process; a first thread that ends stays
                // until then.
                let alone = self.tasks_of(process).count() == 1;
                if alone {
                    return self.process_ends(process);
                }
                wait_until(|| is_gone_or_zombie(leader, number));
                self.thread_ended(task);
                Ok(())
            }
            libc::SYS_exit_group => self.process_ends(process),
            _ => Ok(()),
        }
    }

    fn tasks_of(&self, process: ProcessId) -> impl Iterator<Item = TaskId> {
        let of = move |task: &TaskId| self.threads[task.0 as usize].process == process;
        self.scheduler.alive().filter(of)
    }

    /// Handles the end of a thread: tasks that wait for its end continue, and tasks whose word
    /// changed check it again.
    pub(super) fn thread_ended(&mut self, task: TaskId) {
        self.futexes.leave(task);
        self.scheduler.end(task);
        let space = self.process(task).space;
        self.wake_changed_words(space);
    }

    /// A process ends by itself: waits until it does not exist any more.
    fn process_ends(&mut self, process: ProcessId) -> io::Result<()> {
        let number = self.processes[process.0].number;
        let tasks: Vec<TaskId> = self.tasks_of(process).collect();
        wait_until(|| has_ended(number));
        tasks.into_iter().for_each(|task| self.thread_ended(task));
        self.process_ended(process);
        Ok(())
    }

    /// Handles the end of a process.
    pub(super) fn process_ended(&mut self, process: ProcessId) {
        let Process { number, parent, gone, .. } = self.processes[process.0];
        if gone {
            return;
        }
        // Its own children lose their parent, so none will ask for them.
        for child in self.processes.iter_mut().filter(|child| child.parent == Some(process)) {
            child.unclaimed = false;
        }
        let is_asked_for = parent.is_some_and(|ProcessId(parent)| !self.processes[parent].gone);
        let place = &mut self.processes[process.0];
        (place.gone, place.unclaimed) = (true, is_asked_for);
        let descriptors = std::mem::take(&mut place.descriptors);
        for descriptor in descriptors.into_values() {
            self.release_object(descriptor.object);
        }
        if let Some(waits) = self.processes[process.0].stands_for.take() {
            self.run_unless_stopped(waits);
        }
        self.watchdog.forget(number);
        self.scheduler.touch(Source::Child);
        self.signalled = true;
        if parent.is_none() {
            let ending = sys::reap(number).unwrap_or(sys::Ending::Exited(0));
            self.end = Some(How::Itself(ending));
        }
    }

    /// Handles an interruption: a signal, the watchdog, or the end of a process.
    pub(super) fn look_around(&mut self) -> io::Result<()> {
        if self.options.stop.load(Ordering::SeqCst) {
            self.end = Some(How::Stopped);
            return Ok(());
        }
        let running: Vec<ProcessId> = (0..self.processes.len()).map(ProcessId).collect();
        for process in running {
            let Process { number, gone, .. } = self.processes[process.0];
            if !gone && has_ended(number) {
                let tasks: Vec<TaskId> = self.tasks_of(process).collect();
                tasks.into_iter().for_each(|task| self.thread_ended(task));
                self.process_ended(process);
            }
        }
        if self.made.is_some() && !self.is_newcomer_there() {
            // The call that should have made the process failed.
            if let Some(task) = self.made.take().and_then(|made| made.waits) {
                self.run_unless_stopped(task);
            }
        }
        self.let_others_run_beside_writers();
        if self.watchdog.is_stuck() && self.end.is_none() {
            self.end = Some(How::Spins(self.describe_running()));
        }
        Ok(())
    }

    /// A thread that has been writing to the outside for long may wait for a reader that is another
    /// thread of the program. It then counts as outside.
    fn let_others_run_beside_writers(&mut self) {
        let running: Vec<TaskId> =
            self.scheduler.alive().filter(|task| self.scheduler.is_running(*task)).collect();
        for task in running {
            let call = self.thread(task).call;
            let writes = matches!(call.number, libc::SYS_write | libc::SYS_writev);
            let number = self.threads[task.0 as usize].number;
            if writes && sys_call_of(number) == Some(call.number) {
                self.scheduler.outside(task);
            }
        }
    }

    /// Whether a thread or process of the program exists that has not made a call yet.
    fn is_newcomer_there(&self) -> bool {
        self.processes.iter().filter(|process| !process.gone).any(|process| {
            let threads = format!("/proc/{}/task", process.number);
            let numbers = fs::read_dir(threads).into_iter().flatten().flatten();
            let numbers = numbers.filter_map(|entry| entry.file_name().to_str()?.parse().ok());
            numbers.into_iter().any(|number: i32| {
                let children = format!("/proc/{}/task/{number}/children", process.number);
                let children = fs::read_to_string(children).unwrap_or_default();
                let unknown =
                    |child: i32| !self.processes.iter().any(|known| known.number == child);
                self.task_of(number).is_none() && !is_gone_or_zombie(process.number, number)
                    || children
                        .split_whitespace()
                        .filter_map(|child| child.parse().ok())
                        .any(unknown)
            })
        })
    }

    /// The running threads, in words.
    fn describe_running(&self) -> Vec<String> {
        let running = self.scheduler.alive().filter(|task| self.scheduler.is_running(*task));
        let place = |task: TaskId| {
            let thread = &self.threads[task.0 as usize];
            let process = self.processes[thread.process.0].number;
            match &backtrace::places(process, thread.number)[..] {
                [] => self.describe(task),
                places => format!("{} at {}", self.describe(task), places.join(", called by ")),
            }
        };
        running.map(place).collect()
    }

    /// A thread in words: its name and number.
    pub(super) fn describe(&self, task: TaskId) -> String {
        let thread = &self.threads[task.0 as usize];
        let process = self.processes[thread.process.0].number;
        let name = fs::read_to_string(format!("/proc/{process}/task/{}/comm", thread.number));
        format!("thread {} ({})", thread.number, name.unwrap_or_default().trim())
    }

    /// Handles a pause in which all threads wait for the outside, or forever.
    pub(super) fn wait_for_the_world_outside(&mut self) -> io::Result<Option<TaskId>> {
        let outside = |task: &TaskId| self.scheduler.is_outside(*task);
        if self.scheduler.alive().any(|task| outside(&task)) {
            match self.listener().receive() {
                Ok(call) => {
                    if let Some(task) = self.identify(call)? {
                        self.begin(task)?;
                    }
                }
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {
                    self.look_around()?;
                    if self.end.is_none() && self.waits_for_signals_alone() {
                        let all: Vec<TaskId> = self.scheduler.alive().collect();
                        self.end = Some(How::Deadlock(self.tell(&all)));
                    }
                }
                Err(error) if error.raw_os_error() == Some(libc::ENOENT) => self.look_around()?,
                Err(error) => return Err(error),
            }
            return Ok(None);
        }
        let waiting: Vec<TaskId> = self.scheduler.alive().collect();
        if waiting.is_empty() {
            self.look_around()?;
            if self.end.is_none() {
                std::thread::sleep(Duration::from_millis(1));
            }
            return Ok(None);
        }
        self.end = Some(How::Deadlock(self.tell(&waiting)));
        Ok(None)
    }

    /// The threads and what they wait for, in words.
    fn tell(&self, tasks: &[TaskId]) -> Vec<String> {
        let tell = |task: &TaskId| format!("{}: {}", self.describe(*task), self.waits_for(*task));
        tasks.iter().map(tell).collect()
    }

    /// Whether every thread in the kernel sleeps until a signal comes. A thread of the program that
    /// could send one waits too, and no timer is set.
    fn waits_for_signals_alone(&self) -> bool {
        let mut outside = self.scheduler.alive().filter(|task| self.scheduler.is_outside(*task));
        outside.all(|task| {
            let thread = &self.threads[task.0 as usize];
            let waits = [libc::SYS_pause, libc::SYS_rt_sigsuspend];
            waits.contains(&thread.call.number)
                && sys_call_of(thread.number) == Some(thread.call.number)
        })
    }
}

const VFORK: u64 = libc::CLONE_VFORK as u64;
const MEMORY: u64 = libc::CLONE_VM as u64;

/// Number of checks for the end of a thread without pauses; after that there are pauses between
/// checks.
const SPINS: u32 = 1_000;

fn wait_until(is: impl Fn() -> bool) {
    let mut times = 0;
    while !is() {
        times += 1;
        match times < SPINS {
            true => std::thread::yield_now(),
            false => std::thread::sleep(std::time::Duration::from_micros(200)),
        }
    }
}

/// The call in which a thread sleeps in the kernel, if it does.
fn sys_call_of(thread: i32) -> Option<i64> {
    let text = fs::read_to_string(format!("/proc/{thread}/syscall")).ok()?;
    text.split_whitespace().next()?.parse().ok()
}

/// Whether a thread has ended, or is the remainder of the first thread of a process.
fn is_gone_or_zombie(process: i32, thread: i32) -> bool {
    let stat = fs::read_to_string(format!("/proc/{process}/task/{thread}/stat"));
    let ends = |rest: &str| rest.starts_with(" Z") || rest.starts_with(" X");
    stat.map_or(true, |stat| stat.rsplit(')').next().is_some_and(ends))
}

/// Whether a process has ended: its last thread is gone, and its parent has got the signal.
///
/// The first thread may end before the others; the kernel sends SIGCHLD when the last one ends. A
/// parent that is checked too early has no pending signal yet. The signal would then interrupt it
/// in one run and not in the next.
fn has_ended(process: i32) -> bool {
    let Ok(stat) = fs::read_to_string(format!("/proc/{process}/stat")) else { return true };
    // Behind the name in parentheses are the state and, 17 fields later, the number of threads. The
    // folder of threads cannot be used to count: its reader stops at a thread that ends meanwhile.
    let mut fields = stat.rsplit(')').next().unwrap_or_default().split_whitespace();
    let is_zombie = matches!(fields.next(), Some("Z" | "X"));
    let threads = fields.nth(16).and_then(|count| count.parse().ok()).unwrap_or(0);
    let ended = is_zombie && threads <= 1;
    if ended {
        sys::wait_for_ends_under_way();
    }
    ended
}

/// The process of a thread, and the parent of that process.
pub(super) fn group_and_parent(thread: i32) -> Option<(i32, i32)> {
    let status = fs::read_to_string(format!("/proc/{thread}/status")).ok()?;
    let field = |name: &str| {
        let line = status.lines().find_map(|line| line.strip_prefix(name))?;
        line.trim().parse().ok()
    };
    Some((field("Tgid:")?, field("PPid:")?))
}
