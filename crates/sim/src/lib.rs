//! An EtherCAT segment in deterministic virtual time: both sides meet, and judges watch.
//!
//! From the physics up: an [`oscillator`] makes a clock of its own out of true time; [`cable`] and
//! [`wiring`] say what is connected to what and how far away, `jitter` what a hop adds for one
//! frame, [`path`] when a frame reaches which port; [`random`] is the one source of chance. A
//! [`device`] is an ESC, a stack, an application and a [`cpu`] on one oscillator, a [`segment`] is
//! devices on cables that may be pulled and plugged, and switched off and on, while frames are
//! under way, a [`host`] is the machine that the MainDevice runs on. [`world`] lets MainDevice and
//! segment meet in true time. `audience` says whom a frame visits, `flight` and `disturbance` what
//! becomes of frames that meet something on their way. [`mod@fault`] is what can go wrong with all of them, as data.
//!
//! What happens is told as [`observation`]s to the [`judge`]s on their [`mod@bench`]: they know true time and
//! the intent, and nothing of how the run was planned. [`run`] is the whole main job in one call, what it comes to are [`finding`]s;
//! a [`course`] is when each SubDevice was in sync; a [`plant`] is the machine behind a drive, and [`plant_bench`] tells what lateness
//! did to it; [`sampling`] is what converters do that take or give several samples in a cycle. [`World::new`] takes the MainDevice's application. [`served`] is a segment in host time, for frames from outside.
//!
//! Devices meet only through frames. So a device's own events are caught up with lazily, each time a
//! frame reaches it: cost is per event, never per tick.
#![forbid(unsafe_code)]

mod audience;
pub mod bench;
pub mod cable;
pub mod course;
pub mod cpu;
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
pub mod run;
pub mod sampling;
pub mod segment;
pub mod served;
pub mod statistics;
pub mod storage;
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
pub use wiring::MainPort;
pub use world::{ServedCycle, Setup, Tap, World};
