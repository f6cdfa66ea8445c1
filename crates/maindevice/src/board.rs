//! The notice board: state that the machine writes and procedures read, wishes of procedures to the
//! machine, and events for the user.

use alloc::collections::VecDeque;

use isocat_wire::StationAddress;
use isocat_wire::time::{Dc, Host, Nanos, Time};

use crate::event::Event;
use crate::statistics::Statistics;

/// Events kept until they are taken. Further events are counted and dropped, so that memory is
/// bounded.
const MOST_EVENTS: usize = 1024;

/// What is known of the run, apart from the frames in flight.
pub(crate) struct Board {
    /// Counts of the run.
    pub statistics: Statistics,
    /// Cycles begun.
    pub cycle: u64,
    /// Cycles in a row with all working counters of process data right.
    pub complete_cycles: u64,
    /// Expected and found working counter of the last incomplete process data.
    pub incomplete: (u16, u16),
    /// Last reference time that the cycle brought back, and the host time at which its frame was
    /// sent.
    pub reference_time: (Time<Host>, Time<Dc>),
    /// Whether the cycle's drift datagram controls the clocks; otherwise it only reads.
    pub leading: bool,
    /// When a drift frame was last sent, in the cycle or in addition to it.
    pub led_at: Time<Host>,
    /// When the next drift frame of the cycle is due.
    pub lead_due: Time<Host>,
    /// How often frames have changed their way to the clocks, as far as their working counters show
    /// it.
    pub way_changes: u64,
    /// The state of the ring, if one is configured.
    pub ring: Option<RingState>,
    /// Wishes of procedures to the cycle; the machine takes them.
    pub wishes: VecDeque<Wish>,
    events: VecDeque<Event>,
    dropped: u64,
}

/// A wish of a procedure to the cyclic exchange.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Wish {
    /// Do not control the clocks.
    HoldClocks,
    /// Use the clock at this position as reference from now on.
    Lead(usize),
    /// The clock at this position has this delay from now on.
    Delay(usize, Nanos),
    /// The SubDevice at this position takes no part any more.
    LeaveOut(usize),
}

/// What the returned copies of frames tell about the ring.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) enum View {
    /// Nothing yet.
    #[default]
    Unknown,
    /// Frames come through from end to end.
    Whole,
    /// Frames pass from end to end, but SubDevices process the frames from the secondary port.
    Reverse,
    /// Numbers of SubDevices that answer to the primary port and to the secondary port.
    Cut { near: u16, far: u16 },
}

/// The state of the ring that procedures and machine share.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct RingState {
    /// Frames leave only the primary port.
    pub line: bool,
    /// The SubDevice whose port towards the secondary port is closed.
    pub exit: Option<StationAddress>,
    pub view: View,
}

impl Board {
    /// A board without any information.
    pub fn new() -> Self {
        Self {
            statistics: Statistics::default(),
            cycle: 0,
            complete_cycles: 0,
            incomplete: (0, 0),
            reference_time: (Time::ZERO, Time::ZERO),
            leading: false,
            led_at: Time::ZERO,
            lead_due: Time::ZERO,
            way_changes: 0,
            ring: None,
            wishes: VecDeque::new(),
            events: VecDeque::with_capacity(MOST_EVENTS),
            dropped: 0,
        }
    }

    /// Queues an event. Events are rare, and this is large: the code of the cycle is faster without
    /// it.
    #[cold]
    #[inline(never)]
    pub fn report(&mut self, event: Event) {
        #[cfg(feature = "tracing")]
        crate::trace::event(&event);
        if self.events.len() >= MOST_EVENTS {
            self.dropped += 1;
        } else {
            self.events.push_back(event);
        }
    }

    /// Takes the next event.
    #[inline]
    pub fn poll_event(&mut self) -> Option<Event> {
        if self.has_event() { self.next_event() } else { None }
    }

    /// Whether there is an event.
    #[inline]
    pub fn has_event(&self) -> bool {
        !self.events.is_empty() || self.dropped > 0
    }

    fn next_event(&mut self) -> Option<Event> {
        if let Some(event) = self.events.pop_front() {
            return Some(event);
        }
        let count = core::mem::take(&mut self.dropped);
        (count > 0).then_some(Event::Dropped { count })
    }
}
