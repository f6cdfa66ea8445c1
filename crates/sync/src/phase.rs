//! The clock servo: the host follows the reference clock, to an explicit phase.
//!
//! Each cycle gives one pair: the host time at which a frame was sent, and the system time that the
//! reference clock wrote into it. From these pairs the servo keeps a line (offset and rate) that says
//! at which host time a given system time will come; frames are sent when the phase target comes.
//! Lateness of a single wake-up is in both members of the pair and therefore does not disturb the
//! line.
//!
//! The line is an alpha-beta filter with growing memory: the first samples are weighted as a
//! least-squares fit weights them, so it locks within a few cycles; then the weights stay at what the
//! bandwidth asks for. Gains follow from bandwidth and sample interval, so one setting serves every
//! cycle time.

use isocat_wire::time::{Dc, Host, Nanos, Time};

/// Settings of the servo.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Settings {
    /// Bandwidth of the locked loop, Hz. Larger follows the clocks' wander faster, smaller averages
    /// time-stamp noise longer. 5 Hz averages some 30 samples of a 1 ms cycle.
    pub bandwidth_hz: f64,
    /// The servo is locked while its error stays below this.
    pub lock_threshold: Nanos,
    /// Samples in a row below the threshold until locked, or beyond four times it until lost.
    pub lock_count: u32,
    /// While locked, samples further off than this are not used.
    pub outlier: Nanos,
    /// Outliers in a row after which the line itself is taken for wrong and started anew.
    pub outlier_count: u32,
    /// Without a sample for this long a locked servo is in holdover.
    pub holdover_after: Nanos,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            bandwidth_hz: 5.0,
            lock_threshold: Nanos(1_000),
            lock_count: 8,
            outlier: Nanos(20_000),
            outlier_count: 16,
            holdover_after: Nanos::millis(20),
        }
    }
}

/// What the servo knows.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum State {
    /// No sample yet.
    Free,
    /// The line is not yet trusted.
    Acquiring,
    /// The line predicts the samples within the threshold.
    Locked,
    /// No samples come; the line is extended.
    Holdover,
}

/// Follows the reference clock with a line through pairs of host and system time.
#[derive(Clone, Debug)]
pub struct Servo {
    settings: Settings,
    state: State,
    /// A point of the line, system time as of `host`, with its fraction of a nanosecond.
    host: Time<Host>,
    dc: Time<Dc>,
    fraction: f64,
    /// System time runs faster than host time by this part.
    rate: f64,
    samples: u32,
    last_sample: Time<Host>,
    last_error: Nanos,
    good: u32,
    bad: u32,
    outliers: u32,
}

impl Servo {
    /// A servo without samples.
    pub fn new(settings: Settings) -> Self {
        Self {
            settings,
            state: State::Free,
            host: Time::ZERO,
            dc: Time::ZERO,
            fraction: 0.0,
            rate: 0.0,
            samples: 0,
            last_sample: Time::ZERO,
            last_error: Nanos::ZERO,
            good: 0,
            bad: 0,
            outliers: 0,
        }
    }

    /// Takes one pair: a frame sent at `host` found the reference clock at `dc`.
    pub fn sample(&mut self, host: Time<Host>, dc: Time<Dc>) {
        if self.state == State::Free {
            self.restart(host, dc);
            return;
        }
        let interval = host - self.last_sample;
        if interval.0 <= 0 {
            return;
        }
        let (predicted, fraction) = self.predict(host);
        let error = (dc - predicted).0 as f64 - fraction;
        self.last_error = Nanos(round(error));
        if self.state == State::Locked && self.last_error.abs() > self.settings.outlier {
            self.outliers += 1;
            if self.outliers >= self.settings.outlier_count {
                self.restart(host, dc);
            }
            return;
        }
        self.outliers = 0;
        self.samples = self.samples.saturating_add(1);
        let (alpha, beta) = self.gains(interval);
        let correction = fraction + alpha * error;
        let whole = round(correction);
        self.host = host;
        self.dc = predicted + Nanos(whole);
        self.fraction = correction - whole as f64;
        self.rate = (self.rate + beta * error / interval.0 as f64).clamp(-RATE_LIMIT, RATE_LIMIT);
        self.last_sample = host;
        self.judge();
    }

    /// Tells the servo the time, so that it notices missing samples.
    pub fn handle_timeout(&mut self, now: Time<Host>) {
        if self.state == State::Locked && now - self.last_sample > self.settings.holdover_after {
            self.state = State::Holdover;
        }
    }

    /// Forgets everything: the reference clock is another one.
    pub fn reset(&mut self) {
        *self = Self::new(self.settings);
    }

    /// What the servo knows.
    pub fn state(&self) -> State {
        self.state
    }

    /// The last sample less its prediction.
    pub fn last_error(&self) -> Nanos {
        self.last_error
    }

    /// How much faster system time runs than host time, parts per billion.
    pub fn rate_ppb(&self) -> i64 {
        round(self.rate * 1e9)
    }

    /// The system time that a frame sent at `host` will find at the reference clock. Host time itself
    /// while there is no sample.
    pub fn dc_at(&self, host: Time<Host>) -> Time<Dc> {
        let (dc, fraction) = self.predict(host);
        dc + Nanos(round(fraction))
    }

    /// When to send so that the frame finds system time `dc` at the reference clock.
    pub fn host_at(&self, dc: Time<Dc>) -> Time<Host> {
        let ahead = (dc - self.dc).0 as f64 - self.fraction;
        self.host + Nanos(round(ahead / (1.0 + self.rate)))
    }

    /// The first send time not before `earliest` whose frame finds the reference clock at `phase` of a
    /// cycle of `cycle`. Panics if the cycle is not positive.
    pub fn next_send(&self, earliest: Time<Host>, cycle: Nanos, phase: Nanos) -> Time<Host> {
        assert!(cycle.0 > 0, "a cycle has a length");
        let from = self.dc_at(earliest);
        let into = (from + -phase).phase(cycle.0 as u64) as i64;
        let wait = if into == 0 { 0 } else { cycle.0 - into };
        let send = self.host_at(from + Nanos(wait));
        // Rounding may put the instant a nanosecond before `earliest`.
        send.max(earliest)
    }

    fn restart(&mut self, host: Time<Host>, dc: Time<Dc>) {
        let rate = self.rate;
        *self = Self::new(self.settings);
        self.state = State::Acquiring;
        (self.host, self.dc, self.last_sample) = (host, dc, host);
        self.rate = rate;
        self.samples = 1;
    }

    fn predict(&self, host: Time<Host>) -> (Time<Dc>, f64) {
        let elapsed = host - self.host;
        let correction = self.fraction + elapsed.0 as f64 * self.rate;
        let whole = round(correction);
        (self.dc + elapsed + Nanos(whole), correction - whole as f64)
    }

    /// Weights of the least-squares line through the samples so far, until the bandwidth asks for
    /// more. Critically damped: alpha = 2·w·T, beta = (w·T)².
    fn gains(&self, interval: Nanos) -> (f64, f64) {
        let n = f64::from(self.samples);
        let w = (2.0 * core::f64::consts::PI * self.settings.bandwidth_hz * interval.0 as f64
            / 1e9)
            .min(0.5);
        let alpha = (2.0 * (2.0 * n - 1.0) / (n * (n + 1.0))).max(2.0 * w).min(1.0);
        let beta = (6.0 / (n * (n + 1.0))).max(w * w).min(1.0);
        (alpha, beta)
    }

    fn judge(&mut self) {
        let error = self.last_error.abs();
        let threshold = self.settings.lock_threshold;
        self.good = if error <= threshold { self.good + 1 } else { 0 };
        self.bad = if error.0 > 4 * threshold.0 { self.bad + 1 } else { 0 };
        self.state = match self.state {
            State::Acquiring if self.good >= self.settings.lock_count => State::Locked,
            State::Holdover => State::Acquiring,
            State::Locked if self.bad >= self.settings.lock_count => State::Acquiring,
            state => state,
        };
    }
}

/// To the nearest whole number; `f64::round` needs std.
fn round(value: f64) -> i64 {
    (if value < 0.0 { value - 0.5 } else { value + 0.5 }) as i64
}

/// No two quartz clocks differ by more than 0.1 %: a steeper line is a misreading.
const RATE_LIMIT: f64 = 1e-3;

#[cfg(test)]
mod tests {
    use super::*;

    /// System time as a function of host time: an offset and a rate.
    fn dc(host: u64, ppm: i64) -> Time<Dc> {
        Time::new((777_000_000_123 + host as i64 + host as i64 * ppm / 1_000_000) as u64)
    }

    fn run(servo: &mut Servo, from: u64, cycles: u64, ppm: i64, noise: impl Fn(u64) -> i64) {
        for i in 0..cycles {
            let host = from + i * 1_000_000;
            servo.sample(Time::new(host), dc(host, ppm) + Nanos(noise(i)));
        }
    }

    #[test]
    fn locks_within_twenty_samples_on_any_phase_and_rate() {
        for ppm in [-100, -35, 0, 48, 100] {
            let mut servo = Servo::new(Settings::default());
            run(&mut servo, 5_000, 20, ppm, |i| (i as i64 * 7919 % 21) - 10);
            assert_eq!(servo.state(), State::Locked, "{ppm} ppm");
            assert!((servo.rate_ppb() - ppm * 1000).abs() < 3_000, "{}", servo.rate_ppb());
        }
    }

    #[test]
    fn the_line_is_better_than_its_noise() {
        let mut servo = Servo::new(Settings::default());
        run(&mut servo, 0, 2_000, 48, |i| (i as i64 * 7919 % 21) - 10);
        let ahead = 2_000_000_000;
        let error = servo.dc_at(Time::new(ahead)) - dc(ahead, 48);
        assert!(error.abs() < Nanos(10), "{error}");
        assert_eq!(servo.host_at(servo.dc_at(Time::new(ahead))), Time::new(ahead));
    }

    #[test]
    fn sends_hit_the_phase_target() {
        let mut servo = Servo::new(Settings::default());
        run(&mut servo, 0, 200, -35, |_| 0);
        let (cycle, phase) = (Nanos(1_000_000), Nanos(123_456));
        let mut at = Time::new(200_000_000);
        for _ in 0..50 {
            at = servo.next_send(at, cycle, phase);
            let error = servo.dc_at(at).phase(1_000_000) as i64 - 123_456;
            assert!(error.abs() <= 1, "{error}");
            at += Nanos(1);
        }
    }

    #[test]
    fn one_outlier_is_ignored_and_a_new_truth_accepted() {
        let mut servo = Servo::new(Settings::default());
        run(&mut servo, 0, 100, 20, |_| 0);
        let before = servo.dc_at(Time::new(101_000_000));
        servo.sample(Time::new(100_000_000), dc(100_000_000, 20) + Nanos(20_001));
        assert_eq!(servo.dc_at(Time::new(101_000_000)), before);
        run(&mut servo, 102_000_000, 40, 20, |_| 5_000_000);
        assert_eq!(servo.state(), State::Locked);
        let error = servo.dc_at(Time::new(150_000_000)) - dc(150_000_000, 20);
        assert!((error - Nanos(5_000_000)).abs() < Nanos(100), "{error}");
    }

    #[test]
    fn holdover_when_samples_stop() {
        let mut servo = Servo::new(Settings::default());
        run(&mut servo, 0, 100, 20, |_| 0);
        servo.handle_timeout(Time::new(99_000_000 + 20_000_000));
        assert_eq!(servo.state(), State::Locked);
        servo.handle_timeout(Time::new(99_000_000 + 20_000_001));
        assert_eq!(servo.state(), State::Holdover);
        run(&mut servo, 130_000_000, 20, 20, |_| 0);
        assert_eq!(servo.state(), State::Locked);
    }
}
