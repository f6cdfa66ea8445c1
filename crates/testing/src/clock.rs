//! The virtual clock of the run on this thread, and its timers.
//!
//! embassy-time asks for the time by two global functions, which do not say whose time they want.
//! So each thread has its own clock: tests that run concurrently in one process never see each
//! other's time.

use std::cell::{Cell, RefCell};
use std::pin::Pin;
use std::rc::Rc;
use std::task::{Context, Poll, Waker};
use std::time::Duration;

use crate::host::{Host, Instant, nanos};

thread_local! {
    static CLOCK: RefCell<Option<Rc<Clock>>> = const { RefCell::new(None) };
}

/// Virtual time since the run on this thread began.
///
/// # Panics
///
/// Outside a run: on another thread than that of [`run`](crate::run), or before or after the run.
#[track_caller]
pub fn now() -> Duration {
    Duration::from_nanos(Clock::of_this_thread().now())
}

/// Virtual time as nanoseconds since 2000-01-01, the epoch of EtherCAT; runs begin on 2026-01-01.
/// For stacks that ask for the host's time in this form, as ethercrab's `init` does.
///
/// # Panics
///
/// As [`now`].
#[track_caller]
pub fn ethercat_now() -> u64 {
    BEGIN + Clock::of_this_thread().now()
}

/// 2026-01-01 00:00 UTC in nanoseconds since 2000-01-01: 26 years, seven of them with a leap day.
const BEGIN: u64 = (26 * 365 + 7) * 86_400 * 1_000_000_000;

/// A clock that only moves when it is told to.
pub(crate) struct Clock {
    now: Cell<Instant>,
    timers: RefCell<Vec<Timer>>,
    #[cfg(feature = "embassy-time")]
    embassy_asked: Cell<bool>,
    /// The host that the application runs on.
    pub host: RefCell<Host>,
}

struct Timer {
    due: Instant,
    /// When it wakes its task: at `due` or later, depending on the host.
    wakes: Instant,
    waker: Waker,
}

/// Makes a clock the one of this thread, until it is dropped.
pub(crate) struct Installed(());

impl Clock {
    pub fn new(host: Host) -> Rc<Self> {
        Rc::new(Self {
            now: Cell::new(0),
            timers: RefCell::new(Vec::new()),
            #[cfg(feature = "embassy-time")]
            embassy_asked: Cell::new(false),
            host: RefCell::new(host),
        })
    }

    /// # Panics
    ///
    /// If there is a run on this thread already.
    #[track_caller]
    pub fn install(self: &Rc<Self>) -> Installed {
        let before = CLOCK.with(|clock| clock.borrow_mut().replace(Rc::clone(self)));
        if before.is_some() {
            CLOCK.with(|clock| *clock.borrow_mut() = before);
            panic!("a run inside of a run; expected one at a time on a thread");
        }
        Installed(())
    }

    #[track_caller]
    pub fn of_this_thread() -> Rc<Self> {
        let clock = CLOCK.with(|clock| clock.borrow().clone());
        clock.expect("virtual time was asked for outside of a run; expected the thread of `isocat_testing::run`, while it runs")
    }

    pub fn now(&self) -> Instant {
        self.now.get()
    }

    /// Advances time to `to`, unless that has passed.
    pub fn advance(&self, to: Instant) {
        self.now.set(to.max(self.now()));
    }

    /// Wakes exactly at `due`: for the test itself.
    pub fn wake_at(&self, due: Instant, waker: &Waker) {
        self.add(Timer { due, wakes: due, waker: waker.clone() });
    }

    /// Wakes at `due` or later, as the host decides: for the application.
    pub fn wake_host_at(&self, due: Instant, waker: &Waker) {
        if due <= self.now() {
            return waker.wake_by_ref();
        }
        let wakes = self.host.borrow().wakes(due);
        self.add(Timer { due, wakes, waker: waker.clone() });
    }

    fn add(&self, timer: Timer) {
        let mut timers = self.timers.borrow_mut();
        let is_same =
            |other: &Timer| other.wakes == timer.wakes && other.waker.will_wake(&timer.waker);
        if !timers.iter().any(is_same) {
            timers.push(timer);
        }
    }

    /// Forgets the timers of a task that is about to be polled: it adds those that it still waits
    /// for. So dropped timers wake nothing.
    pub fn forget(&self, waker: &Waker) {
        self.timers.borrow_mut().retain(|timer| !timer.waker.will_wake(waker));
    }

    /// When the next timer wakes its task.
    pub fn next_timer(&self) -> Option<Instant> {
        self.timers.borrow().iter().map(|timer| timer.wakes).min()
    }

    /// Wakes the tasks whose timers are due. A host that wakes up late handles all its timers that
    /// are due by then.
    pub fn fire(&self) {
        let now = self.now();
        let mut timers = self.timers.borrow_mut();
        let is_awake = timers.iter().any(|timer| timer.wakes <= now && timer.due < timer.wakes);
        let is_over = |timer: &mut Timer| timer.wakes <= now || is_awake && timer.due <= now;
        let mut over: Vec<Timer> = timers.extract_if(.., is_over).collect();
        drop(timers);
        over.sort_by_key(|timer| timer.due);
        over.into_iter().for_each(|timer| timer.waker.wake());
    }

    /// Notes that embassy-time asked for a timer.
    #[cfg(feature = "embassy-time")]
    pub fn note_embassy(&self) {
        self.embassy_asked.set(true);
    }

    /// Whether embassy-time has asked for a timer.
    #[cfg(feature = "embassy-time")]
    pub fn has_embassy_asked(&self) -> bool {
        self.embassy_asked.get()
    }
}

impl Drop for Installed {
    fn drop(&mut self) {
        CLOCK.with(|clock| clock.borrow_mut().take());
    }
}

/// Waits for an instant; see [`Bus::sleep`](crate::Bus::sleep).
#[derive(Debug)]
#[must_use = "a future does nothing unless it is awaited"]
pub struct Sleep {
    until: Instant,
    /// Whether the application sleeps, so that its host may wake it late.
    on_the_host: bool,
}

impl Sleep {
    pub(crate) fn new(time: Duration, on_the_host: bool) -> Self {
        let until = Clock::of_this_thread().now().saturating_add(nanos(time));
        Self { until, on_the_host }
    }
}

impl Future for Sleep {
    type Output = ();

    fn poll(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<()> {
        let clock = Clock::of_this_thread();
        if clock.now() >= self.until {
            return Poll::Ready(());
        }
        match self.on_the_host {
            true => clock.wake_host_at(self.until, context.waker()),
            false => clock.wake_at(self.until, context.waker()),
        }
        Poll::Pending
    }
}
