//! Counts all frames of a run, and queues events.

use std::collections::VecDeque;

use isocat_maindevice::Event;
use isocat_maindevice::statistics::Statistics;
use isocat_wire::time::{Host, Time};

/// Counts and events of a run.
#[derive(Default)]
pub(crate) struct Tally {
    /// Counts in the form of isocat's own MainDevice.
    pub statistics: Statistics,
    events: VecDeque<(Time<Host>, Event)>,
    dropped: u64,
    next: u8,
}

impl Tally {
    /// The index of the next frame.
    pub fn index(&mut self) -> u8 {
        self.next = self.next.wrapping_add(1);
        self.next
    }

    /// Queues an event that happened at `at`.
    pub fn tell(&mut self, at: Time<Host>, event: Event) {
        if self.events.len() < MOST_EVENTS {
            self.events.push_back((at, event));
        } else {
            self.dropped += 1;
        }
    }

    /// Takes the next event; after the last one, the number of dropped events.
    pub fn poll_event(&mut self, now: Time<Host>) -> Option<(Time<Host>, Event)> {
        self.events.pop_front().or_else(|| {
            let count = std::mem::take(&mut self.dropped);
            (count > 0).then_some((now, Event::Dropped { count }))
        })
    }
}

/// Largest number of events in the queue.
const MOST_EVENTS: usize = 1_000;
