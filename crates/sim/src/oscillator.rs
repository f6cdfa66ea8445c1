//! Oscillators: what a clock of its own counts while true time passes.

use std::cmp::Ordering;

use isocat_wire::time::{Picos, Scale, Time, True};

/// An oscillator with a constant deviation from true time, counting nanoseconds from zero.
///
/// Its rate is held in 2⁻⁶⁴ ns per ps, so that the deviation is exact to 10⁻¹⁶ and no error
/// accumulates: readings are a closed form of true time, and so is the inverse.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Oscillator {
    rate: u64,
}

impl Oscillator {
    /// An oscillator that runs fast by `deviation_ppb` parts per billion (slow, if negative).
    /// Panics beyond ±1 %, where nothing is a clock any more.
    pub fn new(deviation_ppb: i64) -> Self {
        assert!(deviation_ppb.abs() <= 10_000_000, "an oscillator deviates by less than 1 %");
        let parts = u128::from((1_000_000_000 + deviation_ppb) as u64);
        Self { rate: ((parts << 64) / 1_000_000_000_000) as u64 }
    }

    /// What it counts at a point of true time: whole ns, rounded down.
    pub fn read<S: Scale>(self, at: Time<True>) -> Time<S> {
        Time::new(((u128::from(at.count()) * u128::from(self.rate)) >> 64) as u64)
    }

    /// The first point of true time at which it counts `reading`; never, if that is beyond all time.
    pub fn when<S: Scale>(self, reading: Time<S>) -> Time<True> {
        let scaled = u128::from(reading.count()) << 64;
        let at = scaled.div_ceil(u128::from(self.rate));
        u64::try_from(at).map_or(Time::NEVER, Time::new)
    }

    /// True time that passes while it counts `ns`, rounded to the nearest ps.
    pub fn span(self, ns: u64) -> Picos {
        let scaled = u128::from(ns) << 64;
        Picos(((scaled + u128::from(self.rate / 2)) / u128::from(self.rate)) as i64)
    }

    /// Compares the speed of two oscillators.
    pub fn cmp_speed(self, other: Self) -> Ordering {
        self.rate.cmp(&other.rate)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isocat_wire::time::Device;

    #[test]
    fn ten_seconds_at_48_ppm_gain_480_us() {
        let read = |ppb| Oscillator::new(ppb).read::<Device>(Time::new(10_000_000_000_000)).count();
        assert_eq!(read(0), 9_999_999_999 + 1 - 1);
        assert_eq!(read(48_000).abs_diff(10_000_480_000), 1);
        assert_eq!(read(-35_000).abs_diff(9_999_650_000), 1);
    }

    #[test]
    fn the_inverse_is_the_first_instant() {
        for ppb in [-100_000, -35_001, 0, 1, 48_000, 100_000] {
            let oscillator = Oscillator::new(ppb);
            for reading in [1, 10, 123_456_789, 4_294_967_296, 3_600_000_000_000] {
                let at = oscillator.when::<Device>(Time::new(reading));
                assert_eq!(oscillator.read::<Device>(at).count(), reading, "{ppb} ppb");
                let before = Time::new(at.count() - 1);
                assert_eq!(oscillator.read::<Device>(before).count(), reading - 1, "{ppb} ppb");
            }
        }
        assert_eq!(Oscillator::new(0).when::<Device>(Time::NEVER), Time::NEVER);
    }
}
