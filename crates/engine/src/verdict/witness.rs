//! The interface of a MainDevice to the engine.

use isocat_maindevice::MainDevice;
use isocat_maindevice::quality::{ClockQuality, ObjectQuality};
use isocat_maindevice::segment::Segment;
use isocat_maindevice::statistics::Statistics;
use isocat_sync::phase;

/// A MainDevice in operation: our own, or one that plays another tool's start-up list. All values
/// stay the same if no frame came in.
pub trait Witness {
    /// Counts so far.
    fn statistics(&self) -> &Statistics;
    /// The SubDevices by position, the reference clock, and the plan of the cycle if there is one.
    fn segment(&self) -> &Segment;
    /// The state of the servo; `None` without a reference clock.
    fn phase(&self) -> Option<phase::State>;
    /// Clocks that are read in the background.
    fn clocks(&self) -> &[ClockQuality];
    /// Objects that are read in the background, by position; `None` if there are no background
    /// reads.
    fn objects(&self) -> Option<&[ObjectQuality]>;
    /// Whether delays are measured while the segment runs.
    fn watches_delays(&self) -> bool;
}

impl Witness for MainDevice {
    fn statistics(&self) -> &Statistics {
        self.counts()
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
        self.object_quality()
    }

    fn watches_delays(&self) -> bool {
        self.watches_delays()
    }
}
