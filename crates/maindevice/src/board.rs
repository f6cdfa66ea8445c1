//! The notice board: what the machine keeps and procedures read, what they ask for, and what is told outside.

use alloc::collections::VecDeque;

use isocat_wire::StationAddress;
use isocat_wire::time::{Dc, Host, Time};

use crate::event::Event;
use crate::statistics::Statistics;

/// Events kept until somebody takes them; more are counted and dropped, so that memory is bounded.
const MOST_EVENTS: usize = 1024;

/// What is known of the run besides the frames that are under way.
pub(crate) struct Board {
    /// Counts of the run.
    pub statistics: Statistics,
    /// Cycles begun.
    pub cycle: u64,
    /// Cycles in a row whose process data all counted right.
    pub complete_cycles: u64,
    /// Working counter expected and found where process data were last incomplete.
    pub incomplete: (u16, u16),
    /// Last reference time that the cycle brought back, and when its frame was sent.
    pub reference_time: (Time<Host>, Time<Dc>),
    /// Whether the cycle's drift datagram leads the clocks, and does not only read.
    pub leading: bool,
    /// When a drift frame was last sent, of the cycle or beside it.
    pub led_at: Time<Host>,
    /// When the cycle's next one is due.
    pub lead_due: Time<Host>,
    /// How often frames have come to take another way to the clocks, as far as their working counters show it.
    pub way_changes: u64,
    /// What the ring is, if there is to be one.
    pub ring: Option<RingState>,
    /// What a procedure wants of the cycle; taken by the machine.
    pub wishes: VecDeque<Wish>,
    events: VecDeque<Event>,
    dropped: u64,
}

/// What a procedure wants of the cyclic exchange.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Wish {
    /// The clocks are left to themselves.
    HoldClocks,
    /// This position leads the clocks from now on.
    Lead(usize),
    /// This position takes no part any more.
    LeaveOut(usize),
}

/// What the copies that came back say of the ring.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) enum View {
    /// Nothing yet.
    #[default]
    Unknown,
    /// Frames come through from end to end.
    Whole,
    /// The same, but SubDevices look into what comes from the secondary port.
    Reverse,
    /// So many SubDevices answer to the primary port, and to the secondary port.
    Cut { near: u16, far: u16 },
}

/// What procedures and machine share of the ring.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct RingState {
    /// Frames leave the primary port only.
    pub line: bool,
    /// Whose port towards the secondary port is closed.
    pub exit: Option<StationAddress>,
    pub view: View,
}

impl Board {
    /// Nothing is known yet.
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

    /// Tells an event.
    pub fn report(&mut self, event: Event) {
        if self.events.len() >= MOST_EVENTS {
            self.dropped += 1;
        } else {
            self.events.push_back(event);
        }
    }

    /// The next event.
    pub fn poll_event(&mut self) -> Option<Event> {
        if let Some(event) = self.events.pop_front() {
            return Some(event);
        }
        let count = core::mem::take(&mut self.dropped);
        (count > 0).then_some(Event::Dropped { count })
    }
}
