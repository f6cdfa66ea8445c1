//! Tests MainDevice applications in `cargo test`: on a virtual segment, in deterministic virtual
//! time, with judges.
//!
//! 1. A [`Segment`] is read from a segment file or its text; it holds the seed, and how late the
//!    application's host is.
//! 2. [`run`] switches the segment on and polls the test. The [`Bus`] is the test's access to it:
//!    the test spawns the application, waits for the devices, sets their inputs, and causes faults.
//! 3. The application sends frames through a [`Socket`]. With the feature `embassy-time`, the
//!    timers of embassy-time run on virtual time, and applications on ethercrab need no change:
//!    `ethercrab_tx_rx_task!` replaces their network interface.
//! 4. Time stands still while a task can be polled. When all tasks wait, it advances to the next
//!    timer, or to the instant at which the last bit of an answer is back.
//! 5. The [`Verdict`] is what the MainDevice did, and what judges saw in the segment's true time.
//!
//! ```
//! use std::time::Duration;
//!
//! use isocat_testing::{Segment, run};
//!
//! let text = "cycle = \"1ms\"\n[[subdevice]]\ndevice = \"simple_io4\"\nname = \"lamps\"\n";
//! let segment = Segment::parse(text).expect("a segment");
//! let verdict = run(segment.seed(7), async |bus| {
//!     // A MainDevice of one frame: who is there?
//!     let mut frame = vec![0xFF; 6];
//!     frame.extend([0x02, 0, 0, 0, 0, 0x01, 0x88, 0xA4]);
//!     frame.extend([0x0E, 0x10, 0x07, 0, 0, 0, 0x30, 0x01, 0x02, 0, 0, 0, 0, 0, 0, 0]);
//!     let socket = bus.socket();
//!     socket.send(&frame);
//!     let answer = socket.receive_for(Duration::from_millis(1)).await.expect("the cable is whole");
//!     assert_eq!(answer[28..30], [1, 0], "one device counted");
//! });
//! assert!(!verdict.in_sync(), "no device came to operation: {verdict}");
//! ```
//!
//! A run takes place on the thread that called [`run`], and virtual time belongs to that thread:
//! `cargo test` may run any number of tests concurrently, and each has the same result as alone. An
//! error of a test is a panic, at its line if that is known; [`try_run`] returns an error for a run
//! that can't end.
#![forbid(unsafe_code)]

mod bus;
mod clock;
#[cfg(feature = "embassy-time")]
mod embassy;
#[cfg(feature = "embassy-time")]
mod ethercrab;
mod executor;
mod host;
mod place;
mod run;
mod segment;
mod socket;
mod verdict;

pub use bus::{Bus, Device};
pub use clock::{Sleep, ethercat_now, now};
#[cfg(feature = "embassy-time")]
#[doc(hidden)]
pub use ethercrab::assert_virtual_timers;
pub use executor::Task;
pub use isocat_descriptions::document::FileError;
pub use isocat_serve::Summary;
pub use isocat_subdevice::{Application, Event};
pub use isocat_wire::time::Nanos;
pub use isocat_wire::{AbortCode, AlState, AlStatusCode, ObjectAddress};
pub use place::Place;
pub use run::{Failure, Kind, run, seeds, try_run};
pub use segment::{LATENCY, LIMIT, Segment};
pub use socket::{MOST_WAITING, Socket};
pub use verdict::Verdict;
