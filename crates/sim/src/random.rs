//! The only source of random numbers: a generator with one seed for each run, split by purpose.

use rand_core::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256StarStar;

/// A stream of random numbers for one purpose.
///
/// Streams are split from the run's seed by name, so that a new use of random numbers does not
/// change the other streams.
#[derive(Clone, Debug)]
pub struct Stream(Xoshiro256StarStar);

impl Stream {
    /// The stream of the run `seed` for the purpose `name`; `number` distinguishes several of them.
    pub fn new(seed: u64, name: &str, number: u64) -> Self {
        // FNV-1a over the name is stable, unlike the standard library's hashers.
        let hash = name.bytes().fold(0xcbf2_9ce4_8422_2325u64, |h, b| {
            (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3)
        });
        let mixed = seed ^ hash.rotate_left(17) ^ number.wrapping_mul(0x9E37_79B9_7F4A_7C15);
        Self(Xoshiro256StarStar::seed_from_u64(mixed))
    }

    /// A uniform number in `0..=most`.
    pub fn up_to(&mut self, most: u64) -> u64 {
        // Multiply-shift; its bias is below 2^-64 × `most`, which no statistic can show.
        ((u128::from(self.0.next_u64()) * (u128::from(most) + 1)) >> 64) as u64
    }

    /// A lateness between 0 and `worst`: the absolute value of a normal deviate whose standard
    /// deviation is a quarter of `worst`, limited to `worst`. Its mean is about a fifth of `worst`.
    pub fn lateness(&mut self, worst: u64) -> u64 {
        // The sum of twelve uniform numbers, less its mean 6, is close to a normal deviate. It
        // needs no floating point, so it is the same on every machine.
        const ONE: i64 = 1 << 32;
        let sum: i64 = (0..12).map(|_| (self.0.next_u64() >> 32) as i64).sum();
        let deviate = (sum - 6 * ONE).unsigned_abs();
        let late = (u128::from(deviate) * u128::from(worst) / (4 * ONE as u128)) as u64;
        late.min(worst)
    }

    /// An exponential deviate with this mean, below 44 times the mean. It needs no floating point,
    /// so it is the same on every machine.
    pub fn exponential(&mut self, mean: u64) -> u64 {
        // -ln(u) = ln(2) × (64 - log2(number)). Each squaring gives one bit of the logarithm.
        let number = self.0.next_u64().max(1);
        let zeros = number.leading_zeros();
        let mut mantissa = number << zeros;
        let mut fraction = 0u64;
        for _ in 0..LOG_BITS {
            let square = (u128::from(mantissa) * u128::from(mantissa)) >> 63;
            let carry = square >> 64 != 0;
            mantissa = (if carry { square >> 1 } else { square }) as u64;
            fraction = fraction << 1 | u64::from(carry);
        }
        let halvings = (u64::from(zeros + 1) << LOG_BITS) - fraction;
        let product = u128::from(halvings) * u128::from(LN_2) * u128::from(mean);
        (product >> (LOG_BITS + 32)) as u64
    }
}

/// Fraction bits of the logarithm.
const LOG_BITS: u32 = 20;
/// ln(2) with 32 fraction bits.
const LN_2: u64 = 2_977_044_472;

#[cfg(test)]
mod tests {
    use super::*;

    /// The numbers of xoshiro256** after its seeding by SplitMix64, computed apart from this
    /// program: another version of the generator must not change what a seed gives.
    #[test]
    fn a_seed_gives_the_same_numbers_for_ever() {
        let mut stream = Stream::new(7, "golden", 3);
        let numbers = [(); 4].map(|()| stream.up_to(u64::MAX));
        let expected = [
            0xB64E_C781_05C9_B2AC,
            0x50B1_9E77_284F_57B7,
            0xE016_A870_E250_CFBB,
            0x14E2_577E_D16D_5F49,
        ];
        assert_eq!(numbers, expected);
    }

    #[test]
    fn exponential_deviates_have_their_mean_and_median() {
        let mut stream = Stream::new(1, "test", 0);
        let mut values: Vec<u64> = (0..100_000).map(|_| stream.exponential(1_000_000)).collect();
        let mean = values.iter().sum::<u64>() / 100_000;
        assert!((990_000..1_010_000).contains(&mean), "{mean}");
        values.sort_unstable();
        assert!((683_000..703_000).contains(&values[50_000]), "{}", values[50_000]);
        assert!(values[99_999] < 44_400_000);
        assert_eq!(stream.exponential(0), 0);
    }

    #[test]
    fn streams_differ_by_seed_name_and_number_and_repeat() {
        let first = |seed, name, number| Stream::new(seed, name, number).up_to(u64::MAX);
        assert_eq!(first(1, "host", 0), first(1, "host", 0));
        let others = [first(2, "host", 0), first(1, "cpu", 0), first(1, "host", 1)];
        assert!(others.iter().all(|other| *other != first(1, "host", 0)));
    }

    #[test]
    fn lateness_stays_within_its_bound_and_reaches_out() {
        let mut stream = Stream::new(1, "test", 0);
        let values: Vec<u64> = (0..10_000).map(|_| stream.lateness(20_000)).collect();
        let mean = values.iter().sum::<u64>() / 10_000;
        assert!((3_800..4_200).contains(&mean), "{mean}");
        let largest = values.iter().max().unwrap();
        assert!((16_000..=20_000).contains(largest), "{largest}");
        assert_eq!(stream.lateness(0), 0);
    }
}
