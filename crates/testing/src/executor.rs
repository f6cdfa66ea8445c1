//! Tasks, polled one at a time in the order in which they were woken.
//!
//! The executor owns the futures: a stack may keep wakers in memory that outlives the run, and a
//! waker keeps nothing else alive.

use std::cell::{Cell, RefCell};
use std::collections::{BTreeMap, VecDeque};
use std::pin::Pin;
use std::rc::{Rc, Weak};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll, Wake, Waker};

use crate::clock::Clock;

/// Number of a task.
pub(crate) type Id = u64;
/// The test itself, which is not in the list of tasks.
pub(crate) const ROOT: Id = 0;

pub(crate) struct Executor {
    tasks: RefCell<BTreeMap<Id, Entry>>,
    last: Cell<Id>,
    ready: Arc<Ready>,
}

struct Entry {
    /// `None` while the task is polled.
    future: Option<BoxFuture>,
    waker: Waker,
}

type BoxFuture = Pin<Box<dyn Future<Output = ()>>>;

/// Tasks that were woken, in order.
#[derive(Default)]
struct Ready(Mutex<VecDeque<Arc<Wakes>>>);

struct Wakes {
    id: Id,
    is_queued: AtomicBool,
    ready: Arc<Ready>,
}

/// What a task and its [`Task`] share.
struct Slot<T> {
    output: Option<T>,
    waits: Option<Waker>,
}

/// A future that runs concurrently with the test; see [`Bus::spawn`](crate::Bus::spawn). Awaiting
/// it returns its output.
///
/// If this is dropped, the future continues until the test ends.
#[must_use = "what a task comes to, perhaps an error, is lost unless the task is awaited"]
pub struct Task<T> {
    slot: Rc<RefCell<Slot<T>>>,
    id: Id,
    executor: Weak<Executor>,
}

impl Executor {
    /// An executor without tasks, and the waker of the test itself, which is already woken.
    pub fn new() -> (Rc<Self>, Waker) {
        let ready = Arc::new(Ready::default());
        let root = Wakes::waker(ROOT, &ready);
        let tasks = RefCell::new(BTreeMap::new());
        (Rc::new(Self { tasks, last: Cell::new(ROOT), ready }), root)
    }

    /// Adds a task, which is polled for the first time when its turn comes.
    pub fn spawn<F>(self: &Rc<Self>, future: F) -> Task<F::Output>
    where
        F: Future + 'static,
    {
        let id = self.last.get() + 1;
        self.last.set(id);
        let slot = Rc::new(RefCell::new(Slot { output: None, waits: None }));
        let filled = Rc::clone(&slot);
        let future = Box::pin(async move {
            let output = future.await;
            let waits = {
                let mut slot = filled.borrow_mut();
                slot.output = Some(output);
                slot.waits.take()
            };
            if let Some(waker) = waits {
                waker.wake();
            }
        });
        let entry = Entry { future: Some(future), waker: Wakes::waker(id, &self.ready) };
        self.tasks.borrow_mut().insert(id, entry);
        Task { slot, id, executor: Rc::downgrade(self) }
    }

    /// The number of woken tasks.
    pub fn ready(&self) -> usize {
        self.ready.lock().len()
    }

    /// Takes the task that was woken first.
    pub fn take_ready(&self) -> Option<Id> {
        let woken = self.ready.lock().pop_front()?;
        woken.is_queued.store(false, Ordering::Relaxed);
        Some(woken.id)
    }

    /// Polls a task, if it still exists.
    pub fn poll(&self, id: Id, clock: &Clock) {
        let Some((mut future, waker)) = self.begin(id) else { return };
        let is_over = poll(future.as_mut(), &waker, clock).is_ready();
        let mut tasks = self.tasks.borrow_mut();
        if is_over {
            tasks.remove(&id);
        } else if let Some(entry) = tasks.get_mut(&id) {
            entry.future = Some(future);
            return;
        }
        // Dropping the future may drop or cancel other tasks, so the list must not be borrowed.
        drop(tasks);
        drop(future);
    }

    fn begin(&self, id: Id) -> Option<(BoxFuture, Waker)> {
        let mut tasks = self.tasks.borrow_mut();
        let entry = tasks.get_mut(&id)?;
        Some((entry.future.take()?, entry.waker.clone()))
    }

    /// The number of tasks.
    pub fn tasks(&self) -> usize {
        self.tasks.borrow().len()
    }

    /// Drops all tasks, the oldest first.
    pub fn clear(&self) {
        let first = || self.tasks.borrow_mut().pop_first();
        while let Some(task) = first() {
            drop(task);
        }
    }
}

/// Polls a future after forgetting its timers, which it adds again.
pub(crate) fn poll<F: Future + ?Sized>(
    future: Pin<&mut F>,
    waker: &Waker,
    clock: &Clock,
) -> Poll<F::Output> {
    clock.forget(waker);
    future.poll(&mut Context::from_waker(waker))
}

impl<T> Task<T> {
    /// Ends the task where it waits, and drops its future.
    pub fn cancel(self) {
        let Some(executor) = self.executor.upgrade() else { return };
        let task = executor.tasks.borrow_mut().remove(&self.id);
        drop(task);
    }

    /// Whether the future has finished.
    pub fn is_finished(&self) -> bool {
        self.slot.borrow().output.is_some()
    }
}

impl<T> Future for Task<T> {
    type Output = T;

    fn poll(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<T> {
        let mut slot = self.slot.borrow_mut();
        match slot.output.take() {
            Some(output) => Poll::Ready(output),
            None => {
                slot.waits = Some(context.waker().clone());
                Poll::Pending
            }
        }
    }
}

impl Wakes {
    /// The waker of a task, which is already woken.
    fn waker(id: Id, ready: &Arc<Ready>) -> Waker {
        let is_queued = AtomicBool::new(false);
        let waker = Waker::from(Arc::new(Self { id, is_queued, ready: Arc::clone(ready) }));
        waker.wake_by_ref();
        waker
    }
}

impl Wake for Wakes {
    fn wake(self: Arc<Self>) {
        if !self.is_queued.swap(true, Ordering::Relaxed) {
            let ready = Arc::clone(&self.ready);
            ready.lock().push_back(self);
        }
    }
}

impl Ready {
    fn lock(&self) -> MutexGuard<'_, VecDeque<Arc<Wakes>>> {
        // A panic never leaves the list half changed.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
