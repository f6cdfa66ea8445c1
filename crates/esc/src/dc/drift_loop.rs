//! The drift loop: how a received system time becomes a speed.
//!
//! Published are the registers, the two filters and what a speed counter difference means for the
//! speed (see `clock`). How a time difference becomes a speed counter difference is not published.
//! This file is one model of it, to be replaced as a whole when better is known: a proportional and
//! integral controller in which the mean of the applied difference is the integral part,
//!
//! ```text
//! applied = clamp(mean - GAIN * filtered difference)
//! mean   += (applied - mean) / 2^(speed counter filter depth)
//! ```
//!
//! so that with the usual filter depth of 12 about 15000 received times are needed to settle, as
//! MainDevices are advised to send, and so that the integral cannot wind up.

use isocat_wire::dc::SystemTimeDifference;
use isocat_wire::time::Nanos;

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

/// The state of the loop. Filters hold fixed-point numbers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DriftLoop {
    /// Filtered time difference as register 0x092C shows it, ns.
    difference: i64,
    /// Filtered time difference as it steers, ns, limited.
    steering: i64,
    /// Mean speed counter difference.
    mean: i64,
    /// Speed counter difference applied to the clock.
    applied: i16,
}

impl DriftLoop {
    /// At rest.
    pub const fn new() -> Self {
        Self { difference: 0, steering: 0, mean: 0, applied: 0 }
    }

    /// A system time was received: the local copy is `difference` ns ahead of it, in 32 bits.
    pub fn follow(
        &mut self,
        difference: i32,
        received: u32,
        start: u16,
        (time_depth, speed_depth): (u8, u8),
    ) {
        let sample = i64::from(difference) << FRACTION;
        if received == 0 || difference.unsigned_abs() > PLAUSIBLE {
            // No measurement: a write meant to reset, a datagram that has not passed the reference
            // clock yet, or an offset not set yet. It is shown, not followed.
            self.difference = sample;
            return;
        }
        let depth = time_depth & 0x0F;
        if self.difference.unsigned_abs() >> FRACTION > u64::from(PLAUSIBLE) {
            self.difference = sample;
        }
        self.difference += (sample - self.difference) >> depth;
        let limited = i64::from(difference.clamp(-LIMIT, LIMIT)) << FRACTION;
        self.steering += (limited - self.steering) >> depth;

        let range = i64::from(start.clamp(START_MIN, START_MAX) - 0x7F) << FRACTION;
        let applied = (self.mean - GAIN * self.steering).clamp(-range, range);
        self.mean += (applied - self.mean) >> (speed_depth & 0x0F);
        self.applied = round(applied) as i16;
    }

    /// Register 0x0930 was written: everything starts anew.
    pub fn reset(&mut self) {
        *self = Self::new();
    }

    /// Register 0x0934 was written: the time difference starts anew, the speed stays.
    pub fn reset_time_filter(&mut self) {
        (self.difference, self.steering) = (0, 0);
    }

    /// Register 0x092C.
    pub fn difference(&self) -> SystemTimeDifference {
        if self.difference == 0 {
            return SystemTimeDifference::default();
        }
        SystemTimeDifference::from_nanos(Nanos(round(self.difference)))
    }

    /// Register 0x0932.
    pub fn mean(&self) -> i16 {
        round(self.mean) as i16
    }

    /// The speed counter difference in force.
    pub const fn applied(&self) -> i16 {
        self.applied
    }
}

/// To the nearest whole number.
const fn round(fixed: i64) -> i64 {
    (fixed + (1 << (FRACTION - 1))) >> FRACTION
}

/// Fraction bits of the filters.
const FRACTION: u32 = 20;
/// Speed counter difference for each ns of time difference. Larger locks faster and follows the 10 ns
/// grain of received times more; at the reset value of 0x0930, 4 corrects a difference with a time
/// constant of about 20 ms.
const GAIN: i64 = 4;
/// Largest time difference that steers, ns: 4 times it is the largest speed counter difference at the
/// reset value of 0x0930.
const LIMIT: i32 = 1000;
/// Largest time difference taken for a measurement, ns (16 ms).
const PLAUSIBLE: u32 = 1 << 24;
