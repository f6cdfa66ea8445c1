//! History of the figures: for rates, the sparkline, and the list of events.

use std::collections::VecDeque;

use isocat_engine::status::{Device, Event, Kind, Status};
use isocat_wire::AlState;

/// Follows the statuses of a segment.
#[derive(Clone, Debug, Default)]
pub struct Trend {
    status: Option<Status>,
    /// Lateness of frames.
    phases: VecDeque<f64>,
    /// Time, and the increase of the counters of each SubDevice.
    counts: VecDeque<(i64, Vec<u64>)>,
    /// AL state and error flag of each SubDevice, and since when.
    states: Vec<(Option<AlState>, bool, i64)>,
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
/// A SubDevice that has been behind the others for less is on its way.
const ON_ITS_WAY_NS: i64 = 1_000_000_000;

/// A SubDevice that stays in a lower state than others.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Behind {
    /// Its position.
    pub position: usize,
    /// Time for which it has been in its state.
    pub for_ns: i64,
    /// The highest state of the others, in which it should be, too.
    pub others: AlState,
}

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
        self.note_states(&status);
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

    fn note_states(&mut self, status: &Status) {
        self.states.truncate(status.devices.len());
        for (at, device) in status.devices.iter().enumerate() {
            let now = (device.al_state, device.al_error);
            match self.states.get_mut(at) {
                None => self.states.push((now.0, now.1, status.at_ns)),
                Some((state, error, _)) if (*state, *error) == now => {}
                Some(known) => *known = (now.0, now.1, status.at_ns),
            }
        }
    }

    /// How far a SubDevice is behind the others; `None` if it keeps up with them, or if it has
    /// been in its state for less than a second.
    pub fn behind(&self, device: &Device) -> Option<Behind> {
        let status = self.status()?;
        let of_others = status.devices.iter().filter(|other| other.asked);
        let others =
            of_others.filter_map(|other| other.al_state).max_by_key(|state| rank(*state))?;
        let at = status.devices.iter().position(|other| other.position == device.position)?;
        let for_ns = status.at_ns - self.states.get(at)?.2;
        let is_behind = device.asked && device.al_state.map_or(0, rank) < rank(others);
        (is_behind && for_ns >= ON_ITS_WAY_NS).then_some(Behind {
            position: device.position,
            for_ns,
            others,
        })
    }

    /// The SubDevices that are behind the others, longest first.
    pub fn all_behind(&self) -> Vec<Behind> {
        let devices = self.status.iter().flat_map(|status| &status.devices);
        let mut all: Vec<_> = devices.filter_map(|device| self.behind(device)).collect();
        all.sort_by_key(|behind| std::cmp::Reverse(behind.for_ns));
        all
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

/// The place of a state on the way up; BOOT is beside it.
fn rank(state: AlState) -> u8 {
    match state {
        AlState::Op => 3,
        AlState::SafeOp => 2,
        AlState::PreOp => 1,
        _ => 0,
    }
}
