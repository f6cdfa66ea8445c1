//! The processes of a program, their threads and descriptors.

use std::collections::BTreeMap;
use std::io;
use std::os::fd::AsFd;

use isocat_wire::time::{Host as Clock, Nanos, Time};

use super::life::group_and_parent;
use super::vdso::Patch;
use super::{Errno, Outcome, Supervisor};
use crate::kernel::{ObjectId, Source, TaskId, Timer};
use crate::sys::{self, Reply, Stopped};

/// The index of a process.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct ProcessId(pub usize);

/// A thread of a process.
#[derive(Debug)]
pub(super) struct Thread {
    /// The number that the kernel gave it.
    pub number: i32,
    pub process: ProcessId,
    /// The call at which it stopped.
    pub call: Stopped,
    /// Whether it is stopped, and not in the kernel.
    pub stopped: bool,
    pub reply: Reply,
    /// Its call will take real time.
    pub goes_outside: bool,
    /// The end of its call's wait.
    pub until: Time<Clock>,
    /// The address at which the kernel writes 0 when it ends, for tasks that wait for that.
    pub clear_at_end: u64,
    /// A signal interrupts its wait.
    pub interrupted: bool,
}

/// A process.
#[derive(Debug)]
pub(super) struct Process {
    pub number: i32,
    pub parent: Option<ProcessId>,
    /// The number of its memory; processes that share memory have the same number.
    pub space: u64,
    /// The objects of its descriptors, as far as the virtual kernel has them.
    pub descriptors: BTreeMap<i32, Descriptor>,
    pub timers: Vec<OwnTimer>,
    /// Its program was checked since it was last replaced.
    pub prepared: bool,
    /// The original bytes, to be restored once the clock's page is mapped: address and bytes.
    pub under: Option<Patch>,
    pub gone: bool,
    /// It has ended, and its parent has not asked for it yet.
    pub unclaimed: bool,
    /// The thread that waits in the kernel until this process has its own program, after `vfork`.
    pub stands_for: Option<TaskId>,
}

/// A call that makes a thread or a process.
#[derive(Clone, Copy, Debug)]
pub(super) struct Made {
    /// The address at which the kernel writes 0 when it ends; 0: nowhere.
    pub clear_at_end: u64,
    /// Whether it is a process that uses its parent's memory.
    pub shares_memory: bool,
    /// The thread that stands still until the new process has its own program.
    pub waits: Option<TaskId>,
}

/// A descriptor that stands for an object.
#[derive(Clone, Copy, Debug)]
pub(super) struct Descriptor {
    pub object: ObjectId,
    pub close_on_exec: bool,
}

/// A timer that sends a signal.
#[derive(Debug, Default)]
pub(super) struct OwnTimer {
    /// Its number; -1 is the one of `setitimer` and `alarm`.
    pub id: i32,
    pub timer: Timer,
    /// The signal; 0: none.
    pub signal: i32,
    pub value: u64,
    /// The thread that gets the signal; `None`: any.
    pub thread: Option<i32>,
    /// The clock with which it was created.
    pub clock: i32,
}

impl Process {
    pub(super) fn next_timer(&self) -> Option<Time<Clock>> {
        self.timers.iter().filter_map(|own| own.timer.next()).min()
    }
}

impl Supervisor<'_> {
    pub(super) fn add_process(
        &mut self,
        number: i32,
        parent: Option<ProcessId>,
    ) -> io::Result<ProcessId> {
        let descriptors = match parent {
            Some(ProcessId(parent)) => self.processes[parent].descriptors.clone(),
            None => BTreeMap::new(),
        };
        for descriptor in descriptors.values() {
            self.objects.retain(descriptor.object);
        }
        self.watchdog.watch(number)?;
        self.figures.processes += 1;
        let process = Process {
            number,
            parent,
            space: number as u64,
            descriptors,
            timers: Vec::new(),
            // A copy of its parent has the parent's patches.
            prepared: parent.is_some(),
            under: None,
            gone: false,
            unclaimed: false,
            stands_for: None,
        };
        // The slot of a process that no parent asks for any more is used again.
        let is_parent = |place: usize| {
            let of = |process: &Process| !process.gone && process.parent == Some(ProcessId(place));
            self.processes.iter().any(of)
        };
        let is_free = |(place, process): (usize, &Process)| {
            place > 0 && process.gone && !process.unclaimed && !is_parent(place)
        };
        let free = self.processes.iter().enumerate().position(is_free);
        let place = free.unwrap_or(self.processes.len());
        match free {
            Some(place) => self.processes[place] = process,
            None => self.processes.push(process),
        }
        Ok(ProcessId(place))
    }

    pub(super) fn add_thread(&mut self, number: i32, process: ProcessId) -> TaskId {
        self.figures.threads += 1;
        let thread = Thread {
            number,
            process,
            call: Stopped::default(),
            stopped: false,
            reply: Reply::Continue,
            goes_outside: false,
            until: Time::NEVER,
            clear_at_end: 0,
            interrupted: false,
        };
        let task = self.scheduler.add();
        match self.threads.get_mut(task.0 as usize) {
            Some(place) => *place = thread,
            None => self.threads.push(thread),
        }
        task
    }

    pub(super) fn task_of(&self, number: i32) -> Option<TaskId> {
        self.scheduler.alive().find(|task| self.threads[task.0 as usize].number == number)
    }

    /// Registers a thread that makes its first call: of a known process, or of a new one.
    pub(super) fn newcomer(&mut self, number: i32) -> io::Result<Option<TaskId>> {
        let Some((group, parent)) = group_and_parent(number) else { return Ok(None) };
        let made = self.made.take();
        let clears = made.map(|made| made.clear_at_end);
        let known = |wanted: i32| {
            let alive = |process: &Process| process.number == wanted && !process.gone;
            self.processes.iter().position(alive).map(ProcessId)
        };
        let process = match known(group) {
            Some(process) => process,
            None => {
                let parent = known(parent).unwrap_or(ProcessId(0));
                let process = self.add_process(group, Some(parent))?;
                if let Some(made) = made.filter(|made| made.shares_memory) {
                    self.processes[process.0].space = self.processes[parent.0].space;
                    self.processes[process.0].stands_for = made.waits;
                }
                process
            }
        };
        let task = self.add_thread(number, process);
        if let Some(clears) = clears {
            self.thread(task).clear_at_end = clears;
        }
        Ok(Some(task))
    }

    /// A thread replaced the program and continues as the first thread of its process; all others
    /// have ended.
    pub(super) fn replaced_by(&mut self, task: TaskId) {
        let process = self.threads[task.0 as usize].process;
        let others: Vec<TaskId> = self
            .scheduler
            .alive()
            .filter(|other| *other != task && self.threads[other.0 as usize].process == process)
            .collect();
        for other in others {
            self.futexes.leave(other);
            self.scheduler.end(other);
        }
        self.futexes.leave(task);
    }

    /// The object of a descriptor of the calling process.
    pub(super) fn object(&mut self, task: TaskId, number: u64) -> Option<ObjectId> {
        self.process(task).descriptors.get(&(number as i32)).map(|descriptor| descriptor.object)
    }

    /// Installs a descriptor for an object in the calling process.
    pub(super) fn install(
        &mut self,
        task: TaskId,
        object: ObjectId,
        close_on_exec: bool,
    ) -> Result<Outcome, Errno> {
        let id = self.thread(task).call.id;
        let stand_in = sys::stand_in()?;
        let added = self.listener().add_descriptor(id, stand_in.as_fd(), None, close_on_exec);
        match added {
            Ok(number) => {
                let descriptor = Descriptor { object, close_on_exec };
                self.process(task).descriptors.insert(number, descriptor);
                Ok(Outcome::Done(number.into()))
            }
            Err(error) => {
                self.release_object(object);
                Err(error.into())
            }
        }
    }

    /// Removes the object of a descriptor of the calling process.
    pub(super) fn forget_descriptor(&mut self, task: TaskId, number: i32) {
        if let Some(descriptor) = self.process(task).descriptors.remove(&number) {
            self.release_object(descriptor.object);
        }
    }

    pub(super) fn release_object(&mut self, object: ObjectId) {
        self.scheduler.touch(Source::Object(object));
        let changed = self.objects.release(object);
        if self.objects.get(object).is_none() {
            self.outside.remove(&object);
            self.timer_clocks.remove(&object);
            if let Some(ours) = self.netlinks.remove(&object) {
                self.release_object(ours);
            }
        }
        changed.iter().for_each(|id| self.objects.changed(*id));
        self.touch(&changed);
    }

    /// Lets timers that send signals expire.
    pub(super) fn fire_process_timers(&mut self, now: Time<Clock>) {
        for place in 0..self.processes.len() {
            let process = &mut self.processes[place];
            let number = process.number;
            for own in &mut process.timers {
                if own.timer.fire(now) > 0 && own.signal != 0 {
                    // If the queue of signals is full, the timer counts an overrun, as in a kernel.
                    let _ =
                        sys::send_timer_signal(number, own.thread, own.signal, own.id, own.value);
                    self.signalled = true;
                }
            }
        }
    }
}

/// The time left until an instant, for the program; 0 if it is in the past.
pub(super) fn left(until: Time<Clock>, now: Time<Clock>) -> Nanos {
    (until - now).max(Nanos::ZERO)
}
