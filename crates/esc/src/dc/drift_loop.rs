//! The drift loop: how a received system time becomes a speed.
//!
//! Published are the registers, the two filters, the limits of the speed counter difference and what it
//! means for the speed (see `clock`): all that is in [`DriftLoop`]. How a time difference becomes a
//! speed counter difference is not published: that is one function, [`DriftModel::steer`], and can be
//! replaced by [`Esc::with_drift_model`](crate::Esc::with_drift_model). The model in use unless told
//! otherwise is [`ProportionalIntegral`].

use isocat_wire::dc::SystemTimeDifference;
use isocat_wire::time::{Device, Nanos, Time};

/// Reset value of register 0x0930.
pub(crate) const START: u16 = 0x1000;
/// Least useful value of register 0x0930.
pub(crate) const START_MIN: u16 = 0x0080;
/// Largest useful value of register 0x0930.
pub(crate) const START_MAX: u16 = 0x3FFF;
/// Reset value of register 0x0934.
pub(crate) const TIME_FILTER_DEPTH: u8 = 4;
/// Reset value of register 0x0935.
pub(crate) const SPEED_FILTER_DEPTH: u8 = 12;

/// The unpublished part of the drift loop.
pub trait DriftModel: Sync {
    /// The speed counter difference wanted from now on, with [`DRIFT_FRACTION`] fraction bits; positive
    /// makes the clock faster. Called once for each received system time. The loop clamps what it gives
    /// to what register 0x0932 can hold.
    fn steer(&self, input: &DriftInput) -> i64;
}

/// What a [`DriftModel`] knows when a system time was received.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct DriftInput {
    /// Local copy less received time, ns: positive when the local copy is ahead.
    pub difference: i32,
    /// The same after the filter of register 0x0934, with [`DRIFT_FRACTION`] fraction bits.
    pub filtered: i64,
    /// Time since the last one, ns by the device's oscillator; 0 for the first.
    pub interval: i64,
    /// Register 0x0934, 0..=15.
    pub time_depth: u8,
    /// Register 0x0930, within 0x0080..=0x3FFF.
    pub start: u16,
    /// The speed counter difference in force, with [`DRIFT_FRACTION`] fraction bits.
    pub applied: i64,
    /// Its mean after the filter of register 0x0935, with [`DRIFT_FRACTION`] fraction bits.
    pub mean: i64,
}

/// Fraction bits of the drift loop's filters.
pub const DRIFT_FRACTION: u32 = 20;

/// A proportional and integral controller in which the mean of the applied difference is the integral
/// part:
///
/// ```text
/// applied = clamp(mean - gain * clamp(filtered difference))
/// mean   += (applied - mean) / 2^(speed counter filter depth)        (the filter of register 0x0935)
/// ```
///
/// With the usual filter depth of 12 about 15000 received times are needed to settle, as MainDevices
/// are advised to send; the integral cannot wind up, since it follows what is applied.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct ProportionalIntegral {
    /// Speed counter difference for each ns of time difference, from a speed counter start of 0x1000
    /// on; below, where a unit is worth more, in proportion to the start. Larger locks faster and
    /// follows the 10 ns grain of received times more.
    pub gain: u16,
    /// Largest time difference that steers, ns.
    pub limit: u16,
}

impl ProportionalIntegral {
    /// The model in use unless told otherwise. A gain of 4 corrects a difference with a time constant
    /// of about 20 ms at the reset value of 0x0930, and is stable at one received time a millisecond
    /// over the whole range of 0x0930 (a constant gain is not below about 0x0400). At 1000 ns the
    /// gain asks for the whole range of 0x0932 at that reset value, so that more would make no
    /// difference there.
    pub const DEFAULT: Self = Self { gain: 4, limit: 1_000 };
}

impl DriftModel for ProportionalIntegral {
    fn steer(&self, input: &DriftInput) -> i64 {
        let limit = i64::from(self.limit) << DRIFT_FRACTION;
        let steering = input.filtered.clamp(-limit, limit);
        let share = i64::from(input.start.min(START));
        let wanted = i64::from(self.gain) * (steering * share / i64::from(START));
        input.mean - self.patient(wanted, steering, input)
    }
}

impl ProportionalIntegral {
    /// What is steered lasts until the next time is received. Where those are so far apart that it would
    /// correct more than the whole difference by then (a filter counts as so many received times more), it
    /// is limited to that: else the loop would overshoot.
    ///
    /// A unit of difference D at a start of A - 2 changes the speed by (A² + D²) / (5 (A² - D²)²).
    fn patient(&self, wanted: i64, steering: i64, input: &DriftInput) -> i64 {
        let (a, d) = (i64::from(input.start) + 2, input.applied >> DRIFT_FRACTION);
        let (sum, product) = (a * a + d * d, a * a - d * d);
        let filter = 1i64 << input.time_depth.saturating_sub(2).min(13);
        let whole = 5 * product * product;
        let turns = sum.saturating_mul(input.interval).saturating_mul(filter);
        if turns.saturating_mul(i64::from(self.gain)) <= whole {
            return wanted;
        }
        let most = i128::from(steering.abs()) * i128::from(whole) / i128::from(turns);
        let most = i64::try_from(most).unwrap_or(i64::MAX);
        wanted.clamp(-most, most)
    }
}

/// The state of the loop. Filters hold fixed-point numbers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DriftLoop {
    /// Time difference as register 0x092C shows it, ns, if there was one since the reset.
    shown: Option<i64>,
    /// Filtered time difference, ns.
    filtered: i64,
    /// Mean speed counter difference.
    mean: i64,
    /// Speed counter difference that the clock has, but for the fraction.
    applied: i64,
    /// When a system time was received last.
    received_at: Option<Time<Device>>,
}

impl DriftLoop {
    /// At rest.
    pub const fn new() -> Self {
        Self { shown: None, filtered: 0, mean: 0, applied: 0, received_at: None }
    }

    /// A system time was received: the local copy is `difference` ns ahead of it, in 32 bits.
    pub fn follow(
        &mut self,
        now: Time<Device>,
        difference: i32,
        received: u32,
        start: u16,
        (time_depth, speed_depth): (u8, u8),
        model: &dyn DriftModel,
    ) {
        let sample = i64::from(difference) << DRIFT_FRACTION;
        if received == 0 {
            // A write that is meant to reset, or a datagram that has not passed the reference clock:
            // it is shown, not followed.
            self.shown = Some(sample);
            return;
        }
        self.filtered += (sample - self.filtered) >> (time_depth & 0x0F);
        self.shown = Some(self.filtered);
        let start = start.clamp(START_MIN, START_MAX);
        let Self { filtered, mean, applied, .. } = *self;
        let interval = self.received_at.replace(now).map_or(0, |last| (now - last).0.max(0));
        let time_depth = time_depth & 0x0F;
        let input = DriftInput { difference, filtered, interval, time_depth, start, applied, mean };
        let wanted = model.steer(&input);
        let range = i64::from(start - 0x7F) << DRIFT_FRACTION;
        self.applied = wanted.clamp(-range, range);
        self.mean += (self.applied - self.mean) >> (speed_depth & 0x0F);
    }

    /// Register 0x0930 was written: everything starts anew.
    pub fn reset(&mut self) {
        *self = Self::new();
    }

    /// Register 0x0934 was written on a newer core: the time difference starts anew, the speed stays.
    pub fn reset_time_filter(&mut self) {
        (self.shown, self.filtered) = (None, 0);
    }

    /// Register 0x0935 was written on a newer core: the mean speed starts anew.
    pub fn reset_speed_filter(&mut self) {
        (self.mean, self.applied) = (0, 0);
    }

    /// Register 0x092C.
    pub fn difference(&self) -> SystemTimeDifference {
        self.shown.map_or(SystemTimeDifference::default(), |shown| {
            SystemTimeDifference::from_nanos(Nanos(round(shown)))
        })
    }

    /// Register 0x0932.
    pub fn mean(&self) -> i16 {
        round(self.mean) as i16
    }

    /// The speed counter difference in force.
    pub const fn applied(&self) -> i16 {
        round(self.applied) as i16
    }
}

/// To the nearest whole number.
const fn round(fixed: i64) -> i64 {
    (fixed + (1 << (DRIFT_FRACTION - 1))) >> DRIFT_FRACTION
}
