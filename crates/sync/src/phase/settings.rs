//! What the servo is told: how fast, how sure, how patient.

use isocat_wire::time::Nanos;

/// Settings of the servo.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Settings {
    /// From one sample to the next as a rule: how many of them a line of noisy stamps remembers follows from it, and
    /// not from a gap.
    pub interval: Nanos,
    /// Bandwidth of the locked loop, Hz, above zero. Larger follows the clocks' wander faster, smaller
    /// averages time-stamp noise longer. 5 Hz averages some 30 samples of a 1 ms cycle. With
    /// [`Settings::stamp_noise`] the line's memory is one period of it.
    pub bandwidth_hz: f64,
    /// How much too early a time stamp is as a rule: the mean time from stamp to wire, less what of it
    /// is constant. Zero: stamps are exact.
    pub stamp_noise: Nanos,
    /// The servo is locked while its error stays below this.
    pub lock_threshold: Nanos,
    /// Samples in a row below the threshold until locked, or beyond four times it until lost.
    pub lock_count: u32,
    /// Samples that the line must have before it may be called locked.
    pub least_samples: u32,
    /// Samples further off than this are not used.
    pub outlier: Nanos,
    /// Outliers in a row after which the line itself is taken for wrong and started anew.
    pub outlier_count: u32,
    /// Without a sample for this long a locked servo is in holdover.
    pub holdover_after: Nanos,
}

impl Default for Settings {
    /// For exact stamps and a cycle of up to 4 ms.
    fn default() -> Self {
        Self {
            interval: Nanos::millis(1),
            bandwidth_hz: 5.0,
            stamp_noise: Nanos::ZERO,
            lock_threshold: Nanos(1_000),
            lock_count: 8,
            least_samples: 0,
            outlier: Nanos(20_000),
            outlier_count: 16,
            holdover_after: Nanos::millis(20),
        }
    }
}

impl Settings {
    /// Settings for one sample every `interval`, with stamps that are too early by `stamp_noise` as a
    /// rule, and now and then by any time.
    ///
    /// With noise the threshold is what all but one of fifty samples stay below if what holds frames up
    /// is distributed exponentially. The loop is slower, so that it knows a thousand samples of a
    /// 1 ms cycle, and never fewer than a hundred. The line has samples enough for a rate within
    /// some 50 ppm before it counts as locked, and so serves 100 ms without a sample. Samples come once
    /// an interval, so what is counted in time holds five of them at least, and ten where some of them
    /// are outliers.
    pub fn new(interval: Nanos, stamp_noise: Nanos) -> Self {
        let default = Self::default();
        let holds = |least: Nanos, samples| least.max(Nanos(interval.0.saturating_mul(samples)));
        if stamp_noise.0 <= 0 {
            let holdover_after = holds(default.holdover_after, 5);
            return Self { interval, holdover_after, ..default };
        }
        let seconds = interval.0.max(1) as f64 / 1e9;
        let slowest = 1.0 / (f64::from(LEAST_WINDOW) * seconds);
        Self {
            interval,
            bandwidth_hz: slowest.min(1.0),
            stamp_noise,
            lock_threshold: default.lock_threshold + Nanos(stamp_noise.0.saturating_mul(4)),
            // Eight of them would be found in noise of any size if one waits long enough.
            lock_count: 16,
            least_samples: samples_for_rate(stamp_noise, interval),
            outlier: default.outlier + Nanos(stamp_noise.0.saturating_mul(16)),
            holdover_after: holds(Nanos::millis(100), 10),
            ..default
        }
    }

    /// Samples that a line of noisy stamps remembers.
    pub(super) fn window(&self) -> u32 {
        let seconds = self.interval.0.max(1) as f64 / 1e9;
        ((1.0 / (self.bandwidth_hz * seconds)) as u32).max(LEAST_WINDOW)
    }

    /// The largest number of samples that locking takes when nothing is in its way.
    pub fn samples_to_lock(&self) -> u32 {
        self.least_samples.max(1) + self.lock_count
    }
}

/// Samples after which a least-squares line knows the rate to [`RATE_WANTED`]: its error is
/// sqrt(12) · noise / (interval · n^1.5).
fn samples_for_rate(noise: Nanos, interval: Nanos) -> u32 {
    let ratio = noise.0 as f64 / (interval.0.max(1) as f64 * RATE_WANTED);
    let enough = |n: &u32| f64::from(*n) * f64::from(*n) * f64::from(*n) >= 12.0 * ratio * ratio;
    (8..MOST_SAMPLES).find(enough).unwrap_or(MOST_SAMPLES)
}

/// How well the rate is known before a line of noisy samples counts as locked.
const RATE_WANTED: f64 = 5e-5;
/// Most samples before lock.
const MOST_SAMPLES: u32 = 512;
/// Fewest samples that a line of noisy stamps remembers.
const LEAST_WINDOW: u32 = 100;
