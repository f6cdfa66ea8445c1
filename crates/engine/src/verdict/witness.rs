//! What the engine asks of a MainDevice.

use isocat_maindevice::MainDevice;
use isocat_maindevice::quality::{ClockQuality, ObjectQuality};
use isocat_maindevice::segment::Segment;
use isocat_maindevice::statistics::Statistics;
use isocat_sync::phase;

/// A MainDevice in operation: our own, or one that plays another tool's start-up list. All of it stays the same where
/// nothing came in.
pub trait Witness {
    /// Counts so far.
    fn statistics(&self) -> Statistics;
    /// The SubDevices by position, the reference clock, and the plan of the cycle, as far as there is one.
    fn segment(&self) -> &Segment;
    /// What the servo knows; `None` without a reference clock.
    fn phase(&self) -> Option<phase::State>;
    /// Clocks that are read in the background.
    fn clocks(&self) -> &[ClockQuality];
    /// Objects that are read in the background, by position; `None`: nothing is read in the background.
    fn objects(&self) -> Option<&[ObjectQuality]>;
    /// Whether delays are measured while the segment runs.
    fn watches_delays(&self) -> bool;
}

impl Witness for MainDevice {
    fn statistics(&self) -> Statistics {
        self.statistics()
    }

    fn segment(&self) -> &Segment {
        self.segment()
    }

    fn phase(&self) -> Option<phase::State> {
        self.phase()
    }

    fn clocks(&self) -> &[ClockQuality] {
        self.quality()
    }

    fn objects(&self) -> Option<&[ObjectQuality]> {
        self.snapshot().map(|snapshot| snapshot.objects)
    }

    fn watches_delays(&self) -> bool {
        self.watches_delays()
    }
}
