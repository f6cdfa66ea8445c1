//! Runs a program whose system calls are answered from virtual time.
//!
//! Data's way: a call stops its thread, `Supervisor` receives it and lets `calls` answer it, or the
//! thread waits. When all threads have stopped, the virtual kernel's scheduler names the one to go
//! on, time is let on to where that one is due, and it gets its answer. `launch` looks at the
//! program before it is started, `filter` says which calls stop. `program` keeps processes, threads
//! and their descriptors, `life` lets them begin and end; `image` changes what a program reads its
//! clocks by, as `vdso` has it. `watchdog` notices what is no call.

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

/// How a program is to be run.
#[derive(Clone, Debug)]
pub struct Options {
    /// The interfaces that exist for the program, one for each port of the segment.
    pub interfaces: Vec<String>,
    /// What its calls cost.
    pub costs: Costs,
    /// The bad luck of its machine.
    pub luck: Luck,
    /// It is ended at this virtual time after its start; `None`: it ends by itself.
    pub limit: Option<Nanos>,
    /// Set from elsewhere: the program is to end now.
    pub stop: Arc<AtomicBool>,
}

/// What became of a program.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Ended {
    /// How it ended.
    pub how: How,
    /// Virtual time from its start to its end.
    pub lasted: Nanos,
    /// What was counted meanwhile.
    pub figures: Figures,
    /// Calls that were refused, or done otherwise than a kernel would: in words, and how often.
    pub notes: BTreeMap<String, u64>,
}

/// How a program ended.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum How {
    /// By itself.
    Itself(Ending),
    /// The time that it was given is over.
    Limit,
    /// It was asked to stop from outside.
    Stopped,
    /// All its threads wait for what nobody will do: who waits for what.
    Deadlock(Vec<String>),
    /// A thread makes no call: for so long in real time, and where it is.
    Spins(Vec<String>),
}

/// What was counted.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Figures {
    /// Calls that stopped a thread.
    pub stops: u64,
    /// Readings of the clock that stopped none.
    pub readings: u64,
    /// Times at which another thread went on than the one that had stopped.
    pub switches: u64,
    /// Frames that were sent.
    pub sent: u64,
    /// Frames that came back to the host.
    pub received: u64,
    /// Threads of all processes.
    pub threads: u64,
    /// Processes.
    pub processes: u64,
}

/// From one look at a segment to the next, at least.
const LEAST_LOOK: Nanos = Nanos::micros(1);

/// Virtual time at which a program starts.
pub const START: Time<Clock> = Time::new(1_000_000_000);

/// Runs a program to its end.
///
/// # Errors
///
/// It could not be started, or the machine does not let it be supervised; then it was not started.
pub fn run(program: &Program, options: &Options, wire: &mut dyn Wire) -> io::Result<Ended> {
    sys::adopt_orphans();
    let launched = launch::start(program)?;
    let mut supervisor = Supervisor::new(launched, options, wire)?;
    let how = supervisor.serve();
    supervisor.end(how?)
}

/// One program under supervision.
struct Supervisor<'w> {
    launched: Launched,
    options: Options,
    wire: &'w mut dyn Wire,
    host: Host,
    scheduler: Scheduler,
    futexes: Futexes,
    objects: Objects,
    processes: Vec<Process>,
    /// By their task.
    threads: Vec<Thread>,
    /// Answers on their way.
    flying: Vec<WireAnswer>,
    /// Our copies of the program's descriptors of the world outside.
    outside: BTreeMap<ObjectId, OwnedFd>,
    /// The ends of netlink sockets that are ours, by the program's.
    netlinks: BTreeMap<ObjectId, ObjectId>,
    /// The clocks that timers go by.
    timer_clocks: BTreeMap<ObjectId, i32>,
    /// When the segment was looked at last.
    looked: Time<Clock>,
    /// When the last frame set out, and when the last one is back in a socket.
    last_sent: Time<Clock>,
    last_back: Time<Clock>,
    page: ClockPage,
    /// What real-time clocks show beside virtual time, ns since 1970.
    epoch: u64,
    watchdog: Watchdog,
    /// A call makes a thread or a process, which has not made a call of its own yet.
    made: Option<Made>,
    /// A signal was sent: threads that wait may be interrupted by it.
    signalled: bool,
    /// The thread that ran last.
    last: Option<TaskId>,
    end: Option<How>,
    figures: Figures,
    notes: BTreeMap<String, u64>,
}

/// The page that the program's clocks count in.
#[derive(Debug)]
struct ClockPage {
    file: std::fs::File,
    words: SharedWords,
}

/// What is to become of a call.
#[derive(Clone, PartialEq, Eq, Debug)]
enum Outcome {
    /// It gives this.
    Done(i64),
    /// The kernel does it, at once.
    Pass,
    /// The kernel does it, and that may take real time.
    Outside,
    /// The thread waits, and the call is tried again.
    Wait(Time<Clock>, Vec<Source>),
}

/// An error number of a call.
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

    /// Serves calls until the program is no more.
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

    /// Waits until no thread runs, and tries the calls at which they stopped.
    fn collect(&mut self) -> io::Result<()> {
        // A call may let another thread run, as the one does with which a child gets a program of
        // its own.
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
                // The thread was killed between its call and now.
                Err(error) if error.raw_os_error() == Some(libc::ENOENT) => self.look_around()?,
                Err(error) => return Err(error),
            }
        }
        // What several threads did at the same time is taken in their order, whichever came first.
        stopped.sort_unstable();
        for task in stopped {
            self.begin(task)?;
        }
        Ok(())
    }

    fn is_any_running(&self) -> bool {
        self.made.is_some() || self.scheduler.alive().any(|task| self.scheduler.is_running(task))
    }

    /// Which thread made a call; `None`: it is one that is not supervised any more.
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
            // A thread became another one's by replacing the program.
            self.replaced_by(task);
        }
        // It stands still from here on, whatever becomes of its call.
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

    /// Notes what became of a call.
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

    /// Lets time go on until a thread may; gives it. `None`: something else happened.
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

    /// When the program is ended at the latest.
    fn limit_of_program(&self) -> Time<Clock> {
        self.options.limit.map_or(Time::NEVER, |limit| START + limit)
    }

    /// When the world does something next: a frame is back, a timer expires.
    fn next_event(&self) -> Time<Clock> {
        let frames = self.flying.iter().map(|answer| answer.at);
        let timers = self.processes.iter().filter_map(Process::next_timer);
        let all = frames.chain(timers).chain([self.objects.next_timer()]);
        all.min().unwrap_or(Time::NEVER)
    }

    /// What happened to the machine begins to count.
    pub(super) fn suffer(&mut self) {
        for fault in self.wire.take_machine_faults() {
            if let MachineFault::ClockJump(by) = fault {
                self.epoch = self.epoch.saturating_add_signed(by.0);
                self.page.words.set(word::EPOCH, self.epoch);
            }
            self.host.suffer(fault);
        }
    }

    /// When the segment wants to be looked at next, if time goes on at all: that alone is no reason
    /// for it. It may want it again at once, and gets it a little later: else time would stand
    /// still.
    fn next_look(&self) -> Option<Time<Clock>> {
        let due = self.wire.next_timeout(self.looked)?;
        Some(due.max(self.looked + LEAST_LOOK))
    }

    /// What is due by now happens.
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

    /// Lets a thread go on with the answer to its call.
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
            // It was killed meanwhile.
            Err(error) if error.raw_os_error() == Some(libc::ENOENT) => {}
            Err(error) => return Err(error),
        }
        self.after_release(task)
    }

    /// Until when a thread may read the clock without anybody else being due.
    fn limit(&self, task: TaskId) -> Time<Clock> {
        let limit = self.limit_of_program();
        let look = self.next_look().unwrap_or(Time::NEVER);
        self.scheduler.next_other(task).min(self.next_event()).min(look).min(limit)
    }

    /// The program let time go on by itself.
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

    /// Ends what is left of the program.
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
