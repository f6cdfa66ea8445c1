//! The start time of the SYNC units: one grid for all devices, so that pulses of equal cycle
//! coincide and those of different cycles do so periodically.

use core::fmt;

use isocat_wire::time::{Dc, Nanos, Time};

/// The points of system time at which all pulses of a segment have the same positions as at the
/// first one.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Grid {
    period: u64,
}

/// Why there is no such grid.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum GridError {
    /// A period of 0 or less, or no period at all.
    NoPeriod,
    /// The periods have a common multiple only above [`Grid::LONGEST`].
    TooLong,
}

impl fmt::Display for GridError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoPeriod => f.write_str("no period above 0 ns to make a grid of"),
            Self::TooLong => {
                write!(f, "the cycles have no common multiple of at most {}", Grid::LONGEST)
            }
        }
    }
}

impl core::error::Error for GridError {}

impl Grid {
    /// The longest period: a start time must lie in the nearer half of a 32-bit clock.
    pub const LONGEST: Nanos = Nanos(1 << 31);

    /// The grid of the least common multiple of all periods: the bus cycle, and for each device the
    /// time after which its pulses repeat ([`Pulses::sync1_cycle`](crate::Pulses::sync1_cycle),
    /// [`Registers::period`](crate::opmode::Registers::period)).
    pub fn of(periods: impl IntoIterator<Item = Nanos>) -> Result<Self, GridError> {
        let mut common: Option<u64> = None;
        for Nanos(period) in periods {
            let period = u64::try_from(period).ok().filter(|period| *period > 0);
            let period = period.ok_or(GridError::NoPeriod)?;
            let so_far = common.unwrap_or(1);
            let lcm = (so_far / gcd(so_far, period)).checked_mul(period);
            let lcm = lcm.filter(|lcm| *lcm <= Self::LONGEST.0 as u64);
            common = Some(lcm.ok_or(GridError::TooLong)?);
        }
        common.map(|period| Self { period }).ok_or(GridError::NoPeriod)
    }

    /// Distance of the points.
    pub const fn period(self) -> Nanos {
        Nanos(self.period as i64)
    }

    /// The first point of the grid, shifted by `phase`, at or after `now + lead`. `now` is one
    /// reading of the reference clock for all devices; `lead` is the time needed to program all of
    /// them. A phase outside of one period counts modulo the period.
    pub fn start(self, now: Time<Dc>, lead: Nanos, phase: Nanos) -> Time<Dc> {
        let earliest = now + lead;
        let behind = i128::from(phase.0) - i128::from(earliest.count());
        earliest + Nanos(behind.rem_euclid(self.period.into()) as i64)
    }
}

/// The start time for a clock of 32 bits, or the reason why it would start at a wrong time: the
/// start must lie less than 2^31 ns ahead.
pub fn truncated(start: Time<Dc>, now: Time<Dc>) -> Result<u32, TooFarAhead> {
    let ahead = start - now;
    if (1..1 << 31).contains(&ahead.0) {
        Ok(start.count() as u32)
    } else {
        Err(TooFarAhead { ahead })
    }
}

/// A start time that a 32-bit clock takes as one in the past.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct TooFarAhead {
    /// How far it lies ahead; 0 or less means that it is in the past.
    pub ahead: Nanos,
}

impl fmt::Display for TooFarAhead {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ahead = self.ahead;
        write!(f, "a start {ahead} ahead; a 32-bit clock needs 1 ns to {}", Nanos((1 << 31) - 1))
    }
}

impl core::error::Error for TooFarAhead {}

const fn gcd(mut a: u64, mut b: u64) -> u64 {
    while b > 0 {
        (a, b) = (b, a % b);
    }
    a
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    #[test]
    fn the_grid_is_the_least_common_multiple() {
        let grid = |periods: &[i64]| Grid::of(periods.iter().copied().map(Nanos));
        assert_eq!(grid(&[1_000_000]).map(Grid::period), Ok(Nanos(1_000_000)));
        assert_eq!(grid(&[1_000_000, 250_000, 4_000_000]).unwrap().period(), Nanos(4_000_000));
        assert_eq!(grid(&[1_500_000, 1_000_000]).unwrap().period(), Nanos(3_000_000));
        assert_eq!(grid(&[]), Err(GridError::NoPeriod));
        assert_eq!(grid(&[1_000_000, 0]), Err(GridError::NoPeriod));
        assert_eq!(grid(&[-1]), Err(GridError::NoPeriod));
        // Both sides of the longest period.
        assert_eq!(grid(&[1 << 31]).unwrap().period(), Nanos(1 << 31));
        assert_eq!(grid(&[(1 << 31) + 1]), Err(GridError::TooLong));
        assert_eq!(grid(&[999_983, 999_979]), Err(GridError::TooLong));
        assert_eq!(grid(&[i64::MAX, i64::MAX - 1]), Err(GridError::TooLong));
    }

    #[test]
    fn the_start_lies_on_the_grid_and_far_enough_ahead() {
        let grid = Grid::of([Nanos(1_000_000)]).unwrap();
        let start =
            |now, phase| grid.start(Time::new(now), Nanos(100_000_000), Nanos(phase)).count();
        assert_eq!(start(7_000_300_000, 300_000), 7_100_300_000);
        assert_eq!(start(7_000_300_001, 300_000), 7_101_300_000);
        assert_eq!(start(7_000_299_999, 300_000), 7_100_300_000);
        // A maker's shift may be longer than the cycle, or below 0.
        assert_eq!(start(7_000_300_000, 2_000_200_300_000), start(7_000_300_000, 300_000));
        assert_eq!(start(7_000_300_000, -700_000), start(7_000_300_000, 300_000));
    }

    #[test]
    fn a_32_bit_clock_sees_half_its_range_ahead() {
        let now = Time::<Dc>::new(0xFFFF_FF00);
        assert_eq!(truncated(now + Nanos(0x200), now), Ok(0x100));
        assert_eq!(truncated(now + Nanos((1 << 31) - 1), now), Ok(0x7FFF_FEFF));
        assert!(truncated(now + Nanos(1 << 31), now).is_err());
        assert!(truncated(now, now).is_err());
    }

    proptest! {
        /// Devices of different cycles are started at any reading of the clock. The pulses of each
        /// lie on multiples of its own cycle, so they are in phase with those of every run before.
        #[test]
        fn cycles_that_differ_come_out_in_phase(
            times in proptest::collection::vec(1..=8i64, 1..6),
            now in 0..u64::MAX / 2,
            phase in any::<i64>(),
        ) {
            let periods: Vec<_> = times.iter().map(|times| Nanos(62_500 * times)).collect();
            let grid = Grid::of(periods.iter().copied()).unwrap();
            let lead = Nanos(100_000_000);
            let start = grid.start(Time::new(now), lead, Nanos(phase)).count();
            prop_assert!(start >= now + lead.0 as u64);
            prop_assert!(start < now + lead.0 as u64 + grid.period().0 as u64);
            for Nanos(period) in periods {
                let on = (i128::from(start) - i128::from(phase)).rem_euclid(period.into());
                prop_assert_eq!(on, 0);
            }
        }
    }
}
