//! The line through pairs with symmetric noise: an alpha-beta filter with growing memory.

use isocat_wire::time::{Host, Nanos, Time};

use super::line::{Line, RATE_LIMIT, root};
use super::servo::Uncertainty;

/// Weights and noise of the fit.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct LeastSquares {
    samples: u32,
    alpha: f64,
    beta: f64,
    interval: f64,
    /// Mean square of the distances of samples from the line, ns².
    square: f64,
    /// Whether the last sample was surprisingly late (1) or early (-1).
    surprise: i8,
}

impl LeastSquares {
    /// Moves the line towards a sample that is `error` ns later than the line says.
    pub fn sample(
        &mut self,
        line: &Line,
        host: Time<Host>,
        interval: Nanos,
        error: f64,
        bandwidth_hz: f64,
    ) -> Line {
        self.samples = self.samples.saturating_add(1).max(2);
        self.interval = interval.0 as f64;
        self.forget_if_surprised(error);
        // These are the weights of the least-squares line through the samples so far, until the
        // bandwidth asks for larger ones. Critically damped: alpha = 2·w·T, beta = (w·T)².
        let n = f64::from(self.samples);
        let w = (2.0 * core::f64::consts::PI * bandwidth_hz * self.interval / 1e9).min(0.5);
        self.alpha = (2.0 * (2.0 * n - 1.0) / (n * (n + 1.0))).max(2.0 * w).min(1.0);
        self.beta = (6.0 / (n * (n + 1.0))).max(w * w).min(1.0);
        // Two points always lie on a line, so the third is the first with an error. The error
        // against a line that was fitted without the sample exceeds the noise by the line's own
        // error.
        if self.samples > 2 {
            let weight = (1.0 / (n - 2.0)).max(1.0 / NOISE_MEMORY);
            let square = error * error * (1.0 - self.alpha);
            self.square += weight * (square - self.square);
        }
        let mut line = line.moved(host, self.alpha * error);
        line.rate = (line.rate + self.beta * error / self.interval).clamp(-RATE_LIMIT, RATE_LIMIT);
        line
    }

    /// Restarts the fit after two samples in a row that are off to the same side by far more than
    /// the noise: the rate has changed, and earlier samples are useless. The line goes through both
    /// and learns again.
    fn forget_if_surprised(&mut self, error: f64) {
        let most = match error.abs() > GRAIN {
            true => GRAIN + SURPRISE * root(self.square),
            // For most samples this is enough to see that they are no surprise.
            false => GRAIN,
        };
        let surprise = i8::from(error > most) - i8::from(error < -most);
        if self.samples >= KNOWN && surprise != 0 && surprise == self.surprise {
            self.samples = 2;
        }
        self.surprise = surprise;
    }

    /// Number of samples of the line.
    pub fn samples(&self) -> u32 {
        self.samples
    }

    /// The error of the line; `None` for fewer than three samples.
    ///
    /// With the weights of a least-squares fit the variances are those of its end point and its
    /// slope: alpha and 12 / (n³ T²) times that of the noise. With constant weights they are those
    /// of an alpha-beta filter in white noise.
    pub fn uncertainty(&self) -> Option<Uncertainty> {
        if self.samples < 3 {
            return None;
        }
        // The grain of the clocks remains even if a few samples agree to the nanosecond.
        let noise = root(self.square).max(LEAST_NOISE);
        let (a, b, n) = (self.alpha, self.beta, f64::from(self.samples));
        let grows = b <= 6.0 / (n * (n + 1.0)) * 1.000_001;
        let (phase, rate) = if grows {
            (a, 12.0 / (n * (n * n - 1.0)))
        } else {
            let below = a * (4.0 - 2.0 * a - b);
            ((2.0 * a * a + b * (2.0 - 3.0 * a)) / below, 2.0 * b * b / below)
        };
        // Scaled so that the root of a small number keeps its digits.
        let rate = root(rate * 1e6) / 1e3 * noise / self.interval * 1e9;
        Some(Uncertainty { phase_ns: noise * root(phase), rate_ppb: rate })
    }
}

/// Samples after which the noise is known.
const KNOWN: u32 = 16;
/// The part of the tick in a surprise, ns.
const GRAIN: f64 = 20.0;
/// Standard deviations that a sample must be off to be a surprise.
const SURPRISE: f64 = 5.0;
/// Number of samples over which the noise is averaged.
const NOISE_MEMORY: f64 = 64.0;
/// Noise of a clock with ticks of 10 ns, ns: 10 / sqrt(12).
const LEAST_NOISE: f64 = 2.9;
