//! A run: polls the test's future and its tasks until all of them wait, then advances time to the
//! next event.

use std::fmt;
use std::panic::AssertUnwindSafe;
use std::pin::{Pin, pin};
use std::rc::Rc;
use std::task::Waker;
use std::time::Duration;

use crate::clock::Clock;
use crate::executor::{Executor, ROOT, poll};
use crate::host::{Host, Instant, nanos};
use crate::{Bus, Segment, Verdict, bus};

/// Runs a test on a virtual segment, in virtual time, and returns the verdict of its judges. The
/// run ends when `test` ends.
///
/// # Panics
///
/// If the run can't end, with the text of [`try_run`]'s error.
#[track_caller]
pub fn run<T>(segment: Segment, test: T) -> Verdict
where
    T: AsyncFnOnce(Bus),
{
    match try_run(segment, test) {
        Ok(verdict) => verdict,
        Err(failure) => panic!("{failure}"),
    }
}

/// Runs a test like [`run`], and returns an error if the run can't end. Panics of the test remain
/// panics.
///
/// # Errors
///
/// A [`Failure`] if the run can't end.
///
/// # Panics
///
/// If there is a run on this thread already.
#[track_caller]
pub fn try_run<T>(mut segment: Segment, test: T) -> Result<Verdict, Box<Failure>>
where
    T: AsyncFnOnce(Bus),
{
    let clock = Clock::new(Host::new(segment.scenario.seed, segment.lateness, segment.latency));
    let limit = nanos(segment.limit).min(bus::longest());
    let _installed = clock.install();
    let (executor, waker) = Executor::new();
    let bus = Bus::new(&mut segment, Rc::clone(&clock), Rc::clone(&executor));
    let _tasks = Tasks(Rc::clone(&executor));
    let ended = {
        let root = pin!(test(bus.clone()));
        Run { bus: &bus, clock: &clock, executor: &executor, waker, limit }.to_its_end(root)
    };
    executor.clear();
    let verdict = bus.0.finish();
    match ended {
        Ok(()) => Ok(verdict),
        Err(kind) => Err(Box::new(Failure { kind, devices: bus.states(), verdict })),
    }
}

/// Runs a test once for each seed, in order, until one fails. With `ISOCAT_SEED=17` in the
/// environment it only runs for seed 17.
///
/// ```
/// use isocat_testing::{Segment, run, seeds};
///
/// seeds(0..3, |seed| {
///     let verdict = run(Segment::built_in().seed(seed), async |bus| assert!(!bus.all_op()));
///     assert!(verdict.as_expected(), "{verdict}");
/// });
/// ```
///
/// # Panics
///
/// If the test panics, with the seed; and if there is no seed.
#[track_caller]
pub fn seeds(seeds: impl IntoIterator<Item = u64>, test: impl Fn(u64)) {
    let only = std::env::var("ISOCAT_SEED").ok();
    let only = only.map(|text| match text.parse::<u64>() {
        Ok(seed) => seed,
        Err(_) => panic!("ISOCAT_SEED is \"{text}\"; expected a seed, such as 17"),
    });
    let chosen = seeds.into_iter().filter(|seed| only.is_none_or(|only| only == *seed));
    let mut count = 0;
    for seed in chosen {
        count += 1;
        if let Err(panic) = std::panic::catch_unwind(AssertUnwindSafe(|| test(seed))) {
            let what = panic.downcast_ref::<String>().map(String::as_str);
            let what = what.or_else(|| panic.downcast_ref::<&str>().copied());
            let name = std::thread::current().name().unwrap_or_default().to_owned();
            panic!(
                "seed {seed} failed, after {} that did not. Once more, alone: ISOCAT_SEED={seed} cargo test {name}\n{}",
                count - 1,
                what.unwrap_or("it panicked")
            );
        }
    }
    match only {
        _ if count > 0 => {}
        Some(only) => panic!("ISOCAT_SEED is {only}; expected one of the seeds of this test"),
        None => panic!("no seed; expected at least one, such as 0..100"),
    }
}

/// Why a run can't end.
#[derive(Clone, PartialEq, Debug)]
pub struct Failure {
    /// The kind of failure.
    pub kind: Kind,
    /// What the MainDevice did until then, and the verdict of the judges.
    pub verdict: Verdict,
    /// Each device and its state.
    devices: String,
}

/// Why a run can't end.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Kind {
    /// The test and all its tasks wait, but none of them for a time or for a frame in flight.
    Deadlock {
        /// Number of tasks besides the test.
        tasks: usize,
    },
    /// The virtual time of the run ended before the test.
    OutOfTime {
        /// [`Segment::limit`].
        limit: Duration,
    },
    /// A task always wakes itself, and never waits.
    Spins,
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let at = self.verdict.lasted();
        match self.kind {
            Kind::Deadlock { tasks } => writeln!(
                f,
                "deadlock at {at:?} of virtual time: the test and its tasks ({tasks}) wait, and none of them for a time or a frame"
            )?,
            Kind::OutOfTime { limit } => writeln!(
                f,
                "the test is not over after {limit:?} of virtual time; expected it to end before, or a longer `Segment::limit`"
            )?,
            Kind::Spins => writeln!(
                f,
                "endless loop at {at:?} of virtual time: a task woke itself {MOST_TURNS} times and never waited for a time or a frame"
            )?,
        }
        write!(f, "devices: {}\n{}", self.devices, self.verdict)
    }
}

impl std::error::Error for Failure {}

/// Turns in which a task was ready: after the first number each turn takes time, and at the second
/// the run is considered endless.
const FREE_TURNS: u64 = 100;
const MOST_TURNS: u64 = 1_000_000;
/// Time that such a turn takes, ns, so that a loop that only reads the time ends.
const TURN: Instant = 1_000;

struct Run<'a> {
    bus: &'a Bus,
    clock: &'a Clock,
    executor: &'a Executor,
    waker: Waker,
    limit: Instant,
}

impl Run<'_> {
    fn to_its_end<F: Future<Output = ()>>(&self, mut root: Pin<&mut F>) -> Result<(), Kind> {
        loop {
            if self.while_awake(root.as_mut())? {
                return Ok(());
            }
            let next = [self.clock.next_timer(), self.bus.0.next_arrival()];
            let Some(next) = next.into_iter().flatten().min() else {
                return Err(Kind::Deadlock { tasks: self.executor.tasks() });
            };
            self.go_on(next)?;
        }
    }

    /// Polls all woken tasks until there is none; returns whether the test has ended.
    fn while_awake<F: Future<Output = ()>>(&self, mut root: Pin<&mut F>) -> Result<bool, Kind> {
        for turn in 0..MOST_TURNS {
            let woken = self.executor.ready();
            if woken == 0 {
                return Ok(false);
            }
            if turn >= FREE_TURNS {
                self.go_on(self.clock.now() + TURN)?;
            }
            for _ in 0..woken {
                match self.executor.take_ready() {
                    Some(ROOT) => {
                        if poll(root.as_mut(), &self.waker, self.clock).is_ready() {
                            return Ok(true);
                        }
                    }
                    Some(task) => self.executor.poll(task, self.clock),
                    None => break,
                }
            }
        }
        Err(Kind::Spins)
    }

    /// Advances time, and wakes the tasks that wait for it.
    fn go_on(&self, to: Instant) -> Result<(), Kind> {
        if to > self.limit {
            self.clock.advance(self.limit);
            return Err(Kind::OutOfTime { limit: Duration::from_nanos(self.limit) });
        }
        self.clock.advance(to);
        self.bus.0.arrive();
        self.clock.fire();
        Ok(())
    }
}

/// Drops the tasks however the run ends, because they hold the bus and the bus holds them.
struct Tasks(Rc<Executor>);

impl Drop for Tasks {
    fn drop(&mut self) {
        self.0.clear();
    }
}
