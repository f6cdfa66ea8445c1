//! Ports that stamp the next frame, whatever its content: see [`Chip::stamps_next_frame`].
//!
//! A frame passes the whole segment at once in the simulation. When it enables a port, frames that
//! left before it may still be in flight behind that port and arrive there first. So frames are
//! remembered while they are in flight. A port that no frame has reached yet waits for the
//! following frames.
//!
//! Frames that were lost are not remembered.
//!
//! [`Chip::stamps_next_frame`]: isocat_esc::Chip::stamps_next_frame

use std::collections::VecDeque;

use isocat_esc::Chip;
use isocat_wire::PortNumber;
use isocat_wire::time::{Time, True};

use crate::path::Arrival;
use crate::segment::Segment;
use crate::wiring::MainPort;

/// The memory of a segment with such a chip.
#[derive(Default)]
pub(crate) struct NextFrame {
    /// Whether a chip of the segment stamps the next frame.
    exists: bool,
    /// Frames that may be in flight: their port and send time.
    under_way: VecDeque<(MainPort, Time<True>)>,
    /// For each port of the MainDevice: the arrivals of its frames at ports that wait for one.
    waiting: [Vec<Arrival>; 2],
}

impl NextFrame {
    /// A memory without frames.
    pub fn new(exists: bool) -> Self {
        Self { exists, ..Self::default() }
    }

    /// Takes the chip of a SubDevice that has come.
    pub fn note_chip(&mut self, chip: &Chip) {
        self.exists |= chip.stamps_next_frame;
    }

    /// Whether a chip of the segment stamps the next frame.
    pub const fn exists(&self) -> bool {
        self.exists
    }
}

/// More frames than are ever in flight: 256 of the shortest ones take 1.7 ms.
const MOST_UNDER_WAY: usize = 256;

impl Segment {
    /// Remembers a frame that has passed, and stamps it at ports that wait for one.
    pub(crate) fn remember_frame(&mut self, from: MainPort, start: Time<True>) {
        if !self.next_frame.exists {
            return;
        }
        let waiting = std::mem::take(&mut self.next_frame.waiting[from as usize]);
        for arrival in &waiting {
            self.stamp(*arrival, start);
        }
        let stamped = !waiting.is_empty();
        self.next_frame.waiting[from as usize] = waiting;
        if stamped {
            self.find_waiting_ports();
        }
        let paths = &self.paths;
        let under_way = &mut self.next_frame.under_way;
        let is_back = |(from, left): &(MainPort, Time<True>)| {
            *left + paths[*from as usize].round_trip < start
        };
        while under_way.front().is_some_and(is_back) || under_way.len() >= MOST_UNDER_WAY {
            under_way.pop_front();
        }
        under_way.push_back((from, start));
    }

    /// Handles a frame that enabled ports; `own` are its arrivals. Each port gets the first frame
    /// that arrives there.
    pub(crate) fn stamp_next_frames(&mut self, start: Time<True>, own: &[Arrival]) {
        if !self.next_frame.exists {
            return;
        }
        let devices = &self.devices;
        let waits = |arrival: &Arrival| devices[arrival.device].esc.awaits_frame(arrival.port);
        let mut arrivals: Vec<(Arrival, Time<True>)> = Vec::new();
        for (from, left) in &self.next_frame.under_way {
            let path = &self.paths[*from as usize];
            let all = path.entries.iter().chain(&path.returns);
            arrivals.extend(all.filter(|at| waits(at)).map(|at| (*at, *left)));
        }
        arrivals.extend(own.iter().filter(|at| waits(at)).map(|at| (*at, start)));
        arrivals.sort_unstable_by_key(|(arrival, left)| (*left + arrival.after, arrival.device));
        for (arrival, left) in arrivals {
            self.stamp(arrival, left);
        }
        self.find_waiting_ports();
    }

    /// Finds the waiting ports that frames reach on their present way.
    pub(crate) fn find_waiting_ports(&mut self) {
        if !self.next_frame.exists {
            return;
        }
        let devices = &self.devices;
        for (waiting, path) in self.next_frame.waiting.iter_mut().zip(&self.paths) {
            let all = path.entries.iter().chain(&path.returns);
            let waits = |at: &&Arrival| devices[at.device].esc.awaits_frame(at.port);
            waiting.clear();
            waiting.extend(all.filter(waits));
        }
    }

    fn stamp(&mut self, arrival: Arrival, left: Time<True>) {
        debug_assert_ne!(arrival.port, PortNumber::P0, "port 0 stamps the frame that writes");
        let device = &mut self.devices[arrival.device];
        let at = device.oscillator().read(left + arrival.after);
        device.esc.receive_at_port(arrival.port, at);
    }
}
