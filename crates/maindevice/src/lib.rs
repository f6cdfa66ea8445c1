//! An EtherCAT MainDevice as a machine: frames and time in, frames and events out.
//!
//! [`MainDevice`] takes a [`Config`] and brings the segment behind its port into synchronized
//! operation. The crate uses no socket, thread or clock. Data goes through its modules in this way:
//!
//! 1. `link` holds datagrams that procedures await: it packs them into frames and returns the
//!    answers. `board` holds what machine and procedures know of the run. Procedures are
//!    `async fn`s that the machine polls itself, for many devices concurrently.
//! 2. `bring_up` is the bring-up in order. `scan` and `topology` find the SubDevices, `sii` reads
//!    their SII, `esm` changes their states, `mailbox` and `coe` carry the object accesses of
//!    `objects`. `mode` chooses the synchronization mode of each SubDevice, `mapping` lays out the
//!    process image, `timing` plans the cycle. `clock` sets all clocks to one time, with the delays
//!    that `delay` measures, and `sync` programs SYNC0 and verifies it.
//! 3. `cycle` is the cyclic exchange, with the servo that keeps the host in phase; it does not
//!    allocate.
//! 4. [`application`] is the user's part, called with the process data of each complete cycle.
//!    [`motion`] is a ready-made application, and [`written`] holds the outputs that it writes on a
//!    timeline. A [`Runner`] calls the application at the right time, in virtual time and on a
//!    wire. If a device does not answer an optional [`service`] correctly, it is used without that
//!    service, and SubDevices that fail may be `left_out`.
//! 5. `survey` only reads the segment: it goes to PREOP with the same parts, and continues past
//!    SubDevices that fail.
//! 6. In operation `health` finds SubDevices that left their state or are lost, and `readmit`
//!    brings them back while the others run. `delay_watch` finds delays that changed, and `quality`
//!    finds clocks that do not follow, counters that rise and frames that come late.
//! 7. `ring` uses a second port behind the last SubDevice, if [`Config::ring`] says so. It joins
//!    what comes back at both ports into one frame for all other modules.
//!
//! Results are in [`segment`], errors in [`error`], events in [`event`], and counts in
//! [`statistics`].
//!
//! ```no_run
//! use isocat_maindevice::{Config, Cycle, Event, FRAME_LEN, MainDevice, Port, Runner};
//! use isocat_wire::{Nanos, Time};
//! # use isocat_wire::time::Host;
//! # fn clock() -> Time<Host> { Time::ZERO }
//! # fn send(_: &[u8]) {}
//! # fn receive_until(_: Time<Host>) -> Option<Vec<u8>> { None }
//! let main = MainDevice::new(Config::new(Nanos::millis(1)), clock());
//! // Once in each cycle, when its inputs are there.
//! let mut runner = Runner::new(main, |cycle: &mut Cycle<'_>| {
//!     for mut device in cycle.devices() {
//!         device.copy_inputs_to_outputs();
//!     }
//! });
//! let mut buffer = [0; FRAME_LEN];
//! loop {
//!     while let Some(event) = runner.poll_event() {
//!         println!("{event:?}");
//!     }
//!     while let Some(len) = runner.poll_transmit(clock(), &mut buffer) {
//!         send(&buffer[..len]);
//!     }
//!     let Some(due) = runner.next_timeout() else { break };
//!     match receive_until(due) {
//!         Some(frame) => runner.handle_frame(Port::Primary, clock(), &frame),
//!         None => runner.handle_timeout(clock()),
//!     };
//! }
//! ```
#![no_std]
#![forbid(unsafe_code)]

extern crate alloc;
#[cfg(test)]
extern crate std;

pub mod application;
pub mod change;
pub mod config;
pub mod error;
pub mod event;
pub use isocat_rules::{kind, kinds};
pub mod motion;
pub mod plan;
pub mod segment;
pub mod service;
pub mod statistics;

mod alarm;
mod board;
mod bring_up;
mod clock;
mod coe;
mod cycle;
mod dc;
mod delay;
mod delay_watch;
mod esm;
mod health;
mod hot_connect;
mod left_out;
mod link;
mod machine;
mod mailbox;
mod mapping;
mod mode;
mod objects;
pub mod quality;
mod readmit;
mod ring;
mod runner;
mod scan;
mod sii;
mod soe;
mod stage;
mod survey;
mod sync;
mod times;
mod timing;
mod topology;
#[cfg(feature = "tracing")]
mod trace;
pub mod written;

#[cfg(test)]
mod tests;

pub use application::{Application, Cycle};
pub use change::SegmentChange;
pub use config::{
    AssumedTimes, ClockRange, Config, DelayWatch, DeviceConfig, DriftFilters, MeasureTimes,
    MeasuredTimes, QualityWatch, Readmission, Recovery, Ring, StartupDownload, StartupParameter,
    Survey, Timeouts, WatchdogRegisters,
};
pub use error::{AccessError, Cause, Error, Fault, Place, SdoError, SoeError};
pub use event::{Event, RequestId, Stage};
pub use link::FRAME_LEN;
pub use machine::MainDevice;
pub use mode::takes_sm_mode;
pub use motion::Motion;
pub use plan::plan;
pub use ring::Port;
pub use runner::Runner;
pub use segment::{Segment, SubDevice};
pub use service::{Service, Substitute};
pub use statistics::Statistics;
pub use times::OwnTimes;
