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
//!
//! A program stamps a frame before it hands it over, so a stamp is never too late, only too early: by
//! some microseconds always, by a millisecond when the program was interrupted in between. Seen from
//! the stamp the reference is then later than the line says, never earlier. The servo uses this in
//! three ways:
//!
//! - While it acquires, a sample far later than the line is left out; one far earlier proves that the
//!   line itself was begun with a frame that was held up, and begins it anew.
//! - Where stamps are not exact, a later sample counts as no later than the lock threshold, and while
//!   the servo is locked it weighs a quarter of an earlier one. So the line lies near the frames that
//!   left at once, and what holds up the others does not move it.
//! - The plan keeps time for frames that are late, not for early ones: a line near the earliest is the
//!   one to send by.

use isocat_wire::time::{Dc, Host, Nanos, Time};

/// Settings of the servo.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Settings {
    /// Bandwidth of the locked loop, Hz. Larger follows the clocks' wander faster, smaller averages
    /// time-stamp noise longer. 5 Hz averages some 30 samples of a 1 ms cycle.
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
    /// is distributed exponentially. The loop is slower, so that it averages a hundred samples of a
    /// 1 ms cycle or more, and never fewer than sixteen. The line has samples enough for a rate within
    /// some 50 ppm before it counts as locked, and so serves 100 ms without a sample. Samples come once
    /// an interval, so what is counted in time holds five of them at least, and ten where some of them
    /// are outliers.
    pub fn new(interval: Nanos, stamp_noise: Nanos) -> Self {
        let default = Self::default();
        let holds = |least: Nanos, samples| least.max(Nanos(interval.0.saturating_mul(samples)));
        if stamp_noise.0 <= 0 {
            return Self { holdover_after: holds(default.holdover_after, 5), ..default };
        }
        let seconds = interval.0.max(1) as f64 / 1e9;
        let slowest = 1.0 / (16.0 * 2.0 * core::f64::consts::PI * seconds);
        Self {
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
        let mut error = (dc - predicted).0 as f64 - fraction;
        self.last_error = Nanos(round(error));
        if self.is_outlier(interval) {
            self.outliers += 1;
            let held_up = self.last_error.0 > 0 || self.state == State::Locked;
            if !held_up || self.outliers >= self.settings.outlier_count {
                self.restart(host, dc);
            }
            return;
        }
        self.outliers = 0;
        if self.settings.stamp_noise.0 > 0 && error > 0.0 {
            let most = self.settings.lock_threshold + self.rate_allowance(interval);
            error = error.min(most.0 as f64);
            if self.state == State::Locked {
                error /= LATE_WEIGHT;
            }
        }
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

    /// Whether the last sample is too far off to be used.
    fn is_outlier(&self, interval: Nanos) -> bool {
        self.last_error.abs() > self.settings.outlier + self.rate_allowance(interval)
    }

    /// What a line of few samples may be off since it does not know its rate yet.
    fn rate_allowance(&self, interval: Nanos) -> Nanos {
        match self.state {
            State::Locked => Nanos::ZERO,
            _ if self.samples >= RATE_KNOWN => Nanos::ZERO,
            _ => Nanos((2.0 * RATE_LIMIT * interval.0 as f64) as i64),
        }
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
            State::Acquiring
                if self.good >= self.settings.lock_count
                    && self.samples >= self.settings.least_samples =>
            {
                State::Locked
            }
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
/// How well the rate is known before a line of noisy samples counts as locked.
const RATE_WANTED: f64 = 5e-5;
/// Most samples before lock.
const MOST_SAMPLES: u32 = 512;
/// Samples from which on a line knows its rate.
const RATE_KNOWN: u32 = 8;
/// How much less a sample later than the line weighs, while locked on stamps that are not exact.
const LATE_WEIGHT: f64 = 4.0;

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

    /// Frames leave after their stamp: by an exponential time of this mean, and one of `every` by up to
    /// a millisecond more.
    struct Host {
        random: u64,
        mean: f64,
        every: u64,
    }

    impl Host {
        fn new(seed: u64, mean: f64, every: u64) -> Self {
            Self { random: seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1, mean, every }
        }

        fn random(&mut self) -> u64 {
            self.random ^= self.random << 13;
            self.random ^= self.random >> 7;
            self.random ^= self.random << 17;
            self.random.wrapping_mul(0x2545_F491_4F6C_DD1D)
        }

        /// From the stamp to the wire, ns.
        fn held_up(&mut self) -> i64 {
            let uniform = (self.random() >> 11) as f64 / (1u64 << 53) as f64;
            let mut held = -(1.0 - uniform).ln() * self.mean;
            if self.random() % self.every < 1 {
                held += (10_000 + self.random() % 990_000) as f64;
            }
            held as i64
        }
    }

    /// Runs a servo of this host for a time; gives the samples until it locked, and how often it was not
    /// locked behind that.
    fn run_noisy(
        servo: &mut Servo,
        host: &mut Host,
        cycle: Nanos,
        cycles: u64,
        ppm: i64,
    ) -> (Option<u64>, u64) {
        let (mut locked, mut lost) = (None, 0);
        for i in 0..cycles {
            let stamp = 77_000 + i * cycle.0 as u64;
            let left = stamp + host.held_up() as u64;
            servo.sample(Time::new(stamp), dc(left, ppm));
            servo.handle_timeout(Time::new(stamp + 50_000));
            let is_locked = servo.state() == State::Locked;
            locked = locked.or(is_locked.then_some(i + 1));
            lost += u64::from(locked.is_some() && !is_locked);
        }
        (locked, lost)
    }

    /// Ordinary hosts: locked soon, never lost, and the line between the frames that left at once and
    /// the mean.
    #[test]
    fn locks_on_stamps_that_are_early() {
        for (mean, every) in [(2_000, 100), (10_000, 20), (10_000, 5), (40_000, 10)] {
            for cycle in [Nanos::millis(1), Nanos::millis(4), Nanos::millis(100)] {
                for seed in 1..=20 {
                    let what = std::format!("{mean} ns, 1 of {every}, {cycle}, seed {seed}");
                    let settings = Settings::new(cycle, Nanos(mean));
                    let mut servo = Servo::new(settings);
                    let mut host = Host::new(seed, mean as f64, every);
                    let ppm = [-100, 0, 37][seed as usize % 3];
                    let cycles = 3_000;
                    let (locked, lost) = run_noisy(&mut servo, &mut host, cycle, cycles, ppm);
                    let locked = locked.unwrap_or(u64::MAX);
                    assert!(locked <= 1_000, "{what}: locked after {locked}");
                    assert_eq!(lost, 0, "{what}");
                    let at = 77_000 + cycles * cycle.0 as u64;
                    let error = servo.dc_at(Time::new(at)) - dc(at, ppm);
                    assert!(
                        error > Nanos(-mean / 2) && error < Nanos(mean * 3 / 2),
                        "{what}: {error}"
                    );
                }
            }
        }
    }

    /// One frame that was held up, wherever in the acquisition: a tenth of a second later its trace is half
    /// the lock threshold at most.
    #[test]
    fn one_outlier_does_not_ruin_the_start() {
        for held_up in [5_000, 19_000, 100_000, 1_000_000, 40_000_000] {
            for at in 0..30 {
                let mut servo = Servo::new(Settings::new(Nanos::millis(1), Nanos(2_000)));
                run(&mut servo, 0, 200, 48, |i| if i == at { held_up } else { 0 });
                assert_eq!(servo.state(), State::Locked, "{held_up} ns at {at}");
                let end = 200_000_000;
                let error = servo.dc_at(Time::new(end)) - dc(end, 48);
                assert!(error.abs() < Nanos(5_000), "{held_up} ns at {at}: {error}");
            }
        }
    }

    /// Noise as set locks; ten times as much does not.
    #[test]
    fn garbage_does_not_lock() {
        let cycle = Nanos::millis(1);
        for seed in 1..=20 {
            let servo = || Servo::new(Settings::new(cycle, Nanos(5_000)));
            let mut host = Host::new(seed, 5_000.0, 1_000);
            assert!(run_noisy(&mut servo(), &mut host, cycle, 2_000, 10).0.is_some());
            let mut host = Host::new(seed, 50_000.0, 1_000);
            let locked = run_noisy(&mut servo(), &mut host, cycle, 10_000, 10).0;
            assert_eq!(locked, None, "seed {seed}");
        }
        // And without noise allowed, noise of a microsecond or two is too much.
        let mut host = Host::new(1, 5_000.0, 1_000);
        let mut exact = Servo::new(Settings::new(cycle, Nanos::ZERO));
        assert_eq!(run_noisy(&mut exact, &mut host, cycle, 10_000, 10).0, None);
    }

    /// 40 ms without a sample, then a frame that is late itself: still locked, still in phase.
    #[test]
    fn a_stall_does_not_unlock() {
        let mut servo = Servo::new(Settings::new(Nanos::millis(1), Nanos(10_000)));
        let mut host = Host::new(3, 10_000.0, 50);
        assert!(run_noisy(&mut servo, &mut host, Nanos::millis(1), 2_000, 30).0.is_some());
        let mut at = 2_000_000_000;
        for stall in [40_000_000, 2_000_000, 17_000_000] {
            at += stall;
            servo.handle_timeout(Time::new(at));
            assert_eq!(servo.state(), State::Locked);
            servo.sample(Time::new(at), dc(at + 300_000, 30));
            let error = servo.dc_at(Time::new(at)) - dc(at, 30);
            assert!(error.abs() < Nanos(15_000), "{error}");
            for _ in 0..20 {
                at += 1_000_000;
                servo.sample(Time::new(at), dc(at + host.held_up() as u64, 30));
                assert_eq!(servo.state(), State::Locked);
            }
        }
    }

    #[test]
    fn settings_follow_cycle_and_noise() {
        let exact = Settings::new(Nanos::millis(1), Nanos::ZERO);
        assert_eq!(exact, Settings::default());
        let slow = Settings::new(Nanos::millis(100), Nanos::ZERO);
        assert_eq!(slow, Settings { holdover_after: Nanos::millis(500), ..exact });
        let noisy = Settings::new(Nanos::millis(1), Nanos(10_000));
        assert_eq!(noisy.lock_threshold, Nanos(41_000));
        assert_eq!(noisy.outlier, Nanos(180_000));
        assert!((70..90).contains(&noisy.least_samples), "{}", noisy.least_samples);
        assert!(Settings::new(Nanos::millis(100), Nanos(10_000)).least_samples == 8);
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
