//! The virtual kernel: who runs, who waits, until when, and for what.
//!
//! It knows no system calls, no processes' memory and no real time. One task runs at a time; when it makes a call, the call costs
//! a stated time, and either is answered or the task waits. Time goes on only when all tasks wait: then it jumps to the
//! earliest instant at which a task or the world (a timer, a frame on its way back) is due.
//!
//! - [`Scheduler`]: tasks, their waits, the clock.
//! - [`Futexes`]: the queues behind mutexes, condition variables and joins.
//! - [`Objects`]: what descriptors stand for: packet sockets, timers, event counters, pipes, epoll sets.
//! - [`Host`]: the bad luck of a machine: late wake-ups, slow sends, stalls, each drawn from one seed.

mod epoll;
mod event;
mod futex;
mod host;
mod object;
mod packet;
mod pipe;
mod scheduler;
mod timer;

pub use epoll::{Epoll, Interest};
pub use event::EventCounter;
pub use futex::{FutexKey, Futexes, PiLock};
pub use host::{Costs, Host, Luck, MachineFault};
pub use object::{Kind, ObjectId, Objects, Readiness};
pub use packet::{Arrived, PacketSocket, Protocol};
pub use pipe::{End, Pipe, PipeId};
pub use scheduler::{Scheduler, Source, TaskId};
pub use timer::Timer;
