//! Events that the machine reports while it works.

use alloc::vec::Vec;

use isocat_sync::delay::{Delay, Why};
use isocat_sync::phase;
use isocat_wire::al::{AlStatus, AlStatusCode};
use isocat_wire::time::{Nanos, Picos};

use crate::alarm::Change;
use crate::error::{AccessError, Cause, Error, SdoError};
pub use crate::stage::Stage;

/// Identifies an acyclic request until its event comes.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct RequestId(pub u32);

/// An event.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Event {
    /// A stage begins.
    Progress(Stage),
    /// AL status of a SubDevice changed, on request or by itself. The code is read when the error
    /// bit is set or the change was not requested.
    StateChanged {
        /// Position.
        position: usize,
        /// Register 0x0130.
        status: AlStatus,
        /// Register 0x0134.
        code: AlStatusCode,
        /// Cycle in which it was seen; 0 before the cyclic exchange.
        cycle: u64,
    },
    /// A datagram of the process data has a wrong working counter from this cycle on. Its inputs
    /// are not taken until [`Event::WorkingCounterRestored`].
    WorkingCounter {
        /// Cycle.
        cycle: u64,
        /// Index of the chunk of the process image.
        chunk: usize,
        /// Expected.
        expected: u16,
        /// Found.
        found: u16,
    },
    /// A datagram of the process data has the right working counter again.
    WorkingCounterRestored {
        /// Cycle.
        cycle: u64,
        /// Index of the chunk of the process image.
        chunk: usize,
        /// Number of cycles with a wrong working counter.
        cycles: u64,
    },
    /// The working counter of the drift datagram changed. If it is not that of all clocks, one of
    /// them does not get the reference's time, or the reference does not answer. At the end `found`
    /// equals `expected` again.
    Drift {
        /// Cycle.
        cycle: u64,
        /// Clocks found at the scan.
        expected: u16,
        /// Clocks that answered.
        found: u16,
    },
    /// The delay of a clock cannot be known from the receive times. The clock uses the middle of
    /// the possible values, or 0 ns if the times do not limit it.
    DelayUnknown {
        /// Position.
        position: usize,
        /// The reason; SubDevices in it are named by position.
        why: Why,
        /// The least and the largest possible value.
        between: Option<(Picos, Picos)>,
        /// The value written to 0x0928.
        used: Nanos,
    },
    /// A delay measured while the segment runs differs by more than the error from the one in force
    /// (0x0928): a cable was changed, or a port behaves differently. Reported when it begins; see
    /// [`DelayWatch`](crate::config::DelayWatch).
    DelayChanged {
        /// Position.
        position: usize,
        /// The delay in force.
        written: Nanos,
        /// The delay measured now.
        found: Delay,
        /// Whether 0x0928 is now written with it.
        rewritten: bool,
    },
    /// A delay measured while the segment runs equals the one in force again.
    DelayRestored {
        /// Position.
        position: usize,
        /// The delay in force.
        written: Nanos,
    },
    /// A value that is read in the background left its limits, or is back within them
    /// ([`Config::quality`](crate::Config::quality)).
    Alarm(Change),
    /// No drift frame reached all clocks for many cycles
    /// ([`QualityWatch::unled_cycles`](crate::QualityWatch)): clocks run freely, and 0x092C is out
    /// of date. `cycles` is 0 when a frame reaches them again.
    ClocksUnled {
        /// Number of cycles since the last such frame.
        cycles: u64,
    },
    /// A SubDevice failed during bring-up, and the others are in operation without it. Reported
    /// directly after [`Event::InOperation`].
    LeftOut {
        /// Position.
        position: usize,
        /// The stage that failed.
        stage: Stage,
        /// The reason.
        cause: Cause,
    },
    /// A SubDevice no longer answers at its station address. It takes no part from now on: expected
    /// working counters follow, and its inputs keep their last values.
    Lost {
        /// Position.
        position: usize,
        /// Cycle in which the loss was noticed.
        cycle: u64,
    },
    /// A SubDevice answers in the place of a lost one; its re-admission begins.
    Found {
        /// Position.
        position: usize,
        /// Cycle.
        cycle: u64,
    },
    /// A SubDevice that was lost is in OP again, on the grid that it had.
    Readmitted {
        /// Position.
        position: usize,
        /// Cycle.
        cycle: u64,
        /// Host time since it was found.
        after: Nanos,
    },
    /// A SubDevice that was found cannot be admitted.
    NotReadmitted {
        /// Position.
        position: usize,
        /// The reason. A different device in its place ([`Cause::Identity`]) is ignored until it is
        /// removed.
        cause: Cause,
        /// Time until the next attempt; `None`: when a different device answers there.
        again: Option<Nanos>,
    },
    /// The SubDevices that answer do not agree with the tree of the scan, so none is admitted.
    Unplanned {
        /// Cycle.
        cycle: u64,
        /// SubDevices that answer.
        found: u16,
    },
    /// The reference clock is lost. The host continues with the rate that it knows.
    ReferenceLost {
        /// Position.
        position: usize,
        /// Cycle.
        cycle: u64,
    },
    /// This clock is the reference from now on; the time continues.
    ReferenceElected {
        /// Position.
        position: usize,
        /// Cycle.
        cycle: u64,
    },
    /// The ring is cut ([`Config::ring`](crate::Config::ring)): frames came back at the port that
    /// sent them. Process data continues over both ports. The event is repeated if another cut
    /// changes it; SubDevices between two cuts are [`Event::Lost`].
    RingCut {
        /// Cycle.
        cycle: u64,
        /// The last position reached from the primary port and the first from the secondary port;
        /// `None`: the port itself.
        between: (Option<usize>, Option<usize>),
    },
    /// The reference clock does not reach the SubDevices behind the cut of a ring. This clock is
    /// their reference from now on, at its present rate, so the times of the two parts drift apart.
    ClocksSplit {
        /// Position.
        position: usize,
        /// Cycle.
        cycle: u64,
    },
    /// Frames pass the ring from end to end again, and the reference clock controls all clocks.
    RingHealed {
        /// Cycle.
        cycle: u64,
    },
    /// The recovery of a SubDevice that left OP begins.
    Recovering {
        /// Position.
        position: usize,
        /// Register 0x0130.
        status: AlStatus,
        /// Register 0x0134.
        code: AlStatusCode,
        /// Number of the attempt since it was last in order, from 1.
        attempt: u32,
    },
    /// A SubDevice that left OP is in OP again.
    Recovered {
        /// Position.
        position: usize,
        /// Host time of the attempt.
        after: Nanos,
        /// Whether it was led through INIT, since acknowledging its error did not help.
        through_init: bool,
    },
    /// A SubDevice that left OP did not come back.
    NotRecovered {
        /// Position.
        position: usize,
        /// The reason.
        cause: Cause,
        /// Time until the next attempt; `None`: never.
        again: Option<Nanos>,
    },
    /// The number of SubDevices that answer is not that of the scan.
    CountChanged {
        /// Cycle.
        cycle: u64,
        /// Number at the scan.
        expected: u16,
        /// Number now.
        found: u16,
    },
    /// A cyclic frame did not come back.
    FrameLost {
        /// Cycle.
        cycle: u64,
        /// Index of the frame in the cycle.
        frame: usize,
    },
    /// The caller missed one or more send instants.
    CyclesSkipped {
        /// The next cycle, which is on the grid again.
        cycle: u64,
        /// How late the caller was.
        late: Nanos,
        /// Number of cycles skipped.
        skipped: u64,
    },
    /// The host's lock on the reference clock changed.
    Phase {
        /// Cycle.
        cycle: u64,
        /// The present state of the servo.
        state: phase::State,
    },
    /// A device sent an emergency message.
    Emergency {
        /// Position.
        position: usize,
        /// Error code.
        code: u16,
        /// Error register.
        register: u8,
        /// Vendor-specific data.
        data: [u8; 5],
    },
    /// All SubDevices are in OP, and process data run.
    InOperation {
        /// Cycle.
        cycle: u64,
        /// Host time since the first frame.
        after: Nanos,
    },
    /// An upload ended.
    Uploaded {
        /// The request.
        request: RequestId,
        /// The bytes of the entry.
        result: Result<Vec<u8>, SdoError>,
    },
    /// A download ended.
    Downloaded {
        /// The request.
        request: RequestId,
        /// Whether the device accepted it.
        result: Result<(), SdoError>,
    },
    /// A read of memory ended, see [`MainDevice::read_memory`].
    ///
    /// [`MainDevice::read_memory`]: crate::MainDevice::read_memory
    Read {
        /// The request.
        request: RequestId,
        /// The bytes.
        result: Result<Vec<u8>, AccessError>,
    },
    /// The survey of [`Config::survey`](crate::Config::survey) is complete. SubDevices stay in
    /// PREOP and answer requests until [`MainDevice::stop`](crate::MainDevice::stop).
    Surveyed,
    /// All SubDevices are back in INIT; nothing more is sent.
    Stopped,
    /// The bring-up failed; nothing more is sent.
    Failed(Error),
    /// Events were dropped because they were not polled.
    Dropped {
        /// Number of dropped events.
        count: u64,
    },
}
