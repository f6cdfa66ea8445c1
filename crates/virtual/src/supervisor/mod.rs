//! Runs a program whose system calls are answered from virtual time.
//!
//! The way of the data: a call stops its thread, and `Supervisor` receives it. Then `calls` answers
//! it, or the thread waits. When all threads have stopped, the virtual kernel's scheduler names the
//! next thread, time advances to the instant at which that thread is due, and it gets its answer.
//! `launch` checks the program before it is started, and `filter` defines which calls stop.
//! `program` keeps processes, threads and their descriptors, `life` handles their start and end.
//! `image` patches the functions by which a program reads its clocks, which `vdso` defines.
//! `watchdog` notices events that are not calls.

mod backtrace;
mod calls;
mod counter;
mod filter;
mod image;
mod launch;
mod life;
mod program;
mod vdso;
mod watchdog;

use std::collections::BTreeMap;
use std::io;
use std::os::fd::OwnedFd;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use isocat_wire::time::{Host as Clock, Nanos, Time};

pub use launch::{Program, Refusal};
use program::{Made, Process, ProcessId, Thread};
use vdso::{EPOCH, word};
use watchdog::Watchdog;

use crate::kernel::{
    Arrived, Costs, Futexes, Host, Luck, MachineFault, ObjectId, Objects, Scheduler, Source, TaskId,
};
pub use crate::sys::Ending;
use crate::sys::{self, Launched, Listener, Reply, SharedWords, Stopped};
use crate::wire::{Wire, WireAnswer};

/// The settings for running a program.
#[derive(Clone, Debug)]
pub struct Options {
    /// The interfaces that exist for the program, one for each port of the segment.
    pub interfaces: Vec<String>,
    /// The cost of its calls.
    pub costs: Costs,
    /// The random delays of its machine.
    pub luck: Luck,
    /// The virtual time after its start at which it is ended; `None`: it ends by itself.
    pub limit: Option<Nanos>,
    /// Set by another thread to end the program now.
    pub stop: Arc<AtomicBool>,
}

/// The result of running a program.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Ended {
    /// How it ended.
    pub how: How,
    /// Virtual time from its start to its end.
    pub lasted: Nanos,
    /// Counters of the run.
    pub figures: Figures,
    /// Calls that were refused, or handled otherwise than in a kernel: in words, with their number.
    pub notes: BTreeMap<String, u64>,
}

/// How a program ended.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum How {
    /// The program ended by itself.
    Itself(Ending),
    /// Its time limit was reached.
    Limit,
    /// It was stopped by [`Options::stop`].
    Stopped,
    /// All its threads wait for something that cannot happen. Each line names a thread and what it
    /// waits for.
    Deadlock(Vec<String>),
    /// A thread makes no call: how long in real time, and its position.
    Spins(Vec<String>),
}

/// Counters of a run.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Figures {
    /// Calls that stopped a thread.
    pub stops: u64,
    /// Readings of the clock that did not stop a thread.
    pub readings: u64,
    /// Number of switches to another thread than the one that had stopped.
    pub switches: u64,
    /// Frames that were sent.
    pub sent: u64,
    /// Frames that came back to the host.
    pub received: u64,
    /// Number of threads of all processes.
    pub threads: u64,
    /// Number of processes.
    pub processes: u64,
}

/// Least time between two updates of the segment.
const LEAST_LOOK: Nanos = Nanos::micros(1);

/// Virtual time at which a program starts.
pub const START: Time<Clock> = Time::new(1_000_000_000);

/// Runs a program to its end.
///
/// # Errors
///
/// The program could not be started, or the machine does not allow supervision; the program was
/// then not started.
pub fn run(program: &Program, options: &Options, wire: &mut dyn Wire) -> io::Result<Ended> {
    sys::adopt_orphans();
    let launched = launch::start(program)?;
    let mut supervisor = Supervisor::new(launched, options, wire)?;
    let how = supervisor.serve();
    supervisor.end(how?)
}

/// The supervisor of one program.
struct Supervisor<'w> {
    launched: Launched,
    options: Options,
    wire: &'w mut dyn Wire,
    host: Host,
    scheduler: Scheduler,
    futexes: Futexes,
    objects: Objects,
    processes: Vec<Process>,
    /// The threads by task number.
    threads: Vec<Thread>,
    /// Answers that are under way.
    flying: Vec<WireAnswer>,
    /// Our copies of the program's outside descriptors.
    outside: BTreeMap<ObjectId, OwnedFd>,
    /// Our ends of netlink sockets, by the program's end.
    netlinks: BTreeMap<ObjectId, ObjectId>,
    /// The clocks of the timers.
    timer_clocks: BTreeMap<ObjectId, i32>,
    /// The instant of the last update of the segment.
    looked: Time<Clock>,
    /// The instant at which the last frame was sent, and at which the last one is back in a socket.
    last_sent: Time<Clock>,
    last_back: Time<Clock>,
    page: ClockPage,
    /// The difference between real-time clocks and virtual time, ns since 1970.
    epoch: u64,
    watchdog: Watchdog,
    /// A call makes a thread or a process, which has not made a call yet.
    made: Option<Made>,
    /// A signal was sent, which may interrupt waiting threads.
    signalled: bool,
    /// The thread that ran last.
    last: Option<TaskId>,
    end: Option<How>,
    figures: Figures,
    notes: BTreeMap<String, u64>,
}

/// The page in which the program's clocks count.
#[derive(Debug)]
struct ClockPage {
    file: std::fs::File,
    words: SharedWords,
}

/// The outcome of a call.
#[derive(Clone, PartialEq, Eq, Debug)]
enum Outcome {
    /// The call returns this.
    Done(i64),
    /// The kernel executes the call at once.
    Pass,
    /// The kernel executes the call, which may take real time.
    Outside,
    /// The thread waits, and the call is tried again later.
    Wait(Time<Clock>, Vec<Source>),
}

/// The error number of a call.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct Errno(i32);

impl From<io::Error> for Errno {
    fn from(error: io::Error) -> Self {
        Self(error.raw_os_error().unwrap_or(libc::EIO))
    }
}

type Answer = Result<Outcome, Errno>;

impl<'w> Supervisor<'w> {
    fn new(launched: Launched, options: &Options, wire: &'w mut dyn Wire) -> io::Result<Self> {
        let file = sys::memory("virtual clock", &[0; 4096])?;
        let page = ClockPage { words: SharedWords::map(&file)?, file };
        page.words.set(word::COST, options.costs.call.0 as u64);
        page.words.set(word::EPOCH, EPOCH);
        let watchdog = Watchdog::new(launched.process)?;
        let mut supervisor = Self {
            host: Host::new(options.costs, options.luck.clone()),
            options: options.clone(),
            wire,
            scheduler: Scheduler::new(START),
            futexes: Futexes::default(),
            objects: Objects::default(),
            processes: Vec::new(),
            threads: Vec::new(),
            flying: Vec::new(),
            outside: BTreeMap::new(),
            netlinks: BTreeMap::new(),
            timer_clocks: BTreeMap::new(),
            looked: Time::ZERO,
            last_sent: Time::ZERO,
            last_back: Time::ZERO,
            page,
            epoch: EPOCH,
            watchdog,
            made: None,
            signalled: false,
            last: None,
            end: None,
            figures: Figures::default(),
            notes: BTreeMap::new(),
            launched,
        };
        let process = supervisor.launched.process;
        if supervisor.launched.is_randomized() {
            supervisor.note("addresses differ from run to run, as this machine does not let them be fixed (personality); a program whose way depends on them, as Python's may, differs, too");
        }
        let first = supervisor.add_process(process, None)?;
        supervisor.add_thread(process, first);
        Ok(supervisor)
    }

    fn listener(&self) -> &Listener {
        &self.launched.listener
    }

    fn now(&self) -> Time<Clock> {
        self.scheduler.now()
    }

    /// Serves calls until the program has ended.
    fn serve(&mut self) -> io::Result<How> {
        loop {
            self.collect()?;
            if let Some(how) = self.end.take() {
                return Ok(how);
            }
            let Some(task) = self.choose()? else { continue };
            self.release(task)?;
        }
    }

    /// Waits until no thread runs, and tries the calls at which the threads stopped.
    fn collect(&mut self) -> io::Result<()> {
        // A call may let another thread run, for example when a child gets its own program.
        while self.end.is_none() && self.is_any_running() {
            self.collect_once()?;
        }
        Ok(())
    }

    fn collect_once(&mut self) -> io::Result<()> {
        let mut stopped = Vec::new();
        while self.end.is_none() && self.is_any_running() {
            match self.listener().receive() {
                Ok(call) => {
                    self.watchdog.alive();
                    stopped.extend(self.identify(call)?);
                }
                Err(error) if error.kind() == io::ErrorKind::Interrupted => self.look_around()?,
                // The thread was killed after its call.
                Err(error) if error.raw_os_error() == Some(libc::ENOENT) => self.look_around()?,
                Err(error) => return Err(error),
            }
        }
        // Calls that several threads made at the same time are handled in the order of the threads.
        stopped.sort_unstable();
        for task in stopped {
            self.begin(task)?;
        }
        Ok(())
    }

    fn is_any_running(&self) -> bool {
        self.made.is_some() || self.scheduler.alive().any(|task| self.scheduler.is_running(task))
    }

    /// The thread that made a call; `None` if it is not supervised any more.
    fn identify(&mut self, call: Stopped) -> io::Result<Option<TaskId>> {
        self.figures.stops += 1;
        let task = match self.task_of(call.thread) {
            Some(task) => task,
            None => match self.newcomer(call.thread)? {
                Some(task) => task,
                None => return Ok(None),
            },
        };
        if self.scheduler.is_waiting(task) || self.scheduler.is_answered(task) {
            // A thread took over another one's number by replacing the program.
            self.replaced_by(task);
        }
        // The kernel has sent the signal of its last call by now, and not before.
        self.signalled |= calls::sends_signal(self.thread(task).call.number);
        // From here on it stands still, whatever its call does.
        self.scheduler.outside(task);
        self.thread(task).call = call;
        self.thread(task).stopped = true;
        self.let_parent_run(task)?;
        Ok(Some(task))
    }

    /// Tries a call for the first time.
    fn begin(&mut self, task: TaskId) -> io::Result<()> {
        self.take_time_from_page();
        if !self.prepare_image(task)? {
            return Ok(());
        }
        let (cost, preempted) = (self.host.costs.call, self.host.preempts());
        self.scheduler.spend(cost + preempted);
        let answer = self.call(task, true);
        self.settle(task, answer);
        Ok(())
    }

    /// Stores the answer of a call.
    fn settle(&mut self, task: TaskId, answer: Answer) {
        let reply = match answer {
            Ok(Outcome::Wait(until, sources)) => return self.scheduler.wait(task, until, &sources),
            Ok(Outcome::Done(value)) => Reply::Value(value),
            Ok(Outcome::Pass) => Reply::Continue,
            Ok(Outcome::Outside) => {
                self.thread(task).goes_outside = true;
                Reply::Continue
            }
            Err(Errno(number)) => Reply::Value(-i64::from(number)),
        };
        self.futexes.leave(task);
        self.thread(task).reply = reply;
        self.scheduler.answered(task);
    }

    /// Advances time until a thread may run, and returns that thread. `None`: something else
    /// happened.
    fn choose(&mut self) -> io::Result<Option<TaskId>> {
        if std::mem::take(&mut self.signalled) {
            self.interrupt_by_signals();
        }
        loop {
            if self.options.stop.load(Ordering::SeqCst) {
                self.end = Some(How::Stopped);
                return Ok(None);
            }
            let next = self.scheduler.next();
            let due =
                next.map_or(Time::NEVER, |(_, due)| self.host.after_stall(due.max(self.now())));
            let event = self.next_event();
            let until = due.min(event);
            if until == Time::NEVER {
                return self.wait_for_the_world_outside();
            }
            let limit = self.limit_of_program();
            if let Some(look) = self.next_look().filter(|look| *look <= until.min(limit)) {
                self.scheduler.advance(look);
                self.looked = self.now();
                self.wire.advance(self.now());
                self.suffer();
                continue;
            }
            if until >= limit && until > self.now() {
                self.scheduler.advance(limit);
                self.end = Some(How::Limit);
                return Ok(None);
            }
            if event <= due {
                self.scheduler.advance(event);
                self.fire();
                continue;
            }
            let Some((task, _)) = next else { continue };
            self.scheduler.advance(due);
            if self.scheduler.is_answered(task) {
                return Ok(Some(task));
            }
            let answer = self.call(task, false);
            self.settle(task, answer);
        }
    }

    /// The instant at which the program is ended at the latest.
    fn limit_of_program(&self) -> Time<Clock> {
        self.options.limit.map_or(Time::NEVER, |limit| START + limit)
    }

    /// The next event of the environment: a frame is back, or a timer expires.
    fn next_event(&self) -> Time<Clock> {
        let frames = self.flying.iter().map(|answer| answer.at);
        let timers = self.processes.iter().filter_map(Process::next_timer);
        let all = frames.chain(timers).chain([self.objects.next_timer()]);
        all.min().unwrap_or(Time::NEVER)
    }

    /// Applies the new faults of the machine.
    pub(super) fn suffer(&mut self) {
        for fault in self.wire.take_machine_faults() {
            if let MachineFault::ClockJump(by) = fault {
                self.epoch = self.epoch.saturating_add_signed(by.0);
                self.page.words.set(word::EPOCH, self.epoch);
            }
            self.host.suffer(fault);
        }
    }

    /// The next instant at which the segment needs an update. It alone is no reason to advance
    /// time. If the segment asks for the same instant again it gets a slightly later one, since
    /// time would otherwise stand still.
    fn next_look(&self) -> Option<Time<Clock>> {
        let due = self.wire.next_timeout(self.looked)?;
        Some(due.max(self.looked + LEAST_LOOK))
    }

    /// Handles everything that is due by now.
    fn fire(&mut self) {
        let now = self.now();
        while let Some(place) = self.first_back(now) {
            let WireAnswer { at, interface, bytes } = self.flying.swap_remove(place);
            self.figures.received += 1;
            let frame = Arrived { at, interface, bytes: bytes.into() };
            let takers = self.objects.deliver(&frame);
            self.touch(&takers);
        }
        let fired = self.objects.fire_timers(now);
        self.touch(&fired);
        self.fire_process_timers(now);
    }

    /// The frame that was back first, if one is back by now.
    fn first_back(&self, now: Time<Clock>) -> Option<usize> {
        let back = self.flying.iter().enumerate().filter(|(_, answer)| answer.at <= now);
        back.min_by_key(|(at, answer)| (answer.at, *at)).map(|(at, _)| at)
    }

    fn touch(&mut self, objects: &[ObjectId]) {
        for id in objects {
            self.scheduler.touch(Source::Object(*id));
        }
    }

    /// Continues a thread with the answer to its call.
    fn release(&mut self, task: TaskId) -> io::Result<()> {
        if self.last.replace(task) != Some(task) {
            self.figures.switches += 1;
        }
        let Thread { call, reply, goes_outside, .. } = *self.thread(task);
        self.thread(task).stopped = false;
        self.thread(task).goes_outside = false;
        if goes_outside {
            self.scheduler.outside(task);
        } else {
            self.scheduler.run(task);
        }
        let makes_another = self.before_release(task)?;
        let limit = if makes_another { Time::ZERO } else { self.limit(task) };
        self.page.words.set(word::NOW, self.now().count());
        self.page.words.set(word::LIMIT, limit.count());
        match self.listener().reply(call.id, reply) {
            Ok(()) => {}
            // The thread was killed meanwhile.
            Err(error) if error.raw_os_error() == Some(libc::ENOENT) => {}
            Err(error) => return Err(error),
        }
        self.after_release(task)
    }

    /// The instant until which a thread may read the clock, because nothing else is due before.
    fn limit(&self, task: TaskId) -> Time<Clock> {
        let limit = self.limit_of_program();
        let look = self.next_look().unwrap_or(Time::NEVER);
        self.scheduler.next_other(task).min(self.next_event()).min(look).min(limit)
    }

    /// Takes over the time that the program itself has advanced.
    fn take_time_from_page(&mut self) {
        self.scheduler.advance(Time::new(self.page.words.get(word::NOW)));
    }

    fn note(&mut self, what: impl Into<String>) {
        *self.notes.entry(what.into()).or_default() += 1;
    }

    fn thread(&mut self, task: TaskId) -> &mut Thread {
        &mut self.threads[task.0 as usize]
    }

    fn process(&mut self, task: TaskId) -> &mut Process {
        let ProcessId(place) = self.threads[task.0 as usize].process;
        &mut self.processes[place]
    }

    /// Ends the remaining threads of the program.
    fn end(mut self, how: How) -> io::Result<Ended> {
        self.take_time_from_page();
        self.kill_all();
        let numbers: Vec<i32> = self.processes.iter().map(|process| process.number).collect();
        sys::reap_orphans(&numbers);
        if let Some(error) = self.launched.failed() {
            return Err(error);
        }
        self.figures.readings = self.page.words.get(word::READINGS);
        let lasted = self.now() - START;
        Ok(Ended { how, lasted, figures: self.figures, notes: self.notes })
    }

    fn kill_all(&mut self) {
        for process in self.processes.iter().rev().filter(|process| !process.gone) {
            sys::kill(process.number, libc::SIGKILL);
        }
    }
}
