//! The tasks, the running task, and virtual time.

use isocat_wire::time::{Host, Nanos, Time};

use super::futex::FutexKey;
use super::object::ObjectId;

/// The number of a program's thread, in the order of their creation.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct TaskId(pub u32);

/// What a waiting task waits for, apart from an instant.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Source {
    /// A change of an object: bytes arrived, a timer expired, a member joined a set.
    Object(ObjectId),
    /// A wake of this futex by another task.
    Futex(FutexKey),
    /// The end of a child process.
    Child,
    /// A signal for the task.
    Signal,
}

/// Decides which task runs next, and when.
///
/// A task is added as running. The caller reports for each running task that its call [is
/// answered](Self::answered) or that it [waits](Self::wait). When no task runs any more,
/// [`next`](Self::next) names the next task; the caller lets time [advance](Self::advance) to the
/// instant at which it is due.
#[derive(Debug)]
pub struct Scheduler {
    now: Time<Host>,
    tasks: Vec<Task>,
    sequence: u64,
}

#[derive(Debug)]
struct Task {
    state: State,
    /// The instant from which it may run; [`Time::NEVER`] until it is woken.
    due: Time<Host>,
    /// Of the tasks due at the same instant, the one with the highest priority runs first; of
    /// those, the one that has waited longest for its turn.
    priority: u8,
    turn: u64,
    sources: Vec<Source>,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum State {
    Running,
    Answered,
    Waiting,
    /// In a call to the outside, as long as that call takes.
    Outside,
    Gone,
}

impl Scheduler {
    /// A scheduler without tasks, at `now`.
    pub fn new(now: Time<Host>) -> Self {
        Self { now, tasks: Vec::new(), sequence: 0 }
    }

    /// The present virtual time.
    pub fn now(&self) -> Time<Host> {
        self.now
    }

    /// Advances time by the cost of a call.
    pub fn spend(&mut self, cost: Nanos) {
        self.now += cost;
    }

    /// Advances time to `to`, if that lies ahead.
    pub fn advance(&mut self, to: Time<Host>) {
        self.now = self.now.max(to);
    }

    /// Adds a running task, in the slot of one that has ended if there is one.
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

    /// Sets the priority of a task, 0 to 99, as for `SCHED_FIFO`.
    pub fn set_priority(&mut self, task: TaskId, priority: u8) {
        self.task(task).priority = priority;
    }

    /// The task's call is answered: it may continue when its turn comes.
    pub fn answered(&mut self, task: TaskId) {
        let (now, turn) = (self.now, self.turn());
        let task = self.task(task);
        task.state = State::Answered;
        task.sources.clear();
        (task.due, task.turn) = (now, turn);
    }

    /// The task waits until an instant, or until one of the sources is [touched](Self::touch).
    pub fn wait(&mut self, task: TaskId, until: Time<Host>, sources: &[Source]) {
        let turn = self.turn();
        let task = self.task(task);
        task.state = State::Waiting;
        task.sources.clear();
        task.sources.extend_from_slice(sources);
        (task.due, task.turn) = (until, turn);
    }

    /// The task went into a call to the outside, which takes real time. The others continue
    /// meanwhile.
    pub fn outside(&mut self, task: TaskId) {
        self.task(task).state = State::Outside;
    }

    /// The task runs from now on.
    pub fn run(&mut self, task: TaskId) {
        self.task(task).state = State::Running;
    }

    /// The task has ended.
    pub fn end(&mut self, task: TaskId) {
        let task = self.task(task);
        task.state = State::Gone;
        task.sources = Vec::new();
    }

    /// Wakes all tasks that wait for this source, so that they check their condition again.
    pub fn touch(&mut self, source: Source) {
        for at in 0..self.tasks.len() {
            let task = &self.tasks[at];
            if task.state == State::Waiting && task.sources.contains(&source) {
                self.wake(TaskId(at as u32));
            }
        }
    }

    /// Wakes one task if it waits: it is due now.
    pub fn wake(&mut self, task: TaskId) {
        let (now, turn) = (self.now, self.turn());
        let task = self.task(task);
        if task.state == State::Waiting && task.due > now {
            (task.due, task.turn) = (now, turn);
        }
    }

    /// The next task to run, and the instant from which it may; [`Time::NEVER`] if all wait for
    /// something that cannot happen. `None`: no task can run.
    pub fn next(&self) -> Option<(TaskId, Time<Host>)> {
        self.waiting_for_turn()
            .min_by_key(|(_, task)| {
                (task.due.max(self.now), 100 - task.priority.min(99), task.turn)
            })
            .map(|(at, task)| (TaskId(at as u32), task.due))
    }

    /// The instant at which another task than this one is due; until then the running one need not
    /// stop.
    pub fn next_other(&self, running: TaskId) -> Time<Host> {
        let others = self.waiting_for_turn().filter(|(at, _)| *at != running.0 as usize);
        others.map(|(_, task)| task.due).min().unwrap_or(Time::NEVER)
    }

    /// Whether the task waits.
    pub fn is_waiting(&self, task: TaskId) -> bool {
        self.tasks[task.0 as usize].state == State::Waiting
    }

    /// Whether the task's call is answered and its turn has not come yet.
    pub fn is_answered(&self, task: TaskId) -> bool {
        self.tasks[task.0 as usize].state == State::Answered
    }

    /// Whether the task runs, between two calls.
    pub fn is_running(&self, task: TaskId) -> bool {
        self.tasks[task.0 as usize].state == State::Running
    }

    /// Whether the task is in a call to the outside.
    pub fn is_outside(&self, task: TaskId) -> bool {
        self.tasks[task.0 as usize].state == State::Outside
    }

    /// Whether the task has ended.
    pub fn is_gone(&self, task: TaskId) -> bool {
        self.tasks[task.0 as usize].state == State::Gone
    }

    /// The sources that the task waits for.
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
        // A task that became due in the past is due now like the others: the priority decides.
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
