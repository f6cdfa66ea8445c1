//! Finds the SubDevices that a frame concerns, so that a datagram costs only as much as the
//! SubDevices that it addresses, not as the whole segment.
//!
//! Places are counted in processing order. Indexes hold the possible addresses of each ESC
//! ([`Reach`]); they are rebuilt when a datagram needs them after a change. ESCs whose reach may
//! change by itself are listed, and updated before the audience of a frame is gathered.

use isocat_esc::Reach;
use isocat_wire::Command;

use crate::datagrams::Item;

/// The reaches of all places, and the indexes over them.
pub(crate) struct Audience {
    reaches: Vec<Reach>,
    versions: Vec<u64>,
    /// Places whose reach may have changed when the next frame comes, and a mark for each place.
    restless: Vec<u32>,
    is_restless: Vec<bool>,
    /// Whether the indexes below are up to date, and how often they were not.
    indexed: bool,
    changes: u64,
    /// Station addresses and aliases.
    stations: Vec<(u16, u32)>,
    /// Places sorted by the beginning of their logical addresses, and the furthest end up to each
    /// of them.
    logical: Vec<(u64, u32)>,
    furthest: Vec<u64>,
    adding_events: Vec<u32>,
    marking: usize,
    stopping: usize,
    /// The audience of the present frame, ascending.
    visits: Vec<u32>,
}

impl Audience {
    /// An audience of this number of places, whose reaches are unknown.
    pub fn new(places: usize) -> Self {
        Self {
            reaches: vec![Reach::default(); places],
            versions: vec![UNKNOWN; places],
            restless: (0..places as u32).collect(),
            is_restless: vec![true; places],
            indexed: false,
            changes: 0,
            stations: Vec::with_capacity(2 * places),
            logical: Vec::with_capacity(places),
            furthest: Vec::with_capacity(places),
            adding_events: Vec::with_capacity(places),
            marking: 0,
            stopping: 0,
            visits: Vec::with_capacity(places),
        }
    }

    /// Updates the reach of a place if its version has changed.
    #[inline]
    pub fn update(&mut self, place: usize, version: u32, reach: impl FnOnce() -> Reach) {
        if self.versions[place] != u64::from(version) {
            self.versions[place] = version.into();
            self.replace(place, reach());
        }
    }

    #[inline(never)]
    fn replace(&mut self, place: usize, new: Reach) {
        let old = self.reaches[place];
        if new == old {
            return;
        }
        let count = |was: bool, is: bool, of: usize| of - usize::from(was) + usize::from(is);
        self.marking = count(old.marks_frames, new.marks_frames, self.marking);
        self.stopping = count(old.stops_circulating, new.stops_circulating, self.stopping);
        self.reaches[place] = new;
        self.indexed = false;
        self.changes += 1;
    }

    /// Marks a place whose reach may change by itself before the next frame comes.
    pub fn disturb(&mut self, place: usize) {
        if !self.is_restless[place] {
            self.is_restless[place] = true;
            self.restless.push(place as u32);
        }
    }

    /// Number of places to check before the next frame.
    pub fn restless(&self) -> usize {
        self.restless.len()
    }

    /// One of these places.
    pub fn restless_place(&self, number: usize) -> usize {
        self.restless[number] as usize
    }

    /// Unmarks a place that has settled; the last place takes its number.
    pub fn calm(&mut self, number: usize) {
        let place = self.restless.swap_remove(number);
        self.is_restless[place as usize] = false;
    }

    /// Whether a place stops circulating frames; every place then sees every frame.
    pub fn stops_circulating(&self) -> bool {
        self.stopping > 0
    }

    /// Whether one of the first `places` marks the source address of frames.
    pub fn marks_frames(&self, places: usize) -> bool {
        self.marking > 0 && self.reaches[..places].iter().any(|reach| reach.marks_frames)
    }

    /// Whether a datagram may concern a place.
    pub fn concerns(&self, place: usize, item: &Item) -> bool {
        let reach = &self.reaches[place];
        item.concerns_all()
            || reach.concerns(item.command, item.address_at(place), item.layout.header.len.into())
    }

    /// Finds the audience of a frame and returns its size; `None` means all places. [`Self::visit`]
    /// returns its places.
    pub fn gather(&mut self, items: &[Item]) -> Option<usize> {
        if self.stopping > 0 || items.iter().any(Item::concerns_all) {
            return None;
        }
        Some(self.gather_some(items).len())
    }

    /// The places for which a frame is more than datagrams to all.
    pub fn gather_some(&mut self, items: &[Item]) -> &[u32] {
        self.index();
        self.visits.clear();
        if !items.is_empty() {
            self.visits.extend_from_slice(&self.adding_events);
        }
        for item in items {
            self.add(item);
        }
        self.visits.sort_unstable();
        self.visits.dedup();
        &self.visits
    }

    /// How often the places of a frame may have changed.
    pub fn changes(&self) -> u64 {
        self.changes
    }

    /// A place of the audience, by its number in the audience.
    pub fn visit(&self, number: usize) -> usize {
        self.visits[number] as usize
    }

    fn add(&mut self, item: &Item) {
        use Command::*;
        let address = item.layout.header.address;
        let adp = address as u16;
        match item.command {
            Aprd | Apwr | Aprw => {
                let first = usize::from(0u16.wrapping_sub(adp));
                self.visits.extend((first..self.reaches.len()).step_by(1 << 16).map(|p| p as u32));
            }
            Fprd | Fpwr | Fprw => {
                let first = self.stations.partition_point(|(station, _)| *station < adp);
                let found = self.stations[first..].iter().take_while(|(s, _)| *s == adp);
                self.visits.extend(found.map(|(_, place)| *place));
            }
            Lrd | Lwr | Lrw => {
                let start = u64::from(address);
                let end = start + u64::from(item.layout.header.len);
                let behind = self.logical.partition_point(|(first, _)| *first < end);
                let reaching = (0..behind).rev().take_while(|at| self.furthest[*at] > start);
                let (reaches, logical) = (&self.reaches, &self.logical);
                let places = reaching.map(|at| logical[at].1);
                self.visits.extend(places.filter(|p| reaches[*p as usize].logical().end > start));
            }
            Nop | Brd | Bwr | Brw | Armw | Frmw => {}
        }
    }

    fn index(&mut self) {
        if self.indexed {
            return;
        }
        self.indexed = true;
        self.stations.clear();
        self.logical.clear();
        self.adding_events.clear();
        for (place, reach) in (0..).zip(&self.reaches) {
            self.stations.push((reach.station, place));
            self.stations.extend(reach.alias.map(|alias| (alias, place)));
            let logical = reach.logical();
            if !logical.is_empty() {
                self.logical.push((logical.start, place));
            }
            if reach.adds_events {
                self.adding_events.push(place);
            }
        }
        self.stations.sort_unstable();
        self.logical.sort_unstable();
        self.furthest.clear();
        let mut furthest = 0;
        for (_, place) in &self.logical {
            furthest = furthest.max(self.reaches[*place as usize].logical().end);
            self.furthest.push(furthest);
        }
    }
}

/// A version of no reach.
const UNKNOWN: u64 = u64::MAX;
