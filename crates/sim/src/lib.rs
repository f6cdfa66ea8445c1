//! An EtherCAT segment in deterministic virtual time: both sides meet, and judges watch.
//!
//! From the physics up: an [`oscillator`] derives a clock from true time. [`cable`] and [`wiring`]
//! describe the connections and their delays, `jitter` adds the variation of a hop for one frame,
//! and [`path`] gives the time at which a frame reaches each port. [`random`] is the only source of
//! random numbers. A [`device`] is an ESC, a stack, an application and a [`cpu`] on one oscillator.
//! A [`segment`] is devices on cables, which may be pulled and plugged, switched off and on, while
//! frames are in flight. A [`host`] is the machine on which the MainDevice runs. [`world`] connects
//! MainDevice and segment in true time. `audience` finds the SubDevices that a frame concerns;
//! `flight` and `disturbance` handle frames that meet a change on their way. [`mod@fault`]
//! describes the possible faults as data.
//!
//! What happens is told as [`observation`]s to the [`judge`]s on their [`mod@bench`]: they know
//! true time and the intent, and nothing of how the run was planned. [`run`] is the whole main job
//! in one call, what it comes to are [`finding`]s; a [`course`] is when each SubDevice was in sync;
//! a [`plant`] is the machine behind a drive, and [`plant_bench`] tells what lateness did to it;
//! [`sampling`] is what converters do that take or give several samples in a cycle. [`World::new`]
//! takes the MainDevice's application. [`served`] is a segment in host time, for frames from
//! outside.
//!
//! Devices affect each other only through frames. So the events of a device are processed lazily,
//! each time a frame reaches it: the cost is per event, not per tick.
#![forbid(unsafe_code)]

mod audience;
pub mod bench;
mod brief;
pub mod buffer;
pub mod burst;
pub mod cable;
pub mod course;
pub mod cpu;
mod cyclic_frame;
mod datagrams;
pub mod device;
mod disturbance;
pub mod expect;
pub mod fault;
pub mod finding;
mod flight;
pub mod host;
mod jitter;
pub mod judge;
mod next_frame;
pub mod observation;
pub mod oscillator;
pub mod path;
pub mod plant;
pub mod plant_bench;
pub mod probe;
pub mod random;
mod returns;
pub mod run;
pub mod sampling;
pub mod segment;
pub mod served;
mod silence;
pub mod statistics;
pub mod storage;
pub mod watcher;
pub mod wiring;
pub mod world;

pub use cable::{Cable, Direction, Phy};
pub use course::Course;
pub use cpu::{CpuModel, Overrun, Unevenness};
pub use device::DeviceSetup;
pub use disturbance::BitError;
pub use expect::Expectation;
pub use fault::{Fault, Planned, Timeline};
pub use finding::{Finding, Judged, Kind, Place};
pub use host::HostModel;
pub use oscillator::ClockModel;
pub use run::{Outcome, Run};
pub use sampling::Sampling;
pub use segment::{Closing, Connection, Lost, Returned, Segment};
pub use served::{Passage, Served};
pub use statistics::Statistics;
pub use watcher::Watcher;
pub use wiring::MainPort;
pub use world::{ServedCycle, Setup, Tap, World};
