//! Quality of the running segment: its registers and objects, read in the background within a share
//! of the bus.
//!
//! A `Monitor` tells what to read and when ([`Background`]), and takes the answers; the machine
//! does the reading. Registers of clocks (`clocks`) travel as separate datagrams, error counters
//! and distances (`objects`) by SDO through each SubDevice's mailbox. Each kind has its `Pace`:
//! half of the share if both are present. States, working counters and the lateness of frames
//! (`snapshot`) come with the cycle without further cost. A value that leaves its limits or comes
//! back is reported as a [`Change`] of an [`Alarm`]. It takes several readings in a row, so that a
//! single reading raises no alarm; counters are the exception, since every error counts.
//!
//! Readings are kept in ring buffers that are allocated once.

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
mod reads;
mod ring;
mod round;
mod snapshot;
#[cfg(test)]
mod tests;

pub use crate::alarm::{Alarm, Change, Found, What};
pub use background::Background;
pub use clocks::{ClockQuality, Reading, Registers, Wanted};
pub use objects::{EntryQuality, ObjectQuality};
pub use snapshot::{DeviceQuality, Margin, Moment, Snapshot};

pub use pace::wire_time;
pub(crate) use reads::Reads;
#[cfg(test)]
pub(crate) use reads::ask;
use snapshot::Record;

/// Watches a segment in operation.
#[derive(Clone, Debug)]
pub(crate) struct Monitor {
    began: Time<Host>,
    unled_cycles: u64,
    background: Background,
    /// Number of clocks that may have been read by the present cycle, if some are to be read now:
    /// see [`CLOCKS_A_CYCLE`].
    clocks_read: u64,
    record: Record,
    /// Whether it was reported that clocks are not controlled.
    unled: bool,
}

impl Monitor {
    /// Watches a segment from `now` on; `cycle` is the last one begun. `noise`: standard deviation
    /// of 0x092C by position (1 sigma).
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
        Self {
            began: now,
            unled_cycles: config.unled_cycles,
            background,
            clocks_read: 0,
            record,
            unled: false,
        }
    }

    /// Whether something is due; `unled` is the number of cycles that [`Self::guidance`] takes.
    #[inline]
    pub fn is_due(&self, now: Time<Host>, cycle: u64, unled: Option<u64>) -> bool {
        self.has_clocks_to_read(now, cycle)
            || self.background.has_entry_to_read(now)
            || self.record.is_due(cycle)
            || unled.is_some_and(|cycles| (cycles >= self.unled_cycles) != self.unled)
    }

    /// Whether clocks are due.
    pub fn has_clocks_to_read(&self, now: Time<Host>, cycle: u64) -> bool {
        cycle * CLOCKS_A_CYCLE >= self.clocks_read && self.background.has_clocks_to_read(now)
    }

    /// Puts the clocks that are due into the empty `wanted`, as many as can be read in a frame of
    /// `octets` bytes, and the datagrams that read them into the empty `datagrams`.
    pub fn clocks_to_read(
        &mut self,
        now: Time<Host>,
        cycle: u64,
        octets: usize,
        wanted: &mut Vec<Wanted>,
        datagrams: &mut Vec<u8>,
    ) {
        self.background.next_clocks(now, (CLOCKS_IN_A_FRAME, octets), wanted, datagrams);
        // A batch that is late within its cycle or the next one delays none of the others.
        let read = (cycle * CLOCKS_A_CYCLE + 1).saturating_sub(CLOCKS_A_CYCLE);
        self.clocks_read = self.clocks_read.max(read) + wanted.len() as u64;
    }

    /// Whether an entry is due.
    pub fn has_entry_to_read(&self, now: Time<Host>) -> bool {
        self.background.has_entry_to_read(now)
    }

    /// Takes the answer of a clock; returns the alarms that come or end.
    #[cfg(test)]
    pub fn take_clock(&mut self, index: usize, found: Option<Registers>) -> Vec<Change> {
        self.background.take_clock(index, found)
    }

    /// Takes the answer of a clock without judging it; returns whether no alarm changes by it. If
    /// not, call [`Self::judge_clock`].
    #[inline(always)]
    pub fn keep_clock(&mut self, index: usize, found: Registers) -> bool {
        self.background.keep_clock(index, found)
    }

    /// Judges an answer that was taken, `None` without one; returns the alarms that come or end.
    pub fn judge_clock(&mut self, index: usize, found: Option<Registers>) -> Vec<Change> {
        self.background.judge_clock(index, found)
    }

    /// The entry to read now, of SubDevices with a free mailbox; `None` if it is not time.
    pub fn entry_to_read(
        &mut self,
        now: Time<Host>,
        is_free: impl Fn(usize) -> bool,
    ) -> Option<(usize, ObjectAddress)> {
        self.background.entry_to_read(now, is_free)
    }

    /// Takes the answer of such a reading and its cost on the wire; returns the alarms that come or
    /// end. If the SubDevice is not `admitted` any more, only the cost counts.
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

    /// Called when the state of a SubDevice in the segment has changed: the next look takes it.
    pub fn states_changed(&mut self) {
        self.record.stale = true;
    }

    /// Ends a moment if it is time, and checks states; returns the alarms that come or end.
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

    /// Takes the number of cycles since a drift frame reached all clocks; returns the number to
    /// report, which is 0 when a frame reaches them again.
    pub fn guidance(&mut self, cycles: u64) -> Option<u64> {
        let unled = cycles >= self.unled_cycles;
        if unled == self.unled {
            return None;
        }
        self.unled = unled;
        self.background.set_unled(unled);
        Some(if unled { cycles } else { 0 })
    }

    /// Called when frames take another way to this clock and its delay was corrected.
    pub fn delay_changed(&mut self, position: usize) {
        self.background.delay_changed(position);
    }

    /// All clocks.
    pub fn clocks(&self) -> &[ClockQuality] {
        self.background.clocks()
    }

    /// The readings of objects, by position.
    pub fn objects(&self) -> &[ObjectQuality] {
        self.background.objects()
    }

    /// All present readings.
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

    /// Wire time of all reads so far, including preambles and gaps.
    pub fn spent(&self) -> Nanos {
        self.background.spent()
    }

    /// When it began to watch.
    pub fn began(&self) -> Time<Host> {
        self.began
    }
}

/// Most clocks that are read in one frame: nine tenths of the longest one, which the wire carries
/// in 90 us.
const CLOCKS_IN_A_FRAME: usize = 32;
/// Most clocks that are read on average in one cycle, however long it is. In short cycles the share
/// of the wire allows fewer.
const CLOCKS_A_CYCLE: u64 = 8;
