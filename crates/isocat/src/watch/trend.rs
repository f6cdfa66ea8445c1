//! History of the figures: for rates, the sparkline, and the list of events.

use std::collections::VecDeque;

use isocat_engine::status::{Event, Kind, Status};

/// Follows the statuses of a segment.
#[derive(Clone, Debug, Default)]
pub struct Trend {
    status: Option<Status>,
    /// Lateness of frames.
    phases: VecDeque<f64>,
    /// Time, and the increase of the counters of each SubDevice.
    counts: VecDeque<(i64, Vec<u64>)>,
    events: VecDeque<Event>,
    /// The last event of a service, which repeats its last events.
    last: Option<Event>,
}

/// Largest number of values in the sparkline.
const MOST_PHASES: usize = 512;
/// Largest number of events that are kept.
const MOST_EVENTS: usize = 500;
/// Time over which rates are taken.
const RATE_NS: i64 = 10_000_000_000;

impl Trend {
    /// Takes the next status; returns the new events.
    pub fn take(&mut self, mut status: Status) -> Vec<Event> {
        let mut events = std::mem::take(&mut status.events);
        if status.kind == Kind::Served {
            let known = self.last.as_ref().and_then(|last| events.iter().rposition(|e| e == last));
            events.drain(..known.map_or(0, |known| known + 1));
            self.last = events.last().cloned().or(self.last.take());
        }
        if let Some(phase) = status.host.phase_error_ns {
            push(&mut self.phases, phase, MOST_PHASES);
        }
        let counts = status.devices.iter().map(|device| device.risen()).collect();
        self.counts.push_back((status.at_ns, counts));
        while self.counts.len() > 2 && status.at_ns - self.counts[1].0 >= RATE_NS {
            self.counts.pop_front();
        }
        for event in &events {
            push(&mut self.events, event.clone(), MOST_EVENTS);
        }
        self.status = Some(status);
        events
    }

    /// The last status.
    pub fn status(&self) -> Option<&Status> {
        self.status.as_ref()
    }

    /// Lateness of frames, oldest first, ns.
    pub fn phases(&self) -> impl DoubleEndedIterator<Item = f64> + ExactSizeIterator + '_ {
        self.phases.iter().copied()
    }

    /// Increase of a SubDevice's counters per second, over the last ten seconds.
    pub fn rate(&self, position: usize) -> f64 {
        let (Some((from, before)), Some((to, now))) = (self.counts.front(), self.counts.back())
        else {
            return 0.0;
        };
        let of = |counts: &[u64]| counts.get(position).copied().unwrap_or(0);
        let seconds = (to - from) as f64 / 1e9;
        if seconds <= 0.0 { 0.0 } else { of(now).saturating_sub(of(before)) as f64 / seconds }
    }

    /// The events, oldest first.
    pub fn events(&self) -> impl DoubleEndedIterator<Item = &Event> + ExactSizeIterator {
        self.events.iter()
    }
}

fn push<T>(all: &mut VecDeque<T>, value: T, most: usize) {
    if all.len() >= most {
        all.pop_front();
    }
    all.push_back(value);
}
