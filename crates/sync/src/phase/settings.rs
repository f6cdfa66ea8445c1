//! The settings of the servo: its speed, its limits, its patience.

use isocat_wire::time::Nanos;

/// Settings of the servo.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Settings {
    /// The usual time from one sample to the next. The memory of a line of noisy stamps, in
    /// samples, follows from this and not from a gap.
    pub interval: Nanos,
    /// Bandwidth of the locked loop, Hz, above zero. A larger one follows the clocks' wander
    /// faster; a smaller one averages the noise of the stamps for longer. 5 Hz averages some 30
    /// samples of a 1 ms cycle. With [`Settings::stamp_noise`] the line's memory is one period of
    /// it.
    pub bandwidth_hz: f64,
    /// How early a time stamp usually is: the mean time from stamp to wire, less its constant part.
    /// Zero means that stamps are exact.
    pub stamp_noise: Nanos,
    /// The servo is locked while its error stays below this.
    pub lock_threshold: Nanos,
    /// Number of samples in a row below the threshold until locked, or beyond four times it until
    /// lost.
    pub lock_count: u32,
    /// Number of samples that the line needs before it may count as locked.
    pub least_samples: u32,
    /// Samples with a larger error are not used.
    pub outlier: Nanos,
    /// Number of outliers in a row after which the line itself counts as wrong and is restarted.
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
    /// Settings for one sample every `interval`, with stamps that are usually too early by
    /// `stamp_noise` and sometimes by any time.
    ///
    /// With noise the threshold is a limit that 49 of 50 samples meet if the delays of frames have
    /// an exponential distribution. The loop is slower, so that it knows a thousand samples of a 1
    /// ms cycle, and never fewer than a hundred. Before it counts as locked the line has enough
    /// samples for a rate within some 50 ppm, so that it can bridge 100 ms without a sample. Times
    /// are long enough for at least five samples, one per interval, and for ten where some of them
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
            // Eight in a row would be found by chance in any noise after some time.
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

    /// Largest number of samples until lock, if all are good.
    pub fn samples_to_lock(&self) -> u32 {
        self.least_samples.max(1) + self.lock_count
    }
}

/// Number of samples after which a least-squares line knows the rate to [`RATE_WANTED`]: its error
/// is sqrt(12) · noise / (interval · n^1.5).
fn samples_for_rate(noise: Nanos, interval: Nanos) -> u32 {
    let ratio = noise.0 as f64 / (interval.0.max(1) as f64 * RATE_WANTED);
    let enough = |n: &u32| f64::from(*n) * f64::from(*n) * f64::from(*n) >= 12.0 * ratio * ratio;
    (8..MOST_SAMPLES).find(enough).unwrap_or(MOST_SAMPLES)
}

/// The error of the rate at which a line of noisy samples may count as locked.
const RATE_WANTED: f64 = 5e-5;
/// Largest number of samples before lock.
const MOST_SAMPLES: u32 = 512;
/// Fewest samples that a line of noisy stamps remembers.
const LEAST_WINDOW: u32 = 100;
