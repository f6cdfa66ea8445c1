//! The servo on pairs of known clocks and known hosts.

use isocat_wire::time::{Dc, Nanos, Time};

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
