//! Futexes: the queues behind mutexes, condition variables and joins.
//!
//! The word itself is in the program's memory, and the caller reads and writes it. Only one task
//! runs at a time, so comparing a word and joining its queue is one step without a lock.

use super::scheduler::TaskId;

/// The key of a word: an address in one address space, or a place in shared memory.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct FutexKey {
    /// The address space, or the shared memory.
    pub space: u64,
    /// The address, or the place in the shared memory.
    pub place: u64,
}

/// All tasks that wait on words, in the order in which they began to wait.
#[derive(Debug, Default)]
pub struct Futexes {
    waiters: Vec<Waiter>,
}

#[derive(Debug)]
struct Waiter {
    task: TaskId,
    key: FutexKey,
    bits: u32,
    woken: bool,
}

impl Futexes {
    /// Makes the task wait on the word, for wakes that share a bit with `bits`.
    pub fn wait(&mut self, task: TaskId, key: FutexKey, bits: u32) {
        self.leave(task);
        self.waiters.push(Waiter { task, key, bits, woken: false });
    }

    /// Whether the task was woken.
    pub fn is_woken(&self, task: TaskId) -> bool {
        self.waiters.iter().any(|waiter| waiter.task == task && waiter.woken)
    }

    /// Removes the task from its queue: it was woken, its time is over, or it ended.
    pub fn leave(&mut self, task: TaskId) {
        self.waiters.retain(|waiter| waiter.task != task);
    }

    /// Wakes up to `most` of the tasks that wait on the word, in their order. Returns these tasks.
    pub fn wake(&mut self, key: FutexKey, bits: u32, most: usize) -> Vec<TaskId> {
        let fits =
            |waiter: &&mut Waiter| !waiter.woken && waiter.key == key && waiter.bits & bits != 0;
        let mut woken = Vec::new();
        for waiter in self.waiters.iter_mut().filter(fits).take(most) {
            waiter.woken = true;
            woken.push(waiter.task);
        }
        woken
    }

    /// Moves up to `most` of the tasks that wait on one word to another word. Returns their number.
    pub fn requeue(&mut self, from: FutexKey, to: FutexKey, most: usize) -> usize {
        let waits = |waiter: &&mut Waiter| !waiter.woken && waiter.key == from;
        let moved = self.waiters.iter_mut().filter(waits).take(most);
        moved.map(|waiter| waiter.key = to).count()
    }

    /// Number of tasks that wait on the word.
    pub fn count(&self, key: FutexKey) -> usize {
        self.waiters.iter().filter(|waiter| !waiter.woken && waiter.key == key).count()
    }

    /// The word on which a task waits.
    pub fn key_of(&self, task: TaskId) -> Option<FutexKey> {
        self.waiters.iter().find(|waiter| waiter.task == task).map(|waiter| waiter.key)
    }
}

/// The result of asking for a lock with priority inheritance, whose word holds the owner's thread
/// number.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum PiLock {
    /// The lock is free: the caller takes it by writing this word.
    Taken(u32),
    /// The caller already owns the lock.
    Own,
    /// Another thread owns the lock: this is the new word, and the caller waits.
    Held(u32),
}

/// Bit 31 of the word: other threads wait.
const WAITERS: u32 = 0x8000_0000;
/// Bits 0 to 29: the owner's thread number.
const OWNER: u32 = 0x3FFF_FFFF;

impl PiLock {
    /// Evaluates the word of a lock for which a thread asks.
    pub fn ask(word: u32, thread: u32) -> Self {
        match word & OWNER {
            0 => Self::Taken(thread | word & WAITERS),
            owner if owner == thread => Self::Own,
            _ => Self::Held(word | WAITERS),
        }
    }

    /// The word of the lock when `next` gets it and others may still wait; without `next` the lock
    /// is free.
    pub fn hand_over(next: Option<u32>, others_wait: bool) -> u32 {
        next.map_or(0, |thread| thread | if others_wait { WAITERS } else { 0 })
    }

    /// Whether this thread owns the lock and may release it.
    pub fn is_owner(word: u32, thread: u32) -> bool {
        word & OWNER == thread
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const A: FutexKey = FutexKey { space: 1, place: 0x1000 };
    const B: FutexKey = FutexKey { space: 1, place: 0x1004 };

    fn three_on_a() -> Futexes {
        let mut futexes = Futexes::default();
        (0..3).for_each(|task| futexes.wait(TaskId(task), A, !0));
        futexes
    }

    #[test]
    fn first_come_first_served() {
        let mut futexes = three_on_a();
        assert_eq!(futexes.wake(B, !0, 9), []);
        assert_eq!(futexes.wake(A, !0, 2), [TaskId(0), TaskId(1)]);
        assert!(futexes.is_woken(TaskId(0)) && !futexes.is_woken(TaskId(2)));
        futexes.leave(TaskId(0));
        assert_eq!(futexes.wake(A, !0, 9), [TaskId(2)]);
    }

    #[test]
    fn the_same_place_in_another_space_is_another_word() {
        let mut futexes = three_on_a();
        assert_eq!(futexes.wake(FutexKey { space: 2, ..A }, !0, 9), []);
    }

    #[test]
    fn bits_choose() {
        let mut futexes = Futexes::default();
        futexes.wait(TaskId(0), A, 0b01);
        futexes.wait(TaskId(1), A, 0b10);
        assert_eq!(futexes.wake(A, 0b10, 9), [TaskId(1)]);
    }

    #[test]
    fn requeued_tasks_wait_on_the_other_word() {
        let mut futexes = three_on_a();
        assert_eq!(futexes.wake(A, !0, 1), [TaskId(0)]);
        assert_eq!(futexes.requeue(A, B, 1), 1);
        assert_eq!((futexes.count(A), futexes.count(B)), (1, 1));
        assert_eq!(futexes.wake(B, !0, 9), [TaskId(1)]);
    }

    #[test]
    fn a_lock_goes_from_owner_to_owner() {
        assert_eq!(PiLock::ask(0, 7), PiLock::Taken(7));
        assert_eq!(PiLock::ask(7, 7), PiLock::Own);
        assert_eq!(PiLock::ask(7, 8), PiLock::Held(7 | WAITERS));
        assert!(PiLock::is_owner(7 | WAITERS, 7) && !PiLock::is_owner(7 | WAITERS, 8));
        assert_eq!(PiLock::hand_over(Some(8), true), 8 | WAITERS);
        assert_eq!(PiLock::hand_over(None, false), 0);
    }
}
