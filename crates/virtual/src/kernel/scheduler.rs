//! Tasks, the one that runs, and virtual time.

use isocat_wire::time::{Host, Nanos, Time};

use super::futex::FutexKey;
use super::object::ObjectId;

/// A thread of a program, in the order in which they began.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct TaskId(pub u32);

/// What a waiting task waits for, beside an instant.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Source {
    /// Something about an object changed: bytes came, a timer expired, a member joined a set.
    Object(ObjectId),
    /// A futex on which another task calls wake.
    Futex(FutexKey),
    /// A child process ended.
    Child,
    /// A signal for it.
    Signal,
}

/// Decides who runs next, and when.
///
/// A task is added as running. Whoever drives the scheduler says of a running task either that its
/// call [is answered](Self::answered) or that it [waits](Self::wait); when no task runs any more,
/// [`next`](Self::next) names the one to go on, after the caller let time [advance](Self::advance)
/// to the instant it is due.
#[derive(Debug)]
pub struct Scheduler {
    now: Time<Host>,
    tasks: Vec<Task>,
    sequence: u64,
}

#[derive(Debug)]
struct Task {
    state: State,
    /// From when on it may run; [`Time::NEVER`] until something wakes it.
    due: Time<Host>,
    /// Of tasks that are due at the same instant the one with the higher priority runs first, and
    /// of those with the same the one that has been waiting for its turn for longer.
    priority: u8,
    turn: u64,
    sources: Vec<Source>,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum State {
    Running,
    Answered,
    Waiting,
    /// In a call to the world outside, for as long as that takes.
    Outside,
    Gone,
}

impl Scheduler {
    /// No task, at `now`.
    pub fn new(now: Time<Host>) -> Self {
        Self { now, tasks: Vec::new(), sequence: 0 }
    }

    /// Virtual time.
    pub fn now(&self) -> Time<Host> {
        self.now
    }

    /// A call took this long.
    pub fn spend(&mut self, cost: Nanos) {
        self.now += cost;
    }

    /// Time goes on to `to`, if it lies ahead.
    pub fn advance(&mut self, to: Time<Host>) {
        self.now = self.now.max(to);
    }

    /// A task begins to run, in the place of one that ended if there is such.
    pub fn add(&mut self) -> TaskId {
        let task = Task {
            state: State::Running,
            due: self.now,
            priority: 0,
            turn: 0,
            sources: Vec::new(),
        };
        let free = self.tasks.iter().position(|task| task.state == State::Gone);
        let place = free.unwrap_or(self.tasks.len());
        match free {
            Some(place) => self.tasks[place] = task,
            None => self.tasks.push(task),
        }
        TaskId(place as u32)
    }

    /// Its priority, 0 to 99, as of `SCHED_FIFO`.
    pub fn set_priority(&mut self, task: TaskId, priority: u8) {
        self.task(task).priority = priority;
    }

    /// Its call is answered: it may go on when its turn comes.
    pub fn answered(&mut self, task: TaskId) {
        let (now, turn) = (self.now, self.turn());
        let task = self.task(task);
        task.state = State::Answered;
        task.sources.clear();
        (task.due, task.turn) = (now, turn);
    }

    /// It waits until an instant, or until one of the sources is [touched](Self::touch).
    pub fn wait(&mut self, task: TaskId, until: Time<Host>, sources: &[Source]) {
        let turn = self.turn();
        let task = self.task(task);
        task.state = State::Waiting;
        task.sources.clear();
        task.sources.extend_from_slice(sources);
        (task.due, task.turn) = (until, turn);
    }

    /// It went into a call to the world outside, which takes real time. The others go on meanwhile.
    pub fn outside(&mut self, task: TaskId) {
        self.task(task).state = State::Outside;
    }

    /// It runs from now on.
    pub fn run(&mut self, task: TaskId) {
        self.task(task).state = State::Running;
    }

    /// It is no more.
    pub fn end(&mut self, task: TaskId) {
        let task = self.task(task);
        task.state = State::Gone;
        task.sources = Vec::new();
    }

    /// Wakes all tasks that wait for this source: they look again at what they wait for.
    pub fn touch(&mut self, source: Source) {
        for at in 0..self.tasks.len() {
            let task = &self.tasks[at];
            if task.state == State::Waiting && task.sources.contains(&source) {
                self.wake(TaskId(at as u32));
            }
        }
    }

    /// Wakes one task, if it waits: it is due now.
    pub fn wake(&mut self, task: TaskId) {
        let (now, turn) = (self.now, self.turn());
        let task = self.task(task);
        if task.state == State::Waiting && task.due > now {
            (task.due, task.turn) = (now, turn);
        }
    }

    /// The task that is to go on next, and from when on it may; [`Time::NEVER`] if all wait for
    /// what nobody will do. `None`: there is none that could.
    pub fn next(&self) -> Option<(TaskId, Time<Host>)> {
        self.waiting_for_turn()
            .min_by_key(|(_, task)| {
                (task.due.max(self.now), 100 - task.priority.min(99), task.turn)
            })
            .map(|(at, task)| (TaskId(at as u32), task.due))
    }

    /// When another task than this one is due: until then it need not be stopped.
    pub fn next_other(&self, running: TaskId) -> Time<Host> {
        let others = self.waiting_for_turn().filter(|(at, _)| *at != running.0 as usize);
        others.map(|(_, task)| task.due).min().unwrap_or(Time::NEVER)
    }

    /// Whether it waits.
    pub fn is_waiting(&self, task: TaskId) -> bool {
        self.tasks[task.0 as usize].state == State::Waiting
    }

    /// Whether its call is answered and its turn has not come yet.
    pub fn is_answered(&self, task: TaskId) -> bool {
        self.tasks[task.0 as usize].state == State::Answered
    }

    /// Whether it runs, between two calls.
    pub fn is_running(&self, task: TaskId) -> bool {
        self.tasks[task.0 as usize].state == State::Running
    }

    /// Whether it is in a call to the world outside.
    pub fn is_outside(&self, task: TaskId) -> bool {
        self.tasks[task.0 as usize].state == State::Outside
    }

    /// Whether it has ended.
    pub fn is_gone(&self, task: TaskId) -> bool {
        self.tasks[task.0 as usize].state == State::Gone
    }

    /// What it waits for.
    pub fn sources(&self, task: TaskId) -> &[Source] {
        &self.tasks[task.0 as usize].sources
    }

    /// All tasks that have not ended.
    pub fn alive(&self) -> impl Iterator<Item = TaskId> {
        let alive = self.tasks.iter().enumerate().filter(|(_, task)| task.state != State::Gone);
        alive.map(|(at, _)| TaskId(at as u32))
    }

    fn waiting_for_turn(&self) -> impl Iterator<Item = (usize, &Task)> {
        let may = |task: &Task| matches!(task.state, State::Answered | State::Waiting);
        self.tasks.iter().enumerate().filter(move |(_, task)| may(task))
    }

    fn task(&mut self, task: TaskId) -> &mut Task {
        &mut self.tasks[task.0 as usize]
    }

    fn turn(&mut self) -> u64 {
        self.sequence += 1;
        self.sequence
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ns: u64) -> Time<Host> {
        Time::new(ns)
    }

    #[test]
    fn the_earliest_goes_first() {
        let mut scheduler = Scheduler::new(at(100));
        let [a, b] = [scheduler.add(), scheduler.add()];
        scheduler.wait(a, at(201), &[]);
        scheduler.wait(b, at(200), &[]);
        assert_eq!(scheduler.next(), Some((b, at(200))));
        scheduler.wait(b, at(202), &[]);
        assert_eq!(scheduler.next(), Some((a, at(201))));
    }

    #[test]
    fn of_two_that_are_due_the_one_that_waited_longer_goes_first_unless_priorities_differ() {
        let mut scheduler = Scheduler::new(at(100));
        let [a, b] = [scheduler.add(), scheduler.add()];
        scheduler.answered(b);
        scheduler.answered(a);
        assert_eq!(scheduler.next(), Some((b, at(100))));
        scheduler.set_priority(a, 1);
        assert_eq!(scheduler.next(), Some((a, at(100))));
        // What became due in the past is due now, as all else is: the priority decides.
        scheduler.spend(Nanos(5));
        scheduler.wait(a, at(105), &[]);
        assert_eq!(scheduler.next(), Some((a, at(105))));
    }

    #[test]
    fn a_touched_source_wakes_those_that_wait_for_it_and_no_other() {
        let mut scheduler = Scheduler::new(at(100));
        let [a, b] = [scheduler.add(), scheduler.add()];
        scheduler.wait(a, Time::NEVER, &[Source::Object(ObjectId(1))]);
        scheduler.wait(b, at(500), &[Source::Child, Source::Object(ObjectId(2))]);
        scheduler.touch(Source::Object(ObjectId(2)));
        assert_eq!(scheduler.next(), Some((b, at(100))));
        scheduler.wait(b, at(500), &[Source::Child]);
        scheduler.touch(Source::Object(ObjectId(2)));
        assert_eq!(scheduler.next(), Some((b, at(500))));
    }

    #[test]
    fn those_outside_and_those_that_ended_get_no_turn() {
        let mut scheduler = Scheduler::new(at(100));
        let [a, b] = [scheduler.add(), scheduler.add()];
        scheduler.outside(a);
        scheduler.answered(b);
        scheduler.end(b);
        assert_eq!(scheduler.next(), None);
        scheduler.answered(a);
        assert_eq!(scheduler.next(), Some((a, at(100))));
    }

    #[test]
    fn the_place_of_one_that_ended_is_used_again() {
        let mut scheduler = Scheduler::new(at(100));
        let [a, b] = [scheduler.add(), scheduler.add()];
        scheduler.end(a);
        assert_eq!(scheduler.add(), a);
        assert_eq!(scheduler.alive().collect::<Vec<_>>(), [a, b]);
    }

    #[test]
    fn a_running_task_need_not_stop_before_another_is_due() {
        let mut scheduler = Scheduler::new(at(100));
        let [a, b] = [scheduler.add(), scheduler.add()];
        assert_eq!(scheduler.next_other(a), Time::NEVER);
        scheduler.wait(b, at(700), &[]);
        assert_eq!(scheduler.next_other(a), at(700));
    }
}
