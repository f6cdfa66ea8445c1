//! The servo: lines, outliers, states.

use isocat_wire::time::{Dc, Host, Nanos, Time};

use super::envelope::Envelope;
use super::least_squares::LeastSquares;
use super::line::{Line, RATE_LIMIT, round};
use super::settings::Settings;

/// The state of the servo.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum State {
    /// No sample yet.
    Free,
    /// The line is not yet trusted.
    Acquiring,
    /// The line predicts the samples within the threshold.
    Locked,
    /// No samples arrive; the line is extended.
    Holdover,
}

/// The error of the line: one standard error each, from the distances of the samples to the line.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Uncertainty {
    /// Standard error of the phase at the newest sample, ns. It does not contain an error that no
    /// sample shows: the constant time from stamp to wire.
    pub phase_ns: f64,
    /// Standard error of the rate, parts per billion.
    pub rate_ppb: f64,
}

/// Follows the reference clock with a line through pairs of host and system time.
///
/// - Input: [`sample`](Self::sample) with each pair, [`handle_timeout`](Self::handle_timeout) from
///   time to time, [`reset`](Self::reset) for another reference;
/// - the line: [`dc_at`](Self::dc_at), [`host_at`](Self::host_at), [`next_send`](Self::next_send),
///   [`rate_ppb`](Self::rate_ppb), [`uncertainty`](Self::uncertainty);
/// - its quality: [`state`](Self::state), [`last_error`](Self::last_error).
///
/// Pairs must come in the order of their host times; one that is not later than the last is
/// ignored.
#[derive(Clone, Debug)]
pub struct Servo {
    settings: Settings,
    /// Samples that a line of noisy stamps remembers, by the settings.
    window: u32,
    state: State,
    line: Line,
    fit: Fit,
    last_sample: Time<Host>,
    last_error: Nanos,
    good: u32,
    bad: u32,
    outliers: u32,
}

/// The method that fits the line.
#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "there is one servo, and no heap to put it on")]
enum Fit {
    Exact(LeastSquares),
    Early(Envelope),
}

impl Fit {
    fn new(settings: &Settings) -> Self {
        match settings.stamp_noise.0 > 0 {
            true => Self::Early(Envelope::new()),
            false => Self::Exact(LeastSquares::default()),
        }
    }

    fn samples(&self) -> u32 {
        match self {
            Self::Exact(fit) => fit.samples(),
            Self::Early(fit) => fit.samples(),
        }
    }
}

impl Servo {
    /// A servo without samples.
    pub fn new(settings: Settings) -> Self {
        Self {
            window: settings.window(),
            settings,
            state: State::Free,
            line: Line::default(),
            fit: Fit::new(&settings),
            last_sample: Time::ZERO,
            last_error: Nanos::ZERO,
            good: 0,
            bad: 0,
            outliers: 0,
        }
    }

    /// Adds one pair: a frame sent at `host` found the reference clock at `dc`.
    pub fn sample(&mut self, host: Time<Host>, dc: Time<Dc>) {
        if self.state == State::Free {
            self.restart(host, dc);
            return;
        }
        let interval = host - self.last_sample;
        if interval.0 <= 0 {
            return;
        }
        let error = self.line.error(host, dc);
        self.last_error = Nanos(round(error));
        let distance = self.last_error.abs();
        if distance > self.settings.outlier + self.rate_allowance(interval) {
            return self.leave_out(host, dc);
        }
        self.outliers = 0;
        match &mut self.fit {
            Fit::Exact(fit) => {
                let bandwidth = self.settings.bandwidth_hz;
                self.line = fit.sample(&self.line, host, interval, error, bandwidth);
            }
            Fit::Early(_) => self.sample_early((host, dc), error),
        }
        self.last_sample = host;
        self.judge(distance);
    }

    /// Adds a pair, `error` ns from the line, to the line of noisy stamps. It is not inlined, so
    /// that exact stamps cost less.
    #[inline(never)]
    fn sample_early(&mut self, pair: (Time<Host>, Time<Dc>), error: f64) {
        let Fit::Early(fit) = &mut self.fit else { return };
        let noise = self.settings.stamp_noise;
        if let Some(line) = fit.sample(&self.line, pair, error, self.window, noise) {
            self.line = line;
        }
    }

    /// Advances the time, so that the servo notices missing samples.
    pub fn handle_timeout(&mut self, now: Time<Host>) {
        if self.state == State::Locked && now - self.last_sample > self.settings.holdover_after {
            self.state = State::Holdover;
        }
    }

    /// Restarts the servo for another reference clock.
    pub fn reset(&mut self) {
        *self = Self::new(self.settings);
    }

    /// The state of the servo.
    pub fn state(&self) -> State {
        self.state
    }

    /// The last sample less its prediction.
    pub fn last_error(&self) -> Nanos {
        self.last_error
    }

    /// How much faster system time runs than host time, parts per billion.
    pub fn rate_ppb(&self) -> i64 {
        round(self.line.rate * 1e9)
    }

    /// The errors of phase and rate; `None` while there are too few samples.
    pub fn uncertainty(&self) -> Option<Uncertainty> {
        match &self.fit {
            Fit::Exact(fit) => fit.uncertainty(),
            Fit::Early(fit) => fit.uncertainty(),
        }
    }

    /// The system time that a frame sent at `host` will find at the reference clock. Without a
    /// sample it is the host time itself.
    #[inline]
    pub fn dc_at(&self, host: Time<Host>) -> Time<Dc> {
        let (dc, fraction) = self.line.at(host);
        // It is what rounding left, so nearly always it rounds to zero.
        if fraction.abs() < 0.5 { dc } else { dc + Nanos(round(fraction)) }
    }

    /// When to send so that the frame finds system time `dc` at the reference clock.
    pub fn host_at(&self, dc: Time<Dc>) -> Time<Host> {
        self.line.when(dc)
    }

    /// The first send time not before `earliest` whose frame finds the reference clock at `phase`
    /// of a cycle of `cycle`. Panics if the cycle is not positive.
    pub fn next_send(&self, earliest: Time<Host>, cycle: Nanos, phase: Nanos) -> Time<Host> {
        // Rounding may put the instant a nanosecond before `earliest`.
        self.host_at(self.next_grid(earliest, cycle, phase)).max(earliest)
    }

    /// The system time that the frame of [`next_send`](Self::next_send) finds at the reference
    /// clock.
    pub fn next_grid(&self, earliest: Time<Host>, cycle: Nanos, phase: Nanos) -> Time<Dc> {
        assert!(cycle.0 > 0, "a cycle has a length");
        let from = self.dc_at(earliest);
        let into = (from + -phase).phase(cycle.0 as u64) as i64;
        from + Nanos(if into == 0 { 0 } else { cycle.0 - into })
    }

    /// The line itself.
    pub(super) fn line(&self) -> &Line {
        &self.line
    }

    /// Counts a sample that is too far off the line to be used.
    #[cold]
    fn leave_out(&mut self, host: Time<Host>, dc: Time<Dc>) {
        self.outliers += 1;
        let held_up = self.last_error.0 > 0 || self.state == State::Locked;
        if !held_up || self.outliers >= self.settings.outlier_count {
            self.restart(host, dc);
        }
    }

    /// The additional error of a line of few samples, which does not know its rate yet.
    fn rate_allowance(&self, interval: Nanos) -> Nanos {
        match self.state {
            State::Locked => Nanos::ZERO,
            _ if self.fit.samples() >= RATE_KNOWN => Nanos::ZERO,
            _ => Nanos((2.0 * RATE_LIMIT * interval.0 as f64) as i64),
        }
    }

    #[cold]
    #[inline(never)]
    fn restart(&mut self, host: Time<Host>, dc: Time<Dc>) {
        let rate = self.line.rate;
        *self = Self::new(self.settings);
        self.state = State::Acquiring;
        self.last_sample = host;
        self.line = Line { host, dc, fraction: 0.0, rate };
        self.sample_early((host, dc), 0.0);
    }

    /// Takes the distance of a sample from the line.
    fn judge(&mut self, distance: Nanos) {
        let threshold = self.settings.lock_threshold;
        self.good = if distance <= threshold { self.good + 1 } else { 0 };
        self.bad = if distance.0 > 4 * threshold.0 { self.bad + 1 } else { 0 };
        if self.state == State::Locked && self.bad < self.settings.lock_count {
            return;
        }
        self.state = match self.state {
            State::Acquiring
                if self.good >= self.settings.lock_count
                    && self.fit.samples() >= self.settings.least_samples =>
            {
                State::Locked
            }
            State::Holdover | State::Locked => State::Acquiring,
            state => state,
        };
    }
}

/// Samples after which a line knows its rate.
const RATE_KNOWN: u32 = 8;
