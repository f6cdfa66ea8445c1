//! Which register or object to read next in the background, and what was read.

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

/// The registers of clocks and the entries of 0x1C32 and 0x1C33 that are read while a segment runs, within a share of the
/// wire. It reads nothing itself, so that anybody who exchanges process data can use it:
///
/// - [`clocks_to_read`](Self::clocks_to_read), then [`take_clock`](Self::take_clock) for each of them;
/// - [`entry_to_read`](Self::entry_to_read), then [`take_entry`](Self::take_entry).
#[derive(Clone, Debug)]
pub struct Background {
    clocks: Clocks,
    objects: Objects,
}

impl Background {
    /// Begins at `now`. `noise`: standard deviation of 0x092C by position (1 sigma).
    pub fn new(config: &QualityWatch, segment: &Segment, now: Time<Host>, noise: &[Nanos]) -> Self {
        let pace = Pace::new(config.share_permille, now);
        let clocks = Clocks::new(config, segment, pace, noise);
        let objects = Objects::new(config.objects, &segment.devices, pace);
        let mut background = Self { clocks, objects };
        background.divide_the_share();
        background
    }

    /// Each kind has half of the share, if both are there.
    fn divide_the_share(&mut self) {
        let parts = if self.clocks.are_there() && self.objects.are_there() { 2 } else { 1 };
        self.clocks.pace.divide(parts);
        self.objects.pace.divide(parts);
    }

    /// Whether something is to be read.
    pub fn is_due(&self, now: Time<Host>) -> bool {
        self.clocks.is_due(now) || self.objects.is_due(now)
    }

    /// Which clocks to read now; none if it is not time.
    pub fn clocks_to_read(&mut self, now: Time<Host>) -> Vec<Wanted> {
        if self.clocks.is_due(now) { self.clocks.batch(now) } else { Vec::new() }
    }

    /// Takes what came back from a clock, `None` if nothing did; gives the alarms that come or go.
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

    /// The states of these SubDevices have changed.
    pub(super) fn meet(&mut self, device: &SubDevice) {
        self.clocks.meet(device);
        self.objects.meet(device);
        self.divide_the_share();
    }

    /// Whether drift frames fail to reach all clocks.
    pub(super) fn set_unled(&mut self, unled: bool) {
        for clock in &mut self.clocks.all {
            clock.unled = unled;
        }
    }

    /// Frames take another way to this clock, and its delay was set right.
    pub(super) fn delay_changed(&mut self, position: usize) {
        self.clocks.forget_slope(position);
    }

    /// All clocks but the reference's own.
    pub fn clocks(&self) -> &[ClockQuality] {
        &self.clocks.all
    }

    /// What the objects said, by position.
    pub fn objects(&self) -> &[ObjectQuality] {
        &self.objects.all
    }

    /// Wire time of all reads so far, preambles and gaps included.
    pub fn spent(&self) -> Nanos {
        self.clocks.pace.spent() + self.objects.pace.spent()
    }
}
