//! What is not known of a segment, and why.

use isocat_maindevice::kinds;
use isocat_sim::Place;
use isocat_wire::time::Nanos;

use super::{Verdict, Witness};

/// Something that is not known.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Unknown {
    /// Of which SubDevice, or of the segment.
    pub place: Place,
    /// What, with its figures.
    pub kind: Gap,
}

kinds! {
    /// What is not known. Some of these leave the answer open ([`Gap::decides`]); the others say what no wire shows.
    #[derive(Clone, Copy, PartialEq, Eq, Debug)]
    pub enum Gap {
        /// In some cycles no time of the reference clock came back, so nothing tells when their frames reached the SubDevices.
        FrameTimes = "frame-times" {
            /// Cycles.
            cycles: u64,
        },
        /// Frames came so late that outputs were in time only if the clocks agree better than the plan assumes.
        OutputsMaybeLate = "outputs-maybe-late" {
            /// Cycles.
            cycles: u64,
            /// By how much at most, with the worst clocks.
            by: Nanos,
        },
        /// Frames came so early that inputs were ready only if the clocks agree better than the plan assumes.
        FramesMaybeEarly = "frames-maybe-early" {
            /// Cycles.
            cycles: u64,
            /// By how much at most, with the worst clocks.
            by: Nanos,
        },
        /// The SubDevice has no 0x1C32:0B or 0x1C33:0B, and the plan has no figure of how late its frames may be.
        NothingTells = "nothing-tells",
        /// The counters of 0x1C32 and 0x1C33 could not be read.
        CountersNotRead = "counters-not-read",
        /// Register 0x092C was not read while the segment ran.
        ClockNotRead = "clock-not-read",
        /// Drift frames did not reach all clocks for a while, in which 0x092C tells nothing.
        ClocksNotLed = "clocks-not-led" {
            /// Cycles in a row.
            cycles: u64,
        },
        /// The clock stayed within the limit where it was read, and may have left it in between.
        ClockNearLimit = "clock-near-limit" {
            /// What is certain: the worst reading, what the clock moved between readings, and the error of its delay.
            bound: Nanos,
            /// The limit.
            limit: Nanos,
        },
        /// Nothing is read in the background, so what happened between beginning and end is not known.
        BackgroundOff = "background-off",
        /// Events were dropped because they were not taken.
        EventsDropped = "events-dropped" {
            /// How many.
            count: u64,
        },
        /// A miss that the SubDevice itself caused can have been paid off between two readings of 0x1C32:0B, which goes
        /// down by itself; misses that frames caused are computed.
        OwnMisses = "own-misses" {
            /// The longest time between two readings.
            longest: Nanos,
        },
        /// The SubDevice has no 0x1C32:0B or 0x1C33:0B: misses that it causes itself show nowhere; those that frames caused
        /// are computed.
        NoCounter = "no-counter",
        /// Delays are not measured while the segment runs: a cable that is exchanged moves clocks, and 0x092C does not show
        /// it.
        DelaysNotWatched = "delays-not-watched",
        /// No register shows when a pulse and outputs appear at the pins: how evenly outputs follow SYNC0 is not known.
        Pins = "pins",
    }
}

impl Gap {
    /// Whether it leaves the answer open: something that could have been read was not, or what was read does not exclude
    /// a loss. The others say what registers and frames never show; they are told and change no answer.
    pub const fn decides(&self) -> bool {
        match self {
            Self::FrameTimes { .. }
            | Self::OutputsMaybeLate { .. }
            | Self::FramesMaybeEarly { .. }
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

/// What registers and frames never show of this segment.
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
