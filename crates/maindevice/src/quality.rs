//! How well the segment runs: what its registers and objects say, read in the background within a share of the bus.
//!
//! A `Monitor` says what to read and when, and takes what came back; the machine does the reading. Registers of
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

mod clocks;
mod objects;
mod pace;
mod ring;
mod snapshot;
#[cfg(test)]
mod tests;

pub use crate::alarm::{Alarm, Change, Found, What};
pub use clocks::{ClockQuality, Reading};
pub use objects::{EntryQuality, ObjectQuality};
pub use snapshot::{DeviceQuality, Margin, Moment, Snapshot};

use clocks::Clocks;
pub(crate) use clocks::{Registers, Wanted, read};
use objects::Objects;
use pace::Pace;
pub(crate) use pace::wire_time;
use snapshot::Record;

/// Watches a segment in operation.
#[derive(Clone, Debug)]
pub(crate) struct Monitor {
    began: Time<Host>,
    unled_cycles: u64,
    clocks: Clocks,
    objects: Objects,
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
        let pace = Pace::new(config.share_permille, now);
        let (limit, history) = (config.margin_limit, config.history);
        let clocks = Clocks::new(&config, segment, pace, noise);
        let objects = Objects::new(config.objects, &segment.devices, pace);
        let record = Record::new(limit, history, segment, now, cycle, counts);
        let unled_cycles = config.unled_cycles;
        let mut monitor = Self { began: now, unled_cycles, clocks, objects, record, unled: false };
        monitor.divide_the_share();
        monitor
    }

    /// Each kind has half of the share, if both are there.
    fn divide_the_share(&mut self) {
        let parts = if self.clocks.are_there() && self.objects.are_there() { 2 } else { 1 };
        self.clocks.pace.divide(parts);
        self.objects.pace.divide(parts);
    }

    /// Whether there is something to do.
    pub fn is_due(&self, now: Time<Host>, cycle: u64) -> bool {
        self.clocks.is_due(now) || self.objects.is_due(now) || self.record.is_due(cycle)
    }

    /// Which clocks to read now; none if it is not time.
    pub fn clocks_to_read(&mut self, now: Time<Host>) -> Vec<Wanted> {
        if self.clocks.is_due(now) { self.clocks.batch(now) } else { Vec::new() }
    }

    /// Takes what came back from a clock; gives the alarms that come or go.
    pub fn take_clock(&mut self, index: usize, found: Option<Registers>) -> Vec<Change> {
        self.clocks.sample(index, found)
    }

    /// Which entry to read now, of those whose mailbox is free; none if it is not time.
    pub fn entry_to_read(
        &mut self,
        now: Time<Host>,
        is_free: impl Fn(usize) -> bool,
    ) -> Option<(usize, ObjectAddress)> {
        if self.objects.is_due(now) { self.objects.next(now, is_free) } else { None }
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
        self.objects.pace.charge(now, cost);
        if admitted { self.objects.take(wanted, now, answer) } else { Vec::new() }
    }

    /// Ends a moment if it is time, and looks at states; gives the alarms that come or go.
    pub fn look(
        &mut self,
        now: Time<Host>,
        segment: &Segment,
        cycle: &mut CyclicExchange,
        counts: &Statistics,
    ) -> Vec<Change> {
        let (clocks, objects) = (&mut self.clocks, &mut self.objects);
        let mut changed = false;
        self.record.take_states(now, segment, |device| {
            changed = true;
            clocks.meet(device);
            objects.meet(device);
        });
        if changed {
            self.divide_the_share();
        }
        if !self.record.is_due(cycle.number()) {
            return Vec::new();
        }
        let last = self.clocks.all.iter().filter_map(|clock| clock.last());
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
        for clock in &mut self.clocks.all {
            clock.unled = unled;
        }
        Some(if unled { cycles } else { 0 })
    }

    /// Frames take another way to this clock, and its delay was set right.
    pub fn delay_changed(&mut self, position: usize) {
        self.clocks.forget_slope(position);
    }

    /// All clocks.
    pub fn clocks(&self) -> &[ClockQuality] {
        &self.clocks.all
    }

    /// All that is known.
    pub fn snapshot<'a>(&'a self, now: Time<Host>, cycle: &'a CyclicExchange) -> Snapshot<'a> {
        Snapshot {
            at: now,
            system: cycle.servo().dc_at(now),
            cycle: cycle.number(),
            unled: cycle.unled(),
            working_counters: cycle.wrong(),
            clocks: &self.clocks.all,
            objects: &self.objects.all,
            devices: &self.record.devices,
            moments: &self.record.moments,
        }
    }

    /// Wire time of all reads so far, preambles and gaps included.
    pub fn spent(&self) -> Nanos {
        self.clocks.pace.spent() + self.objects.pace.spent()
    }

    /// Since when it watches.
    pub fn began(&self) -> Time<Host> {
        self.began
    }
}
