//! What the machine tells while it works.

use alloc::vec::Vec;

use isocat_sync::delay::{Delay, Why};
use isocat_sync::phase;
use isocat_wire::al::{AlStatus, AlStatusCode};
use isocat_wire::time::{Nanos, Picos};

use crate::alarm::Change;
use crate::error::{AccessError, Cause, Error, SdoError};
pub use crate::stage::Stage;

/// Names an acyclic request until its event comes.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct RequestId(pub u32);

/// Something that happened.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Event {
    /// A stage begins.
    Progress(Stage),
    /// AL status of a SubDevice changed, wished or not. The code is read when the error bit is set
    /// or the change was not asked for.
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
    /// A datagram of the process data begins to count wrongly; its inputs are not taken until
    /// [`Event::WorkingCounterRestored`].
    WorkingCounter {
        /// Cycle.
        cycle: u64,
        /// Which chunk of the process image.
        chunk: usize,
        /// Expected.
        expected: u16,
        /// Found.
        found: u16,
    },
    /// A datagram of the process data counts right again.
    WorkingCounterRestored {
        /// Cycle.
        cycle: u64,
        /// Which chunk of the process image.
        chunk: usize,
        /// Cycles in which it counted wrongly.
        cycles: u64,
    },
    /// The drift datagram counts other than all clocks: one of them is no longer led by the
    /// reference, or the reference does not answer. Told when the count changes; `found` is
    /// `expected` again at the end.
    Drift {
        /// Cycle.
        cycle: u64,
        /// Clocks found at the scan.
        expected: u16,
        /// Clocks that answered.
        found: u16,
    },
    /// The delay of a clock can't be known from the receive times. It goes on with the middle of what is
    /// possible, or 0 ns if anything is.
    DelayUnknown {
        /// Position.
        position: usize,
        /// Why not; SubDevices in it are named by position.
        why: Why,
        /// What is possible.
        between: Option<(Picos, Picos)>,
        /// What was written to 0x0928.
        used: Nanos,
    },
    /// A delay measured while the segment runs lies beyond the error from the one in force, which is what 0x0928
    /// was written with: a cable was changed, or a port behaves otherwise. Told when it begins; see
    /// [`DelayWatch`](crate::config::DelayWatch).
    DelayChanged {
        /// Position.
        position: usize,
        /// In force.
        written: Nanos,
        /// Measured now.
        found: Delay,
        /// Whether 0x0928 is now written with it.
        rewritten: bool,
    },
    /// A delay measured while the segment runs is again the one in force.
    DelayRestored {
        /// Position.
        position: usize,
        /// In force.
        written: Nanos,
    },
    /// Something that is read in the background leaves its limits, or is back within them
    /// ([`Config::quality`](crate::Config::quality)).
    Alarm(Change),
    /// No drift frame that all clocks took for many cycles ([`QualityWatch::unled_cycles`](crate::QualityWatch)):
    /// clocks run by themselves, and 0x092C tells nothing new. `cycles` is 0 when they are led again.
    ClocksUnled {
        /// Cycles since the last one.
        cycles: u64,
    },
    /// A SubDevice failed on the way up, and the others are in operation without it. Told right behind
    /// [`Event::InOperation`].
    LeftOut {
        /// Position.
        position: usize,
        /// At which stage.
        stage: Stage,
        /// Why.
        cause: Cause,
    },
    /// A SubDevice no longer answers at its station address. It takes no part from now on: expected working
    /// counters follow, and its inputs stay what they last were.
    Lost {
        /// Position.
        position: usize,
        /// Cycle in which it was found out.
        cycle: u64,
    },
    /// Something answers in the place of a SubDevice that was lost; its re-admission begins.
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
    /// A SubDevice that was found can't be admitted.
    NotReadmitted {
        /// Position.
        position: usize,
        /// Why not. Another device in its place ([`Cause::Identity`]) is left alone until it is taken away.
        cause: Cause,
        /// When it is tried again; `None`: when something else answers there.
        again: Option<Nanos>,
    },
    /// What answers does not agree with the tree that was found at the scan: nobody is admitted.
    Unplanned {
        /// Cycle.
        cycle: u64,
        /// SubDevices that answer.
        found: u16,
    },
    /// The reference clock is gone. The host goes on by what it knows of its rate.
    ReferenceLost {
        /// Position.
        position: usize,
        /// Cycle.
        cycle: u64,
    },
    /// This clock leads from now on; the time stays as it was.
    ReferenceElected {
        /// Position.
        position: usize,
        /// Cycle.
        cycle: u64,
    },
    /// The ring is cut ([`Config::ring`](crate::Config::ring)), as frames show that came back where they left. Data flow
    /// on over both ports. Told again where another cut changes it; SubDevices between two cuts are [`Event::Lost`].
    RingCut {
        /// Cycle.
        cycle: u64,
        /// The last position reached from the primary port and the first from the secondary port; `None`: the port
        /// itself.
        between: (Option<usize>, Option<usize>),
    },
    /// The reference clock does not reach those behind the cut of a ring: this clock leads them from now on, at the rate
    /// that it had, and the two parts slide apart.
    ClocksSplit {
        /// Position.
        position: usize,
        /// Cycle.
        cycle: u64,
    },
    /// Frames come through the ring from end to end again; the reference clock leads all.
    RingHealed {
        /// Cycle.
        cycle: u64,
    },
    /// A SubDevice that left OP is brought back.
    Recovering {
        /// Position.
        position: usize,
        /// Register 0x0130.
        status: AlStatus,
        /// Register 0x0134.
        code: AlStatusCode,
        /// Which attempt since it was last well, from 1.
        attempt: u32,
    },
    /// A SubDevice that left OP is in OP again.
    Recovered {
        /// Position.
        position: usize,
        /// Host time of the attempt.
        after: Nanos,
    },
    /// A SubDevice that left OP did not come back.
    NotRecovered {
        /// Position.
        position: usize,
        /// Why not.
        cause: Cause,
        /// When it is tried again; `None`: never.
        again: Option<Nanos>,
    },
    /// Another number of SubDevices answers than was found at the scan.
    CountChanged {
        /// Cycle.
        cycle: u64,
        /// At the scan.
        expected: u16,
        /// Now.
        found: u16,
    },
    /// A cyclic frame did not come back.
    FrameLost {
        /// Cycle.
        cycle: u64,
        /// Which frame of the cycle.
        frame: usize,
    },
    /// The caller let one or more send instants pass.
    CyclesSkipped {
        /// Cycle that follows, on the grid again.
        cycle: u64,
        /// How late the caller was.
        late: Nanos,
        /// Cycles left out.
        skipped: u64,
    },
    /// The host's lock on the reference clock changed.
    Phase {
        /// Cycle.
        cycle: u64,
        /// What the servo knows now.
        state: phase::State,
    },
    /// Emergency of a device.
    Emergency {
        /// Position.
        position: usize,
        /// Error code.
        code: u16,
        /// Error register.
        register: u8,
        /// Data of the vendor.
        data: [u8; 5],
    },
    /// All SubDevices are in OP, process data flow.
    InOperation {
        /// Cycle.
        cycle: u64,
        /// Host time from the first frame.
        after: Nanos,
    },
    /// An upload ended.
    Uploaded {
        /// The request.
        request: RequestId,
        /// Its bytes.
        result: Result<Vec<u8>, SdoError>,
    },
    /// A download ended.
    Downloaded {
        /// The request.
        request: RequestId,
        /// Whether the device took it.
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
    /// What was asked for by [`Config::survey`](crate::Config::survey) is known. SubDevices stay in PREOP and answer
    /// requests until [`MainDevice::stop`](crate::MainDevice::stop).
    Surveyed,
    /// All SubDevices are back in INIT; nothing more is sent.
    Stopped,
    /// The way up ended here; nothing more is sent.
    Failed(Error),
    /// Events were dropped since nobody took them.
    Dropped {
        /// How many.
        count: u64,
    },
}
