//! Chooses the next register or object to read in the background, and keeps the readings.

use alloc::vec::Vec;

use isocat_wire::ObjectAddress;
use isocat_wire::time::{Host, Nanos, Time};

use super::clocks::{ClockQuality, Clocks, Registers, Wanted};
use super::objects::{ObjectQuality, Objects};
use super::pace::Pace;
use crate::alarm::Change;
use crate::config::QualityWatch;
use crate::error::SdoResult;
use crate::segment::{Segment, SubDevice};

/// The registers of clocks and the entries of 0x1C32 and 0x1C33 that are read while a segment runs,
/// within a share of the wire. It does not read itself, so any code that exchanges process data can
/// use it:
///
/// - [`clocks_to_read`](Self::clocks_to_read), then [`take_clock`](Self::take_clock) for each of
///   them;
/// - [`entry_to_read`](Self::entry_to_read), then [`take_entry`](Self::take_entry).
#[derive(Clone, Debug)]
pub struct Background {
    clocks: Clocks,
    objects: Objects,
}

impl Background {
    /// A background from `now` on. `noise`: standard deviation of 0x092C by position (1 sigma).
    pub fn new(config: &QualityWatch, segment: &Segment, now: Time<Host>, noise: &[Nanos]) -> Self {
        let pace = Pace::new(config.share_permille, now);
        let clocks = Clocks::new(config, segment, pace, noise);
        let objects = Objects::new(config.objects, &segment.devices, pace);
        let mut background = Self { clocks, objects };
        background.divide_the_share();
        background
    }

    /// Gives each kind half of the share, if both are present.
    fn divide_the_share(&mut self) {
        let parts = if self.clocks.are_there() && self.objects.are_there() { 2 } else { 1 };
        self.clocks.pace.divide(parts);
        self.objects.pace.divide(parts);
    }

    /// Whether a reading is due.
    pub fn is_due(&self, now: Time<Host>) -> bool {
        self.clocks.is_due(now) || self.objects.is_due(now)
    }

    /// The clocks to read now; empty if it is not time.
    pub fn clocks_to_read(&mut self, now: Time<Host>) -> Vec<Wanted> {
        let mut wanted = Vec::new();
        if self.clocks.is_due(now) {
            self.clocks.batch(now, (CLOCKS_AT_ONCE, usize::MAX), &mut wanted, &mut Vec::new());
        }
        wanted
    }

    /// Whether clocks are due.
    pub(super) fn has_clocks_to_read(&self, now: Time<Host>) -> bool {
        self.clocks.is_due(now)
    }

    /// See [`Clocks::batch`].
    pub(super) fn next_clocks(
        &mut self,
        now: Time<Host>,
        most: (usize, usize),
        wanted: &mut Vec<Wanted>,
        datagrams: &mut Vec<u8>,
    ) {
        self.clocks.batch(now, most, wanted, datagrams);
    }

    /// Whether an entry is due.
    pub(super) fn has_entry_to_read(&self, now: Time<Host>) -> bool {
        self.objects.is_due(now)
    }

    /// Takes the answer of a clock, `None` without an answer; returns the alarms that come or end.
    #[inline]
    pub fn take_clock(&mut self, index: usize, found: Option<Registers>) -> Vec<Change> {
        self.clocks.sample(index, found)
    }

    /// Takes the answer of a clock without judging it: see [`Clocks::take`].
    #[inline(always)]
    pub(super) fn keep_clock(&mut self, index: usize, found: Registers) -> bool {
        self.clocks.take(index, found)
    }

    /// Judges an answer that was taken.
    pub(super) fn judge_clock(&mut self, index: usize, found: Option<Registers>) -> Vec<Change> {
        self.clocks.judge(index, found)
    }

    /// The entry to read now, of SubDevices with a free mailbox; `None` if it is not time.
    pub fn entry_to_read(
        &mut self,
        now: Time<Host>,
        is_free: impl Fn(usize) -> bool,
    ) -> Option<(usize, ObjectAddress)> {
        if self.objects.is_due(now) { self.objects.next(now, is_free) } else { None }
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
        self.objects.pace.charge(now, cost);
        if admitted { self.objects.take(wanted, now, answer) } else { Vec::new() }
    }

    /// Called when the state of this SubDevice has changed.
    pub(super) fn meet(&mut self, device: &SubDevice) {
        self.clocks.meet(device);
        self.objects.meet(device);
        self.divide_the_share();
    }

    /// Sets whether drift frames fail to reach all clocks.
    pub(super) fn set_unled(&mut self, unled: bool) {
        for clock in &mut self.clocks.all {
            clock.set_unled(unled);
        }
    }

    /// Called when frames take another way to this clock and its delay was corrected.
    pub(super) fn delay_changed(&mut self, position: usize) {
        self.clocks.forget_slope(position);
    }

    /// All clocks but the reference clock.
    pub fn clocks(&self) -> &[ClockQuality] {
        &self.clocks.all
    }

    /// The readings of the objects, by position.
    pub fn objects(&self) -> &[ObjectQuality] {
        &self.objects.all
    }

    /// Wire time of all reads so far, including preambles and gaps.
    pub fn spent(&self) -> Nanos {
        self.clocks.pace.spent() + self.objects.pace.spent()
    }
}

/// Number of clocks that are read together, where each is a datagram of its own to the reader.
const CLOCKS_AT_ONCE: usize = 8;
