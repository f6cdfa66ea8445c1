//! How well the segment runs: what its registers and objects say, read in the background within a share of the bus.
//!
//! A `Monitor` says what to read and when ([`Background`]), and takes what came back; the machine does the reading. Registers of
//! clocks (`clocks`) travel as datagrams of their own, error counters and distances (`objects`) by SDO through each
//! SubDevice's mailbox. Each kind has its `Pace`: half of the share if both are there. States, working
//! counters and how late frames were (`snapshot`) come with the cycle and cost nothing. What leaves its limits and what
//! is back within them comes out as a [`Change`] of an [`Alarm`], after some readings in a row, so that a
//! single one raises nothing; counters are the exception, as one error is one too many.
//!
//! Readings are kept in rings whose memory is taken once.

use alloc::vec::Vec;

use isocat_wire::ObjectAddress;
use isocat_wire::time::{Host, Nanos, Time};

use crate::config::QualityWatch;
use crate::cycle::CyclicExchange;
use crate::error::SdoResult;
use crate::segment::Segment;
use crate::statistics::Statistics;

mod background;
mod clocks;
mod objects;
mod pace;
mod ring;
mod snapshot;
#[cfg(test)]
mod tests;

pub use crate::alarm::{Alarm, Change, Found, What};
pub use background::Background;
pub use clocks::{ClockQuality, Reading, Registers, Wanted};
pub use objects::{EntryQuality, ObjectQuality};
pub use snapshot::{DeviceQuality, Margin, Moment, Snapshot};

pub(crate) use clocks::read;
pub use pace::wire_time;
use snapshot::Record;

/// Watches a segment in operation.
#[derive(Clone, Debug)]
pub(crate) struct Monitor {
    began: Time<Host>,
    unled_cycles: u64,
    background: Background,
    record: Record,
    /// It was told that clocks are not led.
    unled: bool,
}

impl Monitor {
    /// Watches a segment from `now` on, `cycle` being the last one begun. `noise`: standard
    /// deviation of 0x092C by position (1 sigma).
    pub fn new(
        config: QualityWatch,
        segment: &Segment,
        now: Time<Host>,
        cycle: u64,
        counts: &Statistics,
        noise: &[Nanos],
    ) -> Self {
        let (limit, history) = (config.margin_limit, config.history);
        let background = Background::new(&config, segment, now, noise);
        let record = Record::new(limit, history, segment, now, cycle, counts);
        Self { began: now, unled_cycles: config.unled_cycles, background, record, unled: false }
    }

    /// Whether there is something to do.
    pub fn is_due(&self, now: Time<Host>, cycle: u64) -> bool {
        self.background.is_due(now) || self.record.is_due(cycle)
    }

    /// Which clocks to read now; none if it is not time.
    pub fn clocks_to_read(&mut self, now: Time<Host>) -> Vec<Wanted> {
        self.background.clocks_to_read(now)
    }

    /// Takes what came back from a clock; gives the alarms that come or go.
    pub fn take_clock(&mut self, index: usize, found: Option<Registers>) -> Vec<Change> {
        self.background.take_clock(index, found)
    }

    /// Which entry to read now, of those whose mailbox is free; none if it is not time.
    pub fn entry_to_read(
        &mut self,
        now: Time<Host>,
        is_free: impl Fn(usize) -> bool,
    ) -> Option<(usize, ObjectAddress)> {
        self.background.entry_to_read(now, is_free)
    }

    /// Takes the answer to such a reading, and what it cost on the wire; gives the alarms that come or go. Of one that is
    /// `admitted` no longer only the cost counts.
    pub fn take_entry(
        &mut self,
        wanted: (usize, ObjectAddress),
        now: Time<Host>,
        answer: &SdoResult,
        cost: Nanos,
        admitted: bool,
    ) -> Vec<Change> {
        self.background.take_entry(wanted, now, answer, cost, admitted)
    }

    /// Ends a moment if it is time, and looks at states; gives the alarms that come or go.
    pub fn look(
        &mut self,
        now: Time<Host>,
        segment: &Segment,
        cycle: &mut CyclicExchange,
        counts: &Statistics,
    ) -> Vec<Change> {
        let background = &mut self.background;
        self.record.take_states(now, segment, |device| background.meet(device));
        if !self.record.is_due(cycle.number()) {
            return Vec::new();
        }
        let last = self.clocks().iter().filter_map(ClockQuality::last);
        let difference = last.map(|reading| reading.difference.abs()).max().unwrap_or_default();
        self.record.end_moment(now, cycle, counts, difference)
    }

    /// Takes for how many cycles no drift frame reached all clocks; gives what is to be told of it: how many, 0 when it
    /// is over.
    pub fn guidance(&mut self, cycles: u64) -> Option<u64> {
        let unled = cycles >= self.unled_cycles;
        if unled == self.unled {
            return None;
        }
        self.unled = unled;
        self.background.set_unled(unled);
        Some(if unled { cycles } else { 0 })
    }

    /// Frames take another way to this clock, and its delay was set right.
    pub fn delay_changed(&mut self, position: usize) {
        self.background.delay_changed(position);
    }

    /// All clocks.
    pub fn clocks(&self) -> &[ClockQuality] {
        self.background.clocks()
    }

    /// All that is known.
    pub fn snapshot<'a>(&'a self, now: Time<Host>, cycle: &'a CyclicExchange) -> Snapshot<'a> {
        Snapshot {
            at: now,
            system: cycle.servo().dc_at(now),
            cycle: cycle.number(),
            unled: cycle.unled(),
            working_counters: cycle.wrong(),
            clocks: self.background.clocks(),
            objects: self.background.objects(),
            devices: &self.record.devices,
            moments: &self.record.moments,
        }
    }

    /// Wire time of all reads so far, preambles and gaps included.
    pub fn spent(&self) -> Nanos {
        self.background.spent()
    }

    /// Since when it watches.
    pub fn began(&self) -> Time<Host> {
        self.began
    }
}
