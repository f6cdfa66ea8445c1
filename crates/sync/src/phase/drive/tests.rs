//! Tests with a reference clock that follows as a drift loop does.

use isocat_wire::time::{Dc, External, Host, Nanos, Time};

use super::*;
use crate::phase::Settings;
use crate::phase::external::Stamps;

/// A clock with a proportional and integral drift loop (20 ms and 1 s), and the host's clock.
struct Clock {
    /// Its time less host time, ns.
    ahead: f64,
    /// Rate of its quartz, and the rate that the loop adds, ppb.
    quartz: f64,
    mean: f64,
    applied: f64,
}

impl Clock {
    fn new(quartz_ppb: f64) -> Self {
        Self { ahead: 777_000_000_000.0, quartz: quartz_ppb, mean: 0.0, applied: 0.0 }
    }

    fn at(&self, host: Time<Host>) -> Time<Dc> {
        Time::new(host.count() + (self.ahead / 10.0) as u64 * 10)
    }

    fn pass(&mut self, seconds: f64) {
        self.ahead += (self.quartz + self.applied) * seconds;
    }

    fn rate(&self) -> f64 {
        self.quartz + self.applied
    }

    fn follow(&mut self, host: Time<Host>, written: Time<Dc>) {
        let difference = (written - self.at(host)).0 as f64;
        self.applied = self.mean + difference.clamp(-1_000.0, 1_000.0) * 50.0;
        self.mean += (self.applied - self.mean) / 1_000.0;
    }
}

/// Clock and drive in a loop of 1 ms; frame `i` leaves `held(i)` ns after its stamp.
struct Bench {
    clock: Clock,
    servo: Servo,
    drive: Drive,
    now: u64,
    /// Number of values written.
    written: u64,
    /// Largest distance of a value from where the servo expected the clock.
    most: Nanos,
    /// Largest change of the clock's rate within 100 ms, ppb.
    jolt: f64,
    rate: f64,
}

impl Bench {
    fn new(quartz_ppb: f64, drive: Drive, noise: Nanos) -> Self {
        Self {
            clock: Clock::new(quartz_ppb),
            servo: Servo::new(Settings::new(Nanos::millis(1), noise)),
            drive,
            now: 5_000_000,
            written: 0,
            most: Nanos::ZERO,
            jolt: 0.0,
            rate: quartz_ppb,
        }
    }

    fn run(&mut self, cycles: u64, held: impl Fn(u64) -> u64) {
        for i in 0..cycles {
            let stamp = Time::new(self.now);
            let value = self.drive.value(stamp, &self.servo);
            let arrives = Time::new(self.now + held(i));
            let found = self.clock.at(arrives);
            if let Some(value) = value {
                self.written += 1;
                self.most = self.most.max((value - self.servo.dc_at(stamp)).abs());
                self.clock.follow(arrives, value);
                self.drive.came_back(value, found);
            }
            self.servo.sample(stamp, found);
            self.servo.handle_timeout(stamp);
            self.now += 1_000_000;
            self.clock.pass(1e-3);
            if i % 100 == 99 {
                self.jolt = self.jolt.max((self.clock.rate() - self.rate).abs());
                self.rate = self.clock.rate();
            }
        }
    }
}

/// Faster than the default limits, so that runs are short.
fn limits() -> Limits {
    Limits { slew_ppb: 10_000, acceleration_ppb: 5_000, most: Nanos(1_000) }
}

/// From 100 ppm in either direction the rates meet in the time that the acceleration allows, and
/// not much sooner. They stay together, and nothing jumps.
#[test]
fn the_reference_takes_over_the_hosts_rate() {
    for quartz in [-100_000.0, 100_000.0] {
        let mut bench = Bench::new(quartz, Drive::after_host(limits()), Nanos::ZERO);
        bench.run(15_000, |_| 0);
        assert!(bench.clock.rate().abs() > 20_000.0, "5 ppm a second: {}", bench.clock.rate());
        assert_eq!(bench.drive.offset(), None);
        bench.run(15_000, |_| 0);
        assert!(bench.clock.rate().abs() < 1_000.0, "{quartz}: {}", bench.clock.rate());
        bench.run(20_000, |_| 0);
        let offset = bench.drive.offset().expect("the rates met");
        let behind = bench.drive.behind(Time::new(bench.now), &bench.servo).unwrap();
        assert!(behind.abs() < Nanos(50), "{quartz}: {behind}, offset {offset}");
        assert!(bench.jolt < 3_000.0, "half a ppm by plan in 100 ms: {}", bench.jolt);
        assert_eq!(bench.servo.state(), State::Locked);
    }
}

/// A phase is corrected at the slew and no faster, without overshoot.
#[test]
fn a_phase_is_caught_up_at_the_slew() {
    let mut bench = Bench::new(1_000.0, Drive::after_host(limits()), Nanos::ZERO);
    bench.run(10_000, |_| 0);
    // This acts as a push of the clock by 100 us: it takes 10 s at 10 ppm, and 2 s for each of both
    // ramps.
    bench.drive.offset += 100_000;
    let behind = |bench: &Bench| bench.drive.behind(Time::new(bench.now), &bench.servo).unwrap();
    let mut last = behind(&bench);
    bench.run(5_000, |_| 0);
    assert!(behind(&bench) < Nanos(-55_000), "{}", behind(&bench));
    for _ in 0..20 {
        last = last.max(behind(&bench));
        bench.run(1_000, |_| 0);
    }
    assert!(behind(&bench).abs() < Nanos(100), "{}", behind(&bench));
    assert!(last < Nanos(200), "it passed by {last}");
}

/// The delay behind the stamp is the error in the clock, to the nanosecond. The values themselves
/// stay on the line of frames that leave at once.
#[test]
fn the_figures_of_injection_are_what_was_held_up() {
    let noise = Nanos(300);
    let mut bench = Bench::new(2_000.0, Drive::after_host(limits()), noise);
    let held = |i: u64| if i.is_multiple_of(10) { 0 } else { (i * 7_919) % 600 };
    bench.run(30_000, held);
    let injected = bench.drive.injected();
    assert!(injected.count > 25_000);
    assert!((-400.0..0.0).contains(&injected.mean_ns), "{injected:?}");
    assert!((150.0..250.0).contains(&injected.deviation_ns), "{injected:?}");
    assert!((400..1_000).contains(&injected.peak_ns), "{injected:?}");
    let mut exact = Bench::new(2_000.0, Drive::after_host(limits()), Nanos::ZERO);
    exact.run(30_000, |_| 0);
    let injected = exact.drive.injected();
    assert!(injected.deviation_ns < 10.0 && injected.peak_ns < 150, "{injected:?}");
}

/// If the clock does not follow, the written values stay within the limit and nothing accumulates.
#[test]
fn a_clock_that_does_not_follow_is_not_left_behind() {
    let mut bench = Bench::new(50_000.0, Drive::after_host(limits()), Nanos::ZERO);
    for _ in 0..30_000 {
        let before = (bench.clock.mean, bench.clock.applied);
        bench.run(1, |_| 0);
        (bench.clock.mean, bench.clock.applied) = before;
    }
    assert!(bench.written > 29_000);
    assert_eq!(bench.most, Nanos(1_000));
    // The clock follows at last, and no faster than if it had always followed.
    bench.run(60_000, |_| 0);
    let behind = bench.drive.behind(Time::new(bench.now), &bench.servo);
    assert!(behind.is_some_and(|behind| behind.abs() < Nanos(100)), "{behind:?}");
}

/// Nothing is written while the host is not locked; the offset is kept over that time.
#[test]
fn silent_unless_locked() {
    let mut bench = Bench::new(500.0, Drive::after_host(limits()), Nanos::ZERO);
    bench.run(7, |_| 0);
    assert_eq!(bench.written, 0);
    bench.run(5_000, |_| 0);
    let (written, offset) = (bench.written, bench.drive.offset());
    assert!(written > 4_900 && offset.is_some());
    bench.now += 30_000_000;
    bench.clock.pass(0.03);
    bench.servo.handle_timeout(Time::new(bench.now));
    assert_eq!(bench.servo.state(), State::Holdover);
    assert_eq!(bench.drive.value(Time::new(bench.now), &bench.servo), None);
    bench.run(3_000, |_| 0);
    assert!(bench.written > written + 2_900);
    assert_eq!(bench.drive.offset(), offset);
}

/// An external time that runs 30 ppm faster than the host's leads, with either kind of stamps.
#[test]
fn an_external_time_leads() {
    let external = |host: u64| Time::<External>::new(host + host / 1_000_000 * 30 + 5_000_000_000);
    for bridge in [false, true] {
        let drive = Drive::after_external(limits(), Source::default());
        let mut bench = Bench::new(-20_000.0, drive, Nanos::ZERO);
        for i in 0..4_000_u64 {
            bench.run(10, |_| 0);
            let at = bench.now - 300_000;
            let stamps = if bridge {
                Stamps::Bridge { internal: bench.clock.at(Time::new(at)), external: external(at) }
            } else {
                let (before, after) = (Time::new(at - 1_000), Time::new(at + 1_000));
                // One read in ten was interrupted and is not used.
                let late = if i % 10 == 0 { 50_000 } else { 0 };
                let after = after + Nanos(late);
                Stamps::Hardware { before, external: external(at), after }
            };
            bench.drive.stamps(stamps, &bench.servo);
        }
        let rate = bench.clock.rate();
        assert!((rate - 30_000.0).abs() < 500.0, "bridge {bridge}: {rate}");
        let at = Time::new(bench.now);
        let difference = external(bench.now).count() as i64 - bench.clock.at(at).count() as i64;
        let offset = bench.drive.offset().expect("the rates met");
        assert!((Nanos(difference) - offset).abs() < Nanos(100), "{bridge}: {difference} {offset}");
        // Without pairs nothing is written.
        let written = bench.written;
        bench.run(1_000, |_| 0);
        assert!(bench.written < written + 110, "{}", bench.written - written);
    }
}
