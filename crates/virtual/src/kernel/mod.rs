//! The virtual kernel decides which task runs, and which tasks wait, until when, and for what.
//!
//! It knows no system calls, no memory of processes and no real time. One task runs at a time. A
//! call costs a stated time; then it is answered, or the task waits. Time advances only when all
//! tasks wait: it jumps to the earliest instant at which a task or the environment (a timer, a
//! frame on its way back) is due.
//!
//! - [`Scheduler`]: tasks, what they wait for, and the clock.
//! - [`Futexes`]: the queues behind mutexes, condition variables and joins.
//! - [`Objects`]: the objects behind descriptors: packet sockets, timers, event counters, pipes,
//!   epoll sets.
//! - [`Host`]: the random delays of a machine: late wake-ups, slow sends, stalls, all from one
//!   seed.

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
