//! The drift loop: what a received system time does to the clock.
//!
//! The registers are published, and so are the two filters, the limits of the speed counter
//! difference and its effect on the speed (see `clock`). It is not published how a time difference
//! becomes a speed counter difference. The [`DriftLaw`], a property of the chip, describes that.

use isocat_wire::dc::{DifferencePolarity, SystemTimeDifference};
use isocat_wire::time::{Device, Nanos, Time};

use super::drift_law::{DriftLaw, FRACTION, Received, Steering, round};

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

/// The registers that set the loop: 0x0930, 0x0934 and 0x0935.
#[derive(Clone, Copy)]
pub(crate) struct Settings {
    pub start: u16,
    pub time_depth: u8,
    pub speed_depth: u8,
}

/// The state of the loop. Filters hold fixed-point numbers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DriftLoop {
    /// Time difference as register 0x092C shows it, ns; `None` if no time was received since the
    /// reset.
    shown: Option<i64>,
    /// Filtered time difference, ns.
    filtered: i64,
    /// When a system time was last received, or when the loop was reset.
    since: Time<Device>,
    /// No time was received since the loop was reset.
    first: bool,
    steering: Steering,
}

impl DriftLoop {
    /// A loop at rest from `now` on.
    pub fn new(now: Time<Device>) -> Self {
        Self { shown: None, filtered: 0, since: now, first: true, steering: Steering::default() }
    }

    /// Handles a received system time: the local copy is `difference` ns ahead of it, in 32 bits.
    /// Returns the ns by which the local time must move.
    #[inline(always)]
    pub fn follow(
        &mut self,
        now: Time<Device>,
        difference: i32,
        zero: bool,
        settings: Settings,
        law: &DriftLaw,
    ) -> i64 {
        let sample = i64::from(difference) << FRACTION;
        // Zero was written: either a MainDevice resets the loop, or the datagram has not passed the
        // reference clock. This law shows it but does not follow it.
        if matches!(law, DriftLaw::Proportional { .. }) && zero {
            self.shown = Some(sample);
            return 0;
        }
        let time_depth = settings.time_depth & 0x0F;
        self.filtered += (sample - self.filtered) >> time_depth;
        self.shown = Some(self.filtered);
        let received = Received {
            difference,
            filtered: self.filtered,
            interval: (now - self.since).0,
            first: self.first,
            start: settings.start,
            time_depth,
            speed_depth: settings.speed_depth & 0x0F,
        };
        (self.since, self.first) = (now, false);
        self.steering.follow(law, &received)
    }

    /// Register 0x0930 was written: the whole loop restarts.
    pub fn reset(&mut self, now: Time<Device>) {
        *self = Self::new(now);
    }

    /// Register 0x0934 was written on a newer core: the time difference restarts, the speed stays.
    pub fn reset_time_filter(&mut self, now: Time<Device>) {
        (self.shown, self.filtered) = (None, 0);
        (self.since, self.first) = (now, true);
        self.steering.forget_difference();
    }

    /// Register 0x0935 was written on a newer core: the mean speed restarts.
    pub fn reset_speed_filter(&mut self) {
        self.steering.forget_speed();
    }

    /// Register 0x092C.
    #[inline]
    pub fn difference(&self, polarity: DifferencePolarity) -> SystemTimeDifference {
        self.shown.map_or(SystemTimeDifference::default(), |shown| {
            SystemTimeDifference::from_nanos(Nanos(round(shown)), polarity)
        })
    }

    /// Register 0x0932.
    #[inline]
    pub fn mean(&self) -> i16 {
        self.steering.shown()
    }

    /// The speed counter difference in force.
    #[inline]
    pub const fn applied(&self) -> i16 {
        self.steering.applied()
    }
}
