//! What is not known of a segment, and why.

use isocat_maindevice::kinds;
use isocat_sim::Place;
use isocat_wire::time::Nanos;

use super::{Verdict, Witness};

/// Something that is not known.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Unknown {
    /// The SubDevice, or the segment.
    pub place: Place,
    /// The gap, with its figures.
    pub kind: Gap,
}

kinds! {
    /// A gap in the knowledge of a segment. Some leave the answer open ([`Gap::decides`]); the
    /// others state what no wire shows.
    #[derive(Clone, Copy, PartialEq, Eq, Debug)]
    pub enum Gap {
        /// In some cycles no time of the reference clock came back, so the arrival of their frames
        /// at the SubDevices is not known.
        FrameTimes = "frame-times" {
            /// Number of cycles.
            cycles: u64,
        },
        /// Frames came so late that outputs were in time only if the clocks agree better than the
        /// plan assumes.
        OutputsMaybeLate = "outputs-maybe-late" {
            /// Number of cycles.
            cycles: u64,
            /// Largest lateness, with the worst clocks.
            by: Nanos,
        },
        /// Frames came so early that inputs were ready only if the clocks agree better than the
        /// plan assumes.
        FramesMaybeEarly = "frames-maybe-early" {
            /// Number of cycles.
            cycles: u64,
            /// Largest earliness, with the worst clocks.
            by: Nanos,
        },
        /// Frames came back when the next cycle had begun, and no time of a reference clock tells
        /// when they had come to SubDevices: outputs or inputs may be a cycle late.
        ReturnedLate = "returned-late" {
            /// Number of frames.
            frames: u64,
        },
        /// The SubDevice has no 0x1C32:0B or 0x1C33:0B, and the plan has no limit for the lateness
        /// of its frames.
        NothingTells = "nothing-tells",
        /// The counters of 0x1C32 and 0x1C33 could not be read.
        CountersNotRead = "counters-not-read",
        /// Register 0x092C was not read while the segment ran.
        ClockNotRead = "clock-not-read",
        /// Drift frames did not reach all clocks for a while, in which 0x092C is meaningless.
        ClocksNotLed = "clocks-not-led" {
            /// Consecutive cycles.
            cycles: u64,
        },
        /// The clock was within the limit at each reading, and may have exceeded it in between.
        ClockNearLimit = "clock-near-limit" {
            /// The certain bound: the worst reading, the movement of the clock between readings,
            /// and the error of its delay.
            bound: Nanos,
            /// The limit.
            limit: Nanos,
        },
        /// There are no background reads, so events between beginning and end are not known.
        BackgroundOff = "background-off",
        /// Events were dropped because the application did not take them.
        EventsDropped = "events-dropped" {
            /// Number of events.
            count: u64,
        },
        /// A miss that the SubDevice itself caused may have been cleared between two readings of
        /// 0x1C32:0B, which goes down by itself; misses that frames caused are computed.
        OwnMisses = "own-misses" {
            /// The longest time between two readings.
            longest: Nanos,
        },
        /// The SubDevice has no 0x1C32:0B or 0x1C33:0B: misses that it causes itself are not
        /// visible; those that frames caused are computed.
        NoCounter = "no-counter",
        /// Delays are not measured while the segment runs: a cable that is replaced shifts clocks,
        /// and 0x092C does not show it.
        DelaysNotWatched = "delays-not-watched",
        /// No register shows when a pulse and outputs appear at the pins, so the spread of outputs
        /// after SYNC0 is not known.
        Pins = "pins",
    }
}

impl Gap {
    /// Whether it leaves the answer open: something that could have been read was not, or the
    /// readings do not exclude a loss. The others state what registers and frames never show; they
    /// are reported and change no answer.
    pub const fn decides(&self) -> bool {
        match self {
            Self::FrameTimes { .. }
            | Self::OutputsMaybeLate { .. }
            | Self::FramesMaybeEarly { .. }
            | Self::ReturnedLate { .. }
            | Self::NothingTells
            | Self::CountersNotRead
            | Self::ClockNotRead
            | Self::ClocksNotLed { .. }
            | Self::ClockNearLimit { .. }
            | Self::BackgroundOff
            | Self::EventsDropped { .. } => true,
            Self::OwnMisses { .. } | Self::NoCounter | Self::DelaysNotWatched | Self::Pins => false,
        }
    }
}

/// Adds the gaps that registers and frames never close for this segment.
pub(super) fn out_of_sight(main: &impl Witness, verdict: &mut Verdict) {
    let segment = main.segment();
    let synchronized = segment.devices.iter().filter(|device| device.mode.uses_dc()).count();
    if synchronized == 0 {
        return;
    }
    if synchronized > 1 && !main.watches_delays() {
        verdict.doubt(Place::SEGMENT, Gap::DelaysNotWatched);
    }
    verdict.doubt(Place::SEGMENT, Gap::Pins);
}
