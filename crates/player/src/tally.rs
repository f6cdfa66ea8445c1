//! What is counted of all frames of a run, and what is told of them.

use std::collections::VecDeque;

use isocat_maindevice::Event;
use isocat_maindevice::statistics::Statistics;
use isocat_wire::time::{Host, Time};

/// Counts and events of a run.
#[derive(Default)]
pub(crate) struct Tally {
    /// Counts, as our own MainDevice has them.
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

    /// Tells of something that happened at `at`.
    pub fn tell(&mut self, at: Time<Host>, event: Event) {
        if self.events.len() < MOST_EVENTS {
            self.events.push_back((at, event));
        } else {
            self.dropped += 1;
        }
    }

    /// Takes the next event; behind the last one, how many were dropped.
    pub fn poll_event(&mut self, now: Time<Host>) -> Option<(Time<Host>, Event)> {
        self.events.pop_front().or_else(|| {
            let count = std::mem::take(&mut self.dropped);
            (count > 0).then_some((now, Event::Dropped { count }))
        })
    }
}

/// Events that may wait to be taken.
const MOST_EVENTS: usize = 1_000;
